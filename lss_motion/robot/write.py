"""Writes measured values into a robot file that a person wrote.

Law: all other text of the file stays as it is, comments included. The file is replaced at once or
not at all, after the new text was loaded and compared with the expected robot.
"""

from __future__ import annotations

import codecs
from typing import TYPE_CHECKING, Any, Literal

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.output import write_output
from lss_motion.files.source import read_data, text_of
from lss_motion.files.yaml_edit import set_comment, set_values
from lss_motion.files.yaml_text import WrittenValue, flow_text
from lss_motion.robot.load import load_robot

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from lss_motion.robot.model import Robot


def write_response(
    path: Path,
    joint_name: str,
    values: Mapping[str, Any],
    comments: Sequence[str],
    *,
    output: Path | None = None,
) -> None:
    """Set fields of a joint's `response` in the robot file, or in a copy of it at `output`.

    `comments` are written above the joint, in place of those of the last call. Raises `InputError`
    if the text cannot be changed, or if the changed file would differ in other values.
    """
    text, mark = _text_of(path)
    changed = set_values(path, text, ("joints", joint_name, "response"), values)
    changed = set_comment(
        path, changed, ("joints", joint_name), f"{joint_name} identified", comments
    )
    robot = load_robot(path)
    servo = robot.servo_robot.joints[joint_name]

    def expected(made: Robot) -> Robot:
        measured = replace(
            servo,
            response=replace(servo.response, **values),
            # Depends on the ramps.
            accel_max_deg_s2=made.servo_robot.joints[joint_name].accel_max_deg_s2,
        )
        if not robot.servos:
            return replace(robot, joints={**robot.joints, joint_name: measured})
        servos = {**robot.servos, joint_name: measured}
        is_behind = any(joint_name in one.servos for one in robot.mechanisms.values())
        joint = made.joints[joint_name] if is_behind else measured
        return replace(robot, joints={**robot.joints, joint_name: joint}, servos=servos)

    text = ", ".join(f"{key}: {value}" for key, value in values.items())
    _replace(
        mark + changed.encode("utf-8"),
        output or path,
        source=path,
        expected=expected,
        by_hand=f"joint {joint_name!r}: add `response: {{{text}}}` to it",
    )


def write_pose(path: Path, name: str, angles_deg: Mapping[str, float]) -> None:
    """Add a pose to the robot file, or set joints of a pose that it has.

    Raises `InputError` as `write_response` does.
    """
    text, mark = _text_of(path)
    changed = set_values(path, text, ("poses", name), angles_deg)
    robot = load_robot(path)
    pose = {**robot.poses.get(name, {}), **angles_deg}
    text = ", ".join(f"{joint}: {angle:g}" for joint, angle in angles_deg.items())
    _replace(
        mark + changed.encode("utf-8"),
        path,
        source=path,
        expected=lambda _: replace(robot, poses={**robot.poses, name: pose}),
        by_hand=f"add `{name}: {{{text}}}` to its poses",
    )


def write_frames(
    path: Path,
    frames: Mapping[str, tuple[float, Literal[1, -1]]],
    stored: Mapping[str, Mapping[str, float]],
) -> None:
    """Set `zero_deg` and `direction` of joints in the robot file; equal values are not written.

    `stored` are settings that the joints' `stored` states from now on. Raises `InputError` as
    `write_response` does.
    """
    text, mark = _text_of(path)
    robot = load_robot(path)
    joints, servos = dict(robot.joints), dict(robot.servos)
    for name, (zero_deg, direction) in frames.items():
        joint = joints[name]
        values: dict[str, float] = {}
        if joint.zero_deg != zero_deg:
            values["zero_deg"] = zero_deg
        if joint.direction != direction:
            values["direction"] = direction
        text = set_values(path, text, ("joints", name), values)
        own = stored.get(name, {})
        text = set_values(path, text, ("joints", name, "stored"), own)
        joints[name] = replace(
            joint, zero_deg=zero_deg, direction=direction, stored={**joint.stored, **own}
        )
        if name in servos:
            servos[name] = joints[name]
    by_hand = "; ".join(f"{n}: zero_deg {z:g}, direction {d}" for n, (z, d) in frames.items())
    _replace(
        mark + text.encode("utf-8"),
        path,
        source=path,
        expected=lambda _: replace(robot, joints=joints, servos=servos),
        by_hand=f"set {by_hand}",
    )


def write_linkage(path: Path, name: str, points: Sequence[tuple[float, float]]) -> list[str]:
    """Write measured points, joint and servo angles, as the linkage of a joint.

    Its range becomes what was measured, where that is less or the joint had no linkage. Return what
    a person should check now. Raises `InputError` as `write_response` does.
    """
    text, mark = _text_of(path)
    robot = load_robot(path)
    joint, is_new = robot.joints[name], name not in robot.mechanisms
    columns = {"joint_deg": [one for one, _ in points], "servo_deg": [one for _, one in points]}
    values = {key: WrittenValue(flow_text(column), column) for key, column in columns.items()}
    changed = set_values(path, text, ("joints", name, "linkage"), values)
    low, high = points[0][0], points[-1][0]
    if not is_new:
        low, high = max(low, joint.position_min_deg), min(high, joint.position_max_deg)
    lines = [f"{path}: linkage of {name} written"]
    if (low, high) != (joint.position_min_deg, joint.position_max_deg):
        ends = [low, high]
        range_deg = {"range_deg": WrittenValue(flow_text(ends), ends)}
        changed = set_values(path, changed, ("joints", name), range_deg)
        lines.append(f"range_deg of {name} is now {low:g} to {high:g}, degrees of the joint")
    if is_new:
        lines.append(
            f"speed_max_deg_s and accel_max_deg_s2 of {name} are now in degrees of the joint, "
            f"those of its servo under `servo`; `lss-motion check {path}` prints both"
        )

    def expected(made: Robot) -> Robot:
        servos = {**robot.servo_robot.joints, name: made.servos[name]}
        return replace(
            robot,
            joints={**robot.joints, name: made.joints[name]},
            servos=servos,
            mechanisms={**robot.mechanisms, name: made.mechanisms[name]},
        )

    _replace(
        mark + changed.encode("utf-8"),
        path,
        source=path,
        expected=expected,
        by_hand=f"joint {name!r}: add `linkage: {flow_text(columns)}` to it",
    )
    return lines


def _text_of(path: Path) -> tuple[str, bytes]:
    """Return the text of the file and its byte-order mark, if it has one."""
    data = read_data(path)
    return text_of(data, path), codecs.BOM_UTF8 if data.startswith(codecs.BOM_UTF8) else b""


def _replace(
    data: bytes,
    output: Path,
    *,
    source: Path,
    expected: Callable[[Robot], Robot],
    by_hand: str,
) -> None:
    """Replace the file if `data` loads as the expected robot; else raise `InputError`."""

    def check(made: Path) -> None:
        changed = load_robot(made)
        if replace(changed, path=None) != replace(expected(changed), path=None):
            raise InputError(
                f"is written in a way that cannot be changed here; by hand, {by_hand}",
                path=source,
            )

    write_output(output, data, check=check, like=source)
