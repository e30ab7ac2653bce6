"""Lip-sync projects of Papagayo (`.pgo`) and switch data of Moho (`.dat`), which others write, too.

A project has voices of phrases of words of phonemes, in frames from 0. Switch data has a frame,
from 1, and a shape in each row, and does not give its frame rate.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.interchange.audacity import label_track
from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import FPS_MAX, Span

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.interchange.reader import LabelTrack

PROJECT: Final = "lipsync version 1"
SWITCH: Final = "MohoSwitch1"
FPS: Final = 24.0
"""Of a new project of Papagayo, and the default of Rhubarb."""
FRAME_MAX: Final = 10_000_000
COUNT_MAX: Final = 100_000
"""Phrases, words or phonemes. Chosen: more than a file of 64 MB holds of use."""


class PapagayoReader(Struct, frozen=True):
    """Reads projects, one track for each voice, and switch data."""

    name: str = "papagayo"

    def recognises(self, data: bytes) -> bool:
        return text_head(data, 64).startswith((PROJECT.encode(), SWITCH.encode()))

    def motions(self, path: Path, data: bytes) -> tuple[LabelTrack, ...]:
        lines = TextLines.of(path, data)
        if lines.text.startswith(SWITCH):
            return (_switch(lines),)
        return tuple(_Project(lines).voices())


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
