"""Simulated buses behind pseudo-terminals, in real time, for any program that opens a port."""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, InputError
from lss_motion.sim.bus import bus_from_robot
from lss_motion.sim.physics import Lines, Physics
from lss_motion.system.reactor import wait_for
from lss_motion.system.real_time import prompt_waits
from lss_motion.system.signals import ENDING
from lss_motion.units import LINE_BITS_PER_BYTE, NS_PER_MS, NS_PER_S, line_time_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path
    from types import FrameType

    from lss_motion.robot.model import Robot
    from lss_motion.sim.bus import SimBus
    from lss_motion.sim.faults import Fault
    from lss_motion.sim.hand import HandMotion

FIFO_BYTES = 256
"""What a USB adapter takes before it makes the host wait: the transmit buffer of an FT232R."""

MOVING_POLL_NS = 20 * NS_PER_MS
"""While horns move, time is simulated at least this often, so that no reply has to wait for it."""

EARLY_NS = 100_000
"""How much before a reply is complete its port is woken. Waking and computing take 60 to 120 us
(measured); the last of it is waited for without sleeping, so that no reply is early either."""

PTY_FOLDERS: Final = ("/dev/pts/", "/dev/ttys")
"""How the names of pseudo-terminals begin on Linux and on macOS."""

TCGETS2 = 0x802C542A
TERMIOS2_BYTES = 44
"""Linux, `asm-generic/termbits.h`: `struct termios2` ends with the output rate as a number."""

RESTING_POLL_NS = 200 * NS_PER_MS
"""How often `should_stop` is polled when nothing else happens."""


def serve(  # noqa: PLR0913  (what one simulated robot needs)
    robot: Robot,
    link: Path | None,
    *,
    seed: int,
    announce: Callable[[str], None],
    faults: Sequence[Fault] = (),
    usb_latency_ns: int = 0,
    hand: HandMotion | None = None,
    lines: Lines = "strict",
    should_stop: Callable[[], bool] = lambda: False,
) -> int | None:
    """Serve every bus of `robot` until a signal ends it or `should_stop()`; return the signal.

    `link` becomes a symbolic link to the port, `LINK.<bus>` where there are several buses; it
    is removed when this returns. A host may close and reopen a port at any time. `announce` gets
    the path of each port, a line when a port was unplugged or blocked, or is back, and what a
    program sends that no document describes.
    """
    buses = {
        name: bus_from_robot(
            robot,
            name,
            seed=seed,
            physics=Physics(lines=lines),
            faults=faults,
            usb_latency_ns=usb_latency_ns,
            hand=hand,
        )
        for name in robot.buses
    }
    return serve_buses(buses, link, announce=announce, should_stop=should_stop)


def serve_buses(
    buses: Mapping[str, SimBus],
    link: Path | None,
    *,
    announce: Callable[[str], None],
    should_stop: Callable[[], bool] = lambda: False,
) -> int | None:
    """Serve existing buses as `serve` does."""
    with contextlib.ExitStack() as stack:
        alarm_fd, received = stack.enter_context(_signals())
        stack.enter_context(prompt_waits())
        ports = []
        for name, bus in buses.items():
            linked = None
            if link is not None:
                linked = link if len(buses) == 1 else link.with_name(f"{link.name}.{name}")
            port = PtyPort(bus, linked, name=name, announce=announce)
            stack.callback(port.close)
            port.open()
            ports.append(port)
        while not received and not should_stop():
            _turn(ports, alarm_fd)
        for name, bus in buses.items():
            if summary := bus.odd_lines.summary():
                announce(f"{name}: lines that no document describes: {summary}")
    return received[0] if received else None


