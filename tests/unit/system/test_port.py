from __future__ import annotations

import contextlib
import errno
import os
import socket
import tty

import pytest

from lss_motion.errors import BlockedPortError, BusError
from lss_motion.system.port import BLOCKED_NS, HELD_MAX_BYTES, Outbox, SerialPort
from lss_motion.system.reactor import wait_for
from lss_motion.units import line_time_ns

BPS = 115200
S = 1_000_000_000


class PtyDevice:
    """Takes at most `room` bytes at once; they stay in it until `leave`."""

    def __init__(self, room=1 << 20):
        self.room = room
        self.taken = b""
        self.waiting = 0
        self.outbox = Outbox("test://", BPS, self._take, lambda: self.waiting)

    def _take(self, data):
        count = min(self.room, len(data))
        self.taken += data[:count]
        self.waiting += count
        return count

    def leave(self, count):
        self.waiting -= count


@pytest.fixture
def terminal():
    """A pseudo-terminal: the descriptor of its other end, and the path of its device."""
    other_fd, fd = os.openpty()
    tty.setraw(fd)
    yield other_fd, os.ttyname(fd)
    os.close(other_fd)
    os.close(fd)


def test_bytes_go_to_a_device_and_come_from_it(terminal):
    other_fd, path = terminal
    with contextlib.closing(SerialPort(path, 115200)) as port:
        assert port.read() == b""
        port.write(b"#5QD\r")
        assert os.read(other_fd, 100) == b"#5QD\r"
        os.write(other_fd, b"*5QD0\r")
        assert wait_for([port.fileno()], 5.0)
        assert port.read() == b"*5QD0\r"
        assert port.next_arrival_ns() is None


@pytest.fixture
def network_port():
    """A port at another computer, which takes all and sends nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = SerialPort(f"socket://127.0.0.1:{server.getsockname()[1]}", 115200)
        yield port
        port.close()


@pytest.mark.parametrize("action", ["write", "read"])
def test_a_port_that_is_lost_is_a_bus_error(action, network_port, monkeypatch):
    def fail(_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(network_port._serial, action, fail)
    with pytest.raises(BusError, match="lost port socket://"):
        network_port.write(b"#254H\r") if action == "write" else network_port.read()


def test_closing_twice_is_no_error(network_port):
    network_port.close()
    network_port.close()


def test_bytes_without_room_are_held_and_leave_in_order():
    device = PtyDevice(room=3)
    device.outbox.write(b"#1D10", 0)
    device.outbox.write(b"T5\r", 1)
    assert (device.taken, device.outbox.held_bytes) == (b"#1D10T", 2)
    device.room = 100
    device.outbox.flush(2)
    assert (device.taken, device.outbox.held_bytes) == (b"#1D10T5\r", 0)


@pytest.mark.parametrize("room", [0, 1 << 20])
def test_a_port_from_which_no_byte_leaves_is_lost_after_a_bounded_time(room):
    """Whether the bytes stay in this program or in the buffer of the system."""
    device = PtyDevice(room=room)
    device.outbox.write(b"#1QD\r", 0)
    bound_ns = BLOCKED_NS + line_time_ns(5, BPS)
    device.outbox.flush(bound_ns - 50_000_000)
    with pytest.raises(BlockedPortError, match="takes no bytes"):
        device.outbox.flush(bound_ns)
    assert device.outbox.held_bytes == 0


def test_a_slow_port_is_not_lost():
    device = PtyDevice(room=0)
    for second in range(20):
        device.outbox.write(b"0123456789", second * S)
        device.room = 1
        device.outbox.flush(second * S + 900_000_000)
        device.room = 0
        device.leave(device.waiting)
    assert device.outbox.held_bytes == 180


def test_a_driver_that_always_reports_some_bytes_is_not_blocked():
    device = PtyDevice()
    for second in range(20):
        device.outbox.write(b"0123456789", 3 * second * S)
        device.outbox.flush(3 * second * S + S // 2)
        device.leave(device.waiting - 4)
        device.outbox.flush(3 * second * S + 2 * S)


def test_a_driver_that_stops_after_it_worked_is_blocked():
    device = PtyDevice()
    for tenth in range(20):
        device.outbox.write(b"0123456789", tenth * S // 10)
        device.leave(device.waiting)
    for tenth in range(20, 25):
        device.outbox.write(b"0123456789", tenth * S // 10)
    with pytest.raises(BlockedPortError):
        device.outbox.write(b"0123456789", 28 * S // 10)


def test_what_is_held_is_bounded():
    device = PtyDevice(room=0)
    device.outbox.write(bytes(HELD_MAX_BYTES), 0)
    with pytest.raises(BlockedPortError):
        device.outbox.write(b"#", 0)
