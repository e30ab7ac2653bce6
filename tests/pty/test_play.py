"""`lss-play` over a pseudo-terminal in real time, judged by what the simulated servos received."""

from __future__ import annotations

import json
import re
import signal
from contextlib import contextmanager

import numpy as np
import pytest
from served_bus import served_bus

from lss_motion.cli.main import main
from lss_motion.cli.play import main as play
from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot
from tests.pair import ROBOT
from tests.programs import ProgramBeside, command, terminal_command
from tests.swing import until
from tests.tables import first_quick
from tests.timed_moves import is_move

pytestmark = pytest.mark.realtime

PAIR = f"{ROBOT}resume_s: 1.5\n"
SWAY = """
sequence: sway
robot: robot.yaml
loop: %s
keyframes:
  - {at_s: 0, pose: home}
  - {at_s: 0.6, deg: {pan: 40, tilt: 30}}
  - {at_s: 1.2, pose: home}
"""
QUESTION = r"go\? \[y/N\] "
SESSION_BEFORE = [b"#1EM1", b"#1AA100", b"#1AD100", b"#1SD3600"]


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "robot.yaml").write_text(PAIR)
    return tmp_path


@contextmanager
def simulated(folder, bus=None):
    """Serve the robot, or a bus of it that was unplugged, behind a pseudo-terminal."""
    if bus is None:
        bus = bus_from_robot(load_robot(folder / "robot.yaml"), "main", seed=1)
        bus.record()
    with served_bus(bus, folder / "port") as served:
        yield served


def playing(folder, port, *options, loop="1"):
    """Play without a terminal."""
    (folder / "sway.yaml").write_text(SWAY % loop)
    words = (folder / "sway.yaml", "--port", port.path, "--yes", *options)
    return ProgramBeside(command("play", *words))


def at_a_keyboard(folder, port, *options, **streams):
    """Play a short show in the foreground of a terminal."""
    (folder / "sway.yaml").write_text(SWAY % 1)
    words = (folder / "sway.yaml", "--port", port.path, *options)
    return ProgramBeside(terminal_command("play", *words), keys=True, **{"merged": True, **streams})


