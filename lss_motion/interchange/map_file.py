"""The keys of a map file: what another robot's joints are on ours.

Importing this module imports pydantic, so it is imported where a file is read.
"""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field

from lss_motion.robot.file import AngleDeg  # noqa: TC001  (pydantic reads it)
from lss_motion.validation import FileModel, Name

SCALE_MAX: Final = 1e6
"""Degrees per unit: a spindle of 1 mm a turn makes 360,000 of a metre."""


def _check_sign(sign: int) -> int:
    if sign not in {1, -1}:
        raise ValueError("must be 1 or -1")
    return sign


class MapEntry(FileModel, title="mapped joint"):
    """One joint: `angle = offset_deg + sign * scale * value`, the value in degrees if an angle."""

    name: Name | None = Field(
        default=None, description="Joint of our robot. Default: the same name."
    )
    skip: bool = Field(default=False, description="Leave this joint out.")
    unit: Literal["deg", "rad", "us", "m", "raw"] | None = Field(
        default=None, description="What the values are. Default: what the file says."
    )
    sign: Annotated[int, AfterValidator(_check_sign)] = Field(
        default=1, description="-1 where our joint turns the other way."
    )
    scale: float | None = Field(
        default=None,
        gt=0.0,
        le=SCALE_MAX,
        description="Degrees of our joint per unit; needed where the unit is no angle.",
    )
    offset_deg: AngleDeg = Field(default=0.0, description="Angle of our joint at value 0.")


class MapFile(FileModel, title="map file"):
    """How the joints of a motion file become joints of a robot."""

    joints: Annotated[dict[str, MapEntry], Field(min_length=1)]
