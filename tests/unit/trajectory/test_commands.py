"""The ease `command`: a joint moves as its servo does by itself on one command."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Response
from lss_motion.robot.profile import ramp_deg_s2
from lss_motion.show.model import Interpolation, Keyframe, Sequence
from lss_motion.sim.profile import Ramps, plan_move, travel_speed_deg_s


@pytest.fixture
def arm(make_robot):
    return make_robot(1)


def script(*moves: tuple[float, float, float], hold_s: float = 0.5) -> Sequence:
    """Return commands for the base: instant, angle and duration of each."""
    frames = [Keyframe(at_s=0.0, deg={"base": 0.0})]
    here_deg = 0.0
    for at_s, deg, duration_s in moves:
        if at_s > (frames[-1].at_s or 0.0):
            frames.append(Keyframe(at_s=at_s, deg={"base": here_deg}))
        frames.append(Keyframe(at_s=round(at_s + duration_s, 6), deg={"base": deg}))
        here_deg = deg
    frames[-1] = replace(frames[-1], hold_s=hold_s)
    eased = tuple(replace(frame, ease=Interpolation.COMMAND) for frame in frames)
    return Sequence(name="script", keyframes=eased, keeps_time=frozenset({"base"}))


def with_response(arm, **fields):
    base = replace(arm.joints["base"], response=Response(**fields))
    return replace(arm, joints={**arm.joints, "base": base})


def simulated(joint, moves, times_s: np.ndarray) -> np.ndarray:
    """Return the angles of the simulated servo, which shares no code with the planner."""
    ramp = ramp_deg_s2(joint)
    ramps = Ramps(joint.speed_max_deg_s, ramp, ramp)
    found = np.zeros(len(times_s))
    position_deg = speed_deg_s = 0.0
    for (at_s, deg, duration_s), until_s in zip(
        moves, [at_s for at_s, _, _ in moves[1:]] + [1e9], strict=True
    ):
        away = deg - position_deg
        law = joint.response.t_law
        most = Ramps(1e4, ramp, ramp)
        toward = np.sign(away) * speed_deg_s
        travel = travel_speed_deg_s(abs(away), duration_s, toward, most, law)
        phases = plan_move(position_deg, speed_deg_s, deg, ramps._replace(speed_deg_s=travel))
        start_s = at_s
        for phase in phases:
            end_s = min(start_s + phase.duration_s, until_s)
            chosen = (times_s >= start_s) & (times_s < end_s)
            local_s = times_s[chosen] - start_s
            found[chosen] = phase.position_deg + local_s * (
                phase.speed_deg_s + 0.5 * phase.accel_deg_s2 * local_s
            )
            if start_s < until_s:
                last_s = end_s - start_s if np.isfinite(end_s) else 0.0
                position_deg = phase.position_deg + last_s * (
                    phase.speed_deg_s + 0.5 * phase.accel_deg_s2 * last_s
                )
                speed_deg_s = phase.speed_deg_s + phase.accel_deg_s2 * last_s
            start_s = end_s
    return found


RESTING = [(0.5, 30.0, 1.0), (2.0, -20.0, 0.8), (3.5, 0.0, 1.2)]
FLOWING = [
    (0.5, 30.0, 1.0),
    (1.5, 50.0, 0.5),
    (2.0, -20.0, 0.9),
    (2.9, -25.0, 0.4),
    (3.3, 0.0, 1.0),
]


@pytest.mark.parametrize("law", ["cruise", "exact"])
@pytest.mark.parametrize("moves", [RESTING, FLOWING])
def test_the_plan_is_the_motion_of_the_simulated_servo(arm, law: str, moves) -> None:
    robot = with_response(arm, t_law=law)
    trajectory = plan(script(*moves), robot)
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    own = simulated(robot.joints["base"], moves, times_s)
    np.testing.assert_allclose(trajectory.sample(times_s)[:, 0], own, atol=1e-5)
    made = [(move.at_s, move.deg, move.duration_s) for move in trajectory.commands]
    np.testing.assert_allclose(made, moves, atol=1e-9)


def test_a_turn_that_comes_before_its_angle_is_named(arm) -> None:
    moves = [(0.5, 60.0, 1.0), (1.5, 0.0, 1.0), (2.5, 60.0, 1.0)]
    trajectory = plan(script(*moves), arm)
    assert len(trajectory.commands) == 3
    (span,) = trajectory.given_up
    assert (span.joint, span.at_s) == ("base", 2.5)
    lowest_deg = trajectory.sample(np.arange(2.0, 3.0, 0.001))[:, 0].min()
    assert span.by_deg == pytest.approx(lowest_deg, abs=1e-3)
    assert span.by_deg > 1.0


TOO_FAST = [(0.5, 30.0, 1.0), (2.0, -40.0, 0.1), (3.0, 0.0, 1.0)]


def test_a_command_that_is_too_fast_gets_the_least_t_and_its_neighbours_stay(arm) -> None:
    trajectory = plan(script(*TOO_FAST), arm)
    speed_max_deg_s = arm.joints["base"].speed_max_deg_s
    least_s = np.ceil(1e3 * 70.0 / speed_max_deg_s) / 1e3
    made = [(move.at_s, move.deg, move.duration_s) for move in trajectory.commands]
    np.testing.assert_allclose(made, [(0.5, 30, 1), (2, -40, least_s), (3, 0, 1)], atol=1e-9)
    (span,) = trajectory.given_up
    assert (span.from_s, span.to_s) == (2.0, 2.1)
    at_key_deg = trajectory.sample(np.array([2.1]))[0, 0]
    assert span.by_deg == pytest.approx(at_key_deg + 40.0)
    assert trajectory.duration_s == pytest.approx(4.5)
    at_s = np.array([1.55, 2.98, 3.0])
    np.testing.assert_allclose(trajectory.sample(at_s)[:, 0], [30.0, -40.0, -40.0], atol=1e-6)


IN_THE_WAY = [(0.5, 60.0, 0.8), (1.3, 54.0, 0.6), (2.2, 0.0, 0.9)]
"""The second command comes when its servo is at its angle, in motion; it would creep back to it."""


@pytest.mark.parametrize("law", ["cruise", "exact"])
def test_the_servo_turns_back_for_a_command_that_it_passes_and_does_not_creep(arm, law) -> None:
    robot = with_response(arm, t_law=law)
    trajectory = plan(script(*IN_THE_WAY), robot)
    moves = [(move.at_s, move.deg, move.duration_s) for move in trajectory.commands]
    np.testing.assert_allclose([moves[0], moves[2]], [IN_THE_WAY[0], IN_THE_WAY[2]])
    assert moves[1][1] == 54.0
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    own = simulated(robot.joints["base"], moves, times_s)
    np.testing.assert_allclose(trajectory.sample(times_s)[:, 0], own, atol=1e-5)
    assert trajectory.sample(np.array([1.9]))[0, 0] == pytest.approx(54.0, abs=0.02)


def test_a_command_that_the_next_replaces_before_a_t_helps_is_left_out(arm) -> None:
    """The servo passes the angle when the command comes, and 20 ms later comes the next one."""
    first = (0.5, 60.0, 0.6)
    passed_deg = float(plan(script(first), arm).sample(np.array([1.1]))[0, 0])
    trajectory = plan(script(first, (1.1, passed_deg, 0.02), (1.12, 0.0, 1.2)), arm)
    assert [move.deg for move in trajectory.commands] == [60.0, 0.0]
    moves = [(move.at_s, move.deg, move.duration_s) for move in trajectory.commands]
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    own = simulated(arm.joints["base"], moves, times_s)
    np.testing.assert_allclose(trajectory.sample(times_s)[:, 0], own, atol=1e-5)


def test_a_command_after_which_the_show_ends_at_once_is_not_left_to_the_servo(arm) -> None:
    trajectory = plan(script((0.5, 30.0, 1.0), (2.0, 0.0, 1.0), hold_s=0.0), arm)
    assert [move.at_s for move in trajectory.commands] == [0.5]
    assert trajectory.sample(np.array([3.0]))[0, 0] == pytest.approx(0.0, abs=1e-6)


def test_only_joints_that_keep_their_time_can_have_it(arm) -> None:
    late = replace(script(*RESTING), keeps_time=frozenset())
    with pytest.raises(InputError, match="'base' moves with the ease command, which only joints"):
        plan(late, arm)


def test_a_stored_plan_has_the_commands(arm, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path))
    long = script(*[(0.5 + 2.0 * n, 30.0 * (n % 2 == 0), 1.0) for n in range(30)])
    made = plan(long, arm)
    assert list(tmp_path.iterdir())
    assert len(made.commands) == 30
    assert plan(long, arm).commands == made.commands
