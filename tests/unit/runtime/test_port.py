from __future__ import annotations

import errno

import pytest

from lss_motion.errors import BusError
from lss_motion.runtime.port import SerialPort


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
