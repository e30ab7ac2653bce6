"""The commands with limp joints or keys: `record` a motion, `jog` to poses, `calibrate` zeros."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import TOLERANCE_MAX_DEG, add_command, robot_at
from lss_motion.cli.hands import (
    HandsControls,
    StepControls,
    add_hands_arguments,
    chosen_joints,
    joint_lines,
    load,
    perform,
    run_command,
)
from lss_motion.cli.messages import ended_by, say
from lss_motion.cli.options import add_options, number_from
from lss_motion.errors import EXIT_FINISHED, BusError, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs
from lss_motion.files.texts import counted
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.settings import JointFrame
    from lss_motion.maintenance.take import Take
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.robot.model import Joint, Robot

SECONDS_MAX: Final = 3600.0

DESCRIPTION: Final = """\
Record a motion that you show by hand, and write it as a sequence file for lss-play.

  lss-motion record --robot my_robot.yaml -o wave.yaml
  lss-motion record --robot my_robot.yaml -o wave.yaml --seconds 10      without keys

Keys: l makes the joints limp, or holds them again; r starts and stops a recording; p keeps the
angles of the joints as a pose; u removes the last pose or recording; q writes the file and ends.
A limp arm falls: hold it before you press l. With --feel soft the joints hold softly instead, and
stay where you push them. However it ends (also with Ctrl-C), the servos hold their angles and get
their settings back, and everything recorded so far is written.
Recordings keep their times. Between poses the robot moves at its approach_speed_deg_s.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_calibrate(commands)
    _add_jog(commands)
    record = add_command(commands, "record", _record, DESCRIPTION)
    add_options(record, "--robot", required=True, help="the robot file")
    add_options(record, "--output", required=True, metavar="S.yaml", help="the sequence to write")
    add_options(record, "--port")
    record.add_argument(
        "--joints",
        nargs="+",
        metavar="NAME",
        help="only these joints or groups; the others get no commands (default all)",
    )
    record.add_argument(
        "--feel", choices=("limp", "soft"), default="limp", help="limp (default), or hold softly"
    )
    record.add_argument(
        "--seconds",
        type=number_from(0.0, SECONDS_MAX, "seconds", is_above=True),
        metavar="N",
        help="no keys: make the joints limp at once and record for N seconds",
    )
    record.add_argument(
        "--tolerance-deg",
        type=number_from(0.0, TOLERANCE_MAX_DEG, "degrees"),
        default=1.0,
        metavar="DEG",
        help="largest deviation of the sequence from the recording (default 1)",
    )
    add_options(record, "--force", "--hand")
    add_options(record, "--virtual", help="simulate in virtual time; needs --seconds")


def _record(arguments: argparse.Namespace) -> int:
    from lss_motion.maintenance.take import Take
    from lss_motion.playing.connection import ask_limits, is_simulated
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.sim.hand import hand_of

    robot = ask_limits(robot_at(arguments.robot, arguments.port))
    joints = chosen_joints(robot, arguments.joints)
    _check(arguments, simulated=is_simulated(robot))
    hands_on = HandsOn(robot, joints, is_soft=arguments.feel == "soft")
    take = Take(tuple(joint.name for joint in hands_on.joints))
    lost: BusError | None = None
    with RecordControls(take, seconds=arguments.seconds) as controls:
        try:
            perform(
                hands_on,
                controls,
                is_virtual=arguments.virtual,
                hand=None if arguments.hand is None else hand_of(arguments.hand, robot.servo_robot),
            )
        except BusError as error:
            lost = error
        take.add(hands_on.take())
        take.finish()
    if hands_on.error is not None:
        raise hands_on.error
    _write(arguments, take, robot)
    if lost is not None:
        raise lost
    if controls.signal_number is not None:
        return ended_by(controls.signal_number)
    return EXIT_FINISHED


