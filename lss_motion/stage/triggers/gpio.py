"""Buttons at the pins of a Raspberry Pi: each press is a trigger.

The library calls from a thread of its own; what it brings is handed to the thread of the server.
"""

from __future__ import annotations

import asyncio
import contextlib
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError, install_command
from lss_motion.playing.remote import stage_messages as stage

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.stage.triggers.sources import Gate, Sink

BOUNCE_S: Final = 0.02
"""Contacts of a button bounce for some milliseconds."""


class GpioPins:
    """The inputs that cues wait for, each with its pull-up: a press connects it to ground."""

    def __init__(self, gate: Gate, sink: Sink) -> None:
        self.gate = gate
        self._sink = sink
        self._buttons: dict[str, Any] = {}
        self._loop = asyncio.get_running_loop()

    def watch(self, pins: Iterable[str]) -> None:
        """Watch these pins from now on; raises `InputError` where that cannot be."""
        wanted = set(pins)
        for pin in set(self._buttons) - wanted:
            self._buttons.pop(pin).close()
        for pin in sorted(wanted - set(self._buttons), key=int):
            self._buttons[pin] = button = _button(pin)
            button.when_pressed = partial(self._called, pin)

    def close(self) -> None:
        """Give the pins back."""
        self.watch(())

    def _called(self, pin: str) -> None:
        """Take a press in the thread of the library."""
        with contextlib.suppress(RuntimeError):  # The loop has ended.
            self._loop.call_soon_threadsafe(self._take, pin)

    def _take(self, pin: str) -> None:
        if self.gate.admits("127.0.0.1", self._loop.time()):
            self._sink(stage.Trigger(kind="gpio", address=pin), f"pin GPIO{pin}")


def _button(pin: str) -> Any:  # noqa: ANN401  (the library has no types)
    install = f"{install_command('gpio')} (on a Raspberry Pi)"
    try:
        from gpiozero import Button
        from gpiozero.exc import BadPinFactory, GPIOZeroError
    except ModuleNotFoundError:
        raise InputError(f"GPIO needs a package and its driver: {install}") from None
    try:
        return Button(int(pin), pull_up=True, bounce_time=BOUNCE_S)
    except BadPinFactory:
        raise InputError(
            f"this computer has no GPIO pins, or no driver of them: {install}"
        ) from None
    except (GPIOZeroError, OSError) as error:
        raise InputError(f"pin GPIO{pin} cannot be used: {error}") from None
