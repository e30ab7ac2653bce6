"""`lss-motion scan` as a user runs it, with everything that can be wrong on the first evening."""

from __future__ import annotations

import fcntl
import os

import pytest
import serial

from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_UNREACHABLE
from lss_motion.robot.load import load_robot
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.system import devices

pytestmark = pytest.mark.realtime


@pytest.mark.slow
def test_a_bag_of_servos_is_found_with_all_that_is_wrong(on_terminal, servo, lss_motion, tmp_path):
    port, starter = "port", tmp_path / "bag.yaml"
    hot = Fault(kind=FaultKind.HOT, servo_id=5, temperature_c=90.0)
    bag = [servo(0), servo(0), servo(5), servo(6), servo(7, baud_bps=250000), servo(209, "LSS-2IO")]
    with on_terminal(*bag, faults=[hot]) as bus:
        code, out, errors = lss_motion("scan", port, "-o", starter)
        received = {line for _, line in bus.lines}
    assert (code, errors) == (EXIT_UNREACHABLE, "")
    assert f"{port} at 115200 bps: 10 ids reply" in out
    assert f"{port} at 250000 bps: 1 id replies" in out
    assert "id 0 at 115200 bps: several servos answer at once" in out
    assert "servo 5 is in safe mode (temperature)" in out
    assert "servo 7 listens at 250000 bps" in out
    assert "LSS-2IO-D9" in out
    assert list(load_robot(starter).joints)[:2] == ["joint_5", "joint_6"]
    assert all(b"Q" in line for line in received if line.startswith(b"#"))


def test_a_healthy_robot_is_well_and_a_missing_servo_is_named(
    on_terminal, servo, lss_motion, tmp_path
):
    robot = tmp_path / "robot.yaml"
    robot.write_text("""
robot: pair
buses: {main: {port: "port"}}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints: {pan: {id: 1}, tilt: {id: 2}}
""")
    asked = ("scan", "--robot", robot, "--baud", 115200)
    with on_terminal(servo(1), servo(2)):
        code, out, errors = lss_motion(*asked)
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "pan    1   LSS-ST1" in out
    with on_terminal(servo(1)):
        code, out, _ = lss_motion(*asked)
    assert code == EXIT_UNREACHABLE
    assert "joint 'tilt': servo 2 does not answer" in out


@pytest.mark.slow
def test_another_host_that_asks_all_servos_at_once_is_noted(on_terminal, servo, lss_motion):
    master = Fault(kind=FaultKind.SECOND_MASTER, text="#254QD", every_s=0.1)
    with on_terminal(servo(1), servo(2), servo(5), faults=[master]):
        code, out, errors = lss_motion("scan", "port", "--baud", 115200)
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "3 ids reply" in out
    assert "note: port: unreadable bytes come that this program did not ask for" in out


@pytest.mark.slow
def test_an_empty_bus_is_told_with_what_to_check(on_terminal, lss_motion):
    with on_terminal():
        code, out, _ = lss_motion("scan", "port", "--baud", 115200)
    assert code == EXIT_UNREACHABLE
    assert "problem: no servo answered" in out
    assert "power of their own" in out


def test_a_port_in_use_is_told_as_such(on_terminal, servo, lss_motion):
    with on_terminal(servo(1)), serial.Serial("port") as other:
        fcntl.flock(other.fileno(), fcntl.LOCK_EX)
        code, _, errors = lss_motion("scan", "port")
    assert code == EXIT_UNREACHABLE
    assert "another program has it open" in errors


def test_without_permission_the_group_to_join_is_named(lss_motion, tmp_path, monkeypatch):
    import grp

    other_fd, fd = os.openpty()
    port = tmp_path / "ttyUSB0"
    port.symlink_to(os.ttyname(fd))

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("os.open", refuse)
    monkeypatch.setattr(grp, "getgrgid", lambda _: grp.struct_group(("uucp", "x", 14, [])))
    code, _, errors = lss_motion("scan", port)
    assert code == EXIT_UNREACHABLE
    assert "it belongs to the group `uucp`" in errors
    assert "usermod -aG uucp" in errors
    os.close(other_fd)
    os.close(fd)


def test_without_a_port_those_of_the_computer_are_shown(lss_motion, monkeypatch):
    def found(*known):
        ports = [devices.SerialDevice(path=path, name="FT232R", is_usb=True) for path in known]
        monkeypatch.setattr(devices, "list_devices", lambda: ports)
        return lss_motion("scan")

    code, out, errors = found("/dev/ttyUSB0", "/dev/ttyUSB1")
    assert (code, out) == (EXIT_INPUT, "/dev/ttyUSB0  FT232R\n/dev/ttyUSB1  FT232R\n")
    assert "name one, such as /dev/ttyUSB0" in errors
    code, _, errors = found()
    assert code == EXIT_UNREACHABLE
    assert "no serial port on USB was found" in errors
    code, out, errors = found("/dev/no-such-port")
    assert code == EXIT_UNREACHABLE
    assert "cannot open port /dev/no-such-port" in errors


def test_what_exists_is_not_overwritten_and_no_rate_is_guessed(lss_motion, tmp_path):
    (tmp_path / "mine.yaml").write_text("mine")
    code, _, errors = lss_motion("scan", "/dev/null", "-o", tmp_path / "mine.yaml")
    assert code == EXIT_INPUT
    assert "exists already" in errors
    code, _, errors = lss_motion("scan", "/dev/null", "--baud", 31250)
    assert code == EXIT_INPUT
    assert "servos support 9600" in errors
