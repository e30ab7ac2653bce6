"""Parameters of a servo from a recording, each with its uncertainty; as text, and as robot keys.

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
    LAG_LEAST_S,
    Measured,
    ModelFit,
    ResponseProblem,
    ResponseShape,
    Rests,
    fallen_deg,
    horn_deg,
)
from lss_motion.maintenance.identify.trials import TrialKind
from lss_motion.playing.remote import schema as m
from lss_motion.units import MS_PER_S

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
NOT_FITTED: Final = (TrialKind.REACH, TrialKind.FAST)
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
    coarse = ResponseProblem(recording, trials, rests, is_coarse=True)
    fits = {hypothesis: coarse.fit(hypothesis) for hypothesis in HYPOTHESES}
    chosen = min(fits.values(), key=lambda fit: fit.misfit_deg)
    best = ResponseProblem(recording, trials, rests).fit(chosen.hypothesis, chosen)
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
    shape = ResponseShape(fit.accel_deg_s2, fit.decel_deg_s2, recording.speed_max_deg_s, fit.lag_s)
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


SIGMAS: Final = 3.0
"""A difference of fewer standard errors counts as none."""
TIME_DIFFERENCE_S: Final = 0.001
RAMP_DIFFERENCE_RATIO: Final = 0.03
DROOP_DIFFERENCE_DEG: Final = 0.3
"""Smaller differences from the assumed values do not matter for playing."""
MISFIT_RATIO: Final = 1.3
MISFIT_LEAST_DEG: Final = 0.02
"""A residual beyond this was not noise."""
MODEL_POINTS: Final = 120
"""Points of the model in a plot: one every four pixels."""


def response_values(found: Identified, joint: Joint) -> dict[str, float | str]:
    """Return the measured fields of `response`.

    `lag_s` is the delay minus half a control loop: playing adds that half, so the sum is right even
    where no loop was found. An undecided law is left out.
    """
    loop_s = joint.response.loop_s if found.loop_s is None else found.loop_s.value
    values: dict[str, float | str] = {
        "lag_s": round(max(0.0, found.delay_s.value - 0.5 * loop_s), 4)
    }
    ratio = ramp_ratio(found, joint.ramp_ratio / joint.response.ramp_ratio)
    if ratio != 1.0 or joint.response.ramp_ratio != 1.0:
        values["ramp_ratio"] = ratio
    if found.loop_s is not None:
        values["loop_s"] = round(loop_s, 5)
    if found.retarget.is_sure:
        values["retarget"] = found.retarget.value
    if found.t_law.is_sure:
        values["t_law"] = found.t_law.value
    return {key: value for key, value in values.items() if key not in found.unsure}


def left_open(found: Identified) -> list[str]:
    """Return the fields of `response` that the readings do not tell."""
    laws = {"retarget": found.retarget, "t_law": found.t_law}
    return [*sorted(found.unsure), *(key for key, law in laws.items() if not law.is_sure)]


def ramp_ratio(found: Identified, stiffness_ratio: float = 1.0) -> float:
    """Return the ratio of the ramps to AA and AD: 1 unless they clearly differ.

    The response model has one ramp for both: the slower one, so that no plan exceeds it. What AS
    makes of the ramps (`stiffness_ratio`) is no part of the ratio.
    """
    ramp, set_deg_s2 = min(found.accel_deg_s2, found.decel_deg_s2), found.ramp_deg_s2
    set_deg_s2 *= stiffness_ratio
    away_deg_s2 = abs(ramp.value - set_deg_s2)
    if away_deg_s2 <= max(RAMP_DIFFERENCE_RATIO * set_deg_s2, SIGMAS * ramp.error):
        return 1.0
    return round(ramp.value / set_deg_s2, 3)


def plots(found: Identified, joint: Joint, recording: Recording) -> tuple[m.Plot, ...]:
    """Return a step as it was read beside the model of it, and the pull of the load over the angle.

    The step is the longest way of the recording. The model has the mean delay for its command, and
    begins where the readings do: what the load does to the horn is in the other plot.
    """
    steps = [trial for trial in recording.trials if trial.kind is TrialKind.STEP and trial.sent]
    pull = m.Plot(
        title="how far the load pulls it",
        x_name=f"{joint.name}, deg",
        y_name="deg",
        series=(
            m.PlotSeries(
                name="load",
                x=(found.low_deg, 0.5 * (found.low_deg + found.high_deg), found.high_deg),
                y=found.droop_deg,
            ),
        ),
    )
    if not steps:
        return (pull,)
    step = max(steps, key=lambda trial: abs(trial.sent[-1].target_deg - trial.start_deg))
    shape = ResponseShape(
        found.accel_deg_s2.value,
        found.decel_deg_s2.value,
        found.speed_max_deg_s,
        max(found.lag_s.value, LAG_LEAST_S),
    )
    hypothesis = next(one for one in HYPOTHESES if one == (found.retarget.value, found.t_law.value))
    times_s = np.linspace(0.0, step.times_s[-1], MODEL_POINTS)
    delays_s = [found.dead_s.value] * len(step.sent)
    model, _ = horn_deg(times_s, step.start_deg, step.sent, delays_s, shape, hypothesis)
    shift_deg = step.readings_deg[0] - step.start_deg
    return (
        m.Plot(
            title="a step",
            x_name="s",
            y_name=f"{joint.name}, deg",
            series=(
                m.PlotSeries(
                    name="read",
                    x=tuple(step.times_s),
                    y=tuple(joint.joint_deg(deg) for deg in step.readings_deg),
                ),
                m.PlotSeries(
                    name="model",
                    x=tuple(times_s.tolist()),
                    y=tuple(joint.joint_deg(deg + shift_deg) for deg in model.tolist()),
                ),
            ),
        ),
        pull,
    )


def summary_lines(found: Identified) -> list[str]:
    """Return all that was measured, a line each."""
    loop = "no grid found"
    if found.loop_s is not None:
        loop = f"every {MS_PER_S * found.loop_s.value:.3f} ms"
    least_ms, middle_ms, most_ms = (MS_PER_S * s for s in found.turnaround_s)
    reached = "its top" if found.is_top else "the fastest commanded; its top is higher"
    low, middle, high = found.droop_deg
    retarget = "keeps its speed" if found.retarget.value == "keep_speed" else "starts from rest"
    law = (
        "distance / T, ramps on top" if found.t_law.value == "cruise" else "the whole move takes T"
    )
    return [
        f"{found.joint}: {found.readings} readings between {found.low_deg:.1f} and "
        f"{found.high_deg:.1f} deg, unexplained {found.misfit_deg:.2f} deg, scatter at rest "
        f"{found.noise_deg:.2f} deg",
        f"  answers after       {middle_ms:.2f} ms ({least_ms:.2f} to {most_ms:.2f})",
        f"  command to horn     {_ms(found.delay_s)} on average: lag {_ms(found.lag_s)}, dead time "
        f"{_ms(found.dead_s)}",
        f"  takes commands up   {loop}",
        f"  command in mid-move {retarget}{_doubt(found.retarget.is_sure)}",
        f"  meaning of T        {law}{_doubt(found.t_law.is_sure)}",
        f"  ramps               {_of(found.accel_deg_s2)} up, {_of(found.decel_deg_s2)} down, set "
        f"to {found.ramp_deg_s2:.0f} deg/s²",
        f"  speed               {_of(found.top_deg_s)} deg/s, {reached}",
        f"  load pulls it by    {_deg(low)} deg at {found.low_deg:.0f}, {_deg(middle)} in the "
        f"middle, {_deg(high)} at {found.high_deg:.0f} (± {_deg(found.droop_error_deg)})",
        f"  play                {_deg(found.play_deg.value)} ± {_deg(found.play_deg.error)} deg",
    ]


def difference_lines(found: Identified, joint: Joint) -> list[str]:
    """Return the differences from the robot file, and what to do about each."""
    assumed, lines = joint.response, []
    values = response_values(found, joint)
    lag_s = float(values.get("lag_s", assumed.lag_s))
    if "lag_s" in found.unsure:
        lines.append(f"lag_s is not known well enough (± {MS_PER_S * found.delay_s.error:.0f} ms)")
    elif abs(lag_s - assumed.lag_s) > max(TIME_DIFFERENCE_S, SIGMAS * found.delay_s.error):
        lines.append(
            f"lag_s is {MS_PER_S * lag_s:.1f} ms, not {MS_PER_S * assumed.lag_s:.1f}: moves would "
            f"be that much {'late' if lag_s > assumed.lag_s else 'early'}"
        )
    if found.loop_s is None:
        lines.append(f"no control loop was seen; loop_s stays {MS_PER_S * assumed.loop_s:g} ms")
    elif abs(found.loop_s.value - assumed.loop_s) > 0.02 * assumed.loop_s:
        lines.append(
            f"loop_s is {MS_PER_S * found.loop_s.value:.2f} ms, not {MS_PER_S * assumed.loop_s:g}"
        )
    for key, decided in (("retarget", found.retarget), ("t_law", found.t_law)):
        was = getattr(assumed, key)
        if not decided.is_sure:
            lines.append(f"{key} could not be decided; it stays {was}. Larger moves may help")
        elif decided.value != was:
            lines.append(f"{key} is {decided.value}, not {was}")
    return lines + _limits(found, joint)


def _limits(found: Identified, joint: Joint) -> list[str]:
    """Return where the servo cannot do what the robot file demands."""
    lines = []
    expected_deg_s2 = joint.ramp_ratio * found.ramp_deg_s2
    ramps = {"up (AA)": found.accel_deg_s2, "down (AD)": found.decel_deg_s2}
    if "ramp_ratio" in found.unsure:
        laws = not (found.retarget.is_sure and found.t_law.is_sure)
        without = ", without retarget and t_law" if laws else ""
        lines.append(f"the ramps are not known well enough{without}; ramp_ratio stays")
        ramps = {}
    for name, ramp in ramps.items():
        away_deg_s2 = abs(ramp.value - expected_deg_s2)
        if away_deg_s2 > max(RAMP_DIFFERENCE_RATIO * expected_deg_s2, SIGMAS * ramp.error):
            lines.append(
                f"the ramp {name} is {ramp.value:.0f} deg/s², not {expected_deg_s2:.0f}, where "
                f"{found.ramp_deg_s2:.0f} is set; ramp_ratio stands for the slower of the two"
            )
    if found.is_top:
        lines.append(
            f"it turns at most {found.top_deg_s.value:.0f} deg/s, and speed_max_deg_s asks for "
            f"{joint.speed_max_deg_s:g}; lower it, or check the supply"
        )
    if found.misfit_deg > MISFIT_RATIO * found.noise_deg + MISFIT_LEAST_DEG:
        lines.append(
            f"the model misses by {found.misfit_deg:.2f} deg where readings scatter by "
            f"{found.noise_deg:.2f}: gears that fall to their other side, or a load that swings; "
            f"the errors above are too small"
        )
    droop_deg = max(found.droop_deg, key=abs)
    if abs(droop_deg) > DROOP_DIFFERENCE_DEG:
        lines.append(
            f"its load pulls it by up to {droop_deg:.1f} deg; a stiffer hold (settings: AH) or "
            f"feedback makes up for it"
        )
    return lines


def comment_lines(found: Identified, when: str) -> list[str]:
    """Return the comment above the joint in its robot file: uncertainties and other results."""
    loop = "no loop seen"
    if found.loop_s is not None:
        loop = f"loop {MS_PER_S * found.loop_s.value:.2f} ms"
    top = "top speed" if found.is_top else "top speed above"
    middle = found.droop_deg[1]
    sure = [
        f"{decided.value}{_doubt(decided.is_sure)}" for decided in (found.retarget, found.t_law)
    ]
    return [
        f"{when}: delay {_ms(found.delay_s)} (lag {_ms(found.lag_s)}), {loop},",
        f"{', '.join(sure)}, ramps {_of(found.accel_deg_s2)}, {_of(found.decel_deg_s2)} deg/s² at "
        f"{found.ramp_deg_s2:.0f},",
        f"{top} {found.top_deg_s.value:.0f} deg/s, droop {_deg(middle)} ± "
        f"{_deg(found.droop_error_deg)} deg, play {_deg(found.play_deg.value)} ± "
        f"{_deg(found.play_deg.error)} deg,",
        f"answers after {MS_PER_S * found.turnaround_s[1]:.2f} ms",
    ]


def _doubt(is_sure: bool) -> str:  # noqa: FBT001  (one word)
    return "" if is_sure else " (not sure)"


def _ms(time_s: Measured) -> str:
    return f"{MS_PER_S * time_s.value:.1f} ± {MS_PER_S * time_s.error:.1f} ms"


def _of(number: Measured) -> str:
    """Return a number with its error; that of a number which is no measurement is 0."""
    if not number.error:
        return f"{number.value:.0f}"
    error = f"{number.error:.0f}" if number.error >= 1.0 else f"{number.error:.1g}"
    return f"{number.value:.0f} ± {error}"


def _deg(angle_deg: float) -> str:
    """Return an angle to a hundredth; a rounded 0 has no sign."""
    return f"{round(angle_deg, 2) + 0.0:.2f}"