def test_a_person_is_asked_and_nothing_is_changed_before_the_answer(folder):
    log = folder / "a.log"
    with simulated(folder) as port, at_a_keyboard(folder, port, "--log", log) as process:
        said = process.wait_for(QUESTION)
        assert [line.split()[:2] for line in said.splitlines() if "LSS-ST1" in line] == [
            ["pan", "1"],
            ["tilt", "2"],
        ]
        assert all(line[2:3] == b"Q" for line in lines_heard(port)), "only questions so far"
        process.press("y")
        assert process.ended() == 0, process.said
        assert any(line.startswith(b"#2D") for line in lines_heard(port))
    assert main(["replay", "--again", str(log)]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("answer", ["\n", "n", "\x03"])
def test_without_a_yes_nothing_moves_and_nothing_was_changed(folder, answer):
    with simulated(folder) as port, at_a_keyboard(folder, port) as process:
        process.wait_for(QUESTION)
        process.press(answer)
        assert process.ended() == 130
        assert "nothing was moved" in process.said
        assert all(line[2:3] == b"Q" for line in lines_heard(port))


def test_where_nobody_can_be_asked_the_port_is_not_even_opened(folder):
    (folder / "sway.yaml").write_text(SWAY % 1)
    with simulated(folder) as port:
        words = command("play", folder / "sway.yaml", "--port", port.path)
        with ProgramBeside(words) as process:
            assert process.ended() == 2
        assert lines_heard(port) == []
    assert "--yes" in process.errors


def lines_heard(port):
    return [line for _, line in port.bus.lines]


def test_a_show_reaches_its_end_and_its_keyframes_over_a_real_terminal(folder):
    """A starved host may send late, leave out moves and get no reading in time, and reports so."""
    path = folder / "r.json"
    with simulated(folder) as port:
        with playing(folder, port, "--report", path) as process:
            assert process.ended() == 0, process.errors
        moves = [line for line in lines_heard(port) if is_move(line)]
        pan = [found for line in moves if (found := re.match(rb"#1D(-?\d+)", line))]
        end_ns = port.bus.lines[-1][0]
        assert lines_heard(port)[-1].rstrip(b"\r") == b"#254H"
        assert abs(port.bus.horn_deg([end_ns])[0, 0]) < 0.6
    report = json.loads(path.read_text())
    timing, bus = report["timing"], report["buses"]["main"]
    assert (report["simulated"], report["outcome"]) == (False, "finished")
    assert report["played_s"] == pytest.approx(1.2, abs=0.05)
    assert 0 < timing["commands"] <= len(moves)
    assert timing["missed"] or max(int(found[1]) for found in pan) >= 390
    assert 0 < bus["replies"] <= bus["queries"]
    assert bus["queries"] - bus["replies"] - bus["timeouts"] <= len(report["joints"])


@pytest.mark.parametrize(
    ("number", "code"),
    first_quick([(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGQUIT, 131)]),
)
def test_a_signal_in_the_middle_brakes_restores_and_holds(folder, number, code):
    with simulated(folder) as port:
        with playing(folder, port, loop="forever") as process:
            process.wait_for("playing")
            wait_for_moves(port, 6)
            process.send_signal(number)
            assert process.ended() == code
        assert process.errors == ""
        assert_restored_and_held(port)
        end_ns = port.bus.lines[-1][0]
        last = port.bus.horn_deg(np.arange(end_ns - 100_000_000, end_ns, 5_000_000))
        assert np.ptp(last, axis=0).max() < 0.2  # It stood still before it was told to hold.


def assert_restored_and_held(port):
    received = [line.rstrip(b"\r") for line in lines_heard(port)]
    assert received[-1] == b"#254H"
    for setting in SESSION_BEFORE:
        assert setting in received[-12:]


@pytest.mark.slow
def test_a_terminal_that_is_closed_in_the_middle_brakes_restores_and_holds(folder):
    with simulated(folder) as port, at_a_keyboard(folder, port, "--yes", screen=True) as process:
        process.wait_for("playing")
        wait_for_moves(port, 6)
        process.hang_up()
        assert process.ended() == 129
        assert_restored_and_held(port)


@pytest.mark.slow
def test_an_interrupt_while_helpers_start_is_theirs_to_ignore_and_the_robot_holds(folder):
    with simulated(folder) as port, at_a_keyboard(folder, port, "--yes", screen=True) as process:
        process.wait_for("preparing")
        process.press("\x03")
        assert process.ended() == 130
        for sign in ("Traceback", "Fatal", "KeyboardInterrupt"):
            assert sign not in process.said
        assert_restored_and_held(port)


def wait_for_moves(port, count):
    until(lambda: sum(line.startswith(b"#1D") for line in lines_heard(port)) >= count)


@pytest.mark.slow
def test_a_second_interrupt_stops_at_once(folder):
    with simulated(folder) as port:
        with playing(folder, port, loop="forever") as process:
            process.wait_for("playing")
            wait_for_moves(port, 6)
            process.send_signal(signal.SIGINT)
            process.wait_for("stopping")
            process.send_signal(signal.SIGINT)
            assert process.ended() == 130
        assert process.errors == ""
        assert lines_heard(port)[-1].rstrip(b"\r") == b"#254H"
        warning = next(
            line for line in process.said.splitlines() if line.startswith("warning: stopped")
        )
        assert "AA, AD, SD stay" in warning
        assert "power off and on" in warning


def test_a_port_that_vanishes_is_an_error_that_says_what_became_of_robot_and_show(folder):
    report = folder / "r.json"
    with simulated(folder) as port:
        with playing(folder, port, "--report", report, loop="forever") as process:
            process.wait_for("playing")
            wait_for_moves(port, 6)
            port.unplug()
            assert process.ended() == 4
        errors = process.errors
        assert "lost port" in errors
        assert "the device is gone" in errors
        assert "command to hold could not be sent" in errors
        played_s = json.loads(report.read_text())["played_s"]
        assert 0.0 < played_s < 60.0
        assert f"--from {played_s:.2f}" in errors
        assert "Traceback" not in errors


@pytest.mark.slow
def test_a_port_that_is_plugged_in_again_is_played_on(folder):
    report = folder / "r.json"
    (folder / "robot.yaml").write_text(f"{ROBOT}resume_s: 20\n")
    with simulated(folder) as port:
        with playing(folder, port, "--report", report, loop="3") as process:
            process.wait_for("playing")
            wait_for_moves(port, 6)
            port.unplug()
            process.wait_for("recovering")
            received = len(port.bus.lines)
            with simulated(folder, port.bus):
                process.wait_for("playing")
                assert process.ended() == 0, process.errors
        lines = [line.rstrip(b"\r") for line in lines_heard(port)[received:]]
        first = next(i for i, line in enumerate(lines) if line.startswith(b"#1D"))
        assert {b"#1EM1", b"#1AA60", b"#1SD1800"} <= set(lines[:first])
        assert lines[-1] == b"#254H"
    (fault,) = json.loads(report.read_text())["faults"]
    assert (fault["kind"], fault["step"]) == ("lost_port", "resume")


@pytest.mark.slow
def test_a_killed_player_leaves_a_robot_that_comes_to_rest_by_itself(folder):
    with simulated(folder) as port:
        with playing(folder, port, loop="forever") as process:
            process.wait_for("playing")
            wait_for_moves(port, 6)
            process.kill()
            process.communicate(timeout=20)
        longest_s = max(
            int(line.rstrip(b"\r").split(b"T")[1]) / 1000
            for line in lines_heard(port)
            if is_move(line)
        )
        last_ns = port.bus.lines[-1][0]
        port.bus.advance(last_ns + int((longest_s + 1.5) * 1e9))
        end_ns = last_ns + int((longest_s + 1.0) * 1e9)
        settled = port.bus.horn_deg(np.arange(end_ns, end_ns + 400_000_000, 20_000_000))
        assert np.ptp(settled, axis=0).max() < 0.2


@pytest.mark.slow
def test_a_show_without_feedback_needs_limits_that_the_servos_store(folder, capsys):
    """A restart is not noticed then: the servo would go on with the speed of the factory."""
    show = folder / "sway.yaml"
    show.write_text(SWAY % 1)
    with simulated(folder) as served:
        words = [str(show), "--port", served.path, "--yes", "--no-feedback"]
        assert play(words) == 2
        errors = capsys.readouterr().err
        assert "nothing notices a servo that restarts" in errors
        assert "pan (servo 1): speed 360 deg/s (SD), the joint allows 180" in errors
        assert "configure" in errors
        assert not any(is_move(line) for _, line in served.bus.lines)
        configure = ["configure", str(folder / "robot.yaml"), "--port", served.path, "--yes"]
        assert main([*configure, "--limits"]) == 0
        assert "SD" in capsys.readouterr().out
        assert play(words) == 0
        assert any(is_move(line) for _, line in served.bus.lines)
        stored = [servo.settings.eeprom for servo in served.bus._servos]
        assert {(one["SD"], one["AA"], one["AD"]) for one in stored} == {(1800, 60, 60)}


@pytest.mark.slow
def test_a_real_robot_tells_of_higher_stored_limits(folder, capsys):
    show = folder / "sway.yaml"
    show.write_text(SWAY % 1)
    with simulated(folder) as served:
        assert play([str(show), "--port", served.path, "--yes"]) == 0
        printed = capsys.readouterr().out
        assert "note: a servo that restarts moves with its stored limits" in printed
        doctor = ["doctor", str(folder / "robot.yaml"), "--port", served.path]
        assert main(doctor) == 0
        printed = capsys.readouterr().out
        assert "pan (servo 1): speed 360 deg/s (SD), the joint allows 180" in printed
        assert "2 servos answer as 'pair' has them" in printed
        words = [str(show), "--port", served.path, "--yes", "--no-feedback", "--force"]
        assert play(words) == 0
        assert "--force: played all the same" in capsys.readouterr().out
