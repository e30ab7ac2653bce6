"""Show time as a function of the run clock, and the moves while its rate changes.

`ShowClock` converts instants into show time. `ramp_s` limits how fast its rate may change, and
`spot_moves` computes the moves of the joints while the rate is not 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.program.quantize import LATEST_ARRIVAL_S
from lss_motion.protocol.line import encode_move
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

    from lss_motion.player.joint_state import JointState
    from lss_motion.player.serial_line import SerialLine
    from lss_motion.program.model import Program


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


RAMP_TICK_NS: Final = 40 * NS_PER_MS
"""At any rate but 1, every moving joint gets a move this often, if the line can carry it."""
GUIDE_PERIOD_NS: Final = 20 * NS_PER_MS
"""A guided joint gets one target for every step of its filter (FACTS.md M6): with one target over
two steps, the filter is quick in the first and slow in the second."""
RAMP_LINE_RATIO: Final = 0.5
"""Spot moves take no more of the line than this. With streamed joints on it, they get half of
that."""
RAMP_LEAST_S: Final = 0.3
RAMP_ACCEL_RATIO: Final = 0.4
"""A change of rate takes no more than this share of any joint's acceleration. Chosen: a course at
its own limit leaves none to spare, and is then left by 1 or 2 deg during a ramp."""
RAMP_LOOK_S: Final = (0.0, 0.1, 0.2, 0.3, 0.4)
"""How far ahead the speeds of the course count for a ramp that begins now."""


class SpotMove(NamedTuple):
    """A move that is computed at run time: servo degrees, and the run time that it has."""

    state: JointState
    aim_deg: float
    left_s: float


def ramp_s(
    joint_states: Collection[JointState], program: Program, show_s: float, change: float
) -> float:
    """Return the time over which the rate may change by `change` within the limits."""
    over_s = RAMP_LEAST_S
    for state in joint_states:
        spare_deg_s2 = RAMP_ACCEL_RATIO * state.limits.ramp_deg_s2
        for ahead_s in RAMP_LOOK_S:
            _, speed_deg_s = state.plan.at(program.within(show_s + ahead_s))
            over_s = max(over_s, abs(speed_deg_s) * change / spare_deg_s2)
    return over_s


class RampPeriods(NamedTuple):
    """How often joints get a target: those that are guided, and all others."""

    guide_ns: int
    tick_ns: int


def ramp_periods(
    joint_states: Collection[JointState], lines: Mapping[str, SerialLine]
) -> RampPeriods:
    """Return how often the lines can carry a target for every joint."""
    streamed = [state for state in joint_states if state.joint.drive == "streamed"]
    others = [state for state in joint_states if state.joint.drive != "streamed"]
    share = 0.5 if streamed and others else 1.0
    return RampPeriods(
        guide_ns=max(GUIDE_PERIOD_NS, round(_busiest_ns(streamed, lines) / share)),
        tick_ns=max(RAMP_TICK_NS, round(_busiest_ns(others, lines) / share)),
    )


def _busiest_ns(joint_states: Collection[JointState], lines: Mapping[str, SerialLine]) -> float:
    """Return the least period of one move for each joint on the busiest line."""
    busiest_ns = max(
        sum(
            line.time_ns(len(encode_move(state.joint.servo_id, -18000, _duration_ms(state))))
            for state in joint_states
            if state.joint.bus == bus
        )
        for bus, line in lines.items()
    )
    return busiest_ns / RAMP_LINE_RATIO


def _duration_ms(state: JointState) -> int | None:
    return 1000 if state.joint.drive == "timed" else None


def spot_moves(
    joint_states: Iterable[JointState],
    lines: Mapping[str, SerialLine],
    *,
    now_ns: int,
    period_ns: int,
    planned_deg: Callable[[JointState, int], float],
    ends_ns: int | None,
) -> Iterator[SpotMove]:
    """Yield a move for every joint that is off its course, to be on it in one period.

    `ends_ns` is when the course comes to rest, if it does: moves from there on reach no further.
    The caller sends each move before it takes the next one, since it keeps the line busy. Streamed
    joints are guided instead (`streamer.guide`).
    """
    for state in joint_states:
        if state.joint.drive == "streamed":
            continue
        is_stepped = state.joint.drive == "stepped"
        arrival_ns = lines[state.joint.bus].arrival_ns(0, now_ns)
        # A jump is right in the middle of the time for which it holds.
        ahead_ns = arrival_ns + (period_ns // 2 if is_stepped else period_ns)
        ahead_ns += ns_from_s(state.lead_s)
        aim_deg = planned_deg(state, ahead_ns)
        position_deg, speed_deg_s = state.place(arrival_ns)
        way_deg = aim_deg + state.disturbance.offset_deg - position_deg
        unit_deg = 1.0 / state.limits.wire_per_deg
        if abs(way_deg) < unit_deg and abs(speed_deg_s) < 1.0:
            continue
        if is_stepped:
            yield SpotMove(state, aim_deg, 0.0)
            continue
        travel_deg_s = min(abs(way_deg) / s_from_ns(period_ns), state.limits.speed_max_deg_s)
        if ends_ns is None or ahead_ns < ends_ns:
            beyond_deg = travel_deg_s * LATEST_ARRIVAL_S
            beyond_deg += 0.5 * travel_deg_s * travel_deg_s / state.limits.ramp_deg_s2
            aim_deg += math.copysign(beyond_deg, way_deg)
            way_deg += math.copysign(beyond_deg, way_deg)
        yield SpotMove(state, aim_deg, abs(way_deg) / max(travel_deg_s, 1.0))
