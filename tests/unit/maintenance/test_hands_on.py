"""Moves of a person after this program was held up: only the latest of each joint leaves."""

from __future__ import annotations

from lss_motion.playing.hands_poller import Poller
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.protocol.framing import Command
from lss_motion.robot.model import Bus, Robot
from tests.joints import joint

BUS = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)


def test_a_move_takes_the_place_of_one_that_waits():
    joints = [joint("pan", 1), joint("tilt", 2)]
    robot = Robot(
        name="head", path=None, buses={"main": BUS}, joints={one.name: one for one in joints}
    )
    line = SerialLine(BUS)
    poller = Poller(robot, joints, {"main": QueryTracker(line)})
    for one in joints:
        poller.note(one, 0, 0.0)
    for tenths in (10, 20, 30):
        poller.order(joints[0], Command(1, "D", tenths))
        poller.order(joints[1], Command(2, "D", -tenths))
    poller.order(joints[0], Command(1, "H"))
    poller.order(joints[0], Command(1, "D", 40))
    sent = b""
    for now_ms in range(10):
        poller.advance(now_ms * 1_000_000)
        sent += line.take()
    moves = [part for part in sent.split(b"\r") if b"Q" not in part and part]
    assert moves == [b"#1H", b"#1D40", b"#2D-30"]
