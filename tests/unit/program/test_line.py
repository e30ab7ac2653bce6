from __future__ import annotations

import pytest

from lss_motion.program.line import LineSchedule, line_use


def test_a_free_line_is_reserved_right_before_the_wish():
    assert LineSchedule().reserve(10_000, 1_000, 0) == 10_000


def test_slots_pile_up_backwards_from_the_wish():
    line = LineSchedule()
    assert [line.reserve(10_000, 1_000, 0) for _ in range(3)] == [10_000, 9_000, 8_000]


def test_a_gap_that_is_just_wide_enough_is_used():
    line = LineSchedule()
    assert line.reserve(10_000, 1_000, 0) == 10_000
    assert line.reserve(8_000, 1_000, 0) == 8_000
    assert line.reserve(10_000, 1_000, 0) == 9_000
    assert line.reserve(10_000, 1_001, 0) == 7_000


def test_it_is_late_only_when_nothing_is_free_before():
    line = LineSchedule()
    line.reserve(10_000, 4_000, 0)
    assert line.reserve(10_000, 1_000, 6_000) == 11_000
    assert line.reserve(10_000, 1_000, 5_000) == 6_000


def test_use_counts_commands_share_and_the_worst_window():
    slots_us = [(0, 10_000), (10_000, 10_000), (500_000, 10_000), (990_000, 10_000)]
    use = line_use("main", 115200, slots_us)
    assert use.commands == 4
    assert use.utilisation_ratio == pytest.approx(0.04)
    assert use.worst_100_ms_ratio == pytest.approx(0.2)
    assert (use.overlaps, use.late_max_us) == (0, 0)


def test_use_finds_what_overlaps_and_how_long_it_waits():
    use = line_use("main", 115200, [(0, 1_000), (400, 1_000), (1_000, 1_000), (9_000, 1_000)])
    assert use.overlaps == 2
    assert use.late_max_us == 1_000


def test_an_unused_line_is_not_used():
    use = line_use("main", 115200, [])
    assert (use.commands, use.utilisation_ratio, use.worst_100_ms_ratio) == (0, 0.0, 0.0)
