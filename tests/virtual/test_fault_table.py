"""The table of faults in the guide: its tool measures, and the guide has a row for each case."""

from __future__ import annotations

import fault_table
from fault_table import CASES, GUIDE, MARKS, Case, Played

CASE = {case.text: case for case in CASES}


def played(text):
    return fault_table.play(CASE[text], fault_table.wave(), seed=3, seeds=8)


def test_a_lost_port_is_noticed_at_once():
    lost = played("the port is unplugged for good")
    assert (lost.noticed, lost.end) == ("`lost_port`", "ends, lost")
    assert 0.0 <= lost.after_s < 0.1


def test_a_silent_servo_is_noticed_within_its_silent_s():
    silent = played("a servo falls silent for good")
    assert silent.noticed == "`silent`"
    assert 0.2 < silent.after_s <= 1.1


def test_another_host_that_asks_is_named_and_the_show_goes_on():
    asks = played("another host asks every 0.1 s")
    assert (asks.noticed, asks.end) == ("a warning", "goes on to its end")


def test_a_careful_run_finds_a_wrong_unit_that_a_show_only_warns_of():
    assert played("positions are in hundredths instead of tenths").noticed == "a warning"
    careful = played("in a careful run: positions are in hundredths instead of tenths")
    assert (careful.noticed, careful.end) == ("an error", "halts within 1 deg")
    assert 0.2 < careful.after_s < 1.0


def test_a_row_has_median_and_worst_and_counts_what_happens():
    runs = [
        Played("`silent`", 0.5, "goes on to its end"),
        Played("`silent`", 1.5, "brakes and holds"),
        Played("", None, "goes on to its end"),
    ]
    assert fault_table.row(Case("x", CASES[0].rows), runs) == (
        "| x | `silent` (2 of 3), not noticed (1 of 3) | 1.00 s, 1.50 s | "
        "goes on to its end (2), brakes and holds (1) |"
    )


def test_the_guide_has_a_row_for_each_case():
    page = GUIDE.read_text(encoding="utf-8")
    inside = page[page.index(MARKS[0]) : page.index(MARKS[1])]
    rows = [line.split("|")[1].strip() for line in inside.splitlines() if line.startswith("|")]
    assert rows[2:] == [case.text for case in CASES], (
        "tools/run python tools/fault_table.py --write"
    )
