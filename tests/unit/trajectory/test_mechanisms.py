"""Plans of joints behind linkages and differentials: whose limit it was, and what is refused."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.playing.api import load_sequence
from lss_motion.robot.load import load_robot

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot

NECK = {
    "robot": "neck",
    "defaults": {"model": "LSS-HS1", "speed_max_deg_s": 200, "accel_max_deg_s2": 900},
    "joints": {
        "tilt": {"range_deg": [-20, 25]},
        "roll": {"range_deg": [-15, 15]},
        "jaw": {
            "id": 1,
            "range_deg": [0, 22],
            "linkage": {"joint_deg": [0, 5, 12, 22], "servo_deg": [-8, 6, 30, 71]},
            "servo": {"speed_max_deg_s": 90},
        },
    },
    "mechanisms": {
        "neck": {
            "kind": "differential",
            "joints": ["tilt", "roll"],
            "servos": {
                "left": {"id": 5, "speed_max_deg_s": 60},
                "right": {"id": 6, "direction": -1},
            },
            "matrix": [[1.8, 1.2], [1.8, -1.2]],
        }
    },
}


def robot_with(**changed: Any) -> Robot:
    return load_robot({**NECK, **changed})


def planned(robot: Robot, *frames: dict[str, Any], **more: Any) -> Trajectory:
    show = {"sequence": "s", "keyframes": list(frames), **more}
    return plan(load_sequence(show, robot), robot)


def test_the_servo_whose_limit_it_was_is_named_with_the_place() -> None:
    trajectory = planned(
        robot_with(),
        {"at_s": 0, "deg": {"tilt": 0, "roll": 0}},
        {"at_s": 0.5, "deg": {"tilt": 20, "roll": 10}},
    )
    span = max(trajectory.stretched, key=lambda span: span.by_s)
    assert (span.joint, span.servo, span.limit) == ("tilt", "left servo of neck", "speed")
    assert span.allowed == 60.0
    assert {name for name, _ in span.at_deg} == {"tilt", "roll"}
    assert "left servo of neck, at tilt" in span.text
    assert trajectory.duration_s > (1.8 * 20 + 1.2 * 10) / 60.0


def test_servos_that_turn_against_each_other_may_be_faster() -> None:
    """Only the left servo is slow, and a roll against the tilt lets it rest."""
    trajectory = planned(
        robot_with(),
        {"at_s": 0, "deg": {"tilt": 0, "roll": 0}},
        {"at_s": 0.5, "deg": {"tilt": 10, "roll": -15}},
    )
    assert not trajectory.stretched


def test_a_linkage_slows_the_joint_where_it_is_steep() -> None:
    robot = robot_with()
    frames = {"at_s": 0, "deg": {"jaw": 0}}, {"at_s": 0.3, "deg": {"jaw": 22}}
    trajectory = planned(robot, *frames)
    assert trajectory.stretched[0].servo == "servo of jaw"
    times_s = np.arange(0.0, trajectory.duration_s, 0.001)
    servo = robot.mechanisms["jaw"].transmission.servo_deg(trajectory.sample(times_s))
    speed = np.abs(np.diff(servo[:, 0])) * 1000.0
    assert speed.max() <= 90.0 * 1.001
    # It uses what the servo has over most of the way, at joint speeds that differ.
    assert np.mean(speed > 88.0) > 0.5


def test_the_verifier_finds_a_servo_that_is_too_fast_by_itself() -> None:
    robot = robot_with()
    free = replace(robot, mechanisms={}, servos={})
    frames = (
        {"at_s": 0, "deg": {"tilt": 0, "roll": 0}},
        {"at_s": 0.5, "deg": {"tilt": 20, "roll": 9}},
    )
    trajectory = planned(free, *frames)
    with pytest.raises(PlanningError, match=r"left servo of neck, at tilt .* would reach speed"):
        verify(trajectory, robot)
    reach = replace(robot.servos["neck.right"], speed_max_deg_s=500.0, position_max_deg=20.0)
    wide = {**robot.servos, "neck.right": reach}
    slow = planned(free, frames[0], {"at_s": 3.0, "deg": {"tilt": 20, "roll": 9}})
    with pytest.raises(PlanningError, match=r"right servo of neck, at .* would be at 20\.\d+ deg"):
        verify(slow, replace(robot, servos=wide))


def test_a_mechanism_is_moved_as_a_whole() -> None:
    with pytest.raises(InputError, match="give roll an angle in the first keyframe"):
        planned(robot_with(), {"at_s": 0, "deg": {"tilt": 0}}, {"at_s": 1, "deg": {"tilt": 5}})
    frames = {"at_s": 0, "deg": {"tilt": 0, "roll": 0}}, {"at_s": 1, "deg": {"tilt": 5}}
    assert planned(robot_with(), *frames).joints == ("tilt", "roll")
    trajectory = planned(replace(robot_with(), mechanisms={}, servos={}), frames[0], frames[1])
    only = planned(
        replace(robot_with(), mechanisms={}, servos={}),
        {"at_s": 0, "deg": {"tilt": 0}},
        {"at_s": 1, "deg": {"tilt": 5}},
    )
    verify(trajectory, robot_with())
    with pytest.raises(PlanningError, match="moves without the other joints of mechanism 'neck'"):
        verify(only, robot_with())


def test_what_cannot_keep_its_time_yet_is_refused() -> None:
    frames = {"at_s": 0, "deg": {"jaw": 0}}, {"at_s": 1, "deg": {"jaw": 9}}
    with pytest.raises(InputError, match="joint 'jaw' cannot keep its time yet"):
        planned(robot_with(), *frames, keep="time")


def test_layers_keep_the_limits_of_servos(tmp_path: Path) -> None:
    import json

    (tmp_path / "robot.yaml").write_text(json.dumps(NECK), encoding="utf-8")
    frames = [{"at_s": 0, "deg": {"roll": 0}}, {"at_s": 0.8, "deg": {"roll": 10}}]
    layer = {"sequence": "l", "robot": "robot.yaml", "keyframes": frames}
    (tmp_path / "layer.yaml").write_text(json.dumps(layer), encoding="utf-8")
    frames = [{"at_s": 0, "deg": {"tilt": 0, "roll": 0}}, {"at_s": 0.8, "deg": {"tilt": 20}}]
    show = {**layer, "keyframes": frames, "layers": [{"file": "layer.yaml", "mode": "add"}]}
    (tmp_path / "show.yaml").write_text(json.dumps(show), encoding="utf-8")
    robot = load_robot(tmp_path / "robot.yaml")
    trajectory = plan(load_sequence(tmp_path / "show.yaml"), robot)
    verify(trajectory, robot)
    assert trajectory.stretched


@pytest.mark.parametrize("names", [("jaw",), ("tilt", "roll")])
def test_smoothed_joints_keep_the_limits_of_servos(names: tuple[str, ...]) -> None:
    """They are averaged over a while, which is no average of what their servos do."""
    robot = robot_with(defaults={**NECK["defaults"], "jerk_max_deg_s3": 6000})
    deg = {"jaw": (0, 20, 3, 22), "tilt": (0, 20, -10, 0), "roll": (0, 10, -10, 0)}
    frames = [
        {"at_s": at_s, "deg": {name: deg[name][index] for name in names}}
        for index, at_s in enumerate((0.0, 0.4, 0.9, 1.5))
    ]
    trajectory = planned(robot, *frames)
    assert trajectory.smoothing
    verify(trajectory, robot)
