"""`lss-motion walk` in a terminal of its own, over a pseudo-terminal, judged at the servos."""

from __future__ import annotations

import os
import pty
import shutil
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from lss_motion.planning import shows
from lss_motion.sim.bus import bus_from_robot
from tests.pty.test_careful import read_until
from tests.served_bus import ServedBus
from tests.timed_moves import is_move

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

EXAMPLE = Path(__file__).resolve().parents[2] / "sequences" / "quadruped_trot.yaml"
APPROACH_MOVES = 12
IN_FRONT = """
import os, sys
os.setsid()
os.close(os.open(os.ttyname(0), os.O_RDWR))
from lss_motion.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
"""Runs `lss-motion` with the terminal as its own, as a shell's job in the foreground has it."""


@contextmanager
def walking(folder, *options, consent="--yes", stderr=subprocess.PIPE):
    """Serve the quadruped, and steer it from a terminal; yields bus, process and its keyboard."""
    options = [*options, consent] if consent else options
    (folder / "robots").mkdir()  # What is learnt about the robot stands beside its file.
    gait = shutil.copy(EXAMPLE, folder)
    shutil.copy(EXAMPLE.parent / "robots" / "quadruped.yaml", folder / "robots")
    _, robot = shows.load_gait(EXAMPLE, None)
    bus = bus_from_robot(robot, "main", seed=1)
    bus.record()
    served = ServedBus(bus, folder / "port")
    keyboard, terminal = pty.openpty()
    command = [sys.executable, "-c", IN_FRONT, "walk", str(gait), "--port",
               str(folder / "port"), *options]  # fmt: skip
    process = subprocess.Popen(
        command,
        stdin=terminal,
        stdout=subprocess.PIPE,
        stderr=stderr,
        text=True,
    )
    try:
        yield bus, process, keyboard
    finally:
        process.kill()
        process.communicate()
        os.close(keyboard)
        os.close(terminal)
        served.unplug()


def wait_for(process, text):
    for line in process.stdout:
        if text in line:
            return
    pytest.fail(f"it never said {text!r}: {process.stderr.read()}")


def wait_for_moves(bus, count):
    """Wait, without looking at the clock, until the servos have received so many moves."""
    turn = threading.Event()
    while sum(is_move(line) for _, line in bus.lines) < count:
        turn.wait(0.01)


def horns_at_the_end(bus):
    end_ns = bus.lines[-1][0]
    return bus.horn_deg(np.arange(end_ns - 100_000_000, end_ns, 10_000_000))


def test_keys_make_it_walk_and_an_interrupt_brings_it_to_its_stand(tmp_path):
    with walking(tmp_path, "--no-feedback", "--force") as (bus, process, keyboard):
        wait_for(process, "playing")
        wait_for_moves(bus, APPROACH_MOVES)
        os.write(keyboard, b"ww")
        wait_for(process, "15 mm/s forward")
        wait_for_moves(bus, APPROACH_MOVES + 100)
        os.write(keyboard, b"\x03")
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 130, errors
        assert errors == ""
        received = [line.rstrip(b"\r") for _, line in bus.lines]
        assert received[-1] == b"#254H"
        stand_deg = approached(bus)
        last = horns_at_the_end(bus)
        assert np.ptp(last, axis=0).max() < 0.2
        assert np.abs(last[-1] - stand_deg).max() < 0.6


def approached(bus):
    """Return where the approach, the first move of every servo, was to lead, by servo."""
    targets = {}
    for _, line in bus.lines:
        if is_move(line):
            servo, rest = line[1:].split(b"D")
            targets.setdefault(int(servo), int(rest.split(b"T")[0]) / 10.0)
    _, robot = shows.load_gait(EXAMPLE, None)
    return np.array([targets[joint.servo_id] for joint in robot.joints.values()])


def test_q_ends_in_the_stand_too(tmp_path):
    with walking(tmp_path, "--no-feedback", "--force", "--quiet") as (bus, process, keyboard):
        wait_for_moves(bus, APPROACH_MOVES)
        os.write(keyboard, b"w\x1b[D")
        wait_for_moves(bus, APPROACH_MOVES + 100)
        os.write(keyboard, b"q")
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 0, errors
        assert np.abs(horns_at_the_end(bus)[-1] - approached(bus)).max() < 0.6
        assert (tmp_path / "robots" / "quadruped.learnt.yaml").exists(), "it is offered no more"


def test_a_first_walk_offers_a_careful_run_of_every_joint(tmp_path):
    with walking(tmp_path, consent="", stderr=subprocess.STDOUT) as (bus, process, keyboard):
        said = read_until(process, "go? [y/N] ")
        assert "Press c for a\ncareful run first" in said
        os.write(keyboard, b"c")
        said = read_until(process, "Begin? [y/N] ")
        assert said.count("deg and back, at most") == APPROACH_MOVES
        os.write(keyboard, b"n\n")
        said, _ = process.communicate(timeout=60)
        assert process.returncode == 130, said
        assert "no: nothing was moved" in said
        assert not any(is_move(line) for _, line in bus.lines)
