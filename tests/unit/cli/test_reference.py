"""The reference page says what the tables say."""

from __future__ import annotations

import re

import pytest

from lss_motion.cli.main import main
from lss_motion.cli.manual import FAMILIES, page
from lss_motion.protocol.codec import FAMILY_TABLES
from lss_motion.protocol.constants import Family


def rows_of(text):
    """Return the cells of all table lines but the heads."""
    lines = [line for line in text.splitlines() if line.startswith("| ") and "---" not in line]
    return [re.split(r" ?(?<!\\)\| ?", line)[1:-1] for line in lines if "| Meaning |" not in line]


@pytest.mark.parametrize("family", list(Family))
def test_every_keyword_and_every_source_is_on_the_page_once(family):
    table = FAMILY_TABLES[family]
    rows = rows_of(page(table))
    assert len(rows) == len(table.rows)
    assert {len(row) for row in rows} == {11}
    shown = [word for row in rows for cell in row[:3] for word in re.findall(r"`([A-Z]+)`", cell)]
    modifiers = [row.name for row in table.rows if row.is_modifier]
    assert sorted(shown) == sorted([*table.by_keyword, *modifiers])
    assert sorted(row[9] for row in rows) == sorted(row.source for row in table.rows)


def test_a_row_has_its_unit_scale_range_and_default():
    rows = {row[2]: row for row in rows_of(page(FAMILY_TABLES[Family.LSS]))}
    first_position = rows["`CFD`"]
    assert first_position[:4] == ["", "`QFD`", "`CFD`", "first position"]
    assert first_position[4:8] == ["deg", "value x 10", "-180 to 180 deg; beyond: clamped", ""]
    assert rows["`CAR`"][7] == "180"
    assert "The same setting as `SD`" in rows["`CSR`"][10]


def test_text_keeps_its_asterisks():
    assert r"The reply is \*5QAR1800" in page(FAMILY_TABLES[Family.LSS])


def test_one_family_or_all_are_printed(capsys):
    assert main(["reference", "LSS-2IO"]) == 0
    one = capsys.readouterr().out
    assert main(["reference"]) == 0
    everything = capsys.readouterr().out
    assert [line for line in one.splitlines() if line.startswith("# ")] == ["# LSS-2IO"]
    heads = [line for line in everything.splitlines() if line.startswith("# ")]
    assert heads == [f"# {name}" for name in FAMILIES]
    assert one in everything
