"""Runs in which a person moves limp joints: arguments, keys and screen of these commands.

`record`, `jog` and `calibrate` each derive their controls from `HandsControls`.
"""

from __future__ import annotations

import re
import sys
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import robot_at
from lss_motion.cli.messages import ended_by, put
from lss_motion.cli.options import add_options, add_robot
from lss_motion.cli.terminal import STOP_KEYS, Inputs
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.playing.player.events import Faulted, Phase, Warned
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from lss_motion.playing.hands_on import HandsOn
    from lss_motion.playing.player.events import Event
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sim.hand import HandMotion


def add_hands_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments that `load` and `run_command` read."""
    add_robot(command, is_required=True)
    add_options(command, "--port")
    command.add_argument(
        "--joints", nargs="+", metavar="NAME", help="only these joints or groups (default all)"
    )
    add_options(command, "--hand")


def load(arguments: argparse.Namespace) -> tuple[Robot, list[str]]:
    """Return the robot, with the limits that its servos report, and the chosen joints."""
    from lss_motion.playing.connection import ask_limits, is_simulated

    robot = ask_limits(robot_at(arguments.robot, arguments.port))
    if arguments.hand is not None and not is_simulated(robot):
        raise InputError("--hand needs the simulated bus: use it with --port sim://")
    return robot, chosen_joints(robot, arguments.joints)


def run_command(arguments: argparse.Namespace, hands_on: HandsOn, controls: HandsControls) -> int:
    """Run until the person ends it; return the exit code, or raise the error that ended it."""
    from lss_motion.sim.hand import hand_of

    hand = None if arguments.hand is None else hand_of(arguments.hand, hands_on.robot.servo_robot)
    with controls:
        if not controls.has_keys:
            raise InputError("needs a terminal, because keys control it")
        perform(hands_on, controls, hand=hand)
    for error in (hands_on.error, controls.error):
        if error is not None:
            raise error
    if controls.signal_number is not None:
        return ended_by(controls.signal_number)
    return EXIT_FINISHED


FRAME_NS: Final = NS_PER_S // 8

BAR_CHARS: Final = 31

NEAR_DEG: Final = 1.0
"""A joint this near to an end of its range is marked as at the limit."""


class HandsScreen:
    """Draws on standard error if that is a terminal; prints lines on standard output."""

    def __init__(self) -> None:
        self._is_live = sys.stderr.isatty()
        self._next_ns = 0
        self._drawn_count = 0

    def print(self, text: str, *, beeps: bool = False) -> None:
        """Print a line that stays, above the drawn lines."""
        self._clear()
        put(text, control="\a" if beeps else "")

    def show(self, lines: Sequence[str], now_ns: int) -> None:
        """Replace the drawn lines, if a new frame is due."""
        if not self._is_live or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + FRAME_NS
        self._clear()
        put("\n".join(lines), sys.stderr)
        self._drawn_count = len(lines)

    def _clear(self) -> None:
        if self._drawn_count:
            put("", sys.stderr, end="", control=f"\x1b[{self._drawn_count}A\x1b[J")
        self._drawn_count = 0


def joint_lines(hands_on: HandsOn, now_ns: int, chosen: str = "") -> list[str]:
    """Return a line per joint: angle, place in its range, limp or not, age of an old reading."""
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
        lines.append(f"{mark} {joint.name:{width}} {reading.deg:z8.1f} {place} {state}{late}")
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


KEYS: Final = re.compile(r"\x1b\[[A-D]|[\s\S]")
"""A key as a terminal sends it: an arrow or a character."""


class HandsControls(Inputs, ABC):
    """Keys, signals and screen of a run; a command overrides `begin`, `turn`, `press`, `lines`."""

    greeting = ""
    """The first instruction to the person."""

    def __init__(self) -> None:
        super().__init__()
        self._screen = HandsScreen()
        self._has_begun = False
        self.now_ns = 0
        self.error: InputError | None = None
        """The error that ended the run early, or None."""

    def act(self, driven: HandsOn, now_ns: int) -> None:
        """Apply the keys and signals since the last call."""
        self.now_ns = now_ns
        signals_count, typed = self.take()
        keys = KEYS.findall(typed)
        stops_count = signals_count
        if not self.takes_text:
            stops_count += sum(key in STOP_KEYS for key in keys)
        for _ in range(stops_count):
            driven.stop()
        if driven.phase is Phase.SHOW and not self._has_begun:
            self._has_begun = True
            self.begin(driven)
        if driven.phase is Phase.SHOW:
            self.turn(driven)
        for key in keys if stops_count == 0 else ():
            if driven.phase is Phase.SHOW:
                self.press(key, driven)

    def begin(self, hands_on: HandsOn) -> None:  # noqa: ARG002  (overridden)
        """Print the first instruction; called once, when every servo has replied."""
        self.print(self.greeting)

    def turn(self, hands_on: HandsOn) -> None:
        """Do the regular work; called in every turn of the run loop."""

    def press(self, key: str, hands_on: HandsOn) -> None:
        """Apply a key."""

    @property
    def takes_text(self) -> bool:
        """Whether a person types a name: then no letter stops; Ctrl-C does."""
        return False

    @abstractmethod
    def lines(self, hands_on: HandsOn, now_ns: int) -> Sequence[str]:
        """Return the lines to draw, while the robot may be moved."""

    def print(self, text: str, *, beeps: bool = False) -> None:
        """Print a line that stays on the screen."""
        self._screen.print(text, beeps=beeps)

    def print_event(self, event: Event) -> None:
        """Print a warning or a fault; other events are not shown."""
        match event:
            case Warned(text):
                self.print(f"warning: {text}")
            case Faulted(joint, cause):
                self.print(f"warning: joint {joint!r} {cause}")
            case _:
                pass

    def show(self, driven: HandsOn, now_ns: int) -> None:
        if driven.phase is Phase.SHOW and (lines := self.lines(driven, now_ns)):
            self._screen.show(lines, now_ns)


class StepControls(HandsControls):
    """Keys that step a joint by one of some sizes, and a text that a person types in between."""

    def __init__(self, steps_deg: Sequence[float], first: int) -> None:
        """Begin with the size at the place `first` of `steps_deg`."""
        super().__init__()
        self._steps_deg, self._step = steps_deg, first
        self._typed: str | None = None
        """The text as far as it is typed; None: none is asked for."""

    def turn(self, hands_on: HandsOn) -> None:
        hands_on.take()

    @property
    def takes_text(self) -> bool:
        return self._typed is not None

    @property
    def step_deg(self) -> float:
        """The size that is chosen."""
        return self._steps_deg[self._step]

    def change_step(self, key: str) -> None:
        """Choose the next larger size with `]`, the next smaller one with any other key."""
        self._step += 1 if key == "]" else -1
        self._step = min(max(self._step, 0), len(self._steps_deg) - 1)


def perform(
    hands_on: HandsOn,
    controls: HandsControls,
    *,
    is_virtual: bool = False,
    hand: HandMotion | None = None,
) -> None:
    """Run until the person ends it; raise `BusError` if a port cannot be opened or is lost."""
    from lss_motion.playing.connection import connect, is_simulated
    from lss_motion.playing.runner import run
    from lss_motion.system.clock import MonotonicClock, VirtualClock

    clock = VirtualClock() if is_virtual else MonotonicClock()
    robot = hands_on.robot
    if is_simulated(robot):
        controls.print(f"no hardware, the robot {robot.name!r} is simulated")
    with connect(robot.buses, robot=robot, clock=clock, hand=hand) as connection:
        run(
            hands_on,
            connection.ports,
            clock,
            on_event=controls.print_event,
            on_turn=controls.show,
            controls=controls,
        )


def chosen_joints(robot: Robot, names: Iterable[str] | None) -> list[str]:
    """Return the joints of these names of joints and groups, in the order of the robot."""
    if names is None:
        return list(robot.joints)
    chosen: set[str] = set()
    for name in names:
        if name not in robot.joints and name not in robot.groups:
            from lss_motion.files.texts import known_names

            known = known_names(name, [*robot.joints, *robot.groups])
            raise InputError(f"unknown joint or group {name!r}; {known}", path=robot.path)
        chosen.update(robot.groups.get(name, (name,)))
    return [name for name in robot.joints if name in chosen]
