"""`lss-motion jog | calibrate`: joints moved by keys and by hand.

What `record`, `jog` and `calibrate` share: the run, its keys, and what is seen.

`lss-motion jog | calibrate`: joints moved by keys and by hand, into the robot file.

The keys of `lss-motion jog`, and what is seen meanwhile.

The steps of `lss-motion calibrate`: let go, zero pose, a push of each joint, agree.

A few lines that stay on the terminal while joints are in somebody's hands.
"""

from __future__ import annotations

import re
import sys
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, add_robot, robot_at
from lss_motion.cli.messages import ended_by, put
from lss_motion.cli.terminal import Inputs
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.source import known_names
from lss_motion.maintenance.calibration import MOVED_MIN_DEG, Frame, frame_of, moved_origin
from lss_motion.player.events import Faulted, Phase, Warned
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.player.events import Event
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.hand import Hand


JOG_TEXT: Final = """\
Move joints by keys, within their ranges, at the robot's approach_speed_deg_s at most.

Keys: up and down choose a joint; left and right move it by a step; [ and ] make the step smaller
and larger; l lets the joint go limp (hold it: it falls), h holds it; c writes where all joints are
into the robot file as a pose; q ends. All else in the robot file stays as you wrote it.
"""

CALIBRATE_TEXT: Final = """\
Find out by hand where the zero of each joint is, and which way it turns.

The joints go limp: hold the robot. Bring it to its zero pose (or to the pose --at), then push each
joint towards its larger angles when asked. What comes of it is shown and, when you agree, written
as zero_deg and direction into the robot file; all else in it stays as you wrote it. With
--to-servos the origin offset of each servo is set and stored as well, so that the servo itself
says 0 at the zero pose.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    jog = add_command(commands, "jog", _jog, "move joints by keys; keep poses", JOG_TEXT)
    calibrate = add_command(
        commands,
        "calibrate",
        _calibrate,
        "find zero and direction of each joint by hand",
        CALIBRATE_TEXT,
    )
    for command in (jog, calibrate):
        add_robot(command, is_required=True)
        command.add_argument("--port", metavar="URL", help="serial device or URL")
        command.add_argument(
            "--joints", nargs="+", metavar="NAME", help="joints or groups; default: all"
        )
        command.add_argument(
            "--hand", metavar="FILE|SEED", help="simulated bus only: who leads limp joints"
        )
    jog.add_argument("--pose", default="pose", metavar="NAME", help="name of the poses kept by c")
    calibrate.add_argument("--at", metavar="POSE", help="a pose of the robot file in place of 0")
    calibrate.add_argument(
        "--to-servos", action="store_true", help="set and store the origin of the servos, too"
    )


def _jog(arguments: argparse.Namespace) -> int:
    from lss_motion.maintenance.hands_on import HandsOn

    robot, joints = _loaded(arguments)
    if not _is_name(arguments.pose):
        raise InputError(f"--pose {arguments.pose!r}: letters, digits, - and _ make a name")
    return _run(arguments, HandsOn(robot, joints), JogControls(robot, arguments.pose))


def _calibrate(arguments: argparse.Namespace) -> int:
    from lss_motion.files.source import known_names
    from lss_motion.maintenance.hands_on import HandsOn

    robot, joints = _loaded(arguments)
    if arguments.at is not None and arguments.at not in robot.poses:
        known = known_names(arguments.at, robot.poses)
        raise InputError(f"unknown pose {arguments.at!r}; {known}", path=robot.path)
    pose = robot.poses.get(arguments.at, {})
    hands_on = HandsOn(robot, joints, also_ask=("QO", "QG") if arguments.to_servos else ())
    return _run(
        arguments, hands_on, CalibrateControls(robot, pose, is_to_servos=arguments.to_servos)
    )


def _is_name(name: str) -> bool:
    return name.replace("_", "").replace("-", "").isalnum() and name.isascii()


def _loaded(arguments: argparse.Namespace) -> tuple[Robot, list[str]]:
    from lss_motion.connection import ask_limits, is_simulated

    robot = ask_limits(robot_at(arguments.robot, arguments.port))
    if arguments.hand is not None and not is_simulated(robot):
        raise InputError("--hand needs the simulated bus: use it with --port sim://")
    return robot, chosen_joints(robot, arguments.joints)


def _run(arguments: argparse.Namespace, hands_on: HandsOn, controls: HandsControls) -> int:
    from lss_motion.sim.hand import hand_of

    hand = None if arguments.hand is None else hand_of(arguments.hand, hands_on.robot)
    with controls:
        if not controls.has_keys:
            raise InputError("needs a terminal: it is steered by keys")
        perform(hands_on, controls, hand=hand)
    if hands_on.error is not None:
        raise hands_on.error
    if controls.error is not None:
        raise controls.error
    if controls.signal_number is not None:
        return ended_by(controls.signal_number)
    return EXIT_FINISHED


FRAME_NS: Final = NS_PER_S // 8
BAR_CHARS: Final = 31
NEAR_DEG: Final = 1.0
"""So near to an end of its range a joint is shown as being there."""


class Screen:
    """Draws on standard error if that is a terminal; what is said goes to standard output."""

    def __init__(self) -> None:
        self._is_live = sys.stderr.isatty()
        self._next_ns = 0
        self._drawn_count = 0

    def say(self, text: str) -> None:
        """Print a line for good, above what is drawn."""
        self._clear()
        put(text)

    def show(self, lines: Sequence[str], now_ns: int) -> None:
        """Draw the lines in place of those before, if it is time."""
        if not self._is_live or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + FRAME_NS
        self._clear()
        put("\n".join(lines), sys.stderr)
        self._drawn_count = len(lines)

    def _clear(self) -> None:
        if self._drawn_count:
            put(f"\x1b[{self._drawn_count}A\x1b[J", sys.stderr, end="")
        self._drawn_count = 0


def joint_lines(hands_on: HandsOn, now_ns: int, chosen: str = "") -> list[str]:
    """Return a line for every joint: angle, place in its range, limp or not, age of the reading."""
    width = max(len(joint.name) for joint in hands_on.joints)
    lines = []
    for joint in hands_on.joints:
        reading = hands_on.readings.get(joint.name)
        if reading is None:
            continue
        mark = ">" if joint.name == chosen else " "
        state = "limp" if joint.name in hands_on.limp else "    "
        age_ms = 1000.0 * s_from_ns(now_ns - reading.at_ns)
        late = f"  {age_ms:.0f} ms ago" if age_ms > 200.0 else ""
        place = f"{_bar(joint, reading.deg)} {_at_limit(joint, reading.deg)}"
        lines.append(f"{mark} {joint.name:{width}} {reading.deg:8.1f} {place} {state}{late}")
    return lines


def _bar(joint: Joint, deg: float) -> str:
    low, high = joint.position_min_deg, joint.position_max_deg
    at = round((min(max(deg, low), high) - low) / (high - low) * (BAR_CHARS - 1))
    return f"{low:6.0f} |{'-' * at}#{'-' * (BAR_CHARS - 1 - at)}| {high:<6.0f}"


def _at_limit(joint: Joint, deg: float) -> str:
    if deg < joint.position_min_deg - NEAR_DEG or deg > joint.position_max_deg + NEAR_DEG:
        return "BEYOND"
    is_near = min(deg - joint.position_min_deg, joint.position_max_deg - deg) < NEAR_DEG
    return "LIMIT " if is_near else "      "


KEYS: Final = re.compile(r"\x1b\[[A-D]|[^\x1b]")
"""A key as a terminal sends it: an arrow, or a character."""


class HandsControls(Inputs, ABC):
    """Keys, signals and the screen of a run; each command has its own `begin`, `turn`, `press`."""

    greeting = ""
    """What to do first."""

    def __init__(self) -> None:
        super().__init__()
        self._screen = Screen()
        self._has_begun = False
        self.now_ns = 0
        self.error: InputError | None = None
        """Why it ended early, if it did."""

    def act(self, driven: HandsOn, now_ns: int) -> None:
        """Apply what came since the last call."""
        self.now_ns = now_ns
        signals_count, keys = self.take()
        for _ in range(signals_count):
            driven.stop()
        if driven.phase is Phase.SHOW and not self._has_begun:
            self._has_begun = True
            self.begin(driven)
        if driven.phase is Phase.SHOW:
            self.turn(driven)
        for key in KEYS.findall(keys):
            if key in "qQ":
                driven.stop()
            elif driven.phase is Phase.SHOW:
                self.press(key, driven)

    def begin(self, hands_on: HandsOn) -> None:  # noqa: ARG002  (for those that need it)
        """Do what comes first, once every servo has answered."""
        self.say(self.greeting)

    def turn(self, hands_on: HandsOn) -> None:
        """Do what is to be done all the time."""

    def press(self, key: str, hands_on: HandsOn) -> None:
        """Do what a key asks for."""

    @abstractmethod
    def lines(self, hands_on: HandsOn, now_ns: int) -> Sequence[str]:
        """Return what is to be seen."""

    def say(self, text: str) -> None:
        self._screen.say(text)

    def tell(self, event: Event) -> None:
        """Say what happened, if a person should know."""
        match event:
            case Warned(text):
                self.say(f"warning: {text}")
            case Faulted(joint, cause):
                self.say(f"warning: joint {joint!r} {cause}")
            case _:
                pass

    def show(self, driven: HandsOn, now_ns: int) -> None:
        if lines := self.lines(driven, now_ns):
            self._screen.show(lines, now_ns)


def perform(
    hands_on: HandsOn,
    controls: HandsControls,
    *,
    is_virtual: bool = False,
    hand: Hand | None = None,
) -> None:
    """Run until somebody ends it; raises `BusError` when a port cannot be opened or is lost."""
    from lss_motion.connection import connect, is_simulated
    from lss_motion.runtime.clock import MonotonicClock, VirtualClock
    from lss_motion.runtime.runner import run

    clock = VirtualClock() if is_virtual else MonotonicClock()
    robot = hands_on.robot
    if is_simulated(robot):
        controls.say(f"no hardware, the robot {robot.name!r} is simulated")
    with connect(robot.buses, robot=robot, clock=clock, hand=hand) as connection:
        run(
            hands_on,
            connection.ports,
            clock,
            on_event=controls.tell,
            on_turn=controls.show,
            controls=controls,
        )


def chosen_joints(robot: Robot, names: Iterable[str] | None) -> list[str]:
    """Return the joints that are meant by names of joints and groups, in the robot's order."""
    if names is None:
        return list(robot.joints)
    chosen: set[str] = set()
    for name in names:
        if name not in robot.joints and name not in robot.groups:
            known = known_names(name, [*robot.joints, *robot.groups])
            raise InputError(f"unknown joint or group {name!r}; {known}", path=robot.path)
        chosen.update(robot.groups.get(name, (name,)))
    return [name for name in robot.joints if name in chosen]


