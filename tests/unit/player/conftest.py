"""A line, a questioner, and joints, without any time of their own."""

from __future__ import annotations

from dataclasses import replace

import pytest

from lss_motion.player.line import Line
from lss_motion.player.queries import Questioner
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.models import SERVO_MODELS

BUS = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)


def joint(name="j0", servo_id=1, **fields) -> Joint:
    base = Joint(
        name=name,
        servo_id=servo_id,
        bus="main",
        model=SERVO_MODELS["LSS-ST1"],
        position_min_deg=-90.0,
        position_max_deg=90.0,
        speed_max_deg_s=180.0,
        accel_max_deg_s2=600.0,
    )
    return replace(base, **fields)


class Kit:
    joint = staticmethod(joint)
    bus = BUS

    @staticmethod
    def robot(*joints, **fields) -> Robot:
        named = {one.name: one for one in joints or (joint(),)}
        return Robot(name="bench", path=None, buses={"main": BUS}, joints=named, **fields)


@pytest.fixture
def kit():
    return Kit


@pytest.fixture
def line():
    return Line(BUS)


@pytest.fixture
def questioner(line):
    return Questioner(line)
