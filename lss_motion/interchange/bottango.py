"""`AnimationCommands.json` of Bottango: Bezier curves in time, signals between two pulse widths.

A curve `sC,id,start,duration,y0,x0,c0,y1,x1,c1` runs from y0 to y1. 0 is the least and 8192 the
largest signal of the effector. The control points (x in ms, c in signal) are relative to the ends
of the curve. Between curves an effector keeps its signal.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.interchange.fields import NUMBER_MAX, JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import (
    VALUES_MAX,
    Channel,
    Measure,
    Reader,
    recording,
    summarised,
    thinned,
)
from lss_motion.show.model import TIME_MAX_S
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray, ForeignMotion

FULL_SIGNAL: Final = 8192.0
"""Largest y of a curve; the least is 0 (FACTS.md F2)."""

SAMPLE_MS: Final = 10.0
"""Curves are sampled at 100 Hz; the reduction to keys follows later."""

CURVE_SAMPLES_MAX: Final = 500
"""Enough for a cubic: straight lines between 500 samples differ from it by 1e-5 of its height."""

OVERLAP_MAX_S: Final = 0.0015
"""Allowed overlap of two curves, because starts and durations are rounded to a millisecond."""

BISECTIONS: Final = 40
"""Halvings of the curve parameter; for a curve of an hour the rest is about 3 ns."""

_SIGNALS: Final = {
    "rSVPin": (2, Measure.US),
    "rSVI2C": (3, Measure.US),
    "rMTR": (2, Measure.RAW),
}
"""Command that registers an effector → position of the least signal in it, and the unit."""


@dataclass(slots=True)
class _Controller:
    """The effectors of one controller: least signal, largest signal and unit by id."""

    prefix: str
    signals: dict[str, tuple[float, float, Measure]] = field(default_factory=dict)


def _is_bottango(data: bytes) -> bool:
    return starts_json(data, b"[") and b'"Animation Commands"' in data


def _bottango_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = JsonFields(path)
    content = parsed_json(path, data)
    if not isinstance(content, list) or not content:
        fields.refuse("the file must be a list of controllers")
    animations = _Animations(fields)
    for index, entry in enumerate(content):
        where = f"[{index}]"
        controller = fields.mapping(entry, where)
        title = str(controller.get("Controller Name") or index)
        animations.add(controller, where, f"{title}/" if len(content) > 1 else "")
    return animations.motions()


BOTTANGO: Final = Reader("bottango", _is_bottango, _bottango_motions)
"""Reads a list of controllers; each animation, over all controllers, is one motion.

