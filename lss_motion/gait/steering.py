"""A walk that is steered while it goes: whatever is steered, it always ends in a stable stand.

Time is cut into phases: between two boundaries the same legs swing. At a boundary a new velocity
may be taken up; like every change it is blended in over one cycle. What is planned from there on
is a *stretch*: the phases that are walked at that velocity, and then the steps that lead to a
stand. A later stretch replaces those steps from its own first boundary on; if none comes, they are
walked. So a stretch is only taken if all of it, its end included, is within every limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError, PlanningError
from lss_motion.gait.curves import Spline
from lss_motion.gait.kinematics import neutral_mm
from lss_motion.gait.model import Walk
from lss_motion.gait.pacing import (
    ACCEL_SHARE,
    FOOT_ERROR_MM,
    angles_at,
    check_margin,
    check_range,
    checked_times_s,
    error_mm,
    joints_of,
    paced,
)
from lss_motion.gait.passage import Walking, lean_s_of, stepping
from lss_motion.gait.stepping import INSTANT_S, STILL, Foot, Stepper, Twist, Walker
from lss_motion.units import significant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.gait.model import BodyPose, Gait
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

KEYS_PER_CYCLE: Final = 64
"""Keys of one cycle. Measured: feet stray 0.03 mm between them at the longest strides."""

SLOPE_STEP_S: Final = 1e-4
"""Slopes at keys are differences over twice this: a hundred millionth of a degree off."""

HISTORY_S: Final = 0.3
"""How much of what was before a stretch begins with: a servo is sent what it does early."""

CHANGE_RATIOS: Final = (1.0, 0.7, 0.45, 0.25, 0.1, 0.0)
"""How much of a change of velocity is tried at one boundary; the rest follows at the next."""

SLOWED_RATIO: Final = 1.05
"""Slower than each part of a velocity needs by this, so that parts can be put together. Chosen: a
tenth of the acceleration."""

USED_MAX_RATIO: Final = 1.0 + 1e-6
"""What was within the limits once is still within when it is integrated anew: rounding."""


@dataclass(frozen=True, slots=True, kw_only=True)
class WalkPlan:
    """What is walked from a boundary on, with all that leads to a stand.

    The joints follow cubics through `angles_deg` with `slopes_deg_s` at `times_s`, which begin
    `HISTORY_S` before `from_s`, where the stretch begins. Until `next_s` the velocity is `twist`;
    `following` is the walker there. `end_s` is when it stands. Seconds count from the stand at
    which the walk began.
    """

    twist: Twist
    from_s: float
    next_s: float
    end_s: float
    times_s: FloatArray
    angles_deg: FloatArray
    slopes_deg_s: FloatArray
    margin_min_mm: float
    following: Walker


@dataclass(frozen=True, slots=True)
class Steering:
    """Plans the stretches of a gait that never breaks off; `gait.actions` do not matter."""

    gait: Gait
    robot: Robot
    pose: BodyPose

    @property
    def stepper(self) -> Stepper:
        return Stepper(self.gait)

    @property
    def joints(self) -> tuple[str, ...]:
        """The order of the columns of a stretch."""
        return joints_of(self.gait)

    def standing(self) -> Walker:
        """Return the robot before its first step."""
        feet = [neutral_mm(leg) for leg in self.gait.legs]
        still = Walker(
            boundary=0,
            twist=STILL,
            changes=(),
            place=np.zeros(3),
            feet=tuple(Foot(place_mm=foot, from_mm=foot) for foot in feet),
            past_s=np.zeros(0),
            past=Spline(HISTORY_S, np.zeros((0, 0)), np.zeros((0, 0))),
        )
        passage = stepping(
            self.gait, self.pose, self.stepper.travel(still, 1), self.stepper.legs(still, ())
        )
        angles = angles_at(self.gait, passage, np.zeros(1), (_walk(STILL),))
        check_range(self.gait, self.robot, passage, np.zeros(1), angles, (_walk(STILL),))
        angles = np.repeat(angles, 2, axis=0)
        past = Spline(HISTORY_S, angles, np.zeros_like(angles))
        return replace(still, past_s=np.array([-HISTORY_S, 0.0]), past=past)

    def is_standing(self, walker: Walker) -> bool:
        """Return whether it has come to rest, with every foot where it belongs."""
        return walker.twist == STILL and not self.stepper.goes_on(walker)

    def plan_towards(self, walker: Walker, commanded: Twist, hold: int = 1) -> WalkPlan:
        """Return the stretch that comes closest to `wanted`, held for `hold` phases.

        A change that asks too much is made in part; the rest is asked for at the next boundary.
        Where nothing but to stop is possible, that is what is returned. Raises `InputError` or
        `PlanningError` if even that is not, which the stretch before has ruled out.
        """
        for ratio in CHANGE_RATIOS:
            try:
                return self.plan(walker, walker.twist.towards(commanded, ratio), hold)
            except (InputError, PlanningError):
                continue
        return self.plan(walker, STILL, hold)

    def plan(self, walker: Walker, twist: Twist, hold: int = 1) -> WalkPlan:
        """Return the stretch at exactly that velocity; raises if it breaks a limit anywhere."""
        first, taken = walker, self.stepper.changed(walker, twist)
        own: list[list[Foot]] = [[] for _ in self.gait.legs]
        walker = self.stepper.walked(taken, hold, own)
        following, stopping = walker, self.stepper.changed(walker, STILL)
        way = self.stepper.travel(stopping, 1 + self.stepper.phases, since=taken)
        walker = stopping
        while walker.boundary < following.boundary + self.stepper.phases or self.stepper.goes_on(
            walker
        ):
            walker = self.stepper.walked(walker, 1, own)
        passage = stepping(self.gait, self.pose, way, self.stepper.legs(taken, own))
        return self._judged(passage, first, following, twist)

    # ---- joints

    def _judged(self, passage: Walking, first: Walker, following: Walker, twist: Twist) -> WalkPlan:
        """Return the stretch if it is within every limit."""
        gait, robot, actions = self.gait, self.robot, (_walk(twist),)
        begins_s = first.boundary * self.stepper.phase_s + (
            lean_s_of(gait) if first.boundary else 0.0
        )
        next_s = following.boundary * self.stepper.phase_s + lean_s_of(gait)
        keys = 2 * -(-KEYS_PER_CYCLE // (2 * self.stepper.phases))
        step_s = self.stepper.phase_s / keys
        count = int(np.ceil((passage.duration_s - begins_s) / step_s - INSTANT_S))
        times_s = begins_s + step_s * np.arange(count + 1, dtype=np.float64)
        angles = angles_at(gait, passage, times_s, actions)
        later = angles_at(gait, passage, times_s + SLOPE_STEP_S, actions)
        earlier = angles_at(gait, passage, times_s - SLOPE_STEP_S, actions)
        slopes = (later - earlier) / (2.0 * SLOPE_STEP_S)
        angles[0], slopes[0] = first.past.values[-1], first.past.slopes[-1]
        slopes[-1] = 0.0
        curve = Spline(step_s, angles, slopes)
        check_range(gait, robot, passage, times_s, angles, actions)
        self._check_pace(curve)
        if error_mm(gait, passage, times_s, curve.middles()) > FOOT_ERROR_MM:
            raise InputError("a leg is so close to the end of its reach that it cannot follow")
        judged_s = checked_times_s(passage, times_s)
        judged_s = judged_s[judged_s >= begins_s]
        margin_mm = passage.at(judged_s).margin_mm()
        worst = int(np.argmin(margin_mm))
        check_margin(gait, passage, actions, float(margin_mm[worst]), float(judged_s[worst]))
        split = round((next_s - begins_s) / step_s)
        return WalkPlan(
            twist=twist,
            from_s=begins_s,
            next_s=next_s,
            end_s=float(times_s[-1]),
            times_s=np.concatenate([first.past_s[:-1], times_s]),
            angles_deg=np.concatenate([first.past.values[:-1], angles]),
            slopes_deg_s=np.concatenate([first.past.slopes[:-1], slopes]),
            margin_min_mm=float(margin_mm[worst]),
            following=_with_past(following, first, times_s, curve, split),
        )

    def _check_pace(self, curve: Spline) -> None:
        speed, accel = curve.peaks()
        for column, name in enumerate(self.joints):
            joint = self.robot.joints[name]
            for used, allowed, unit in (
                (speed[column], joint.speed_max_deg_s, "deg/s"),
                (accel[column], ACCEL_SHARE * joint.accel_max_deg_s2, "deg/s²"),
            ):
                if used > USED_MAX_RATIO * allowed:
                    raise PlanningError(
                        f"joint {name!r} would need {significant(used)} {unit}, allowed "
                        f"{allowed:g} {unit}",
                        joint=name,
                    )


def slowed_to_limits(gait: Gait, robot: Robot, top: Twist) -> tuple[Gait, Twist]:
    """Return a gait whose cycle is as long as the servos need for each part of `top`, and `top`.

    What is too fast is slowed as a whole, as `paced` does, so that strides keep their lengths.
    Raises `InputError` or `PlanningError` if a stride of `top` cannot be walked at any pace.
    """
    alone = [
        Twist(forward_mm_s=top.forward_mm_s),
        Twist(left_mm_s=top.left_mm_s),
        Twist(turn_deg_s=top.turn_deg_s),
    ]
    walks = [replace(gait, actions=(_walk(twist),)) for twist in alone if twist != STILL]
    ratio = max((part.pace_ratio for walk in walks for part in paced(walk, robot)), default=1.0)
    ratio = max(1.0, ratio * SLOWED_RATIO)
    slower = STILL.towards(top, 1.0 / ratio)
    return replace(gait, cycle_s=gait.cycle_s * ratio), slower


def _with_past(
    following: Walker, first: Walker, times_s: FloatArray, curve: Spline, split: int
) -> Walker:
    """Return the walker with the last `HISTORY_S` of keys that lead to it."""
    kept = min(split, int(np.ceil(HISTORY_S / curve.step_s)))
    rows = slice(split - kept, split + 1)
    past = Spline(curve.step_s, curve.values[rows], curve.slopes[rows])
    if kept * curve.step_s >= HISTORY_S - INSTANT_S:
        return replace(following, past_s=times_s[rows], past=past)
    before = first.past
    return replace(
        following,
        past_s=np.concatenate([first.past_s[:-1], times_s[rows]]),
        past=Spline(
            curve.step_s,
            np.concatenate([before.values[:-1], past.values]),
            np.concatenate([before.slopes[:-1], past.slopes]),
        ),
    )


def _walk(twist: Twist) -> Walk:
    """Return the action that a complaint is about."""
    return Walk(
        forward_mm_s=twist.forward_mm_s,
        left_mm_s=twist.left_mm_s,
        turn_deg_s=twist.turn_deg_s,
        cycles=1,
        label="steered",
    )
