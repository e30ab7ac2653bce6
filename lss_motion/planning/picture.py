"""Figures of matplotlib without a screen: made for a file, with errors for people.

`draw_curve` and `Timeline` keep pictures of long shows readable and quick: a curve is drawn as the
least and largest value of each column of pixels, and what happens in a show is drawn as one
collection, with as many texts as there is room for. `plot_gait` draws a gait: paths from above,
steps over time, and the stability margin.

Used by `planning.trajectory.plot` and the commands. matplotlib is imported when a figure is made.
"""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.output import write_output
from lss_motion.show.gait.pacing import looped_s
from lss_motion.show.splines import runs

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

    from numpy.typing import NDArray

    from lss_motion.show.gait.kinematics import Stance
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced


DPI: Final = 110
"""Chosen: text is readable at full size on a screen."""

COLUMNS: Final = 1200
"""Columns of a curve: about the pixels of the widest axes."""

LINES_MAX: Final = 120
"""More keyframes than this have no line through all curves; they would be a grey area."""

CHAR_IN: Final = 0.06
"""Width of a letter of a small text (measured: 0.05 to 0.06)."""

TEXT_MAX_CHARS: Final = 24

KEYFRAME, ANCHOR, HOLD, EVENT = "#9aa5b1", "#7d3c98", "#b9d3ee", "#117a65"
TEXT: Final = "#4a5560"
"""Colours of what happens in a show."""


def new_figure(path: Path, width_in: float, height_in: float) -> Figure:
    """Return an empty figure for `path`; raises `InputError` if its suffix cannot be drawn."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    kinds = FigureCanvasAgg(figure).get_supported_filetypes()
    if path.suffix.lstrip(".").lower() not in kinds:
        allowed = ", ".join(f".{kind}" for kind in sorted(kinds))
        raise InputError(
            f"cannot draw {path.suffix or 'a file without suffix'}: use {allowed}", path=path
        )
    return figure


def envelope(
    times_s: FloatArray, values: FloatArray, columns: int = COLUMNS
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the middle, the least and the largest value of each of `columns` equal spans of time.

    Spans without a sample are left out. Neighbours share a sample, so that a curve has no gaps.
    """
    edges_s = np.linspace(times_s[0], times_s[-1], columns + 1)
    starts = np.unique(np.searchsorted(times_s, edges_s[:-1], side="left"))
    starts = starts[starts < len(times_s)]
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    ends = np.append(starts[1:], len(times_s) - 1)
    low, high = np.minimum(low, values[ends]), np.maximum(high, values[ends])
    return 0.5 * (times_s[starts] + times_s[ends]), low, high


def draw_curve(axis: Any, times_s: FloatArray, values: FloatArray, color: str) -> None:  # noqa: ANN401
    """Draw a curve; one with many samples as the area that it covers in each column of pixels."""
    times_s, values = np.asarray(times_s, dtype=np.float64), np.asarray(values, dtype=np.float64)
    if len(times_s) <= 4 * COLUMNS:
        axis.plot(times_s, values, color=color, linewidth=1.1)
        return
    at_s, low, high = envelope(times_s, values)
    axis.fill_between(at_s, low, high, color=color, linewidth=0.8)


class Instant(Struct, frozen=True):
    """Something that happens at a time of a show, with the text that stands there."""

    at_s: float
    text: str = ""


