"""The steps of `lss-motion calibrate`: let go, zero pose, a push of each joint, agree."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.cli.hands import HandsControls
from lss_motion.cli.joint_screen import joint_lines
from lss_motion.errors import InputError
from lss_motion.maintenance.calibration import MOVED_MIN_DEG, Frame, frame_of, moved_origin
from lss_motion.player.events import Phase

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.robot.model import Joint, Robot


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
            origin, gyre = hands_on.answered(name, "QO"), hands_on.answered(name, "QG")
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
