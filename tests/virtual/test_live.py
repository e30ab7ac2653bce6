"""A robot without a show: judged at the horns and at the bytes that its servos received."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

import lss_motion as lss
from lss_motion.playing.hands_on import HandsOn
from lss_motion.playing.player.events import Faulted
from lss_motion.robot.servo_models import SERVO_MODELS
from tests.timed_moves import is_move
from tests.virtual.conftest import make_robot

S = 1_000_000_000


@pytest.fixture
def robot():
    return make_robot(2, end="limp", baud_bps=115200)


def horns(live):
    (bus,) = live._connection.simulated.values()
    times_ns = np.arange(0, live._connection.clock.now_ns(), 5_000_000)
    return bus, times_ns, bus.horn_deg(times_ns)


def test_a_move_takes_its_time_and_ends_at_its_place(robot):
    with lss.connect(robot, is_virtual=True) as live:
        assert live.move_to({"j0": 40.0}, 2.0) == pytest.approx(2.0)
        assert live.read() == pytest.approx({"j0": 40.0, "j1": 0.0}, abs=0.5)
        bus, times_ns, horn_deg = horns(live)
        moved = times_ns[np.abs(horn_deg[:, 0]) > 0.5][0]
        there = times_ns[horn_deg[:, 0] > 39.5][0]
        assert (there - moved) / S == pytest.approx(1.75, abs=0.25)
        assert np.abs(horn_deg[:, 1]).max() < 0.5, "the other joint holds"
        assert b"#254L\r" not in [line for _, line in bus.lines]
    assert bus.lines[-1][1] == b"#254L\r", "the end of the robot file comes at the end"


def test_limits_hold_whatever_is_asked(robot):
    limits = robot.joints["j0"]
    with lss.connect(robot, is_virtual=True) as live:
        assert live.move_to({"j0": 60.0}, 0.01) > 0.5
        _, _, horn_deg = horns(live)
        speed = np.abs(np.diff(horn_deg, axis=0)).max() / 0.005
        assert speed < 1.05 * limits.speed_max_deg_s
        for wrong in ({"j0": 1000.0}, {"nobody": 1.0}, {}):
            with pytest.raises(lss.InputError):
                live.move_to(wrong)
        with pytest.raises(lss.InputError):
            live.move_to({"j0": 0.0}, 0.0)


def test_limp_joints_stay_limp_until_they_are_moved(robot):
    with lss.connect(robot, is_virtual=True) as live:
        live.limp("j0")
        live.move_to({"j1": 10.0}, 1.0)
        bus = horns(live)[0]
        live.read()
        orders = [line for _, line in bus.lines if line in (b"#1L\r", b"#254H\r")]
        assert orders[-1] == b"#1L\r", "the hold after a move is taken back"
        assert not any(is_move(line) and line.startswith(b"#1D") for _, line in bus.lines)
        live.move_to({"j0": 10.0}, 1.0)
        assert live.read()["j0"] == pytest.approx(10.0, abs=0.5)
        orders = [line for _, line in bus.lines if line in (b"#1L\r", b"#254H\r")]
        assert orders[-1] == b"#254H\r"
        with pytest.raises(lss.InputError, match="unknown joint 'j7'"):
            live.limp("j7")


def test_an_exception_in_the_block_leaves_a_robot_that_holds(robot):
    live = lss.connect(robot, is_virtual=True)
    with pytest.raises(ZeroDivisionError), live:
        raise ZeroDivisionError
    bus = next(iter(live._connection.simulated.values()))
    assert bus.lines[-1][1] == b"#254H\r"
    with pytest.raises(lss.InputError, match="closed"):
        live.read()
    live.close()


def test_an_interrupted_move_ends_safely(robot, monkeypatch):
    live = lss.connect(robot, is_virtual=True)
    real, turns = live._connection.clock.wait_until, []

    def interrupt(instant_ns, filenos=()):
        turns.append(instant_ns)
        if len(turns) == 300:
            raise KeyboardInterrupt
        real(instant_ns, filenos)

    monkeypatch.setattr(live._connection.clock, "wait_until", interrupt)
    with pytest.raises(KeyboardInterrupt), live:
        live.move_to({"j0": 60.0}, 20.0)
    bus = next(iter(live._connection.simulated.values()))
    assert any(is_move(line) for _, line in bus.lines)
    assert bus.lines[-1][1] == b"#254H\r"


def test_what_is_no_robot_or_no_name_is_refused_in_words(robot):
    with pytest.raises(lss.InputError, match="a robot is needed here, not a str"):
        lss.connect("desk_arm.yaml")
    with pytest.raises(lss.InputError, match="a program is needed here, not a Robot"):
        lss.start(robot, {})
    with lss.connect(robot, is_virtual=True) as live:
        with pytest.raises(lss.InputError, match="names one by one"):
            live.limp(["j0", "j1"])
        assert "-0.0" not in str(live.read())


class StopAfter:
    """Ends what runs after so long."""

    def __init__(self, duration_s):
        self.duration_s, self.began_ns = duration_s, None

    def filenos(self):
        return []

    def act(self, driven, now_ns):
        self.began_ns = now_ns if self.began_ns is None else self.began_ns
        if now_ns - self.began_ns > self.duration_s * S:
            driven.stop()


@pytest.mark.parametrize("firmware", [779, 780])
def test_an_lss_pro_that_holds_is_in_no_error_whatever_its_firmware(firmware):
    """Code 6 is `holding` up to firmware 779 and `error` from 780 on."""
    robot = make_robot(1, baud_bps=115200, model=SERVO_MODELS["LSS-P-S1"])
    bus = replace(robot.buses["bus0"], pro_firmware=firmware)
    events = []
    with lss.connect(replace(robot, buses={"bus0": bus}), is_virtual=True) as live:
        live.move_to({"j0": 10.0}, 1.0)
        hands_on = HandsOn(live.robot, list(live.robot.joints))
        live._connection.run(hands_on, controls=StopAfter(3.0), on_event=events.append)
        assert live.read()["j0"] == pytest.approx(10.0, abs=0.5)
    assert not [event for event in events if isinstance(event, Faulted)]


def test_a_joint_that_lost_its_turn_between_two_moves_is_not_moved():
    robot = make_robot(
        1, baud_bps=115200, position_min_deg=0.0, position_max_deg=250.0, turns="by_hand"
    )
    with lss.connect(robot, is_virtual=True) as live:
        live.move_to({"j0": 220.0}, 3.0)
        (bus,) = live._connection.simulated.values()
        bus._servos[0].reset(live._connection.clock.now_ns(), 0.02)
        moves = [line for _, line in bus.lines if is_move(line)]
        for _ in range(2):
            with pytest.raises(lss.PlaybackError, match="in another turn"):
                live.move_to({"j0": 200.0}, 1.0)
        assert [line for _, line in bus.lines if is_move(line)] == moves
