"""Small moves of one joint on its bus, from rest to rest; it holds however that ends.

`JointRun` is driven by the run loop (`playing.runner.Driven`): settings of the session, trials with
queries in between, and however they end, restore the settings and hold. What it moves and judges is
decided by its subclasses: `Experiment` (the trials of one joint), `maintenance.careful.CarefulRun`.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import deque
from enum import Enum
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import BusError, LssMotionError, PlaybackError
from lss_motion.maintenance.identify.trials import (
    SETTLE_S,
    PlannedMove,
    Recording,
    SentMove,
    Trial,
    TrialKind,
    TrialPlan,
    make_trials,
)
from lss_motion.playing.player import handshake
from lss_motion.playing.player.checks import reported_firmware
from lss_motion.playing.player.handshake import Dialogue
from lss_motion.playing.player.health import STATUS_TEXTS, status_fault
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.playing.player.servo_model import ServoSettings
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import BROADCAST_ID, Status, status_from
from lss_motion.protocol.framing import Command, encode, encode_move
from lss_motion.robot.on_fault import Cause
from lss_motion.robot.profile import Profile, ramp_deg_s2, ramp_setting_deg_s2
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.maintenance.identify.trials import MotionWindow
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.handshake import Answers, Item, SettingsDialogue
    from lss_motion.playing.player.servo_model import Probe
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Joint, Robot

READ_EVERY_NS: Final = 6 * NS_PER_MS
"""The period of the readings, if the line allows: ten in a ramp of 60 ms."""
STATUS_EVERY: Final = 10
"""One query in so many is for the status of the servo."""
SILENT_ASKS: Final = 6
SILENT_NS: Final = NS_PER_S // 2
"""After so many queries without an answer in so long a time, a servo is silent."""
ARRIVED_RATIO: Final = 0.5
"""A horn that moved less than this share of its way is blocked."""
WAY_LEAST_DEG: Final = 2.0
"""Shorter ways are not judged: load or play may absorb them."""
GUARD_DEG: Final = 2.0
"""Readings this far outside the window end it: more than noise, less than harm."""
SETTLE_MAX_S: Final = 3.0
"""No horn takes longer to settle; one that still moves swings or is pushed."""
OUTSIDE_READINGS: Final = 2
"""So many consecutive readings outside the window end it: one may be damaged."""


class ExperimentState(Enum):
    """The phase of an experiment."""

    PREPARE = "preparing"
    HOLD = "holding"
    TRIALS = "measuring"
    BRAKE = "stopping"
    RESTORE = "restoring"
    DONE = "done"


class JointRun(ABC):
    """Moves one joint. `error` is set if that failed, `is_stopped` if a person ended it.

    A subclass sets `_dialogue` to the first settings, begins trials when they are made
    (`_prepared`), goes on after each (`_trial_over`), and watches the readings (`_watch`).
    """

    def __init__(
        self,
        joint: Joint,
        robot: Robot,
        answers: Answers,
        window: MotionWindow,
        *,
        standing_deg: float,
    ) -> None:
        """`answers` are for `handshake.questions`; the joint stands at `standing_deg` (servo)."""
        self.joint = joint
        self.state = ExperimentState.PREPARE
        self.error: LssMotionError | None = None
        self.is_stopped = False
        self.window = window
        self._answers: Answers = dict(answers)
        self._line = SerialLine(robot.buses[joint.bus])
        self._poller = PositionPoller(joint, self._line, reported_firmware(joint, answers))
        self._standing_deg = self._target_deg = self._rested_deg = standing_deg
        self._profile = Profile(
            standing_deg,
            ramp_deg_s2=ramp_deg_s2(joint),
            speed_max_deg_s=joint.speed_max_deg_s,
            response=joint.response,
        )
        self._dialogue: Dialogue | SettingsDialogue | None = None
        self._trial = Trial(TrialKind.STEP, 0.0, standing_deg)
        self._moves: deque[PlannedMove] = deque()
        self._began_ns = 0
        self._rests_ns = 0
        self._outside_count = 0
        self._has_set = self._has_moved = False
        self._holds_all = False
        """Whether the servo may have restarted: then it may be limp and without its limits, and
        what made it restart may have hit the others."""
        self._now_ns = 0

    # ---- what a subclass decides

    @abstractmethod
    def _prepared(self, now_ns: int) -> None:
        """Go on after settings."""

    @abstractmethod
    def _trial_over(self, now_ns: int) -> None:
        """Judge a trial that is over, and begin the next one, or `_restore`."""

    def _take(self, polled: PolledReading, now_ns: int) -> None:
        """Use an answer of the servo."""
        if polled.reading_deg is not None:
            self._trial.times_s.append(s_from_ns(polled.asked_ns - self._began_ns))
            self._trial.readings_deg.append(polled.reading_deg)
            self._watch(polled.reading_deg, now_ns)
        elif polled.fault is not None:
            self._fail(self._fault(polled.fault), now_ns)

    def _watch(self, reading_deg: float, now_ns: int) -> None:
        """Stop after two consecutive readings outside the window."""
        cause = outside(self.joint, self.window, reading_deg)
        self._outside_count = self._outside_count + 1 if cause else 0
        if self._outside_count >= OUTSIDE_READINGS:
            self._fail(self._fault(cause), now_ns)

    def _stop_move(self, now_ns: int) -> tuple[Command, float]:
        """Return the command that brakes to rest, and the time that this takes.

        Within the joint's limits; on a fault, the horn stops at the present angle.
        """
        braking_deg_s2 = ramp_deg_s2(self.joint)
        position_deg, speed_deg_s = self._profile.at(s_from_ns(self._line.arrival_ns(0, now_ns)))
        stop_deg = position_deg + 0.5 * speed_deg_s * abs(speed_deg_s) / braking_deg_s2
        if self.error is not None and self._trial.readings_deg:
            stop_deg = self._trial.readings_deg[-1]
        stop_deg = min(max(stop_deg, self.window.low_deg), self.window.high_deg)
        wire = round(stop_deg * self.joint.model.wire_per_deg)
        return Command(self.joint.servo_id, "D", wire), abs(speed_deg_s) / braking_deg_s2

    # ---- calls of the run loop

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        self._now_ns = leaves_ns
        while self._step(leaves_ns):
            pass
        data = self._line.take()
        return {self.joint.bus: data} if data else {}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        if bus != self.joint.bus:
            return
        for reply, _ in self._line.receive(data, now_ns):
            if self._dialogue is not None:
                self._dialogue.receive(bus, reply, now_ns)
            elif (polled := self._poller.receive(reply, now_ns)) is not None:
                self._take(polled, now_ns)

    def next_wakeup_ns(self) -> int | None:
        if self.state is ExperimentState.DONE:
            return None
        if self._dialogue is not None:
            wakeup_ns = self._dialogue.next_wakeup_ns()
            return self._now_ns if wakeup_ns is None else max(wakeup_ns, self._now_ns)
        wakeups_ns = [self._poller.next_wakeup_ns()]
        if self._may_move:
            wakeups_ns.append(self._rests_ns + ns_from_s(SETTLE_MAX_S))
        if self._may_move and self._moves:
            wakeups_ns.append(self._due_ns(self._moves[0]))
        return max(min(wakeups_ns), self._now_ns)

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes if the run ends now: the settings that it found, and hold.

        Before the first move the joint is left as it was: it may be limp.
        """
        if not self._has_set:
            return {}
        restored = handshake.restoring_orders([self.joint], self._answers)
        last = self._hold_bytes() if self._has_moved else b""
        return {self.joint.bus: b"".join(encode(i.command) for i in restored) + last}

    # ---- requests of a person

    def stop(self, now_ns: int) -> None:
        """Brake, hold, restore the settings, end. A second call ends at once without braking."""
        if self.state is ExperimentState.DONE:
            return
        if self.is_stopped:
            self._abort(now_ns)
            return
        self.is_stopped = True
        if self.state not in (ExperimentState.BRAKE, ExperimentState.RESTORE):
            self._brake(now_ns)

    # ---- phases

    def _step(self, now_ns: int) -> bool:
        """Do what is due; return whether the phase changed."""
        if self.state is ExperimentState.DONE:
            return False
        if self._dialogue is not None:
            self._has_set = True
            self._dialogue.advance(now_ns)
            if self._dialogue.is_finished:
                self._after_dialogue(now_ns)
                return True
            return False
        while self._may_move and self._moves and self._due_ns(self._moves[0]) <= now_ns:
            self._send(self._moves.popleft(), now_ns)
        if self._may_move and self._is_over(now_ns):
            self._after_trial(now_ns)
            return True
        self._poller.ask(now_ns, self._due_ns(self._moves[0]) if self._moves else None)
        if self._poller.is_silent and self.state is not ExperimentState.BRAKE:
            text = f"servo {self.joint.servo_id} has stopped answering; check its power and wiring"
            error = BusError(f"joint {self.joint.name!r}: {text}", url=self._line.bus.port)
            self._fail(error, now_ns)
            return True
        return False

    @property
    def _may_move(self) -> bool:
        """Whether the servo is not in doubt to have restarted; to brake needs no settings."""
        return self.state is ExperimentState.BRAKE or not self._poller.servo.is_doubtful

    def _after_dialogue(self, now_ns: int) -> None:
        if self.state is ExperimentState.RESTORE:
            self._take_answers()
            self._finish(now_ns)
        else:
            self._prepared(now_ns)

    def _after_trial(self, now_ns: int) -> None:
        if self.state is ExperimentState.BRAKE:
            self._restore()
            return
        self._trial_over(now_ns)
        if self.error is not None:
            self._brake(now_ns)

    def _begin(self, plan: TrialPlan, at_ns: int) -> None:
        self._trial = Trial(plan.kind, s_from_ns(at_ns), self._target_deg)
        self._moves = deque(plan.moves)
        self._began_ns = at_ns
        self._rests_ns = at_ns + ns_from_s(plan.end_s)

    def _fail(self, error: LssMotionError, now_ns: int) -> None:
        if self.state is not ExperimentState.BRAKE:
            self.error = self.error or error
            self._brake(now_ns)

    def _brake(self, now_ns: int) -> None:
        """Brake to rest, if anything may move."""
        if not self._has_moved:
            self._restore()
            return
        self._take_answers()
        self.state = ExperimentState.BRAKE
        command, lasts_s = self._stop_move(now_ns)
        if self._poller.servo.is_doubtful or self._poller.is_silent:
            self._holds_all = True
            command, lasts_s = Command(self.joint.servo_id, "H"), 0.0
        self._begin(TrialPlan(TrialKind.STEP, (), lasts_s), now_ns)
        self._line.send(encode(command), now_ns)

    def _restore(self) -> None:
        self._take_answers()
        self.state = ExperimentState.RESTORE
        self._dialogue = self._ask(handshake.restoring_orders([self.joint], self._answers))

    def _abort(self, now_ns: int) -> None:
        self._take_answers()
        for data in self.safe_bytes().values():
            self._line.send(data, now_ns)
        self.state = ExperimentState.DONE

    def _finish(self, now_ns: int) -> None:
        self.state = ExperimentState.DONE
        if self._has_moved:
            self._line.send(self._hold_bytes(), now_ns)

    def _take_answers(self) -> None:
        if self._dialogue is not None:
            self._answers = {**self._answers, **self._dialogue.answers}
            self._dialogue = None

    # ---- one trial

    def _due_ns(self, move: PlannedMove) -> int:
        return self._began_ns + ns_from_s(move.at_s)

    def _send(self, move: PlannedMove, now_ns: int) -> None:
        wire = round(move.target_deg * self.joint.model.wire_per_deg)
        received_ns = self._line.send(
            encode_move(self.joint.servo_id, wire, move.duration_ms), now_ns
        )
        self._target_deg = wire / self.joint.model.wire_per_deg
        received_s, duration_s = (
            s_from_ns(received_ns - self._began_ns),
            s_from_ms(move.duration_ms),
        )
        self._trial.sent.append(SentMove(received_s, self._target_deg, duration_s))
        self._profile.retarget(s_from_ns(received_ns), self._target_deg, duration_s)

    def _is_over(self, now_ns: int) -> bool:
        """Return whether the horn rests, or has not come to rest in time."""
        if self._moves or now_ns < self._rests_ns + ns_from_s(SETTLE_S):
            return False
        if self._trial.is_settled(s_from_ns(now_ns - self._began_ns)):
            return True
        if now_ns < self._rests_ns + ns_from_s(SETTLE_MAX_S):
            return False
        if self.state is not ExperimentState.BRAKE:
            self.error = self._fault("does not come to rest: something swings, or pushes it")
        return True

    def _fault(self, cause: str) -> PlaybackError:
        return PlaybackError(f"joint {self.joint.name!r} {cause}", joint=self.joint.name)

    def _hold_bytes(self) -> bytes:
        servo_id = BROADCAST_ID if self._holds_all else self.joint.servo_id
        return encode(Command(servo_id, "H"))

    def _ask(self, items: Sequence[Item]) -> Dialogue:
        return Dialogue(items, {self.joint.bus: self._poller.tracker})


