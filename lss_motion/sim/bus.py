"""One serial line with servos on it, as a pure function of time: no clock, no thread, no port."""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.family import Family
from lss_motion.protocol.line import Command, CommandParser, Reply, encode
from lss_motion.sim.faults import FaultKind, Faults
from lss_motion.sim.motors import Motors
from lss_motion.sim.physics import TICK_NS, Physics, turnaround_of
from lss_motion.sim.servo import ORDERED_FIRMWARE, Servo
from lss_motion.sim.truth import Truth
from lss_motion.sim.wire import HostLine, ServoLine

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from lss_motion.sim.faults import Fault, Turn
    from lss_motion.sim.physics import ServoSpec


class SimBus:
    """Servos on a serial line, told the time by its caller; the first instant is power-up.

    `write(data, now_ns)`     the host's bytes enter the line, queued behind earlier ones
    `read(now_ns)`            what has arrived at the host since the last `read`
    `next_arrival_ns()`       when the next reply is complete; None: none is under way
    `advance(now_ns)`         bring everything up to now; `write` and `read` do so too

    Instants do not go back. How often anything is called changes nothing of what happens.
    """

    def __init__(
        self,
        servos: Sequence[ServoSpec],
        *,
        baud_bps: int,
        firmware: int,
        seed: int = 0,
        physics: Physics | None = None,
        faults: Sequence[Fault] = (),
    ) -> None:
        physics = physics or Physics()
        boards = [spec.servo_id for spec in servos if spec.model.family is Family.IO2]
        if boards:
            raise InputError(f"ids {boards}: LSS-2IO boards are not simulated yet")
        randoms = [Random(f"{seed}/{index}") for index in range(len(servos))]
        phases_ns = [random.randrange(TICK_NS) for random in randoms]
        self.baud_bps = baud_bps
        self.motors = Motors(servos, physics, phases_ns)
        self.heard: list[tuple[int, bytes]] | None = None
        """After `record()`: every line that reached the servos, and when its CR did."""
        self._turnaround = physics.turnaround or turnaround_of(firmware)
        self._is_ordered = firmware >= ORDERED_FIRMWARE
        self._parser = CommandParser(grouped=self._is_ordered)
        self._host_line = HostLine(baud_bps)
        self._servo_line = ServoLine(baud_bps, Random(f"{seed}/line"))
        self._faults = Faults(faults, Random(f"{seed}/faults"))
        self._is_started = False
        self._servos = [
            Servo(
                spec,
                index,
                self.motors,
                firmware=firmware,
                baud_bps=baud_bps,
                random=randoms[index],
            )
            for index, spec in enumerate(servos)
        ]

    def record(self) -> None:
        """Keep `heard` and the true angles from now on; to be called before the first instant."""
        assert not self._is_started, "what happened before cannot be recorded"
        self.heard = []
        self.motors.truth = Truth(len(self._servos))

    def write(self, data: bytes, now_ns: int) -> None:
        self.advance(now_ns)
        self._host_line.write(data, now_ns)

    def read(self, now_ns: int) -> bytes:
        self.advance(now_ns)
        return self._servo_line.read(now_ns)

    def next_arrival_ns(self) -> int | None:
        """Return when the earliest reply that was not read to its end is complete.

        What the host has written will reach the servos whatever it writes later, so this looks
        as far ahead as the bytes on the line allow.
        """
        lines = self._host_line.lines
        while lines:
            end_ns = self._servo_line.next_end_ns()
            if end_ns is not None and end_ns <= lines[0][0]:
                break
            self._hear(*lines.popleft())
        return self._servo_line.next_end_ns()

    def advance(self, now_ns: int) -> None:
        if not self._is_started:
            self._is_started = True
            self.motors.start(now_ns)
            self._faults.start(now_ns)
        lines = self._host_line.lines
        while lines and lines[0][0] <= now_ns:
            self._hear(*lines.popleft())
        self._turn_until(now_ns)
        self.motors.advance(now_ns)

    @property
    def is_resting(self) -> bool:
        """Return whether no horn moves and nothing is on its way to make one move."""
        return self.motors.is_resting and not self._host_line.lines

    def backlog_ns(self, now_ns: int) -> int:
        """Return how long the host's bytes will still occupy the line."""
        return self._host_line.backlog_ns(now_ns)

    def horn_deg(self, times_ns: Iterable[int]) -> NDArray[np.float64]:
        """Return the true servo angles at given instants, (instants, servos), in the order given.

        Only after `record()`, and up to the instant of the last `advance`.
        """
        assert self.motors.truth is not None, "nothing was recorded"
        return self.motors.truth.horn_deg(times_ns)

    # -- what the servos hear -------------------------------------------------------------------

    def _hear(self, heard_ns: int, line: bytes) -> None:
        self._turn_until(heard_ns)
        self.motors.advance(heard_ns)
        line = self._faults.heard(line, heard_ns)
        if self.heard is not None and line:
            self.heard.append((heard_ns, line))
        commands = [item for item in self._parser.feed(line) if isinstance(item, Command)]
        answers: list[tuple[Servo, Command, Reply]] = []
        for command in commands:
            for servo in self._meant(command.servo_id):
                reply = servo.obey(command, heard_ns) if self._hears(servo, heard_ns) else None
                if reply is not None:
                    answers.append((servo, command, reply))
        is_group = self._is_ordered and len(commands) > 1
        if is_group and all(command.servo_id != BROADCAST_ID for command in commands):
            self._send_in_turn(heard_ns, answers)
        else:
            for servo, command, reply in answers:
                self._send(servo, reply, self._start_ns(servo, command, heard_ns))

    def _meant(self, servo_id: int) -> list[Servo]:
        if servo_id == BROADCAST_ID:
            return self._servos
        return [servo for servo in self._servos if servo.servo_id == servo_id]

    def _start_ns(self, servo: Servo, command: Command, heard_ns: int) -> int:
        """Return when a servo begins to answer one query."""
        turnaround = self._turnaround
        if command.servo_id == BROADCAST_ID and self._is_ordered:
            if command.keyword == "QID" and isinstance(command.value, int):
                slot_ns = command.value * 1000 * servo.servo_id
                return heard_ns + turnaround.broadcast_ns + slot_ns
            if servo.settings.number("SLOTCOUNT"):
                slot_ns = turnaround.slot_ns * servo.settings.number("SLOT")
                return heard_ns + turnaround.broadcast_ns + slot_ns
        return heard_ns + servo.random.randint(turnaround.single_min_ns, turnaround.single_max_ns)

    def _send_in_turn(self, heard_ns: int, answers: list[tuple[Servo, Command, Reply]]) -> None:
        """Answer a group: one servo after another, in the order of the line (lss_facts 2.3)."""
        start_ns = heard_ns + self._turnaround.group_ns
        previous: Servo | None = None
        for servo, _, reply in answers:
            if previous is not None and servo is not previous:
                start_ns += self._turnaround.group_gap_ns
            previous = servo
            start_ns = self._send(servo, reply, start_ns)

    def _send(self, servo: Servo, reply: Reply, start_ns: int) -> int:
        """Send one reply once the servo has sent the one before; return when it ends."""
        sender = self._faults.sender(servo.servo_id, start_ns)
        if sender != servo.servo_id and reply.servo_id == servo.servo_id:
            reply = replace(reply, servo_id=sender)
        for data, begin_ns in self._faults.sent(servo.servo_id, encode(reply), start_ns):
            servo.sent_ns = self._servo_line.send(data, max(begin_ns, servo.sent_ns))
        return max(start_ns, servo.sent_ns)

    # -- faults ---------------------------------------------------------------------------------

    def _hears(self, servo: Servo, now_ns: int) -> bool:
        is_deaf = self._faults.is_deaf(servo.servo_id, now_ns)
        return servo.baud_bps == self.baud_bps and servo.is_listening(now_ns) and not is_deaf

    def _turn_until(self, now_ns: int) -> None:
        """Let the faults of servos that are due begin and end."""
        while (due_ns := self._faults.next_turn_ns()) is not None and due_ns <= now_ns:
            turn = self._faults.pop_turn()
            self.motors.advance(due_ns)
            for servo in self._servos:
                if turn.fault.servo_id in (None, servo.servo_id):
                    self._befall(servo, turn)

    def _befall(self, servo: Servo, turn: Turn) -> None:
        fault, index = turn.fault, servo.index
        match fault.kind:
            case FaultKind.RESET:
                servo.reset(turn.due_ns)
            case FaultKind.HOT:
                self.motors.heat(index, turn.due_ns, fault.temperature_c)
            case FaultKind.STUCK:
                self.motors.jam(index, turn.due_ns, is_jammed=turn.is_begin)
            case FaultKind.WEAK:
                ratio = fault.speed_ratio if turn.is_begin else 1.0
                self.motors.weaken(index, turn.due_ns, ratio)
            case _:
                raise AssertionError(f"{fault.kind} is not about a servo")