def _check(arguments: argparse.Namespace, *, simulated: bool) -> None:
    output = Output(arguments.output, OutputKind.YAML)
    require_outputs([output], sources=[arguments.robot], is_forced=arguments.force)
    if not simulated and (arguments.virtual or arguments.hand is not None):
        raise InputError("--virtual and --hand need the simulated bus: use --port sim://")
    if arguments.virtual and arguments.seconds is None:
        raise InputError("--virtual needs --seconds: there are no keys in virtual time")


def _write(arguments: argparse.Namespace, take: Take, robot: Robot) -> None:
    from lss_motion.maintenance.take import sequence_of
    from lss_motion.planning.summaries import fit_text, plan_lines
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.write import write_sequence

    if not take.parts:
        say("nothing was recorded, so no file was written")
        return
    shown = sequence_of(take, robot, arguments.output.stem, tolerance_deg=arguments.tolerance_deg)
    comments = [*shown.comments, *map(fit_text, shown.fits)]
    write_sequence(shown.sequence, arguments.output, comments=comments)
    say(f"{arguments.output}: {counted(shown.sequence.keyframes, 'keyframe')}")
    say("\n".join([*comments, *plan_lines(plan(shown.sequence, robot), robot)]))


KEYS: Final = "l limp/hold  r record  p pose  u undo  q write and end"
RATE_NS: Final = NS_PER_S
"""The shown rate of readings is counted over this time."""


class RecordControls(HandsControls):
    """Fills `take` from the readings. With `seconds`, makes the joints limp and records at once."""

    def __init__(self, take: Take, *, seconds: float | None = None) -> None:
        super().__init__()
        self._take_shown = take
        self._seconds = seconds
        self._end_ns: int | None = None
        self._count = 0
        self._rate_hz = 0.0
        self._counted_ns = 0

    def begin(self, hands_on: HandsOn) -> None:
        if blind := blind_joints(hands_on):
            self.print(
                f"{', '.join(blind)}: RC servos do not say where they are; they hold, and are "
                f"recorded where they were sent"
            )
        if self._seconds is not None:
            hands_on.let_go(self._led_by_hand(hands_on))
            self._take_shown.start(self.now_ns)
            self._end_ns = self.now_ns + ns_from_s(self._seconds)
        elif not self.has_keys:
            self.print("there is no terminal for keys: give --seconds")
            hands_on.stop()
        else:
            self.print(f"hold the robot, then press l to make it limp. {KEYS}")

    def turn(self, hands_on: HandsOn) -> None:
        fresh = hands_on.take()
        self._take_shown.add(fresh)
        self._count += len(fresh)
        if self.now_ns - self._counted_ns >= RATE_NS:
            self._rate_hz = self._count * NS_PER_S / (self.now_ns - self._counted_ns)
            self._count, self._counted_ns = 0, self.now_ns
        if self._end_ns is not None and self.now_ns >= self._end_ns:
            self._end_ns = None
            self._take_shown.finish()
            hands_on.stop()

    def press(self, key: str, hands_on: HandsOn) -> None:
        take, names = self._take_shown, [joint.name for joint in hands_on.joints]
        match key:
            case "l":
                if hands_on.limp:
                    hands_on.hold(names)
                    self.print("holding")
                else:
                    hands_on.let_go(self._led_by_hand(hands_on))
                    self.print("let go: the joints are limp")
            case "r" if take.running is None:
                take.start(self.now_ns)
                self.print("recording")
            case "r":
                take.finish()
                self.print(f"recorded, {take.recorded_s:.1f} s in all")
            case "p" if take.running is not None:
                self.print("recording; press r to end it first")
            case "p":
                take.drop({name: hands_on.readings[name].deg for name in names})
                self.print(f"pose {len(take.parts)}")
            case "u":
                self.print("removed the last part" if take.undo() else "there is nothing to remove")
            case _:
                pass

    def _led_by_hand(self, hands_on: HandsOn) -> list[str]:
        """Return the joints that a hand can lead: an RC servo would be lost while it is limp."""
        blind = blind_joints(hands_on)
        return [joint.name for joint in hands_on.joints if joint.name not in blind]

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        take = self._take_shown
        state = "RECORDING" if take.running is not None else f"{counted(take.parts, 'part')}"
        per_joint_hz = self._rate_hz / len(hands_on.joints)
        head = f"{state}  {take.recorded_s:.1f} s  {per_joint_hz:.0f} readings/s a joint   {KEYS}"
        return [head, *joint_lines(hands_on, now_ns)]


