"""Joints that keep their time: every instant is met, and angle is given up where they are too slow.

The keyframes are followed at exactly the authored times. Where that breaks a limit, the motion of
the joint is the closest one within the limits (`keep_joint`); joints do not depend on each other.
`part_of` and `beside` plan a track in which other joints keep their angles and may be late.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory import explain
from lss_motion.planning.trajectory.closest_spline import Bounds
from lss_motion.planning.trajectory.curves import Path, commands_of, concatenate, peaks, shifted
from lss_motion.planning.trajectory.keep_joint import (
    CELL_S,
    GIVEN_UP_MIN_DEG,
    KNOT_MIN_S,
    AskedMotion,
    JointFollower,
    KeyAsked,
    PassGrid,
)
from lss_motion.planning.trajectory.keys import SAME_ANGLE_DEG, SAME_INSTANT_S, is_timed, named
from lss_motion.planning.trajectory.model import (
    AskedSpan,
    CommandedMove,
    GivenUp,
    PathClock,
    PathMotion,
    Trajectory,
    motions_of,
    steady_clock,
)
from lss_motion.planning.trajectory.retime import Layout, laid_out, scaled
from lss_motion.planning.trajectory.smoothing import JERK_SLACK, jerk_limits, limited
from lss_motion.planning.trajectory.tracks import ParallelPass, of_passes, verified
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Timing
from lss_motion.show.splines import distinct, runs

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Mark, Pass, Smoothing
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.show.model import Sequence as Show

    FloatArray = NDArray[np.float64]

ROUNDING_RATIO: Final = 1e-9
"""A motion this little beyond a limit is at it."""

PULL_MAX_S: Final = 0.5
"""A weighted key counts at most for so much time around it."""

PULL_OF_SUM_S: Final = 0.2
"""Time around a weighted key of a sum that it counts for. Chosen: a syllable."""

TURN_DEG_S: Final = 1.0
"""A sum that is slower at a key turns or stays there."""

LAST_OF_ENDLESS: Final = 3
"""Passes after which a show without end would end, so that it has a first, middle and last."""

PASS_SLACK_S: Final = 1e-9
"""Passes that differ by less are equally long: rounding."""


def check_time_kept(sequence: Show) -> None:
    """Raise `InputError` if joints should keep times that the file does not give."""
    if is_timed(sequence):
        return
    raise InputError(
        "keep: time needs the author's times; give the keyframes at_s or after_s and remove "
        "timing: fastest, or remove keep: time",
        path=sequence.path,
    )


def time_kept(sequence: Show, robot: Robot, *, may_flow: bool = True) -> Trajectory:
    """Return the plan of keyframes whose joints all keep their time; it has passed the verifier.

    `may_flow` False lets every pass of a loop end at rest. Raises `PlanningError` if an exact key
    cannot be met.
    """
    check_time_kept(sequence)
    if sequence.timing is Timing.FIT:
        sequence = scaled(sequence, sequence.fit_duration_s or 0.0)
    layout = laid_out(sequence, robot, may_flow=may_flow, keeps_time=True)
    _check_jumps(layout)
    names = tuple(layout.keys)
    keys = [_joint_keys(layout, name) for name in names]
    own_s = {}
    if sequence.loop == 1:
        length_s = layout.spacing.length_s
        own_s = {n: commands_of(layout.keys[n], robot.joints[n], length_s).spans_s for n in names}
    path, grid = concatenate(layout.paths), PassGrid.of(layout)
    joints = _followed(path, names, robot, grid, keys, show=sequence, own_s=own_s)
    trajectory = replace(_assembled(layout, joints), smoothing=_smoothing(sequence, names, robot))
    return verified(trajectory, sequence, robot)


def _smoothing(show: Show, names: tuple[str, ...], robot: Robot) -> tuple[Smoothing, ...]:
    return limited(names, jerk_limits(show, robot, names))


def _followed(
    path: Path,
    names: tuple[str, ...],
    robot: Robot,
    grid: PassGrid,
    keys: Sequence[tuple[KeyAsked, ...]],
    *,
    show: Show,
    own_s: Mapping[str, Sequence[tuple[float, float]]] = MappingProxyType({}),
) -> list[JointFollower]:
    """Return the joints of a path, a column each, following it at its own times."""
    exceeded = _exceeded(path, [robot.joints[name] for name in names])
    jerk_max = (JERK_SLACK * jerk_limits(show, robot, names)).tolist()
    found = []
    for column, (name, own_keys) in enumerate(zip(names, keys, strict=True)):
        joint = robot.joints[name]
        bounds = Bounds(
            low_deg=joint.position_min_deg,
            high_deg=joint.position_max_deg,
            speed_deg_s=joint.speed_max_deg_s,
            accel_deg_s2=joint.accel_max_deg_s2,
            jerk_deg_s3=jerk_max[column],
        )
        follower = JointFollower(
            name=name,
            bounds=bounds,
            asked=AskedMotion(path=path, column=column),
            grid=grid,
            keys=own_keys,
            source="" if show.path is None else str(show.path),
            own_s=own_s.get(name, ()),
        )
        follower.follow(runs(exceeded[:, column]))
        found.append(follower)
    return found


def _check_jumps(layout: Layout) -> None:
    """Raise `InputError` for two keys of a joint with different angles and no time between them."""
    show = layout.sequence
    last: dict[str, tuple[float, float]] = {}
    for frame, at_s, left_s in zip(
        show.keyframes,
        layout.spacing.reached_s.tolist(),
        layout.spacing.left_s.tolist(),
        strict=True,
    ):
        for name, deg in frame.deg.items():
            free_s, before_deg = last.get(name, (-math.inf, deg))
            if at_s <= free_s + SAME_INSTANT_S and abs(deg - before_deg) > SAME_ANGLE_DEG:
                raise InputError(
                    f"keyframe {named(frame)}: joint {name!r} would have to go from "
                    f"{before_deg:g} to {deg:g} deg in no time; come later",
                    path=show.path,
                    line=frame.line,
                )
            last[name] = (max(left_s, free_s), deg)


def _exceeded(path: Path, joints: Sequence[Joint]) -> NDArray[np.bool_]:
    """Return which segments of which joints exceed a limit at the authored times."""
    speed, accel = peaks(path)
    low_deg, high_deg = _extremes(path)
    most = 1.0 + ROUNDING_RATIO
    return np.asarray(
        (speed > most * np.array([joint.speed_max_deg_s for joint in joints]))
        | (accel > most * np.array([joint.accel_max_deg_s2 for joint in joints]))
        | (low_deg < np.array([joint.position_min_deg for joint in joints]) - SAME_ANGLE_DEG)
        | (high_deg > np.array([joint.position_max_deg for joint in joints]) + SAME_ANGLE_DEG)
    )


def _extremes(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the least and the largest angle of each segment and joint."""
    start, linear, square, cube = np.moveaxis(path.coefficients, 1, 0)
    length_s = path.segment_lengths_s[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(square**2 - 3.0 * cube * linear)
        turns_s = [(-square - root) / (3.0 * cube), (-square + root) / (3.0 * cube)]
        turns_s.append(-linear / (2.0 * square))
    found = [start, start + length_s * (linear + length_s * (square + length_s * cube))]
    for turn_s in turns_s:
        inside_s = np.where((turn_s > 0.0) & (turn_s < length_s), turn_s, 0.0)
        found.append(start + inside_s * (linear + inside_s * (square + inside_s * cube)))
    return np.minimum.reduce(found), np.maximum.reduce(found)


def _joint_keys(layout: Layout, name: str) -> tuple[KeyAsked, ...]:
    """Return the keys of a joint in all passes."""
    frames = [
        (index, frame) for index, frame in enumerate(layout.sequence.keyframes) if name in frame.deg
    ]
    reached_s, left_s = layout.spacing.reached_s, layout.spacing.left_s
    angles = [frame.deg[name] for _, frame in frames]
    found = []
    for count in range(len(layout.paths)):
        start_s = count * layout.spacing.length_s
        for place, (index, frame) in enumerate(frames):
            before, after = max(0, place - 1), min(len(frames) - 1, place + 1)
            rise = (angles[place] - angles[before]) * (angles[after] - angles[place])
            since_s = float(reached_s[index] - left_s[frames[before][0]]) if place else 0.0
            until_s = float(reached_s[frames[after][0]] - left_s[index]) if after > place else 0.0
            found.append(
                KeyAsked(
                    at_s=start_s + float(reached_s[index]),
                    left_s=start_s + float(left_s[index]),
                    deg=frame.deg[name],
                    name=named(frame),
                    label=frame.label,
                    line=frame.line,
                    is_exact=frame.is_exact,
                    weight=frame.weight,
                    around_s=min(0.5 * (max(since_s, 0.0) + max(until_s, 0.0)), PULL_MAX_S),
                    is_turn=rise <= 0.0,
                )
            )
    return tuple(found)


def united(
    pieces: Sequence[tuple[FloatArray, FloatArray]], knots_s: FloatArray, end_s: float
) -> Path:
    """Return the path of joints with own starts and cubics; `knots_s` are knots in any case."""
    starts_s = distinct(np.concatenate([knots_s, *(starts for starts, _ in pieces)]))
    starts_s = starts_s[np.append(True, np.diff(starts_s) > KNOT_MIN_S)]
    starts_s = starts_s[starts_s < end_s - KNOT_MIN_S]
    coefficients = np.empty((len(starts_s), 4, len(pieces)))
    for column, (own_starts_s, cubics) in enumerate(pieces):
        chosen = np.searchsorted(own_starts_s, starts_s + KNOT_MIN_S, side="right") - 1
        coefficients[:, :, column] = shifted(cubics[chosen], starts_s - own_starts_s[chosen])
    return Path(knots_s=np.append(starts_s, end_s), coefficients=coefficients)


def _assembled(layout: Layout, joints: Sequence[JointFollower]) -> Trajectory:
    """Return the plan of all passes."""
    sequence, length_s = layout.sequence, layout.spacing.length_s
    starts_s: FloatArray = length_s * np.arange(len(layout.paths) + 1, dtype=np.float64)
    path = united([joint.pieces() for joint in joints], starts_s[:-1], joints[0].end_s)
    clock = steady_clock(length_s)
    motions = []
    for from_s, to_s in zip(starts_s[:-1].tolist(), starts_s[1:].tolist(), strict=True):
        first = int(np.argmin(np.abs(path.knots_s - from_s)))
        end = int(np.argmin(np.abs(path.knots_s - to_s)))
        knots_s = path.knots_s[first : end + 1] - path.knots_s[first]
        knots_s[-1] = length_s
        part = Path(knots_s=knots_s, coefficients=path.coefficients[first:end])
        motions.append(PathMotion(path=part, clock=clock))
    given_up, asked = _given_up(joints)
    commands, left_out = _commands(layout, joints)
    given_up = tuple(sorted((*given_up, *left_out), key=lambda span: span.from_s))
    return of_passes(
        layout,
        motions,
        given_up=given_up,
        asked=asked,
        commands=commands if sequence.loop == 1 else (),
        marks=explain.marks(
            sequence.keyframes, layout.spacing, clock, is_timed=True, kept=frozenset(layout.keys)
        ),
    )


def _commands(
    layout: Layout, joints: Sequence[JointFollower]
) -> tuple[tuple[CommandedMove, ...], list[GivenUp]]:
    """Return the commands that the servos carry out, and the angles that these do not reach."""
    found, left_out = [], []
    for joint in joints:
        keys = layout.keys[joint.name]
        servo = layout.robot.joints[joint.name]
        done = commands_of(keys, servo, layout.spacing.length_s)
        columns = (done.moves, done.received_s, done.durations_s, done.off_deg)
        for move, received_s, duration_s, off_deg in zip(
            *(column.tolist() for column in columns), strict=True
        ):
            from_s, to_s = float(keys.left_s[move]), float(keys.reached_s[move + 1])
            if joint.is_changed(from_s, to_s):
                continue
            asked_deg = float(keys.deg[move + 1])
            if duration_s > 0.0:
                move_made = CommandedMove(
                    at_s=received_s, joint=joint.name, deg=asked_deg, duration_s=duration_s
                )
                found.append(move_made)
            if abs(off_deg) > GIVEN_UP_MIN_DEG:
                line_deg = float(keys.deg[move]), asked_deg
                left_out.append(joint.left_out((from_s, to_s), line_deg, asked_deg - off_deg))
    return tuple(sorted(found, key=lambda move: move.at_s)), left_out


def _given_up(
    joints: Sequence[JointFollower],
) -> tuple[tuple[GivenUp, ...], tuple[AskedSpan, ...]]:
    """Return what all joints give up, in order of time, and what is asked for there."""
    found = [(joint, span) for joint in joints for span in joint.given_up()]
    found.sort(key=lambda pair: pair[1].from_s)
    asked = tuple(joint.asked_in(span) for joint, span in found)
    return tuple(span for _, span in found), asked


def sum_kept(
    path: Path,
    names: tuple[str, ...],
    robot: Robot,
    *,
    marks: Sequence[Mark],
    show: Show,
) -> Trajectory:
    """Return the plan of joints that keep their time along a path, such as a sum of layers.

    `names` are the columns of the path, `marks` the keyframes along it: exact ones are met.
    """
    asked = [AskedMotion(path=path, column=column) for column in range(len(names))]
    keys = [
        tuple(_marked_key(own, mark) for mark in marks if name in mark.kept)
        for name, own in zip(names, asked, strict=True)
    ]
    cells = max(1, math.ceil(path.length_s / CELL_S - 1e-9))
    grid = PassGrid(cell_s=path.length_s / cells, cells=cells, seams=(), is_looped=False, tied=None)
    joints = _followed(path, names, robot, grid, keys, show=show)
    united_path = united([joint.pieces() for joint in joints], np.zeros(1), joints[0].end_s)
    motion = PathMotion(path=united_path, clock=steady_clock(path.length_s))
    given_up, asked_spans = _given_up(joints)
    trajectory = Trajectory(
        name=show.name,
        joints=names,
        first=motion,
        middle=motion,
        last=motion,
        given_up=given_up,
        asked=asked_spans,
        smoothing=_smoothing(show, names, robot),
    )
    verify(trajectory, robot)
    return trajectory


def _marked_key(asked: AskedMotion, mark: Mark) -> KeyAsked:
    """Return the key of a joint at a keyframe of a sum; the sum gives its angle."""
    at_s = mark.planned_s if mark.authored_s is None else mark.authored_s
    return KeyAsked(
        at_s=at_s,
        left_s=at_s + mark.hold_s,
        deg=float(asked.angles(np.array([at_s]))[0]),
        name=repr(mark.label) if mark.label else f"at {at_s:g} s",
        label=mark.label,
        line=None,
        is_exact=mark.is_exact,
        weight=mark.weight,
        around_s=PULL_OF_SUM_S,
        is_turn=abs(asked.speed(at_s)) < TURN_DEG_S,
    )


def part_of(track: Show, joints: Collection[str]) -> Show:
    """Return the keyframes of a track with those joints only; all of its times are kept.

    Keyframes of other joints stay in it without angles: no hold and no anchor of these joints.
    """
    frames = []
    for frame in track.keyframes:
        deg = {name: angle_deg for name, angle_deg in frame.deg.items() if name in joints}
        own = frame if deg else replace(frame, is_anchor=False, hold_may_shrink=True)
        frames.append(replace(own, deg=deg))
    return replace(track, keyframes=tuple(frames), keeps_time=track.keeps_time & {*joints})


def is_even(slow: Trajectory, track: Show) -> bool:
    """Return whether every pass of `slow` is as long as the author's."""
    ends_s = [(frame.at_s or 0.0) + frame.hold_s for frame in track.keyframes]
    length_s = track.fit_duration_s or max(ends_s)
    return all(abs(motion.duration_s - length_s) <= PASS_SLACK_S for motion in _passes(slow))


def _passes(trajectory: Trajectory) -> tuple[Pass, Pass, Pass]:
    return trajectory.first, trajectory.middle, trajectory.last


def beside(
    slow: Trajectory, kept: Trajectory, robot: Robot, are_kept: Iterable[bool]
) -> Trajectory:
    """Return the joints of a show that may be late beside those that keep their time.

    A pass lasts until the late joints are through it; the others wait for them at its end. Both
    have the same keyframes; `are_kept` has for each whether all of its joints keep their time.
    """
    joints = tuple(name for name in robot.joints if name in {*slow.joints, *kept.joints})
    if slow.loop != 1:
        kept = _waiting(kept, slow)
    parts = (slow, kept)

    def during(
        from_s: float, duration_s: float, parts: tuple[Trajectory, Trajectory] = parts
    ) -> ParallelPass:
        return ParallelPass(joints=joints, parts=parts, from_s=from_s, duration_s=duration_s)

    first = middle = last = during(0.0, max(part.first.duration_s for part in parts))
    if any(part.first is not part.last or part.is_periodic for part in parts):
        middle = during(slow.pass_start_s(1), slow.middle.duration_s)
        # The last pass of a show without end is the one that would end it.
        count = slow.loop or LAST_OF_ENDLESS
        ending = replace(slow, loop=count), replace(kept, loop=count)
        last = during(ending[0].pass_start_s(count - 1), slow.last.duration_s, ending)
    marks = [
        replace(own, is_kept=True) if is_kept else replace(late, kept=own.kept)
        for own, late, is_kept in zip(kept.marks, slow.marks, are_kept, strict=True)
    ]
    return Trajectory(
        name=slow.name,
        joints=joints,
        first=first,
        middle=middle,
        last=last,
        loop=slow.loop,
        is_periodic=slow.is_periodic or kept.is_periodic,
        stretched=slow.stretched,
        given_up=kept.given_up,
        asked=kept.asked,
        commands=kept.commands,
        marks=tuple(marks),
        smoothing=(*slow.smoothing, *kept.smoothing),
    )


def _waiting(kept: Trajectory, slow: Trajectory) -> Trajectory:
    """Return the passes of `kept`, each with a rest at its end until that of `slow` is over."""

    def longer(motion: PathMotion, until_s: float) -> PathMotion:
        end_s = motion.duration_s
        if until_s - end_s <= PASS_SLACK_S:
            return motion
        clock = PathClock(
            times_s=np.array([0.0, end_s, until_s]),
            path_s=np.array([0.0, end_s, end_s]),
            rates=np.array([1.0, 0.0]),
            rate_slopes=np.zeros(2),
        )
        return PathMotion(path=motion.path, clock=clock)

    first, middle, last = (
        longer(motion, other.duration_s)
        for motion, other in zip(motions_of(kept), _passes(slow), strict=True)
    )
    return replace(kept, first=first, middle=middle, last=last)
