"""PyPose projects (`.ppr`): named poses in Dynamixel positions, and sequences of `pose|ms`."""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import Pose, motion_of_poses, read_or_refused
from lss_motion.interchange.robotis import ax_deg
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion, RefusedMotion

DURATION_MAX_MS: Final = 65_535
SERVOS_MAX: Final = 253
"""Number of ids of a Dynamixel bus."""

AX_POSITIONS: Final = 1024
MX_POSITIONS: Final = 4096
"""The two resolutions of Dynamixel servos: 300 deg in 1024 and 360 deg in 4096; the middle is 0."""

_POSE: Final = re.compile(r"pose\s*=", re.IGNORECASE)
_HEADER: Final = re.compile(r"[^:=]{0,200}:\s*\d{1,3}\s*(:.*)?", re.ASCII)


class PyPoseReader(Struct, frozen=True):
    """Reads `name:count[:resolution…]`, `Pose=` and `Seq=` lines; joints are `ID<n>`, from 1."""

    name: str = "pypose"

    def recognises(self, data: bytes) -> bool:
        head = text_head(data, 65_536)
        rows = [row.strip() for row in head.decode("utf-8", "replace").splitlines() if row.strip()]
        is_headed = bool(rows) and _HEADER.fullmatch(rows[0]) is not None
        return is_headed and any(_POSE.match(row) for row in rows)

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
        lines = TextLines.of(path, data)
        head_line, head, rows = lines.with_head()
        if _HEADER.fullmatch(head) is None:
            lines.refuse(head_line, "the first line must be `name:number of servos`")
        scales = _scales(lines, head_line, head)
        poses: dict[str, dict[str, float]] = {}
        sequences: list[tuple[int, str, str]] = []
        for number, line in rows:
            kind, _, rest = line.partition("=")
            name, colon, values = rest.partition(":")
            match kind.strip().lower():
                case "pose" if colon:
                    poses[name.strip()] = _angles(lines, number, values, scales)
                case "seq" if colon:
                    sequences.append((number, name.strip(), values))
                case _:
                    lines.refuse(number, "is neither `Pose=name: …` nor `Seq=name: …`")
        if not sequences:
            lines.refuse(None, "has no sequence (`Seq=name: pose|ms, …`)")
        return tuple(
            read_or_refused(name, partial(_motion, lines, number, name, text, poses))
            for number, name, text in sequences
        )


def _scales(lines: TextLines, line: int, head: str) -> list[Callable[[float], float]]:
    _, count, *rest = head.split(":")
    servos_count = lines.whole(count, line, SERVOS_MAX)
    words = [word for part in rest for word in part.replace(",", " ").split()]
    sizes = [lines.whole(word, line, MX_POSITIONS) for word in words] or [AX_POSITIONS]
    if len(sizes) == 1:
        sizes *= servos_count
    if len(sizes) != servos_count or not sizes:
        lines.refuse(line, f"{counted(sizes, 'resolution')} for {counted(servos_count, 'servo')}")
    known = {AX_POSITIONS: ax_deg, MX_POSITIONS: lambda position: (position - 2048) * 360.0 / 4096}
    if odd := [size for size in sizes if size not in known]:
        lines.refuse(line, f"resolution {odd[0]} is not {AX_POSITIONS} or {MX_POSITIONS}")
    return [known[size] for size in sizes]


def _angles(
    lines: TextLines, number: int, text: str, scales: list[Callable[[float], float]]
) -> dict[str, float]:
    words = [word for word in text.split(",") if word.strip()]
    if len(words) != len(scales):
        lines.refuse(number, f"{counted(words, 'position')} for {counted(scales, 'servo')}")
    positions = [lines.whole(word, number, MX_POSITIONS) for word in words]
    pairs = enumerate(zip(positions, scales, strict=True), start=1)
    return {f"ID{servo}": scale(position) for servo, (position, scale) in pairs}


def _motion(
    lines: TextLines, number: int, name: str, text: str, known: dict[str, dict[str, float]]
) -> ForeignMotion:
    poses: list[Pose] = []
    for index, step in enumerate((s for s in text.split(",") if s.strip()), start=1):
        pose, bar, time = (part.strip() for part in step.partition("|"))
        if not bar:
            lines.refuse(number, f"step {index} ({step.strip()!r:.40}) is not `pose|milliseconds`")
        if pose not in known:
            lines.refuse(number, f"step {index} names pose {pose!r:.40}, which does not exist")
        start_s = poses[-1].at_s if poses else 0.0
        at_s = start_s + s_from_ms(lines.whole(time, number, DURATION_MAX_MS))
        place = f"step {index} of {name!r:.40}"
        poses.append(Pose(at_s=at_s, values=known[pose], label=pose, place=place, line=number))
    comments = [
        f"Imported from {lines.path.name} (PyPose sequence {name!r:.60}).",
        "Positions are read as Dynamixel: 1024 = 300 deg or 4096 = 360 deg, the middle is 0 deg.",
    ]
    return motion_of_poses(lines.path, name, poses, comments=comments)
