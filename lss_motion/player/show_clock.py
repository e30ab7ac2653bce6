"""Show time as a function of the run clock."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True, slots=True)
class _Leg:
    """From `start_ns` the rate changes evenly from `from_rate` to `to_rate` over `ramp_ns`."""

    start_ns: int
    start_s: float
    from_rate: float
    to_rate: float
    ramp_ns: int

    def show_s(self, now_ns: int) -> float:
        elapsed_s = (now_ns - self.start_ns) / NS_PER_S
        ramp_s = self.ramp_ns / NS_PER_S
        if self.ramp_ns == 0 or elapsed_s >= ramp_s:
            ramped_s = 0.5 * (self.from_rate + self.to_rate) * ramp_s
            return self.start_s + ramped_s + self.to_rate * (elapsed_s - ramp_s)
        change = 0.5 * (self.to_rate - self.from_rate) * elapsed_s * elapsed_s / ramp_s
        return self.start_s + self.from_rate * elapsed_s + change


class ShowClock:
    """Show time in seconds since the start. Rate 1 is as planned, 0 a pause."""

    def __init__(self, start_ns: int, start_s: float, rate: float) -> None:
        self._legs: list[_Leg] = []
        self._begin(_Leg(start_ns, start_s, rate, rate, 0))

    def show_s(self, now_ns: int) -> float:
        """Return the show time at `now_ns`, also for an instant in the past."""
        for leg in reversed(self._legs):
            if leg.start_ns <= now_ns:
                return leg.show_s(now_ns)
        return self._legs[0].show_s(now_ns)

    def rate(self, now_ns: int) -> float:
        leg = self._legs[-1]
        if leg.ramp_ns == 0 or now_ns >= leg.start_ns + leg.ramp_ns:
            return leg.to_rate
        share = max(0, now_ns - leg.start_ns) / leg.ramp_ns
        return leg.from_rate + share * (leg.to_rate - leg.from_rate)

    def is_ramping(self, now_ns: int) -> bool:
        return now_ns < self.ramp_end_ns

    def ramp_to(self, rate: float, now_ns: int, over_s: float) -> None:
        """Change the rate evenly from its present value to `rate`, over `over_s`."""
        ramp_ns = ns_from_s(over_s)
        self._begin(_Leg(now_ns, self.show_s(now_ns), self.rate(now_ns), rate, ramp_ns))

    def stand_at(self, show_s: float, now_ns: int) -> None:
        """Stop at `show_s` from the instant on at which the show reached it, by `now_ns`."""
        reached_ns = self.instant_ns(show_s)
        start_ns = now_ns if reached_ns is None else min(max(reached_ns, self.ramp_end_ns), now_ns)
        self._begin(_Leg(start_ns, show_s, 0.0, 0.0, 0))

    def halt(self, since_ns: int) -> None:
        """Stand since `since_ns`, a past instant, where the show was then."""
        start_ns = max(since_ns, self._legs[-1].start_ns)
        self._begin(_Leg(start_ns, self.show_s(start_ns), 0.0, 0.0, 0))

    def instant_ns(self, show_s: float) -> int | None:
        """Return when the show reaches `show_s` at the present target rate; None: never."""
        if self.target_rate <= 0.0:
            return None
        return self.ramp_end_ns + ns_from_s((show_s - self._ramp_end_s) / self.target_rate)

    def knots(self, until_ns: int, step_ns: int) -> Iterator[tuple[int, float]]:
        """Yield `(instant, show time)` between which show time may be interpolated.

        These are every change of the rate, and steps of `step_ns` within its ramps.
        """
        for index, leg in enumerate(self._legs):
            is_last = index + 1 == len(self._legs)
            end_ns = until_ns if is_last else min(self._legs[index + 1].start_ns, until_ns)
            ramp_end_ns = min(leg.start_ns + leg.ramp_ns, end_ns)
            for instant_ns in range(leg.start_ns, ramp_end_ns, step_ns):
                yield instant_ns, leg.show_s(instant_ns)
            yield ramp_end_ns, leg.show_s(ramp_end_ns)
            if end_ns > ramp_end_ns:
                yield end_ns, leg.show_s(end_ns)

    def _begin(self, leg: _Leg) -> None:
        self._legs.append(leg)
        self.target_rate = leg.to_rate
        self.ramp_end_ns = leg.start_ns + leg.ramp_ns
        """When the rate is, or was, steady again."""
        self._ramp_end_s = leg.show_s(self.ramp_end_ns)
