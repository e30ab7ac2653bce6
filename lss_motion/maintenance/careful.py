"""The careful run of one joint: it moves a little, slowly, and is compared with what is expected.

`CarefulRun` is a `JointRun`. It holds the joint where it is, then drives the legs of
`careful_legs`. While the joint moves, every reading must be near the course of its leg. A servo
whose angles, speeds and ramps all have another unit reports the way that is expected and turns
another; so its angle as a pulse (QP), or for an LSS-PRO its speed (QWD), is compared as well. After
two readings in a row that deviate, the servo is halted (H, which has no unit). However it ends, the
settings are given back and the joint holds.
"""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.maintenance.careful_legs import (
    MEANS,
    UNIT_REMEDY,
    WAY_DEG,
    judgement,
    lag_scatter_s,
    make_legs,
    measured,
)
from lss_motion.maintenance.identify.joint_run import ExperimentState, JointRun
from lss_motion.maintenance.identify.trials import MotionWindow, PlannedMove, TrialKind, TrialPlan
from lss_motion.playing.player import handshake
from lss_motion.playing.player.estimators import LAG_MAX_S
from lss_motion.playing.player.handshake import SettingsDialogue
from lss_motion.playing.player.transactions import Item
from lss_motion.protocol.codec import language_table, make_command
from lss_motion.protocol.constants import PULSE_MAX_US, PULSE_MIN_US
from lss_motion.protocol.framing import Command
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from lss_motion.maintenance.careful_legs import CarefulMove, MoveRatios
    from lss_motion.maintenance.identify.joint_run import PolledReading
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.model import Joint, Robot


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
            item = Item(bus=joint.bus, command=command, is_query=False)
            is_known = handshake.reported(joint, self._answers, f"Q{keyword}") is not None
            (known if is_known else unknown).append(item)
        for keyword, wire in joint.settings.items():
            command = Command(joint.servo_id, keyword, wire)
            known.append(Item(bus=joint.bus, command=command, is_query=False))
        then = handshake.position_queries([joint])
        if self.state is ExperimentState.PREPARE and self._witness:
            query = Command(joint.servo_id, self._witness)
            then.append(Item(bus=joint.bus, command=query, is_query=True, tries=WITNESS_TRIES))
        probes = handshake.probes([joint], self._answers, known)
        self._probes = probes.get(joint.name, [])
        lines, trackers = {joint.bus: self._line}, {joint.bus: self._poller.tracker}
        return SettingsDialogue(known, then, unknown, lines, trackers)

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
