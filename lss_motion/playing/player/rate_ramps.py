"""Moves that are computed at run time: while the rate of the show is not 1, or off the program.

`ramp_s` limits how fast the rate may change; `spot_move` computes the moves meanwhile. Streamed
joints are guided (`guide`), also at rate 1 if they are off their program.

Timed joints that are off their plan join it again within their limits: T is the time at travel
speed, and the ramps of the servo come on top of it. So `rejoin`, `send_deferred` and `on_time_s`
compute the T of such a joint from its way and its speed, not from what is left of T.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.planning.program.line import longest_move
from lss_motion.planning.program.moves import LATEST_ARRIVAL_S
from lss_motion.planning.program.streamed import FilterProfile
from lss_motion.playing.player.joint_state import LONGEST_NS, REST_DEG_S, JointState
from lss_motion.playing.player.servo_model import closing_deg
from lss_motion.protocol.framing import encode_move
from lss_motion.robot.profile import Profile
from lss_motion.units import NS_PER_MS, ns_from_s, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.query_tracker import SerialLine
    from lss_motion.playing.player.show_clock import ShowClock


RAMP_TICK_NS: Final = 40 * NS_PER_MS
"""At any rate but 1, every moving joint gets a move this often, if the line can carry it."""
GUIDE_PERIOD_NS: Final = 20 * NS_PER_MS
"""A guided joint gets one target for every step of its filter (FACTS.md M6): with one target over
two steps, the filter is quick in the first and slow in the second."""
RAMP_LINE_RATIO: Final = 0.5
"""Spot moves take no more of the line than this, or of what guided joints leave of it."""
GUIDE_LINE_RATIO: Final = 0.85
"""Guiding targets take no more of the line than this. The program sends as many where all joints
that are guided move, and one for two steps breaks the limit of a fast joint (`streamed`)."""
COARSE_NS: Final = 400 * NS_PER_MS
"""A joint whose model is wrong gets a spot move this often. Chosen: a servo that begins each move
at rest needs 0.3 s to gain 180 deg/s and to lose it again at 600 deg/s2; moves of 0.3 s do as well.
"""
SPOT_WAIT_NS: Final = 2 * GUIDE_PERIOD_NS
"""A spot move waits no longer for a gap between guiding targets. Chosen: two of their rounds."""
RAMP_LEAST_S: Final = 0.3
RAMP_ACCEL_RATIO: Final = 0.4
"""A change of rate takes no more than this share of any joint's acceleration. Chosen: a course at
its own limit leaves none to spare, and is then left by 1 or 2 deg during a ramp."""
CLOSING_RATIO: Final = 0.5
"""Share of the acceleration with which a joint that is off its course may close in on it. Chosen:
the course needs the rest."""
RAMP_LOOK_S: Final = (0.0, 0.1, 0.2, 0.3, 0.4)
"""How far ahead the speeds of the course count for a ramp that begins now."""


class SpotMove(NamedTuple):
    """A move that is computed at run time: servo degrees, and the run time that it has."""

    aim_deg: float
    left_s: float


class Spot(NamedTuple):
    """A joint that is to get a spot move at a tick of the rate."""

    state: JointState
    since_ns: int
    period_ns: int
    """The time that its spot move has; 0: it gets the rest of its move under way."""
    late_ns: int
    is_coarse: bool = False
    """Whether the model of the joint is wrong: it gets the plan's angle, and T as it is."""


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


