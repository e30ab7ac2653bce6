"""Numbers in lines of text, taken out with their line: what the text formats share."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NoReturn

from lss_motion.errors import InputError
from lss_motion.source_file import text_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NUMBER_MAX_CHARS: Final = 40
"""Longer digits are no measurement."""

_NUMBER: Final = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d{1,3})?", re.ASCII)

VALUE_MAX: Final = 1e12
"""Seconds since 1970 are 1.7e9, milliseconds 1.7e12 / 1000; nothing larger is meant."""

LINES_MAX: Final = 5_000_000
"""A long table has a line for each of its 4,000,000 values at most, and some to explain them.
Without a bound, 64 MB of short lines are a gigabyte of text objects."""


@dataclass(frozen=True, slots=True)
class TextLines:
    """The lines of one text file, from 1; every refusal says which."""

    path: Path
    text: str

    @classmethod
    def of(cls, path: Path, data: bytes) -> TextLines:
        """Return the lines of a UTF-8 file with any line ends, or raise `InputError`."""
        text = text_of(data, path).replace("\r\n", "\n").replace("\r", "\n")
        if text.count("\n") > LINES_MAX:
            raise InputError(f"has more than {LINES_MAX:,} lines, the most that is read", path=path)
        return cls(path, text)

    def numbered(self) -> Iterator[tuple[int, str]]:
        """Yield number and content of every line that holds something."""
        for number, line in enumerate(self.text.split("\n"), start=1):
            if line.strip():
                yield number, line.strip()

    def number(self, word: str, line: int, *, has_commas: bool = False) -> float:
        """Return a finite number; a decimal comma only where `has_commas`."""
        word = word.strip()
        is_number = len(word) <= NUMBER_MAX_CHARS and _NUMBER.fullmatch(word)
        if not is_number or ("," in word and not has_commas):
            self.refuse(line, f"{word!r:.60} is not a number")
        value = float(word.replace(",", "."))
        if not abs(value) <= VALUE_MAX:
            self.refuse(line, f"{word!r:.60} is out of all bounds")
        return value

    def whole(self, word: str, line: int, most: int) -> int:
        """Return a whole number from 0 to `most`."""
        word = word.strip()
        is_number = word.isascii() and word.isdigit() and len(word) <= NUMBER_MAX_CHARS
        if not is_number or int(word) > most:
            self.refuse(line, f"{word!r:.60} is not a whole number from 0 to {most}")
        return int(word)

    def refuse(self, line: int | None, reason: str) -> NoReturn:
        """Raise `InputError`."""
        raise InputError(reason, path=self.path, line=line)
