"""Faults of a show, and the steps that the player takes about them.

`FaultHandler` turns what a streamer found, a lost port, or a servo that did not arrive into a
`Verdict` for the player, and keeps the recovery that is under way. `FaultEscalation` takes the
steps of `on_fault` for each fault, one after the other: warn, slow, resume, hold, limp.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, LostPortError, LssMotionError
from lss_motion.playing.player.events import Faulted, Warned
from lss_motion.playing.player.handshake import Recovery, not_applied_error, silent_error
from lss_motion.playing.player.health import turn_text
from lss_motion.robot.on_fault import ENDING, Cause, FaultStep
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.handshake import Answers, Dialogue, Item
    from lss_motion.playing.player.preflight import Preflight
    from lss_motion.playing.player.session import Session
    from lss_motion.playing.player.streamer import Streamer
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.robot.on_fault import Escalations


SLOW_EVERY_NS: Final = NS_PER_S // 2
"""Chosen: a change of rate takes 0.3 s, and its effect must show before the next change."""
SLOW_RATIO: Final = 0.5
RAISE_AFTER_NS: Final = 2 * NS_PER_S
"""The rate is raised again when no fault has slowed the show for so long. Measured: a joint that
waves passes its plan on its way, and was slowed and raised in every swing with half a second; RMS
of horns was then up to 1.2 times that of a show that is not slowed, and 0.8 times with two.
"""
SLOW_RATE_LEAST: Final = 0.1
"""A joint that cannot follow at a tenth of its speed does not follow at all."""
RESUMES_MAX: Final = 10
"""Chosen: a line that fails more often than this in a show is broken."""
DAMAGED_LEAST: Final = 5
"""So many unreadable pieces while a servo was waited for are reported. Chosen."""
FINDINGS_NS: Final = NS_PER_S
"""The models of the servos are judged this often."""


@dataclass(slots=True)
class _Escalated:
    """One active fault: its steps, the step that was taken last, and when."""

    steps: tuple[FaultStep, ...]
    index: int
    since_ns: int

    @property
    def step(self) -> FaultStep:
        return self.steps[self.index]

    @property
    def is_last(self) -> bool:
        return self.index + 1 == len(self.steps)


class FaultEscalation:
    """Takes the steps of every active fault, one after the other.

    `faults` are all faults so far, each with its highest step. `rate_max` is the rate of the show
    clock that the active faults allow.
    """

    def __init__(self, robot: Robot, show: Escalations) -> None:
        self.faults: list[Faulted] = []
        self.rate_max = 1.0
        self._robot = robot
        self._show = show
        self._active: dict[tuple[str, Cause], _Escalated] = {}
        self._slowed_ns: int | None = None
        self._slow_fault_ns = 0
        """Instant of the last fault that slows the show."""
        self._resumes = 0

    @property
    def is_idle(self) -> bool:
        """Return whether no fault is active, and the rate is not reduced for an earlier one."""
        return not self._active and self._slowed_ns is None

    def judge(self, active_faults: Mapping[tuple[str, Cause], str], now_ns: int) -> list[Faulted]:
        """Take the steps that are due; return them. `active_faults`: all faults of this instant."""
        for gone in [key for key in self._active if key not in active_faults]:
            del self._active[gone]
        taken = []
        for (joint, cause), text in active_faults.items():
            fault = self._active.get((joint, cause))
            if fault is None:
                taken.append(self.begin(joint, cause, text, now_ns))
            elif now_ns >= self._next_ns(fault) and not fault.is_last:
                fault.index, fault.since_ns = fault.index + 1, now_ns
                taken.append(self.note(joint, cause, text, fault.step))
        self._slow(now_ns)
        return taken

    def answering_again(self, active_faults: Collection[tuple[str, Cause]]) -> set[str]:
        """Return the joints that were silent, answer again, and must be resumed for that."""
        silent = {
            name
            for (name, cause), fault in self._active.items()
            if cause is Cause.SILENT and fault.step is not FaultStep.RESUME
        }
        back = {name for name in silent if (name, Cause.SILENT) not in active_faults}
        for name in sorted(back):
            steps = self._robot.escalation(Cause.RESTARTED, self._robot.joints[name], self._show)
            if FaultStep.RESUME not in steps or self._resumes >= RESUMES_MAX:
                back.remove(name)
        self._resumes += len(back)
        return back

    def begin(self, joint: str, cause: Cause, text: str, now_ns: int) -> Faulted:
        """Take the first step about a new fault. `joint` is empty for a fault of a port."""
        steps = self._robot.escalation(cause, self._robot.joints.get(joint), self._show)
        if self._resumes >= RESUMES_MAX and FaultStep.RESUME in steps:
            steps = tuple(step for step in steps if step is not FaultStep.RESUME) or (
                FaultStep.HOLD,
            )
        self._resumes += FaultStep.RESUME in steps
        if joint:  # What is no joint's ends with its recovery, and not by patience.
            self._active[joint, cause] = _Escalated(steps, 0, now_ns)
        return self.note(joint, cause, text, steps[0])

    def give_up(self, joint: str, cause: Cause, text: str) -> Faulted:
        """Take the step after `resume` for what did not come back: at least hold."""
        steps = self._robot.escalation(cause, self._robot.joints.get(joint), self._show)
        after = steps[steps.index(FaultStep.RESUME) + 1 :] if FaultStep.RESUME in steps else ()
        return self.note(joint, cause, text, next(iter(after), FaultStep.HOLD))

    def clear(self) -> None:
        """Forget the active faults: the next ones begin with their first step."""
        self._active.clear()
        self.rate_max, self._slowed_ns = 1.0, None

    def change_show(self, show: Escalations) -> None:
        """Take the steps of another show from now on, which may resume as often as the first."""
        self._show, self._resumes = show, 0

    def wakeups_ns(self) -> list[int]:
        """Return when `judge` has something to do if no servo answers before."""
        wakeups_ns = [] if self._slowed_ns is None else [self._slowed_ns + SLOW_EVERY_NS]
        if self._active:
            active = self._active.values()
            wakeups_ns += [self._next_ns(fault) for fault in active if not fault.is_last]
        return wakeups_ns

    def _next_ns(self, fault: _Escalated) -> int:
        return fault.since_ns + ns_from_s(self._robot.patience_s)

    def note(self, joint: str, cause: Cause, text: str, step: FaultStep) -> Faulted:
        """Record a step that was taken about a fault; return it."""
        fault = Faulted(joint, text, cause, step)
        same = [i for i, f in enumerate(self.faults) if (f.joint, f.kind) == (joint, cause)]
        if not same:
            self.faults.append(fault)
        elif list(FaultStep).index(step) >= list(FaultStep).index(self.faults[same[0]].step):
            self.faults[same[0]] = fault
        return fault

    def _slow(self, now_ns: int) -> None:
        if self._slowed_ns is not None and now_ns < self._slowed_ns + SLOW_EVERY_NS:
            return
        if any(fault.step is FaultStep.SLOW for fault in self._active.values()):
            self.rate_max = max(SLOW_RATIO * self.rate_max, SLOW_RATE_LEAST)
            self._slowed_ns = self._slow_fault_ns = now_ns
        elif self.rate_max < 1.0:
            if now_ns >= self._slow_fault_ns + RAISE_AFTER_NS:
                self.rate_max = min(self.rate_max / SLOW_RATIO, 1.0)
            self._slowed_ns = now_ns
        else:
            self._slowed_ns = None


RESTARTED_TEXT: Final = "had lost its settings and is given them again. Look at its power supply"
SILENT_TEXT: Final = (
    "does not answer where the show begins: its restart would look like this. Look at its cable "
    "and its power"
)
ABSENT: Final = (Cause.SILENT, Cause.RESTARTED, Cause.LOST_TURN)
"""With these it is unknown whether a servo still has the limits that it was given, or where it
is."""
LEFT_OUT_TEXT: Final = (
    "is sent no move until it is back and has its settings again (`on_fault`: `restarted: resume`)"
)


class Verdict(Enum):
    """Decision about the show after faults were judged."""

    CONTINUE = auto()
    RECOVER = auto()
    END = auto()


class FaultHandler:
    """Decides about the faults of one show.

    `lost_ports` are the buses without a port, with the reason. `recovery` is the wait for missing
    servos, from the first fault until the show goes on again.
    """

    def __init__(self, session: Session) -> None:
        self.escalation = FaultEscalation(session.robot, session.on_fault)
        self.lost_ports: dict[str, str] = {}
        self.recovery: Recovery | None = None
        self._suspected: set[str] = set()
        """Joints whose answers came twice, which may be two servos."""
        self._named: set[str] = set()
        """Joints that were reported as other than the robot file says."""
        self._judged_ns = 0
        self._events: list[Event] = []
        self._session = session

    def take_events(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    def clear(self) -> None:
        """Forget faults and recovery: the show goes on."""
        self.escalation.clear()
        self.recovery = None

    # ---- while a program is streamed

    def judge(self, streamer: Streamer, now_ns: int) -> Verdict:
        """Take the steps that are due about the faults that `streamer` has found."""
        if streamer.scheduler is None:
            return Verdict.CONTINUE
        if now_ns >= self._judged_ns + FINDINGS_NS:
            self._judged_ns = now_ns
            self._judge_models(streamer)
        health = streamer.scheduler.health
        if not health.active_faults and self.escalation.is_idle:
            return Verdict.CONTINUE
        # A joint in another turn is stopped, not resumed: first that is known.
        found = {
            (name, cause): text
            for (name, cause), text in health.active_faults.items()
            if cause is not Cause.RESTARTED or not health.may_be_turned(name)
        }
        watched = {key: text for key, text in found.items() if self._is_watched(*key)}
        answering = self.escalation.answering_again(found.keys())
        taken = self.escalation.judge(watched, now_ns)
        for fault in taken:
            self._take(fault, now_ns)
        streamer.leave_out(self._session.left_out)
        if any(fault.step in ENDING for fault in taken):
            return Verdict.END
        gone = answering | {fault.joint for fault in taken if fault.step is FaultStep.RESUME}
        if not gone:
            return Verdict.CONTINUE
        self._session.put_back(gone)
        self._suspected |= health.doubled
        # A power failure of one servo may have hit others that have not been noticed yet.
        gone |= health.awaited.keys() | streamer.scheduler.doubted
        missing = [joint for joint in self._session.driven if joint.name in gone]
        self._wait_for(missing, now_ns)
        streamer.scheduler.doubt_all({joint.bus for joint in missing})
        return Verdict.RECOVER

    def _judge_models(self, streamer: Streamer) -> None:
        """Report once for each joint that its servo is not what the robot file says."""
        for name, state in streamer.joint_states.items():
            if name not in self._named and (text := state.finding):
                self._named.add(name)
                self._events.append(Warned(text))

    def arrive(self, restarted: list[Joint], silent: list[Joint], now_ns: int) -> Verdict:
        """Judge servos that restarted during the approach, and servos that are silent after it.

        A silent servo may be about to restart.
        """
        wrong = [(joint, Cause.RESTARTED, f"has restarted: servo {joint.servo_id} {RESTARTED_TEXT}")
                 for joint in restarted]  # fmt: skip
        wrong += [(joint, Cause.SILENT, f"is silent: servo {joint.servo_id} {SILENT_TEXT}")
                  for joint in silent]  # fmt: skip
        taken = self._begin(wrong, now_ns)
        if any(fault.step in ENDING for fault in taken):
            return Verdict.END
        joints = [joint for joint, _, _ in wrong]
        gone = [j for j, f in zip(joints, taken, strict=True) if f.step is FaultStep.RESUME]
        if not gone:
            return Verdict.CONTINUE
        self._wait_for(gone, now_ns)
        return Verdict.RECOVER

    def lose_turns(self, turned: Iterable[tuple[Joint, float, float]], now_ns: int) -> Verdict:
        """Judge joints that report a servo angle in another turn than the one where they were."""
        wrong = [
            (joint, Cause.LOST_TURN, turn_text(joint, reported_deg, before_deg))
            for joint, reported_deg, before_deg in turned
        ]
        return Verdict.END if self._begin(wrong, now_ns) else Verdict.CONTINUE

    def _begin(self, wrong: Sequence[tuple[Joint, Cause, str]], now_ns: int) -> list[Faulted]:
        """Take the first steps about new faults; return them."""
        begin = self.escalation.begin
        taken = [begin(joint.name, cause, text, now_ns) for joint, cause, text in wrong]
        for fault in taken:
            self._take(fault, now_ns)
        return taken

    def note_astray(self, joint: str, off_deg: float, approaches: int) -> None:
        """Note that a joint does not reach the place where the show begins or goes on."""
        text = (
            f"is {off_deg:.1f} deg from where the show begins after {approaches} approaches. Look "
            f"for what holds it"
        )
        self._events.append(self.escalation.note(joint, Cause.ASTRAY, text, FaultStep.HOLD))

    def goal_misses(self, streamer: Streamer) -> dict[str, float]:
        """Return the joints beyond their goal tolerance by their last reading, and by how far."""
        if streamer.scheduler is None:
            return {}
        return {
            name: abs(state.disturbance.error_deg)
            for name, state in streamer.joint_states.items()
            if name not in self._session.left_out
            and state.joint.drive != "stepped"
            and abs(state.disturbance.error_deg) > state.joint.goal_deg
        }

    def note_goal(self, name: str, off_deg: float) -> Verdict:
        """Note that a joint has not reached its goal in its time: a warning, or no finish."""
        joint = self._session.robot.joints[name]
        key = "following_deg" if joint.goal_tolerance_deg is None else "goal_tolerance_deg"
        text = (
            f"is {off_deg:.1f} deg from its goal {joint.goal_time_s:g} s after the show, allowed "
            f"is {joint.goal_deg:g} deg ({key}). Look for what holds it"
        )
        steps = self._session.robot.escalation(Cause.ASTRAY, joint, self._session.on_fault)
        step = FaultStep.WARN if steps == (FaultStep.WARN,) else FaultStep.HOLD
        self._events.append(self.escalation.note(name, Cause.ASTRAY, text, step))
        return Verdict.CONTINUE if step is FaultStep.WARN else Verdict.END

    def _take(self, fault: Faulted, now_ns: int) -> None:
        """Report a step, and carry out what concerns its joint alone."""
        self._events.append(fault)
        robot = self._session.robot
        joint, together = robot.joints[fault.joint], robot.together(fault.joint)
        if fault.step is FaultStep.LIMP:
            for name in together:
                self._session.make_limp(robot.joints[name], now_ns)
                self._session.leave_out(name)
        elif fault.kind is Cause.LOST_TURN:
            self._session.halt(joint, now_ns)
        is_absent = fault.kind in ABSENT and fault.step is not FaultStep.RESUME
        if fault.step is FaultStep.LIMP or is_absent:
            if is_absent and fault.step not in ENDING and joint.name not in self._session.left_out:
                self._events.append(Warned(f"joint {joint.name!r} {LEFT_OUT_TEXT}"))
            self._session.leave_out(joint.name)

    def _is_watched(self, name: str, cause: Cause) -> bool:
        """Return whether a fault counts: of a joint that is left out only that it is absent."""
        if name not in self._session.left_out:
            return True
        is_limp = any(joint.name == name for joint in self._session.limp)
        return cause in ABSENT and not is_limp

    def lose_sound(self, text: str) -> Verdict:
        """Judge a sound that cannot be played: a warning, or the end of the show."""
        steps = self._session.robot.escalation(Cause.SOUND, None, self._session.on_fault)
        if steps[0] is FaultStep.WARN:
            self._events.append(Warned(text))
            return Verdict.CONTINUE
        self._events.append(self.escalation.note("", Cause.SOUND, text, steps[0]))
        return Verdict.END

    def stall(self, text: str, now_ns: int) -> Verdict:
        """Note that this program was held up while a move was due.

        All servos are examined before the show goes on: they may have restarted meanwhile.
        """
        fault = self.escalation.begin("", Cause.STALLED, text, now_ns)
        self._events.append(fault)
        if fault.step is not FaultStep.RESUME:
            return Verdict.END
        self._wait_for(self._session.driven, now_ns)
        return Verdict.RECOVER

    def extend_recovery(self, by_ns: int) -> None:
        """Wait longer for the missing servos: this program was held up meanwhile."""
        if self.recovery is not None:
            self.recovery.give_up_ns += by_ns

    # ---- ports

    def lose_port(self, bus: str, reason: str, now_ns: int) -> Verdict:
        """Note that the port of a bus is gone."""
        self.lost_ports[bus] = reason
        fault = self.escalation.begin("", Cause.LOST_PORT, reason, now_ns)
        self._events.append(fault)
        if fault.step is not FaultStep.RESUME:
            return Verdict.END
        self._wait_for([joint for joint in self._session.driven if joint.bus == bus], now_ns)
        return Verdict.RECOVER

    def find_port(self, bus: str) -> None:
        """Note that the port of a bus is back."""
        self.lost_ports.pop(bus, None)

    def is_resumable(self, bus: str) -> bool:
        """Return whether the player waits for a port that is lost."""
        show = self._session.on_fault
        steps = self._session.robot.escalation(Cause.LOST_PORT, None, show)
        return bus in self.lost_ports or FaultStep.RESUME in steps

    # ---- recovery

    @property
    def missing(self) -> set[str]:
        """The joints whose servos are missing."""
        return {joint.name for joint in self.recovery.missing} if self.recovery else set()

    def recovery_dialogue(self, now_ns: int) -> Dialogue | Preflight:
        """Return the queries to the missing servos, repeated until they answer.

        First, other servos are looked for with the id of one whose answers came twice.
        """
        assert self.recovery is not None
        suspects = [one for one in self.recovery.missing if one.name in self._suspected]
        self._suspected.clear()
        if suspects:
            return self.proof({}, now_ns, suspects)
        return self._session.dialogue(self.recovery.queries(self._session.original))

    def proof(self, answers: Answers, now_ns: int, suspects: Sequence[Joint] = ()) -> Preflight:
        """Return the dialogue that compares servos with what they were.

        Those that answer again, and others that were not heard, since they were not asked while
        these were waited for.
        """
        assert self.recovery is not None
        missing = self.recovery.missing
        others = [one for one in self._session.unheard(now_ns) if one not in missing]
        return self._session.proof([*missing, *others], answers, suspects)

    def prove(self, preflight: Preflight, now_ns: int) -> LssMotionError | None:
        """Return why a servo that was away must not move: it is another one, or answers no more.

        For what it left open it is waited again, if there is time.
        """
        try:
            preflight.require_same()
        except LssMotionError as error:
            return error
        if left := preflight.unproved:
            return self.wait_again(left, (), preflight.answers, now_ns)
        if self.recovery is not None:
            self._end_recovery(self.recovery, preflight.answers)
        return None

    def is_over(self, now_ns: int) -> bool:
        """Return whether the time for the recovery is over, or there is none."""
        return self.recovery is None or now_ns >= self.recovery.give_up_ns

    def give_up(self, answers: Answers, now_ns: int) -> BusError | None:
        """Take the step after waiting; return the error if a port is missing."""
        assert self.recovery is not None
        robot = self._session.robot
        waited = f"and was not back after {robot.resume_s:g} s"
        error = None
        for bus, reason in self.lost_ports.items():
            error = LostPortError(f"{reason}, {waited}", url=robot.buses[bus].port)
            self._events.append(self.escalation.give_up("", Cause.LOST_PORT, error.reason))
        for joint in [] if self.lost_ports else self.recovery.absent(answers):
            text = (
                f"is silent: servo {joint.servo_id} did not answer, {waited}. Look at its cable "
                f"and its power{self._damaged_text(joint, self.recovery)}"
            )
            self._take(self.escalation.give_up(joint.name, Cause.SILENT, text), now_ns)
        return error

    def _damaged_text(self, joint: Joint, recovery: Recovery) -> str:
        """Return what damaged bytes in place of answers may mean; empty if there were few."""
        count = self._session.lines[joint.bus].garbage - recovery.garbage[joint.bus]
        if count < DAMAGED_LEAST:
            return ""
        return (
            f". Damaged bytes came instead, as when two servos have the id {joint.servo_id}: "
            f"lss-motion scan"
        )

    def _end_recovery(self, recovery: Recovery, answers: Answers) -> None:
        """Note that all servos answer again; report those that had restarted."""
        for joint in recovery.restarted(answers, self._session.original):
            text = f"has restarted: servo {joint.servo_id} {RESTARTED_TEXT}"
            note = self.escalation.note(joint.name, Cause.RESTARTED, text, FaultStep.RESUME)
            self._events.append(note)

    def wait_again(
        self, silent: Sequence[Joint], wrong: Sequence[Item], answers: Answers, now_ns: int
    ) -> LssMotionError | None:
        """Wait for servos that fell silent or did not take their settings (`wrong`).

        Return the error if the time for that is over.
        """
        session = self._session
        if self.is_over(now_ns) and wrong:
            return not_applied_error(wrong[0], answers, session.joints)
        if self.is_over(now_ns):
            return silent_error(silent, session.joints, session.robot, answers)
        assert self.recovery is not None
        addresses = {(item.bus, item.command.servo_id) for item in wrong}
        self.recovery.replace_missing(
            joint
            for joint in session.driven
            if joint in silent or (joint.bus, joint.servo_id) in addresses
        )
        return None

    def _wait_for(self, gone: list[Joint], now_ns: int) -> None:
        """Wait for these servos, too. The whole time begins anew for all."""
        give_up_ns = now_ns + ns_from_s(self._session.robot.resume_s)
        if self.recovery is None:
            lines = self._session.lines.items()
            self.recovery = Recovery(give_up_ns, {name: line.garbage for name, line in lines})
        self.recovery.add(gone, give_up_ns)
