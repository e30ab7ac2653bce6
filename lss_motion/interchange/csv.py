"""CSV tables: wide (`time_s,<joint>_deg,…`) and long (`time_s,servo,deg[,ease]`).

`columns` says what names and units mean. The time column is `time`, `t`, `timestamp` or the like;
it may be `frame` after a line `# fps: N`. Units stand in the names or in a row below them. The
separator is a comma, a semicolon, a tab or blanks; a line `sep=;` of a spreadsheet changes nothing.
Decimal commas are allowed if the separator is not a comma. An empty cell sets no key. The header
may be a comment, as of `numpy.savetxt`. Speeds and forces are left out.
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from itertools import islice
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.interchange.columns import (
    ANGLE_UNITS,
    assumed_units,
    is_instant,
    is_other_measure,
    is_time_name,
    is_time_text,
    name_and_unit,
    seconds_at,
    seconds_of,
    stamp_pair,
    unit_of_column,
    with_units,
)
from lss_motion.interchange.fields import TextLines, is_number, text_head
from lss_motion.interchange.reader import (
    DIGITS,
    FPS_MAX,
    VALUES_MAX,
    Channel,
    ForeignMotion,
    Measure,
    PoseNote,
    Reader,
    is_dense,
    motion_name,
    motion_of_curves,
    summarised,
)
from lss_motion.show.model import Interpolation
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import Curves, FloatArray, IntArray


FRAME: Final = "frame"
_SEPARATOR: Final = re.compile(r"sep=.", re.IGNORECASE)
_FPS: Final = re.compile(r"#\s*fps\s*[:=]\s*(\d{1,4}(?:\.\d{1,6})?)\s*", re.IGNORECASE | re.ASCII)


class TimeColumn(Struct, frozen=True):
    """Which column is the time, in units of `second`; `rest_at` has nanoseconds to be added."""

    at: int
    second: float
    rest_at: int | None = None

    @property
    def columns(self) -> set[int | None]:
        return {self.at, self.rest_at}


class CsvRows(Struct, frozen=True):
    """A table: its header, its separator, and its rows with their line numbers.

    `first_row` is the number of lines above the first row.
    """

    lines: TextLines
    header_line: int
    header: list[str]
    delimiter: str
    fps: float | None
    first_row: int

    @property
    def has_commas(self) -> bool:
        return self.delimiter != ","

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of every row; a row has as many cells as the header."""
        is_blank = self.delimiter == " "
        text = self.lines.text.split("\n")[self.first_row :]
        if is_blank:
            text = [" ".join(line.split()) for line in text]
        reader = csv.reader(text, delimiter=self.delimiter, skipinitialspace=is_blank)
        try:
            for row in reader:
                if (
                    not row
                    or (len(row) == 1 and not row[0].strip())
                    or row[0].lstrip().startswith("#")
                ):
                    continue
                number = self.first_row + reader.line_num
                if len(row) != len(self.header):
                    self.lines.refuse(
                        number,
                        f"{len(row)} cells, but the header has {len(self.header)}: is the file "
                        "cut short?",
                    )
                yield number, row
        except csv.Error as error:
            raise InputError(
                f"no table: {error}", path=self.lines.path, line=self.first_row + reader.line_num
            ) from error

    def time_column(self) -> TimeColumn:
        """Return the time column; a column `date` is one if there is no other."""
        if (pair := stamp_pair(self.header)) is not None:
            return TimeColumn(pair[0], 1.0, pair[1])
        found = [(at, seconds_of(name)) for at, name in enumerate(self.header)]
        for at, second in sorted(found, key=lambda one: self.header[one[0]].lower() == "date"):
            if second is not None:
                return TimeColumn(at, second)
        frames = [at for at, name in enumerate(self.header) if name.lower() == FRAME]
        if not frames:
            like = [name for name in self.header if is_time_name(name)]
            self.lines.refuse(
                self.header_line,
                f"no column is the time; name it time_s, time_ms, time or {FRAME}, in a header line"
                + (f"; {like[0]!r:.60} is not understood" if like else ""),
            )
        if self.fps is None:
            self.lines.refuse(
                self.header_line, "frames need their rate: put a line `# fps: 24` on top"
            )
        return TimeColumn(frames[0], 1.0 / self.fps)

    def time_s(self, column: TimeColumn, row: Sequence[str], number: int) -> float:
        """Return the time of a row, or raise `InputError`."""
        has_commas = self.has_commas
        time_s = seconds_at(
            self.lines, row[column.at], number, column.second, has_commas=has_commas
        )
        if column.rest_at is None:
            return time_s
        rest_ns = self.lines.number(row[column.rest_at], number, has_commas=has_commas)
        return round(time_s + rest_ns / NS_PER_S, DIGITS)


