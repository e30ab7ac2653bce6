"""Repeated passes: the moves that would be lost at a seam are sent again."""

from __future__ import annotations

from itertools import pairwise

import pytest

from lss_motion.planning.program.line import sent_us
from lss_motion.planning.program.model import Move, Repeat
from lss_motion.planning.program.schedule import closed_pass

REPEAT = Repeat(from_us=1_000_000, to_us=2_000_000)


def move(due_us, target_wire=100, duration_ms=400, servo_id=1):
    return Move(
        due_us=due_us,
        bus="main",
        servo_id=servo_id,
        target_wire=target_wire,
        duration_ms=duration_ms,
    )


@pytest.fixture
def robot(kit):
    return kit.robot()


def sent(moves):
    return [(m.due_us, m.target_wire, m.duration_ms) for m in moves if m.servo_id == 1]


def test_a_move_on_different_sides_of_the_seams_is_sent_in_every_pass(robot):
    # The move before the first seam comes after the second seam, and would be lost there.
    moves = [move(999_000), move(1_600_000, 7), move(2_003_000), move(2_600_000, 7)]
    assert sent(closed_pass(moves, REPEAT, robot)) == [
        (999_000, 100, 400), (1_000_000, 100, 399), (1_600_000, 7, 400)
    ]  # fmt: skip


def test_a_move_with_a_place_in_the_pass_is_not_sent_twice(robot):
    early = [move(999_000), move(1_600_000, 7), move(1_999_000), move(2_600_000, 7)]
    late = [move(1_003_000), move(1_600_000, 7), move(2_003_000), move(2_600_000, 7)]
    for moves in (early, late):
        kept = [m for m in moves if m.due_us < REPEAT.to_us]
        assert closed_pass(moves, REPEAT, robot) == kept


def test_a_move_sent_again_takes_a_free_slot(robot):
    others = [move(1_000_900, 1, servo_id=2), move(2_000_000 - 400, 1, servo_id=3)]
    moves = [*others, move(999_000), move(1_600_000, 7), move(2_003_000), move(2_600_000, 7)]
    found = closed_pass(moves, REPEAT, robot)
    again_us = sent(found)[1][0]
    baud_bps = robot.buses["main"].baud_bps
    assert again_us == 1_000_900 + sent_us(len(others[0].data), baud_bps)
    slots_us = [(m.due_us, m.due_us + sent_us(len(m.data), baud_bps)) for m in found]
    again = [slot for slot in slots_us if slot[0] >= REPEAT.from_us]
    again += [(first - 1_000_000, end - 1_000_000) for first, end in again if end > REPEAT.to_us]
    again.sort()
    assert len(again) == 5
    assert all(end <= following for (_, end), (following, _) in pairwise(again))
    full = [move(us, 1, servo_id=2) for us in range(1_000_000, 1_600_000, 500)]
    assert len(sent(closed_pass([*moves, *full], REPEAT, robot))) == 2, "nothing fits in between"
