"""What a person sees and is asked before a real robot moves."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Final

from lss_motion.cli.messages import put
from lss_motion.connection import is_simulated
from lss_motion.errors import InputError
from lss_motion.player.events import Phase

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from lss_motion.cli.controls import Inputs
    from lss_motion.player.events import Found
    from lss_motion.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.runtime.runner import Controls

YES_HELP: Final = "move a real robot without asking first; it is checked all the same"
YES_KEYS: Final = "yY"
NO_KEYS: Final = "nNqQ\r\n\x1b\x03\x04"
"""Enter alone is no, as the question says."""
LEFT: Final = (0, 2, 4)
"""The columns of words."""


def must_ask(arguments: argparse.Namespace, robot: Robot) -> bool:
    """Return whether a person is to be asked: before anything real moves, unless `--yes` is given.

    A pseudo-terminal counts as real: nobody knows what is behind it. Raises `InputError` where
    nobody could answer.
    """
    from lss_motion.cli.controls import is_at_keyboard

    if arguments.yes or is_simulated(robot):
        return False
    if not is_at_keyboard():
        raise InputError(
            "a real robot would move, and nobody is there to be asked: nothing was sent. Run it in "
            "a terminal, or add --yes to go without being asked"
        )
    return True


def table_lines(servos: Sequence[Found]) -> list[str]:
    """Return what the servos said, one line each, as a person wants to see it."""
    head = ("joint", "servo", "model", "firmware", "status", "at", "to start", "V", "°C", "deg/s",
            "deg/s²")  # fmt: skip
    rows = [head, *map(_row, servos)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    return [
        "  ".join(
            text.ljust(width) if column in LEFT else text.rjust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _row(found: Found) -> tuple[str, ...]:
    return (
        found.joint,
        str(found.servo_id),
        found.model or "-",
        "-" if found.firmware is None else str(found.firmware),
        found.status or "-",
        f"{found.position_deg:.1f}",
        f"{found.start_deg - found.position_deg:+.1f}",
        _number(found.voltage_v, 1),
        _number(found.temperature_c, 0),
        _number(found.speed_max_deg_s, 0),
        _number(found.accel_max_deg_s2, 0),
    )


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


class Agreement:
    """Controls that ask `go? [y/N]` once the robot has been checked; the rest is for `inner`.

    `note` is told what was answered, with its instant.
    """

    def __init__(
        self,
        inner: Controls[Player],
        inputs: Inputs,
        robot_name: str,
        note: Callable[[str, int], None] | None = None,
    ) -> None:
        self._inner = inner
        self._inputs = inputs
        self._robot_name = robot_name
        self._note = note
        self._is_asking = False

    def filenos(self) -> Sequence[int]:
        return (self._inputs if self._is_asking else self._inner).filenos()

    def act(self, driven: Player, now_ns: int) -> None:
        """Ask, wait for the answer, and pass it on."""
        if driven.phase is not Phase.READY:
            self._is_asking = False
            self._inner.act(driven, now_ns)
            return
        if not self._is_asking:
            self._is_asking = True
            _ask(f"the robot {self._robot_name!r} will move: go? [y/N] ")
        signals_count, keys = self._inputs.take()
        answer = next((key for key in keys if key in YES_KEYS + NO_KEYS), "")
        if signals_count or not self._inputs.has_keys or (answer and answer in NO_KEYS):
            _ask("no: nothing was moved\n")
            if self._note is not None:
                self._note("stop", now_ns)
            driven.stop(now_ns)
        elif answer:
            _ask("yes\n")
            if self._note is not None:
                self._note("go", now_ns)
            driven.go()


def _ask(text: str) -> None:
    put(text, sys.stderr, end="")
