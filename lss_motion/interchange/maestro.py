"""Settings XML of the Pololu Maestro: sequences of frames, targets in quarter microseconds.

The Maestro sends the targets of a frame at its start and then waits for its duration; the speed of
the channels is not known. The reader therefore puts the targets at the end of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, parse_xml
from lss_motion.interchange.reader import Pose, Unit, motion_of_poses, read_or_refused, summarised
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion, RefusedMotion

QUARTERS_PER_US: Final = 4.0
CHANNELS_MAX: Final = 24
"""Channels of the largest Maestro."""

TARGET_MAX: Final = 65_535
DURATION_MAX_MS: Final = 65_535
"""Targets and durations are 16-bit numbers (FACTS.md F4)."""

OFF: Final = 0
"""Target that switches the channel off."""


@dataclass(slots=True)
class _Frame:
    line: int
    name: str
    duration_ms: int
    text: str = ""


@dataclass(slots=True)
class _Content:
    """Channels and sequences of the file, in its order."""

    channels: list[Mapping[str, str]] = field(default_factory=list)
    sequences: list[tuple[str, list[_Frame]]] = field(default_factory=list)
    open_frame: _Frame | None = None

    def start(self, lines: TextLines, line: int, tag: str, attributes: dict[str, str]) -> None:
        if tag == "Channel":
            self.channels.append(attributes)
        elif tag == "Sequence":
            self.sequences.append((attributes.get("name", ""), []))
        elif tag == "Frame" and self.sequences:
            if "duration" not in attributes:
                lines.refuse(line, "this frame has no duration; give it one in milliseconds")
            duration_ms = lines.whole(attributes["duration"], line, DURATION_MAX_MS)
            self.open_frame = _Frame(line, attributes.get("name", ""), duration_ms)
            self.sequences[-1][1].append(self.open_frame)

    def end(self, tag: str) -> None:
        if tag == "Frame":
            self.open_frame = None

    def add_text(self, part: str) -> None:
        if self.open_frame is not None:
            self.open_frame.text += part


class MaestroReader(Struct, frozen=True):
    """Reads `<UscSettings>`: one motion per sequence. Values are pulses, so a map is needed."""

    name: str = "maestro"

    def recognises(self, data: bytes) -> bool:
        return b"<UscSettings" in data[:4096]

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
        lines = TextLines.of(path, data)
        content = _parsed(lines)
        names = _names(content)
        found = [
            read_or_refused(title, partial(_motion, lines, title, frames, content, names))
            for title, frames in content.sequences
            if frames
        ]
        if not found:
            lines.refuse(None, "has no sequence with a frame (scripts are programs: not read)")
        return tuple(found)


def _parsed(lines: TextLines) -> _Content:
    content = _Content()
    parse_xml(lines, partial(content.start, lines), content.end, content.add_text)
    return content


def _names(content: _Content) -> list[str]:
    """Return the name of each channel: its own name if that is unique, else `channel<n>`."""
    given = [channel.get("name", "").strip() for channel in content.channels]
    given += [""] * (CHANNELS_MAX - len(given))
    return [
        name if name and given.count(name) == 1 else f"channel{index}"
        for index, name in enumerate(given)
    ]


def _motion(
    lines: TextLines, title: str, frames: list[_Frame], content: _Content, names: list[str]
) -> ForeignMotion:
    poses: list[Pose] = []
    left_out: list[str] = []
    end_ms = 0
    for number, frame in enumerate(frames, start=1):
        words = frame.text.split()
        if len(words) > len(names):
            lines.refuse(frame.line, f"{counted(words, 'target')}, a Maestro has {CHANNELS_MAX}")
        targets = [lines.whole(word, frame.line, TARGET_MAX) for word in words]
        left_out += [f"{names[i]} is switched off" for i, t in enumerate(targets) if t == OFF]
        end_ms += frame.duration_ms
        poses.append(
            Pose(
                at_s=s_from_ms(end_ms),
                values={names[i]: t / QUARTERS_PER_US for i, t in enumerate(targets) if t != OFF},
                label=frame.name,
                place=f"frame {number} of {title!r:.40}",
                line=frame.line,
            )
        )
    limited = [
        name
        for name, channel in zip(names, content.channels, strict=False)
        if any(channel.get(key, "0") != "0" for key in ("speed", "acceleration"))
    ]
    left_out += [f"speed and acceleration of {', '.join(limited)}"] * bool(limited)
    comments = (
        f"Imported from {lines.path.name} (Maestro sequence {title!r:.60}).",
        "A frame's targets are reached at the end of its duration.",
        *summarised(left_out),
    )
    return motion_of_poses(lines.path, title, poses, unit_of=lambda _: Unit.US, comments=comments)
