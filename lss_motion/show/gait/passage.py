"""Passages of a gait, from rest to rest: walks with entry and exit, or moves of the body.

`Passage` is what `pacing` uses of both. `Posing` moves the body over standing feet, `Walking`
combines the path of the body, the steps of the feet, sway and swings.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.show.gait.curves import blend, through
from lss_motion.show.gait.kinematics import Stance, neutral_mm
from lss_motion.show.gait.stepping import Steps, Travel, steps, travel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.show.gait.model import BodyMove, BodyPose, Gait, Walk, Wave

    FloatArray = NDArray[np.float64]

SWAY_WIDTH_RATIO: Final = 0.5
"""Share of a cycle over which the body leans away from one leg and back. Chosen: the next leg of a
crawl lifts a quarter of a cycle later, when the lean away from it has reached its half."""

LEAN_RATIO: Final = 0.5
"""The sway begins this share of a cycle before the first step and ends it after the last one."""

FADE_S: Final = 1.0
"""Swings fade in and out for so long, or for half of a shorter passage. Chosen."""


class Passage(Protocol):
    """Body and feet from rest to rest, at the author's pace. Feet are neutral at both ends."""

    @property
    def duration_s(self) -> float:
        """How long it takes at the author's pace."""

    def at(self, times_s: FloatArray) -> Stance:
        """Return body and feet, legs in the order of the gait."""

    @property
    def starts_s(self) -> FloatArray:
        """When each of its actions begins."""

    @property
    def turns_s(self) -> FloatArray:
        """The instants at which a foot lifts or lands."""


class Posing(Struct, frozen=True, kw_only=True):
    """The body moves from pose to pose; the feet stand. `poses` has x, y, z, roll, pitch, yaw."""

    times_s: FloatArray
    poses: FloatArray
    feet_mm: FloatArray
    waves: tuple[Wave, ...] = ()

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    @property
    def starts_s(self) -> FloatArray:
        return self.times_s[:-1]

    @property
    def turns_s(self) -> FloatArray:
        return np.zeros(0)

    def at(self, times_s: FloatArray) -> Stance:
        pose = through(self.times_s, self.poses, np.clip(times_s, 0.0, self.duration_s))
        pose = pose + swings(self.waves, times_s, self.duration_s)
        feet = np.zeros((len(times_s), *self.feet_mm.shape))
        return Stance(
            places=np.zeros((len(times_s), 3)),
            shift_mm=pose[:, :3],
            tilt_deg=pose[:, 3:],
            feet_mm=feet + self.feet_mm,
            is_down=np.ones(feet.shape[:2], dtype=np.bool_),
        )


class Walking(Struct, frozen=True, kw_only=True):
    """The body travels in one pose, swaying away from lifted legs; the feet step.

    Travel and steps begin `lean_s` after the passage, and end as much before its end.
    """

    travel: Travel
    steps: tuple[Steps, ...]
    pose: FloatArray
    lean_s: float
    cycle_s: float
    swings_ratio: FloatArray
    """The middle of the step of each leg, as a share of the cycle."""
    sways_mm: FloatArray
    """How far the body leans at that time, (legs, 2)."""
    waves: tuple[Wave, ...] = ()

    @property
    def _stepping_s(self) -> float:
        lands_s = [float(own.lands_s[-1]) for own in self.steps if len(own.lands_s)]
        return max([self.travel.duration_s, *lands_s])

    @property
    def duration_s(self) -> float:
        return self._stepping_s + 2.0 * self.lean_s

    @property
    def starts_s(self) -> FloatArray:
        return self.travel.starts_s + np.where(self.travel.starts_s > 0.0, self.lean_s, 0.0)

    @property
    def begins_s(self) -> FloatArray:
        """When each walk begins to travel, after the lean."""
        return self.travel.starts_s + self.lean_s

    @property
    def turns_s(self) -> FloatArray:
        instants = [part for own in self.steps for part in (own.lifts_s, own.lands_s)]
        return np.unique(np.concatenate(instants)) + self.lean_s

    def at(self, times_s: FloatArray) -> Stance:
        walked_s = np.asarray(times_s - self.lean_s)
        feet = [own.at(walked_s) for own in self.steps]
        pose = self.pose + swings(self.waves, times_s, self.duration_s)
        shift_mm = pose[:, :3]
        shift_mm[:, :2] += self._sway_mm(walked_s)
        return Stance(
            places=self.travel.at(walked_s),
            shift_mm=shift_mm,
            tilt_deg=pose[:, 3:],
            feet_mm=np.stack([foot for foot, _ in feet], axis=1),
            is_down=np.stack([down for _, down in feet], axis=1),
        )

    def _sway_mm(self, walked_s: FloatArray) -> FloatArray:
        if self.lean_s == 0.0:
            return np.zeros((len(walked_s), 2))
        offset = walked_s[:, None] / self.cycle_s - self.swings_ratio + 0.5
        offset = (offset % 1.0 - 0.5) / SWAY_WIDTH_RATIO
        weight = np.where(np.abs(offset) < 0.5, np.cos(np.pi * offset) ** 2, 0.0)
        end_s = self._stepping_s + self.lean_s
        share = blend(walked_s / self.lean_s + 1.0) * blend((end_s - walked_s) / self.lean_s)
        return np.asarray(share[:, None] * (weight @ self.sways_mm))