def delimiter_of(line: str) -> str:
    """Return what divides the cells of a table, from its first line."""
    for mark in ";\t":  # The commas of a line without names may be decimal signs.
        if mark in line and all(is_number(w.strip(), has_commas=True) for w in line.split(mark)):
            return mark
    mark = max(",;\t", key=line.count)
    return mark if mark in line or " " not in line.strip() else " "


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of one line."""
    if delimiter == " ":
        line = re.sub(r"\s+(?=[(\[])", "", line.strip())
    rows = csv.reader([line], delimiter=delimiter, skipinitialspace=delimiter == " ")
    return [cell.strip() for cell in next(rows, [])]


class TableHeader(Struct, frozen=True):
    """The line of the names, the names, their separator, and the number of lines above the rows."""

    line: int
    names: list[str]
    delimiter: str
    first_row: int


def header_of(lines: Iterator[tuple[int, str]]) -> TableHeader | None:
    """Return the header among numbered lines, with the units of a row below it; None: no line.

    A comment above a line of numbers is the header if it has as many cells.
    """
    comment: tuple[int, str] | None = None
    for number, line in lines:
        if line.startswith("#"):
            comment = number, line.lstrip("#").strip()
            continue
        if _SEPARATOR.fullmatch(line):
            continue
        delimiter = delimiter_of(line)
        header = cells_of(line, delimiter)
        if comment is not None and len(header) > 1 and _are_values(header, delimiter):
            names = cells_of(comment[1], delimiter)
            if len(names) == len(header) and not any(is_number(name) for name in names):
                return TableHeader(comment[0], names, delimiter, number - 1)
        return _with_row_below(TableHeader(number, header, delimiter, number), next(lines, None))
    return None


def _with_row_below(header: TableHeader, row: tuple[int, str] | None) -> TableHeader:
    """Return the header with the units in the row below it, which may be a comment, if it has."""
    if row is None:
        return header
    number, line = row
    text = line.lstrip("#").strip()
    is_blank = header.delimiter == " "
    try:
        cells = text.split() if is_blank else cells_of(text, header.delimiter)
    except csv.Error:  # It is named where the rows are read.
        return header
    names = with_units(header.names, cells)
    return header if names is None else replace(header, names=names, first_row=number)


def _are_values(cells: list[str], delimiter: str) -> bool:
    """Return whether all cells are numbers or times."""
    return all(
        not cell or is_number(cell, has_commas=delimiter != ",") or is_time_text(cell)
        for cell in cells
    )


def csv_rows(lines: TextLines) -> CsvRows:
    """Return the table. A comment above it may give the frame rate.

    Names of columns differ, except where the first line has none but numbers.
    """
    fps: float | None = None
    for number, line in lines.numbered():
        if not line.startswith("#"):
            break
        if match := _FPS.fullmatch(line):
            fps = float(match[1])
            if not 0.0 < fps <= FPS_MAX:
                lines.refuse(number, f"fps {fps:g} must be more than 0 and at most {FPS_MAX:g}")
    try:
        found = header_of(lines.numbered())
    except csv.Error as error:
        raise InputError(f"no table: {error}", path=lines.path) from error
    if found is None:
        lines.refuse(None, "has no header line")
    header = found.names
    twice = [name for name in header if header.count(name) > 1]
    if twice and not all(is_number(name, has_commas=True) for name in header):
        lines.refuse(found.line, f"column {twice[0]!r:.60} occurs twice")
    return CsvRows(lines, found.line, header, found.delimiter, fps, found.first_row)


_LONG_NAMES: Final = ("servo", "joint")
_LONG_VALUES: Final = ("position", "angle", "value", "pos")


def _is_value(name: str) -> bool:
    """Return whether a column of a long table has the values: `deg`, `position (rad)`."""
    base, unit = name_and_unit(name)
    return name in {"deg", "rad", "us"} or (base in _LONG_VALUES and unit in ANGLE_UNITS)


def head_of(data: bytes) -> tuple[TableHeader, list[str]] | None:
    """Return the header of what may be a table, and the first rows below it; None: it is none."""
    head = text_head(data, 65_536).decode("utf-8", "replace")
    rows = [(at, row.strip()) for at, row in enumerate(head.splitlines(), 1) if row.strip()]
    try:
        found = header_of(iter(rows))
    except csv.Error:
        return None
    if found is None or found.names[0].startswith("{"):
        return None
    return found, [row for at, row in rows if at > found.first_row and not row.startswith("#")]


def _is_csv(data: bytes) -> bool:
    found = head_of(data)
    if found is None or len(found[0].names) < 2:
        return False
    (header, rows) = found
    names = header.names
    if stamp_pair(names) is None and not any(
        seconds_of(name) or (is_time_name(name) and is_instant(name)) for name in names
    ):
        return False
    if header.delimiter != " ":
        return True
    cells = cells_of(rows[0], " ") if rows else []
    return len(cells) == len(names) and _are_values(cells, " ")


def _csv_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    table = csv_rows(TextLines.of(path, data))
    header = [name.lower() for name in table.header]
    is_long = any(n in header for n in _LONG_NAMES) and any(map(_is_value, header))
    return (_long(table, header) if is_long else _wide(table),)


CSV: Final = Reader("csv", _is_csv, _csv_motions)
"""Reads both forms; the header decides which."""


def _wide(table: CsvRows) -> ForeignMotion:
    time = table.time_column()
    own = [(at, name) for at, name in enumerate(table.header) if at not in time.columns and name]
    others = [name for _, name in own if is_time_name(name) or is_other_measure(name)]
    names = [(at, name) for at, name in own if name not in others]
    if not names:
        table.lines.refuse(table.header_line, "no column is a joint")
    columns = [
        (at, *unit_of_column(table.lines.path, table.header_line, name)) for at, name in names
    ]
    joints = [joint for _, joint, _ in columns]
    if len(set(joints)) < len(joints):
        twice = next(joint for joint in joints if joints.count(joint) > 1)
        table.lines.refuse(table.header_line, f"joint {twice!r:.60} has two columns")
    is_clock = any(is_time_text(row[time.at].strip()) for _, row in islice(table.rows(), 1))
    times_s, values, numbers = _cells(table, time, [at for at, _, _ in columns])
    channels: list[Channel] = []
    empty = [f"column {name}, which is no angle" for name in others]
    for column, (_, joint, unit) in enumerate(columns):
        given = np.isfinite(values[:, column])
        if given.any():
            own_times_s = times_s if given.all() else times_s[given]
            channel = Channel(
                name=joint,
                unit=unit,
                times_s=own_times_s,
                values=values[given, column],
                lines=numbers if given.all() else numbers[given],
            )
            channels.append(channel)
        else:
            empty.append(f"column {joint}, which is empty")
    if not channels:
        table.lines.refuse(None, "has no row with a value")
    path = table.lines.path
    return ForeignMotion(
        path=path,
        name=motion_name(path),
        channels=tuple(channels),
        notes={},
        comments=(
            f"Imported from {path.name} (CSV).",
            *assumed_units([name for _, name in names], "" if is_clock else table.header[time.at]),
            *_may_be_radians(channels, [name for _, name in names]),
            *summarised(empty),
        ),
        is_recording=is_dense(times_s),
    )


def _may_be_radians(channels: Sequence[Channel], names: Sequence[str]) -> list[str]:
    """Return a comment if a recording in degrees, whose unit is assumed, may be one in radians."""
    bare = [one for one in channels if one.unit is Measure.DEG and one.name in names]
    most = max((float(np.abs(one.values).max()) for one in bare), default=0.0)
    if not 0.0 < most <= math.pi or not any(is_dense(one.times_s) for one in bare):
        return []
    return [f"They are at most {most:.3g}: if they are radians, end the names in _rad."]


def _cells(
    table: CsvRows, time: TimeColumn, value_columns: Sequence[int]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return increasing times, values (rows, joints) with NaN for empty cells, and line numbers."""
    lines, has_commas = table.lines, table.has_commas
    flat, times, numbers = array("d"), array("d"), array("i")
    for number, row in table.rows():
        time_s = table.time_s(time, row, number)
        if times and time_s <= times[-1]:
            lines.refuse(number, f"times must increase, but {time_s:g} s follows {times[-1]:g} s")
        times.append(time_s)
        numbers.append(number)
        if len(flat) + len(value_columns) > VALUES_MAX:
            lines.refuse(number, f"more than {VALUES_MAX:,} values")
        for at in value_columns:
            word = row[at]
            empty = not word.strip()
            flat.append(
                float("nan") if empty else lines.number(word, number, has_commas=has_commas)
            )
    rows = np.array(flat).reshape(-1, len(value_columns))
    return np.array(times), rows, np.array(numbers, dtype=np.int32)


