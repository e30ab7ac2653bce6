"""Where links of the figure of a robot file touch each other in a plan.

Links count as capsules: a bar is one; of an ellipsoid or a box it is the largest that fits inside,
so that a corner may touch unseen, but nothing is named that does not touch. Links that are fixed to
each other, neighbours at a joint, and those that touch in the pose of rest are never named.
"""

from __future__ import annotations

import itertools
import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.figure import Figure, Shape
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

STEP_S: Final = 0.01
"""At 180 deg/s the end of a link of 300 mm moves by 9 mm in it, less than such a link is thick."""
BLOCK: Final = 4096
"""Instants at once, so that a long show needs no more memory than a short one."""
DEPTH_MIN_MM: Final = 0.5
"""Chosen: less is within the accuracy of any figure."""


class Touch(Struct, frozen=True, kw_only=True):
    """Two links that touch, for the first time at `at_s`, and deepest at `deepest_s`."""

    one: str
    other: str
    at_s: float
    depth_mm: float
    deepest_s: float


class _Capsule(Struct, frozen=True):
    """A capsule of a link, in its frame: the ends of its axis, and its radius."""

    link: int
    ends: FloatArray
    radius_mm: float


def touches(trajectory: Trajectory, robot: Robot) -> tuple[Touch, ...]:
    """Return the pairs of links that touch in the first pass and one more, the first first.

    Joints that do not move in the plan stand as the figure has them at rest.
    """
    figure = robot.figure
    if figure is None:
        return ()
    capsules = [
        _capsule(index, shape)
        for index, shapes in enumerate(figure.solids())
        for shape in shapes
        if shape.kind != "mesh"
    ]
    pairs = _pairs(figure, capsules)
    end_s = trajectory.first.duration_s
    if trajectory.loop != 1:
        end_s += trajectory.middle.duration_s
    found: dict[tuple[int, int], tuple[float, float, float]] = {}
    steps = math.ceil(end_s / STEP_S) + 1
    for start in range(0, steps if pairs else 0, BLOCK):
        times_s = np.minimum(np.arange(start, min(start + BLOCK, steps)) * STEP_S, end_s)
        angles = trajectory.sample(times_s)
        ends = _ends(figure, capsules, dict(zip(trajectory.joints, angles.T, strict=True)))
        for one, other in pairs:
            depths = _depths_mm(capsules, ends, one, other)
            if (most := float(depths.max())) < DEPTH_MIN_MM:
                continue
            key = (capsules[one].link, capsules[other].link)
            first_s = float(times_s[(depths >= DEPTH_MIN_MM).argmax()])
            known = found.get(key, (first_s, 0.0, 0.0))
            deepest = max(known[1:], (most, float(times_s[depths.argmax()])))
            found[key] = (min(known[0], first_s), *deepest)
    names = [link.name for link in figure.links]
    return tuple(
        Touch(one=names[one], other=names[two], at_s=at_s, depth_mm=depth, deepest_s=deepest_s)
        for (one, two), (at_s, depth, deepest_s) in sorted(found.items(), key=lambda item: item[1])
    )


def touch_lines(found: Sequence[Touch]) -> list[str]:
    """Return a warning for each pair of links that touch."""
    return [
        f"warning: {touch.one} and {touch.other} touch at {touch.at_s:.2f} s, most at "
        f"{touch.deepest_s:.2f} s, by {touch.depth_mm:.0f} mm (figure of the robot file)"
        for touch in found
    ]


def _capsule(link: int, shape: Shape) -> _Capsule:
    """Return the largest capsule along the longest axis of a shape that fits into it."""
    size = shape.size_mm
    match shape.kind:
        case "capsule":
            radius, half, along = size[0], size[1] / 2.0, 2
        case "cylinder":
            radius = min(size[0], size[1] / 2.0)
            half, along = size[1] / 2.0 - radius, 2
        case "sphere":
            radius, half, along = size[0], 0.0, 2
        case _:
            halves = [part / 2.0 if shape.kind == "box" else part for part in size]
            along = int(np.argmax(halves))
            radius = min(part for axis, part in enumerate(halves) if axis != along)
            half = halves[along] - radius
            if shape.kind == "ellipsoid" and half > 0.0:
                # Pointed ends: a cylinder with these sizes just fits in, and so does the capsule.
                radius, half = radius * math.sqrt(0.5), halves[along] * math.sqrt(0.5)
                half = max(half - radius, 0.0)
    tip = half * np.array(shape.rotation)[:, along]
    middle = np.array(shape.origin_mm)
    return _Capsule(link, np.array([middle - tip, middle + tip]), radius)


