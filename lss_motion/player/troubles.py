"""What goes wrong on the way, and what becomes of the show for it."""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, LostPortError
from lss_motion.player.events import Warned
from lss_motion.player.ladder import Ladder
from lss_motion.player.recovery import Recovery
from lss_motion.robot.on_fault import ENDING, Cause, FaultStep
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.player.dialogue import Item
    from lss_motion.player.events import Faulted
    from lss_motion.player.session import Session
    from lss_motion.player.settings import Answers
    from lss_motion.player.streamer import Streamer
    from lss_motion.robot.model import Joint


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
        self.ladder = Ladder(session.robot, session.program.on_fault)
        self.lost: dict[str, str] = {}
        self.recovery: Recovery | None = None
        self.events: list[Faulted | Warned] = []
        self._session = session

    def forget(self) -> None:
        """Begin anew: the show goes on."""
        self.ladder.forget()
        self.recovery = None

    # ---- while something is streamed

    def judge(self, streamer: Streamer, now_ns: int) -> Verdict:
        """Take the steps that are due about what was read."""
        if streamer.reader is None:
            return Verdict.GO_ON
        if self.ladder.is_idle and not streamer.reader.watch.troubles:
            return Verdict.GO_ON
        troubles = streamer.reader.watch.troubles.items()
        watched = {trouble: text for trouble, text in troubles if self._is_watched(*trouble)}
        back = self.ladder.taken_up({trouble for trouble, _ in troubles})
        taken = self.ladder.judge(watched, now_ns)
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
        gone |= streamer.reader.watch.quiet()
        self._miss([joint for joint in self._session.driven if joint.name in gone], now_ns)
        return Verdict.RECOVER

    def lose(self, bus: str, reason: str, now_ns: int) -> Verdict:
        """Note that the port of a bus is gone."""
        self.lost[bus] = reason
        fault = self.ladder.begin("", Cause.LOST_PORT, reason, now_ns)
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
        taken = [self.ladder.begin(joint.name, cause, text, now_ns) for joint, cause, text in wrong]
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
        self.events.append(self.ladder.note(joint, Cause.ASTRAY, text, FaultStep.HOLD))

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
            self.events.append(self.ladder.give_up("", Cause.LOST_PORT, error.reason))
        for joint in [] if self.lost else self.recovery.absent(answers):
            text = (
                f"is silent: servo {joint.servo_id} did not answer, {waited}. Look at its cable "
                f"and its power"
            )
            self._take(self.ladder.give_up(joint.name, Cause.SILENT, text), now_ns)
        return error

    def found(self, answers: Answers) -> None:
        """Note that all are back, and which of them had restarted."""
        assert self.recovery is not None
        for joint in self.recovery.restarted(answers, self._session.had):
            text = f"has restarted: servo {joint.servo_id} {RESTARTED_TEXT}"
            note = self.ladder.note(joint.name, Cause.RESTARTED, text, FaultStep.RESUME)
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
