"""What a program written for the maker's protocol sees on the simulated port, in real time."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from lss_motion.errors import InputError
from lss_motion.protocol.family import Family
from lss_motion.robot.model import Bus, Joint, Robot, ServoModel
from lss_motion.sim.pty import serve

pytestmark = pytest.mark.realtime

ST1 = ServoModel(name="LSS-ST1", family=Family.LSS, speed_max_deg_s=360.0, wire_per_deg=10)


def make_robot(servo_ids=(5,), bus_names=("main",), baud_bps=115200) -> Robot:
    buses = {
        name: Bus(name=name, port="sim://", baud_bps=baud_bps, firmware=370) for name in bus_names
    }
    joints = {
        f"{name}{servo_id}": Joint(
            name=f"{name}{servo_id}",
            servo_id=servo_id,
            bus=name,
            model=ST1,
            position_min_deg=-90.0,
            position_max_deg=90.0,
            speed_max_deg_s=180.0,
            accel_max_deg_s2=600.0,
        )
        for name in bus_names
        for servo_id in servo_ids
    }
    return Robot(name="test", path=None, buses=buses, joints=joints)


@contextmanager
def served(robot, link):
    stop, ready = threading.Event(), threading.Event()
    said = []

    def announce(text):
        said.append(text)
        if len(said) == len(robot.buses):
            ready.set()

    thread = threading.Thread(
        target=serve,
        args=(robot, link),
        kwargs={"seed": 1, "announce": announce, "should_stop": stop.is_set},
    )
    thread.start()
    try:
        assert ready.wait(5.0)
        yield said
    finally:
        stop.set()
        thread.join(5.0)
        assert not thread.is_alive()


@contextmanager
def opened(path, baud_bps=115200):
    with serial.Serial(str(path), baud_bps, timeout=0.1) as port:
        yield port


def ask(port, line):
    port.write(f"{line}\r".encode())
    return port.read_until(b"\r").decode()


def test_a_plain_client_asks_and_moves(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(), link) as said, opened(link) as port:
        assert "5 simulated" not in said[0]
        assert "1 simulated servo" in said[0]
        assert "115200" in said[0]
        assert ask(port, "#5QMS") == "*5QMSLSS-ST1\r"
        port.write(b"#5QD\r#5QV\r#5Q\r")
        answers = [port.read_until(b"\r") for _ in range(3)]
        assert [answer[:3] for answer in answers] == [b"*5Q"] * 3
        assert ask(port, "#254QID") == "*5QID5\r"
        port.write(b"#5D450\r")
        time.sleep(0.8)
        assert abs(int(ask(port, "#5QD")[4:]) - 450) <= 15
        asked_s = time.monotonic()
        port.write(b"#5RESET\r")
        while not ask(port, "#5Q"):
            pass
        assert 1.25 <= time.monotonic() - asked_s < 1.6


def test_a_host_may_close_and_open_again(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(), link):
        for _ in range(3):
            with opened(link) as port:
                assert ask(port, "#5QG") == "*5QG1\r"


def test_a_host_at_another_rate_gets_no_answer(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(), link):
        with opened(link, 9600) as port:
            assert ask(port, "#5QG") == ""
        with opened(link) as port:
            port.write(b"\r")
            assert ask(port, "#5QG") == "*5QG1\r"


def test_every_bus_has_its_own_port_and_no_link_is_left(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(bus_names=("left", "right")), link):
        assert sorted(path.name for path in tmp_path.iterdir()) == ["lss.left", "lss.right"]
        with opened(tmp_path / "lss.left") as left, opened(tmp_path / "lss.right") as right:
            left.write(b"#5LED2\r")
            assert ask(left, "#5QLED") == "*5QLED2\r"
            assert ask(right, "#5QLED") == "*5QLED7\r"
    assert list(tmp_path.iterdir()) == []


def test_a_file_in_the_place_of_the_link_is_kept(tmp_path):
    link = tmp_path / "precious"
    link.write_text("mine")
    with pytest.raises(InputError, match="precious exists"):
        serve(make_robot(), link, seed=1, announce=print, should_stop=lambda: True)
    assert link.read_text() == "mine"


def test_no_client_is_served_faster_than_the_line(tmp_path):
    """18 servos, 20 rounds of QD, each asked when the last has answered."""
    link = tmp_path / "lss"
    servo_ids = tuple(range(1, 19))
    with served(make_robot(servo_ids), link), opened(link) as port:
        bytes_both_ways, started_s = 0, time.monotonic()
        for _ in range(20):
            for servo_id in servo_ids:
                query = f"#{servo_id}QD"
                bytes_both_ways += len(query) + 1 + len(ask(port, query))
        took_s = time.monotonic() - started_s
    line_s = bytes_both_ways * 10 / 115200
    assert took_s >= line_s + 360 * 0.2e-3
    assert took_s <= 3.0 * (line_s + 360 * 0.6e-3)  # only gross lateness: machines are shared


def test_a_client_that_floods_the_port_is_slowed(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(baud_bps=9600), link), opened(link, 9600) as port:
        port.timeout = 10.0
        started_s = time.monotonic()
        port.write(b"#6LED1\r" * 200 + b"#5QG\r")
        assert port.read_until(b"\r") == b"*5QG1\r"
        assert time.monotonic() - started_s >= 1405 * 10 / 9600


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_without_a_trace(tmp_path, number):
    link = tmp_path / "lss"
    program = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
from pathlib import Path
from test_bus_pty import make_robot, serve
def announce(text):
    print(text, flush=True)
print(serve(make_robot(), Path({str(link)!r}), seed=1, announce=announce))
"""
    process = subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert str(link) in process.stdout.readline()
    process.send_signal(number)
    out, errors = process.communicate(timeout=10)
    assert (process.returncode, errors) == (0, "")
    assert out.strip() == str(int(number))
    assert not link.is_symlink()
