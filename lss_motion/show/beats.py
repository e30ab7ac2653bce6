"""The beats of a file: `at_beat` of a keyframe becomes the time of that beat."""

from __future__ import annotations

from bisect import bisect_right
from itertools import pairwise
from typing import TYPE_CHECKING, Final, TypeVar

from lss_motion.files.yaml_source import Mistake

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.files.source import Location
    from lss_motion.show.file import KeyframeEntry, SequenceFile, TrackEntry

DIGITS: Final = 6
"""Decimals of a time between two beats: 1 us."""


def beats_of(content: SequenceFile) -> tuple[float, ...]:
    """Return the beats that a file gives, in seconds; none if it has no key `beats`."""
    given = content.beats
    if given is None:
        return ()
    return tuple(given if isinstance(given, list) else given.at_s)


def beat_time(beats_s: Sequence[float], beat: float) -> float | None:
    """Return when beat number `beat` is, counted from 1; None if there is no such beat.

    A part of a beat is that part of the time to the next one.
    """
    whole, part = int(beat), beat - int(beat)
    if not 1 <= whole <= len(beats_s) or (part and whole == len(beats_s)):
        return None
    before_s = beats_s[whole - 1]
    return round(before_s + part * (beats_s[whole] - before_s), DIGITS) if part else before_s


def beat_number(beats_s: Sequence[float], at_s: float) -> float | None:
    """Return the number of the beat at an instant, with its part; None outside of the beats."""
    if len(beats_s) < 2 or not beats_s[0] <= at_s <= beats_s[-1]:
        return None
    whole = bisect_right(beats_s, at_s)
    if whole == len(beats_s):
        return float(whole)
    before_s = beats_s[whole - 1]
    return whole + (at_s - before_s) / (beats_s[whole] - before_s)


def on_beats(content: SequenceFile) -> tuple[SequenceFile, list[Mistake]]:
    """Return the file with a time in place of every `at_beat`, and what is wrong with them."""
    beats_s, problems = beats_of(content), list[Mistake]()
    place: Location = ("beats",) if isinstance(content.beats, list) else ("beats", "at_s")
    for index, (before_s, beat_s) in enumerate(pairwise(beats_s), start=1):
        if beat_s <= before_s:
            reason = f"beats must be in order, but {beat_s:g} s comes after {before_s:g} s"
            problems.append(Mistake((*place, index), reason))
            break
    is_anchored = not isinstance(content.beats, list | None) and content.beats.anchor
    resolver = _Resolver(beats_s, is_anchored=is_anchored)
    tracks = {
        name: resolver.resolved(track, ("tracks", name)) for name, track in content.tracks.items()
    }
    own = resolver.resolved(content, ())
    return own.changed(tracks=tracks), [*problems, *resolver.problems]


Track = TypeVar("Track", bound="TrackEntry")


class _Resolver:
    def __init__(self, beats_s: tuple[float, ...], *, is_anchored: bool) -> None:
        self._beats_s, self._is_anchored = beats_s, is_anchored
        self.problems: list[Mistake] = []

    def resolved(self, track: Track, place: Location) -> Track:
        """Return a track with a time in place of every beat."""
        if all(entry.at_beat is None for entry in track.keyframes):
            return track
        frames = []
        for index, entry in enumerate(track.keyframes):
            found = entry
            if entry.at_beat is not None:
                reason = self._problem(track, entry)
                if reason:
                    at = (*place, "keyframes", index, "at_beat")
                    self.problems.append(Mistake(at, reason))
                found = self._timed(entry)
            frames.append(found)
        return track.changed(keyframes=frames)

    def _problem(self, track: TrackEntry, entry: KeyframeEntry) -> str:
        beat = entry.at_beat or 0.0
        if not self._beats_s:
            return (
                "at_beat needs the beats of the music, `beats: [...]`; `lss-motion beats SONG "
                "--into FILE` writes them"
            )
        if entry.at_s is not None or entry.after_s is not None:
            key = "after_s" if entry.at_s is None else "at_s"
            return f"at_beat is a time, and so is {key}; give one of them"
        if track.timing in ("fit", "fastest"):
            return f"at_beat keeps the time of a beat, but timing is {track.timing}; use authored"
        if beat_time(self._beats_s, beat) is None:
            return f"there is no beat {beat:g}; beats has those from 1 to {len(self._beats_s)}"
        return ""

    def _timed(self, entry: KeyframeEntry) -> KeyframeEntry:
        update: dict[str, object] = {"at_beat": None}
        if entry.at_s is None and entry.after_s is None:
            update["at_s"] = beat_time(self._beats_s, entry.at_beat or 0.0)
        if self._is_anchored and "anchor" not in entry.given:
            update["anchor"] = True
        return entry.changed(**update)
