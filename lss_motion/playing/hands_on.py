"""A robot moved by hand: joints limp, held or moved, their angles read continuously.

`HandsOn` is driven by the run loop as a `Player` is, and ends the same way: however it ends, the
servos hold their position and get their settings back. A limp joint falls; the caller warns first.

Phases: connect (query the servos), prepare (settings of the session, as for a show), show (the part
of the person), restore, done.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.errors import LssMotionError
from lss_motion.playing.hands_mapping import (
    JointReading,
    JointReadings,
    leaves_ranges,
    servo_targets,
)
from lss_motion.playing.hands_poller import IDLE_NS, Poller, has_reading
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.player import checks, handshake
from lss_motion.playing.player.events import Event, Faulted, Phase, PhaseEntered, Warned
from lss_motion.playing.player.handshake import Dialogue, Item, SettingsDialogue
from lss_motion.playing.player.preflight import Preflight
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.playing.player.servo_model import Probe
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.framing import Command, encode
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.robot.servo_models import RC_RANGE_DEG
from lss_motion.units import MS_PER_S, NS_PER_MS, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.playing.hands_poller import ServoHealth
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Joint, Robot

PULSE_NS: Final = 20 * NS_PER_MS
"""An RC servo gets its pulse so often, and no step may be shorter (FACTS.md B19)."""
RESTS_DEG_S: Final = 5.0
"""A servo that is slower by its readings counts as at rest. Chosen: twice what steps of
0.1 deg make of one that stands."""
SLOWER_RATIO: Final = 1.5
SLOWER_TIMES: Final = 8
"""Servos that have other ramps are in step if they are slow: a move is made up to 25 times slower
where a joint would leave its range on the way."""
RAMP_PAUSE_S: Final = 0.1
"""A pause of this program is not made up for by a jump of an RC servo."""

SOFT: Final[Mapping[str, int]] = {"AH": -10, "AS": -4}
"""Settings of the session with which a hand can push a holding joint: the softest that the
documents allow (FACTS.md M24, M25). They do not state how soft that is."""

GIVE_WAY_DEG: Final = 1.0
"""A soft joint that was pushed this far is commanded to its new angle, within its range: no
document states what H does to a horn that was pushed. Chosen: above backlash and noise."""

GIVE_WAY_S: Final = 0.02


@dataclass(slots=True)
class _Ramp:
    """The way of an RC servo, which would jump: where it is sent, and where it is going."""

    at_deg: float
    to_deg: float
    speed_deg_s: float

    def after(self, seconds: float) -> float:
        """Return where it is sent so much later, in servo degrees."""
        step_deg = self.speed_deg_s * seconds
        return self.at_deg + min(max(self.to_deg - self.at_deg, -step_deg), step_deg)


class HandsOn:
    """Joints of `robot` that a person moves, until `stop`; `error` is set if it cannot begin.

    Where a mechanism moves a joint, all of its servos do what is asked of the joint, together:
    they go limp, hold and move at once, and its other joints with them. `servos` are those servos.
    An RC servo stands where it was sent; it is led there in small steps.

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
        self.view = view = JointView(robot)
        self._servo_robot = robot = robot.servo_robot
        self.servos = [
            _session(robot, name, is_soft=is_soft)
            for name in dict.fromkeys(servo for name in joints for servo in view.servos_of(name))
        ]
        self.joints = self.servos
        """The joints, each with all others that the same servos move."""
        if not view.is_plain:
            names = {mate for name in joints for mate in view.mates_of(name)}
            self.joints = [joint for name, joint in self.robot.joints.items() if name in names]
        self._mixed = JointReadings(view)
        self._fresh: list[JointReading] = []
        self._wanted_deg: dict[str, float] = {}
        """Where joints of mechanisms were sent last, until they are limp or held."""
        self._waiting: dict[str, tuple[str, float]] = {}
        """By mechanism the joint whose move waits until its servos rest, and how long it takes."""
        self._ramps: dict[str, _Ramp] = {}
        self._ramped_ns = 0
        self.phase = Phase.CONNECT
        self.error: LssMotionError | None = None
        self.limp: set[str] = set()
        self.lines = {name: SerialLine(robot.buses[name]) for name in robot.buses}
        self._is_soft = is_soft
        self._held_deg: dict[str, float] = {}
        self._trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self._poller = Poller(robot, self.servos, self._trackers, has_health=has_health)
        self._events: deque[Event] = deque([PhaseEntered(Phase.CONNECT)])
        self._answers: Answers = {}
        self._needs_frame = needs_frame
        self._before = Preflight(self.servos, robot, self._trackers)
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
            self._step_ramps(leaves_ns)
            if self._waiting:
                self._mix()
                self._send_waiting()
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
                    self._begin_recovery(now_ns)

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
        return self.view.fault(self._poller.faults.popleft()) if self._poller.faults else None

    def safe_bytes(self) -> Mapping[str, bytes]:
        """Return the last bytes: hold, if any servo was released, held or moved."""
        return handshake.safe_bytes(self.robot) if self._has_acted else {}

    # ---- requests of a person

    @property
    def readings(self) -> Mapping[str, JointReading]:
        """The latest reading of each joint; complete from the show on."""
        self._mix()
        return self._mixed.latest

    def _mix(self) -> None:
        """Take the readings of servos as those of joints."""
        for reading in self._poller.take():
            self._fresh += self._mixed.add(reading)

    @property
    def health(self) -> Mapping[str, ServoHealth]:
        """What each of `servos` reported last, besides its angle."""
        return self._poller.health

    def take(self) -> list[JointReading]:
        """Return the readings since the last call, oldest first."""
        self._mix()
        fresh, self._fresh = self._fresh, []
        if self._is_soft:
            self._give_way(fresh)
        return fresh

    @property
    def has_sent_all(self) -> bool:
        """Whether no command waits for its place on the line."""
        return not self._poller.has_orders

    def answer_of(self, servo: str, keyword: str) -> int | None:
        """Return the number (wire unit) that a servo answered, if it did."""
        joint = self._servo_robot.joints[servo]
        value = self._answers.get((joint.bus, joint.servo_id, keyword))
        return value if isinstance(value, int) else None

    def set(self, name: str, keyword: str, value: int) -> None:
        """Set a value of the servos of a joint (wire unit) that stays after the end."""
        for joint in self._ready([name]):
            self._poller.order(joint, Command(joint.servo_id, keyword, value))

    def let_go(self, joints: Iterable[str]) -> None:
        """Make joints limp: they fall if no hand holds them."""
        names = self._with_mates(joints)
        for servo in self._ready(names):
            self._poller.order(servo, Command(servo.servo_id, "L"))
            self._ramps.pop(servo.name, None)
            self.limp |= names
        self._forget(names)

    def hold(self, joints: Iterable[str]) -> None:
        """Make joints keep the angle at which they receive the command."""
        names = self._with_mates(joints)
        for servo in self._ready(names):
            self._ramps.pop(servo.name, None)
            self._poller.order(servo, self._holding(servo))
            self._held_deg |= {name: self.readings[name].deg for name in names}
            self.limp -= names
        self._forget(names)

    def _with_mates(self, joints: Iterable[str]) -> frozenset[str]:
        return frozenset(mate for name in joints for mate in self.view.mates_of(name))

    def _forget(self, joints: Iterable[str]) -> None:
        """Forget where joints were sent: they do not stand there any more."""
        for name in joints:
            self._wanted_deg.pop(name, None)
            if (mechanism := self.view.mechanism_of(name)) is not None:
                self._waiting.pop(mechanism.name, None)

    def _holding(self, servo: Joint) -> Command:
        """Return what lets a servo hold; an RC servo knows only where it was sent."""
        if has_reading(servo):
            return Command(servo.servo_id, "H")
        return _jump(servo, servo.servo_deg(self._poller.readings[servo.name].deg))

    def move(self, name: str, joint_deg: float, duration_s: float) -> float:
        """Move a joint by the profile of its servos; return the target, kept within all ranges.

        It takes longer where a servo or another joint of the mechanism would be too fast.
        """
        if self.phase is not Phase.SHOW:
            return joint_deg
        mechanism = self.view.mechanism_of(name)
        if mechanism is None:
            target_deg = self.robot.joints[name].within_deg(joint_deg)
            self._send({name: target_deg}, duration_s)
            self.limp.discard(name)
            return target_deg
        wanted_deg = {
            mate: self._wanted_deg.get(mate, self.readings[mate].deg) for mate in mechanism.joints
        }
        servos = self._poller.readings
        aim = servo_targets(
            mechanism,
            self.robot,
            {servo: servos[servo].deg for servo in mechanism.servos},
            {**wanted_deg, name: joint_deg},
            name,
        )
        self._wanted_deg |= aim.joint_deg
        self.limp -= {*mechanism.joints}
        lasts_s = self._in_step(mechanism, aim.servo_deg, max(duration_s, aim.least_s))
        if lasts_s is None:
            self._waiting[mechanism.name] = (name, duration_s)
        else:
            self._waiting.pop(mechanism.name, None)
            self._send(aim.servo_deg, lasts_s)
        return aim.joint_deg[name]

    def _in_step(
        self, mechanism: Mechanism, servo_deg: Mapping[str, float], lasts_s: float
    ) -> float | None:
        """Return how long a move takes that keeps all joints in their ranges on its way.

        None: its servos move, and have to brake first, which they do.
        """
        servos = [self._servo_robot.joints[name] for name in mechanism.servos]
        if len(mechanism.joints) == 1 or not all(map(has_reading, servos)):
            return lasts_s
        readings, mixed = self._poller.readings, self._mixed
        standing = {
            name: (readings[name].deg, mixed.speed_deg_s(name)) for name in mechanism.servos
        }
        is_at_rest = max(abs(deg_s) for _, deg_s in standing.values()) < RESTS_DEG_S
        for _ in range(SLOWER_TIMES):
            if not leaves_ranges(mechanism, self.robot, standing, servo_deg, lasts_s):
                break
            if not is_at_rest:
                if mechanism.name not in self._waiting:
                    for servo in servos:
                        self._poller.order(servo, self._holding(servo))
                return None
            lasts_s *= SLOWER_RATIO
        return lasts_s

    def _send_waiting(self) -> None:
        """Send what had to wait until its servos rest."""
        for mechanism in [self.robot.mechanisms[name] for name in self._waiting]:
            speeds = (self._mixed.speed_deg_s(name) for name in mechanism.servos)
            if max(map(abs, speeds)) < RESTS_DEG_S:
                name, lasts_s = self._waiting.pop(mechanism.name)
                self.move(name, self._wanted_deg[name], lasts_s)

    def _send(self, servo_deg: Mapping[str, float], duration_s: float) -> None:
        """Send servos there, in degrees of ideal servos."""
        self._has_acted = True
        for name, deg in servo_deg.items():
            servo = self._servo_robot.joints[name]
            to_deg = servo.servo_deg(deg)
            if has_reading(servo):
                duration_ms = float(max(1, math.ceil(duration_s * MS_PER_S)))
                language = servo.model.language
                move = make_command(language, servo.servo_id, "D", to_deg, {"T": duration_ms})
                self._poller.order(servo, move)
                continue
            here_deg = servo.servo_deg(self._poller.readings[name].deg)
            at_deg = self._ramps[name].at_deg if name in self._ramps else here_deg
            speed_deg_s = abs(to_deg - at_deg) / max(duration_s, s_from_ns(PULSE_NS))
            self._ramps[name] = _Ramp(at_deg, to_deg, min(speed_deg_s, servo.speed_max_deg_s))

    def _step_ramps(self, now_ns: int) -> None:
        """Send RC servos a pulse's way on, in the steps that their board knows."""
        if now_ns - self._ramped_ns < PULSE_NS:
            return
        passed_s = min(s_from_ns(now_ns - self._ramped_ns), RAMP_PAUSE_S)
        self._ramped_ns = now_ns
        for name, ramp in list(self._ramps.items()):
            servo = self._servo_robot.joints[name]
            ramp.at_deg = ramp.after(passed_s)
            self._poller.order(servo, _jump(servo, ramp.at_deg))
            if ramp.at_deg == ramp.to_deg:
                del self._ramps[name]

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
                for servo in self.servos:
                    angle_deg = handshake.reported(servo, self._answers, "QD")
                    assert angle_deg is not None, "essential queries are answered"
                    if not has_reading(servo) and self.answer_of(servo.name, "QG") == -1:
                        # FACTS.md B9.
                        angle_deg = -RC_RANGE_DEG * 10.0 / servo.model.wire_per_deg - angle_deg
                    self._poller.note(servo, now_ns, angle_deg)
                self._enter(Phase.SHOW)
            case _:
                self._finish(now_ns)

    def _connected(self, preflight: Preflight) -> None:
        try:
            preflight.require_own_ids()
            texts = checks.check_answers(
                self.servos,
                self._answers,
                self._servo_robot,
                stored=preflight.stored,
                needs_frame=self._needs_frame,
            )
            self._events += map(Warned, texts)
        except LssMotionError as error:
            self.error = error
            self._restore()
            return
        self._poller.firmware = {
            joint.name: checks.reported_firmware(joint, self._answers) for joint in self.servos
        }
        self._has_set = True
        self._enter(Phase.PREPARE)
        orders = handshake.session_orders(self.servos, self._answers)
        orders += handshake.unconfirmed_orders(self.servos, self._answers)
        self._dialogue = self._ask([*handshake.settings_queries(self.servos), *orders])

    def _probes(self) -> dict[str, list[Probe]]:
        """Return what shows whether a servo has restarted; of some it is only the gyre."""
        probes = handshake.probes(self.servos, self._answers)
        for joint in self.servos:
            gyre = self.answer_of(joint.name, "QG")
            if joint.name not in probes and gyre is not None:
                probes[joint.name] = [Probe("QG", gyre, None)]
        return probes

    def _begin_recovery(self, now_ns: int) -> None:
        """Compare servos that have restarted with what they were, and set them up again.

        For those whose answers come twice another one with the same id is looked for.
        """
        restarted, self._poller.restarted = self._poller.restarted, {}
        doubled, self._poller.doubled = self._poller.doubled, []
        self._away = [one for one in self.servos if one.name in restarted or one in doubled]
        for servo in self._away:
            for mate in self._poller.stop_mates(servo):
                self.lines[mate.bus].send(encode(Command(mate.servo_id, "H")), now_ns)
            if servo.name in restarted:
                self.limp |= self._with_mates([self.view.label(servo.name)[0]])
                text = f"{restarted[servo.name]}. It is limp"
                fault = Faulted(servo.name, text, Cause.RESTARTED, FaultStep.WARN)
                self._events.append(self.view.fault(fault))
        self._prove(doubled)

    def _prove(self, suspects: Sequence[Joint] = ()) -> None:
        self._dialogue = Preflight(
            self._away,
            self._servo_robot,
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
            orders += [Item.to(servo, "H") for servo in self.servos if has_reading(servo)]
        if self._has_set:
            orders += handshake.restoring_orders(self.servos, self._answers)
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
        servos = dict.fromkeys(servo for name in joints for servo in self.view.servos_of(name))
        return [self._servo_robot.joints[name] for name in servos]

    def _give_way(self, fresh: Iterable[JointReading]) -> None:
        """Make joints that were pushed hold their present angle."""
        for name, deg in {reading.joint: reading.deg for reading in fresh}.items():
            is_held = name in self._held_deg and name not in self.limp
            if is_held and abs(deg - self._held_deg[name]) > GIVE_WAY_DEG:
                self._held_deg[name] = self.move(name, deg, GIVE_WAY_S)


def _jump(servo: Joint, servo_deg: float) -> Command:
    """Return what sends an RC servo there: to the next whole degree."""
    step = servo.model.wire_step
    wire = round(servo_deg * servo.model.wire_per_deg / step) * step
    return Command(servo.servo_id, "D", wire)


def _session(robot: Robot, name: str, *, is_soft: bool) -> Joint:
    """Return a servo with the session's settings."""
    servo = robot.joints[name]
    soft = SOFT if is_soft and has_reading(servo) else {}
    return replace(servo, settings={**servo.settings, **soft})