class PolledReading(Struct, frozen=True):
    """The content of an answer: an angle, the value of `also`, a fault of the servo, or nothing."""

    asked_ns: int
    """When the servo received the query completely."""
    turnaround_s: float
    reading_deg: float | None = None
    fault: str | None = None
    also: float | None = None


class PositionPoller:
    """Queries to the servo of one joint, one at a time.

    STUCK must come twice to be a fault: a horn that turns back stands still for a moment. With
    `also`, a keyword, every second query is that one.

    A query without an answer, and a servo that is limp, are signs of a restart: then one of its
    probes is queried at once, and it `is_doubtful` until it answers as it was set (`watch`).
    """

    def __init__(self, joint: Joint, line: SerialLine, firmware: int | None) -> None:
        self.tracker = QueryTracker(line)
        self.joint = joint
        self.also = ""
        self.is_silent = False
        self._firmware = firmware
        self._line = line
        self._next_ns = 0
        self._count = 0
        self._silent_count = self._silent_ns = 0
        self._status: Status | None = None
        self.servo = ServoSettings(joint)

    def watch(self, probes: Sequence[Probe], now_ns: int) -> None:
        """Watch for a restart from now on: the servo is set to these, and is to have power."""
        self.servo.begin(probes)
        self.servo.powered_ns = now_ns

    def ask(self, now_ns: int, quiet_until_ns: int | None) -> None:
        """Send a query if it is due and ends before `quiet_until_ns` (None: no limit)."""
        tracker, servo_id = self.tracker, self.joint.servo_id
        self._note_timeouts(len(tracker.expire(now_ns)), now_ns)
        if tracker.is_waiting(servo_id):
            return
        probe = self.servo.urgent
        if probe is None:
            self._next_ns = max(self._next_ns, tracker.quiet_until_ns(servo_id))
        if now_ns < self._next_ns:
            return
        question = Command(servo_id, probe or self._keyword())
        ends_ns = self._line.arrival_ns(len(encode(question)), now_ns)
        if quiet_until_ns is not None and ends_ns > quiet_until_ns and not self.servo.is_doubtful:
            self._next_ns = quiet_until_ns
            return
        tracker.send(question, now_ns)
        self._count += 1
        self._next_ns = now_ns + READ_EVERY_NS

    def _note_timeouts(self, count: int, now_ns: int) -> None:
        if not count:
            return
        if not self._silent_count:
            self._silent_ns = now_ns
        self._silent_count += count
        lasts_ns = now_ns - self._silent_ns
        self.is_silent = self._silent_count >= SILENT_ASKS and lasts_ns >= SILENT_NS
        self.servo.note_sign(now_ns)
        if self.servo.urgent is not None:
            self._next_ns = now_ns

    def _keyword(self) -> str:
        if self.servo.is_limp or self._count % STATUS_EVERY == STATUS_EVERY - 1:
            return "Q"
        return self.also if self.also and self._count % 2 else "QD"

    def next_wakeup_ns(self) -> int:
        give_up_ns = self.tracker.give_up_ns
        return self._next_ns if give_up_ns is None else give_up_ns

    def receive(self, reply: Reply, now_ns: int) -> PolledReading | None:
        """Return the content of `reply`; None if it answers no query."""
        answers = self.tracker.receive(reply, now_ns)
        if not answers:
            return None
        asked, _ = answers[-1]  # One question at a time: there is no other.
        self._silent_count = 0
        wait_ns = now_ns - asked.arrival_ns - self._line.time_ns(len(encode(reply)))
        turnaround_s = max(0.0, s_from_ns(wait_ns))
        if reply.keyword in self.servo.keywords:
            fault = self.servo.take(reply.keyword, reply.value)
            return PolledReading(asked.arrival_ns, turnaround_s, fault=fault)
        statement = read_reply(self.joint.model.language, reply)
        if statement is None or not isinstance(statement.value, int | float):
            return PolledReading(asked.arrival_ns, turnaround_s)
        if reply.keyword == "QD":
            return PolledReading(asked.arrival_ns, turnaround_s, reading_deg=float(statement.value))
        if reply.keyword == self.also:
            return PolledReading(asked.arrival_ns, turnaround_s, also=float(statement.value))
        fault = self._status_fault(int(statement.value), asked.arrival_ns)
        return PolledReading(asked.arrival_ns, turnaround_s, fault=fault)

    def _status_fault(self, code: int, asked_ns: int) -> str | None:
        """Return the fault that a status shows; None: there is none, or it is to be confirmed."""
        status = status_from(code, self.joint.model.family, self._firmware)
        before, self._status = self._status, status
        is_passing = status is Status.STUCK and before is not Status.STUCK
        if self.servo.is_limp_again(status, asked_ns):
            return STATUS_TEXTS[Cause.RESTARTED]
        return None if is_passing else status_fault(status)


