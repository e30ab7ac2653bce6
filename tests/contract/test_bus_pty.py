"""What a program written for the maker's protocol sees on the simulated port, in real time."""

from __future__ import annotations

import re
import signal
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest
import serial

from lss_motion.errors import InputError
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.robot.model import Bus, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.pty import serve
from tests.joints import joint
from tests.programs import ProgramBeside

pytestmark = pytest.mark.realtime

ST1 = SERVO_MODELS["LSS-ST1"]


def make_robot(servo_ids=(5,), bus_names=("main",), baud_bps=115200) -> Robot:
    buses = {
        name: Bus(name=name, port="sim://", baud_bps=baud_bps, firmware=370) for name in bus_names
    }
    joints = {
        f"{name}{servo_id}": joint(f"{name}{servo_id}", servo_id, bus=name, model=ST1)
        for name in bus_names
        for servo_id in servo_ids
    }
    return Robot(name="test", path=None, buses=buses, joints=joints)


@contextmanager
def served(robot, link, **options):
    stop, ready = threading.Event(), threading.Event()
    said = []

    def announce(text):
        said.append(text)
        if len(said) == len(robot.buses):
            ready.set()

    thread = threading.Thread(
        target=serve,
        args=(robot, link),
        kwargs={"seed": 1, "announce": announce, "should_stop": stop.is_set, **options},
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


@pytest.mark.slow
@pytest.mark.parametrize("baud_bps", [57600, 250000])
def test_a_servo_answers_at_the_rate_that_it_was_set_to_after_its_reset(tmp_path, baud_bps):
    link = tmp_path / "lss"
    with served(make_robot(), link):
        with opened(link) as port:
            port.write(f"#5CB{baud_bps}\r#5RESET\r".encode())
            time.sleep(1.5)
            assert ask(port, "#5QG") == ""
        with opened(link, baud_bps) as port:
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
    with pytest.raises(InputError, match="precious exists already"):
        serve(make_robot(), link, seed=1, announce=print, should_stop=lambda: True)
    assert link.read_text() == "mine"


def test_a_link_that_a_killed_simulator_left_is_replaced(tmp_path):
    link = tmp_path / "lss"
    link.symlink_to("/dev/pts/999999")
    with served(make_robot(), link), opened(link) as port:
        assert ask(port, "#5QLED") == "*5QLED7\r"
    assert not link.is_symlink()


@pytest.mark.slow
def test_no_client_is_served_faster_than_the_line(tmp_path):
    """18 servos, 20 rounds of QD, each asked when the last has answered.

    That none is served much slower is judged by `tools/bench.py loop`: a test machine is busy.
    """
    link = tmp_path / "lss"
    servo_ids = tuple(range(1, 19))
    line_s, rounds = 0.0, 20
    with served(make_robot(servo_ids), link), opened(link) as port:
        port.timeout = 10.0  # A busy machine may answer late; a query before that collides.
        started_s = time.monotonic()
        for servo_id in servo_ids * rounds:
            query = f"#{servo_id}QD"
            line_s += (len(query) + 1 + len(ask(port, query))) * 10 / 115200
        taken_s = time.monotonic() - started_s
    assert taken_s >= line_s + 18 * rounds * 0.2e-3


@pytest.mark.slow
def test_the_speed_of_a_wheel_is_reached_within_half_a_second(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(), link), opened(link) as port:
        for command, question, speed in (("WD900", "QWD", 900), ("WR40", "QWR", 40)):
            port.write(f"#5{command}\r".encode())
            time.sleep(0.5)
            assert int(ask(port, f"#5{question}")[5:]) == pytest.approx(speed, abs=speed // 50)
        port.write(b"#5H\r")


def test_a_relative_move_starts_where_the_horn_is(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(), link), opened(link) as port:
        port.write(b"#5D-200\r")
        time.sleep(0.6)
        port.write(b"#5MD300\r")
        time.sleep(0.8)
        assert int(ask(port, "#5QD")[4:]) == pytest.approx(100, abs=5)


def test_two_commands_in_one_line_without_a_return_between_them(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot((5, 6)), link), opened(link) as port:
        port.write(b"#254FPC7#254CAS-6\r")
        for servo_id in (5, 6):
            assert ask(port, f"#{servo_id}QFPC") == f"*{servo_id}QFPC7\r"
            assert ask(port, f"#{servo_id}QAS1") == f"*{servo_id}QAS-6\r"


KEPT = {
    "O": (-24, 100), "AR": (1200, 3600), "SD": (900, 1800), "SR": (12, 30), "LED": (3, 5),
    "G": (-1, 1), "AS": (-4, 2), "AH": (3, -2), "AA": (30, 60), "AD": (40, 70), "EM": (0, 1),
    "FPC": (3, 10), "HD": (20, 40), "ABR": (1, 0), "PO": (-50, 50),
}  # fmt: skip
"""Settings with a session and a configured value: two values of each."""

ONLY_KEPT = {
    "CFD": 300, "CFP": 1600, "CLB": 12, "CLE": 1, "CLP": 900, "CLN": -900, "CB": 57600,
    "CIS": 3, "CRIS": 5,
}  # fmt: skip
"""Settings that are configured only, and what they are set to."""

ONLY_SESSION = {
    "MMD": 600, "IPE": 0, "SCSL": 300, "SLOTCOUNT": 4, "SLOT": 2, "PROTOCOL": 1, "Y": 1, "TQM": 500
}  # fmt: skip
"""Settings that a session forgets."""


@pytest.mark.slow
def test_every_setting_of_the_session_and_of_the_memory_is_read_back(tmp_path):
    told = {"CLB": "QLB", "SCSL": "QCSL"}
    table = LSS_TABLE.rows
    settings = {row.name for row in table if (row.actions or row.configs) and row.queries}
    tried = {*KEPT, *(key[1:] for key in ONLY_KEPT), *ONLY_SESSION} | {"CSL", "ID"}
    moving = {"P", "D", "WD", "WR", "MD_RAW", "CR"}
    assert settings - moving == tried - {"SCSL"}
    link = tmp_path / "lss"
    with served(make_robot(), link), opened(link) as port:
        for name, (configured, session) in KEPT.items():
            port.write(f"#5C{name}{configured}\r".encode())
            assert ask(port, f"#5Q{name}") == f"*5Q{name}{configured}\r"
            port.write(f"#5{name}{session}\r".encode())
            assert ask(port, f"#5Q{name}") == f"*5Q{name}{session}\r"
            assert ask(port, f"#5Q{name}1") == f"*5Q{name}{configured}\r"
        for keyword, value in {**ONLY_KEPT, **ONLY_SESSION}.items():
            is_config = keyword in ONLY_KEPT
            query = told.get(keyword, "Q" + (keyword[1:] if is_config else keyword))
            port.write(f"#5{keyword}{value}\r".encode())
            assert ask(port, f"#5{query}") == f"*5{query}{value}\r"
        port.write(b"#5CB115200\r#5CID7\r#5RESET\r")
        time.sleep(1.35)
        assert ask(port, "#7QID") == "*7QID7\r"
        for name, (configured, _) in KEPT.items():
            wanted = KEPT["SR"][0] * 60 if name == "SD" else configured
            assert ask(port, f"#7Q{name}") == f"*7Q{name}{wanted}\r"
        assert ask(port, "#7QPROTOCOL") == "*7QPROTOCOL0\r"


def test_a_slow_adapter_delivers_in_batches(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(), link, usb_latency_ns=16_000_000), opened(link) as port:
        started_s = time.monotonic()
        for _ in range(30):
            assert ask(port, "#5QG") == "*5QG1\r"
        assert time.monotonic() - started_s >= 29 * 0.016


def test_an_unplugged_port_is_gone_and_comes_back_behind_the_same_link(tmp_path):
    link = tmp_path / "lss"
    fault = Fault(kind=FaultKind.UNPLUGGED, at_s=0.6, until_s=1.2)
    with served(make_robot(), link, faults=[fault]) as said:
        with opened(link) as port:
            assert ask(port, "#5QG") == "*5QG1\r"
            time.sleep(0.8)
            assert not link.exists()
            with pytest.raises(serial.SerialException):
                ask(port, "#5QG")
        time.sleep(0.7)
        with opened(link) as port:
            assert ask(port, "#5QG") == "*5QG1\r"
        assert [text.split(":")[1][:10] for text in said[1:]] == [" unplugged", f" {link}"[:10]]


@pytest.mark.slow
def test_a_client_that_floods_the_port_is_slowed(tmp_path):
    link = tmp_path / "lss"
    with served(make_robot(baud_bps=9600), link), opened(link, 9600) as port:
        port.timeout = 10.0
        started_s = time.monotonic()
        port.write(b"#6LED1\r" * 200 + b"#5QG\r")
        assert port.read_until(b"\r") == b"*5QG1\r"
        assert time.monotonic() - started_s >= 1405 * 10 / 9600


@pytest.mark.slow
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
    with ProgramBeside([sys.executable, "-c", program]) as process:
        process.wait_for(re.escape(str(link)))
        process.send_signal(number)
        assert (process.ended(), process.errors) == (0, "")
    assert process.said.splitlines()[-1] == str(int(number))
    assert not link.is_symlink()
