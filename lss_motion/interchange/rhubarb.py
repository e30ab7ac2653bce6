"""Mouth cues of Rhubarb Lip Sync: JSON, XML and TSV (its switch data: see `papagayo`)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.interchange.audacity import label_track
from lss_motion.interchange.fields import (
    JsonFields,
    TextLines,
    parse_xml,
    parsed_json,
    starts_json,
    text_head,
)
from lss_motion.interchange.reader import Span

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import LabelTrack

_TSV_ROW: Final = re.compile(rb"\d+(\.\d+)?\t[A-HX]\r?\n")


@dataclass(slots=True)
class _Xml:
    """The cues of an XML file, in its order."""

    lines: TextLines
    spans: list[Span] = field(default_factory=list)
    sound: str = ""
    text: str = ""
    cue: tuple[int, dict[str, str]] | None = None

    def start(self, line: int, tag: str, attributes: dict[str, str]) -> None:
        self.text = ""
        if tag == "mouthCue":
            self.cue = line, attributes

    def add_text(self, part: str) -> None:
        self.text += part

    def end(self, tag: str) -> None:
        if tag == "soundFile":
            self.sound = self.text.strip()
        if tag == "mouthCue" and self.cue is not None:
            line, attributes = self.cue
            from_s, to_s = (
                self.lines.number(attributes.get(name, ""), line) for name in ("start", "end")
            )
            self.spans.append(Span(from_s=from_s, to_s=to_s, text=self.text.strip(), line=line))
            self.cue = None


class RhubarbReader(Struct, frozen=True):
    """Reads `mouthCues`, `<rhubarbResult>`, and rows of a time and a shape."""

    name: str = "rhubarb"

    def recognises(self, data: bytes) -> bool:
        head = text_head(data, 4096)
        is_json = starts_json(data, b"{") and b'"mouthCues"' in data
        return is_json or b"<rhubarbResult" in head or _TSV_ROW.match(head) is not None

    def motions(self, path: Path, data: bytes) -> tuple[LabelTrack, ...]:
        lines = TextLines.of(path, data)
        sound = ""
        if starts_json(data, b"{"):
            spans, sound = _json_spans(path, data)
        elif lines.text.lstrip().startswith("<"):
            found = _Xml(lines)
            parse_xml(lines, found.start, found.end, found.add_text)
            spans, sound = found.spans, found.sound
        else:
            spans = _tsv_spans(lines)
        comment = f"The mouth cues of {path.name} (Rhubarb)."
        return (label_track(lines, "", spans, comments=[comment], sound=sound, is_mouth=True),)


def _json_spans(path: Path, data: bytes) -> tuple[list[Span], str]:
    fields = JsonFields(path)
    content = fields.mapping(parsed_json(path, data), "the file")
    spans = []
    for number, item in enumerate(fields.items(content, "mouthCues", "the file"), start=1):
        where = f"mouth cue {number}"
        cue = fields.mapping(item, where)
        from_s, to_s = (fields.duration(cue, key, where) for key in ("start", "end"))
        spans.append(Span(from_s=from_s, to_s=to_s, text=fields.text(cue, "value", where)))
    about = content.get("metadata")
    sound = about.get("soundFile") if isinstance(about, dict) else ""
    return spans, sound if isinstance(sound, str) else ""


def _tsv_spans(lines: TextLines) -> list[Span]:
    rows = []
    for number, line in lines.numbered():
        at, tab, shape = line.partition("\t")
        if not tab:
            lines.refuse(number, f"{line!r:.60} is no row of a time, a tab and a mouth shape")
        rows.append((lines.number(at, number), shape.strip(), number))
    if len(rows) < 2:
        lines.refuse(None, "has less than two rows")
    spans = [
        Span(from_s=from_s, to_s=to_s, text=shape, line=number)
        for (from_s, shape, number), (to_s, _, _) in pairwise(rows)
    ]
    last_s, shape, number = rows[-1]
    # The last row closes the mouth; it is a cue of its own unless the mouth is closed before.
    return spans if shape == rows[-2][1] else [*spans, Span(last_s, last_s, shape, number)]
