"""CSV tables: wide (`time_s,<joint>_deg,…`) and long (`time_s,servo,deg[,ease]`).

The time column is `time`, `t`, `timestamp` or the like, in seconds, or in the unit of its name; its
cells may be `hh:mm:ss` or ISO 8601. It may be `frame` after a line `# fps: N`. Units end a name
(`_deg`, `_rad`, `_us`, `_ms`) or stand in brackets: `elbow (rad)`. A column without a unit is in
degrees, as in the tables of `lss-motion plan --csv`; a unit that is not known is refused. The
separator is a comma, a semicolon, a tab or blanks. Decimal commas are allowed if the separator is
not a comma. An empty cell sets no key. The header may be a comment, as of `numpy.savetxt`.
"""

from __future__ import annotations

import csv
import re
from array import array
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.interchange.fields import VALUE_MAX, TextLines, is_number, text_head
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
    summarised,
)
from lss_motion.show.model import Interpolation

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray, IntArray


_TIMES: Final = frozenset(
    {"time", "t", "ts", "timestamp", "timestamps", "time_stamp", "stamp", "datetime", "elapsed",
     "elapsed_time", "time_elapsed", "epoch", "sec", "secs", "second", "seconds"}
)  # fmt: skip
"""Names of a time column, without a unit."""

_TIME_WORDS: Final = frozenset(
    {"time", "times", "timestamp", "timestamps", "stamp", "datetime", "date", "elapsed", "epoch",
     "sec", "secs", "seconds", "millis", "micros", "milliseconds", "nsec", "msec", "duration",
     "delay", "pause", "hold", "frame", "frames"}
)  # fmt: skip
"""A name with one of these words is no joint."""

_TIME_UNITS: Final = {
    **dict.fromkeys(["s", "sec", "secs", "second", "seconds"], 1.0),
    **dict.fromkeys(["ms", "msec", "msecs", "millis", "millisecond", "milliseconds"], 1e-3),
    **dict.fromkeys(["us", "µs", "μs", "usec", "micros", "microsecond", "microseconds"], 1e-6),
    **dict.fromkeys(["ns", "nsec", "nanos", "nanosecond", "nanoseconds"], 1e-9),
    **dict.fromkeys(["min", "minutes"], 60.0),
}
"""Measure of a time → seconds."""

_ANGLE_UNITS: Final = {
    **dict.fromkeys(["deg", "degs", "degree", "degrees", "°"], Measure.DEG),
    **dict.fromkeys(["rad", "rads", "radian", "radians"], Measure.RAD),
    **dict.fromkeys(["us", "µs", "μs", "usec", "microsecond", "microseconds"], Measure.US),
}
_OTHER_UNITS: Final = frozenset(
    {"mm", "cm", "mrad", "ticks", "steps", "counts", "turns", "revs", "rpm", "pct", "percent", "%",
     "mdeg", "ddeg", "cdeg", "dps", "ms", "ns"}
)  # fmt: skip
"""Ends of a name that are units, of which none is read."""

_BRACKETS: Final = re.compile(r"[\s_]*[(\[{<]([^()\[\]{}<>]*)[)\]}>]")
_END: Final = re.compile(
    r"(.*?)(?:[\s_.,/:-]+|(?<=[a-z])(?=Deg|Rad|\u00b0)|(?=\u00b0))"
    r"((?:deg|rad)\w{0,4}(?:[\s_/]+|_per_)s(?:ec)?\d?|[a-z\u00b0%\u00b5\u03bc]+)",
    re.IGNORECASE,
)
_CLOCK_UNIT: Final = re.compile(
    r"h{1,2}:m{1,2}:s{1,2}(?:[.,]\w{1,9})?|iso[ -]?(?:8601)?|utc|unix|epoch", re.IGNORECASE
)
_CLOCK: Final = re.compile(r"(?:(\d{1,4}):)?([0-5]?\d):([0-5]\d)([.,]\d{1,9})?", re.ASCII)
_DATE: Final = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d.{0,24}", re.ASCII)


def name_and_unit(name: str) -> tuple[str, str]:
    """Return the name of a column without its unit, and the unit in small letters, or ""."""
    for found in reversed([*_BRACKETS.finditer(name)]):
        if not found[1].strip().isdigit():  # A number is an index.
            return (name[: found.start()] + name[found.end() :]).strip(), found[1].strip().lower()
    if end := _END.fullmatch(name):
        base, unit = end[1], end[2].lower()
        is_time = _plain(base) in _TIMES or not _TIME_WORDS.isdisjoint(_words(base))
        known = _TIME_UNITS.keys() - {"min"} if is_time else _ANGLE_UNITS.keys() | _OTHER_UNITS
        if base and (unit in known or re.match(r"(deg|rad)\w*(/|_| )", unit)):
            return base, unit
    return name, ""


