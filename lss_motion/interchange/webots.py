"""Webots `.motion` text: `[[minutes:]seconds:]milliseconds,pose,values`; `*` sets no key.

The names of the joints are in the first line, or in a second line of their own. Version 1.1 has `%`
in place of `,`, no names of poses, and in its first column an instant with colons, or a duration.
The unit of the duration is assumed: milliseconds since the row before.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import Pose, motion_of_poses, summarised, unit_of_ros_joint
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

HEADER: Final = "#WEBOTS_MOTION"
_TIME: Final = re.compile(r"(?:(?:(\d{1,4}):)?(\d{1,5}):)?(\d{1,8})", re.ASCII)
"""Minutes and seconds may be absent, as in the player of Webots (FACTS.md F16)."""
_VERSION: Final = re.compile(r"V1\.\d{1,2}", re.ASCII | re.IGNORECASE)

VARIANTS: Final = (
    f"variants: `{HEADER},V1.0,joint,...` and rows `mm:ss:mmm,pose,value,...`; the joints in a "
    f"line of their own; `{HEADER},V1.1`, joints and rows divided by `%`, first column "
    "mm:ss:mmm or a duration in ms"
)
"""What is read, for messages."""


class WebotsReader(Struct, frozen=True):
    """Reads `#WEBOTS_MOTION,V1.0,joint,…` and its rows; radians (metres for sliding joints)."""

    name: str = "webots"

    def recognises(self, data: bytes) -> bool:
        return text_head(data, 1024).lstrip().startswith(HEADER.encode())

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        lines = TextLines.of(path, data)
        table = _table(lines)
        poses: list[Pose] = []
        durations_count = 0
        for number, row in table.rows:
            cells = [cell.strip() for cell in row.split(table.delimiter)]
            is_duration = table.delimiter == "%" and cells[0].isascii() and cells[0].isdigit()
            if is_duration:
                before_s = poses[-1].at_s if poses else 0.0
                at_s = before_s + s_from_ms(lines.whole(cells[0], number, DURATION_MAX_MS))
            else:
                at_s = _instant_s(lines, number, cells[0])
            durations_count += is_duration
            poses.append(_pose(table, number, cells, at_s))
        if not poses:
            lines.refuse(None, "has no row with values")
        keyed = {name for pose in poses for name in pose.values}
        idle = [f"joint {name}, which has no value" for name in table.names if name not in keyed]
        guess = [
            "The first column has durations; their unit is assumed to be milliseconds."
        ] * bool(durations_count)
        comments = (f"Imported from {path.name} (Webots motion).", *guess, *summarised(idle))
        return (
            motion_of_poses(path, path.stem, poses, unit_of=unit_of_ros_joint, comments=comments),
        )


DURATION_MAX_MS: Final = 3_600_000
"""Chosen: one hour between two rows."""


class _Table(Struct, frozen=True):
    lines: TextLines
    delimiter: str
    names: list[str]
    rows: list[tuple[int, str]]


def _table(lines: TextLines) -> _Table:
    """Return names and rows; the names are in the first line or in the one after it."""
    line, head, rows = lines.with_head()
    title, *words = (word.strip() for word in re.split("[,%]", head))
    if title != HEADER or not words or not _VERSION.fullmatch(words[0]):
        lines.refuse(line, f"the first line must be `{HEADER},V1.0,joint,...`; {VARIANTS}")
    delimiter = "%" if "%" in head else ","
    names = words[1:]
    if not any(names):
        if not rows:
            lines.refuse(line, f"names no joint; {VARIANTS}")
        (line, head), *rows = rows
        delimiter = "%" if "%" in head else ","
        names = [word.strip() for word in head.rstrip(f"{delimiter} ").split(delimiter)]
        if ":" in names[0] and _TIME.fullmatch(names[0]):
            lines.refuse(line, f"names of joints are expected here; {VARIANTS}")
    if len(set(names)) < len(names) or not all(names):
        lines.refuse(line, "every joint needs a name of its own")
    return _Table(lines, delimiter, names, rows)


def _instant_s(lines: TextLines, number: int, word: str) -> float:
    time = _TIME.fullmatch(word)
    if time is None:
        lines.refuse(
            number,
            f"{word!r:.60} is not a time of the form mm:ss:mmm, ss:mmm or mmm; {VARIANTS}",
        )
    minutes, seconds, milliseconds = (int(part or 0) for part in time.groups())
    return 60.0 * minutes + seconds + s_from_ms(milliseconds)


def _pose(table: _Table, number: int, cells: list[str], at_s: float) -> Pose:
    lines, names = table.lines, table.names
    if cells[-1] == "" and len(cells) > len(names) + 1:
        cells = cells[:-1]  # A row may end in a delimiter.
    # Older files have no pose names, only times and values.
    has_label = len(cells) == len(names) + 2
    values = cells[2 if has_label else 1 :]
    if len(values) != len(names):
        lines.refuse(number, f"{counted(values, 'value')} for {counted(names, 'joint')}")
    return Pose(
        at_s=at_s,
        values={
            name: lines.number(value, number)
            for name, value in zip(names, values, strict=True)
            if value != "*"
        },
        label=cells[1] if has_label else "",
        line=number,
    )
