"""The response model of a servo, and its least squares fit over all trials.

Model (`horn_deg`): a profile with two ramps, and a horn that follows it with a first-order lag, for
each hypothesis of what `D…T…` means. Unlike `planning.program.response` it lets a command be taken
up late, because the fit measures that. Angles are servo degrees, instants seconds of one trial.

Fit (`ResponseProblem`): for a hypothesis, the two ramps, the lag, how far the load pulls the horn
(a parabola over the angle), the play, and one delay for each command, because a servo takes a
command up at its next control loop.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.trials import Recording, SentMove, Trial

    Array = NDArray[np.float64]


FALLING_DEG: Final = 0.05
"""The change of the load over which gears fall from one side to the other. Chosen: half a wire
unit, so that the fit has a slope to follow."""
TINY_DEG_S: float = 1e-6
"""A slower horn is at rest: a wire unit in a day."""
READINGS_MAX: Final = 120
"""The number of readings of a trial that are used, evenly spread: more only take time."""
READINGS_COARSE: Final = 40
ITERATIONS_COARSE: Final = 10
"""Enough to separate right from wrong hypotheses."""
LAGS_TRIED_S: Final = (0.005, 0.01, 0.02, 0.04, 0.08, 0.16)
"""The search begins at the best of these. Chosen to cover all servos."""
LAG_LEAST_S: Final = 5e-4
"""A smaller lag counts as none: in half a millisecond no servo moves by a wire unit."""
OUTLIER_DEG: Final = 0.4
"""Larger residuals count less: a bus without checksums delivers wrong numbers."""
ITERATIONS_MAX: Final = 25
DELAY: Final = 6
PLAY: Final = 7
SHARED: Final = 8
"""Logarithms of accel, decel and lag; three coefficients of the droop; the mean delay; the play.
After these come the delays of the commands, as differences from their mean."""
PRIOR_DEG: Final = 0.5
"""Each prior below counts as one residual of this size: little beside the readings of a trial, but
enough to exclude absurd numbers that would save a wrong hypothesis."""
PRIOR_DELAY_S: Final = 0.006
"""Delays differ by a control loop of some milliseconds."""
PRIOR_LOG_RAMP: Final = 0.5
"""Ramps are close to AA and AD."""
COST_RATIO: Final = 1e-5
"""A step that lowers the cost by less than this share is the last."""
PRIOR_PLAY_DEG: Final = 0.5
"""Play is close to that of the rests."""
STEPS: Final = np.array([1e-4] * DELAY + [1e-5, 1e-3])
OWN_STEP_S: Final = 1e-5
"""Steps of the parameters for numeric derivatives."""


class Hypothesis(NamedTuple):
    """An undocumented meaning of `D…T…` (FACTS.md A10, A11); named as in `model.Response`."""

    retarget: Literal["keep_speed", "from_rest"]
    t_law: Literal["cruise", "exact"]


HYPOTHESES: tuple[Hypothesis, ...] = (
    Hypothesis("keep_speed", "cruise"),
    Hypothesis("keep_speed", "exact"),
    Hypothesis("from_rest", "cruise"),
    Hypothesis("from_rest", "exact"),
)


class Measured(NamedTuple):
    """A number and its standard error."""

    value: float
    error: float


class Rests(Struct, frozen=True):
    """Servo degrees. `droop_deg` are coefficients over (angle - middle) / half room.

    Play shows in one of two ways. Without a load, it depends on the direction from which a rest was
    reached. Under a load that changes sides (`is_falling`), it shows at that angle, since the gears
    fall to the other end of their play. A load that does not change sides hides it.
    """

    droop_deg: tuple[float, float, float]
    play: Measured
    is_falling: bool = False


class ResponseShape(Struct, frozen=True):
    """Parameters of a motion: two ramps, the speed limit SD, the time constant of the lag."""

    accel_deg_s2: float
    decel_deg_s2: float
    speed_max_deg_s: float
    lag_s: float


class _ProfilePoint(NamedTuple):
    start_s: float
    position_deg: float
    speed_deg_s: float
    accel_deg_s2: float

    def after(self, duration_s: float) -> tuple[float, float]:
        speed_deg_s = self.speed_deg_s + self.accel_deg_s2 * duration_s
        return (
            self.position_deg + 0.5 * (self.speed_deg_s + speed_deg_s) * duration_s,
            speed_deg_s,
        )


def horn_deg(
    times_s: NDArray[np.float64],
    start_deg: float,
    sent: Sequence[SentMove],
    delays_s: Sequence[float],
    shape: ResponseShape,
    hypothesis: Hypothesis,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the horn's angle at `times_s`, and how far it is behind the profile there.

    The servo rested on `start_deg` before. It takes up each move its delay after receiving it. The
    horn follows the profile with `lag_s * dh/dt = x - h`, which is solved exactly within a phase of
    constant acceleration.
    """
    points = [_ProfilePoint(-math.inf, start_deg, 0.0, 0.0)]
    for move, delay_s in zip(sent, delays_s, strict=True):
        points = _retargeted(points, move, move.received_s + delay_s, shape, hypothesis)
    return _lagged(points, shape.lag_s, times_s)


