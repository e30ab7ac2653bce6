"""From what the author wants to what the robot can do: `plan`.

A plan that is remembered needs no planner: what makes one is loaded when there is one to make.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.sequence.model import Timing
from lss_motion.sequence.speed import at_speed
from lss_motion.trajectory.cache import name_of, remembered
from lss_motion.trajectory.cues import planned_cues
from lss_motion.trajectory.span import looped_span

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence
    from lss_motion.trajectory.model import Trajectory


def plan(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the motion of `robot` that comes closest to `sequence` within all limits.

    The result has passed `verify`. Raises `InputError` for a sequence that means nothing on this
    robot, `PlanningError` where no motion fulfils it: a missed anchor, a duration too short, a
    spline that swings out of range.
    """
    _check_limits(robot)
    trajectory = _planned(at_speed(sequence), robot)
    return replace(trajectory, on_fault=sequence.on_fault) if sequence.on_fault else trajectory


def _check_limits(robot: Robot) -> None:
    """Raise `InputError` where a limit is what the servo is set to and nobody has asked it."""
    for joint in robot.unread:
        raise InputError(
            f"joint {joint.name!r}: its robot file leaves {' and '.join(sorted(joint.unread))} to "
            f"the servo, which was not asked. `lss-play` asks it; offline give --robot-cache "
            f"FILE, written by `lss-motion configure ROBOT --backup FILE`",
            path=robot.path,
        )


def _planned(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of a sequence whose times are final."""
    bare = replace(sequence, layers=(), events=())
    trajectory = base = _base(bare, robot)
    if sequence.layers:
        from lss_motion.trajectory.layers import layered

        trajectory = layered(base, replace(sequence, events=()), robot, _planned)
        slower = trajectory.first.duration_s / max(base.first.duration_s, 1e-9)
        cues = [replace(cue, at_s=slower * cue.at_s) for cue in base.cues]
        for layer in sequence.layers:
            own = planned_cues(replace(layer.sequence, path=sequence.path), trajectory)
            cues += [replace(cue, at_s=layer.from_s + cue.at_s) for cue in own]
        trajectory = replace(trajectory, cues=tuple(cues))
    if sequence.events:
        cues = [*trajectory.cues, *planned_cues(sequence, trajectory)]
        trajectory = replace(trajectory, cues=tuple(cues))
    return trajectory


def _base(sequence: Sequence, robot: Robot) -> Trajectory:
    if not sequence.play and not sequence.tracks:
        return _alone(sequence, robot)
    from lss_motion.trajectory.verify import verify

    if sequence.play:
        from lss_motion.trajectory.play import in_a_row

        trajectory = in_a_row(sequence, robot, _planned)
    else:
        if sequence.loop != 1 and not sequence.keyframes:
            raise InputError(
                "there is nothing to loop outside of the tracks; give each track its own loop",
                path=sequence.path,
            )
        from lss_motion.trajectory.tracks import side_by_side

        own = [replace(sequence, tracks=())] if sequence.keyframes else []
        trajectory = side_by_side(sequence, [*own, *sequence.tracks], robot, _alone)
    verify(trajectory, robot, has_parts=False)  # The parts have passed it already.
    return trajectory


def _alone(track: Sequence, robot: Robot) -> Trajectory:
    if track.tracks or track.layers or track.play:
        raise InputError("a track holds keyframes and nothing else", path=track.path)
    if track.loop_span_s is not None:
        from lss_motion.trajectory.verify import verify

        whole = _alone(replace(track, loop=1, loop_span_s=None), robot)
        trajectory = looped_span(track, whole)
        verify(trajectory, robot, has_parts=False)
        return trajectory
    ratio = track.speed_ratio
    trajectory = _keyframes(replace(track, speed_ratio=1.0), robot)
    if track.timing is Timing.FASTEST and ratio < 1.0:
        from lss_motion.trajectory.fit import at_ratio

        return at_ratio(trajectory, ratio)
    return trajectory


def _keyframes(track: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of the keyframes alone, made or remembered."""

    def make() -> Trajectory:
        from lss_motion.trajectory.track import planned_track

        return planned_track(track, robot)

    return remembered(name_of(track, robot), make)
