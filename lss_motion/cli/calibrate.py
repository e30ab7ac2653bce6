"""The command `calibrate`: find zero and direction of each joint by hand.

Its steps: all joints go limp, a person brings the robot to a known pose, pushes each joint once,
and agrees to the result.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.hands import HandsControls, add_hands_arguments, joint_lines, load, run_command
from lss_motion.errors import InputError
from lss_motion.playing.player.events import Phase

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.settings import Frame
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.robot.model import Joint, Robot


DESCRIPTION: Final = """\
Find the zero and the direction of each joint by hand, and write them into the robot file.

  lss-motion calibrate my_robot.yaml
  lss-motion calibrate my_robot.yaml --joints elbow wrist --at rest

The joints go limp: hold the robot. Bring it to its zero pose, or to the pose that --at names. Then
push each joint towards its larger angles when its line appears. The result is shown first. If you
agree, it is written as zero_deg and direction; where the servo has another gyre or origin than the
file states, those are written as well (`stored`). Nothing else in the robot file changes. With
--to-servos the origin offset of each servo is set and stored as well, so that the servo itself
reports 0 at the zero pose.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    calibrate = add_command(
        commands,
        "calibrate",
        _calibrate,
        DESCRIPTION,
    )
    add_hands_arguments(calibrate)
    calibrate.add_argument(
        "--at", metavar="POSE", help="bring the robot to this pose of its file, not to zero"
    )
    calibrate.add_argument(
        "--to-servos", action="store_true", help="also set and store the origin in the servos"
    )


def _calibrate(arguments: argparse.Namespace) -> int:
    from lss_motion.files.texts import known_names
    from lss_motion.playing.hands_on import HandsOn

    robot, joints = load(arguments)
    if arguments.at is not None and arguments.at not in robot.poses:
        known = known_names(arguments.at, robot.poses)
        raise InputError(f"unknown pose {arguments.at!r}; {known}", path=robot.path)
    pose = robot.poses.get(arguments.at, {})
    hands_on = HandsOn(robot, joints, needs_frame=False)
    return run_command(
        arguments, hands_on, CalibrateControls(robot, pose, is_to_servos=arguments.to_servos)
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
        if hands_on.phase is not Phase.SHOW:
            return []
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
        from lss_motion.maintenance.settings import Frame, moved_origin, stated_frame
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
            frames[name] = Frame(zero_deg=0.0, direction=frame.direction)
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
