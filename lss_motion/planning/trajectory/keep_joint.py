"""One joint that keeps its time: what is asked of it, and the closest motion within its limits.

Around each place over a limit a window is replaced by the closest motion (`closest_spline`). It is
widened until the motion at both of its ends is the one asked for again, so that the result is that
of solving the whole.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.closest_spline import (
    GAUSS_SHARES,
    TIE_SLACK_DEG,
    Bounds,
    Pull,
    Tie,
    Wanted,
    basis,
    closest,
)
from lss_motion.planning.trajectory.curves import shifted
from lss_motion.planning.trajectory.model import AskedSpan, GivenUp, MissedKey
from lss_motion.planning.trajectory.retime import (
    AT_LIMIT_RATIO,
    BREAK_S,
    RELENTLESS_LONG_S,
    RELENTLESS_S,
    RELENTLESS_SHARE,
    RELENTLESS_SHARE_KEPT,
)
from lss_motion.show.splines import near_runs

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.closest_spline import Closest
    from lss_motion.planning.trajectory.curves import Path
    from lss_motion.planning.trajectory.retime import Layout

    FloatArray = NDArray[np.float64]

CELL_S: Final = 0.01
"""Cells of the splines are at most this long. Measured: 0.1 to 0.3 % more deviation than with 2 ms;
half as long takes twice the time."""

MARGIN_S: Final = 0.5
"""Time around a place over the limits that its window takes at once. Measured: with 0.25 s windows
are widened so often that it takes twice as long."""

WIDEN_S: Final = 0.3
WIDEN_RATIO: Final = 0.3
"""A window grows by this, or by this share of itself, whichever is more."""

EDGE_S: Final = 0.06
EDGE_DEG: Final = 0.005
"""A window is wide enough if the deviation near its ends is below this."""

STILL_S: Final = 0.04
"""A joint rests so long before a command of the author, where that leaves time: the compiler takes
20 ms for a standstill."""

GIVEN_UP_MIN_DEG: Final = 0.1
"""Smaller deviations are not reported: the unit of an LSS."""

GAP_S: Final = 0.5
"""Spans of deviation that are closer together are reported as one: a deviation changes its sign."""

MISSED_MIN_DEG: Final = 0.5
"""A key at which a joint turns or stays is reported if it is missed by more. Chosen: it is seen."""

ASKED_STEP_S: Final = 0.02
"""Step of the asked angles that a plan keeps for its picture."""

ASKED_DECIMALS: Final = 3

SAME_CELL: Final = 1e-6
"""Share of a cell by which instants differ by rounding only."""

KNOT_MIN_S: Final = 1e-10
"""Knots of different joints that are closer together differ by rounding only."""

NAMED_MAX: Final = 3
"""Keys that an error names; the others are counted."""


class PassGrid(Struct, frozen=True, kw_only=True):
    """The cells that all joints share, over all passes that differ."""

    cell_s: float
    cells: int
    seams: tuple[int, ...]
    """The cells at which a pass begins, but for the first."""
    is_looped: bool
    tied: tuple[float, float] | None
    """Two instants at which angle and speed must be equal, because the part between is looped."""

    @classmethod
    def of(cls, layout: Layout) -> PassGrid:
        length_s = layout.spacing.length_s
        cells = max(1, math.ceil(length_s / CELL_S - 1e-9))
        passes = len(layout.paths)
        seams = tuple(cells * count for count in range(1, passes))
        tied = layout.sequence.loop_span_s
        if passes > 2:
            tied = (length_s, 2.0 * length_s)
        return cls(
            cell_s=length_s / cells,
            cells=cells * passes,
            seams=seams,
            is_looped=layout.sequence.loop != 1,
            tied=tied,
        )

    def time_s(self, cell: int) -> float:
        return self.cell_s * cell

    def cells_of(self, span_s: float) -> int:
        return max(1, round(span_s / self.cell_s))


class KeyAsked(Struct, frozen=True, kw_only=True):
    """One key of a joint that keeps its time, in the time of all passes."""

    at_s: float
    left_s: float
    deg: float
    name: str
    label: str
    line: int | None
    is_exact: bool
    weight: float
    around_s: float
    """Half of the time to the keys before and after it."""
    is_turn: bool
    """The joint turns or stays here."""


class AskedMotion(Struct, frozen=True, kw_only=True):
    """The motion of one joint as the author asks for it: a column of a path."""

    path: Path
    column: int

    def angles(self, times_s: FloatArray) -> FloatArray:
        segments = self.path.segments_of(times_s)
        local_s = times_s - self.path.knots_s[segments]
        c0, c1, c2, c3 = (self.path.coefficients[segments, k, self.column] for k in range(4))
        return np.asarray(c0 + local_s * (c1 + local_s * (c2 + local_s * c3)))

    def speed(self, at_s: float) -> float:
        segment = int(self.path.segments_of(np.array([at_s]))[0])
        local_s = at_s - float(self.path.knots_s[segment])
        _, c1, c2, c3 = self.path.coefficients[segment, :, self.column].tolist()
        return float(c1 + local_s * (2.0 * c2 + 3.0 * local_s * c3))


class CellWindow(Struct, frozen=True, kw_only=True):
    """The cells from `first` to `end` and the motion in them."""

    first: int
    end: int
    cubics: FloatArray
    deviation_deg: FloatArray
    """Given minus asked at the Gauss points of the cells, (cells, 4)."""


class JointFollower:
    """Follows what is asked of one joint at its times, as closely as its limits allow."""

    def __init__(
        self,
        *,
        name: str,
        bounds: Bounds,
        asked: AskedMotion,
        grid: PassGrid,
        keys: Sequence[KeyAsked],
        source: str,
        own_s: Sequence[tuple[float, float]] = (),
    ) -> None:
        """Take what is asked for; in the spans `own_s` it is given where the rest allows it."""
        self.name, self.bounds, self.asked, self.grid, self.keys = name, bounds, asked, grid, keys
        self._source = source
        cell_s = grid.cell_s
        self._walls = [
            (int((from_s - STILL_S) / cell_s), math.ceil(to_s / cell_s)) for from_s, to_s in own_s
        ]
        self._windows: dict[tuple[int, int], CellWindow] = {}
        self._spans: list[tuple[int, int]] = []

    @property
    def windows(self) -> list[CellWindow]:
        """The windows in order; outside of them the motion is the one that is asked for."""
        return [self._windows[span] for span in self._spans]

    @property
    def end_s(self) -> float:
        return float(self.asked.path.knots_s[-1])

    @property
    def _is_smooth(self) -> bool:
        return math.isfinite(self.bounds.jerk_deg_s3)

    def follow(self, exceeded: Iterable[tuple[int, int]]) -> None:
        """Replace the motion around segments, (first, end), that exceed a limit."""
        knots_s, cell_s = self.asked.path.knots_s, self.grid.cell_s
        margin = self.grid.cells_of(MARGIN_S)
        spans = [
            (
                int(knots_s[first] / cell_s) - margin,
                math.ceil(float(knots_s[end]) / cell_s) + margin,
            )
            for first, end in exceeded
        ]
        cores = [(first + margin, end - margin) for first, end in spans]
        spans = [self._grown(core, span) for core, span in zip(cores, spans, strict=True)]
        if self._is_smooth and len(self.keys) > 1:
            spans = [(0, self.grid.cells)]  # What is asked for jumps at every key.
        self._spans = self._joined(spans)
        while pending := [span for span in self._spans if span not in self._windows]:
            grown = [self._solve(span) for span in pending]
            done = [span for span in self._spans if span in self._windows]
            self._spans = self._joined([*done, *grown])

    def _grown(self, span: tuple[int, int], to: tuple[int, int]) -> tuple[int, int]:
        """Return the span, grown to `to` but not into the spans that are given as asked for."""
        first, end = span
        # A wall may reach into the span where the author leaves no time between them.
        below = [min(wall[1], first) for wall in self._walls if wall[0] < first]
        above = [max(wall[0], end) for wall in self._walls if wall[1] > end]
        return max([to[0], *below]), min([to[1], *above])

    def is_changed(self, from_s: float, to_s: float) -> bool:
        """Return whether angle is given up between two instants."""
        cell_s = self.grid.cell_s
        for window in self.windows:
            first = max(0, math.floor(from_s / cell_s) - window.first)
            end = max(0, math.ceil(to_s / cell_s) - window.first)
            if np.abs(window.deviation_deg[first:end]).max(initial=0.0) > GIVEN_UP_MIN_DEG:
                return True
        return False

    def _joined(self, spans: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
        """Return the spans in order, within the motion, with those that touch made one."""
        found: list[tuple[int, int]] = []
        for first, end in sorted(spans):
            low, high = max(0, first), min(self.grid.cells, end)
            if found and low <= found[-1][1]:
                found[-1] = (found[-1][0], max(found[-1][1], high))
            else:
                found.append((low, high))
        if self.grid.tied is None:
            return found
        # What is equal at two instants is solved as one, with all that lies between.
        from_s, to_s = self.grid.tied
        low = int(from_s / self.grid.cell_s + SAME_CELL)
        high = min(math.ceil(to_s / self.grid.cell_s - SAME_CELL), self.grid.cells)
        touching = [span for span in found if any(span[0] <= p <= span[1] for p in (low, high))]
        inside = (low, high) in found or any(s[0] <= low and high <= s[1] for s in found)
        if not touching or inside:
            return found
        margin = self.grid.cells_of(MARGIN_S)
        return self._joined([*found, (low - margin, high + margin)])

    def _solve(self, span: tuple[int, int]) -> tuple[int, int]:
        """Solve a window and return its span, or the span to be solved in its place."""
        first, end = span
        is_whole = first == 0 and end == self.grid.cells
        wanted = self._wanted(span)
        found = self._closest(wanted)
        grow = max(self.grid.cells_of(WIDEN_S), math.ceil(WIDEN_RATIO * (end - first)))
        grown = first - grow, end + grow
        if found is None and not is_whole:
            self._walls = [
                wall for wall in self._walls if not (wall[0] <= end and first <= wall[1])
            ]
            return self._grown(span, grown)
        if found is None:
            found = self._elastic(wanted)
        window = self._window(span, wanted, found)
        edge = min(self.grid.cells_of(EDGE_S), end - first)
        sizes = np.abs(window.deviation_deg)
        grown = self._grown(span, grown)
        low = grown[0] if first > 0 and sizes[:edge].max() > EDGE_DEG else first
        high = grown[1] if end < self.grid.cells and sizes[-edge:].max() > EDGE_DEG else end
        if (low, high) == span:
            self._windows[span] = window
        return low, high

    def _closest(self, wanted: Wanted) -> Closest | None:
        """Return the closest motion that is not at the acceleration limit for long."""
        while found := closest(wanted, self.bounds):
            accels = np.abs(found.accels(wanted.cell_s))
            is_at_limit = accels > AT_LIMIT_RATIO * self.bounds.accel_deg_s2
            before = np.ones(len(accels)) if wanted.accel_shares is None else wanted.accel_shares
            shares = before.copy()
            for first, end in near_runs(is_at_limit, self.grid.cells_of(BREAK_S)):
                lasts_s = (end - first) * wanted.cell_s
                if lasts_s > RELENTLESS_S:
                    is_long = lasts_s > RELENTLESS_LONG_S
                    share = RELENTLESS_SHARE_KEPT if is_long else RELENTLESS_SHARE
                    shares[first:end] = np.minimum(shares[first:end], share)
            if np.array_equal(shares, before):
                return found
            wanted = replace(wanted, accel_shares=shares)
        return None

    def _wanted(self, span: tuple[int, int]) -> Wanted:
        first, end = span
        grid = self.grid
        from_s, to_s = grid.time_s(first), grid.time_s(end)
        times_s = grid.cell_s * (np.arange(first, end)[:, None] + GAUSS_SHARES)
        deg = self.asked.angles(times_s)
        weights = np.ones_like(deg)
        own = [key for key in self.keys if key.left_s >= from_s and key.at_s <= to_s]
        for key in own:
            if key.weight != 1.0 and key.left_s > key.at_s:
                weights[(times_s >= key.at_s) & (times_s <= key.left_s)] *= key.weight
        slopes = np.diff(deg.ravel()) / np.diff(times_s.ravel())
        return Wanted(
            from_s=from_s,
            cell_s=grid.cell_s,
            deg=deg,
            weights=weights,
            speed_peak_deg_s=float(np.abs(slopes).max(initial=0.0)),
            ties=(*self._end_ties(from_s, to_s), *self._exact_ties(own, from_s, to_s)),
            pulls=tuple(
                Pull(at_s=key.at_s, deg=key.deg, weight_s=(key.weight - 1.0) * key.around_s)
                for key in own
                if key.weight > 1.0 and not key.is_exact and from_s <= key.at_s <= to_s
            ),
        )

    def _end_ties(self, from_s: float, to_s: float) -> Iterator[Tie]:
        """Yield angle and speed at both ends, and those of a looped part."""
        for at_s in (from_s, to_s):
            angle_deg = float(self.asked.angles(np.array([at_s]))[0])
            yield Tie(at_s=at_s, value=angle_deg)
            yield Tie(at_s=at_s, value=self.asked.speed(at_s), order=1)
            if self._is_smooth:
                yield Tie(at_s=at_s, order=2)
        tied = self.grid.tied
        slack_s = SAME_CELL * self.grid.cell_s
        if tied is not None and from_s <= tied[0] + slack_s and tied[1] <= to_s + slack_s:
            yield Tie(at_s=tied[1], same_as_s=tied[0])
            yield Tie(at_s=tied[1], same_as_s=tied[0], order=1)
            if self._is_smooth:
                yield Tie(at_s=tied[1], same_as_s=tied[0], order=2)

    def _exact_ties(self, keys: Sequence[KeyAsked], from_s: float, to_s: float) -> Iterator[Tie]:
        """Yield the ties of exact keys; a hold is a band around its angle."""
        for key in keys:
            if not key.is_exact:
                continue
            inner_s = np.arange(key.at_s, key.left_s, 0.5 * self.grid.cell_s)[1:].tolist()
            for at_s in sorted({key.at_s, key.left_s}):
                if from_s < at_s < to_s:
                    yield Tie(at_s=at_s, value=key.deg)
            for at_s in inner_s:
                if from_s < at_s < to_s:
                    yield Tie(at_s=at_s, value=key.deg, slack_deg=TIE_SLACK_DEG)

    def _elastic(self, wanted: Wanted) -> Closest:
        """Return the motion that misses exact keys and the last angle by as little as possible.

        It may use all of the acceleration limit. Raises `PlanningError` that names the exact keys
        if one of them is missed.
        """
        end_s = self.grid.time_s(self.grid.cells)
        is_free = [
            tie.order == 0 and tie.same_as_s is None and tie.at_s > 0.0 for tie in wanted.ties
        ]
        priced = tuple(tie for tie, free in zip(wanted.ties, is_free, strict=True) if free)
        kept = tuple(tie for tie, free in zip(wanted.ties, is_free, strict=True) if not free)
        found = closest(replace(wanted, ties=kept, may_miss=priced), self.bounds)
        if found is None:
            raise PlanningError(f"joint {self.name!r} cannot keep its time", joint=self.name)
        missed = {
            tie.at_s: by_deg
            for tie, by_deg in zip(priced, found.missed_deg.tolist(), strict=True)
            if by_deg > TIE_SLACK_DEG
        }
        exact = [
            (key, max(by_deg for at_s, by_deg in missed.items() if key.at_s <= at_s <= key.left_s))
            for key in self.keys
            if key.is_exact and any(key.at_s <= at_s <= key.left_s for at_s in missed)
        ]
        if exact:
            raise self._not_exact(exact)
        if self.grid.is_looped and missed:
            raise PlanningError(
                f"joint {self.name!r} cannot be back at {wanted.ties[0].value:g} deg at the end of "
                f"the pass, at {end_s:g} s: it misses that by {max(missed.values()):.2f} deg. Give "
                "the last move more time",
                joint=self.name,
                time_s=end_s,
            )
        return found

    def _not_exact(self, exact: Sequence[tuple[KeyAsked, float]]) -> PlanningError:
        key = exact[0][0]
        texts = [
            f"{one.deg:g} deg at {one.at_s:g} s by {by_deg:.2f} deg"
            for one, by_deg in exact[:NAMED_MAX]
        ]
        if (rest := len(exact) - NAMED_MAX) > 0:
            texts.append(f"{rest} more")
        place = f"{self._source}:{key.line}: " if self._source and key.line is not None else ""
        return PlanningError(
            f"{place}keyframe {key.name} cannot be exact: joint {self.name!r}, allowed "
            f"{self.bounds.speed_deg_s:g} deg/s and {self.bounds.accel_deg_s2:g} deg/s², misses "
            f"{', '.join(texts)}. Give the moves around it more time, ask for less, or let it give "
            "up angle there (no exact; keep: time at that keyframe, too, if others have it)",
            joint=self.name,
            time_s=key.at_s,
        )

    def _window(self, span: tuple[int, int], wanted: Wanted, found: Closest) -> CellWindow:
        first, end = span
        coefficients = found.coefficients
        given = sum(
            coefficients[k : k + end - first, None] * basis(GAUSS_SHARES)[:, k] for k in range(4)
        )
        return CellWindow(
            first=first,
            end=end,
            cubics=found.cubics(self.grid.cell_s),
            deviation_deg=np.asarray(given - wanted.deg),
        )

    def pieces(self) -> tuple[FloatArray, FloatArray]:
        """Return starts and cubics of the motion: asked for outside of windows, given inside."""
        path, grid = self.asked.path, self.grid
        starts_s = path.knots_s[:-1]
        cubics = path.coefficients[:, :, self.asked.column]
        is_kept = np.ones(len(starts_s), dtype=np.bool_)
        more: list[tuple[FloatArray, FloatArray]] = []
        for window in self.windows:
            from_s, to_s = grid.time_s(window.first), grid.time_s(window.end)
            is_kept &= (starts_s < from_s - KNOT_MIN_S) | (starts_s > to_s + KNOT_MIN_S)
            cells = np.arange(window.first, window.end, dtype=np.float64)
            more.append((grid.cell_s * cells, window.cubics))
            if window.end < grid.cells:
                segment = int(path.segments_of(np.array([to_s + KNOT_MIN_S]))[0])
                by_s = np.array([to_s - starts_s[segment]])
                more.append((np.array([to_s]), shifted(cubics[segment : segment + 1], by_s)))
        all_starts_s = np.concatenate([starts_s[is_kept], *(starts for starts, _ in more)])
        all_cubics = np.concatenate([cubics[is_kept], *(own for _, own in more)])
        order = np.argsort(all_starts_s, kind="stable")
        return all_starts_s[order], all_cubics[order]

    def given_up(self) -> Iterator[GivenUp]:
        """Yield the spans in which the angle differs from the one that is asked for."""
        cell_s = self.grid.cell_s
        for window in self.windows:
            times_s = (
                cell_s * (np.arange(window.first, window.end)[:, None] + GAUSS_SHARES)
            ).ravel()
            deviation_deg = window.deviation_deg.ravel()
            is_off = np.abs(deviation_deg) > GIVEN_UP_MIN_DEG
            for first, end in near_runs(is_off, round(GAP_S / cell_s) * len(GAUSS_SHARES)):
                own_deg = np.abs(deviation_deg[first:end])
                worst = first + int(own_deg.argmax())
                from_s, to_s = float(times_s[first]), float(times_s[end - 1])
                yield GivenUp(
                    from_s=from_s,
                    to_s=to_s,
                    joint=self.name,
                    by_deg=float(own_deg.max()),
                    at_s=float(times_s[worst]),
                    rms_deg=float(np.sqrt(np.mean(own_deg**2))),
                    missed=tuple(self._missed(from_s, to_s, times_s, deviation_deg)),
                )

    def left_out(
        self, span_s: tuple[float, float], line_deg: tuple[float, float], stop_deg: float
    ) -> GivenUp:
        """Return what a command of `span_s` gives up that is replaced before its angle is reached.

        It is asked for at constant speed from the first angle of `line_deg` to the second; the
        joint could stop at `stop_deg` when it is replaced.
        """
        from_s, to_s = span_s
        times_s = np.linspace(from_s, to_s, max(2, round((to_s - from_s) / ASKED_STEP_S)))
        off_deg = self.asked.angles(times_s) - np.interp(times_s, span_s, line_deg)
        label = next((key.label for key in self.keys if key.at_s == to_s), "")
        missed = MissedKey(at_s=to_s, label=label, asked_deg=line_deg[1], given_deg=stop_deg)
        return GivenUp(
            from_s=from_s,
            to_s=to_s,
            joint=self.name,
            by_deg=abs(stop_deg - line_deg[1]),
            at_s=to_s,
            rms_deg=float(np.sqrt(np.mean(off_deg**2))),
            missed=(missed,),
        )

    def asked_in(self, span: GivenUp) -> AskedSpan:
        """Return what is asked for in a span."""
        steps = max(1, round((span.to_s - span.from_s) / ASKED_STEP_S))
        deg = self.asked.angles(np.linspace(span.from_s, span.to_s, steps + 1))
        return AskedSpan(
            from_s=span.from_s,
            to_s=span.to_s,
            joint=self.name,
            deg=tuple(np.round(deg, ASKED_DECIMALS).tolist()),
        )

    def _missed(
        self, from_s: float, to_s: float, times_s: FloatArray, deviation_deg: FloatArray
    ) -> Iterator[MissedKey]:
        """Yield the keys of a span at which the joint should turn or stay and does not come to."""
        slack_s = self.grid.cell_s
        for key in self.keys:
            if key.is_turn and from_s - slack_s <= key.at_s <= to_s + slack_s:
                off_deg = float(np.interp(key.at_s, times_s, deviation_deg))
                if abs(off_deg) > MISSED_MIN_DEG:
                    yield MissedKey(
                        at_s=key.at_s,
                        label=key.label,
                        asked_deg=key.deg,
                        given_deg=key.deg + off_deg,
                    )
