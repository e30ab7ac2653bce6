"""A robot without a show, moved by a client of another process: jog, poses, limp, hold.

`LiveJob` opens the robot and serves one client until it stops. Between planned moves to a pose
(`playing.live.Live.move_to`) the robot is in the hands of the client (`playing.hands_on`): joints
turn while the client says so, hold, or are limp.

A joint that jogs has a target that lies a fraction of a second ahead and is renewed as long as the
client repeats its wish. So it stops by itself when the client is silent, and also when this process
is killed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from msgspec import Struct

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.texts import known_names
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.player.events import Faulted, Phase, Warned
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.joint_health import joints_health
from lss_motion.playing.remote.player_end import message_of
from lss_motion.protocol.constants import Status, status_from
from lss_motion.units import NS_PER_MS, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.playing.connection import Connection
    from lss_motion.playing.live import Live
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Joint, Robot

DEAD_MAN_NS: Final = 250 * NS_PER_MS
"""A joint jogs so long after the last wish: two and a half repetitions of 100 ms."""
STEP_NS: Final = 50 * NS_PER_MS
"""How often the target of a joint that jogs is renewed."""
LEAD_S: Final = 0.15
"""The target lies so far ahead, and the way to brake besides: three renewals may be late."""
AIM_LEAST_S: Final = 0.02
"""A joint at the end of its range gets moves of no length; no move is shorter than this."""
STRAY_S: Final = 0.3
STRAY_DEG: Final = 5.0
"""The target of a joint that is blocked leads its reading by at most the way of this time and this
angle besides. Readings are up to 100 ms old, and a horn lags by as much."""
STATE_NS: Final = 100 * NS_PER_MS
"""How often the angles are sent."""
HEALTH_EVERY: Final = 5
"""Health is sent with every fifth of them."""


class GuidedTask(Protocol):
    """Steps of one task about one joint, led by questions that a client answers."""

    joint: Joint
    now: m.MaintenanceChanged

    @property
    def is_over(self) -> bool:
        """Whether it takes no more answers."""

    def answer(self, text: str, hands_on: HandsOn) -> None:
        """Take an answer to the question of `now`; raises `InputError` for one it did not offer."""

    def cancel(self, hands_on: HandsOn) -> None:
        """End it; nothing is written."""


class GuidedTasks(Protocol):
    """Calibration and identification, plugged in by a client that offers them."""

    def joint(self, robot: Robot, name: str) -> Joint:
        """Return the joint; raises `InputError` for one that is unknown or that cannot be read."""

    def calibration(self, robot: Robot, joint: Joint) -> GuidedTask:
        """Begin to calibrate a joint."""

    def measured(
        self, connection: Connection, robot: Robot, name: str, operator: Operator
    ) -> tuple[GuidedTask | None, bool]:
        """Measure a joint that is free to move; return what follows, and whether it was stopped."""


class LiveJob(Struct, frozen=True, kw_only=True):
    """A robot that a client moves; `tasks` calibrates and identifies its joints."""

    robot: Robot
    tasks: GuidedTasks | None = None

    def run(self, operator: Operator) -> None:
        """Serve the client until it stops, or is gone; send the last event."""
        from lss_motion.playing.live import connect

        error = None
        try:
            with connect(self.robot) as live:
                for text in live.warnings:
                    operator.send(m.WarningRaised(text=text))
                LiveSession(live, operator, self.tasks).run()
        except LssMotionError as failed:
            error = str(failed)
        operator.send(m.Ended(outcome="fault" if error else "stopped", error=error, report=None))


@dataclass(slots=True)
class Jogging:
    """A joint that turns: its speed, its place by the profile, and when that was sent.

    `low_deg` and `high_deg` are how far it may turn.
    """

    speed_deg_s: float
    at_deg: float
    at_ns: int
    asked_ns: int
    low_deg: float
    high_deg: float
    sent_ns: int = 0

    def turn_to(self, to_deg: float) -> None:
        """Turn to an angle, and not beyond; the range of the joint holds besides."""
        self.speed_deg_s = math.copysign(self.speed_deg_s, to_deg - self.at_deg)
        if self.speed_deg_s > 0.0:
            self.high_deg = max(min(self.high_deg, to_deg), self.at_deg)
        else:
            self.low_deg = min(max(self.low_deg, to_deg), self.at_deg)


class LiveSession:
    """Alternates between the hands of the client and moves to a pose."""

    def __init__(self, live: Live, operator: Operator, tasks: GuidedTasks | None = None) -> None:
        self._live, self._operator, self._tasks = live, operator, tasks
        live.robot.require_turns(live.robot.servo_robot.joints.values())
        self._poses = dict(live.robot.poses)
        self._is_over = False
        self._limp: set[str] = set()
        self._guide: GuidedTask | None = None

    def run(self) -> None:
        """Run until the client stops, or is gone."""
        while not self._is_over:
            hands = Hands(
                self._operator,
                self._live.robot,
                self._poses,
                self._limp,
                self._guide,
                tasks=self._tasks,
            )
            self._live.by_hand(
                HandsOn(self._live.robot, list(self._live.robot.joints), has_health=True),
                controls=hands,
                on_event=self._note,
            )
            self._is_over, self._limp, self._guide = hands.is_over, hands.limp, None
            if hands.has_stopped:
                self._live.hold_at_end()
            elif isinstance(hands.wanted, m.Maintain):
                self._measure(hands.wanted)
            elif hands.wanted is not None:
                self._go(hands.wanted)

    def _go(self, wanted: m.PoseGo) -> None:
        """Move to a pose; what goes wrong is told, and the robot holds."""
        pose = self._poses[wanted.pose]
        stopping = Stopping(self._operator, self._live.robot, self._limp)
        try:
            self._live.move_to(pose, wanted.duration_s, controls=stopping)
        except LssMotionError as failed:
            if not stopping.has_stopped:
                self._operator.send(m.WarningRaised(text=f"pose {wanted.pose!r}: {failed}"))
        if stopping.has_stopped:
            self._is_over = True
            self._live.hold_at_end()
        self._limp -= set(pose)

    def _measure(self, wanted: m.Maintain) -> None:
        """Measure a joint; the result is asked about when the robot is in the hands again."""
        tasks = self._tasks
        assert tasks is not None, "`Hands` refuses what nothing can do"
        self._guide, has_stopped = self._live.lend(
            lambda connection: tasks.measured(
                connection, self._live.robot, wanted.joint, self._operator
            )
        )
        self._limp.discard(wanted.joint)
        if self._guide is not None:
            self._operator.send(self._guide.now)
        if has_stopped:
            self._is_over = True
            self._live.hold_at_end()

    def _note(self, event: Event) -> None:
        """Send warnings and faults; the phases of each run are of no interest."""
        if isinstance(event, Warned | Faulted) and (message := message_of(event)) is not None:
            self._operator.send(message)


class Stopping:
    """The controls of a move to a pose: it can only be stopped."""

    def __init__(self, operator: Operator, robot: Robot, limp: set[str]) -> None:
        self.has_stopped = False
        self._operator, self._robot, self._limp = operator, robot, limp
        self._state_ns = 0

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""
        return self._operator.filenos()

    def act(self, player: Player, now_ns: int) -> None:
        """Stop if the client says so or is gone; refuse the rest."""
        self._tell(player, now_ns)
        for operation in self._operator.take(now_ns):
            match operation:
                case m.Estop():
                    self.has_stopped = True
                    player.abort(now_ns)
                case m.Stop():
                    self._stop(player, now_ns)
                case m.Beat():
                    pass
                case _:
                    self._operator.refuse(operation, "the robot moves to a pose; wait, or stop")
        if self._operator.take_signals() or self._operator.is_cut:
            self._stop(player, now_ns)

    def _stop(self, player: Player, now_ns: int) -> None:
        if not self.has_stopped:
            self.has_stopped = True
            player.stop(now_ns)

    def _tell(self, player: Player, now_ns: int) -> None:
        if now_ns < self._state_ns:
            return
        self._state_ns = now_ns + STATE_NS
        self._operator.look_for_client()
        states = {} if player.show is None else player.show.joint_states
        read_deg = {
            name: state.joint.joint_deg(state.disturbance.measured_deg)
            for name, state in states.items()
            if state.disturbance.measured_deg is not None
        }
        read_deg = JointView(self._robot).joint_deg(read_deg)
        self._operator.offer(live_state(self._robot, read_deg, self._limp, is_ready=True))


class Hands:
    """The client's hands, as controls of `HandsOn`: jog, limp and hold until `is_over`."""

    def __init__(
        self,
        operator: Operator,
        robot: Robot,
        poses: dict[str, Mapping[str, float]],
        limp: set[str],
        guide: GuidedTask | None = None,
        tasks: GuidedTasks | None = None,
    ) -> None:
        """Begin with these joints limp. A pose that is saved is added to `poses`.

        `guide` has asked something, which the client may answer now.
        """
        self.is_over = False
        """Whether the client has ended it, has stopped it, or is gone."""
        self.has_stopped = False
        """Whether that was a stop: then all joints hold, whatever the robot file wants."""
        self.wanted: m.PoseGo | m.Maintain | None = None
        """The pose to which the robot is to move next, or the joint that is to be measured."""
        self.limp = set(limp)
        self._operator, self._robot, self._poses = operator, robot, poses
        self._end_ns: int | None = None
        """When joints that turned have come to rest, and it ends."""
        self._jogs: dict[str, Jogging] = {}
        self._has_begun = False
        self._found_limp: set[str] = set()
        """Joints that were limp when this began and have got no order since."""
        self._state_ns = self._told = 0
        self._guide, self._tasks = guide, tasks

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""
        return self._operator.filenos()

    def act(self, hands_on: HandsOn, now_ns: int) -> None:
        """Obey the operations since the last call, and renew the targets of joints that jog."""
        if hands_on.phase is Phase.SHOW and not self._has_begun:
            self._has_begun = True
            hands_on.let_go(self.limp)
            self._found_limp = found_limp(hands_on)
        for operation in self._operator.take(now_ns):
            try:
                self._obey(operation, hands_on, now_ns)
            except InputError as refused:
                self._operator.refuse(operation, str(refused))
            else:
                self._operator.accept(operation)
        if self._operator.take_signals() or self._operator.is_cut:
            self._end(hands_on, now_ns)
        if hands_on.phase is Phase.SHOW:
            self._renew(hands_on, now_ns)
        if self._end_ns is not None and now_ns >= self._end_ns:
            self._end_ns = None
            hands_on.stop()
        self._tell(hands_on, now_ns)

    def _obey(self, operation: m.AnyOperation, hands_on: HandsOn, now_ns: int) -> None:
        match operation:
            case m.Estop():
                self._end(hands_on, now_ns)
                self._end_ns = None
                hands_on.stop()
                hands_on.stop()  # The second call ends at once.
            case m.Stop():
                self._end(hands_on, now_ns)
            case m.Disconnect():
                self._end(hands_on, now_ns, is_stop=False)
            case m.Beat():
                pass
            case _ if self.is_over:
                raise InputError("the robot is being disconnected; connect it again")
            case _ if hands_on.phase is not Phase.SHOW or self.wanted is not None:
                raise InputError("the servos are being asked; wait a moment")
            case _:
                self._handle(operation, hands_on, now_ns)

    def _handle(self, operation: m.AnyOperation, hands_on: HandsOn, now_ns: int) -> None:
        """Obey an operation that needs servos which are ready."""
        match operation:
            case m.Jog():
                self._jog(operation, hands_on, now_ns)
            case m.Limp() | m.Hold():
                names = self._with_mates(self._named(operation.joints, hands_on), hands_on)
                self._found_limp -= set(names)
                for name in names:
                    self._jogs.pop(name, None)
                if isinstance(operation, m.Limp):
                    hands_on.let_go(names)
                else:
                    hands_on.hold(names)
                self.limp = set(hands_on.limp)
            case m.PoseGo():
                self._require_pose(operation.pose)
                self._want(operation, hands_on)
            case m.PoseSave():
                self._save(operation, hands_on)
            case m.Maintain():
                self._maintain(operation, hands_on)
            case m.MaintenanceAnswer():
                self._answer(operation.answer, hands_on)
            case _:
                raise InputError(f"{operation.op} is no operation on a robot without a show")

    def _end(self, hands_on: HandsOn, now_ns: int, *, is_stop: bool = True) -> None:
        """Brake what turns, then end."""
        self.has_stopped = self.has_stopped or is_stop
        if self.is_over:
            return
        self.is_over, self._end_ns = True, now_ns
        self._drop_guide(hands_on)
        for name, jog in list(self._jogs.items()):
            rest_s = 2.0 * _braking_s(self._robot.joints[name], jog)
            self._end_ns = max(self._end_ns, now_ns + ns_from_s(rest_s))
            self._brake(name, jog, hands_on, now_ns)

    # ---- jog

    def _jog(self, operation: m.Jog, hands_on: HandsOn, now_ns: int) -> None:
        (name,) = self._named((operation.joint,), hands_on)
        joint = self._robot.joints[name]
        mates = self._with_mates([name], hands_on)
        self._found_limp -= set(mates)
        limit_deg_s = self._robot.approach_deg_s(joint)
        speed_deg_s = operation.speed_ratio * limit_deg_s
        jog = self._jogs.get(name)
        if jog is None and speed_deg_s:
            here_deg = hands_on.readings[name].deg
            range_deg = joint.position_min_deg, joint.position_max_deg
            jog = self._jogs[name] = Jogging(speed_deg_s, here_deg, now_ns, now_ns, *range_deg)
            self.limp -= set(mates)
        elif jog is not None:
            jog.low_deg, jog.high_deg = joint.position_min_deg, joint.position_max_deg
            jog.speed_deg_s, jog.asked_ns = speed_deg_s or jog.speed_deg_s, now_ns
            if not speed_deg_s:
                self._brake(name, jog, hands_on, now_ns)
        if jog is not None and speed_deg_s and operation.to_deg is not None:
            jog.turn_to(operation.to_deg)

    def _renew(self, hands_on: HandsOn, now_ns: int) -> None:
        """Send the next target of each joint that jogs; brake one that is not asked for."""
        for name, jog in list(self._jogs.items()):
            if now_ns - jog.asked_ns > DEAD_MAN_NS:
                self._brake(name, jog, hands_on, now_ns)
            elif now_ns - jog.sent_ns >= STEP_NS:
                jog.sent_ns = now_ns
                self._advance(name, jog, hands_on, now_ns)
                joint = self._robot.joints[name]
                self._aim(joint, jog, hands_on, LEAD_S + _braking_s(joint, jog))

    def _brake(self, name: str, jog: Jogging, hands_on: HandsOn, now_ns: int) -> None:
        """Let a joint come to rest as soon as its acceleration allows."""
        del self._jogs[name]
        self._advance(name, jog, hands_on, now_ns)
        joint = self._robot.joints[name]
        self._aim(joint, jog, hands_on, _braking_s(joint, jog))

    def _advance(self, name: str, jog: Jogging, hands_on: HandsOn, now_ns: int) -> None:
        """Move the place of a joint on to now, not far from where it was read."""
        here_deg = hands_on.readings[name].deg
        at_deg = jog.at_deg + jog.speed_deg_s * s_from_ns(now_ns - jog.at_ns)
        stray_deg = abs(jog.speed_deg_s) * STRAY_S + STRAY_DEG
        at_deg = min(max(at_deg, here_deg - stray_deg), here_deg + stray_deg)
        jog.at_deg, jog.at_ns = at_deg, now_ns

    def _aim(self, joint: Joint, jog: Jogging, hands_on: HandsOn, lead_s: float) -> None:
        """Send a target so far ahead, at the speed of the joint, within its range."""
        wanted_deg = jog.at_deg + jog.speed_deg_s * lead_s
        target_deg = min(max(wanted_deg, jog.low_deg), jog.high_deg)
        duration_s = max(abs(target_deg - jog.at_deg) / abs(jog.speed_deg_s), AIM_LEAST_S)
        jog.at_deg = min(max(jog.at_deg, jog.low_deg), jog.high_deg)
        hands_on.move(joint.name, target_deg, duration_s)

    # ---- poses

    def _require_pose(self, pose: str) -> None:
        if pose not in self._poses:
            raise InputError(f"unknown pose {pose!r}; {known_names(pose, self._poses)}")

    def _want(self, operation: m.PoseGo | m.Maintain, hands_on: HandsOn) -> None:
        self._require_rest()
        self._drop_guide(hands_on)
        self.wanted = operation
        hands_on.stop()  # Holds, and ends this part; then the move begins.

    def _save(self, operation: m.PoseSave, hands_on: HandsOn) -> None:
        """Write where the joints are into the robot file."""
        from lss_motion.robot.load import load_robot
        from lss_motion.robot.write import write_pose

        path = self._robot.path
        if path is None:
            raise InputError("this robot has no file")
        self._require_rest()
        known = load_robot(path).poses
        if operation.is_new and operation.pose in known:
            raise InputError(f"pose {operation.pose!r} exists; save over it, or take another name")
        if not operation.is_new and operation.pose not in known:
            raise InputError(
                f"unknown pose {operation.pose!r}; {known_names(operation.pose, known)}"
            )
        joints = hands_on.readings if operation.is_new else known[operation.pose]
        angles_deg = {
            name: self._seen_deg(name, hands_on) for name in joints if name in hands_on.readings
        }
        write_pose(path, operation.pose, angles_deg)
        self._poses[operation.pose] = {**known.get(operation.pose, {}), **angles_deg}

    def _require_rest(self) -> None:
        if self._jogs:
            raise InputError("a joint turns; let it stop first")

    def _seen_deg(self, name: str, hands_on: HandsOn) -> float:
        return self._robot.joints[name].within_deg(round(hands_on.readings[name].deg, 1))

    def _named(self, names: Sequence[str], hands_on: HandsOn) -> list[str]:
        known = [joint.name for joint in hands_on.joints]
        for name in names:
            if name not in known:
                raise InputError(f"unknown joint {name!r}; {known_names(name, known)}")
        return list(names) or known

    def _with_mates(self, names: Sequence[str], hands_on: HandsOn) -> list[str]:
        """Return joints with all that the same servos move."""
        return list(dict.fromkeys(mate for one in names for mate in hands_on.view.mates_of(one)))

    # ---- calibrate and identify

    def _maintain(self, operation: m.Maintain, hands_on: HandsOn) -> None:
        """Begin a calibration here; a measurement begins when this part has ended."""
        if self._tasks is None:
            raise InputError(f"{operation.what} is not offered here")
        joint = self._tasks.joint(self._robot, operation.joint)
        if operation.what == "identify":
            self._want(operation, hands_on)
            return
        self._require_rest()
        self._drop_guide(hands_on)
        self._guide = self._tasks.calibration(self._robot, joint)
        self._operator.send(self._guide.now)

    def _answer(self, answer: str, hands_on: HandsOn) -> None:
        if self._guide is None or self._guide.is_over:
            raise InputError("nothing is asked now")
        self._guide.answer(answer, hands_on)
        self.limp = set(hands_on.limp)
        self._found_limp.discard(self._guide.joint.name)
        self._operator.send(self._guide.now)

    def _drop_guide(self, hands_on: HandsOn) -> None:
        """End what is being asked; nothing of it is written."""
        if self._guide is not None and not self._guide.is_over:
            self._guide.cancel(hands_on)
            self._operator.send(self._guide.now)
        self._guide = None

    # ---- state

    def _tell(self, hands_on: HandsOn, now_ns: int) -> None:
        if now_ns < self._state_ns:
            self._operator.link.flush()
            return
        self._state_ns = now_ns + STATE_NS
        self._operator.look_for_client()
        hands_on.take()
        read_deg = {name: reading.deg for name, reading in hands_on.readings.items()}
        self._operator.offer(
            live_state(
                self._robot,
                read_deg,
                hands_on.limp | self._found_limp,
                is_ready=self._has_begun,
            )
        )
        self._told += 1
        if self._told % HEALTH_EVERY == 0:
            self._operator.offer(live_health(self._robot, hands_on))


