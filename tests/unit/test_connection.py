"""Opening the ports of a robot: all or none, at any rate."""

from __future__ import annotations

import socket

import pytest

from lss_motion.errors import BusError, InputError
from lss_motion.playing.connection import connect, with_port
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.framing import Command
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import Bus
from lss_motion.system.clock import VirtualClock

ROBOT = """
robot: two
buses:
  left: {port: "sim://", baud_bps: 115200}
  right: {port: "sim://", baud_bps: 500000}
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, accel_max_deg_s2: 300}
joints:
  arm:  {id: 5, bus: left}
  hand: {id: 6, bus: right}
"""


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "robot.yaml"
    path.write_text(ROBOT)
    return load_robot(path)


def ask(bus, servo_id, keyword):
    return Item(bus=bus, command=Command(servo_id, keyword))


def test_questions_go_to_every_bus_and_a_missing_answer_is_absent(robot):
    with connect(robot.buses, robot=robot, clock=VirtualClock()) as connection:
        answers = connection.ask(
            [ask("left", 5, "QID"), ask("right", 6, "QG"), ask("left", 6, "Q")]
        )
    assert answers == {("left", 5, "QID"): 5, ("right", 6, "QG"): 1}


def test_no_servo_answers_at_another_rate_and_all_do_at_the_first_again(robot):
    with connect(robot.buses, robot=robot, clock=VirtualClock()) as connection:
        connection.set_baud("left", 9600)
        assert connection.ask([ask("left", 5, "QID")]) == {}
        connection.set_baud("left", 115200)
        assert connection.ask([ask("left", 5, "QID")]) == {("left", 5, "QID"): 5}


def test_a_wait_takes_its_time_and_drops_late_data(robot):
    clock = VirtualClock()
    with connect(robot.buses, robot=robot, clock=clock) as connection:
        connection.ports["left"].write(b"#5QD\r")
        connection.wait(0.5)
        assert clock.now_ns() == 500_000_000
        assert connection.ports["left"].read() == b""


def test_nothing_stays_open_when_one_port_does_not_open(robot, monkeypatch):
    closed = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        closed_port = server.getsockname()[1]
    monkeypatch.setattr("lss_motion.sim.bus.SimPort.close", lambda port: closed.append(port.url))
    buses = {
        "left": robot.buses["left"],
        "gone": Bus(
            name="gone", port=f"socket://127.0.0.1:{closed_port}", baud_bps=9600, firmware=1
        ),
    }
    with pytest.raises(BusError, match="cannot open port socket://"):
        connect(buses, robot=robot)
    assert closed == ["sim://"]


def test_a_simulated_port_needs_a_robot(robot):
    with pytest.raises(InputError, match="give one"):
        connect(robot.buses)


def test_an_empty_port_is_refused(robot):
    with pytest.raises(InputError, match="--port is empty"):
        with_port(robot, "")
