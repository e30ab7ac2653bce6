"""Which ports are opened: what a robot file of a stranger names must be a serial line."""

from __future__ import annotations

import os
import pty
import socket

import pytest

from lss_motion.errors import BusError
from lss_motion.playing.connection import connect
from lss_motion.robot.model import Bus
from lss_motion.system import devices
from lss_motion.system.devices import SerialDevice, opened_name


@pytest.fixture
def terminal():
    """The path of a pseudo-terminal, as `lss-motion sim` has one."""
    other_fd, fd = os.openpty()
    yield os.ttyname(fd)
    os.close(other_fd)
    os.close(fd)


def test_a_terminal_is_opened_by_its_path_and_by_links_to_it(terminal, tmp_path):
    (tmp_path / "one").symlink_to(terminal)
    (tmp_path / "two").symlink_to(tmp_path / "one")
    for path in (terminal, str(tmp_path / "one"), str(tmp_path / "two")):
        assert opened_name(path) == path


@pytest.mark.parametrize("url", ["socket://[::1]:4001", "SOCKET://shop:4001", "rfc2217://h:2217",
                                 "rfc2217://h:2217?ign_set_control&timeout=2"])  # fmt: skip
def test_a_line_behind_another_computer_is_a_port(url):
    assert opened_name(url) == url


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("/dev/no-such-port", "there is no such device"),
        ("no/such/path", "there is no such device"),
        (__file__, "that is no serial device"),
        ("/", "that is no serial device"),
        ("/dev/null", "that is no serial device"),
        ("/dev/zero", "that is no serial device"),
        ("/dev/ptmx", "that is no serial device"),
        ("a\0b", "that is no serial device"),
        ("", "there is no such device|that is no serial device"),
        ("loop://", "loop:// is no serial line"),
        ("alt://", "alt:// is no serial line"),
        ("alt:///dev/ttyS0?class=PosixPollSerial", "alt:// is no serial line"),
        ("spy:///dev/ttyS0?raw", "spy:// is no serial line"),
        ("SPY:///dev/ttyS0?file=x", "SPY:// is no serial line"),
        ("cp2110://", "cp2110:// is no serial line"),
        ("file:///etc/passwd", "file:// is no serial line"),
        ("nosuch://", "nosuch:// is no serial line"),
        ("://", ":// is no serial line"),
        ("socket://", "it needs a computer and a port"),
        ("socket://host", "it needs a computer and a port"),
        ("socket://host:99999", "it needs a computer and a port"),
        ("socket://host:1/path", "it needs a computer and a port"),
        ("socket://[:1", "it needs a computer and a port"),
        ("socket://host:1?logging=debug", "the option 'logging' is not supported"),
        ("rfc2217://host:1?logging=debug", "the option 'logging' is not supported"),
        ("hwgrep://", "no serial device is described by ''"),
        ("hwgrep://(", "no serial device is described by"),
        ("hwgrep://(a+)+$&n=x", "the text is no pattern and has no options"),
    ],
)
def test_what_can_be_no_serial_line_is_refused_by_name(url, said):
    with pytest.raises(BusError, match=said) as caught:
        opened_name(url)
    assert caught.value.url == url
    assert url in str(caught.value)


def test_no_file_is_written_and_no_device_opened(tmp_path):
    kept = tmp_path / "kept"
    kept.write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(tmp_path / "socket"))
    urls = [f"spy:///dev/null?file={kept}", f"spy://loop://?file={kept}", str(kept),
            str(tmp_path / "pipe"), str(tmp_path / "socket"), str(tmp_path)]  # fmt: skip
    for url in urls:
        with pytest.raises(BusError):
            connect({"main": Bus(name="main", port=url, baud_bps=115200, firmware=370)})
    server.close()
    assert kept.read_text() == "mine"


def test_one_port_that_is_refused_leaves_all_others_closed(terminal, monkeypatch):
    ports = {"good": terminal, "bad": "spy:///dev/null?file=x"}
    buses = {
        name: Bus(name=name, port=port, baud_bps=115200, firmware=370)
        for name, port in ports.items()
    }
    monkeypatch.setattr("lss_motion.playing.connection.SerialPort", None)
    with pytest.raises(BusError, match="spy:// is no serial line"):
        connect(buses)


FOUND = [
    SerialDevice(
        path="/dev/ttyUSB0", name="FTDI FT232R (A50285)", is_usb=True, hardware="0403:6001"
    ),
    SerialDevice(
        path="/dev/ttyUSB1", name="FTDI FT232R (B11111)", is_usb=True, hardware="0403:6001"
    ),
]


def test_a_usb_device_is_found_by_a_part_of_its_name_if_it_is_the_only_one(terminal, monkeypatch):
    ours = SerialDevice(path=terminal, name="FTDI FT232R (C.3)", is_usb=True, hardware="0403:6002")
    monkeypatch.setattr(devices, "list_devices", lambda: [*FOUND, ours])
    for text in ("c.3", "0403:6002"):
        assert opened_name(f"hwgrep://{text}") == terminal
    with pytest.raises(BusError, match=r"/dev/ttyUSB0 and /dev/ttyUSB1 and .* are described by"):
        opened_name("hwgrep://FTDI")
    for text in ("C.*3", "cx3"):
        with pytest.raises(BusError, match="no serial device is described by"):
            opened_name(f"hwgrep://{text}")


def test_the_terminal_of_the_person_is_no_port():
    pid, fd = pty.fork()
    if pid == 0:
        try:
            opened_name(os.ttyname(0))
        except BusError as error:
            os.write(1, str(error).encode())
        os._exit(0)
    said = b""
    while data := _read(fd):
        said += data
    os.waitpid(pid, 0)
    os.close(fd)
    assert b"the terminal in which this command runs" in said


def _read(fd):
    try:
        return os.read(fd, 1000)
    except OSError:  # The other end is closed.
        return b""
