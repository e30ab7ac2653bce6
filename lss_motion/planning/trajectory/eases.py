"""Where `spline` or `smooth` costs time: keyframes at which the other would be less late.

`spline` swings into and out of its keys, which asks more of a servo than `smooth` in one place and
less in another. `smooth` rests at every turn of a joint, which in a recording of several joints
comes often. The plan keeps the ease that the author gave; `ease_advice` plans again with the other
where it asks less, and returns what that would gain.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.planning.trajectory.curves import peaks
from lss_motion.planning.trajectory.kept_plans import cache_name
from lss_motion.planning.trajectory.keys import is_timed
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.retime import laid_out
from lss_motion.show.keyframes import at_speed
from lss_motion.show.model import Interpolation, Timing

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.retime import Layout
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Keyframe, Sequence

    FloatArray = NDArray[np.float64]

LATE_MIN_S: Final = 0.01
"""Shows whose keyframes are late by less in all get no advice: it cannot be seen."""

GAIN_MIN_RATIO: Final = 0.1
"""Less gain is no advice. Chosen: the curve changes for it."""


OTHER: Final = {
    Interpolation.SPLINE: Interpolation.SMOOTH,
    Interpolation.SMOOTH: Interpolation.SPLINE,
}
"""What may keep time better than an ease: both pass through keys without a rest."""


class Lateness(NamedTuple):
    """How late the keyframes of a track are."""

    total_s: float
    most_s: float


class EaseAdvice(Struct, frozen=True, kw_only=True):
    """What another ease at some keyframes would do for the sum of the lateness of all."""

    name: str
    """Name of the sequence or track."""
    ease: Interpolation
    """What the keyframes should have instead of `OTHER[ease]`."""
    keyframes: tuple[Keyframe, ...]
    is_whole: bool
    """They are all of the track but its first, to which nothing travels."""
    late: Lateness
    would_be: Lateness


def ease_advice(sequence: Sequence, robot: Robot) -> tuple[EaseAdvice, ...]:
    """Return the advice for a sequence, its tracks and the sequences that it plays."""
    tracks = {cache_name(track, robot): track for track in _tracks_of(at_speed(sequence))}
    found = [_advice(track, robot) for track in tracks.values()]
    return tuple(advice for advice in found if advice is not None)


def _tracks_of(sequence: Sequence) -> Iterator[Sequence]:
    if sequence.keyframes:
        yield replace(sequence, tracks=(), layers=(), events=(), loop_span_s=None, loop=1)
    for track in sequence.tracks:
        yield replace(track, loop=1)
    for step in sequence.play:
        if step.sequence is not None:
            yield from _tracks_of(step.sequence)


def _advice(track: Sequence, robot: Robot) -> EaseAdvice | None:
    if track.timing is not Timing.AUTHORED or not is_timed(track):
        return None
    if not any(frame.ease in OTHER for frame in track.keyframes[1:]):
        return None
    late = _lateness(track, robot)
    if late is None or late.total_s < LATE_MIN_S:
        return None
    used = _used(track, laid_out(track, robot))
    found: list[EaseAdvice] = []
    for given, ease in OTHER.items():
        for chosen in _worth_trying(track, robot, given, used):
            would_be = _lateness(_changed(track, chosen, ease), robot)
            if would_be is None or would_be.total_s >= (1.0 - GAIN_MIN_RATIO) * late.total_s:
                continue
            advice = EaseAdvice(
                name=track.name,
                ease=ease,
                keyframes=tuple(track.keyframes[index] for index in chosen),
                is_whole=len(chosen) == len(track.keyframes) - 1,
                late=late,
                would_be=would_be,
            )
            found.append(advice)
    return min(found, key=lambda advice: advice.would_be.total_s, default=None)


def _worth_trying(
    track: Sequence, robot: Robot, given: Interpolation, used: FloatArray
) -> Iterator[list[int]]:
    """Yield the keyframes with an ease at which the other asks less, and all with that ease.

    A spline is curved by its neighbours: single keys do not get what was computed for all, so only
    all of them are tried.
    """
    frames = enumerate(track.keyframes)
    having = [index for index, frame in frames if frame.ease is given and index > 0]
    changed = _changed(track, having, OTHER[given])
    try:
        used_changed = _used(changed, laid_out(changed, robot))
    except InputError:  # A spline swings out of the range of a joint.
        return
    better = [index for index in having if used[index] > max(1.0, used_changed[index])]
    if given is Interpolation.SPLINE:
        yield from (chosen for chosen in (better, having) if chosen)
    elif better:
        yield having


def _changed(track: Sequence, chosen: list[int], ease: Interpolation) -> Sequence:
    """Return the track with another ease at the chosen keyframes."""
    frames = list(track.keyframes)
    for index in chosen:
        frames[index] = replace(frames[index], ease=ease)
    return replace(track, keyframes=tuple(frames))


def _lateness(track: Sequence, robot: Robot) -> Lateness | None:
    """Return how late the keyframes are; None if there is no plan."""
    try:
        marks = plan(track, robot).marks
    except (InputError, PlanningError):
        return None
    late_s = [max(0.0, mark.planned_s - (mark.authored_s or 0.0)) for mark in marks]
    return Lateness(sum(late_s), max(late_s, default=0.0))


def _used(track: Sequence, layout: Layout) -> FloatArray:
    """Return how much of its limits the moves to each keyframe use at the author's times.

    The use of an acceleration counts as that of the speed with which it goes away.
    """
    path = layout.paths[0]
    limits = [layout.robot.joints[name] for name in layout.keys]
    speed, accel = peaks(path)
    used = np.maximum(
        speed / np.array([joint.speed_max_deg_s for joint in limits]),
        np.sqrt(accel / np.array([joint.accel_max_deg_s2 for joint in limits])),
    )
    columns = {name: column for column, name in enumerate(layout.keys)}
    spacing, left_s = layout.spacing, dict.fromkeys(columns, 0.0)
    found = np.zeros(len(track.keyframes))
    for index, frame in enumerate(track.keyframes):
        for name in frame.deg.keys() & columns.keys():
            low, high = np.searchsorted(
                path.knots_s, [left_s[name], float(spacing.reached_s[index])]
            ).tolist()
            if high > low:
                found[index] = max(found[index], float(used[low:high, columns[name]].max()))
            left_s[name] = float(spacing.left_s[index])
    return found
