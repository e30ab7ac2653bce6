"""Cuts the references of all joints into segments that are fitted side by side.

A segment leads from one stop of a servo to the next. It depends on no other segment: it begins at
rest on the wire value nearest to the reference, and its last move ends on such a value too. Stops
are the standstills of the reference and, in long parts without any, some of its turning points,
where the servo comes to rest for an instant anyway.
"""

from __future__ import annotations

from bisect import bisect_left
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.planning.program.moves import nearest_wire
from lss_motion.planning.program.reference_grid import GRID_S, STILL_ROUNDING_DEG

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from lss_motion.planning.program.moves import InitialMotion
    from lss_motion.planning.program.reference_grid import Reference, ServoLimits
    from lss_motion.planning.program.response import FloatArray, IntArray

STRETCH_S: Final = 6.0
"""A part without a standstill is cut about this often. A cut costs no moves: the bench show of
`compile` needs 47,740 with cuts every 10 s, 47,701 every 6 s, 47,610 every 4 s. The longest
segments decide how many rounds there are; with shorter ones the work for each segment outweighs
that."""
TURN_STEPS: Final = 12
TURN_ACCEL_RATIO: Final = 0.7
"""A servo can stop in step with the reference at a turning point if, for `TURN_STEPS` on either
side, the reference bends with no more than this share of the ramp."""
SEARCH_STEPS: Final = 32
"""Grid points searched first for the end of a standstill; each further search takes twice as
many."""

Stop = tuple[int, int]


class Segment(Struct, frozen=True):
    """One joint from a stop to the next. Instants in seconds.

    The segment begins in the stop that begins at the index `first` of the reference's grid. The
    servo must receive the first move between `onset_s` and `latest_s`; `departs_s` is the best
    estimate. `stop` is the standstill, `(first, last)` index of the grid, on whose wire value the
    segment ends; None at the end of a reference in motion. `initial` is the motion before a segment
    that does not begin in a stop.
    """

    joint: int
    wire: int
    first: int
    after_s: float
    onset_s: float
    departs_s: float
    latest_s: float
    stop: Stop | None
    stop_wire: int
    initial: InitialMotion | None = None


def segments_of(
    joint: int,
    reference: Reference,
    limits: ServoLimits,
    follow_deg: float,
    refused: Container[tuple[int, int]],
    initial: InitialMotion | None = None,
) -> Iterator[Segment]:
    """Yield the segments of one joint, in order of time.

    A segment may begin while the servo is up to `follow_deg` from its reference. `refused` holds
    `(joint, index)` of stops at which the servo does not stop.
    """
    stops = [stop for stop in _stops(reference, limits) if (joint, stop[0]) not in refused]
    last = len(reference.position_deg) - 1
    if initial is not None and initial.first_s is not None:
        first = reference.index(initial.first_s)
        stops = [stop for stop in stops if stop[1] > first]
        before = stops.pop(0) if stops else None
        wire = nearest_wire(float(reference.position_deg[before[0] if before else last]), limits)
        start_s, first_s = reference.start_s, initial.first_s
        yield Segment(joint, 0, 0, start_s, first_s, first_s, first_s, before, wire, initial)
        if before is None:
            return
    else:
        before = stops.pop(0) if stops and stops[0][0] == 0 else None
        wire = nearest_wire(float(reference.position_deg[before[1] if before else 0]), limits)
        if initial is not None:
            wire = round(initial.profile.at(reference.start_s)[0] * limits.wire_per_deg)
    bounds: list[Stop | None] = [before, *stops]
    at = [stop[0] for stop in stops]
    if bounds[-1] is None or bounds[-1][1] < last:
        bounds.append(None)
        at.append(last)
    wires = [wire, *(nearest_wire(deg, limits) for deg in reference.position_deg[at].tolist())]
    yield from _segments(joint, reference, limits, follow_deg, bounds, wires)


def _stops(reference: Reference, limits: ServoLimits) -> list[Stop]:
    """Return the standstills of a reference, and turning points where standstills are far apart."""
    rests = reference.rests()
    if reference.given:
        return rests  # Between them the moves are known already.
    stretch = round(STRETCH_S / GRID_S)
    edges = [0, *(index for rest in rests for index in rest), len(reference.position_deg) - 1]
    if max(b - a for a, b in zip(edges[::2], edges[1::2], strict=True)) < 2 * stretch:
        return rests
    turns, accels = (column.tolist() for column in _turns(reference, limits.ramp_deg_s2))
    stops = list(rests)
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        now = start
        while now + 2 * stretch < end:
            low = bisect_left(turns, now + stretch)
            high = bisect_left(turns, min(now + 2 * stretch, end - stretch))
            now += stretch
            if low < high:
                now = turns[min(range(low, high), key=accels.__getitem__)]
                stops.append((now, now))
    return sorted(stops)