JOG_KEYS: Final = "arrows choose and move  [ ] step  l limp  h hold  c keep pose  q end"
STEPS_DEG: Final = (0.1, 0.5, 1.0, 5.0, 15.0)
LEAD_S: Final = 0.5
"""A key that is held down sends a joint no further ahead than it turns in so long: it stops soon
after the key is released. Chosen."""


class JogControls(HandsControls):
    """Moves one joint at a time; poses go into the robot file at once."""

    greeting = JOG_KEYS

    def __init__(self, robot: Robot, pose_name: str) -> None:
        super().__init__()
        self._robot = robot
        self._pose_name = pose_name
        self._poses = set(robot.poses)
        self._chosen = 0
        self._step = 2
        self._target_deg: dict[str, float] = {}

    def turn(self, hands_on: HandsOn) -> None:
        hands_on.take()

    def press(self, key: str, hands_on: HandsOn) -> None:
        joint = hands_on.joints[self._chosen]
        match key:
            case "\x1b[A" | "k":
                self._chosen = (self._chosen - 1) % len(hands_on.joints)
            case "\x1b[B" | "j":
                self._chosen = (self._chosen + 1) % len(hands_on.joints)
            case "\x1b[C" | "+" | "=":
                self._move(hands_on, joint.name, STEPS_DEG[self._step])
            case "\x1b[D" | "-":
                self._move(hands_on, joint.name, -STEPS_DEG[self._step])
            case "[" | "]":
                self._step += 1 if key == "]" else -1
                self._step = min(max(self._step, 0), len(STEPS_DEG) - 1)
            case "l":
                hands_on.let_go([joint.name])
                self._target_deg.pop(joint.name, None)
            case "h":
                hands_on.hold([joint.name])
                self._target_deg.pop(joint.name, None)
            case "c":
                self._keep(hands_on)
            case _:
                pass

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        if hands_on.phase is not Phase.SHOW:
            return []
        chosen = hands_on.joints[self._chosen].name
        head = f"step {STEPS_DEG[self._step]:g} deg   {JOG_KEYS}"
        return [head, *joint_lines(hands_on, now_ns, chosen)]

    def _move(self, hands_on: HandsOn, name: str, step_deg: float) -> None:
        joint, here_deg = self._robot.joints[name], hands_on.readings[name].deg
        speed_deg_s = min(self._robot.approach_speed_deg_s, joint.speed_max_deg_s)
        lead_deg = max(abs(step_deg), LEAD_S * speed_deg_s)
        wanted_deg = self._target_deg.get(name, here_deg) + step_deg
        wanted_deg = min(max(wanted_deg, here_deg - lead_deg), here_deg + lead_deg)
        wanted_deg = round(wanted_deg, 2)
        target_deg = hands_on.move(name, wanted_deg, abs(wanted_deg - here_deg) / speed_deg_s)
        self._target_deg[name] = target_deg
        if target_deg != wanted_deg:
            low, high = joint.position_min_deg, joint.position_max_deg
            self.say(f"\a{name} ends at {target_deg:g} deg; its range is {low:g} to {high:g}")

    def _keep(self, hands_on: HandsOn) -> None:
        """Write where all joints are into the robot file, under a name that is free."""
        from lss_motion.robot.write import write_pose

        assert self._robot.path is not None
        names = (self._pose_name, *(f"{self._pose_name}_{n}" for n in range(2, 1000)))
        name = next((n for n in names if n not in self._poses), "")
        if not name:
            self.say("a thousand poses have this name; end and give another --pose")
            return
        pose = {}
        for joint in hands_on.joints:
            deg = round(hands_on.readings[joint.name].deg, 1)
            pose[joint.name] = min(max(deg, joint.position_min_deg), joint.position_max_deg)
        try:
            write_pose(self._robot.path, name, pose)
        except InputError as error:
            self.say(f"not kept: {error}")
            return
        self._poses.add(name)
        said = ", ".join(f"{joint} {angle:g}" for joint, angle in pose.items())
        self.say(f"{self._robot.path}: pose {name}: {said}")


