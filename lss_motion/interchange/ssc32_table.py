"""Step tables of the Lynxmotion SSC-32 visual sequencer: `PROJECT;SEQUENCE;STEP;PIN0…;T0…`.

A step gives each pin an angle in degrees and a time in ms. The next step begins when the slowest
pin has arrived, or after TMAX if that is later.
"""

from __future__ import annotations

from collections import defaultdict
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import (
    DIGITS,
    Channel,
    ForeignMotion,
    Note,
    Unit,
    motion_name,
    read_or_refused,
    summarised,
    thinned,
)
from lss_motion.show.model import TIME_MAX_S
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import RefusedMotion

PINS_COUNT: Final = 32
DURATION_MAX_MS: Final = 65_535
"""Times are 16-bit numbers on the board."""

_ABOUT: Final = ("PROJECT", "SEQUENCE", "STEP")


class Ssc32TableReader(Struct, frozen=True):
    """Reads the table: one motion per project and sequence; joints are `PIN<n>`."""

    name: str = "ssc32-csv"

    def recognises(self, data: bytes) -> bool:
        head = text_head(data, 4096).lstrip().split(b"\n", 1)[0]
        return b"STEP;" in head and b";PIN" in head

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
        lines = TextLines.of(path, data)
        head_line, head, rows = lines.with_head()
        columns = {word.strip(): at for at, word in enumerate(head.split(";")) if word.strip()}
        pins = [f"PIN{n}" for n in range(PINS_COUNT) if f"PIN{n}" in columns]
        needed = [*_ABOUT, *pins, *(f"T{pin[3:]}" for pin in pins)]
        missing = [name for name in needed if name not in columns]
        if not pins or missing:
            lines.refuse(head_line, f"column {missing[0] if missing else 'PIN0'} is missing")
        groups: defaultdict[tuple[str, str], list[tuple[int, list[str]]]] = defaultdict(list)
        width = 1 + max(columns[name] for name in needed)
        for number, row in rows:
            cells = [cell.strip() for cell in row.split(";")]
            if len(cells) < width:
                lines.refuse(number, f"{len(cells)} fields, at least {width} are needed")
            groups[cells[columns["PROJECT"]], cells[columns["SEQUENCE"]]].append((number, cells))
        if not groups:
            lines.refuse(head_line, "has no step")
        titles = [
            f"{project} {sequence}".strip() or motion_name(path) for project, sequence in groups
        ]
        return tuple(
            read_or_refused(title, partial(_motion, lines, title, steps, columns, pins))
            for title, steps in zip(titles, groups.values(), strict=True)
        )


def _motion(
    lines: TextLines,
    title: str,
    steps: Sequence[tuple[int, list[str]]],
    columns: Mapping[str, int],
    pins: Sequence[str],
) -> ForeignMotion:
    keys: dict[str, list[tuple[float, float, int]]] = {pin: [] for pin in pins}
    start_s = 0.0
    for number, cells in steps:
        times_s = [
            s_from_ms(lines.whole(cells[columns[f"T{pin[3:]}"]], number, DURATION_MAX_MS))
            for pin in pins
        ]
        longest = _cell(cells, columns, "TMAX")
        step_s = s_from_ms(lines.whole(longest, number, DURATION_MAX_MS)) if longest else 0.0
        step_s = max([step_s, *times_s])
        for pin, time_s in zip(pins, times_s, strict=True):
            angle_deg = lines.number(cells[columns[pin]], number, has_commas=True)
            if time_s == 0.0:
                lines.refuse(number, f"{pin} takes no time; give T{pin[3:]}")
            keys[pin].append((start_s + time_s, angle_deg, number))
            if time_s < step_s:  # The pin waits for the others.
                keys[pin].append((start_s + step_s, angle_deg, number))
        start_s += step_s
        if start_s > TIME_MAX_S:
            lines.refuse(number, f"ends more than a day ({TIME_MAX_S:g} s) after the start")
    idle = [pin for pin in pins if not any(angle for _, angle, _ in keys[pin])]
    idle = idle if len(idle) < len(pins) else []
    found = [f"{', '.join(idle)}, which stay at 0"] * bool(idle)
    channels: list[Channel] = []
    for pin in pins:
        if pin not in idle:
            times_s, angles_deg, numbers = np.array(keys[pin]).T
            own_times_s, own_deg = thinned(times_s, angles_deg)
            own_lines = numbers[np.searchsorted(np.round(times_s, DIGITS), own_times_s)]
            channels.append(
                Channel(
                    name=pin,
                    unit=Unit.DEG,
                    times_s=own_times_s,
                    values=own_deg,
                    lines=own_lines.astype(np.int32),
                )
            )
    return ForeignMotion(
        path=lines.path,
        name=motion_name(lines.path, title),
        channels=tuple(channels),
        notes=dict[float, Note](),
        comments=(
            f"Imported from {lines.path.name} (SSC-32 visual sequencer, {title!r:.60}).",
            *summarised(found),
        ),
    )


def _cell(cells: Sequence[str], columns: Mapping[str, int], name: str) -> str:
    """Return a cell, or "" if it is missing: rows are often shorter than the header."""
    at = columns.get(name)
    return "" if at is None or at >= len(cells) else cells[at]
