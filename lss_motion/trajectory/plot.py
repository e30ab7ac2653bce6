"""A picture of a trajectory: angle, speed and acceleration of every joint, with their limits."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.picture import new_figure, save

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint, Robot
    from lss_motion.trajectory.model import Trajectory

    FloatArray = NDArray[np.float64]

SAMPLES_MAX: Final = 20_000
"""Samples of each curve. Chosen: several for every pixel of a wide picture."""

PASSES_SHOWN: Final = 3
"""Passes that are shown of a loop without end."""

ROW_HEIGHT_IN: Final = 1.5
"""Height of a joint's row; many joints get lower rows, down to `ROW_HEIGHT_MIN_IN`."""

ROW_HEIGHT_MIN_IN: Final = 0.95
WIDTH_IN: Final = 15.0
ANNOTATED_MIN_S: Final = 0.01
"""A span that is slowed by less is shaded but not annotated."""

LABELS_MAX: Final = 24
"""More keyframe labels than this would overlap; then only the lines are drawn."""

PLANNED, HORN, LIMIT, LATE, MARK = "#1f5fa8", "#e0701a", "#c0392b", "#f6c344", "#9aa5b1"
"""Colours: the plan, measured horn angles, limits, slowed spans, keyframes."""

ASKED: Final = "#3f9b5b"
"""Colour of the angles that the author asks for, where the plan gives up angle."""


def plot(
    trajectory: Trajectory,
    robot: Robot,
    path: Path,
    *,
    horn: tuple[FloatArray, FloatArray] | None = None,
) -> None:
    """Draw the trajectory into `path`; the suffix chooses the kind of picture.

    `horn` adds measured horn angles: times in s, and degrees, (n, joints), in the order of
    `trajectory.joints`.
    Raises `InputError` for a suffix that cannot be drawn or a file that cannot be written.
    """
    count = len(trajectory.joints)
    row_in = max(ROW_HEIGHT_MIN_IN, min(ROW_HEIGHT_IN, 16.0 / count))
    figure = new_figure(path, WIDTH_IN, 1.3 + row_in * max(count, 2))
    axes = figure.subplots(count, 3, sharex=True, squeeze=False)
    times_s, curves = _curves(trajectory)
    for row, name in enumerate(trajectory.joints):
        values = [curve[:, row] for curve in curves]
        own_horn = None if horn is None else (horn[0], horn[1][:, row])
        _row(axes[row], robot.joints[name], times_s, values, own_horn)
        _asked(axes[row][0], trajectory, name)
    for axis in axes.flat:
        _spans(axis, trajectory)
    for axis, title in zip(
        axes[0], ("angle, deg", "speed, deg/s", "acceleration, deg/s²"), strict=True
    ):
        axis.set_title(title, fontsize=10, loc="left", pad=22 if _labels(trajectory) else 6)
    for axis in axes[-1]:
        axis.set_xlabel("s", fontsize=8)
    for mark in _labels(trajectory):
        axes[0][0].annotate(
            mark[1],
            (mark[0], 1.0),
            xycoords=("data", "axes fraction"),
            rotation=35,
            fontsize=7,
            color="#4a5560",
            xytext=(0, 2),
            textcoords="offset points",
        )
    figure.suptitle(_headline(trajectory), fontsize=11, x=0.01, ha="left")
    figure.legend(
        handles=_legend(trajectory, has_horn=horn is not None),
        loc="upper right",
        ncols=6,
        fontsize=8,
        frameon=False,
    )
    save(figure, path)


def _shown_s(trajectory: Trajectory) -> float:
    if trajectory.loop is None:
        return trajectory.pass_start_s(PASSES_SHOWN)
    return trajectory.duration_s


def _curves(trajectory: Trajectory) -> tuple[FloatArray, list[FloatArray]]:
    """Return instants, and angle, speed and acceleration there."""
    end_s = _shown_s(trajectory)
    times_s = np.linspace(0.0, end_s, int(min(SAMPLES_MAX, max(2, end_s * 500.0))))
    return times_s, [trajectory.sample(times_s, order) for order in (0, 1, 2)]


