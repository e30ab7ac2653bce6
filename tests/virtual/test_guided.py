"""Calibrate and identify, led by a client: what is asked, what is written, what the servos got."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.maintenance.guided import (
    AT_ZERO,
    CANCEL,
    DISCARD,
    KEEP,
    PUSHED,
    RELEASE,
    WRITE,
    Calibration,
    ServoTasks,
)
from lss_motion.playing.connection import connect
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.player.events import Phase
from lss_motion.playing.remote import schema as m
from lss_motion.playing.runner import run
from lss_motion.robot.load import load_robot
from lss_motion.sim.hand import HandMotion
from lss_motion.system.clock import VirtualClock

ROBOT = """\
robot: bench
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
  # The shoulder.
  a: {id: 1}
  b: {id: 2}
"""


@pytest.fixture
def robot(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text(ROBOT)
    return load_robot(path)


class AnsweringPerson:
    """Answers a guide, each answer at a time of its own; then ends. Keeps what it was told."""

    def __init__(self, guide, *answers):
        self.guide, self.answers, self.told = guide, list(answers), [guide.now]

    def filenos(self):
        return []

    def act(self, hands_on, now_ns):
        if hands_on.phase is not Phase.SHOW:
            return
        hands_on.take()
        if self.answers and now_ns >= self.answers[0][0] * 1_000_000_000:
            self.guide.answer(self.answers.pop(0)[1], hands_on)
            self.told.append(self.guide.now)
        if not self.answers and hands_on.has_sent_all:
            hands_on.stop()


def calibrated(robot, *answers):
    """Let a hand bring joint a to 12 deg at 3 s, and push it to 4 deg at 5 s."""
    times_s = np.array([0.0, 2.0, 3.0, 4.0, 5.0, 9.0])
    hand = HandMotion(times_s, {"a": np.array([0.0, 0.0, 12.0, 12.0, 4.0, 4.0])})
    clock = VirtualClock()
    person = AnsweringPerson(Calibration(robot, robot.joints["a"]), *answers)
    with connect(robot.buses, robot=robot, clock=clock, hand=hand) as connection:
        run(HandsOn(robot, ["a", "b"]), connection.ports, clock, controls=person)
    lines = [line.rstrip(b"\r") for _, line in connection.simulated["main"].lines]
    return person.told, [line for line in lines if line in (b"#1L", b"#1H", b"#2L", b"#2H")]


def test_a_joint_is_calibrated_by_hand(robot):
    told, orders = calibrated(robot, (1.5, RELEASE), (3.5, AT_ZERO), (5.5, PUSHED), (6.0, WRITE))
    assert [one.state for one in told] == ["asking"] * 4 + ["done"]
    zero, direction = told[3].result.lines
    assert zero in {"zero_deg 0 → 11.9", "zero_deg 0 → 12", "zero_deg 0 → 12.1"}
    assert direction == "direction 1 → -1"
    found = load_robot(robot.path).joints["a"]
    assert found.zero_deg == pytest.approx(12.0, abs=0.2)
    assert found.direction == -1
    assert "# The shoulder." in robot.path.read_text()
    assert orders[0] == b"#1L"
    assert orders[1] == b"#1H"
    assert b"#2L" not in orders, "the other joint is not touched"


def test_a_small_push_is_asked_for_again_and_nothing_is_written_unasked(robot):
    told, orders = calibrated(
        robot, (1.5, RELEASE), (3.5, AT_ZERO), (3.6, PUSHED), (3.7, KEEP), (6.0, DISCARD)
    )
    assert "less than 5°" in told[3].question.text
    assert told[4].result.lines[1] == "direction 1 → 1"
    assert told[5].state == "stopped"
    assert robot.path.read_text() == ROBOT
    assert orders[:2] == [b"#1L", b"#1H"]
    told, orders = calibrated(robot, (1.5, CANCEL))
    assert told[-1].state == "stopped"
    assert b"#1L" not in orders


def test_only_answers_that_are_offered_are_taken(robot):
    guide = Calibration(robot, robot.joints["a"])
    with pytest.raises(InputError, match="make it limp"):
        guide.answer(WRITE, HandsOn(robot, ["a"]))
    with pytest.raises(InputError, match="unknown joint 'c'"):
        ServoTasks().joint(robot, "c")


class MeasuringClient:
    """Stands for the client of a measurement: it may stop it, and keeps what it is sent."""

    is_cut = False

    def __init__(self, stop_at=None):
        self.stop_at, self.sent, self.answers = stop_at, [], []

    def filenos(self):
        return []

    def look_for_client(self):
        pass

    def take_signals(self):
        return 0

    def take(self, now_ns):
        if self.stop_at is not None and self.sent and self.sent[-1].progress >= self.stop_at:
            self.stop_at = None
            return [m.Jog(id=3, joint="a", speed_ratio=1.0), m.Stop(id=4)]
        return []

    def accept(self, operation):
        self.answers.append((operation.id, True))

    def refuse(self, operation, why):
        self.answers.append((operation.id, why))

    def send(self, message):
        self.sent.append(message)

    offer = send


def identified(robot, client):
    with connect(robot.buses, robot=robot, clock=VirtualClock()) as connection:
        guide, has_stopped = ServoTasks().measured(connection, robot, "a", client)
    lines = [line.rstrip(b"\r") for _, line in connection.simulated["main"].lines]
    return guide, has_stopped, lines


def test_a_measurement_that_is_stopped_writes_nothing_and_holds(robot):
    client = MeasuringClient(stop_at=0.2)
    guide, has_stopped, lines = identified(robot, client)
    assert has_stopped
    assert client.answers[0][0] == 3
    assert "being measured" in client.answers[0][1]
    assert client.answers[1] == (4, True)
    assert guide.now.state == "stopped"
    assert guide.is_over
    assert robot.path.read_text() == ROBOT
    assert lines[-1] == b"#1H"


def test_a_joint_without_room_is_not_measured_and_the_client_is_told(tmp_path):
    path = tmp_path / "tight.yaml"
    path.write_text(ROBOT.replace("{id: 1}", "{id: 1, range_deg: [-1, 1]}"))
    client = MeasuringClient()
    guide, _, lines = identified(load_robot(path), client)
    assert guide is None
    assert client.sent[-1].state == "failed"
    assert "a" in client.sent[-1].step
    assert not any(line.startswith(b"#1D") for line in lines)
