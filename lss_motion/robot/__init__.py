"""robot.yaml → Robot: buses, joints, limits and poses; the table of servo models.

`load_robot(path)` reads a robot file, `robot_schema()` describes one to an editor. Servo models
and what each family can do are in `robot.models`.
"""

from lss_motion.robot.load import load_robot, robot_schema

__all__ = ["load_robot", "robot_schema"]
