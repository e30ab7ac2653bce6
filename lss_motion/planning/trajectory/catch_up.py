"""Making up for lateness: while the motion is late it goes faster than authored, until it is not.

The rate is 1 where the motion is on time. In a span between keys where a limit binds
(`free_spans`), it is what the limits allow, as long as no key is early (`ahead`). Behind one that
leaves the motion late, it may rise to `PACE_MAX`, and comes back to 1 where the motion is on time
again; there it is never early. Holds keep their length. Where an anchor would be late, the way to
it becomes as fast as it needs.

`_Sweep` goes along the path, from one slow window to the next. Each is solved once, as fast as it
can be, up to where it is guessed to be on time; if it is late there, the solution is continued.
Where that would be early, `braking.braked` puts its end, on time at rate 1; only where that finds
nothing (about one in fifty), the end is sought with more solutions.
"""

from __future__ import annotations

import itertools
import math
from bisect import bisect_left, bisect_right
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.planning.trajectory.ahead import KeptKeys, kept_keys
from lss_motion.planning.trajectory.braking import braked, mixed
from lss_motion.planning.trajectory.dues import EARLY_S, Dues
from lss_motion.planning.trajectory.free_spans import MARGIN_CELLS, MARGIN_S, free_spans, without
from lss_motion.planning.trajectory.solver import (
    MARGIN_RATIO,
    RATE_SLACK,
    RateWindow,
    is_legal,
    solve,
)
from lss_motion.show.splines import distinct

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.solver import RateTask

    FloatArray = NDArray[np.float64]

PACE_MAX: Final = 2.0
"""Largest rate of a motion that is late. Chosen: more is seen as haste, and measured over random
sequences a larger rate makes up for lateness hardly earlier."""

PACE_ANCHOR_MAX: Final = 50.0
"""Largest rate before an anchor that would be late. Chosen: a second of slack becomes 20 ms."""

PACE_STEPS: Final = 5
"""Halvings to find the least rate that meets an anchor: to within 11 %."""

LATE_MIN_S: Final = 1e-5
"""Less lateness is not made up: a hundredth of a millisecond."""

ANCHOR_LATE_S: Final = 1e-4
"""An anchor that is later makes the motion before it faster. A tenth of what an anchor allows."""

CATCH_UP_RATIO: Final = 0.003
"""The faster one of two solutions that are mixed is early by at most this share of the lateness.
Chosen: far below the 2 % by which the sum of all lateness may exceed the least."""

END_ERROR_S: Final = 0.002
"""That instant is not sought more precisely: two solutions so near are mixed."""

ROUNDS_MAX: Final = 6
"""Solutions to find one instant at which the motion is on time. Measured: 2 or 3 are needed."""

SAVED_RATIO: Final = 1.5
"""Share of the time that the steady rates of the segments ahead would save in which the motion is
guessed to be on time. Above 1, because a solution that ends too early is only continued. Measured
with 0.7 to 3: this one has the fewest cells."""

GUESSED_SEGMENTS: Final = 400
"""The guess looks no further ahead."""

FIRST_S: Final = 0.2
"""Added to the guess: the rate rises and falls gradually."""

NEXT_S: Final = 0.1
"""A solution ends where the next slow part begins, if that is so much later than the last one."""

END_REACH_S: Final = 0.5
"""Where a solution is continued, so much of it is solved again. Its end counts for the rates in
half of that; if they differ at the middle, it is twice as much."""

SAME_RATIO: Final = 2e-3
"""Squared rates that differ by less, as they do on different grids, are the same."""

BRAKE_S: Final = 0.25
"""What is solved again begins this long before the motion is on time, and twice as long before
where the rate must fall earlier."""

TIGHT_RATIO: Final = 0.01
"""Segments authored so near a limit may use all of it, so that rate 1 is never too fast."""

GENTLE_ROUNDS: Final = 3
"""Attempts to pass keys at rate 1 although they could be passed faster."""

HASTE_S: Final = 1.0
"""Before a key that is later with them, keys may be passed faster. Chosen: braking from and to rate
1 takes a few tenths of a second."""


