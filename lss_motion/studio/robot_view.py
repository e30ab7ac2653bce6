"""What the pages show of a robot: joints, limits, poses and its figure, as JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.show.gait.kinematics import figure_view

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait


def robot_view(robot: Robot, gait: Gait | None = None) -> dict[str, object]:
    """Return the view of a robot; a limit that its file leaves to the servo is None.

    A URDF file that is wrong or missing costs the figure only: `figure_problem` says why.
    """
    figure, figure_problem = None, None
    try:
        figure = figure_view(robot, gait)
    except InputError as error:
        figure_problem = str(error)
    return {
        "name": robot.name,
        "file": None if robot.path is None else str(robot.path),
        "buses": {
            bus.name: {"port": bus.port, "baud_bps": bus.baud_bps} for bus in robot.buses.values()
        },
        "joints": [
            {
                "name": joint.name,
                "id": joint.servo_id,
                "bus": joint.bus,
                "model": joint.model.name,
                "range_deg": [joint.position_min_deg, joint.position_max_deg],
                **{
                    limit: None if limit in joint.unread else getattr(joint, limit)
                    for limit in ("speed_max_deg_s", "accel_max_deg_s2")
                },
                "direction": joint.direction,
                "zero_deg": joint.zero_deg,
            }
            for joint in robot.joints.values()
        ],
        "poses": {name: dict(angles) for name, angles in robot.poses.items()},
        "mirror": robot.mirror,
        "groups": {name: list(joints) for name, joints in robot.groups.items()},
        "figure": figure,
        "figure_problem": figure_problem,
    }
