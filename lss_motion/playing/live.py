"""A robot without a show: `connect` checks it, then moves single joints, reads, and lets go.

    with lss.connect(robot) as live:
        live.move_to({"elbow": 30}, 1.5)      # within the limits; returns when it is there
        live.set_target({"elbow": 31})        # at any rate; returns at once, the joint follows
        live.read()                           # {'base': 0.1, 'elbow': 29.9, …}
        live.limp("elbow")                    # it falls: hold it

Each move is a small show: it is planned, verified and compiled as any other, and the servos have
their own settings again after it. While joints follow targets, a process of its own plays (as
`remote.handle.start`), and the ports are with it until another call needs them. When the block is
left, by an exception too, the robot gets its safe end.
"""

from __future__ import annotations

import atexit
import contextlib
from typing import TYPE_CHECKING, Self, TypeVar

from msgspec.structs import replace

from lss_motion.errors import BusError, InputError, LssMotionError, PlaybackError
from lss_motion.files.texts import known_names
from lss_motion.playing import connection as connections
from lss_motion.playing.api import compile, is_simulated, plan, with_port  # noqa: A004
from lss_motion.playing.discovery import limit_questions, robot_from_answers
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.player import handshake
from lss_motion.playing.player.events import Phase
from lss_motion.playing.player.handshake import Item
from lss_motion.playing.player.health import turn_text
from lss_motion.playing.player.player import Player
from lss_motion.playing.player.repertoire import Repertoire
from lss_motion.playing.targets import (
    TargetLimiter,
    TargetRule,
    live_program,
    target_values,
)
from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.framing import Command
from lss_motion.robot.model import HALF_TURN_DEG, Robot
from lss_motion.show.check import check_sequence
from lss_motion.show.model import Keyframe, Sequence, Timing
from lss_motion.system.clock import MonotonicClock, VirtualClock

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.remote.handle import Handle
    from lss_motion.playing.runner import Controls
    from lss_motion.robot.model import Joint

T = TypeVar("T")


def connect(
    robot: Robot,
    *,
    port: str | None = None,
    is_virtual: bool = False,
    seed: int = 0,
    targets: TargetRule | None = None,
) -> Live:
    """Open the ports of `robot` and check every servo; nothing moves.

    `port` overrides that of the file. `is_virtual` needs a simulated robot, for which time then
    passes as fast as the computer can. `targets` says how joints follow `Live.set_target`.
    Raises `BusError` when a port or a servo cannot be reached,
    and `InputError` or `PlaybackError` when the robot is not what the file says or not fit to move.
    """
    return Live(with_port(robot, port), is_virtual=is_virtual, seed=seed, targets=targets)


