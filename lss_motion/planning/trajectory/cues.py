"""Marks, cues and waits at planned times, in every pass of a loop."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.model import LoopedSpan

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.planning.trajectory.model import Mark, Trajectory, WaitPoint
    from lss_motion.show.model import Cue, Sequence

LATE_SLACK_S: Final = 1e-6
"""A cue at the end of a pass may lie beyond it by the rounding error of added decimals."""


def planned_cues(sequence: Sequence, trajectory: Trajectory) -> tuple[Cue, ...]:
    """Return the cues of `sequence` at planned times.

    A cue between two keyframes is moved as they are, in proportion; beside joints that keep their
    time it stays where the author put it. Raises `InputError` for a cue
    after the end of a pass.
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
        beyond_s = max(cue.at_s - float(authored_s[-1]), 0.0)
        at_s = float(np.interp(cue.at_s, authored_s, planned_s)) + beyond_s
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
