"""A robot moved by hand: joints limp, held or moved, their angles read continuously.

`HandsOn` is driven by the run loop as a `Player` is, and ends the same way: however it ends, the
servos hold their position and get their settings back. A limp joint falls; the caller warns first.

Phases: connect (query the servos), prepare (settings of the session, as for a show), show (the part
of the person), restore, done.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, LssMotionError
from lss_motion.playing.player import checks, handshake
from lss_motion.playing.player.events import Event, Faulted, Phase, PhaseEntered, Warned
from lss_motion.playing.player.handshake import Dialogue, Item, SettingsDialogue
from lss_motion.playing.player.health import STATUS_TEXTS, turn_text
from lss_motion.playing.player.preflight import Preflight
from lss_motion.playing.player.query_choice import health_words
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.playing.player.servo_model import Probe, ServoSettings
from lss_motion.protocol.codec import make_command, read_reply
from lss_motion.protocol.constants import Family, Status, status_from
from lss_motion.protocol.framing import Command, encode
from lss_motion.robot.model import HALF_TURN_DEG
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.units import MS_PER_S, NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.playing.player.handshake import Answers
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Joint, Robot


STATUS_NS: Final = NS_PER_S // 2
"""How often one joint, the next each time, is queried for its status to detect safe mode."""
SILENT_NS: Final = NS_PER_S
"""A joint without an answer for so long is reported. Chosen: a person waits no longer."""
HEALTH_NS: Final = NS_PER_S // 10
"""The same with `has_health`: a round of status and values of 18 joints takes eleven seconds."""
IDLE_NS: Final = 20 * NS_PER_MS


class JointReading(Struct, frozen=True):
    """The angle of a joint, in joint degrees, at the instant when its servo received the query."""

    joint: str
    at_ns: int
    deg: float


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
            is_clear = hand.joint.servo_id not in self._trackers[bus].twins.unclear
            if own_bus == bus and hand.move is not None and not hand.left and is_clear:
                move, hand.move = hand.move, None
                return move
        return None

    def _note_order(self, bus: str, command: Command, arrival_ns: int) -> None:
        hand = self._hands[bus, command.servo_id]
        if command.keyword in ("D", "H"):
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


def _status_turn(joints: Sequence[Joint], *, has_health: bool) -> deque[tuple[Joint, str]]:
    """Return the queries about the state of servos: each servo in turn, then its next keyword."""
    words = {
        joint.name: health_words(joint.model.family) if has_health else ("Q",) for joint in joints
    }
    rounds = max(map(len, words.values()), default=0)
    return deque(
        (joint, own[place % len(own)])
        for place in range(rounds)
        for joint in joints
        if (own := words[joint.name])
    )


SOFT: Final[Mapping[str, int]] = {"AH": -10, "AS": -4}
"""Settings of the session with which a hand can push a holding joint: the softest that the
documents allow (FACTS.md M24, M25). They do not state how soft that is."""

GIVE_WAY_DEG: Final = 1.0
"""A soft joint that was pushed this far is commanded to its new angle, within its range: no
document states what H does to a horn that was pushed. Chosen: above backlash and noise."""

GIVE_WAY_S: Final = 0.02


class HandsOn:
    """Joints of `robot` that a person moves, until `stop`; `error` is set if it cannot begin.

    With `is_soft`, joints hold softly and stay where a hand pushes them. `answer_of` returns what a
    servo answered before the show. Without `needs_frame` a servo
    may have another gyre or origin than its robot file states: that is a warning. With
    `has_health`, `health` is kept up to date.
    """

    def __init__(
        self,
        robot: Robot,
        joints: Sequence[str],
        *,
        is_soft: bool = False,
        needs_frame: bool = True,
        has_health: bool = False,
    ) -> None:
        self.robot = robot
        self.joints = [_session(robot, name, is_soft=is_soft) for name in joints]
        self.phase = Phase.CONNECT
        self.error: LssMotionError | None = None
        self.limp: set[str] = set()
        self.lines = {name: SerialLine(robot.buses[name]) for name in robot.buses}
        self._is_soft = is_soft
        self._held_deg: dict[str, float] = {}
        self._trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self._poller = Poller(robot, self.joints, self._trackers, has_health=has_health)
        self._events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self._answers: Answers = {}
        self._needs_frame = needs_frame
        self._before = Preflight(self.joints, robot, self._trackers)
        self._dialogue: Dialogue | Preflight | SettingsDialogue | None = self._before
        self._away: list[Joint] = []
        """Joints whose servos have restarted, and do not have their settings again."""
        self._has_set = self._has_acted = False
        self._stops = 0
        self._now_ns = 0

    # ---- calls of the run loop

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        self._now_ns = leaves_ns
        while self._dialogue is not None:
            self._dialogue.advance(leaves_ns)
            if not self._dialogue.is_finished:
                break
            self._after_dialogue(leaves_ns)
        if self.phase is Phase.SHOW and self._dialogue is None:
            self._poller.advance(leaves_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        """Take bytes of a bus. No byte raises."""
        for reply, ended_ns in self.lines[bus].receive(data, now_ns):
            if self._dialogue is not None:
                self._dialogue.receive(bus, reply, now_ns)
            elif self.phase is Phase.SHOW:
                self._poller.receive(bus, reply, ended_ns)
                if self._poller.restarted or self._poller.doubled:
                    self._begin_recovery()

    def next_wakeup_ns(self) -> int | None:
        if self.phase is Phase.DONE:
            return None
        if self._dialogue is None:
            return self._poller.next_wakeup_ns(self._now_ns)
        wakeup_ns = self._dialogue.next_wakeup_ns()
        return self._now_ns + IDLE_NS if wakeup_ns is None else max(wakeup_ns, self._now_ns)

    def next_event(self) -> Event | None:
        if self._events:
            return self._events.popleft()
        return self._poller.faults.popleft() if self._poller.faults else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes: hold, if any servo was released, held or moved."""
        return handshake.safe_bytes(self.robot) if self._has_acted else {}

    # ---- requests of a person

    @property
    def readings(self) -> Mapping[str, JointReading]:
        """The latest reading of each joint; complete from the show on."""
        return self._poller.readings

    @property
    def health(self) -> Mapping[str, ServoHealth]:
        """What each servo reported last, besides its angle."""
        return self._poller.health

    def take(self) -> list[JointReading]:
        """Return the readings since the last call, oldest first."""
        fresh = self._poller.take()
        if self._is_soft:
            self._give_way(fresh)
        return fresh

    @property
    def has_sent_all(self) -> bool:
        """Whether no command waits for its place on the line."""
        return not self._poller.has_orders

    def answer_of(self, name: str, keyword: str) -> int | None:
        """Return the number (wire unit) that a joint's servo answered, if it did."""
        joint = self.robot.joints[name]
        value = self._answers.get((joint.bus, joint.servo_id, keyword))
        return value if isinstance(value, int) else None

    def set(self, name: str, keyword: str, value: int) -> None:
        """Set a value of a joint's servo (wire unit) that stays after the end."""
        for joint in self._ready([name]):
            self._poller.order(joint, Command(joint.servo_id, keyword, value))

    def let_go(self, joints: Iterable[str]) -> None:
        """Make joints limp: they fall if no hand holds them."""
        for joint in self._ready(joints):
            self._poller.order(joint, Command(joint.servo_id, "L"))
            self.limp.add(joint.name)

    def hold(self, joints: Iterable[str]) -> None:
        """Make joints keep the angle at which they receive the command."""
        for joint in self._ready(joints):
            self._poller.order(joint, Command(joint.servo_id, "H"))
            self._held_deg[joint.name] = self.readings[joint.name].deg
            self.limp.discard(joint.name)

    def move(self, name: str, joint_deg: float, duration_s: float) -> float:
        """Move a joint by its own profile; return the target, which is kept within its range."""
        target_deg = joint_deg
        for joint in self._ready([name]):
            target_deg = min(max(joint_deg, joint.position_min_deg), joint.position_max_deg)
            command = make_command(
                joint.model.language,
                joint.servo_id,
                "D",
                joint.servo_deg(target_deg),
                {"T": float(max(1, math.ceil(duration_s * MS_PER_S)))},
            )
            self._poller.order(joint, command)
            self.limp.discard(name)
        return target_deg

    def stop(self) -> None:
        """Hold, restore the settings and end. A second call ends at once, holding."""
        self._stops += 1
        if self.phase is Phase.RESTORE and self._stops > 1:
            self._finish(self._now_ns)
        elif self.phase not in (Phase.RESTORE, Phase.DONE):
            self._restore()

    # ---- phases

    def _after_dialogue(self, now_ns: int) -> None:
        assert self._dialogue is not None
        dialogue, self._dialogue = self._dialogue, None
        match self.phase:
            case Phase.CONNECT:
                assert isinstance(dialogue, Preflight)
                self._answers = dialogue.answers
                self._connected(dialogue)
            case Phase.SHOW if isinstance(dialogue, Preflight):
                self._proved(dialogue)
            case Phase.SHOW if isinstance(dialogue, SettingsDialogue):
                self._set_again(dialogue, now_ns)
            case Phase.PREPARE:
                self._answers = {**self._answers, **dialogue.answers}
                self._poller.watch(self._probes())
                for joint in self.joints:
                    angle_deg = handshake.reported(joint, self._answers, "QD")
                    assert angle_deg is not None, "essential queries are answered"
                    self._poller.note(joint, now_ns, angle_deg)
                self._enter(Phase.SHOW)
            case _:
                self._finish(now_ns)

    def _connected(self, preflight: Preflight) -> None:
        try:
            preflight.require_own_ids()
            texts = checks.check_answers(
                self.joints,
                self._answers,
                self.robot,
                stored=preflight.stored,
                needs_frame=self._needs_frame,
            )
            self._events += map(Warned, texts)
        except LssMotionError as error:
            self.error = error
            self._restore()
            return
        self._poller.firmware = {
            joint.name: checks.reported_firmware(joint, self._answers) for joint in self.joints
        }
        self._has_set = True
        self._enter(Phase.PREPARE)
        orders = handshake.session_orders(self.joints, self._answers)
        orders += handshake.unconfirmed_orders(self.joints, self._answers)
        self._dialogue = self._ask([*handshake.settings_queries(self.joints), *orders])

    def _probes(self) -> dict[str, list[Probe]]:
        """Return what shows whether a servo has restarted; of some it is only the gyre."""
        probes = handshake.probes(self.joints, self._answers)
        for joint in self.joints:
            gyre = self.answer_of(joint.name, "QG")
            if joint.name not in probes and gyre is not None:
                probes[joint.name] = [Probe("QG", gyre, None)]
        return probes

    def _begin_recovery(self) -> None:
        """Compare servos that have restarted with what they were, and set them up again.

        For those whose answers come twice another one with the same id is looked for.
        """
        restarted, self._poller.restarted = self._poller.restarted, {}
        doubled, self._poller.doubled = self._poller.doubled, []
        self._away = [one for one in self.joints if one.name in restarted or one in doubled]
        for joint in self._away:
            if joint.name in restarted:
                self.limp.add(joint.name)
                text = f"{restarted[joint.name]}. It is limp"
                self._events.append(Faulted(joint.name, text, Cause.RESTARTED, FaultStep.WARN))
        self._prove(doubled)

    def _prove(self, suspects: Sequence[Joint] = ()) -> None:
        self._dialogue = Preflight(
            self._away,
            self.robot,
            self._trackers,
            before=self._before,
            suspects=suspects,
        )

    def _proved(self, preflight: Preflight) -> None:
        try:
            preflight.require_same()
        except LssMotionError as error:
            self.error = error
            self._restore()
            return
        if preflight.unproved:
            self._prove()
            return
        self._dialogue = SettingsDialogue.of(self._away, self._answers, self._trackers)

    def _set_again(self, dialogue: SettingsDialogue, now_ns: int) -> None:
        standing_deg = handshake.standing_deg(self._away, dialogue.answers)
        if dialogue.wrong:
            self.error = handshake.not_applied_error(
                dialogue.wrong[0], dialogue.answers, self._away
            )
            self._restore()
        elif len(standing_deg) < len(self._away):
            self._prove()
        else:
            for joint in self._away:
                self._poller.settle(joint, now_ns, standing_deg[joint.name])

    def _restore(self) -> None:
        if self._dialogue is not None and self.phase is not Phase.SHOW:
            self._answers = {**self._answers, **self._dialogue.answers}
        self._enter(Phase.RESTORE)
        orders: list[Item] = []
        if self._has_acted:
            orders += [Item.to(joint, "H") for joint in self.joints]
        if self._has_set:
            orders += handshake.restoring_orders(self.joints, self._answers)
        self._dialogue = self._ask(orders)

    def _finish(self, now_ns: int) -> None:
        self._dialogue = None
        self.limp.clear()
        for name, data in self.safe_bytes().items():
            self.lines[name].send(data, now_ns)
        self._enter(Phase.DONE)

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._events.append(PhaseEntered(phase))

    def _ask(self, items: Iterable[Item]) -> Dialogue:
        return Dialogue(items, self._trackers)

    def _ready(self, joints: Iterable[str]) -> list[Joint]:
        if self.phase is not Phase.SHOW:
            return []
        self._has_acted = True
        return [self.robot.joints[name] for name in joints]

    def _give_way(self, fresh: Iterable[JointReading]) -> None:
        """Make joints that were pushed hold their present angle."""
        for name, deg in {reading.joint: reading.deg for reading in fresh}.items():
            is_held = name in self._held_deg and name not in self.limp
            if is_held and abs(deg - self._held_deg[name]) > GIVE_WAY_DEG:
                self._held_deg[name] = self.move(name, deg, GIVE_WAY_S)


def _session(robot: Robot, name: str, *, is_soft: bool) -> Joint:
    """Return a joint with the session's settings; raises `InputError` if it cannot be read."""
    joint = robot.joints[name]
    if joint.model.family is Family.IO2:
        raise InputError(
            f"joint {name!r} is on an {joint.model.name}, which cannot read where its servos "
            "are; leave it out with --joints",
            path=robot.path,
        )
    return replace(joint, settings={**joint.settings, **(SOFT if is_soft else {})})
