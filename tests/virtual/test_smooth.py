"""What smoothing leaves at the horn, behind the ramps of a simulated servo."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from lss_motion.show.model import Keyframe, Sequence

STEP_S = 0.04
"""Angles are differenced over this, as the signal of an accelerometer on a head is filtered."""

FRAMES = tuple(
    Keyframe(deg={"j0": deg}, at_s=at_s, hold_s=0.3)
    for at_s, deg in ((0.0, 0.0), (1.5, 45.0), (3.0, -30.0), (4.5, 0.0))
)


def horn_jerk(played):
    """Return the jerk of the horn of the only joint at equal instants of the show."""
    truth = played.result.truth
    at_s = np.arange(0.0, 4.8, STEP_S)
    horn_deg = np.interp(at_s, truth.times_s, truth.horn_deg[:, 0])
    return np.diff(horn_deg, n=3) / STEP_S**3


def test_smooth_motion_shakes_the_horn_less(stage, kit):
    robot = kit.robot(1, baud_bps=115200, accel_max_deg_s2=300.0)
    rough = Sequence(name="turn", keyframes=FRAMES)
    before, after = (
        horn_jerk(stage.play(robot, replace(rough, smooth_s=smooth_s), has_feedback=False))
        for smooth_s in (0.0, 0.2)
    )
    # Measured: 1,790 deg/s³ RMS instead of 2,060. The servo's own ramps make the rest.
    assert np.abs(after).max() < 0.9 * np.abs(before).max()
    assert after.std() < 0.93 * before.std()
