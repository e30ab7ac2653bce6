"""Every row and every example of the three protocol documents, against the tables and the codec."""

from __future__ import annotations

import sys

import pytest

from lss_motion.errors import ProtocolError
from lss_motion.protocol.codec import (
    FAMILY_TABLES,
    make_command,
    make_reply,
    read_command,
    read_reply,
)
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import Command, CommandParser, Reply, ReplyParser, encode
from lss_motion.protocol.table import Form
from tests.protocol_table import (
    DOCUMENT_EXAMPLE_COUNT,
    DOCUMENT_ROW_COUNT,
    EXAMPLES,
    ROWS,
    DocumentRow,
    Example,
)

ALL_ROWS = [
    pytest.param(family, row, id=f"{family}-{row.line}")
    for family, rows in ROWS.items()
    for row in rows
]
ALL_EXAMPLES = [
    pytest.param(family, example, id=f"{family}-{example.line}-{example.printed}")
    for family, examples in EXAMPLES.items()
    for example in examples
]
COMMANDS = [param for param in ALL_EXAMPLES if not param.values[1].is_reply]
REPLIES = [param for param in ALL_EXAMPLES if param.values[1].is_reply]


def parsed(data: bytes) -> Command | Reply:
    parser = ReplyParser() if data.startswith(b"*") else CommandParser()
    (item,) = parser.feed(data)
    assert isinstance(item, Command | Reply)
    return item


@pytest.mark.parametrize("family", list(Family))
def test_all_rows_and_examples_of_the_document_are_in_the_table(
    family: Family, capsys: pytest.CaptureFixture[str]
) -> None:
    rows, examples = len(ROWS[family]), len(EXAMPLES[family])
    with capsys.disabled():
        sys.stdout.write(
            f"\n{family}: {rows}/{DOCUMENT_ROW_COUNT[family]} rows,"
            f" {examples}/{DOCUMENT_EXAMPLE_COUNT[family]} examples covered\n"
        )
    assert rows == len({row.line for row in ROWS[family]}) == DOCUMENT_ROW_COUNT[family]
    assert examples == DOCUMENT_EXAMPLE_COUNT[family]


@pytest.mark.parametrize(("family", "row"), ALL_ROWS)
def test_a_row_of_the_document_has_its_keywords_unit_default_and_session(
    family: Family, row: DocumentRow
) -> None:
    table = FAMILY_TABLES[family]
    if row.is_modifier:
        rows = [table.modifiers[row.action]]
    else:
        printed = [
            (form, row.meant.get(keyword, keyword))
            for form, keywords in (
                (Form.ACTION, row.action),
                (Form.QUERY, row.query),
                (Form.CONFIG, row.config),
            )
            for keyword in keywords.split()
        ]
        assert printed
        found = [table.find(keyword) for _, keyword in printed]
        assert [form for form, _ in found] == [form for form, _ in printed]
        rows = [known for _, known in found]
    for known in rows:
        assert known.unit == row.unit
        assert float(known.wire_per_unit) == row.wire_per_unit
        assert known.default == row.default
        if row.session is not None:
            assert known.sets_session is row.session


@pytest.mark.parametrize(("family", "example"), ALL_EXAMPLES)
def test_printed_bytes_survive_parsing_and_encoding(family: Family, example: Example) -> None:
    printed = example.printed.encode() + b"\r"
    assert encode(parsed(printed)) == printed


@pytest.mark.parametrize(("family", "example"), COMMANDS)
def test_encoding_a_command_gives_the_bytes_of_the_document(
    family: Family, example: Example
) -> None:
    if not example.is_refused:
        command = make_command(
            family, example.servo_id, example.keyword, example.value, example.modifiers
        )
        assert encode(command) == example.data
        return
    value = 1e99 if isinstance(example.value, str) else example.value
    with pytest.raises(ProtocolError, match=example.keyword):
        make_command(family, example.servo_id, example.keyword, value)


@pytest.mark.parametrize(("family", "example"), COMMANDS)
def test_decoding_a_command_of_the_document_gives_the_value_back(
    family: Family, example: Example
) -> None:
    command = parsed(example.data)
    assert isinstance(command, Command)
    decoded = read_command(family, command)
    assert decoded is not None
    assert (decoded.servo_id, decoded.keyword, decoded.value, decoded.modifiers) == (
        example.servo_id,
        example.keyword,
        example.value,
        example.modifiers,
    )


@pytest.mark.parametrize(("family", "example"), REPLIES)
def test_encoding_a_reply_gives_the_bytes_of_the_document(family: Family, example: Example) -> None:
    printed = parsed(example.data)
    assert encode(make_reply(family, printed.servo_id, example.keyword, example.value)) == (
        example.data
    )


@pytest.mark.parametrize(("family", "example"), REPLIES)
def test_decoding_a_reply_of_the_document_gives_the_value_back(
    family: Family, example: Example
) -> None:
    reply = parsed(example.data)
    assert isinstance(reply, Reply)
    decoded = read_reply(family, reply)
    assert decoded is not None
    assert (decoded.servo_id, decoded.keyword, decoded.value) == (
        example.servo_id,
        example.keyword,
        example.value,
    )


@pytest.mark.parametrize(
    ("family", "example"), [param for param in ALL_EXAMPLES if param.values[1].meant]
)
def test_the_printed_bytes_of_a_misprint_differ_from_the_meant_ones(
    family: Family, example: Example
) -> None:
    assert example.decision
    assert parsed(example.printed.encode() + b"\r") != parsed(example.data)
