"""robot.yaml → Robot: buses, joints, limits and poses; the table of servo models.

`load.load_robot(path)` reads a robot file, `load.robot_schema()` describes one to an editor. Servo
models and what each family can do are in `models`.
"""
