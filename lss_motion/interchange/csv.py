"""CSV tables: wide (`time_s,<joint>_deg,…`) and long (`time_s,servo,deg[,ease]`).

The time column is `time_s`, `t_s`, `time` or `t` in seconds, `time_ms` or `t_ms`, or `frame` after
a line `# fps: N`. Joint columns end in `_deg`, `_rad` or `_us`. A column without an ending is in
degrees, as in the tables of `lss-motion plan --csv`. The separator is a comma, a semicolon or a
tab. Decimal commas are allowed if the separator is not a comma. An empty cell sets no key.
"""

from __future__ import annotations

import csv
import re
from array import array
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import known_names
from lss_motion.interchange.fields import TextLines, is_number, text_head
from lss_motion.interchange.reader import (
    DIGITS,
    FPS_MAX,
    VALUES_MAX,
    Channel,
    ForeignMotion,
    Note,
    Unit,
    is_dense,
    motion_name,
    summarised,
)
from lss_motion.show.model import Interpolation

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray, IntArray


SECONDS: Final = {
    **dict.fromkeys(["time_s", "t_s", "time", "t", "seconds"], 1.0),
    **dict.fromkeys(["time_ms", "t_ms"], 1e-3),
}
"""Name of a time column → its unit in seconds."""

FRAME: Final = "frame"
_FPS: Final = re.compile(r"#\s*fps\s*[:=]\s*(\d{1,4}(?:\.\d{1,6})?)\s*", re.IGNORECASE | re.ASCII)


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
        text = self.lines.text.split("\n")[self.first_row :]
        reader = csv.reader(text, delimiter=self.delimiter)
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

    def time_column(self) -> tuple[int, float]:
        """Return the index of the time column, and its unit in seconds."""
        names = [name.lower() for name in self.header]
        at = next((at for at, n in enumerate(names) if n in SECONDS or n == FRAME), None)
        if at is None:
            self.lines.refuse(
                self.header_line,
                f"no column is the time; name it {', '.join(SECONDS)} or {FRAME}, in a header line",
            )
        if names[at] != FRAME:
            return at, SECONDS[names[at]]
        if self.fps is None:
            self.lines.refuse(
                self.header_line, "frames need their rate: put a line `# fps: 24` on top"
            )
        return at, 1.0 / self.fps


def delimiter_of(line: str) -> str:
    """Return what divides the cells of a table, from its first line."""
    for mark in ";\t":  # The commas of a line without names may be decimal signs.
        if mark in line and all(is_number(w.strip(), has_commas=True) for w in line.split(mark)):
            return mark
    return max(",;\t", key=line.count)


