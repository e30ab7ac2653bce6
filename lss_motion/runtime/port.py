"""What the runner needs of a port, and the one that is real: pyserial."""

from __future__ import annotations

import contextlib
import errno
import time
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import BusError, LostPortError
from lss_motion.runtime.devices import permission_hint
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    import serial

READ_MAX_BYTES: Final = 4096
"""Taken in one go; a 115200 line delivers that in a third of a second."""
POLL_NS: Final = 2 * NS_PER_MS
"""How often a port that cannot be waited on is looked at (Windows, `loop://`)."""

NO_PORT: Final = "that is no serial device. `lss-motion scan` says which there are"
IN_USE: Final = "another program has it open; end that one first (LSS Config? another lss-motion?)"

GONE: Final = "the device is gone, or another program reads from it. Look at its plug and cable"


class Port(Protocol):
    """One open bus. Neither call blocks."""

    url: str

    def write(self, data: bytes) -> None:
        """Hand `data` over. Raises `BusError` when the port is lost."""

    def read(self) -> bytes:
        """Return what has arrived. Raises `BusError` when the port is lost."""

    def fileno(self) -> int | None:
        """Return what to wait on for arrivals; None where there is no such thing."""

    def next_arrival_ns(self) -> int | None:
        """Return when to look for arrivals; None where waiting on `fileno` says it."""

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
    """Return what to tell a person about a failure to open or use a port."""
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
    """Return the number that the system gave an error, also one that pyserial only quotes."""
    if isinstance(error, OSError) and error.errno is not None:
        return error.errno
    cause = error.__context__  # `termios.error` is no OSError, but has one's arguments.
    first = cause.args[0] if cause is not None and cause.args else 0
    return first if isinstance(first, int) else 0
