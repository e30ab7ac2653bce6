"""ROS motions in YAML: JointTrajectory messages, play_motion and play_motion2 collections, goals.

Positions are radians (REP 103), or metres for a sliding joint; the file does not define which. A
joint with the name of a sliding joint therefore needs a map.

`ros2 topic echo` separates messages by documents. Joint states are a recording, and so are
trajectories of one point each with increasing stamps; other trajectories are a motion each.
"""

from __future__ import annotations

import re
from functools import partial
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Final, NoReturn

from msgspec.structs import replace

from lss_motion.files.source import text_of
from lss_motion.files.texts import counted
from lss_motion.interchange.fields import VALUE_MAX
from lss_motion.interchange.reader import (
    ForeignMotion,
    Pose,
    Reader,
    is_dense,
    motion_of_poses,
    read_or_refused,
    summarised,
    unit_of_ros_joint,
)
from lss_motion.interchange.yaml_nodes import NodeFields, YamlNode, yaml_trees
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from lss_motion.interchange.reader import RefusedMotion


_WRAPPINGS: Final = ("goal", "trajectory", "joint_trajectory", "play_motion", "ros__parameters")
"""Keys around a trajectory or a collection of motions. The name of a node may be one as well."""

SHORTENED: Final = "..."
"""What `ros2 topic echo` writes in place of what is beyond the first 128 of a list."""

GOAL_S: Final = 4.0
"""Time to reach a published goal without `time_from_start`; less if the next goal comes earlier.
Assumed: the publisher of ros2_controllers_test_nodes uses this time."""

_POINT_EXTRAS: Final = ("velocities", "accelerations", "effort", "efforts")


_STATE: Final = re.compile(rb"^name:.{0,20000}?^position:", re.DOTALL | re.MULTILINE)
"""A message of joint states, after its header."""


def _is_ros(data: bytes) -> bool:
    if b"joint_names" in data and b"points" in data:
        return True
    if b"goal_names" in data and b"joints" in data:
        return True
    if _STATE.search(data) is not None:
        return True
    has_times = b"time_from_start" in data or b"times_from_start" in data
    return b"motions" in data and b"joints" in data and has_times