def csv_rows(lines: TextLines) -> CsvRows:
    """Return the table. A comment above it may give the frame rate.

    Names of columns differ, except where the first line has none but numbers.
    """
    fps: float | None = None
    found: tuple[int, str] | None = None
    for number, line in lines.numbered():
        if match := _FPS.fullmatch(line):
            fps = float(match[1])
            if not 0.0 < fps <= FPS_MAX:
                lines.refuse(number, f"fps {fps:g} must be more than 0 and at most {FPS_MAX:g}")
        if not line.startswith("#"):
            found = number, line
            break
    if found is None:
        lines.refuse(None, "has no header line")
    number, line = found
    delimiter = delimiter_of(line)
    try:
        header = [name.strip() for name in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error as error:
        raise InputError(f"no table: {error}", path=lines.path, line=number) from error
    twice = [name for name in header if header.count(name) > 1]
    if twice and not all(is_number(name, has_commas=True) for name in header):
        lines.refuse(number, f"column {twice[0]!r:.60} occurs twice")
    return CsvRows(lines, number, header, delimiter, fps, number)


_SUFFIXES: Final = {"_deg": Unit.DEG, "_rad": Unit.RAD, "_us": Unit.US}
_LONG_NAMES: Final = ("servo", "joint")
_LONG_VALUES: Final = ("deg", "rad", "us")


class CsvReader(Struct, frozen=True):
    """Reads both forms; the header decides which."""

    name: str = "csv"

    def recognises(self, data: bytes) -> bool:
        head = text_head(data, 65_536).decode("utf-8", "replace")
        rows = (row.strip() for row in head.splitlines())
        first = next((row for row in rows if row and not row.startswith("#")), "")
        words = {word.strip().strip('"').lower() for word in re.split(r"[,;\t]", first)}
        return bool(words & {*SECONDS, FRAME}) and len(words) > 1

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        table = csv_rows(TextLines.of(path, data))
        header = [name.lower() for name in table.header]
        is_long = any(n in header for n in _LONG_NAMES) and any(v in header for v in _LONG_VALUES)
        return (_long(table, header) if is_long else _wide(table),)


def _wide(table: CsvRows) -> ForeignMotion:
    time_at, second = table.time_column()
    names = [(at, name) for at, name in enumerate(table.header) if at != time_at and name]
    if not names:
        table.lines.refuse(table.header_line, "no column is a joint")
    columns = [(at, *unit_of_column(name)) for at, name in names]
    joints = [joint for _, joint, _ in columns]
    if len(set(joints)) < len(joints):
        twice = next(joint for joint in joints if joints.count(joint) > 1)
        table.lines.refuse(table.header_line, f"joint {twice!r:.60} has two columns")
    times_s, values, numbers = _cells(table, time_at, second, [at for at, _, _ in columns])
    channels: list[Channel] = []
    empty: list[str] = []
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
    bare = [joint for (_, joint, _), (_, name) in zip(columns, names, strict=True) if joint == name]
    units = (f"Columns without a unit are degrees: {', '.join(bare)}.",) if bare else ()
    path = table.lines.path
    return ForeignMotion(
        path=path,
        name=motion_name(path),
        channels=tuple(channels),
        notes={},
        comments=(f"Imported from {path.name} (CSV).", *units, *summarised(empty)),
        is_recording=is_dense(times_s),
    )


def unit_of_column(name: str) -> tuple[str, Unit]:
    """Return joint and unit of a column; a name without an ending is in degrees."""
    for suffix, unit in _SUFFIXES.items():
        if name.endswith(suffix) and len(name) > len(suffix):
            return name.removesuffix(suffix), unit
    return name, Unit.DEG


def _cells(
    table: CsvRows, time_at: int, second: float, value_columns: Sequence[int]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return increasing times, values (rows, joints) with NaN for empty cells, and line numbers."""
    lines, has_commas = table.lines, table.has_commas
    flat, times, numbers = array("d"), array("d"), array("i")
    for number, row in table.rows():
        time_s = round(lines.number(row[time_at], number, has_commas=has_commas) * second, DIGITS)
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
    time_at, second = table.time_column()
    name_at = next(header.index(name) for name in _LONG_NAMES if name in header)
    unit_name = next(name for name in _LONG_VALUES if name in header)
    value_at = header.index(unit_name)
    ease_at = header.index("ease") if "ease" in header else None
    samples: dict[str, dict[float, tuple[float, int]]] = {}
    eases: dict[float, Interpolation] = {}
    for count, (number, row) in enumerate(table.rows()):
        if count >= VALUES_MAX:
            lines.refuse(number, f"more than {VALUES_MAX:,} values")
        time_s = round(
            lines.number(row[time_at], number, has_commas=table.has_commas) * second, DIGITS
        )
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
    extra = [
        n for i, n in enumerate(table.header) if i not in {time_at, name_at, value_at, ease_at}
    ]
    channels = tuple(_channel(joint, Unit(unit_name), own) for joint, own in samples.items())
    dense = [is_dense(channel.times_s) for channel in channels]
    return ForeignMotion(
        path=lines.path,
        name=motion_name(lines.path),
        channels=channels,
        notes={time_s: Note(ease=ease) for time_s, ease in eases.items()},
        comments=(
            f"Imported from {lines.path.name} (CSV, one row per key).",
            *summarised([f"column {name}" for name in extra]),
        ),
        is_recording=any(dense) and not eases,
    )


def _channel(joint: str, unit: Unit, samples: dict[float, tuple[float, int]]) -> Channel:
    times_s = sorted(samples)
    return Channel(
        name=joint,
        unit=unit,
        times_s=np.array(times_s),
        values=np.array([samples[time_s][0] for time_s in times_s]),
        lines=np.array([samples[time_s][1] for time_s in times_s], dtype=np.int32),
    )


def _ease(lines: TextLines, number: int, word: str) -> Interpolation:
    try:
        return Interpolation(word.lower())
    except ValueError:
        known = known_names(word, [ease.value for ease in Interpolation])
        lines.refuse(number, f"unknown ease {word!r:.40}; {known}")
