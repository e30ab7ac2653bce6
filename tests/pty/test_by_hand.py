"""`record`, `jog` and `calibrate` with keys on a real terminal, servos behind another one."""

from __future__ import annotations

import re
import signal
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest
from served_bus import served_bus

from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence
from lss_motion.sim.bus import bus_from_robot
from lss_motion.sim.hand import HandMotion
from tests.programs import ProgramBeside, terminal_command

pytestmark = pytest.mark.realtime

ROBOT = """\
robot: pair   # two joints
joints:
  # the head
  pan:  {id: 1, model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
  tilt: {id: 2, model: LSS-ST1, range_deg: [-40, 60], speed_max_deg_s: 180, accel_max_deg_s2: 600}
poses:
  home: {pan: 0, tilt: 0}   # straight ahead
"""
SWAY_S = np.arange(0.0, 60.0, 0.05)
SWAY = HandMotion(
    SWAY_S, {"pan": 30.0 * np.sin(SWAY_S), "tilt": 10.0 + 10.0 * np.sin(2.0 * SWAY_S)}
)


@contextmanager
def simulated(folder, hand=None):
    """Serve the robot behind a pseudo-terminal from a thread; yields the bus and `unplug`."""
    (folder / "robot.yaml").write_text(ROBOT)
    bus = bus_from_robot(load_robot(folder / "robot.yaml"), "main", seed=1, hand=hand)
    bus.record()
    with served_bus(bus, folder / "port") as served:
        yield bus, served.unplug


def person(folder, *command):
    """Run a command in a terminal of its own, with the robot behind its port."""
    robot = ("--robot", folder / "robot.yaml", "--port", folder / "port")
    words = terminal_command(*command, *robot)
    return ProgramBeside(words, keys=True, screen=True, cwd=folder)


def received(bus):
    return [line.rstrip(b"\r") for _, line in bus.lines]


@pytest.mark.slow
def test_poses_and_a_stretch_that_a_hand_shows_become_a_sequence(tmp_path):
    out = tmp_path / "shown.yaml"
    with simulated(tmp_path, SWAY) as (bus, _), person(tmp_path, "record", "-o", out) as someone:
        someone.wait_for("press l")
        assert not any(line.endswith(b"L") for line in received(bus))  # Nothing falls unasked.
        someone.press("l")
        someone.wait_for("let go")
        someone.press("p")
        someone.wait_for("pose 1")
        someone.press("r")
        someone.wait_for(r"RECORDING  [1-9]")
        someone.press("r")
        someone.wait_for("recorded")
        someone.press("pu")
        someone.wait_for("removed")
        someone.press("q")
        code = someone.ended()
        assert code == 0, someone.said
        assert "Traceback" not in someone.said
        lines = received(bus)
    assert {b"#1L", b"#2L", b"#1H", b"#2H"} <= set(lines)
    assert lines[-1] == b"#254H"
    sequence = load_sequence(out, load_robot(tmp_path / "robot.yaml"))
    assert [k.label for k in sequence.keyframes if k.label] == ["pose 1"]
    recorded = [k for k in sequence.keyframes if not k.label]
    rest = recorded[0]  # It stands where the stretch begins.
    assert 1.0 <= recorded[-1].at_s - (rest.at_s + rest.hold_s) < 6.0


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_leaves_servos_that_hold_and_a_file_of_what_was_shown(tmp_path, number, code):
    out = tmp_path / "shown.yaml"
    with simulated(tmp_path, SWAY) as (bus, _), person(tmp_path, "record", "-o", out) as someone:
        someone.wait_for("press l")
        someone.press("lr")
        someone.wait_for(r"RECORDING  (0\.[2-9]|[1-9])")
        if number == signal.SIGINT:
            someone.press("\x03")  # As the terminal makes it of Ctrl-C.
        else:
            someone.send_signal(number)
        assert someone.ended() == code
        assert received(bus)[-1] == b"#254H"
        assert b"#1SD3600" in received(bus)[-14:]
    assert load_sequence(out, load_robot(tmp_path / "robot.yaml")).keyframes
    assert "Traceback" not in someone.said


@pytest.mark.slow
def test_a_port_that_is_lost_while_recording_loses_nothing_that_was_shown(tmp_path):
    out = tmp_path / "shown.yaml"
    with simulated(tmp_path, SWAY) as (_, unplug), person(tmp_path, "record", "-o", out) as someone:
        someone.wait_for("press l")
        someone.press("lr")
        someone.wait_for(r"RECORDING  (0\.[2-9]|[1-9])")
        unplug()
        assert someone.ended() == 4
    assert "lost port" in someone.said
    assert "Traceback" not in someone.said
    assert load_sequence(out, load_robot(tmp_path / "robot.yaml")).keyframes


