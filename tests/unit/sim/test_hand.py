from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot
from lss_motion.sim.hand import HandMotion, hand_from_seed, hand_of

ARM = Path(__file__).resolve().parents[3] / "sequences" / "robots" / "desk_arm.yaml"
SECOND = 1_000_000_000


@pytest.fixture
def arm():
    return load_robot(ARM)


def bus_led_by(arm, hand):
    bus = bus_from_robot(arm, "main", hand=hand)
    bus.record()
    bus.advance(0)
    return bus


RAMP = HandMotion(np.array([0.0, 1.0, 3.0]), {"shoulder": np.array([0.0, 0.0, 40.0])})


def test_a_limp_horn_is_where_the_hand_is_and_stays_where_it_let_go(arm):
    bus = bus_led_by(arm, RAMP)
    bus.advance(5 * SECOND)
    angles_deg = bus.horn_deg([SECOND, 2 * SECOND, 3 * SECOND, 5 * SECOND])[:, 1]
    assert angles_deg == pytest.approx([0.0, -20.0, -40.0, -40.0], abs=0.2)  # direction: -1
    assert np.ptp(bus.horn_deg(range(0, 5 * SECOND, SECOND // 10)), axis=0)[[0, 2, 3, 4]].max() == 0


def test_a_horn_that_holds_gives_way_little_and_comes_back(arm):
    bus = bus_led_by(arm, RAMP)
    bus.write(b"#2H\r", SECOND // 2)
    bus.advance(5 * SECOND)
    end_deg, after_deg = bus.horn_deg([3 * SECOND - 10_000_000, 5 * SECOND])[:, 1]
    assert end_deg == pytest.approx(-2.0, abs=0.2)  # A twentieth of the way.
    assert after_deg == pytest.approx(0.0, abs=0.01)


def test_a_horn_that_is_told_to_hold_in_motion_stops_where_it_is(arm):
    bus = bus_led_by(arm, RAMP)
    bus.write(b"#2H\r", 2 * SECOND)
    bus.advance(5 * SECOND)
    assert bus.horn_deg([5 * SECOND])[0, 1] == pytest.approx(-20.0, abs=0.5)


def test_the_hand_catches_a_horn_that_was_elsewhere_without_a_jump(arm):
    bus = bus_led_by(arm, RAMP)
    bus.write(b"#2H\r", SECOND // 2)
    bus.write(b"#2L\r", int(2.5 * SECOND))
    bus.advance(5 * SECOND)
    angles_deg = bus.horn_deg(range(0, 5 * SECOND, SECOND // 200))[:, 1]
    assert np.abs(np.diff(angles_deg)).max() <= 600.0 / 200 + 0.1
    assert angles_deg[-1] == pytest.approx(-40.0, abs=0.2)


def test_a_hand_from_a_seed_stays_in_the_ranges_and_moves_every_joint(arm):
    hand = hand_of("5", arm)
    again = hand_from_seed(5, arm)
    for name, joint in arm.joints.items():
        column = hand.angles_deg[name]
        np.testing.assert_array_equal(column, again.angles_deg[name])
        assert joint.position_min_deg <= column.min() < column.max() <= joint.position_max_deg
        assert np.ptp(column) > 0.3 * (joint.position_max_deg - joint.position_min_deg)
        assert np.abs(np.diff(column)).max() / 0.01 < joint.speed_max_deg_s


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("", None, "header"),
        ("t_s\n0\n", 1, "header"),
        ("t_s,sholder\n0,1\n", 1, "sholder"),
        ("t_s,base\n0,x\n", 2, "x"),
        ("t_s,base\n0,1\n1,nan\n", 3, "finite"),
        ("t_s,base\n0,1\n0,2\n", 3, "increase"),
        ("t_s,base\n0,1\n1\n", 3, "finite"),
        ("t_s,base\n", None, "no row"),
    ],
)
def test_a_hand_file_that_is_wrong_is_refused_with_its_line(arm, tmp_path, text, line, reason):
    path = tmp_path / "hand.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        hand_of(str(path), arm)
    assert caught.value.line in (line, 1)
