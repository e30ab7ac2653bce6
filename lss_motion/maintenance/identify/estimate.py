"""Computes the parameters of a servo from a recording, each with its uncertainty.

`identify` fits the model of `fit` under every hypothesis and keeps the best. `read_rests` uses the
rests alone: how far the load pulls the horn at each angle, and the play of the gears.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct

from lss_motion.errors import PlaybackError
from lss_motion.maintenance.identify.response_fit import (
    HYPOTHESES,
    Measured,
    ModelFit,
    Problem,
    Rests,
    Shape,
    fallen_deg,
    horn_deg,
)
from lss_motion.maintenance.identify.trials import Kind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.maintenance.identify.response_fit import Hypothesis
    from lss_motion.maintenance.identify.trials import Recording, Trial
    from lss_motion.robot.model import Joint

    Array = NDArray[np.float64]


PLAY_LEAST_DEG: Final = 0.1
"""Less play than a wire unit counts as none."""
PLAY_SIGMAS: Final = 4.0
FALL_RATIO: Final = 0.5
"""Gears that fall to their other side must explain this share of the residuals without them."""
DECIDED_RATIO: Final = 1.15
"""A hypothesis is rejected if its residuals are larger than the best ones by this factor."""
MISFIT_MAX_DEG: Final = 0.7
"""Above this no hypothesis explains the readings, and no fitted value is valid. Several times the
scatter of a reading (FACTS.md E7: 0.1 deg)."""
LOOP_PERIODS_S: Final = (0.001, 0.025)
"""The range in which a control period is searched."""
LOOP_COHERENCE_LEAST: Final = 0.72
"""Instants of take-up on a grid give 1, random ones 0; the best of the 30 000 grids that are tried
gives 0.56 for thirty random instants."""
LOOP_SIGMAS: Final = 3.0
"""A dead time contradicts a control loop if it differs by so many standard errors."""
SATURATED_RATIO: Final = 0.94
"""A horn slower than this share of its profile turns at its top speed."""
NOT_FITTED: Final = (Kind.REACH, Kind.FAST)
"""Trials before the top speed is known: the servo may not have followed its profile."""
STEEP_RATIO: Final = 0.97
SLOPE_S: Final = 0.05
"""Speeds are slopes over this time."""


class Decided(NamedTuple):
    """The choice between two laws; `is_sure` if the readings separate them."""

    value: str
    is_sure: bool


class Identified(Struct, frozen=True, kw_only=True):
    """How one servo responds. Angles in joint degrees.

    `delay_s`      from the last byte of a command to the horn, on average: what playing leads by
    `lag_s`        time constant of the horn behind the servo's profile
    `dead_s`       the rest of the delay: until the profile begins
    `loop_s`       period of the grid on which commands are taken up; None: none was found
    `accel_deg_s2`, `decel_deg_s2`  the ramps, with AA and AD at `ramp_deg_s2`
    `top_deg_s`    the fastest that the horn turned; `is_top` if it could not turn faster
    `droop_deg`    how far its load pulls the horn from where it should stand: at the low end of
                   the window, in its middle, at its high end; below 0: beyond
    `play_deg`     how much further it must be sent when it turns back
    `noise_deg`    root mean square of a reading's scatter at rest
    `misfit_deg`   root mean square of what the model does not explain
    `turnaround_s` least, median and largest of 100
    `unsure`       fields of `response` that were not measured well enough
    """

    joint: str
    low_deg: float
    high_deg: float
    ramp_deg_s2: float
    speed_max_deg_s: float
    delay_s: Measured
    lag_s: Measured
    dead_s: Measured
    loop_s: Measured | None
    retarget: Decided
    t_law: Decided
    accel_deg_s2: Measured
    decel_deg_s2: Measured
    top_deg_s: Measured
    is_top: bool
    droop_deg: tuple[float, float, float]
    droop_error_deg: float
    play_deg: Measured
    noise_deg: float
    misfit_deg: float
    turnaround_s: tuple[float, float, float]
    readings: int
    unsure: frozenset[str] = frozenset()


def identify(joint: Joint, recording: Recording) -> Identified:
    """Return the parameters of the servo of `joint`.

    Raises `PlaybackError` if no hypothesis explains the readings.
    """
    trials = [trial for trial in recording.trials if trial.kind not in NOT_FITTED]
    rests = read_rests(recording, trials)
    coarse = Problem(recording, trials, rests, is_coarse=True)
    fits = {hypothesis: coarse.fit(hypothesis) for hypothesis in HYPOTHESES}
    chosen = min(fits.values(), key=lambda fit: fit.misfit_deg)
    best = Problem(recording, trials, rests).fit(chosen.hypothesis, chosen)
    play = Measured(best.play_deg, best.errors[7]) if rests.play.value else rests.play
    if best.misfit_deg > MISFIT_MAX_DEG:
        raise PlaybackError(
            f"joint {joint.name!r}: no model explains its readings, the best misses by "
            f"{best.misfit_deg:.1f} deg. Is the joint free, and does nothing swing on it?",
            joint=joint.name,
        )
    retarget, t_law = best.hypothesis
    top, is_top = _top_speed(recording, best)
    loop = _loop(trials, best)
    delay = Measured(best.delay_s, math.hypot(best.errors[6], _spread_error(best)))
    lag, dead = _parts(best, delay, loop)
    window = recording.window
    low_deg, high_deg = sorted((joint.joint_deg(window.low_deg), joint.joint_deg(window.high_deg)))
    return Identified(
        joint=joint.name,
        low_deg=low_deg,
        high_deg=high_deg,
        ramp_deg_s2=recording.ramp_deg_s2,
        speed_max_deg_s=recording.speed_max_deg_s,
        delay_s=delay,
        lag_s=lag,
        dead_s=dead,
        loop_s=loop,
        retarget=Decided(retarget, _is_sure(fits, chosen, 0)),
        t_law=Decided(t_law, _is_sure(fits, chosen, 1)),
        accel_deg_s2=Measured(best.accel_deg_s2, best.accel_deg_s2 * best.errors[0]),
        decel_deg_s2=Measured(best.decel_deg_s2, best.decel_deg_s2 * best.errors[1]),
        top_deg_s=top,
        is_top=is_top,
        droop_deg=_droop(joint, best, is_falling=rests.is_falling),
        droop_error_deg=best.errors[3],
        play_deg=play,
        noise_deg=_noise_deg(trials),
        misfit_deg=best.rms_deg,
        turnaround_s=_turnaround(recording),
        readings=sum(len(trial.times_s) for trial in recording.trials),
    )


def _is_sure(fits: dict[Hypothesis, ModelFit], best: ModelFit, place: int) -> bool:
    """Return whether every hypothesis with the other law at `place` is clearly worse."""
    others = [f for h, f in fits.items() if h[place] != best.hypothesis[place]]
    return min(f.misfit_deg for f in others) > DECIDED_RATIO * best.misfit_deg


def _spread_error(fit: ModelFit) -> float:
    """Return the standard error of the mean delay: each command meets its own control loop."""
    delays = np.concatenate(fit.delays_s)
    return float(np.std(delays) / math.sqrt(len(delays)))


def _parts(fit: ModelFit, delay: Measured, loop: Measured | None) -> tuple[Measured, Measured]:
    """Return lag and dead time, whose sum is the delay.

    Only the shape of the ramps separates them, slow ones poorly. Where a control loop was found and
    the shape does not contradict it, the profile is assumed to begin at the first loop.
    """
    error = math.hypot(fit.lag_s * fit.errors[2], delay.error)
    dead_s = fit.delay_s - fit.lag_s
    first_s = 0.0 if loop is None else 0.5 * loop.value
    if loop is not None and abs(dead_s - first_s) < LOOP_SIGMAS * error:
        return Measured(fit.delay_s - first_s, delay.error), Measured(first_s, delay.error)
    return Measured(fit.lag_s, fit.lag_s * fit.errors[2]), Measured(dead_s, error)


def _loop(trials: Sequence[Trial], fit: ModelFit) -> Measured | None:
    """Return the period of the grid on which the commands were taken up, if there is one.

    On a clock with that period all instants of take-up have the same phase.
    """
    taken_s = np.array(
        [
            trial.began_s + move.received_s + delay_s
            for trial, delays_s in zip(trials, fit.delays_s, strict=True)
            for move, delay_s in zip(trial.sent, delays_s, strict=True)
        ]
    )
    taken_s -= taken_s.mean()
    step_hz = 0.2 / float(np.ptp(taken_s))
    rates_hz = np.arange(1.0 / LOOP_PERIODS_S[1], 1.0 / LOOP_PERIODS_S[0], step_hz)
    hands = np.zeros(len(rates_hz), dtype=np.complex128)
    for instant_s in taken_s.tolist():
        hands += np.exp(2j * math.pi * instant_s * rates_hz)
    coherence = np.abs(hands) / len(taken_s)
    at = int(np.argmax(coherence))
    if coherence[at] < LOOP_COHERENCE_LEAST:
        return None
    period_s = 1.0 / float(rates_hz[at])
    return Measured(period_s, period_s * step_hz / float(rates_hz[at]))


def _top_speed(recording: Recording, fit: ModelFit) -> tuple[Measured, bool]:
    """Return the highest speed of the horn, and whether its profile was faster.

    It is taken where the profile is fastest: the fastest reading would be mostly scatter.
    """
    shape = Shape(fit.accel_deg_s2, fit.decel_deg_s2, recording.speed_max_deg_s, fit.lag_s)
    best, is_top = Measured(0.0, 0.0), False
    for trial in recording.trials:
        times_s = np.array(trial.times_s)
        delays = [fit.delay_s - fit.lag_s] * len(trial.sent)
        asked_deg, _ = horn_deg(times_s, trial.start_deg, trial.sent, delays, shape, fit.hypothesis)
        slopes = _slopes(times_s, np.array(trial.readings_deg), asked_deg)
        if not len(slopes):
            continue
        steep = slopes[slopes[:, 2] >= STEEP_RATIO * slopes[:, 2].max()]
        made_deg_s, error_deg_s, asked_deg_s = np.median(steep, axis=0).tolist()
        if made_deg_s > best.value:
            best = Measured(made_deg_s, error_deg_s)
            is_top = made_deg_s < SATURATED_RATIO * asked_deg_s
    return best, is_top


def _slopes(times_s: Array, angles_deg: Array, asked_deg: Array) -> Array:
    """Return for every span of `SLOPE_S` the slope of the angles, its error, and the asked one."""
    rows = []
    first = 0
    for last in range(len(times_s)):
        while times_s[last] - times_s[first] > SLOPE_S:
            first += 1
        if last - first < 3 or times_s[last] - times_s[first] < 0.7 * SLOPE_S:
            continue
        t = times_s[first : last + 1] - times_s[first : last + 1].mean()
        angles = angles_deg[first : last + 1]
        slope = float(t @ angles / (t @ t))
        left = angles - angles.mean() - slope * t
        error = math.sqrt(float(left @ left) / (last - first - 1) / float(t @ t))
        rows.append((abs(slope), error, abs(float(t @ asked_deg[first : last + 1] / (t @ t)))))
    return np.array(rows)


def _droop(joint: Joint, fit: ModelFit, *, is_falling: bool) -> tuple[float, float, float]:
    """Return how far the horn stands below its target, in joint degrees, from low to high."""
    level, slope, bend = fit.droop_deg
    at = np.array([-1.0, 0.0, 1.0])
    droop = level + at * (slope + at * bend)
    if is_falling:
        droop = droop + fallen_deg(droop, fit.play_deg)
    low, middle, high = (joint.direction * droop)[:: joint.direction].tolist()
    return low, middle, high


def _noise_deg(trials: Sequence[Trial]) -> float:
    squares = [trial.rest_variance_deg2() for trial in trials]
    return math.sqrt(float(np.mean(squares)))


def _turnaround(recording: Recording) -> tuple[float, float, float]:
    least, middle, most = np.percentile(recording.turnarounds_s, (1.0, 50.0, 99.0)).tolist()
    return least, middle, most


def read_rests(recording: Recording, trials: Sequence[Trial]) -> Rests:
    """Return the load and the play that the rests at the end of the trials show."""
    window = recording.window
    targets = np.array([trial.sent[-1].target_deg for trial in trials])
    missing = targets - np.array([trial.rest_deg() for trial in trials])
    away = (targets - 0.5 * (window.low_deg + window.high_deg)) / (0.5 * window.room_deg)
    load = np.stack([np.ones_like(away), away, away**2], axis=1)
    ways = np.array([trial.last_direction() for trial in trials])
    turned = _RestFit(np.column_stack([load, 0.5 * ways]), missing)
    if turned.is_real(turned.step):
        return Rests(turned.droop, turned.step)
    plain = _RestFit(load, missing)
    heights = np.unique(np.round(away, 3))
    falls = [
        _RestFit(np.column_stack([load, 0.5 * np.sign(away - height)]), missing)
        for height in 0.5 * (heights[1:] + heights[:-1])
    ]
    best = min(falls, key=lambda line: line.rms_deg, default=plain)
    level, slope, _ = best.droop
    falling = best.step._replace(value=math.copysign(best.step.value, best.step.value * slope))
    changes = abs(slope) > abs(level) and best.rms_deg < FALL_RATIO * plain.rms_deg
    if changes and best.is_real(falling):
        return Rests(best.droop, falling, is_falling=True)
    return Rests(plain.droop, Measured(0.0, turned.step.error))


class _RestFit:
    """Least squares of the load's parabola and, in the fourth column, of a step."""

    def __init__(self, columns: Array, missing: Array) -> None:
        found = np.linalg.lstsq(columns, missing, rcond=None)[0]
        left = missing - columns @ found
        spare = max(1, len(missing) - columns.shape[1])
        self.rms_deg = math.sqrt(float(left @ left) / spare)
        self.droop = (float(found[0]), float(found[1]), float(found[2]))
        self.step = Measured(0.0, math.inf)
        if len(found) > 3:
            spread = np.linalg.pinv(columns.T @ columns)[3, 3]
            self.step = Measured(float(found[3]), self.rms_deg * math.sqrt(max(0.0, spread)))

    @staticmethod
    def is_real(step: Measured) -> bool:
        return step.value > max(PLAY_LEAST_DEG, PLAY_SIGMAS * step.error)
