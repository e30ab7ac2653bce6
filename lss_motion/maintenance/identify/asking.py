"""Asks one servo where it is as often as the line allows, and now and then how it fares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.player.queries import Questioner
from lss_motion.player.watch import status_fault
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import Status, status_from
from lss_motion.protocol.line import Command, encode
from lss_motion.units import NS_PER_MS, s_from_ns

if TYPE_CHECKING:
    from lss_motion.player.line import Line
    from lss_motion.protocol.line import Reply
    from lss_motion.robot.model import Joint

READ_EVERY_NS: Final = 6 * NS_PER_MS
"""So often, if the line allows: ten readings in a ramp of 60 ms."""
STATUS_EVERY: Final = 10
"""One question in so many asks how the servo fares."""
SILENT_ASKS: Final = 6
"""So many questions in a row without an answer, with a pause after each, and it is silent."""


@dataclass(frozen=True, slots=True)
class Answered:
    """What an answer said: a position, or what is wrong with the servo, or neither."""

    asked_ns: int
    """When the servo had the question complete."""
    turnaround_s: float
    reading_deg: float | None = None
    fault: str | None = None


class Asking:
    """Questions to the servo of one joint, one at a time.

    A servo that is stuck must say so twice: a horn that turns back stands still for a moment.
    """

    def __init__(self, joint: Joint, line: Line) -> None:
        self.questioner = Questioner(line)
        self._joint = joint
        self._line = line
        self._next_ns = 0
        self._count = 0
        self._silent_count = 0
        self._status: Status | None = None

    @property
    def is_silent(self) -> bool:
        return self._silent_count >= SILENT_ASKS

    def ask(self, now_ns: int, quiet_until_ns: int | None) -> None:
        """Ask, if it is time and the line stays free until `quiet_until_ns`; None is for ever."""
        questioner, servo_id = self.questioner, self._joint.servo_id
        self._silent_count += len(questioner.expire(now_ns))
        if questioner.is_waiting(servo_id):
            return
        self._next_ns = max(self._next_ns, questioner.quiet_until_ns(servo_id))
        if now_ns < self._next_ns:
            return
        is_status = self._count % STATUS_EVERY == STATUS_EVERY - 1
        question = Command(servo_id, "Q" if is_status else "QD")
        ends_ns = self._line.heard_ns(len(encode(question)), now_ns)
        if quiet_until_ns is not None and ends_ns > quiet_until_ns:
            self._next_ns = quiet_until_ns
            return
        questioner.ask(question, now_ns)
        self._count += 1
        self._next_ns = now_ns + READ_EVERY_NS

    def next_wakeup_ns(self) -> int:
        give_up_ns = self.questioner.give_up_ns
        return self._next_ns if give_up_ns is None else give_up_ns

    def receive(self, reply: Reply, now_ns: int) -> Answered | None:
        """Return what `reply` says; None if it answers nothing that was asked."""
        answers = self.questioner.answer(reply, now_ns)
        if not answers:
            return None
        asked, _ = answers[-1]  # One question at a time: there is no other.
        self._silent_count = 0
        wait_ns = now_ns - asked.heard_ns - self._line.time_ns(len(encode(reply)))
        turnaround_s = max(0.0, s_from_ns(wait_ns))
        said = read_reply(self._joint.model.family, reply)
        if said is None or not isinstance(said.value, int | float):
            return Answered(asked.heard_ns, turnaround_s)
        if reply.keyword == "QD":
            return Answered(asked.heard_ns, turnaround_s, reading_deg=float(said.value))
        firmware = self._line.bus.firmware
        status = status_from(int(said.value), self._joint.model.family, firmware)
        before, self._status = self._status, status
        is_passing = status is Status.STUCK and before is not Status.STUCK
        fault = None if is_passing else status_fault(status)
        return Answered(asked.heard_ns, turnaround_s, fault=fault)
