"""The figure of a robot from the legs of its gait, and the figure that pictures of a robot use."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, assert_never

from lss_motion.robot.figure import ORIGIN, UPRIGHT, Figure, FigureLink, turned
from lss_motion.robot.urdf import urdf_figure
from lss_motion.show.gait.model import LegKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.robot.figure import Vector
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait, Leg


def figure_of(robot: Robot, gait: Gait | None = None) -> Figure | None:
    """Return the figure of its robot file, else of the legs of the gait; None: it has none.

    Raises `InputError` with the line where the URDF file that it names is wrong or missing.
    """
    if robot.figure is not None:
        return robot.figure
    if robot.urdf is not None:
        return urdf_figure(robot.urdf, robot.joints)
    return None if gait is None else figure_of_legs(gait.legs)


def figure_view(robot: Robot, gait: Gait | None = None) -> dict[str, Any] | None:
    """Return `figure_of` as JSON for a browser; raises `InputError` as that does."""
    figure = figure_of(robot, gait)
    return None if figure is None else figure.as_json()


def figure_of_legs(legs: Sequence[Leg]) -> Figure:
    """Return a body with the hips as corners, and three links a leg (see `kinematics`)."""
    around = sorted(legs, key=lambda leg: math.atan2(leg.hip_mm[1], leg.hip_mm[0]))
    corners = [(*leg.hip_mm, 0.0) for leg in around]
    links = [FigureLink(name="body", lines_mm=((*corners, corners[0]),))]
    feet = []
    for leg in legs:
        made = _leg_links(leg, len(links))
        links += made
        feet.append((len(links) - 1, made[-1].lines_mm[0][-1]))
    return Figure(source="legs", links=tuple(links), feet=tuple(feet))


def _leg_links(leg: Leg, index: int) -> list[FigureLink]:
    """Return the three links of a leg, the first of which gets this index."""
    one, two, three = leg.lengths_mm
    rotation = UPRIGHT
    ends: tuple[Vector, Vector, Vector]
    match leg.kind:
        case LegKind.COXA:
            rotation = turned((0.0, 0.0, 1.0), math.radians(leg.yaw_deg))
            ends = ((one, 0.0, 0.0), (two, 0.0, 0.0), (0.0, 0.0, -three))
            first = (0.0, 0.0, 1.0)
        case LegKind.ABDUCTION:
            # The right side is a mirror image: its first joint turns the other way.
            side = math.copysign(1.0, leg.hip_mm[1])
            ends = ((0.0, side * one, 0.0), (0.0, 0.0, -two), (0.0, 0.0, -three))
            first = (side, 0.0, 0.0)
        case _:
            assert_never(leg.kind)
    starts = ((*leg.hip_mm, 0.0), ends[0], ends[1])
    axes = (first, (0.0, -1.0, 0.0), (0.0, -1.0, 0.0))
    parts = zip(leg.joints, starts, ends, axes, leg.zero_deg, leg.direction, strict=True)
    return [
        FigureLink(
            name=joint,
            parent=0 if part == 0 else index + part - 1,
            joint=joint,
            ratio=float(direction),
            rest_deg=-zero_deg * direction,
            axis=axis,
            origin_mm=start,
            rotation=rotation if part == 0 else UPRIGHT,
            lines_mm=((ORIGIN, end),),
        )
        for part, (joint, start, end, axis, zero_deg, direction) in enumerate(parts)
    ]