def _braking_s(joint: Joint, jog: Jogging) -> float:
    """Return how long a joint goes on at its speed for the way that it needs to brake."""
    return abs(jog.speed_deg_s) / (2.0 * joint.accel_max_deg_s2)


def found_limp(hands_on: HandsOn) -> set[str]:
    """Return the joints that reported to be limp when they were asked, as after power-up."""
    limp = set()
    for servo in hands_on.servos:
        code, firmware = (hands_on.answer_of(servo.name, key) for key in ("Q", "QF"))
        if code is not None and status_from(code, servo.model.family, firmware) is Status.LIMP:
            limp |= {*hands_on.view.mates_of(hands_on.view.label(servo.name)[0])}
    return limp


def live_state(
    robot: Robot, read_deg: Mapping[str, float], limp: set[str], *, is_ready: bool
) -> m.RobotChanged:
    """Return the state of a robot without a show, as an event."""
    return m.RobotChanged(
        state="live" if is_ready else "connecting",
        port=", ".join(bus.port for bus in robot.buses.values()),
        is_simulated=all(bus.is_simulated for bus in robot.buses.values()),
        joints={
            name: m.LiveJoint(
                deg=None if name not in read_deg else _rounded(read_deg[name]),
                is_limp=name in limp,
            )
            for name in robot.joints
        },
        text="",
    )


def live_health(robot: Robot, hands_on: HandsOn) -> m.Health:
    """Return what the servos of a robot without a show reported, as an event."""
    joints = {
        name: m.JointHealth(
            status=None if health.status is None else health.status.value,
            temperature_c=health.temperature_c,
            voltage_v=health.voltage_v,
            current_a=health.current_a,
            error_deg=None,
            correction_deg=0.0,
            allowed_deg=robot.servo_robot.joints[name].following_deg,
        )
        for name, health in hands_on.health.items()
    }
    joints = joints_health(hands_on.view, joints, {})
    return m.Health(
        phase="live",
        show_s=None,
        rate=0.0,
        is_paused=False,
        late_us=0,
        missed=0,
        joints=joints,
        buses={},
    )


def _rounded(deg: float) -> float | None:
    return round(deg, 2) if math.isfinite(deg) else None