def blind_joints(hands_on: HandsOn) -> list[str]:
    """Return the joints whose servos do not say where they are."""
    from lss_motion.playing.hands_poller import has_reading

    blind = {servo.name for servo in hands_on.servos if not has_reading(servo)}
    return [j.name for j in hands_on.joints if blind & {*hands_on.view.servos_of(j.name)}]


JOG_TEXT: Final = """\
Move joints with keys, within their ranges and not faster than the robot's approach_speed_deg_s.

  lss-motion jog my_robot.yaml

Keys: up and down choose a joint; left and right move it by a step; [ and ] make the step smaller
and larger; l makes the joint limp (hold it, it falls); h holds it; c asks for a name and writes the
angles of all joints as a pose into the robot file; q ends. Nothing else in the robot file changes.
"""


def _add_jog(commands: Commands) -> None:
    jog = add_command(commands, "jog", _jog, JOG_TEXT)
    add_hands_arguments(jog)
    jog.add_argument(
        "--pose",
        metavar="NAME",
        help="the key c asks for no name: the poses are NAME, NAME_2, ...",
    )


def _jog(arguments: argparse.Namespace) -> int:
    from lss_motion.playing.hands_on import HandsOn

    robot, joints = load(arguments)
    robot.require_turns(HandsOn(robot, joints).servos)
    if arguments.pose is not None and not _is_name(arguments.pose):
        raise InputError(f"--pose {arguments.pose!r}: a name has letters, digits, - and _ only")
    return run_command(arguments, HandsOn(robot, joints), JogControls(robot, arguments.pose))


def _is_name(name: str) -> bool:
    return re.fullmatch(r"[A-Za-z0-9_-]+", name) is not None


JOG_KEYS: Final = "arrows choose and move  [ ] step  l limp  h hold  c keep pose  q end"

STEPS_DEG: Final = (0.1, 0.5, 1.0, 5.0, 15.0)

LEAD_S: Final = 0.5
"""While a key is held down, the target leads the joint by at most the angle that the joint turns in
this time, so that it stops soon after the key is released. Chosen."""

NAME_MAX_CHARS: Final = 40
"""Chosen: a longer name of a pose is a mistake."""

HELD_NS: Final = NS_PER_S // 2
"""A key that comes again so soon is held down. Chosen: keyboards repeat some 30 times a second."""


