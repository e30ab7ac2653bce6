"""Paths of the body and of the feet of a walking robot over the ground.

`Travel` is the path of the body, integrated from its velocity; every change of the velocity is
blended in over one cycle. `Steps` is the path of one foot. `Stepper` makes both for a robot that
is steered, from one boundary of phases to the next.

A foot lands where it will be neutral in the middle of its stance. A steered robot computes that
when the foot lifts, as if the velocity stayed the same.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.show.gait.curves import blend, hermite, lift
from lss_motion.show.gait.kinematics import neutral_mm

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from lss_motion.show.gait.curves import Spline
    from lss_motion.show.gait.model import Gait, Walk

    FloatArray = NDArray[np.float64]

CELLS_PER_CYCLE: Final = 64
"""Cells of the integration. Measured: error of 1e-6 mm at 90 degrees a cycle and 500 mm/s."""

HOME_MM: Final = 1e-6
"""A foot this near to its final position needs no more step: rounding."""

INSTANT_S: Final = 1e-9
"""Instants this near are equal: rounding."""


class Travel(Struct, frozen=True):
    """The path of the body over the ground: x, y in mm and heading in rad."""

    starts_s: FloatArray
    """When each walk begins."""
    _times_s: FloatArray
    _places: FloatArray
    _rates: FloatArray

    @property
    def duration_s(self) -> float:
        """How long the body travels."""
        return float(self._times_s[-1])

    def at(self, times_s: FloatArray) -> FloatArray:
        """Return x, y, heading, (n, 3); constant before the first and after the last instant."""
        inside_s = np.clip(times_s, self._times_s[0], self._times_s[-1])
        step_s = self._times_s[1] - self._times_s[0]
        cell = ((inside_s - self._times_s[0]) / step_s).astype(np.intp)
        cell = np.clip(cell, 0, len(self._times_s) - 2)
        return hermite(
            step_s,
            (self._places[cell], self._places[cell + 1]),
            (self._rates[cell], self._rates[cell + 1]),
            (inside_s - self._times_s[cell])[:, None],
        )


def travel(walks: Sequence[Walk], cycle_s: float) -> Travel:
    """Return the path of the body over consecutive `walks`, from rest to rest.

    The velocity of each walk is blended in over its first cycle, that of the last one is blended
    out over one more cycle. So each walk covers exactly its velocity times its cycles.
    """
    twists = np.array(
        [
            (0.0, 0.0, 0.0),
            *((w.forward_mm_s, w.left_mm_s, np.radians(w.turn_deg_s)) for w in walks),
            (0.0, 0.0, 0.0),
        ]
    )
    starts_s: FloatArray = cycle_s * np.cumsum([0, *(walk.cycles for walk in walks)])

    def own(times_s: FloatArray) -> FloatArray:
        part = np.clip(np.searchsorted(starts_s, times_s, side="right") - 1, 0, len(starts_s) - 1)
        share = blend((times_s - starts_s[part]) / cycle_s)[:, None]
        return np.asarray(twists[part] * (1.0 - share) + twists[part + 1] * share)

    cells = CELLS_PER_CYCLE * (sum(walk.cycles for walk in walks) + 1)
    return integrated(own, cells=cells, cell_s=cycle_s / CELLS_PER_CYCLE, starts_s=starts_s[:-1])


def integrated(
    twist: Callable[[FloatArray], FloatArray],
    *,
    cells: int,
    cell_s: float,
    starts_s: FloatArray,
    from_s: float = 0.0,
    place: FloatArray | None = None,
) -> Travel:
    """Return the path of a body whose velocity in its own frame is `twist(times_s)`, (n, 3).

    The velocity is in mm/s forward and left, and rad/s. The path begins at `place` (default: the
    origin) at `from_s`.
    """
    begins = np.zeros(3) if place is None else place
    # Two points a cell, for Simpson's rule.
    fine_s: FloatArray = from_s + np.arange(2 * cells + 1, dtype=np.float64) * (0.5 * cell_s)
    own = twist(fine_s)
    # The headings at the middles come from the parabola through each cell.
    heading = np.zeros(2 * cells + 1)
    left, middle, right = own[:-2:2, 2], own[1::2, 2], own[2::2, 2]
    heading[2::2] = np.cumsum(cell_s / 6.0 * (left + 4.0 * middle + right))
    heading[1::2] = heading[:-2:2] + cell_s / 24.0 * (5.0 * left + 8.0 * middle - right)
    cosine, sine = np.cos(begins[2] + heading), np.sin(begins[2] + heading)
    rates = np.stack(
        [cosine * own[:, 0] - sine * own[:, 1], sine * own[:, 0] + cosine * own[:, 1], own[:, 2]],
        axis=1,
    )
    places = np.zeros((cells + 1, 3))
    simpson = cell_s / 6.0 * (rates[:-2:2] + 4.0 * rates[1::2] + rates[2::2])
    places[1:] = np.cumsum(simpson, axis=0)
    return Travel(
        starts_s=starts_s, _times_s=fine_s[::2], _places=begins + places, _rates=rates[::2]
    )


class Steps(Struct, frozen=True, kw_only=True):
    """The path of one foot: step k takes it from `places_mm[k]` to `places_mm[k + 1]`.

    Standing feet do not move. A stepping foot has no speed over the ground when it lifts and when
    it lands.
    """

    lifts_s: FloatArray
    lands_s: FloatArray
    places_mm: FloatArray
    height_mm: float

    def at(self, times_s: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the foot, (n, 3) mm, and whether it stands, (n,)."""
        done = np.searchsorted(self.lands_s, times_s, side="right")
        begun = np.searchsorted(self.lifts_s, times_s, side="left")
        is_up = begun > done
        step = np.minimum(done, max(len(self.lifts_s) - 1, 0))
        foot = np.zeros((len(times_s), 3))
        foot[:, :2] = self.places_mm[done]
        if is_up.any():
            lifts_s = self.lifts_s[step]
            share = ((times_s - lifts_s) / (self.lands_s[step] - lifts_s))[:, None]
            stride = self.places_mm[np.minimum(step + 1, len(self.places_mm) - 1)] - foot[:, :2]
            foot[:, :2] += np.where(is_up[:, None], blend(share) * stride, 0.0)
            foot[:, 2] = np.where(is_up, self.height_mm * lift(share[:, 0]), 0.0)
        return foot, ~is_up


