"""The careful run of one joint: it moves a little, slowly, and is compared with what is expected.

A joint turns `WAY_DEG` out and back three times (`make_legs`). Of the settings that shape a move
(SD, T, AA, AD), each limits one of the first four legs: the leg has the expected speed only if the
servo counts this setting in the unit of the documents. If it does not, another setting still limits
the speed to `SPEED_RATIO` of that of the joint. The last two legs are as in a show, slower.
`judgement` compares the readings of one leg with its `Course`.

`CarefulRun` is a `JointRun`. It holds the joint where it is, then drives the legs. While the joint
moves, every reading must be near the course of its leg. A servo whose angles, speeds and ramps all
have another unit reports the way that is expected and turns another; so its angle as a pulse (QP),
or for an LSS-PRO its speed (QWD), is compared as well. After two readings in a row that deviate,
the servo is halted (H, which has no unit). However it ends, the settings are given back and the
joint holds.
"""

from __future__ import annotations

import math
from collections import deque
from statistics import median
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.maintenance.identify.joint_run import ExperimentState, JointRun
from lss_motion.maintenance.identify.trials import MotionWindow, PlannedMove, TrialKind, TrialPlan
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS
from lss_motion.playing.player import handshake
from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.playing.player.handshake import Item, SettingsDialogue
from lss_motion.protocol.codec import language_table, make_command
from lss_motion.protocol.constants import PULSE_MAX_US, PULSE_MIN_US
from lss_motion.protocol.framing import Command
from lss_motion.robot.profile import Piece, ramp_setting_deg_s2, travel_speed
from lss_motion.robot.servo_models import ramp_of_steps, ramp_steps
from lss_motion.units import MS_PER_S, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.maintenance.identify.joint_run import PolledReading
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.model import Joint, Robot


WAY_DEG: Final = 5.0
"""A small move. Chosen: fifty times the scatter of a reading (FACTS.md E7), five times the backlash
of worn gears, and less than what brings a limb into contact with another in a pose of rest."""
WAY_LEAST_DEG: Final = 1.0
"""In a shorter move, scatter and backlash hide the speed."""
MARGIN_DEG: Final = 0.5
"""Distance that is kept from the end of the range."""
SPEED_RATIO: Final = 0.2
"""No leg is faster than this share of the joint's speed limit, nor than the approach speed."""
SLOWER_RATIO: Final = 0.25
"""Speed of the legs that one setting limits, as a share of what the others allow. Chosen: a unit
that is 10 times as large, or as small, changes the speed by 4 or 10, which no load does."""
SLOW_LEG_S: Final = 2.0
"""A slow joint turns less than `WAY_DEG`, so that a leg does not last much longer than this."""
GENTLE_RATIO: Final = 1.0 / 9.0
"""Ramp of the legs that test it, in units of speed² / way: a third of the speed is reached."""
JUDGED: Final = (0.2, 0.8)
"""The part of the way over which the speed is measured, as shares of it: without backlash and
without the end, where a load slows the horn."""
ARRIVED_RATIO: Final = 0.6
"""A horn that turned less than this share of its way is blocked: backlash and load take less."""
SCATTER_DEG: Final = 0.2
"""Scatter of two readings (FACTS.md E7): at a low speed, it hides the lag."""
RATIO_MAX: Final = 1.7
"""A horn whose speed is within 1/1.7 and 1.7 times what is expected has the right units. Chosen: a
loaded servo and other ramps make 1.3 (measured), a wrong unit at least 2.5."""


