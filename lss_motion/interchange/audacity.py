"""Label tracks of Audacity: rows of start, end and text, divided by tabs.

What readers of label files share stands here, too: the checked track of what they found.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import DIGITS, LabelTrack, Span, motion_name

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


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


SPANS_MAX: Final = 100_000
"""Maximum number of labels of a track. Chosen: two hours of speech."""


def label_track(
    lines: TextLines,
    name: str,
    spans: Sequence[Span],
    *,
    comments: Sequence[str] = (),
    sound: str = "",
    is_mouth: bool = False,
    assumed_fps: float | None = None,
) -> LabelTrack:
    """Return the track of some labels; raise `InputError` for a time that no show has."""
    if not spans:
        lines.refuse(None, f"track {name!r:.60} has no label")
    if len(spans) > SPANS_MAX:
        lines.refuse(None, f"has more than {SPANS_MAX:,} labels, the maximum")
    for span in spans:
        if not 0.0 <= span.from_s <= span.to_s:
            lines.refuse(span.line, f"a label from {span.from_s:g} s to {span.to_s:g} s cannot be")
    return LabelTrack(
        path=lines.path,
        name=motion_name(lines.path, name),
        spans=tuple(
            replace(span, from_s=round(span.from_s, DIGITS), to_s=round(span.to_s, DIGITS))
            for span in sorted(spans, key=lambda span: span.from_s)
        ),
        comments=tuple(comments),
        is_mouth=is_mouth,
        sound=sound,
        assumed_fps=assumed_fps,
    )
