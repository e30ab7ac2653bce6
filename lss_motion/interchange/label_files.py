"""Labels of sounds and mouths, as other tools write them: each track of a file as a `LabelTrack`.

| reader     | what it reads                                                                   |
|------------|---------------------------------------------------------------------------------|
| `AUDACITY` | rows of start, end and text, divided by tabs                                    |
| `RHUBARB`  | mouth cues of Rhubarb Lip Sync: JSON, XML and TSV (its switch data: `PAPAGAYO`) |
| `PAPAGAYO` | lip-sync projects (`.pgo`) and switch data of Moho (`.dat`)                     |
| `PRAAT`    | TextGrids, long and short: tiers of intervals and of points                     |
| `XLIGHTS`  | timing tracks (`.xtiming`): layers of phrases, words and phonemes               |

A project of Papagayo has voices of phrases of words of phonemes, in frames from 0. Switch data has
a frame, from 1, and a shape in each row, and does not give its frame rate. Both forms of a
TextGrid, as Praat itself reads them, are a row of numbers, texts in quotes and flags in angle
brackets; all other words are for people.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.interchange.fields import (
    JsonFields,
    TextLines,
    parse_xml,
    parsed_json,
    starts_json,
    text_head,
)
from lss_motion.interchange.reader import (
    DIGITS,
    FPS_MAX,
    LabelTrack,
    Reader,
    Span,
    motion_name,
    read_or_refused,
)
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import RefusedMotion


_ROW: Final = re.compile(rb"\d+[.,]\d+\t\d+[.,]\d+(\t[^\t\n]*)?\r?\n")
FREQUENCIES: Final = "\\"
"""Begins a row with the frequencies of the label before, which is no label."""


def _is_audacity(data: bytes) -> bool:
    return _ROW.match(text_head(data, 4096)) is not None


def _audacity_motions(path: Path, data: bytes) -> tuple[LabelTrack, ...]:
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


AUDACITY: Final = Reader("audacity", _is_audacity, _audacity_motions)
"""Reads the rows as labels; a label may be an instant."""


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


def _is_rhubarb(data: bytes) -> bool:
    head = text_head(data, 4096)
    is_json = starts_json(data, b"{") and b'"mouthCues"' in data
    return is_json or b"<rhubarbResult" in head or _TSV_ROW.match(head) is not None


def _rhubarb_motions(path: Path, data: bytes) -> tuple[LabelTrack, ...]:
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


RHUBARB: Final = Reader("rhubarb", _is_rhubarb, _rhubarb_motions)
"""Reads `mouthCues`, `<rhubarbResult>`, and rows of a time and a shape."""


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


PROJECT: Final = "lipsync version 1"
SWITCH: Final = "MohoSwitch1"
FPS: Final = 24.0
"""Of a new project of Papagayo, and the default of Rhubarb."""
FRAME_MAX: Final = 10_000_000
COUNT_MAX: Final = 100_000
"""Phrases, words or phonemes. Chosen: more than a file of 64 MB holds of use."""


def _is_papagayo(data: bytes) -> bool:
    return text_head(data, 64).startswith((PROJECT.encode(), SWITCH.encode()))


def _papagayo_motions(path: Path, data: bytes) -> tuple[LabelTrack, ...]:
    lines = TextLines.of(path, data)
    if lines.text.startswith(SWITCH):
        return (_switch(lines),)
    return tuple(_Project(lines).voices())


PAPAGAYO: Final = Reader("papagayo", _is_papagayo, _papagayo_motions)
"""Reads projects, one track for each voice, and switch data."""


def _switch(lines: TextLines) -> LabelTrack:
    _, _, rows = lines.with_head()
    found = []
    for number, line in rows:
        frame, _, shape = line.partition(" ")
        found.append((lines.whole(frame, number, FRAME_MAX), shape.strip(), number))
    spans = [
        Span(_time_s(frame), _time_s(max(frame, after)), shape, number)
        for (frame, shape, number), (after, _, _) in zip(
            found, [*found[1:], *found[-1:]], strict=True
        )
    ]
    return label_track(
        lines,
        "",
        spans,
        comments=[f"The mouth shapes of {lines.path.name} (switch data)."],
        is_mouth=True,
        assumed_fps=FPS,
    )


def _time_s(frame: int) -> float:
    return max(frame - 1, 0) / FPS


class _Project:
    """The lines of a project, one after the other."""

    def __init__(self, lines: TextLines) -> None:
        self._lines = lines
        self._rows: Iterator[tuple[int, str]] = iter(
            [(number, line.strip()) for number, line in enumerate(lines.text.split("\n"), start=1)]
        )
        self._number = 1

    def voices(self) -> Iterator[LabelTrack]:
        """Yield a track for each voice that speaks."""
        self._text()
        sound = self._text()
        fps = float(self._whole(round(FPS_MAX)))
        if not fps:
            self._lines.refuse(self._number, "0 frames per second are too few")
        self._whole(FRAME_MAX)
        is_any = False
        for _ in range(self._whole(COUNT_MAX)):
            name = self._text()
            self._text()
            spans = [span for _ in range(self._whole(COUNT_MAX)) for span in self._phrase(fps)]
            if spans:
                is_any = True
                comment = f"The voice {name!r} of {self._lines.path.name} (Papagayo)."
                yield label_track(
                    self._lines, name, spans, comments=[comment], sound=sound, is_mouth=True
                )
        if not is_any:
            self._lines.refuse(None, "no voice of it has a phoneme")

    def _phrase(self, fps: float) -> Iterator[Span]:
        self._text()
        self._whole(FRAME_MAX)
        self._whole(FRAME_MAX)
        for _ in range(self._whole(COUNT_MAX)):
            yield from self._word(fps)

    def _word(self, fps: float) -> list[Span]:
        words = self._text().split()
        if len(words) < 4:
            self._lines.refuse(self._number, "a word has a text, two frames and a count")
        end, count = (
            self._lines.whole(word, self._number, FRAME_MAX) for word in (words[-2], words[-1])
        )
        found = []
        for _ in range(count):
            frame, _, shape = self._text().partition(" ")
            at = self._lines.whole(frame, self._number, FRAME_MAX)
            found.append((at, shape.strip(), self._number))
        # A word that the program did not know has no phoneme, and so one end more than spans.
        ends = [*(at for at, _, _ in found[1:]), end + 1]
        return [
            Span(at / fps, max(at, after) / fps, shape, number)
            for (at, shape, number), after in zip(found, ends, strict=False)
        ]

    def _text(self) -> str:
        try:
            self._number, line = next(self._rows)
        except StopIteration:
            self._lines.refuse(self._number, "ends here, but more must follow: it was cut off")
        return line

    def _whole(self, maximum: int) -> int:
        return self._lines.whole(self._text(), self._number, maximum)


HEAD: Final = b"ooTextFile"
PRAAT_COUNT_MAX: Final = 1_000_000
"""Tiers, or labels of a tier."""
_TOKEN: Final = re.compile(
    r'"(?P<text>[^"]*(?:""[^"]*)*)"|<(?P<flag>\w+)>|(?<!\S)(?P<number>[-+]?\d[\d.eE+-]*)%?(?!\S)|!.*'
)


def _is_praat(data: bytes) -> bool:
    head = data[:256]
    return HEAD in head and b"TextGrid" in head


def _praat_motions(path: Path, data: bytes) -> tuple[LabelTrack | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    return tuple(_Tokens(lines).tiers())


PRAAT: Final = Reader("praat", _is_praat, _praat_motions)
"""Reads each tier as a track. The empty texts of intervals are pauses."""


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
        return self._lines.whole(self._next("number"), self._line, PRAAT_COUNT_MAX)


LAYERS: Final = ("phrases", "words", "phonemes")
"""What the layers of a track hold, where it has three."""


@dataclass(slots=True)
class _TimingContent:
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


def _is_xlights(data: bytes) -> bool:
    head = text_head(data, 4096)
    return b"<timing" in head and b"<EffectLayer" in head


def _xlights_motions(path: Path, data: bytes) -> tuple[LabelTrack | RefusedMotion, ...]:
    lines = TextLines.of(path, data)
    content = _TimingContent(lines)
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


XLIGHTS: Final = Reader("xlights", _is_xlights, _xlights_motions)
"""Reads each layer of each track as one track of labels."""


def _track(lines: TextLines, title: str, spans: list[Span]) -> LabelTrack:
    comment = f"The timing track {title!r:.60} of {lines.path.name} (xLights)."
    return label_track(lines, title, spans, comments=[comment])
