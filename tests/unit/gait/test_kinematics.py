"""Joint angles ⇄ foot of a leg, and the stability margin of a stance."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.show.gait.kinematics import Stance, forward, inverse, neutral_mm, reach_excess_mm
from lss_motion.show.gait.model import Leg, LegKind

COXA = Leg(
    name="lf",
    kind=LegKind.COXA,
    joints=("a", "b", "c"),
    hip_mm=(80.0, 60.0),
    yaw_deg=90.0,
    lengths_mm=(50.0, 80.0, 120.0),
    stance_mm=130.0,
)
DOG = Leg(
    name="lf",
    kind=LegKind.ABDUCTION,
    joints=("a", "b", "c"),
    hip_mm=(100.0, 40.0),
    yaw_deg=0.0,
    lengths_mm=(50.0, 90.0, 80.0),
    stance_mm=50.0,
)
RIGHT_DOG = replace(DOG, hip_mm=(100.0, -40.0))


@pytest.mark.parametrize(
    ("leg", "angles", "foot"),
    [
        # Out along the yaw, femur level, tibia straight down.
        (COXA, (0, 0, 0), (80, 60 + 50 + 80, -120)),
        # A quarter turn to the left from pointing left is backwards.
        (COXA, (90, 0, 0), (80 - 130, 60, -120)),
        # Knee straight up, tibia level again: at a right angle to the femur.
        (COXA, (0, 90, 0), (80, 60 + 50 + 120, 80)),
        # Stretched.
        (COXA, (0, 0, 90), (80, 60 + 250, 0)),
        # Straight down below the thigh.
        (DOG, (0, 0, 0), (100, 90, -170)),
        (RIGHT_DOG, (0, 0, 0), (100, -90, -170)),
        # Swung outwards until the leg is level.
        (DOG, (90, 0, 0), (100, 40 + 170, 50)),
        (RIGHT_DOG, (90, 0, 0), (100, -40 - 170, 50)),
        # Thigh level to the front, shank straight down.
        (DOG, (0, 90, -90), (190, 90, -80)),
        # Thigh level to the back, shank straight down.
        (DOG, (0, -90, 90), (10, 90, -80)),
    ],
)
def test_forward_follows_the_definition_of_the_frames(leg, angles, foot):
    found = forward(leg, np.array([angles], dtype=float))
    np.testing.assert_allclose(found, [foot], atol=1e-9)


def test_knees_bend_to_the_side_of_the_leg():
    foot = np.array([[100.0, 90.0, -120.0]])
    back, ahead = inverse(DOG, foot), inverse(replace(DOG, knee="forward"), foot)
    assert back[0, 1] < 0.0 < back[0, 2]
    assert ahead[0, 2] < 0.0 < ahead[0, 1]
    np.testing.assert_allclose(forward(DOG, back), foot, atol=1e-9)
    np.testing.assert_allclose(forward(DOG, ahead), foot, atol=1e-9)


def test_the_knee_of_an_insect_is_above_its_foot_and_hip():
    angles = inverse(COXA, np.array([[80.0, 190.0, -90.0]]))
    assert angles[0, 1] > 10.0


def test_joint_angles_count_from_the_zero_and_in_the_direction_of_the_leg():
    turned = replace(DOG, zero_deg=(0.0, -74.5, 164.5), direction=(1, -1, -1))
    foot = np.array([[100.0, 90.0, -140.0]])
    plain, joint = inverse(DOG, foot)[0], inverse(turned, foot)[0]
    np.testing.assert_allclose(joint, [plain[0], -(plain[1] + 74.5), 164.5 - plain[2]])
    np.testing.assert_allclose(forward(turned, joint[None]), foot, atol=1e-9)


@pytest.mark.parametrize(
    ("leg", "foot", "words"),
    [
        (COXA, (80, 60 + 50 + 212.5, 0), r"12\.5 mm too far out"),
        (COXA, (80, 60 + 50 + 30, 0), r"10\.0 mm too close"),
        (DOG, (100, 90, -177.25), r"7\.2 mm too far out"),
        (DOG, (100, 80, 0), r"10\.0 mm too close"),
    ],
)
def test_a_foot_out_of_reach_is_named_with_leg_point_and_distance(leg, foot, words):
    feet = np.array([[100.0, 100.0, -100.0], foot])
    with pytest.raises(InputError, match=words) as caught:
        inverse(leg, feet)
    assert f"leg 'lf' cannot reach the foot point x {foot[0]:.1f}, y" in str(caught.value)
    excess = reach_excess_mm(leg, feet)
    assert excess[0] == 0.0
    assert excess[1] != 0.0


def test_a_leg_stands_outwards_of_its_hip():
    np.testing.assert_allclose(neutral_mm(COXA), [80.0, 190.0], atol=1e-9)
    np.testing.assert_allclose(neutral_mm(RIGHT_DOG), [100.0, -90.0], atol=1e-9)


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


def test_feet_are_given_in_the_frame_of_the_body():
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
