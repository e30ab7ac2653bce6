"""What the columns of a table mean: the joint, the unit, or the time that their names give.

Units end a name (`_deg`, `_rad`, `_us`, `_ms`) or stand in brackets: `elbow (rad)`. A column
without a unit is in degrees, as in the tables of `lss-motion plan --csv`, and one of a ROS topic in
radians; a unit that is not known is refused. A time is a number of seconds or of the unit in its
name, `hh:mm:ss`, ISO 8601, or the two parts of a stamp of ROS: seconds and nanoseconds.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.interchange.fields import VALUE_MAX, TextLines, is_number
from lss_motion.interchange.reader import DIGITS, Measure, unit_of_ros_joint

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


_TIMES: Final = frozenset(
    {"time", "t", "ts", "timestamp", "timestamps", "time_stamp", "stamp", "datetime", "date_time",
     "date", "elapsed", "elapsed_time", "time_elapsed", "epoch", "sec", "secs", "second", "seconds",
     "zeit", "temps", "tiempo", "tempo", "tijd", "tid", "czas", "\u6642\u9593", "\u65f6\u95f4"}
)  # fmt: skip
"""Names of a time column, without a unit; also as spreadsheets in other languages name it."""

_UNITLESS_TIMES: Final = _TIMES - {
    "sec",
    "secs",
    "second",
    "seconds",
    "date",
    "datetime",
    "date_time",
}

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

ANGLE_UNITS: Final = {
    **dict.fromkeys(["deg", "degs", "degree", "degrees", "°"], Measure.DEG),
    **dict.fromkeys(["rad", "rads", "radian", "radians"], Measure.RAD),
    **dict.fromkeys(["us", "µs", "μs", "usec", "microsecond", "microseconds"], Measure.US),
}
_OTHER_UNITS: Final = frozenset(
    {"mm", "cm", "mrad", "ticks", "steps", "counts", "turns", "revs", "rpm", "pct", "percent", "%",
     "mdeg", "ddeg", "cdeg", "dps", "ms", "ns"}
)  # fmt: skip
"""Ends of a name that are units, of which none is read."""

_MEASURES: Final = frozenset(
    {"velocity", "velocities", "vel", "speed", "speeds", "acceleration", "accelerations", "accel",
     "effort", "efforts", "torque", "current", "voltage", "temperature", "temp", "seq", "name"}
)  # fmt: skip
"""Last words of columns that stand beside positions, and are none."""

_SPEED: Final = re.compile(
    r"(deg|rad|\u00b0)\w*( ?/ ?|_per_|[_ ])s(ec(ond)?)?(\^?2|\u00b2)?|dps|rpm"
)
"""Units of speeds and accelerations, as they end a name or stand in brackets."""

_ROS: Final = re.compile(r"(/|field\.).*\bposition\W?\d*\W?", re.IGNORECASE)
"""Positions of a ROS topic in a table, as PlotJuggler and `rostopic echo -p` name them."""

_PAIR: Final = re.compile(r"(.*?)(?:n(?:ano)?secs?|nanoseconds?)", re.IGNORECASE)
"""The nanoseconds of a stamp; its seconds have the same name, with `sec` or the like."""

_BLANK_UNITS: Final = frozenset({"", "-", "--", "none", "n/a", "1"})
"""What stands in a row of units where there is none."""

_BRACKETS: Final = re.compile(r"[\s_]*[(\[{<]([^()\[\]{}<>]*)[)\]}>]")
_END: Final = re.compile(
    r"(.*?)(?:[\s_.,/:-]+(?:in\s+)?|(?<=[a-z])(?=Deg|Rad|\u00b0)|(?=\u00b0))"
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
        known = _TIME_UNITS.keys() - {"min"} if is_time else ANGLE_UNITS.keys() | _OTHER_UNITS
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
    if ANGLE_UNITS.get(unit) in {Measure.DEG, Measure.RAD}:
        return False
    return _plain(base) in _TIMES or not _TIME_WORDS.isdisjoint(_words(base))


def is_instant(name: str) -> bool:
    """Return whether a column about time is neither a duration nor a pause."""
    return re.search(r"duration|after|delay|pause|hold|frames", name, re.IGNORECASE) is None


def stamp_pair(header: Sequence[str]) -> tuple[int, int] | None:
    """Return the indices of the seconds and nanoseconds of a stamp: `header.stamp.sec`, `.nanosec`.

    None: the table has no such pair.
    """
    plain = [_plain(name) for name in header]
    for rest_at, name in enumerate(plain):
        if (pair := _PAIR.fullmatch(name)) is not None:
            for end in ("sec", "secs", "s", "seconds"):
                if pair[1] + end in plain:
                    return plain.index(pair[1] + end), rest_at
    return None


def is_other_measure(name: str) -> bool:
    """Return whether a column is about a speed, a force or the like, and no angle."""
    base, unit = name_and_unit(name)
    return _SPEED.fullmatch(unit) is not None or _words(base)[-1:] in [[w] for w in _MEASURES]


def is_time_text(word: str) -> bool:
    """Return whether a cell looks like `hh:mm:ss` or a date."""
    return _CLOCK.fullmatch(word) is not None or _DATE.fullmatch(word) is not None


def with_units(header: Sequence[str], cells: Sequence[str]) -> list[str] | None:
    """Return the header with the units in a row below it; None: the cells are not all units.

    A unit that is not known counts where others are, so that it is refused.
    """
    units = [re.sub(r"[(\[{<](.*)[)\]}>]", r"\1", cell.strip()).strip() for cell in cells]
    known = _TIME_UNITS.keys() | ANGLE_UNITS.keys() | _OTHER_UNITS
    named = [unit for unit in units if unit.lower() not in _BLANK_UNITS]
    is_known = [unit.lower() in known or _is_unit(unit) for unit in named]
    if len(cells) != len(header) or not any(is_known) or any(map(is_number, named)):
        return None
    return [
        name if unit.lower() in _BLANK_UNITS or name_and_unit(name)[1] else f"{name} ({unit})"
        for name, unit in zip(header, units, strict=True)
    ]


def _is_unit(unit: str) -> bool:
    return any(form.fullmatch(unit.lower()) is not None for form in (_SPEED, _CLOCK_UNIT))


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


def unit_of_column(path: Path, line: int | None, name: str) -> tuple[str, Measure]:
    """Return joint and unit of a column; a name without a unit is in degrees, or of a ROS topic.

    Raises `InputError` for a unit that is not known.
    """
    base, unit = name_and_unit(name)
    if unit and unit not in ANGLE_UNITS:
        reason = f"column {name!r:.60}: unit {unit!r:.40} is not read; deg, rad or us are"
        raise InputError(f"{reason}. Convert it, or remove the column", path=path, line=line)
    if unit:
        return base, ANGLE_UNITS[unit]
    return name, unit_of_ros_joint(name) if _ROS.fullmatch(name) else Measure.DEG


def assumed_units(names: Sequence[str], time: str = "") -> list[str]:
    """Return comments on the units that names do not give: of joints, and of the time."""
    bare = [name for name in names if not name_and_unit(name)[1]]
    of_ros = [name for name in bare if _ROS.fullmatch(name)]
    degrees = [name for name in bare if name not in of_ros]
    texts = []
    if degrees:
        texts.append(f"Columns without a unit are degrees: {', '.join(degrees)}.")
    if of_ros:
        texts.append(f"Columns of ROS topics are radians (REP 103): {', '.join(of_ros)}.")
    if _plain(time) in _UNITLESS_TIMES:
        texts.append(f"The times of column {time} have no unit and are read as seconds.")
    return texts
