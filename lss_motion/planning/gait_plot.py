"""A picture of a gait: paths from above, steps over time, and the stability margin."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from lss_motion.planning.picture import new_figure, save
from lss_motion.show.gait.pacing import looped_s
from lss_motion.show.splines import runs

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.show.gait.kinematics import Stance
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced

    FloatArray = NDArray[np.float64]

SAMPLES_PER_S: Final = 200
SAMPLES_MAX: Final = 20_000
SNAPSHOTS: Final = 6
"""How often body and standing feet are drawn along a walk."""

BODY, LEFT, RIGHT, GROUND, UNSAFE = "#1f5fa8", "#2a9d6f", "#e0701a", "#9aa5b1", "#c0392b"
"""Colours of the body, the legs of either side, the ground, and a negative margin."""


def plot_gait(gait: Gait, passages: tuple[Paced, ...], path: Path) -> None:
    """Draw the gait into `path`; its suffix selects the kind of picture.

    From above: body and feet over the ground, every walk from its own start. Over time: bars while
    feet stand, the height of each foot, and the margin (`Stance.margin_mm`). Raises `InputError`
    for a suffix that cannot be drawn or a file that cannot be written.
    """
    figure = new_figure(path, 14.0, 8.0)
    shapes = figure.subplot_mosaic(
        [["above", "diagram"], ["above", "height"], ["above", "margin"]],
        width_ratios=[1.0, 1.2],
        height_ratios=[1.3, 1.0, 1.0],
    )
    samples = [_sample(part) for part in passages]
    _draw_from_above(shapes["above"], gait, samples)
    starts_s = np.cumsum([0.0, *(part.duration_s + part.hold_s for part in passages)])
    for start_s, sample in zip(starts_s.tolist(), samples, strict=False):
        _draw_over_time(shapes, gait, start_s, sample)
    _label_axes(shapes, gait)
    is_looped = any(looped_s(gait, part) > 0.0 for part in passages)
    looped = ", the cycles that are looped drawn once" if is_looped else ""
    figure.suptitle(f"{gait.name}: {gait.pattern.name}{looped}", fontsize=11, x=0.01, ha="left")
    save(figure, path)


class _Sample(Struct, frozen=True):
    times_s: FloatArray
    stance: Stance
    margin_mm: FloatArray


def _sample(part: Paced) -> _Sample:
    count = int(min(SAMPLES_MAX, max(2, part.duration_s * SAMPLES_PER_S)))
    times_s = np.linspace(0.0, part.duration_s, count)
    stance = part.passage.at(times_s / part.pace_ratio)
    return _Sample(times_s, stance, stance.margin_mm())


def _draw_from_above(axis: Any, gait: Gait, samples: list[_Sample]) -> None:  # noqa: ANN401  matplotlib
    """Draw the paths from above, with forward up."""
    for sample in samples:
        stance = sample.stance
        for foot, colour in zip(np.moveaxis(stance.feet_mm, 1, 0), _colours(gait), strict=True):
            axis.plot(-foot[:, 1], foot[:, 0], color=colour, linewidth=0.8, alpha=0.7)
        centre = stance.centre_mm()
        axis.plot(-centre[:, 1], centre[:, 0], color=BODY, linewidth=1.6)
        snapshots = 1 if stance.is_down.all() else SNAPSHOTS
        for index in np.linspace(0, len(centre) - 1, snapshots).astype(int).tolist():
            _draw_snapshot(axis, gait, stance, centre, index)
    axis.set_aspect("equal")


def _draw_snapshot(axis: Any, gait: Gait, stance: Stance, centre: FloatArray, index: int) -> None:  # noqa: ANN401
    """Draw the hips and the polygon of the feet that stand."""
    heading = stance.places[index, 2] + np.radians(stance.tilt_deg[index, 2])
    cosine, sine = np.cos(heading), np.sin(heading)
    hips = np.array([leg.hip_mm for leg in gait.legs])
    # Left legs front to rear, then right legs rear to front: once around the body.
    half = len(hips) // 2
    hips = hips[[*range(half), *range(len(hips) - 1, half - 1, -1), 0]]
    turned = centre[index] + hips @ np.array([[cosine, sine], [-sine, cosine]])
    axis.plot(-turned[:, 1], turned[:, 0], color=BODY, linewidth=0.8, alpha=0.5)
    feet = stance.feet_mm[index, stance.is_down[index], :2]
    around = np.argsort(np.arctan2(*(feet - centre[index]).T))
    feet = feet[[*around, around[0]]]
    axis.fill(-feet[:, 1], feet[:, 0], color=GROUND, alpha=0.12, linewidth=0)
    axis.plot(-feet[:, 1], feet[:, 0], color=GROUND, linewidth=0.6, marker="o", markersize=2.5)


def _draw_over_time(shapes: dict[str, Any], gait: Gait, start_s: float, sample: _Sample) -> None:
    times_s = start_s + sample.times_s
    for row, (leg, colour) in enumerate(zip(gait.legs, _colours(gait), strict=True)):
        down = sample.stance.is_down[:, row]
        bars = [(times_s[first], times_s[end - 1] - times_s[first]) for first, end in runs(down)]
        shapes["diagram"].broken_barh(bars, (row - 0.35, 0.7), color=colour)
        shapes["height"].plot(
            times_s,
            sample.stance.feet_mm[:, row, 2],
            color=colour,
            linewidth=1.0,
            label=leg.name,
        )
    margin_mm = sample.margin_mm
    shapes["margin"].plot(times_s, margin_mm, color=BODY, linewidth=1.2)
    shapes["margin"].fill_between(times_s, margin_mm, 0.0, margin_mm < 0, color=UNSAFE, alpha=0.4)


def _label_axes(shapes: dict[str, Any], gait: Gait) -> None:
    titles = {
        "above": "from above, mm: the body, its feet, the polygons that carry it",
        "diagram": "feet on the ground",
        "height": "height of the feet, mm",
        "margin": "margin of the body's centre to the edge of its feet, mm",
    }
    for name, axis in shapes.items():
        axis.set_title(titles[name], fontsize=10, loc="left")
        axis.grid(visible=True, color="#e6e9ec", linewidth=0.6)
        axis.tick_params(labelsize=8)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
    shapes["diagram"].set_yticks(range(len(gait.legs)), [leg.name for leg in gait.legs])
    shapes["diagram"].invert_yaxis()
    shapes["margin"].axhline(0.0, color=UNSAFE, linewidth=0.8, linestyle=(0, (5, 3)))
    shapes["margin"].set_xlabel("s", fontsize=8)
    for name in ("height", "margin"):
        shapes[name].sharex(shapes["diagram"])


def _colours(gait: Gait) -> list[str]:
    return [LEFT if leg.hip_mm[1] > 0.0 else RIGHT for leg in gait.legs]
