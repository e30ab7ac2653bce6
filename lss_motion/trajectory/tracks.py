"""Tracks beside each other: joints that are planned apart and move at the same time."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import PlanningError
from lss_motion.trajectory.model import Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence as Show

    FloatArray = NDArray[np.float64]

PERIOD_MAX_S: Final = 600.0
"""Within this, tracks that loop forever must meet again. Chosen: all of it is compiled."""

PERIOD_UNIT_S: Final = 1e-6
"""Passes are compared in whole microseconds, the unit of a program's instants."""

PERIOD_SLACK_S: Final = 1e-9
"""A pass that is no whole number of units is no part of a common period: it would drift."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Together:
    """A pass in which tracks move side by side: their show time from `from_s` on."""

    joints: tuple[str, ...]
    parts: tuple[Trajectory, ...]
    from_s: float
    duration_s: float

    @property
    def seams_s(self) -> FloatArray:
        return np.zeros(0)

    @property
    def knots_s(self) -> FloatArray:
        end_s = self.from_s + self.duration_s
        knots_s = np.concatenate([track.knots_until(end_s) for track in self.parts]) - self.from_s
        inside_s = knots_s[(knots_s > 0.0) & (knots_s < self.duration_s)]
        return np.unique(np.concatenate([[0.0], inside_s, [self.duration_s]]))

    def sample(self, times_s: FloatArray, order: int = 0) -> FloatArray:
        times_s = np.asarray(times_s, dtype=np.float64)
        show_s = self.from_s + np.clip(times_s, 0.0, self.duration_s)
        values = np.empty((len(times_s), len(self.joints)))
        for track in self.parts:
            columns = [self.joints.index(name) for name in track.joints]
            values[:, columns] = track.sample(show_s, order)
        if order > 0:
            values[(times_s < 0.0) | (times_s > self.duration_s)] = 0.0
        return values


def side_by_side(
    show: Show,
    tracks: Sequence[Show],
    robot: Robot,
    plan: Callable[[Show, Robot], Trajectory],
) -> Trajectory:
    """Return the tracks played at the same time.

    The show lasts as long as its longest track. A track that loops forever is played as often as
    it fits into that, at least once; but where the keyframes outside of tracks, or all tracks,
    loop forever, so does the show.
    """
    planned = [plan(track, robot) for track in tracks]
    is_endless = show.loop is None if show.keyframes else all(t.loop is None for t in planned)
    if is_endless:
        return _endless(show, planned, robot)
    length_s = max(track.duration_s for track in planned if track.loop is not None)
    finite = [
        track if track.loop is not None else _fitting(source, track, length_s, robot, plan)
        for source, track in zip(tracks, planned, strict=True)
    ]
    whole = Together(
        joints=_joints(finite, robot),
        parts=tuple(finite),
        from_s=0.0,
        duration_s=max(track.duration_s for track in finite),
    )
    return _merged(show, finite, whole, whole, loop=1)


def _fitting(
    source: Show,
    track: Trajectory,
    length_s: float,
    robot: Robot,
    plan: Callable[[Show, Robot], Trajectory],
) -> Trajectory:
    """Return an endless track with as many passes as fit into `length_s`."""
    ends_s = track.first.duration_s + track.last.duration_s
    count = 2 + math.floor((length_s - ends_s) / track.middle.duration_s + 1e-9)
    if count >= 2 or not track.is_periodic:
        return replace(track, loop=max(1, count))
    return plan(replace(source, loop=1), robot)


def _endless(show: Show, tracks: Sequence[Trajectory], robot: Robot) -> Trajectory:
    looped = [track for track in tracks if track.loop is None]
    begun_s = max(
        track.first.duration_s if track.loop is None else track.duration_s for track in tracks
    )
    joints, parts = _joints(tracks, robot), tuple(tracks)
    period_s = _common_period_s(looped)
    first = Together(joints=joints, parts=parts, from_s=0.0, duration_s=begun_s)
    cycle = Together(joints=joints, parts=parts, from_s=begun_s, duration_s=period_s)
    return _merged(show, tracks, first, cycle, loop=None)


def _common_period_s(looped: Sequence[Trajectory]) -> float:
    """Return after what time all loops are where they were."""
    periods_s = [track.middle.duration_s for track in looped]
    if max(periods_s) - min(periods_s) <= PERIOD_SLACK_S:
        return periods_s[0]
    units = [round(period_s / PERIOD_UNIT_S) for period_s in periods_s]
    is_whole = all(
        abs(unit * PERIOD_UNIT_S - period_s) <= PERIOD_SLACK_S
        for unit, period_s in zip(units, periods_s, strict=True)
    )
    common_s = math.lcm(*units) * PERIOD_UNIT_S
    if is_whole and common_s <= PERIOD_MAX_S:
        return common_s
    passes = ", ".join(f"{t.name!r} {s:.6g} s" for t, s in zip(looped, periods_s, strict=True))
    raise PlanningError(
        f"the tracks loop forever, but their passes ({passes}) do not meet again within "
        f"{PERIOD_MAX_S:g} s; make one pass a multiple of the other, or give loops a count"
    )


def _joints(tracks: Sequence[Trajectory], robot: Robot) -> tuple[str, ...]:
    keyed = {name for track in tracks for name in track.joints}
    return tuple(name for name in robot.joints if name in keyed)


def _merged(
    show: Show, tracks: Sequence[Trajectory], first: Together, cycle: Together, *, loop: int | None
) -> Trajectory:
    return Trajectory(
        name=show.name,
        joints=first.joints,
        first=first,
        middle=cycle,
        last=cycle,
        loop=loop,
        is_periodic=loop is None,
        stretched=tuple(
            sorted((s for track in tracks for s in track.stretched), key=lambda s: s.from_s)
        ),
        marks=tuple(sorted((m for t in tracks for m in t.marks), key=lambda m: m.planned_s)),
    )
