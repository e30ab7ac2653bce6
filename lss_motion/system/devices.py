"""The serial devices of this computer, and which names of ports may be opened.

The name of a port stands in a robot file, which may be a stranger's. So only what can be a serial
line is opened; pyserial's other URLs write files (`spy://`) or run code of any class (`alt://`).
"""

from __future__ import annotations

import os
import re
import stat
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from msgspec import Struct

from lss_motion.errors import BusError

if TYPE_CHECKING:
    from collections.abc import Callable

ABSENT: Final = "there is no such device; is it plugged in?"
NO_PORT: Final = "that is no serial device. `lss-motion scan` lists them"
OWN_TERMINAL: Final = "that is the terminal in which this command runs, no serial device"
ALLOWED: Final = (
    "a port is a serial device such as /dev/ttyUSB0 or COM3, sim://, socket://HOST:PORT, "
    "rfc2217://HOST:PORT, or hwgrep://TEXT with a part of the name of a USB device"
)
RFC2217_OPTIONS: Final = frozenset({"ign_set_control", "poll_modem", "timeout"})
"""Options of pyserial that only concern how it speaks to the other computer."""
COM_NAME: Final = re.compile(r"(\\\\\.\\)?COM[1-9][0-9]{0,2}", re.IGNORECASE)
TTY_DRIVERS: Final = Path("/proc/tty/drivers")
"""Linux lists here what device numbers are terminals, and of what type."""
NO_LINES: Final = ("system", "console", "pty:master")
"""Types of terminals that are no serial lines: screens, keyboards, and what makes terminals."""


def opened_name(url: str) -> str:
    """Return what pyserial must be given to open the port `url`; raises `BusError` if it may not.

    Nothing is opened here. That is judged by the number of a device, since to open some devices
    has an effect already, such as `/dev/watchdog`.
    """
    scheme, is_url, rest = url.partition("://")
    if not is_url:
        _require_device(url)
        return url
    judge = _SCHEMES.get(scheme.lower())
    if judge is None:
        raise _refused(url, f"{scheme}:// is no serial line: {ALLOWED}")
    return judge(url, rest)


def _refused(url: str, why: str) -> BusError:
    return BusError(f"cannot open port {url}: {why}", url=url)


def _require_device(path: str) -> None:
    """Raise `BusError` unless `path` is a serial device, or a symbolic link to one."""
    if sys.platform == "win32":
        if not COM_NAME.fullmatch(path):
            raise _refused(path, NO_PORT)
        return
    try:
        found = Path(path).stat()
    except OSError as error:
        hint = permission_hint(path) if isinstance(error, PermissionError) else ABSENT
        raise _refused(path, hint) from error
    except ValueError as error:  # A zero byte in the name.
        raise _refused(path, NO_PORT) from error
    if not stat.S_ISCHR(found.st_mode) or not _is_terminal(found.st_rdev):
        raise _refused(path, NO_PORT)
    if found.st_rdev in _own_terminals():
        raise _refused(path, OWN_TERMINAL)


def _is_terminal(device: int) -> bool:
    """Return whether a device number is that of a terminal that may be a serial line.

    Where the system does not list them, pyserial finds out, which opens it.
    """
    try:
        rows = [row.split() for row in TTY_DRIVERS.read_text(encoding="ascii").splitlines()]
    except OSError:
        return True
    for row in rows:
        major, minors, kind = row[-3:]
        first, _, last = minors.partition("-")
        if int(major) == os.major(device) and os.minor(device) in range(
            int(first), int(last or first) + 1
        ):
            return not kind.startswith(NO_LINES)
    return False


def _own_terminals() -> set[int]:
    """Return the device numbers of the terminals from which this program reads, or writes to."""
    found = set()
    for fd in range(3):
        try:
            if os.isatty(fd):
                found.add(os.fstat(fd).st_rdev)
        except OSError:
            continue
    return found


def _network_name(url: str, _rest: str) -> str:
    """Return the URL of a serial line behind another computer."""
    try:
        parts = urlsplit(url)
        is_whole = bool(parts.hostname and parts.port and not parts.username)
        options = [word.partition("=")[0] for word in parts.query.split("&") if word]
        is_whole = is_whole and not parts.path.strip("/")
    except ValueError:
        is_whole, options = False, []
    if not is_whole:
        raise _refused(url, f"it needs a computer and a port: {ALLOWED}")
    known = RFC2217_OPTIONS if url.lower().startswith("rfc2217:") else ()
    for option in options:
        if option not in known:
            raise _refused(url, f"the option {option!r} is not supported")
    return url


def _matching_device(url: str, text: str) -> str:
    """Return the path of the only device that is described by `text`, which is no pattern.

    A pattern of a stranger could take for ever, and the first of several matches be another robot.
    """
    wanted = text.lower()
    found = [
        device.path
        for device in list_devices()
        if any(wanted in words.lower() for words in (device.path, device.name, device.hardware))
    ]
    if not wanted or not found:
        raise _refused(url, f"no serial device is described by {text!r}. `lss-motion scan` "
                       f"lists them; the text is no pattern and has no options")  # fmt: skip
    if len(found) > 1:
        raise _refused(url, f"{' and '.join(found)} are described by {text!r}: give more of it")
    _require_device(found[0])
    return found[0]


_SCHEMES: Final[dict[str, Callable[[str, str], str]]] = {
    "socket": _network_name,
    "rfc2217": _network_name,
    "hwgrep": _matching_device,
}


class SerialDevice(Struct, frozen=True, kw_only=True):
    """A serial port of this computer.

    `name` is the text that its USB chip reports, `hardware` its numbers, such as `0403:6001`.
    """

    path: str
    name: str
    is_usb: bool
    hardware: str = ""


def list_devices() -> list[SerialDevice]:
    """Return the serial ports of this computer, those on USB first."""
    from serial.tools.list_ports import comports

    found = [
        SerialDevice(
            path=port.device,
            name=_name(port),
            is_usb=port.vid is not None,
            hardware=str(port.hwid or ""),
        )
        for port in comports()
    ]
    return sorted(found, key=lambda device: (not device.is_usb, device.path))


def permission_hint(path: str) -> str:
    """Return how to get the permission to open a device: the group to join, where there is one.

    Never raises.
    """
    try:
        import grp

        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        user = os.environ.get("USER") or "$USER"
    except (ImportError, KeyError, OSError):
        return "no permission; on Linux join the group that owns it, usually `dialout`"
    if group == "root":
        return (
            "no permission: it belongs to root alone. `sudo chmod a+rw` helps until it is plugged "
            "in again; a udev rule that gives it to `dialout` helps permanently"
        )
    return (
        f"no permission: it belongs to the group `{group}`. Join it with "
        f"`sudo usermod -aG {group} {user}`, then log out and in again"
    )


def _name(port: object) -> str:
    """Return the name of a port in pyserial's list, and its serial number if it has one."""
    words = [getattr(port, key, None) for key in ("manufacturer", "product")]
    name = " ".join(str(word) for word in words if word)
    if not name:
        description = getattr(port, "description", None)
        name = "" if description in (None, "n/a") else str(description)
    serial_number = getattr(port, "serial_number", None)
    return f"{name} ({serial_number})" if serial_number else name or "no name"
