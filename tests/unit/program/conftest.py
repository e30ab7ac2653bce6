"""Robots of one kind of joint, and shows for them."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.verify import profiles
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Joint, Response, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence, Timing
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
    """Return a sequence of `(at_s, {joint: deg}, hold_s)` rows."""
    frames = tuple(
        Keyframe(at_s=at_s, deg=deg, hold_s=hold[0] if hold else 0.0) for at_s, deg, *hold in rows
    )
    return Sequence(name="keys", keyframes=frames, loop=loop, timing=timing)


def lively(names, duration_s, *, seed=0, step_s=(0.6, 1.2), swing_deg=50.0) -> Sequence:
    """Return a show in which all joints swing at random instants, from rest at 0 to rest at 0."""
    random = np.random.default_rng(seed)
    rows, at_s = [(0.0, dict.fromkeys(names, 0.0))], 0.0
    while at_s < duration_s - 2.0 * step_s[1]:
        at_s = round(at_s + random.uniform(*step_s), 3)
        rows.append((at_s, {name: float(random.uniform(-swing_deg, swing_deg)) for name in names}))
    return keys(*rows, (duration_s, dict.fromkeys(names, 0.0)))


def mixed(**fields) -> Robot:
    """Return a robot with a timed, a streamed (with `fields`) and a stepped joint."""
    return robot(
        joint(),
        joint("j1", 2, drive="streamed", **fields),
        joint("j2", 209, model=SERVO_MODELS["LSS-2IO"], drive="stepped"),
    )


def compiled(robot, *, seed=0, duration_s=8.0, swing_deg=50.0, **options):
    """Return program and trajectory of a lively show."""
    show = lively(list(robot.joints), duration_s, seed=seed, swing_deg=swing_deg)
    trajectory = plan(show, robot)
    return compile_program(trajectory, robot, **options), trajectory


def horn_error_deg(program, robot, trajectory, name, lag_s):
    """Return how far the predicted horn is from the plan, (instants)."""
    times_s = np.arange(0.0, trajectory.duration_s, 0.005)
    joint = robot.joints[name]
    servo_deg = profiles(program, robot)[name].sample(times_s - lag_s)
    planned = trajectory.sample(times_s)[:, trajectory.joints.index(name)]
    return np.abs(joint.direction * (servo_deg - joint.zero_deg) - planned)


class ProgramKit:
    """Robots, shows and compiled programs for the tests of this folder."""

    joint = staticmethod(joint)
    robot = staticmethod(robot)
    keys = staticmethod(keys)
    lively = staticmethod(lively)
    plan = staticmethod(plan)
    mixed = staticmethod(mixed)
    compiled = staticmethod(compiled)
    horn_error_deg = staticmethod(horn_error_deg)
    Response = Response


@pytest.fixture
def kit() -> type[ProgramKit]:
    return ProgramKit
