"""Show time as a function of the run clock."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.system.clock_leg import ClockLeg
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterator


TRIM_MAX_RATIO: Final = 300e-6
"""No servo can notice a change of the rate by this much, and no crystal of a sound device is
further off. Limits are kept: plans may exceed them by 0.1 %."""
CLOSING_S: Final = 10.0
"""A follower makes up its error over this time. Chosen: the noise of a leader is smoothed, and
a drift of 200 ppm that begins is 2 ms off at most."""
KEPT_NS: Final = 20 * NS_PER_S
"""Legs that ended longer ago are forgotten. Chosen: longer than any answer, stall or wait that is
judged by a past show time."""

PAST_MAX: Final = 4000
"""Ends of forgotten legs that are kept for the report. Chosen: more than a picture has pixels."""

ASKED_MAX: Final = 16
"""Show times whose instants are kept: the same few are asked for several times in every turn."""


class Leg(NamedTuple):
    """Where a leader is: at `show_s` at the run instant `instant_ns`, with this rate."""

    instant_ns: int
    show_s: float
    rate: float

    def at_s(self, now_ns: int) -> float:
        return self.show_s + self.rate * (now_ns - self.instant_ns) / NS_PER_S


class ShowClock:
    """Show time in seconds since the start. Rate 1 is as planned, 0 a pause.

    A leader (`follow`) trims it; rates are without the trim.
    """

    def __init__(self, start_ns: int, start_s: float, rate: float) -> None:
        self.trim_ratio = 0.0
        """By how much the clock is faster than its rate, to follow a leader."""
        self._past: list[tuple[int, float]] = []
        """Ends of forgotten legs, for reports."""
        self._legs: list[ClockLeg] = []
        self._reached_ns: dict[float, int] = {}
        """By show times that `instant_ns` was asked for in this leg: those of moves and marks."""
        self._begin(start_ns, start_s, rate, rate)

    def show_s(self, now_ns: int) -> float:
        """Return the show time at `now_ns`, also for a past instant, up to `KEPT_NS` ago."""
        leg = self.leg
        if now_ns >= self.ramp_end_ns:  # Nearly always: as `ClockLeg.show_s`, without a call.
            steady_s = (now_ns - leg.start_ns) / NS_PER_S - self._ramp_s
            return leg.start_s + (1.0 + leg.trim_ratio) * (self._ramped_s + leg.to_rate * steady_s)
        for leg in reversed(self._legs):
            if leg.start_ns <= now_ns:
                return leg.show_s(now_ns)
        return self._legs[0].show_s(now_ns)

    def rate(self, now_ns: int) -> float:
        return self._legs[-1].rate(now_ns)

    def is_ramping(self, now_ns: int) -> bool:
        return now_ns < self.ramp_end_ns

    def follow(
        self,
        leader: Leg,
        now_ns: int,
        trim_max_ratio: float = TRIM_MAX_RATIO,
        closing_s: float = CLOSING_S,
    ) -> float | None:
        """Trim the clock so that it meets `leader` in `closing_s`; return how far off it is, in s.

        Its rate differs from the target rate by at most `trim_max_ratio`. A clock that stands or
        ramps is not trimmed: None. What is further off than a trim makes up in time is for the
        caller to decide about.
        """
        if self.target_rate <= 0.0 or now_ns < self.ramp_end_ns:
            return None
        off_s = leader.at_s(now_ns) - self.show_s(now_ns)
        wanted = leader.rate / self.target_rate - 1.0 + off_s / (closing_s * self.target_rate)
        trim_ratio = max(-trim_max_ratio, min(wanted, trim_max_ratio))
        if trim_ratio != self.trim_ratio and now_ns >= self.leg.start_ns:
            show_s = self.show_s(now_ns)
            self.trim_ratio = trim_ratio
            self._begin(now_ns, show_s, self.target_rate, self.target_rate)
        return off_s

    def ramp_to(self, rate: float, now_ns: int, over_s: float) -> None:
        """Change the rate evenly from its present value to `rate`, over `over_s`."""
        self._begin(now_ns, self.show_s(now_ns), self.rate(now_ns), rate, ns_from_s(over_s))

    def stand_at(self, show_s: float, now_ns: int) -> None:
        """Stop at `show_s` from the instant on at which the show reached it, by `now_ns`."""
        reached_ns = self.instant_ns(show_s)
        start_ns = now_ns if reached_ns is None else min(max(reached_ns, self.ramp_end_ns), now_ns)
        self._begin(start_ns, show_s, 0.0, 0.0)

    def jump_to(self, show_s: float, now_ns: int) -> None:
        """Stand at `show_s` from now on, wherever the show was; for a show that stands."""
        self._begin(now_ns, show_s, 0.0, 0.0)

    def run_from(self, show_s: float, now_ns: int) -> None:
        """Be at `show_s` now and run at rate 1; for a show of which every joint rests meanwhile."""
        self.trim_ratio = 0.0
        self._begin(now_ns, show_s, 1.0, 1.0)

    def go_back(self, by_s: float, now_ns: int) -> None:
        """Go on from an earlier show time, at which every joint rests as it does now."""
        left_ns = max(0, self.ramp_end_ns - now_ns)
        show_s = self.show_s(now_ns) - by_s
        self._begin(now_ns, show_s, self.rate(now_ns), self.target_rate, left_ns)

    def halt(self, since_ns: int) -> None:
        """Stand since `since_ns`, a past instant, where the show was then."""
        start_ns = max(since_ns, self._legs[-1].start_ns)
        self._begin(start_ns, self.show_s(start_ns), 0.0, 0.0)

    def instant_ns(self, show_s: float) -> int | None:
        """Return when the show reaches `show_s` at the present target rate; None: never."""
        if self.target_rate <= 0.0:
            return None
        reached_ns = self._reached_ns.get(show_s)
        if reached_ns is None:
            rate = self.target_rate * (1.0 + self.trim_ratio)
            reached_ns = self.ramp_end_ns + ns_from_s((show_s - self._ramp_end_s) / rate)
            if len(self._reached_ns) >= ASKED_MAX:
                self._reached_ns.clear()
            self._reached_ns[show_s] = reached_ns
        return reached_ns

    def knots(self, since_ns: int, until_ns: int, step_ns: int) -> Iterator[tuple[int, float]]:
        """Yield `(instant, show time)` between which show time may be interpolated.

        These are every change of the rate, and steps of `step_ns` within its ramps, from `since_ns`
        on, which is at most `KEPT_NS` before the start of the present leg.
        """
        for index, leg in enumerate(self._legs):
            is_last = index + 1 == len(self._legs)
            end_ns = until_ns if is_last else min(self._legs[index + 1].start_ns, until_ns)
            start_ns = max(leg.start_ns, since_ns)
            if end_ns < start_ns:
                continue
            ramp_end_ns = max(min(leg.ramp_end_ns, end_ns), start_ns)
            for instant_ns in range(start_ns, ramp_end_ns, step_ns):
                yield instant_ns, leg.show_s(instant_ns)
            yield ramp_end_ns, leg.show_s(ramp_end_ns)
            if end_ns > ramp_end_ns:
                yield end_ns, leg.show_s(end_ns)

    def course(self, until_ns: int, step_ns: int) -> Iterator[tuple[int, float]]:
        """Yield `(instant, show time)` as `knots`, from the start of the show on.

        What is longer ago than legs are kept is coarser: its ramps are straight, and after
        thousands of changes every other one is left out.
        """
        yield from self._past
        yield from self.knots(self._legs[0].start_ns, until_ns, step_ns)

    def _begin(
        self, start_ns: int, start_s: float, from_rate: float, to_rate: float, ramp_ns: int = 0
    ) -> None:
        leg = ClockLeg(start_ns, start_s, from_rate, to_rate, ramp_ns, self.trim_ratio)
        self._legs.append(leg)
        self.leg = leg
        """The present leg: another one after every change of the clock."""
        while len(self._legs) > 1 and self._legs[1].start_ns < start_ns - KEPT_NS:
            past = self._legs.pop(0)
            self._past.append((past.start_ns, past.start_s))
            if past.ramp_ns:
                self._past.append((past.ramp_end_ns, past.show_s(past.ramp_end_ns)))
            if len(self._past) > PAST_MAX:
                del self._past[1::2]
        self.target_rate = to_rate
        self.ramp_end_ns = leg.ramp_end_ns
        """When the rate is, or was, steady again."""
        self._ramp_s = ramp_ns / NS_PER_S
        self._ramped_s = 0.5 * (from_rate + to_rate) * self._ramp_s
        """How far the show goes in the ramp of this leg, without the trim."""
        self._ramp_end_s = leg.show_s(leg.ramp_end_ns)
        self._reached_ns.clear()
