"""The keys of `lss-motion jog`, and what is seen meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.hands import HandsControls
from lss_motion.cli.joint_screen import joint_lines
from lss_motion.errors import InputError
from lss_motion.player.events import Phase

if TYPE_CHECKING:
    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.robot.model import Robot

KEYS: Final = "arrows choose and move  [ ] step  l limp  h hold  c keep pose  q end"
STEPS_DEG: Final = (0.1, 0.5, 1.0, 5.0, 15.0)
LEAD_S: Final = 0.5
"""A key that is held down sends a joint no further ahead than it turns in so long: it stops soon
after the key is released. Chosen."""


class JogControls(HandsControls):
    """Moves one joint at a time; poses go into the robot file at once."""

    greeting = KEYS

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
        head = f"step {STEPS_DEG[self._step]:g} deg   {KEYS}"
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
