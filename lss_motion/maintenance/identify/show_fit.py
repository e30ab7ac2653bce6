"""Fits the response model of a servo to the moves and readings of an ordinary show.

`identify_from_show` is what `estimate.identify` is for an experiment. A show is read ten times a
second and does not stop between moves, so pieces of it are fitted, each from a few moves before it
on. All pieces, and all small changes of the parameters, are computed at once: a row a change, a
column a piece.

Fitted are the ramps (one for both), the lag, the dead time, the load as a constant and the sine and
cosine of the angle, the play, and the top speed. The instant within a control loop at which a servo
takes a command up is unknown, so a reading counts less where the horn is fast.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from lss_motion.errors import PlaybackError
from lss_motion.maintenance.identify.estimate import (
    DECIDED_RATIO,
    PLAY_LEAST_DEG,
    SATURATED_RATIO,
    Decided,
    Identified,
)
from lss_motion.maintenance.identify.response_fit import HYPOTHESES, Hypothesis, Measured
from lss_motion.program.response import States, Trapezoids, exact_speeds, trapezoids
from lss_motion.robot.profile import Profile, ramp_deg_s2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.show_log import ShowRecording
    from lss_motion.program.response import FloatArray
    from lss_motion.robot.model import Joint

STEP_S: Final = 0.01
"""Step of the horn. At 1000 deg/s² a profile bends by 0.01 deg within it."""
PIECE_S: Final = 1.5
"""A piece is scored over this time: a few moves."""
PIECES_MAX: Final = 40
"""Chosen: a minute of motion, a second of computing for a joint."""
TAIL_S: Final = 2.0
"""After the last move of a piece no later readings are used."""
WARM_MOVES: Final = 4
"""Moves before a piece, since the profile at its begin is only known from the robot file."""
REST_S: Final = 0.3
"""After a longer rest the profile is known."""
MOTION_DEG: Final = 3.0
"""Pieces in which the readings differ by less show no motion."""
RESTS_RATIO: Final = 0.2
"""Share of the pieces that may be without motion: they show the load."""
NEVER_S: Final = 1e9
"""Instant of a move that does not exist."""
TINY_DEG_S: Final = 1e-6
"""A move to where the servo stands has this speed."""

RAMP, LAG, DEAD, LOAD, PLAY, TOP = 0, 1, 2, 3, 6, 7
SIZE: Final = 8
"""Parameters: logarithms of ramp and lag, dead time, three of the load, play, logarithm of the top
speed."""
STEPS: Final = np.array([1e-3, 1e-3, 1e-5, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3])
"""Steps of the parameters for numeric derivatives."""
STEP_MAX: Final = np.array([0.7, 0.7, 0.05, 2.0, 2.0, 2.0, 0.5, 0.5])
"""Largest change of the parameters in one step of the fit."""
USUAL_LAG_S: Final = 0.02
SPREAD: Final = np.array([1.5, 1.0, 0.05, 5.0, 5.0, 5.0, 1.0, 0.7])
"""What is expected of the parameters, as standard deviations; `PRIOR_DEG` is their weight."""
PRIOR_DEG: Final = 0.5
TIMING_S: Final = 0.002
NOISE_DEG: Final = 0.15
"""Scatter of the instants at which commands are taken up (FACTS.md M7: every 5 ms), and of readings
with the play of small loads (FACTS.md E7: a tenth)."""
OUTLIER: Final = 3.0
"""Larger residuals, in units of the scatter, count less: lost moves, damaged answers."""
STARTS: Final = [(ramp, lag_s, dead_s, top) for ramp in (1.0, 0.45, 0.15) for top in (1.0, 0.4)
                 for lag_s, dead_s in ((0.02, 0.003), (0.05, 0.003), (0.02, 0.04))]  # fmt: skip
"""The search begins at the best of these: ramps and top speed as shares of the usual ones."""
ITERATIONS_MAX: Final = 20
COST_RATIO: Final = 1e-4
MISFIT_MAX_DEG: Final = 2.0
"""Above this no hypothesis explains the readings. Several times what the control loop leaves open
at 200 deg/s."""
MOVING_DEG_S: Final = 20.0
STILL_DEG_S: Final = 1.0
MOVING_LEAST: Final = 30
"""A joint has moved enough to be measured with so many readings at such a speed."""
DELAY_ERROR_MAX_S: Final = 0.008
RAMP_ERROR_MAX_RATIO: Final = 0.2
"""Values with larger standard errors are not written."""


class TooLittleMotionError(PlaybackError):
    """A joint did not move enough in a show to be measured."""


class _Piece(NamedTuple):
    """Moves `first` to `last` (not included), scored between two instants."""

    first: int
    last: int
    from_s: float
    until_s: float


@dataclass(frozen=True, slots=True)
class _Pieces:
    """Pieces as arrays, (pieces, moves); times count from the begin of each piece."""

    received_s: FloatArray
    target_deg: FloatArray
    duration_s: FloatArray
    start_deg: FloatArray
    start_deg_s: FloatArray
    steps: int
    piece: NDArray[np.intp]
    """Of each reading."""
    time_s: FloatArray
    reading_deg: FloatArray


class Fitted(NamedTuple):
    """Parameters, what they leave, and the parameters without each piece (jackknife)."""

    vector: FloatArray
    misfit: float
    """Root mean square of the weighted residuals, outliers less."""
    rms_deg: float
    without: FloatArray


def identify_from_show(recording: ShowRecording) -> Identified:
    """Return the parameters of a servo, with errors; the period of its control loop is unknown.

    Raises `TooLittleMotionError`, or `PlaybackError` if no hypothesis explains the readings.
    """
    joint = recording.joint
    if not recording.moves:
        raise _too_little(joint, "it was sent no move with a T")
    pieces = _pieces(recording)
    problems = {one: ShowProblem(recording, pieces, one) for one in HYPOTHESES}
    fits = {one: problem.fit() for one, problem in problems.items()}
    chosen = min(fits, key=lambda one: fits[one].misfit)
    best = fits[chosen]
    if best.rms_deg > MISFIT_MAX_DEG:
        raise PlaybackError(
            f"joint {joint.name!r}: no model explains its readings, the best misses by "
            f"{best.rms_deg:.1f} deg. Was it held or pushed in this show?",
            joint=joint.name,
        )
    return _identified(recording, pieces, chosen, fits, problems[chosen])


# ---- pieces of a show


def _pieces(recording: ShowRecording) -> _Pieces:
    states = list(_states(recording))
    found = list(_cut(recording, states))
    times_s, readings_deg = np.array(recording.times_s), np.array(recording.readings_deg)
    owns = [np.flatnonzero((times_s >= p.from_s) & (times_s < p.until_s)) for p in found]
    ranges_deg = [float(np.ptp(readings_deg[own])) if len(own) > 2 else -1.0 for own in owns]
    moving = [n for n, range_deg in enumerate(ranges_deg) if range_deg >= MOTION_DEG]
    still = [n for n, range_deg in enumerate(ranges_deg) if 0.0 <= range_deg < MOTION_DEG]
    chosen = [*_spread(moving, PIECES_MAX), *_spread(still, int(RESTS_RATIO * PIECES_MAX))]
    if len(moving) < 3:
        raise _too_little(recording.joint, "in fewer than 3 pieces of the show")
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
    return _Pieces(
        received_s,
        target_deg,
        duration_s,
        np.array([states[piece.first][0] for piece in some]),
        np.array([states[piece.first][1] for piece in some]),
        math.ceil(float(time_s.max()) / STEP_S) + 2,
        piece_of,
        time_s,
        readings_deg[reading],
    )


def _too_little(joint: Joint, why: str) -> TooLittleMotionError:
    return TooLittleMotionError(
        f"joint {joint.name!r} did not move enough to be measured: {why}. A longer show, or "
        f"lss-motion identify {joint.name} without --from",
        joint=joint.name,
    )


def _spread(numbers: Sequence[int], most: int) -> list[int]:
    """Return at most `most` of the numbers, evenly spread."""
    if len(numbers) <= most:
        return [*numbers]
    return [numbers[round(at)] for at in np.linspace(0, len(numbers) - 1, most).tolist()]


def _states(recording: ShowRecording) -> Iterator[tuple[float, float, bool]]:
    """Yield for each move position and speed of the profile at its receipt, and if it rested.

    The profile is that of the robot file; the horn where it is unknown.
    """
    joint, profile, ends_s = recording.joint, None, -math.inf
    times_s, breaks_s = np.array(recording.times_s), np.array([*recording.breaks_s, math.inf])
    last_s = -math.inf
    for received_s, target_deg, duration_s in recording.moves:
        is_broken = np.searchsorted(breaks_s, last_s) != np.searchsorted(breaks_s, received_s)
        if profile is None or is_broken:
            at = max(int(np.searchsorted(times_s, received_s)) - 1, 0)
            standing_deg = recording.readings_deg[at] if len(times_s) else target_deg
            profile, ends_s = _profile(joint, standing_deg), -math.inf
        position_deg, speed_deg_s = profile.at(received_s)
        yield position_deg, speed_deg_s, not is_broken and received_s > ends_s + REST_S
        profile.retarget(received_s, target_deg, duration_s)
        profile.forget_before(received_s)
        *_, last = profile.pieces()
        last_s, ends_s = received_s, last.start_s


def _profile(joint: Joint, position_deg: float) -> Profile:
    return Profile(
        position_deg,
        ramp_deg_s2=ramp_deg_s2(joint),
        speed_max_deg_s=joint.speed_max_deg_s,
        response=joint.response,
    )


def _cut(recording: ShowRecording, states: Sequence[tuple[float, float, bool]]) -> Iterator[_Piece]:
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
            if states[first][2] or begin - first >= WARM_MOVES:
                break
            first -= 1
        yield _Piece(first, index, moves[begin].received_s, float(until_s))
        begin = index


# ---- the model


class ShowProblem:
    """The pieces of one joint, to be fitted under one hypothesis."""

    def __init__(self, recording: ShowRecording, pieces: _Pieces, hypothesis: Hypothesis) -> None:
        joint = recording.joint
        self._pieces, self._hypothesis = pieces, hypothesis
        self._speed_max_deg_s = joint.speed_max_deg_s
        stiffness_ratio = joint.ramp_ratio / joint.response.ramp_ratio
        self._usual = np.zeros(SIZE)
        self._usual[RAMP] = math.log(recording.ramp_deg_s2 * stiffness_ratio)
        self._usual[LAG] = math.log(USUAL_LAG_S)
        self._usual[TOP] = math.log(joint.model.speed_max_deg_s)
        self._prior = (PRIOR_DEG / NOISE_DEG / SPREAD) ** 2
        self._weight = np.ones(len(pieces.time_s))

    def fit(self) -> Fitted:
        """Return the best parameters. Levenberg-Marquardt from the best of `STARTS`."""
        vector = self._start()
        damping = 1e-2
        for _ in range(ITERATIONS_MAX):
            residual, jacobian = self._linear(vector)
            cost = self._cost(vector, residual)
            better, damping = self._improved(vector, residual, jacobian, cost, damping)
            if better is None:
                break
            vector, new_cost = better
            if cost - new_cost < COST_RATIO * cost:
                break
        residual, jacobian = self._linear(vector)
        share = _shares(residual)
        return Fitted(
            vector,
            math.sqrt(float(_soft(residual).mean())),
            math.sqrt(float(np.sum(share * (residual / self._weight) ** 2) / np.sum(share))),
            self._without(vector, residual, jacobian),
        )

    def speeds_deg_s(self, vector: FloatArray) -> FloatArray:
        """Return the speed of the profile at each reading."""
        profile_deg = self._profiles_deg(vector[None])[0]
        speed_deg_s = np.asarray(np.gradient(profile_deg, STEP_S, axis=1), dtype=np.float64)
        found: FloatArray = np.abs(self._at_readings(speed_deg_s[None])[0])
        return found

    def scatter_deg(self, vector: FloatArray) -> float:
        """Return the root mean square of what is left of the readings at rest, or of all."""
        left_deg = self._readings_deg(vector[None])[0] - self._pieces.reading_deg
        is_still = self.speeds_deg_s(vector) < STILL_DEG_S
        chosen = left_deg[is_still] if is_still.any() else left_deg
        return float(np.sqrt(np.mean(np.minimum(chosen * chosen, OUTLIER**2))))

    def _start(self) -> FloatArray:
        starts = np.tile(self._usual, (len(STARTS), 1))
        for row, (ramp, lag_s, dead_s, top) in zip(starts, STARTS, strict=True):
            row[RAMP] += math.log(ramp)
            row[LAG], row[DEAD] = math.log(lag_s), dead_s
            row[TOP] += math.log(top)
        readings_deg = self._readings_deg(starts)
        off_deg = np.median(readings_deg - self._pieces.reading_deg, axis=1)
        starts[:, LOAD] = off_deg
        residuals = readings_deg - off_deg[:, None] - self._pieces.reading_deg
        at = int(np.argmin(_soft(residuals / NOISE_DEG / 4.0).sum(axis=1)))
        speed_deg_s = self.speeds_deg_s(starts[at])
        self._weight = 1.0 / np.hypot(NOISE_DEG, TIMING_S * speed_deg_s)
        found: FloatArray = starts[at]
        return found

    def _readings_deg(self, vectors: FloatArray) -> FloatArray:
        """Return what the servo would read, (vectors, readings)."""
        horn_deg = self._horns_deg(vectors, self._profiles_deg(vectors))
        horn_deg = self._at_readings(horn_deg)
        angle = np.radians(horn_deg)
        load = vectors[:, LOAD : LOAD + 3, None]
        found: FloatArray = horn_deg - (
            load[:, 0] + load[:, 1] * np.sin(angle) + load[:, 2] * np.cos(angle)
        )
        return found

    def _at_readings(self, values: FloatArray) -> FloatArray:
        """Return values on the grid, (vectors, pieces, steps), at the readings."""
        place = self._pieces.time_s / STEP_S
        low = np.clip(place.astype(np.intp), 0, self._pieces.steps - 2)
        part, row = place - low, self._pieces.piece
        found: FloatArray = (1.0 - part) * values[:, row, low] + part * values[:, row, low + 1]
        return found

    def _profiles_deg(self, vectors: FloatArray) -> FloatArray:
        """Return the profiles on the grid, (vectors, pieces, steps)."""
        moves = self._moves(vectors)
        begins_s = np.stack([move.start.time_s for move in moves], axis=-1)
        grid_s = STEP_S * np.arange(self._pieces.steps, dtype=np.float64)
        begun = (grid_s[:, None] >= begins_s[:, :, None, :]).sum(axis=-1)
        index = np.maximum(begun - 1, 0)

        def under_way(values: list[FloatArray]) -> FloatArray:
            return np.take_along_axis(np.stack(values, axis=-1), index, axis=-1)

        start = States(
            under_way([move.start.time_s for move in moves]),
            under_way([move.start.position_deg for move in moves]),
            under_way([move.start.speed_deg_s for move in moves]),
        )
        every = Trapezoids(
            start,
            under_way([move.sign for move in moves]),
            under_way([move.ramp_deg_s2 for move in moves]),
            under_way([move.first_deg_s for move in moves]),
            under_way([move.peak_deg_s for move in moves]),
            under_way([move.first_s for move in moves]),
            under_way([move.cruise_s for move in moves]),
        )
        return every.positions_deg(np.maximum(grid_s, start.time_s))

    def _moves(self, vectors: FloatArray) -> list[Trapezoids]:
        """Return each move with the state in which the servo takes it up, (vectors, pieces)."""
        pieces, shape = self._pieces, (len(vectors), len(self._pieces.start_deg))
        ramp = np.broadcast_to(np.exp(vectors[:, RAMP, None]), shape)
        taken_s = pieces.received_s + vectors[:, DEAD, None, None]
        position_deg, speed_deg_s = pieces.start_deg, pieces.start_deg_s
        moves: list[Trapezoids] = []
        for index in range(pieces.received_s.shape[1]):
            begin_s = taken_s[:, :, index]
            if moves:
                state = moves[-1].at(np.maximum(begin_s, moves[-1].start.time_s))
                position_deg, speed_deg_s = state.position_deg, state.speed_deg_s
            if self._hypothesis.retarget == "from_rest":
                speed_deg_s = np.zeros(shape)
            start = States(
                begin_s, np.broadcast_to(position_deg, shape), np.broadcast_to(speed_deg_s, shape)
            )
            target_deg = np.broadcast_to(pieces.target_deg[:, index], shape)
            travel_deg_s = self._travel_deg_s(start, target_deg, pieces.duration_s[:, index], ramp)
            moves.append(trapezoids(start, target_deg, travel_deg_s, ramp))
        return moves

    def _travel_deg_s(
        self, start: States, target_deg: FloatArray, duration_s: FloatArray, ramp: FloatArray
    ) -> FloatArray:
        """Return the travel speeds that the servo makes of each T."""
        if self._hypothesis.t_law == "exact":
            asked_deg_s = exact_speeds(start, target_deg, duration_s, ramp)
        else:
            asked_deg_s = np.abs(target_deg - start.position_deg) / duration_s
        asked_deg_s = np.maximum(asked_deg_s, TINY_DEG_S)
        found: FloatArray = np.minimum(asked_deg_s, self._speed_max_deg_s)
        return found

    def _horns_deg(self, vectors: FloatArray, profile_deg: FloatArray) -> FloatArray:
        """Return the shafts of horns that follow profiles: with lag, top speed and play."""
        lag_s = np.exp(vectors[:, LAG, None])
        fading = np.exp(-STEP_S / lag_s)
        reach_deg = STEP_S * np.exp(vectors[:, TOP, None])
        half_deg = 0.5 * np.maximum(vectors[:, PLAY, None], 0.0)
        behind_deg = lag_s[..., None] / STEP_S * np.diff(profile_deg, axis=-1)
        found = np.empty_like(profile_deg)
        horn_deg = shaft_deg = profile_deg[..., 0] - behind_deg[..., 0]
        found[..., 0] = horn_deg
        for step in range(1, profile_deg.shape[-1]):
            late_deg = behind_deg[..., step - 1]
            gap_deg = horn_deg - profile_deg[..., step - 1] + late_deg
            moved_deg = profile_deg[..., step] - late_deg + gap_deg * fading - horn_deg
            horn_deg = horn_deg + np.minimum(np.maximum(moved_deg, -reach_deg), reach_deg)
            shaft_deg = np.maximum(np.minimum(shaft_deg, horn_deg + half_deg), horn_deg - half_deg)
            found[..., step] = shaft_deg
        return found

    # ---- one step of the fit

    def _residual(self, vectors: FloatArray) -> FloatArray:
        found: FloatArray = self._readings_deg(vectors) - self._pieces.reading_deg
        return found * self._weight

    def _linear(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the residuals in units of their scatter, and their derivatives."""
        residuals = self._residual(np.vstack([vector, vector + np.diag(STEPS)]))
        return residuals[0], (residuals[1:] - residuals[0]).T / STEPS

    def _cost(self, vector: FloatArray, residual: FloatArray) -> float:
        prior = float(np.sum(self._prior * (vector - self._usual) ** 2))
        return float(_soft(residual).sum()) + prior

    def _improved(
        self,
        vector: FloatArray,
        residual: FloatArray,
        jacobian: FloatArray,
        cost: float,
        damping: float,
    ) -> tuple[tuple[FloatArray, float] | None, float]:
        """Return parameters with a lower cost and that cost, if there are any, and the damping."""
        share = _shares(residual)
        normal = (jacobian.T * share) @ jacobian + np.diag(self._prior)
        gradient = (jacobian.T * share) @ residual + self._prior * (vector - self._usual)
        dampings = damping * 6.0 ** np.arange(-1, 5)
        scale = np.diag(normal) + 1e-9
        steps = [-np.linalg.solve(normal + one * np.diag(scale), gradient) for one in dampings]
        tried = vector + np.clip(steps, -STEP_MAX, STEP_MAX)
        tried[:, PLAY] = np.maximum(tried[:, PLAY], 0.0)
        residuals = self._residual(tried)
        costs = [self._cost(one, own) for one, own in zip(tried, residuals, strict=True)]
        at = int(np.argmin(costs))
        if costs[at] >= cost:
            return None, damping
        return (tried[at], costs[at]), max(float(dampings[at]), 1e-9)

    def _without(
        self, vector: FloatArray, residual: FloatArray, jacobian: FloatArray
    ) -> FloatArray:
        """Return the parameters without each piece in turn, by a linear step."""
        share = _shares(residual)
        count = len(self._pieces.start_deg)
        masks = [self._pieces.piece == one for one in range(count)]
        parts = [(jacobian[m].T * share[m]) @ jacobian[m] for m in masks]
        pulls = [(jacobian[m].T * share[m]) @ residual[m] for m in masks]
        prior, away = np.diag(self._prior), self._prior * (vector - self._usual)
        total, pull = sum(parts) + prior, sum(pulls) + away
        moved = [
            -np.linalg.solve(total - part, pull - own)
            for part, own in zip(parts, pulls, strict=True)
        ]
        found: FloatArray = vector + np.array(moved)
        return found


