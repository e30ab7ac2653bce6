"""The figure of a robot: links that turn with joints, for pictures and, with masses, for torques.

Frames are those of ROS (REP 103): x forward, y left, z up, in mm. A `Figure` comes from `figure` of
a robot file (`robot.load`), from its `urdf` (`robot.urdf`) or from the legs of a gait
(`show.gait.kinematics`). A browser draws it with the same rule that `Figure.placed` has:

    link in the world = link of its parent · origin_mm · rotation · turn about axis
    turn = ratio · (joint angle - rest_deg)
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import numpy as np
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

Vector = tuple[float, float, float]
Rotation = tuple[Vector, Vector, Vector]
"""Rows of a rotation matrix."""
ShapeKind = Literal["box", "cylinder", "sphere", "capsule", "ellipsoid", "mesh"]
Shade = Literal["dark", "light"]
"""How a part is drawn that has not the colour of the figure."""

ORIGIN: Final[Vector] = (0.0, 0.0, 0.0)
UPRIGHT: Final[Rotation] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

SLENDERNESS_RATIO: Final = 30.0
"""Chosen: a link without a width is drawn this many times thinner than the figure is long."""

DIRECTIONS: Final[Mapping[str, Vector]] = {
    "x": (1.0, 0.0, 0.0),
    "-x": (-1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "-y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-z": (0.0, 0.0, -1.0),
}
"""x forward, y left, z up."""


class Shape(Struct, frozen=True, kw_only=True):
    """A solid in the frame of a link, as in URDF.

    `size_mm`: of a box x, y, z; of a cylinder radius and length (along z); of a sphere its radius;
    of a capsule its radius, and its length along z without both round ends; of an ellipsoid its
    half axes along x, y and z. URDF has neither.
    A mesh is a file, `path` relative to the folder of the robot file, and `size_mm` is one unit of
    it along x, y and z.
    """

    kind: ShapeKind
    size_mm: tuple[float, ...]
    origin_mm: Vector = ORIGIN
    rotation: Rotation = UPRIGHT
    path: str | None = None
    shade: Shade | None = None


class FigureLink(Struct, frozen=True, kw_only=True):
    """One rigid part. `parent` is the index of an earlier link; -1: the ground.

    `joint` is the joint of the robot that turns it about `axis` (a unit vector of its own frame);
    None: it is fixed. `lines_mm` are drawn in its own frame. `Figure.solids` is what it fills.
    """

    name: str
    parent: int = -1
    joint: str | None = None
    ratio: float = 1.0
    rest_deg: float = 0.0
    axis: Vector = (0.0, 0.0, 1.0)
    origin_mm: Vector = ORIGIN
    rotation: Rotation = UPRIGHT
    lines_mm: tuple[tuple[Vector, ...], ...] = ()
    width_mm: float | None = None
    shade: Shade | None = None
    shapes: tuple[Shape, ...] = ()
    mass_kg: float | None = None
    """None: unknown."""
    com_mm: Vector = ORIGIN
    """Its centre of mass in its own frame; only with `mass_kg`."""
    inertia_kg_m2: Rotation | None = None
    """About that centre, in its own frame; None: that of its solids, filled evenly."""


class Figure(Struct, frozen=True, kw_only=True):
    """Links, parents first. The robot stands on `feet`: links, and points of their frames."""

    source: Literal["figure", "legs", "urdf"]
    links: tuple[FigureLink, ...]
    feet: tuple[tuple[int, Vector], ...] = ()
    notes: tuple[str, ...] = ()
    """What of its file cannot be drawn, and why."""

    @property
    def has_masses(self) -> bool:
        """Whether any link that a joint moves has a mass, without which there are no torques."""
        moved: list[bool] = []
        for link in self.links:
            moved.append(link.joint is not None or (link.parent >= 0 and moved[link.parent]))
        return any(link.mass_kg and own for link, own in zip(self.links, moved, strict=True))

    def placed(self, joint_deg: Mapping[str, float]) -> list[tuple[FloatArray, FloatArray]]:
        """Return rotation (3, 3) and origin (3,) mm of each link; a missing angle counts as rest.

        Points of a link are `rotation @ point + origin` in the world.
        """
        import numpy as np

        placed: list[tuple[FloatArray, FloatArray]] = []
        for link in self.links:
            rotation, origin = np.eye(3), np.zeros(3)
            if link.parent >= 0:
                rotation, origin = placed[link.parent]
            origin = rotation @ np.array(link.origin_mm) + origin
            rotation = rotation @ np.array(link.rotation)
            if link.joint is not None:
                deg = joint_deg.get(link.joint, link.rest_deg)
                turn_rad = math.radians(link.ratio * (deg - link.rest_deg))
                rotation = rotation @ np.array(turned(link.axis, turn_rad))
            placed.append((rotation, origin))
        return placed

    def points_mm(self, joint_deg: Mapping[str, float]) -> dict[str, FloatArray]:
        """Return the points of the lines of each link in the world, (n, 3), by its name."""
        import numpy as np

        return {
            link.name: np.array([p for line in link.lines_mm for p in line]) @ rotation.T + origin
            for link, (rotation, origin) in zip(self.links, self.placed(joint_deg), strict=True)
            if link.lines_mm
        }

    def solids(self) -> tuple[tuple[Shape, ...], ...]:
        """Return what each link fills, in its own frame: its shapes, and its lines as capsules."""
        default_mm = self.reach_mm / SLENDERNESS_RATIO
        return tuple(
            (
                *link.shapes,
                *(
                    capsule(start, end, link.width_mm or default_mm, link.shade)
                    for line in link.lines_mm
                    for start, end in itertools.pairwise(line)
                ),
            )
            for link in self.links
        )

    @property
    def reach_mm(self) -> float:
        """No point of a line or shape is further than this from the root, whatever joints do.

        Solids of a URDF file count as far as its lines go.
        """
        start_mm: list[float] = []
        reach = 0.0
        for link in self.links:
            parent = start_mm[link.parent] if link.parent >= 0 else 0.0
            start_mm.append(parent + math.hypot(*link.origin_mm))
            ends = [math.hypot(*point) for line in link.lines_mm for point in line]
            if self.source == "figure":
                ends += [math.hypot(*own.origin_mm) + _radius_mm(own) for own in link.shapes]
            reach = max(reach, start_mm[-1] + max(ends, default=0.0))
        return reach

    def as_json(self) -> dict[str, Any]:
        """Return the figure as a browser gets it."""
        reach = self.reach_mm
        return {
            "source": self.source,
            "links": [
                {
                    "name": link.name,
                    "parent": link.parent,
                    "joint": link.joint,
                    "ratio": link.ratio,
                    "rest_deg": link.rest_deg,
                    "axis": list(link.axis),
                    "origin_mm": list(link.origin_mm),
                    "rotation": _flat(link.rotation),
                    "lines_mm": [[list(point) for point in line] for line in link.lines_mm],
                    "width_mm": link.width_mm or reach / SLENDERNESS_RATIO,
                    "shade": link.shade,
                    "shapes": [
                        {
                            "kind": shape.kind,
                            "size_mm": list(shape.size_mm),
                            "origin_mm": list(shape.origin_mm),
                            "rotation": _flat(shape.rotation),
                            "path": shape.path,
                            "shade": shape.shade,
                        }
                        for shape in link.shapes
                    ],
                }
                for link in self.links
            ],
            "feet": [[link, list(point)] for link, point in self.feet],
            "reach_mm": reach,
            "notes": list(self.notes),
        }


def _radius_mm(shape: Shape) -> float:
    """Return the radius of the ball around a shape that is no mesh."""
    if shape.kind == "box":
        return math.hypot(*shape.size_mm) / 2.0
    if shape.kind == "capsule":
        radius, length = shape.size_mm
        return radius + length / 2.0
    if shape.kind == "cylinder":
        radius, length = shape.size_mm
        return math.hypot(radius, length / 2.0)
    return max(shape.size_mm)


def capsule(start: Vector, end: Vector, width_mm: float, shade: Shade | None = None) -> Shape:
    """Return a round bar between two points, with round ends around them."""
    x, y, z = (to - at for at, to in zip(start, end, strict=True))
    length = math.hypot(x, y, z)
    sideways = math.hypot(x, y)
    axis = (-y / sideways, x / sideways, 0.0) if sideways else (1.0, 0.0, 0.0)
    return Shape(
        kind="capsule",
        size_mm=(width_mm / 2.0, length),
        origin_mm=middle_of(start, end),
        rotation=turned(axis, math.atan2(sideways, z)),
        shade=shade,
    )


def middle_of(start: Vector, end: Vector) -> Vector:
    """Return the point between two others."""
    x, y, z = ((at + to) / 2.0 for at, to in zip(start, end, strict=True))
    return (x, y, z)


def _flat(rotation: Rotation) -> list[float]:
    return [value for row in rotation for value in row]


def turned(axis: Vector, angle_rad: float) -> Rotation:
    """Return the rotation about a unit vector, counter-clockwise seen against it (Rodrigues)."""
    x, y, z = axis
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    rest = 1.0 - cosine
    return (
        (cosine + rest * x * x, rest * x * y - sine * z, rest * x * z + sine * y),
        (rest * x * y + sine * z, cosine + rest * y * y, rest * y * z - sine * x),
        (rest * x * z - sine * y, rest * y * z + sine * x, cosine + rest * z * z),
    )


def unit_vector(direction: str | Sequence[float]) -> Vector:
    """Return the unit vector of a name in `DIRECTIONS`, or of a vector that is not zero."""
    if isinstance(direction, str):
        return DIRECTIONS[direction]
    x, y, z = direction
    length = math.hypot(x, y, z)
    return (x / length, y / length, z / length)