class RampPeriods:
    """How often joints get a target, by what their lines can carry: guided joints, and others."""

    def __init__(self, joint_states: Iterable[JointState], lines: Mapping[str, SerialLine]) -> None:
        self._streamed: dict[str, list[tuple[JointState, int]]] = {bus: [] for bus in lines}
        self._others_ns = dict.fromkeys(lines, 0)
        """How long one move for each joint that is not streamed takes on each bus."""
        for state in joint_states:
            bus = state.joint.bus
            slot_ns = lines[bus].time_ns(len(longest_move(state.joint)))
            if state.joint.drive == "streamed":
                self._streamed[bus].append((state, slot_ns))
            else:
                self._others_ns[bus] += slot_ns

    def guide_ns(self, bus: str) -> int:
        """Return how often each guided joint of a bus gets a target: after whole filter steps."""
        steps = self._guided_ns(bus) / (GUIDE_LINE_RATIO * GUIDE_PERIOD_NS)
        return max(1, math.ceil(steps)) * GUIDE_PERIOD_NS

    def tick_ns(self) -> int:
        """Return how often all other joints get a move."""
        return max(RAMP_TICK_NS, *(round(self._tick_ns(bus)) for bus in self._others_ns))

    def _tick_ns(self, bus: str) -> float:
        left_ratio = 1.0 - self._guided_ns(bus) / self.guide_ns(bus)
        return self._others_ns[bus] / (RAMP_LINE_RATIO * left_ratio)

    def _guided_ns(self, bus: str) -> int:
        """Return how long one target for each guided joint takes on a bus."""
        return sum(slot_ns for state, slot_ns in self._streamed[bus] if state.guide_ns is not None)

    def next_guide_ns(self, bus: str) -> float:
        """Return when the next guiding target is due on a bus; infinite: no joint is guided."""
        dues_ns = (state.guide_ns for state, _ in self._streamed[bus])
        return min((due_ns for due_ns in dues_ns if due_ns is not None), default=math.inf)


