"""Finds legs in a URDF file, and writes a gait file to begin with.

A leg is a chain of three joints from the first link to a foot, with the axes of one of the kinds of
`show.gait.model.LegKind`. Its measures are read from the axes and the foot with all joints at 0.
Law: a leg counts only if its kinematics give the foot where the URDF file has it, at random angles.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.robot.figure import turned
from lss_motion.robot.urdf import MM_PER_M
from lss_motion.show.gait.kinematics import forward, inverse, neutral_mm
from lss_motion.show.gait.model import Leg, LegKind

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from lss_motion.interchange.urdf_joints import ServoJoint
    from lss_motion.robot.urdf import UrdfElement, UrdfFile

    FloatArray = NDArray[np.float64]

SAME_MM: Final = 0.5
"""Chosen: lengths and heights that differ by less are equal; drawings are that exact."""
PARALLEL: Final = 1e-3
"""The sine between two axes that count as parallel: 0.06 degrees."""
FOOT_MIN_MM: Final = 5.0
"""Chosen: a foot is further than this from the last axis."""
PROVED_MM: Final = 0.01
"""The largest distance between the foot of the URDF file and that of the leg; angles are rounded to
0.01 degrees only afterwards."""
TRIALS: Final = 24
LEG_COUNTS: Final = (4, 6)
STANDS_DEG: Final[dict[LegKind, tuple[tuple[float, ...], tuple[float, ...]]]] = {
    LegKind.COXA: ((25.0, 15.0, 5.0, 35.0, 45.0), (-80.0, -90.0, -70.0, -100.0, -60.0)),
    LegKind.ABDUCTION: ((0.0,), (35.0, 25.0, 45.0, 15.0, 55.0)),
}
"""Stances that are tried, the best first. Coxa: elevation of femur and tibia. Abduction: the bend
of the thigh backwards, with the shank as far forward, so that the foot is below its hip."""
ROOM_DEG: Final = 15.0
"""Chosen: a stance leaves each joint so much to both ends of its range, for steps."""
CYCLES_S: Final = {"tripod": 2.0, "crawl": 4.0}
"""Chosen: slow; of a crawl, in which one leg steps after the other, twice as slow."""
STEP_SHARE: Final = 0.1
STRIDE_SHARE: Final = 0.15
"""Chosen: height and length of the first steps, shares of the length of the leg below its hip."""


class _Chain(Struct, frozen=True):
    """Three joints from the body to a foot, all at 0: axes and points in the body, in mm."""

    joints: tuple[ServoJoint, ServoJoint, ServoJoint]
    axes: FloatArray
    points_mm: FloatArray
    foot: str
    """The link on which the foot is."""
    foot_mm: FloatArray
    """The foot in the frame of that link."""
    tip_mm: FloatArray
    """The foot in the body."""


class LegFinder:
    """Finds the legs of one file."""

    def __init__(self, file: UrdfFile, servos: tuple[ServoJoint, ...]) -> None:
        self._file = file
        self._servos = {one.urdf.name: one for one in servos}
        self._below: dict[str, list[str]] = {name: [] for name in file.order}
        for child, joint in file.above.items():
            self._below[joint.parent].append(child)
        self._hips_z: list[float] = []
        self.notes: list[str] = []

    def gait(self, name: str, robot: str) -> str | None:
        """Return a gait file for the robot file `robot`; None: there are not four or six legs."""
        chains = [c for c in self._chains() if len(c) == 3]
        if len(chains) not in LEG_COUNTS:
            return None
        try:
            text = self._text(name, robot, self._named([self._leg(chain) for chain in chains]))
        except InputError as refused:
            self.notes.append(f"no gait file was made: {refused.reason}")
            return None
        self.notes.append(
            f"{len(chains)} legs were recognised; stance, height and step of their gait are chosen"
        )
        return text

    # ---- chains

    def _chains(self) -> Iterator[list[ServoJoint]]:
        """Yield the driven joints of each branch that begins with one, from the body outwards."""
        waiting = [self._file.order[0]]
        while waiting:
            for child in self._below[waiting.pop()]:
                servo = self._servo_above(child)
                if servo is None:
                    waiting.append(child)
                else:
                    chain = [servo]
                    self._follow(child, chain)
                    yield chain

    def _follow(self, link: str, chain: list[ServoJoint]) -> None:
        driven = [child for child in self._moved(link) if self._servo_above(child) is not None]
        if len(driven) == 1 and (servo := self._servo_above(driven[0])) is not None:
            chain.append(servo)
            self._follow(driven[0], chain)
        elif driven:
            chain.clear()  # A branch is no leg.

    def _moved(self, link: str) -> Iterator[str]:
        """Yield the links below that the next servos move, and those that move with this one."""
        for child in self._below[link]:
            yield child
            if self._servo_above(child) is None:
                yield from self._moved(child)

    def _servo_above(self, link: str) -> ServoJoint | None:
        return self._servos.get(self._file.above[link].name)

    # ---- a leg

    def _leg(self, chain: list[ServoJoint]) -> Leg:
        first, second, third = chain
        frames = placed(self._file, {})
        links = [joint.urdf.child for joint in chain]
        axes = np.array(
            [frames[link][0] @ np.array(j.urdf.axis) for link, j in zip(links, chain, strict=True)]
        )
        points = np.array([frames[link][1] for link in links])
        foot, foot_mm = self._foot(third, axes[2], frames)
        rotation, origin = frames[foot]
        made = _Chain(
            joints=(first, second, third),
            axes=axes,
            points_mm=points,
            foot=foot,
            foot_mm=foot_mm,
            tip_mm=rotation @ foot_mm + origin,
        )
        if abs(abs(axes[0, 2]) - 1.0) < PARALLEL:
            leg = _coxa_leg(made)
        elif abs(abs(axes[0, 0]) - 1.0) < PARALLEL:
            leg = _abduction_leg(made)
        else:
            raise InputError(f"joint {first.name} turns neither about z nor about x")
        self._prove(leg, made)
        return leg

    def _foot(
        self,
        third: ServoJoint,
        axis: FloatArray,
        frames: Mapping[str, tuple[FloatArray, FloatArray]],
    ) -> tuple[str, FloatArray]:
        """Return the link and the point of it that is furthest from the last axis."""
        link, point = third.urdf.child, np.zeros(3)
        start = frames[link][1]
        best_mm = FOOT_MIN_MM
        parts = [link, *self._moved(link)]
        corners = [(one, at) for one in parts for at in _corners(self._file, self._file.links[one])]
        for choices in ([(one, np.zeros(3)) for one in parts], corners):
            for name, corner in choices:
                rotation, origin = frames[name]
                away = rotation @ corner + origin - start
                away_mm = float(np.linalg.norm(away - (away @ axis) * axis))
                if away_mm > best_mm:
                    best_mm, link, point = away_mm, name, corner
            if best_mm > FOOT_MIN_MM:
                return link, point
        raise InputError(
            f"the end of the leg below joint {third.name} is not known: add a fixed link there"
        )

    def _prove(self, leg: Leg, chain: _Chain) -> None:
        """Compare the foot of `leg` with that of the file."""
        random = np.random.default_rng(1)
        lows, highs = np.array([joint.range_deg for joint in chain.joints]).T
        tried = random.uniform(lows, highs, (TRIALS, 3))
        hips_z = _hip_z(chain, leg.kind)
        self._hips_z.append(hips_z)
        own = forward(leg, tried)
        for angles, foot in zip(tried, own, strict=True):
            frames = placed(
                self._file, {j.urdf.name: a for j, a in zip(chain.joints, angles, strict=True)}
            )
            rotation, origin = frames[chain.foot]
            theirs = rotation @ chain.foot_mm + origin - np.array([0.0, 0.0, hips_z])
            off_mm = float(np.linalg.norm(theirs - foot))
            if off_mm > PROVED_MM:
                raise InputError(
                    f"the leg of joint {chain.joints[0].name} is built in another way (its foot "
                    f"is {off_mm:.1f} mm off)"
                )

    # ---- the file

    def _named(self, legs: list[Leg]) -> list[Leg]:
        """Return the legs with names by their places, left side first, from the front back."""
        sides = [
            sorted(
                (leg for leg in legs if leg.hip_mm[1] * side > 0.0), key=lambda leg: -leg.hip_mm[0]
            )
            for side in (1, -1)
        ]
        if len(sides[0]) != len(sides[1]):
            raise InputError("it has not as many legs on the left as on the right side")
        places = ("front", "rear") if len(sides[0]) == 2 else ("front", "middle", "rear")
        return [
            replace(leg, name=f"{side}_{place}")
            for side, ones in zip(("left", "right"), sides, strict=True)
            for place, leg in zip(places, ones, strict=True)
        ]

    def _text(self, name: str, robot: str, legs: list[Leg]) -> str:
        kind = legs[0].kind
        if any(leg.kind is not kind for leg in legs):
            raise InputError("its legs are of different kinds")
        if max(self._hips_z) - min(self._hips_z) > SAME_MM:
            raise InputError("its legs begin at different heights")
        stance_mm, height_mm = self._stance(legs)
        below_mm = legs[0].lengths_mm[1] + legs[0].lengths_mm[2]
        step_mm, stride_mm = round(STEP_SHARE * below_mm), round(STRIDE_SHARE * below_mm)
        pattern = "tripod" if len(legs) == 6 else "crawl"
        knee = f", knee: {legs[0].knee}" if kind is LegKind.ABDUCTION else ""
        rows = []
        for leg in legs:
            yaw = f", yaw_deg: {_digits(leg.yaw_deg)}" if kind is LegKind.COXA else ""
            rows += [
                f"  {leg.name}:",
                f"    {{joints: [{', '.join(leg.joints)}],",
                f"     hip_mm: {_list(leg.hip_mm)}{yaw}, lengths_mm: {_list(leg.lengths_mm)},",
                f"     zero_deg: {_list(leg.zero_deg)}, direction: {_list(leg.direction)}}}",
            ]
        return "\n".join(
            [
                "# Legs as they were recognised in the URDF file. Stance, height, pattern and step",
                "# are chosen to begin with: try `lss-motion gait` on this file.",
                "",
                f"gait: {name} walks",
                f"robot: {robot}",
                "",
                f"leg: {{kind: {kind.value}, stance_mm: {_digits(stance_mm)}{knee}}}",
                "legs:",
                *rows,
                "",
                f"height_mm: {_digits(height_mm)}",
                f"pattern: {pattern}",
                f"cycle_s: {CYCLES_S[pattern]:g}",
                f"step_height_mm: {step_mm}",
                "",
                "do:",
                f"  - walk: {{stride_mm: {stride_mm}, cycles: 3}}",
                f"  - walk: {{stride_mm: -{stride_mm}, cycles: 3}}",
                "",
            ]
        )

    def _stance(self, legs: list[Leg]) -> tuple[float, float]:
        """Return how far out and how low feet stand: the first choice with room in all ranges."""
        one, two, three = legs[0].lengths_mm
        rooms = []
        for upper in STANDS_DEG[legs[0].kind][0]:
            for lower in STANDS_DEG[legs[0].kind][1]:
                if legs[0].kind is LegKind.COXA:
                    femur, tibia = math.radians(upper), math.radians(lower)
                    stance = one + two * math.cos(femur) + three * math.cos(tibia)
                    height = -(two * math.sin(femur) + three * math.sin(tibia))
                else:
                    thigh = math.radians(lower)
                    shank = math.asin(min(two * math.sin(thigh) / three, 0.95))
                    stance, height = one, two * math.cos(thigh) + three * math.cos(shank)
                room = self._room_deg(legs, stance, height)
                if room >= ROOM_DEG:
                    return stance, height
                rooms.append((room, stance, height))
        room, stance, height = max(rooms)
        if room <= 0.0:
            raise InputError("the ranges of its joints allow none of the stances that were tried")
        return stance, height

    def _room_deg(self, legs: list[Leg], stance_mm: float, height_mm: float) -> float:
        if height_mm <= 0.0:
            return -math.inf
        room = math.inf
        for leg in legs:
            foot = [*neutral_mm(replace(leg, stance_mm=stance_mm)), -height_mm]
            try:
                angles = inverse(leg, np.array([foot]))[0]
            except InputError:
                return -math.inf
            names = {one.name: one for one in self._servos.values()}
            for joint, angle in zip(leg.joints, angles, strict=True):
                low, high = names[joint].range_deg
                room = min(room, angle - low, high - angle)
        return float(room)


def placed(
    file: UrdfFile, joint_deg: Mapping[str, float]
) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Return rotation (3, 3) and origin (3,) in mm of each link, in the frame of the first one.

    `joint_deg` by the names of the file; a joint that is left out is at 0.
    """
    frames = {file.order[0]: (np.eye(3), np.zeros(3))}
    for link in file.order[1:]:
        joint = file.above[link]
        rotation, origin = frames[joint.parent]
        at_mm, rest = file.frame(joint.element)
        turn = turned(joint.axis, math.radians(joint_deg.get(joint.name, 0.0)))
        frames[link] = (
            rotation @ np.array(rest) @ np.array(turn),
            rotation @ np.array(at_mm) + origin,
        )
    return frames


