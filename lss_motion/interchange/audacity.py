"""Label tracks of Audacity: rows of start, end and text, divided by tabs."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.label_track import label_track
from lss_motion.interchange.reader import Span

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import LabelTrack

_ROW: Final = re.compile(rb"\d+[.,]\d+\t\d+[.,]\d+(\t[^\t\n]*)?\r?\n")
FREQUENCIES: Final = "\\"
"""Begins a row with the frequencies of the label before, which is no label."""


class AudacityReader(Struct, frozen=True):
    """Reads the rows as labels; a label may be an instant."""

    name: str = "audacity"

    def recognises(self, data: bytes) -> bool:
        return _ROW.match(text_head(data, 4096)) is not None

    def motions(self, path: Path, data: bytes) -> tuple[LabelTrack, ...]:
        lines = TextLines.of(path, data)
        spans = []
        for number, line in lines.numbered():
            if line.startswith(FREQUENCIES):
                continue
            words = line.split("\t", 2)
            if len(words) < 2:
                lines.refuse(number, f"{line!r:.60} is no row of start, tab, end, tab and text")
            from_s, to_s = (lines.number(word, number, has_commas=True) for word in words[:2])
            text = words[2].strip() if len(words) > 2 else ""
            spans.append(Span(from_s, to_s, text, number))
        comment = f"The labels of {path.name} (Audacity)."
        return (label_track(lines, "", spans, comments=[comment]),)