def not_arrived(
    joint: Joint, *, way_deg: float, from_deg: float, rest_deg: float, target_deg: float
) -> str:
    """Return the fault text of a horn that went from `from_deg` to `rest_deg` only, or ''."""
    if way_deg < WAY_LEAST_DEG or abs(rest_deg - from_deg) >= ARRIVED_RATIO * way_deg:
        return ""
    return (
        f"was commanded to {joint.joint_deg(target_deg):.1f} deg and stays at "
        f"{joint.joint_deg(rest_deg):.1f} deg: it is blocked, or its load is too heavy. Free it, "
        f"and begin again"
    )


def outside(joint: Joint, window: MotionWindow, reading_deg: float) -> str:
    """Return the fault text of a horn at `reading_deg` outside the window, or ''."""
    if window.low_deg - GUARD_DEG <= reading_deg <= window.high_deg + GUARD_DEG:
        return ""
    low, high = sorted((joint.joint_deg(window.low_deg), joint.joint_deg(window.high_deg)))
    return (
        f"is at {joint.joint_deg(reading_deg):.1f} deg but was to stay within {low:.1f} to "
        f"{high:.1f} deg"
    )


HOLD_MS: Final = 300
"""T of the first command, whose target is the present angle."""
DITHER_S: Final = 0.02
"""Trials begin at instants spread evenly over this time, so that they meet the control loops of the
servo, whose period is some milliseconds, at every phase."""
GOLDEN_RATIO: Final = 0.6180339887498949


