"""The tables: complete and consistent rows, and the effect of a value on a servo."""

from __future__ import annotations

import re
from fractions import Fraction

import pytest

from lss_motion.errors import ProtocolError
from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import BAUD_RATES_BPS, Family
from lss_motion.protocol.framing import Command, encode
from lss_motion.protocol.io2 import BAUD_MAX_BPS, IO2_TABLE, PIN_IDS, SECTION_MAX_CHARS
from lss_motion.protocol.lss import LSS_TABLE
from lss_motion.protocol.lss_pro import PRO_TABLE
from lss_motion.protocol.table import Device, FamilyTable, Form, Row, Value, make_table

ROWS = [
    pytest.param(table, row, id=f"{family}-{row.name}-{index}")
    for family, table in FAMILY_TABLES.items()
    for index, row in enumerate(table.rows)
]


def test_every_family_has_its_table() -> None:
    assert set(FAMILY_TABLES) == set(Family)
    assert all(table.family is family for family, table in FAMILY_TABLES.items())


@pytest.mark.parametrize(("table", "row"), ROWS)
def test_a_row_has_a_source_a_keyword_and_a_meaning(table: FamilyTable, row: Row) -> None:
    assert re.match(r"(LSS|2IO) A?\d|PRO \S|FACTS [A-Z]\d", row.source)
    assert row.meaning
    keywords = (*row.actions, *row.queries, *row.configs)
    assert keywords or row.is_modifier
    assert all(table.row(keyword) is row for keyword in keywords)
    assert all(keyword.startswith("Q") for keyword in row.queries)
    assert all(keyword.startswith("C") for keyword in row.configs)
    assert not any(keyword.startswith("Q") for keyword in row.actions)


@pytest.mark.parametrize(("table", "row"), ROWS)
def test_a_row_is_consistent(table: FamilyTable, row: Row) -> None:
    assert row.minimum <= row.maximum
    assert row.default is None or row.allows(row.default)
    assert all(name in table.modifiers for name in row.modifiers)
    assert not row.modifiers or row.actions
    assert row.suffixes is None or row.queries
    assert row.mirrors is None or row.mirrors in table.by_keyword
    assert row.value is not Value.NONE or not (row.queries or row.configs)
    assert row.firmware <= table.firmware


def test_a_keyword_has_its_form() -> None:
    assert LSS_TABLE.find("O")[0] is Form.ACTION
    assert LSS_TABLE.find("QO")[0] is Form.QUERY
    assert LSS_TABLE.find("CO")[0] is Form.CONFIG
    assert LSS_TABLE.row("RS") is LSS_TABLE.row("RESET")
    assert LSS_TABLE.modifiers["SD"] is not LSS_TABLE.row("SD")


def test_an_unknown_keyword_is_refused_with_the_nearest() -> None:
    with pytest.raises(ProtocolError, match="'QDX' is no LSS keyword; did you mean QD"):
        LSS_TABLE.row("QDX")
    with pytest.raises(ProtocolError, match=r"'@' is no LSS-2IO keyword$"):
        IO2_TABLE.row("@")


def test_a_keyword_in_two_rows_fails_an_assertion() -> None:
    row = LSS_TABLE.row("L")
    with pytest.raises(AssertionError, match="L is in two rows"):
        make_table(Family.LSS, [row, row], firmware=0, answers_broadcast=True)


@pytest.mark.parametrize(
    ("table", "keyword", "received", "kept"),
    [
        (LSS_TABLE, "P", 499, 500),
        (LSS_TABLE, "P", 2501, 2500),
        (LSS_TABLE, "P", 1500, 1500),
        (LSS_TABLE, "CFD", 1801, 1800),
        (LSS_TABLE, "LED", 8, None),
        (LSS_TABLE, "AA", 0, 0),
        (LSS_TABLE, "G", 0, None),
        (PRO_TABLE, "CFD", 1790, 1790),
        (PRO_TABLE, "CFD", 1791, 1800),
        (PRO_TABLE, "CFD", -1791, -1800),
        (IO2_TABLE, "D", 1456, 900),
        (IO2_TABLE, "LED", 9, 0),
    ],
)
def test_the_row_gives_the_effect_of_a_value_on_the_servo(
    table: FamilyTable, keyword: str, received: int, kept: int | None
) -> None:
    assert table.row(keyword).kept(received) == kept


@pytest.mark.parametrize(("table", "row"), ROWS)
def test_every_wire_value_of_a_row_comes_back_from_its_physical_value(
    table: FamilyTable, row: Row
) -> None:
    edges = (row.minimum, row.minimum + 1, -1, 0, 1, 29, 1443, row.maximum - 1, row.maximum)
    assert [row.wire(row.physical(wire)) for wire in edges] == list(edges)


def test_values_without_a_unit_stay_integers() -> None:
    assert isinstance(LSS_TABLE.row("LED").physical(3), int)
    assert LSS_TABLE.row("QSD").wire_per_unit == Fraction(10)


def test_the_rows_that_need_a_reset_match_the_documents() -> None:
    def later(table: FamilyTable) -> set[str]:
        return {row.name for row in table.rows if row.needs_reset}

    assert later(LSS_TABLE) == {"ID", "B", "FP", "FD", "CRC"}
    assert later(PRO_TABLE) == {"ID", "FD"}
    assert later(IO2_TABLE) == set()


def test_each_part_of_a_2io_accepts_its_own_commands() -> None:
    def accepted(device: Device) -> set[str]:
        return {row.name for row in IO2_TABLE.rows if not row.devices or device in row.devices}

    common = {"ID", "MS"}
    assert accepted(Device.MASTER) == common | {"LED", "B", "G", "RESET", "DEFAULT"}
    assert accepted(Device.SERVO) == common | {"L", "P", "D", "G"}
    assert accepted(Device.ANALOG) == common | {"A", "AM", "G"}


def test_the_ids_and_limits_of_a_2io_match_its_sketch() -> None:
    assert sorted(PIN_IDS.values()) == [203, 204, 205, 207, 209, 210, 211]
    assert max(IO2_TABLE.row("CB").choices or ()) == BAUD_MAX_BPS
    assert not IO2_TABLE.answers_broadcast
    assert len(encode(Command(12, "D", -1443, (("T", 1000),)))) - 1 == SECTION_MAX_CHARS - 1


def test_fast_baud_rates_need_newer_firmware() -> None:
    assert LSS_TABLE.row("CB").choices == BAUD_RATES_BPS
    assert {rate for rate, since in BAUD_RATES_BPS.items() if since} == {750000, 921600}
