"""ROS motions in YAML: JointTrajectory messages, play_motion and play_motion2 collections, goals.

Positions are radians (REP 103), or metres for a sliding joint; the file does not define which. A
joint with the name of a sliding joint therefore needs a map.

`yaml_trees` reads the YAML as nested texts, lists and mappings with line numbers. It constructs no
objects, and it bounds size and depth. Unlike `files.yaml_source`, it keeps every scalar as text.
`ros2 topic echo` separates messages by documents. Joint states are a recording, and so are
trajectories of one point each with increasing stamps; other trajectories are a motion each.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, Final, NoReturn

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.source import text_of
from lss_motion.files.texts import counted
from lss_motion.files.yaml_source import DEPTH_MAX, syntax_reason
from lss_motion.interchange.fields import NUMBER_MAX, VALUE_MAX
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
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from lss_motion.interchange.reader import RefusedMotion


NODES_MAX: Final = 4_000_000
"""Maximum number of nodes, as for values of a recording. An alias counts as its content."""


class RosNode(Struct, frozen=True):
    """A text, a list or a mapping, and the line where it starts."""

    value: str | list[RosNode] | dict[str, RosNode]
    line: int
    size: int = 1
    """Number of nodes in it, with itself and with the content of aliases."""


def yaml_trees(text: str, path: Path) -> Iterator[RosNode]:
    """Yield the documents of `text`, at least one, or raise `InputError` with the line."""
    import yaml

    loader = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
    try:
        yield from _NodeBuilder(path, yaml.parse(text, Loader=loader)).documents()
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise InputError(syntax_reason(error), path=path, line=line) from error


class _NodeBuilder:
    """Builds the tree from the events of the YAML parser."""

    def __init__(self, path: Path, events: Iterator[Any]) -> None:
        self._path = path
        self._events = events
        self._anchors: dict[str, RosNode] = {}
        self._nodes_count = 0

    def documents(self) -> Iterator[RosNode]:
        is_empty = True
        for event in self._events:
            match type(event).__name__:
                case "DocumentStartEvent":
                    self._anchors.clear()
                case "ScalarEvent" if not event.value and not is_empty:
                    pass  # An echo ends in `---`.
                case "ScalarEvent" | "AliasEvent" | "MappingStartEvent" | "SequenceStartEvent":
                    is_empty = False
                    yield self._node(event, 0)
        if is_empty:
            raise InputError("is empty", path=self._path)

    def _node(self, event: Any, depth: int) -> RosNode:  # noqa: ANN401  yaml seam
        line = event.start_mark.line + 1
        if type(event).__name__ == "AliasEvent":
            if event.anchor not in self._anchors:
                raise self._error(line, f"alias *{event.anchor} has no anchor before it")
            node = self._anchors[event.anchor]
            self._count(line, node.size)
            return node
        self._count(line, 1)
        if depth > DEPTH_MAX:
            raise self._error(line, f"nested more than {DEPTH_MAX} deep")
        if event.tag is not None and event.tag.startswith("tag:yaml.org,2002:python"):
            raise self._error(line, f"tag {event.tag!r:.60} would run code, which is not allowed")
        match type(event).__name__:
            case "ScalarEvent":
                node = RosNode(str(event.value), line)
            case "MappingStartEvent":
                node = self._mapping(line, depth)
            case _:
                node = self._list(line, depth)
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _mapping(self, line: int, depth: int) -> RosNode:
        value: dict[str, RosNode] = {}
        size = 1
        while type(event := next(self._events)).__name__ != "MappingEndEvent":
            key = self._node(event, depth + 1)
            if not isinstance(key.value, str):
                raise self._error(key.line, "a key must be plain text")
            if key.value in value:
                raise self._error(key.line, f"{key.value!r:.60} is given twice")
            value[key.value] = self._node(next(self._events), depth + 1)
            size += key.size + value[key.value].size
        return RosNode(value, line, size)

    def _list(self, line: int, depth: int) -> RosNode:
        value: list[RosNode] = []
        while type(event := next(self._events)).__name__ != "SequenceEndEvent":
            value.append(self._node(event, depth + 1))
        return RosNode(value, line, 1 + sum(node.size for node in value))

    def _count(self, line: int, size: int) -> None:
        self._nodes_count += size
        if self._nodes_count > NODES_MAX:
            raise self._error(line, f"more than {NODES_MAX:,} keys and values")

    def _error(self, line: int, reason: str) -> InputError:
        return InputError(reason, path=self._path, line=line)


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


@dataclass(slots=True)
class _RosFile:
    """Converts the nodes of one file; every `InputError` contains the line."""

    path: Path
    left_out: list[str] = field(default_factory=list)

    def unwrapped(self, node: RosNode) -> dict[str, RosNode]:
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

    def states(self, name: str, messages: Iterable[RosNode]) -> ForeignMotion:
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
        self, name: str, messages: list[RosNode]
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

    def _trajectory(self, name: str, node: RosNode) -> ForeignMotion:
        top = self.unwrapped(node)
        if "joint_names" not in top:
            self.refuse(node, "must have 'joint_names' and 'points'")
        return self.motion(name, top, top["joint_names"])

    def _stamp_s(self, node: RosNode) -> float:
        """Return the stamp of a message in seconds; 0 where it has none."""
        top = node.value if isinstance(node.value, dict) else {}
        header = top["header"].value if "header" in top else None
        if not isinstance(header, dict) or "stamp" not in header:
            return 0.0
        return self._time(header["stamp"])

    def goals(self, name: str, top: dict[str, RosNode]) -> ForeignMotion:
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
        self, name: str, node: RosNode, joints: list[str], sent_s: float, wait_s: float
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

    def listed_motion(self, name: str, node: RosNode) -> ForeignMotion:
        """Return one motion of a collection."""
        motion = self.mapping(node, name)
        if "joints" not in motion:
            self.refuse(node, f"motion {name!r:.60} has no 'joints'")
        return self.motion(name, motion, motion["joints"])

    def motion(self, name: str, motion: dict[str, RosNode], joints: RosNode) -> ForeignMotion:
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

    def _points(self, node: RosNode, names: list[str]) -> Iterator[Pose]:
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
        self, name: str, motion: dict[str, RosNode], joints: RosNode, names: list[str]
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

    def _time(self, node: RosNode) -> float:
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

    def number(self, node: RosNode, maximum: float = NUMBER_MAX) -> float:
        """Return the number in `node`, or raise `InputError`."""
        try:
            value = float(node.value) if isinstance(node.value, str) else math.nan
        except ValueError:
            value = math.nan
        if not abs(value) <= maximum:
            self.refuse(node, f"{node.value!r:.60} is not a number, or out of range")
        return value

    def mapping(self, node: RosNode, where: str) -> dict[str, RosNode]:
        """Return the mapping in `node`, or raise `InputError`."""
        if not isinstance(node.value, dict):
            self.refuse(node, f"{where:.60} must hold keys and values")
        return node.value

    def items(self, node: RosNode, where: str) -> list[RosNode]:
        """Return the list in `node`, which has one entry or more, or raise `InputError`."""
        if not isinstance(node.value, list) or not node.value:
            self.refuse(node, f"{where} must be a list with at least one entry")
        return node.value

    def refuse(self, node: RosNode, reason: str) -> NoReturn:
        """Raise `InputError` with `reason` and the line."""
        if node.value == SHORTENED:
            reason = "left out by `ros2 topic echo`; write it with --full-length"
        raise InputError(reason, path=self.path, line=node.line)


def _about(motion: dict[str, RosNode]) -> Iterator[str]:
    meta = motion["meta"].value if "meta" in motion else None
    for key, node in meta.items() if isinstance(meta, dict) else ():
        if isinstance(node.value, str) and node.value:
            yield f"{key}: {node.value}"