class Experiment(JointRun):
    """Measures one joint. `error` is set if that failed, `is_stopped` if a person ended it."""

    def __init__(
        self,
        joint: Joint,
        robot: Robot,
        answers: Answers,
        window: MotionWindow,
        *,
        standing_deg: float,
    ) -> None:
        """`answers` are for `handshake.questions`; the joint stands at `standing_deg` (servo)."""
        super().__init__(joint, robot, answers, window, standing_deg=standing_deg)
        self.recording = Recording(window, float(ramp_setting_deg_s2(joint)), joint.speed_max_deg_s)
        orders = handshake.session_orders([joint], answers)
        orders += handshake.unconfirmed_orders([joint], answers)
        self._dialogue = self._ask([*handshake.settings_queries([joint]), *orders])
        self._plans: deque[TrialPlan] = deque()
        self._planned = 0
        self._droop_deg = 0.0

    @property
    def progress_ratio(self) -> float:
        """The share of the trials that are over."""
        return 1.0 - len(self._plans) / self._planned if self._planned else 0.0

    def _prepared(self, now_ns: int) -> None:
        self._take_answers()
        probes = handshake.probes([self.joint], self._answers)
        self._poller.watch(probes.get(self.joint.name, ()), now_ns)
        self.state = ExperimentState.HOLD
        self._has_moved = True
        move = PlannedMove(0.0, self._standing_deg, HOLD_MS)
        self._begin(TrialPlan(TrialKind.STEP, (move,), s_from_ms(HOLD_MS)), now_ns)

    def _take(self, polled: PolledReading, now_ns: int) -> None:
        self.recording.turnarounds_s.append(polled.turnaround_s)
        super()._take(polled, now_ns)

    def _trial_over(self, now_ns: int) -> None:
        if self.error is None and self.state is ExperimentState.HOLD:
            self._plan()
            self._rested_deg = self._trial.rest_deg()
        elif self.error is None:
            self.recording.trials.append(self._trial)
            self._check_arrival()
            self._rested_deg = self._trial.rest_deg()
            if self._trial.kind is TrialKind.FAST:
                self._plan()
        if self.error is not None:
            return
        if self._plans:
            dither_s = DITHER_S * (GOLDEN_RATIO * len(self._plans) % 1.0)
            self._begin(self._plans.popleft(), now_ns + ns_from_s(dither_s))
        else:
            self._restore()

    def _plan(self) -> None:
        """Plan all trials; after the fast ones, plan the remaining ones again."""
        left = len(self._plans)
        top_deg_s = math.inf
        if self.state is ExperimentState.HOLD:
            self._droop_deg = self._target_deg - self._trial.rest_deg()
            self.state = ExperimentState.TRIALS
        else:
            top_deg_s = max(trial.fastest_deg_s() for trial in self.recording.trials)
        try:
            plans = make_trials(
                self.joint,
                self.window,
                self._standing_deg,
                droop_deg=self._droop_deg,
                top_deg_s=top_deg_s,
            )
        except LssMotionError as error:
            self.error = error
            return
        self._planned = len(plans)
        self._plans = deque(plans[-left:])

    def _check_arrival(self) -> None:
        """Set the error if the horn did not move to its target."""
        cause = not_arrived(
            self.joint,
            way_deg=abs(self._target_deg - self._trial.start_deg),
            from_deg=self._rested_deg,
            rest_deg=self._trial.rest_deg(),
            target_deg=self._target_deg,
        )
        if cause:
            self.error = self.error or self._fault(cause)
