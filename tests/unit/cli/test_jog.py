"""`lss-motion jog`: keys at a robot that stands; what they write into its file."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from lss_motion.cli.by_hand import HELD_NS, JogControls
from lss_motion.playing.player.events import Phase
from lss_motion.robot.load import load_robot
from tests.pair import ROBOT


class Jogged:
    """Controls and a robot that stands at 10 and 70 degrees."""

    def __init__(self, path, pose_name=None):
        path.write_text(ROBOT)
        self.path, robot = path, load_robot(path)
        self.controls = JogControls(robot, pose_name)
        joints = list(robot.joints.values())
        readings = {"pan": SimpleNamespace(deg=10.0), "tilt": SimpleNamespace(deg=70.0)}
        self.stops = 0
        self.hands_on = SimpleNamespace(
            joints=joints, readings=readings, phase=Phase.SHOW, take=list, stop=self._stop
        )
        self.now_ns = 0

    def _stop(self):
        self.stops += 1

    def press(self, *keys):
        """Press keys, a second apart."""
        for key in keys:
            self.now_ns += 2 * HELD_NS
            self.controls.take = lambda key=key: (0, key)
            self.controls.act(self.hands_on, self.now_ns)

    @property
    def poses(self):
        return dict(load_robot(self.path).poses)


@pytest.fixture
def jogged(tmp_path):
    jogged = Jogged(tmp_path / "robot.yaml")
    with jogged.controls:
        yield jogged


def test_a_pose_gets_the_name_that_is_typed(jogged, capsys):
    jogged.press("c")
    assert "name of this pose?" in capsys.readouterr().out
    jogged.press("q", "u", "x", "\x7f", "i", "e", "t", "\r")
    assert jogged.stops == 0, "q is a letter of the name"
    assert jogged.poses["quiet"] == {"pan": 10.0, "tilt": 60.0}
    jogged.press("q")
    assert jogged.stops == 1


def test_enter_alone_takes_a_free_name_and_escape_none(jogged):
    jogged.press("c", "\r", "c", "\x1b", "c", "\r")
    assert set(jogged.poses) == {"home", "pose", "pose_2"}


def test_a_name_that_is_taken_is_asked_for_again(jogged, capsys):
    jogged.press("c", *"home", "\r")
    assert "there is a pose home" in capsys.readouterr().out
    jogged.press(*"away", "\r")
    assert set(jogged.poses) == {"home", "away"}
    assert jogged.poses["home"] == {"pan": 0.0, "tilt": 0.0}


def test_what_no_name_can_have_is_not_taken(jogged):
    jogged.press("c", *"a b#:/ü\t", "\x1b[A", "c", "\r")
    assert set(jogged.poses) == {"home", "abc"}


def test_a_held_key_types_no_name(jogged):
    jogged.press("c")
    for _ in range(20):
        jogged.now_ns += HELD_NS // 15
        jogged.controls.act(jogged.hands_on, jogged.now_ns)
    jogged.press("\r")
    assert set(jogged.poses) == {"home", "pose"}


def test_with_a_name_given_no_name_is_asked_for(tmp_path):
    jogged = Jogged(tmp_path / "robot.yaml", "nod")
    with jogged.controls:
        jogged.press("c", "c")
    assert set(jogged.poses) == {"home", "nod", "nod_2"}