def test_jog_moves_within_the_range_and_keeps_poses_in_the_robot_file(tmp_path):
    with simulated(tmp_path) as (bus, _), person(tmp_path, "jog", "--pose", "nod") as someone:
        someone.wait_for("keep pose")
        someone.press("\x1b[B]]")  # tilt, 15 deg
        while "its range is -40 to 60" not in someone.said:
            someone.press("\x1b[C")
            someone.wait_for(r"> tilt +\d")
        someone.wait_for(r"> tilt +(59\.[6-9]|60\.\d) ")  # It has arrived.
        someone.press("c")
        someone.wait_for("pose nod: ")
        someone.press("q")
        assert someone.ended() == 0, someone.said
        lines = received(bus)
    targets = [int(re.split(rb"D|T", line)[1]) for line in lines if line.startswith(b"#2D")]
    assert max(targets) == 600
    assert not any(line.startswith(b"#1D") for line in lines)
    end_ns = bus.lines[-1][0]
    tilt_deg = bus.horn_deg(range(bus.lines[0][0], end_ns, 20_000_000))[:, 1]
    assert tilt_deg.max() <= 60.0 + 0.1
    assert np.abs(np.diff(tilt_deg)).max() / 0.02 < 1.5 * 30.0  # approach_speed_deg_s
    assert lines[-1] == b"#254H"
    pose = load_robot(tmp_path / "robot.yaml").poses["nod"]
    assert pose == pytest.approx({"pan": 0.0, "tilt": 60.0}, abs=0.5)
    text = (tmp_path / "robot.yaml").read_text()
    assert all(comment in text for comment in ("# two joints", "# the head", "# straight ahead"))


def test_a_held_key_and_a_flood_of_keys_delay_no_stop(tmp_path):
    """150 poses were written, one after the other, before the stop behind them was read."""
    with simulated(tmp_path) as (bus, _), person(tmp_path, "jog", "--pose", "pose") as someone:
        someone.wait_for("keep pose")
        someone.press("\x1b[C")
        someone.press("c" * 2000)
        someone.wait_for("pose pose: ")
        someone.press("c" * 2000 + "q" + "c" * 90)
        assert someone.ended() == 0, someone.said
        assert received(bus)[-1] == b"#254H"
    assert set(load_robot(tmp_path / "robot.yaml").poses) <= {"home", "pose", "pose_2"}


class PushAtWill:
    """A hand that holds all joints at 0 until `is_pushing`, then at `pushed_deg`."""

    def __init__(self, **pushed_deg):
        self.pushed_deg = pushed_deg
        self.is_pushing = False

    def led(self, joint):
        def at(time_s):
            return self.pushed_deg[joint.name] if self.is_pushing else 0.0

        return SimpleNamespace(at=at, is_over=lambda time_s: False)


@pytest.mark.slow
def test_calibrate_finds_zero_and_direction(tmp_path):
    hand = PushAtWill(pan=25.0, tilt=-20.0)
    options = ["calibrate", "--to-servos"]
    with simulated(tmp_path, hand) as (bus, _), person(tmp_path, *options) as someone:
        someone.wait_for("press l")
        someone.press("l")
        someone.wait_for("press Enter")
        someone.press("\n")
        someone.wait_for("push pan")
        someone.press("\n")
        someone.wait_for("moved less than 5")
        hand.is_pushing = True
        someone.wait_for(r"> pan +2[45]")
        someone.press("\n")
        someone.wait_for("push tilt")
        someone.press("\n")
        someone.wait_for(r"direction 1 -> -1")
        someone.wait_for("press y")
        assert "zero_deg" not in (tmp_path / "robot.yaml").read_text()
        someone.press("y")
        assert someone.ended() == 0, someone.said
        lines = received(bus)
    robot = load_robot(tmp_path / "robot.yaml")
    assert (robot.joints["pan"].direction, robot.joints["tilt"].direction) == (1, -1)
    assert robot.joints["pan"].zero_deg == pytest.approx(0.0, abs=0.3)
    assert "# the head" in (tmp_path / "robot.yaml").read_text()
    assert lines[-1] == b"#254H"
    stored = [line for line in lines if re.match(rb"#\dCO-?\d+$", line)]
    assert len(stored) == 2
    assert lines.index(stored[0]) < lines.index(b"#1H")  # While it is limp.


@pytest.mark.slow
def test_a_signal_while_calibrating_writes_nothing_and_holds(tmp_path):
    with simulated(tmp_path) as (bus, _), person(tmp_path, "calibrate") as someone:
        someone.wait_for("press l")
        someone.press("l")
        someone.wait_for("press Enter")
        someone.press("\x03")
        assert someone.ended() == 130
        assert received(bus)[-1] == b"#254H"
    assert (tmp_path / "robot.yaml").read_text() == ROBOT


def test_a_port_that_is_lost_while_jogging_is_an_error_in_words(tmp_path):
    with simulated(tmp_path) as (_, unplug), person(tmp_path, "jog") as someone:
        someone.wait_for("keep pose")
        someone.press("\x1b[C")
        someone.wait_for("> pan")
        unplug()
        assert someone.ended() == 4
    assert "lost port" in someone.said
    assert "Traceback" not in someone.said
