"""Kinematics: joint angles ⇄ foot of a leg in closed form, and body and feet at instants.

Kinematic angles of a coxa-femur-tibia leg, all 0 with coxa and femur level and the tibia straight
down: the coxa turns counter-clockwise seen from above, positive femur angles lift the knee,
positive tibia angles stretch the leg outwards. The knee is above the line from hip to foot, and
the leg never reaches across its own first axis.

Kinematic angles of an abduction-thigh-shank leg, all 0 with a straight leg hanging down: positive
abduction swings the foot outwards, positive thigh and shank angles swing it forward, the shank's
counted from the thigh. `Leg.knee` gives the side of the knee.

`Stance` has body and feet over the ground, and measures how stable they are. `figure_of` is for
pictures of a robot.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.robot.figure import ORIGIN, UPRIGHT, Figure, FigureLink, turned
from lss_motion.robot.urdf import urdf_figure
from lss_motion.show.gait.model import LegKind

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.show.gait.model import Leg

    FloatArray = NDArray[np.float64]
    from collections.abc import Sequence

    from lss_motion.robot.figure import Vector
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait

REACH_SLACK_MM: Final = 1e-6
"""A foot this far beyond the reach counts as within: rounding."""

GRAVITY_MM_S2: Final = 9810.0

SAME_POINT_MM: Final = 1e-9
"""A foot this far outside of an edge through it counts as on the edge: rounding."""


def neutral_mm(leg: Leg) -> FloatArray:
    """Return the position of the standing foot below the body: x, y."""
    outward = leg.stance_mm * _axes(leg)[0 if leg.kind is LegKind.COXA else 1]
    return np.asarray(leg.hip_mm + outward[:2], dtype=np.float64)


def forward(leg: Leg, joint_deg: FloatArray) -> FloatArray:
    """Return the foot in the body, (n, 3) mm, for joint angles, (n, 3)."""
    kinematic_deg = joint_deg / np.array(leg.direction) + np.array(leg.zero_deg)
    first, second, third = np.radians(kinematic_deg).T
    one, two, three = leg.lengths_mm
    match leg.kind:
        case LegKind.COXA:
            shank = second + third - 0.5 * np.pi
            reach = one + two * np.cos(second) + three * np.cos(shank)
            up = two * np.sin(second) + three * np.sin(shank)
            local = np.stack([reach * np.cos(first), reach * np.sin(first), up], axis=1)
        case LegKind.ABDUCTION:
            ahead = two * np.sin(second) + three * np.sin(second + third)
            down = two * np.cos(second) + three * np.cos(second + third)
            outward = one * np.cos(first) + down * np.sin(first)
            up = one * np.sin(first) - down * np.cos(first)
            local = np.stack([ahead, outward, up], axis=1)
        case _:
            assert_never(leg.kind)
    return local @ _axes(leg) + _hip(leg)


def inverse(leg: Leg, foot_mm: FloatArray) -> FloatArray:
    """Return the joint angles, (n, 3) degrees, that put the foot at points of the body, (n, 3).

    Raises `InputError` with leg, point and distance for the point that is furthest out of reach.
    Ranges of joints are not checked here.
    """
    kinematic, excess_mm = _solve(leg, foot_mm)
    worst = int(np.argmax(np.abs(excess_mm)))
    if abs(excess_mm[worst]) > REACH_SLACK_MM:
        x, y, z = foot_mm[worst]
        side = "too far out" if excess_mm[worst] > 0.0 else "too close"
        raise InputError(
            f"leg {leg.name!r} cannot reach the foot point x {x:.1f}, y {y:.1f}, z {z:.1f} mm of "
            f"the body: it is {abs(excess_mm[worst]):.1f} mm {side}"
        )
    return np.asarray((np.degrees(kinematic) - np.array(leg.zero_deg)) * np.array(leg.direction))


def reach_excess_mm(leg: Leg, foot_mm: FloatArray) -> FloatArray:
    """Return how far points of the body, (n, 3), are too far (+) or too close (-); 0: in reach."""
    return _solve(leg, foot_mm)[1]


def _solve(leg: Leg, foot_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return kinematic angles in rad and the excess; angles are valid where that is 0."""
    local = (foot_mm - _hip(leg)) @ _axes(leg).T
    match leg.kind:
        case LegKind.COXA:
            return _coxa(leg, local)
        case LegKind.ABDUCTION:
            return _abduction(leg, local)
        case _:
            assert_never(leg.kind)


