from __future__ import annotations

import os
import select
import signal
from pathlib import Path

import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning import shows
from lss_motion.planning.program.move_table import MoveTable
from lss_motion.playing.walking.planner import (
    PlannerProcess,
    PlanRequest,
    WalkPlanner,
    packed,
    unpacked,
)
from lss_motion.show.gait.model import BodyPose
from lss_motion.show.gait.steering import slowed_to_limits
from lss_motion.show.gait.stepping import STILL, Twist

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"
AHEAD = PlanRequest(commanded=Twist(forward_mm_s=15.0), was_taken=False, begins_s=1.0)


@pytest.fixture(scope="module")
def dog():
    gait, robot = shows.load_gait(EXAMPLES / "quadruped_trot.yaml", None)
    gait, _ = slowed_to_limits(replace(gait, start=BodyPose()), robot, Twist(forward_mm_s=20.0))
    return gait, robot


def test_a_packed_reply_is_unpacked_unchanged(dog):
    reply = WalkPlanner(*dog, 0.2).plan(AHEAD)
    back = unpacked(*packed(reply))
    assert [*back.extension.moves] == [*reply.extension.moves]
    assert len(back.extension.moves) > 20
    for name, reference in reply.extension.profiles.items():
        for at_s in (0.5, 1.3, 2.0, 9.0):
            assert back.extension.profiles[name].at(at_s) == reference.at(at_s)
    assert replace(back, extension=None) == replace(reply, extension=None)
    assert [*back.extension.moves[3:5]] == [*reply.extension.moves[3:5]]
    assert isinstance(back.extension.moves, MoveTable)


def test_a_request_that_cannot_be_planned_is_replied_with_a_reason(dog):
    gait, robot = dog
    planner = WalkPlanner(gait, robot, 0.2)
    deep = BodyPose(shift_mm=(0.0, 0.0, 500.0))
    reply = planner.plan(replace(AHEAD, commanded=STILL, pose=deep))
    assert reply.extension is None
    assert "too far out" in reply.reason
    assert unpacked(*packed(reply)) == reply


def test_the_process_replies_as_the_planner_and_its_end_is_an_error(dog):
    with PlannerProcess(*dog, 0.2) as link:
        link.send(AHEAD, 0)
        assert link.poll(0) is None
        assert select.select([link.fileno()], [], [], 60.0)[0]
        reply = link.poll(0)
        expected = WalkPlanner(*dog, 0.2).plan(AHEAD)
        assert [*reply.extension.moves] == [*expected.extension.moves]
        os.kill(link._child.pid, signal.SIGKILL)
        assert select.select([link.fileno()], [], [], 60.0)[0]
        with pytest.raises(PlanningError, match="goes to a stand by itself"):
            link.poll(0)
