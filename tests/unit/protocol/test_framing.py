"""Bytes ⇄ commands and replies."""

from __future__ import annotations

import pytest

from lss_motion.protocol.framing import (
    LINE_MAX_BYTES,
    Command,
    CommandParser,
    Garbage,
    Reply,
    ReplyParser,
    encode,
    encode_group,
    encode_move,
)

COMMANDS = [
    (b"#5D1443T500\r", [Command(5, "D", 1443, (("T", 500),))]),
    (b"#5D1800T2500CH400\r", [Command(5, "D", 1800, (("T", 2500), ("CH", 400)))]),
    (b"#5D0SD180\r", [Command(5, "D", 0, (("SD", 180),))]),
    (b"#5QSD2\r", [Command(5, "QSD", 2)]),
    (b"#5CFD\r", [Command(5, "CFD")]),
    (b"#5CRC*\r", [Command(5, "CRC", "*")]),
    (b"#5CRC\r", [Command(5, "CRC")]),
    (b"#254QID120\r", [Command(254, "QID", 120)]),
    (b"#254FPC5#254CAS-6\r", [Command(254, "FPC", 5), Command(254, "CAS", -6)]),
    (
        b"#0QD0QC0#5QD0QC0\r",
        [Command(0, "QD", 0), Command(0, "QC", 0), Command(5, "QD", 0), Command(5, "QC", 0)],
    ),
    (b"#0QD#5QD#10QD\r", [Command(0, "QD"), Command(5, "QD"), Command(10, "QD")]),
    (
        b"#1D100T250#2D200T250\r",
        [Command(1, "D", 100, (("T", 250),)), Command(2, "D", 200, (("T", 250),))],
    ),
]

REPLIES = [
    (b"*5QD1443\r", [Reply(5, "QD", 1443)]),
    (b"*5QD-13\r", [Reply(5, "QD", -13)]),
    (b"*QID5\r", [Reply(None, "QID", 5)]),
    (b"*254QID5\r", [Reply(254, "QID", 5)]),
    (b"*5QDT\r", [Reply(5, "QDT")]),
    (b"*5QFDDIS\r", [Reply(5, "QFD", "DIS")]),
    (b"*5QMSLSS-HS1\r", [Reply(5, "QMS", "LSS-HS1")]),
    (b"*209QMSLSS-2IO-D9\r", [Reply(209, "QMS", "LSS-2IO-D9")]),
    (b"*5QN00123\r", [Reply(5, "QN", "00123")]),
    (b"*5QNAB12C\r", [Reply(5, "QN", "AB12C")]),
    (b"*5QF368\r", [Reply(5, "QF", 368)]),
    (b"*5QF368.29.14\r", [Reply(5, "QF", "368.29.14")]),
    (b"*5QZZ7\r", [Reply(5, "QZZ", 7)]),
    (b"*15QD960QT400*5QD500\r", [Reply(15, "QD", 960), Reply(15, "QT", 400), Reply(5, "QD", 500)]),
]

GARBAGE_COMMANDS = [
    b"\r",
    b"#\r",
    b"#5\r",
    b"#D100\r",
    b"D100\r",
    b"#5D1-\r",
    b"#5D--1\r",
    b"#5D100T\r",
    b"#5D1.5\r",
    b"#5 D1\r",
    b"#5D\xff1\r",
]
GARBAGE_REPLIES = [b"\r", b"*\r", b"*5\r", b"5QD1\r", b"*5QD14x\r", b"*5QD-\r", b"*5QD\x001\r"]


@pytest.mark.parametrize(("data", "commands"), COMMANDS)
def test_commands_are_read_whole_and_byte_by_byte(data: bytes, commands: list[Command]) -> None:
    assert CommandParser().feed(data) == commands
    parser = CommandParser()
    assert [item for byte in data for item in parser.feed(bytes([byte]))] == commands


@pytest.mark.parametrize(("data", "replies"), REPLIES)
def test_replies_are_read_whole_and_byte_by_byte(data: bytes, replies: list[Reply]) -> None:
    assert ReplyParser().feed(data) == replies
    parser = ReplyParser()
    assert [item for byte in data for item in parser.feed(bytes([byte]))] == replies


@pytest.mark.parametrize(("data", "items"), [case for case in COMMANDS + REPLIES if case[1][1:]])
def test_a_group_is_written_as_one_line(data: bytes, items: list[Command] | list[Reply]) -> None:
    written = encode_group(items)
    assert written.count(b"\r") == 1
    parser = ReplyParser() if data.startswith(b"*") else CommandParser()
    assert parser.feed(written) == items


@pytest.mark.parametrize(
    ("data", "items"), [case for case in COMMANDS + REPLIES if not case[1][1:]]
)
def test_one_command_or_reply_is_written_exactly(
    data: bytes, items: list[Command] | list[Reply]
) -> None:
    assert encode(items[0]) == data
    assert encode_group(items) == data


def test_a_zero_separates_queries_in_a_group_to_one_servo() -> None:
    queries = [Command(0, "QD"), Command(0, "QC"), Command(5, "QD"), Command(5, "QC")]
    assert encode_group(queries) == b"#0QD0QC0#5QD0QC0\r"


def test_encode_move_writes_the_same_bytes_as_encode() -> None:
    assert encode_move(12, -1443, 50) == encode(Command(12, "D", -1443, (("T", 50),)))
    assert encode_move(12, -1443, None) == encode(Command(12, "D", -1443))


