"""From signals to the cues that they trigger: addresses, values, edges, and the timecode.

`Bags` chooses which of its shows such a cue plays.

A signal with a value that lasts (a sensor, a fader) triggers when the value passes its threshold,
not for as long as it is beyond it. All that may refuse a cue that was triggered is in `director`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.stage.model import Kind
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from random import Random

    from lss_motion.stage.model import Cue, Signal

SENSOR_TIMES: Final = 2
"""So many readings in a row: a reply has no checksum, and one flipped bit must not start a show
(as `playing.player.cues.TIMES_MET`)."""

PRESSED: Final = frozenset({Kind.OSC, Kind.NOTE, Kind.MQTT, Kind.GPIO, Kind.SACN})
"""Signals of these kinds with the value 0 are a button that is released, or a note that ends."""

JUMP_S: Final = 0.5
"""A larger difference from the expected position is a jump of the timecode. Chosen: longer than any
delay of a source, shorter than a jump that a person would make."""

FREEWHEEL_S: Final = 2.0
"""Without a new position for so long nothing more is triggered, if the stage says nothing else."""


@dataclass(slots=True)
class _Edge:
    """Whether a value is beyond the threshold of a cue; it takes `times` in a row to change."""

    times: int
    is_met: bool = False
    count: int = 0

    def passes(self, *, is_met: bool) -> bool:
        """Take a value; return whether the threshold has just been passed."""
        self.count = 0 if is_met == self.is_met else self.count + 1
        if self.count < self.times:
            return False
        self.is_met, self.count = is_met, 0
        return is_met


@dataclass(slots=True)
class Triggers:
    """The cues of a stage, by what triggers them."""

    cues: tuple[Cue, ...]
    _edges: dict[str, _Edge] = field(default_factory=dict)

    def triggered(self, signal: Signal) -> list[Cue]:
        """Return the cues that a signal triggers, in the order of the file."""
        if signal.kind is Kind.CUE:
            return [cue for cue in self.cues if cue.name == signal.address]
        return [cue for cue in self.cues if _matches(cue, signal) and self._passes(cue, signal)]

    def _passes(self, cue: Cue, signal: Signal) -> bool:
        if cue.on.side is None:
            return not (signal.kind in PRESSED and signal.value == 0)
        if signal.value is None:
            return False
        times = SENSOR_TIMES if signal.kind is Kind.SENSOR else 1
        edge = self._edges.setdefault(cue.name, _Edge(times))
        return edge.passes(is_met=cue.on.is_met(signal.value))


def _matches(cue: Cue, signal: Signal) -> bool:
    on = cue.on
    is_same = on.kind is signal.kind and on.address == signal.address
    return is_same and on.channel in (None, signal.channel)


class TimecodeCues:
    """Which cues the timecode passes, and which show it is in after a jump."""

    def __init__(
        self, cues: Iterable[Cue], duration_s: dict[str, float], freewheel_s: float = FREEWHEEL_S
    ) -> None:
        """Take the cues of a stage, and the durations of its shows."""
        self._freewheel_ns = ns_from_s(freewheel_s)
        self.renew(cues, duration_s)
        self._at_s: float | None = None
        """The position up to which cues were passed; None: the source is lost."""
        self._rate = 0.0
        self._now_ns = self._received_ns = 0

    def renew(self, cues: Iterable[Cue], duration_s: dict[str, float]) -> None:
        """Go on with other cues and shows."""
        timed = (cue for cue in cues if cue.on.kind is Kind.TIMECODE)
        self._cues = sorted(timed, key=lambda cue: cue.on.at_s)
        self._duration_s = duration_s

    def take(
        self, at_s: float | None, rate: float, now_ns: int
    ) -> Iterator[tuple[Cue, float | None]]:
        """Take a position; yield the cues that were passed, each with where its show begins.

        None: at its beginning. After a jump forward or back it is the show in which the timecode
        is. While it stands or runs backwards nothing is passed.
        """
        expected_s = self._expected_s(now_ns)
        self._received_ns = now_ns
        if at_s is None:
            self._at_s = None
            return
        if self._at_s is None or expected_s is None or abs(at_s - expected_s) > JUMP_S:
            self._at_s, self._rate, self._now_ns = at_s, rate, now_ns
            if rate > 0.0 and (found := self._within(at_s)) is not None:
                yield found, at_s - found.on.at_s
            return
        yield from self._pass_to(at_s, now_ns)
        # It does not go back for a source whose positions scatter: nothing is passed twice.
        self._at_s, self._rate, self._now_ns = max(at_s, self._at_s), rate, now_ns

    def tick(self, now_ns: int) -> Iterator[tuple[Cue, float | None]]:
        """Yield the cues that were passed since the last position."""
        at_s = self._expected_s(now_ns)
        if (
            at_s is not None
            and self._rate > 0.0
            and now_ns - self._received_ns < self._freewheel_ns
        ):
            yield from self._pass_to(at_s, now_ns)

    def next_ns(self) -> int | None:
        """Return when the next cue is passed; None: not as it is now."""
        if self._at_s is None or self._rate <= 0.0:
            return None
        coming = (cue.on.at_s for cue in self._cues if cue.on.at_s > self._at_s)
        at_s = next(coming, None)
        if at_s is None:
            return None
        return self._now_ns + ns_from_s((at_s - self._at_s) / self._rate) + 1

    def _expected_s(self, now_ns: int) -> float | None:
        if self._at_s is None:
            return None
        return self._at_s + s_from_ns(now_ns - self._now_ns) * self._rate

    def _pass_to(self, at_s: float, now_ns: int) -> Iterator[tuple[Cue, None]]:
        assert self._at_s is not None
        from_s = self._at_s
        if at_s > from_s:
            self._at_s, self._now_ns = at_s, now_ns
        for cue in self._cues:
            if from_s < cue.on.at_s <= at_s:
                yield cue, None

    def _within(self, at_s: float) -> Cue | None:
        """Return the last cue whose first show is under way at this position."""
        found = None
        for cue in self._cues:
            if self._lasts(cue, at_s):
                found = cue
        return found

    def under_way(self, now_ns: int) -> Iterator[tuple[Cue, float]]:
        """Yield the cue in whose show the timecode runs now, and its show time."""
        at_s = self._expected_s(now_ns)
        if at_s is not None and self._rate > 0.0 and (found := self._within(at_s)) is not None:
            yield found, at_s - found.on.at_s

    def coming(self, now_ns: int) -> tuple[Cue, float] | None:
        """Return the next cue whose show follows, and the seconds up to it, also of a stand."""
        at_s = self._expected_s(now_ns)
        if at_s is None:
            return None
        ahead = (cue for cue in self._cues if cue.can_wait and cue.on.at_s >= at_s)
        cue = next(ahead, None)
        return None if cue is None else (cue, cue.on.at_s - at_s)

    @property
    def has_position(self) -> bool:
        """Whether there is timecode, running or standing."""
        return self._at_s is not None

    def is_running(self, now_ns: int) -> bool:
        """Return whether there is timecode, and it does not stand."""
        return self._expected_s(now_ns) is not None and self._rate > 0.0

    def is_within(self, cue: Cue, now_ns: int) -> bool:
        """Return whether the timecode runs, and is in the first show of this cue."""
        at_s = self._expected_s(now_ns)
        return at_s is not None and self._rate > 0.0 and self._lasts(cue, at_s)

    def _lasts(self, cue: Cue, at_s: float) -> bool:
        """Return whether the first show of a cue that follows is under way at this position."""
        if not cue.shows or not cue.follows:
            return False
        return cue.on.at_s <= at_s < cue.on.at_s + self._duration_s.get(cue.shows[0], 0.0)


class Bags:
    """Which of several shows a cue plays: in turn, or at random without repeats.

    For each cue the shows that are still to come before all have been played.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._coming: dict[str, list[str]] = {}

    def next(self, cue: Cue) -> str:
        """Return the show that the cue plays next; it stays the next one until it is taken."""
        if len(cue.shows) == 1:
            return cue.shows[0]
        if not self._coming.get(cue.name):
            self._coming[cue.name] = self._filled(cue, None)
        return self._coming[cue.name][0]

    def forget(self) -> None:
        """Begin anew: cues may have other shows."""
        self._coming.clear()

    def take(self, cue: Cue) -> None:
        """Note that the next show is played."""
        if len(cue.shows) == 1:
            return
        last = self._coming[cue.name].pop(0)
        if not self._coming[cue.name]:
            self._coming[cue.name] = self._filled(cue, last)

    def _filled(self, cue: Cue, last: str | None) -> list[str]:
        """Return all shows of a cue; a random order does not begin with `last`."""
        shows = list(cue.shows)
        if cue.choice == "random":
            self._random.shuffle(shows)
            if shows[0] == last:
                other = self._random.randrange(1, len(shows))
                shows[0], shows[other] = shows[other], shows[0]
        return shows
