"""`calibrate --linkage`: measure what a push rod makes of its servo, point by point."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.hands import StepControls, joint_lines
from lss_motion.errors import InputError

if TYPE_CHECKING:
    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.robot.model import Robot

KEYS: Final = "left right step  [ ] size  l limp  h hold  Enter angle  u undo  w end  q quit"
STEPS_DEG: Final = (0.5, 1.0, 2.0, 5.0, 10.0)
ANGLE_MAX_CHARS: Final = 8


class LinkageControls(StepControls):
    """Steps one servo; a person types the angle of the joint at each place."""

    greeting = KEYS

    def __init__(self, robot: Robot, name: str) -> None:
        """Measure the linkage of joint `name`, whose servo `HandsOn` moves in servo degrees."""
        super().__init__(STEPS_DEG, 3)
        self._robot, self._name = robot, name
        self._servo = robot.servo_robot.joints[name]
        self._here_deg = 0.0
        self._target_deg: float | None = None
        self._points: list[tuple[float, float]] = []
        self._is_asking = False

    def press(self, key: str, hands_on: HandsOn) -> None:
        if self._typed is not None:
            self._type(key)
        elif self._is_asking:
            self._answer(key, hands_on)
        else:
            self._act(key, hands_on)

    def lines(self, hands_on: HandsOn, now_ns: int) -> list[str]:
        head = f"{len(self._points)} measured   step {self.step_deg:g} deg   {KEYS}"
        if self._typed is not None:
            head = f"angle of {self._name} here, in degrees: {self._typed}_"
        return [head, *joint_lines(hands_on, now_ns, self._name)]

    def _act(self, key: str, hands_on: HandsOn) -> None:
        match key:
            case "\x1b[C" | "+" | "=":
                self._move(hands_on, self.step_deg)
            case "\x1b[D" | "-":
                self._move(hands_on, -self.step_deg)
            case "[" | "]":
                self.change_step(key)
            case "l" | "h":
                (hands_on.let_go if key == "l" else hands_on.hold)([self._name])
                self._target_deg = None
            case "\r" | "\n":
                self._here_deg, self._typed = hands_on.readings[self._name].deg, ""
                self.print(f"what is the angle of {self._name} here? Enter: keep, Escape: none")
            case "u" if self._points:
                joint_deg, servo_deg = self._points.pop()
                self.print(f"forgot {joint_deg:zg} at servo {servo_deg:z.1f} deg")
            case "w":
                self._show()
            case _:
                pass

    def _move(self, hands_on: HandsOn, step_deg: float) -> None:
        here_deg = hands_on.readings[self._name].deg
        from_deg = here_deg if self._target_deg is None else self._target_deg
        speed_deg_s = self._robot.approach_deg_s(self._servo)
        wanted_deg = round(from_deg + step_deg, 2)
        lasts_s = abs(wanted_deg - here_deg) / speed_deg_s
        self._target_deg = hands_on.move(self._name, wanted_deg, lasts_s)
        if self._target_deg != wanted_deg:
            low, high = self._servo.position_min_deg, self._servo.position_max_deg
            text = f"the servo ends at {self._target_deg:zg} deg; its range is {low:g} to {high:g}"
            self.print(text, beeps=True)

    def _type(self, key: str) -> None:
        """Apply a key to the angle of the joint."""
        typed = self._typed or ""
        if key == "\x1b":
            self._typed = None
        elif key in "\x7f\b":
            self._typed = typed[:-1]
        elif key in "0123456789.-":
            self._typed = (typed + key)[:ANGLE_MAX_CHARS]
        elif key in "\r\n":
            try:
                joint_deg = float(typed)
            except ValueError:
                self.print(f"{typed!r} is no angle in degrees")
                self._typed = ""
                return
            self._typed = None
            if any(known == joint_deg for known, _ in self._points):
                self.print(f"{joint_deg:zg} deg was measured already; u removes the last")
                return
            self._points.append((joint_deg, round(self._here_deg, 2)))
            self.print(f"{self._name} {joint_deg:zg} deg at servo {self._here_deg:z.1f} deg")

    def _show(self) -> None:
        """Print the table, how smooth it is, and what is wrong with it; ask to write it."""
        from lss_motion.robot.mechanisms import table_report

        self._points.sort()
        report = table_report(self._name, self._points, self._robot)
        for line in report.lines:
            self.print(line)
        for problem in report.problems:
            self.print(f"not yet: {problem}", beeps=True)
        if not report.problems:
            self._is_asking = True
            self.print(f"press y to write this to {self._robot.path}, n to measure more")

    def _answer(self, key: str, hands_on: HandsOn) -> None:
        from lss_motion.robot.write import write_linkage

        if key == "n":
            self._is_asking = False
            self.print(self.greeting)
        elif key == "y":
            assert self._robot.path is not None
            try:
                lines = write_linkage(self._robot.path, self._name, self._points)
            except InputError as error:
                self.error = error
            else:
                for line in lines:
                    self.print(line)
            hands_on.stop()