class Course(Struct, frozen=True):
    """A profile from rest to rest over `way_deg`, from its start on; magnitudes above 0."""

    way_deg: float
    speed_deg_s: float
    accel_deg_s2: float
    decel_deg_s2: float

    @property
    def peak_deg_s(self) -> float:
        """The highest speed."""
        both = self.accel_deg_s2 * self.decel_deg_s2 / (self.accel_deg_s2 + self.decel_deg_s2)
        return min(self.speed_deg_s, math.sqrt(2.0 * both * self.way_deg))

    @property
    def duration_s(self) -> float:
        """When it rests."""
        peak = self.peak_deg_s
        ramps_deg = 0.5 * peak * peak * (1.0 / self.accel_deg_s2 + 1.0 / self.decel_deg_s2)
        cruise_s = (self.way_deg - ramps_deg) / peak
        return cruise_s + peak / self.accel_deg_s2 + peak / self.decel_deg_s2

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the angle from the start, and the speed."""
        peak, left_s = self.peak_deg_s, self.duration_s - time_s
        if time_s <= 0.0:
            return 0.0, 0.0
        if left_s <= 0.0:
            return self.way_deg, 0.0
        if time_s < peak / self.accel_deg_s2:
            return 0.5 * self.accel_deg_s2 * time_s**2, self.accel_deg_s2 * time_s
        if left_s < peak / self.decel_deg_s2:
            return (
                self.way_deg - 0.5 * self.decel_deg_s2 * left_s**2,
                self.decel_deg_s2 * left_s,
            )
        return peak * (time_s - 0.5 * peak / self.accel_deg_s2), peak

    def time_s(self, angle_deg: float) -> float:
        """Return when it is at `angle_deg`, between its ends."""
        peak, left_deg = self.peak_deg_s, self.way_deg - angle_deg
        if angle_deg <= 0.5 * peak**2 / self.accel_deg_s2:
            return math.sqrt(2.0 * angle_deg / self.accel_deg_s2)
        if left_deg <= 0.5 * peak**2 / self.decel_deg_s2:
            return self.duration_s - math.sqrt(2.0 * left_deg / self.decel_deg_s2)
        return angle_deg / peak + 0.5 * peak / self.accel_deg_s2


class CarefulMove(Struct, frozen=True, kw_only=True):
    """One move from rest to rest. Servo degrees."""

    tests: str
    """The setting whose unit it tests; empty: it is as in a show."""
    start_deg: float
    target_deg: float
    duration_ms: int
    settings: dict[str, float]
    """The settings of the session by keyword, in physical units."""
    course: Course

    @property
    def sign(self) -> float:
        """The direction of the move."""
        return math.copysign(1.0, self.target_deg - self.start_deg)


def way_of(joint: Joint, robot: Robot, standing_deg: float) -> float:
    """Return by how many servo degrees the joint turns, towards the end that is further away.

    0: its range has no room for a move that shows anything. Raises `InputError` for a joint that
    stands outside of its range.
    """
    ends = joint.servo_range_deg
    if not ends[0] - MARGIN_DEG <= standing_deg <= ends[1] + MARGIN_DEG:
        raise InputError(
            f"joint {joint.name!r} stands at {joint.joint_deg(standing_deg):.1f} deg, outside of "
            f"its range of {joint.position_min_deg:g} to {joint.position_max_deg:g} deg, where no "
            f"careful move begins. Bring it inside by hand while it is limp, or see whether "
            f"`zero_deg` and `direction` are right (lss-motion calibrate)",
            path=robot.path,
            line=joint.lines.get("range_deg"),
        )
    room_deg = max(standing_deg - ends[0], ends[1] - standing_deg) - MARGIN_DEG
    slow_deg = max(SLOW_LEG_S * SLOWER_RATIO * top_deg_s(joint, robot), WAY_LEAST_DEG)
    way_deg = min(WAY_DEG, slow_deg, room_deg)
    if way_deg < WAY_LEAST_DEG:
        return 0.0
    return way_deg if ends[1] - standing_deg >= standing_deg - ends[0] else -way_deg


def top_deg_s(joint: Joint, robot: Robot) -> float:
    """Return the highest speed of the joint in a careful run."""
    return min(SPEED_RATIO * joint.speed_max_deg_s, robot.approach_speed_deg_s)


def make_legs(joint: Joint, robot: Robot, standing_deg: float, way_deg: float) -> list[CarefulMove]:
    """Return the legs of a joint: out and back three times, by `way_deg` (servo degrees)."""
    top = top_deg_s(joint, robot)
    ramp = ramp_setting_deg_s2(joint)
    steps = ramp_steps(joint.model, GENTLE_RATIO * top * top / abs(way_deg), 1.0)
    gentle = min(ramp_of_steps(joint.model, max(steps, 1)), ramp)
    slow = SLOWER_RATIO * top
    plans = (
        ("SD", slow, top, ramp, ramp),
        ("T", top, slow, ramp, ramp),
        ("AA", top, top, gentle, ramp),
        ("AD", top, top, ramp, gentle),
        ("", top, top, ramp, ramp),
        ("", top, top, ramp, ramp),
    )
    legs = []
    for number, (tests, limit, travel, accel, decel) in enumerate(plans):
        ends = (standing_deg, standing_deg + way_deg)
        start_deg, target_deg = ends[:: -1 if number % 2 else 1]
        settings = {"EM": 1.0, "AA": accel, "AD": decel, "SD": _settable(joint, limit)}
        legs.append(_leg(joint, tests, (start_deg, target_deg), travel, settings))
    return legs


def _settable(joint: Joint, speed_deg_s: float) -> float:
    """Return the speed nearest below that SD can express, at least its smallest."""
    row = language_table(joint.model.language).row("SD")
    return max(math.floor(row.wire_per_unit * speed_deg_s), 1) / float(row.wire_per_unit)


def _leg(
    joint: Joint,
    tests: str,
    ends_deg: tuple[float, float],
    travel_deg_s: float,
    settings: dict[str, float],
) -> CarefulMove:
    """Return a leg whose T makes the joint travel at `travel_deg_s`, if nothing else slows it."""
    start_deg, target_deg = ends_deg
    way_deg, ratio = abs(target_deg - start_deg), joint.ramp_ratio
    duration_s = way_deg / travel_deg_s
    if joint.response.t_law == "exact":  # Its T includes the ramps.
        duration_s += travel_deg_s / (ratio * min(settings["AA"], settings["AD"]))
    duration_ms = min(math.ceil(MS_PER_S * duration_s), DURATION_MAX_MS)
    ramp = ratio * max(settings["AA"], settings["AD"])
    travel = travel_speed(
        Piece(0.0, 0.0, 0.0, 0.0), way_deg, s_from_ms(duration_ms), ramp, joint.response
    )
    course = Course(
        way_deg=way_deg,
        speed_deg_s=min(settings["SD"], travel),
        accel_deg_s2=ratio * settings["AA"],
        decel_deg_s2=ratio * settings["AD"],
    )
    return CarefulMove(
        tests=tests,
        start_deg=start_deg,
        target_deg=target_deg,
        duration_ms=duration_ms,
        settings=settings,
        course=course,
    )


class MoveRatios(Struct, frozen=True):
    """What the readings of a leg show: the share of the way, of the speed, and the lag."""

    way_ratio: float
    speed_ratio: float
    """0: the horn did not come far enough to tell."""
    expected_deg_s: float
    """The expected speed over the part of the way that is judged."""
    lag_s: float
    """By how much it was later than its profile, half-way."""


def measured(leg: CarefulMove, times_s: Sequence[float], turned_deg: Sequence[float]) -> MoveRatios:
    """Return what the readings show; `times_s` count from the instant of the command.

    `turned_deg` are angles from the rest before the leg, in its direction. A load may keep the horn
    short of its target, so shares are those of the way that it went.
    """
    course, way_deg = leg.course, turned_deg[-1] if turned_deg else 0.0
    way_ratio = way_deg / course.way_deg
    if way_ratio < ARRIVED_RATIO:
        return MoveRatios(way_ratio, 0.0, 0.0, 0.0)
    angles_deg = [share * way_deg for share in (JUDGED[0], 0.5, JUDGED[1])]
    first_s, middle_s, last_s = (_crossing_s(times_s, turned_deg, deg) for deg in angles_deg)
    # What backlash takes, it takes at the start.
    lost_deg = max(course.way_deg - way_deg, 0.0)
    begins_s, half_s, ends_s = (
        course.time_s(min(deg + lost_deg, course.way_deg)) for deg in angles_deg
    )
    judged_deg, least_s = angles_deg[2] - angles_deg[0], s_from_ms(1)
    return MoveRatios(
        way_ratio,
        (ends_s - begins_s) / max(last_s - first_s, least_s),
        judged_deg / max(ends_s - begins_s, least_s),
        middle_s - half_s,
    )


def _crossing_s(times_s: Sequence[float], turned_deg: Sequence[float], angle_deg: float) -> float:
    """Return when the horn came to `angle_deg`, between two readings; it did."""
    before_s, before_deg = 0.0, 0.0
    for time_s, turn_deg in zip(times_s, turned_deg, strict=True):
        if turn_deg >= angle_deg:
            share = (angle_deg - before_deg) / max(turn_deg - before_deg, 1e-9)
            return before_s + share * (time_s - before_s)
        before_s, before_deg = time_s, turn_deg
    return before_s


MEANS: Final = {
    "SD": "its speed limit (SD)",
    "T": "the time of a move (T)",
    "AA": "its acceleration (AA)",
    "AD": "its deceleration (AD)",
    "D": "its angles (D)",
}
UNIT_REMEDY: Final = (
    "If nothing holds or pushes it and its supply is right, this servo has other units than its "
    "`model` in the robot file: compare that with the label on the servo, and update its firmware; "
    "for an LSS-PRO, `units` in the robot file can say what its servos count in"
)


def lag_scatter_s(leg: CarefulMove) -> float:
    """Return how much the scatter of the readings may change the lag of a leg."""
    return SCATTER_DEG / leg.course.peak_deg_s


def judgement(joint: Joint, leg: CarefulMove, found: MoveRatios, identify_command: str) -> str:
    """Return how the leg deviates from what is expected, and what to do; '' if it does not."""
    if found.way_ratio < ARRIVED_RATIO:
        turned_deg = found.way_ratio * leg.course.way_deg
        return (
            f"turned {turned_deg:.1f} deg where {leg.course.way_deg:.1f} deg were expected. It is "
            f"blocked, or too weak for its load: free it, and look at its supply. {UNIT_REMEDY}"
        )
    assumed_s = joint.response.lag_s
    allowed_s = LAG_MAX_S + lag_scatter_s(leg)
    if not leg.tests and found.lag_s - assumed_s > allowed_s:
        return (
            f"is {MS_PER_S * found.lag_s:.0f} ms later than its profile, "
            f"{MS_PER_S * assumed_s:.0f} ms are assumed (`response` of the joint), and "
            f"{MS_PER_S * LAG_MAX_S:.0f} ms more can be corrected. Lighten its load, or measure "
            f"it: {identify_command}"
        )
    if not 1.0 / RATIO_MAX <= found.speed_ratio <= RATIO_MAX:
        tested = MEANS.get(leg.tests, "its speed")
        return (
            f"turned at {found.speed_ratio * found.expected_deg_s:.1f} deg/s where "
            f"{found.expected_deg_s:.1f} deg/s were expected: {found.speed_ratio:.2g} times as "
            f"fast, in the move that tests {tested}. {UNIT_REMEDY}"
        )
    return ""


NEAR_DEG: Final = 2.0
"""A reading may be so far from the course of its leg: more than load, backlash and scatter make,
and few enough degrees that a joint which moves wrongly stops before it touches anything."""
NEAR_RATIO: Final = 0.4
"""The same for a short leg, as a share of its way."""
NEAR_LEAST_DEG: Final = 1.0
LATE_S: Final = 0.15
"""Beyond its assumed lag a horn may be so much later than its course while it moves. Chosen: a
heavy limb; what a show cannot correct is found after the leg."""
DEVIATIONS: Final = 2
"""So many readings in a row must deviate: one may be damaged."""
SAG_DEG: Final = 8.0
"""A load may pull a joint so far when it begins to hold. Chosen: a joint that sags more is held by
nothing; H, which holds it, has no unit that could be wrong."""
UNMOVED_DEG: Final = 0.5
"""A joint that has turned less did not receive its command: it is sent once more."""
HOLD_S: Final = 0.2
"""The joint holds for so long before its first leg."""
ROOM_DEG: Final = WAY_DEG + 1.0
"""The joint stays within this of where it stood."""
PULSE_MID_US: Final = 1500.0
PULSE_HALF_US: Final = 1000.0
"""The middle of a pulse, and half of the pulses of the angular range (FACTS.md C11)."""
WITNESS_TRIES: Final = 2
FAST_RATIO: Final = 2.0
FAST_DEG_S: Final = 3.0
"""A speed (QWD, whole degrees a second) is too high above so many times that of the leg, and this
much more for its rounding and the ramps of a load."""


class Careful(Struct, frozen=True, kw_only=True):
    """What a careful run has shown of one joint."""

    way_deg: float
    """By how many joint degrees it turned, out and back."""
    lag_s: float | None
    """None: it is too slow to tell."""
    speed_ratio: float
    """Its speed in units of the expected one, at the speed of a show."""
    has_witness: bool
    """Whether the unit of its angles was compared with that of its pulses, or of its speed."""


class CarefulRun(JointRun):
    """Moves one joint of `robot`. `found` is set when all was as expected, else `error`.

    `way_deg`: see `way_of`; not 0.
    """

    def __init__(
        self, joint: Joint, robot: Robot, answers: Answers, *, standing_deg: float, way_deg: float
    ) -> None:
        """`answers` are those of a preflight; the joint stands at `standing_deg` (servo)."""
        window = MotionWindow(standing_deg - ROOM_DEG, standing_deg + ROOM_DEG)
        super().__init__(joint, robot, answers, window, standing_deg=standing_deg)
        self.found: Careful | None = None
        self._way_deg = way_deg
        self._identify_command = robot.identify_command(joint.name)
        self._legs = deque(make_legs(joint, robot, standing_deg, way_deg))
        self._count = len(self._legs)
        self._leg: CarefulMove | None = None
        self._results: list[MoveRatios] = []
        self._deviations = self._contradictions = 0
        self._may_resend = True
        self._has_witnessed = False
        """Whether the pulses or the speed of a leg showed a motion."""
        self._pulses_deg: deque[float] = deque(maxlen=DEVIATIONS + 1)
        self._pulse_deg: float | None = None
        """The angle by pulses at the rest before the leg."""
        self._range_deg = handshake.reported(joint, answers, "QAR")
        known = language_table(joint.model.language).by_keyword
        pulse = "QP" if "QP" in known and self._range_deg else ""
        self._witness = pulse or ("QWD" if "QWD" in known else "")
        """The query whose answer has another unit than angles, to compare them."""
        self._dialogue = self._settings(self._legs[0])

    @property
    def progress_ratio(self) -> float:
        """The share of the legs that are over."""
        return len(self._results) / self._count

    # ---- settings

    def _settings(self, leg: CarefulMove) -> SettingsDialogue:
        """Return the dialogue that sets what `leg` needs, and asks where the joint stands."""
        joint, table = self.joint, language_table(self.joint.model.language).by_keyword
        known: list[Item] = []
        unknown: list[Item] = []
        for keyword, value in leg.settings.items():
            if f"Q{keyword}" not in table:
                continue
            command = make_command(joint.model.language, joint.servo_id, keyword, value)
            item = Item(bus=joint.bus, command=command)
            is_known = handshake.reported(joint, self._answers, f"Q{keyword}") is not None
            (known if is_known else unknown).append(item)
        for keyword, wire in joint.settings.items():
            command = Command(joint.servo_id, keyword, wire)
            known.append(Item(bus=joint.bus, command=command))
        then = handshake.position_queries([joint])
        if self.state is ExperimentState.PREPARE and self._witness:
            query = Command(joint.servo_id, self._witness)
            then.append(Item(bus=joint.bus, command=query, tries=WITNESS_TRIES))
        probes = handshake.probes([joint], self._answers, known)
        self._probes = probes.get(joint.name, [])
        return SettingsDialogue(known, then, unknown, {joint.bus: self._poller.tracker})

    def _prepared(self, now_ns: int) -> None:
        """Hold before the first leg; begin the others."""
        dialogue, self._dialogue = self._dialogue, None
        assert isinstance(dialogue, SettingsDialogue)
        standing_deg = handshake.reported(self.joint, dialogue.answers, "QD")
        if dialogue.wrong:
            self.error = handshake.not_applied_error(
                dialogue.wrong[0], dialogue.answers, [self.joint]
            )
        elif standing_deg is None:
            self.error = self._fault("does not report where it stands; check its cable")
        elif cause := self._elsewhere(standing_deg, NEAR_DEG):
            self.error = self._fault(cause)
        if self.error is not None:
            self._brake(now_ns)
            return
        self._poller.watch(self._probes, now_ns)
        if self.state is ExperimentState.PREPARE:
            self._hold(dialogue.answers, now_ns)
        else:
            self._start(now_ns)

    def _elsewhere(self, standing_deg: float, near_deg: float) -> str:
        """Return why no leg begins where the joint stands; '' if one does."""
        if abs(standing_deg - self._rested_deg) <= near_deg:
            return ""
        here, there = map(self.joint.joint_deg, (standing_deg, self._rested_deg))
        return (
            f"stands at {here:.1f} deg, {there:.1f} deg were expected, although it was not sent "
            f"there: something moved it, or its servo restarted or changed its gyre (G) or origin "
            f"(O). Look at its supply, compare its settings (lss-motion configure), begin anew"
        )

    def _hold(self, answers: Answers, now_ns: int) -> None:
        value = answers.get((self.joint.bus, self.joint.servo_id, self._witness))
        is_used = isinstance(value, int)
        if is_used and self._witness == "QP":  # At an end of the range it tells nothing.
            is_used = PULSE_MIN_US < int(value or 0) < PULSE_MAX_US
        self._poller.also = self._witness if is_used else ""
        self.state = ExperimentState.HOLD
        self._has_moved = True
        self._line.send(self._hold_bytes(), now_ns)
        self._begin(TrialPlan(TrialKind.STEP, (), HOLD_S), now_ns)

    def _start(self, now_ns: int) -> None:
        """Begin the next leg."""
        self._leg = self._legs.popleft()
        self._pulse_deg = median(self._pulses_deg) if self._pulses_deg else None
        self._may_resend = True
        self._move(self._leg, now_ns)

    def _move(self, leg: CarefulMove, now_ns: int) -> None:
        """Send the command of a leg."""
        self._has_witnessed = False
        self._deviations = self._contradictions = 0
        move = PlannedMove(0.0, leg.target_deg, leg.duration_ms)
        lasts_s = leg.course.duration_s + self.joint.response.lag_s
        self._begin(TrialPlan(TrialKind.STEP, (move,), lasts_s), now_ns)

    # ---- readings

    def _take(self, polled: PolledReading, now_ns: int) -> None:
        if polled.also is None:
            super()._take(polled, now_ns)
        elif self._poller.also == "QP":
            self._compare_pulse(polled.also, now_ns)
        else:
            self._compare_speed(polled.also, now_ns)

    def _compare_speed(self, speed_deg_s: float, now_ns: int) -> None:
        """Halt the joint if it is much faster than its leg: its angles have another unit."""
        if self._leg is None or self.state is not ExperimentState.TRIALS:
            return
        expected_deg_s = self._leg.course.peak_deg_s
        self._has_witnessed |= bool(speed_deg_s)
        is_slow = abs(speed_deg_s) <= FAST_RATIO * expected_deg_s + FAST_DEG_S
        self._contradictions = 0 if is_slow else self._contradictions + 1
        if self._contradictions >= DEVIATIONS:
            what = MEANS.get(self._leg.tests, "its speed")
            cause = (
                f"turns at {abs(speed_deg_s):.0f} deg/s by its speed (QWD), {expected_deg_s:.3g} "
                f"deg/s were expected, in the move that tests {what}. {UNIT_REMEDY}"
            )
            self._fail(self._fault(cause), now_ns)

    def _watch(self, reading_deg: float, now_ns: int) -> None:
        """Halt the joint after two consecutive readings that are far from its course."""
        if self.state is ExperimentState.BRAKE:
            return
        leg, sent = self._leg, self._trial.sent
        if leg is None or not sent or self.state is not ExperimentState.TRIALS:
            cause = self._elsewhere(reading_deg, SAG_DEG)
        else:
            cause = self._off_course(leg, self._trial.times_s[-1] - sent[0].received_s, reading_deg)
        self._deviations = self._deviations + 1 if cause else 0
        if self._deviations < DEVIATIONS:
            return
        if leg is not None and self._may_resend and self._has_not_moved():
            self._may_resend = False
            self._move(leg, now_ns)
        else:
            self._fail(self._fault(cause), now_ns)

    def _has_not_moved(self) -> bool:
        """Return whether no answer in a leg shows a motion: the line may have lost the command."""
        turned_deg = [abs(deg - self._rested_deg) for deg in self._trial.readings_deg]
        is_still = bool(self._trial.sent) and max(turned_deg) < UNMOVED_DEG
        return is_still and not self._has_witnessed

    def _off_course(self, leg: CarefulMove, since_s: float, reading_deg: float) -> str:
        """Return how a reading deviates from the course of its leg; '' if it does not."""
        turned_deg = leg.sign * (reading_deg - self._rested_deg)
        way_deg = leg.course.way_deg
        near_deg = max(min(NEAR_DEG, NEAR_RATIO * way_deg), NEAR_LEAST_DEG)
        late_s = since_s - self.joint.response.lag_s - LATE_S
        most_deg, least_deg = leg.course.at(since_s)[0], leg.course.at(late_s)[0]
        if least_deg - near_deg <= turned_deg <= most_deg + near_deg:
            return ""
        at_deg = f"{self.joint.joint_deg(reading_deg):.1f} deg"
        if turned_deg < -near_deg:
            wanted_deg = self.joint.direction * leg.sign * way_deg
            return (
                f"turns the wrong way: it was to turn by {wanted_deg:+.1f} deg and is at {at_deg}, "
                f"{-turned_deg:.1f} deg behind its start. Was it pushed, or has its servo changed "
                f"its gyre (G)? Compare its settings (lss-motion configure), and see whether "
                f"anything else drives this bus"
            )
        what = MEANS.get(leg.tests, "its speed")
        pace = "fast" if turned_deg > most_deg else "slow"
        where_deg = most_deg if turned_deg > most_deg else leg.course.at(since_s)[0]
        return (
            f"is too {pace}: {since_s:.2f} s after its command it has turned {turned_deg:.1f} deg, "
            f"{where_deg:.1f} deg were expected, in the move that tests {what}. {UNIT_REMEDY}"
        )

    def _compare_pulse(self, pulse_us: float, now_ns: int) -> None:
        """Halt the joint if its pulses show another way than its angles: they have another unit."""
        if not PULSE_MIN_US < pulse_us < PULSE_MAX_US or not self._range_deg:
            return
        at_deg = (pulse_us - PULSE_MID_US) / PULSE_HALF_US * 0.5 * self._range_deg
        self._pulses_deg.append(at_deg)
        readings_deg = self._trial.readings_deg
        if self.state is not ExperimentState.TRIALS or not self._trial.sent or not readings_deg:
            return
        if self._pulse_deg is None:
            return
        by_pulse_deg, by_angle_deg = (
            at_deg - self._pulse_deg,
            readings_deg[-1] - self._rested_deg,
        )
        self._has_witnessed |= abs(by_pulse_deg) > UNMOVED_DEG
        moving_deg = self._leg.course.peak_deg_s * LATE_S if self._leg is not None else 0.0
        is_same = abs(by_pulse_deg - by_angle_deg) <= NEAR_LEAST_DEG + 0.5 * moving_deg
        self._contradictions = 0 if is_same else self._contradictions + 1
        if self._contradictions < DEVIATIONS:
            return
        self._fail(
            self._fault(
                f"has turned {by_pulse_deg:+.1f} deg by its pulses (QP) and {by_angle_deg:+.1f} "
                f"deg by {MEANS['D']}, which are to be the same. {UNIT_REMEDY}"
            ),
            now_ns,
        )

    # ---- after a leg

    def _trial_over(self, now_ns: int) -> None:
        if self.error is None and self.state is ExperimentState.HOLD:
            self._rested_deg = self._trial.rest_deg()
            self.state = ExperimentState.TRIALS
            self._start(now_ns)
        elif self.error is None:
            self._judge()
        if self.error is not None:
            return
        if self._leg is not None and self._trial.sent:
            self._rested_deg = self._trial.rest_deg()
            if self._legs:
                self._dialogue = self._settings(self._legs[0])
            else:
                self._conclude()
                self._restore()
            self._leg = None

    def _judge(self) -> None:
        """Compare the leg that is over with its course."""
        leg, trial = self._leg, self._trial
        assert leg is not None
        received_s = trial.sent[0].received_s
        times_s = [time_s - received_s for time_s in trial.times_s]
        turned_deg = [leg.sign * (deg - self._rested_deg) for deg in trial.readings_deg]
        result = measured(leg, times_s, turned_deg)
        self._results.append(result)
        if cause := judgement(self.joint, leg, result, self._identify_command):
            self.error = self._fault(cause)

    def _conclude(self) -> None:
        last = self._results[-DEVIATIONS:]
        is_fast = self._leg is not None and lag_scatter_s(self._leg) < LAG_MAX_S
        self.found = Careful(
            way_deg=self.joint.direction * self._way_deg,
            lag_s=median(result.lag_s for result in last) if is_fast else None,
            speed_ratio=median(result.speed_ratio for result in last),
            has_witness=bool(self._poller.also),
        )

    # ---- how it ends

    def _stop_move(self, now_ns: int) -> tuple[Command, float]:
        """Halt after a deviation, as angles may be wrong; else brake by the ramps of the leg."""
        halt = Command(self.joint.servo_id, "H")
        leg, sent = self._leg, self._trial.sent
        if self.error is not None or leg is None or not sent:
            return halt, 0.0
        since_s = s_from_ns(self._line.arrival_ns(0, now_ns) - self._began_ns) - sent[0].received_s
        turned_deg, speed_deg_s = leg.course.at(since_s)
        if not speed_deg_s:
            return halt, 0.0
        decel = leg.course.decel_deg_s2
        stop_deg = min(turned_deg + 0.5 * speed_deg_s**2 / decel, leg.course.way_deg)
        wire = round((leg.start_deg + leg.sign * stop_deg) * self.joint.model.wire_per_deg)
        return Command(self.joint.servo_id, "D", wire), speed_deg_s / decel

    def _take_answers(self) -> None:
        """Drop a dialogue: its answers are the settings of a leg, not those to give back."""
        self._dialogue = None