def _corners(file: UrdfFile, link: UrdfElement) -> Iterator[FloatArray]:
    """Yield the middles of the faces of boxes, the ends of cylinders and the poles of balls."""
    for tag in ("visual", "collision"):
        for part in link.of(tag):
            geometry = part.one("geometry")
            if geometry is None or not geometry.children:
                continue
            shape = geometry.children[0]
            half: tuple[float, ...]
            match shape.tag:
                case "box":
                    half = tuple(0.5 * MM_PER_M * s for s in file.vector(shape, "size", (0, 0, 0)))
                case "cylinder":
                    half = (0.0, 0.0, 0.5 * MM_PER_M * file.number(shape, "length", 0.0))
                case "sphere":
                    half = (MM_PER_M * file.number(shape, "radius", 0.0),) * 3
                case _:
                    continue
            at_mm, rotation = file.frame(part)
            for axis in range(3):
                for side in (-1.0, 1.0):
                    corner = np.zeros(3)
                    corner[axis] = side * half[axis]
                    yield np.array(rotation) @ corner + np.array(at_mm)


def _hip_z(chain: _Chain, kind: LegKind) -> float:
    """Return the height of the hip: of the second axis of a coxa leg, else of the first."""
    return float(chain.points_mm[1 if kind is LegKind.COXA else 0, 2])