def _soft(residual: FloatArray) -> FloatArray:
    """Return soft-l1 squares: those of small residuals, less of large ones."""
    found: FloatArray = 2.0 * OUTLIER**2 * (np.sqrt(1.0 + (residual / OUTLIER) ** 2) - 1.0)
    return found


def _shares(residual: FloatArray) -> FloatArray:
    """Return the weights of residuals in the normal equations that `_soft` requires."""
    found: FloatArray = 1.0 / np.sqrt(1.0 + (residual / OUTLIER) ** 2)
    return found


# ---- the result


def _identified(
    recording: ShowRecording,
    pieces: _Pieces,
    chosen: Hypothesis,
    fits: dict[Hypothesis, Fitted],
    problem: ShowProblem,
) -> Identified:
    joint, best = recording.joint, fits[chosen]
    speeds_deg_s = problem.speeds_deg_s(best.vector)
    moving = int((speeds_deg_s > MOVING_DEG_S).sum())
    if moving < MOVING_LEAST:
        raise _too_little(joint, f"{moving} readings in motion, {MOVING_LEAST} are needed")
    delay = _measured(best, lambda vectors: vectors[:, DEAD] + np.exp(vectors[:, LAG]))
    ramp = _measured(best, lambda vectors: np.exp(vectors[:, RAMP]))
    top = _measured(best, lambda vectors: np.exp(vectors[:, TOP]))
    asked_deg_s = float(speeds_deg_s.max())
    is_top = top.value + 2.0 * top.error < SATURATED_RATIO * asked_deg_s
    low_deg, high_deg = float(pieces.reading_deg.min()), float(pieces.reading_deg.max())
    at = np.radians(sorted((low_deg, 0.5 * (low_deg + high_deg), high_deg),
                           key=joint.joint_deg))  # fmt: skip
    low, middle, high = (_load(best, angle) for angle in at.tolist())
    play = _measured(best, lambda vectors: vectors[:, PLAY])
    return Identified(
        joint=joint.name,
        low_deg=min(joint.joint_deg(low_deg), joint.joint_deg(high_deg)),
        high_deg=max(joint.joint_deg(low_deg), joint.joint_deg(high_deg)),
        ramp_deg_s2=recording.ramp_deg_s2,
        speed_max_deg_s=joint.speed_max_deg_s,
        delay_s=delay,
        lag_s=_measured(best, lambda vectors: np.exp(vectors[:, LAG])),
        dead_s=_measured(best, lambda vectors: vectors[:, DEAD]),
        loop_s=None,
        retarget=Decided(chosen.retarget, _is_sure(fits, chosen, 0)),
        t_law=Decided(chosen.t_law, _is_sure(fits, chosen, 1)),
        accel_deg_s2=ramp,
        decel_deg_s2=ramp,
        top_deg_s=top if is_top else Measured(asked_deg_s, 0.0),
        is_top=is_top,
        droop_deg=(
            joint.direction * low.value,
            joint.direction * middle.value,
            joint.direction * high.value,
        ),
        droop_error_deg=max(low.error, middle.error, high.error),
        play_deg=play if play.value > PLAY_LEAST_DEG else Measured(0.0, play.error),
        noise_deg=problem.scatter_deg(best.vector),
        misfit_deg=best.rms_deg,
        turnaround_s=tuple(np.percentile(recording.turnarounds_s, (1.0, 50.0, 99.0)).tolist()),
        readings=len(pieces.time_s),
        unsure=_unsure(delay, ramp, _possible(fits, chosen)),
    )


