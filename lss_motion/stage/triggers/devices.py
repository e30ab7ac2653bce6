"""Inputs of this computer: notes and program changes of MIDI, and buttons at the pins of a Pi.

The libraries call from threads of their own; what they bring is handed to the thread of the server.
That of MIDI does not tell that a device is gone, so the names of the inputs are looked at, and it
is opened again.
"""

from __future__ import annotations

import asyncio
import contextlib
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from lss_motion.errors import InputError, install_command
from lss_motion.playing.remote import stage_messages as stage
from lss_motion.stage.timecode import midi

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from lss_motion.stage.triggers.sources import Gate, Sink


LOOK_S: Final = 1.0
"""How often an open input is looked at. Plugging a device takes longer."""
MISSING_S: Final = 5.0
"""How often a missing input is looked for."""
_NOTE_ON: Final = 0x90
_PROGRAM: Final = 0xC0


def trigger_of(message: Sequence[int]) -> stage.Trigger | None:
    """Return the trigger of one MIDI message; None: it is none.

    A note on with velocity 0 is the end of a note (MIDI 1.0).
    """
    if len(message) < 2 or not all(0 <= byte < 128 for byte in message[1:]):
        return None
    kind, channel, number = message[0] & 0xF0, 1 + (message[0] & 0x0F), str(message[1])
    if kind == _PROGRAM and len(message) == 2:
        return stage.Trigger(kind="program", address=number, channel=channel)
    if kind == _NOTE_ON and len(message) == 3 and message[2]:
        velocity = float(message[2])
        return stage.Trigger(kind="note", address=number, value=velocity, channel=channel)
    return None


class MidiSystem(Protocol):
    """The MIDI inputs of the computer, as `stage.timecode.midi` has them."""

    def open_port(self, kind: str, name: str) -> tuple[Any, str]:
        """Open an input by a part of its name; raises `NoPortError`."""

    def is_there(self, device: Any, port: str) -> bool:  # noqa: ANN401  (the library has no types)
        """Return whether an open input still exists."""

    def close(self, device: Any) -> None:  # noqa: ANN401
        """Close an input."""


class MidiPort:
    """A MIDI input by a part of its name."""

    def __init__(
        self,
        wanted: str,
        gate: Gate,
        sink: Sink,
        note: Callable[[str], None],
        *,
        system: MidiSystem = midi,
    ) -> None:
        self.gate = gate
        self._wanted, self._sink, self._note, self._system = wanted, sink, note, system
        self._input: Any = None
        self._open_name: str | None = None
        self._reported = ""
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None

    @property
    def open_name(self) -> str | None:
        """The name of the input that is open."""
        return self._open_name

    def open(self) -> None:
        """Begin to look for the input."""
        self._look()

    def close(self) -> None:
        """Close the input."""
        if self._timer is not None:
            self._timer.cancel()
        self._drop()

    def _look(self) -> None:
        """Open the input if it is there now; note if it is gone."""
        name = self._open_name
        if name is not None and not self._system.is_there(self._input, name):
            self._say(f"MIDI: {name} has vanished; it is opened when it is back")
            self._drop()
        if self._open_name is None:
            try:
                self._input, self._open_name = self._system.open_port("MidiIn", self._wanted)
            except midi.NoPortError as error:
                if name is None:
                    self._say(f"{error}; it is opened when it is there")
            else:
                self._input.set_callback(self._called)
                self._say(f"MIDI: {self._open_name} is open")
        pause_s = LOOK_S if self._open_name is not None else MISSING_S
        self._timer = self._loop.call_later(pause_s, self._look)

    def _say(self, text: str) -> None:
        """Note what has changed; once while a device is missing."""
        if text != self._reported:
            self._reported = text
            self._note(text)

    def _drop(self) -> None:
        if self._input is not None:
            with contextlib.suppress(Exception):  # Of a device that is gone.
                self._input.cancel_callback()
            self._system.close(self._input)
        self._input, self._open_name = None, None

    def _called(self, arrived: tuple[Sequence[int], float], _data: object = None) -> None:
        """Take a message in the thread of the library."""
        with contextlib.suppress(RuntimeError):  # The loop has ended.
            self._loop.call_soon_threadsafe(self._take, list(arrived[0]))

    def _take(self, message: list[int]) -> None:
        trigger = trigger_of(message)
        if trigger is not None and self.gate.admits("127.0.0.1", self._loop.time()):
            self._sink(trigger, f"MIDI {self._open_name or self._wanted}")


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
