"""The state of one joint while a program is played.

One joint while a program is played: what it was told, where it is, what it is told next.

What the filter of a servo in EM0 makes of its targets, at whatever instants it may step.

The filter steps every `Response.filter_s`, and nobody knows when: a target that comes a little
late is one step late for some of the possible instants and on time for the others. So the course
is kept for several of them, and a target may be said only if it keeps the limits for all.

What is kept of one joint's readings for a picture: few points, however long a show is.

Counts of one run, and how they become the numbers of the report.

What is kept does not grow with the run: lateness is counted in bins.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from dataclasses import dataclass, field
from itertools import accumulate
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.player.estimators import DisturbanceEstimator, LagEstimator, LostMoveDetector
from lss_motion.program.drives import profile_lead_s
from lss_motion.program.model import received_us
from lss_motion.program.quantize import LATEST_ARRIVAL_S, nearest_wire
from lss_motion.program.reference import DURATION_MAX_MS, servo_limits
from lss_motion.program.response import Profile
from lss_motion.program.stepped import PULSE_S
from lss_motion.program.streamed import SETTLED_DEG, FilterProfile
from lss_motion.program.verify import make_profile, profiles
from lss_motion.protocol.line import encode_move
from lss_motion.units import MS_PER_S, NS_PER_US, ns_from_s, s_from_ms, s_from_ns, s_from_us

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.serial_line import SerialLine
    from lss_motion.player.show_clock import ShowClock
    from lss_motion.program.model import Move, Program
    from lss_motion.program.reference import ServoLimits
    from lss_motion.program.response import PiecewiseProfile
    from lss_motion.program.verify import ServoProfile
    from lss_motion.protocol.constants import Status
    from lss_motion.robot.model import Joint, Robot


STEP_OFFSETS: Final = 16
"""Instants of the steps that are looked at, evenly spread over one period: 1.25 ms apart, about
what one command takes on an ordinary line."""
ROOM_RATIO: Final = 1.0
"""A fitted course winds within its tolerance: a step may differ from the last one by so many
tolerances, besides what the acceleration limit allows. Of 52 streamed joints of random shows, the
worst needs 0.94."""
CLOSING_RATIO: Final = 0.5
"""What closes up on the plan takes this share of the acceleration; the rest is for the plan."""
CLOSING_GAIN: Final = 0.5
"""And in one step no more than this share of what is missing."""


@dataclass(slots=True)
class _StepOffset:
    """The filter, if its steps are made at one of the possible instants."""

    step: int
    """The number of the next step."""
    value_deg: float
    last_deg: float = 0.0
    """How far the last step went."""
    lagged_deg: float = 0.0
    """By how much steps differ from the last ones, as the horn feels it, which lags behind."""

    def go_on(self, until: int, target_deg: float, count: int, lag_ratio: float) -> None:
        """Make all steps before `until`. The horn feels `felt_ratio` of a change at once."""
        while self.step < until:
            if self.value_deg == target_deg and self.last_deg == 0.0:
                self.step, self.lagged_deg = until, 0.0
                return
            self.step += 1
            value_deg = self.value_deg + (target_deg - self.value_deg) / count
            if abs(value_deg - target_deg) < SETTLED_DEG:
                value_deg = target_deg
            step_deg = value_deg - self.value_deg
            self.lagged_deg += lag_ratio * (step_deg - self.last_deg - self.lagged_deg)
            self.value_deg, self.last_deg = value_deg, step_deg


class Setpoints:
    """The filter of one servo, target by target. Instants must not go back."""

    def __init__(self, position_deg: float, *, count: int, limits: ServoLimits) -> None:
        self._limits = limits
        self._count = count
        self._period_s = limits.response.filter_s
        self._target_deg = position_deg
        response = limits.response
        self._lag_ratio = -math.expm1(-self._period_s / response.lag_s) if response.lag_s else 1.0
        self._phases = [_StepOffset(0, position_deg) for _ in range(STEP_OFFSETS)]

    def allowed(self, arrival_s: float) -> tuple[float, float]:
        """Return the least and largest target that keep the limits if heard at `heard_s`.

        Where the possible instants disagree, it is half-way between them.
        """
        self._go_on(arrival_s)
        spans = [self._span(phase) for phase in self._phases]
        low_deg, high_deg = max(low for low, _ in spans), min(high for _, high in spans)
        if low_deg > high_deg:
            low_deg = high_deg = 0.5 * (low_deg + high_deg)
        return low_deg, high_deg

    def commanded(self, arrival_s: float, target_deg: float) -> None:
        """Note that the servo hears `D target` at `heard_s`."""
        self._go_on(arrival_s)
        self._target_deg = target_deg

    def _go_on(self, arrival_s: float) -> None:
        for index, phase in enumerate(self._phases):
            until = math.ceil(arrival_s / self._period_s - index / STEP_OFFSETS)
            phase.go_on(until, self._target_deg, self._count, self._lag_ratio)

    def _span(self, phase: _StepOffset) -> tuple[float, float]:
        """Return between which targets the next step keeps speed, acceleration, and range."""
        limits, value_deg, last_deg = self._limits, phase.value_deg, phase.last_deg
        more_deg = _step_gain_deg(limits) + ROOM_RATIO * limits.tolerance_deg
        most_deg = limits.speed_max_deg_s * self._period_s
        down_deg = self._brakable_deg(value_deg - limits.position_min_deg, most_deg, more_deg)
        up_deg = self._brakable_deg(limits.position_max_deg - value_deg, most_deg, more_deg)
        lagged_deg = (1.0 - self._lag_ratio) * phase.lagged_deg
        slowest_deg = last_deg + (-more_deg - lagged_deg) / self._lag_ratio
        fastest_deg = last_deg + (more_deg - lagged_deg) / self._lag_ratio
        low_deg = min(max(slowest_deg, -down_deg), fastest_deg)
        high_deg = max(min(fastest_deg, up_deg), slowest_deg)
        return value_deg + self._count * low_deg, value_deg + self._count * high_deg

    def _brakable_deg(self, room_deg: float, most_deg: float, less_deg: float) -> float:
        """Return the longest step, up to `most_deg`, from which targets in the range can brake.

        Every step may be shorter than the last one by `less_deg`; the target of each, which is
        `count` times as far away as the step goes, lies no further than the end of the range.
        """
        count, least_deg, steps = self._count, most_deg, 0
        if room_deg >= most_deg * (count + most_deg / less_deg):
            return most_deg
        while steps * less_deg < least_deg:
            braked_deg = less_deg * steps * (count + 0.5 * (steps - 1))
            least_deg = min(least_deg, (max(room_deg, 0.0) + braked_deg) / (count + steps))
            steps += 1
        return least_deg


def make_setpoints(joint: Joint, position_deg: float, limits: ServoLimits) -> Setpoints | None:
    """Return the filter of a joint whose servo stands at `position_deg`; None if it has none."""
    if joint.drive != "streamed":
        return None
    return Setpoints(position_deg, count=joint.filter_count, limits=limits)


def closing_deg(off_deg: float, limits: ServoLimits) -> float:
    """Return by how much the next step goes further than the plan, to close up on it.

    No further than it can brake from before it is there.
    """
    less_deg = CLOSING_RATIO * _step_gain_deg(limits)
    most_deg = less_deg * (math.sqrt(0.25 + 2.0 * abs(off_deg) / less_deg) - 0.5)
    return math.copysign(min(most_deg, CLOSING_GAIN * abs(off_deg)), off_deg)


def _step_gain_deg(limits: ServoLimits) -> float:
    """Return by how much the acceleration limit lets a step differ from the last one."""
    return limits.ramp_deg_s2 * limits.response.filter_s * limits.response.filter_s


POINTS_MAX: Final = 1000
"""Chosen: one for every pixel of a wide picture."""


@dataclass(slots=True)
class Trace:
    """Readings that were believed, as `(seconds, planned angle, measured angle)` of the joint.

    Every `stride`-th is kept; when there are too many, every other one of those, so what is kept
    always covers the whole show evenly.
    """

    points: list[tuple[float, float, float]] = field(default_factory=list)
    stride: int = 1
    _count: int = 0

    def add(self, at_s: float, planned_deg: float, measured_deg: float) -> None:
        """Take the next reading, at seconds since the start of the show, pauses included."""
        if self._count % self.stride == 0:
            self.points.append((at_s, planned_deg, measured_deg))
        self._count += 1
        if len(self.points) > POINTS_MAX:
            del self.points[1::2]
            self.stride *= 2


REST_DEG_S = 1.0
"""Slower than this a servo is at rest: what is left of a filter's way is below a wire unit."""
REST_DEG = 0.5
"""And a timed one no further than this from its target. Chosen: what braking from that speed takes,
with room for what a lost move leaves."""
LONGEST_NS = ns_from_s(s_from_ms(DURATION_MAX_MS))
HISTORY_S = 2.0
"""How long what the profile did is kept: longer than any answer may take."""