class JogControls(StepControls):
    """Moves one joint at a time. Writes each pose into the robot file at once."""

    greeting = JOG_KEYS

    def __init__(self, robot: Robot, pose_name: str | None = None) -> None:
        """Without `pose_name` a person gives each pose a name."""
        super().__init__(STEPS_DEG, 2)
        self._robot = robot
        self._pose_name = pose_name
        self._poses = set(robot.poses)
        self._chosen = 0
        self._target_deg: dict[str, float] = {}
        self._pose: dict[str, float] = {}
        self._c_ns = -HELD_NS

    def press(self, key: str, hands_on: HandsOn) -> None:
        if self._typed is not None:
            self._type(key)
            return
        joint = hands_on.joints[self._chosen]
        match key:
            case "\x1b[A" | "k":
                self._chosen = (self._chosen - 1) % len(hands_on.joints)
            case "\x1b[B" | "j":
                self._chosen = (self._chosen + 1) % len(hands_on.joints)
            case "\x1b[C" | "+" | "=":
                self._move(hands_on, joint.name, self.step_deg)
            case "\x1b[D" | "-":
                self._move(hands_on, joint.name, -self.step_deg)
            case "[" | "]":
                self.change_step(key)
            case "l":
                hands_on.let_go([joint.name])
                self._target_deg.pop(joint.name, None)
            case "h":
                hands_on.hold([joint.name])
                self._target_deg.pop(joint.name, None)
            case "c" if not self._is_c_held():
                self._take_pose(hands_on)
            case _:
                pass

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        chosen = hands_on.joints[self._chosen].name
        head = f"step {self.step_deg:g} deg   {JOG_KEYS}"
        if self._typed is not None:
            head = f"name: {self._typed}_"
        return [head, *joint_lines(hands_on, now_ns, chosen)]

    def _move(self, hands_on: HandsOn, name: str, step_deg: float) -> None:
        joint, here_deg = self._robot.joints[name], hands_on.readings[name].deg
        speed_deg_s = self._robot.approach_deg_s(joint)
        lead_deg = max(abs(step_deg), LEAD_S * speed_deg_s)
        desired_deg = self._target_deg.get(name, here_deg) + step_deg
        desired_deg = min(max(desired_deg, here_deg - lead_deg), here_deg + lead_deg)
        desired_deg = round(desired_deg, 2)
        target_deg = hands_on.move(name, desired_deg, abs(desired_deg - here_deg) / speed_deg_s)
        self._target_deg[name] = target_deg
        if target_deg != desired_deg:
            low, high = joint.position_min_deg, joint.position_max_deg
            text = f"{name} ends at {target_deg:zg} deg; its range is {low:g} to {high:g}"
            self.print(text, beeps=True)

    def _take_pose(self, hands_on: HandsOn) -> None:
        """Take the present angles; write them, or ask for the name of the pose first."""
        for joint in hands_on.joints:
            deg = round(hands_on.readings[joint.name].deg, 1)
            self._pose[joint.name] = joint.within_deg(deg) + 0.0
        if self._pose_name is not None:
            self._keep(self._free_name(self._pose_name))
            return
        self._typed = ""
        self.print(f"name of this pose? Enter alone: {self._free_name('pose')}, Escape: none")

    def _type(self, key: str) -> None:
        """Apply a key to the name of a pose."""
        typed = self._typed or ""
        if key in "\r\n":
            self._typed = None
            self._keep(typed or self._free_name("pose"))
        elif key == "\x1b":
            self._typed = None
            self.print("no pose was written")
        elif key in "\x7f\b":
            self._typed = typed[:-1]
        elif _is_name(key) and not (key == "c" and not typed and self._is_c_held()):
            self._typed = (typed + key)[:NAME_MAX_CHARS]

    def _is_c_held(self) -> bool:
        """Return whether the key c, which asked for the name, is still held down."""
        is_held = self.now_ns - self._c_ns < HELD_NS
        self._c_ns = self.now_ns
        return is_held

    def _free_name(self, name: str) -> str:
        """Return `name`, or else `name_2` and so on, that no pose has yet."""
        names = (name, *(f"{name}_{number}" for number in range(2, len(self._poses) + 3)))
        return next(free for free in names if free not in self._poses)

    def _keep(self, name: str) -> None:
        """Write the angles that were taken into the robot file, as a new pose."""
        from lss_motion.robot.write import write_pose

        assert self._robot.path is not None
        if name in self._poses:
            self._typed = ""
            self.print(f"there is a pose {name}; another name?")
            return
        try:
            write_pose(self._robot.path, name, self._pose)
        except InputError as error:
            self.print(f"the pose was not written: {error}")
            return
        self._poses.add(name)
        angles = ", ".join(f"{joint} {angle:zg}" for joint, angle in self._pose.items())
        self.print(f"{self._robot.path}: pose {name}: {angles}")


