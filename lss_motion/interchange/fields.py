"""Checked access to values in JSON and text files of other tools.

`JsonFields` and `TextLines` return values of the expected type, or raise `InputError` with the
place in the file. Sizes are bounded, so a damaged file cannot fill the memory.
"""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from typing import TYPE_CHECKING, Final, NoReturn
from xml.parsers import expat

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import text_of
from lss_motion.interchange.reader import VALUES_MAX

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path


NUMBER_MAX: Final = 1e9
"""Larger than any time, angle, pulse or position in the formats."""

COMMAS_MAX: Final = 2 * VALUES_MAX
COLONS_MAX: Final = VALUES_MAX
"""The longest format (pypot) has two numbers and one key per value of a recording. Without a bound,
64 MB of empty lists, or of keys, would need gigabytes of memory after parsing."""


def utf8_of(path: Path, data: bytes) -> bytes:
    """Return a text in UTF-8 that is in UTF-16, as Praat and spreadsheets write it; others as is.

    Raises `InputError` if it begins as UTF-16 and is not.
    """
    if not data.startswith((b"\xfe\xff", b"\xff\xfe")):
        return data
    try:
        return data.decode("utf-16").encode()
    except UnicodeError as error:
        raise InputError(f"is not UTF-16: {error}", path=path) from error


def text_head(data: bytes, size_bytes: int) -> bytes:
    """Return the first bytes of a file, without a byte order mark."""
    return data[:size_bytes].removeprefix(b"\xef\xbb\xbf")


def starts_json(data: bytes, bracket: bytes) -> bool:
    """Return whether `data` looks like a JSON object (`{`) or list (`[`)."""
    return text_head(data, 1024).lstrip().startswith(bracket)


def parsed_json(path: Path, data: bytes) -> object:
    """Return the content of a JSON file. NaN and repeated keys raise `InputError`."""

    def once(pairs: list[tuple[str, object]]) -> dict[str, object]:
        values = dict(pairs)
        if len(values) < len(pairs):
            counts = Counter(name for name, _ in pairs)
            twice = counts.most_common(1)[0][0]
            raise InputError(f"key {twice!r:.60} is given twice in one object", path=path)
        return values

    def refused(constant: str) -> NoReturn:
        raise InputError(f"{constant} is no number that a joint can reach", path=path)

    if data.count(b",") > COMMAS_MAX or data.count(b":") > COLONS_MAX:
        raise InputError(f"has more than {VALUES_MAX:,} values, the maximum", path=path)
    text = text_of(data, path)
    try:
        return json.loads(text, object_pairs_hook=once, parse_constant=refused)
    except json.JSONDecodeError as error:
        is_cut = error.pos >= len(text.rstrip()) or error.msg.startswith("Unterminated string")
        reason = "ends inside of its JSON: it was cut off" if is_cut else f"not JSON: {error.msg}"
        raise InputError(reason, path=path, line=error.lineno) from error
    except InputError:
        raise
    except (RecursionError, ValueError) as error:  # ValueError: thousands of digits.
        raise InputError(f"not JSON that can be read: {error}", path=path) from error


