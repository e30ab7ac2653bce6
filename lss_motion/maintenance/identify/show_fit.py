"""Fits the response model of a servo to the moves and readings of an ordinary show.

`identify_from_show` is what `estimate.identify` is for an experiment. A show is read ten times a
second and does not stop between moves, so pieces of it (`show_pieces`) are fitted. All pieces, and
all small changes of the parameters, are computed at once: a row a change, a column a piece.

Shared by all pieces are the ramps (one for both), the lag, the dead time, the load as a constant
and the sine and cosine of the angle, the play, and the top speed. Of each piece alone are how long
each move waits for the control loop of its servo, which no log tells, and where the profile is at
its begin. All readings after a move share the error of its wait: without these parameters many
readings of one move would count as so many measurements.

First the shared parameters are fitted under every hypothesis, coarsely; then all parameters under
those that are left. Errors are the larger of two: by the curvature of the fit, and by leaving out
each piece in turn (jackknife). To both comes what the phase of the control loop adds: moves at
multiples of its period all wait for the same time.
"""

from __future__ import annotations

import math
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
from lss_motion.maintenance.identify.show_pieces import (
    DEAD,
    LAG,
    LOAD,
    PLAY,
    RAMP,
    SIZE,
    TOP,
    Believed,
    ShowModel,
    Vectors,
    cut,
    too_little,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.maintenance.identify.show_pieces import Pieces, ShowRecording
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.robot.model import Joint

STEP_S: Final = 0.01
"""Step of the horn. At 1000 deg/s² a profile bends by 0.01 deg within it."""
COARSE_STEP_S: Final = 0.02
COARSE_PIECES: Final = 24
"""Of the search for the hypothesis."""

STEPS: Final = np.array([1e-3, 1e-3, 1e-5, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3])
WAIT_STEP_S: Final = 1e-5
START_STEPS: Final = (1e-3, 1e-2)
"""Steps of the parameters for numeric derivatives."""
STEP_MAX: Final = np.array([0.7, 0.7, 0.05, 2.0, 2.0, 2.0, 0.5, 0.5])
"""Largest change of the parameters in one step of the fit."""
USUAL_LAG_S: Final = 0.02
SPREAD: Final = np.array([1.5, 1.0, 0.05, 5.0, 5.0, 5.0, 1.0, 0.7])
"""What is expected of the parameters, as standard deviations; `PRIOR_DEG` is their weight."""
PRIOR_DEG: Final = 0.5
START_ERROR: Final = (1.0, 20.0)
"""A begin in mid-move by a model that was fitted coarsely, deg and deg/s. Chosen."""
TIMING_S: Final = 0.002
NOISE_DEG: Final = 0.15
"""Scatter of the instants at which commands are taken up (FACTS.md M7: every 5 ms), and of readings
with the play of small loads (FACTS.md E7: a tenth), of a coarse fit."""
READ_S: Final = 0.0003
NOISE_LEAST_DEG: Final = 0.03
"""Scatter of the instants of readings, and what steps of the horn leave of an exact reading."""
OUTLIER: Final = 3.0
"""Larger residuals, in units of the scatter, count less: lost moves, damaged answers."""
STARTS: Final = [(ramp, lag_s, dead_s, top) for ramp in (1.0, 0.45, 0.15) for top in (1.0, 0.4)
                 for lag_s, dead_s in ((0.02, 0.003), (0.05, 0.003), (0.02, 0.04))]  # fmt: skip
"""The search begins at the best of these: ramps and top speed as shares of the usual ones."""
ITERATIONS_MAX: Final = 20
COST_RATIO: Final = 1e-4
ROUNDS_MAX: Final = 3
SAME_RAMP_RATIO: Final = 0.01
"""Pieces are cut once more where the ramp that was found differs by more."""
KEPT_MORE: Final = 1.0
"""Hypotheses whose coarse fit misses by so much more than the best one, in units of the coarse
scatter or of what that one misses by, are out. With half of it the true one was lost where pieces
begin in long moves."""
LOOSE_DEG: Final = 0.5
"""Scatter of the readings in the search for the minimum. Chosen: with 0.14 deg a search from the
coarse parameters ended beside it in half of the shows of a servo with slow ramps and a load."""
PHASES: Final = 16
"""Phases of the control loop that are tried for their share of the errors."""
DECIDED_SIGMAS: Final = 2.0
"""A law is excluded where it is worse by so many standard errors of the sum over all pieces."""
PIECE_COST_MAX: Final = OUTLIER**2
"""No piece counts for more in that sum than one reading at the border of an outlier."""
EXPLAINED_MISFIT: Final = 1.6
"""A fit that misses by more, in units of the scatter at rest, has not found what the servo does:
then no law and no value is certain. Chosen: right models miss by 0.8 to 1.2."""
MISFIT_MAX_DEG: Final = 2.0
"""Above this no hypothesis explains the readings. Several times what the control loop leaves open
at 200 deg/s."""
LOAD_MAX_DEG: Final = 10.0
"""No servo is held by a position loop as soft as that. Chosen."""
MOVING_DEG_S: Final = 20.0
STILL_DEG_S: Final = 1.0
MOVING_LEAST: Final = 30
"""A joint has moved enough to be measured with so many readings at such a speed."""
DELAY_ERROR_MAX_S: Final = 0.008
RAMP_ERROR_MAX_RATIO: Final = 0.2
"""Values with larger standard errors are not written."""


class Fitted(NamedTuple):
    """Parameters, what they leave, and what is needed for their errors."""

    vectors: Vectors
    misfit: float
    """Root mean square of the weighted residuals, outliers less, with the priors of pieces."""
    rms_deg: float
    covariance: FloatArray
    """Of the shared parameters."""
    without: FloatArray
    """The shared parameters without each piece in turn."""
    by_phase: FloatArray
    """How far the shared parameters are off, by the phase of the control loop."""
    costs: FloatArray
    """Of each piece."""

    def excludes(self, other: Fitted) -> bool:
        """Return whether the readings separate this fit from a worse one of the same pieces.

        It must be better by more than the scatter, and so in many pieces: what a single piece says,
        the begin of that piece may have made.
        """
        if other.misfit <= DECIDED_RATIO * self.misfit:
            return False
        better = np.clip(other.costs - self.costs, -PIECE_COST_MAX, PIECE_COST_MAX)
        return float(better.sum()) > DECIDED_SIGMAS * float(np.linalg.norm(better))

    def measured(self, value: Callable[[FloatArray], FloatArray]) -> Measured:
        """Return a function of the shared parameters, with its standard error."""
        best = self.vectors.shared
        at = float(value(best)[0])
        slopes = (value(best + np.diag(STEPS)) - at) / STEPS
        curved = float(slopes @ self.covariance @ slopes)
        without = value(self.without)
        count = len(without)
        left_out = (count - 1) / count * float(np.sum((without - without.mean()) ** 2))
        waited = float(np.mean((value(best + self.by_phase) - at) ** 2))
        return Measured(at, math.sqrt(max(curved, left_out) + waited))


def identify_from_show(recording: ShowRecording) -> Identified:
    """Return the parameters of a servo, with errors; the period of its control loop is unknown.

    Raises `TooLittleMotionError`, or `PlaybackError` if no hypothesis explains the readings.
    """
    joint = recording.joint
    if not recording.moves:
        raise too_little(joint, "it was sent no move with a T")
    _require_motion(recording)
    coarse = {one: _coarse(recording, one) for one in HYPOTHESES}
    least = min(fit.misfit for fit in coarse.values())
    kept = [one for one, fit in coarse.items() if fit.misfit <= least + KEPT_MORE * max(1.0, least)]
    loose = {one: _loose(recording, one, coarse[one].vectors.shared) for one in kept}
    best, shared = min(loose.values(), key=lambda found: found[1].misfit)
    noise_deg = best.scatter_deg(shared.vectors)
    fits, problems = {}, {}
    for one, (_, fit) in loose.items():
        problems[one], fits[one] = _fine(recording, one, noise_deg, fit.vectors.shared)
    chosen = min(fits, key=lambda one: fits[one].misfit)
    misfit_deg = fits[chosen].rms_deg
    if misfit_deg > MISFIT_MAX_DEG:
        raise _unexplained(joint, f"misses by {misfit_deg:.1f} deg")
    found = _identified(recording, chosen, fits, problems[chosen])
    if (load_deg := max(map(abs, found.droop_deg))) > LOAD_MAX_DEG:
        raise _unexplained(joint, f"would need a load that pulls it by {load_deg:.0f} deg")
    return found


def _unexplained(joint: Joint, why: str) -> PlaybackError:
    return PlaybackError(
        f"joint {joint.name!r}: no model explains its readings, the best {why}. Was it held or "
        f"pushed in this show?",
        joint=joint.name,
    )


def _require_motion(recording: ShowRecording) -> None:
    """Raise if no reading is in motion by the robot file: a fit takes its time."""
    joint = recording.joint
    assumed = Hypothesis(joint.response.retarget, joint.response.t_law)
    ramp_deg_s2 = recording.ramp_deg_s2 * joint.ramp_ratio
    pieces = cut(recording, Believed(ramp_deg_s2, assumed, START_ERROR))
    if not ShowProblem(recording, pieces, assumed).moving():
        raise too_little(joint, _readings_text(0))


def _readings_text(moving: int) -> str:
    return f"{moving} readings in motion, {MOVING_LEAST} are needed"


def _coarse(recording: ShowRecording, hypothesis: Hypothesis) -> Fitted:
    """Return the shared parameters alone."""
    joint = recording.joint
    ramp_deg_s2 = recording.ramp_deg_s2 * joint.ramp_ratio
    pieces = cut(recording, Believed(ramp_deg_s2, hypothesis, START_ERROR), COARSE_PIECES)
    return ShowProblem(recording, pieces, hypothesis).fit()


def _loose(
    recording: ShowRecording, hypothesis: Hypothesis, shared: FloatArray
) -> tuple[ShowProblem, Fitted]:
    """Return the better fit of all parameters from the coarse ones and from the usual ones.

    With a large scatter of the readings the cost has fewer minima beside the one that is searched.
    """
    problem, found = _fine(recording, hypothesis, LOOSE_DEG, shared)
    other, usual = _fine(recording, hypothesis, LOOSE_DEG, problem.usual[None])
    return (other, usual) if usual.misfit < found.misfit else (problem, found)


def _fine(
    recording: ShowRecording, hypothesis: Hypothesis, noise_deg: float, shared: FloatArray
) -> tuple[ShowProblem, Fitted]:
    """Return the fit of all parameters; where pieces begin is computed with what it finds."""
    more = ROUNDS_MAX
    while True:
        log_ramp, more = float(shared[0, RAMP]), more - 1
        pieces = cut(recording, Believed(math.exp(log_ramp), hypothesis, START_ERROR))
        problem = ShowProblem(recording, pieces, hypothesis, noise_deg)
        fit = problem.fit(shared)
        shared = fit.vectors.shared
        if not more or abs(float(shared[0, RAMP]) - log_ramp) < SAME_RAMP_RATIO:
            return problem, fit


# ---- the model


class ShowProblem:
    """The pieces of one joint, to be fitted under one hypothesis.

    With the scatter of the readings, `noise_deg`, the parameters of the pieces are fitted, too;
    without it only the shared ones, coarsely.
    """

    def __init__(
        self,
        recording: ShowRecording,
        pieces: Pieces,
        hypothesis: Hypothesis,
        noise_deg: float | None = None,
    ) -> None:
        joint = recording.joint
        self.pieces = pieces
        self._noise_deg = noise_deg
        self.model = ShowModel(
            pieces,
            hypothesis,
            speed_max_deg_s=joint.speed_max_deg_s,
            step_s=COARSE_STEP_S if noise_deg is None else STEP_S,
        )
        self._loop_s = joint.response.loop_s
        stiffness_ratio = joint.ramp_ratio / joint.response.ramp_ratio
        self.usual = np.zeros(SIZE)
        self.usual[RAMP] = math.log(recording.ramp_deg_s2 * stiffness_ratio)
        self.usual[LAG] = math.log(USUAL_LAG_S)
        self.usual[TOP] = math.log(joint.model.speed_max_deg_s)
        self._prior = (PRIOR_DEG / NOISE_DEG / SPREAD) ** 2
        count, moves = pieces.received_s.shape
        waits_s = np.full((count, moves), self._loop_s / math.sqrt(12.0))
        self._own_prior = np.concatenate([waits_s, pieces.start_error], axis=1) ** -2.0
        self._weight = np.ones(len(pieces.time_s))

    def fit(self, shared: FloatArray | None = None) -> Fitted:
        """Return the best parameters, searched from `shared` or from the best of `STARTS`.

        Levenberg-Marquardt.
        """
        vectors = Vectors.of(self._start() if shared is None else shared, self.pieces)
        self._weigh(vectors)
        damping = 1e-2
        for _ in range(ITERATIONS_MAX):
            residual, jacobian = self._linear(vectors)
            cost = self._cost(vectors, residual[None])[0]
            better, damping = self._improved(vectors, residual, jacobian, cost, damping)
            if better is None:
                break
            vectors, new_cost = better
            if cost - new_cost < COST_RATIO * cost:
                break
        return self._fitted(vectors)

    def moving(self, vectors: Vectors | None = None) -> int:
        """Return how many readings are in motion; without parameters, with the usual ones."""
        found = Vectors.of(self.usual[None], self.pieces) if vectors is None else vectors
        return int((self.model.speeds_deg_s(found) > MOVING_DEG_S).sum())

    def scatter_deg(self, vectors: Vectors) -> float:
        """Return the scatter of what is left of the readings at rest, or of all."""
        left_deg = self.model.readings_deg(vectors)[0] - self.pieces.reading_deg
        is_still = self.model.speeds_deg_s(vectors) < STILL_DEG_S
        chosen = left_deg[is_still] if is_still.sum() >= MOVING_LEAST else left_deg
        away_deg = float(np.minimum(np.abs(chosen), OUTLIER * NOISE_DEG).mean())
        return max(1.25 * away_deg, NOISE_LEAST_DEG)

    def _start(self) -> FloatArray:
        starts = np.tile(self.usual, (len(STARTS), 1))
        for row, (ramp, lag_s, dead_s, top) in zip(starts, STARTS, strict=True):
            row[RAMP] += math.log(ramp)
            row[LAG], row[DEAD] = math.log(lag_s), dead_s
            row[TOP] += math.log(top)
        readings_deg = self.model.readings_deg(Vectors.of(starts, self.pieces))
        off_deg = np.median(readings_deg - self.pieces.reading_deg, axis=1)
        starts[:, LOAD] = off_deg
        residuals = readings_deg - off_deg[:, None] - self.pieces.reading_deg
        at = int(np.argmin(_soft(residuals / NOISE_DEG / 4.0).sum(axis=1)))
        found: FloatArray = starts[at : at + 1]
        return found

    def _weigh(self, vectors: Vectors) -> None:
        speed_deg_s = self.model.speeds_deg_s(vectors)
        noise_deg, timing_s = NOISE_DEG, TIMING_S
        if self._noise_deg is not None:
            noise_deg, timing_s = self._noise_deg, READ_S
        self._weight = 1.0 / np.hypot(noise_deg, timing_s * speed_deg_s)

    # ---- one step of the fit

    def _residual(self, vectors: Vectors) -> FloatArray:
        found: FloatArray = self.model.readings_deg(vectors) - self.pieces.reading_deg
        return found * self._weight

    def _linear(self, vectors: Vectors) -> tuple[FloatArray, FloatArray]:
        """Return the residuals in units of their scatter, and their derivatives.

        A row of the derivatives is a reading; first the shared parameters, then those of its piece.
        """
        own_size = 0 if self._noise_deg is None else vectors.own.shape[-1]
        own_steps = np.array([WAIT_STEP_S] * max(own_size - 2, 0) + [*START_STEPS])[:own_size]
        steps = np.concatenate([STEPS, own_steps])
        rows = 1 + len(steps)
        shared = np.tile(vectors.shared, (rows, 1))
        shared[1 : 1 + SIZE] += np.diag(STEPS)
        own = vectors.own
        if own_size:
            own = np.tile(own, (rows, 1, 1))
            own[1 + SIZE :] += np.diag(own_steps)[:, None, :]
        residuals = self._residual(Vectors(shared, own))
        return residuals[0], (residuals[1:] - residuals[0]).T / steps

    def _cost(self, vectors: Vectors, residuals: FloatArray) -> FloatArray:
        prior = np.sum(self._prior * (vectors.shared - self.usual) ** 2, axis=-1)
        own = np.sum(self._own_prior * vectors.own**2, axis=(-1, -2))
        found: FloatArray = _soft(residuals).sum(axis=-1) + prior + own
        return found

    def _improved(
        self,
        vectors: Vectors,
        residual: FloatArray,
        jacobian: FloatArray,
        cost: float,
        damping: float,
    ) -> tuple[tuple[Vectors, float] | None, float]:
        """Return parameters with a lower cost and that cost, if there are any, and the damping."""
        blocks = self._blocks(vectors, residual, jacobian)
        dampings = damping * 8.0 ** np.arange(-1, 4)
        moved = [blocks.step(one) for one in dampings.tolist()]
        shared = vectors.shared + np.clip([one.shared[0] for one in moved], -STEP_MAX, STEP_MAX)
        shared[:, PLAY] = np.maximum(shared[:, PLAY], 0.0)
        tried = Vectors(shared, vectors.own + np.concatenate([one.own for one in moved]))
        costs = self._cost(tried, self._residual(tried))
        at = int(np.argmin(costs))
        if costs[at] >= cost:
            return None, damping
        return (tried.at(at), float(costs[at])), max(float(dampings[at]), 1e-9)

    def _blocks(self, vectors: Vectors, residual: FloatArray, jacobian: FloatArray) -> _Blocks:
        """Return the normal equations, the parameters of each piece eliminated."""
        share = _shares(residual)[:, None]
        firsts = self.pieces.firsts
        weighted = jacobian * share
        products = np.einsum("ri,rj->rij", weighted, jacobian)
        normal = np.add.reduceat(products, firsts)
        pull = np.add.reduceat(weighted * residual[:, None], firsts)
        own = vectors.own[0]
        if self._noise_deg is None:
            zero = np.zeros((len(firsts), 0))
            return _Blocks(normal, pull, self._prior, self._away(vectors), zero, own)
        pull[:, SIZE:] += self._own_prior * own
        return _Blocks(normal, pull, self._prior, self._away(vectors), self._own_prior, own)

    def _away(self, vectors: Vectors) -> FloatArray:
        found: FloatArray = self._prior * (vectors.shared[0] - self.usual)
        return found

    def _fitted(self, vectors: Vectors) -> Fitted:
        residual, jacobian = self._linear(vectors)
        share = _shares(residual)
        blocks = self._blocks(vectors, residual, jacobian)
        soft = float(_soft(residual).sum()) + float(np.sum(self._own_prior * vectors.own**2))
        left = math.sqrt(soft / len(residual))
        return Fitted(
            vectors,
            left,
            math.sqrt(float(np.sum(share * (residual / self._weight) ** 2) / np.sum(share))),
            blocks.covariance() * max(1.0, left * left),
            vectors.shared + blocks.without(),
            self._by_phase(blocks),
            self._costs(vectors, residual),
        )

    def _costs(self, vectors: Vectors, residual: FloatArray) -> FloatArray:
        found: FloatArray = np.add.reduceat(_soft(residual), self.pieces.firsts)
        found += np.sum(self._own_prior * vectors.own[0] ** 2, axis=-1)
        return found

    def _by_phase(self, blocks: _Blocks) -> FloatArray:
        """Return how far the shared parameters are off if the control loop has each phase."""
        received_s = self.pieces.begin_s[:, None] + self.pieces.received_s
        phases_s = self._loop_s * (np.arange(PHASES) + 0.5) / PHASES
        waits_s = (phases_s[:, None, None] - received_s) % self._loop_s - 0.5 * self._loop_s
        return blocks.shifted(waits_s)


class _Blocks:
    """Normal equations of shared parameters and of those of each piece."""

    def __init__(
        self,
        normal: FloatArray,
        pull: FloatArray,
        prior: FloatArray,
        away: FloatArray,
        own_prior: FloatArray,
        own: FloatArray,
    ) -> None:
        self._own_prior, self._empty = own_prior, np.zeros_like(own)
        own_size = own_prior.shape[-1]
        self._inner = normal[:, SIZE:, SIZE:] + own_prior[:, :, None] * np.eye(own_size)
        self._mixed = normal[:, SIZE:, :SIZE]
        self._outer, self._prior = normal[:, :SIZE, :SIZE], np.diag(prior)
        self._pull, self._away = pull, away
        self._reduced, self._pulls, self._gain = self._eliminated(0.0)

    def _eliminated(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return each piece's normal equations of the shared parameters alone, and the gain."""
        inner = self._inner * (1.0 + damping * np.eye(self._inner.shape[-1]))
        gain: FloatArray = np.asarray(np.linalg.solve(inner, self._mixed), dtype=np.float64)
        reduced: FloatArray = self._outer - np.einsum("pki,pkj->pij", self._mixed, gain)
        pulls: FloatArray = self._pull[:, :SIZE] - np.einsum(
            "pki,pk->pi", gain, self._pull[:, SIZE:]
        )
        return reduced, pulls, gain

    def step(self, damping: float) -> Vectors:
        """Return the damped step of all parameters."""
        reduced, pulls, gain = self._eliminated(damping)
        total = reduced.sum(axis=0) + self._prior
        total += damping * np.diag(np.diag(total) + 1e-9)
        shared = -np.linalg.solve(total, pulls.sum(axis=0) + self._away)
        own = self._empty
        if gain.shape[1]:
            inner = self._inner * (1.0 + damping * np.eye(self._inner.shape[-1]))
            alone = np.linalg.solve(inner, self._pull[:, SIZE:, None])[..., 0]
            own = -alone - gain @ shared
        return Vectors(shared[None], own[None])

    def covariance(self) -> FloatArray:
        """Return the covariance of the shared parameters."""
        found: FloatArray = np.linalg.inv(self._reduced.sum(axis=0) + self._prior)
        return found

    def without(self) -> FloatArray:
        """Return the steps of the shared parameters without each piece in turn."""
        total, pull = self._reduced.sum(axis=0) + self._prior, self._pulls.sum(axis=0) + self._away
        found: FloatArray = -np.linalg.solve(
            total - self._reduced, (pull - self._pulls)[..., None]
        )[..., 0]
        return found

    def shifted(self, waits_s: FloatArray) -> FloatArray:
        """Return how far the shared parameters are off with other waits, (sets, pieces, moves)."""
        if not self._own_prior.size:
            return np.zeros((1, SIZE))
        priced = self._own_prior[:, :-2] * waits_s
        pulls = np.einsum("pki,spk->si", self._gain[:, :-2], priced)
        total = self._reduced.sum(axis=0) + self._prior
        found: FloatArray = np.linalg.solve(total, pulls.T).T
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
    chosen: Hypothesis,
    fits: dict[Hypothesis, Fitted],
    problem: ShowProblem,
) -> Identified:
    joint, best, pieces = recording.joint, fits[chosen], problem.pieces
    speeds_deg_s = problem.model.speeds_deg_s(best.vectors)
    moving = problem.moving(best.vectors)
    if moving < MOVING_LEAST:
        raise too_little(joint, _readings_text(moving))
    is_explained = best.misfit <= EXPLAINED_MISFIT
    laws = [one for one, fit in fits.items() if not best.excludes(fit)]
    possible = [fits[one] for one in laws]
    delay = _of_all(best, possible, lambda shared: shared[:, DEAD] + np.exp(shared[:, LAG]))
    ramp = _of_all(best, possible, lambda shared: np.exp(shared[:, RAMP]))
    top = best.measured(lambda shared: np.exp(shared[:, TOP]))
    asked_deg_s = float(speeds_deg_s.max())
    is_top = top.value + 2.0 * top.error < SATURATED_RATIO * asked_deg_s
    low_deg, high_deg = float(pieces.reading_deg.min()), float(pieces.reading_deg.max())
    at = np.radians(sorted((low_deg, 0.5 * (low_deg + high_deg), high_deg),
                           key=joint.joint_deg))  # fmt: skip
    low, middle, high = (_load(best, angle) for angle in at.tolist())
    play = best.measured(lambda shared: shared[:, PLAY])
    return Identified(
        joint=joint.name,
        low_deg=min(joint.joint_deg(low_deg), joint.joint_deg(high_deg)),
        high_deg=max(joint.joint_deg(low_deg), joint.joint_deg(high_deg)),
        ramp_deg_s2=recording.ramp_deg_s2,
        speed_max_deg_s=joint.speed_max_deg_s,
        delay_s=delay,
        lag_s=_of_all(best, possible, lambda shared: np.exp(shared[:, LAG])),
        dead_s=_of_all(best, possible, lambda shared: shared[:, DEAD]),
        loop_s=None,
        retarget=Decided(
            chosen.retarget,
            is_explained and all(law.retarget == chosen.retarget for law in laws),
        ),
        t_law=Decided(
            chosen.t_law, is_explained and all(law.t_law == chosen.t_law for law in laws)
        ),
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
        noise_deg=problem.scatter_deg(best.vectors),
        misfit_deg=best.rms_deg,
        turnaround_s=tuple(np.percentile(recording.turnarounds_s, (1.0, 50.0, 99.0)).tolist()),
        readings=len(pieces.time_s),
        unsure=_unsure(delay, ramp) if is_explained else frozenset({"lag_s", "ramp_ratio"}),
    )


def _of_all(
    best: Fitted, possible: Sequence[Fitted], value: Callable[[FloatArray], FloatArray]
) -> Measured:
    """Return a function of the parameters; its error holds under all laws that are possible."""
    own = best.measured(value)
    away = max(abs(float(value(fit.vectors.shared)[0]) - own.value) for fit in possible)
    return Measured(own.value, math.hypot(own.error, away))


def _load(best: Fitted, angle: float) -> Measured:
    """Return how far the load pulls the horn at an angle (radians)."""
    basis = np.array([1.0, math.sin(angle), math.cos(angle)])
    return best.measured(lambda shared: shared[:, LOAD : LOAD + 3] @ basis)


def _unsure(delay: Measured, ramp: Measured) -> frozenset[str]:
    """Return the fields of `response` that the show does not tell well enough."""
    found = set()
    if delay.error > DELAY_ERROR_MAX_S:
        found.add("lag_s")
    if ramp.error > RAMP_ERROR_MAX_RATIO * ramp.value:
        found.add("ramp_ratio")
    return frozenset(found)
