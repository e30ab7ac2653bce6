"""Laws of legs and gaits that hold whatever they are told."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.load import load_robot
from lss_motion.show.gait.kinematics import forward, inverse, neutral_mm, reach_excess_mm
from lss_motion.show.gait.load import load_gait, sequence_from
from lss_motion.show.gait.model import PATTERNS, BodyPose, Leg, LegKind, Walk
from lss_motion.show.gait.pacing import paced

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
SAME_MM = 0.01
STEERED = 10
COMMANDS = 40
"""Two walks of 40 commands for each pattern: four of six legs, one of four."""

lengths = st.floats(5.0, 300.0)
angles = st.floats(-180.0, 180.0)
legs = st.builds(
    Leg,
    name=st.just("x"),
    kind=st.sampled_from(LegKind),
    joints=st.just(("a", "b", "c")),
    hip_mm=st.tuples(st.floats(-200.0, 200.0), st.sampled_from([-80.0, 80.0])),
    yaw_deg=angles,
    lengths_mm=st.tuples(lengths, lengths, lengths),
    stance_mm=lengths,
    knee=st.sampled_from(["back", "forward"]),
    zero_deg=st.tuples(angles, angles, angles),
    direction=st.tuples(*[st.sampled_from([1, -1])] * 3),
)


@given(leg=legs, joints=st.lists(st.tuples(angles, angles, angles), min_size=1, max_size=5))
def test_inverse_finds_angles_for_every_point_that_forward_can_reach(leg, joints):
    feet = forward(leg, np.array(joints))
    if leg.kind is LegKind.COXA:
        # A leg does not reach across its own first axis: only what is on the side of its coxa.
        first = np.array(joints)[:, 0] * leg.direction[0] + leg.zero_deg[0] + leg.yaw_deg
        outward = np.stack([np.cos(np.radians(first)), np.sin(np.radians(first))], axis=1)
        feet = feet[((feet[:, :2] - leg.hip_mm) * outward).sum(axis=1) >= 0.0]
        assume(len(feet) > 0)
    np.testing.assert_allclose(forward(leg, inverse(leg, feet)), feet, atol=SAME_MM)


@given(leg=legs, foot=st.tuples(*[st.floats(-900.0, 900.0)] * 3))
def test_a_point_is_reached_within_a_hundredth_or_refused_with_its_distance(leg, foot):
    points = np.array([foot])
    excess_mm = abs(float(reach_excess_mm(leg, points)[0]))
    if excess_mm > 1e-6:
        with pytest.raises(InputError, match=f"it is {excess_mm:.1f} mm too"):
            inverse(leg, points)
    else:
        np.testing.assert_allclose(forward(leg, inverse(leg, points)), points, atol=SAME_MM)


@given(leg=legs, bend=st.floats(1.0, 500.0))
def test_a_point_beyond_the_stretched_leg_is_exactly_that_much_too_far(leg, bend):
    stretched = {LegKind.COXA: (0.0, 0.0, 90.0), LegKind.ABDUCTION: (0.0, 0.0, 0.0)}[leg.kind]
    plain = replace(leg, zero_deg=(0.0, 0.0, 0.0), direction=(1, 1, 1))
    end = forward(plain, np.array([stretched]))
    longer = replace(plain, lengths_mm=(*leg.lengths_mm[:2], leg.lengths_mm[2] + bend))
    beyond = forward(longer, np.array([stretched]))
    assert np.linalg.norm(beyond - end) == pytest.approx(bend)
    assert reach_excess_mm(leg, beyond)[0] == pytest.approx(bend, abs=1e-6)


HEXAPOD = replace(
    load_gait(EXAMPLES / "hexapod_walk.yaml"), start=BodyPose(), cycle_s=1.0, step_height_mm=15.0
)
ROBOT = load_robot(EXAMPLES / "robots" / "hexapod.yaml")
QUADRUPED = replace(load_gait(EXAMPLES / "quadruped_trot.yaml"), cycle_s=1.0, step_height_mm=10.0)
DOG = load_robot(EXAMPLES / "robots" / "quadruped.yaml")


def steered(gait, commands):
    walks = [
        Walk(forward_mm_s=ahead, left_mm_s=left, turn_deg_s=turn, cycles=cycles)
        for ahead, left, turn, cycles in commands
    ]
    return replace(gait, actions=tuple(walks))


def assert_walks_and_stands(gait, robot):
    """No limit broken, nothing out of reach, no slip, and a stable stand at the end."""
    (part,) = parts = paced(gait, robot)
    trajectory = plan(sequence_from(gait, parts), robot)  # Verified at 1 kHz.
    at_s = np.linspace(0.0, part.times_s[-1], 20 * len(gait.actions) + 1)
    stance = part.passage.at(at_s)
    if gait.pattern.is_static:
        assert stance.margin_mm().min() >= 0.0
    neutral = [[*neutral_mm(leg), -gait.height_mm] for leg in gait.legs]
    np.testing.assert_allclose(stance.feet_in_body()[-1], neutral, atol=1e-6)
    assert stance.is_down[-1].all()
    first, last = trajectory.sample(np.array([0.0, trajectory.duration_s]))
    np.testing.assert_allclose(first, last, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(STEERED))
def test_whatever_is_steered_breaks_no_limit_and_ends_in_a_stable_stand(seed):
    random = np.random.default_rng(seed)
    known = [*PATTERNS[6].values(), PATTERNS[4]["trot"]]
    pattern = known[seed % len(known)]
    is_dog = len(pattern.lifts_ratio) == 4
    gait = replace(QUADRUPED if is_dog else HEXAPOD, pattern=pattern, duty=pattern.duty_ratio)
    most = (30.0, 15.0, 10.0) if is_dog else (50.0, 40.0, 15.0)
    commands = [(*(random.uniform(-1.0, 1.0, 3) * most).tolist(), 1) for _ in range(COMMANDS)]
    assert_walks_and_stands(steered(gait, commands), DOG if is_dog else ROBOT)


@settings(max_examples=settings().max_examples // 8)
@given(
    commands=st.lists(
        st.tuples(st.floats(-50, 50), st.floats(-40, 40), st.floats(-15, 15), st.integers(1, 3)),
        min_size=1,
        max_size=4,
    ),
    pattern=st.sampled_from([*PATTERNS[6].values()]),
    duty=st.floats(0.5, 0.9),
)
def test_any_walk_that_is_not_refused_stands_at_its_end(commands, pattern, duty):
    gait = replace(HEXAPOD, pattern=pattern, duty=max(duty, pattern.duty_ratio))
    assert_walks_and_stands(steered(gait, commands), ROBOT)