class JsonFields(Struct, frozen=True):
    """Typed access to one JSON file. Every `InputError` contains the place in the file."""

    path: Path

    def mapping(self, value: object, where: str) -> dict[str, object]:
        """Return `value` as an object, or raise `InputError`."""
        if not isinstance(value, dict):
            self.refuse(f"{where} must be an object, such as {{...}}")
        return value

    def items(self, values: dict[str, object], key: str, where: str) -> list[object]:
        """Return the list under `key`, which has at least one entry, or raise `InputError`."""
        listed = values.get(key)
        if not isinstance(listed, list) or not listed:
            self.refuse(f"{where} must have a list {key!r} with at least one entry")
        return listed

    def text(self, values: dict[str, object], key: str, where: str) -> str:
        """Return the text under `key`, or raise `InputError`."""
        value = values.get(key)
        if not isinstance(value, str):
            self.refuse(f"{where} must have a text {key!r}")
        return value

    def number(self, values: dict[str, object], key: str, where: str) -> float:
        """Return the number under `key`, or raise `InputError`."""
        if key not in values:
            self.refuse(f"{where} has no {key!r}")
        return self.plain_number(values[key], f"{where}.{key}")

    def plain_number(self, value: object, where: str) -> float:
        """Return `value` as a finite number below `NUMBER_MAX`, or raise `InputError`."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.refuse(f"{where} is {value!r:.60}, but must be a number")
        number = float(value) if abs(value) < NUMBER_MAX else math.inf  # Not for huge integers.
        if not math.isfinite(number):
            self.refuse(f"{where} is {value!r:.60}, which is out of range")
        return number

    def duration(self, values: dict[str, object], key: str, where: str) -> float:
        """Return the number of seconds under `key`, 0 or more, or raise `InputError`."""
        number = self.number(values, key, where)
        if number < 0.0:
            self.refuse(f"{where}.{key} is {number:g}, but must be 0 s or more")
        return number

    def refuse(self, reason: str) -> NoReturn:
        """Raise `InputError` with `reason`."""
        raise InputError(reason, path=self.path)


CUT_OFF: Final = (
    "no element found",
    "unclosed token",
    "partial character",
    "unclosed CDATA section",
)
"""What expat calls a text that ends too early."""

NUMBER_MAX_CHARS: Final = 40
"""A longer number is not a measurement."""

_NUMBER: Final = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d{1,3})?", re.ASCII)


def is_number(word: str, *, has_commas: bool = False) -> bool:
    """Return whether `word` is a number. `has_commas` allows a decimal comma."""
    if len(word) > NUMBER_MAX_CHARS or ("," in word and not has_commas):
        return False
    return _NUMBER.fullmatch(word) is not None


VALUE_MAX: Final = 1e12
"""Larger than any time: seconds since 1970 are 1.7e9."""

LINES_MAX: Final = 5_000_000
"""A long table has one line for each of at most 4,000,000 values, and some comments. Without a
bound, 64 MB of short lines would become a gigabyte of text objects."""


class TextLines(Struct, frozen=True):
    """The lines of one text file, numbered from 1. Every `InputError` contains the line number."""

    path: Path
    text: str

    @classmethod
    def of(cls, path: Path, data: bytes) -> TextLines:
        """Return the lines of a UTF-8 file with any line ends, or raise `InputError`."""
        text = text_of(data, path).replace("\r\n", "\n").replace("\r", "\n")
        if text.count("\n") > LINES_MAX:
            raise InputError(f"has more than {LINES_MAX:,} lines, the maximum", path=path)
        return cls(path, text)

    def numbered(self) -> Iterator[tuple[int, str]]:
        """Yield number and content of every line that is not blank."""
        for number, line in enumerate(self.text.split("\n"), start=1):
            if line.strip():
                yield number, line.strip()

    def with_head(self) -> tuple[int, str, list[tuple[int, str]]]:
        """Return number and content of the first line that is not blank, and the lines after it."""
        (number, head), *rows = [*self.numbered()] or [(1, "")]
        return number, head, rows

    def number(self, word: str, line: int, *, has_commas: bool = False) -> float:
        """Return a finite number. `has_commas` allows a decimal comma."""
        word = word.strip()
        if not is_number(word, has_commas=has_commas):
            self.refuse(line, f"{word!r:.60} is not a number")
        value = float(word.replace(",", "."))
        if not abs(value) <= VALUE_MAX:
            self.refuse(line, f"{word!r:.60} is out of range")
        return value

    def whole(self, word: str, line: int, maximum: int) -> int:
        """Return a whole number from 0 to `maximum`."""
        word = word.strip()
        is_number = word.isascii() and word.isdigit() and len(word) <= NUMBER_MAX_CHARS
        if not is_number or int(word) > maximum:
            self.refuse(line, f"{word!r:.60} is not a whole number from 0 to {maximum}")
        return int(word)

    def refuse(self, line: int | None, reason: str) -> NoReturn:
        """Raise `InputError` with `reason`."""
        raise InputError(reason, path=self.path, line=line)


def parse_xml(
    lines: TextLines,
    start: Callable[[int, str, dict[str, str]], None],
    end: Callable[[str], None],
    text: Callable[[str], None],
) -> None:
    """Call `start` with line, tag and attributes, `text` and `end` for all elements of a file.

    Raises `InputError` for what is no XML, and for a document type: its entities could expand
    without end.
    """
    parser = expat.ParserCreate()

    def started(tag: str, attributes: dict[str, str]) -> None:
        start(parser.CurrentLineNumber, tag, attributes)

    def refused(*_: object) -> None:
        lines.refuse(
            parser.CurrentLineNumber, "declares a document type, which is not allowed here"
        )

    parser.buffer_text = True
    parser.StartElementHandler = started
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text
    parser.StartDoctypeDeclHandler = refused
    try:
        parser.Parse(lines.text.encode(), True)  # noqa: FBT003  expat's own order
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        if reason in CUT_OFF:
            reason += ": it was cut off, copy it again"
        raise InputError(f"not XML: {reason}", path=lines.path, line=error.lineno) from error
