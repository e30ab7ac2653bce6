"""Webots `.motion` text: `minutes:seconds:milliseconds,pose,values`; `*` sets no key."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import Pose, motion_of_poses, summarised, unit_of_ros_joint

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

HEADER: Final = "#WEBOTS_MOTION"
_TIME: Final = re.compile(r"(\d{1,4}):(\d{1,2}):(\d{1,3})", re.ASCII)


@dataclass(frozen=True, slots=True)
class WebotsReader:
    """Reads `#WEBOTS_MOTION,V1.0,joint,…` and its rows; radians (metres for sliding joints)."""

    name: str = "webots"

    def recognises(self, data: bytes) -> bool:
        return text_head(data, 64).lstrip().startswith(HEADER.encode())

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        lines = TextLines.of(path, data)
        head_line, head, rows = lines.with_head()
        title, *words = (word.strip() for word in head.split(","))
        if title != HEADER or len(words) < 2:
            lines.refuse(head_line, f"the first line must be `{HEADER},V1.0,joint,...`")
        names = words[1:]
        if len(set(names)) < len(names) or not all(names):
            lines.refuse(head_line, "every joint needs a name of its own")
        poses = [_pose(lines, number, row, names) for number, row in rows]
        keyed = {name for pose in poses for name in pose.values}
        idle = [f"joint {name}, which has no value" for name in names if name not in keyed]
        comments = (f"Imported from {path.name} (Webots motion).", *summarised(idle))
        return (
            motion_of_poses(path, path.stem, poses, unit_of=unit_of_ros_joint, comments=comments),
        )


def _pose(lines: TextLines, number: int, row: str, names: list[str]) -> Pose:
    cells = [cell.strip() for cell in row.split(",")]
    time = _TIME.fullmatch(cells[0])
    if time is None:
        lines.refuse(number, f"{cells[0]!r:.60} is not a time of the form mm:ss:mmm")
    # Older files have no pose names, only times and values.
    has_label = len(cells) == len(names) + 2
    values = cells[2 if has_label else 1 :]
    if len(values) != len(names):
        lines.refuse(number, f"{len(values)} values for {len(names)} joints")
    minutes, seconds, milliseconds = map(int, time.groups())
    return Pose(
        at_s=60.0 * minutes + seconds + milliseconds / 1000.0,
        values={
            name: lines.number(value, number)
            for name, value in zip(names, values, strict=True)
            if value != "*"
        },
        label=cells[1] if has_label else "",
        line=number,
    )
