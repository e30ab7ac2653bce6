"""Timing tracks of xLights (`.xtiming`): layers of labels, such as phrases, words and phonemes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.interchange.audacity import label_track
from lss_motion.interchange.fields import TextLines, parse_xml, text_head
from lss_motion.interchange.reader import Span, motion_name, read_or_refused
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import LabelTrack, RefusedMotion

LAYERS: Final = ("phrases", "words", "phonemes")
"""What the layers of a track hold, where it has three."""


@dataclass(slots=True)
class _Content:
    """The layers of all tracks, in the order of the file."""

    lines: TextLines
    tracks: list[tuple[str, list[list[Span]]]] = field(default_factory=list)

    def start(self, line: int, tag: str, attributes: dict[str, str]) -> None:
        if tag == "timing":
            self.tracks.append((attributes.get("name", ""), []))
        elif tag == "EffectLayer" and self.tracks:
            self.tracks[-1][1].append([])
        elif tag == "Effect" and self.tracks and self.tracks[-1][1]:
            from_s, to_s = (
                s_from_ms(self.lines.number(attributes.get(name, ""), line))
                for name in ("starttime", "endtime")
            )
            text = attributes.get("label", "").strip()
            self.tracks[-1][1][-1].append(Span(from_s, to_s, text, line))


class XLightsReader(Struct, frozen=True):
    """Reads each layer of each track as one track of labels."""

    name: str = "xlights"

    def recognises(self, data: bytes) -> bool:
        head = text_head(data, 4096)
        return b"<timing" in head and b"<EffectLayer" in head

    def motions(self, path: Path, data: bytes) -> tuple[LabelTrack | RefusedMotion, ...]:
        lines = TextLines.of(path, data)
        content = _Content(lines)
        parse_xml(lines, content.start, lambda _: None, lambda _: None)
        found = []
        for name, layers in content.tracks:
            names = LAYERS if len(layers) == len(LAYERS) else range(1, len(layers) + 1)
            for layer, spans in zip(names, layers, strict=True):
                title = motion_name(path, name if len(layers) == 1 else f"{name} {layer}")
                found.append(read_or_refused(title, partial(_track, lines, title, spans)))
        if not found:
            lines.refuse(None, "has no timing track with a layer")
        return tuple(found)


def _track(lines: TextLines, title: str, spans: list[Span]) -> LabelTrack:
    comment = f"The timing track {title!r:.60} of {lines.path.name} (xLights)."
    return label_track(lines, title, spans, comments=[comment])
