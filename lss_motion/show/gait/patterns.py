"""Gait patterns as data: when each leg lifts; and the order of the legs of a robot."""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.show.gait.model import Pattern

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.show.gait.model import Leg

PARTS: Final[Mapping[int, tuple[str, ...]]] = MappingProxyType(
    {
        4: ("left front", "left rear", "right front", "right rear"),
        6: (
            "left front",
            "left middle",
            "left rear",
            "right front",
            "right middle",
            "right rear",
        ),
    }
)
"""Positions of the legs by the number of legs, in the order of `Pattern.lifts_ratio`."""


_THIRD, _SIXTH = 1.0 / 3.0, 1.0 / 6.0

_SIX = (
    # Two sets of three legs in turn.
    Pattern(name="tripod", lifts_ratio=(0, 0.5, 0, 0.5, 0, 0.5), duty_ratio=0.5, is_static=True),
    # A wave from rear to front on each side, half a cycle apart.
    Pattern(
        name="ripple",
        lifts_ratio=(2 * _THIRD, _THIRD, 0, _SIXTH, 5 * _SIXTH, 0.5),
        duty_ratio=2 * _THIRD,
        is_static=True,
    ),
    # One leg at a time, from rear to front, left and then right.
    Pattern(
        name="wave",
        lifts_ratio=(2 * _SIXTH, _SIXTH, 0, 5 * _SIXTH, 4 * _SIXTH, 0.5),
        duty_ratio=5 * _SIXTH,
        is_static=True,
    ),
    # Opposite pairs in turn: four feet are always down.
    Pattern(
        name="amble",
        lifts_ratio=(0, _THIRD, 2 * _THIRD, 2 * _THIRD, _THIRD, 0),
        duty_ratio=2 * _THIRD,
        is_static=True,
    ),
)
_FOUR = (
    # Diagonal pairs in turn.
    Pattern(name="trot", lifts_ratio=(0, 0.5, 0.5, 0), duty_ratio=0.5, is_static=False),
    # The legs of one side in turn.
    Pattern(name="pace", lifts_ratio=(0, 0, 0.5, 0.5), duty_ratio=0.5, is_static=False),
    # Front and rear in turn.
    Pattern(name="bound", lifts_ratio=(0, 0.5, 0, 0.5), duty_ratio=0.5, is_static=False),
    # One leg at a time, rear before front, as dogs walk; not stable at every instant.
    Pattern(name="walk", lifts_ratio=(0.25, 0, 0.75, 0.5), duty_ratio=0.75, is_static=False),
    # The same, slower and with sway: the centre is always over three feet.
    Pattern(
        name="crawl",
        lifts_ratio=(0.25, 0, 0.75, 0.5),
        duty_ratio=0.85,
        is_static=True,
        sway_ratio=_SIXTH,
    ),
)

PATTERNS: Final[Mapping[int, Mapping[str, Pattern]]] = MappingProxyType(
    {
        4: MappingProxyType({pattern.name: pattern for pattern in _FOUR}),
        6: MappingProxyType({pattern.name: pattern for pattern in _SIX}),
    }
)
"""By number of legs and name; the first is the default. The phases are those of the literature."""

SIDES_NEEDED: Final = "as many legs on the left (hip y above 0) as on the right (below 0)"


def in_order(legs: Sequence[Leg]) -> tuple[Leg, ...] | None:
    """Return the legs in the order of `PARTS`, by their hips; None if the sides are not equal."""
    left = sorted((leg for leg in legs if leg.hip_mm[1] > 0.0), key=lambda leg: -leg.hip_mm[0])
    right = sorted((leg for leg in legs if leg.hip_mm[1] < 0.0), key=lambda leg: -leg.hip_mm[0])
    if len(left) != len(right) or len(left) + len(right) != len(legs):
        return None
    return (*left, *right)
