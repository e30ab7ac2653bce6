"""The values of a gait: legs, pattern, actions; and the known patterns as data.

They are immutable. `show.gait.load` makes them from files.

Frames are those of ROS (REP 103): x forward, y left, z up, turns counter-clockwise seen from above.
The body's origin lies between the hips, at their height. A foot is the point at the shank's end.
"""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from msgspec import Struct, field

from lss_motion.files.source import Located

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

LEAD_IN_CYCLES: Final = 3
"""After so many cycles of one velocity a walk is steady: feet that were placed before the velocity
was blended in have stepped once more, and the effect on the spline has decayed."""

LAID_OUT_CYCLES: Final = 7
"""Cycles that are laid out of a looped walk: lead-in, the looped cycle, and an equal lead-out."""

Triple = tuple[float, float, float]


class LegKind(StrEnum):
    """How the three joints of a leg are arranged, from the body to the foot."""

    COXA = "coxa-femur-tibia"
    """As in insects: the coxa turns the leg about a vertical axis, femur and tibia lift it."""
    ABDUCTION = "abduction-thigh-shank"
    """As in dogs: the first joint swings the leg sideways, thigh and shank forward and back."""


class Leg(Struct, frozen=True, kw_only=True):
    """One leg. Its kinematic angles are defined in `kinematics`.

    Joint angle and kinematic angle: `joint = direction * (kinematic - zero_deg)`, for each of the
    three joints.
    """

    name: str
    kind: LegKind
    joints: tuple[str, str, str]
    hip_mm: tuple[float, float]
    """Where the first axis meets the plane of the hips: x, y in the body."""
    yaw_deg: float
    """Where a coxa leg points when its coxa is at 0, seen from above; 0 is forward."""
    lengths_mm: Triple
    """From first axis to second, to third, to foot."""
    stance_mm: float
    """Distance from hip to foot in a stand: along the yaw, or straight left or right."""
    knee: Literal["back", "forward"] = "back"
    """Where the knee of an abduction leg points."""
    zero_deg: Triple = (0.0, 0.0, 0.0)
    direction: tuple[int, int, int] = (1, 1, 1)


class Pattern(Struct, frozen=True, kw_only=True):
    """When in a cycle each leg lifts, as a share of the cycle, in the order of `patterns.PARTS`.

    `duty_ratio` is the default share of the cycle in which a foot is on the ground. `is_static`:
    the robot can stop at any instant without falling; `pacing` checks that. `sway_ratio` is how far
    the body leans away from a lifted leg by default, as a share of the distance from body to foot.
    """

    name: str
    lifts_ratio: tuple[float, ...]
    duty_ratio: float
    is_static: bool
    sway_ratio: float = 0.0


class BodyPose(Struct, frozen=True, kw_only=True):
    """Where the body is over its feet.

    `shift_mm`: forward, left, up from where it stands. `tilt_deg`: roll, pitch, yaw; positive are
    right side down, nose down, turned left. Applied in the order roll, pitch, yaw.
    """

    shift_mm: Triple = (0.0, 0.0, 0.0)
    tilt_deg: Triple = (0.0, 0.0, 0.0)


class Wave(Struct, frozen=True, kw_only=True):
    """A swing of the body about its pose, with the amplitudes of `pose` and the period `every_s`.

    `start_ratio` is its phase at the start of a passage, as a share of the period.
    """

    pose: BodyPose
    every_s: float
    start_ratio: float = 0.0


class BodyMove(Located, frozen=True, kw_only=True):
    """Bring the body to a pose in `in_s` over standing feet, and keep it for `hold_s`.

    Consecutive moves without a hold do not stop between them.
    """

    _where: ClassVar = frozenset({"line"})
    pose: BodyPose
    in_s: float
    hold_s: float = 0.0
    label: str = ""
    line: int | None = None


class Walk(Located, frozen=True, kw_only=True):
    """Walk whole cycles at one velocity of the body, in its own frame."""

    _where: ClassVar = frozenset({"line"})
    forward_mm_s: float
    left_mm_s: float
    turn_deg_s: float
    cycles: int
    more_cycles: int | None = 0
    """Cycles that the loop of the middle adds; None: without end."""
    label: str = ""
    line: int | None = None


Action = BodyMove | Walk


class Gait(Located, frozen=True, kw_only=True):
    """Legs, pattern and actions. The robot starts in the pose `start`, feet at their stance.

    `cycle_s` and all speeds are those of the author; `paced` slows them to the servo limits.
    `sway_mm` is how far the body leans away from a lifted leg.
    """

    _where: ClassVar = frozenset({"path", "robot_path"})
    name: str
    legs: tuple[Leg, ...]
    height_mm: float
    pattern: Pattern
    duty: float
    cycle_s: float
    step_height_mm: float
    sway_mm: float
    actions: tuple[Action, ...]
    waves: tuple[Wave, ...] = ()
    """Added to all poses, while standing and while walking. They fade at every rest."""
    start: BodyPose = field(default_factory=BodyPose)
    sit: BodyPose | None = None
    """The pose in which the robot sits; None: it cannot."""
    loop: int | None = 1
    path: Path | None = None
    robot_path: Path | None = None


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
