"""Makers of robots and keyframes, and a plan cache for each test."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Interpolation, Keyframe

MODEL = SERVO_MODELS["LSS-ST1"]

MakeRobot = Callable[..., Robot]
MakeFrame = Callable[..., Keyframe]


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


@pytest.fixture
def make_robot() -> MakeRobot:
    def make(count=2, speed=180.0, accel=600.0, reach=170.0, **limits) -> Robot:
        """`limits` gives single joints their own (speed, accel)."""
        joints = {}
        for index, name in enumerate(
            ["base", "elbow", *(f"j{n}" for n in range(2, count))][:count]
        ):
            own_speed, own_accel = limits.get(name, (speed, accel))
            joints[name] = Joint(
                name=name,
                servo_id=index + 1,
                bus="main",
                model=MODEL,
                position_min_deg=-reach,
                position_max_deg=reach,
                turns="by_hand" if reach > 180.0 else None,
                speed_max_deg_s=own_speed,
                accel_max_deg_s2=own_accel,
            )
        bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
        return Robot(name="arm", path=None, buses={"main": bus}, joints=joints)

    return make


@pytest.fixture
def frame() -> MakeFrame:
    def make(
        at_s=None,
        hold_s=0.0,
        ease="smooth",
        label="",
        line=None,
        anchor=False,
        may_shrink=False,
        **deg,
    ):
        return Keyframe(
            at_s=at_s,
            hold_s=hold_s,
            hold_may_shrink=may_shrink,
            ease=Interpolation(ease),
            label=label,
            line=line,
            is_anchor=anchor,
            deg=deg,
        )

    return make
