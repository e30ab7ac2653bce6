"""sequence.yaml → Sequence: times made absolute, poses made angles, everything checked."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.sequence.check import joint_problems, jumps, loop_problem
from lss_motion.sequence.model import Interpolation, Keyframe, Sequence, Timing
from lss_motion.sequence.timing import absolute_times, has_times, timing_of, timing_problems
from lss_motion.spelling import known_names
from lss_motion.yaml_source import Location, Problem, read_yaml

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.file import KeyframeEntry, SequenceFile
    from lss_motion.yaml_source import YamlSource


def load_sequence(path: Path | str, robot: Robot | None = None) -> Sequence:
    """Return the sequence of a sequence file, checked against its robot.

    The robot is `robot`, or else the one that the file names; it gives the poses and the ranges.
    `robot_path` of the result is where that robot was read. Raises `InputError` with file, line,
    value and remedy; its `more` holds all further problems, those of the robot file included.
    """
    from lss_motion.sequence.file import KeyframeEntry, SequenceFile
    from lss_motion.validation import validate

    source = read_yaml(Path(path))
    blanks = {"keyframes": KeyframeEntry()}
    content, problems, left_out = validate(SequenceFile, source, blanks=blanks)
    try:
        robot = robot or _named_robot(source, left_out)
        robot_error = None
    except InputError as error:
        robot_error = error
    if content is not None:
        loader = _Loader(content, left_out, source, robot)
        sequence = loader.sequence()
        problems += loader.problems
        if not problems and robot_error is None:
            return sequence
    raise _all_of(source, problems, robot_error)


def sequence_schema() -> dict[str, Any]:
    """Return the JSON Schema of a sequence file."""
    from lss_motion.json_schema import json_schema
    from lss_motion.sequence.file import SequenceFile

    return json_schema(SequenceFile)


def _named_robot(source: YamlSource, left_out: frozenset[Location]) -> Robot | None:
    """Return the robot that the file names; None if that key itself is at fault."""
    name = source.value.get("robot")
    if ("robot",) in left_out or ("robot" in source.value and name is None):
        return None
    if name is None:
        raise source.error([Problem((), "no robot: give 'robot: FILE' here, or --robot FILE")])
    path = source.path.parent / str(name)
    if not path.exists():
        reason = f"robot file {str(name)!r} not found; looked for {path}"
        raise source.error([Problem(("robot",), reason)])
    return load_robot(path)


def _all_of(
    source: YamlSource, problems: list[Problem], robot_error: InputError | None
) -> InputError:
    if not problems:
        assert robot_error is not None, "called without a problem"
        return robot_error
    error = source.error(problems)
    if robot_error is None:
        return error
    more = [*error.more, robot_error]
    return InputError(error.reason, path=error.path, line=error.line, more=more)


@dataclass(slots=True)
class _Loader:
    """Builds the keyframes of one file and notes what does not fit, unless its part is left out."""

    content: SequenceFile
    left_out: frozenset[Location]
    source: YamlSource
    robot: Robot | None
    problems: list[Problem] = field(default_factory=list)

    def sequence(self) -> Sequence:
        content, unread = self.content, self._unread()
        keyframes = [self._keyframe(i, entry) for i, entry in enumerate(content.keyframes)]
        if not unread and not self.left_out & {("timing",), ("duration_s",)}:
            self.problems += timing_problems(content)
        timing = timing_of(content)
        if timing is not Timing.FASTEST and (has_times(content) or timing is Timing.AUTHORED):
            keyframes = self._timed(keyframes, unread)
        if self.robot is not None:
            self._check_joints(keyframes, self.robot)
        loop = None if content.loop == "forever" else content.loop
        is_whole = not self.problems and not self.left_out and self.robot is not None
        if loop != 1 and is_whole and (reason := loop_problem(keyframes)):
            self._note(("keyframes", len(keyframes) - 1), reason)
        return Sequence(
            name=content.sequence,
            keyframes=tuple(keyframes),
            path=self.source.path,
            robot_path=None if self.robot is None else self.robot.path,
            timing=timing,
            fit_duration_s=content.duration_s,
            loop=loop,
        )

    def _unread(self) -> frozenset[int]:
        """Return the keyframes that could not be read: in their place stands a blank."""
        return frozenset(part for _, *rest in self.left_out for part in rest if type(part) is int)

    def _note(self, location: Location, reason: str) -> None:
        self.problems.append(Problem(location, reason))

    def _keyframe(self, index: int, entry: KeyframeEntry) -> Keyframe:
        is_read = ("keyframes", index) not in self.left_out
        if not entry.deg and entry.pose is None and is_read:
            self._note(("keyframes", index), "a keyframe names joints: give 'pose' or 'deg'")
        return Keyframe(
            deg={**self._pose(index, entry.pose), **(entry.deg or {})},
            hold_s=entry.hold_s,
            is_anchor=entry.anchor,
            ease=Interpolation(entry.ease or self.content.interpolation),
            label=entry.label or entry.pose or "",
            line=self.source.line(("keyframes", index)),
        )

    def _pose(self, index: int, name: str | None) -> Mapping[str, float]:
        if name is None or self.robot is None:
            return {}
        if name not in self.robot.poses:
            known = known_names(name, self.robot.poses)
            self._note(("keyframes", index, "pose"), f"unknown pose {name!r}; {known}")
        return self.robot.poses.get(name, {})

    def _timed(self, keyframes: list[Keyframe], unread: frozenset[int]) -> list[Keyframe]:
        times_s, problems = absolute_times(self.content.keyframes, unread)
        if has_times(self.content):  # Otherwise the one problem of all of them is noted already.
            self.problems += problems
        timed = [replace(k, at_s=at_s) for k, at_s in zip(keyframes, times_s, strict=True)]
        for index, reason in jumps(timed):
            self._note(("keyframes", index), reason)
        return timed

    def _check_joints(self, keyframes: list[Keyframe], robot: Robot) -> None:
        for index, name, reason in joint_problems(keyframes, robot):
            is_own = name in (self.content.keyframes[index].deg or {})
            key = ("deg", name) if is_own else ("pose",)
            self._note(("keyframes", index, *key), reason)
