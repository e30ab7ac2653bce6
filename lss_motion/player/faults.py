"""What goes wrong in a show, and the steps that the player takes.

What goes wrong on the way, and what becomes of the show for it.

What is done about what is wrong: warn, slow the show, wait and resume, hold, let go.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, LostPortError
from lss_motion.player.events import Faulted, Warned
from lss_motion.player.handshake import Recovery
from lss_motion.robot.on_fault import ENDING, Cause, FaultStep
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from lss_motion.player.handshake import Answers
    from lss_motion.player.player import Session
    from lss_motion.player.streamer import Streamer
    from lss_motion.player.transactions import Item
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.robot.on_fault import Ladders


SLOW_EVERY_NS: Final = NS_PER_S // 2
"""Chosen: a change of rate takes 0.3 s, and its effect must be seen before the next."""
SLOW_RATIO: Final = 0.5
SLOW_RATE_LEAST: Final = 0.1
"""A joint that cannot follow a tenth of its speed does not follow."""
RESUMES_MAX: Final = 10
"""Chosen: a line that breaks oftener than this in a show is broken."""


@dataclass(slots=True)
class _Climb:
    """Where one trouble stands on its ladder, and since when."""

    steps: tuple[FaultStep, ...]
    place: int
    since_ns: int

    @property
    def step(self) -> FaultStep:
        return self.steps[self.place]

    @property
    def is_last(self) -> bool:
        return self.place + 1 == len(self.steps)


class FaultEscalation:
    """Takes the steps of every trouble, one after the other. `faults` is what it came to.

    `rate_max` is the rate of the show clock that the troubles allow.
    """

    def __init__(self, robot: Robot, show: Ladders) -> None:
        self.faults: list[Faulted] = []
        self.rate_max = 1.0
        self._robot = robot
        self._show = show
        self._climbs: dict[tuple[str, Cause], _Climb] = {}
        self._slowed_ns: int | None = None
        self._resumes = 0

    @property
    def is_idle(self) -> bool:
        """Return whether there is no trouble, nor anything left to be done about an earlier one."""
        return not self._climbs and self._slowed_ns is None

    def judge(self, active_faults: Mapping[tuple[str, Cause], str], now_ns: int) -> list[Faulted]:
        """Return the steps to be taken now, given what is wrong now."""
        for gone in [trouble for trouble in self._climbs if trouble not in active_faults]:
            del self._climbs[gone]
        taken = []
        for (joint, cause), text in active_faults.items():
            climb = self._climbs.get((joint, cause))
            if climb is None:
                taken.append(self.begin(joint, cause, text, now_ns))
            elif now_ns >= self._next_ns(climb) and not climb.is_last:
                climb.place, climb.since_ns = climb.place + 1, now_ns
                taken.append(self._take(joint, cause, text, climb.step))
        self._slow(now_ns)
        return taken

    def taken_up(self, active_faults: Collection[tuple[str, Cause]]) -> set[str]:
        """Return the joints that were only warned of as silent, answer, and are to be resumed."""
        silent = {
            name
            for (name, cause), climb in self._climbs.items()
            if cause is Cause.SILENT and climb.step is not FaultStep.RESUME
        }
        back = {name for name in silent if (name, Cause.SILENT) not in active_faults}
        for name in sorted(back):
            steps = self._robot.ladder(Cause.RESTARTED, self._robot.joints[name], self._show)
            if FaultStep.RESUME not in steps or self._resumes >= RESUMES_MAX:
                back.remove(name)
        self._resumes += len(back)
        return back

    def begin(self, joint: str, cause: Cause, text: str, now_ns: int) -> Faulted:
        """Take the first step about a trouble. `joint` is empty for that of a port."""
        steps = self._robot.ladder(cause, self._robot.joints.get(joint), self._show)
        if self._resumes >= RESUMES_MAX and FaultStep.RESUME in steps:
            steps = tuple(step for step in steps if step is not FaultStep.RESUME) or (
                FaultStep.HOLD,
            )
        self._resumes += FaultStep.RESUME in steps
        self._climbs[joint, cause] = climb = _Climb(steps, 0, now_ns)
        return self._take(joint, cause, text, climb.step)

    def give_up(self, joint: str, cause: Cause, text: str) -> Faulted:
        """Take the step after `resume` about what did not come back: at the least, hold."""
        steps = self._robot.ladder(cause, self._robot.joints.get(joint), self._show)
        after = steps[steps.index(FaultStep.RESUME) + 1 :] if FaultStep.RESUME in steps else ()
        return self._take(joint, cause, text, next(iter(after), FaultStep.HOLD))

    def forget(self) -> None:
        """Begin at the foot of every ladder, as after all has been put right."""
        self._climbs.clear()
        self.rate_max, self._slowed_ns = 1.0, None

    def next_wakeup_ns(self) -> int | None:
        """Return when `judge` has something to do, if nothing is heard till then."""
        wakeups_ns = [self._next_ns(climb) for climb in self._climbs.values() if not climb.is_last]
        if self._slowed_ns is not None:
            wakeups_ns.append(self._slowed_ns + SLOW_EVERY_NS)
        return min(wakeups_ns, default=None)

    def _next_ns(self, climb: _Climb) -> int:
        return climb.since_ns + ns_from_s(self._robot.patience_s)

    def note(self, joint: str, cause: Cause, text: str, step: FaultStep) -> Faulted:
        """Keep in mind a step that was taken about a trouble; return it."""
        return self._take(joint, cause, text, step)

    def _take(self, joint: str, cause: Cause, text: str, step: FaultStep) -> Faulted:
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
        if any(climb.step is FaultStep.SLOW for climb in self._climbs.values()):
            self.rate_max = max(SLOW_RATIO * self.rate_max, SLOW_RATE_LEAST)
            self._slowed_ns = now_ns
        elif self.rate_max < 1.0:
            self.rate_max = min(self.rate_max / SLOW_RATIO, 1.0)
            self._slowed_ns = now_ns
        else:
            self._slowed_ns = None


RESTARTED_TEXT: Final = "had lost its settings and is given them again. Look at its power supply"
SILENT_TEXT: Final = (
    "does not answer where the show begins: its restart would look like this. Look at its cable "
    "and its power"
)


ABSENT: Final = (Cause.SILENT, Cause.RESTARTED)
"""With these nobody knows whether a servo still has the limits that it was given."""
LEFT_OUT_TEXT: Final = (
    "is sent no move until it is back and has its settings again (`on_fault`: `restarted: resume`)"
)


class Verdict(Enum):
    """What is to become of the show."""

    GO_ON = auto()
    RECOVER = auto()
    END = auto()


class Troubles:
    """Judges what a streamer has read, and keeps account of who is gone.

    `lost` are the buses without a port, with the reason. `recovery` is the wait that goes on, from
    its first trouble until the show goes on again. What is said about it all is in `events`.
    """

    def __init__(self, session: Session) -> None:
        self.escalation = FaultEscalation(session.robot, session.program.on_fault)
        self.lost: dict[str, str] = {}
        self.recovery: Recovery | None = None
        self.events: list[Faulted | Warned] = []
        self._session = session

    def forget(self) -> None:
        """Begin anew: the show goes on."""
        self.escalation.forget()
        self.recovery = None

    # ---- while something is streamed

    def judge(self, streamer: Streamer, now_ns: int) -> Verdict:
        """Take the steps that are due about what was read."""
        if streamer.scheduler is None:
            return Verdict.GO_ON
        if self.escalation.is_idle and not streamer.scheduler.health.active_faults:
            return Verdict.GO_ON
        active_faults = streamer.scheduler.health.active_faults.items()
        watched = {trouble: text for trouble, text in active_faults if self._is_watched(*trouble)}
        back = self.escalation.taken_up({trouble for trouble, _ in active_faults})
        taken = self.escalation.judge(watched, now_ns)
        for fault in taken:
            self._take(fault, now_ns)
        streamer.leave_out(self._session.left_out)
        if any(fault.step in ENDING for fault in taken):
            return Verdict.END
        gone = back | {fault.joint for fault in taken if fault.step is FaultStep.RESUME}
        if not gone:
            return Verdict.GO_ON
        self._session.left_out -= gone
        # What took one servo's power may have taken that of others, not noticed yet.
        gone |= streamer.scheduler.health.unresponsive()
        self._miss([joint for joint in self._session.driven if joint.name in gone], now_ns)
        return Verdict.RECOVER

    def lose(self, bus: str, reason: str, now_ns: int) -> Verdict:
        """Note that the port of a bus is gone."""
        self.lost[bus] = reason
        fault = self.escalation.begin("", Cause.LOST_PORT, reason, now_ns)
        self.events.append(fault)
        if fault.step is not FaultStep.RESUME:
            return Verdict.END
        self._miss([joint for joint in self._session.driven if joint.bus == bus], now_ns)
        return Verdict.RECOVER

    def arrive(self, restarted: list[Joint], silent: list[Joint], now_ns: int) -> Verdict:
        """Note who has restarted on the way to where the show begins, and who says nothing there.

        Who says nothing may be about to restart.
        """
        wrong = [(joint, Cause.RESTARTED, f"has restarted: servo {joint.servo_id} {RESTARTED_TEXT}")
                 for joint in restarted]  # fmt: skip
        wrong += [(joint, Cause.SILENT, f"is silent: servo {joint.servo_id} {SILENT_TEXT}")
                  for joint in silent]  # fmt: skip
        taken = [
            self.escalation.begin(joint.name, cause, text, now_ns) for joint, cause, text in wrong
        ]
        for fault in taken:
            self._take(fault, now_ns)
        if any(fault.step in ENDING for fault in taken):
            return Verdict.END
        joints = [joint for joint, _, _ in wrong]
        gone = [j for j, f in zip(joints, taken, strict=True) if f.step is FaultStep.RESUME]
        if not gone:
            return Verdict.GO_ON
        self._miss(gone, now_ns)
        return Verdict.RECOVER

    def is_resumable(self, bus: str) -> bool:
        """Return whether a port that is lost is to be waited for."""
        ladder = self._session.robot.ladder(Cause.LOST_PORT, None, self._session.program.on_fault)
        return bus in self.lost or FaultStep.RESUME in ladder

    def strayed(self, joint: str, off_deg: float, approaches: int) -> None:
        """Note that a joint does not get to where the show begins or goes on."""
        text = (
            f"is {off_deg:.1f} deg from where the show begins after {approaches} approaches. Look "
            f"for what holds it"
        )
        self.events.append(self.escalation.note(joint, Cause.ASTRAY, text, FaultStep.HOLD))

    # ---- while somebody is gone

    @property
    def missing(self) -> set[str]:
        """The joints that are waited for."""
        return {joint.name for joint in self.recovery.missing} if self.recovery else set()

    def questions(self) -> list[Item]:
        """Return what to ask those who are gone until they answer."""
        assert self.recovery is not None
        return self.recovery.questions(self._session.had)

    def is_over(self, now_ns: int) -> bool:
        """Return whether those who are gone have been waited for long enough."""
        return self.recovery is None or now_ns >= self.recovery.give_up_ns

    def give_up(self, answers: Answers, now_ns: int) -> BusError | None:
        """Take the step after waiting; return the error if it was for a port."""
        assert self.recovery is not None
        robot = self._session.robot
        waited = f"and was not back after {robot.resume_s:g} s"
        error = None
        for bus, reason in self.lost.items():
            error = LostPortError(f"{reason}, {waited}", url=robot.buses[bus].port)
            self.events.append(self.escalation.give_up("", Cause.LOST_PORT, error.reason))
        for joint in [] if self.lost else self.recovery.absent(answers):
            text = (
                f"is silent: servo {joint.servo_id} did not answer, {waited}. Look at its cable "
                f"and its power"
            )
            self._take(self.escalation.give_up(joint.name, Cause.SILENT, text), now_ns)
        return error

    def found(self, answers: Answers) -> None:
        """Note that all are back, and which of them had restarted."""
        assert self.recovery is not None
        for joint in self.recovery.restarted(answers, self._session.had):
            text = f"has restarted: servo {joint.servo_id} {RESTARTED_TEXT}"
            note = self.escalation.note(joint.name, Cause.RESTARTED, text, FaultStep.RESUME)
            self.events.append(note)

    def miss_again(self, silent: Iterable[Joint], wrong: Iterable[Item]) -> None:
        """Wait again for those who answered and then did not take their settings."""
        assert self.recovery is not None
        addresses = {(item.bus, item.command.servo_id) for item in wrong}
        silent = list(silent)
        self.recovery.missing = [
            joint
            for joint in self._session.driven
            if joint in silent or (joint.bus, joint.servo_id) in addresses
        ]

    def _miss(self, gone: list[Joint], now_ns: int) -> None:
        """Wait for these, too: as long as for any, however long others were waited for."""
        give_up_ns = now_ns + ns_from_s(self._session.robot.resume_s)
        if self.recovery is None:
            self.recovery = Recovery(give_up_ns)
        self.recovery.give_up_ns = give_up_ns
        self.recovery.add(gone)

    def _take(self, fault: Faulted, now_ns: int) -> None:
        """Say what went wrong, and do what concerns its joint alone."""
        self.events.append(fault)
        joint = self._session.robot.joints[fault.joint]
        if fault.step is FaultStep.LIMP:
            self._session.let_go(joint, now_ns)
        is_absent = fault.kind in ABSENT and fault.step is not FaultStep.RESUME
        if fault.step is FaultStep.LIMP or is_absent:
            if is_absent and fault.step not in ENDING and joint.name not in self._session.left_out:
                self.events.append(Warned(f"joint {joint.name!r} {LEFT_OUT_TEXT}"))
            self._session.left_out.add(joint.name)

    def _is_watched(self, name: str, cause: Cause) -> bool:
        """Return whether a trouble of a joint is judged: of one left out, only that it is gone."""
        if name not in self._session.left_out:
            return True
        is_let_go = any(joint.name == name for joint in self._session.limp)
        return cause in ABSENT and not is_let_go