def _pairs(figure: Figure, capsules: Sequence[_Capsule]) -> list[tuple[int, int]]:
    """Return the capsules that shall not touch, as pairs of indices."""
    groups: list[int] = []
    above: dict[int, int] = {}
    for index, link in enumerate(figure.links):
        parent = groups[link.parent] if link.parent >= 0 else -1
        if link.joint is None and link.parent >= 0:
            groups.append(parent)
        else:
            groups.append(index)
            above[index] = parent
    filled = {groups[one.link] for one in capsules}

    def neighbour(group: int) -> int:
        """Return the next group above that fills something: joints in one place are one joint."""
        parent = above[group]
        while parent >= 0 and parent not in filled:
            parent = above[parent]
        return parent

    ends = _ends(figure, capsules, {})
    found = []
    for one, other in itertools.combinations(range(len(capsules)), 2):
        first, second = groups[capsules[one].link], groups[capsules[other].link]
        if first == second or first == neighbour(second) or second == neighbour(first):
            continue
        if float(_depths_mm(capsules, ends, one, other).max()) < DEPTH_MIN_MM:
            found.append((one, other))
    return found


def _ends(
    figure: Figure, capsules: Sequence[_Capsule], joint_deg: Mapping[str, FloatArray]
) -> list[FloatArray]:
    """Return the ends of each capsule in the world, (2, n, 3); joints not given are at rest."""
    count = len(next(iter(joint_deg.values()), np.zeros(1)))
    frames: list[tuple[FloatArray, FloatArray]] = []
    for link in figure.links:
        rotation, origin = np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3))
        if link.parent >= 0:
            rotation, origin = frames[link.parent]
        origin = origin + rotation @ np.array(link.origin_mm)
        rotation = rotation @ np.array(link.rotation)
        if link.joint is not None and link.joint in joint_deg:
            turn = np.radians(link.ratio * (joint_deg[link.joint] - link.rest_deg))
            rotation = rotation @ _turned(np.array(link.axis), turn)
        frames.append((rotation, origin))
    return [
        np.stack([frames[one.link][0] @ end + frames[one.link][1] for end in one.ends])
        for one in capsules
    ]


def _turned(axis: FloatArray, turn: FloatArray) -> FloatArray:
    """Return rotations (n, 3, 3) about an axis (Rodrigues)."""
    x, y, z = axis
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, cosine = np.sin(turn)[:, None, None], np.cos(turn)[:, None, None]
    return np.asarray(np.eye(3) + sine * across + (1.0 - cosine) * (across @ across))


def _depths_mm(
    capsules: Sequence[_Capsule], ends: Sequence[FloatArray], one: int, other: int
) -> FloatArray:
    """Return how deep two capsules are in each other, (n,); below 0: they are apart."""
    radii = capsules[one].radius_mm + capsules[other].radius_mm
    spheres = [np.ptp(capsules[each].ends, axis=0) for each in (one, other)]
    near = radii + sum(0.5 * math.hypot(*span) for span in spheres)
    apart = 0.5 * (ends[one].sum(axis=0) - ends[other].sum(axis=0))
    is_near = np.einsum("ni,ni->n", apart, apart) < near * near
    depths = np.full(len(is_near), -1.0)
    if is_near.any():
        distance = _distances(ends[one][:, is_near], ends[other][:, is_near])
        depths[is_near] = radii - distance
    return depths


def _distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the distances of two segments, ends (2, n, 3) each (Ericson, 5.1.9)."""
    first, second, between = one[1] - one[0], other[1] - other[0], one[0] - other[0]

    def dot(a: FloatArray, b: FloatArray) -> FloatArray:
        return np.asarray(np.einsum("ni,ni->n", a, b))

    a, e, b = dot(first, first), dot(second, second), dot(first, second)
    c, f = dot(first, between), dot(second, between)
    safe_a, safe_e = (np.where(size > 0.0, size, 1.0) for size in (a, e))
    across = a * e - b * b
    # Parallel ones are as near at the first end as anywhere.
    is_across = across > 1e-9 * a * e
    s = np.where(is_across, (b * f - c * e) / np.where(is_across, across, 1.0), 0.0)
    s = np.clip(s, 0.0, 1.0)
    t = np.where(e > 0.0, (b * s + f) / safe_e, 0.0)
    s = np.where(t < 0.0, -c / safe_a, np.where(t > 1.0, (b - c) / safe_a, s))
    s = np.where(e > 0.0, s, -c / safe_a)
    s, t = np.clip(np.where(a > 0.0, s, 0.0), 0.0, 1.0), np.clip(t, 0.0, 1.0)
    gap = between + s[:, None] * first - t[:, None] * second
    return np.asarray(np.sqrt(dot(gap, gap)))
