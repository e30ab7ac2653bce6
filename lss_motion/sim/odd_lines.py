"""Lines that programs send to servos, but that no document describes.

Published programs send lines with spaces (`#1 D500 SD600`), with decimals (`#1D100.0`), to id 255,
or a setting without its value (`#254CO`). What firmware does with them is not known. So it is an
assumption of the simulator (FACTS.md A27, `Physics.lines`), and `OddLines` counts them: a program
that sends them is told so, whatever the servos do. Lenient servos take a value that is missing for
0, as the maker's sketch of the LSS-2IO does (FACTS.md B5).
"""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import BROADCAST_ID, Family
from lss_motion.protocol.framing import commands_in
from lss_motion.protocol.table import Form

if TYPE_CHECKING:
    from lss_motion.sim.physics import Lines

SERVOS: Final = (Family.LSS, Family.LSS_PRO)
WITHOUT_VALUE: Final = "CFD"
"""Without a value it means that there is no first position."""
_COMMON: Final = re.compile(rb"#(?:1?[0-9]?[0-9]|2[0-4][0-9]|25[0-4])[A-Za-z]+-?[0-9]+\r")
"""A line that is not looked at any further."""
_BLANK: Final = re.compile(rb"[\s#\x00]*")
_DECIMAL: Final = re.compile(rb"([A-Za-z])(-?[0-9]*\.[0-9]+|-?[0-9]+\.)")
_BARE: Final = re.compile(rb"(?<=[0-9])([A-Za-z]+)(?=[\r#]|$)")
"""A keyword without a value."""
_ID: Final = re.compile(rb"#\s*([0-9]+)")
SPACE, DECIMAL, ID, VALUE, OTHER = "space", "decimal", "id", "value", "other"
MEANINGS: Final = {
    SPACE: "with spaces",
    DECIMAL: "with decimals",
    ID: f"to an id above {BROADCAST_ID}",
    VALUE: "with a setting without its value",
    OTHER: "that no document describes",
}
"""Kinds of lines, with the text for a person."""


class OddLines:
    """Counts the odd lines of one bus, and reads them as the servos are assumed to do."""

    def __init__(self, lines: Lines, *, is_grouped: bool) -> None:
        self.counts: Counter[str] = Counter()
        """By kind; a line may be of several."""
        self._lines = lines
        self._is_grouped = is_grouped
        self._new: list[str] = []

    def read(self, line: bytes) -> bytes:
        """Return a line of the host, CR included, as the servos read it."""
        if _COMMON.fullmatch(line) is not None or _BLANK.fullmatch(line) is not None:
            return line
        kinds = _kinds(line, is_grouped=self._is_grouped)
        for kind in kinds:
            self.counts[kind] += 1
            if self.counts[kind] == 1:
                self._new.append(self._text(kind, line))
        return _as_meant(line) if kinds and self._lines == "lenient" else line

    def take_texts(self) -> list[str]:
        """Return a text for each kind of line that has come for the first time."""
        texts, self._new = self._new, []
        return texts

    def summary(self) -> str:
        """Return how many lines of each kind have come; empty: none."""
        return ", ".join(f"{count} {MEANINGS[kind]}" for kind, count in self.counts.items())

    def _text(self, kind: str, line: bytes) -> str:
        sent = ascii(line.rstrip(b"\r").decode("latin-1"))[1:-1]
        does = "is ignored"
        if self._lines == "lenient" and kind != OTHER:
            does = "is taken with 0" if kind == VALUE else "is taken as it seems to be meant"
        return (
            f"a program sends lines {MEANINGS[kind]}, such as {sent:.60}: what firmware does with "
            f"them is not known. Such a line {does} here (--lines); do not rely on it"
        )


def _kinds(line: bytes, *, is_grouped: bool) -> list[str]:
    """Return of which kinds a line is; none: documents describe it."""
    commands = commands_in(line, grouped=is_grouped)
    bare = line.rstrip(b"\r")
    sections = sum(1 for part in bare.split(b"#") if part.strip(b"\0 \t\r\n"))
    is_lost = not commands or (is_grouped and len(commands) < sections)
    kinds = [SPACE] if is_lost and b" " in bare and not _has_text(bare) else []
    if is_lost and _DECIMAL.search(bare.replace(b" ", b"")) is not None:
        kinds.append(DECIMAL)
    if any(int(number) > BROADCAST_ID for number in _ID.findall(bare)):
        kinds.append(ID)
    if any(one.value is None and _is_setting(one.keyword) for one in commands):
        kinds.append(VALUE)
    return kinds or ([OTHER] if is_lost else [])


def _has_text(line: bytes) -> bool:
    """Return whether spaces may be part of a text."""
    return b'"' in line


def _is_setting(keyword: str) -> bool:
    """Return whether a keyword stores a value in servos, and means nothing without one."""
    if keyword == WITHOUT_VALUE:
        return False
    found = (FAMILY_TABLES[family].by_keyword.get(keyword) for family in SERVOS)
    return any(one is not None and one[0] is Form.CONFIG for one in found)


def _as_meant(line: bytes) -> bytes:
    """Return a line without spaces and decimals, with a value, and to an id that there is."""
    line = line.replace(b" ", b"")
    line = _DECIMAL.sub(lambda found: found[1] + _whole(found[2]), line)
    line = _BARE.sub(lambda bare: bare[0] + b"0" * _is_setting(bare[1].decode().upper()), line)

    def known(found: re.Match[bytes]) -> bytes:
        return b"#%d" % min(int(found[1]), BROADCAST_ID)

    return _ID.sub(known, line)


def _whole(number: bytes) -> bytes:
    return b"%d" % int(float(number))
