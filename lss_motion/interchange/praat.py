"""TextGrids of Praat, long and short text: tiers of intervals and of points.

Both forms, as Praat itself reads them, are a row of numbers, texts in quotes and flags in angle
brackets; all other words are for people.
"""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.interchange.audacity import label_track
from lss_motion.interchange.fields import TextLines
from lss_motion.interchange.reader import Span, motion_name, read_or_refused

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.interchange.reader import LabelTrack, RefusedMotion

HEAD: Final = b"ooTextFile"
COUNT_MAX: Final = 1_000_000
"""Tiers, or labels of a tier."""
_TOKEN: Final = re.compile(
    r'"(?P<text>[^"]*(?:""[^"]*)*)"|<(?P<flag>\w+)>|(?<!\S)(?P<number>[-+]?\d[\d.eE+-]*)%?(?!\S)|!.*'
)


class PraatReader(Struct, frozen=True):
    """Reads each tier as a track. The empty texts of intervals are pauses."""

    name: str = "praat"

    def recognises(self, data: bytes) -> bool:
        head = data[:256].replace(b"\0", b"")
        return HEAD in head and b"TextGrid" in head

    def motions(self, path: Path, data: bytes) -> tuple[LabelTrack | RefusedMotion, ...]:
        lines = TextLines.of(path, _utf8(path, data))
        return tuple(_Tokens(lines).tiers())


def _utf8(path: Path, data: bytes) -> bytes:
    """Return the text in UTF-8; Praat writes UTF-16 where a text is not ASCII."""
    if not data.startswith((b"\xfe\xff", b"\xff\xfe")):
        return data
    try:
        return data.decode("utf-16").encode()
    except UnicodeError as error:
        raise InputError(f"is not UTF-16: {error}", path=path) from error


class _Tokens:
    """Numbers and texts of a file, one after the other."""

    def __init__(self, lines: TextLines) -> None:
        self._lines = lines
        self._found = _TOKEN.finditer(lines.text)
        self._at, self._line = 0, 1

    def tiers(self) -> Iterator[LabelTrack | RefusedMotion]:
        """Yield each tier."""
        if "ooTextFile" not in self._text() or "TextGrid" not in self._text():
            self._lines.refuse(self._line, "is no TextGrid in text form; save it as a text file")
        self._number()
        self._number()
        if self._next("flag") != "exists":
            self._lines.refuse(self._line, "has no tier")
        count = self._count()
        if not count:
            self._lines.refuse(self._line, "has no tier")
        for _ in range(count):
            kind, name = self._text(), self._text()
            self._number()
            self._number()
            read = self._interval if kind == "IntervalTier" else self._point
            spans = [read() for _ in range(self._count())]
            title = motion_name(self._lines.path, name)
            yield read_or_refused(title, partial(self._track, name, spans))

    def _track(self, name: str, spans: list[Span]) -> LabelTrack:
        comment = f"The tier {name!r:.60} of {self._lines.path.name} (Praat)."
        return label_track(self._lines, name, spans, comments=[comment])

    def _interval(self) -> Span:
        from_s, to_s = self._number(), self._number()
        return Span(from_s, to_s, self._text().strip(), self._line)

    def _point(self) -> Span:
        at_s = self._number()
        return Span(at_s, at_s, self._text().strip(), self._line)

    def _next(self, kind: str) -> str:
        for token in self._found:
            if token.lastgroup is None:  # A comment.
                continue
            self._line += self._lines.text.count("\n", self._at, token.start())
            self._at = token.start()
            if token.lastgroup != kind:
                self._lines.refuse(
                    self._line, f"{token.group()!r:.60} stands where a {kind} must be"
                )
            return str(token.group(kind))
        return self._lines.refuse(self._line, f"ends where a {kind} must follow: it was cut off")

    def _text(self) -> str:
        return self._next("text").replace('""', '"')

    def _number(self) -> float:
        return self._lines.number(self._next("number"), self._line)

    def _count(self) -> int:
        return self._lines.whole(self._next("number"), self._line, COUNT_MAX)
