from __future__ import annotations

import errno

import pytest

from lss_motion.errors import BlockedPortError, BusError
from lss_motion.system.port import BLOCKED_NS, HELD_MAX_BYTES, Outbox, SerialPort
from lss_motion.units import line_time_ns

BPS = 115200
S = 1_000_000_000


class Device:
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


def test_bytes_written_to_a_loop_come_back():
    port = SerialPort("loop://", 115200)
    try:
        assert port.read() == b""
        port.write(b"#5QD\r")
        assert port.read() == b"#5QD\r"
        assert port.fileno() is None
        assert port.next_arrival_ns() is not None
    finally:
        port.close()


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("/dev/no-such-port", "there is no such device"),
        ("nosuch://", "cannot open port nosuch://"),
        (__file__, ": that is no serial device"),
        ("/", ": that is no serial device"),
        ("/dev/null", ": that is no serial device"),
    ],
)
def test_a_port_that_cannot_be_opened_is_named(url, said):
    with pytest.raises(BusError, match=said) as caught:
        SerialPort(url, 115200)
    assert caught.value.url == url
    assert url in str(caught.value)


@pytest.mark.parametrize("action", ["write", "read"])
def test_a_port_that_is_lost_is_a_bus_error(action, monkeypatch):
    port = SerialPort("loop://", 115200)

    def fail(_):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(port._serial, action, fail)
    with pytest.raises(BusError, match="lost port loop://"):
        port.write(b"#254H\r") if action == "write" else port.read()
    port.close()


def test_closing_twice_is_no_error():
    port = SerialPort("loop://", 115200)
    port.close()
    port.close()


def test_bytes_without_room_are_held_and_leave_in_order():
    device = Device(room=3)
    device.outbox.write(b"#1D10", 0)
    device.outbox.write(b"T5\r", 1)
    assert (device.taken, device.outbox.held_bytes) == (b"#1D10T", 2)
    device.room = 100
    device.outbox.flush(2)
    assert (device.taken, device.outbox.held_bytes) == (b"#1D10T5\r", 0)


@pytest.mark.parametrize("room", [0, 1 << 20])
def test_a_port_from_which_no_byte_leaves_is_lost_after_a_bounded_time(room):
    """Whether the bytes stay in this program or in the buffer of the system."""
    device = Device(room=room)
    device.outbox.write(b"#1QD\r", 0)
    bound_ns = BLOCKED_NS + line_time_ns(5, BPS)
    device.outbox.flush(bound_ns - 50_000_000)
    with pytest.raises(BlockedPortError, match="takes no bytes"):
        device.outbox.flush(bound_ns)
    assert device.outbox.held_bytes == 0


def test_a_slow_port_is_not_lost():
    device = Device(room=0)
    for second in range(20):
        device.outbox.write(b"0123456789", second * S)
        device.room = 1
        device.outbox.flush(second * S + 900_000_000)
        device.room = 0
        device.leave(device.waiting)
    assert device.outbox.held_bytes == 180


def test_a_driver_that_always_reports_some_bytes_is_not_blocked():
    device = Device()
    for second in range(20):
        device.outbox.write(b"0123456789", 3 * second * S)
        device.outbox.flush(3 * second * S + S // 2)
        device.leave(device.waiting - 4)
        device.outbox.flush(3 * second * S + 2 * S)


def test_a_driver_that_stops_after_it_worked_is_blocked():
    device = Device()
    for tenth in range(20):
        device.outbox.write(b"0123456789", tenth * S // 10)
        device.leave(device.waiting)
    for tenth in range(20, 25):
        device.outbox.write(b"0123456789", tenth * S // 10)
    with pytest.raises(BlockedPortError):
        device.outbox.write(b"0123456789", 28 * S // 10)


def test_what_is_held_is_bounded():
    device = Device(room=0)
    device.outbox.write(bytes(HELD_MAX_BYTES), 0)
    with pytest.raises(BlockedPortError):
        device.outbox.write(b"#", 0)
