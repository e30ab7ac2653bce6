"""Cuts the courses of all joints into lanes that can be fitted side by side.

A lane leads from one stop of a servo to the next, and what happens in it depends on no other lane:
it begins at rest on the wire value nearest to the course, and its last move ends there too. Stops
are the standstills of the course and, in long stretches without any, a few of its turning points,
where the servo comes to rest for an instant anyway.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.course import GRID_S, STILL_ROUNDING_DEG
from lss_motion.program.wording import lattice

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from lss_motion.program.batch import FloatArray, IntArray
    from lss_motion.program.course import Course, ServoLimits
    from lss_motion.program.moves import Begin

STRETCH_S: Final = 6.0
"""A stretch without a standstill is cut about this often. A cut costs next to nothing: the bench
show of `compile` needs 4 moves more of 47,695 than with cuts every 10 s. The longest lanes decide
how many rounds there are, and the last rounds have few lanes to fill their arrays."""
TURN_STEPS: Final = 12
TURN_ACCEL_RATIO: Final = 0.7
"""A servo can stop in step with the course where, for so many grid steps on either side of the
turning point, the course bends with no more than this share of the ramp."""
SEARCH_STEPS: Final = 1024
"""Looked through at once for the end of a standstill."""

Stop = tuple[int, int]


@dataclass(frozen=True, slots=True)
class Lane:
    """One joint from a stop to the next. Instants in seconds.

    The first move is to be heard between `onset_s` and `latest_s`; `leaves_s` is the best guess.
    `stop` is the standstill on whose wire value it ends, `(first, last)` index of the course's
    grid; None at the end of a course in motion. `begin`: what it comes out of, if not a stop.
    """

    joint: int
    wire: int
    after_s: float
    onset_s: float
    leaves_s: float
    latest_s: float
    stop: Stop | None
    stop_wire: int
    begin: Begin | None = None


def lanes_of(
    joint: int,
    course: Course,
    limits: ServoLimits,
    follow_deg: float,
    refused: Container[tuple[int, int]],
    begin: Begin | None = None,
) -> Iterator[Lane]:
    """Yield the lanes of one joint, in order of time.

    A lane may begin while the servo is up to `follow_deg` from its course. `refused` holds
    `(joint, index)` of stops that are to be travelled through.
    """
    stops = [stop for stop in _stops(course, limits) if (joint, stop[0]) not in refused]
    last = len(course.position_deg) - 1
    if begin is not None and begin.first_s is not None:
        first = course.index(begin.first_s)
        stops = [stop for stop in stops if stop[1] > first]
        before = stops.pop(0) if stops else None
        wire = lattice(float(course.position_deg[before[0] if before else last]), limits)
        start_s, first_s = course.start_s, begin.first_s
        yield Lane(joint, 0, start_s, first_s, first_s, first_s, before, wire, begin)
        if before is None:
            return
    else:
        before = stops.pop(0) if stops and stops[0][0] == 0 else None
        wire = lattice(float(course.position_deg[before[1] if before else 0]), limits)
        if begin is not None:
            wire = round(begin.profile.at(course.start_s)[0] * limits.wire_per_deg)
    ends: list[Stop | None] = [*stops, None]
    for end in ends:
        if before is not None and before[1] == last:
            return
        end_wire = lattice(float(course.position_deg[end[0] if end else last]), limits)
        lane = _lane(joint, course, limits, follow_deg, (before, end), (wire, end_wire))
        if lane is not None:
            yield lane
        before, wire = end, end_wire


def _stops(course: Course, limits: ServoLimits) -> list[Stop]:
    """Return the standstills of a course, and turning points where they are far between."""
    rests = course.rests()
    stretch = round(STRETCH_S / GRID_S)
    edges = [0, *(index for rest in rests for index in rest), len(course.position_deg) - 1]
    if max(b - a for a, b in zip(edges[::2], edges[1::2], strict=True)) < 2 * stretch:
        return rests
    turns, accels = _turns(course, limits.ramp_deg_s2)
    stops = list(rests)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        now = start
        while now + 2 * stretch < end:
            low, high = np.searchsorted(
                turns, (now + stretch, min(now + 2 * stretch, end - stretch))
            )
            now += stretch
            if low < high:
                now = int(turns[low + int(np.argmin(accels[low:high]))])
                stops.append((now, now))
    return sorted(stops)


def _turns(course: Course, ramp_deg_s2: float) -> tuple[IntArray, FloatArray]:
    """Return the turning points at which a servo can stop, and how sharply the course turns."""
    steps = np.diff(course.position_deg)
    turns = 1 + np.flatnonzero(steps[:-1] * steps[1:] < 0.0)
    turns = turns[(turns >= TURN_STEPS) & (turns < len(steps) - TURN_STEPS)]
    around = turns[:, None] + np.arange(-TURN_STEPS, TURN_STEPS + 1)
    accels = np.abs(course.accel_deg_s2()[around]).max(axis=1, initial=0.0)
    is_gentle = accels <= TURN_ACCEL_RATIO * ramp_deg_s2
    return turns[is_gentle], accels[is_gentle]


def _lane(
    joint: int,
    course: Course,
    limits: ServoLimits,
    follow_deg: float,
    stops: tuple[Stop | None, Stop | None],
    wires: tuple[int, int],
) -> Lane | None:
    """Return one lane; None where its course never leaves the wire value it begins on."""
    before, stop = stops
    last = stop[0] if stop is not None else len(course.position_deg) - 1
    first = before[0] if before is not None else 0
    position_deg = wires[0] / limits.wire_per_deg
    half_unit_deg = 0.5 / limits.wire_per_deg + STILL_ROUNDING_DEG
    leaves = _first_away(course.position_deg, first, last, position_deg, half_unit_deg)
    if leaves is None:
        if wires[0] == wires[1]:
            return None
        leaves = last
    onset = min(before[1], leaves) if before is not None else leaves
    outside = _first_away(course.position_deg, leaves, last, position_deg, follow_deg)
    latest = last if outside is None else max(outside - 1, leaves)
    onset_s, latest_s = course.time_s(onset), course.time_s(latest)
    return Lane(
        joint=joint,
        wire=wires[0],
        after_s=course.time_s(first),
        onset_s=onset_s,
        leaves_s=min(max(_leaves_s(course, onset), onset_s), latest_s),
        latest_s=latest_s,
        stop=stop,
        stop_wire=wires[1],
    )


def _first_away(
    grid: FloatArray, first: int, last: int, position_deg: float, distance_deg: float
) -> int | None:
    """Return the first index from `first` to `last` further off than `distance_deg`."""
    while first <= last:
        some = grid[first : min(first + SEARCH_STEPS, last + 1)]
        away = np.abs(some - position_deg) > distance_deg
        if away.any():
            return first + int(away.argmax())
        first += SEARCH_STEPS
    return None


def _leaves_s(course: Course, onset: int) -> float:
    """Return when the course leaves its standstill, between two grid points, as a parabola."""
    grid = course.position_deg
    first, second = (
        math.sqrt(abs(grid[min(onset + step, len(grid) - 1)] - grid[onset])) for step in (1, 2)
    )
    if second <= first:
        return course.time_s(onset)
    return course.time_s(onset + 1) - GRID_S * first / (second - first)