The name of a joint is the id of its effector, with the prefix `controller/` if the file has
several controllers.
"""


@dataclass(slots=True)
class _Animations:
    """Collects the curves of the file by animation and joint."""

    fields: JsonFields
    curves: dict[str, dict[str, list[FloatArray]]] = field(default_factory=dict)
    units: dict[str, Measure] = field(default_factory=dict)
    left_out: dict[str, list[str]] = field(default_factory=dict)
    values_count: int = 0

    def add(self, entry: dict[str, object], where: str, prefix: str) -> None:
        """Add the animations of one controller."""
        controller = _Controller(prefix)
        setup = self.fields.mapping(entry.get("Setup", {}), f"{where}.Setup")
        for line in str(setup.get("Controller Setup Commands", "")).splitlines():
            self._register(controller, line.strip(), f"{where}.Setup")
        for number, listed in enumerate(self.fields.items(entry, "Animations", where)):
            place = f"{where}.Animations[{number}]"
            animation = self.fields.mapping(listed, place)
            name = str(animation.get("Animation Name") or f"animation {number + 1}")
            self.curves.setdefault(name, {})
            self.left_out.setdefault(name, [])
            text = self.fields.text(animation, "Animation Commands", place)
            for row, line in enumerate(text.splitlines(), start=1):
                self._commands(controller, name, line, f"{place} command {row}")
            if str(animation.get("Animation Loop Commands", "")).strip():
                self.left_out[name].append("the return to the start (Animation Loop Commands)")

    def _register(self, controller: _Controller, line: str, where: str) -> None:
        kind, *words = line.split(",")
        if kind not in _SIGNALS:
            return
        at, unit = _SIGNALS[kind]
        if len(words) < at + 1:
            self.fields.refuse(f"{where}: {line!r:.60} is cut short")
        # The id of a servo behind I2C is its address followed by its channel (FACTS.md F2).
        effector = "".join(words[: at - 1])
        low, high = (self._number(word, where) for word in words[at - 1 : at + 1])
        controller.signals[effector] = (low, high, unit)

    def _commands(self, controller: _Controller, name: str, line: str, where: str) -> None:
        text = line.strip()
        is_group = text.startswith("sSY,")  # Only the first curve of a group begins with sC.
        for command in text.removeprefix("sSY,").split(";"):
            words = command.split(",")
            if words[0] == "sC":
                self._curve(controller, name, words[1:], where)
            elif is_group and words[0] in controller.signals:
                self._curve(controller, name, words, where)
            elif command:
                self.left_out[name].append(f"commands {words[0]:.20}")

    def _curve(self, controller: _Controller, name: str, words: list[str], where: str) -> None:
        if len(words) != 9:
            self.fields.refuse(f"{where}: a curve has an id and 8 numbers, not {len(words) - 1}")
        effector = words[0]
        if effector not in controller.signals:
            self.fields.refuse(f"{where}: effector {effector!r:.40} is not set up")
        low, high, unit = controller.signals[effector]
        numbers = [self._number(word, where) for word in words[1:]]
        start_ms, duration_ms = numbers[:2]
        if start_ms < 0.0 or duration_ms < 0.0 or s_from_ms(start_ms + duration_ms) > TIME_MAX_S:
            self.fields.refuse(f"{where}: must lie between 0 s and a day ({TIME_MAX_S:g} s)")
        self.values_count += min(int(duration_ms / SAMPLE_MS), CURVE_SAMPLES_MAX) + 3
        if self.values_count > VALUES_MAX:
            self.fields.refuse(f"{where}: comes to more than {VALUES_MAX:,} samples")
        samples = _sampled(*numbers)
        samples[1] = low + (high - low) * samples[1] / FULL_SIGNAL
        joint = controller.prefix + effector
        self.units[joint] = unit
        self.curves[name].setdefault(joint, []).append(samples)

    def _number(self, word: str, where: str) -> float:
        try:
            number = float(word)
        except ValueError:
            self.fields.refuse(f"{where}: {word!r:.40} is not a number")
        if not abs(number) < NUMBER_MAX:
            self.fields.refuse(f"{where}: {word!r:.40} is out of range")
        return number

    def motions(self) -> tuple[ForeignMotion, ...]:
        path = self.fields.path
        found: list[ForeignMotion] = []
        for name, joints in self.curves.items():
            if not joints:
                continue
            comments = (
                f"Imported from {path.name} (Bottango animation {name!r:.60}).",
                *summarised(self.left_out[name]),
            )
            channels = [self._channel(name, joint, curves) for joint, curves in joints.items()]
            found.append(recording(path, name, channels, comments=comments))
        if not found:
            self.fields.refuse("no animation has a curve (sC) of a servo or motor")
        return tuple(found)

    def _channel(self, name: str, joint: str, curves: list[FloatArray]) -> Channel:
        curves = sorted(curves, key=lambda samples: float(samples[0, 0]))
        rows = [curves[0]]
        for before, after in pairwise(curves):
            gap_s = after[0, 0] - before[0, -1]
            if gap_s < -OVERLAP_MAX_S:
                self.fields.refuse(
                    f"animation {name!r:.60}: two curves of {joint!r:.40} overlap "
                    f"at {after[0, 0]:g} s"
                )
            if gap_s > s_from_ms(SAMPLE_MS):
                rows.append(np.array([[after[0, 0] - s_from_ms(SAMPLE_MS)], [before[1, -1]]]))
            rows.append(after)
        times_s, values = thinned(*np.concatenate(rows, axis=1))
        return Channel(name=joint, unit=self.units[joint], times_s=times_s, values=values)


def _sampled(
    start_ms: float,
    duration_ms: float,
    start_y: float,
    start_x_ms: float,
    start_dy: float,
    end_y: float,
    end_x_ms: float,
    end_dy: float,
) -> FloatArray:
    """Return times (s) and heights of a cubic Bezier curve at even times, with both ends."""
    steps = min(int(duration_ms / SAMPLE_MS), CURVE_SAMPLES_MAX)
    times_ms = np.linspace(0.0, duration_ms, steps + 2)
    # A control point outside the time of the curve would make its time run backwards.
    first_ms, second_ms = np.clip([start_x_ms, duration_ms + end_x_ms], 0.0, duration_ms)
    low, high = np.zeros_like(times_ms), np.ones_like(times_ms)
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        is_early = _bezier(middle, 0.0, first_ms, second_ms, duration_ms) < times_ms
        low, high = np.where(is_early, middle, low), np.where(is_early, high, middle)
    heights = _bezier(0.5 * (low + high), start_y, start_y + start_dy, end_y + end_dy, end_y)
    heights[[0, -1]] = start_y, end_y
    return np.stack([(start_ms + times_ms) / 1000.0, heights])


def _bezier(u: FloatArray, a: float, b: float, c: float, d: float) -> FloatArray:
    v = 1.0 - u
    return a * v**3 + 3.0 * b * v**2 * u + 3.0 * c * v * u**2 + d * u**3
