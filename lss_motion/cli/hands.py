"""What `record`, `jog` and `calibrate` share: the run, its keys, and what is seen."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, Final

from lss_motion.cli.controls import Inputs
from lss_motion.cli.joint_screen import Screen
from lss_motion.errors import InputError
from lss_motion.player.events import Faulted, Phase, Warned
from lss_motion.spelling import known_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.player.events import Event
    from lss_motion.robot.model import Robot
    from lss_motion.sim.hand import Hand


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
