"""What asks the servos of a robot that a person moves, and sends them what the person wants."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.playing.hands_mapping import JointReading
from lss_motion.playing.player.events import Faulted
from lss_motion.playing.player.health import STATUS_TEXTS, turn_text
from lss_motion.playing.player.query_choice import health_words
from lss_motion.playing.player.servo_model import Probe, ServoSettings
from lss_motion.protocol.codec import read_reply
from lss_motion.protocol.constants import Family, Status, status_from
from lss_motion.protocol.framing import Command, encode
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.playing.player.query_tracker import QueryTracker
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Joint, Robot


STATUS_NS: Final = NS_PER_S // 2
"""How often one joint, the next each time, is queried for its status to detect safe mode."""
SILENT_NS: Final = NS_PER_S
"""A joint without an answer for so long is reported. Chosen: a person waits no longer."""
HEALTH_NS: Final = NS_PER_S // 10
"""The same with `has_health`: a round of status and values of 18 joints takes eleven seconds."""
IDLE_NS: Final = 20 * NS_PER_MS


@dataclass(slots=True)
class ServoHealth:
    """What a servo reported last; None: it was not asked yet, or has no such value."""

    status: Status | None = None
    temperature_c: float | None = None
    voltage_v: float | None = None
    current_a: float | None = None


@dataclass(slots=True)
class _PolledJoint:
    """What the poller knows of one joint besides its angle and its health."""

    servo: ServoSettings
    words: tuple[str, ...] = ()
    """The queries that come before each move: whether its servo has restarted."""
    left: list[str] = field(default_factory=list)
    """Those of them that are to be answered before `move` leaves."""
    move: Command | None = None
    """The move that waits for them, or for its place on the line."""
    is_turned: bool = False
    """Whether the last reading was in another turn than the one before."""
    is_barred: bool = False
    """Whether it is in another turn, so that it gets no move."""
    commanded_deg: float | None = None
    """Where a servo was sent that has no reading, in servo degrees."""

    @property
    def joint(self) -> Joint:
        return self.servo.joint

    def hold_back(self) -> None:
        """Send no move before all queries are answered once more."""
        self.left = list(self.words)


class Poller:
    """Sends commands before queries, and as many queries at once as can be told apart.

    The latest angles are in `readings`; `take()` returns those since the last call. With
    `has_health`, temperature, voltage and current are asked for, too.

    A move leaves when its servo has just answered that it still has its settings (`watch`): a
    servo that restarts is limp, moves with its stored limits, and may be in another turn.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Iterable[Joint],
        trackers: Mapping[str, QueryTracker],
        *,
        has_health: bool = False,
    ) -> None:
        self.readings: dict[str, JointReading] = {}
        self.faults: deque[Faulted] = deque()
        self._robot = robot
        self._lines = lines = {bus: tracker.line for bus, tracker in trackers.items()}
        self._trackers = trackers
        self._fresh: list[JointReading] = []
        self._hands = {(j.bus, j.servo_id): _PolledJoint(ServoSettings(j)) for j in joints}
        self.restarted: dict[str, str] = {}
        """By joint, the fault of a servo that has lost its settings since they were set."""
        self.doubled: list[Joint] = []
        """Joints whose answers come twice, as when two servos have the id."""
        owners = [hand.joint for hand in self._hands.values()]
        self.health = {joint.name: ServoHealth() for joint in owners}
        self._turns = {bus: deque((j, "QD") for j in owners if j.bus == bus) for bus in lines}
        self._status_turns = {
            bus: _status_turn([joint for joint, _ in turn], has_health=has_health)
            for bus, turn in self._turns.items()
        }
        self._together = {
            joint.name: [one for one in owners if one.name in robot.together(joint.name)]
            for joint in owners
        }
        """Servos of one mechanism: their moves leave together, and they stop together."""
        self._status_every_ns = HEALTH_NS if has_health else STATUS_NS
        self._status_ns = dict.fromkeys(lines, 0)
        self._next_ns = dict.fromkeys(lines, 0)
        """When the next query may be sent, if that is known."""
        self._orders: dict[str, deque[Command]] = {bus: deque() for bus in lines}
        self._reported: set[str] = set()
        self.firmware: dict[str, int | None] = {}
        """What the servos of the joints answered to QF; the codes of a status depend on it."""

    def watch(self, probes: Mapping[str, Sequence[Probe]]) -> None:
        """Query one of these, by joint, before each move; its servo must answer as it was set."""
        for hand in self._hands.values():
            hand.servo.begin(probes.get(hand.joint.name, ()))
            turn = () if hand.joint.turns is None else ("QD",)
            hand.words = (*hand.servo.keywords[:1], *turn)

    def order(self, joint: Joint, command: Command) -> None:
        """Send a command before the next query; a move takes the place of one that waits.

        `L` and `H` end a move that waits. A joint in another turn gets no move.
        """
        hand = self._hands[joint.bus, joint.servo_id]
        if command.keyword != "D":
            hand.move = None if command.keyword in ("L", "H") else hand.move
            self._orders[joint.bus].append(command)
        elif not hand.is_barred:
            hand.move = command
            hand.hold_back()

    @property
    def has_orders(self) -> bool:
        return any(self._orders.values()) or any(hand.move for hand in self._hands.values())

    def take(self) -> list[JointReading]:
        fresh, self._fresh = self._fresh, []
        return fresh

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""
        for bus, line in self._lines.items():
            self._trackers[bus].expire(now_ns)
            while line.free_ns <= now_ns and (command := self._next_order(bus)) is not None:
                self._note_order(bus, command, line.send(encode(command), now_ns))
            while self._ask(bus, now_ns):
                pass

    def _next_order(self, bus: str) -> Command | None:
        """Return the command that may leave now, and let it wait no more."""
        if self._orders[bus]:
            return self._orders[bus].popleft()
        for (own_bus, _), hand in self._hands.items():
            if own_bus == bus and hand.move is not None:
                moved = [one for one in self._mates(hand.joint) if one.move is not None]
                if all(map(self._is_clear, moved)):
                    for one in moved:
                        if one.move is not None:
                            self._orders[one.joint.bus].append(one.move)
                        one.move = None
                    return self._orders[bus].popleft()
        return None

    def _is_clear(self, hand: _PolledJoint) -> bool:
        """Return whether the move of a servo may leave."""
        unclear = self._trackers[hand.joint.bus].twins.unclear
        return not hand.left and hand.joint.servo_id not in unclear

    def _mates(self, joint: Joint) -> list[_PolledJoint]:
        """Return the servos of the mechanism of a servo, itself first."""
        others = [one for one in self._together[joint.name] if one is not joint]
        return [self._hands[one.bus, one.servo_id] for one in (joint, *others)]

    def stop_mates(self, joint: Joint) -> list[Joint]:
        """Send no moves to the servos of a mechanism of which one does not do its part.

        Return the others.
        """
        mates = self._mates(joint)
        for mate in mates:
            mate.move = None
        return [mate.joint for mate in mates[1:]]

    def _note_order(self, bus: str, command: Command, arrival_ns: int) -> None:
        hand = self._hands[bus, command.servo_id]
        if command.keyword == "D" and not has_reading(hand.joint):
            assert isinstance(command.value, int)
            hand.commanded_deg = command.value / hand.joint.model.wire_per_deg
            self.note(hand.joint, arrival_ns, hand.commanded_deg)
        elif command.keyword in ("D", "H"):
            hand.servo.powered_ns = arrival_ns
            self._reported.discard(f"{hand.joint.name} {STATUS_TEXTS[Cause.RESTARTED]}")
        elif command.keyword == "L":
            hand.servo.powered_ns = None

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        for asked, answer in self._trackers[bus].receive(reply, now_ns):
            hand = self._hands[bus, asked.command.servo_id]
            keyword = asked.command.keyword
            if keyword == "Q":
                self._notice_status(hand, answer, asked.arrival_ns)
            elif keyword in hand.servo.keywords:
                self._take_probe(hand, answer)
            else:
                statement = read_reply(hand.joint.model.language, answer)
                if statement is not None and isinstance(statement.value, int | float):
                    self._take(hand, keyword, asked.arrival_ns, float(statement.value))

        doubled = self._trackers[bus].twins.doubled
        for servo_id in doubled:
            if (double := self._hands.get((bus, servo_id))) is not None:
                double.move = None
                self.doubled.append(double.joint)
        doubled.clear()

    def _take_probe(self, hand: _PolledJoint, answer: Reply) -> None:
        """Let a move pass, or note that the servo has restarted."""
        if (fault := hand.servo.take(answer.keyword, answer.value)) is not None:
            self.restarted[hand.joint.name] = fault
            hand.move, hand.servo.powered_ns = None, None
        elif hand.servo.has_settings and hand.left[:1] == [answer.keyword]:
            del hand.left[0]

    def _take(self, hand: _PolledJoint, keyword: str, at_ns: int, value: float) -> None:
        health = self.health[hand.joint.name]
        match keyword:
            case "QT":
                health.temperature_c = value
            case "QV":
                health.voltage_v = value
            case "QC":
                health.current_a = value
            case _ if not has_reading(hand.joint):
                commanded_deg = hand.commanded_deg
                before_deg = hand.joint.servo_deg(self.readings[hand.joint.name].deg)
                self.note(hand.joint, at_ns, before_deg if commanded_deg is None else commanded_deg)
            case _ if self._is_turned(hand, value):
                hand.hold_back()
            case _:
                self.note(hand.joint, at_ns, value)
                if hand.left[:1] == ["QD"]:
                    del hand.left[0]

    def _is_turned(self, hand: _PolledJoint, servo_deg: float) -> bool:
        """Return whether a reading is in another turn than the one before.

        The second in a row is a fault, and counts: then the joint gets no move any more.
        """
        joint = hand.joint
        before_deg = joint.servo_deg(self.readings[joint.name].deg)
        was_turned, hand.is_turned = hand.is_turned, abs(servo_deg - before_deg) > HALF_TURN_DEG
        if was_turned and hand.is_turned:
            hand.move, hand.is_barred, hand.is_turned = None, True, False
            self._report(joint, turn_text(joint, servo_deg, before_deg), Cause.LOST_TURN)
        return hand.is_turned

    def settle(self, joint: Joint, at_ns: int, servo_deg: float) -> None:
        """Note that a servo that had restarted has its settings again, and stands there."""
        hand = self._hands[joint.bus, joint.servo_id]
        hand.servo.trust()
        for _ in range(2):
            if not self._is_turned(hand, servo_deg):
                break
        self.note(joint, at_ns, servo_deg)

    def note(self, joint: Joint, at_ns: int, servo_deg: float) -> None:
        """Record the angle of a servo."""
        reading = JointReading(joint.name, at_ns, joint.joint_deg(servo_deg))
        self.readings[joint.name] = reading
        self._fresh.append(reading)
        self._reported.discard(f"{joint.name} does not answer")

    def next_wakeup_ns(self, now_ns: int) -> int:
        wakeups_ns = [now_ns + IDLE_NS]
        for bus, tracker in self._trackers.items():
            wakeups_ns.append(self._next_ns[bus])
            if (give_up_ns := tracker.give_up_ns) is not None:
                wakeups_ns.append(give_up_ns)
        return min(wakeup_ns for wakeup_ns in wakeups_ns if wakeup_ns > now_ns)

    def _ask(self, bus: str, now_ns: int) -> bool:
        """Query the next servo, if that is possible now; return whether it was."""
        tracker, line = self._trackers[bus], self._lines[bus]
        is_status_due = now_ns >= self._status_ns[bus]
        turn = self._status_turns[bus] if is_status_due else self._turns[bus]
        if guards := self._guards(bus, now_ns):
            is_status_due, turn = False, guards
        for _ in range(len(turn)):
            joint, keyword = turn[0]
            if now_ns - self.readings[joint.name].at_ns > SILENT_NS:
                self._report(joint, "does not answer", Cause.SILENT)
            if tracker.quiet_until_ns(joint.servo_id) <= now_ns:
                break
            turn.rotate(-1)
        else:
            return False
        if tracker.is_waiting(joint.servo_id):  # Replies to equal queries cannot be told apart.
            return False
        command = Command(joint.servo_id, keyword)
        earliest_ns = tracker.earliest_ns(joint.servo_id, len(encode(command)))
        if earliest_ns is None:
            return False
        self._next_ns[bus] = max(earliest_ns, line.free_ns)
        if self._next_ns[bus] > now_ns:
            return False
        tracker.send(command, now_ns)
        turn.rotate(-1)
        if is_status_due:
            self._status_ns[bus] = now_ns + self._status_every_ns
        return True

    def _guards(self, bus: str, now_ns: int) -> deque[tuple[Joint, str]]:
        """Return the queries for which moves wait, of servos that may be queried now."""
        tracker = self._trackers[bus]
        return deque(
            (hand.joint, hand.left[0])
            for (own_bus, servo_id), hand in self._hands.items()
            if own_bus == bus and hand.move and hand.left
            if tracker.quiet_until_ns(servo_id) <= now_ns and not tracker.is_waiting(servo_id)
        )

    def _notice_status(self, hand: _PolledJoint, reply: Reply, asked_ns: int) -> None:
        joint = hand.joint
        if not isinstance(reply.value, int):
            return
        state = status_from(reply.value, joint.model.family, self.firmware.get(joint.name))
        self.health[joint.name].status = state
        if state in (Status.SAFE_MODE, Status.ERROR):
            cause = Cause.ERROR if state is Status.ERROR else Cause.SAFE_MODE
            self._report(joint, f"reports {state.value}", cause)
        if hand.servo.is_limp_again(state, asked_ns):
            hand.servo.powered_ns = None
            self._report(joint, STATUS_TEXTS[Cause.RESTARTED], Cause.RESTARTED)

    def _report(self, joint: Joint, text: str, cause: Cause) -> None:
        if (key := f"{joint.name} {text}") not in self._reported:
            self._reported.add(key)
            self.faults.append(Faulted(joint.name, text, cause, FaultStep.WARN))
            if cause is Cause.SILENT:
                for mate in self.stop_mates(joint):
                    self._orders[mate.bus].append(Command(mate.servo_id, "H"))


def has_reading(joint: Joint) -> bool:
    """Return whether a servo says where it is: an RC servo stands where it was sent, one hopes."""
    return joint.model.family is not Family.IO2


def _status_turn(joints: Sequence[Joint], *, has_health: bool) -> deque[tuple[Joint, str]]:
    """Return the queries about the state of servos: each servo in turn, then its next keyword."""
    words = {
        joint.name: health_words(joint.model.family)
        if has_health or not has_reading(joint)
        else ("Q",)
        for joint in joints
    }
    rounds = max(map(len, words.values()), default=0)
    return deque(
        (joint, own[place % len(own)])
        for place in range(rounds)
        for joint in joints
        if (own := words[joint.name])
    )
