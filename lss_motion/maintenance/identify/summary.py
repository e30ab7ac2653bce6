"""The result of an identification as text, and as fields of the robot file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.maintenance.identify.response_fit import (
    HYPOTHESES,
    LAG_LEAST_S,
    Shape,
    horn_deg,
)
from lss_motion.maintenance.identify.trials import Kind
from lss_motion.units import MS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.maintenance.identify.estimate import Identified
    from lss_motion.maintenance.identify.response_fit import Measured
    from lss_motion.maintenance.identify.trials import Recording
    from lss_motion.robot.model import Joint


SIGMAS: Final = 3.0
"""A difference of fewer standard errors counts as none."""
TIME_DIFFERENCE_S: Final = 0.001
RAMP_DIFFERENCE_RATIO: Final = 0.03
DROOP_DIFFERENCE_DEG: Final = 0.3
"""Smaller differences from the assumed values do not matter for playing."""
MISFIT_RATIO: Final = 1.3
MISFIT_LEAST_DEG: Final = 0.02
MODEL_POINTS: Final = 120
"""Points of the model in a plot: one every four pixels."""
"""A residual beyond this was not noise."""


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


class Series(Struct, frozen=True):
    """Points of one line of a plot."""

    name: str
    x: Sequence[float]
    y: Sequence[float]


class Plot(Struct, frozen=True):
    """What a page draws of a result."""

    title: str
    x_name: str
    y_name: str
    series: tuple[Series, ...]


def plots(found: Identified, joint: Joint, recording: Recording) -> list[Plot]:
    """Return a step as it was read beside the model of it, and the pull of the load over the angle.

    The step is the longest way of the recording. The model has the mean delay for its command, and
    begins where the readings do: what the load does to the horn is in the other plot.
    """
    steps = [trial for trial in recording.trials if trial.kind is Kind.STEP and trial.sent]
    pull = Plot(
        title="how far the load pulls it",
        x_name=f"{joint.name}, deg",
        y_name="deg",
        series=(
            Series(
                "load",
                (found.low_deg, 0.5 * (found.low_deg + found.high_deg), found.high_deg),
                found.droop_deg,
            ),
        ),
    )
    if not steps:
        return [pull]
    step = max(steps, key=lambda trial: abs(trial.sent[-1].target_deg - trial.start_deg))
    shape = Shape(
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
    return [
        Plot(
            title="a step",
            x_name="s",
            y_name=f"{joint.name}, deg",
            series=(
                Series("read", step.times_s, [joint.joint_deg(deg) for deg in step.readings_deg]),
                Series(
                    "model",
                    times_s.tolist(),
                    [joint.joint_deg(deg + shift_deg) for deg in model.tolist()],
                ),
            ),
        ),
        pull,
    ]


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
