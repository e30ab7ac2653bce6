"""Ports: what the run loop requires of one, the serial port, and the computer's serial devices.

`Port` is the contract; `SerialPort` opens a device with pyserial; `ReopeningPort` wraps a port and
opens it again after it was lost. No call blocks, except `close`, which waits for the last bytes.
"""

from __future__ import annotations

import contextlib
import errno
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import BusError, LostPortError
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Callable

    import serial

    from lss_motion.runtime.clock import Clock


READ_MAX_BYTES: Final = 4096
"""The most that one call reads; a line at 115200 bps delivers that in a third of a second."""
POLL_NS: Final = 2 * NS_PER_MS
"""How often a port without a file number is polled (Windows, `loop://`)."""

NO_PORT: Final = "that is no serial device. `lss-motion scan` lists them"
IN_USE: Final = "another program has it open; end that one first (LSS Config? another lss-motion?)"
GONE: Final = "the device is gone, or another program reads from it. Look at its plug and cable"


class Port(Protocol):
    """One open bus. No call blocks, except `close`."""

    url: str

    def write(self, data: bytes) -> None:
        """Send `data`. Raises `BusError` when the port is lost."""

    def read(self) -> bytes:
        """Return what has arrived. Raises `BusError` when the port is lost."""

    def fileno(self) -> int | None:
        """Return the file number that becomes readable when data arrives, or None."""

    def next_arrival_ns(self) -> int | None:
        """Return when to read next; None where waiting on `fileno` is enough."""

    def close(self) -> None: ...


class SerialPort:
    """A device or pyserial URL, opened exclusively, 8N1, without flow control."""

    def __init__(self, url: str, baud_bps: int) -> None:
        import serial

        self.url = url
        try:
            self._serial: serial.Serial = serial.serial_for_url(
                url, baudrate=baud_bps, timeout=0, write_timeout=None, do_not_open=True
            )
            with contextlib.suppress(ValueError, AttributeError, NotImplementedError):
                self._serial.exclusive = True
            self._serial.open()
            self._serial.reset_input_buffer()
            with contextlib.suppress(AttributeError, OSError, ValueError, NotImplementedError):
                self._serial.set_low_latency_mode(True)
        except (serial.SerialException, ValueError, OSError) as error:
            raise BusError(f"cannot open port {url}: {_reason(error, url)}", url=url) from error

    def write(self, data: bytes) -> None:
        import serial

        try:
            self._serial.write(data)
        except (serial.SerialException, OSError) as error:
            raise self._lost() from error

    def read(self) -> bytes:
        import serial

        try:
            return bytes(self._serial.read(READ_MAX_BYTES))
        except (serial.SerialException, OSError) as error:
            raise self._lost() from error

    def fileno(self) -> int | None:
        try:
            return int(self._serial.fileno())
        except (AttributeError, OSError, NotImplementedError):
            return None

    def next_arrival_ns(self) -> int | None:
        return None if self.fileno() is not None else time.monotonic_ns() + POLL_NS

    def close(self) -> None:
        """Wait until everything has left, then close."""
        with contextlib.suppress(Exception):
            self._serial.flush()
        with contextlib.suppress(Exception):
            self._serial.close()

    def _lost(self) -> LostPortError:
        return LostPortError(f"lost port {self.url}: {GONE}", url=self.url)


def _reason(error: Exception, url: str) -> str:
    """Return the cause of a failure to open or use a port, in words for a person."""
    hints = {
        errno.ENOENT: "there is no such device; is it plugged in?",
        errno.EACCES: permission_hint(url),
        errno.EBUSY: IN_USE,
        errno.EAGAIN: IN_USE,
        errno.ENOTTY: NO_PORT,
        errno.EISDIR: NO_PORT,
    }
    return hints.get(_number(error), str(error))


def _number(error: BaseException) -> int:
    """Return the system's number of an error, also of one that pyserial only quotes."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    cause = error.__context__  # `termios.error` is not an OSError, but has its arguments.
    first = cause.args[0] if cause is not None and cause.args else 0
    return first if isinstance(first, int) else 0


REOPEN_NS: Final = 100 * NS_PER_MS
"""How often a lost port is looked for. Chosen: a delay of 0.1 s does not matter to a person, and
looking for an absent device takes microseconds."""


class ReopeningPort:
    """A port that drops what is written while it is lost.

    `waits` is called when the port is lost and decides: False raises the `BusError`. `lost` is
    called with the reason and the instant, `found` when the port is open again.
    """

    def __init__(
        self,
        port: Port,
        reopen: Callable[[], Port],
        clock: Clock,
        *,
        waits: Callable[[], bool],
        lost: Callable[[str, int], None],
        found: Callable[[], None],
    ) -> None:
        self.url = port.url
        self._port: Port | None = port
        self._reopen = reopen
        self._clock = clock
        self._waits = waits
        self._lost = lost
        self._found = found
        self._next_ns = 0

    def write(self, data: bytes) -> None:
        if self._port is None:
            return
        try:
            self._port.write(data)
        except BusError as error:
            self._lose(error)

    def read(self) -> bytes:
        if self._port is None:
            self._look()
            return b""
        try:
            return self._port.read()
        except BusError as error:
            self._lose(error)
            return b""

    def fileno(self) -> int | None:
        return None if self._port is None else self._port.fileno()

    def next_arrival_ns(self) -> int | None:
        return self._next_ns if self._port is None else self._port.next_arrival_ns()

    def close(self) -> None:
        if self._port is not None:
            self._port.close()

    def _lose(self, error: BusError) -> None:
        if not self._waits():
            raise error
        assert self._port is not None
        self._port.close()
        self._port = None
        now_ns = self._clock.now_ns()
        self._next_ns = now_ns + REOPEN_NS
        self._lost(error.reason, now_ns)

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + REOPEN_NS
        try:
            self._port = self._reopen()
        except BusError:
            return
        self._found()


@dataclass(frozen=True, slots=True, kw_only=True)
class Device:
    """A serial port of this computer. `name` is the text that its USB chip reports."""

    path: str
    name: str
    is_usb: bool


def list_devices() -> list[Device]:
    """Return the serial ports of this computer, those on USB first."""
    from serial.tools.list_ports import comports

    found = [
        Device(path=port.device, name=_name(port), is_usb=port.vid is not None)
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