def _retargeted(
    points: list[_ProfilePoint],
    move: SentMove,
    taken_s: float,
    shape: ResponseShape,
    hypothesis: Hypothesis,
) -> list[_ProfilePoint]:
    """Return the profile up to `taken_s`, and from there to the target of the move."""
    kept = [point for point in points if point.start_s < taken_s]
    last = kept[-1]
    position_deg, speed_deg_s = last.position_deg, 0.0
    if math.isfinite(last.start_s):
        position_deg, speed_deg_s = last.after(taken_s - last.start_s)
    if hypothesis.retarget == "from_rest":
        speed_deg_s = 0.0
    away_deg = move.target_deg - position_deg
    travel_deg_s = min(
        shape.speed_max_deg_s,
        _travel_deg_s(
            abs(away_deg),
            move.duration_s,
            max(math.copysign(1.0, away_deg) * speed_deg_s, 0.0),
            shape,
            hypothesis.t_law,
        ),
    )
    return kept + _move(taken_s, position_deg, speed_deg_s, move.target_deg, travel_deg_s, shape)


def _travel_deg_s(
    distance_deg: float, duration_s: float, speed_deg_s: float, shape: ResponseShape, t_law: str
) -> float:
    """Return the speed that T demands: distance / T, or that of the trapezoid that lasts T.

    In the latter, the ramps take (v - v0)²/2a and v²/2d from the distance at speed v.
    """
    if t_law == "cruise":
        return distance_deg / duration_s
    square = 0.5 / shape.accel_deg_s2 + 0.5 / shape.decel_deg_s2
    slowing_s = duration_s - speed_deg_s / shape.decel_deg_s2
    if slowing_s > 0.0:
        slower = (distance_deg - 0.5 * speed_deg_s**2 / shape.decel_deg_s2) / slowing_s
        if 0.0 < slower <= speed_deg_s:
            return slower
    linear = duration_s + speed_deg_s / shape.accel_deg_s2
    constant = distance_deg + 0.5 * speed_deg_s**2 / shape.accel_deg_s2
    discriminant = linear**2 - 4.0 * square * constant
    return math.inf if discriminant < 0.0 else (linear - math.sqrt(discriminant)) / (2.0 * square)


