"""The keys of `figure` and `urdf` in a robot file: what the robot looks like."""

from __future__ import annotations

import math
from typing import Annotated, Final, Literal

from lss_motion.files.keys import Check, Field, FileModel, Name, Plain, Text, check_text
from lss_motion.robot.figure import DIRECTIONS
from lss_motion.robot.linkage_file import PATH_MAX_CHARS, AngleDeg

AXES_COUNT: Final = 3
DIRECTION_MAX: Final = 1e6
"""Chosen: far more than the length of a direction that is meant in mm."""


def _check_direction_of(value: object, _key: str) -> object:
    if isinstance(value, str) and value in DIRECTIONS:
        return value
    if (
        isinstance(value, list)
        and len(value) == AXES_COUNT
        and all(type(part) in (int, float) and abs(part) <= DIRECTION_MAX for part in value)
    ):
        if math.hypot(*value) * DIRECTION_MAX >= 1.0:
            return value
        raise ValueError("is no direction; one part must not be 0")
    words = ", ".join(DIRECTIONS)
    raise ValueError(f"must be one of {words}, or a direction such as [1, 0, 0.5]")


Direction = Annotated[
    str | list[float] | None,
    Plain(
        _check_direction_of,
        {
            "anyOf": [
                {"enum": list(DIRECTIONS)},
                {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
            ]
        },
    ),
]
FIGURE_MAX_MM: Final = 100_000.0
"""Chosen: a hundred metres; more is a typing error or another unit."""
FIGURE_LINKS_MAX: Final = 500
"""Chosen: ten times the links of the largest figure that is known to be driven by such servos."""
LINK_MAX_KG: Final = 1000.0
"""Chosen: a tonne; more is a typing error or another unit."""
FigureShape = Literal["bar", "capsule", "box", "ellipsoid"]
FigureMm = Annotated[float, Field(ge=-FIGURE_MAX_MM, le=FIGURE_MAX_MM)]
FigureSizeMm = Annotated[float, Field(gt=0.0, le=FIGURE_MAX_MM)]


class FigureLinkEntry(FileModel, title="link of a figure"):
    """One part of the robot as it looks, and as it weighs: a joint turns it about its beginning.

    Directions are x forward, y left and z up, those of the robot with all joints at rest_deg.
    """

    parent: Name | None = Field(
        default=None,
        description="The link at whose end this one begins. Left out: it stands on the ground.",
    )
    joint: Name | None = Field(
        default=None,
        description="The joint that turns it. Several links may have the same one. Left out: it "
        "is fixed to its parent.",
    )
    axis: Direction = Field(
        default=None,
        description="The joint turns it about this direction, counter-clockwise for larger angles "
        "if the direction points at you.",
        examples=["y"],
    )
    rest_deg: AngleDeg = Field(
        default=0.0, description="The angle of the joint at which the link points along."
    )
    along: Direction = Field(default="x", description="Where it points from its beginning.")
    length_mm: float = Field(
        default=0.0,
        ge=0.0,
        le=FIGURE_MAX_MM,
        description="How long it is. 0: nothing is drawn, such as between two joints in one place.",
    )
    offset_mm: Annotated[list[FigureMm], Field(min_length=3, max_length=3)] = Field(
        default=[0.0, 0.0, 0.0],
        description="Where it begins, from the end of its parent: x, y, z.",
    )
    width_mm: float | None = Field(
        default=None,
        gt=0.0,
        le=FIGURE_MAX_MM,
        description="How thick it is drawn. Default: a thirtieth of the whole figure.",
    )
    shape: FigureShape = Field(
        default="bar",
        description="What it is. bar: from its beginning to its end, width_mm thick. capsule: the "
        "same with round ends. box, ellipsoid: of size_mm, in the middle of it.",
    )
    size_mm: Annotated[list[FigureSizeMm], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="Box and ellipsoid: how large it is along x, y and z, such as a head.",
        examples=[[80, 70, 90]],
    )
    shade: Literal["dark", "light"] | None = Field(
        default=None,
        description="Drawn dark or light, as an eye. Left out: in the colour of the figure.",
    )
    mass_kg: float | None = Field(
        default=None,
        ge=0.0,
        le=LINK_MAX_KG,
        description="What it weighs, with the servos in it. Left out: unknown.",
    )
    com_mm: Annotated[list[FigureMm], Field(min_length=3, max_length=3)] | None = Field(
        default=None,
        description="Its centre of mass, from its beginning: x, y, z. Left out: its middle.",
    )
    foot: bool = Field(
        default=False,
        description="The robot stands on the end of this link: the ground is drawn below the "
        "lowest foot.",
    )


FilePath = Annotated[str, Field(min_length=1, max_length=PATH_MAX_CHARS), Check(check_text)]


class UrdfEntry(FileModel, title="urdf"):
    """A URDF file as the picture of the robot. Its meshes are drawn if they are STL files."""

    file: FilePath = Field(
        description="The file; its path is relative to the robot file and stays below its folder, "
        "as those of its meshes."
    )
    joints: dict[Name, Text] = Field(
        default={},
        description="The joint of the URDF file for each joint of this file. Left out: joints of "
        "the same name.",
        examples=[{"shoulder": "shoulder_pan_joint"}],
    )