class DeferredTarget(NamedTuple):
    """A target that a joint is to be told again."""

    resend_ns: int
    target_deg: float
    travel_deg_s: float = math.inf
    """How fast it is to go there, for a joint that is told so."""


@dataclass(slots=True)
class JointState:
    """One joint. Angles are servo degrees; instants are of the run clock.

    `plan` is the profile over show time if all goes well; `profile` is the profile over run time
    after all that was really sent.
    """

    joint: Joint
    plan: PiecewiseProfile
    profile: ServoProfile
    disturbance: DisturbanceEstimator
    limits: ServoLimits
    lead_s: float
    origin_s: float = 0.0
    """When the show time was 0, on the run clock."""
    active: Move | None = None
    """The move of the program that is under way, or was last."""
    deferred: DeferredTarget | None = None
    """When to say which target again, because the speed limit did not let it be said at once."""
    setpoints: Setpoints | None = None
    """What the filter of a streamed joint makes of its targets."""
    guide_ns: int | None = None
    """When a streamed joint that is off its program is told next where to go; None: it is on it."""
    last_arrival_ns: int | None = None
    """When the servo heard its last move."""
    resent: int = 0
    """How often it was told again what it had missed."""
    status: Status | None = None
    temperature_max_c: float | None = None
    voltage_min_v: float | None = None
    current_max_a: float | None = None
    visited_ns: int | None = None
    """When it was last the turn of its servo to be asked."""
    health_ns: int | None = None
    health_count: int = 0
    """When it was last asked how it fares, and how often."""
    lost_moves: LostMoveDetector | None = None
    """What its servo may have missed; None: nobody judges that."""
    lag: LagEstimator = field(default_factory=LagEstimator)
    early_s: float = 0.0
    """By how much its moves leave earlier than the program says, for its lag. A joint in EM0 keeps
    it while it moves: an instant that creeps past a step of the filter, and nobody knows when it
    steps, leaves out a target or uses one twice, which is more than the acceleration allows."""
    trace: Trace = field(default_factory=Trace)
    is_driven: bool = True
    """Whether it is sent moves: not while nobody knows what its servo would make of them."""

    def stand_at(self, position_deg: float) -> None:
        """Note that the servo stands at `position_deg`, wherever it was before."""
        self.profile = make_profile(self.joint, position_deg, origin_s=self.origin_s)
        self.deferred = self.guide_ns = None
        self.setpoints = make_setpoints(self.joint, position_deg, self.limits)
        self.disturbance.stand_at(position_deg)

    def leave_program(self, now_ns: int) -> None:
        """Note that moves made on the spot take the place of the program's: the rate is not 1.

        What a timed joint is owed of the program is over; a streamed one is led from now on.
        """
        if self.joint.drive == "timed":
            self.deferred = None
        elif self.joint.drive == "streamed" and self.is_driven and self.guide_ns is None:
            self.guide_ns = now_ns

    def take_over(self, earlier: JointState) -> None:
        """Take over what was learnt about the same joint: what pulls at it, and how it lags."""
        self.lag, self.early_s = earlier.lag, earlier.lag.extra_s
        if self.lost_moves is not None and earlier.lost_moves is not None:
            self.lost_moves.mismatches = earlier.lost_moves.mismatches
        self.disturbance.estimate_deg = earlier.disturbance.estimate_deg
        self.disturbance.offset_deg = earlier.disturbance.offset_deg

    def place(self, arrival_ns: int) -> tuple[float, float]:
        """Return position and speed of the profile at `heard_ns`, after all that was sent."""
        return self.profile.at(s_from_ns(arrival_ns))

    def is_at_rest(self, now_ns: int) -> bool:
        """Return whether its servo should have come to rest; after the longest T it has anyway.

        What is believed of one that took a garbled word for its target may be that it goes on.
        """
        if self.last_arrival_ns is not None and now_ns - self.last_arrival_ns > LONGEST_NS:
            return True
        position_deg, speed_deg_s = self.place(now_ns)
        if isinstance(self.profile, Profile):  # Where it turns round, it is slow as well.
            off_deg = abs(position_deg - self.profile.target_deg)
            return abs(speed_deg_s) < REST_DEG_S and off_deg < REST_DEG
        return abs(speed_deg_s) < REST_DEG_S

    def wire_for(self, target_deg: float, arrival_ns: int) -> int:
        """Return the wire value next to `target_deg` plus the correction, inside the range.

        A timed move keeps the speed limit by its T, the others by their target: what it takes off
        is owed, to be said again when the servo has come that far, or led to (`lead`).
        """
        corrected = target_deg + self.disturbance.offset_deg
        wire = nearest_wire(corrected, self.limits)
        low_deg, high_deg = self._reach(arrival_ns)
        allowed = nearest_wire(min(max(corrected, low_deg), high_deg), self.limits)
        is_held_back = allowed != wire
        if isinstance(self.profile, FilterProfile):
            next_s = self.profile.receive_s(self.profile.acts_on(s_from_ns(arrival_ns)) + 1)
            self.guide_ns = ns_from_s(next_s) if is_held_back else None
        else:
            resend_ns = arrival_ns + ns_from_s(PULSE_S)
            self.deferred = DeferredTarget(resend_ns, target_deg) if is_held_back else None
        return allowed

    @property
    def resend_ns(self) -> int | None:
        """When it is to be told something again, whatever the program says."""
        return self.guide_ns if self.deferred is None else self.deferred.resend_ns

    def _reach(self, arrival_ns: int) -> tuple[float, float]:
        """Return between which targets the limits allow one."""
        arrival_s = s_from_ns(arrival_ns)
        if self.setpoints is not None:
            return self.setpoints.allowed(arrival_s)
        if self.joint.drive == "timed":
            return self.limits.position_min_deg, self.limits.position_max_deg
        passed_s = (
            PULSE_S if self.last_arrival_ns is None else arrival_s - s_from_ns(self.last_arrival_ns)
        )
        reach_deg = self.limits.speed_max_deg_s * min(passed_s, 2.0 * PULSE_S)
        reach_deg += self.joint.unit_deg
        position_deg, _ = self.profile.at(arrival_s)
        return position_deg - reach_deg, position_deg + reach_deg

    def begun_s(self, line: SerialLine) -> float:
        """Return the show time at which the move under way is heard if all goes well."""
        assert self.active is not None
        return s_from_us(received_us(self.active, line.bus.baud_bps))

    def left_s(self, line: SerialLine, clock: ShowClock, now_ns: int) -> float:
        """Return how much run time is left to the move under way if it is sent now; 0 if no T."""
        move = self.active
        if move is None or move.duration_ms is None:
            return 0.0
        end_s = self.begun_s(line) + s_from_ms(move.duration_ms)
        arrival_ns = line.arrival_ns(len(move.data), now_ns)
        return (end_s - clock.show_s(arrival_ns)) / clock.target_rate

    @property
    def target_deg(self) -> float:
        """The target of the move under way."""
        assert self.active is not None
        return self.active.target_wire / self.limits.wire_per_deg

    def send_active(self, line: SerialLine, left_s: float, now_ns: int) -> None:
        """Send the move under way, with `left_s` to travel."""
        self.send(line, self.target_deg, left_s, now_ns)

    def duration_for(self, target_wire: int, arrival_ns: int, left_s: float) -> int:
        """Return T: what is left, but never so short that the joint's speed limit breaks."""
        target_deg = target_wire / self.limits.wire_per_deg
        position_deg, _ = self.place(arrival_ns)
        least_s = abs(target_deg - position_deg) / self.limits.speed_max_deg_s
        return max(1, round(MS_PER_S * left_s), -int(-MS_PER_S * least_s // 1))

    def send(self, line: SerialLine, target_deg: float, left_s: float, now_ns: int) -> None:
        """Hand over the move to `target_deg` that has `left_s`, corrected and within the limits."""
        if not self.is_driven:
            return
        servo_id, is_timed = self.joint.servo_id, self.joint.drive == "timed"
        guess_ms = max(1, round(MS_PER_S * left_s)) if is_timed else None
        guess = encode_move(servo_id, round(target_deg * self.limits.wire_per_deg), guess_ms)
        arrival_ns = line.arrival_ns(len(guess), now_ns)
        target_wire = self.wire_for(target_deg, arrival_ns)
        duration_ms = self.duration_for(target_wire, arrival_ns, left_s) if is_timed else None
        data = encode_move(servo_id, target_wire, duration_ms)
        if self.guide_ns is not None:
            self.guide_ns -= line.time_ns(len(data))
        arrival_ns = line.send(data, now_ns)
        self.note_sent(arrival_ns, target_wire, duration_ms)

    def note_sent(self, arrival_ns: int, target_wire: int, duration_ms: int | None) -> None:
        """Note that the servo hears `D target [T duration]` at `heard_ns`."""
        arrival_s = s_from_ns(arrival_ns)
        duration_s = None if duration_ms is None else s_from_ms(duration_ms)
        target_deg = target_wire / self.limits.wire_per_deg
        if self.lost_moves is not None and isinstance(self.profile, Profile):
            self.lost_moves.commanded(self.profile.copy(), arrival_s, target_deg, duration_s)
        if self.setpoints is not None:
            self.setpoints.commanded(arrival_s, target_deg)
        self.profile.retarget(arrival_s, target_deg, duration_s)
        self.profile.forget_before(arrival_s - HISTORY_S)
        self.last_arrival_ns = arrival_ns


def make_joint_states(
    program: Program,
    robot: Robot,
    standing_deg: Mapping[str, float],
    origin_s: float,
    *,
    has_feedback: bool,
) -> dict[str, JointState]:
    """Return the track of every joint of `program`; its servo stands at `standing_deg`.

    `origin_s` is when the show time is 0, on the run clock.
    """
    joint_states = {}
    for name, plan in profiles(program, robot).items():
        joint, servo_deg = robot.joints[name], standing_deg[name]
        limits = servo_limits(joint, program.tolerance_deg)
        joint_states[name] = JointState(
            joint=joint,
            plan=plan,
            profile=make_profile(joint, servo_deg, origin_s=origin_s),
            setpoints=make_setpoints(joint, servo_deg, limits),
            disturbance=DisturbanceEstimator(
                speed_max_deg_s=joint.speed_max_deg_s, standing_deg=servo_deg
            ),
            limits=limits,
            lead_s=profile_lead_s(joint),
            origin_s=origin_s,
            lost_moves=LostMoveDetector(joint.unit_deg, joint.response.loop_s)
            if has_feedback
            else None,
        )
    return joint_states


MISSED_NS: Final = ns_from_s(LATEST_ARRIVAL_S)
"""A move that leaves later than this has been missed: its predecessor had begun to brake."""
LATEST_COMMANDS: Final = 100
BIN_BITS: Final = 7
"""A bin is narrower than a 2^-6 of its lateness: percentiles are right to 1.6 %. Chosen."""


@dataclass(slots=True)
class Statistics:
    """Lateness of every move, in ns behind the instant at which it was due to leave."""

    latest_ns: deque[int] = field(default_factory=lambda: deque(maxlen=LATEST_COMMANDS))
    """That of the last moves, for the display."""
    missed: int = 0
    max_ns: int = 0
    _bins: Counter[int] = field(default_factory=Counter, repr=False)
    """How many moves were so late, by the upper end of the bin in ns."""

    def sent(self, late_ns: int) -> None:
        late_ns = max(0, late_ns)
        self.latest_ns.append(late_ns)
        self.missed += late_ns > MISSED_NS
        self.max_ns = max(self.max_ns, late_ns)
        shift = max(0, late_ns.bit_length() - BIN_BITS)
        self._bins[late_ns >> shift << shift | ((1 << shift) - 1)] += 1

    def histogram_us(self) -> list[tuple[int, int]]:
        """Return how many moves were late by at most so many µs, and by more than the last."""
        counts: Counter[int] = Counter()
        for end_ns, count in self._bins.items():
            counts[1 << max(3, (end_ns // NS_PER_US).bit_length())] += count
        return sorted(counts.items())

    def timing(self) -> dict[str, int]:
        """Return the `timing` object of the report."""
        ends_ns = sorted(self._bins)
        sums = list(accumulate(self._bins[end_ns] for end_ns in ends_ns))
        count = sums[-1] if sums else 0

        def at_ratio(ratio: float) -> int:
            rank = int(ratio * count)
            above = (end_ns for end_ns, so_far in zip(ends_ns, sums, strict=True) if so_far > rank)
            return min(next(above, 0), self.max_ns)

        return {
            "commands": count,
            "missed": self.missed,
            "late_p50_us": at_ratio(0.5) // NS_PER_US,
            "late_p99_us": at_ratio(0.99) // NS_PER_US,
            "late_max_us": self.max_ns // NS_PER_US,
        }
