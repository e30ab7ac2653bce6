"""A picture of a trajectory: angle, speed and acceleration of every joint, with their limits.

Above them stands what happens in the show: keyframes, holds, anchors and events.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.planning.picture import Instant, Timeline, draw_curve, new_figure, save, with_room
from lss_motion.planning.trajectory.playlist import all_cues, all_marks
from lss_motion.planning.trajectory.torques import torque_curves

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.show.model import Cue

    FloatArray = NDArray[np.float64]

SAMPLES_MAX: Final = 120_000
"""Samples of each curve. Chosen: 5 ms apart in a show of ten minutes, so that no peak is missed."""

LONG_S: Final = 60.0
"""A longer show has a wider picture, most of it for the angles."""

PASSES_SHOWN: Final = 3
"""Passes that are shown of a loop without end."""

ROW_HEIGHT_IN: Final = 1.5
"""Height of a joint's row; many joints get lower rows, down to `ROW_HEIGHT_MIN_IN`."""

ROW_HEIGHT_MIN_IN: Final = 0.95
WIDTH_IN: Final = 16.0
WIDE_IN: Final = 26.0
TIMELINE_ROW_IN: Final = 0.3
SOUND_ROW_IN: Final = 0.8
SOUNDS_MAX: Final = 30
"""Sounds that are drawn; each file is read for it. Chosen."""
ANGLE_SHARE: Final = 0.9
"""Of the width of a column, what the labels of its axes leave."""
ANNOTATED_MIN_S: Final = 0.01
"""A span that is slowed by less is shaded but not annotated."""

SPAN_SHARE_MIN: Final = 0.001
"""Least width of a shaded span: a pixel or two."""

TITLES: Final = ("angle, deg", "speed, deg/s", "acceleration, deg/s²", "torque of servo, N·m")
PLANNED, HORN, LIMIT, LATE = "#1f5fa8", "#e0701a", "#c0392b", "#f6c344"
"""Colours: the plan, measured horn angles, limits, slowed spans."""

ASKED: Final = "#3f9b5b"
"""Colour of the angles that the author asks for, where the plan gives up angle."""


def plot(
    trajectory: Trajectory,
    robot: Robot,
    path: Path,
    *,
    horn: tuple[FloatArray, FloatArray] | None = None,
    beats_s: Sequence[float] = (),
) -> None:
    """Draw the trajectory into `path`; the suffix chooses the kind of picture.

    A robot with masses has a column more: the torque of the servo of each joint.
    `horn` adds measured horn angles: times in s, and degrees, (n, joints), in the order of
    `trajectory.joints`. `beats_s` are those of one pass, drawn over the sounds of the show.
    Raises `InputError` for a suffix that cannot be drawn, a file that cannot be written, and a
    wrong URDF file of the robot.
    """
    count = len(trajectory.joints)
    end_s = _shown_s(trajectory)
    timeline = timeline_of(trajectory, end_s)
    row_in = max(ROW_HEIGHT_MIN_IN, min(ROW_HEIGHT_IN, 16.0 / count))
    top_in = TIMELINE_ROW_IN * timeline.rows + 0.2
    width_in, share = (WIDE_IN, 2.4) if end_s > LONG_S else (WIDTH_IN, 1.6)
    times_s, curves = _curves(trajectory, end_s)
    torques = torque_curves(trajectory, robot, times_s)
    columns = len(TITLES) - (torques is None)
    angle_in = ANGLE_SHARE * width_in * share / (share + columns - 1.0)
    sounds = [cue for cue in all_cues(trajectory, end_s) if cue.sound]
    sound_in = [SOUND_ROW_IN] * bool(sounds or beats_s)
    figure = new_figure(path, width_in, 1.2 + top_in + sum(sound_in) + row_in * max(count, 2))
    axes = figure.subplots(
        count + 1 + len(sound_in),
        columns,
        sharex=True,
        squeeze=False,
        height_ratios=[top_in, *sound_in, *([row_in] * count)],
        width_ratios=[share, *([1.0] * (columns - 1))],
    )
    axes[0][0].set_xlim(-0.01 * end_s, 1.01 * end_s)
    for axis in axes[: 1 + len(sound_in)].flat:
        axis.axis("off")
    if sound_in:
        beats = all_beats(trajectory, beats_s, end_s)
        _sounds(axes[1][0], sounds, beats, (end_s, angle_in))
        axes = np.delete(axes, 1, axis=0)
    if timeline.rows:
        axes[0][0].axis("on")
        timeline.draw(axes[0][0], angle_in)
    for row, name in enumerate(trajectory.joints):
        values = [curve[:, row] for curve in curves]
        own_horn = None if horn is None else (horn[0], horn[1][:, row])
        _row(axes[row + 1], robot.joints[name], times_s, values, own_horn)
        if torques is not None:
            _torque(axes[row + 1][3], times_s, torques[name])
        _asked(axes[row + 1][0], trajectory, row)
        for axis in axes[row + 1]:
            timeline.draw_lines(axis)
            _spans(axis, trajectory, end_s)
        _notes(axes[row + 1][0], trajectory, name, (end_s / angle_in, end_s))
    handles = _legend(
        trajectory,
        timeline,
        has_horn=horn is not None,
        has_sound=bool(sounds),
        has_beats=bool(beats_s),
    )
    _titles(figure, axes, _headline(trajectory), handles)
    save(figure, path)


