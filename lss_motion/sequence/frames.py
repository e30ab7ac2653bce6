"""The keyframes of one track: times made absolute, poses made angles, everything checked."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from lss_motion.sequence.check import joint_problems, jumps, loop_problem
from lss_motion.sequence.model import Interpolation, Keyframe, Sequence, Timing
from lss_motion.sequence.timing import absolute_times, has_times, timing_of, timing_problems
from lss_motion.spelling import known_names
from lss_motion.yaml_source import Location, Problem

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.file import KeyframeEntry, TrackEntry
    from lss_motion.yaml_source import YamlSource


@dataclass(slots=True)
class TrackLoader:
    """Builds the sequence of one track and notes what does not fit, unless its part is left out.

    `place` is where the track stands in the file; `left_out` and `problems` count from there.
    """

    content: TrackEntry
    place: Location
    left_out: frozenset[Location]
    source: YamlSource
    robot: Robot | None
    is_offset: bool = False
    """Whether its angles are added to others, so that no range says anything about them."""
    is_looped_in_part: bool = False
    problems: list[Problem] = field(default_factory=list)

    def sequence(self, name: str) -> Sequence:
        content, unread = self.content, self._unread()
        keyframes = [self._keyframe(i, entry) for i, entry in enumerate(content.keyframes)]
        if not unread and not self.left_out & {("timing",), ("duration_s",)}:
            for problem in timing_problems(content):
                self._note(problem.location, problem.reason)
        timing = timing_of(content)
        if timing is not Timing.FASTEST and (has_times(content) or timing is Timing.AUTHORED):
            keyframes = self._timed(keyframes, unread)
        if self.robot is not None:
            self._check_joints(keyframes, self.robot)
        loop = None if content.loop == "forever" else content.loop
        is_whole = not self.problems and not self.left_out and self.robot is not None
        is_looped = loop != 1 and not self.is_looped_in_part
        if is_looped and is_whole and (reason := loop_problem(keyframes)):
            self._note(("keyframes", len(keyframes) - 1), reason)
        return Sequence(
            name=name,
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
        self.problems.append(Problem((*self.place, *location), reason))

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
            line=self.source.line((*self.place, "keyframes", index)),
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
            for problem in problems:
                self._note(problem.location, problem.reason)
        timed = [replace(k, at_s=at_s) for k, at_s in zip(keyframes, times_s, strict=True)]
        for index, reason in jumps(timed):
            self._note(("keyframes", index), reason)
        return timed

    def _check_joints(self, keyframes: list[Keyframe], robot: Robot) -> None:
        for index, name, reason in joint_problems(keyframes, robot, is_offset=self.is_offset):
            is_own = name in (self.content.keyframes[index].deg or {})
            key = ("deg", name) if is_own else ("pose",)
            self._note(("keyframes", index, *key), reason)
