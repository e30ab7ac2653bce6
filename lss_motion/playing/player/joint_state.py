"""State of one joint while a program is played.

`JointState` holds what was sent to one servo, the response model after it, and what the readings
say. Only its methods change it.

Law: every target that leaves for a servo passes `JointState.send`, which keeps the limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

from msgspec.structs import replace

from lss_motion.planning.program.moves import nearest_wire
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS, servo_limits
from lss_motion.planning.program.streamed import PULSE_S, FilterProfile
from lss_motion.planning.program.verify import make_profile, profiles
from lss_motion.playing.player.estimators import (
    OFFSET_MAX_DEG,
    OFFSET_RATE_DEG_S,
    DisturbanceEstimator,
    Swing,
    Trace,
)
from lss_motion.playing.player.servo_model import (
    LostMoveDetector,
    Observation,
    ServoSettings,
    Setpoints,
    make_setpoints,
    step_gain_deg,
    with_room,
)
from lss_motion.playing.player.standing import PushDetector, StandingCorrector
from lss_motion.protocol.constants import status_from
from lss_motion.protocol.framing import encode_move
from lss_motion.robot.profile import Profile, profile_lead_s
from lss_motion.units import (
    MS_PER_S,
    NS_PER_S,
    NS_PER_US,
    US_PER_S,
    ns_from_s,
    s_from_ms,
    s_from_ns,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.planning.program.model import Move, Program
    from lss_motion.planning.program.reference_grid import ServoLimits
    from lss_motion.planning.program.response import PiecewiseProfile
    from lss_motion.planning.program.verify import ServoProfile
    from lss_motion.playing.player.query_tracker import SerialLine
    from lss_motion.playing.player.show_clock import ShowClock
    from lss_motion.protocol.constants import Status
    from lss_motion.robot.model import Joint, Robot


REST_DEG_S = 1.0
"""A slower servo is at rest: the filter has less than one wire unit left to go."""
REST_DEG = 0.5
"""A timed servo at rest is no further than this from its target. Chosen: the braking distance from
that speed, with room for the error after a lost move."""
LONGEST_NS = ns_from_s(s_from_ms(DURATION_MAX_MS))
RECENT_S: Final = (0.0, 0.08, 0.16, 0.25)
"""A horn that lags is still on its way so long after its profile. Chosen: three times the largest
lag that is corrected, and a ramp between the samples."""
SPARE_RATIO: Final = 0.9  # A joint faster than this share of its limit has no speed to spare.
STILL_S: Final = 0.25
STILL_DEG: Final = 0.05
"""A joint rests when its profile has moved by less than this for so long: half a unit of an LSS."""
STANDING_DEG_S: Final = 20.0
STANDING_LEAST_S: Final = 0.1
"""Speed and shortest T of a correction at rest. Chosen: gentle, and done before the next readings
are judged."""
RETRIES_MAX: Final = 12
"""One move is sent again so often. Chosen: half a line that loses every other command takes one in
4,000 as a servo that is stuck, and a stuck servo is given up after 2 s."""
HISTORY_S = 2.0
"""The profile is kept for this long: longer than any answer may take."""


class DeferredTarget(NamedTuple):
    """A target that is sent to a joint again later."""

    resend_ns: int
    target_deg: float
    travel_deg_s: float = math.inf
    """Travel speed of a timed joint on the way there."""


@dataclass(slots=True)
class JointState:
    """State of one joint. Angles are servo degrees; instants are on the run clock.

    `plan` is the profile over show time if nothing goes wrong; `profile` is the profile over run
    time after everything that was sent.
    """

    joint: Joint
    plan: PiecewiseProfile
    profile: ServoProfile
    disturbance: DisturbanceEstimator
    limits: ServoLimits
    lead_s: float
    range_deg: tuple[float, float]
    """The joint's own range. A servo that stood outside has wider limits, until it is back."""
    origin_s: float = 0.0
    """Instant of show time 0 on the run clock."""
    identify_command: str = ""
    """What measures its servo."""
    active: Move | None = None
    """The move of the program that is under way, or the last one."""
    deferred: DeferredTarget | None = None
    """The target that must be sent again; None: there is none. At first, the speed limit of a
    stepped joint, or the time that a timed one has left, did not allow it."""
    setpoints: Setpoints | None = None
    """Filter model of a streamed joint."""
    guide_ns: int | None = None
    """Instant of the next guiding target for a streamed joint that is off its program; None: it
    follows the program."""
    coarse_until: tuple[int, float] = 0, 0.0
    """Until which instant a coarse spot move leads, and for which rate of the show."""
    last_arrival_ns: int | None = None
    """Instant at which the servo received its last move."""
    resent: int = 0
    """Number of moves that were sent again because the servo had lost them."""
    _retries: int = 0
    """How often the move under way was sent again."""
    firmware: int | None = None
    """What the servo answered to QF before the show; None: nothing. Its status depends on it."""
    status: Status | None = None
    temperature_max_c: float | None = None
    voltage_min_v: float | None = None
    current_max_a: float | None = None
    health_ns: int | None = None
    """Instant of the last health query."""
    health_count: int = 0
    """Number of health queries so far."""
    lost_moves: LostMoveDetector | None = None
    """Detector of moves that the servo has lost; None: without feedback."""
    early_s: float = 0.0
    """By how much moves leave earlier than the program says, to make up for the lag. It does not
    change while a joint is at its speed limit, or while one in EM0 moves: a send instant that
    creeps past an unknown step of the filter skips a target or uses one twice."""
    settings: ServoSettings = field(init=False)
    """Whether the servo still has them; the scheduler that polls it sets and keeps them."""
    standing: StandingCorrector = field(default_factory=StandingCorrector)
    push: PushDetector = field(default_factory=PushDetector)
    _is_correcting: bool = False
    _is_approach: bool = False
    swing: Swing = field(default_factory=Swing)
    trace: Trace = field(default_factory=Trace)
    is_driven: bool = True
    """False while the servo's settings are unknown, or it is left out; no moves are sent."""
    in_doubt: bool = False
    """Whether the servo may have restarted: no moves are sent until its settings are known."""
    held_back: int = 0
    """Number of moves that were not sent since the servo was in doubt."""
    _has_missed: bool = False
    """Whether a move was held back since the doubt began."""
    _reports: list[set[str]] = field(default_factory=list)
    """What holds the name of this joint while it is sent targets besides the program's."""
    _spare_deg: float = 0.0
    """What the last jump of a stepped joint left of what it was allowed; less than 0: it was
    rounded up."""

    def __post_init__(self) -> None:
        self.settings = ServoSettings(self.joint)

    # ---- where the servo is

    def place(self, arrival_ns: int) -> tuple[float, float]:
        """Return position and speed of the profile at `arrival_ns`, after all that was sent."""
        return self.profile.at(arrival_ns / NS_PER_S)

    def predicted_deg(self, now_ns: int) -> float:
        """Return where the horn should be: the profile, late by its lag, less its load."""
        horn = self.disturbance.horn
        position_deg, _ = self.profile.at(s_from_ns(now_ns) - self.lead_s - horn.early_s)
        return position_deg - horn.load_deg(position_deg, self.swing.way)

    def is_at_rest(self, now_ns: int) -> bool:
        """Return whether the servo should have come to rest; true after the longest T in any case.

        A servo that reported a garbled target may be modelled as moving on for ever.
        """
        if self.last_arrival_ns is not None and now_ns - self.last_arrival_ns > LONGEST_NS:
            return True
        position_deg, speed_deg_s = self.place(now_ns)
        if isinstance(self.profile, Profile):  # A timed joint is slow where it reverses, too.
            off_deg = abs(position_deg - self.profile.target_deg)
            return abs(speed_deg_s) < REST_DEG_S and off_deg < REST_DEG
        return abs(speed_deg_s) < REST_DEG_S

    def stand_at(self, position_deg: float) -> None:
        """Note that the servo stands at `position_deg`, whatever was sent before."""
        self.profile = make_profile(self.joint, position_deg, origin_s=self.origin_s)
        self._resend_at()
        self.in_doubt = False
        self.setpoints = make_setpoints(self.joint, position_deg, self.limits)
        self.disturbance.stand_at(position_deg)

    def learn_droop(self, measured_deg: float, now_ns: int, within_deg: float) -> None:
        """Take the distance of a resting horn from its profile as its load, if it is small."""
        droop_deg = self.place(now_ns)[0] - measured_deg
        if abs(droop_deg) <= within_deg:
            self.disturbance.horn.rest(droop_deg, measured_deg)
            self.disturbance.aim(measured_deg, 0.0, math.inf)

    def limit_speed(self, speed_max_deg_s: float) -> None:
        """Send no faster move, also where a correction makes it longer; before the first one.

        It is for the way to the start, on which nothing is learnt before its end: where the
        profile of the servo began is not known exactly, since its load has moved the horn.
        """
        self._is_approach = True
        slower_deg_s = min(self.limits.speed_max_deg_s, speed_max_deg_s)
        self.limits = replace(self.limits, speed_max_deg_s=slower_deg_s)
        self.setpoints = make_setpoints(self.joint, self.place(0)[0], self.limits)

    def take_over(self, earlier: JointState) -> None:
        """Take over the estimates of load, lag and lost moves of the same joint."""
        self.early_s = earlier.disturbance.horn.early_s
        if self.lost_moves is not None and earlier.lost_moves is not None:
            self.lost_moves.take_over(earlier.lost_moves)
        self.disturbance.take_over(earlier.disturbance)

    # ---- what the program requires

    def begin_move(self, move: Move) -> None:
        """Note that `move` of the program is under way, whether it is sent or not."""
        self.active, self._retries = move, 0

    def leave_move(self) -> None:
        """Note that no move is under way: the show stands, and goes on from another place."""
        self.active = None
        self._resend_at()

    def extend_plan(self, later: PiecewiseProfile, keep_from_s: float) -> None:
        """Continue the plan with `later`; what was before `keep_from_s` is dropped."""
        self.plan = self.plan.followed_by(later, keep_from_s)

    def leave_program(self, guide_ns: int) -> None:
        """Drop the deferred target of a timed joint, and guide a streamed one from `guide_ns` on.

        The rate is not 1: spot moves take the place of the program's.
        """
        if self.joint.drive == "timed":
            self._resend_at()
        elif self.joint.drive == "streamed" and self.guide_ns is None and self.takes_moves:
            self._resend_at(guide_ns=guide_ns)

    def drive(self, *, is_driven: bool) -> None:
        """Send moves to the servo from now on, or none."""
        self.is_driven = is_driven
        if not is_driven:
            self._resend_at()

    def hold_back(self, *, has_missed: bool = False) -> None:
        """Send no move to the servo until `release`: it may have lost its limits, or its turn.

        `has_missed`: it needs a move already.
        """
        self.held_back += self.resend_ns is not None
        self.in_doubt = True
        self._has_missed |= has_missed or self.resend_ns is not None
        self._resend_at()

    def doubt(self, now_ns: int, count: int = 1) -> None:
        """Note a sign that the servo has restarted; several in a row hold its moves back."""
        if self.settings.note_sign(now_ns, count):
            self.hold_back()

    def take_probe(self, keyword: str, value: int | str | None) -> str | None:
        """Judge the answer to a probe; return the fault of a servo that has restarted."""
        fault, doubt = self.settings.take(keyword, value), self.settings.doubt
        if fault is not None or (doubt is not None and doubt.proofs):
            self.hold_back()
        return fault

    def release(self) -> bool:
        """Send moves to the servo again; return whether any was held back."""
        self.in_doubt, self._has_missed, had_missed = False, False, self._has_missed
        return had_missed

    def defer(self, resend_ns: int, target_deg: float, travel_deg_s: float = math.inf) -> None:
        """Send `target_deg` again at `resend_ns`; a timed joint then travels at `travel_deg_s`."""
        self._resend_at(deferred=DeferredTarget(resend_ns, target_deg, travel_deg_s))

    def lead_coarsely(self, until_ns: int, rate: float) -> None:
        """Note that a coarse spot move leads until then, at that rate of the show."""
        self.coarse_until = until_ns, rate

    def guide_at(self, guide_ns: int | None) -> None:
        """Send a streamed joint its next guiding target then; None: the program's moves again."""
        self._resend_at(guide_ns=guide_ns)

    def report_resends(self, resending: set[str]) -> None:
        """Keep the name of this joint in `resending` while it is sent targets of its own."""
        self._reports.append(resending)
        self._resend_at(self.deferred, self.guide_ns)

    def _resend_at(
        self, deferred: DeferredTarget | None = None, guide_ns: int | None = None
    ) -> None:
        """Let this be what the joint is sent besides the program's moves, and report it."""
        self.deferred, self.guide_ns = deferred, guide_ns
        for resending in self._reports:
            if deferred is None and guide_ns is None:
                resending.discard(self.joint.name)
            else:
                resending.add(self.joint.name)

    def may_retry(self) -> bool:
        """Count that the servo has lost the move under way; false if that was too often.

        Then it is stuck, or off, and its profile is what its readings say. A streamed joint is
        guided to the target: no move is sent again.
        """
        self._retries += 1
        if self._retries > RETRIES_MAX:
            return False
        self.resent += self.joint.drive != "streamed"
        return True

    @property
    def takes_moves(self) -> bool:
        """Whether the servo is sent moves."""
        return self.is_driven and not self.in_doubt

    @property
    def resend_ns(self) -> int | None:
        """Instant at which a target must be sent besides the program's; None: there is none."""
        return self.guide_ns if self.deferred is None else self.deferred.resend_ns

    @property
    def target_deg(self) -> float:
        """Target of the move under way."""
        assert self.active is not None
        return self.active.target_wire / self.limits.wire_per_deg

    def begun_s(self, line: SerialLine) -> float:
        """Return the show time at which the move under way arrives if it is sent on time."""
        assert self.active is not None
        time_ns = line.times_ns[len(self.active.data)]  # As `received_us`, from the table.
        return (self.active.due_us + time_ns // NS_PER_US) / US_PER_S

    def left_s(self, line: SerialLine, clock: ShowClock, now_ns: int) -> float:
        """Return the run time left to the move under way if it is sent now; 0 if it has no T."""
        move = self.active
        if move is None or move.duration_ms is None:
            return 0.0
        end_s = self.begun_s(line) + move.duration_ms / MS_PER_S
        arrival_ns = line.arrival_ns(len(move.data), now_ns)
        return (end_s - clock.show_s(arrival_ns)) / clock.target_rate

    # ---- sending

    def send_active(self, line: SerialLine, left_s: float, now_ns: int) -> None:
        """Send the move under way, with `left_s` to travel."""
        self.send(line, self.target_deg, left_s, now_ns)

    def send(self, line: SerialLine, target_deg: float, left_s: float, now_ns: int) -> None:
        """Send the move to `target_deg`, corrected and within the limits, with `left_s` to travel.

        While the joint is not driven or in doubt, nothing is sent.
        """
        if self.in_doubt or not self.is_driven:
            self._has_missed |= self.in_doubt
            self.held_back += self.in_doubt
            return
        servo_id, is_timed = self.joint.servo_id, self.joint.drive == "timed"
        guess_ms = max(1, round(MS_PER_S * left_s)) if is_timed else None
        guess = encode_move(servo_id, round(target_deg * self.limits.wire_per_deg), guess_ms)
        arrival_ns = line.arrival_ns(len(guess), now_ns)
        target_wire = self.wire_for(target_deg, arrival_ns)
        duration_ms = self.duration_for(target_wire, arrival_ns, left_s) if is_timed else None
        data = encode_move(servo_id, target_wire, duration_ms)
        if self.guide_ns is not None:
            self.guide_at(self.guide_ns - line.time_ns(len(data)))
        arrival_ns = line.send(data, now_ns)
        self.note_sent(arrival_ns, target_wire, duration_ms)

    def halt(self, line: SerialLine, now_ns: int) -> None:
        """Brake within the limits, and expect no target that was deferred.

        A timed joint is sent the nearest place where it can stop. The others have stopped at
        their last target.
        """
        self._resend_at()
        if self.joint.drive != "timed" or self.active is None:
            return
        arrival_ns = line.arrival_ns(len(self.active.data), now_ns)
        position_deg, speed_deg_s = self.place(arrival_ns)
        if abs(speed_deg_s) < REST_DEG_S:
            return
        way_deg = 0.5 * speed_deg_s * abs(speed_deg_s) / self.limits.ramp_deg_s2
        way_deg += speed_deg_s * self.joint.response.loop_s
        target_deg = position_deg + way_deg - self.disturbance.offset_deg
        self.send(line, target_deg, abs(way_deg / speed_deg_s), now_ns)

    def wire_for(self, target_deg: float, arrival_ns: int) -> int:
        """Return the wire value next to `target_deg` plus the correction, within the limits.

        A timed move keeps the speed limit by its T, other moves by their target. If the limits cut
        a target, it is deferred until the servo has come that far, or the joint is guided to it.
        """
        corrected = target_deg + self.disturbance.offset_deg
        wire = allowed = nearest_wire(corrected, self.limits)
        if self.joint.drive != "timed":
            low_deg, high_deg = self._reach(arrival_ns)
            allowed = nearest_wire(min(max(corrected, low_deg), high_deg), self.limits)
        if allowed == wire:
            if self.deferred is not None or self.guide_ns is not None:
                self._resend_at()
        elif isinstance(self.profile, FilterProfile):
            next_s = self.profile.receive_s(self.profile.acts_on(s_from_ns(arrival_ns)) + 1)
            self.guide_at(ns_from_s(next_s))
        else:
            self.defer(arrival_ns + ns_from_s(PULSE_S), target_deg)
        return allowed

    def _reach(self, arrival_ns: int) -> tuple[float, float]:
        """Return the least and largest target that the limits allow at `arrival_ns`; not timed."""
        arrival_s = s_from_ns(arrival_ns)
        if self.setpoints is not None:
            return self.setpoints.allowed(arrival_s)
        position_deg, _ = self.profile.at(arrival_s)
        reach_deg = max(self._jump_deg(arrival_ns), 0.0)
        return position_deg - reach_deg, position_deg + reach_deg

    def _jump_deg(self, arrival_ns: int) -> float:
        """Return how far a stepped joint may jump at `arrival_ns`.

        It has what its speed allows since its last jump, and what that one left: no more than two
        pulses and one unit. So what whole degrees round up is made up for by the next jump.
        """
        speed_deg_s, unit_deg = self.limits.speed_max_deg_s, self.joint.unit_deg
        if self.last_arrival_ns is None:
            return speed_deg_s * PULSE_S + unit_deg
        passed_s = s_from_ns(arrival_ns - self.last_arrival_ns)
        most_deg = speed_deg_s * 2.0 * PULSE_S + unit_deg
        return min(self._spare_deg + speed_deg_s * passed_s, most_deg)

    def duration_for(self, target_wire: int, arrival_ns: int, left_s: float) -> int:
        """Return T in ms: `left_s`, but never so short that the joint exceeds its speed limit."""
        target_deg = target_wire / self.limits.wire_per_deg
        position_deg, _ = self.place(arrival_ns)
        least_s = abs(target_deg - position_deg) / self.limits.speed_max_deg_s
        return max(1, round(MS_PER_S * left_s), -int(-MS_PER_S * least_s // 1))

    def note_sent(self, arrival_ns: int, target_wire: int, duration_ms: int | None) -> None:
        """Note that the servo receives `D target [T duration]` at `arrival_ns`."""
        arrival_s = arrival_ns / NS_PER_S
        duration_s = None if duration_ms is None else duration_ms / MS_PER_S
        target_deg = target_wire / self.limits.wire_per_deg
        if self.lost_moves is not None and isinstance(self.profile, Profile):
            self.lost_moves.commanded(self.profile.copy(), arrival_s, target_deg, duration_s)
        if not self._is_correcting:
            self.standing.begin()
        if self.setpoints is not None:
            self.setpoints.commanded(arrival_s, target_deg)
        if self.joint.drive == "stepped":
            way_deg = abs(target_deg - self.profile.at(arrival_s)[0])
            self._spare_deg = self._jump_deg(arrival_ns) - way_deg
        self.profile.retarget(arrival_s, target_deg, duration_s)
        self.profile.forget_before(arrival_s - HISTORY_S)
        self.last_arrival_ns = arrival_ns
        self._narrow(target_deg)

    def _narrow(self, target_deg: float) -> None:
        """Let no target lead out of the range again, no further than the last one does."""
        limits, (least_deg, most_deg) = self.limits, self.range_deg
        if limits.position_min_deg < least_deg or limits.position_max_deg > most_deg:
            self.limits = replace(
                limits,
                position_min_deg=min(max(limits.position_min_deg, target_deg), least_deg),
                position_max_deg=max(min(limits.position_max_deg, target_deg), most_deg),
            )

    # ---- queries and answers

    def note_health_query(self, now_ns: int) -> None:
        """Note a query about the servo's health."""
        self.health_ns = now_ns
        self.health_count += 1

    @property
    def target_due_ns(self) -> float:
        """Instant from which the servo must be polled for its target, or infinite."""
        return math.inf if self.lost_moves is None else self.lost_moves.target_due_ns

    def note_target_query(self) -> None:
        """Note that the servo is polled for its target."""
        assert self.lost_moves is not None
        self.lost_moves.count_target_query()

    def take_target(self, target_deg: float, arrival_s: float) -> bool:
        """Use the target that the servo reported; it received the query at `arrival_s`.

        Return whether it has lost a move. Then `profile` is the one that it really follows.
        """
        assert self.lost_moves is not None
        other = self.lost_moves.target_reported(arrival_s, target_deg)
        if other is not None:
            self.profile = other
        return other is not None

    def observe(self, measured_deg: float, read_s: float, planned_deg: float) -> Observation | None:
        """Use the horn angle that was measured at `read_s`; None: it was rejected."""
        assert self.lost_moves is not None
        horn, before_deg = self.disturbance.horn, self.disturbance.measured_deg
        course_s = read_s - self.lead_s - horn.early_s
        expected_deg, speed_deg_s = self.profile.at(course_s)
        self.swing.take(expected_deg)
        free_deg = measured_deg + horn.load_deg(expected_deg, self.swing.way)
        other = self.lost_moves.judge(course_s, expected_deg, free_deg, speed_deg_s)
        elapsed_s = self.disturbance.take(
            measured_deg, read_s, expected_deg=expected_deg, planned_deg=planned_deg
        )
        if elapsed_s is None:
            return None
        if other is not None:
            self.profile = other
        elif not (self.lost_moves.is_doubtful or self.in_doubt):
            self._learn(measured_deg, read_s, elapsed_s, before_deg)
        joint_deg, load = self.joint.joint_deg, self.disturbance
        self.trace.add(read_s - self.origin_s, joint_deg(planned_deg), joint_deg(measured_deg))
        return Observation(other is not None, load.error_deg, load.model_error_deg)

    def _learn(
        self, measured_deg: float, read_s: float, elapsed_s: float, before_deg: float | None
    ) -> None:
        """Learn from an accepted reading; `before_deg` is the one before."""
        horn = self.disturbance.horn
        course_s = read_s - self.lead_s - horn.lag_s
        plain_deg, plain_deg_s = self.profile.at(read_s - self.lead_s)
        lagged_deg, speed_deg_s = self.profile.at(course_s)
        # The largest speed of the profile of late, 0 if it rests.
        recent_deg_s = max([abs(self.profile.at(course_s - ago_s)[1]) for ago_s in RECENT_S])
        noise_deg = math.sqrt(horn.noise_deg2)
        if not self._is_approach:
            near = [self.profile.at(course_s + by_s)[0] for by_s in (-horn.late_s, horn.late_s)]
            free_deg = horn.free_deg(lagged_deg, *near) if recent_deg_s else (0.0, 0.0)
            load_deg = horn.load_deg(lagged_deg, self.swing.way)
            off_deg = measured_deg + load_deg - lagged_deg
            if self.push.take(off_deg, load_deg, read_s, noise_deg, free_deg):
                horn.doubt()
            is_pushed = self.push.is_pushed
            if not is_pushed and (self.disturbance.offset_deg or self.early_s):
                without_deg = plain_deg - measured_deg
                effect_deg = without_deg - self.disturbance.error_deg
                horn.judge_effect(without_deg, effect_deg, elapsed_s)
            if before_deg is not None:  # It may still be on its way, whatever its profile does.
                moved_deg = self.disturbance.moved_deg - 3.0 * noise_deg
                recent_deg_s = max(recent_deg_s, moved_deg / elapsed_s)
            course = plain_deg, lagged_deg, speed_deg_s, recent_deg_s
            horn.take(measured_deg, course, self.swing.way, elapsed_s, is_pushed=is_pushed)
        self.disturbance.note_estimate(lagged_deg, self.swing.way)
        if self._may_shift(plain_deg_s, recent_deg_s):
            self.early_s = horn.early_s
        if self._is_settled(read_s) and before_deg is not None:
            horn.note_scatter(measured_deg - before_deg, elapsed_s)
            self.standing.take(self.disturbance.error_deg, read_s, math.sqrt(horn.noise_deg2))
        if self.setpoints is not None:
            self._correct(lagged_deg, self.swing.way, elapsed_s)

    def _may_shift(self, speed_deg_s: float, recent_deg_s: float) -> bool:
        """Return whether moves may leave earlier or later from now on.

        In motion not by less than half a control tick, which only shifts their phase.
        """
        may_shift = abs(speed_deg_s) < REST_DEG_S
        if self.setpoints is None:
            change_s = abs(self.disturbance.horn.early_s - self.early_s)
            has_speed = recent_deg_s < SPARE_RATIO * self.limits.speed_max_deg_s
            may_shift = has_speed and (may_shift or change_s >= 0.5 * self.joint.response.loop_s)
        return may_shift and not self.joint.is_shared

    def may_stand(self, now_s: float) -> bool:
        """Return whether the last move is so long ago that the servo may be at rest."""
        last_ns = self.last_arrival_ns
        return last_ns is None or now_s - (last_ns / NS_PER_S + self.lead_s) >= STILL_S

    def _is_settled(self, read_s: float) -> bool:
        """Return whether the servo was at rest at `read_s` and for a while before."""
        if not self.may_stand(read_s):
            return False
        course_s = read_s - self.lead_s - max(self.disturbance.horn.lag_s, 0.0)
        now_deg, speed_deg_s = self.profile.at(course_s)
        then_deg, _ = self.profile.at(course_s - STILL_S)
        return abs(now_deg - then_deg) < STILL_DEG and abs(speed_deg_s) < STILL_DEG / STILL_S

    def aim(self, duration_s: float, now_ns: int) -> None:
        """Set the correction for the move under way, which has `duration_s` to travel."""
        if self.setpoints is None:
            target_deg = self.target_deg
            way_deg = target_deg + self.disturbance.offset_deg - self.place(now_ns)[0]
            self._correct(target_deg, self.swing.way_of(way_deg), duration_s)

    def _correct(self, target_deg: float, way: float, duration_s: float) -> None:
        """Move the correction towards what is known of load and play, as far as that is sure."""
        if self.joint.is_shared:
            return
        share = self.swing.share(self.disturbance.horn.half_play_deg)
        self.disturbance.aim(target_deg, way, OFFSET_RATE_DEG_S * duration_s, share)

    @property
    def finding(self) -> str:
        """What is wrong with the model of the servo, and the remedy; empty: nothing is."""
        text = self.disturbance.horn.finding
        if not text and self.disturbance.offset_max_deg >= OFFSET_MAX_DEG:
            text = f"its load pulls it by {OFFSET_MAX_DEG:g} deg or more"
        remedy = f"measure it: {self.identify_command} ; with --from LOG a show's log is enough"
        return f"joint {self.joint.name!r}: {text}; {remedy}" if text else ""

    def standing_offset_deg(self, now_ns: int) -> float | None:
        """Return the correction that a joint at rest needs in place of its own; None: none."""
        if self.joint.is_shared or self.push.is_pushed or not self._is_settled(s_from_ns(now_ns)):
            return None
        horn, offset_deg = self.disturbance.horn, self.disturbance.offset_deg
        noise_deg, is_modelled = math.sqrt(horn.noise_deg2), horn.model_ratio > 0.5
        return self.standing.next_offset_deg(
            offset_deg, s_from_ns(now_ns), noise_deg, is_modelled=is_modelled
        )

    def correct_standing(
        self, line: SerialLine, offset_deg: float, planned_deg: float, now_ns: int
    ) -> None:
        """Send a joint that rests on `planned_deg` there again, with another correction."""
        way_deg = abs(offset_deg - self.disturbance.offset_deg)
        self.disturbance.correct(offset_deg)
        self._is_correcting = True
        self.send(line, planned_deg, max(way_deg / STANDING_DEG_S, STANDING_LEAST_S), now_ns)
        self._is_correcting = False
        self.standing.await_rest()

    def note_health(self, keyword: Literal["Q", "QT", "QV", "QC"], value: float) -> None:
        """Keep the status, the highest temperature and current, the lowest voltage."""
        match keyword:
            case "Q":  # Firmware versions number them differently.
                self.status = status_from(int(value), self.joint.model.family, self.firmware)
            case "QT":
                self.temperature_max_c = max(value, self.temperature_max_c or value)
            case "QV":
                self.voltage_min_v = min(value, self.voltage_min_v or value)
            case "QC":
                self.current_max_a = max(value, self.current_max_a or 0.0)


def make_joint_states(
    program: Program,
    robot: Robot,
    standing_deg: Mapping[str, float],
    origin_s: float,
    *,
    has_feedback: bool,
) -> dict[str, JointState]:
    """Return the state of every joint of `program`; its servo stands at `standing_deg`.

    `origin_s` is the instant of show time 0 on the run clock.
    """
    robot, own_joints = with_room(robot, standing_deg), robot.joints
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
                speed_max_deg_s=joint.speed_max_deg_s,
                standing_deg=servo_deg,
                step_max_deg=CORRECTION_RATIO * joint.filter_count * step_gain_deg(limits)
                if joint.drive == "streamed"
                else math.inf,
            ),
            limits=limits,
            lead_s=profile_lead_s(joint),
            range_deg=own_joints[name].servo_range_deg,
            origin_s=origin_s,
            identify_command=robot.identify_command(name),
            lost_moves=LostMoveDetector(joint.unit_deg, joint.response.loop_s)
            if has_feedback
            else None,
        )
    return joint_states


CORRECTION_RATIO: Final = 0.25
"""Share of the acceleration of a joint in EM0 that one reading may use; the plan needs most of it.
Chosen: a wrong reading that was believed took a joint beyond its limit."""