def _move(
    now_s: float,
    position_deg: float,
    speed_deg_s: float,
    target_deg: float,
    travel_deg_s: float,
    shape: ResponseShape,
) -> list[_ProfilePoint]:
    """Return the phases of a move that ends at rest on `target_deg`.

    If the horn moves the wrong way, or too fast to stop in time, it brakes to rest first and comes
    back.
    """
    points: list[_ProfilePoint] = []
    accel, decel = shape.accel_deg_s2, shape.decel_deg_s2

    def go(duration_s: float, accel_deg_s2: float) -> None:
        nonlocal now_s, position_deg, speed_deg_s
        if duration_s > 0.0:
            point = _ProfilePoint(now_s, position_deg, speed_deg_s, accel_deg_s2)
            points.append(point)
            position_deg, speed_deg_s = point.after(duration_s)
            now_s += duration_s

    stop_deg = position_deg + 0.5 * speed_deg_s * abs(speed_deg_s) / decel
    sign = math.copysign(1.0, target_deg - stop_deg)
    if sign * speed_deg_s < -TINY_DEG_S:
        go(abs(speed_deg_s) / decel, -math.copysign(decel, speed_deg_s))
        speed_deg_s = 0.0
    distance, speed = abs(target_deg - position_deg), abs(speed_deg_s)
    reach = (2.0 * accel * decel * distance + decel * speed**2) / (accel + decel)
    peak = travel_deg_s if speed > travel_deg_s else min(travel_deg_s, math.sqrt(reach))
    rate = -decel if peak < speed else accel
    ramps_deg = abs(peak**2 - speed**2) / (2.0 * abs(rate)) + peak**2 / (2.0 * decel)
    go((peak - speed) / rate, sign * rate)
    if peak > TINY_DEG_S:
        go(max(0.0, distance - ramps_deg) / peak, 0.0)
        go(peak / decel, -sign * decel)
    points.append(_ProfilePoint(now_s, target_deg, 0.0, 0.0))
    return points


