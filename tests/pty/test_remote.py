"""A show that plays in a process of its own, on servos behind a pseudo-terminal."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import pytest

import lss_motion as lss
from lss_motion.playing.remote import handle as module
from tests.programs import ProgramBeside
from tests.swing import WAIT_S, until, write_show

pytestmark = pytest.mark.realtime

PLAYER = """\
import sys, time
import lss_motion as lss
robot = lss.load_robot("arm.yaml")
program = lss.compile(lss.plan(lss.load_sequence("swing.yaml"), robot), robot)
handle = lss.start(program, robot, rule=lss.LossRule("stop", silent_s=1.0))
for event in handle.events():
    if event.event == "phase" and event.phase == "playing":
        print(handle._process.pid, flush=True)
        time.sleep(60)
"""


@pytest.fixture
def show(tmp_path):
    write_show(tmp_path)

    def load():
        robot = lss.load_robot("arm.yaml")
        return lss.compile(lss.plan(lss.load_sequence("swing.yaml"), robot), robot), robot

    return load


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().split(")")[1].split()[0] != "Z"


def wait_for(handle, phase):
    for event in handle.events(WAIT_S):
        if event.event == "phase" and event.phase == phase:
            return
    raise AssertionError(f"never {phase}")


def fail_in_the_show(handle):
    until(handle.readings)
    assert handle.readings()["a"].planned_deg == pytest.approx(0.0, abs=30.1)
    raise ZeroDivisionError


@pytest.mark.slow
def test_an_exception_in_the_block_stops_the_show(on_terminal, servo, show):
    with on_terminal(servo(1)) as bus:
        handle = lss.start(*show())
        with pytest.raises(ZeroDivisionError), handle:
            fail_in_the_show(handle)
        assert handle.wait(WAIT_S).outcome == "stopped"
        assert not handle.is_playing
        assert bus.lines[-1][1] == b"#254H\r"


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_client_that_is_killed_or_stands_still_leaves_a_safe_robot(
    on_terminal, servo, show, number
):
    with on_terminal(servo(1)) as bus:
        with ProgramBeside([sys.executable, "-c", PLAYER]) as client:
            pid = int(client.wait_for(r"\d+\n"))
            time.sleep(1.5)  # While it plays, its beats keep the show going.
            assert is_running(pid)
            client.send_signal(number)
            until(lambda: not is_running(pid))
        assert bus.lines[-1][1] == b"#254H\r"
        assert any(b"EM1" in line for _, line in bus.lines[-10:]), "settings are given back"


def test_a_killed_player_is_an_error_not_a_hang(on_terminal, servo, show):
    with on_terminal(servo(1)):
        handle = lss.start(*show())
        wait_for(handle, "playing")
        os.kill(handle._process.pid, signal.SIGKILL)
        with pytest.raises(lss.BusError, match="without a report"):
            handle.wait(WAIT_S)
        handle.stop()
        handle.close()


def test_a_player_that_stands_still_is_left_and_makes_the_robot_safe_when_it_goes_on(
    on_terminal, servo, show, monkeypatch
):
    monkeypatch.setattr(module, "STOP_S", 0.5)
    with on_terminal(servo(1)) as bus:
        handle = lss.start(*show(), rule=lss.LossRule("go_on", silent_s=0.1))
        wait_for(handle, "playing")
        pid = handle._process.pid
        os.kill(pid, signal.SIGSTOP)
        try:
            for _ in range(20_000):  # More than a socket takes: nobody waits for it.
                handle.rate(0.9)
            with pytest.warns(RuntimeWarning, match="stands still"):
                handle.close()
            assert is_running(pid)
        finally:
            os.kill(pid, signal.SIGCONT)
        until(lambda: not is_running(pid))
        handle.close()
        assert bus.lines[-1][1] == b"#254H\r"


@pytest.mark.slow
def test_a_robot_that_is_not_there_is_raised_by_wait(tmp_path, monkeypatch, show):
    monkeypatch.chdir(tmp_path)
    with lss.start(*show()) as handle:
        with pytest.raises(lss.InputError, match="no keyframe has the label 'wve'"):
            handle.seek("wve")
        with pytest.raises(lss.BusError, match="port"):
            handle.wait(WAIT_S)