def _titles(figure: Any, axes: Any, headline: str, handles: list[Any]) -> None:  # noqa: ANN401
    """Write the headline, the legend, the titles of the columns, and the unit of time below."""
    figure.suptitle(headline, fontsize=11, x=0.01, ha="left")
    figure.legend(handles=handles, loc="upper right", ncols=9, fontsize=8, frameon=False)
    for axis, title in zip(axes[1], TITLES, strict=False):
        axis.set_title(title, fontsize=10, loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("s", fontsize=8)


def timeline_of(trajectory: Trajectory, end_s: float) -> Timeline:
    """Return keyframes, anchors, holds and events of every pass until `end_s`."""
    marks = all_marks(trajectory, end_s)
    return Timeline(
        keyframes=tuple(Instant(m.planned_s, m.label) for m in marks if not m.is_anchor),
        anchors=tuple(Instant(m.planned_s, m.label) for m in marks if m.is_anchor),
        holds_s=tuple((m.planned_s, m.planned_s + m.held_s) for m in marks if m.held_s > 0.0),
        events=tuple(Instant(cue.at_s, cue.text) for cue in all_cues(trajectory, end_s)),
    )


def _shown_s(trajectory: Trajectory) -> float:
    if trajectory.loop is None:
        return trajectory.pass_start_s(PASSES_SHOWN)
    return trajectory.duration_s


def _curves(trajectory: Trajectory, end_s: float) -> tuple[FloatArray, list[FloatArray]]:
    """Return instants, and angle, speed and acceleration there."""
    count = int(min(SAMPLES_MAX, max(2, end_s * 500.0)))
    times_s = np.linspace(0.0, end_s, count)
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
    for axis, value, (low, high) in zip(axes[: len(values)], values, bounds, strict=True):
        _panel(axis)
        draw_curve(axis, times_s, value, PLANNED)
        for limit in (low, high):
            # A range limit far away would flatten the angle curve, and is left out.
            shown = axis.get_ylim()
            if axis is not axes[0] or shown[0] <= limit <= shown[1]:
                axis.axhline(limit, color=LIMIT, linewidth=0.8, linestyle=(0, (5, 3)))
    if horn is not None:
        draw_curve(axes[0], *horn, HORN)
    axes[0].set_ylabel(joint.name, fontsize=9, fontweight="bold")


def _panel(axis: Any) -> None:  # noqa: ANN401  matplotlib is untyped here
    axis.grid(visible=True, color="#e6e9ec", linewidth=0.6)
    axis.tick_params(labelsize=7)
    axis.margins(y=0.12)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def _torque(
    axis: Any,  # noqa: ANN401  as above
    times_s: FloatArray,
    values: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    """Draw the torque of a servo, and between which torques it can give any at its speed."""
    torque, *ends = values
    _panel(axis)
    draw_curve(axis, times_s, torque, PLANNED)
    for end in ends:
        if np.isfinite(end).all():
            draw_curve(axis, times_s, end, LIMIT)


def _asked(axis: Any, trajectory: Trajectory, row: int) -> None:  # noqa: ANN401  as above
    """Draw what the author asks for where the joint gives up angle, and shade what it gives up."""
    for span in trajectory.asked:
        if span.joint == trajectory.joints[row]:
            times_s = np.linspace(span.from_s, span.to_s, len(span.deg))
            axis.plot(times_s, span.deg, color=ASKED, linewidth=0.9, linestyle=(0, (3, 1.5)))
            given_deg = trajectory.sample(times_s)[:, row]
            axis.fill_between(times_s, span.deg, given_deg, color=ASKED, alpha=0.2, linewidth=0)


def all_beats(trajectory: Trajectory, beats_s: Sequence[float], end_s: float) -> FloatArray:
    """Return the beats of every pass until `end_s`."""
    own_s = np.asarray(beats_s, dtype=np.float64)
    found, start_s, index = [np.zeros(0)], 0.0, 0
    while len(own_s) and start_s < end_s and (trajectory.loop is None or index < trajectory.loop):
        length_s = trajectory.pass_start_s(index + 1) - start_s
        found.append(start_s + own_s[own_s <= max(length_s, 0.0)])
        if length_s <= 0.0:
            break
        index, start_s = index + 1, start_s + length_s
    return np.concatenate(found)


def _sounds(
    axis: Any,  # noqa: ANN401
    cues: Sequence[Cue],
    beats_s: FloatArray,
    size: tuple[float, float],
) -> None:
    """Draw the sounds of the show with their loudness, and its beats over them.

    `size` is how long the show is, and how wide the axes are in inches.
    """
    from lss_motion.sound.envelope import draw_beats, draw_waveform, waveform
    from lss_motion.sound.files import SoundPart

    axis.axis("on")
    end_s, width_in = size
    problems = []
    for cue in cues[:SOUNDS_MAX]:
        lasts_s = min(cue.style.lasts_s or np.inf, end_s - cue.at_s)
        if lasts_s <= 0.0:
            continue
        ratio = cue.style.speed_ratio
        try:
            wave = waveform(SoundPart(path=Path(cue.sound), to_s=lasts_s * ratio))
        except InputError as error:
            problems.append(f"{Path(cue.sound).name} is not drawn: {error.reason}")
            continue
        draw_waveform(axis, wave, cue.at_s, ratio)
    draw_beats(axis, beats_s, (0.0, end_s), width_in)
    for number, text in enumerate(dict.fromkeys(problems)):
        axis.text(
            0.0,
            0.8 - 0.2 * number,
            text,
            transform=axis.transAxes,
            fontsize=7,
            color=LIMIT,
            parse_math=False,
        )
    axis.set_yticks([])
    axis.set_ylabel("sound", fontsize=8)
    axis.tick_params(axis="x", labelbottom=False, length=0)
    for side in ("top", "right", "bottom", "left"):
        axis.spines[side].set_visible(False)


def _spans(axis: Any, trajectory: Trajectory, end_s: float) -> None:  # noqa: ANN401  as above
    """Shade the spans that are slowed; in a long show they are drawn wide enough to be seen."""
    axis.broken_barh(
        [
            (span.from_s, max(span.to_s - span.from_s, SPAN_SHARE_MIN * end_s))
            for span in trajectory.stretched
        ],
        (0.0, 1.0),
        transform=axis.get_xaxis_transform(),
        color=LATE,
        alpha=0.3,
        linewidth=0,
        zorder=0.4,
    )


def _notes(axis: Any, trajectory: Trajectory, joint: str, room_s: tuple[float, float]) -> None:  # noqa: ANN401
    """Say by how much spans are slowed because of the joint, as far as there is room."""
    notes = [
        Instant(span.from_s, f"+{span.by_s:.2f} s: {span.limit}")
        for span in trajectory.stretched
        if span.joint == joint and span.by_s >= ANNOTATED_MIN_S
    ]
    for note in with_room(notes, *room_s):
        axis.annotate(
            note.text,
            (note.at_s, 0.03),
            xycoords=("data", "axes fraction"),
            fontsize=7,
            color="#8a5a00",
            xytext=(2, 0),
            textcoords="offset points",
        )


def _headline(trajectory: Trajectory) -> str:
    length = "without end" if trajectory.loop is None else f"{trajectory.duration_s:.3f} s"
    lost_s = sum(stretch.by_s for stretch in trajectory.stretched)
    late = f", spans slowed by {lost_s:.3f} s in all" if lost_s > 0.0005 else ""
    by_deg = max((span.by_deg for span in trajectory.given_up), default=0.0)
    given_up = f", up to {by_deg:.1f} deg given up to keep the time" if by_deg > 0.0 else ""
    return f"{trajectory.name}: {length}{late}{given_up}"


def _legend(
    trajectory: Trajectory,
    timeline: Timeline,
    *,
    has_horn: bool,
    has_sound: bool,
    has_beats: bool,
) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from lss_motion.sound.envelope import BEAT, LEVEL

    handles: list[Any] = [Line2D([], [], color=PLANNED, label="plan")]
    if has_horn:
        handles.append(Line2D([], [], color=HORN, label="horn"))
    if trajectory.asked:
        handles.append(Line2D([], [], color=ASKED, linestyle="--", label="asked"))
        handles.append(Patch(color=ASKED, alpha=0.2, label="given up"))
    handles.append(Line2D([], [], color=LIMIT, linestyle="--", label="limit"))
    handles += timeline.handles()
    if has_sound:
        handles.append(Line2D([], [], color=LEVEL, label="loudness"))
    if has_beats:
        handles.append(Line2D([], [], color=BEAT, label="beat"))
    if trajectory.stretched:
        handles.append(Patch(color=LATE, alpha=0.3, label="stretched"))
    return handles
