"""Action groups of Hiwonder robots (`.d6a`): an SQLite file with a table `ActionGroup`.

A row has `Index`, `Time` in ms and a position for each servo (`Servo1`, `Servo2`, …): 0 to 1000
over 240 deg for bus servos, 500 is 0 deg. In files of RC servos the positions are pulses of 500 to
2500 us. The file does not contain the pose before the first row.
"""

from __future__ import annotations

import re
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.interchange.reader import (
    VALUES_MAX,
    Measure,
    Pose,
    Reader,
    motion_name,
    motion_of_poses,
)
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

SQLITE: Final = b"SQLite format 3\0"
TABLE: Final = "ActionGroup"

POSITION_MAX: Final = 1000
ZERO: Final = 500
DEG_PER_POSITION: Final = 240.0 / POSITION_MAX
"""Bus servos (FACTS.md F14)."""

PULSE_MIN_US: Final = 400
PULSE_MAX_US: Final = 2600
"""RC servos take 500 to 2500 us; with a margin."""

DURATION_MAX_MS: Final = 65_535
"""A 16-bit number on the wire of these servos."""

STEPS_MAX: Final = 10_000_000
"""Steps of the SQLite machine, far more than reading 4,000,000 values needs: a damaged or hostile
file ends there."""

JOURNAL: Final = slice(18, 20)
"""Versions of the file format. 2 (write-ahead log) cannot be opened in memory; 1 reads the same."""

HEADER_BYTES: Final = 100
PAGE_BYTES: Final = slice(16, 18)
PAGE_MOST: Final = 65_536
"""Written as 1."""
CHANGED: Final = slice(24, 28)
PAGES: Final = slice(28, 32)
COUNTED_AT: Final = slice(92, 96)
"""Header of an SQLite file. The number of pages is valid where these two counters are equal."""

_SERVO: Final = re.compile(r"servo(\d{1,3})", re.ASCII | re.IGNORECASE)

Rows = list[tuple[object, ...]]


def _is_d6a(data: bytes) -> bool:
    return data.startswith(SQLITE)


def _d6a_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    if not _is_d6a(data):
        raise InputError("is not an SQLite file, as .d6a files are", path=path)
    if len(data) < (size := _size(data)):
        raise InputError(f"has {len(data)} of its {size} bytes: it was cut off", path=path)
    try:
        columns, rows = _read(path, data)
    except (sqlite3.Error, OverflowError, UnicodeDecodeError, MemoryError) as error:
        raise InputError(f"cannot be read as SQLite: {error}", path=path) from error
    ids = [int(match[1]) for name in columns if (match := _SERVO.fullmatch(name))]
    if not rows:
        raise InputError(f"table {TABLE} has no row", path=path)
    positions = [
        [_whole(path, value, place, PULSE_MAX_US) for value in row[1:]]
        for place, row in enumerate(rows, start=1)
    ]
    is_pulse = any(max(row) > POSITION_MAX for row in positions)
    if is_pulse and min(map(min, positions)) < PULSE_MIN_US:
        raise InputError(
            f"positions above {POSITION_MAX} are pulses in us, but others are below "
            f"{PULSE_MIN_US} us",
            path=path,
        )
    poses: list[Pose] = []
    for place, (row, values) in enumerate(zip(rows, positions, strict=True), start=1):
        duration_s = s_from_ms(_whole(path, row[0], place, DURATION_MAX_MS))
        poses.append(
            Pose(
                at_s=(poses[-1].at_s if poses else 0.0) + duration_s,
                values={
                    f"ID{servo}": float(v) if is_pulse else (v - ZERO) * DEG_PER_POSITION
                    for servo, v in zip(ids, values, strict=True)
                },
                place=f"row {place}",
            )
        )
    scale = "pulses in us" if is_pulse else "1000 positions over 240 deg, 500 = 0 deg"
    return (
        motion_of_poses(
            path,
            motion_name(path),
            poses,
            unit_of=lambda _: Measure.US if is_pulse else Measure.DEG,
            comments=(f"Imported from {path.name} (Hiwonder action group); {scale}.",),
        ),
    )


D6A: Final = Reader("d6a", _is_d6a, _d6a_motions)
"""Reads the table `ActionGroup(Index, Time, Servo1, …)`; joints are `ID<n>`."""


def _size(data: bytes) -> int:
    """Return how many bytes the header says that there are; 0 if it does not say."""
    if len(data) < HEADER_BYTES or data[CHANGED] != data[COUNTED_AT]:
        return 0
    page_bytes = int.from_bytes(data[PAGE_BYTES], "big")
    return (PAGE_MOST if page_bytes == 1 else page_bytes) * int.from_bytes(data[PAGES], "big")


def _read(path: Path, data: bytes) -> tuple[list[str], Rows]:
    """Return the names of the columns of servos, and rows of time and positions."""
    image = bytearray(data)
    if len(image) >= JOURNAL.stop:
        image[JOURNAL] = bytes(min(version, 1) for version in image[JOURNAL])
    with closing(sqlite3.connect(":memory:")) as base:
        base.deserialize(bytes(image))
        base.execute("PRAGMA trusted_schema = OFF")
        base.execute("PRAGMA query_only = ON")
        base.set_progress_handler(lambda: 1, STEPS_MAX)
        found = base.execute(
            "SELECT name FROM sqlite_master WHERE type = 'table' AND lower(name) = lower(?)",
            (TABLE,),
        ).fetchone()
        if found is None:
            raise InputError(f"has no table {TABLE}, as .d6a files have", path=path)
        # Read by place: no text of the file becomes part of a statement.
        cursor = base.execute(f"SELECT * FROM {TABLE}")  # noqa: S608
        names = [str(column[0]) for column in cursor.description]
        lower = [name.lower() for name in names]
        servos = [at for at, name in enumerate(lower) if _SERVO.fullmatch(name)]
        ids = {int(lower[at][5:]) for at in servos}
        if "time" not in lower or not servos or len(ids) < len(servos):
            raise InputError(f"table {TABLE} needs the columns Index, Time, Servo1, …", path=path)
        rows_max = VALUES_MAX // len(names)
        rows = cursor.fetchmany(rows_max + 1)
        if len(rows) > rows_max:
            raise InputError(f"has more than {VALUES_MAX:,} values, the maximum", path=path)
    if "index" in lower:
        by = lower.index("index")
        rows.sort(key=lambda row: row[by] if isinstance(row[by], int | float) else 0)
    time_at = lower.index("time")
    return [names[at] for at in servos], [
        (row[time_at], *(row[at] for at in servos)) for row in rows
    ]


def _whole(path: Path, value: object, place: int, maximum: int) -> int:
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if not isinstance(value, int) or not 0 <= value <= maximum:
        raise InputError(
            f"row {place}: {value!r:.40} is not a whole number from 0 to {maximum}", path=path
        )
    return value
