"""`lss-motion walk` in a terminal of its own, over a pseudo-terminal, judged at the servos."""

from __future__ import annotations

import shutil
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from served_bus import served_bus

import lss_motion as lss
from lss_motion.planning import shows
from lss_motion.sim.bus import bus_from_robot
from tests.programs import ProgramBeside, terminal_command
from tests.swing import until
from tests.timed_moves import is_move

pytestmark = [pytest.mark.realtime, pytest.mark.slow]

EXAMPLE = Path(__file__).resolve().parents[2] / "sequences" / "quadruped_trot.yaml"
APPROACH_MOVES = 12


@contextmanager
def walking(folder, *options, consent="--yes", merged=False):
    """Serve the quadruped, and steer it from a terminal; yields its bus and the program."""
    options = [*options, consent] if consent else options
    (folder / "robots").mkdir()  # What is learnt about the robot stands beside its file.
    gait = shutil.copy(EXAMPLE, folder)
    shutil.copy(EXAMPLE.parent / "robots" / "quadruped.yaml", folder / "robots")
    _, robot = shows.load_gait(EXAMPLE, None)
    bus = bus_from_robot(robot, "main", seed=1)
    bus.record()
    command = terminal_command("walk", gait, "--port", folder / "port", *options)
    with (
        served_bus(bus, folder / "port"),
        ProgramBeside(command, keys=True, merged=merged) as process,
    ):
        yield bus, process


def wait_for_moves(bus, count):
    """Wait until the servos have received so many moves."""
    until(lambda: sum(is_move(line) for _, line in bus.lines) >= count)


def horns_at_the_end(bus):
    end_ns = bus.lines[-1][0]
    return bus.horn_deg(np.arange(end_ns - 100_000_000, end_ns, 10_000_000))


def test_keys_make_it_walk_and_an_interrupt_brings_it_to_its_stand(tmp_path):
    with walking(tmp_path, "--no-feedback", "--force") as (bus, process):
        process.wait_for("playing")
        wait_for_moves(bus, APPROACH_MOVES)
        process.press("ww")
        process.wait_for("15 mm/s forward")
        wait_for_moves(bus, APPROACH_MOVES + 100)
        process.press("\x03")
        assert process.ended() == 130, process.errors
        assert process.errors == ""
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
    with walking(tmp_path, "--no-feedback", "--force", "--quiet") as (bus, process):
        wait_for_moves(bus, APPROACH_MOVES)
        process.press("w\x1b[D")
        wait_for_moves(bus, APPROACH_MOVES + 100)
        process.press("q")
        assert process.ended() == 0, process.errors
        assert np.abs(horns_at_the_end(bus)[-1] - approached(bus)).max() < 0.6
        assert (tmp_path / "robots" / "quadruped.learnt.yaml").exists(), "it is offered no more"


def test_a_first_walk_offers_a_careful_run_of_every_joint(tmp_path):
    with walking(tmp_path, consent="", merged=True) as (bus, process):
        said = process.wait_for(r"go\? \[y/N\] ")
        assert "Press c for a\ncareful run first" in said
        process.press("c")
        said = process.wait_for(r"Begin\? \[y/N\] ")
        assert said.count("deg and back, at most") == APPROACH_MOVES
        process.press("n\n")
        assert process.ended() == 130, process.said
        assert "no: nothing was moved" in process.said
        assert not any(is_move(line) for _, line in bus.lines)


def test_a_program_in_python_makes_it_walk_and_leaves_it_in_its_stand(tmp_path):
    _, robot = shows.load_gait(EXAMPLE, None)
    bus = bus_from_robot(robot, "main", seed=1)
    bus.record()
    with (
        served_bus(bus, tmp_path / "port"),
        lss.walk(EXAMPLE, port=str(tmp_path / "port")) as walk,
    ):
        next(e for e in walk.events(60) if e.event == "phase" and e.phase == "playing")
        wait_for_moves(bus, APPROACH_MOVES)
        with pytest.raises(lss.InputError, match="turn_deg_s is nan"):
            walk.steer(turn_deg_s=float("nan"))
        walk.steer(forward_mm_s=1000.0)  # As fast as it can.
        wait_for_moves(bus, APPROACH_MOVES + 100)
        walk.pause()
        refused = next(e for e in walk.events(60) if e.event == "refused")
        assert "the robot is led" in refused.text
        walk.stop()
        assert walk.wait(60).outcome == "stopped"
    last = horns_at_the_end(bus)
    assert np.ptp(last, axis=0).max() < 0.2
    assert np.abs(last[-1] - approached(bus)).max() < 0.6
