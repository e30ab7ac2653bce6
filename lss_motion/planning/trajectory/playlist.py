"""Play lists: sequences one after the other, and the moves from where one ends to the next.

Marks, cues and waits stand at planned times, in every pass of a loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.model import LoopedSpan, Trajectory, WaitPoint
from lss_motion.show.check import loop_problem
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.show.splines import distinct

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.show.model import PlaylistStep, Wait

    FloatArray = NDArray[np.float64]
    from collections.abc import Iterator

    from lss_motion.planning.trajectory.model import Mark
    from lss_motion.show.model import Cue

SAME_DEG: Final = 1e-9
"""Angles closer than this need no move."""

WAIT_SETTLE_S: Final = 0.05
"""Rest before a wait begins, because the horns lag behind the plan."""

WAIT_LEAD_S: Final = 0.25
"""Rest after a wait, because moves are sent before they start. Chosen: as long as the lead at the
beginning of a show."""

PEAK_RATIO: Final = 1.5
"""Peak speed of a smooth move from rest to rest, divided by its mean speed."""


class PlayListPass(Struct, frozen=True, kw_only=True):
    """A pass in which trajectories follow one another, each from rest to rest.

    `parts[k]` starts at `starts_s[k]`, where the joints are at `poses_deg[k]`; a joint that it
    does not move stays there. It is the plan of `sequences[k]`; None: a move between two of them.
    """

    joints: tuple[str, ...]
    parts: tuple[Trajectory, ...]
    sequences: tuple[Sequence | None, ...]
    starts_s: FloatArray
    poses_deg: FloatArray
    duration_s: float

    @property
    def seams_s(self) -> FloatArray:
        return self.starts_s

    @property
    def knots_s(self) -> FloatArray:
        found = [
            start_s + part.knots_until(part.duration_s)
            for start_s, part in zip(self.starts_s.tolist(), self.parts, strict=True)
        ]
        return distinct(np.concatenate([[0.0], *found, [self.duration_s]]))

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        times_s = np.asarray(times_s, dtype=np.float64)
        inside_s = np.clip(times_s, 0.0, self.duration_s)
        chosen = np.clip(np.searchsorted(self.starts_s, inside_s, side="right") - 1, 0, None)
        values = (
            self.poses_deg[chosen] if order == 0 else np.zeros((len(times_s), len(self.joints)))
        )
        for index in distinct(chosen).tolist():
            part, rows = self.parts[index], np.flatnonzero(chosen == index)
            columns = np.array([self.joints.index(name) for name in part.joints], dtype=np.intp)
            local_s = inside_s[rows] - self.starts_s[index]
            values[np.ix_(rows, columns)] = part.sample(local_s, order)
        if order > 0:
            values[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return values


@dataclass(slots=True)
class _StepCollector:
    """Collects the parts of a play list, and the angle of every joint after them."""

    robot: Robot
    plan: Callable[[Sequence, Robot], Trajectory]
    pose_deg: dict[str, float]
    parts: list[tuple[float, Trajectory, dict[str, float]]]
    sequences: list[Sequence | None]
    waits: list[WaitPoint]
    now_s: float = 0.0

    def append(self, part: Trajectory, sequence: Sequence | None) -> None:
        self.parts.append((self.now_s, part, dict(self.pose_deg)))
        self.sequences.append(sequence)
        waits = all_waits(part, part.duration_s)
        self.waits += [replace(point, at_s=point.at_s + self.now_s) for point in waits]
        end_deg = part.sample(np.array([part.duration_s]))[0].tolist()
        self.pose_deg |= zip(part.joints, end_deg, strict=True)
        self.now_s += part.duration_s

    def pause(self, pause_s: float) -> None:
        """Append a rest."""
        self.now_s += pause_s

    def wait(self, wait: Wait) -> None:
        """Append a rest with a wait in it."""
        self.waits.append(WaitPoint(at_s=self.now_s + WAIT_SETTLE_S, wait=wait))
        self.pause(WAIT_SETTLE_S + WAIT_LEAD_S)

    def idle(self, wait: Wait, part: Trajectory, sequence: Sequence) -> None:
        """Append a wait during which `part` is played again and again, from where it begins."""
        begins_s = self.now_s + WAIT_SETTLE_S
        self.pause(WAIT_SETTLE_S + WAIT_LEAD_S)
        self.append(part, sequence)
        self.move_to(_start(part), None, sequence.smooth_s)
        at_s = self.now_s + WAIT_SETTLE_S
        self.waits.append(WaitPoint(at_s=at_s, wait=wait, back_s=at_s - begins_s))
        self.pause(WAIT_SETTLE_S + WAIT_LEAD_S)

    def move_to(
        self, target_deg: Mapping[str, float], move_s: float | None, smooth_s: float = 0.0
    ) -> None:
        """Append the move to the angles, in `move_s` or at the approach speed; none if there."""
        ways = {
            name: (self.pose_deg[name], angle_deg)
            for name, angle_deg in target_deg.items()
            if name in self.pose_deg and abs(self.pose_deg[name] - angle_deg) > SAME_DEG
        }
        if not ways:
            return
        longest_deg = max(abs(to_deg - from_deg) for from_deg, to_deg in ways.values())
        if move_s is None:
            move_s = PEAK_RATIO * longest_deg / self.robot.approach_speed_deg_s
        frames = (
            Keyframe(deg={name: way[0] for name, way in ways.items()}, at_s=0.0),
            Keyframe(deg={name: way[1] for name, way in ways.items()}, at_s=move_s, label="move"),
        )
        move = Sequence(name="move", keyframes=frames, smooth_s=smooth_s)
        self.append(self.plan(move, self.robot), None)


def planned_play_list(
    show: Sequence, robot: Robot, plan: Callable[[Sequence, Robot], Trajectory]
) -> Trajectory:
    """Return the steps of a play list, one after the other, as often as the list is looped.

    Every step begins and ends at rest. Where a joint is not at the start of a step, a move to it
    comes first, in the step's `move_s`, else at the robot's approach speed.
    """
    planned = [(step, *_planned(step, robot, plan)) for step in show.play]
    start_deg: dict[str, float] = {}
    for _, part, _ in planned:
        start_deg = {**(_start(part) if part else {}), **start_deg}
    steps = _StepCollector(robot, plan, dict(start_deg), [], [], [])
    for step, part, times in planned:
        steps.pause(step.pause_s)
        if part is None or step.sequence is None:
            if step.wait is not None:
                steps.wait(step.wait)
            continue
        for _ in range(times if step.wait is None else 1):
            steps.move_to(_start(part), step.move_s, step.sequence.smooth_s)
            if step.wait is None:
                steps.append(part, step.sequence)
            else:
                steps.idle(step.wait, part, step.sequence)
    if show.loop != 1:
        steps.move_to(start_deg, None)
    return _trajectory(show, steps, robot)


def _planned(
    step: PlaylistStep, robot: Robot, plan: Callable[[Sequence, Robot], Trajectory]
) -> tuple[Trajectory | None, int]:
    """Return the plan of a step and how often it is played."""
    sequence = step.sequence
    if sequence is None:
        return None, 1
    is_plain = bool(sequence.keyframes) and not sequence.tracks and not sequence.layers
    is_plain = is_plain and sequence.loop_span_s is None
    may_flow = step.times > 1 and is_plain and not loop_problem(sequence.keyframes)
    if may_flow and sequence.loop is not None:
        # It ends where it begins: planned as a loop, it goes on without a stop.
        return plan(replace(sequence, loop=sequence.loop * step.times), robot), 1
    return plan(sequence, robot), step.times


def _start(part: Trajectory) -> dict[str, float]:
    return dict(zip(part.joints, part.sample(np.zeros(1))[0].tolist(), strict=True))


def _trajectory(show: Sequence, steps: _StepCollector, robot: Robot) -> Trajectory:
    joints = tuple(name for name in robot.joints if name in steps.pose_deg)
    parts = steps.parts
    if not parts:
        raise InputError("the play list moves no joint", path=show.path)
    whole = PlayListPass(
        joints=joints,
        parts=tuple(part for _, part, _ in parts),
        sequences=tuple(steps.sequences),
        starts_s=np.array([start_s for start_s, _, _ in parts]),
        poses_deg=np.array([[pose_deg[name] for name in joints] for _, _, pose_deg in parts]),
        duration_s=steps.now_s,
    )
    return Trajectory(
        name=show.name,
        joints=joints,
        first=whole,
        middle=whole,
        last=whole,
        loop=show.loop,
        stretched=tuple(
            replace(stretch, from_s=stretch.from_s + start_s, to_s=stretch.to_s + start_s)
            for start_s, part, _ in parts
            for stretch in part.stretched
        ),
        given_up=tuple(span.later(start_s) for start_s, part, _ in parts for span in part.given_up),
        asked=tuple(span.later(start_s) for start_s, part, _ in parts for span in part.asked),
        commands=tuple(move.later(start_s) for start_s, part, _ in parts for move in part.commands),
        marks=tuple(
            mark.later(start_s)
            for start_s, part, _ in parts
            for mark in all_marks(part, part.duration_s)
        ),
        waits=tuple(steps.waits),
        cues=tuple(
            replace(cue, at_s=cue.at_s + start_s)
            for start_s, part, _ in parts
            for cue in all_cues(part, part.duration_s)
        ),
    )


LATE_SLACK_S: Final = 1e-6
"""A cue at the end of a pass may lie beyond it by the rounding error of added decimals."""


def planned_cues(sequence: Sequence, trajectory: Trajectory) -> tuple[Cue, ...]:
    """Return the cues of `sequence` at planned times.

    A cue is as late as the keyframe before it, and never earlier than its time; beside joints that
    keep their time it stays where the author put it. Raises `InputError` for a cue after the end of
    a pass.
    """
    pairs = sorted(
        (mark.authored_s, mark.planned_s)
        for mark in trajectory.marks
        if mark.authored_s is not None and not _keeps_time(sequence)
    )
    authored_s = np.array([0.0, *(authored for authored, _ in pairs)])
    planned_s = np.array([0.0, *(planned for _, planned in pairs)])
    end_s = trajectory.first.duration_s
    found = []
    for cue in sequence.events:
        before = int(np.searchsorted(authored_s, cue.at_s, side="right")) - 1
        at_s = cue.at_s + max(0.0, float(planned_s[before] - authored_s[before]))
        if cue.at_s <= authored_s[-1]:
            at_s = min(at_s, end_s)
        if at_s > end_s + LATE_SLACK_S:
            raise InputError(
                f"an event at {cue.at_s:g} s is never reached: "
                f"the sequence (one pass of it) is over after {end_s:.3f} s",
                path=sequence.path,
                line=cue.line,
            )
        found.append(_cut(replace(cue, at_s=at_s), end_s))
    return tuple(found)


def _keeps_time(sequence: Sequence) -> bool:
    return bool(sequence.keeps_time) or any(track.keeps_time for track in sequence.tracks)


def _cut(cue: Cue, end_s: float) -> Cue:
    """Return a cue whose sound, if it is a bed or looped, ends with its pass."""
    if not cue.sound or not (cue.style.is_bed or cue.style.is_looped):
        return cue
    return replace(cue, style=replace(cue.style, lasts_s=end_s - cue.at_s))


def _scaled(cue: Cue, ratio: float) -> Cue:
    if cue.style.lasts_s is None or ratio == 1.0:
        return cue
    return replace(cue, style=replace(cue.style, lasts_s=ratio * cue.style.lasts_s))


def all_cues(trajectory: Trajectory, end_s: float) -> tuple[Cue, ...]:
    """Return the cues of all passes that begin before `end_s`, in the order of their starts."""
    found = [
        _scaled(replace(cue, at_s=start_s + ratio * cue.at_s), ratio)
        for start_s, ratio, from_s in _passes(trajectory, end_s)
        for cue in trajectory.cues
        if cue.at_s >= from_s
    ]
    return tuple(sorted(found, key=lambda cue: cue.start_s))


def all_marks(trajectory: Trajectory, end_s: float) -> tuple[Mark, ...]:
    """Return the marks of all passes that begin before `end_s`, in order of time.

    Both times of a mark are in show time; the authored one counts from the start of its pass.
    """
    return tuple(
        replace(
            mark,
            planned_s=start_s + ratio * mark.planned_s,
            held_s=ratio * mark.held_s,
            authored_s=None if mark.authored_s is None else start_s + mark.authored_s,
        )
        for start_s, ratio, from_s in _passes(trajectory, end_s)
        for mark in trajectory.marks
        if mark.planned_s >= from_s
    )


def all_waits(trajectory: Trajectory, end_s: float) -> tuple[WaitPoint, ...]:
    """Return the waits of all passes that begin before `end_s`, in order of time."""
    return tuple(
        replace(point, at_s=start_s + ratio * point.at_s)
        for start_s, ratio, from_s in _passes(trajectory, end_s)
        for point in trajectory.waits
        if point.at_s >= from_s
    )


def _passes(trajectory: Trajectory, end_s: float) -> Iterator[tuple[float, float, float]]:
    """Yield for every pass what is added to times, their scale, and the least time that is in it.

    A pass that starts in motion is shorter than the first; its marks and cues are scaled with it.
    Those of a looped span are in show time already; only where it never ends, they are repeated.
    """
    if not trajectory.marks and not trajectory.cues and not trajectory.waits:
        return
    first_s = trajectory.first.duration_s
    yield 0.0, 1.0, 0.0
    index = 1
    if isinstance(span := trajectory.middle, LoopedSpan):
        while trajectory.loop is None and trajectory.pass_start_s(index) < end_s:
            yield index * span.duration_s, 1.0, span.from_s + LATE_SLACK_S
            index += 1
        return
    while first_s > 0.0 and (trajectory.loop is None or index < trajectory.loop):
        start_s = trajectory.pass_start_s(index)
        if start_s >= end_s:
            return
        yield start_s, trajectory.motion_of(index).duration_s / first_s, 0.0
        index += 1
