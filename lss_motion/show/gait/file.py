"""The keys of a gait file: names, units, and bounds of each key alone.

`show.gait.load` checks what several keys mean together. The descriptions are the
reference of the file format.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from lss_motion.files.keys import (
    FILE_VERSION,
    VERSION,
    Check,
    Field,
    FileModel,
    Name,
    Text,
    Version,
)
from lss_motion.robot.linkage_file import AngleDeg  # noqa: TC001  (read when it is checked)
from lss_motion.show.file import Loop, TimeS  # noqa: TC001  (read when they are checked)
from lss_motion.show.gait.model import PATTERNS, LegKind
from lss_motion.show.model import TIME_MAX_S

LENGTH_MAX_MM: Final = 10_000.0
"""Chosen: ten metres; more is a typing error or another unit."""

SPEED_MAX_MM_S: Final = 10_000.0
WAY_MAX_MM: Final = 10_000_000.0
"""Chosen: ten kilometres, a day at full speed."""

CYCLE_MIN_S: Final = 0.05
"""Ten control ticks of a servo."""

ACTIONS_MAX: Final = 1_000
LAYERS_MAX: Final = 16
"""Chosen: more swings than a viewer can tell apart."""

KINDS: Final = tuple(kind.value for kind in LegKind)
PATTERN_NAMES: Final = tuple(name for patterns in PATTERNS.values() for name in patterns)


def _check_direction(directions: list[int]) -> list[int]:
    if not set(directions) <= {1, -1}:
        raise ValueError("each must be 1 or -1")
    return directions


LengthMm = Annotated[float, Field(gt=0.0, le=LENGTH_MAX_MM)]
PlaceMm = Annotated[float, Field(ge=-LENGTH_MAX_MM, le=LENGTH_MAX_MM)]
SpeedMmS = Annotated[float, Field(ge=-SPEED_MAX_MM_S, le=SPEED_MAX_MM_S)]
TurnDegS = Annotated[float, Field(ge=-3600.0, le=3600.0)]
DurationS = Annotated[float, Field(ge=CYCLE_MIN_S, le=3600.0)]
TiltDeg = Annotated[float, Field(ge=-90.0, le=90.0)]


class LegDefaults(FileModel, title="leg defaults"):
    """Fields that legs share. Values of a leg come first."""

    kind: Annotated[str, Field(json_schema_extra={"enum": list(KINDS)})] | None = Field(
        default=None,
        description="coxa-femur-tibia: as in insects. abduction-thigh-shank: as in dogs.",
    )
    lengths_mm: Annotated[list[LengthMm], Field(min_length=3, max_length=3)] | None = Field(
        default=None, description="From first axis to second, to third, to the end of the foot."
    )
    stance_mm: Annotated[float, Field(ge=0.0, le=LENGTH_MAX_MM)] | None = Field(
        default=None, description="Distance of the standing foot outwards from its hip."
    )
    knee: Literal["back", "forward"] | None = Field(
        default=None, description="Direction of the knee; abduction legs only. Default: back."
    )
    zero_deg: Annotated[list[AngleDeg], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="The kinematic angles at which the three joints are at 0. Kinematic angles "
        "are 0 with coxa and femur level and the tibia straight down, or with a straight leg "
        "hanging down; positive are a turn to the left or outwards, a lift or a swing forward.",
    )
    direction: (
        Annotated[list[int], Field(min_length=3, max_length=3), Check(_check_direction)] | None
    ) = Field(
        default=None,
        description="-1 where the joint counts the other way: "
        "joint angle = direction * (kinematic angle - zero_deg).",
    )


class LegEntry(LegDefaults, title="leg"):
    """One leg: its position and its joints."""

    joints: Annotated[list[Name], Field(min_length=3, max_length=3)] = Field(
        description="The three joints, from the body to the foot."
    )
    hip_mm: Annotated[list[PlaceMm], Field(min_length=2, max_length=2)] = Field(
        description="Position of the first axis: forward and left of the body's centre."
    )
    yaw_deg: AngleDeg | None = Field(
        default=None,
        description="Direction of a coxa leg with its coxa at 0: 0 forward, 90 left.",
    )


class MoveEntry(FileModel, title="move"):
    """The body changes its height over standing feet."""

    in_s: DurationS = Field(default=1.0, description="How long the move takes.")
    hold_s: TimeS = Field(default=0.0, description="How long the body stays there.")
    label: Text | None = Field(default=None, description="Shown on screen and in plots.")


class PoseEntry(MoveEntry, title="pose"):
    """The body shifts and tilts over its feet. It keeps the pose while the robot walks."""

    shift_mm: Annotated[list[PlaceMm], Field(min_length=3, max_length=3)] = Field(
        default=[0.0, 0.0, 0.0], description="Forward, left, up from its position in a stand."
    )
    tilt_deg: Annotated[list[TiltDeg], Field(min_length=3, max_length=3)] = Field(
        default=[0.0, 0.0, 0.0],
        description="Roll (right side down), pitch (nose down), yaw (turned left).",
    )


class SwingEntry(FileModel, title="body layer"):
    """The body swings about its pose. Layers add up."""

    shift_mm: Annotated[list[PlaceMm], Field(min_length=3, max_length=3)] = Field(
        default=[0.0, 0.0, 0.0], description="Amplitude forward, left, up."
    )
    tilt_deg: Annotated[list[TiltDeg], Field(min_length=3, max_length=3)] = Field(
        default=[0.0, 0.0, 0.0], description="Amplitude of roll, pitch, yaw."
    )
    every_s: DurationS = Field(description="Period of the swing.")
    start: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0,
        description="Phase at the start, a share of the period: 0.25 is the amplitude.",
    )


class WalkEntry(FileModel, title="walk"):
    """Walk for whole cycles at one velocity. Consecutive walks do not stop between them."""

    forward_mm_s: SpeedMmS = 0.0
    left_mm_s: SpeedMmS = 0.0
    turn_deg_s: TurnDegS = Field(default=0.0, description="Positive turns to the left.")
    stride_mm: PlaceMm | None = Field(
        default=None, description="Forward per cycle, in place of forward_mm_s."
    )
    for_s: Annotated[float, Field(ge=CYCLE_MIN_S, le=TIME_MAX_S)] | None = Field(
        default=None, description="Duration, rounded to whole cycles."
    )
    distance_mm: Annotated[float, Field(gt=0.0, le=WAY_MAX_MM)] | None = Field(
        default=None, description="Exact distance; the speed is lowered to fill whole cycles."
    )
    cycles: Loop = Field(default=1, description="A count, or forever: until the show is stopped.")
    label: Text | None = Field(default=None, description="Shown on screen and in plots.")


class TurnEntry(FileModel, title="turn"):
    """Turn on the spot by exactly an angle."""

    deg: Annotated[float, Field(ge=-3600.0, le=3600.0)] = Field(description="Positive is left.")
    turn_deg_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 30.0
    label: Text | None = Field(default=None, description="Shown on screen and in plots.")


class ActionEntry(FileModel, title="action"):
    """One action: exactly one of these keys."""

    stand: MoveEntry | None = Field(default=None, description="Stand straight.")
    sit: MoveEntry | None = Field(default=None, description="Go down to sit_height_mm.")
    pose: PoseEntry | None = None
    walk: WalkEntry | None = None
    turn: TurnEntry | None = None


class GaitFile(FileModel, title="gait file"):
    """A robot with four or six legs, its pattern, and its actions."""

    gait: Text = Field(description="Name of the gait, as shown on screen and in reports.")
    version: Version = Field(default=FILE_VERSION, description=VERSION)
    robot: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="Robot file, relative to this file. May be left out if --robot gives it.",
        examples=["robots/hexapod.yaml"],
    )
    legs: Annotated[dict[Name, LegEntry], Field(min_length=1)] | None = Field(
        default=None,
        description="The legs by name, in any order; the hips give their positions.",
    )
    leg: LegDefaults = Field(default_factory=LegDefaults, description="Fields that all legs share.")
    legs_from: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="In place of legs and leg: a gait file that has them, relative to this file.",
        examples=["hexapod_walk.yaml"],
    )
    height_mm: LengthMm = Field(description="Height of the hips over the ends of the feet.")
    sit_height_mm: LengthMm | None = Field(default=None, description="Height of the hips in a sit.")
    start: Literal["standing", "sitting"] = Field(
        default="standing", description="Pose before the first action."
    )
    pattern: Annotated[str, Field(json_schema_extra={"enum": list(PATTERN_NAMES)})] | None = Field(
        default=None,
        description="Six legs: tripod (default), ripple, wave, amble. "
        "Four: trot (default), pace, bound, walk, crawl.",
    )
    duty: float | None = Field(
        default=None,
        ge=0.5,
        le=0.95,
        description="Share of the cycle in which a foot stands. Default: that of the pattern.",
    )
    cycle_s: DurationS = Field(
        default=1.0,
        description="Duration of one step of every leg. It is made longer if the servos need that.",
    )
    step_height_mm: LengthMm = Field(default=25.0, description="Height to which feet are lifted.")
    sway_mm: Annotated[float, Field(ge=0.0, le=LENGTH_MAX_MM)] | None = Field(
        default=None,
        description="How far the body leans away from a lifted leg. Default: that of the pattern, "
        "0 for all but crawl.",
    )
    layers: Annotated[list[SwingEntry], Field(max_length=LAYERS_MAX)] = Field(
        default=[],
        description="Swings of the body on top of all actions. They fade in and out over at most a "
        "second wherever the robot comes to rest.",
    )
    do: Annotated[list[ActionEntry], Field(min_length=1, max_length=ACTIONS_MAX)] = Field(
        description="Actions in order."
    )
    loop: Loop = Field(default=1, description="How often it is played: a count, or forever.")
