from __future__ import annotations

import os

import pytest

from lss_motion.errors import InputError
from lss_motion.playing.walking.inputs import EVENT, Gamepad, OperatorInput
from lss_motion.show.gait.stepping import STILL, Twist

TOP = Twist(forward_mm_s=40.0, left_mm_s=20.0, turn_deg_s=10.0)
UP, RIGHT = "\x1b[A", "\x1b[C"


def pressed(keys):
    operator = OperatorInput(TOP)
    operator.press(keys)
    return operator


@pytest.mark.parametrize(
    ("keys", "twist"),
    [
        ("", STILL),
        ("w", Twist(forward_mm_s=10.0)),
        (UP + UP, Twist(forward_mm_s=20.0)),
        ("wwwwwww", Twist(forward_mm_s=40.0)),
        ("ws", STILL),
        ("S", Twist(forward_mm_s=-10.0)),
        ("a" + RIGHT, Twist(left_mm_s=5.0, turn_deg_s=-2.5)),
        ("ww-", Twist(forward_mm_s=15.0)),
        ("ww----------", Twist(forward_mm_s=5.0)),
        ("ww--++++", Twist(forward_mm_s=20.0)),
        ("wwa ", STILL),
        ("w?\x1b\x1b[Zé", Twist(forward_mm_s=10.0)),
    ],
)
def test_keys_become_a_velocity(keys, twist):
    assert pressed(keys).twist() == twist


def test_a_sitting_robot_is_commanded_no_velocity_until_it_stands():
    operator = pressed("wwx")
    assert (operator.is_sitting, operator.twist()) == (True, STILL)
    operator.press("w")
    assert operator.twist() == STILL
    operator.press("xw")
    assert operator.twist() == Twist(forward_mm_s=10.0)


def test_q_ends_the_walk_and_stops_the_robot():
    operator = pressed("wwq")
    assert (operator.has_ended, operator.twist()) == (True, STILL)


def event(number, value, kind=2):
    return EVENT.pack(0, value, kind, number)


@pytest.fixture
def pad(tmp_path):
    """A gamepad and the end that its events are written to."""
    path = tmp_path / "js0"
    os.mkfifo(path)
    with Gamepad(path) as gamepad:
        end = os.open(path, os.O_WRONLY)
        yield gamepad, end
        os.close(end)


def test_sticks_become_ratios_also_when_events_come_in_pieces(pad):
    gamepad, end = pad
    assert gamepad.stick() is None
    data = event(1, -32767) + event(0, 16384, kind=0x82) + event(3, -32768) + event(7, 5, kind=1)
    os.write(end, data[:11])
    assert gamepad.stick() == (1.0, 0.0, 0.0)
    os.write(end, data[11:])
    forward, left, turn = gamepad.stick()
    assert (forward, turn) == (1.0, 1.0)
    assert left == pytest.approx(-0.5, abs=1e-3)
    os.write(end, event(1, 2000))
    assert gamepad.stick()[0] == 0.0, "a stick near its middle counts as released"


def test_an_unplugged_pad_releases_both_sticks(tmp_path):
    path = tmp_path / "js0"
    os.mkfifo(path)
    with Gamepad(path) as gamepad:
        end = os.open(path, os.O_WRONLY)
        os.write(end, event(1, -32767))
        assert gamepad.stick() == (1.0, 0.0, 0.0)
        os.close(end)
        assert gamepad.stick() == (0.0, 0.0, 0.0)
        assert gamepad.stick() is None
        assert gamepad.filenos() == []


def test_a_missing_pad_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="/dev/input/js0"):
        Gamepad(tmp_path / "none")
