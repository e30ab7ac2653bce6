"""What readers of label files share: the checked track of what they found."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.interchange.reader import DIGITS, LabelTrack, motion_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.interchange.fields import TextLines
    from lss_motion.interchange.reader import Span

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