def _turns(reference: Reference, ramp_deg_s2: float) -> tuple[IntArray, FloatArray]:
    """Return the turning points at which a servo can stop, and the acceleration of each."""
    steps = reference.steps_deg
    turns = 1 + np.flatnonzero(steps[:-1] * steps[1:] < 0.0)
    turns = turns[(turns >= TURN_STEPS) & (turns < len(steps) - TURN_STEPS)]
    around = turns[:, None] + np.arange(-TURN_STEPS - 1, TURN_STEPS + 1)
    changes = np.abs(np.diff(steps[around], axis=1)).max(axis=1, initial=0.0)
    accels = changes / (GRID_S * GRID_S)
    is_gentle = accels <= TURN_ACCEL_RATIO * ramp_deg_s2
    return turns[is_gentle], accels[is_gentle]


def _segments(
    joint: int,
    reference: Reference,
    limits: ServoLimits,
    follow_deg: float,
    bounds: Sequence[Stop | None],
    wires: Sequence[int],
) -> Iterator[Segment]:
    """Yield the segments from each of the `bounds` to the next; None is an end of the reference.

    A reference that never leaves the wire value on which it begins has no segment there.
    """
    end = len(reference.position_deg) - 1
    edges = [
        (before[0] if before else 0, before[1] if before else end, after[0] if after else end)
        for before, after in pairwise(bounds)
    ]
    first, rested, last = np.array(edges, dtype=np.intp).reshape(-1, 3).T
    wire, stop_wire = np.array(wires[:-1]), np.array(wires[1:])
    position_deg = wire / limits.wire_per_deg
    half_unit_deg = 0.5 / limits.wire_per_deg + STILL_ROUNDING_DEG
    leaves = _first_away(reference.position_deg, first, last, position_deg, half_unit_deg)
    is_moved = (leaves <= last) | (wire != stop_wire)
    leaves = np.minimum(leaves, last)
    onset = np.minimum(rested, leaves)
    # The landing of the segment before may come to rest a little after a turning point.
    is_turn = np.array([stop is not None and stop[0] == stop[1] for stop in bounds[:-1]])
    after_s = reference.times_s(first) + GRID_S * is_turn
    outside = _first_away(reference.position_deg, leaves, last, position_deg, follow_deg)
    onset_s = np.maximum(reference.times_s(onset), after_s)
    latest_s = np.maximum(reference.times_s(np.maximum(outside - 1, leaves)), onset_s)
    departs_s = np.minimum(np.maximum(_departures_s(reference, onset), onset_s), latest_s)
    times_s = (after_s, onset_s, departs_s, latest_s)
    rows = zip(*(column.tolist() for column in times_s), strict=True)
    for at, (start_s, begin_s, guess_s, end_s) in enumerate(rows):
        if is_moved[at]:
            stop, stop_at, index = bounds[at + 1], wires[at + 1], edges[at][0]
            yield Segment(joint, wires[at], index, start_s, begin_s, guess_s, end_s, stop, stop_at)


def _first_away(
    grid: FloatArray, first: IntArray, last: IntArray, position_deg: FloatArray, distance_deg: float
) -> IntArray:
    """Return the first indices from `first` to `last` that are further away than `distance_deg`.

    The index after `last` stands for none.
    """
    found, begin, steps = last + 1, first, SEARCH_STEPS
    some = np.arange(len(first))
    while len(some):
        index = begin[:, None] + np.arange(steps)
        off_deg = grid.take(index, mode="clip") - position_deg[some, None]
        is_away = (np.abs(off_deg) > distance_deg) & (index <= last[some, None])
        step = is_away.argmax(axis=1)
        is_found = is_away[np.arange(len(some)), step]
        found[some[is_found]] = begin[is_found] + step[is_found]
        begin, steps = begin + steps, 2 * steps
        goes_on = ~is_found & (begin <= last[some])
        some, begin = some[goes_on], begin[goes_on]
    return found


def _departures_s(reference: Reference, onset: IntArray) -> FloatArray:
    """Return when the reference leaves its standstills, between two grid points, as a parabola."""
    grid = reference.position_deg
    first, second = (
        np.sqrt(np.abs(grid.take(onset + step, mode="clip") - grid[onset])) for step in (1, 2)
    )
    bends = second > first
    before_s = GRID_S * first / np.where(bends, second - first, 1.0)
    return np.where(bends, reference.times_s(onset + 1) - before_s, reference.times_s(onset))
