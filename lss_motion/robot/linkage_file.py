"""The keys of a linkage in a robot file, and the angles and lengths that its other keys share."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from lss_motion.files.keys import Field, FileModel

ANGLE_MAX_DEG: Final = 36_000.0
"""A hundred turns: more than any winch; a larger angle is a typing error."""

AngleDeg = Annotated[float, Field(ge=-ANGLE_MAX_DEG, le=ANGLE_MAX_DEG)]

PATH_MAX_CHARS: Final = 256
"""Names below /dev/serial/by-id are long, but not longer than this."""

TABLE_POINTS_MAX: Final = 1000
"""Chosen: far more than a person measures."""
LINKAGE_MAX_MM: Final = 10_000.0
"""Chosen: ten metres; more is a typing error."""
RATIO_MIN: Final = 0.02
RATIO_MAX: Final = 1000.0
"""Chosen: more than any gear of such servos; a smaller ratio is singular (`SLOPE_MIN`)."""
Points = Annotated[list[AngleDeg], Field(min_length=1, max_length=TABLE_POINTS_MAX)]
LengthMm = Annotated[float, Field(gt=0.0, le=LINKAGE_MAX_MM)]
Ratio = Annotated[float, Field(ge=RATIO_MIN, le=RATIO_MAX)]


class LinkageEntry(FileModel, title="linkage"):
    """What stands between a joint and its servo: a table of measured points, or a four-bar.

    A table needs joint_deg and servo_deg. A four-bar (kind: four_bar) needs its four lengths.
    """

    kind: Literal["table", "four_bar"] = Field(
        default="table",
        description="table: a smooth curve through measured points. four_bar: computed from four "
        "lengths.",
    )
    joint_deg: Points | None = Field(
        default=None,
        description="Table: angles of the joint, rising; 3 or more. They cover range_deg.",
        examples=[[0, 5, 12, 22]],
    )
    servo_deg: Points | None = Field(
        default=None,
        description="Table: the angle of the servo at each of joint_deg, before zero_deg and "
        "direction; all rising or all falling.",
        examples=[[-8, 6, 30, 71]],
    )
    smooth_deg: float | None = Field(
        default=None,
        gt=0.0,
        le=90.0,
        description="Table: the curve may miss each measured point by so many degrees of the "
        "servo, to be smooth. `lss-motion check ROBOT` shows what it makes of them.",
    )
    crank_mm: LengthMm | None = Field(
        default=None, description="Four-bar: from the axis of the servo to the rod."
    )
    rod_mm: LengthMm | None = Field(
        default=None, description="Four-bar: from the crank to the rocker."
    )
    rocker_mm: LengthMm | None = Field(
        default=None, description="Four-bar: from the axis of the joint to the rod."
    )
    base_mm: LengthMm | None = Field(
        default=None, description="Four-bar: from the axis of the servo to that of the joint."
    )
    offset_deg: AngleDeg | None = Field(
        default=None,
        description="Four-bar: how far the rocker leans from the perpendicular of the base, away "
        "from the servo, where the joint angle is 0. Default 0.",
    )
    turns: Literal["towards", "away"] | None = Field(
        default=None,
        description="Four-bar: larger joint angles turn the rocker towards the servo (default), or "
        "away from it.",
    )
    rod: Literal["open", "crossed"] | None = Field(
        default=None,
        description="Four-bar: whether the rod crosses the line between both axes. Default open.",
    )