def spot_move(
    spot: Spot,
    line: SerialLine,
    *,
    now_ns: int,
    planned_deg: Callable[[JointState, int], float],
    ends_ns: int | None,
) -> SpotMove | None:
    """Return a move that brings a joint onto its course in one period; None: it is there.

    `ends_ns` is when the course comes to rest, if it does: moves from there on reach no further.
    Streamed joints are guided instead (`guide`).
    """
    state, period_ns = spot.state, spot.period_ns
    is_stepped = state.joint.drive == "stepped"
    arrival_ns = line.arrival_ns(0, now_ns)
    # A jump is right in the middle of the time for which it holds.
    here_ns = arrival_ns + ns_from_s(state.lead_s)
    ahead_ns = here_ns + (period_ns // 2 if is_stepped else period_ns)
    aim_deg = planned_deg(state, ahead_ns)
    position_deg, speed_deg_s = state.place(arrival_ns)
    way_deg = aim_deg + state.disturbance.offset_deg - position_deg
    unit_deg = 1.0 / state.limits.wire_per_deg
    if abs(way_deg) < unit_deg and abs(speed_deg_s) < 1.0:
        return None
    if is_stepped:
        return SpotMove(aim_deg, 0.0)
    if spot.is_coarse:
        if _is_bound_for(state, aim_deg):
            return None
        return SpotMove(aim_deg, _coarse_s(state, aim_deg, planned_deg(state, here_ns), period_ns))
    if ends_ns is not None and ahead_ns >= ends_ns:
        travel_deg_s = min(abs(way_deg) / s_from_ns(period_ns), state.limits.speed_max_deg_s)
        return SpotMove(aim_deg, abs(way_deg) / max(travel_deg_s, 1.0))
    course_deg = aim_deg - planned_deg(state, here_ns)
    way_deg = course_deg + _closing_deg(state, way_deg - course_deg, period_ns)
    travel_deg_s = min(abs(way_deg) / s_from_ns(period_ns), state.limits.speed_max_deg_s)
    beyond_deg = travel_deg_s * LATEST_ARRIVAL_S
    beyond_deg += 0.5 * travel_deg_s * travel_deg_s / state.limits.ramp_deg_s2
    way_deg += math.copysign(beyond_deg, way_deg)
    aim_deg = position_deg + way_deg - state.disturbance.offset_deg
    return SpotMove(aim_deg, abs(way_deg) / max(travel_deg_s, 1.0))


def tick_spots(
    state: JointState,
    planned_deg: Callable[[JointState, int], float],
    rate: float,
    now_ns: int,
    period_ns: int,
    late_ns: int,
) -> list[Spot]:
    """Return the spot move of a joint at a tick; none while a coarse one is under way.

    A joint gets few long ones where the model of its servo is wrong. A servo that begins each move
    at rest, for example, hardly moves if it gets one at each tick.
    """
    is_known = state.disturbance.horn.model_ratio == 1.0
    if is_known or rate == 0.0 or state.joint.drive != "timed":
        return [Spot(state, now_ns, period_ns, late_ns)]
    until_ns, at_rate = state.coarse_until
    if at_rate == rate and now_ns + period_ns // 2 < until_ns:
        return []
    coarse_ns = _coarse_ns(state, planned_deg, now_ns, period_ns)
    state.lead_coarsely(now_ns + coarse_ns, rate)
    return [Spot(state, now_ns, coarse_ns, late_ns, is_coarse=True)]


def _coarse_ns(
    state: JointState,
    planned_deg: Callable[[JointState, int], float],
    now_ns: int,
    period_ns: int,
) -> int:
    """Return the time that a coarse spot move has: until the plan turns round, if that is soon.

    It is a multiple of `period_ns`, after which the next tick comes.
    """
    here_ns = now_ns + ns_from_s(state.lead_s)
    before_deg, way_deg = planned_deg(state, here_ns), 0.0
    for ahead_ns in range(period_ns, COARSE_NS + 1, period_ns):
        next_deg = planned_deg(state, here_ns + ahead_ns)
        step_deg = next_deg - before_deg
        if way_deg * step_deg < 0.0:
            return ahead_ns - period_ns
        way_deg, before_deg = step_deg or way_deg, next_deg
    return max(COARSE_NS, period_ns)


def _is_bound_for(state: JointState, target_deg: float) -> bool:
    """Return whether the last move of a timed joint leads to a target of its plan."""
    profile, aim_deg = state.profile, target_deg + state.disturbance.offset_deg
    if not isinstance(profile, Profile):
        return False
    return abs(profile.target_deg - aim_deg) < state.joint.unit_deg


def _coarse_s(state: JointState, aim_deg: float, here_deg: float, period_ns: int) -> float:
    """Return the T of a coarse spot move: the shorter, the further its horn is behind its plan."""
    last_deg = state.disturbance.last_deg
    way_deg = 0.0 if last_deg is None else abs(aim_deg - last_deg)
    ratio = min(abs(aim_deg - here_deg) / way_deg, 1.0) if way_deg else 1.0
    return max(ratio * s_from_ns(period_ns), way_deg / state.limits.speed_max_deg_s)


def _closing_deg(state: JointState, off_deg: float, period_ns: int) -> float:
    """Return how much of its distance to the course a timed joint covers in one period.

    All of it if it is small. A joint that is further off comes so fast that it can still brake:
    else it would pass its course, and pass it again on its way back.
    """
    brake_deg_s2 = CLOSING_RATIO * state.limits.ramp_deg_s2
    most_deg = math.sqrt(2.0 * brake_deg_s2 * abs(off_deg)) * s_from_ns(period_ns)
    return math.copysign(min(abs(off_deg), most_deg), off_deg)


ROUNDING_S: Final = 1e-4
"""An interval this little longer than steps of a filter counts as one of these steps. Chosen: far
below the jitter of a line."""
ON_PROGRAM_RATIO: Final = 1.0
"""A joint nearer to its plan than this share of the program's tolerance is on it again."""


def guide(
    state: JointState,
    line: SerialLine,
    planned_deg: Callable[[JointState, int], float],
    now_ns: int,
    period_ns: int,
    *,
    is_even: bool,
) -> None:
    """Send a guiding target that leads for `period_ns`, and set the instant of the next one.

    Guiding ends when the joint rests where its plan does, or when, at a steady rate of 1
    (`is_even`), it is so near to its plan that the program's move under way has the same effect.
    """
    profile, limits = state.profile, state.limits
    assert isinstance(profile, FilterProfile), "only streamed joints are led"
    size = _target_bytes(state, state.place(now_ns)[0])
    arrival_s = s_from_ns(line.arrival_ns(size, now_ns))
    step = profile.acts_on(arrival_s)
    steps = max(1, round(s_from_ns(period_ns) / profile.period_s))
    from_s = profile.step_s(step) - 0.5 * profile.period_s
    from_deg = _wanted_deg(state, planned_deg, from_s)
    to_deg = _wanted_deg(state, planned_deg, from_s + steps * profile.period_s)
    off_deg = from_deg - profile.value(step - 1)
    is_near = abs(off_deg) <= ON_PROGRAM_RATIO * limits.tolerance_deg
    if is_even and is_near and state.active is not None:
        state.guide_at(None)
        state.send_active(line, 0.0, now_ns)
        return
    target_deg = to_deg
    is_at_rest = from_deg == to_deg and abs(off_deg) <= 1.0 / limits.wire_per_deg
    if not is_at_rest:
        way_deg = to_deg - from_deg + closing_deg(off_deg, limits)
        target_deg = profile.value(step - 1) + way_deg / (1.0 - profile.keep_ratio**steps)
    state.send(line, target_deg - state.disturbance.offset_deg, 0.0, now_ns)
    if not is_at_rest:
        size = _target_bytes(state, target_deg + to_deg - from_deg)
        last_ns = state.last_arrival_ns or ns_from_s(arrival_s)
        next_ns = last_ns + steps * ns_from_s(profile.period_s)
        state.guide_at(next_ns - line.time_ns(size))


def first_guide_ns(state: JointState, line: SerialLine, now_ns: int) -> int:
    """Return when the first guiding target leaves: whole filter steps after the last target."""
    profile = state.profile
    assert isinstance(profile, FilterProfile), "only streamed joints are led"
    if state.last_arrival_ns is None:
        return now_ns
    time_ns = line.time_ns(_target_bytes(state, state.place(now_ns)[0]))
    since_ns = now_ns + time_ns - state.last_arrival_ns - ns_from_s(ROUNDING_S)
    steps = math.ceil(since_ns / ns_from_s(profile.period_s))
    next_ns = state.last_arrival_ns + steps * ns_from_s(profile.period_s)
    return max(next_ns - time_ns, now_ns)


def _target_bytes(state: JointState, target_deg: float) -> int:
    """Return how many bytes a guiding target has."""
    wire = round(target_deg * state.limits.wire_per_deg)
    return len(encode_move(state.joint.servo_id, wire, None))


def is_off_course(
    state: JointState, planned_deg: Callable[[JointState, int], float], from_ns: int, to_ns: int
) -> bool:
    """Return whether a streamed joint moves, or its plan does until `to_ns`, or it is elsewhere."""
    position_deg, speed_deg_s = state.place(from_ns)
    instants_s = (s_from_ns(at_ns) for at_ns in (from_ns, (from_ns + to_ns) // 2, to_ns))
    off_deg = max(abs(_wanted_deg(state, planned_deg, at_s) - position_deg) for at_s in instants_s)
    return speed_deg_s != 0.0 or off_deg > 1.0 / state.limits.wire_per_deg


def _wanted_deg(
    state: JointState, planned_deg: Callable[[JointState, int], float], at_s: float
) -> float:
    """Return where the filter of a joint should be at `at_s`: ahead of the horn, corrected."""
    at_ns = ns_from_s(at_s + state.lead_s + state.early_s)
    wanted_deg = planned_deg(state, at_ns) + state.disturbance.offset_deg
    return min(max(wanted_deg, state.limits.position_min_deg), state.limits.position_max_deg)


JOIN_S: Final = 0.1
"""Time in which a joint that has lost a move catches up, if its limits allow it. Chosen."""


def rejoin(
    state: JointState,
    line: SerialLine,
    clock: ShowClock,
    within: Callable[[float], float],
    now_ns: int,
) -> None:
    """Send the rest of the move under way to a servo that has lost it.

    A joint that is behind travels faster until it meets the plan; from there the rest of the move
    is deferred. `within` turns a show time into one of the plan.
    """
    assert state.active is not None
    arrival_ns = line.arrival_ns(len(state.active.data), now_ns)
    planned_deg, planned_deg_s = state.plan.at(within(clock.show_s(arrival_ns)))
    position_deg, own_deg_s = state.place(arrival_ns)
    planned_way_deg = state.target_deg - planned_deg
    way_deg = state.target_deg + state.disturbance.offset_deg - position_deg
    sense, ramp_deg_s2 = math.copysign(1.0, way_deg), state.limits.ramp_deg_s2
    travel_deg_s = _travel_deg_s(state, within(state.begun_s(line)))
    # Distance that it loses while it speeds up, less the distance that the plan loses.
    slower_deg_s = max(0.0, travel_deg_s - sense * own_deg_s)
    planned_slower_deg_s = max(0.0, travel_deg_s - sense * planned_deg_s)
    behind_deg = abs(way_deg) - abs(planned_way_deg)
    behind_deg += 0.5 * (slower_deg_s**2 - planned_slower_deg_s**2) / ramp_deg_s2
    faster_deg_s = _faster_deg_s(state, travel_deg_s, behind_deg)
    left_s = state.left_s(line, clock, now_ns)
    is_on_its_way = way_deg * planned_way_deg > 0.0 and travel_deg_s > REST_DEG_S
    if not is_on_its_way or faster_deg_s <= 0.0:
        state.send_active(line, left_s, now_ns)
        return
    state.send_active(line, abs(way_deg) / (travel_deg_s + faster_deg_s), now_ns)
    # The distance lost while it speeds up comes back while it slows down.
    joins_s = slower_deg_s / ramp_deg_s2 + behind_deg / faster_deg_s
    if joins_s < left_s:
        state.defer(arrival_ns + ns_from_s(joins_s), state.target_deg, travel_deg_s)


def _faster_deg_s(state: JointState, travel_deg_s: float, behind_deg: float) -> float:
    """Return by how much faster than `travel_deg_s` a joint travels to catch up."""
    if behind_deg <= state.joint.unit_deg:
        return 0.0
    return min(
        state.limits.speed_max_deg_s - travel_deg_s,
        behind_deg / JOIN_S,
        math.sqrt(behind_deg * state.limits.ramp_deg_s2),
    )


def _travel_deg_s(state: JointState, begun_s: float) -> float:
    """Return the travel speed between the ramps of the move that began at `begun_s`."""
    move = state.active
    assert move is not None
    assert move.duration_ms is not None
    planned_deg, _ = state.plan.at(begun_s)
    travel_deg_s = abs(state.target_deg - planned_deg) / s_from_ms(move.duration_ms)
    return min(travel_deg_s, state.limits.speed_max_deg_s)


def send_deferred(state: JointState, line: SerialLine, now_ns: int) -> None:
    """Send the deferred target: a timed joint travels on as planned, within the longest T."""
    assert state.deferred is not None
    _, target_deg, travel_deg_s = state.deferred
    way_deg = target_deg + state.disturbance.offset_deg - state.place(now_ns)[0]
    left_s = min(abs(way_deg) / travel_deg_s, s_from_ns(LONGEST_NS))
    state.send(line, target_deg, left_s, now_ns)


def on_time_s(
    state: JointState, line: SerialLine, show_s: Callable[[int], float], now_ns: int
) -> float:
    """Return the time that the move under way has to travel if sent on time; 0 if it has no T.

    That is its T, unless the move reverses the joint. Then its target may be near and T short, and
    a small distance of the profile from the plan would change the travel speed many times over. So
    the speed of the plan is kept instead of its end; also where only the profile reverses, since it
    is ahead of the plan and too fast to stop at the target. `show_s` turns an instant into one of
    the plan.
    """
    move = state.active
    assert move is not None
    if move.duration_ms is None:
        return 0.0
    arrival_ns, target_deg = line.arrival_ns(len(move.data), now_ns), state.target_deg
    planned_deg, speed_deg_s = state.plan.at(show_s(arrival_ns))
    planned_way_deg = target_deg - planned_deg
    position_deg, own_deg_s = state.place(arrival_ns)
    way_deg = target_deg + state.disturbance.offset_deg - position_deg
    planned_s = s_from_ms(move.duration_ms)
    if not planned_way_deg:
        return planned_s
    kept_s = planned_s * abs(way_deg / planned_way_deg)
    if speed_deg_s * planned_way_deg < 0.0 < way_deg * planned_way_deg:
        return kept_s
    stop_deg = 0.5 * own_deg_s * abs(own_deg_s) / state.limits.ramp_deg_s2
    return min(planned_s, kept_s) if (way_deg - stop_deg) * own_deg_s < 0.0 else planned_s
