"""The keys of a sequence file: names, units, plain bounds. What they mean is `sequence.load`'s.

Importing this module imports pydantic, so it is imported where a file is read.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

from pydantic import Field, PlainValidator, WithJsonSchema

from lss_motion.robot.file import AngleDeg  # noqa: TC001  (pydantic reads it)
from lss_motion.sequence.timing import KEYFRAMES_MAX, TIME_MAX_S
from lss_motion.validation import FileModel, Name, Text

TIME_MIN_S: Final = 0.001
"""The unit of T on the wire: one millisecond."""

LOOP_MAX: Final = 1_000_000
"""Chosen: a one-second loop for twelve days; more is `forever`."""

FOREVER: Final = "forever"

TimeS = Annotated[float, Field(ge=0.0, le=TIME_MAX_S)]
Ease = Literal["smooth", "spline", "linear", "hold"]


def _check_loop(loop: Any) -> int | Literal["forever"]:  # noqa: ANN401  whatever YAML holds
    match loop:
        case "forever":
            return "forever"
        case int() if not isinstance(loop, bool) and 1 <= loop <= LOOP_MAX:
            return loop
        case _:
            raise ValueError(f"must be a count from 1 to {LOOP_MAX:,}, or forever")


Loop = Annotated[
    int | Literal["forever"],
    PlainValidator(_check_loop),
    WithJsonSchema(
        {"anyOf": [{"type": "integer", "minimum": 1, "maximum": LOOP_MAX}, {"const": FOREVER}]}
    ),
]


class KeyframeEntry(FileModel, title="keyframe"):
    """Joint angles to be reached at one time; joints that it does not name are left alone.

    A keyframe names at least one joint, by `pose`, `deg` or both. `at_s` is absolute; `after_s`
    counts from the end of the keyframe before (its time plus its `hold_s`), for the first
    keyframe from the start of the show. The first keyframe may leave its time out: 0.
    """

    at_s: TimeS | None = Field(default=None, description="Seconds from the start of the show.")
    after_s: TimeS | None = Field(
        default=None,
        description="Seconds from the end of the keyframe before, hold_s included.",
    )
    pose: Name | None = Field(default=None, description="Name of a pose of the robot file.")
    deg: dict[Name, AngleDeg] | None = Field(
        default=None,
        description="Joint angles in degrees; they win over those of the pose.",
        examples=[{"elbow": -20}],
    )
    hold_s: TimeS = Field(default=0.0, description="How long the named joints stay there.")
    anchor: bool = Field(
        default=False, description="This time must be met; planning fails rather than being late."
    )
    ease: Ease | None = Field(
        default=None,
        description="How the joints travel to this keyframe, if not as the whole file does.",
    )
    label: Text | None = Field(
        default=None, description="Shown on screen and in plots. Default: the name of the pose."
    )


class SequenceFile(FileModel, title="sequence file"):
    """A show: keyframes in order of time, for one robot."""

    sequence: Text = Field(description="Name of the sequence, as shown on screen and in reports.")
    robot: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="Robot file, relative to this file. May be left out if always given by "
        "--robot.",
        examples=["robots/desk_arm.yaml"],
    )
    timing: Literal["authored", "fastest", "fit"] | None = Field(
        default=None,
        description="authored: as the keyframes say, slower only where a servo cannot follow. "
        "fastest: as fast as the servos can, no times. fit: one pass takes duration_s. "
        "Default: authored, or fastest if no keyframe has a time.",
    )
    duration_s: float | None = Field(
        default=None,
        ge=TIME_MIN_S,
        le=TIME_MAX_S,
        description="How long one pass takes; with timing: fit only.",
    )
    interpolation: Ease = Field(
        default="smooth",
        description="How joints travel between keyframes. smooth: never beyond the keys. "
        "spline: rounder, may swing beyond them. linear: straight lines with stops. "
        "hold: stay, then move as late as possible.",
    )
    keyframes: Annotated[list[KeyframeEntry], Field(min_length=1, max_length=KEYFRAMES_MAX)]
    loop: Loop = Field(default=1, description="How often it is played: a count, or forever.")
