"""Shows of a few keyframes, samples of one joint, and the closed form of a move."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lss_motion.show.model import Sequence

if TYPE_CHECKING:
    from lss_motion.planning.trajectory.model import Trajectory


def show(*frames, name="test", **more) -> Sequence:
    return Sequence(name=name, keyframes=frames, **more)


def at(trajectory: Trajectory, joint: str, *times_s: float, order: int = 0) -> np.ndarray:
    """Return the samples of one joint."""
    column = trajectory.joints.index(joint)
    return trajectory.sample(np.array(times_s), order)[:, column]


def blink(frame, *, name="blink", joint="elbow", top=20.0, **more) -> Sequence:
    """Return a show in which a joint moves up and down within 1 s."""
    return show(
        frame(0.0, **{joint: 0.0}),
        frame(0.5, **{joint: top}),
        frame(1.0, **{joint: 0.0}),
        name=name,
        **more,
    )


def trapezoid_s(deg, speed=180.0, accel=600.0) -> float:
    """Return the least duration of a move from rest to rest, from first principles."""
    if deg <= speed**2 / accel:
        return 2.0 * (deg / accel) ** 0.5
    return deg / speed + speed / accel