class PtyPort:
    """One bus behind one pseudo-terminal. The host's side is `path` while it is plugged in."""

    def __init__(
        self,
        bus: SimBus,
        link: Path | None,
        *,
        name: str,
        announce: Callable[[str], None],
    ) -> None:
        try:
            import termios
            import tty
        except ImportError as error:
            raise BusError(
                "this system has no pseudo-terminals; play in process with port sim://"
            ) from error
        self._termios = termios
        self._tty = tty
        self.bus = bus
        self.master_fd = self._slave_fd = -1
        self._link = link
        self._name = name
        self._announce = announce
        self._opened = contextlib.ExitStack()
        self._rates_bps = {
            getattr(termios, name): int(name[1:])
            for name in dir(termios)
            if name[:1] == "B" and name[1:].isdigit()
        }
        bus.advance(time.monotonic_ns())
        self._blocks_ns = bus.blocks_ns()
        self._is_blocked = False

    def open(self) -> None:
        """Plug it in: make the pseudo-terminal and the link to it, and announce its path."""
        self.master_fd, self._slave_fd = os.openpty()
        self._is_blocked = False
        self._opened.callback(os.close, self.master_fd)
        self._opened.callback(os.close, self._slave_fd)
        path = shown = os.ttyname(self._slave_fd)
        self._tty.setraw(self._slave_fd)
        self._set_rate()
        os.set_blocking(self.master_fd, False)
        if self._link is not None:
            self._opened.enter_context(_linked(self._link, path))
            shown = f"{self._link} -> {path}"
        count = self.bus.servo_count
        servos = f"{count} simulated servo{'' if count == 1 else 's'}"
        self._announce(f"{self._name}: {shown}, {self.bus.baud_bps} bps, {servos}")

    def close(self) -> None:
        """Unplug it: the host finds its port gone."""
        self._opened.close()
        self.master_fd = self._slave_fd = -1

    @property
    def is_plugged(self) -> bool:
        return self.master_fd >= 0

    def plug(self, now_ns: int) -> None:
        """Close, open, block and free the port as the faults of the bus require."""
        is_out = any(from_ns <= now_ns < until_ns for from_ns, until_ns in self.bus.outages_ns())
        if is_out and self.is_plugged:
            self.close()
            self._announce(f"{self._name}: unplugged")
        elif not is_out and not self.is_plugged:
            self.open()
        if self.is_plugged:
            self._block(is_wanted=any(a_ns <= now_ns < z_ns for a_ns, z_ns in self._blocks_ns))

    def _block(self, *, is_wanted: bool) -> None:
        """Make writes of the host fail, as a full system buffer does, or let them pass again."""
        if is_wanted is not self._is_blocked:
            self._is_blocked = is_wanted
            action = self._termios.TCOOFF if is_wanted else self._termios.TCOON
            self._termios.tcflow(self._slave_fd, action)
            self._announce(f"{self._name}: {'takes no bytes' if is_wanted else 'takes bytes'}")

    def is_open_to_host(self, now_ns: int) -> bool:
        """Return whether the adapter has room; if not, the host's bytes wait in the system."""
        return self.is_plugged and self.bus.backlog_ns(now_ns) < self._fifo_ns()

    def wakeup_ns(self, now_ns: int) -> int:
        """Return the next instant with something to do if the host sends nothing."""
        poll_ns = RESTING_POLL_NS if self.bus.is_resting else MOVING_POLL_NS
        spans_ns = [*self.bus.outages_ns(), *self._blocks_ns]
        turns_ns = [turn_ns for span_ns in spans_ns for turn_ns in span_ns]
        wakeup_ns = min([now_ns + poll_ns, *(turn for turn in turns_ns if turn > now_ns)])
        arrival_ns = self.bus.next_arrival_ns()
        if arrival_ns is not None:
            wakeup_ns = min(wakeup_ns, arrival_ns - EARLY_NS)
        if self.is_plugged and not self.is_open_to_host(now_ns):
            room_ns = now_ns + self.bus.backlog_ns(now_ns) - self._fifo_ns() + 1
            wakeup_ns = min(wakeup_ns, room_ns)
        return wakeup_ns

    def take(self, now_ns: int) -> None:
        """Take what the host has written, as far as the adapter has room."""
        used_bytes = self.bus.backlog_ns(now_ns) * self.bus.baud_bps // NS_PER_S
        room_bytes = max(FIFO_BYTES - used_bytes // LINE_BITS_PER_BYTE, 1)
        with contextlib.suppress(BlockingIOError):
            data = os.read(self.master_fd, room_bytes)
            self._follow_rate(now_ns)
            self.bus.write(data, now_ns)

    def give(self, now_ns: int) -> None:
        """Deliver bytes that have arrived or are about to arrive; bytes without room are lost."""
        self._deliver(self.bus.read(now_ns))
        for text in self.bus.odd_lines.take_texts():
            self._announce(f"{self._name}: {text}")
        arrival_ns = self.bus.next_arrival_ns()
        if arrival_ns is not None and arrival_ns <= now_ns + EARLY_NS:
            data = self.bus.read(arrival_ns)
            while time.monotonic_ns() < arrival_ns:
                pass
            self._deliver(data)

    def _deliver(self, data: bytes) -> None:
        if data and self.is_plugged:
            with contextlib.suppress(BlockingIOError):
                os.write(self.master_fd, data)

    def _fifo_ns(self) -> int:
        return line_time_ns(FIFO_BYTES, self.bus.baud_bps)

    def _set_rate(self) -> None:
        """Set the terminal to the rate of the bus, for hosts that do not set one."""
        codes = {rate_bps: code for code, rate_bps in self._rates_bps.items()}
        attributes = self._termios.tcgetattr(self._slave_fd)
        code = codes.get(self.bus.baud_bps, attributes[5])
        attributes[4] = attributes[5] = code
        self._termios.tcsetattr(self._slave_fd, self._termios.TCSANOW, attributes)
        self._own_code = code

    def _follow_rate(self, now_ns: int) -> None:
        """Run the line at the rate that the host has set, if it has set one."""
        code = self._termios.tcgetattr(self._slave_fd)[5]
        if code == self._own_code:
            return
        self._own_code = code
        rate_bps = self._rates_bps.get(code) or self._special_rate_bps()
        if rate_bps:
            self.bus.set_host_rate(rate_bps, now_ns)

    def _special_rate_bps(self) -> int:
        """Return a rate that has no code of its own, such as 250000; 0 if it cannot be read."""
        import fcntl

        settings = bytearray(TERMIOS2_BYTES)
        with contextlib.suppress(OSError):
            fcntl.ioctl(self._slave_fd, TCGETS2, settings)
        return int.from_bytes(settings[-4:], sys.byteorder)


def _turn(ports: list[PtyPort], alarm_fd: int) -> None:
    """Wait for a host or the next instant, then bring every port up to now."""
    now_ns = time.monotonic_ns()
    open_ports = {port.master_fd: port for port in ports if port.is_open_to_host(now_ns)}
    wait_ns = min(port.wakeup_ns(now_ns) for port in ports) - now_ns
    readable = wait_for([alarm_fd, *open_ports], max(wait_ns, 0) / NS_PER_S)
    now_ns = time.monotonic_ns()
    for port in ports:
        if port.master_fd in readable:
            port.take(now_ns)
        port.give(now_ns)
        port.plug(now_ns)


def _is_left_over(link: Path) -> bool:
    """Return whether `link` is a symbolic link to a pseudo-terminal that does not exist."""
    return link.is_symlink() and str(link.readlink()).startswith(PTY_FOLDERS) and not link.exists()


@contextlib.contextmanager
def _linked(link: Path, target: str) -> Iterator[None]:
    """Make the symbolic link for the time of the context.

    It replaces only what another simulator that was killed has left: a link to a pseudo-terminal
    that is gone.
    """
    if os.path.lexists(link) and not _is_left_over(link):
        raise InputError(f"{link} exists already; choose another --link, or remove it first")
    fresh = link.with_name(f".{link.name}.{os.getpid()}")
    try:
        fresh.symlink_to(target)
        fresh.replace(link)
    except OSError as error:
        raise InputError(f"cannot make the link {link}: {error.strerror}") from error
    try:
        yield
    finally:
        if link.is_symlink() and str(link.readlink()) == target:
            link.unlink()


@contextlib.contextmanager
def _signals() -> Iterator[tuple[int, list[int]]]:
    """Collect the signals that end a program; each makes the yielded descriptor readable.

    Outside the main thread, where Python delivers no signals, the list stays empty.
    """
    received: list[int] = []
    alarm_fd, ring_fd = os.pipe()
    os.set_blocking(ring_fd, False)

    def ring(number: int, _frame: FrameType | None) -> None:
        received.append(number)
        with contextlib.suppress(BlockingIOError):
            os.write(ring_fd, b"!")

    is_main = threading.current_thread() is threading.main_thread()
    numbers = ENDING if is_main else ()
    previous = {number: signal.signal(number, ring) for number in numbers}
    try:
        yield alarm_fd, received
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
        os.close(alarm_fd)
        os.close(ring_fd)
