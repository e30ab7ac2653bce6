r"""A ROS 2 node: joints follow `joint_targets`, and are reported as `joint_states`.

Both topics have `sensor_msgs/msg/JointState`, radians. It was written by the documentation of rclpy
and tried with a stand-in for it; IT WAS NEVER RUN WITH ROS 2.

    python3 sequences/nodes/targets_ros2.py sequences/robots/desk_arm.yaml
    ros2 topic pub -r 20 /joint_targets sensor_msgs/msg/JointState \
        "{name: [elbow], position: [0.5]}"

The robot is `sim://` unless its file or `--port` names another. A target that is refused is logged
and changes nothing; when no more come, the joints brake and hold.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from typing import Any

import lss_motion as lss

STATES_HZ = 20.0


def targets_deg(names: Sequence[str], position_rad: Sequence[float]) -> dict[str, float]:
    """Return the targets of a message, in degrees; raises `InputError` for one without angles."""
    if len(names) != len(position_rad):
        raise lss.InputError(f"{len(names)} names and {len(position_rad)} positions")
    return {name: math.degrees(rad) for name, rad in zip(names, position_rad, strict=True)}


def states_rad(deg: Mapping[str, float]) -> tuple[list[str], list[float]]:
    """Return names and positions of a message about joints that are at these degrees."""
    return list(deg), [math.radians(angle) for angle in deg.values()]


def make_node(live: lss.Live) -> Any:  # noqa: ANN401  (rclpy has no types)
    """Return the node; rclpy must have been started."""
    from rclpy.node import Node
    from sensor_msgs.msg import JointState

    node = Node("lss_motion")
    publisher = node.create_publisher(JointState, "joint_states", 10)

    def follow(message: Any) -> None:  # noqa: ANN401
        try:
            live.set_target(targets_deg(message.name, message.position))
        except lss.InputError as error:
            node.get_logger().warning(f"refused: {error}")

    def report() -> None:
        message = JointState()
        message.header.stamp = node.get_clock().now().to_msg()
        message.name, message.position = states_rad(live.read())
        publisher.publish(message)

    node.create_subscription(JointState, "joint_targets", follow, 1)
    node.create_timer(1.0 / STATES_HZ, report)
    return node


def main(words: Sequence[str] | None = None) -> None:
    """Connect the robot of the file and spin until Ctrl-C."""
    import rclpy

    parser = argparse.ArgumentParser(description="lead joints by a ROS 2 topic")
    parser.add_argument("robot", metavar="ROBOT", help="a robot file")
    parser.add_argument("--port", help="in place of the port of the file")
    arguments, ros_arguments = parser.parse_known_args(words)
    rclpy.init(args=ros_arguments)
    with lss.connect(lss.load_robot(arguments.robot), port=arguments.port) as live:
        live.set_target({})  # From here on `read` waits for nothing.
        node = make_node(live)
        try:
            rclpy.spin(node)
        except KeyboardInterrupt:
            pass
        finally:
            node.destroy_node()
            if rclpy.ok():
                rclpy.shutdown()


if __name__ == "__main__":
    main()