class CalibrateControls(HandsControls):
    """Asks step by step; nothing is written before the person agrees."""

    greeting = "hold the robot, then press l to let all joints go limp; q ends"

    def __init__(self, robot: Robot, pose: Mapping[str, float], *, is_to_servos: bool) -> None:
        super().__init__()
        self._robot = robot
        self._pose = pose
        self._is_to_servos = is_to_servos
        self._servo_deg: dict[str, float] = {}
        self._frames: dict[str, Frame] = {}
        self._is_written = False

    def turn(self, hands_on: HandsOn) -> None:
        hands_on.take()
        if self._is_written and hands_on.has_sent_all:
            hands_on.stop()

    def press(self, key: str, hands_on: HandsOn) -> None:
        is_agreed = key in "\r\n"
        joint = self._next(hands_on)
        if not hands_on.limp:
            if key == "l":
                hands_on.let_go(joint.name for joint in hands_on.joints)
                where = "the pose" if self._pose else "its zero pose (every joint at 0)"
                self.say(f"bring the robot to {where}, then press Enter")
        elif not self._servo_deg:
            if is_agreed:
                self._servo_deg = {j.name: _servo_deg(hands_on, j) for j in hands_on.joints}
                self._ask_for_push(hands_on)
        elif joint is not None:
            if is_agreed or key == "s":
                self._take_push(hands_on, joint, is_pushed=is_agreed)
        elif key == "y":
            self._write(hands_on)
        elif key == "n":
            self.say("nothing was written")
            hands_on.stop()

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        if hands_on.phase is not Phase.SHOW:
            return []
        joint = self._next(hands_on)
        is_pushing = joint is not None and bool(self._servo_deg)
        chosen = joint.name if joint is not None and is_pushing else ""
        return joint_lines(hands_on, now_ns, chosen)

    def _next(self, hands_on: HandsOn) -> Joint | None:
        """Return the joint whose direction is not known yet."""
        return next((j for j in hands_on.joints if j.name not in self._frames), None)

    def _ask_for_push(self, hands_on: HandsOn) -> None:
        joint = self._next(hands_on)
        if joint is not None:
            self.say(
                f"push {joint.name} by {MOVED_MIN_DEG:g} deg or more towards its larger angles "
                "and press Enter there; s keeps its direction"
            )
            return
        for name, frame in self._frames.items():
            old = self._robot.joints[name]
            self.say(
                f"{name}: zero_deg {old.zero_deg:g} -> {frame.zero_deg:g}, "
                f"direction {old.direction} -> {frame.direction}"
            )
        goal = f"{self._robot.path} and the servos" if self._is_to_servos else self._robot.path
        self.say(f"press y to write this to {goal}, n to leave all as it is")

    def _take_push(self, hands_on: HandsOn, joint: Joint, *, is_pushed: bool) -> None:
        frame = frame_of(
            joint,
            servo_deg=self._servo_deg[joint.name],
            pose_deg=self._pose.get(joint.name, 0.0),
            pushed_deg=_servo_deg(hands_on, joint) if is_pushed else None,
        )
        if frame is None:
            self.say(f"{joint.name} has moved less than {MOVED_MIN_DEG:g} deg")
            return
        self._frames[joint.name] = frame
        self._ask_for_push(hands_on)

    def _write(self, hands_on: HandsOn) -> None:
        from lss_motion.robot.write import write_frames

        assert self._robot.path is not None
        frames = dict(self._frames)
        origins: dict[str, int] = {}
        for name, frame in self._frames.items() if self._is_to_servos else ():
            origin, gyre = hands_on.answer_of(name, "QO"), hands_on.answer_of(name, "QG")
            if origin is None or gyre is None:
                self.say(f"{name} did not say its origin and gyre; its servo is left as it is")
                continue
            origins[name] = moved_origin(
                self._robot.joints[name],
                origin_wire=origin,
                gyre=gyre,
                zero_deg=frame.zero_deg,
            )
            frames[name] = Frame(zero_deg=0.0, direction=frame.direction)
        try:
            write_frames(
                self._robot.path, {n: (f.zero_deg, f.direction) for n, f in frames.items()}
            )
        except InputError as error:
            self.error = error
            hands_on.stop()
            return
        for name, origin in origins.items():  # Limp: what a held servo does with it, nobody knows.
            hands_on.set(name, "O", origin)
            hands_on.set(name, "CO", origin)
            self.say(f"{name}: origin of the servo set to {origin} (wire unit) and stored")
        self.say(f"{self._robot.path}: written; hold the robot until it is held by its servos")
        self._is_written = True


def _servo_deg(hands_on: HandsOn, joint: Joint) -> float:
    return joint.servo_deg(hands_on.readings[joint.name].deg)