def made_up(
    task: RateTask,
    windows: Sequence[RateWindow],
    stops_s: FloatArray,
    dues: Dues,
    *,
    seam_square: float = 1.0,
) -> list[RateWindow] | None:
    """Return the windows of the path in which the rate is not 1, lateness made up for.

    None: a slow part begins so close behind another one that the rates between them do not agree.

    `windows` have the slow parts at rates up to 1. At the positions `stops_s` no joint moves, so
    that the rate may jump. `seam_square` is the squared rate at all seams.
    """
    if not windows and dues.begins_late_s(task.path.knots_s[0]) <= LATE_MIN_S:
        return []
    for is_eased in (True, False):
        sweep = partial(
            _Sweep, task, windows, stops_s, dues, seam_square=seam_square, is_eased=is_eased
        )
        try:
            usual = sweep()
            found = usual.run()
            if usual.missed_s:
                urgent = sweep(urgent_s=usual.missed_s)
                hurried = urgent.run()
                found = hurried if len(urgent.missed_s) < len(usual.missed_s) else found
        except _RateJumpError:
            continue
        return found
    return None


def _from(window: RateWindow, whole: RateWindow, head: int) -> RateWindow:
    """Return a window from a grid point of `whole` on, whose rates it has before its own."""
    from_s = float(whole.grid_s[head])
    before = (whole.grid_s >= from_s) & (whole.grid_s < window.from_s)
    after = window.grid_s >= from_s
    return RateWindow(
        np.concatenate([whole.grid_s[before], window.grid_s[after]]),
        np.concatenate([whole.squares[before], window.squares[after]]),
    )


class _RateJumpError(Exception):
    """A window would begin at a lower rate than the motion before it has."""


class _SweepPlace(Struct, frozen=True):
    """Where the sweep is, how late, and how many windows it has found."""

    at_s: float
    late_s: float
    found: tuple[RateWindow, ...]


def _shares(task: RateTask) -> FloatArray:
    """Return the share of the limits that each segment may use where the motion is not slow."""
    speed, accel = task.peaks()
    used = np.maximum(speed / task.speed_max_deg_s, accel / task.accel_max_deg_s2).max(axis=1)
    return np.where(np.abs(used - 1.0) < TIGHT_RATIO, 1.0, MARGIN_RATIO)


def _rates(task: RateTask, held_s: FloatArray) -> FloatArray:
    """Return the largest steady rate of each segment; 1 where a hold is kept."""
    speed, accel = task.peaks()
    used = np.maximum(speed / task.speed_max_deg_s, np.sqrt(accel / task.accel_max_deg_s2))
    rates = 1.0 / np.clip(used.max(axis=1), 1.0 / PACE_ANCHOR_MAX, 1.0)  # A slow part is 1, too.
    middles_s = 0.5 * (task.path.knots_s[:-1] + task.path.knots_s[1:])
    for from_s, to_s in held_s.tolist():
        rates[slice(*np.searchsorted(middles_s, [from_s, to_s]))] = 1.0
    return np.asarray(rates)


