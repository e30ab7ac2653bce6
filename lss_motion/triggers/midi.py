"""Notes and program changes of a MIDI input, which is opened again when it was gone.

The library calls from a thread of its own; what it brings is handed to the thread of the server.
It does not tell that a device is gone, so the names of the inputs are looked at.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError
from lss_motion.remote import stage_messages as stage

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.triggers.sources import Gate, Sink

LOOK_S: Final = 1.0
"""How often the inputs are looked at. Plugging a device takes longer."""
NO_DRIVER_S: Final = 30.0
"""How often a MIDI system is asked for that is not there: it writes to the terminal each time."""
INSTALL: Final = 'MIDI needs a package: pip install "lss-motion[stage]"'
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


def port_in(names: Sequence[str], wanted: str) -> int | None:
    """Return which of these inputs is meant by a part of its name; `default` is the first."""
    for place, name in enumerate(names):
        if wanted == "default" or wanted.casefold() in name.casefold():
            return place
    return None


class MidiPort:
    """A MIDI input by a part of its name."""

    def __init__(
        self,
        wanted: str,
        gate: Gate,
        sink: Sink,
        note: Callable[[str], None],
        *,
        make: Callable[[], Any] | None = None,
    ) -> None:
        self.gate = gate
        self._wanted, self._sink, self._note = wanted, sink, note
        self._make = make or _make
        self._input: Any = None
        self._open_name: str | None = None
        self._has_looked = False
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None

    @property
    def open_name(self) -> str | None:
        """The name of the input that is open."""
        return self._open_name

    def open(self) -> None:
        """Begin to look for the input; raises `InputError` where the package is missing."""
        self._look()

    def close(self) -> None:
        """Close the input."""
        if self._timer is not None:
            self._timer.cancel()
        self._drop()

    def _look(self) -> None:
        """Open the input if it is there now; note if it is gone."""
        pause_s = LOOK_S
        try:
            self._input = self._make() if self._input is None else self._input
            names = self._input.get_ports()
        except InputError:
            raise
        except Exception as error:  # noqa: BLE001  (the library raises its own, by driver)
            self._say_gone(f"no MIDI system ({error})")
            self._drop()
            names, pause_s = [], NO_DRIVER_S
        self._timer = self._loop.call_later(pause_s, self._look)
        if self._open_name is not None and self._open_name not in names:
            self._say_gone("has vanished")
            self._drop()
        elif self._open_name is None and self._input is not None:
            self._try(names)
        self._has_looked = True

    def _try(self, names: Sequence[str]) -> None:
        place = port_in(names, self._wanted)
        if place is None:
            if not self._has_looked:
                listed = ", ".join(names) or "none"
                self._note(f"MIDI: no input {self._wanted!r} yet; there are: {listed}")
            return
        try:
            self._input.open_port(place)
        except Exception as error:  # noqa: BLE001  (the library raises its own, by driver)
            self._note(f"MIDI: {names[place]} cannot be opened: {error}")
            self._drop()
            return
        self._input.set_callback(self._called)
        self._open_name = names[place]
        self._note(f"MIDI: {self._open_name} is open")

    def _say_gone(self, why: str) -> None:
        if self._open_name is not None or not self._has_looked:
            name = self._open_name or self._wanted
            self._note(f"MIDI: {name}: {why}; it is opened when it is there")

    def _drop(self) -> None:
        if self._input is not None:
            with contextlib.suppress(Exception):  # Of a device that is gone.
                self._input.cancel_callback()
                self._input.close_port()
            with contextlib.suppress(Exception):
                self._input.delete()
        self._input, self._open_name = None, None

    def _called(self, arrived: tuple[Sequence[int], float], _data: object = None) -> None:
        """Take a message in the thread of the library."""
        with contextlib.suppress(RuntimeError):  # The loop has ended.
            self._loop.call_soon_threadsafe(self._take, list(arrived[0]))

    def _take(self, message: list[int]) -> None:
        trigger = trigger_of(message)
        if trigger is not None and self.gate.admits("127.0.0.1", self._loop.time()):
            self._sink(trigger, f"MIDI {self._open_name or self._wanted}")


def _make() -> Any:  # noqa: ANN401  (the library has no types)
    try:
        import rtmidi
    except ModuleNotFoundError:
        raise InputError(INSTALL) from None
    return rtmidi.MidiIn(name="lss-motion")