def _coxa(leg: Leg, local: FloatArray) -> tuple[FloatArray, FloatArray]:
    one, two, three = leg.lengths_mm
    x, y, z = local.T
    reach = np.hypot(x, y) - one
    bend, excess_mm = _knee(two, three, reach, z)
    lifted = np.arctan2(z, reach) + np.arctan2(three * np.sin(bend), two + three * np.cos(bend))
    # The bend counts from the stretched leg, the tibia's angle from the right angle.
    tibia = 0.5 * np.pi - bend
    return np.stack([np.arctan2(y, x), _wrapped(lifted), tibia], axis=1), excess_mm


def _abduction(leg: Leg, local: FloatArray) -> tuple[FloatArray, FloatArray]:
    one, two, three = leg.lengths_mm
    ahead, outward, up = local.T
    aside = np.hypot(outward, up)
    down = np.sqrt(np.maximum(aside**2 - one**2, 0.0))
    bend, excess_mm = _knee(two, three, ahead, down)
    bend = bend if leg.knee == "back" else -bend
    abducted = np.arctan2(outward, -up) - np.arctan2(one, down)
    thigh = np.arctan2(ahead, down) - np.arctan2(three * np.sin(bend), two + three * np.cos(bend))
    excess_mm = np.where(aside < one - REACH_SLACK_MM, aside - one, excess_mm)
    return np.stack([_wrapped(abducted), _wrapped(thigh), bend], axis=1), excess_mm