class _Sweep:
    """Goes along the path once. `found` has the windows so far, `late_s` the lateness after them.

    `on_time` is the last place at which the motion was on time. `is_eased`: limits are not used to
    the last part in a thousand where the motion is not slow, so that hardly a cell needs repair.
    """

    def __init__(
        self,
        task: RateTask,
        windows: Sequence[RateWindow],
        stops_s: FloatArray,
        dues: Dues,
        *,
        seam_square: float,
        is_eased: bool,
        urgent_s: Sequence[float] = (),
    ) -> None:
        self.task = replace(task, knot_caps={}, shares=_shares(task) if is_eased else None)
        self.dues = dues
        self.stops_s = frozenset(stops_s.tolist())
        start_s, self.end_s = task.path.knots_s[[0, -1]].tolist()
        spans = free_spans(
            windows, stops_s, (start_s, self.end_s), dues, urgent_s, is_hasty=seam_square != 1.0
        )
        keys_s = [key for span in spans for key in itertools.pairwise(span.keys_s)]
        self.free_s = np.array(keys_s, dtype=np.float64).reshape(-1, 2)
        self.calm_s = without(dues.held, self.free_s)
        self.windows = [span.window for span in spans]
        self.starts_s = [window.from_s for window in self.windows]
        self.seam_square = seam_square
        self.edges_s = sorted({*self.stops_s, *dues.seams_s, self.end_s})
        rest_ends = (stops_s, dues.held.ravel(), dues.anchors_s, [self.end_s])
        self.rest_edges_s = distinct(np.concatenate([*map(np.asarray, rest_ends)])).tolist()
        self.is_rest = task.path.rests
        self.anchors_s = sorted(dues.anchors_s)
        self.missed_s: list[float] = []
        self.pace = PACE_MAX
        self.rates = _rates(task, dues.held)
        self.late_s = dues.begins_late_s(start_s)
        is_late = self.late_s > LATE_MIN_S
        self.at_s = start_s if is_late else min(self.starts_s, default=self.end_s)
        self.found: list[RateWindow] = []
        self.on_time = self._place()

    def run(self) -> list[RateWindow]:
        while self.at_s < self.end_s:
            missed_s = self._step()
            if missed_s is not None:
                self._hurry(missed_s)
        return self.found

    def _place(self) -> _SweepPlace:
        return _SweepPlace(self.at_s, self.late_s, tuple(self.found))

    def _return_to(self, place: _SweepPlace) -> None:
        self.at_s, self.late_s, self.found = place.at_s, place.late_s, list(place.found)

    def _window_at(self, at_s: float) -> RateWindow | None:
        """Return the window in which a position lies; not at its ends."""
        index = bisect_left(self.starts_s, at_s) - 1
        if index >= 0 and at_s < self.windows[index].to_s:
            return self.windows[index]
        return None

    def _hurry(self, anchor_s: float) -> None:
        """Go again from where the motion was on time, as fast as the anchor needs, to behind it.

        If it cannot be met, the fastest way remains: it has the least lateness.
        """
        start = self.on_time
        self.anchors_s = [at_s for at_s in self.anchors_s if at_s != anchor_s]

        def is_met(pace: float) -> bool:
            self._return_to(start)
            self.pace = pace
            self.on_time = start
            missed = False
            while self.at_s < anchor_s:
                before_s = self.at_s
                self._step()
                missed = before_s < anchor_s <= self.at_s and self._late_at(anchor_s)
            self.pace = PACE_MAX
            return not missed

        if is_met(PACE_ANCHOR_MAX):
            best, low, high = self._place(), math.log(PACE_MAX), math.log(PACE_ANCHOR_MAX)
            for _ in range(PACE_STEPS):
                middle = 0.5 * (low + high)
                if is_met(math.exp(middle)):
                    best, high = self._place(), middle
                else:
                    low = middle
            self._return_to(best)
        else:
            self.missed_s.append(anchor_s)

    def _late_at(self, anchor_s: float) -> bool:
        """Return whether an anchor at or shortly before the present place is missed."""
        late_s = self.late_s
        if anchor_s < self.at_s and self.found and self.found[-1].from_s < anchor_s:
            window = self.found[-1]
            backwards = self.dues.lateness(window, 0.0)
            late_s += float(np.interp(anchor_s, window.grid_s, backwards - backwards[-1]))
        return late_s > ANCHOR_LATE_S

    def _step(self) -> float | None:
        """Go on by one window, rest or jump; return the first anchor on this way that is late."""
        from_s = self.at_s
        if from_s in self.dues.seams_s:
            self.late_s = 0.0
        index = bisect_left(self.starts_s, from_s)
        is_start = index < len(self.starts_s) and self.starts_s[index] == from_s
        if self.late_s <= LATE_MIN_S:
            self.on_time = self._place()
        if self.late_s <= LATE_MIN_S and not is_start:
            self.at_s = self.starts_s[index] if index < len(self.starts_s) else self.end_s
            return None
        if not self._rested():
            self._follow(self.windows[index] if is_start else None)
        for anchor_s in self.anchors_s[bisect_right(self.anchors_s, from_s) :]:
            if anchor_s > self.at_s:
                return None
            if self._late_at(anchor_s):
                return anchor_s
        return None

    def _rested(self) -> bool:
        """Go over a rest, or a hold under which others move; return whether there is one."""
        from_s = self.at_s
        edge_s = self.rest_edges_s[bisect_right(self.rest_edges_s, from_s)]
        is_held = self.dues.is_held(from_s, edge_s)
        segment = int(self.task.path.segments_of(np.array([from_s]))[0])
        if self.is_rest[segment]:
            if not is_held:
                self.late_s = max(0.0, self.late_s - self.dues.spent(from_s, edge_s))
            self.at_s = edge_s
            return True
        index = bisect_left(self.starts_s, from_s)
        if is_held and (index == len(self.starts_s) or self.starts_s[index] >= edge_s):
            self.at_s = edge_s
            return True
        return False

    def _follow(self, window: RateWindow | None) -> None:
        """Go on as fast as possible, from the start of a slow window or with lateness alone."""
        from_s, late_s = self.at_s, self.late_s
        lost_s, until_s = late_s, from_s
        if window is not None:
            lost_s += max(0.0, float(self.dues.lateness(window, 0.0)[-1]))
            slow = np.flatnonzero(window.squares < 1.0)
            until_s = float(window.grid_s[slow[-1] if len(slow) else 0])
        edge_s = self.edges_s[bisect_right(self.edges_s, from_s)]
        wanted_s = self._guessed_s(until_s, lost_s)
        fastest: RateWindow | None = None
        while True:
            to_s = self._end(wanted_s, edge_s, until_s)
            fastest = self._fastest(fastest, from_s, to_s)
            if from_s not in self.stops_s and fastest.squares[0] < self._most(from_s) - RATE_SLACK:
                raise _RateJumpError
            whole, is_met = self._unhurried(fastest, late_s)
            if not is_met and self._early(whole, late_s):
                whole, is_met = self._settled(whole, late_s)
                whole = self._kept(whole, late_s)
            lateness_s = self.dues.lateness(whole, late_s)
            if is_met or to_s >= edge_s or lateness_s[-1] <= LATE_MIN_S:
                break
            gain = max(1.0 - 1.0 / math.sqrt(float(whole.squares.max())), 0.1)
            until_s = to_s
            wanted_s = to_s + max(float(lateness_s[-1]) / gain, 0.5 * (to_s - from_s))
        for at_s, square in ((from_s, whole.squares[0]), (whole.to_s, whole.squares[-1])):
            is_seam = at_s in self.dues.seams_s and at_s not in self.stops_s
            if is_seam and abs(square - self.seam_square) > RATE_SLACK:
                raise _RateJumpError
        self.found.append(whole)
        self.at_s = whole.to_s
        self.late_s = max(0.0, float(lateness_s[-1]))

    def _unhurried(self, fastest: RateWindow, late_s: float) -> tuple[RateWindow, bool]:
        """Return the window early at no key of its free spans, and whether it ends on time.

        Keys that would be early are passed at most at rate 1, unless another key is later then.
        """
        keys = self._at_keys(fastest, late_s)
        if keys is None:
            return fastest, False
        hasty_s = keys.hasty_s(self.stops_s)
        for _ in range(GENTLE_ROUNDS):
            if not hasty_s:
                break
            calmer = self._solved(fastest.from_s, fastest.to_s, calm_keys_s=hasty_s)
            gentle = self._at_keys(calmer, late_s, hasty_s, keys.calm)
            if gentle is None:
                break
            is_later = gentle.late_s > keys.late_s + LATE_MIN_S
            if not is_later.any():
                keys = gentle
                break
            later_s = float(keys.at_s[int(np.argmax(is_later))])
            hasty_s = tuple(at_s for at_s in hasty_s if not later_s - HASTE_S <= at_s <= later_s)
        return self._cut_behind(keys, late_s)

    def _at_keys(
        self,
        fastest: RateWindow,
        late_s: float,
        calm_keys_s: tuple[float, ...] = (),
        calm: RateWindow | None = None,
    ) -> KeptKeys | None:
        """Return the window early at no key of its free spans; None if there is no such span."""
        inside = (self.free_s[:, 0] >= fastest.from_s) & (self.free_s[:, 1] <= fastest.to_s)
        spans_s = self.free_s[inside]
        if not len(spans_s):
            return None
        capped_s = set(calm_keys_s)
        while True:
            found = kept_keys(self.task, fastest, calm, spans_s, self.dues, late_s)
            if isinstance(found, KeptKeys):
                return found
            if found is None:
                calm = self._solved(fastest.from_s, float(spans_s[-1, 1]), until_s=-math.inf)
                continue
            if capped_s.issuperset(found):
                raise _RateJumpError
            capped_s |= set(found) if found[1] in capped_s else {found[1]}
            fastest = self._solved(fastest.from_s, fastest.to_s, calm_keys_s=tuple(capped_s))

    def _kept(self, whole: RateWindow, late_s: float) -> RateWindow:
        """Return the window with its keys and holds kept again, where its end was solved anew."""
        inside = (self.free_s[:, 0] >= whole.from_s) & (self.free_s[:, 1] <= whole.to_s)
        if not inside.any():
            return whole
        spans_s = self.free_s[inside]
        found = kept_keys(self.task, whole, None, spans_s, self.dues, late_s)
        if found is None:
            calm = self._solved(whole.from_s, float(spans_s[-1, 1]), until_s=-math.inf)
            found = kept_keys(self.task, whole, calm, spans_s, self.dues, late_s)
        if not isinstance(found, KeptKeys):
            raise _RateJumpError
        return found.window

    def _cut_behind(self, keys: KeptKeys, from_late_s: float) -> tuple[RateWindow, bool]:
        """Return the window up to where the author's pace begins on time, and whether it does."""
        window = keys.window
        for at_s, late_s, square in zip(keys.at_s, keys.late_s, keys.squares, strict=True):
            is_steady = abs(square - 1.0) < RATE_SLACK or at_s in self.stops_s
            if is_steady and late_s <= LATE_MIN_S and at_s not in self.free_s[:, 0]:
                end = int(np.abs(window.grid_s - at_s).argmin()) + 1
                found = RateWindow(window.grid_s[:end], window.squares[:end])
                # Between free spans it may have been early, where it makes up for lateness.
                return (window, False) if self._early(found, from_late_s) else (found, True)
        return window, False

    def _guessed_s(self, until_s: float, lost_s: float) -> float:
        """Return about where the motion is on time again that is `lost_s` late at a position."""
        knots_s = self.task.path.knots_s
        first = int(np.searchsorted(knots_s, until_s, side="right")) - 1
        edges_s = knots_s[first : first + GUESSED_SEGMENTS + 1].copy()
        edges_s[0] = until_s
        rates = np.minimum(self.rates[first : first + GUESSED_SEGMENTS], self.pace)
        saved_s = SAVED_RATIO * np.cumsum(np.diff(edges_s) * (1.0 - 1.0 / rates))
        return float(np.interp(lost_s, np.append(0.0, saved_s), edges_s)) + FIRST_S

    def _fastest(self, known: RateWindow | None, from_s: float, to_s: float) -> RateWindow:
        """Return the largest rates from a position to another.

        `known` has those up to an earlier end. Only what comes shortly before that is solved again:
        there the rate fell to 1.
        """
        back_s = END_REACH_S
        while known and (head := self._head(known, known.to_s - back_s)):
            start_max = float(known.squares[head])
            tail = self._solved(float(known.grid_s[head]), to_s, start_max=start_max)
            middle = self._head(known, known.to_s - 0.5 * back_s)
            found = float(np.interp(known.grid_s[middle], tail.grid_s, tail.squares))
            is_same = abs(found - known.squares[middle]) <= SAME_RATIO * found
            if is_same and tail.squares[0] >= start_max - RATE_SLACK:
                return RateWindow(
                    np.concatenate([known.grid_s[:head], tail.grid_s]),
                    np.concatenate([known.squares[:head], tail.squares]),
                )
            back_s *= 2.0
        return self._solved(from_s, to_s)

    def _is_due(self, window: RateWindow) -> NDArray[np.bool_]:
        """Return at which grid points the motion must not be early: inside of free spans it may."""
        grid_s, starts_s, ends_s = window.grid_s, self.free_s[:, 0], self.free_s[:, 1]
        begun = np.searchsorted(starts_s, grid_s - EARLY_S)
        return np.asarray(begun == np.searchsorted(ends_s, grid_s + EARLY_S))

    def _least_s(self, window: RateWindow, late_s: float) -> float:
        """Return the least lateness where it counts, negative where the motion is early."""
        lateness_s = self.dues.lateness(window, late_s)[self._is_due(window)]
        return float(lateness_s.min(initial=math.inf))

    def _early(self, whole: RateWindow, late_s: float) -> int:
        """Return the first grid point at which the motion must not be early but is; 0: none."""
        is_early = (self.dues.lateness(whole, late_s) < -EARLY_S) & self._is_due(whole)
        return int(np.argmax(is_early))

    def _settled(self, whole: RateWindow, late_s: float) -> tuple[RateWindow, bool]:
        """Return the window nowhere early, and whether it ends where the motion is on time.

        If it does not, the motion is on time only for an instant, before it has to be slow again.
        """
        before = 0
        while True:
            early = self._early(whole, late_s)
            if not early:
                return whole, False
            lateness = self._lateness_along(whole, late_s)
            found = None
            if early > before:
                found = braked(self.task, whole, early, lateness, self._is_due(whole))
            if found is None or (found.to_s < whole.to_s and not self._is_freed(found.to_s)):
                met_s = float(whole.grid_s[early - 1])
                whole = self._on_time(whole, late_s, early)
                return self._cut(whole, met_s), True
            before, whole, is_whole = early, found, found.to_s == whole.to_s
            if not is_whole or abs(self.dues.lateness(whole, late_s)[-1]) <= LATE_MIN_S:
                return whole, True

    def _lateness_along(
        self, whole: RateWindow, late_s: float
    ) -> Callable[[RateWindow], FloatArray]:
        """Return a function for the lateness of windows on the first grid points of `whole`."""
        authored_s = self.dues.authored(whole.grid_s)
        due_s = authored_s - authored_s[0] - late_s

        def lateness(window: RateWindow) -> FloatArray:
            passed_s = np.concatenate([[0.0], np.cumsum(window.spent_s)])
            return np.asarray(passed_s - due_s[: len(passed_s)])

        return lateness

    def _is_freed(self, at_s: float) -> bool:
        """Return whether the motion can go on at rate 1 from a position inside of a slow window.

        What is slow behind it becomes a window of its own.
        """
        outline = self._window_at(at_s)
        if outline is None or self._split(outline, at_s):
            return True
        rest_s = np.append(at_s, outline.grid_s[outline.grid_s > at_s])
        return is_legal(self.task, RateWindow(rest_s, np.ones(len(rest_s))), 0)

    def _split(self, outline: RateWindow, at_s: float) -> bool:
        """Let a window begin at a position, if it is slow behind it; return whether it is."""
        rest_s = np.append(at_s, outline.grid_s[outline.grid_s > at_s])
        levels = np.append(1.0, np.interp(rest_s[1:], outline.grid_s, outline.squares))
        if not (levels < 1.0).any():
            return False
        index = bisect_right(self.starts_s, at_s)
        self.windows.insert(index, RateWindow(rest_s, levels))
        self.starts_s.insert(index, at_s)
        return True

    def _cut(self, whole: RateWindow, met_s: float) -> RateWindow:
        """Return the window up to where the rate is 1 again behind `met_s`, if it is slow later.

        That slow part becomes a window of its own, from which on the motion may be fast again.
        """
        grid_s, squares = whole.grid_s, whole.squares
        steady = np.flatnonzero((np.abs(squares - 1.0) < RATE_SLACK) & (grid_s > met_s))
        if not len(steady):
            return whole
        at = int(steady[0])
        later = np.flatnonzero(squares[at:] < 1.0 - RATE_SLACK)
        if not len(later) or later[0] <= MARGIN_CELLS:
            return whole
        at_s = float(grid_s[at])
        if outline := self._window_at(at_s):
            self._split(outline, at_s)
        return RateWindow(grid_s[: at + 1], squares[: at + 1])

    def _end(self, wanted_s: float, edge_s: float, least_s: float = math.inf) -> float:
        """Return where a window may end: at the edge, well behind a slow one, or where one begins.

        The latter if that is behind `least_s`. Behind a slow part the rate may first have to rise
        above 1, and then needs room to fall.
        """
        end_s = min(wanted_s, edge_s)
        while window := self._window_at(end_s):
            if window.from_s > least_s + NEXT_S:
                return window.from_s
            end_s = min(window.to_s + BRAKE_S, edge_s)
        return edge_s if end_s > edge_s - 2.0 * EARLY_S else end_s

    def _most(self, at_s: float) -> float:
        """Return the largest squared rate at an end of a window."""
        if at_s in self.stops_s:
            return math.inf
        return self.seam_square if at_s in self.dues.seams_s else 1.0

    def _solved(
        self,
        from_s: float,
        to_s: float,
        *,
        until_s: float = math.inf,
        start_max: float | None = None,
        calm_keys_s: tuple[float, ...] = (),
    ) -> RateWindow:
        """Return the largest rates: up to the pace before `until_s`, in free spans above it.

        Behind that, in holds outside of free spans and at `calm_keys_s` they are at most 1.
        """
        begin_max, end_max = self._most(from_s), self._most(to_s)
        free, calm = self.free_s, self.calm_s
        keys_s = np.array(calm_keys_s)[:, None] + [[-EARLY_S, EARLY_S]]
        slow_s = [
            (float(window.grid_s[cell]), float(window.grid_s[cell + 1]))
            for window in self.windows[max(0, bisect_right(self.starts_s, from_s) - 1) :]
            if window.from_s < to_s
            for cell in np.flatnonzero(np.minimum(window.squares[:-1], window.squares[1:]) < 1.0)
        ]
        return solve(
            replace(
                self.task,
                rate_max=self.pace,
                fast_s=(-math.inf, until_s),
                calm_s=np.concatenate([calm[(calm[:, 1] > from_s) & (calm[:, 0] < to_s)], keys_s]),
                free_s=free[(free[:, 1] > from_s) & (free[:, 0] < to_s)],
                slow_s=np.array(slow_s),
            ),
            from_s,
            to_s,
            start_max=begin_max if start_max is None else start_max,
            end_max=end_max,
        )

    def _on_time(self, whole: RateWindow, late_s: float, early: int) -> RateWindow:
        """Return the window with the rate back at 1 where the motion is on time.

        `whole` goes on at the pace. It is early at its grid point `early` for the first time.
        """
        lateness_s = self.dues.lateness(whole, late_s)
        least_s = -CATCH_UP_RATIO * float(lateness_s.max())
        head = self._head(whole, whole.grid_s[early - 1] - BRAKE_S)
        until_s, low_s, high_s = float(whole.grid_s[early - 1]), -math.inf, whole.to_s
        faster = whole
        best_s = self._least_s(whole, late_s)
        growth = 1.0
        for _ in range(ROUNDS_MAX):
            if low_s > -math.inf and (best_s >= least_s or high_s - low_s < END_ERROR_S):
                break
            to_s = self._end(max(until_s, float(whole.grid_s[head]) + MARGIN_S), whole.to_s)
            tail, head = self._tail(whole, head, to_s, until_s)
            found_s = self._least_s(tail, float(lateness_s[head]))
            gain = max(1.0 - 1.0 / math.sqrt(float(tail.squares.max())), 0.05)
            if found_s >= 0.0:
                low_s, growth = until_s, 2.0 * growth
            else:
                faster, best_s, high_s = tail, found_s, until_s
            until_s += growth * (found_s - 0.5 * least_s) / gain
            if not low_s < until_s < high_s:
                until_s = 0.5 * (max(low_s, high_s - BRAKE_S) + high_s)
        low_s = max(low_s, float(whole.grid_s[0]))
        slower, head = self._tail(whole, head, faster.to_s, low_s)
        faster = _from(faster, whole, head)
        tail = mixed(slower, faster, lambda tail: self._least_s(tail, float(lateness_s[head])))
        return RateWindow(
            np.concatenate([whole.grid_s[:head], tail.grid_s]),
            np.concatenate([whole.squares[:head], tail.squares]),
        )

    def _tail(
        self, whole: RateWindow, head: int, to_s: float, until_s: float
    ) -> tuple[RateWindow, int]:
        """Return the largest rates from a grid point of `whole` to `to_s`, and that grid point.

        It is `head`, or the last one before it from which the limits allow this.
        """
        while True:
            start_max = float(whole.squares[head])
            tail = self._solved(
                float(whole.grid_s[head]), to_s, until_s=until_s, start_max=start_max
            )
            if head == 0 or tail.squares[0] >= start_max - RATE_SLACK:
                return tail, head
            behind_s = max(2.0 * (until_s - float(whole.grid_s[head])), BRAKE_S)
            head = min(head - 1, self._head(whole, until_s - behind_s))

    def _head(self, whole: RateWindow, at_s: float) -> int:
        """Return the grid point of `whole` at or before a position."""
        return max(0, int(np.searchsorted(whole.grid_s, at_s, side="right")) - 1)
