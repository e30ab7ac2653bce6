"""The command `jog`: keys move joints and write poses into the robot file."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.hands import HandsControls, add_hands_arguments, joint_lines, load, run_command
from lss_motion.errors import InputError
from lss_motion.playing.player.events import Phase
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.robot.model import Robot


DESCRIPTION: Final = """\
Move joints with keys, within their ranges and not faster than the robot's approach_speed_deg_s.

  lss-motion jog my_robot.yaml

Keys: up and down choose a joint; left and right move it by a step; [ and ] make the step smaller
and larger; l makes the joint limp (hold it, it falls); h holds it; c asks for a name and writes the
angles of all joints as a pose into the robot file; q ends. Nothing else in the robot file changes.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    jog = add_command(commands, "jog", _jog, DESCRIPTION)
    add_hands_arguments(jog)
    jog.add_argument(
        "--pose",
        metavar="NAME",
        help="the key c asks for no name: the poses are NAME, NAME_2, ...",
    )


def _jog(arguments: argparse.Namespace) -> int:
    from lss_motion.playing.hands_on import HandsOn

    robot, joints = load(arguments)
    robot.require_turns(robot.joints[name] for name in joints)
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


class JogControls(HandsControls):
    """Moves one joint at a time. Writes each pose into the robot file at once."""

    greeting = JOG_KEYS

    def __init__(self, robot: Robot, pose_name: str | None = None) -> None:
        """Without `pose_name` a person gives each pose a name."""
        super().__init__()
        self._robot = robot
        self._pose_name = pose_name
        self._poses = set(robot.poses)
        self._typed: str | None = None
        """The name as far as it is typed; None: no name is asked for."""
        self._chosen = 0
        self._step = 2
        self._target_deg: dict[str, float] = {}
        self._pose: dict[str, float] = {}
        self._c_ns = -HELD_NS

    def turn(self, hands_on: HandsOn) -> None:
        hands_on.take()

    @property
    def takes_text(self) -> bool:
        return self._typed is not None

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
            case "c" if not self._is_c_held():
                self._take_pose(hands_on)
            case _:
                pass

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        if hands_on.phase is not Phase.SHOW:
            return []
        chosen = hands_on.joints[self._chosen].name
        head = f"step {STEPS_DEG[self._step]:g} deg   {JOG_KEYS}"
        if self._typed is not None:
            head = f"name: {self._typed}_"
        return [head, *joint_lines(hands_on, now_ns, chosen)]

    def _move(self, hands_on: HandsOn, name: str, step_deg: float) -> None:
        joint, here_deg = self._robot.joints[name], hands_on.readings[name].deg
        speed_deg_s = min(self._robot.approach_speed_deg_s, joint.speed_max_deg_s)
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
            deg = min(max(deg, joint.position_min_deg), joint.position_max_deg)
            self._pose[joint.name] = deg + 0.0
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
