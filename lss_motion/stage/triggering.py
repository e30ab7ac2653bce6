"""From signals to the cues that they trigger: addresses, values, edges, times of day, timecode.

`Bags` chooses which of its shows such a cue plays. `CronClock` finds which times of day are due, on
a wall clock that jumps: NTP sets it after the start of a computer without a battery, and summer
time begins and ends. Each expression fires once:

- It goes through the minutes of UTC, which summer time does not change, and never through one
  again. A clock that is set back fires nothing before it is where it was; set back by more than
  `CORRECTED`, it counts as a corrected clock, and the new time holds (as cron of Debian does).
- A clock that is set forward fires what was skipped within `LATE`, not the cues of hours.
- An expression with a fixed hour and minute in the hour that summer time skips fires at its end,
  and in the hour that winter time repeats fires once. Others (`*/10 * * * *`) go by the minutes.

A signal with a value that lasts (a sensor, a fader) triggers when the value passes its threshold,
not for as long as it is beyond it. All that may refuse a cue that was triggered is in `director`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime, time, timedelta, tzinfo
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError, install_command
from lss_motion.stage.model import TriggerKind
from lss_motion.stage.timecode.timecode import is_song
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from random import Random

    from lss_motion.stage.model import CueTrigger, Signal, StageCue

SENSOR_TIMES: Final = 2
"""So many readings in a row: a reply has no checksum, and one flipped bit must not start a show
(as `playing.player.cues.TIMES_MET`)."""

PRESSED: Final = frozenset(
    {TriggerKind.OSC, TriggerKind.NOTE, TriggerKind.MQTT, TriggerKind.GPIO, TriggerKind.SACN}
)
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

    cues: tuple[StageCue, ...]
    _edges: dict[str, _Edge] = field(default_factory=dict)

    def triggered(self, signal: Signal) -> list[StageCue]:
        """Return the cues that a signal triggers, in the order of the file."""
        if signal.kind is TriggerKind.CUE:
            return [cue for cue in self.cues if cue.name == signal.address]
        return [cue for cue in self.cues if _matches(cue, signal) and self._passes(cue, signal)]

    def _passes(self, cue: StageCue, signal: Signal) -> bool:
        if cue.on.side is None:
            return not (signal.kind in PRESSED and signal.value == 0)
        if signal.value is None:
            return False
        times = SENSOR_TIMES if signal.kind is TriggerKind.SENSOR else 1
        edge = self._edges.setdefault(cue.name, _Edge(times))
        return edge.passes(is_met=cue.on.is_met(signal.value))


def _matches(cue: StageCue, signal: Signal) -> bool:
    on = cue.on
    is_same = on.kind is signal.kind and on.address == signal.address
    return is_same and on.channel in (None, signal.channel)


class TimecodeCues:
    """Which cues the timecode passes, and which show it is in after a jump."""

    def __init__(
        self,
        cues: Iterable[StageCue],
        duration_s: dict[str, float],
        freewheel_s: float = FREEWHEEL_S,
    ) -> None:
        """Take the cues of a stage, and the durations of its shows."""
        self._freewheel_ns = ns_from_s(freewheel_s)
        self.renew(cues, duration_s)
        self._song = ""
        self._at_s: float | None = None
        """The position up to which cues were passed; None: the source is lost."""
        self._rate = 0.0
        self._now_ns = self._received_ns = 0

    def renew(self, cues: Iterable[StageCue], duration_s: dict[str, float]) -> None:
        """Go on with other cues and shows."""
        timed = (cue for cue in cues if cue.on.kind is TriggerKind.TIMECODE)
        self._cues = sorted(timed, key=lambda cue: cue.on.at_s)
        self._duration_s = duration_s

    def take(
        self, at_s: float | None, rate: float, now_ns: int, song: str = ""
    ) -> Iterator[tuple[StageCue, float | None]]:
        """Take a position; yield the cues that were passed, each with where its show begins.

        None: at its beginning. After a jump forward or back, or in another song, it is the show in
        which the timecode is. While it stands or runs backwards nothing is passed.
        """
        is_other, self._song = song != self._song, song
        expected_s = self._expected_s(now_ns)
        self._received_ns = now_ns
        if at_s is None:
            self._at_s = None
            return
        if self._at_s is None or expected_s is None or is_other or abs(at_s - expected_s) > JUMP_S:
            self._at_s, self._rate, self._now_ns = at_s, rate, now_ns
            if rate > 0.0 and (found := self._within(at_s)) is not None:
                yield found, at_s - found.on.at_s
            return
        yield from self._pass_to(at_s, now_ns)
        # It does not go back for a source whose positions scatter: nothing is passed twice.
        self._at_s, self._rate, self._now_ns = max(at_s, self._at_s), rate, now_ns

    def tick(self, now_ns: int) -> Iterator[tuple[StageCue, float | None]]:
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
        coming = (cue.on.at_s for cue in self._playing() if cue.on.at_s > self._at_s)
        at_s = next(coming, None)
        if at_s is None:
            return None
        return self._now_ns + ns_from_s((at_s - self._at_s) / self._rate) + 1

    def _expected_s(self, now_ns: int) -> float | None:
        if self._at_s is None:
            return None
        return self._at_s + s_from_ns(now_ns - self._now_ns) * self._rate

    def _pass_to(self, at_s: float, now_ns: int) -> Iterator[tuple[StageCue, None]]:
        assert self._at_s is not None
        from_s = self._at_s
        if at_s > from_s:
            self._at_s, self._now_ns = at_s, now_ns
        for cue in self._playing():
            if from_s < cue.on.at_s <= at_s:
                yield cue, None

    def _within(self, at_s: float) -> StageCue | None:
        """Return the last cue whose first show is under way at this position."""
        found = None
        for cue in self._playing():
            if self._lasts(cue, at_s):
                found = cue
        return found

    def under_way(self, now_ns: int) -> Iterator[tuple[StageCue, float]]:
        """Yield the cue in whose show the timecode runs now, and its show time."""
        at_s = self._expected_s(now_ns)
        if at_s is not None and self._rate > 0.0 and (found := self._within(at_s)) is not None:
            yield found, at_s - found.on.at_s

    def coming(self, now_ns: int) -> tuple[StageCue, float] | None:
        """Return the next cue whose show follows, and the seconds up to it, also of a stand."""
        at_s = self._expected_s(now_ns)
        if at_s is None:
            return None
        ahead = (cue for cue in self._playing() if cue.can_wait and cue.on.at_s >= at_s)
        cue = next(ahead, None)
        return None if cue is None else (cue, cue.on.at_s - at_s)

    @property
    def has_position(self) -> bool:
        """Whether there is timecode, running or standing."""
        return self._at_s is not None

    def is_running(self, now_ns: int) -> bool:
        """Return whether there is timecode, and it does not stand."""
        return self._expected_s(now_ns) is not None and self._rate > 0.0

    def is_within(self, cue: StageCue, now_ns: int) -> bool:
        """Return whether the timecode runs, and is in the first show of this cue."""
        at_s = self._expected_s(now_ns)
        is_playing = at_s is not None and self._rate > 0.0 and cue in self._playing()
        return is_playing and at_s is not None and self._lasts(cue, at_s)

    def _playing(self) -> Iterator[StageCue]:
        """Yield the cues of the song that is played, and those of any."""
        return (cue for cue in self._cues if not cue.on.song or is_song(cue.on.song, self._song))

    def _lasts(self, cue: StageCue, at_s: float) -> bool:
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

    def next(self, cue: StageCue) -> str:
        """Return the show that the cue plays next; it stays the next one until it is taken."""
        if len(cue.shows) == 1:
            return cue.shows[0]
        if not self._coming.get(cue.name):
            self._coming[cue.name] = self._filled(cue, None)
        return self._coming[cue.name][0]

    def forget(self) -> None:
        """Begin anew: cues may have other shows."""
        self._coming.clear()

    def take(self, cue: StageCue) -> None:
        """Note that the next show is played."""
        if len(cue.shows) == 1:
            return
        last = self._coming[cue.name].pop(0)
        if not self._coming[cue.name]:
            self._coming[cue.name] = self._filled(cue, last)

    def _filled(self, cue: StageCue, last: str | None) -> list[str]:
        """Return all shows of a cue; a random order does not begin with `last`."""
        shows = list(cue.shows)
        if cue.choice == "random":
            self._random.shuffle(shows)
            if shows[0] == last:
                other = self._random.randrange(1, len(shows))
                shows[0], shows[other] = shows[other], shows[0]
        return shows


MINUTE: Final = timedelta(minutes=1)

CORRECTED: Final = timedelta(hours=3)
"""cron(8) of Debian: a change of more than three hours is a correction of the clock."""

LATE: Final = timedelta(minutes=5)
"""Chosen: a cue this late still belongs to its evening; an hour of cues at once does not."""

FIELDS: Final = 5

AHEAD: Final = 1500
"""A day of an expression that is due every minute, and an hour."""


def cron_problem(text: str) -> str:
    """Return why a cron expression cannot be used; empty if it can.

    Raises `InputError` if the library for it is not installed.
    """
    try:
        from cronsim import CronSim, CronSimError
    except ImportError as error:
        raise InputError(f"times of day need a library: {install_command('stage')}") from error
    if len(text.split()) != FIELDS:
        return (
            f"has {len(text.split())} fields, not {FIELDS}: minute, hour, day, month, weekday, "
            f"such as `*/10 18-23 * * fri,sat`"
        )
    try:
        next(CronSim(text, datetime(2024, 1, 1)))  # noqa: DTZ001  any local time
    except CronSimError as error:
        return f"is no time of day: {error}; such as `*/10 18-23 * * fri,sat`"
    except StopIteration:
        return "never comes"
    return ""


def clock_time(text: str) -> time | None:
    """Return the time of day of a text such as `23:00`; None: there is none such."""
    try:
        return time.fromisoformat(text)
    except ValueError:
        return None


def end_of_span(now: time, spans: Iterable[tuple[time, time]]) -> time | None:
    """Return the end of the span in which a time of day is; None: it is in none.

    Spans may go through midnight. Of several the one that is named first counts.
    """
    for begin, end in spans:
        if begin <= now < end if begin <= end else now >= begin or now < end:
            return end
    return None


class CronClock:
    """Finds the cron expressions that are due, minute by minute."""

    def __init__(
        self,
        expressions: Iterable[str],
        zone: tzinfo | None = None,
        seen: datetime | None = None,
    ) -> None:
        """Watch `expressions`; `zone` is that of the times, None: that of the computer.

        `seen`: when the process before this one was seen last. What has come since then, or until
        the first call of `due`, fires late, as with a clock that is set forward.
        """
        self._seen = seen
        self.watch(expressions, zone)
        self._until: datetime | None = None
        """The last minute, in UTC, that was gone through."""
        self._until_local: datetime | None = None
        """The latest local time that was gone through."""

    def watch(self, expressions: Iterable[str], zone: tzinfo | None) -> None:
        """Go on with other expressions."""
        self._expressions = tuple(dict.fromkeys(expressions))
        self._coming: dict[str, tuple[datetime | None, str]] = {}
        """By expression: what was said of its next time, and in which minute."""
        self._zone = zone

    def begin(self, wall: datetime) -> None:
        """Note from when on minutes are gone through: `seen`, or now if that is long ago."""
        if self._until is None:
            is_near = self._seen is not None and timedelta() <= wall - self._seen <= LATE
            since = self._seen if is_near and self._seen is not None else wall
            self._until = since.astimezone(UTC).replace(second=0, microsecond=0)
            self._until_local = self._local(self._until)

    def due(self, wall: datetime) -> tuple[list[str], str]:
        """Return the expressions that are due by `wall`, an aware time, and what was noticed.

        Each is returned once, also if several of its minutes have passed. The first call only
        notes the time.
        """
        minute = wall.astimezone(UTC).replace(second=0, microsecond=0)
        until, text = self._until, ""
        if until is None or until - minute > CORRECTED:
            if until is not None:
                text = f"the clock was set back by {until - minute}: times of day begin anew"
            self._until, self._until_local = minute, self._local(minute)
            return [], text
        if minute - until > LATE:
            text = f"the clock was set forward by {minute - until}: what was due before is left out"
            self._until = minute - LATE
            self._until_local = self._local(self._until)
        found: dict[str, None] = {}
        for passed in self._minutes(minute):
            found |= dict.fromkeys(self._due_at(passed))
        return list(found), text

    def coming(self, expression: str, spans: Sequence[tuple[time, time]]) -> datetime | None:
        """Return the next local time of an expression that is in none of the spans.

        None: within `AHEAD` times there is none, or the time of day is not known yet.
        """
        if self._until is None:
            return None
        after = self._local(self._until)
        for _ in range(AHEAD):
            after = _next(expression, after)
            if after == datetime.max:  # noqa: DTZ901  local times
                return None
            if end_of_span(after.time(), spans) is None:
                return after
        return None

    def when(self, on: CueTrigger, spans: Sequence[tuple[time, time]]) -> str:
        """Return when a trigger fires next, as an operator says it; at no time in the spans."""
        if on.kind is not TriggerKind.TIME:
            return on.words
        expression = on.address
        known, text = self._coming.get(expression, (None, ""))
        if known is None or known != self._until:
            found = self.coming(expression, spans)
            text = on.words if self._until is None else f"{on.words}, in quiet hours only"
            if found is not None and self._until is not None:
                is_near = found - self._local(self._until) < timedelta(days=1)
                text = f"next {found:%H:%M}" if is_near else f"next {found:%Y-%m-%d %H:%M}"
            self._coming[expression] = (self._until, text)
        return text

    def local(self, wall: datetime) -> datetime:
        """Return the time of day of `wall`, without a zone."""
        return self._local(wall)

    def _minutes(self, minute: datetime) -> Iterator[datetime]:
        assert self._until is not None
        while self._until < minute:
            self._until += MINUTE
            yield self._until

    def _due_at(self, minute: datetime) -> Iterator[str]:
        """Yield the expressions that are due in this minute of UTC."""
        local, before = self._local(minute), self._until_local
        assert before is not None
        for expression in self._expressions:
            begin = local - MINUTE if _is_wild(expression) else before
            if begin < local and _next(expression, begin) <= local:
                yield expression
        self._until_local = max(local, before)

    def _local(self, instant: datetime) -> datetime:
        return instant.astimezone(self._zone).replace(tzinfo=None)


def _is_wild(expression: str) -> bool:
    """Return whether it has no fixed minute or hour, as cron of Debian divides them."""
    return any(field.startswith("*") for field in expression.split()[:2])


def _next(expression: str, after: datetime) -> datetime:
    from cronsim import CronSim

    return next(CronSim(expression, after), datetime.max)  # noqa: DTZ901  local times