def _load(best: Fitted, angle: float) -> Measured:
    """Return how far the load pulls the horn at an angle (radians)."""
    basis = np.array([1.0, math.sin(angle), math.cos(angle)])
    return _measured(best, lambda vectors: vectors[:, LOAD : LOAD + 3] @ basis)


def _unsure(delay: Measured, ramp: Measured, possible: Sequence[Fitted]) -> frozenset[str]:
    """Return the fields of `response` that the show does not tell well enough.

    The ramp belongs to a law: where several are possible, theirs must agree.
    """
    found = set()
    if delay.error > DELAY_ERROR_MAX_S:
        found.add("lag_s")
    spread = math.expm1(float(np.ptp([fit.vector[RAMP] for fit in possible])))
    if max(ramp.error / ramp.value, spread) > RAMP_ERROR_MAX_RATIO:
        found.add("ramp_ratio")
    return frozenset(found)


def _possible(fits: dict[Hypothesis, Fitted], chosen: Hypothesis) -> list[Fitted]:
    """Return the fits of all laws that the readings do not rule out."""
    return [fit for fit in fits.values() if fit.misfit <= DECIDED_RATIO * fits[chosen].misfit]


def _measured(best: Fitted, value: Callable[[FloatArray], FloatArray]) -> Measured:
    """Return a function of the parameters, with its standard error by the jackknife."""
    without = value(best.without)
    spread = float(np.sum((without - without.mean()) ** 2))
    count = len(without)
    return Measured(float(value(best.vector[None])[0]), math.sqrt((count - 1) / count * spread))


def _is_sure(fits: dict[Hypothesis, Fitted], chosen: Hypothesis, place: int) -> bool:
    others = [fit.misfit for one, fit in fits.items() if one[place] != chosen[place]]
    return min(others) > DECIDED_RATIO * fits[chosen].misfit
