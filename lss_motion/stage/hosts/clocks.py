"""The clock of another computer, from exchanges of messages with it.

Both clocks are monotonic; neither is ever compared with a wall clock. In an exchange a message
leaves here, arrives there, is answered, and the answer returns: four instants, two of each clock.
No message arrives before it leaves. So the difference of the clocks lies in an interval as wide as
the round trip, wherever the time on the way was spent, and half of that is an honest bound.

`ClockEstimator` keeps the best of each `BEST_OF` exchanges, fits offset and rate to them, and stays
inside what all of their intervals allow. It assumes that the rate of two clocks differs by at most
`RATE_MAX_RATIO`, and changes by less than `WANDER_RATIO` while an interval is kept. Intervals that
contradict each other mean that a clock jumped or was slewed: then it starts again.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct

from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

BEST_OF: Final = 16
"""On a link like Wi-Fi one exchange is wrong by 42 ms at most, the best of 16 by 3 ms (measured:
tools/benches/network.py)."""
POINTS_MAX: Final = 32
"""Intervals that are kept: about a minute with an exchange every `EVERY_NS`."""
EVERY_NS: Final = 125 * NS_PER_MS
"""An exchange is made this often; chosen: 16 of them in two seconds, 100 bytes each."""
BURST_NS: Final = 10 * NS_PER_MS
"""Until the first `BEST_OF` exchanges are made, one follows the other so soon."""
LATE_NS: Final = NS_PER_S
"""An answer that takes longer is ignored: its interval is worthless."""
RATE_MAX_RATIO: Final = 500e-6
"""Two crystals differ by up to 200 ppm; a program that disciplines a clock may slew it by 500 ppm
(the limit of the Linux kernel)."""
WANDER_RATIO: Final = 2e-6
"""Chosen: a crystal that warms up changes by some tenths of a ppm in a minute."""
WARN_NS: Final = 3 * NS_PER_MS
REFUSE_NS: Final = 10 * NS_PER_MS
"""Clocks that are known no better start no show. Chosen: at 100 deg/s, 1 degree."""


class Exchange(Struct, frozen=True):
    """One question and its answer.

    `asked_ns` and `returned_ns` are of this computer's clock, the other two of the other's.
    """

    asked_ns: int
    received_ns: int
    answered_ns: int
    returned_ns: int

    @property
    def round_trip_ns(self) -> int:
        """Time on the way, both ways."""
        return (self.returned_ns - self.asked_ns) - (self.answered_ns - self.received_ns)

    @property
    def is_possible(self) -> bool:
        """Whether any two clocks could have made these four instants."""
        return self.answered_ns >= self.received_ns and 0 <= self.round_trip_ns <= LATE_NS


class Interval(Struct, frozen=True):
    """At the own instant `at_ns` the other clock is ahead by `low_ns` to `high_ns`."""

    at_ns: int
    low_ns: int
    high_ns: int

    @property
    def half_ns(self) -> float:
        """Half of the round trip: the honest bound of one exchange."""
        return (self.high_ns - self.low_ns) / 2

    @property
    def middle_ns(self) -> float:
        return (self.high_ns + self.low_ns) / 2


class ClockEstimate(Struct, frozen=True):
    """The other clock at the own instant `at_ns`: ahead by `offset_ns`, faster by `rate_ratio`.

    The truth lies within `bound_ns` of `offset_ns`.
    """

    at_ns: int
    offset_ns: int
    rate_ratio: float
    bound_ns: int

    def other_ns(self, own_ns: int) -> int:
        """Return the instant of the other clock at an instant of the own clock."""
        return own_ns + self.offset_ns + round(self.rate_ratio * (own_ns - self.at_ns))

    def own_ns(self, other_ns: int) -> int:
        """Return the instant of the own clock at an instant of the other clock."""
        elapsed_ns = other_ns - self.at_ns - self.offset_ns
        return (
            self.at_ns + elapsed_ns - round(elapsed_ns * self.rate_ratio / (1.0 + self.rate_ratio))
        )

    @property
    def verdict(self) -> Literal["good", "poor", "unfit"]:
        """Whether a show may start on it: `poor` with a warning, `unfit` not at all."""
        if self.bound_ns > REFUSE_NS:
            return "unfit"
        return "poor" if self.bound_ns > WARN_NS else "good"


class ClockEstimator:
    """What is known of one other clock."""

    def __init__(self) -> None:
        self._points: deque[Interval] = deque(maxlen=POINTS_MAX)
        self._window: list[Interval] = []
        self.restarts = 0
        """How often a clock has jumped, or was slewed."""
        self.round_trip_ns: int | None = None
        """The smallest of the last `BEST_OF` exchanges."""

    @property
    def is_ready(self) -> bool:
        """Whether `BEST_OF` exchanges have been made since the last restart."""
        return bool(self._points)

    def add(self, exchange: Exchange) -> None:
        """Take one exchange; one that is impossible is ignored."""
        if not exchange.is_possible:
            return
        interval = Interval(
            (exchange.asked_ns + exchange.returned_ns) // 2,
            exchange.answered_ns - exchange.returned_ns,
            exchange.received_ns - exchange.asked_ns,
        )
        self._window.append(interval)
        if self._points and self._contradicts(interval):
            self._restart(interval)
        if len(self._window) >= BEST_OF:
            best = min(self._window, key=_half_ns)
            self.round_trip_ns = best.high_ns - best.low_ns
            self._points.append(best)
            self._window.clear()

    def estimate(self, now_ns: int) -> ClockEstimate | None:
        """Return offset and rate at an instant; None before the first `BEST_OF` exchanges."""
        if not self._points:
            return None
        points = list(self._points)
        if self._window:  # The newest is not carried far, while the rate is not known well.
            points.append(min(self._window, key=_half_ns))
        slowest, fastest = _rates(points)
        lows, highs = zip(
            *(_carried(point, now_ns, slowest, fastest) for point in points), strict=True
        )
        low_ns, high_ns = max(lows), min(highs)
        if low_ns > high_ns:  # By rounding, or a slew that no exchange has contradicted yet.
            low_ns, high_ns = _carried(points[-1], now_ns, slowest, fastest)
        rate, offset_ns = _line(points, now_ns)
        rate = min(max(rate, slowest), fastest)
        offset_ns = min(max(offset_ns, low_ns), high_ns)
        bound_ns = max(offset_ns - low_ns, high_ns - offset_ns)
        return ClockEstimate(now_ns, round(offset_ns), rate, round(bound_ns) + 1)

    def _contradicts(self, interval: Interval) -> bool:
        """Return whether the offset left what the kept intervals allow at that instant."""
        slowest, fastest = _rates(self._points)
        carried = [_carried(point, interval.at_ns, slowest, fastest) for point in self._points]
        low_ns = max(low for low, _ in carried)
        high_ns = min(high for _, high in carried)
        return interval.low_ns > high_ns or interval.high_ns < low_ns

    def _restart(self, interval: Interval) -> None:
        self.restarts += 1
        self._points.clear()
        self._window[:] = [interval]


def _half_ns(interval: Interval) -> float:
    return interval.half_ns


def _rates(points: Sequence[Interval] | deque[Interval]) -> tuple[float, float]:
    """Return the least and the greatest rate that the intervals allow, and what it may wander."""
    slowest, fastest = -RATE_MAX_RATIO, RATE_MAX_RATIO
    last = points[-1]
    for point in points:
        span_ns = last.at_ns - point.at_ns
        if span_ns > 0:
            slowest = max(slowest, (last.low_ns - point.high_ns) / span_ns - WANDER_RATIO)
            fastest = min(fastest, (last.high_ns - point.low_ns) / span_ns + WANDER_RATIO)
    if slowest > fastest:
        return -RATE_MAX_RATIO, RATE_MAX_RATIO
    return slowest, fastest


def _carried(point: Interval, at_ns: int, slowest: float, fastest: float) -> tuple[float, float]:
    """Return the interval at another instant, wider by what the rate may have been meanwhile."""
    elapsed_ns = at_ns - point.at_ns
    if elapsed_ns < 0:
        slowest, fastest = fastest, slowest
    return point.low_ns + slowest * elapsed_ns, point.high_ns + fastest * elapsed_ns


def _line(points: Sequence[Interval] | deque[Interval], at_ns: int) -> tuple[float, float]:
    """Return rate and offset at `at_ns` of the line through the intervals, narrow ones first."""
    weights = [1.0 / (point.half_ns + 1.0) ** 2 for point in points]
    total = sum(weights)
    pairs = list(zip(weights, points, strict=True))
    mean_at = sum(weight * (point.at_ns - at_ns) for weight, point in pairs) / total
    base_ns = points[-1].middle_ns
    mean_ns = sum(weight * (point.middle_ns - base_ns) for weight, point in pairs) / total
    spread = sum(weight * (point.at_ns - at_ns - mean_at) ** 2 for weight, point in pairs)
    if spread == 0.0:
        return 0.0, base_ns + mean_ns
    slope = (
        sum(
            weight * (point.at_ns - at_ns - mean_at) * (point.middle_ns - base_ns - mean_ns)
            for weight, point in pairs
        )
        / spread
    )
    return slope, base_ns + mean_ns - slope * mean_at
