"""In which order moves leave when joints lag differently, and what is passed by or replaced."""

from __future__ import annotations

from random import Random

import pytest

from lss_motion.player.due import EARLY_MAX_US, DueMoves
from lss_motion.program.model import Move

ENDLESS = float("inf")


def move(due_us, servo_id=1):
    return Move(due_us=due_us, bus="main", servo_id=servo_id, target_wire=0, duration_ms=100)


def moves(*dues_us, servo_id=1):
    return [(due_us, move(due_us, servo_id)) for due_us in dues_us]


def left(due_moves, before_us=ENDLESS):
    found = []
    while due_moves.first(before_us) is not None:
        due = due_moves.pop()
        found.append((due.at_us, due.due_us))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_all_moves_leave_in_the_order_of_their_instants(seed):
    random = Random(seed)
    early_us = {servo_id: random.randint(-30_000, EARLY_MAX_US) for servo_id in range(6)}
    listed = sorted((random.randrange(2_000_000), random.randrange(6)) for _ in range(300))
    due_moves = DueMoves(
        iter([(due_us, move(due_us, servo_id)) for due_us, servo_id in listed]),
        lambda one: early_us[one.servo_id],
    )
    found = left(due_moves)
    assert [at_us for at_us, _ in found] == sorted(at_us for at_us, _ in found)
    assert sorted(found) == sorted((due - early_us[servo], due) for due, servo in listed)


def test_nobody_is_earlier_than_an_estimate_may_be():
    assert left(DueMoves(iter(moves(500_000)), lambda _: 10**9)) == [(440_000, 500_000)]


def test_what_is_due_after_a_wait_does_not_leave_before_it():
    due_moves = DueMoves(iter(moves(100, 1000, 1001)), lambda _: 500)
    assert left(due_moves, before_us=1001) == [(-400, 100), (500, 1000)]
    assert due_moves.first(1001) is None
    assert left(due_moves) == [(501, 1001)]


def test_what_the_show_has_passed_never_leaves():
    due_moves = DueMoves(iter(moves(100, 200, 300, 400)), lambda one: one.due_us)
    due_moves.first(ENDLESS)
    assert [due_us for due_us, _ in due_moves.pass_by(300)] == [100, 200, 300]
    assert left(due_moves) == [(0, 400)]


def test_a_walk_that_goes_on_replaces_what_was_due_from_there():
    due_moves = DueMoves(iter(moves(100, 200, 300, 90_000)), lambda _: 0)
    due_moves.first(ENDLESS)
    due_moves.replace_from(250, [move(260), move(95_000)])
    assert [due_us for _, due_us in left(due_moves)] == [100, 200, 260, 95_000]