def steps(
    neutral_mm: FloatArray,
    travel: Travel,
    *,
    lift_ratio: float,
    duty_ratio: float,
    cycle_s: float,
    height_mm: float,
) -> Steps:
    """Return the steps of a foot that stands `neutral_mm` from the body, (2,), at rest.

    Every step leads to where the foot is neutral in the middle of the next stance, so that it
    reaches as far ahead as behind. The foot steps until it is neutral with the body at rest.
    """
    # A foot that lifts after the body has come to rest steps to its neutral position.
    count = int(np.ceil(travel.duration_s / cycle_s - lift_ratio - 1e-9)) + 1
    lifts_s = cycle_s * (lift_ratio + np.arange(count))
    lands_s = lifts_s + cycle_s * (1.0 - duty_ratio)
    places_mm = below(
        neutral_mm, travel.at(np.concatenate([[0.0], lands_s + 0.5 * duty_ratio * cycle_s]))
    )
    stride_mm = np.hypot(*np.diff(places_mm, axis=0).T)
    late = lifts_s >= travel.duration_s - 1e-9 * cycle_s
    is_kept = ~(late & (stride_mm <= HOME_MM))
    return Steps(
        lifts_s=lifts_s[is_kept],
        lands_s=lands_s[is_kept],
        places_mm=places_mm[np.concatenate([[True], is_kept])],
        height_mm=height_mm,
    )


def below(neutral_mm: FloatArray, places: FloatArray) -> FloatArray:
    """Return the neutral position of a foot, (n, 2), for a body at `places`, (n, 3)."""
    cosine, sine = np.cos(places[:, 2]), np.sin(places[:, 2])
    x = cosine * neutral_mm[0] - sine * neutral_mm[1]
    y = sine * neutral_mm[0] + cosine * neutral_mm[1]
    return np.asarray(places[:, :2] + np.stack([x, y], axis=1))


class Twist(Struct, frozen=True, kw_only=True):
    """A velocity of the body in its own frame; turns to the left are positive."""

    forward_mm_s: float = 0.0
    left_mm_s: float = 0.0
    turn_deg_s: float = 0.0

    def as_array(self) -> FloatArray:
        """Return it as mm/s, mm/s, rad/s."""
        return np.array([self.forward_mm_s, self.left_mm_s, np.radians(self.turn_deg_s)])

    def towards(self, other: Twist, ratio: float) -> Twist:
        """Return the velocity at `ratio` between this one and `other`; exact at 0 and 1."""
        if ratio in (0.0, 1.0):
            return other if ratio else self
        here, there = self.as_array(), other.as_array()
        forward, left, turn = (here + ratio * (there - here)).tolist()
        return Twist(forward_mm_s=forward, left_mm_s=left, turn_deg_s=float(np.degrees(turn)))


STILL: Final = Twist()


class Foot(Struct, frozen=True, kw_only=True):
    """A foot that stands at `place_mm`, or steps there from `from_mm` until `lands_s`."""

    place_mm: FloatArray
    from_mm: FloatArray
    lifts_s: float = 0.0
    lands_s: float = 0.0


class Walker(Struct, frozen=True, kw_only=True):
    """A walking robot at a boundary of phases. Seconds count from the first one."""

    boundary: int
    twist: Twist
    changes: tuple[tuple[float, Twist, Twist], ...]
    """Changes of the velocity that are still blended in: time, old and new velocity."""
    place: FloatArray
    feet: tuple[Foot, ...]
    past_s: FloatArray
    past: Spline
    """The joint angles before the boundary, at equal steps that end there."""


