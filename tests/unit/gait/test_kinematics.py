from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.gait.kinematics import forward, inverse, neutral_mm, reach_excess_mm
from lss_motion.gait.model import Leg, LegKind

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
def test_forward_puts_the_foot_where_the_frames_say(leg, angles, foot):
    found = forward(leg, np.array([angles], dtype=float))
    np.testing.assert_allclose(found, [foot], atol=1e-9)


def test_knees_bend_to_the_side_that_was_asked_for():
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