class Timeline(Struct, frozen=True):
    """What happens in a show: keyframes, anchors, holds (from, to) and events."""

    keyframes: tuple[Instant, ...] = ()
    anchors: tuple[Instant, ...] = ()
    holds_s: tuple[tuple[float, float], ...] = ()
    events: tuple[Instant, ...] = ()

    @property
    def rows(self) -> int:
        """Rows of `draw`: keyframes and holds, anchors, events; those that there are."""
        return sum(map(bool, (self.keyframes or self.holds_s, self.anchors, self.events)))

    def draw(self, axis: Any, width_in: float) -> None:  # noqa: ANN401  matplotlib is untyped here
        """Draw a row for keyframes and holds, one for anchors and one for events.

        `width_in` is the width of the axes: it says how much room there is for texts.
        """
        names, row = [], 0
        for name, instants, color, marker in (
            ("keyframes", self.keyframes, KEYFRAME, "|"),
            ("anchors", self.anchors, ANCHOR, "v"),
            ("events", self.events, EVENT, "D"),
        ):
            holds_s = self.holds_s if name == "keyframes" else ()
            if not instants and not holds_s:
                continue
            y = -float(row)
            axis.broken_barh([(a, b - a) for a, b in holds_s], (y - 0.3, 0.6), color=HOLD)
            at_s = [instant.at_s for instant in instants]
            axis.plot(at_s, [y] * len(at_s), marker, color=color, markersize=4.0)
            self._texts(axis, instants, y, width_in)
            names.append(f"{name} ({len(instants)})")
            row += 1
        axis.set_yticks([-float(k) for k in range(row)], names, fontsize=7)
        axis.set_ylim(-row + 0.5, 1.0)
        axis.tick_params(axis="x", labelbottom=False, length=0)
        for side in ("top", "right", "bottom"):
            axis.spines[side].set_visible(False)

    def _texts(self, axis: Any, instants: tuple[Instant, ...], y: float, width_in: float) -> None:  # noqa: ANN401
        """Write the texts beside their instants, each only where the one before has ended."""
        from_s, to_s = axis.get_xlim()
        for instant in with_room(instants, (to_s - from_s) / width_in, to_s):
            axis.text(
                instant.at_s,
                y + 0.2,
                f" {instant.text}",
                fontsize=7,
                color=TEXT,
                clip_on=True,
                parse_math=False,
            )

    def draw_lines(self, axis: Any) -> None:  # noqa: ANN401  matplotlib is untyped here
        """Draw lines through a curve: at anchors, at events, and at keyframes if they are few."""
        if len(self.keyframes) <= LINES_MAX:
            _lines(axis, self.keyframes, KEYFRAME, 0.5)
            for from_s, to_s in self.holds_s:
                axis.axvspan(from_s, to_s, color=HOLD, alpha=0.35, linewidth=0)
        _lines(axis, self.anchors, ANCHOR, 0.9)
        if len(self.events) <= LINES_MAX:
            _lines(axis, self.events, EVENT, 0.5)

    def handles(self) -> list[Any]:
        """Return the legend of the lines."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        found: list[Any] = []
        for name, is_there, color in (
            ("keyframe", self.keyframes, KEYFRAME),
            ("anchor", self.anchors, ANCHOR),
            ("event", self.events, EVENT),
        ):
            if is_there:
                found.append(Line2D([], [], color=color, label=name))
        if self.holds_s:
            found.append(Patch(color=HOLD, label="hold"))
        return found


def with_room(instants: Iterable[Instant], s_per_in: float, end_s: float) -> Iterator[Instant]:
    """Yield the instants whose text has room behind that of the one before, and until `end_s`."""
    free_s = -np.inf
    for instant in sorted(instants, key=lambda instant: instant.at_s):
        text = instant.text
        if len(text) > TEXT_MAX_CHARS:
            text = text[: TEXT_MAX_CHARS - 1] + "…"
        until_s = instant.at_s + (len(text) + 1) * CHAR_IN * s_per_in
        if text and instant.at_s >= free_s and until_s <= end_s:
            yield Instant(instant.at_s, text)
            free_s = until_s


def _lines(axis: Any, instants: tuple[Instant, ...], color: str, width: float) -> None:  # noqa: ANN401
    """Draw vertical lines through the axes as one collection."""
    axis.vlines(
        [instant.at_s for instant in instants],
        0.0,
        1.0,
        transform=axis.get_xaxis_transform(),
        color=color,
        linewidth=width,
        zorder=0.5,
    )


def save(figure: Figure, path: Path) -> None:
    """Write the figure; raises `InputError` if the file cannot be written."""
    drawn = io.BytesIO()
    with warnings.catch_warnings():
        # A character that the font does not have is drawn as a box; the warning is no help.
        warnings.simplefilter("ignore")
        figure.savefig(drawn, dpi=DPI, format=path.suffix.lstrip(".").lower())
    write_output(path, drawn.getvalue())


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


class _GaitSample(Struct, frozen=True):
    times_s: FloatArray
    stance: Stance
    margin_mm: FloatArray


def _sample(part: Paced) -> _GaitSample:
    count = int(min(SAMPLES_MAX, max(2, part.duration_s * SAMPLES_PER_S)))
    times_s = np.linspace(0.0, part.duration_s, count)
    stance = part.passage.at(times_s / part.pace_ratio)
    return _GaitSample(times_s, stance, stance.margin_mm())


def _draw_from_above(axis: Any, gait: Gait, samples: list[_GaitSample]) -> None:  # noqa: ANN401  matplotlib
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


def _draw_over_time(
    shapes: dict[str, Any], gait: Gait, start_s: float, sample: _GaitSample
) -> None:
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