def _knee(
    two: float, three: float, along: FloatArray, across: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the bend of the knee (0: straight), and how far out of reach the foot is."""
    distance = np.hypot(along, across)
    cosine = (distance**2 - two**2 - three**2) / (2.0 * two * three)
    far, near = distance - (two + three), distance - abs(two - three)
    excess_mm = np.where(far > 0.0, far, np.where(near < 0.0, near, 0.0))
    return np.arccos(np.clip(cosine, -1.0, 1.0)), excess_mm


def _wrapped(angle: FloatArray) -> FloatArray:
    """Return the angle wrapped to ±180 degrees, in rad."""
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)


def _hip(leg: Leg) -> FloatArray:
    return np.array([*leg.hip_mm, 0.0])


def _axes(leg: Leg) -> FloatArray:
    """Return the axes of the leg's own frame as rows, in the body.

    A coxa leg has its x outwards; an abduction leg has x forward and y outwards, which mirrors the
    right side, so that equal angles mean the same on both.
    """
    if leg.kind is LegKind.ABDUCTION:
        return np.diag([1.0, np.sign(leg.hip_mm[1]), 1.0])
    yaw = np.radians(leg.yaw_deg)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    return np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])


class Stance(Struct, frozen=True, kw_only=True):
    """Body and feet at n instants, over a ground whose origin is below the body's start.

    `places`: x, y in mm and heading in rad, (n, 3). `shift_mm`: the body over that place, up from
    the ground, (n, 3), and `tilt_deg`: its tilt there, (n, 3). `feet_mm`: on or over the ground,
    (n, legs, 3). `is_down`: which feet stand, (n, legs).
    """

    places: FloatArray
    shift_mm: FloatArray
    tilt_deg: FloatArray
    feet_mm: FloatArray
    is_down: NDArray[np.bool_]

    def feet_in_body(self) -> FloatArray:
        """Return the feet in the frame of the body, (n, legs, 3)."""
        relative = self.feet_mm.copy()
        relative[:, :, :2] -= self.places[:, None, :2]
        relative = _rotated(relative, _rotation(2, -self.places[:, 2])) - self.shift_mm[:, None, :]
        roll, pitch, yaw = np.radians(self.tilt_deg).T
        for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
            relative = _rotated(relative, _rotation(axis, -angle))
        return relative

    def centre_mm(self) -> FloatArray:
        """Return the point of the ground below the body's centre, (n, 2)."""
        shift = np.zeros((len(self.places), 1, 3))
        shift[:, 0, :2] = self.shift_mm[:, :2]
        turned = _rotated(shift, _rotation(2, self.places[:, 2]))[:, 0, :2]
        return np.asarray(self.places[:, :2] + turned)

    def margin_mm(self) -> FloatArray:
        """Return the stability margin, (n,): how far the centre is inside of the standing feet.

        It is the distance to the nearest edge of their polygon; negative outside of it, and where
        fewer than three feet stand.
        """
        centre = self.centre_mm()
        margin = np.full(len(centre), -np.inf)
        groups, group = np.unique(self.is_down, axis=0, return_inverse=True)
        for index, down in enumerate(groups):
            chosen = np.flatnonzero(group.ravel() == index)
            feet = self.feet_mm[chosen][:, down, :2]
            margin[chosen] = _margin(feet, centre[chosen])
        return margin

    def slope_deg(self) -> FloatArray:
        """Return the slope of the ground on which nothing is left of the margin, (n,); 0: none is.

        On a slope the weight acts where the plumb line meets the ground: height times tangent
        further down. The centre of the body is taken for that of the mass; a tilt of the body
        alone, on level ground, leaves it where it is.
        """
        margin_mm = np.maximum(self.margin_mm(), 0.0)
        return np.asarray(np.degrees(np.arctan2(margin_mm, self.shift_mm[:, 2])))

    def tip_s(self, step_height_mm: float) -> FloatArray:
        """Return how long the body needs to tip onto its lifted feet, (n,); inf: it does not.

        It tips as a pendulum on the line of the feet that stand, from rest: with
        `tau = sqrt(height / g)`, its centre at the distance `d` moves to `d * cosh(t / tau)`. A
        foot at the distance `l` from that line, lifted by `step_height_mm`, lands when the body
        leans by `step_height_mm / l`. With fewer than two feet on the ground it is 0.
        """
        height_mm = self.shift_mm[:, 2]
        centre = self.centre_mm()
        depth_mm = np.maximum(-self.margin_mm(), 0.0)
        tips_s = np.full(len(centre), np.inf)
        for index in np.flatnonzero(depth_mm > 0.0):
            down = self.is_down[index]
            feet = self.feet_mm[index, :, :2]
            if down.sum() < 2:
                tips_s[index] = 0.0
                continue
            first, second = feet[down][:2]
            along = (second - first) / max(float(np.hypot(*(second - first))), SAME_POINT_MM)
            across = np.array([-along[1], along[0]])
            side = (centre[index] - first) @ across
            away = np.abs((feet[~down] - first) @ across)[
                ((feet[~down] - first) @ across) * side > 0.0
            ]
            if not len(away):
                continue
            lean = step_height_mm * height_mm[index] / (float(away.max()) * depth_mm[index])
            tau_s = math.sqrt(height_mm[index] / GRAVITY_MM_S2)
            tips_s[index] = tau_s * math.acosh(1.0 + lean)
        return tips_s


def _margin(feet: FloatArray, centre: FloatArray) -> FloatArray:
    """Return the distance to the nearest edge, a line with all feet to its left."""
    if feet.shape[1] == 0:
        return np.full(len(centre), -np.inf)
    if feet.shape[1] == 1:
        return np.asarray(-np.hypot(*(feet[:, 0] - centre).T))
    edges = feet[:, None, :, :] - feet[:, :, None, :]
    lengths = np.hypot(edges[..., 0], edges[..., 1])
    is_pair = lengths > SAME_POINT_MM
    units = edges / np.where(is_pair, lengths, 1.0)[..., None]

    def left_of(points: FloatArray) -> FloatArray:
        ahead = points[:, None, None, :] - feet[:, :, None, :]
        return np.asarray(units[..., 0] * ahead[..., 1] - units[..., 1] * ahead[..., 0])

    is_edge = is_pair
    for other in range(feet.shape[1]):
        is_edge = is_edge & (left_of(feet[:, other]) >= -SAME_POINT_MM)
    return np.asarray(np.where(is_edge, left_of(centre), np.inf).min(axis=(1, 2)))


def _rotation(axis: int, angle: FloatArray) -> FloatArray:
    """Return the rotations about one axis, (n, 3, 3)."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    rotation = np.zeros((len(angle), 3, 3))
    rotation[:, axis, axis] = 1.0
    rotation[:, first, first] = rotation[:, second, second] = np.cos(angle)
    rotation[:, second, first] = np.sin(angle)
    rotation[:, first, second] = -rotation[:, second, first]
    return rotation


def _rotated(points: FloatArray, rotation: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nlj->nli", rotation, points))


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