class Live:
    """An open robot. A context manager; `close` gives the robot its safe end."""

    def __init__(
        self, robot: Robot, *, is_virtual: bool, seed: int, targets: TargetRule | None = None
    ) -> None:
        """Open the ports; see `connect`."""
        if is_virtual and not is_simulated(robot):
            raise InputError("is_virtual needs the simulated bus: use it with port='sim://'")
        self._clock = VirtualClock() if is_virtual else MonotonicClock()
        self._targets, self._seed = targets or TargetRule(), seed
        self._follower: Handle | None = None
        """What leads the joints to targets in a process of its own, which has the ports."""
        self.warnings: list[str] = []
        """What a person may want to mend, found when the robot was checked."""
        self._limp: dict[str, Joint] = {}
        """Servos without power, by name."""
        self._held_deg: dict[str, float] = {}
        """Where servos that hold stood last, in degrees of ideal servos."""
        self._is_closed = False
        self._opened = self._open(robot)
        try:
            if robot.unread:
                robot = robot_from_answers(robot, self._connection.ask(limit_questions(robot)))
            servos = robot.servo_robot
            _, self.warnings = self._connection.examined(servos.joints.values(), servos)
        except BaseException:
            self._leave()
            raise
        self.robot = robot
        """The robot, with the limits that its file leaves to the servos."""
        self._view, self._servos = JointView(robot), robot.servo_robot
        self._is_failed = False
        atexit.register(self.close)

    def _open(self, robot: Robot) -> connections.Connection:
        """Open the ports; `_connection` gives them to who asks or moves servos."""
        opened = connections.connect(robot.buses, robot=robot, clock=self._clock, seed=self._seed)
        return opened.__enter__()

    @property
    def _connection(self) -> connections.Connection:
        """The open ports, which are taken back if joints follow targets."""
        if self._follower is not None:
            self._end_following()
        return self._opened

    def read(self) -> dict[str, float]:
        """Return where every joint is, in joint degrees; raises `BusError` if one does not say.

        Of joints that follow targets it is the last reading, or else where they should be.
        """
        if self._follower is not None and (known := self._follower.readings()):
            return {
                name: round(one.predicted_deg if one.read_deg is None else one.read_deg, 3) + 0.0
                for name, one in known.items()
            }
        # + 0.0: no -0.0 is shown.
        return {name: deg + 0.0 for name, deg in self._view.joint_deg(self._read_servos()).items()}

    def _read_servos(self) -> dict[str, float]:
        """Return where every servo is, in degrees of ideal servos."""
        servos = list(self._servos.joints.values())
        answers = self._ask(handshake.position_queries(servos))
        standing_deg = handshake.standing_deg(servos, answers)
        if silent := [servo for servo in servos if servo.name not in standing_deg]:
            raise handshake.silent_error(silent, servos, self._servos, answers)
        return {servo.name: servo.joint_deg(standing_deg[servo.name]) for servo in servos}

    def move_to(
        self,
        deg: Mapping[str, float],
        duration_s: float | None = None,
        *,
        controls: Controls[Player] | None = None,
    ) -> float:
        """Move these joints to these angles and wait until they are there; return how long it took.

        That is `duration_s`, or longer where a limit requires it; without `duration_s` as short as
        the limits allow. Joints that are limp are held again if they are moved, and the others stay
        as they are; those of the same mechanism hold where they stand. `controls` may stop it on
        the way. Raises `InputError` for an unknown joint or an angle out of its range, and
        `PlaybackError` if a joint does not follow.
        """
        if not deg:
            raise InputError("move_to needs at least one joint and its angle")
        if duration_s is not None and not duration_s > 0.0:
            raise InputError(f"duration_s is {duration_s:g}; it must be above 0")
        targets = target_values(deg, self.robot.joints)
        timing = Timing.FASTEST if duration_s is None else Timing.AUTHORED
        check_sequence(Sequence(name="move", keyframes=(Keyframe(deg=targets),)), self.robot)
        moved = dict.fromkeys(mate for name in targets for mate in self._view.mates_of(name))
        joints = [self.robot.joints[name] for name in moved]
        servos = dict.fromkeys(servo for name in moved for servo in self._view.servos_of(name))
        servos_deg = self._read_servos()
        self._require_same_turn([self._servos.joints[name] for name in servos], servos_deg)
        here = {name: deg + 0.0 for name, deg in self._view.joint_deg(servos_deg).items()}
        from_deg = {joint.name: joint.within_deg(here[joint.name]) for joint in joints}
        to_deg = {name: targets.get(name, from_deg[name]) for name in moved}
        keyframes = (
            Keyframe(deg=from_deg, at_s=None if duration_s is None else 0.0),
            Keyframe(
                deg={name: targets.get(name, from_deg[name]) for name in moved}, at_s=duration_s
            ),
        )
        trajectory = plan(Sequence(name="move", keyframes=keyframes, timing=timing), self.robot)
        program = compile(trajectory, self.robot)
        # It holds between moves; what the robot file wants at the end comes at the end.
        robot = replace(self._servos, end="hold")
        player = Player(Repertoire.single(program, robot), robot)
        self._guarded(player, controls)
        for name in servos:
            self._limp.pop(name, None)
        self._send_limp(self._limp.values())
        if player.error is not None:
            raise player.error
        if player.outcome != "finished":
            text = "; ".join(str(fault) for fault in player.faults) or "the move was stopped"
            raise PlaybackError(f"{text}. The robot holds")
        self._held_deg |= {name: servos_deg[name] for name in servos_deg if name not in self._limp}
        self._held_deg |= self._view.servo_deg(to_deg)
        return program.duration_s

    def set_target(self, deg: Mapping[str, float]) -> None:
        """Let these joints follow targets that come at any rate, each within its limits.

        The newest target of each joint counts; one out of the range counts as its end. The first
        call returns when the servos are ready, which takes about a second, all others at once.
        Without a target for 200 ms all joints brake and hold, and go on with the next one;
        `TargetRule` changes that. Any other method but `read` ends it first, within the limits. A
        robot on `sim://` stands anew at its beginning then: `lss-motion sim` keeps one.

        Raises `InputError` for an unknown joint or what is no angle, and what ended it before:
        `PlaybackError` for a joint that did not follow, `BusError` for a lost port.
        """
        joints = self.robot.joints
        values = target_values(deg, joints)
        nearest = {name: joints[name].within_deg(value) for name, value in values.items()}
        if self._follower is not None and not self._follower.is_playing:
            self._end_following()
        is_new = any(name in self._limp for name in nearest)
        if is_new and self._follower is not None:
            self._end_following()
        if self._follower is None:
            self._begin_following(nearest)
        assert self._follower is not None
        self._follower.set_target(nearest)

    def latency_s(self, name: str) -> float:
        """Return the bound from `set_target` to the horn of a joint that begins to obey it.

        It holds without faults, and while the computer keeps time: the way to the process that
        plays, its tick, the moves of all joints of the bus, a query on its way, and servo and horn.
        """
        from lss_motion.playing.remote.handle import TARGET_EVERY_S

        self.robot.require_servos("set_target")
        (joint,) = self._named((name,))
        low_deg = {one.name: one.position_min_deg for one in self.robot.joints.values()}
        program = live_program(self.robot, low_deg)
        limiter = TargetLimiter(program, self.robot, self._targets)
        return TARGET_EVERY_S + limiter.latency_s(joint.name)

    def _begin_following(self, names: Iterable[str]) -> None:
        """Give the ports to a process in which joints follow targets; those named are not limp."""
        from lss_motion.playing.remote.handle import Handle
        from lss_motion.playing.remote.job import Job
        from lss_motion.playing.remote.schema import PhaseChanged

        if self._clock.is_virtual:
            raise InputError("set_target is for a robot in real time: connect without is_virtual")
        self.robot.require_servos("set_target")
        here = self.read()
        for name in names:
            self._limp.pop(name, None)
        joints = [joint for joint in self.robot.joints.values() if joint.name not in self._limp]
        self._require_same_turn(joints, here)
        robot = replace(self.robot, end="hold")
        program = live_program(robot, {joint.name: here[joint.name] for joint in joints})
        options = {"is_open": True, "seed": self._seed}
        job = Job(shows=program, robot=robot, targets=self._targets, options=options)
        self._opened.__exit__(None, None, None)
        self._follower = follower = Handle(job, program)
        for event in follower.events():
            if isinstance(event, PhaseChanged) and event.phase == Phase.SHOW.value:
                return
        self._end_following()

    def _end_following(self) -> None:
        """Let the joints brake and hold, and take the ports back; raise what went wrong."""
        follower, self._follower = self._follower, None
        assert follower is not None
        known = follower.readings()
        follower.close()
        self._held_deg |= {name: one.planned_deg for name, one in known.items()}
        self._opened = self._open(self.robot)
        report = follower.wait()
        if report.outcome != "stopped":
            text = "; ".join(map(str, report.faults)) or f"joints {report.outcome}"
            raise PlaybackError(f"{text}. The robot holds")

    def _require_same_turn(self, joints: Iterable[Joint], here_deg: Mapping[str, float]) -> None:
        """Raise `PlaybackError` for a joint that held and is in another turn: it has restarted."""
        for joint in joints:
            before_deg = self._held_deg.get(joint.name, here_deg[joint.name])
            if abs(here_deg[joint.name] - before_deg) > HALF_TURN_DEG:
                reported_deg = joint.servo_deg(here_deg[joint.name])
                text = turn_text(joint, reported_deg, joint.servo_deg(before_deg))
                raise PlaybackError(f"joint {joint.name!r} {text}", joint=joint.name)

    def limp(self, *names: str) -> None:
        """Take the power from these joints, or from all: they fall, and hands can move them.

        All joints of a mechanism go limp together.
        """
        servos = self._servos_named(names)
        for servo in servos:
            self._limp[servo.name] = servo
            self._held_deg.pop(servo.name, None)
        self._send_limp(servos)

    def hold(self, *names: str) -> None:
        """Hold these joints, or all, where they are now."""
        servos = self._servos_named(names)
        for servo in servos:
            self._limp.pop(servo.name, None)
        self._ask([Item.to(servo, "H") for servo in servos])

    def hold_at_end(self) -> None:
        """Let the last bytes hold all joints, whatever `end` of the robot file says."""
        self._is_failed = True

    def close(self) -> None:
        """Give the robot its safe end (`end` of its file) and close the ports; once is enough."""
        if self._is_closed:
            return
        atexit.unregister(self.close)
        if self._follower is not None:
            try:
                self._end_following()
            except LssMotionError as failed:
                self.warnings.append(str(failed))
        is_limp = self.robot.end == "limp" and not self._is_failed
        word = "L" if is_limp else "H"
        with contextlib.suppress(BusError):
            self._ask(
                [Item(bus=bus, command=Command(BROADCAST_ID, word)) for bus in self.robot.buses]
            )
            self._send_limp(self._limp.values())
        self._leave()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._is_failed = self._is_failed or kind is not None
        self.close()

    def __repr__(self) -> str:
        """Return one line: the robot, and what is limp."""
        limp = f", limp: {', '.join(self._limp)}" if self._limp else ""
        state = "closed" if self._is_closed else "open" if self._follower is None else "following"
        return f"<live {self.robot.name!r}: {state}{limp}>"

    def _named(self, names: tuple[str, ...]) -> list[Joint]:
        for name in names:
            if not isinstance(name, str):
                raise InputError(
                    f"{name!r} is no name; give the names one by one: 'elbow', 'wrist'"
                )
            if name not in self.robot.joints:
                raise InputError(f"unknown joint {name!r}; {known_names(name, self.robot.joints)}")
        return [self.robot.joints[name] for name in names or self.robot.joints]

    def _servos_named(self, names: tuple[str, ...]) -> list[Joint]:
        """Return the servos of these joints, or all."""
        joints = self._named(names)
        own = dict.fromkeys(servo for one in joints for servo in self._view.servos_of(one.name))
        return [self._servos.joints[name] for name in own]

    def _send_limp(self, joints: Iterable[Joint]) -> None:
        if orders := [Item.to(joint, "L") for joint in joints]:
            self._ask(orders)

    def _ask(self, items: Iterable[Item]) -> Mapping[tuple[str, int, str], int | str | None]:
        if self._is_closed:
            raise InputError("this robot was closed; connect again")
        return self._connection.ask(items)

    def by_hand(
        self,
        hands_on: HandsOn,
        *,
        controls: Controls[HandsOn],
        on_event: Callable[[Event], None] | None = None,
    ) -> None:
        """Let `controls` move, hold and release joints of this robot until they stop `hands_on`.

        At its end all joints hold, those that were limp as well.
        """
        try:
            self._connection.run(hands_on, controls=controls, on_event=on_event)
        except BaseException:
            self._is_failed = True
            raise
        finally:
            self._limp.clear()
            self._held_deg.clear()
        if hands_on.error is not None:
            raise hands_on.error

    def lend(self, use: Callable[[connections.Connection], T]) -> T:
        """Return what `use` makes of the open ports; if it raises, the last bytes hold."""
        try:
            return use(self._connection)
        except BaseException:
            self._is_failed = True
            raise

    def _guarded(self, player: Player, controls: Controls[Player] | None) -> None:
        """Play; whatever interrupts it ends without limp joints other than those there were."""
        try:
            self._connection.run(player, controls=controls)
        except BaseException:
            self._is_failed = True
            raise

    def _leave(self) -> None:
        self._is_closed = True
        self._opened.__exit__(None, None, None)
