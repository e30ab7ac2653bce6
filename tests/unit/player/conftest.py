"""A line, a questioner, and joints, without any time of their own."""

from __future__ import annotations

import pytest

from lss_motion.player.line import Line
from lss_motion.player.queries import Questioner
from lss_motion.robot.model import Bus, Robot
from tests.joints import joint

BUS = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)


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
