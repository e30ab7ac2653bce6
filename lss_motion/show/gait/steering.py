"""Plans of a walk that is steered while it goes. Law: every plan ends in a stable stand.

Time is divided into phases; between two boundaries the same legs swing. At a boundary a new
velocity can begin; it is blended in over one cycle. A `WalkPlan` has the phases that are walked at
that velocity, and then the steps that lead to a stand. The next plan replaces those steps from its
own first boundary on. If none comes in time, they are walked. So a plan is valid only if all of
it, its end included, is within every limit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, PlanningError
from lss_motion.show.gait.curves import Spline
from lss_motion.show.gait.kinematics import neutral_mm
from lss_motion.show.gait.model import Walk
from lss_motion.show.gait.pacing import (
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
from lss_motion.show.gait.passage import Walking, lean_s_of, stepping
from lss_motion.show.gait.stepping import INSTANT_S, STILL, Foot, Stepper, Twist, Walker
from lss_motion.units import significant

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import BodyPose, Gait

    FloatArray = NDArray[np.float64]

KEYS_PER_CYCLE: Final = 64
"""Keys of one cycle. Measured: feet deviate 0.03 mm between them at the longest strides."""

SLOPE_STEP_S: Final = 1e-4
"""Slopes at keys are differences over twice this: their error is 1e-8 of a degree."""

HISTORY_S: Final = 0.3
"""How much of the path before its start a plan holds: commands are sent ahead of their motion."""

CHANGE_RATIOS: Final = (1.0, 0.7, 0.45, 0.25, 0.1, 0.0)
"""Shares of a change of velocity that are tried at one boundary; the rest follows at the next."""

SLOWED_RATIO: Final = 1.05
"""The cycle is longer by this than each part of a velocity needs, so that parts can be combined.
Chosen: a tenth of the acceleration."""

USED_MAX_RATIO: Final = 1.0 + 1e-6
"""A path within the limits stays within when it is integrated again: rounding."""


class WalkPlan(Struct, frozen=True, kw_only=True):
    """The walk from a boundary on, with the steps that lead to a stand.

    The joints follow cubics through `angles_deg` with `slopes_deg_s` at `times_s`, which begin
    `HISTORY_S` before the start of the plan, `from_s`. Until `next_s` the velocity is `twist`;
    `following` is the walker at that boundary. The robot stands from `end_s` on. Seconds count
    from the stand at which the walk began.
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


class SteeredGait(Struct, frozen=True):
    """Makes the plans of one walk with the body in `pose`; `gait.actions` are not used."""

    gait: Gait
    robot: Robot
    pose: BodyPose

    @property
    def stepper(self) -> Stepper:
        """The steps of this gait."""
        return Stepper(self.gait)

    @property
    def joints(self) -> tuple[str, ...]:
        """The order of the columns of a plan."""
        return joints_of(self.gait)

    def standing(self) -> Walker:
        """Return the walker before its first step."""
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
        """Return whether the walker rests, with every foot at its neutral position."""
        return walker.twist == STILL and not self.stepper.goes_on(walker)

    def plan_towards(self, walker: Walker, commanded: Twist, hold: int = 1) -> WalkPlan:
        """Return the plan whose velocity is closest to `commanded`, held for `hold` phases.

        A change that would break a limit is made in part. If no velocity is possible, the plan
        stops. Raises `InputError` or `PlanningError` if stopping breaks a limit, which the check
        of the plan before excludes.
        """
        for ratio in CHANGE_RATIOS:
            try:
                return self.plan(walker, walker.twist.towards(commanded, ratio), hold)
            except (InputError, PlanningError):
                continue
        return self.plan(walker, STILL, hold)

    def plan(self, walker: Walker, twist: Twist, hold: int = 1) -> WalkPlan:
        """Return the plan at exactly that velocity; raises if it breaks a limit anywhere."""
        first, taken = walker, self.stepper.changed(walker, twist)
        own: list[list[Foot]] = [[] for _ in self.gait.legs]
        walker = self.stepper.walked(taken, hold, own)
        following, stopping = walker, self.stepper.changed(walker, STILL)
        path = self.stepper.travel(stopping, 1 + self.stepper.phases, since=taken)
        walker = stopping
        while walker.boundary < following.boundary + self.stepper.phases or self.stepper.goes_on(
            walker
        ):
            walker = self.stepper.walked(walker, 1, own)
        passage = stepping(self.gait, self.pose, path, self.stepper.legs(taken, own))
        return self._within_limits(passage, first, following, twist)

    def _within_limits(
        self, passage: Walking, first: Walker, following: Walker, twist: Twist
    ) -> WalkPlan:
        """Return the plan of a passage if it is within every limit; raises if it is not."""
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
        checked_s = checked_times_s(passage, times_s)
        checked_s = checked_s[checked_s >= begins_s]
        margin_mm = passage.at(checked_s).margin_mm()
        worst = int(np.argmin(margin_mm))
        check_margin(gait, passage, actions, float(margin_mm[worst]), float(checked_s[worst]))
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

    The gait is slowed as a whole, as by `paced`, so that strides keep their lengths. Raises
    `InputError` or `PlanningError` if a stride of `top` cannot be walked at any pace.
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
    """Return the walker with the keys of the last `HISTORY_S` before it."""
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
    """Return the action that errors refer to."""
    return Walk(
        forward_mm_s=twist.forward_mm_s,
        left_mm_s=twist.left_mm_s,
        turn_deg_s=twist.turn_deg_s,
        cycles=1,
        label="steered",
    )