def _plain(name: str) -> str:
    """Return a name in small letters, without marks of other programs before it: `__time`."""
    return re.sub(r"[\s-]+", "_", name.strip("_ ./%#").lower())


def _words(name: str) -> list[str]:
    return re.findall(r"[a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", name).lower())


def is_time_name(name: str) -> bool:
    """Return whether a column is about time, and therefore no joint."""
    base, unit = name_and_unit(name)
    if _ANGLE_UNITS.get(unit) in {Measure.DEG, Measure.RAD}:
        return False
    return _plain(base) in _TIMES or not _TIME_WORDS.isdisjoint(_words(base))


def _is_instant(name: str) -> bool:
    """Return whether a column about time is neither a duration nor a pause."""
    return re.search(r"duration|after|delay|pause|hold|frames", name, re.IGNORECASE) is None


def seconds_of(name: str) -> float | None:
    """Return the unit of a time column in seconds; None if it is none that is understood."""
    base, unit = name_and_unit(name)
    if base == "%time":  # As `rostopic echo -p` writes it.
        return 1e-9
    base = _plain(base)
    if not unit and base in _TIME_UNITS and len(base) > 2:
        return _TIME_UNITS[base]
    if base not in _TIMES:
        return None
    return 1.0 if not unit or _CLOCK_UNIT.fullmatch(unit) else _TIME_UNITS.get(unit)