CALIBRATE_TEXT: Final = """\
Find the zero and the direction of each joint by hand, and write them into the robot file.

  lss-motion calibrate my_robot.yaml
  lss-motion calibrate my_robot.yaml --joints elbow wrist --at rest

The joints go limp: hold the robot. Bring it to its zero pose, or to the pose that --at names. Then
push each joint towards its larger angles when its line appears. The result is shown first. If you
agree, it is written as zero_deg and direction; where the servo has another gyre or origin than the
file states, those are written as well (`stored`). Nothing else in the robot file changes. With
--to-servos the origin offset of each servo is set and stored as well, so that the servo itself
reports 0 at the zero pose.

With --linkage a push rod is measured: step its servo with the arrows, or let it go limp and move
it, and type the angle of the joint, read with a protractor or in a photo, at five or more places.
The table is shown with how smooth it is, and written as the `linkage` of the joint if you agree.

  lss-motion calibrate my_robot.yaml --linkage jaw
"""


def _add_calibrate(commands: Commands) -> None:
    calibrate = add_command(
        commands,
        "calibrate",
        _calibrate,
        CALIBRATE_TEXT,
    )
    add_hands_arguments(calibrate)
    calibrate.add_argument(
        "--at", metavar="POSE", help="bring the robot to this pose of its file, not to zero"
    )
    calibrate.add_argument(
        "--linkage",
        metavar="JOINT",
        help="measure what a push rod makes of its servo: step it, type the angle of the joint",
    )
    calibrate.add_argument(
        "--to-servos", action="store_true", help="also set and store the origin in the servos"
    )


def _calibrate(arguments: argparse.Namespace) -> int:
    from lss_motion.files.texts import known_names
    from lss_motion.playing.hands_on import HandsOn

    robot, joints = load(arguments)
    if arguments.linkage is not None:
        if arguments.at is not None or arguments.joints is not None or arguments.to_servos:
            raise InputError("--linkage measures one joint; it goes without the other options")
        return _measure_linkage(arguments, robot)
    if arguments.at is not None and arguments.at not in robot.poses:
        known = known_names(arguments.at, robot.poses)
        raise InputError(f"unknown pose {arguments.at!r}; {known}", path=robot.path)
    pose = robot.poses.get(arguments.at, {})
    hands_on = HandsOn(robot, joints, needs_frame=False)
    _require_own_readings(hands_on)
    return run_command(
        arguments, hands_on, CalibrateControls(robot, pose, is_to_servos=arguments.to_servos)
    )


def _measure_linkage(arguments: argparse.Namespace, robot: Robot) -> int:
    """Step the servo of a joint, whose angles a person types, and write the table."""
    from lss_motion.cli.linkage import LinkageControls
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.robot.mechanisms import require_measurable

    require_measurable(robot, arguments.linkage)
    servos = robot.servo_robot
    hands_on = HandsOn(servos, [arguments.linkage], needs_frame=False)
    servos.require_turns(hands_on.servos)
    return run_command(arguments, hands_on, LinkageControls(robot, arguments.linkage))


def _require_own_readings(hands_on: HandsOn) -> None:
    """Raise `InputError` for joints whose zero cannot be found by hand."""
    robot, others = hands_on.robot, "leave them out with --joints"
    if blind := blind_joints(hands_on):
        raise InputError(
            f"{', '.join(blind)}: RC servos of an LSS-2IO cannot say where they are; {others}, and "
            f"find their zero_deg with `lss-motion jog`",
            path=robot.path,
        )
    view = hands_on.view
    if geared := [j.name for j in hands_on.joints if view.mechanism_of(j.name) is not None]:
        raise InputError(
            f"{', '.join(geared)}: a ratio, a linkage or a mechanism stands between these joints "
            f"and their servos, whose zeros are no angles of joints; {others}, and measure them as "
            f"the guide head-neck.md says",
            path=robot.path,
        )