def _coxa_leg(chain: _Chain) -> Leg:
    axes, points, name = chain.axes, chain.points_mm, chain.joints[0].name
    side = axes[1]
    if abs(side[2]) > PARALLEL or np.linalg.norm(np.cross(side, axes[2])) > PARALLEL:
        raise InputError(f"joints 2 and 3 of the leg of {name} are not level and parallel")
    up = np.array([0.0, 0.0, 1.0])
    out = np.cross(side, up)
    if (chain.tip_mm - points[0]) @ out < 0.0:
        out = -out
    hip = np.array([points[0, 0], points[0, 1], points[1, 2]])
    _require_plane(name, (chain.tip_mm - hip) @ side)
    knee, ankle, tip = (
        np.array([(point - hip) @ out, point[2] - hip[2]])
        for point in (points[1], points[2], chain.tip_mm)
    )
    femur, tibia = ankle - knee, tip - ankle
    femur_deg, tibia_deg = (math.degrees(math.atan2(v[1], v[0])) for v in (femur, tibia))
    lifts = np.cross(out, up)
    return Leg(
        name=name,
        joints=(chain.joints[0].name, chain.joints[1].name, chain.joints[2].name),
        kind=LegKind.COXA,
        hip_mm=(float(hip[0]), float(hip[1])),
        yaw_deg=math.degrees(math.atan2(out[1], out[0])),
        lengths_mm=(float(knee[0]), float(np.hypot(*femur)), float(np.hypot(*tibia))),
        stance_mm=0.0,
        zero_deg=(0.0, femur_deg, _turn(tibia_deg - femur_deg + 90.0)),
        direction=(_sign(axes[0, 2]), _sign(axes[1] @ lifts), _sign(axes[2] @ lifts)),
        knee="back",
    )


