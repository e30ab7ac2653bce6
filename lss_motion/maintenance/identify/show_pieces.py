"""Cuts a show into pieces of a few moves, which a fit can compute all at once.

A piece begins a few moves before the readings that are scored: where the profile of its servo is at
that moment is known from a model only, and what is wrong with it fades with each move. What is left
is for the fit: `Pieces.start_error` says how well each begin is known.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import PlaybackError
from lss_motion.robot.profile import Profile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.response_fit import Hypothesis
    from lss_motion.maintenance.identify.show_log import ShowRecording
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.robot.model import Joint

PIECE_S: Final = 1.5
"""A piece is scored over this time: a few moves."""
PIECES_MAX: Final = 40
"""Chosen: a minute of motion, a second of computing for a joint."""
TAIL_S: Final = 2.0
"""After the last move of a piece no later readings are used."""
WARM_MOVES: Final = 4
"""Moves before a piece, since the profile at its begin is only known from a model."""
REST_S: Final = 0.3
"""After a longer rest the profile is known."""
MOTION_DEG: Final = 3.0
"""Pieces in which the readings differ by less show no motion."""
RESTS_RATIO: Final = 0.2
"""Share of the pieces that may be without motion: they show the load."""
NEVER_S: Final = 1e9
"""Instant of a move that does not exist."""
RESTED: Final = (0.05, 0.5)
"""How well a begin at rest is known: angle (deg) and speed (deg/s). Chosen: half a wire unit."""


class TooLittleMotionError(PlaybackError):
    """A joint did not move enough in a show to be measured."""


def too_little(joint: Joint, why: str) -> TooLittleMotionError:
    """Return the error that says why a joint did not move enough, and what to do."""
    return TooLittleMotionError(
        f"joint {joint.name!r} did not move enough to be measured: {why}. Play a longer show, or "
        f"measure it by an experiment",
        joint=joint.name,
    )


class Believed(NamedTuple):
    """What the profile of a servo is taken to do, and how well that is known."""

    ramp_deg_s2: float
    hypothesis: Hypothesis
    start_error: tuple[float, float]
    """Standard errors of angle (deg) and speed (deg/s) of a profile in mid-move."""


class _Piece(NamedTuple):
    """Moves `first` to `last` (not included), scored between two instants."""

    first: int
    last: int
    from_s: float
    until_s: float


class Pieces(Struct, frozen=True):
    """Pieces as arrays, (pieces, moves); times count from the begin of each piece."""

    begin_s: FloatArray
    received_s: FloatArray
    target_deg: FloatArray
    duration_s: FloatArray
    start_deg: FloatArray
    start_deg_s: FloatArray
    start_error: FloatArray
    """(pieces, 2): standard errors of the last two."""
    last_s: float
    """The last reading of all."""
    piece: NDArray[np.intp]
    """Of each reading; they rise."""
    time_s: FloatArray
    reading_deg: FloatArray

    @property
    def firsts(self) -> NDArray[np.intp]:
        """The first reading of each piece."""
        return np.searchsorted(self.piece, np.arange(len(self.begin_s)))


def cut(recording: ShowRecording, believed: Believed, most: int = PIECES_MAX) -> Pieces:
    """Return at most `most` pieces with motion of a show, and some without; or raise."""
    states = list(_states(recording, believed))
    found = list(_cut(recording, states))
    times_s, readings_deg = np.array(recording.times_s), np.array(recording.readings_deg)
    owns = [np.flatnonzero((times_s >= p.from_s) & (times_s < p.until_s)) for p in found]
    ranges_deg = [float(np.ptp(readings_deg[own])) if len(own) > 2 else -1.0 for own in owns]
    moving = [n for n, range_deg in enumerate(ranges_deg) if range_deg >= MOTION_DEG]
    still = [n for n, range_deg in enumerate(ranges_deg) if 0.0 <= range_deg < MOTION_DEG]
    chosen = [*_spread(moving, most), *_spread(still, int(RESTS_RATIO * most))]
    if len(moving) < 3:
        raise too_little(recording.joint, "in fewer than 3 pieces of the show")
    some, count = [found[n] for n in chosen], max(found[n].last - found[n].first for n in chosen)
    received_s = np.full((len(some), count), NEVER_S)
    target_deg, duration_s = np.zeros((len(some), count)), np.ones((len(some), count))
    begin_s = np.array([recording.moves[piece.first].received_s for piece in some])
    for row, piece in enumerate(some):
        own = recording.moves[piece.first : piece.last]
        received_s[row, : len(own)] = [move.received_s - begin_s[row] for move in own]
        target_deg[row, : len(own)] = [move.target_deg for move in own]
        duration_s[row, : len(own)] = [move.duration_s for move in own]
    piece_of = np.concatenate([np.full(len(owns[n]), row) for row, n in enumerate(chosen)])
    reading = np.concatenate([owns[n] for n in chosen])
    time_s = times_s[reading] - begin_s[piece_of]
    starts = [states[piece.first] for piece in some]
    return Pieces(
        begin_s,
        received_s,
        target_deg,
        duration_s,
        np.array([state.position_deg for state in starts]),
        np.array([state.speed_deg_s for state in starts]),
        np.array([RESTED if state.is_rest else believed.start_error for state in starts]),
        float(time_s.max()),
        piece_of,
        time_s,
        readings_deg[reading],
    )


def _spread(numbers: Sequence[int], most: int) -> list[int]:
    """Return at most `most` of the numbers, evenly spread."""
    if len(numbers) <= most:
        return [*numbers]
    return [numbers[round(at)] for at in np.linspace(0, len(numbers) - 1, most).tolist()]


class _State(NamedTuple):
    """The profile when it receives a move, and whether it rested."""

    position_deg: float
    speed_deg_s: float
    is_rest: bool


def _states(recording: ShowRecording, believed: Believed) -> Iterator[_State]:
    """Yield the state of the profile at the receipt of each move; the horn where it is unknown."""
    profile, ends_s = None, -math.inf
    times_s, breaks_s = np.array(recording.times_s), np.array([*recording.breaks_s, math.inf])
    last_s = -math.inf
    for received_s, target_deg, duration_s in recording.moves:
        is_broken = np.searchsorted(breaks_s, last_s) != np.searchsorted(breaks_s, received_s)
        if profile is None or is_broken:
            at = max(int(np.searchsorted(times_s, received_s)) - 1, 0)
            standing_deg = recording.readings_deg[at] if len(times_s) else target_deg
            profile, ends_s = _profile(recording.joint, believed, standing_deg), -math.inf
        is_rest = not is_broken and received_s > ends_s + REST_S
        yield _State(*profile.at(received_s), is_rest)
        profile.retarget(received_s, target_deg, duration_s)
        profile.forget_before(received_s)
        *_, last = profile.pieces()
        last_s, ends_s = received_s, last.start_s


def _profile(joint: Joint, believed: Believed, position_deg: float) -> Profile:
    retarget, t_law = believed.hypothesis
    return Profile(
        position_deg,
        ramp_deg_s2=believed.ramp_deg_s2,
        speed_max_deg_s=joint.speed_max_deg_s,
        response=replace(joint.response, retarget=retarget, t_law=t_law),
    )


def _cut(recording: ShowRecording, states: Sequence[_State]) -> Iterator[_Piece]:
    """Yield the pieces of a show, of `PIECE_S` or up to a break."""
    moves, breaks_s = recording.moves, np.array([*recording.breaks_s, math.inf])
    after = np.searchsorted(breaks_s, [move.received_s for move in moves])
    begin = 0
    for index in range(1, len(moves) + 1):
        is_end = index == len(moves)
        is_broken = not is_end and after[index] != after[begin]
        passed_s = 0.0 if is_end else moves[index].received_s - moves[begin].received_s
        if not (is_end or is_broken or passed_s >= PIECE_S):
            continue
        next_s = math.inf if is_end else moves[index].received_s
        until_s = min(next_s, moves[index - 1].received_s + TAIL_S, breaks_s[after[begin]])
        first = begin
        while first > max(begin - 2 * WARM_MOVES, 0) and after[first - 1] == after[begin]:
            if states[first].is_rest or begin - first >= WARM_MOVES:
                break
            first -= 1
        yield _Piece(first, index, moves[begin].received_s, float(until_s))
        begin = index
