"""How replies leave: after which turnaround, in which order, and what happens to them."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING, NamedTuple, Protocol

from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.sim.faults import damaged
from lss_motion.sim.physics import CORRUPT_SERIAL_RATIO, corrupt_reply_ratio_of, turnaround_of
from lss_motion.sim.servo import ORDERED_FIRMWARE, Servo

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.sim.faults import Faults
    from lss_motion.sim.physics import Physics
    from lss_motion.sim.wire import ServoLine


class Talker(Protocol):
    """What sends one reply after the other: a servo, or a board for all its pins."""

    sent_ns: int
    random: Random


class Answer(NamedTuple):
    """A reply, the command that it answers, and who says so as which id."""

    talker: Talker
    servo_id: int
    command: Command
    reply: Reply


class Answering:
    """Puts replies on the line from the servos to the host."""

    def __init__(
        self, line: ServoLine, faults: Faults, *, physics: Physics, firmware: int, seed: int
    ) -> None:
        self._line = line
        self._faults = faults
        self._turnaround = physics.turnaround or turnaround_of(firmware)
        self._is_ordered = firmware >= ORDERED_FIRMWARE
        ratio = physics.corrupt_reply_ratio
        self._race_ratio = corrupt_reply_ratio_of(firmware) if ratio is None else ratio
        self._race = Random(f"{seed}/race")

    def send_each(self, heard_ns: int, answers: Sequence[Answer]) -> None:
        """Let everybody answer as soon as it can; several at once damage each other's bytes."""
        for answer in answers:
            self._send(answer, self._start_ns(answer, heard_ns))

    def send_in_turn(self, heard_ns: int, answers: Sequence[Answer]) -> None:
        """Answer a group: one servo after another, in the order of the line (FACTS.md W17)."""
        start_ns = heard_ns + self._turnaround.group_ns
        previous: Talker | None = None
        for answer in answers:
            if previous is not None and answer.talker is not previous:
                start_ns += self._turnaround.group_gap_ns
            previous = answer.talker
            start_ns = self._send(answer, start_ns)

    def _start_ns(self, answer: Answer, heard_ns: int) -> int:
        """Return when somebody begins to answer one query."""
        turnaround, command, servo = self._turnaround, answer.command, answer.talker
        is_slotted = self._is_ordered and command.servo_id == BROADCAST_ID
        if is_slotted and isinstance(servo, Servo):
            if command.keyword == "QID" and isinstance(command.value, int):
                slot_ns = command.value * 1000 * servo.servo_id
                return heard_ns + turnaround.broadcast_ns + slot_ns
            if servo.settings.number("SLOTCOUNT"):
                slot_ns = turnaround.slot_ns * servo.settings.number("SLOT")
                return heard_ns + turnaround.broadcast_ns + slot_ns
        wait_ns = servo.random.randint(turnaround.single_min_ns, turnaround.single_max_ns)
        return heard_ns + wait_ns

    def _send(self, answer: Answer, start_ns: int) -> int:
        """Send one reply once its sender has sent the one before; return when it ends."""
        talker, servo_id, _, reply = answer
        sender = self._faults.sender(servo_id, start_ns)
        if sender != servo_id and reply.servo_id == servo_id:
            reply = replace(reply, servo_id=sender)
        data = encode(reply)
        if self._race_ratio and isinstance(talker, Servo):
            ratio = self._race_ratio * (CORRUPT_SERIAL_RATIO if reply.keyword == "QN" else 1.0)
            if self._race.random() < ratio:
                data = damaged(data, self._race)
        for piece, begin_ns in self._faults.sent(servo_id, data, start_ns):
            talker.sent_ns = self._line.send(piece, max(begin_ns, talker.sent_ns))
        return max(start_ns, talker.sent_ns)
