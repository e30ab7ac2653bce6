"""What the maker's own hardware tests send, and what they require in reply (summer of 2021).

They ran on firmware 369 or a pre-release of 370. Each line of theirs ends with two CR.
"""

from __future__ import annotations

import re

import pytest

from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.sim.bus import SimBus
from lss_motion.sim.physics import Physics, ServoSpec

QUERIES = (
    "ID", "B", "D", "DT", "P", "WD", "WR", "VT", "MD", "S", "EM", "O", "AR", "AS", "AH", "HD",
    "AA", "AD", "G", "LE", "LP", "LN", "CSL", "FPC", "MMD", "IPE", "SD", "SR", "V", "T", "C",
    "MS", "F", "N", "M", "LED", "LB", "PO", "IS", "RIS", "CR", "TQM", "Y",
)  # fmt: skip
SINCE_369 = {"VT", "MD", "HD", "LE", "LP", "LN", "CSL", "M", "PO", "IS", "RIS", "CR", "TQM", "Y"}
CHANGES = (
    ("EM0", "EM", 0), ("CEM1", "EM", 1), ("O1000", "O", 1000), ("CO0", "O", 0),
    ("AR3600", "AR", 3600), ("CAR1800", "AR", 1800), ("AS4", "AS", 4), ("CAS0", "AS", 0),
    ("AH0", "AH", 0), ("CAH4", "AH", 4), ("AA0", "AA", 0), ("CAA100", "AA", 100),
    ("AD0", "AD", 0), ("CAD100", "AD", 100), ("G-1", "G", -1), ("CG1", "G", 1),
    ("FPC10", "FPC", 10), ("CFPC5", "FPC", 5), ("MMD500", "MMD", 500), ("MMD1023", "MMD", 1023),
    ("SD100", "SD", 100), ("CSD200", "SD", 200), ("SR10", "SR", 10), ("CSR20", "SR", 20),
    ("CLED2", "LED", 2), ("CB115200", "B", 115200), ("CB921600", "B", 921600),
)  # fmt: skip
RANGES = {"V": (0, 14000), "T": (0, 1000), "LED": (0, 7), "ID": (0, 254), "B": (9600, 921600)}


class MakersBench:
    def __init__(self, firmware: int):
        spec = ServoSpec(servo_id=5, model=SERVO_MODELS["LSS-HS1"])
        physics = Physics(corrupt_reply_ratio=0.0)
        self.bus = SimBus([spec], baud_bps=115200, firmware=firmware, physics=physics)
        self.now_ns = 0
        self.bus.advance(0)

    def write(self, command: str, servo_id: int = 5) -> None:
        self.bus.write(f"#{servo_id}{command}\r\r".encode(), self.now_ns)
        self.wait_s(0.005)

    def read(self, command: str, servo_id: int = 5) -> str:
        self.write(command, servo_id)
        self.wait_s(0.005)
        return self.bus.read(self.now_ns).decode()

    def wait_s(self, duration_s: float) -> None:
        self.now_ns += round(duration_s * 1e9)
        self.bus.advance(self.now_ns)


@pytest.mark.parametrize("firmware", [368, 369, 370])
@pytest.mark.parametrize("word", QUERIES)
def test_each_query_is_answered_under_its_name_by_the_firmware_that_has_it(firmware, word):
    reply = MakersBench(firmware).read(f"Q{word}")
    if firmware == 368 and word in SINCE_369:
        assert reply == ""
        return
    match = re.fullmatch(rf"\*5Q{word}(-?[0-9]*|LSS-HS1)\r", reply)
    assert match, reply
    if word in RANGES:
        assert RANGES[word][0] <= int(match[1]) <= RANGES[word][1]


@pytest.mark.parametrize(("command", "word", "value"), CHANGES)
def test_each_change_is_read_back(command, word, value):
    bench = MakersBench(370)
    bench.write(command)
    assert bench.read(f"Q{word}") == f"*5Q{word}{value}\r"


def test_moves_arrive_within_the_time_and_tolerance_of_the_tests():
    bench = MakersBench(369)
    for target in (0, 900, 0):
        bench.write(f"D{target}")
        bench.wait_s(0.8)
        assert abs(int(bench.read("QD")[4:]) - target) <= 10


@pytest.mark.parametrize(
    ("command", "query", "speed", "within"), [("WD100", "QSD2", 100, 5), ("WR10", "QSR2", 10, 1)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_wheel_reports_its_present_speed_with_its_sign(command, query, speed, within, sign):
    bench = MakersBench(369)
    bench.write(command if sign == 1 else command.replace("1", "-1", 1))
    bench.wait_s(0.5)
    reply = bench.read(query)
    assert reply.startswith(f"*5{query[:-1]}")
    assert int(reply[5:]) == pytest.approx(sign * speed, abs=within)


@pytest.mark.parametrize("command", ["RDM200", "SCSL300", "CHD20", "CLN-500", "CLP500", "CLE1"])
def test_369_has_commands_that_368_has_not(command):
    word = {"RDM": "MD", "SCS": "CSL", "CHD": "HD", "CLN": "LN", "CLP": "LP", "CLE": "LE"}
    query, value = f"Q{word[command[:3]]}", re.sub("[A-Z]+", "", command)
    for firmware, reply in ((369, f"*5{query}{value}\r"), (368, "")):
        bench = MakersBench(firmware)
        bench.write(command)
        assert bench.read(query) == reply


def test_an_acknowledging_servo_repeats_what_it_received():
    bench = MakersBench(369)
    assert bench.read("D100") == ""
    assert bench.read("ECR1") == ""
    assert bench.read("QCR") == "*5QCR1\r"
    assert bench.read("D900") == "*5D900\r"
    assert bench.read("CSD500") == "*5CSD500\r"
    assert bench.read("QD").startswith("*5QD")
    assert bench.read("D800", servo_id=254) == "", "all servos would send at once"
    assert bench.read("QDT") == "*5QDT800\r"
    assert bench.read("ECR0") == "*5ECR0\r"
    assert bench.read("D100") == ""
    bench.write("ECR1")
    bench.write("RESET")
    bench.wait_s(1.5)
    assert bench.read("D100") == ""


@pytest.mark.parametrize(
    ("command", "query"),
    [("Y1", "QY"), ("PO50", "QPO"), ("CPO-50", "QPO"), ("TQM500", "QTQM"), ("CGM500", "QTQM")],
)
def test_private_settings_are_kept(command, query):
    bench = MakersBench(369)
    bench.write(command)
    value = command.lstrip("CGPOYTQM")
    assert bench.read(query) == f"*5{query}{value}\r"