class CalibrateControls(HandsControls):
    """Leads a person through the steps. Nothing is written before the person agrees."""

    greeting = "hold the robot, then press l to make all joints limp; q ends"

    def __init__(self, robot: Robot, pose: Mapping[str, float], *, is_to_servos: bool) -> None:
        super().__init__()
        self._robot = robot
        self._pose = pose
        self._is_to_servos = is_to_servos
        self._servo_deg: dict[str, float] = {}
        self._frames: dict[str, JointFrame] = {}
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
                self.print(f"bring the robot to {where}, then press Enter")
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
            self.print("nothing was written")
            hands_on.stop()

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        joint = self._next(hands_on)
        is_pushing = joint is not None and bool(self._servo_deg)
        chosen = joint.name if joint is not None and is_pushing else ""
        return joint_lines(hands_on, now_ns, chosen)

    def _next(self, hands_on: HandsOn) -> Joint | None:
        """Return the next joint without a direction, or None."""
        return next((j for j in hands_on.joints if j.name not in self._frames), None)

    def _ask_for_push(self, hands_on: HandsOn) -> None:
        from lss_motion.maintenance.settings import MOVED_MIN_DEG

        joint = self._next(hands_on)
        if joint is not None:
            self.print(
                f"push {joint.name} by {MOVED_MIN_DEG:g} deg or more towards its larger angles "
                "and press Enter there; s keeps its direction"
            )
            return
        for name, frame in self._frames.items():
            old = self._robot.joints[name]
            self.print(
                f"{name}: zero_deg {old.zero_deg:zg} -> {frame.zero_deg:zg}, "
                f"direction {old.direction} -> {frame.direction}"
            )
        goal = f"{self._robot.path} and the servos" if self._is_to_servos else self._robot.path
        self.print(f"press y to write this to {goal}, n to change nothing")

    def _take_push(self, hands_on: HandsOn, joint: Joint, *, is_pushed: bool) -> None:
        from lss_motion.maintenance.settings import MOVED_MIN_DEG, frame_of

        frame = frame_of(
            joint,
            servo_deg=self._servo_deg[joint.name],
            pose_deg=self._pose.get(joint.name, 0.0),
            pushed_deg=_servo_deg(hands_on, joint) if is_pushed else None,
        )
        if frame is None:
            self.print(f"{joint.name} has moved less than {MOVED_MIN_DEG:g} deg")
            return
        self._frames[joint.name] = frame
        self._ask_for_push(hands_on)

    def _servo_frame(self, hands_on: HandsOn, name: str) -> dict[str, int]:
        """Return gyre and origin of a servo, as far as it reported them, in wire units."""
        answers = {key: hands_on.answer_of(name, f"Q{key}") for key in ("G", "O")}
        return {key: wire for key, wire in answers.items() if wire is not None}

    def _write(self, hands_on: HandsOn) -> None:
        from lss_motion.maintenance.settings import JointFrame, moved_origin, stated_frame
        from lss_motion.robot.write import write_frames

        assert self._robot.path is not None
        frames = dict(self._frames)
        origins: dict[str, int] = {}
        stored = {name: self._servo_frame(hands_on, name) for name in self._frames}
        for name, frame in self._frames.items() if self._is_to_servos else ():
            origin, gyre = hands_on.answer_of(name, "QO"), hands_on.answer_of(name, "QG")
            if origin is None or gyre is None:
                self.print(f"{name} did not report its origin and gyre; its servo is not changed")
                continue
            origins[name] = moved_origin(
                self._robot.joints[name],
                origin_wire=origin,
                gyre=gyre,
                zero_deg=frame.zero_deg,
            )
            frames[name] = JointFrame(zero_deg=0.0, direction=frame.direction)
            stored[name]["O"] = origins[name]
        try:
            write_frames(
                self._robot.path,
                {n: (f.zero_deg, f.direction) for n, f in frames.items()},
                {n: stated_frame(self._robot.joints[n], wires) for n, wires in stored.items()},
            )
        except InputError as error:
            self.error = error
            hands_on.stop()
            return
        # The joints are still limp: the effect of a new origin on a held servo is not documented.
        for name, origin in origins.items():
            hands_on.set(name, "O", origin)
            hands_on.set(name, "CO", origin)
            self.print(f"{name}: origin of the servo set to {origin} (wire unit) and stored")
        self.print(f"{self._robot.path}: written; hold the robot until its servos hold it")
        self._is_written = True


def _servo_deg(hands_on: HandsOn, joint: Joint) -> float:
    return joint.servo_deg(hands_on.readings[joint.name].deg)
