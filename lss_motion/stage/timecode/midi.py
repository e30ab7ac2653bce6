"""MIDI ports of this computer, through RtMidi (`python-rtmidi`): ALSA and JACK, CoreMIDI, Windows.

A port is named by a part of its name, and is looked for again when it has vanished.
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import install_command
from lss_motion.files.texts import known_names

if TYPE_CHECKING:
    from types import ModuleType

CLIENT: Final = "lss_motion"
THROUGH: Final = "midi through"
"""A port of ALSA that only repeats what it is sent."""


class NoPortError(Exception):
    """There is no such MIDI port; the text says why and what to do."""


def rtmidi_module() -> ModuleType:
    """Return the library; raises `NoPortError` without it."""
    try:
        import rtmidi
    except ImportError as error:
        raise NoPortError(f"MIDI needs a library: {install_command('midi')}") from error
    module: ModuleType = rtmidi
    return module


def open_port(kind: str, name: str) -> tuple[Any, str]:
    """Open the input or output (`MidiIn`, `MidiOut`) whose name holds `name`; return it, and that.

    Without a name there must be one only. Raises `NoPortError`.
    """
    library = rtmidi_module()
    found: list[tuple[Any, int, str]] = []
    for api in library.get_compiled_api():
        if api == library.API_RTMIDI_DUMMY:
            continue
        with contextlib.suppress(library.RtMidiError):  # Its server does not run.
            device = getattr(library, kind)(rtapi=api, name=CLIENT)
            ports = device.get_ports()
            names = [(number, str(port)) for number, port in enumerate(ports)]
            found += [(device, number, port) for number, port in names]
    fitting = [
        (device, number, port)
        for device, number, port in found
        if (name.lower() in port.lower() if name else THROUGH not in port.lower())
    ]
    way = "input" if kind == "MidiIn" else "output"
    if not fitting:
        if name:
            text = known_names(name, [port for _, _, port in found])
            raise NoPortError(f"MIDI {way} {name!r} is not there; {text}")
        raise NoPortError(f"this computer has no MIDI {way}; connect one")
    if len(fitting) > 1 and not name:
        names_text = ", ".join(repr(port) for _, _, port in fitting)
        raise NoPortError(f"there are several MIDI {way}s; name one of {names_text}")
    device, number, port = fitting[0]
    try:
        device.open_port(number)
    except (library.RtMidiError, RuntimeError) as error:
        raise NoPortError(f"MIDI {way} {port!r} cannot be opened: {error}") from error
    return device, port


def is_there(device: Any, port: str) -> bool:  # noqa: ANN401  (the library has no types)
    """Return whether an open port still exists."""
    try:
        return any(str(name) == port for name in device.get_ports())
    except Exception:  # noqa: BLE001  (its server is gone, too)
        return False


def close(device: Any) -> None:  # noqa: ANN401
    """Close a port; one that has vanished raises whatever it likes."""
    with contextlib.suppress(Exception):
        device.close_port()
        device.delete()
