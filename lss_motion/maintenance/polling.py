"""Asking servos where they are, one after the other, as fast as their line allows."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.player.events import Faulted
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import Status, status_from
from lss_motion.protocol.line import Command, encode
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.line import Line
    from lss_motion.player.queries import Questioner
    from lss_motion.protocol.line import Reply
    from lss_motion.robot.model import Joint, Robot

STATUS_NS: Final = NS_PER_S // 2
"""How often one joint, the next each time, is asked for its status: safe mode is noticed."""
SILENT_NS: Final = NS_PER_S
"""A joint without an answer for so long is named. Chosen: nobody waits longer to be told."""
IDLE_NS: Final = 20 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class Reading:
    """Where a joint was when its servo heard the question, in joint degrees."""

    joint: str
    at_ns: int
    deg: float


class Poller:
    """Orders before questions, as many of these in flight as can be told apart.

    The latest angles are in `readings`; `take()` returns what came since the last call.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Iterable[Joint],
        lines: Mapping[str, Line],
        questioners: Mapping[str, Questioner],
    ) -> None:
        self.readings: dict[str, Reading] = {}
        self.faults: deque[Faulted] = deque()
        self._robot = robot
        self._lines = lines
        self._questioners = questioners
        self._fresh: list[Reading] = []
        self._owners = {(joint.bus, joint.servo_id): joint for joint in joints}
        owners = self._owners.values()
        self._turns = {bus: deque(j for j in owners if j.bus == bus) for bus in lines}
        self._status_turns = {bus: deque(turn) for bus, turn in self._turns.items()}
        self._status_ns = dict.fromkeys(lines, 0)
        self._next_ns = dict.fromkeys(lines, 0)
        """When the next question may be asked, if that was known."""
        self._orders: dict[str, deque[Command]] = {bus: deque() for bus in lines}
        self._named: set[str] = set()

    def order(self, joint: Joint, command: Command) -> None:
        """Send an order before the next question."""
        self._orders[joint.bus].append(command)

    @property
    def has_orders(self) -> bool:
        return any(self._orders.values())

    def take(self) -> list[Reading]:
        fresh, self._fresh = self._fresh, []
        return fresh

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""
        for bus, line in self._lines.items():
            self._questioners[bus].expire(now_ns)
            while self._orders[bus] and line.free_ns <= now_ns:
                line.send(encode(self._orders[bus].popleft()), now_ns)
            while self._ask(bus, now_ns):
                pass

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        for asked, answer in self._questioners[bus].answer(reply, now_ns):
            joint = self._owners[bus, asked.command.servo_id]
            if asked.command.keyword == "Q":
                self._notice_status(joint, answer)
                continue
            said = read_reply(joint.model.family, answer)
            if said is not None and isinstance(said.value, int | float):
                self.note(joint, asked.heard_ns, float(said.value))

    def note(self, joint: Joint, at_ns: int, servo_deg: float) -> None:
        """Take in that a servo was at an angle."""
        reading = Reading(joint.name, at_ns, joint.joint_deg(servo_deg))
        self.readings[joint.name] = reading
        self._fresh.append(reading)
        self._named.discard(f"{joint.name} does not answer")

    def next_wakeup_ns(self, now_ns: int) -> int:
        wakeups_ns = [now_ns + IDLE_NS]
        for bus, questioner in self._questioners.items():
            wakeups_ns.append(self._next_ns[bus])
            if (give_up_ns := questioner.give_up_ns) is not None:
                wakeups_ns.append(give_up_ns)
        return min(wakeup_ns for wakeup_ns in wakeups_ns if wakeup_ns > now_ns)

    def _ask(self, bus: str, now_ns: int) -> bool:
        """Ask the next servo, if it may be asked now; return whether it was."""
        questioner, line = self._questioners[bus], self._lines[bus]
        is_status_due = now_ns >= self._status_ns[bus]
        turn = self._status_turns[bus] if is_status_due else self._turns[bus]
        for _ in range(len(turn)):
            joint = turn[0]
            self._notice_silence(joint, now_ns)
            if questioner.quiet_until_ns(joint.servo_id) <= now_ns:
                break
            turn.rotate(-1)
        else:
            return False
        if questioner.is_waiting(joint.servo_id):  # Equal questions are believed as a row only.
            return False
        command = Command(joint.servo_id, "Q" if is_status_due else "QD")
        earliest_ns = questioner.earliest_ns(joint.servo_id, len(encode(command)))
        if earliest_ns is None:
            return False
        self._next_ns[bus] = max(earliest_ns, line.free_ns)
        if self._next_ns[bus] > now_ns:
            return False
        questioner.ask(command, now_ns)
        turn.rotate(-1)
        if is_status_due:
            self._status_ns[bus] = now_ns + STATUS_NS
        return True

    def _notice_silence(self, joint: Joint, now_ns: int) -> None:
        if now_ns - self.readings[joint.name].at_ns > SILENT_NS:
            self._name(joint, "does not answer", Cause.SILENT)

    def _notice_status(self, joint: Joint, reply: Reply) -> None:
        if not isinstance(reply.value, int):
            return
        firmware = self._robot.buses[joint.bus].firmware
        state = status_from(reply.value, joint.model.family, firmware)
        if state in (Status.SAFE_MODE, Status.ERROR):
            cause = Cause.ERROR if state is Status.ERROR else Cause.SAFE_MODE
            self._name(joint, f"reports {state.value}", cause)

    def _name(self, joint: Joint, text: str, cause: Cause) -> None:
        if (key := f"{joint.name} {text}") not in self._named:
            self._named.add(key)
            self.faults.append(Faulted(joint.name, text, cause, FaultStep.WARN))
