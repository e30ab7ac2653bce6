"""Animations of Choregraphe for NAO and Pepper: `.xar`, `.qianim`, and its export to Python.

A timeline of a `.xar` file has curves of keys by frame, and is named as its box; frames become
times by `fps`. Angles are degrees there, and radians in the export to Python, which is read as
text and not run: `names.append("HeadYaw")`, `times.append([…])`, `keys.append([…])`. Hands open
by a share from 0 to 1. The tangents of the curves are not carried over.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from lss_motion.interchange.fields import NUMBER_MAX, TextLines, parse_xml, text_head
from lss_motion.interchange.reader import (
    FPS_MAX,
    VALUES_MAX,
    Measure,
    Reader,
    motion_of_curves,
    read_or_refused,
    summarised,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.interchange.reader import Curves, ForeignMotion, RefusedMotion

FPS: Final = 25.0
"""Of a timeline that does not give it, the default of Choregraphe."""

FRAME_MAX: Final = 10_000_000
MUTED: Final = frozenset({"1", "true"})
UNITS: Final = {
    "0": Measure.DEG,
    "degree": Measure.DEG,
    "1": Measure.RAW,
    "dimensionless": Measure.RAW,
    "meter": Measure.M,
}
"""Values of `unit`. Without one, all but hands are in degrees."""

_HAND: Final = re.compile(r".*hand", re.IGNORECASE)


def _is_choregraphe(data: bytes) -> bool:
    head = text_head(data, 65_536)
    if b"<ChoregrapheProject" in head or (b"<ActuatorCurve" in head and b"actuator=" in head):
        return True
    return all(f"{name}.append(".encode() in head for name in ("names", "times", "keys"))


def _choregraphe_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    if not lines.text.lstrip().startswith("<"):
        return (_from_python(lines),)
    found = _XarTimelines(lines)
    parse_xml(lines, found.start, found.end, lambda _: None)
    if not found.timelines:
        lines.refuse(None, "has no timeline with keys of joints; other boxes hold no motion")
    return tuple(
        read_or_refused(timeline.name, partial(timeline.motion, lines))
        for timeline in found.timelines
    )


CHOREGRAPHE: Final = Reader("choregraphe", _is_choregraphe, _choregraphe_motions)
"""Reads `<Timeline fps>` with `<ActuatorCurve actuator><Key frame value>`, and the export."""


@dataclass(slots=True)
class _XarTimeline:
    """The curves below one `<Timeline>`, or below an animation."""

    name: str
    fps: float
    keys: Curves = field(default_factory=dict)
    units: dict[str, Measure] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)

    def motion(self, lines: TextLines) -> ForeignMotion:
        about = [f"Imported from {lines.path.name} (Choregraphe, timeline {self.name!r:.60})."]
        about += summarised(["the tangents of the curves", *self.left_out])
        return motion_of_curves(
            lines.path, self.name, self.keys, self.units.__getitem__, comments=about
        )


@dataclass(slots=True)
class _XarTimelines:
    """The timelines of an XML file that have keys, in its order."""

    lines: TextLines
    timelines: list[_XarTimeline] = field(default_factory=list)
    boxes: list[str] = field(default_factory=list)
    """The names of the boxes around the present element."""
    open: list[_XarTimeline] = field(default_factory=list)
    curve: str | None = None
    """The joint of the present curve; None where it is muted."""
    count: int = 0

    def start(self, line: int, tag: str, attributes: dict[str, str]) -> None:
        match tag:
            case "Box" | "ChoregrapheBox":
                self.boxes.append(attributes.get("name", ""))
            case "Timeline" | "Animation":
                name = self.boxes[-1] if self.boxes else ""
                self.open.append(
                    _XarTimeline(name or self.lines.path.stem, self._fps(line, attributes))
                )
            case "ActuatorCurve":
                self._begin(line, attributes)
            case "Key" if self.curve is not None:
                self._key(line, attributes, self.curve)
            case _:
                pass

    def end(self, tag: str) -> None:
        match tag:
            case "Box" | "ChoregrapheBox":
                self.boxes.pop()
            case "Timeline" | "Animation":
                timeline = self.open.pop()
                if timeline.keys:
                    self.timelines.append(timeline)
            case "ActuatorCurve":
                self.curve = None
            case _:
                pass

    def _begin(self, line: int, attributes: dict[str, str]) -> None:
        joint = attributes.get("actuator", "").strip()
        if not joint or not self.open:
            self.lines.refuse(line, "<ActuatorCurve> must name its actuator, in a <Timeline>")
        timeline = self.open[-1]
        if joint in timeline.units:
            self.lines.refuse(line, f"actuator {joint!r:.60} has two curves in one timeline")
        if attributes.get("mute", "0").lower() in MUTED:
            timeline.left_out.append(f"actuator {joint}, which is muted")
            return
        if "fps" in attributes:
            timeline.fps = self._fps(line, attributes)
        unit = attributes.get("unit", "-1").lower()
        is_share = _HAND.fullmatch(joint) is not None
        timeline.units[joint] = UNITS.get(unit, Measure.RAW if is_share else Measure.DEG)
        if unit not in {*UNITS, "-1"}:
            self.lines.refuse(line, f"unit {unit!r:.40} of actuator {joint!r:.60} is not known")
        self.curve = joint

    def _key(self, line: int, attributes: dict[str, str], joint: str) -> None:
        timeline = self.open[-1]
        frame = self.lines.whole(attributes.get("frame", ""), line, FRAME_MAX)
        value = self.lines.number(attributes.get("value", ""), line)
        self.count += 1
        if self.count > VALUES_MAX or abs(value) > NUMBER_MAX:
            self.lines.refuse(line, f"more than {VALUES_MAX:,} keys, or a value out of range")
        own = timeline.keys.setdefault(joint, {})
        if frame / timeline.fps in own:
            self.lines.refuse(line, f"actuator {joint!r:.60} has two keys in frame {frame}")
        own[frame / timeline.fps] = value, line

    def _fps(self, line: int, attributes: dict[str, str]) -> float:
        fps = self.lines.number(attributes["fps"], line) if "fps" in attributes else FPS
        if not 0.0 < fps <= FPS_MAX:
            self.lines.refuse(line, f"fps {fps:g} must be more than 0 and at most {FPS_MAX:g}")
        return fps


_CALL: Final = re.compile(
    r"^[ \t]*(names|times|keys)\.append\((.*)\)[ \t;]*(?:#.*)?$", re.MULTILINE
)
_BEZIER: Final = re.compile(r"\[\s*([-+.\deE]+)\s*,\s*\[[^\[\]]*\](?:\s*,\s*\[[^\[\]]*\])?\s*\]")
"""A key of the export with tangents: `[value, [type, dt, dy], [type, dt, dy]]`."""


def _calls(lines: TextLines) -> Iterator[tuple[str, str, int]]:
    """Yield list, argument and line of each `append` of the export."""
    line, at = 1, 0
    for call in _CALL.finditer(lines.text):
        line += lines.text.count("\n", at, call.start())
        at = call.start()
        yield call[1], call[2].strip(), line


def _from_python(lines: TextLines) -> ForeignMotion:
    keys: Curves = {}
    joint, count = "", 0
    times_s: list[float] = []
    for name, argument, line in _calls(lines):
        if name == "names":
            joint = argument.strip("\"'")
            if not joint or joint in keys:
                lines.refuse(line, f"joint {joint!r:.60} is named twice, or has no name")
            continue
        values = _numbers(lines, line, _BEZIER.sub(r"\1", argument))
        count += len(values)
        if count > VALUES_MAX:
            lines.refuse(line, f"more than {VALUES_MAX:,} values")
        if name == "times":
            times_s = values
            continue
        if not joint or len(values) != len(times_s) or not values:
            lines.refuse(line, f"{len(values)} keys of {joint!r:.60} for {len(times_s)} times")
        if any(b <= a for a, b in pairwise(times_s)):
            lines.refuse(line, f"the times of {joint!r:.60} must increase")
        own = zip(times_s, values, strict=True)
        keys[joint] = {at_s: (value, line) for at_s, value in own}
    if not keys:
        lines.refuse(None, "has no names, times and keys")
    units = {joint: Measure.RAW if _HAND.fullmatch(joint) else Measure.RAD for joint in keys}
    about = [f"Imported from {lines.path.name} (Choregraphe, export to Python)."]
    return motion_of_curves(lines.path, "", keys, units.__getitem__, comments=about)


def _numbers(lines: TextLines, line: int, argument: str) -> list[float]:
    if not argument.startswith("[") or not argument.endswith("]"):
        lines.refuse(line, f"{argument!r:.60} is no list of numbers")
    words = [word for word in argument[1:-1].split(",") if word.strip()]
    return [lines.number(word, line) for word in words]