def _lagged(
    points: list[_ProfilePoint], lag_s: float, times_s: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a horn that follows the profile with a first-order lag, and its distance behind."""
    table = np.array(points)
    start_s, position, speed, accel = table.T
    start_s = np.where(np.isfinite(start_s), start_s, start_s[1] - 1.0 if len(points) > 1 else 0.0)
    behind = position - lag_s * (
        speed - lag_s * accel
    )  # The horn's angle after a long time in this phase.
    gap = np.zeros(len(points))
    for index in range(1, len(points)):
        passed_s = start_s[index] - start_s[index - 1]
        before = points[index - 1]
        speed_deg_s = before.speed_deg_s + before.accel_deg_s2 * passed_s
        final_deg = before.position_deg + 0.5 * (before.speed_deg_s + speed_deg_s) * passed_s
        final_deg -= lag_s * (speed_deg_s - lag_s * before.accel_deg_s2)
        fading = math.exp(-passed_s / lag_s)
        gap[index] = final_deg + gap[index - 1] * fading - behind[index]
    at = np.maximum(np.searchsorted(start_s, times_s, side="right") - 1, 0)
    passed = np.maximum(times_s - start_s[at], 0.0)
    now_speed = speed[at] + accel[at] * passed
    profile = position[at] + 0.5 * (speed[at] + now_speed) * passed
    behind_deg: NDArray[np.float64] = lag_s * (now_speed - lag_s * accel[at])
    behind_deg -= gap[at] * np.exp(-passed / lag_s)
    return profile - behind_deg, behind_deg


class FitTrial(Struct, frozen=True):
    """One trial for the fit: its readings as arrays, thinned."""

    start_deg: float
    arrived: float
    """Direction of the last move before: 1, -1, or 0 if unknown."""
    sent: tuple[SentMove, ...]
    times_s: Array
    readings_deg: Array


def thinned(trial: Trial, arrived: float, most: int) -> FitTrial:
    """Return a trial with at most `most` of its readings."""
    count = len(trial.times_s)
    kept = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.intp))
    return FitTrial(
        trial.start_deg,
        arrived,
        tuple(trial.sent),
        np.array(trial.times_s)[kept],
        np.array(trial.readings_deg)[kept],
    )


def fallen_deg(droop_deg: Array, play_deg: float) -> Array:
    """Return how much lower the horn hangs with its gears on the side of the load."""
    fallen: Array = 0.5 * play_deg * np.tanh(droop_deg / FALLING_DEG)
    return fallen


def with_play(horn: Array, arrived: float, play_deg: float) -> Array:
    """Return the angle of the shaft behind gears with play, pushed at either end of it."""
    if play_deg <= 0.0 or not len(horn):
        return horn
    half = 0.5 * play_deg
    shaft = np.empty_like(horn)
    at = float(horn[0]) - arrived * half
    for index, angle in enumerate(horn.tolist()):
        at = min(max(at, angle - half), angle + half)
        shaft[index] = at
    return shaft


class ModelFit(Struct, frozen=True):
    """The best parameters under one hypothesis. `delays_s`: a tuple a trial, a delay a move.

    A delay runs from the last byte of a command to the effect at the horn, `lag_s` included.
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
    """Like `rms_deg`, plus a penalty for improbable delays and ramps."""
    errors: tuple[float, ...]


class ResponseProblem:
    """The trials of one joint, to be fitted under any hypothesis.

    `rests` state whether there is play, and how it shows; its size is fitted, too.
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
        directions = [0.0, *(trial.last_direction() for trial in trials)]
        most = READINGS_COARSE if is_coarse else READINGS_MAX
        self._iterations = ITERATIONS_COARSE if is_coarse else ITERATIONS_MAX
        self.trials = [
            thinned(trial, direction, most)
            for trial, direction in zip(trials, directions, strict=False)
        ]
        self._ramp_deg_s2 = recording.ramp_deg_s2
        self._speed_max_deg_s = recording.speed_max_deg_s
        self._middle_deg = 0.5 * (window.low_deg + window.high_deg)
        self._half_deg = 0.5 * window.room_deg
        self._rests = rests
        counts = [len(trial.sent) for trial in self.trials]
        self._starts = SHARED + np.concatenate(([0], np.cumsum(counts)))
        size = int(self._starts[-1])
        self._prior = np.zeros(size)
        self._prior[:2] = (PRIOR_DEG / PRIOR_LOG_RAMP) ** 2
        self._prior[PLAY] = (PRIOR_DEG / PRIOR_PLAY_DEG) ** 2
        self._prior[SHARED:] = (PRIOR_DEG / PRIOR_DELAY_S) ** 2
        self._usual = np.zeros(size)
        self._usual[:2] = np.log(self._ramp_deg_s2)
        self._usual[PLAY] = rests.play.value

    def fit(self, hypothesis: Hypothesis, start: ModelFit | None = None) -> ModelFit:
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
        """Return the readings that the model predicts for a trial.

        A load pulls a horn that lags: the pull at an angle shows later by the lag.
        """
        trial = self.trials[index]
        accel, decel, lag_s = np.exp(vector[:3])
        lag_s = max(float(lag_s), LAG_LEAST_S)
        shape = ResponseShape(float(accel), float(decel), self._speed_max_deg_s, lag_s)
        own = vector[self._starts[index] : self._starts[index + 1]]
        delays = own + (vector[DELAY] - lag_s)
        horn, behind = horn_deg(
            trial.times_s, trial.start_deg, trial.sent, delays.tolist(), shape, hypothesis
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

    def _vector_of(self, fit: ModelFit) -> Array:
        logs = np.log([fit.accel_deg_s2, fit.decel_deg_s2, fit.lag_s])
        own = np.concatenate(fit.delays_s) - fit.delay_s
        return np.concatenate([logs, fit.droop_deg, [fit.delay_s, fit.play_deg], own])

    def _cost(
        self, vector: Array, hypothesis: Hypothesis, residuals: list[Array] | None = None
    ) -> float:
        """Return the sum of the soft-l1 residuals and of the priors."""
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
        """Return a step that lowers the cost, if there is one, and its damping."""
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

    def _made(self, vector: Array, residuals: list[Array], hypothesis: Hypothesis) -> ModelFit:
        accel, decel, lag_s = np.exp(vector[:3])
        flat = np.concatenate(residuals)
        weights = _weights(flat)
        delays = vector[DELAY] + vector
        return ModelFit(
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
        """Return standard errors of the shared parameters: each trial is left out once (jackknife).

        The delays, which occur in one trial only, are eliminated from it first; leaving a trial
        out is then a small linear problem.
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
