"""Robots of one kind of joint, and shows for them."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.robot.model import Bus, Joint, Response, Robot
from lss_motion.sequence.model import Keyframe, Sequence, Timing
from lss_motion.trajectory.planner import plan
from tests.joints import joint


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path_factory.mktemp("plans")))


def robot(*joints: Joint, baud_bps=115200) -> Robot:
    joints = joints or (joint(),)
    return Robot(
        name="bench",
        path=None,
        buses={"main": Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370)},
        joints={one.name: one for one in joints},
    )


def keys(*rows, loop=1, timing=Timing.AUTHORED) -> Sequence:
    """A sequence of `(at_s, {joint: deg}, hold_s)` rows."""
    frames = tuple(
        Keyframe(at_s=at_s, deg=deg, hold_s=hold[0] if hold else 0.0) for at_s, deg, *hold in rows
    )
    return Sequence(name="keys", keyframes=frames, loop=loop, timing=timing)


def lively(names, duration_s, *, seed=0, step_s=(0.6, 1.2), swing_deg=50.0) -> Sequence:
    """All joints swing about at random instants, from rest at 0 to rest at 0."""
    random = np.random.default_rng(seed)
    rows, at_s = [(0.0, dict.fromkeys(names, 0.0))], 0.0
    while at_s < duration_s - 2.0 * step_s[1]:
        at_s = round(at_s + random.uniform(*step_s), 3)
        rows.append((at_s, {name: float(random.uniform(-swing_deg, swing_deg)) for name in names}))
    return keys(*rows, (duration_s, dict.fromkeys(names, 0.0)))


class Kit:
    """What the tests of this folder build their worlds from."""

    joint = staticmethod(joint)
    robot = staticmethod(robot)
    keys = staticmethod(keys)
    lively = staticmethod(lively)
    plan = staticmethod(plan)
    Response = Response


@pytest.fixture
def kit() -> type[Kit]:
    return Kit