def _long(table: CsvRows, header: list[str]) -> ForeignMotion:
    lines = table.lines
    time = table.time_column()
    name_at = next(header.index(name) for name in _LONG_NAMES if name in header)
    value_at = next(at for at, name in enumerate(header) if _is_value(name))
    unit = ANGLE_UNITS[name_and_unit(header[value_at])[1] or header[value_at]]
    ease_at = header.index("ease") if "ease" in header else None
    samples: Curves = {}
    eases: dict[float, Interpolation] = {}
    for count, (number, row) in enumerate(table.rows()):
        if count >= VALUES_MAX:
            lines.refuse(number, f"more than {VALUES_MAX:,} values")
        time_s = table.time_s(time, row, number)
        value = lines.number(row[value_at], number, has_commas=table.has_commas)
        joint = row[name_at].strip()
        if not joint:
            lines.refuse(number, "names no joint")
        own = samples.setdefault(joint, {})
        there, _ = own.setdefault(time_s, (value, number))
        if there != value:
            lines.refuse(number, f"{joint!r:.60} is already at {there:g} at {time_s:g} s")
        if ease_at is not None and (word := row[ease_at].strip()):
            ease = _ease(lines, number, word)
            if eases.setdefault(time_s, ease) is not ease:
                lines.refuse(number, f"two eases at {time_s:g} s: {eases[time_s]} and {ease}")
    if not samples:
        lines.refuse(None, "has no row with a value")
    used = {*time.columns, name_at, value_at, ease_at}
    extra = [name for at, name in enumerate(table.header) if at not in used]
    motion = motion_of_curves(
        lines.path,
        "",
        samples,
        lambda _: unit,
        comments=(
            f"Imported from {lines.path.name} (CSV, one row per key).",
            *summarised([f"column {name}" for name in extra]),
        ),
    )
    if not eases:
        return motion
    notes = {time_s: PoseNote(ease=ease) for time_s, ease in eases.items()}
    return replace(motion, notes=notes, is_recording=False)


def _ease(lines: TextLines, number: int, word: str) -> Interpolation:
    try:
        return Interpolation(word.lower())
    except ValueError:
        known = known_names(word, [ease.value for ease in Interpolation])
        lines.refuse(number, f"unknown ease {word!r:.40}; {known}")
