"""The torques that a motion asks of the joints of a figure with masses: recursive Newton-Euler.

Links are rigid and the first stands still and upright. Friction, the motors' own inertia and what
touches the robot from outside are not in it, as no file has them. All instants are computed at
once, in blocks that fit a cache.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.robot.figure import Figure, Shape

    FloatArray = NDArray[np.float64]

GRAVITY_M_S2: Final = 9.81
BLOCK: Final = 4096
"""Instants at once. Measured: 18 joints take 4 µs an instant; with 512 they take 9."""
M_PER_MM: Final = 0.001


class _TurnedBody(Struct, frozen=True):
    """A link that a joint turns, with all that is fixed to it. Arrays in metres and kilograms."""

    parent: int
    """The index of another segment; -1: what stands still."""
    column: int
    ratio: float
    rest_deg: float
    axis: FloatArray
    back: FloatArray
    """Rotates vectors of the parent into this frame at rest."""
    origin: FloatArray
    """Of this frame, in that of the parent."""
    mass_kg: float
    first: FloatArray
    """Mass times centre."""
    inertia: FloatArray
    """About the origin of the frame."""


class RigidTree:
    """A figure as bodies that joints turn, `joints` as the columns of angles and torques."""

    def __init__(self, figure: Figure, joints: Sequence[str]) -> None:
        """Merge links that are fixed to each other; a joint not in `joints` stays at rest."""
        self._count = len(joints)
        self._segments = _segments(figure, joints)

    def torques_n_m(self, deg: FloatArray, deg_s: FloatArray, deg_s2: FloatArray) -> FloatArray:
        """Return the torque of each joint, (n, joints), at angles, speeds and accelerations.

        Positive torques turn a joint to larger angles. A joint that turns several links, and one
        that turns a link by a ratio, gets what its work asks for.
        """
        found = np.zeros((len(deg), self._count))
        motion = [np.radians(one) for one in (deg, deg_s, deg_s2)]
        for start in range(0, len(deg), BLOCK):
            rows = slice(start, start + BLOCK)
            self._add(found[rows], *(np.ascontiguousarray(one[rows].T) for one in motion))
        return found

    def _add(
        self, found: FloatArray, angle: FloatArray, speed: FloatArray, accel: FloatArray
    ) -> None:
        """Add to the torques of a block, (n, joints), from arrays (joints, n)."""
        count = angle.shape[1]
        still = np.zeros((3, count))
        up = np.zeros((3, count))
        up[2] = GRAVITY_M_S2  # The ground pushes up: as if all were accelerated so.
        states: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        turns: list[tuple[FloatArray, FloatArray]] = []
        forces: list[FloatArray] = []
        moments: list[FloatArray] = []
        for one in self._segments:
            spin, twist, push = states[one.parent] if one.parent >= 0 else (still, still, up)
            turn = one.ratio * (angle[one.column] - np.radians(one.rest_deg))
            cosine, sine = np.cos(turn), np.sin(turn)
            turns.append((cosine, sine))
            moved = push
            if one.parent >= 0:
                arm = one.origin[:, None]
                moved = push + _cross(twist, arm) + _cross(spin, _cross(spin, arm))
            spin, twist, moved = (
                _turned(one.axis, one.back @ vector, cosine, -sine)
                for vector in (spin, twist, moved)
            )
            axis = one.axis[:, None]
            rate = one.ratio * speed[one.column]
            twist = twist + axis * (one.ratio * accel[one.column]) + _cross(spin, axis) * rate
            spin = spin + axis * rate
            states.append((spin, twist, moved))
            first = one.first[:, None]
            forces.append(
                one.mass_kg * moved + _cross(twist, first) + _cross(spin, _cross(spin, first))
            )
            moments.append(
                one.inertia @ twist + _cross(spin, one.inertia @ spin) + _cross(first, moved)
            )
        for index in reversed(range(len(self._segments))):
            one, (cosine, sine) = self._segments[index], turns[index]
            found[:, one.column] += one.ratio * (one.axis @ moments[index])
            if one.parent >= 0:
                force = one.back.T @ _turned(one.axis, forces[index], cosine, sine)
                moment = one.back.T @ _turned(one.axis, moments[index], cosine, sine)
                forces[one.parent] += force
                moments[one.parent] += moment + _cross(one.origin[:, None], force)


def _segments(figure: Figure, joints: Sequence[str]) -> tuple[_TurnedBody, ...]:
    """Return the links that joints turn, parents first, without those that carry no mass."""
    columns = {name: column for column, name in enumerate(joints)}
    links, solids = figure.links, figure.solids()
    owner: list[int] = []
    frames: list[tuple[FloatArray, FloatArray]] = []
    """Of each link in the frame of its owner."""
    turning: list[int] = []
    starts: list[tuple[int, FloatArray, FloatArray]] = []
    sums: list[tuple[float, FloatArray, FloatArray]] = []
    for index, link in enumerate(links):
        parent = owner[link.parent] if link.parent >= 0 else -1
        base, shift = frames[link.parent] if link.parent >= 0 else (np.eye(3), np.zeros(3))
        shift = shift + base @ np.array(link.origin_mm) * M_PER_MM
        base = base @ np.array(link.rotation)
        if link.joint in columns:
            starts.append((parent, base, shift))
            parent = len(turning)
            turning.append(index)
            sums.append((0.0, np.zeros(3), np.zeros((3, 3))))
            base, shift = np.eye(3), np.zeros(3)
        owner.append(parent)
        frames.append((base, shift))
        if link.mass_kg and parent >= 0:
            mass, first, inertia = sums[parent]
            com = base @ np.array(link.com_mm) * M_PER_MM + shift
            own = link.inertia_kg_m2
            about = _even_inertia(solids[index], link.mass_kg) if own is None else np.array(own)
            about = base @ about @ base.T + link.mass_kg * _away(com)
            sums[parent] = (mass + link.mass_kg, first + link.mass_kg * com, inertia + about)
    carries = [mass > 0.0 for mass, *_ in sums]
    for index in reversed(range(len(turning))):
        if carries[index] and starts[index][0] >= 0:
            carries[starts[index][0]] = True
    kept = [index for index, does in enumerate(carries) if does]
    return tuple(
        _TurnedBody(
            parent=kept.index(starts[index][0]) if starts[index][0] >= 0 else -1,
            column=columns[links[turning[index]].joint or ""],
            ratio=links[turning[index]].ratio,
            rest_deg=links[turning[index]].rest_deg,
            axis=np.array(links[turning[index]].axis),
            back=starts[index][1].T,
            origin=starts[index][2],
            mass_kg=sums[index][0],
            first=sums[index][1],
            inertia=sums[index][2],
        )
        for index in kept
    )


def _away(point_m: FloatArray) -> FloatArray:
    """Return the inertia of a kilogram at a point, about the origin."""
    return np.eye(3) * (point_m @ point_m) - np.outer(point_m, point_m)


def _even_inertia(solids: Sequence[Shape], mass_kg: float) -> FloatArray:
    """Return the inertia, about their centre, of solids of one density that weigh so much.

    Meshes do not count: a link of which nothing else is known is a point.
    """
    parts = [(_volume(one), one) for one in solids if one.kind != "mesh"]
    whole = sum(volume for volume, _ in parts)
    if not whole:
        return np.zeros((3, 3))
    at = [M_PER_MM * np.array(one.origin_mm) for _, one in parts]
    middle = sum((volume * at[n] for n, (volume, _) in enumerate(parts)), np.zeros(3)) / whole
    found = np.zeros((3, 3))
    for (volume, one), point in zip(parts, at, strict=True):
        rotation = np.array(one.rotation)
        own = rotation @ np.diag(_inertia_per_kg(one)) @ rotation.T
        found += mass_kg * volume / whole * (own + _away(point - middle))
    return found


def _volume(shape: Shape) -> float:
    """Return the volume of a shape in mm³."""
    size = shape.size_mm
    match shape.kind:
        case "box":
            return math.prod(size)
        case "cylinder":
            return math.pi * size[0] ** 2 * size[1]
        case "capsule":
            return math.pi * size[0] ** 2 * (size[1] + 4.0 / 3.0 * size[0])
        case _:
            return 4.0 / 3.0 * math.pi * math.prod((*size, size[0], size[0])[:3])


def _inertia_per_kg(shape: Shape) -> tuple[float, float, float]:
    """Return the inertia of an even solid about its centre, by its mass, along its axes, in m²."""
    size = [M_PER_MM * part for part in shape.size_mm]
    if shape.kind == "box":
        x, y, z = (part * part / 12.0 for part in size)
    elif shape.kind in ("cylinder", "capsule"):
        # The round ends of a capsule as more of its cylinder: exact for what is long, and for a
        # short one within a twentieth.
        length = size[1] + (4.0 / 3.0 * size[0] if shape.kind == "capsule" else 0.0)
        x = y = size[0] ** 2 / 4.0
        z = length**2 / 12.0
    else:
        x, y, z = (part * part / 5.0 for part in (*size, size[0], size[0])[:3])
    return (y + z, x + z, x + y)


def _cross(one: FloatArray, two: FloatArray) -> FloatArray:
    """Return the vector product along the first axis; `np.cross` takes three times as long."""
    return np.stack(
        [
            one[1] * two[2] - one[2] * two[1],
            one[2] * two[0] - one[0] * two[2],
            one[0] * two[1] - one[1] * two[0],
        ]
    )


def _turned(
    axis: FloatArray, vector: FloatArray, cosine: FloatArray, sine: FloatArray
) -> FloatArray:
    """Return vectors (3, n) turned about an axis (Rodrigues)."""
    along = axis @ vector
    return (
        vector * cosine
        + _cross(axis[:, None], vector) * sine
        + axis[:, None] * (along * (1.0 - cosine))
    )
