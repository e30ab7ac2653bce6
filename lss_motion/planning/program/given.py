"""Segments for which the author gives the commands: they are sent as they are, where they fit.

A plan with the ease `command` is the motion of the servos on these commands. They are received as
planned, up to the slots of the line. A segment in which the servo would then be further from its
reference than `SHIFTED_RATIO` allows is fitted like any other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from lss_motion.planning.program.moves import FittedMoves, no_moves, profiles_from_rest, replayed
from lss_motion.planning.program.reference_grid import GRID_S, LimitArrays
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.planning.program.reference_grid import GivenCommand, Reference, ServoLimits
    from lss_motion.planning.program.response import FloatArray, IntArray
    from lss_motion.planning.program.segments import Segment

    Grant = Callable[[IntArray, IntArray, IntArray], IntArray]


SHIFTED_RATIO: Final = 2.5
"""Given commands may take the servo so many tolerances from its reference, and twice as far as it
travels at most in the time by which the line shifts one of them: a servo that turns back later is
off by both ways. Chosen: commands for many servos at one instant wait for each other on the line,
as those of a script do."""

SHIFT_MAX_S: Final = 0.025
"""The line may shift a given command by so much. Chosen: 18 commands at one instant take 23 ms at
115200 bps."""


class GivenMoves(NamedTuple):
    """Segments with the moves that the author gives for them, and the segment of each move."""

    segments: list[Segment]
    moves: FittedMoves
    of_segment: IntArray


def given_moves(
    references: Sequence[Reference],
    limits: Sequence[ServoLimits],
    segments: Sequence[Segment],
    new_line: Callable[[], Grant],
) -> GivenMoves:
    """Return the given moves of all segments that keep the tolerance with them."""
    found = [(segment, own) for segment in segments if (own := _given(references, segment))]
    if not found:
        return GivenMoves([], no_moves(), np.zeros(0, dtype=np.intp))
    of_segment = np.repeat(np.arange(len(found)), [len(own) for _, own in found])
    joint = np.array([segment.joint for segment, _ in found], dtype=np.intp)
    commands = [command for _, own in found for command in own]
    requested_s = np.array([command.received_s for command in commands])
    received_s = _received_s(found, joint[of_segment], requested_s, new_line())
    own_limits = [limits[at] for at in joint.tolist()]
    begins_deg = np.array([segment.wire for segment, _ in found])
    begins_deg = begins_deg / np.array([limit.wire_per_deg for limit in own_limits])
    # Each segment as a joint of its own: it begins at rest.
    moves = replayed(
        of_segment,
        received_s,
        np.array([command.target_wire for command in commands], dtype=np.float64),
        np.array([command.duration_ms for command in commands], dtype=np.float64),
        begins_deg,
        LimitArrays(own_limits),
    )
    profiles = profiles_from_rest(moves, own_limits, begins_deg)
    fits = np.zeros(len(found), dtype=bool)
    for at, ((segment, own), profile) in enumerate(zip(found, profiles, strict=True)):
        reference, stop = references[segment.joint], segment.stop
        if stop is None or own[-1].target_wire != segment.stop_wire:
            continue
        index = np.arange(segment.first, stop[1] + 1)
        shift_s = float(np.abs((received_s - requested_s)[of_segment == at]).max())
        asked_deg = reference.position_deg[index]
        off_deg = np.abs(profile.sample(reference.times_s(index)) - asked_deg).max()
        shifted_deg = 2.0 * shift_s * np.abs(np.diff(asked_deg)).max(initial=0.0) / GRID_S
        is_near = off_deg <= SHIFTED_RATIO * limits[segment.joint].tolerance_deg + shifted_deg
        is_over = profile.end_s <= reference.time_s(stop[1]) + shift_s + GRID_S
        fits[at] = is_near and is_over and shift_s <= SHIFT_MAX_S
    chosen = np.flatnonzero(fits[of_segment])
    number = np.cumsum(fits) - 1
    kept = moves.take(chosen)
    kept = FittedMoves(joint[kept.joint], *(getattr(kept, name) for name in _VALUES))
    kept_segments = [segment for (segment, _), is_kept in zip(found, fits, strict=True) if is_kept]
    return GivenMoves(kept_segments, kept, number[of_segment[chosen]])


_VALUES = FittedMoves.__struct_fields__[1:]
"""The columns of moves besides the joint."""


def _given(references: Sequence[Reference], segment: Segment) -> tuple[GivenCommand, ...]:
    """Return the commands that the servo receives from the begin of a segment to its stop."""
    reference = references[segment.joint]
    if segment.initial is not None or segment.stop is None or not reference.given:
        return ()
    from_s, to_s = segment.onset_s - GRID_S, reference.time_s(segment.stop[0]) - GRID_S
    return tuple(own for own in reference.given if from_s <= own.received_s < to_s)


def _received_s(
    found: Sequence[tuple[Segment, tuple[GivenCommand, ...]]],
    joint: IntArray,
    requested_s: FloatArray,
    grant: Grant,
) -> FloatArray:
    """Return when the line lets the servos receive the commands."""
    after_s = np.append(-np.inf, requested_s[:-1])
    firsts = np.cumsum([0, *(len(own) for _, own in found)])[:-1]
    after_s[firsts] = [segment.after_s for segment, _ in found]
    in_turn = np.argsort(requested_s, kind="stable")
    columns = (
        np.rint(US_PER_S * times_s[in_turn]).astype(np.intp) for times_s in (requested_s, after_s)
    )
    received_s = np.empty(len(requested_s))
    received_s[in_turn] = grant(joint[in_turn], *columns) / US_PER_S
    return received_s
