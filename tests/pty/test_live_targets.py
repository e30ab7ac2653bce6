"""Targets that a program sets in real time, on servos behind a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest

import lss_motion as lss
from tests.swing import WAIT_S, until

pytestmark = pytest.mark.realtime

ARM = {
    "robot": "arm",
    "buses": {"main": {"port": "./port"}},
    "joints": {
        name: {
            "id": number,
            "model": "LSS-ST1",
            "range_deg": [-90, 90],
            "speed_max_deg_s": 120,
            "accel_max_deg_s2": 600,
        }
        for number, name in enumerate("ab", start=1)
    },
}
LEADS = """\
import json, sys, time
import lss_motion as lss
with lss.connect(lss.load_robot(json.loads(sys.argv[1]))) as live:
    while True:
        live.set_target({"a": 80})
        print("leads", flush=True)
        time.sleep(0.05)
"""


def horn_deg(bus, servo=0):
    return float(bus.horn_deg([time.monotonic_ns()])[0][servo])


def test_joints_follow_and_the_robot_is_taken_back(on_terminal, servo):
    with on_terminal(servo(1), servo(2)) as bus, lss.connect(lss.load_robot(ARM)) as live:
        live.set_target({"a": 30.0, "b": 1e9})
        began_s = time.monotonic()
        while time.monotonic() < began_s + WAIT_S and abs(live.read()["b"] - 90.0) > 0.5:
            live.set_target({"a": 30.0})
            time.sleep(0.02)
        assert live.read()["b"] == pytest.approx(90.0, abs=0.5)
        assert "following" in repr(live)
        live.hold()
        assert live.read() == pytest.approx({"a": 30.0, "b": 90.0}, abs=0.5)
        assert live.move_to({"b": 80.0}) > 0.0
        live.set_target({"b": 70.0})
        with pytest.raises(lss.InputError, match="did you mean"):
            live.set_target({"aa": 3.0})
    assert not live.warnings
    moves = [line for _, line in bus.lines if line.startswith(b"#2D")]
    assert moves[-1].startswith(b"#2D")
    assert bus.lines[-1][1] in {b"#254H\r", b"#254H"}


@pytest.mark.slow
def test_a_program_that_is_killed_leaves_joints_that_brake_and_hold(on_terminal, servo):
    import json

    with on_terminal(servo(1), servo(2)) as bus:
        program = subprocess.Popen(
            [sys.executable, "-c", LEADS, json.dumps(ARM)], stdout=subprocess.PIPE, text=True
        )
        assert program.stdout is not None
        assert program.stdout.readline() == "leads\n"
        assert until(lambda: horn_deg(bus) > 20.0)
        os.kill(program.pid, signal.SIGKILL)
        program.wait(WAIT_S)
        program.stdout.close()
        time.sleep(1.0)
        stopped_deg = horn_deg(bus)
        time.sleep(0.3)
        assert horn_deg(bus) == pytest.approx(stopped_deg, abs=0.05)
        assert stopped_deg < 75.0


def test_virtual_time_has_no_targets():
    with (
        lss.connect(lss.load_robot(ARM), port="sim://", is_virtual=True) as live,
        pytest.raises(lss.InputError, match="real time"),
    ):
        live.set_target({"a": 10.0})
