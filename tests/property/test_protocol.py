"""Laws of the bus languages that hold for every value and every byte."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

from hypothesis import given
from hypothesis import strategies as st

from lss_motion.protocol.codec import (
    FAMILY_TABLES,
    make_command,
    make_reply,
    read_command,
    read_reply,
    reply_number,
)
from lss_motion.protocol.framing import (
    LINE_MAX_BYTES,
    Command,
    CommandParser,
    Garbage,
    Reply,
    ReplyParser,
    commands_in,
    encode,
    encode_group,
    encode_move,
    encode_query,
    size_of,
)
from lss_motion.protocol.table import WIRE_MAX, WIRE_MIN, Form, ReplyShape, Row, Value

if TYPE_CHECKING:
    from lss_motion.protocol.constants import Family

IDS = st.integers(0, 255)
WIRE = st.integers(WIRE_MIN, WIRE_MAX)
TEXT = st.text("ABCXYZabc019-._ ", min_size=1, max_size=24)
NOISE = st.one_of(st.binary(max_size=200), st.text("#*QDT0159-\r\n.", max_size=200).map(str.encode))
SPOKEN = [
    (family, keyword, form, row)
    for family, table in FAMILY_TABLES.items()
    for keyword, (form, row) in table.by_keyword.items()
    if form is not Form.QUERY
]
ASKED = [
    (family, keyword, row)
    for family, table in FAMILY_TABLES.items()
    for keyword, (form, row) in table.by_keyword.items()
    if form is Form.QUERY
]


def wire_values(row: Row) -> st.SearchStrategy[int]:
    if row.choices is not None:
        return st.sampled_from(sorted(row.choices))
    low, high = -(-row.minimum // row.step), row.maximum // row.step
    return st.integers(low, high).map(lambda value: value * row.step)


@st.composite
def commands(draw: st.DrawFn) -> tuple[Family, Command]:
    family, keyword, form, row = draw(st.sampled_from(SPOKEN))
    value = None
    if row.value is Value.REQUIRED or (row.value is Value.OPTIONAL and draw(st.booleans())):
        value = draw(wire_values(row))
    known = FAMILY_TABLES[family].modifiers
    named = row.modifiers if value is not None and form is Form.ACTION else ()
    modifiers = [(name, draw(wire_values(known[name]))) for name in named if draw(st.booleans())]
    return family, Command(draw(IDS), keyword, value, tuple(modifiers))


@st.composite
def replies(draw: st.DrawFn) -> tuple[Family, Reply]:
    family, keyword, row = draw(st.sampled_from(ASKED))
    values = {
        ReplyShape.INTEGER: WIRE,
        ReplyShape.OPTIONAL: st.none() | WIRE,
        ReplyShape.DISABLED: st.just("DIS") | WIRE,
        ReplyShape.VERSION: WIRE | st.just("368.29.14"),
        ReplyShape.CHANNELS: WIRE | st.just(",1500,988"),
        ReplyShape.TEXT: TEXT,
    }
    return family, Reply(draw(st.none() | IDS), keyword, draw(values[row.reply_shape]))


def cut(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = [0, *sorted(cut % (len(data) + 1) for cut in cuts), len(data)]
    return [data[start:end] for start, end in pairwise(edges)]


@given(commands())
def test_a_command_comes_back_from_its_bytes_and_from_its_physical_values(
    spoken: tuple[Family, Command],
) -> None:
    family, command = spoken
    assert CommandParser().feed(encode(command)) == [command]
    assert commands_in(encode_query(command), grouped=True) == (command,)
    said = read_command(family, command)
    assert said is not None
    assert not isinstance(said.value, str)
    assert (
        make_command(family, command.servo_id, said.keyword, said.value, said.modifiers) == command
    )


@given(replies())
def test_a_reply_comes_back_from_its_bytes_and_from_its_physical_value(
    spoken: tuple[Family, Reply],
) -> None:
    family, reply = spoken
    assert ReplyParser().feed(encode(reply)) == [reply]
    assert size_of(reply) == len(encode(reply))
    said = read_reply(family, reply)
    assert said is not None
    number = said.value if isinstance(said.value, int | float) else None
    assert reply_number(family, reply) == number
    assert make_reply(family, reply.servo_id, said.keyword, said.value) == reply


@given(IDS, WIRE, st.none() | st.integers(1, WIRE_MAX))
def test_a_move_is_the_same_line_however_it_is_written(
    servo_id: int, position_wire: int, duration_ms: int | None
) -> None:
    modifiers = () if duration_ms is None else (("T", duration_ms),)
    assert encode_move(servo_id, position_wire, duration_ms) == encode(
        Command(servo_id, "D", position_wire, modifiers)
    )


@given(st.lists(commands().map(lambda spoken: spoken[1]), min_size=1, max_size=8))
def test_a_group_line_holds_its_commands(group: list[Command]) -> None:
    line = encode_group(group)
    assert line.count(b"\r") == 1
    assert CommandParser().feed(line) == group


@given(NOISE, st.lists(replies(), max_size=4), st.lists(st.integers(0, 300), max_size=12))
def test_any_chunks_give_the_same_replies(
    noise: bytes, spoken: list[tuple[Family, Reply]], cuts: list[int]
) -> None:
    data = noise + b"".join(encode(reply) for _, reply in spoken)
    for grouped in (True, False):
        parser = ReplyParser(grouped=grouped)
        chunked = [item for chunk in cut(data, cuts) for item in parser.feed(chunk)]
        assert chunked == ReplyParser(grouped=grouped).feed(data)


@given(NOISE, st.lists(commands(), max_size=4), st.lists(st.integers(0, 300), max_size=12))
def test_any_chunks_give_the_same_commands(
    noise: bytes, spoken: list[tuple[Family, Command]], cuts: list[int]
) -> None:
    data = noise + b"".join(encode(command) for _, command in spoken)
    for grouped in (True, False):
        parser = CommandParser(grouped=grouped)
        chunked = [item for chunk in cut(data, cuts) for item in parser.feed(chunk)]
        assert chunked == CommandParser(grouped=grouped).feed(data)


@given(st.lists(NOISE, max_size=4), replies())
def test_a_clean_reply_after_any_noise_is_heard(
    noise: list[bytes], spoken: tuple[Family, Reply]
) -> None:
    reply = spoken[1]
    parser = ReplyParser()
    for chunk in noise:
        parser.feed(chunk)
    assert parser.feed(encode(reply))[-1] == reply


@given(st.lists(NOISE, max_size=4), commands())
def test_a_clean_command_after_any_noise_is_heard(
    noise: list[bytes], spoken: tuple[Family, Command]
) -> None:
    command = spoken[1]
    parser = CommandParser()
    for chunk in noise:
        parser.feed(chunk)
    assert parser.feed(encode(command))[-1] == command


@given(st.lists(NOISE, max_size=6))
def test_garbage_loses_no_byte_and_memory_stays_bounded(noise: list[bytes]) -> None:
    for parser in (ReplyParser(), ReplyParser(grouped=False), CommandParser()):
        given_bytes = kept_bytes = 0
        is_all_garbage = True
        for chunk in noise:
            items = parser.feed(chunk)
            given_bytes += len(chunk)
            kept_bytes += sum(len(item.data) for item in items if isinstance(item, Garbage))
            is_all_garbage &= all(isinstance(item, Garbage) for item in items)
            assert len(parser._rest) < LINE_MAX_BYTES
        if is_all_garbage:
            assert kept_bytes + len(parser._rest) == given_bytes


@given(st.sampled_from(b"#*x9\xff"), st.integers(0, 5000))
def test_a_flood_without_an_end_is_kept_in_one_section_of_memory(byte: int, size: int) -> None:
    for parser in (ReplyParser(), CommandParser()):
        for _ in range(5):
            parser.feed(bytes([byte]) * size)
            assert len(parser._rest) < LINE_MAX_BYTES