def test_lower_case_and_leading_zeros_are_understood() -> None:
    assert CommandParser().feed(b"#005d-010t020\r#07qd\r#5d1t2ch3\r") == [
        Command(5, "D", -10, (("T", 20),)),
        Command(7, "QD"),
        Command(5, "D", 1, (("T", 2), ("CH", 3))),
    ]
    assert ReplyParser().feed(b"*005QD-007\r") == [Reply(5, "QD", -7)]


def test_a_group_reply_may_leave_out_the_q_of_later_keywords() -> None:
    assert ReplyParser().feed(b"*15QD960T400*5QD500T750\r") == [
        Reply(15, "QD", 960),
        Reply(15, "QT", 400),
        Reply(5, "QD", 500),
        Reply(5, "QT", 750),
    ]


@pytest.mark.parametrize("data", GARBAGE_COMMANDS)
def test_an_invalid_command_is_garbage_and_the_next_one_is_read(data: bytes) -> None:
    assert CommandParser().feed(data + b"#5Q\r") == [Garbage(data), Command(5, "Q")]


@pytest.mark.parametrize("data", GARBAGE_REPLIES)
def test_an_invalid_reply_is_garbage_and_the_next_one_is_read(data: bytes) -> None:
    assert ReplyParser().feed(data + b"*5Q6\r") == [Garbage(data), Reply(5, "Q", 6)]


def test_a_start_byte_begins_a_new_section() -> None:
    assert CommandParser().feed(b"x#5D#6Q\r") == [Garbage(b"x"), Command(5, "D"), Command(6, "Q")]
    assert ReplyParser().feed(b"*5Q*6Q1\r") == [Reply(5, "Q"), Reply(6, "Q", 1)]


def test_without_groups_a_section_with_more_than_one_item_is_garbage() -> None:
    replies = ReplyParser(grouped=False).feed(b"*5QD14QT400\r*5Q6\r")
    assert replies == [Garbage(b"*5QD14QT400\r"), Reply(5, "Q", 6)]
    commands = CommandParser(grouped=False).feed(b"#0QD0QC0\r#5D1CH2\r")
    assert commands == [Garbage(b"#0QD0QC0\r"), Command(5, "D", 1, (("CH", 2),))]


def test_without_groups_a_section_that_was_cut_short_is_garbage() -> None:
    commands = CommandParser(grouped=False).feed(b"#5D14#6D1443\r")
    assert commands == [Garbage(b"#5D14"), Command(6, "D", 1443)]
    replies = ReplyParser(grouped=False).feed(b"*5QD14*5QD1443\r")
    assert replies == [Garbage(b"*5QD14"), Reply(5, "QD", 1443)]


def test_the_longest_section_is_read_and_a_longer_one_is_garbage() -> None:
    longest = b"*5QN".ljust(LINE_MAX_BYTES - 1, b"7") + b"\r"
    assert ReplyParser().feed(longest) == [Reply(5, "QN", "7" * (LINE_MAX_BYTES - 5))]
    longer = longest.replace(b"QN7", b"QN77")
    items = ReplyParser().feed(longer + b"*5Q6\r")
    assert items[-1] == Reply(5, "Q", 6)
    assert items[:-1]
    assert all(isinstance(item, Garbage) for item in items[:-1])


def test_the_longest_command_is_read_and_a_longer_one_is_garbage() -> None:
    longest = b"#5D".ljust(LINE_MAX_BYTES - 1, b"0") + b"\r"
    assert CommandParser().feed(longest) == [Command(5, "D", 0)]
    items = CommandParser().feed(longest.replace(b"D", b"D0") + b"#5Q\r")
    assert items[-1] == Command(5, "Q")
    assert items[:-1]
    assert all(isinstance(item, Garbage) for item in items[:-1])


def test_an_incomplete_line_gives_no_item_yet() -> None:
    parser = ReplyParser()
    assert parser.feed(b"*5QD14") == []
    assert parser.feed(b"43") == []
    assert parser.feed(b"\r") == [Reply(5, "QD", 1443)]


def test_in_a_group_only_queries_to_one_servo_share_a_section() -> None:
    queries = [Command(5, "QD"), Command(5, "QT"), Command(5, "QV")]
    assert encode_group(queries) == b"#5QD0QT0QV0\r"
    assert encode_group([Command(5, "QD"), Command(5, "D", 100)]) == b"#5QD#5D100\r"
    assert encode_group([Command(5, "D", 100), Command(5, "QD")]) == b"#5D100#5QD\r"
    assert encode_group([Reply(5, "QD", 1), Reply(5, "QDT"), Reply(5, "QV", 2)]) == b"*5QD1QDTQV2\r"


def test_without_groups_text_is_a_reply_like_any_other() -> None:
    assert ReplyParser(grouped=False).feed(b"*5QMSLSS-HS1\r") == [Reply(5, "QMS", "LSS-HS1")]


@pytest.mark.parametrize("keyword", ["QMS", "QN"])
def test_text_that_looks_like_a_number_stays_text(keyword: str) -> None:
    assert ReplyParser().feed(b"*5%b0042\r" % keyword.encode()) == [Reply(5, keyword, "0042")]


@pytest.mark.parametrize("parser", [CommandParser, ReplyParser])
def test_the_parser_stores_at_most_one_section_of_noise(
    parser: type[CommandParser | ReplyParser],
) -> None:
    most = LINE_MAX_BYTES - 1
    assert parser().feed(b"x" * most) == []
    assert parser().feed(b"x" * (most + 1)) == [Garbage(b"x" * most)]
