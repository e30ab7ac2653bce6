"""Ports: what the run loop requires of one, and the serial port.

`Port` is the contract; `SerialPort` opens a port with pyserial; `ReopeningPort` wraps a port and
opens it again after it was lost. `Outbox` holds the bytes that a port does not take at once, and
raises when it takes none for too long. No call waits, except `close`, which waits for the last
bytes as long as they leave.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
import time
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import BlockedPortError, BusError, LostPortError
from lss_motion.system.devices import ABSENT, NO_PORT, opened_name, permission_hint
from lss_motion.system.reactor import wait_for
from lss_motion.units import NS_PER_MS, NS_PER_S, line_time_ns, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable

    import serial

    from lss_motion.system.clock import Clock


READ_MAX_BYTES: Final = 4096
"""The most that one call reads; a line at 115200 bps delivers that in a third of a second."""
POLL_NS: Final = 2 * NS_PER_MS
"""How often a port is polled that has no file number (Windows) or did not take all."""
BLOCKED_NS: Final = NS_PER_S // 2
"""A port is lost when no byte leaves it for so long, beyond the line time of what waits. Chosen:
half of `robot.model.SILENT_S`, so that the port is named as the cause, not its servos."""
HELD_MAX_BYTES: Final = 64 * 1024
"""The most that waits for a port. Chosen: what the fastest line (500000 bps) carries in
twice `BLOCKED_NS`, so that it is not full before the port is lost."""
LOOK_NS: Final = 20 * NS_PER_MS
"""How long after a write, and how often, the system is asked how many bytes have not left."""

IN_USE: Final = "another program has it open; end that one first (LSS Config? another lss-motion?)"
GONE: Final = "the device is gone, or another program reads from it. Look at its plug and cable"
BLOCKED: Final = (
    "it takes no bytes, or none leaves it: a stalled adapter, or flow control (XOFF). Unplug it "
    "and plug it in again"
)


class Port(Protocol):
    """One open bus. No call waits, except `close`."""

    url: str

    def write(self, data: bytes) -> None:
        """Send `data`, or keep it until there is room. Raises `BusError` when the port is lost."""

    def read(self) -> bytes:
        """Return what has arrived, and send what is kept. Raises `BusError` when the port is lost.

        To be called every 50 ms at least.
        """

    def fileno(self) -> int | None:
        """Return the file number that becomes readable when data arrives, or None."""

    def next_arrival_ns(self) -> int | None:
        """Return when to read next; None where waiting on `fileno` is enough."""

    def has_sent_all(self) -> bool:
        """Return whether nothing that was written is still kept in this computer."""

    def close(self) -> None:
        """Close, after what is kept has left. Raises `BlockedPortError` if it does not leave."""


class Outbox:
    """Bytes on their way into a port that takes them when it can.

    `take` gets bytes and returns how many the port took; it never waits. `waiting` returns how many
    of those have not left yet. While nothing is held, the time counts from the first write after
    the last byte that left: a driver may report for ever that a few bytes wait. Raises
    `BlockedPortError`.
    """

    def __init__(
        self, url: str, baud_bps: int, take: Callable[[bytes], int], waiting: Callable[[], int]
    ) -> None:
        self._url = url
        self._baud_bps = baud_bps
        self._take = take
        self._waiting = waiting
        self._held = bytearray()
        self._written_bytes = 0
        self._left_bytes = 0
        """How many bytes had left at the last look at which any had."""
        self._lost_ns: int | None = None
        """When the port is lost if no byte leaves; None: nothing is known to wait."""
        self._look_ns = 0
        self._was_full = False

    @property
    def held_bytes(self) -> int:
        """How many bytes the port has not taken."""
        return len(self._held)

    @property
    def lost_ns(self) -> int | None:
        """When the port will be lost if no byte leaves; None while none is held."""
        return self._lost_ns if self._held else None

    def write(self, data: bytes, now_ns: int) -> None:
        """Hand over `data` behind what is held."""
        self._held += data
        self._written_bytes += len(data)
        if self._lost_ns is None:
            self._count_from(now_ns, len(self._held))
        self.flush(now_ns)
        if len(self._held) > HELD_MAX_BYTES:
            raise self.blocked()

    def flush(self, now_ns: int) -> None:
        """Hand over what is held, and look whether bytes leave."""
        if self._held:
            taken_bytes = self._take(bytes(self._held))
            del self._held[:taken_bytes]
            if taken_bytes and self._was_full:  # Others have left, or there would be no room.
                self._count_from(now_ns, len(self._held))
            self._was_full = bool(self._held)
        if self._lost_ns is not None and now_ns >= min(self._look_ns, self._lost_ns):
            self._look(self._lost_ns, now_ns)

    def unsent_bytes(self) -> int:
        """Return how many bytes are held here or wait in the system."""
        return len(self._held) + self._waiting()

    def blocked(self) -> BlockedPortError:
        """Drop what is held; return the error of a lost port."""
        self._held.clear()
        return BlockedPortError(f"lost port {self._url}: {BLOCKED}", url=self._url)

    def _look(self, lost_ns: int, now_ns: int) -> None:
        unsent_bytes = self.unsent_bytes()
        left_bytes = self._written_bytes - unsent_bytes
        self._look_ns = now_ns + LOOK_NS
        if left_bytes <= self._left_bytes and unsent_bytes:
            if now_ns >= lost_ns:
                raise self.blocked()
            return
        self._left_bytes = left_bytes
        self._lost_ns = None
        if self._held:
            self._count_from(now_ns, unsent_bytes)

    def _count_from(self, now_ns: int, unsent_bytes: int) -> None:
        self._lost_ns = now_ns + line_time_ns(unsent_bytes, self._baud_bps) + BLOCKED_NS
        self._look_ns = now_ns + LOOK_NS


class SerialPort:
    """A port that `opened_name` allows, opened exclusively, 8N1, without flow control.

    A write to a device never waits. One over the network (`socket://`) or on Windows may wait for
    `BLOCKED_NS` before the port is lost.
    """

    def __init__(self, url: str, baud_bps: int) -> None:
        import serial

        self.url = url
        name = opened_name(url)
        try:
            self._serial: serial.Serial = serial.serial_for_url(
                name,
                baudrate=baud_bps,
                timeout=0,
                write_timeout=s_from_ns(BLOCKED_NS),
                do_not_open=True,
            )
            with contextlib.suppress(ValueError, AttributeError, NotImplementedError):
                self._serial.exclusive = True
            self._serial.open()
            self._serial.reset_input_buffer()
            with contextlib.suppress(AttributeError, OSError, ValueError, NotImplementedError):
                self._serial.set_low_latency_mode(True)
        except (serial.SerialException, ValueError, OSError) as error:
            raise BusError(f"cannot open port {url}: {_reason(error, url)}", url=url) from error
        self._out_fd = self._device_fd()
        self._outbox = Outbox(url, baud_bps, self._take, self._waiting_bytes)
        self._is_lost = False

    def write(self, data: bytes) -> None:
        try:
            self._outbox.write(data, time.monotonic_ns())
        except BlockedPortError:
            self._is_lost = True
            raise
        except OSError as error:
            raise self._lost(error) from error

    def read(self) -> bytes:
        try:
            self._outbox.flush(time.monotonic_ns())
            # A device without data and one that is gone both give none: pyserial tells them apart.
            return self._arrived() or bytes(self._serial.read(READ_MAX_BYTES))
        except BlockedPortError:
            self._is_lost = True
            raise
        except OSError as error:
            raise self._lost(error) from error

    def fileno(self) -> int | None:
        try:
            return int(self._serial.fileno())
        except (AttributeError, OSError, NotImplementedError):
            return None

    def next_arrival_ns(self) -> int | None:
        is_polled = self._outbox.held_bytes or self.fileno() is None
        return time.monotonic_ns() + POLL_NS if is_polled else None

    def has_sent_all(self) -> bool:
        return not self._outbox.unsent_bytes()

    def close(self) -> None:
        """Close, after what is kept has left. Raises `BlockedPortError` if it does not leave."""
        is_lost, self._is_lost = self._is_lost, True
        try:
            if not is_lost:
                self._drain()
        finally:
            self._discard()
            with contextlib.suppress(Exception):
                self._serial.close()

    def _drain(self) -> None:
        """Wait until everything has left, as long as bytes leave."""
        unsent_bytes = self._outbox.unsent_bytes()
        while unsent_bytes:
            self.write(b"")  # The time counts from now, if not from earlier.
            wait_for((), s_from_ns(POLL_NS))
            unsent_bytes = self._outbox.unsent_bytes()
        with contextlib.suppress(Exception):
            self._serial.flush()

    def _discard(self) -> None:
        """Drop what has not left: the system would wait for it in `close`, 30 s on Linux."""
        with contextlib.suppress(Exception):
            if self._outbox.unsent_bytes() and self._out_fd is not None:
                self._serial.reset_output_buffer()

    def _lost(self, error: OSError) -> BusError:
        """Return what every failure of the system is: a lost port."""
        import serial

        self._is_lost = True
        if isinstance(error, serial.SerialTimeoutException):
            return self._outbox.blocked()
        return LostPortError(f"lost port {self.url}: {GONE}", url=self.url)

    def _arrived(self) -> bytes:
        """Return what has arrived at a device, at less cost than pyserial; else nothing."""
        if self._out_fd is None:
            return b""
        try:
            return os.read(self._out_fd, READ_MAX_BYTES)
        except BlockingIOError:
            return b""

    def _device_fd(self) -> int | None:
        """Return the descriptor of a device that is written without waiting, or None."""
        import serial

        is_device = type(self._serial).write is serial.Serial.write and sys.platform != "win32"
        return self.fileno() if is_device else None

    def _take(self, data: bytes) -> int:
        if self._out_fd is None:
            return int(self._serial.write(data) or 0)
        try:
            return os.write(self._out_fd, data)
        except BlockingIOError:
            return 0

    def _waiting_bytes(self) -> int:
        if self._out_fd is None:
            return 0
        with contextlib.suppress(OSError):
            return int(self._serial.out_waiting)
        return 0


def _reason(error: Exception, url: str) -> str:
    """Return the cause of a failure to open or use a port, in words for a person."""
    hints = {
        errno.ENOENT: ABSENT,
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


PROBE: Final = b"#\r"
"""Sent to a port that was blocked, to see whether bytes leave it again. Servos ignore it: a line
without a command. It also ends a line of which only the beginning had left."""


class ReopeningPort:
    """A port that drops what is written while it is lost.

    `waits` is called when the port is lost and decides: False raises the `BusError`. `lost` is
    called with the reason and the instant, `found` with the instant when the port is open again.
    Both are called in `read` only, after all that was sent in the same turn: a log can repeat that.
    A port that was blocked is found when `PROBE` has left it.
    """

    def __init__(
        self,
        port: Port,
        reopen: Callable[[], Port],
        clock: Clock,
        *,
        waits: Callable[[], bool],
        lost: Callable[[str, int], None],
        found: Callable[[int], None],
    ) -> None:
        self.url = port.url
        self._port: Port | None = port
        self._probed: Port | None = None
        """A port that was opened again, while the probe has not left it."""
        self._was_blocked = False
        self._reopen = reopen
        self._clock = clock
        self._waits = waits
        self._lost = lost
        self._found = found
        self._next_ns = 0
        self._reason: str | None = None
        """Why the port was lost, until `lost` was called."""

    def write(self, data: bytes) -> None:
        if self._port is None:
            return
        try:
            self._port.write(data)
        except BusError as error:
            self._lose(error)

    def read(self) -> bytes:
        data = b""
        if self._port is not None:
            try:
                data = self._port.read()
            except BusError as error:
                self._lose(error)
        elif self._reason is None:
            self._look()
        if self._reason is not None:
            reason, self._reason = self._reason, None
            self._lost(reason, self._clock.now_ns())
        return data

    def fileno(self) -> int | None:
        return None if self._port is None else self._port.fileno()

    def next_arrival_ns(self) -> int | None:
        if self._reason is not None:
            return self._clock.now_ns()
        return self._next_ns if self._port is None else self._port.next_arrival_ns()

    def has_sent_all(self) -> bool:
        return self._port is not None and self._port.has_sent_all()

    def close(self) -> None:
        for port in (self._port, self._probed):
            if port is not None:
                port.close()

    def _lose(self, error: BusError) -> None:
        if not self._waits():
            raise error
        assert self._port is not None
        self._port.close()
        self._port = None
        self._was_blocked = isinstance(error, BlockedPortError)
        self._next_ns = self._clock.now_ns() + REOPEN_NS
        self._reason = error.reason

    def _look(self) -> None:
        now_ns = self._clock.now_ns()
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + REOPEN_NS
        try:
            if self._probed is None:
                self._probed = self._reopen()
                if self._was_blocked:
                    self._probed.write(PROBE)
            elif self._was_blocked:
                self._probed.read()  # Nothing that comes before the player's queries is a reply.
            if self._was_blocked and not self._probed.has_sent_all():
                return
        except BusError:
            if self._probed is not None:
                self._probed.close()
            self._probed = None
            return
        self._port, self._probed = self._probed, None
        self._found(now_ns)
