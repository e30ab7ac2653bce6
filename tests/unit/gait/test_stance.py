from __future__ import annotations

import numpy as np
import pytest

from lss_motion.gait.kinematics import Stance

SQUARE = [[100, 80, 0], [-100, 80, 0], [100, -80, 0], [-100, -80, 0]]


def stance(feet=SQUARE, *, place=(0, 0, 0), shift=(0, 0, 90), tilt=(0, 0, 0), down=None):
    count = len(feet)
    return Stance(
        places=np.array([place], dtype=float),
        shift_mm=np.array([shift], dtype=float),
        tilt_deg=np.array([tilt], dtype=float),
        feet_mm=np.array([feet], dtype=float),
        is_down=np.array([[True] * count if down is None else down]),
    )


def test_the_body_sees_its_feet_below_it():
    feet = stance(place=(30, 40, np.pi / 2)).feet_in_body()[0]
    # Turned left: what is ahead over the ground is to the right of the body.
    np.testing.assert_allclose(feet[0], [80 - 40, -(100 - 30), -90], atol=1e-9)


def test_positive_tilts_are_right_down_nose_down_and_turned_left():
    ahead, right = [100, 0, 0], [0, -100, 0]

    def seen(foot, tilt):
        return stance([foot], tilt=tilt).feet_in_body()[0, 0]

    # The ground comes nearer to the side that goes down.
    assert seen(right, (10, 0, 0))[2] > -80.0
    assert seen(ahead, (0, 10, 0))[2] > -80.0
    # What was ahead is to the right of a body that turned left.
    assert seen(ahead, (0, 0, 10))[1] < -10.0


def test_a_tilted_body_keeps_its_distances():
    plain, tilted = stance().feet_in_body()[0], stance(tilt=(10, -7, 20)).feet_in_body()[0]
    np.testing.assert_allclose(np.linalg.norm(plain, axis=1), np.linalg.norm(tilted, axis=1))
    assert np.abs(plain - tilted).max() > 10.0


@pytest.mark.parametrize(
    ("shift", "down", "margin"),
    [
        ((0, 0, 90), None, 80.0),
        ((0, 30, 90), None, 50.0),
        ((90, 0, 90), None, 10.0),
        ((130, 0, 90), None, -30.0),
        # On the edge of three: the diagonal goes through the centre.
        ((0, 0, 90), [True, True, True, False], 0.0),
        ((30, 0, 90), [True, True, True, False], 30 * 80 / np.hypot(100, 80)),
        ((-30, 0, 90), [True, True, True, False], -30 * 80 / np.hypot(100, 80)),
        # Two feet: the distance to their line; one: to its point; none: no distance.
        ((0, 30, 90), [True, False, False, True], -30 * 100 / np.hypot(100, 80)),
        ((100, 20, 90), [True, False, False, False], -60.0),
        ((0, 0, 90), [False] * 4, -np.inf),
    ],
)
def test_the_margin_is_the_distance_to_the_nearest_edge_of_the_feet_that_stand(shift, down, margin):
    assert stance(shift=shift, down=down).margin_mm()[0] == pytest.approx(margin)


def test_the_margin_turns_and_travels_with_the_body():
    turn = np.array([[0, -1], [1, 0]])
    feet = np.array(SQUARE, dtype=float)
    feet[:, :2] = feet[:, :2] @ turn.T + [500, 300]
    moved = stance(feet.tolist(), place=(500, 300, np.pi / 2), shift=(0, 30, 90))
    assert moved.margin_mm()[0] == pytest.approx(50.0)