def _row(
    axes: Any,  # noqa: ANN401  matplotlib is untyped here
    joint: Joint,
    times_s: FloatArray,
    values: list[FloatArray],
    horn: tuple[FloatArray, FloatArray] | None,
) -> None:
    speed, accel = joint.speed_max_deg_s, joint.accel_max_deg_s2
    bounds = ((joint.position_min_deg, joint.position_max_deg), (-speed, speed), (-accel, accel))
    for axis, value, (low, high) in zip(axes, values, bounds, strict=True):
        axis.plot(times_s, value, color=PLANNED, linewidth=1.2)
        axis.grid(visible=True, color="#e6e9ec", linewidth=0.6)
        axis.tick_params(labelsize=7)
        axis.margins(x=0.01, y=0.12)
        for side in ("top", "right"):
            axis.spines[side].set_visible(False)
        for limit in (low, high):
            # A range limit far away would flatten the angle curve, and is left out.
            shown = axis.get_ylim()
            if axis is not axes[0] or shown[0] <= limit <= shown[1]:
                axis.axhline(limit, color=LIMIT, linewidth=0.8, linestyle=(0, (5, 3)))
    if horn is not None:
        axes[0].plot(*horn, color=HORN, linewidth=1.0, alpha=0.9)
    axes[0].set_ylabel(joint.name, fontsize=9, fontweight="bold")


def _asked(axis: Any, trajectory: Trajectory, joint: str) -> None:  # noqa: ANN401  as above
    """Draw what the author asks for where the joint gives up angle."""
    for span in trajectory.asked:
        if span.joint == joint:
            times_s = np.linspace(span.from_s, span.to_s, len(span.deg))
            axis.plot(times_s, span.deg, color=ASKED, linewidth=0.9, linestyle=(0, (3, 1.5)))


def _spans(axis: Any, trajectory: Trajectory) -> None:  # noqa: ANN401  matplotlib is untyped here
    for mark in trajectory.marks:
        axis.axvline(mark.planned_s, color=MARK, linewidth=1.1 if mark.is_anchor else 0.5)
    for stretch in trajectory.stretched:
        axis.axvspan(stretch.from_s, stretch.to_s, color=LATE, alpha=0.3, linewidth=0)
        is_own = axis.get_ylabel() == stretch.joint
        if is_own and stretch.by_s >= ANNOTATED_MIN_S:
            axis.annotate(
                f"+{stretch.by_s:.2f} s: {stretch.limit}",
                (stretch.from_s, 0.03),
                xycoords=("data", "axes fraction"),
                fontsize=7,
                color="#8a5a00",
                xytext=(2, 0),
                textcoords="offset points",
            )


def _labels(trajectory: Trajectory) -> list[tuple[float, str]]:
    found = [(mark.planned_s, mark.label) for mark in trajectory.marks if mark.label]
    return found if len(found) <= LABELS_MAX else []


def _headline(trajectory: Trajectory) -> str:
    length = "without end" if trajectory.loop is None else f"{trajectory.duration_s:.3f} s"
    lost_s = sum(stretch.by_s for stretch in trajectory.stretched)
    late = f", {lost_s:.3f} s slower than authored" if lost_s > 0.0 else ""
    by_deg = max((span.by_deg for span in trajectory.given_up), default=0.0)
    given_up = f", up to {by_deg:.1f} deg given up to keep the time" if by_deg > 0.0 else ""
    return f"{trajectory.name}: {length}{late}{given_up}"


def _legend(trajectory: Trajectory, *, has_horn: bool) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [Line2D([], [], color=PLANNED, label="plan")]
    if has_horn:
        handles.append(Line2D([], [], color=HORN, label="horn"))
    if trajectory.asked:
        handles.append(Line2D([], [], color=ASKED, linestyle="--", label="asked"))
    handles.append(Line2D([], [], color=LIMIT, linestyle="--", label="limit"))
    handles.append(Line2D([], [], color=MARK, label="keyframe"))
    if trajectory.stretched:
        handles.append(Patch(color=LATE, alpha=0.3, label="stretched"))
    return handles