def _abduction_leg(chain: _Chain) -> Leg:
    axes, points, name = chain.axes, chain.points_mm, chain.joints[0].name
    if abs(axes[1, 0]) > PARALLEL or np.linalg.norm(np.cross(axes[1], axes[2])) > PARALLEL:
        raise InputError(f"joints 2 and 3 of the leg of {name} do not turn across the first")
    hip = np.array([points[1, 0], points[0, 1], points[0, 2]])
    side = math.copysign(1.0, hip[1])
    out = axes[1] * _sign(axes[1, 1] * side)
    ahead, down = np.array([1.0, 0.0, 0.0]), np.cross(np.array([side, 0.0, 0.0]), out) * -1.0
    _require_plane(name, (points[1] - hip) @ down)
    knee, tip = points[2] - points[1], chain.tip_mm - points[2]
    thigh = np.array([knee @ ahead, knee @ down])
    shank = np.array([tip @ ahead, tip @ down])
    thigh_deg, shank_deg = (math.degrees(math.atan2(v[0], v[1])) for v in (thigh, shank))
    first_deg = math.degrees(math.atan2(out[2], side * out[1]))
    swings = np.cross(down, ahead)
    bend_deg = _turn(shank_deg - thigh_deg)
    directions = (
        _sign(axes[0, 0] * side), _sign(axes[1] @ swings), _sign(axes[2] @ swings),
    )  # fmt: skip
    low, high = chain.joints[2].range_deg
    middle_deg = bend_deg + 0.5 * (low + high) * directions[2]
    return Leg(
        name=name,
        joints=(chain.joints[0].name, chain.joints[1].name, chain.joints[2].name),
        kind=LegKind.ABDUCTION,
        hip_mm=(float(hip[0]), float(hip[1])),
        yaw_deg=0.0,
        lengths_mm=(
            float((chain.tip_mm - hip) @ out),
            float(np.hypot(*thigh)),
            float(np.hypot(*shank)),
        ),
        stance_mm=0.0,
        zero_deg=(first_deg, thigh_deg, bend_deg),
        direction=directions,
        knee="back" if middle_deg >= 0.0 else "forward",
    )


def _require_plane(name: str, off_mm: float) -> None:
    if abs(off_mm) > SAME_MM:
        raise InputError(
            f"the leg of {name} is not in one plane with its first axis: {abs(off_mm):.1f} mm off"
        )


def _turn(angle_deg: float) -> float:
    """Return the angle between -180 and 180."""
    return (angle_deg + 180.0) % 360.0 - 180.0


def _sign(value: float) -> int:
    return 1 if value > 0.0 else -1


def _digits(value: float) -> str:
    return f"{round(value, 2) + 0.0:g}"


def _list(values: tuple[float, ...]) -> str:
    return f"[{', '.join(map(_digits, values))}]"
