"""The entry point: `plan` makes a verified trajectory of a sequence, or loads it from the cache.

The modules that make plans are imported only when a plan is made.
"""

# ruff: noqa: TC001 - public: `help` looks up the annotations.
from __future__ import annotations

import math
from functools import partial

from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.kept_plans import cache_name, kept_plan
from lss_motion.planning.trajectory.keys import merged
from lss_motion.planning.trajectory.model import JOINT_SECONDS_MAX, Trajectory, with_looped_span
from lss_motion.planning.trajectory.playlist import planned_cues
from lss_motion.robot.model import Robot
from lss_motion.show.model import Interpolation, Sequence, Timing


def plan(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the motion of `robot` that comes closest to `sequence` within all limits.

    The result has passed `verify`. Raises `InputError` for a sequence that does not fit this robot,
    and `PlanningError` where no motion fulfils it: a missed anchor, a duration that is too short,
    a spline that leaves a joint's range.
    """
    _check_limits(robot)
    from lss_motion.planning.trajectory.more_time import planned_or_slower

    trajectory = planned_or_slower(sequence, partial(_planned, robot=robot))
    return replace(trajectory, on_fault=sequence.on_fault) if sequence.on_fault else trajectory


def _check_limits(robot: Robot) -> None:
    """Raise `InputError` where a limit was not read from the servo, or its turn is unknown."""
    robot.require_turns(robot.servo_robot.joints.values())
    for joint in robot.unread:
        raise InputError(
            f"joint {joint.name!r}: its robot file leaves {' and '.join(sorted(joint.unread))} to "
            f"the servo, whose settings are not known. `lss-play` reads them; offline give "
            f"--robot-cache FILE, written by `lss-motion configure ROBOT --backup FILE`",
            path=robot.path,
        )


def _planned(sequence: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of a sequence to which `at_speed` was applied."""
    bare = replace(sequence, layers=(), events=())
    trajectory = base = _planned_base(bare, robot)
    if sequence.layers:
        from lss_motion.planning.trajectory.layers import layered
        from lss_motion.planning.trajectory.verify import verify

        if base.loop is None:
            cues = [*base.cues, *planned_cues(sequence, base)]
            base = replace(base, cues=tuple(cues))
            trajectory = layered(base, replace(sequence, events=()), robot, _planned)
            verify(trajectory, robot, has_parts=False)
            return trajectory
        trajectory = layered(base, replace(sequence, events=()), robot, _planned)
        slower = trajectory.first.duration_s / max(base.first.duration_s, 1e-9)
        if any(mark.kept for mark in trajectory.marks):
            slower = 1.0
        cues = [replace(cue, at_s=slower * cue.at_s) for cue in base.cues]
        for layer in sequence.layers:
            own = planned_cues(replace(layer.sequence, path=sequence.path), trajectory)
            cues += [replace(cue, at_s=layer.from_s + cue.at_s) for cue in own]
        trajectory = replace(trajectory, cues=tuple(cues))
    if sequence.events:
        cues = [*trajectory.cues, *planned_cues(sequence, trajectory)]
        trajectory = replace(trajectory, cues=tuple(cues))
    return trajectory


def _planned_base(sequence: Sequence, robot: Robot) -> Trajectory:
    if not sequence.play and not sequence.tracks:
        return _planned_track(sequence, robot)
    from lss_motion.planning.trajectory.verify import verify

    if sequence.play:
        from lss_motion.planning.trajectory.playlist import planned_play_list

        trajectory = planned_play_list(sequence, robot, _planned)
    else:
        if sequence.loop != 1 and not sequence.keyframes:
            raise InputError(
                "there is nothing to loop outside of the tracks; give each track its own loop",
                path=sequence.path,
            )
        from lss_motion.planning.trajectory.tracks import planned_tracks

        own = [replace(sequence, tracks=())] if sequence.keyframes else []
        trajectory = planned_tracks(sequence, [*own, *sequence.tracks], robot, _planned_track)
    verify(trajectory, robot, has_parts=False)  # The parts have passed it already.
    return trajectory


def _planned_track(track: Sequence, robot: Robot) -> Trajectory:
    if track.tracks or track.layers or track.play:
        raise InputError("a track holds keyframes and nothing else", path=track.path)
    if track.loop_span_s is not None:
        from lss_motion.planning.trajectory.verify import verify

        trajectory = with_looped_span(track, _planned_joints(replace(track, loop=1), robot))
        verify(trajectory, robot, has_parts=False)
        return trajectory
    return _planned_joints(track, robot)


def _planned_joints(track: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of joints that keep their time beside that of the others."""
    keyed = {name for frame in track.keyframes for name in frame.deg}
    if robot.servos:
        _check_mechanisms(track, keyed, robot)
    if not (kept := keyed & track.keeps_time):
        return _planned_angles(replace(track, keeps_time=frozenset(), loop_span_s=None), robot)
    if kept == keyed:
        return _time_kept(replace(track, keeps_time=frozenset(kept)), robot)
    from lss_motion.planning.trajectory.keep_time import beside, is_even, part_of
    from lss_motion.planning.trajectory.verify import verify

    slow = _planned_joints(part_of(track, keyed - kept), robot)
    may_flow = is_even(slow, track)
    own = _time_kept(part_of(track, kept), robot, may_flow=may_flow)
    are_kept = [bool(frame.deg) and kept.issuperset(frame.deg) for frame in track.keyframes]
    trajectory = beside(slow, own, robot, are_kept)
    verify(trajectory, robot, has_parts=False)
    return trajectory


def _check_mechanisms(track: Sequence, keyed: set[str], robot: Robot) -> None:
    """Raise `InputError` where keyframes leave open where a mechanism is, or cannot plan it."""
    for mechanism in robot.mechanisms.values():
        own, line = keyed & {*mechanism.joints}, track.keyframes[0].line
        missing = [name for name in mechanism.joints if own and name not in own]
        if missing:
            raise InputError(
                f"the keyframes move joint {min(own)!r} and not {missing[0]!r}, which has the same "
                f"servos (mechanism {mechanism.name!r}): give {missing[0]} an angle in the first "
                f"keyframe as well, such as 0",
                path=track.path,
                line=line,
            )
        if own and own & track.keeps_time and not mechanism.is_scaled:
            raise InputError(
                f"joint {min(own & track.keeps_time)!r} cannot keep its time yet: the limits of "
                f"its servos depend on where it is (mechanism {mechanism.name!r}). Remove it from "
                f"`keep: time`, or give its keys more time",
                path=track.path,
                line=line,
            )
        is_sent = any(frame.ease is Interpolation.COMMAND for frame in track.keyframes)
        if own and is_sent and any(own & {*frame.deg} for frame in track.keyframes):
            raise InputError(
                f"the ease command is a move of a servo, and joint {min(own)!r} is none: it stands "
                f"behind mechanism {mechanism.name!r}. Choose another ease",
                path=track.path,
                line=line,
            )


def _time_kept(track: Sequence, robot: Robot, *, may_flow: bool = True) -> Trajectory:
    """Return the plan of keyframes whose joints all keep their time, made or from the cache."""
    _check_length(track)

    def make() -> Trajectory:
        from lss_motion.planning.trajectory.keep_time import time_kept

        return time_kept(track, robot, may_flow=may_flow)

    name = cache_name(track, robot, may_flow=may_flow)
    return _placed(kept_plan(name, make, robot), track)


def _planned_angles(track: Sequence, robot: Robot) -> Trajectory:
    ratio = track.speed_ratio
    trajectory = _keyframes(replace(track, speed_ratio=1.0), robot)
    if track.timing is Timing.FASTEST and ratio < 1.0:
        from lss_motion.planning.trajectory.retime import at_ratio

        return at_ratio(trajectory, ratio)
    return trajectory


def _keyframes(track: Sequence, robot: Robot) -> Trajectory:
    """Return the plan of the keyframes alone, made or from the cache."""
    _check_length(track)
    whole, (track, now_of) = track, merged(track, robot)

    def make() -> Trajectory:
        from lss_motion.planning.trajectory.more_time import planned_or_advised
        from lss_motion.planning.trajectory.smoothing import smooth_track

        return planned_or_advised(track, robot, smooth_track)

    found = kept_plan(cache_name(track, robot), make, robot)
    if track is not whole:
        marks = [
            replace(found.marks[now], label=frame.label)
            for frame, now in zip(whole.keyframes, now_of, strict=True)
        ]
        found = replace(found, marks=tuple(marks))
    return _placed(found, whole)


def _placed(trajectory: Trajectory, track: Sequence) -> Trajectory:
    """Return the plan with the lines of its keyframes, which a stored plan does not know."""
    if track.path is None:
        return trajectory
    marks = tuple(
        replace(mark, place="" if frame.line is None else f"{track.path.name}:{frame.line}")
        for mark, frame in zip(trajectory.marks, track.keyframes, strict=True)
    )
    return replace(trajectory, marks=marks)


def _check_length(track: Sequence) -> None:
    """Raise `InputError` for keyframes over a time that cannot be verified, before any work."""
    joints = len({name for keyframe in track.keyframes for name in keyframe.deg})
    if not track.keyframes or not math.isfinite(track.keyframes[-1].at_s or 0.0):
        return  # `keys_by_joint` reports that.
    last = track.keyframes[-1]
    most_s = JOINT_SECONDS_MAX / max(1, joints)
    if (last.at_s or 0.0) + last.hold_s > most_s:
        raise InputError(
            f"the keyframes end at {(last.at_s or 0.0) + last.hold_s:,.0f} s; with {joints} joints "
            f"at most {most_s:,.0f} s can be planned at once: repeat shorter ones with `loop`",
            path=track.path,
            line=last.line,
        )
