from __future__ import annotations

import pickle
from random import Random

import pytest
from msgspec.structs import replace

from lss_motion.planning.program.model import Move, Program
from lss_motion.planning.program.move_table import MADE_AT_ONCE, MoveTable, columns_of, table_of


def moves(count: int) -> list[Move]:
    random = Random(count)
    return [
        Move(
            due_us=1_000 * index,
            bus=random.choice(("left", "right")),
            servo_id=random.randrange(1, 250),
            target_wire=random.randrange(-1800, 1801),
            duration_ms=random.choice((None, random.randrange(1, 9_999))),
        )
        for index in range(count)
    ]


@pytest.mark.parametrize("count", [0, 1, MADE_AT_ONCE, 2 * MADE_AT_ONCE + 3])
def test_a_table_equals_the_sequence_of_its_moves(count):
    expected = moves(count)
    table = table_of(expected)
    assert isinstance(table, MoveTable)
    assert table_of(table) is table
    assert len(table) == count
    assert [*table] == expected
    assert [table[index] for index in range(-count, count)] == expected + expected
    assert [*table[1:-1:2]] == expected[1:-1:2]
    assert [*pickle.loads(pickle.dumps(table))] == expected
    with pytest.raises(IndexError):
        table[count]


def test_the_moves_of_a_table_hold_plain_integers():
    for move in table_of(moves(20)):
        assert type(move) is Move
        assert {type(move.due_us), type(move.servo_id), type(move.target_wire)} == {int}
        assert type(move.duration_ms) in {int, type(None)}


def test_programs_are_equal_if_their_moves_are():
    expected = moves(5)
    program = Program(
        name="any",
        robot="any",
        moves=tuple(expected),
        duration_s=1.0,
        start_deg={},
        tolerance_deg=0.2,
    )
    assert replace(program, moves=table_of(expected)) == program
    assert program == replace(program, moves=table_of(expected))
    assert replace(program, moves=table_of(expected[:-1])) != program
    assert table_of(expected) != 5


def test_columns_refuse_a_move_to_an_unknown_servo(kit):
    robot = kit.robot(kit.joint())
    (joint,) = robot.joints.values()
    own = Move(due_us=0, bus=joint.bus, servo_id=joint.servo_id, target_wire=5, duration_ms=None)
    assert columns_of([own], robot).joint.tolist() == [0]
    for other in (own._replace(servo_id=joint.servo_id + 1), own._replace(bus="other")):
        with pytest.raises((AssertionError, IndexError)):
            columns_of([own, other], robot)