def seconds_at(
    lines: TextLines, word: str, number: int, second: float, *, has_commas: bool
) -> float:
    """Return a time in seconds: a number of units of `second`, `hh:mm:ss`, or ISO 8601."""
    word = word.strip()
    if second == 1.0:
        clock = _CLOCK.fullmatch(word)
        if clock is not None and (clock[1] or clock[4]):
            whole_s = 3600 * int(clock[1] or 0) + 60 * int(clock[2]) + int(clock[3])
            return round(whole_s + float("0" + (clock[4] or ".0").replace(",", ".")), DIGITS)
        if _DATE.fullmatch(word):
            try:
                at = datetime.fromisoformat(word)
            except ValueError:
                lines.refuse(number, f"{word!r:.60} is no time of ISO 8601")
            return round((at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp(), DIGITS)
    if ":" in word or "/" in word:
        lines.refuse(number, f"time {word!r:.60} is not understood; write seconds, or hh:mm:ss")
    if is_number(word, has_commas=has_commas):
        at_s = float(word.replace(",", ".")) * second
        if second < 1.0 and abs(at_s) < VALUE_MAX:
            return round(at_s, DIGITS)
        if abs(at_s) >= VALUE_MAX:
            lines.refuse(
                number, f"{word!r:.60} is out of range for seconds: give the unit, `time_ns`"
            )
    return round(lines.number(word, number, has_commas=has_commas) * second, DIGITS)


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

    def time_column(self) -> tuple[int, float]:
        """Return the index of the time column, and its unit in seconds."""
        for at, name in enumerate(self.header):
            second = seconds_of(name)
            if second is not None:
                return at, second
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
        return frames[0], 1.0 / self.fps


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


def header_of(rows: Iterable[tuple[int, str]]) -> tuple[int, list[str], str, int] | None:
    """Return the header, with its line, its delimiter, and the number of lines above the rows.

    A comment above a line of numbers is the header if it has as many cells.
    """
    comment: tuple[int, str] | None = None
    for number, line in rows:
        if line.startswith("#"):
            comment = number, line.lstrip("#").strip()
            continue
        delimiter = delimiter_of(line)
        header = cells_of(line, delimiter)
        if comment is not None and len(header) > 1 and _are_values(header, delimiter):
            names = cells_of(comment[1], delimiter)
            if len(names) == len(header) and not any(is_number(name) for name in names):
                return comment[0], names, delimiter, number - 1
        return number, header, delimiter, number
    return None


def _are_values(cells: list[str], delimiter: str) -> bool:
    """Return whether all cells are numbers or times."""
    return all(
        not cell
        or is_number(cell, has_commas=delimiter != ",")
        or _CLOCK.fullmatch(cell)
        or _DATE.fullmatch(cell)
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
    number, header, delimiter, first_row = found
    twice = [name for name in header if header.count(name) > 1]
    if twice and not all(is_number(name, has_commas=True) for name in header):
        lines.refuse(number, f"column {twice[0]!r:.60} occurs twice")
    return CsvRows(lines, number, header, delimiter, fps, first_row)


_LONG_NAMES: Final = ("servo", "joint")
_LONG_VALUES: Final = ("position", "angle", "value", "pos")


def _is_value(name: str) -> bool:
    """Return whether a column of a long table has the values: `deg`, `position (rad)`."""
    base, unit = name_and_unit(name)
    return name in {"deg", "rad", "us"} or (base in _LONG_VALUES and unit in _ANGLE_UNITS)


def _is_csv(data: bytes) -> bool:
    head = text_head(data, 65_536).decode("utf-8", "replace")
    rows = [(at, row.strip()) for at, row in enumerate(head.splitlines(), 1) if row.strip()]
    try:
        found = header_of(rows)
    except csv.Error:
        return False
    if found is None or len(found[1]) < 2:
        return False
    _, header, delimiter, first_row = found
    if not any(seconds_of(name) or (is_time_name(name) and _is_instant(name)) for name in header):
        return False
    first = next((row for at, row in rows if at > first_row and not row.startswith("#")), "")
    cells = cells_of(first, delimiter)
    return delimiter != " " or (len(cells) == len(header) and _are_values(cells, delimiter))


def _csv_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    table = csv_rows(TextLines.of(path, data))
    header = [name.lower() for name in table.header]
    is_long = any(n in header for n in _LONG_NAMES) and any(map(_is_value, header))
    return (_long(table, header) if is_long else _wide(table),)


CSV: Final = Reader("csv", _is_csv, _csv_motions)
"""Reads both forms; the header decides which."""


def _wide(table: CsvRows) -> ForeignMotion:
    time_at, second = table.time_column()
    others = [name for at, name in enumerate(table.header) if at != time_at and is_time_name(name)]
    names = [
        (at, name)
        for at, name in enumerate(table.header)
        if at != time_at and name and name not in others
    ]
    if not names:
        table.lines.refuse(table.header_line, "no column is a joint")
    columns = [
        (at, *unit_of_column(table.lines.path, table.header_line, name)) for at, name in names
    ]
    joints = [joint for _, joint, _ in columns]
    if len(set(joints)) < len(joints):
        twice = next(joint for joint in joints if joints.count(joint) > 1)
        table.lines.refuse(table.header_line, f"joint {twice!r:.60} has two columns")
    times_s, values, numbers = _cells(table, time_at, second, [at for at, _, _ in columns])
    channels: list[Channel] = []
    empty = [f"column {name}, which is about time" for name in others]
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


def unit_of_column(path: Path, line: int | None, name: str) -> tuple[str, Measure]:
    """Return joint and unit of a column; a name without a unit is in degrees.

    Raises `InputError` for a unit that is not known.
    """
    base, unit = name_and_unit(name)
    if unit and unit not in _ANGLE_UNITS:
        reason = f"column {name!r:.60}: unit {unit!r:.40} is not read; deg, rad or us are"
        raise InputError(f"{reason}. Convert it, or remove the column", path=path, line=line)
    return (base, _ANGLE_UNITS[unit]) if unit else (name, Measure.DEG)


def _cells(
    table: CsvRows, time_at: int, second: float, value_columns: Sequence[int]
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return increasing times, values (rows, joints) with NaN for empty cells, and line numbers."""
    lines, has_commas = table.lines, table.has_commas
    flat, times, numbers = array("d"), array("d"), array("i")
    for number, row in table.rows():
        time_s = seconds_at(lines, row[time_at], number, second, has_commas=has_commas)
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
    value_at = next(at for at, name in enumerate(header) if _is_value(name))
    unit = _ANGLE_UNITS[name_and_unit(header[value_at])[1] or header[value_at]]
    ease_at = header.index("ease") if "ease" in header else None
    samples: dict[str, dict[float, tuple[float, int]]] = {}
    eases: dict[float, Interpolation] = {}
    for count, (number, row) in enumerate(table.rows()):
        if count >= VALUES_MAX:
            lines.refuse(number, f"more than {VALUES_MAX:,} values")
        time_s = seconds_at(lines, row[time_at], number, second, has_commas=table.has_commas)
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
    channels = tuple(_channel(joint, unit, own) for joint, own in samples.items())
    dense = [is_dense(channel.times_s) for channel in channels]
    return ForeignMotion(
        path=lines.path,
        name=motion_name(lines.path),
        channels=channels,
        notes={time_s: PoseNote(ease=ease) for time_s, ease in eases.items()},
        comments=(
            f"Imported from {lines.path.name} (CSV, one row per key).",
            *summarised([f"column {name}" for name in extra]),
        ),
        is_recording=any(dense) and not eases,
    )


def _channel(joint: str, unit: Measure, samples: dict[float, tuple[float, int]]) -> Channel:
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
