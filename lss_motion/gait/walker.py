"""How a steered robot steps: its velocity, its body and its feet, from boundary to boundary.

Every change of the velocity is blended in over one cycle. Where a foot lands is settled when it
lifts: where it will be neutral in the middle of its stance, if the velocity stays as it is then.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.gait.curves import blend
from lss_motion.gait.kinematics import neutral_mm
from lss_motion.gait.steps import HOME_MM, Steps, below
from lss_motion.gait.travel import CELLS_PER_CYCLE, Travel, integrated

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.gait.curves import Spline
    from lss_motion.gait.model import Gait

    FloatArray = NDArray[np.float64]

INSTANT_S: Final = 1e-9
"""Instants this near are one: rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Twist:
    """A velocity of the body in its own frame; turns to the left are positive."""

    forward_mm_s: float = 0.0
    left_mm_s: float = 0.0
    turn_deg_s: float = 0.0

    def as_array(self) -> FloatArray:
        """Return it as mm/s, mm/s, rad/s."""
        return np.array([self.forward_mm_s, self.left_mm_s, np.radians(self.turn_deg_s)])

    def towards(self, other: Twist, ratio: float) -> Twist:
        """Return the velocity that is `ratio` of the way to `other`; at 0 and 1 exactly."""
        if ratio in (0.0, 1.0):
            return other if ratio else self
        here, there = self.as_array(), other.as_array()
        forward, left, turn = (here + ratio * (there - here)).tolist()
        return Twist(forward_mm_s=forward, left_mm_s=left, turn_deg_s=float(np.degrees(turn)))


STILL: Final = Twist()


@dataclass(frozen=True, slots=True, kw_only=True)
class Foot:
    """Where a foot stands, or where its step leads, which ends at `lands_s` and began there."""

    place_mm: FloatArray
    from_mm: FloatArray
    lifts_s: float = 0.0
    lands_s: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Walker:
    """A walking robot at a boundary of phases. Seconds count from the first one."""

    boundary: int
    twist: Twist
    changes: tuple[tuple[float, Twist, Twist], ...]
    """Changes of the velocity that are still blended: when, from what, to what."""
    place: FloatArray
    feet: tuple[Foot, ...]
    past_s: FloatArray
    past: Spline
    """The joints until now, at equal steps that end now."""


@dataclass(frozen=True, slots=True)
class Stepper:
    """Steps of a gait that is steered; `gait.actions` do not matter."""

    gait: Gait

    @property
    def phases(self) -> int:
        """How many phases a cycle has: as many as there are instants at which legs lift."""
        return len(set(self.gait.pattern.lifts_ratio))

    @property
    def phase_s(self) -> float:
        return self.gait.cycle_s / self.phases

    def changed(self, walker: Walker, twist: Twist) -> Walker:
        """Return the walker with another velocity from here on."""
        now_s = walker.boundary * self.phase_s
        kept = [own for own in walker.changes if now_s - own[0] < self.gait.cycle_s - INSTANT_S]
        if twist != walker.twist:
            kept.append((now_s, walker.twist, twist))
        return replace(walker, twist=twist, changes=tuple(kept))

    def walked(self, walker: Walker, count: int, own: list[list[Foot]]) -> Walker:
        """Return the walker `count` phases later; append every step to `own`."""
        gait, cycle_s = self.gait, self.gait.cycle_s
        for _ in range(count):
            way = self.travel(walker, self.phases)
            feet = list(walker.feet)
            now_s = walker.boundary * self.phase_s
            for index, leg in enumerate(gait.legs):
                if not self._lifts(index, walker.boundary):
                    continue
                lands_s = now_s + cycle_s * (1.0 - gait.duty)
                middle = way.at(np.array([lands_s + 0.5 * gait.duty * cycle_s]))
                target = below(neutral_mm(leg), middle)[0]
                here = feet[index].place_mm
                if self._is_still(walker) and np.hypot(*(target - here)) <= HOME_MM:
                    continue
                feet[index] = Foot(place_mm=target, from_mm=here, lifts_s=now_s, lands_s=lands_s)
                own[index].append(feet[index])
            place = way.at(np.array([now_s + self.phase_s]))[0]
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
        """Return whether the body still moves, or a foot is under way or not yet home."""
        now_s = walker.boundary * self.phase_s
        if not self._is_still(walker):
            return True
        for leg, foot in zip(self.gait.legs, walker.feet, strict=True):
            home = below(neutral_mm(leg), walker.place[None, :])[0]
            if foot.lands_s > now_s + INSTANT_S or np.hypot(*(home - foot.place_mm)) > HOME_MM:
                return True
        return False

    def travel(self, walker: Walker, phases: int, since: Walker | None = None) -> Travel:
        """Return the way of the body from here, or from `since`, for so many phases more."""
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
        """Return the steps of every leg: one that is under way here, and those that follow."""
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
