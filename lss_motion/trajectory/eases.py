"""Where `spline` costs time: keyframes at which another ease would make a motion less late.

`spline` swings into and out of its keys, which asks more of a servo than `smooth` in one place and
less in another. The plan keeps the ease that the author gave; `ease_advice` plans again with
`smooth` where it asks less, and returns what that would gain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError, PlanningError
from lss_motion.sequence.keyframes import at_speed
from lss_motion.sequence.model import Interpolation, Timing
from lss_motion.trajectory.keys import is_timed
from lss_motion.trajectory.path import peaks
from lss_motion.trajectory.planner import cache_name, plan
from lss_motion.trajectory.retime import laid_out

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Keyframe, Sequence
    from lss_motion.trajectory.retime import Layout

    FloatArray = NDArray[np.float64]

LATE_MIN_S: Final = 0.01
"""Shows whose keyframes are late by less in all get no advice: it cannot be seen."""

GAIN_MIN_RATIO: Final = 0.1
"""Less gain is no advice. Chosen: the curve changes for it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EaseAdvice:
    """What `ease: smooth` at some keyframes would do for the sum of the lateness of all."""

    name: str
    """Name of the sequence or track."""
    keyframes: tuple[Keyframe, ...]
    late_s: float
    would_be_s: float


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
    splines = [
        index
        for index, frame in enumerate(track.keyframes)
        if frame.ease is Interpolation.SPLINE and index > 0
    ]
    if not splines or track.timing is not Timing.AUTHORED or not is_timed(track):
        return None
    late_s = _late_s(track, robot)
    if late_s is None or late_s < LATE_MIN_S:
        return None
    used = _used(track, laid_out(track, robot))
    smooth = _smoothed(track, splines)
    used_smooth = _used(smooth, laid_out(smooth, robot))
    better = [index for index in splines if used[index] > max(1.0, used_smooth[index])]
    best: tuple[float, list[int]] = ((1.0 - GAIN_MIN_RATIO) * late_s, [])
    for chosen in (better, splines):
        would_be_s = _late_s(_smoothed(track, chosen), robot) if chosen else None
        if would_be_s is not None and would_be_s < best[0]:
            best = (would_be_s, chosen)
    if not best[1]:
        return None
    frames = tuple(track.keyframes[index] for index in best[1])
    return EaseAdvice(name=track.name, keyframes=frames, late_s=late_s, would_be_s=best[0])


def _smoothed(track: Sequence, chosen: list[int]) -> Sequence:
    """Return the track with `smooth` as the ease of the chosen keyframes."""
    frames = [
        replace(frame, ease=Interpolation.SMOOTH) if index in chosen else frame
        for index, frame in enumerate(track.keyframes)
    ]
    return replace(track, keyframes=tuple(frames))


def _late_s(track: Sequence, robot: Robot) -> float | None:
    """Return the sum of the lateness at all keyframes; None if there is no plan."""
    try:
        marks = plan(track, robot).marks
    except (InputError, PlanningError):
        return None
    return sum(max(0.0, mark.planned_s - (mark.authored_s or 0.0)) for mark in marks)


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
