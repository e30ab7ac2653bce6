"""In which order moves leave when joints lag differently, and what is passed by or replaced."""

from __future__ import annotations

from itertools import count
from random import Random

import pytest

from lss_motion.player.streamer import EARLY_MAX_US, DueMoves
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


def test_a_move_overtakes_none_of_its_servo_when_its_lag_is_believed_longer():
    """Seed 20098: damaged answers made a lag of 60 ms, and a joint went to and fro."""
    early_us = {1: 0, 2: 0}
    both = sorted(moves(*range(0, 400_000, 20_000)) + moves(*range(0, 400_000, 20_000), servo_id=2))
    due_moves = DueMoves(iter(both), lambda one: early_us[one.servo_id])
    found = []
    while due_moves.first(ENDLESS) is not None:
        found.append(due_moves.pop())
        early_us[1] = EARLY_MAX_US if len(found) % 8 < 4 else 0
    for servo_id in (1, 2):
        own = [due for due in found if due.move.servo_id == servo_id]
        assert [due.due_us for due in own] == list(range(0, 400_000, 20_000))
        assert all(0 <= due.due_us - due.at_us <= EARLY_MAX_US for due in own)
    assert [due.at_us for due in found] == sorted(due.at_us for due in found)
    assert len({due.due_us - due.at_us for due in found}) > 2


def test_moves_of_one_instant_leave_as_they_stand_in_the_program():
    due_moves = DueMoves(iter(moves(100, servo_id=5) + moves(100, servo_id=2)), lambda _: 0)
    assert [due_moves.first(ENDLESS) and due_moves.pop().move.servo_id for _ in "12"] == [5, 2]


def test_a_walk_without_end_is_not_looked_through_to_its_end():
    endless = ((10_000 * number, move(10_000 * number)) for number in count())
    assert DueMoves(endless, lambda _: 500).first(ENDLESS).due_us == 0


def begun(seed):
    """Return moves of joints that lag differently, some of which have left; and what is to come.

    What is to come are `(due_us, servo_id)`, and how much earlier each servo's moves leave.
    """
    random = Random(seed)
    early_us = {servo_id: random.randint(-30_000, EARLY_MAX_US) for servo_id in range(6)}
    dues = sorted((random.randrange(1_000_000), servo_id) for servo_id in 25 * list(range(6)))
    due_moves = DueMoves(
        iter([(due_us, move(due_us, servo_id)) for due_us, servo_id in dues]),
        lambda one: early_us[one.servo_id],
    )
    for _ in range(40):
        due_moves.first(ENDLESS)
        due = due_moves.pop()
        dues.remove((due.due_us, due.move.servo_id))
    return due_moves, dues, early_us


@pytest.mark.parametrize("seed", range(5))
def test_what_was_passed_by_is_named_in_order_and_the_rest_leaves_in_order(seed):
    due_moves, dues, early_us = begun(seed)
    until_us = Random(seed).choice([dues[3][0], dues[20][0], dues[90][0]])
    passed = [(due_us, one.servo_id) for due_us, one in due_moves.pass_by(until_us)]
    assert passed == [one for one in dues if one[0] <= until_us]
    rest = [(due - early_us[servo], due) for due, servo in dues if due > until_us]
    assert left(due_moves) == sorted(rest)


@pytest.mark.parametrize("seed", range(5))
def test_what_was_due_before_a_replacement_still_leaves_in_order(seed):
    due_moves, dues, early_us = begun(seed)
    from_us = Random(seed).choice([dues[3][0], dues[20][0], dues[90][0]])
    due_moves.replace_from(from_us, [move(from_us + 7, 1)])
    kept = [one for one in dues if one[0] < from_us] + [(from_us + 7, 1)]
    assert left(due_moves) == sorted((due - early_us[servo], due) for due, servo in kept)


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
