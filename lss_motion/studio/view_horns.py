"""Where the bytes of a show take its joints, as curves of the Timeline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.planning.program.verify import driven, profiles
from lss_motion.robot.profile import profile_lead_s
from lss_motion.studio.view_curves import Samples, Tolerance, fitted

if TYPE_CHECKING:
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.program.response import PiecewiseProfile
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.studio.view_curves import Curve

INSIDE: Final = 3
"""Samples between the ends of a piece of a profile. Chosen: a cubic that fits there fits
everywhere."""


def horn_curves(program: Program, robot: Robot, end_s: float) -> dict[str, Curve]:
    """Return where the bytes take each joint: the profiles of its servos, later by their lead."""
    servos = driven(robot.servo_robot, program)
    horns = {
        name: _horn(servos.joints[name], profile, end_s)
        for name, profile in profiles(program, robot).items()
    }
    behind = {servo for mechanism in robot.mechanisms.values() for servo in mechanism.servos}
    curves = {
        name: fitted(samples, np.zeros(0), Tolerance())
        for name, samples in horns.items()
        if name not in behind
    }
    for mechanism in robot.mechanisms.values():
        if {*mechanism.servos} <= horns.keys():
            own = [horns[name] for name in mechanism.servos]
            for name, samples in zip(mechanism.joints, _joints_of(mechanism, own), strict=True):
                curves[name] = fitted(samples, np.zeros(0), Tolerance())
    return curves


def _horn(servo: Joint, profile: PiecewiseProfile, end_s: float) -> Samples:
    """Return where a horn is, in degrees of an ideal servo."""
    start_s, position_deg, speed_deg_s, accel_deg_s2 = profile.table
    start_s = start_s + profile_lead_s(servo)
    first = max(int(np.searchsorted(start_s, 0.0, side="right")) - 1, 0)
    pieces = np.arange(first, max(int(np.searchsorted(start_s, end_s)), first + 1))
    begins_s = np.maximum(start_s[pieces], 0.0)
    ends_s = np.minimum(np.append(start_s[1:], np.inf)[pieces], end_s)
    # Both ends of each piece: of a stepped servo, a piece begins elsewhere than one ended.
    lasts_s = np.maximum(ends_s - begins_s, 0.0)
    times_s = begins_s[:, None] + lasts_s[:, None] * np.linspace(0.0, 1.0, INSIDE + 2)
    origin_s = np.where(np.isfinite(start_s[pieces]), start_s[pieces], begins_s)
    since_s = times_s - origin_s[:, None]
    speed, accel = speed_deg_s[pieces, None], accel_deg_s2[pieces, None]
    servo_deg = position_deg[pieces, None] + since_s * (speed + 0.5 * accel * since_s)
    return Samples(
        times_s.ravel(),
        servo.direction * (servo_deg - servo.zero_deg).ravel(),
        servo.direction * (speed + accel * since_s).ravel(),
        np.full(times_s.size, np.nan),
    )


def _joints_of(mechanism: Mechanism, horns: list[Samples]) -> list[Samples]:
    """Return where the horns of its servos take the joints of a mechanism."""
    times_s = horns[0].times_s
    if len(horns) > 1:
        times_s = np.unique(np.concatenate([one.times_s for one in horns]))
    deg, deg_s = (
        np.stack([np.interp(times_s, one.times_s, getattr(one, key)) for one in horns], axis=1)
        if len(horns) > 1
        else getattr(horns[0], key)[:, None]
        for key in ("deg", "deg_s")
    )
    g = mechanism.transmission
    joint_deg = g.joint_deg(deg)
    joint_deg_s = np.einsum("njs,ns->nj", np.linalg.pinv(g.slopes(joint_deg)), deg_s)
    nothing = np.full(len(times_s), np.nan)
    return [
        Samples(times_s, joint_deg[:, column], joint_deg_s[:, column], nothing)
        for column in range(len(mechanism.joints))
    ]