def posing(gait: Gait, start: BodyPose, moves: Sequence[BodyMove]) -> Posing:
    """Return the passage of consecutive moves; only the last may have a hold."""
    return Posing(
        times_s=np.cumsum([0.0, *(move.in_s for move in moves)]),
        poses=np.stack([_xyz_rpy(gait, start), *(_xyz_rpy(gait, move.pose) for move in moves)]),
        feet_mm=np.array([[*neutral_mm(leg), 0.0] for leg in gait.legs]),
        waves=gait.waves,
    )


def walking(gait: Gait, pose: BodyPose, walks: Sequence[Walk]) -> Walking:
    """Return the passage of consecutive walks."""
    path = travel(walks, gait.cycle_s)
    legs = tuple(
        steps(
            neutral_mm(leg),
            path,
            lift_ratio=lift_ratio,
            duty_ratio=gait.duty,
            cycle_s=gait.cycle_s,
            height_mm=gait.step_height_mm,
        )
        for leg, lift_ratio in zip(gait.legs, gait.pattern.lifts_ratio, strict=True)
    )
    return replace(stepping(gait, pose, path, legs), waves=gait.waves)


def swings(waves: Sequence[Wave], times_s: FloatArray, duration_s: float) -> FloatArray:
    """Return the sum of the swings, (n, 6); it is zero and at rest at both ends of a passage."""
    fade_s = min(FADE_S, 0.5 * duration_s)
    share = blend(times_s / fade_s) * blend((duration_s - times_s) / fade_s)
    total = np.zeros((len(times_s), 6))
    for wave in waves:
        angle = 2.0 * np.pi * (times_s / wave.every_s + wave.start_ratio)
        most = np.array([*wave.pose.shift_mm, *wave.pose.tilt_deg])
        total += (share * np.sin(angle))[:, None] * most
    return total


def stepping(gait: Gait, pose: BodyPose, path: Travel, legs: tuple[Steps, ...]) -> Walking:
    """Return the passage of a body in one pose with its path, and of the steps of its feet."""
    neutral = np.array([neutral_mm(leg) for leg in gait.legs])
    return Walking(
        travel=path,
        steps=legs,
        pose=_xyz_rpy(gait, pose),
        lean_s=lean_s_of(gait),
        cycle_s=gait.cycle_s,
        swings_ratio=np.array(gait.pattern.lifts_ratio) + 0.5 * (1.0 - gait.duty),
        sways_mm=-gait.sway_mm * neutral / np.hypot(*neutral.T)[:, None],
    )


def lean_s_of(gait: Gait) -> float:
    """Return how long the sway takes to begin before the first step, and to end after the last."""
    return LEAN_RATIO * gait.cycle_s if gait.sway_mm > 0.0 else 0.0


def _xyz_rpy(gait: Gait, pose: BodyPose) -> FloatArray:
    """Return a pose as x, y, z, roll, pitch, yaw, its z from the ground."""
    x, y, z = pose.shift_mm
    return np.array([x, y, gait.height_mm + z, *pose.tilt_deg])
