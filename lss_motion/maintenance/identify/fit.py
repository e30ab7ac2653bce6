"""Least squares over all trials: the one set of numbers, and one delay for each command.

What is fitted for a hypothesis: the two ramps, the lag of the horn, how far the load pulls it
(a parabola over the angle), and for each command how much later the horn does it. The last are
not one number, because a servo takes a command up at its next control loop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.maintenance.identify.fit_trial import fallen_deg, thinned, with_play
from lss_motion.maintenance.identify.motion import Hypothesis, Shape, horn_deg

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.recording import Recording, Trial
    from lss_motion.maintenance.identify.rests import Rests

    Array = NDArray[np.float64]

READINGS_MAX: Final = 120
"""As many readings of a trial are used, evenly spread: more only cost time."""
READINGS_COARSE: Final = 40
ITERATIONS_COARSE: Final = 10
"""What is enough to tell right from wrong."""
LAGS_TRIED_S: Final = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
"""Where the search begins: the best of these. Chosen to cover what a servo can be."""
LAG_LEAST_S: Final = 5e-4
"""A lag below this is none: in half a millisecond no servo moves by a wire unit."""
OUTLIER_DEG: Final = 0.4
"""Residuals beyond this count less: a bus without checksums delivers wrong numbers."""
ITERATIONS_MAX: Final = 25
DELAY: Final = 6
PLAY: Final = 7
SHARED: Final = 8
"""Logarithms of accel, decel and lag; three coefficients of the droop; the mean delay; the play.
After these come the delays of the commands, as differences from their mean."""
PRIOR_DEG: Final = 0.5
"""What follows counts as much as one residual of this size: nothing against the readings of a
trial, but enough that a wrong hypothesis cannot hide in absurd numbers."""
PRIOR_DELAY_S: Final = 0.006
"""Delays differ by a control loop of some milliseconds."""
PRIOR_LOG_RAMP: Final = 0.5
"""Ramps are about what AA and AD say."""
COST_RATIO: Final = 1e-5
"""A step that lowers the cost by less than this share is the last."""
PRIOR_PLAY_DEG: Final = 0.5
"""Play is about what the rests show."""
STEPS: Final = np.array([1e-4] * DELAY + [1e-5, 1e-3])
OWN_STEP_S: Final = 1e-5
"""How far each number is moved to see what the readings would do."""


@dataclass(frozen=True)
class Fit:
    """The best numbers under one hypothesis. `delays_s` is one list a trial, one delay an order.

    A delay runs from the last byte of a command to what the horn does of it, `lag_s` included.
    `errors` are standard errors by jackknife over the trials: of the logarithms of accel, decel
    and lag, of the droop's coefficients, of the mean delay (s), and of the play.
    """

    hypothesis: Hypothesis
    accel_deg_s2: float
    decel_deg_s2: float
    lag_s: float
    droop_deg: tuple[float, float, float]
    """Coefficients over (angle - middle) / half room."""
    delay_s: float
    play_deg: float
    delays_s: tuple[tuple[float, ...], ...]
    rms_deg: float
    misfit_deg: float
    """Like `rms_deg`, and more for delays and ramps that a servo hardly has."""
    errors: tuple[float, ...]


class Problem:
    """The trials of one joint, ready to be fitted under any hypothesis.

    `rests` say whether there is play, and how it shows; how much is fitted, too.
    """

    def __init__(
        self,
        recording: Recording,
        trials: Sequence[Trial],
        rests: Rests,
        *,
        is_coarse: bool = False,
    ) -> None:
        window = recording.window
        ways = [0.0, *(trial.last_way() for trial in trials)]
        most = READINGS_COARSE if is_coarse else READINGS_MAX
        self._iterations = ITERATIONS_COARSE if is_coarse else ITERATIONS_MAX
        self.trials = [thinned(trial, way, most) for trial, way in zip(trials, ways, strict=False)]
        self._ramp_deg_s2 = recording.ramp_deg_s2
        self._speed_max_deg_s = recording.speed_max_deg_s
        self._middle_deg = 0.5 * (window.low_deg + window.high_deg)
        self._half_deg = 0.5 * window.room_deg
        self._rests = rests
        counts = [len(trial.orders) for trial in self.trials]
        self._starts = SHARED + np.concatenate(([0], np.cumsum(counts)))
        size = int(self._starts[-1])
        self._prior = np.zeros(size)
        self._prior[:2] = (PRIOR_DEG / PRIOR_LOG_RAMP) ** 2
        self._prior[PLAY] = (PRIOR_DEG / PRIOR_PLAY_DEG) ** 2
        self._prior[SHARED:] = (PRIOR_DEG / PRIOR_DELAY_S) ** 2
        self._usual = np.zeros(size)
        self._usual[:2] = np.log(self._ramp_deg_s2)
        self._usual[PLAY] = rests.play.value

    def fit(self, hypothesis: Hypothesis, start: Fit | None = None) -> Fit:
        """Return the best fit, searched from `start` or from scratch. Levenberg-Marquardt."""
        if start is None:
            vectors = [self._vector(lag_s) for lag_s in LAGS_TRIED_S]
            vector = min(vectors, key=lambda v: self._cost(v, hypothesis))
        else:
            vector = self._vector_of(start)
        residuals = self._residuals(vector, hypothesis)
        damping = 1e-3
        for _ in range(self._iterations):
            normal, gradient = self._normal(vector, residuals, hypothesis)
            cost = self._cost(vector, hypothesis, residuals)
            step, damping = self._improved(vector, normal, gradient, cost, damping, hypothesis)
            if step is None:
                break
            vector = vector + step
            residuals = self._residuals(vector, hypothesis)
            if cost - self._cost(vector, hypothesis, residuals) < COST_RATIO * cost:
                break
        return self._made(vector, residuals, hypothesis)

    # ---- the model

    def predicted_deg(self, vector: Array, index: int, hypothesis: Hypothesis) -> Array:
        """Return what the readings of a trial would be.

        A load pulls a horn as it lags: what it pulls at an angle shows as much later.
        """
        trial = self.trials[index]
        accel, decel, lag_s = np.exp(vector[:3])
        lag_s = max(float(lag_s), LAG_LEAST_S)
        shape = Shape(float(accel), float(decel), self._speed_max_deg_s, lag_s)
        own = vector[self._starts[index] : self._starts[index + 1]]
        delays = own + (vector[DELAY] - lag_s)
        horn, behind = horn_deg(
            trial.times_s, trial.start_deg, trial.orders, delays.tolist(), shape, hypothesis
        )
        away = (horn - self._middle_deg) / self._half_deg
        droop = vector[3] + away * (vector[4] + away * vector[5])
        droop_later = (vector[4] + 2.0 * away * vector[5]) * behind / self._half_deg
        shaft = horn
        if self._rests.is_falling:
            shaft = horn - fallen_deg(droop, float(vector[PLAY]))
        elif self._rests.play.value:
            shaft = with_play(horn, trial.arrived, float(vector[PLAY]))
        reading: Array = shaft - droop + droop_later
        return reading

    def _residuals(self, vector: Array, hypothesis: Hypothesis) -> list[Array]:
        return [
            self.predicted_deg(vector, index, hypothesis) - trial.readings_deg
            for index, trial in enumerate(self.trials)
        ]

    def _vector(self, lag_s: float) -> Array:
        ramp, rests = np.log(self._ramp_deg_s2), self._rests
        own = np.zeros(int(self._starts[-1]) - SHARED)
        return np.concatenate(
            ([ramp, ramp, np.log(lag_s), *rests.droop_deg, lag_s, rests.play.value], own)
        )

    def _vector_of(self, fit: Fit) -> Array:
        logs = np.log([fit.accel_deg_s2, fit.decel_deg_s2, fit.lag_s])
        own = np.concatenate(fit.delays_s) - fit.delay_s
        return np.concatenate([logs, fit.droop_deg, [fit.delay_s, fit.play_deg], own])

    def _cost(
        self, vector: Array, hypothesis: Hypothesis, residuals: list[Array] | None = None
    ) -> float:
        """Return the sum of soft-l1 residuals and of what the prior adds."""
        flat = np.concatenate(residuals or self._residuals(vector, hypothesis)) / OUTLIER_DEG
        soft = 2.0 * OUTLIER_DEG**2 * float(np.sum(np.sqrt(1.0 + flat * flat) - 1.0))
        return soft + float(np.sum(self._prior * (vector - self._usual) ** 2))

    # ---- one step

    def _blocks(
        self, vector: Array, residuals: list[Array], hypothesis: Hypothesis
    ) -> list[tuple[Array, Array]]:
        """Return for each trial the weighted derivatives by its parameters, and its residuals."""
        blocks = []
        for index, trial in enumerate(self.trials):
            columns = self._columns(index).tolist()
            plain = residuals[index] + trial.readings_deg
            jacobian = np.empty((len(plain), len(columns)))
            for place, column in enumerate(columns):
                step = float(STEPS[column]) if column < SHARED else OWN_STEP_S
                moved = vector.copy()
                moved[column] += step
                jacobian[:, place] = (self.predicted_deg(moved, index, hypothesis) - plain) / step
            weight = np.sqrt(_weights(residuals[index]))
            blocks.append((jacobian * weight[:, None], residuals[index] * weight))
        return blocks

    def _normal(
        self, vector: Array, residuals: list[Array], hypothesis: Hypothesis
    ) -> tuple[Array, Array]:
        normal = np.diag(self._prior)
        gradient = self._prior * (vector - self._usual)
        for index, (jacobian, weighted) in enumerate(self._blocks(vector, residuals, hypothesis)):
            columns = self._columns(index)
            normal[np.ix_(columns, columns)] += jacobian.T @ jacobian
            gradient[columns] += jacobian.T @ weighted
        return normal, gradient

    def _columns(self, index: int) -> NDArray[np.intp]:
        own = np.arange(self._starts[index], self._starts[index + 1])
        return np.concatenate((np.arange(SHARED), own)).astype(np.intp)

    def _improved(
        self,
        vector: Array,
        normal: Array,
        gradient: Array,
        cost: float,
        damping: float,
        hypothesis: Hypothesis,
    ) -> tuple[Array | None, float]:
        """Return a step that lowers the cost, if there is one, and the damping it took."""
        scale = np.diag(normal) + 1e-9
        for _ in range(8):
            solved = np.linalg.solve(normal + damping * np.diag(scale), -gradient)
            step: Array = np.asarray(solved, dtype=np.float64)
            step[:3] = np.clip(step[:3], -0.7, 0.7)
            step[DELAY:] = np.clip(step[DELAY:], -0.05, 0.05)
            if self._cost(vector + step, hypothesis) < cost:
                return step, max(damping / 5.0, 1e-9)
            damping *= 6.0
        return None, damping

    # ---- the result

    def _made(self, vector: Array, residuals: list[Array], hypothesis: Hypothesis) -> Fit:
        accel, decel, lag_s = np.exp(vector[:3])
        flat = np.concatenate(residuals)
        weights = _weights(flat)
        delays = vector[DELAY] + vector
        return Fit(
            hypothesis=hypothesis,
            accel_deg_s2=float(accel),
            decel_deg_s2=float(decel),
            lag_s=max(float(lag_s), LAG_LEAST_S),
            droop_deg=(float(vector[3]), float(vector[4]), float(vector[5])),
            delay_s=float(vector[DELAY]),
            play_deg=max(0.0, float(vector[PLAY])),
            delays_s=tuple(
                tuple(delays[a:b].tolist())
                for a, b in zip(self._starts[:-1], self._starts[1:], strict=True)
            ),
            rms_deg=float(np.sqrt(np.sum(weights * flat**2) / np.sum(weights))),
            misfit_deg=(self._cost(vector, hypothesis, residuals) / len(flat)) ** 0.5,
            errors=self._errors(vector, residuals, hypothesis),
        )

    def _errors(
        self, vector: Array, residuals: list[Array], hypothesis: Hypothesis
    ) -> tuple[float, ...]:
        """Return standard errors of the shared numbers: each trial is left out once (jackknife).

        The delays, which only one trial knows, are eliminated from it first; then leaving a trial
        out is a small linear problem.
        """
        parts = []
        for index, (jacobian, weighted) in enumerate(self._blocks(vector, residuals, hypothesis)):
            columns = self._columns(index)
            prior = np.diag(np.sqrt(self._prior[columns]))[SHARED:]
            jacobian = np.vstack((jacobian, prior))  # noqa: PLW2901
            weighted = np.concatenate((weighted, prior @ (vector - self._usual)[columns]))  # noqa: PLW2901
            shared, own = jacobian[:, :SHARED], jacobian[:, SHARED:]
            shared = shared - own @ np.linalg.lstsq(own, shared, rcond=None)[0]
            parts.append((shared.T @ shared, shared.T @ weighted))
        total = sum((part for part, _ in parts), start=np.zeros((SHARED, SHARED)))
        steady = 1e-9 * np.diag(np.diag(total) + 1.0)
        moved = [np.linalg.solve(total - part + steady, gradient) for part, gradient in parts]
        spread = np.array(moved) - np.mean(moved, axis=0)
        count = len(parts)
        errors: list[float] = np.sqrt((count - 1) / count * np.sum(spread**2, axis=0)).tolist()
        return tuple(errors)


def _weights(residuals: Array) -> Array:
    """Return the weights of soft-l1: 1 for small residuals, falling with large ones."""
    weights: Array = 1.0 / np.sqrt(1.0 + (residuals / OUTLIER_DEG) ** 2)
    return weights