class Stepper(Struct, frozen=True):
    """Steps of a gait that is steered; `gait.actions` are not used."""

    gait: Gait

    @property
    def phases(self) -> int:
        """Phases of a cycle: the number of different instants at which legs lift."""
        return len(set(self.gait.pattern.lifts_ratio))

    @property
    def phase_s(self) -> float:
        """How long a phase takes."""
        return self.gait.cycle_s / self.phases

    def changed(self, walker: Walker, twist: Twist) -> Walker:
        """Return the walker with another velocity from here on."""
        now_s = walker.boundary * self.phase_s
        kept = [own for own in walker.changes if now_s - own[0] < self.gait.cycle_s - INSTANT_S]
        if twist != walker.twist:
            kept.append((now_s, walker.twist, twist))
        return replace(walker, twist=twist, changes=tuple(kept))

    def walked(self, walker: Walker, count: int, own: list[list[Foot]]) -> Walker:
        """Return the walker `count` phases later; append every step of leg i to `own[i]`."""
        gait, cycle_s = self.gait, self.gait.cycle_s
        for _ in range(count):
            path = self.travel(walker, self.phases)
            feet = list(walker.feet)
            now_s = walker.boundary * self.phase_s
            for index, leg in enumerate(gait.legs):
                if not self._lifts(index, walker.boundary):
                    continue
                lands_s = now_s + cycle_s * (1.0 - gait.duty)
                middle = path.at(np.array([lands_s + 0.5 * gait.duty * cycle_s]))
                target = below(neutral_mm(leg), middle)[0]
                here = feet[index].place_mm
                if self._is_still(walker) and np.hypot(*(target - here)) <= HOME_MM:
                    continue
                feet[index] = Foot(place_mm=target, from_mm=here, lifts_s=now_s, lands_s=lands_s)
                own[index].append(feet[index])
            place = path.at(np.array([now_s + self.phase_s]))[0]
            walker = replace(walker, boundary=walker.boundary + 1, place=place, feet=tuple(feet))
        return walker

    def _lifts(self, leg: int, boundary: int) -> bool:
        lift = round(self.gait.pattern.lifts_ratio[leg] * self.phases)
        return boundary % self.phases == lift

    def _is_still(self, walker: Walker) -> bool:
        """Return whether the body has come to rest at this boundary."""
        now_s = walker.boundary * self.phase_s
        last_s = max((at_s for at_s, _, _ in walker.changes), default=-np.inf)
        return walker.twist == STILL and now_s - last_s >= self.gait.cycle_s - INSTANT_S

    def goes_on(self, walker: Walker) -> bool:
        """Return whether the body moves, or a foot steps or is not at its neutral position."""
        now_s = walker.boundary * self.phase_s
        if not self._is_still(walker):
            return True
        for leg, foot in zip(self.gait.legs, walker.feet, strict=True):
            home = below(neutral_mm(leg), walker.place[None, :])[0]
            if foot.lands_s > now_s + INSTANT_S or np.hypot(*(home - foot.place_mm)) > HOME_MM:
                return True
        return False

    def travel(self, walker: Walker, phases: int, since: Walker | None = None) -> Travel:
        """Return the path of the body from `walker` (or `since`) to `phases` after `walker`."""
        start = since or walker
        own_cells = -(-CELLS_PER_CYCLE // self.phases)
        changes, twist = walker.changes, walker.twist.as_array()
        if since is not None:
            changes = (*since.changes, *(own for own in changes if own not in since.changes))

        def own(times_s: FloatArray) -> FloatArray:
            velocity = np.tile(twist, (len(times_s), 1))
            for at_s, before, after in changes:
                left = 1.0 - blend((times_s - at_s) / self.gait.cycle_s)
                velocity -= left[:, None] * (after.as_array() - before.as_array())
            return velocity

        return integrated(
            own,
            cells=own_cells * (walker.boundary - start.boundary + phases),
            cell_s=self.phase_s / own_cells,
            starts_s=np.zeros(1),
            from_s=start.boundary * self.phase_s,
            place=start.place,
        )

    def legs(self, walker: Walker, own: list[list[Foot]] | tuple[()]) -> tuple[Steps, ...]:
        """Return the steps of every leg: the one under way at the boundary, and those in `own`."""
        now_s = walker.boundary * self.phase_s
        legs = []
        for index, foot in enumerate(walker.feet):
            under_way = [foot] if foot.lands_s > now_s + INSTANT_S else []
            taken = [*under_way, *(own[index] if own else [])]
            first = taken[0].from_mm if taken else foot.place_mm
            legs.append(
                Steps(
                    lifts_s=np.array([step.lifts_s for step in taken]),
                    lands_s=np.array([step.lands_s for step in taken]),
                    places_mm=np.array([first, *(step.place_mm for step in taken)]),
                    height_mm=self.gait.step_height_mm,
                )
            )
        return tuple(legs)