def _ros_motions(path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
    file = _RosFile(path)
    trees = yaml_trees(text_of(data, path), path)
    first = next(trees)
    if isinstance(first.value, dict) and {"name", "position"} <= first.value.keys():
        return (file.states(path.stem, chain([first], trees)),)
    top = file.unwrapped(first)
    if "joint_names" in top:
        return file.trajectories(path.stem, [first, *trees])
    if "goal_names" in top:
        return (file.goals(path.stem, top),)
    listed = file.mapping(top["motions"], "motions")
    if not listed:
        file.refuse(top["motions"], "'motions' holds no motion")
    return tuple(
        read_or_refused(name, partial(file.listed_motion, name, node))
        for name, node in listed.items()
    )


ROS: Final = Reader("ros", _is_ros, _ros_motions)
"""Reads `{joint_names, points}` and `{motions: {name: {joints, points | positions}}}`.

It also reads the parameters of a publisher of goals: `{goal_names, wait_sec_between_publish,
joints}`, and the goals under their names.
"""


class _RosFile(NodeFields):
    """Converts the nodes of one file."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.left_out: list[str] = []

    def refuse(self, node: YamlNode, reason: str) -> NoReturn:
        """Raise `InputError` with the line; what an echo left out is named as that."""
        if node.value == SHORTENED:
            reason = "left out by `ros2 topic echo`; write it with --full-length"
        super().refuse(node, reason)

    def unwrapped(self, node: YamlNode) -> dict[str, YamlNode]:
        """Return the mapping with `joint_names`, `motions` or `goal_names` inside the wrappings."""
        while True:
            here = self.mapping(node, "the file")
            if "joint_names" in here or "motions" in here or "goal_names" in here:
                return here
            inner = next((here[key] for key in _WRAPPINGS if key in here), None)
            if inner is None and len(here) == 1:
                inner = next(iter(here.values()))
            if inner is None or not isinstance(inner.value, dict):
                self.refuse(node, "must have 'joint_names' and 'points', or 'motions'")
            node = inner

    def states(self, name: str, messages: Iterable[YamlNode]) -> ForeignMotion:
        """Return the recording of joint states, each with its stamp."""
        poses: list[Pose] = []
        for number, node in enumerate(messages, start=1):
            where = f"message {number}"
            message = self.mapping(node, where)
            if not {"name", "position", "header"} <= message.keys():
                self.refuse(node, f"{where} needs a 'header', 'name' and 'position'")
            header = self.mapping(message["header"], "'header'")
            if "stamp" not in header:
                self.refuse(message["header"], f"{where}: its header has no 'stamp'")
            names = [str(item.value) for item in self.items(message["name"], "'name'")]
            values = [self.number(item) for item in self.items(message["position"], "'position'")]
            if len(values) != len(names) or len(set(names)) < len(names):
                self.refuse(
                    node, f"{where} has {counted(values, 'position')} for {counted(names, 'joint')}"
                )
            poses.append(
                Pose(
                    at_s=self._time(header["stamp"]),
                    values=dict(zip(names, values, strict=True)),
                    place=where,
                    line=node.line,
                )
            )
        comments = [f"Imported from {self.path.name} (ROS, joint states)."]
        motion = motion_of_poses(
            self.path, name, poses, unit_of=unit_of_ros_joint, comments=comments
        )
        is_recording = any(is_dense(channel.times_s) for channel in motion.channels)
        return replace(motion, is_recording=is_recording)

    def trajectories(
        self, name: str, messages: list[YamlNode]
    ) -> tuple[ForeignMotion | RefusedMotion, ...]:
        """Return the motion of each message, or of all if they are single points with stamps."""
        if len(messages) == 1:
            return (self._trajectory(name, messages[0]),)
        found = [
            read_or_refused(f"message {number}", partial(self._trajectory, f"message {number}", it))
            for number, it in enumerate(messages, start=1)
        ]
        starts_s = [self._stamp_s(node) for node in messages]
        is_streamed = all(
            isinstance(motion, ForeignMotion)
            and all(len(channel.times_s) == 1 for channel in motion.channels)
            for motion in found
        )
        if not is_streamed or any(b <= a for a, b in pairwise(starts_s)):
            return tuple(found)
        poses = [
            Pose(
                at_s=start_s + float(motion.channels[0].times_s[0]),
                values={channel.name: float(channel.values[0]) for channel in motion.channels},
                place=motion.name,
                line=node.line,
            )
            for start_s, motion, node in zip(starts_s, found, messages, strict=True)
            if isinstance(motion, ForeignMotion)
        ]
        comments = [f"Imported from {self.path.name} (ROS, trajectories of one point each)."]
        motion = motion_of_poses(
            self.path, name, poses, unit_of=unit_of_ros_joint, comments=comments
        )
        return (motion,)

    def _trajectory(self, name: str, node: YamlNode) -> ForeignMotion:
        top = self.unwrapped(node)
        if "joint_names" not in top:
            self.refuse(node, "must have 'joint_names' and 'points'")
        return self.motion(name, top, top["joint_names"])

    def _stamp_s(self, node: YamlNode) -> float:
        """Return the stamp of a message in seconds; 0 where it has none."""
        top = node.value if isinstance(node.value, dict) else {}
        header = top["header"].value if "header" in top else None
        if not isinstance(header, dict) or "stamp" not in header:
            return 0.0
        return self._time(header["stamp"])

    def goals(self, name: str, top: dict[str, YamlNode]) -> ForeignMotion:
        """Return the goals that a publisher sends, one every `wait_sec_between_publish`."""
        for key in ("joints", "wait_sec_between_publish"):
            if key not in top:
                self.refuse(top["goal_names"], f"'goal_names' needs {key!r} beside it")
        joints = [str(item.value) for item in self.items(top["joints"], "'joints'")]
        wait_s = self.number(top["wait_sec_between_publish"])
        if wait_s <= 0.0 or len(set(joints)) < len(joints):
            self.refuse(top["joints"], "needs a wait above 0 s, and every joint once")
        poses: list[Pose] = []
        for index, item in enumerate(self.items(top["goal_names"], "'goal_names'")):
            goal = str(item.value)
            if goal not in top:
                self.refuse(item, f"goal {goal!r:.60} does not exist")
            poses.append(self._goal(goal, top[goal], joints, index * wait_s, wait_s))
        known = {"goal_names", "joints", "wait_sec_between_publish", "controller_name"}
        found = [key for key in top if key not in {*known, *(pose.label for pose in poses)}]
        comments = [
            f"Imported from {self.path.name} (ROS, goals of a publisher).",
            *summarised(found),
        ]
        return motion_of_poses(self.path, name, poses, unit_of=unit_of_ros_joint, comments=comments)

    def _goal(
        self, name: str, node: YamlNode, joints: list[str], sent_s: float, wait_s: float
    ) -> Pose:
        parts = node.value if isinstance(node.value, dict) else {"positions": node}
        if "positions" not in parts:
            self.refuse(node, f"goal {name!r:.60} has no 'positions'")
        values = [self.number(value) for value in self.items(parts["positions"], name)]
        if len(values) != len(joints):
            self.refuse(
                node, f"{name:.60} has {counted(values, 'position')} for {counted(joints, 'joint')}"
            )
        needed_s = self._time(parts["time_from_start"]) if "time_from_start" in parts else GOAL_S
        reached_s = min(max(needed_s, 0.0), wait_s)
        return Pose(
            at_s=sent_s + reached_s,
            values=dict(zip(joints, values, strict=True)),
            hold_s=wait_s - reached_s,
            label=name,
            place=name,
            line=node.line,
        )

    def listed_motion(self, name: str, node: YamlNode) -> ForeignMotion:
        """Return one motion of a collection."""
        motion = self.mapping(node, name)
        if "joints" not in motion:
            self.refuse(node, f"motion {name!r:.60} has no 'joints'")
        return self.motion(name, motion, motion["joints"])

    def motion(self, name: str, motion: dict[str, YamlNode], joints: YamlNode) -> ForeignMotion:
        """Return the motion with `points`, or with the flat lists of play_motion2."""
        names = [str(item.value) for item in self.items(joints, "the list of joints")]
        if len(set(names)) < len(names):
            twice = next(joint for joint in names if names.count(joint) > 1)
            self.refuse(joints, f"joint {twice!r:.60} is listed twice")
        self.left_out = []
        if "points" in motion:
            poses = list(self._points(motion["points"], names))
        else:
            poses = list(self._flat(name, motion, joints, names))
        comments = [f"Imported from {self.path.name} (ROS, motion {name!r:.60}).", *_about(motion)]
        comments += summarised(self.left_out)
        return motion_of_poses(self.path, name, poses, unit_of=unit_of_ros_joint, comments=comments)

    def _points(self, node: YamlNode, names: list[str]) -> Iterator[Pose]:
        for index, item in enumerate(self.items(node, "'points'")):
            where = f"point {index + 1}"
            point = self.mapping(item, where)
            if "positions" not in point:
                self.refuse(item, f"{where} has no 'positions'")
            if "time_from_start" not in point:
                self.refuse(item, f"{where} has no 'time_from_start'")
            values = [self.number(value) for value in self.items(point["positions"], where)]
            if len(values) != len(names):
                self.refuse(
                    item, f"{where} has {counted(values, 'position')} for {counted(names, 'joint')}"
                )
            self.left_out += [key for key in _POINT_EXTRAS if key in point and point[key].value]
            yield Pose(
                at_s=self._time(point["time_from_start"]),
                values=dict(zip(names, values, strict=True)),
                place=where,
                line=item.line,
            )

    def _flat(
        self, name: str, motion: dict[str, YamlNode], joints: YamlNode, names: list[str]
    ) -> Iterator[Pose]:
        """Yield the poses of play_motion2: one list of positions, row by row."""
        for key in ("positions", "times_from_start"):
            if key not in motion:
                self.refuse(joints, f"motion {name!r:.60} has no {key!r}")
        positions = self.items(motion["positions"], "'positions'")
        times = self.items(motion["times_from_start"], "'times_from_start'")
        if len(positions) != len(times) * len(names):
            self.refuse(
                motion["positions"],
                f"{len(positions)} positions are not {len(times)} times {len(names)} joints",
            )
        for index, time in enumerate(times):
            row = positions[index * len(names) : (index + 1) * len(names)]
            yield Pose(
                at_s=self._time(time),
                values=dict(zip(names, map(self.number, row), strict=True)),
                place=f"time {index + 1}",
                line=time.line,
            )

    def _time(self, node: YamlNode) -> float:
        if isinstance(node.value, str):
            return self.number(node)
        if isinstance(node.value, list):  # As `rostopic pub` accepts it.
            if len(node.value) != 2:
                self.refuse(node, "a time as a list must be [seconds, nanoseconds]")
            return self.number(node.value[0], VALUE_MAX) + self.number(node.value[1]) / NS_PER_S
        parts = self.mapping(node, "a time")
        seconds = next((parts[key] for key in ("sec", "secs") if key in parts), None)
        rest = next((parts[key] for key in ("nanosec", "nsecs", "nanosecs") if key in parts), None)
        if seconds is None:
            self.refuse(node, "a time must be seconds, or {sec: ..., nanosec: ...}")
        return self.number(seconds, VALUE_MAX) + (
            0.0 if rest is None else self.number(rest) / NS_PER_S
        )


def _about(motion: dict[str, YamlNode]) -> Iterator[str]:
    meta = motion["meta"].value if "meta" in motion else None
    for key, node in meta.items() if isinstance(meta, dict) else ():
        if isinstance(node.value, str) and node.value:
            yield f"{key}: {node.value}"
