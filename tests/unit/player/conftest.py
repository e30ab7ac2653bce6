"""A line, a tracker, and joint states, without a clock."""

from __future__ import annotations

import pytest

from lss_motion.planning.program.model import Driving, Program
from lss_motion.playing.player.joint_state import make_joint_states
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.robot.model import Bus, Robot
from tests.joints import joint

BUS = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
TOLERANCE_DEG = 0.2


class PlayerKit:
    joint = staticmethod(joint)
    bus = BUS

    @staticmethod
    def robot(*joints, **fields) -> Robot:
        named = {one.name: one for one in joints or (joint(),)}
        return Robot(name="bench", path=None, buses={"main": BUS}, joints=named, **fields)

    @classmethod
    def state(cls, joint, moves=(), *, has_feedback=True):
        """Return the track of a joint that stands at 0 deg, and plans `moves` and nothing else."""
        robot = cls.robot(joint)
        count = joint.filter_count if joint.drive == "streamed" else 0
        program = Program(
            name="still",
            robot=robot.name,
            moves=tuple(moves),
            duration_s=1.0,
            start_deg={joint.name: 0.0},
            tolerance_deg=TOLERANCE_DEG,
            drives={joint.name: Driving(joint.drive, count)},
        )
        standing_deg = {joint.name: 0.0}
        joint_states = make_joint_states(
            program, robot, standing_deg, 0.0, has_feedback=has_feedback
        )
        return joint_states[joint.name]


@pytest.fixture
def kit():
    return PlayerKit


@pytest.fixture
def line():
    return SerialLine(BUS)


@pytest.fixture
def tracker(line):
    return QueryTracker(line)
