from __future__ import annotations

from random import Random

import pytest

from lss_motion.program.line import BUCKET_US, LineSchedule, line_use


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


def best_end_us(slots_us, latest_end_us, size_us, earliest_us):
    """Say what `reserve` promises, by trying every place next to another slot."""

    def is_free(start_us):
        return all(stop <= start_us or start >= start_us + size_us for start, stop in slots_us)

    ends_us = [latest_end_us, *(start for start, _ in slots_us if start <= latest_end_us)]
    end_us = max(end for end in ends_us if is_free(end - size_us))
    if end_us - size_us >= earliest_us:
        return end_us
    after_us = max(earliest_us, latest_end_us - size_us)
    starts_us = [after_us, *(stop for _, stop in slots_us if stop >= after_us)]
    return min(start for start in starts_us if is_free(start)) + size_us


@pytest.mark.parametrize("seed", range(6))
def test_every_slot_is_the_best_free_one_wherever_it_lies(seed):
    random, line, slots_us = Random(seed), LineSchedule(), []
    step_us = (1, 500)[seed % 2]  # Coarse steps leave gaps that are just wide enough.
    for count in range(160):
        # About the edges of the stretches by which slots are kept, some as long as one of them.
        middle_us = random.randrange(-1, 4) * BUCKET_US
        size_us = random.choice((1_000, 1_041, 5_000, 20_000, BUCKET_US if count % 40 == 9 else 1))
        wish_us = middle_us + random.choice((-1, 0, 1, random.randrange(-30_000, 30_000, step_us)))
        wish = wish_us, size_us, wish_us - size_us - random.choice((-3_000, 0, 1, 2_000, 40_000))
        wanted_us = best_end_us(slots_us, *wish)
        other = line.copy()
        assert line.reserve(*wish) == wanted_us, (count, wish)
        assert other.reserve(*wish) == wanted_us, "a copy knows the same slots, and no later ones"
        slots_us.append((wanted_us - size_us, wanted_us))


def test_a_slot_across_the_edge_of_a_stretch_sees_what_is_behind_it():
    line = LineSchedule()
    assert line.reserve(5_000, 1_000, 0) == 5_000
    assert line.reserve(BUCKET_US + 1_100, 1_000, 0) == BUCKET_US + 1_100
    assert line.reserve(BUCKET_US + 600, 1_000, 0) == BUCKET_US + 100


def test_a_copy_and_its_original_leave_each_other_alone():
    line = LineSchedule()
    line.reserve(10_000, 1_000, 0)
    other = line.copy()
    assert [one.reserve(10_000, 1_000, 0) for one in (line, other)] == [9_000, 9_000]
    assert [one.reserve(10_000, 1_000, 0) for one in (line, other)] == [8_000, 8_000]


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


def test_use_goes_from_the_first_byte_to_the_last():
    # 10 ms, 20 ms and, waiting for these, 30 ms of sending: from 0.5 s to 1.03 s.
    slots_us = [(1_000_000, 30_000), (500_000, 10_000), (980_000, 20_000)]
    use = line_use("main", 500_000, slots_us)
    assert use.utilisation_ratio == pytest.approx(60.0 / 530.0)
    assert use.worst_100_ms_ratio == pytest.approx(0.5)
    assert (use.bus, use.baud_bps) == ("main", 500_000)


def test_what_has_to_wait_makes_the_use_longer():
    use = line_use("main", 115200, [(0, 90_000), (10_000, 60_000)])
    assert use.utilisation_ratio == pytest.approx(1.0)
    assert use.worst_100_ms_ratio == 1.0
    assert use.late_max_us == 80_000


def test_of_commands_due_at_once_the_shorter_one_goes_first():
    use = line_use("main", 115200, [(0, 3_000), (0, 1_000)])
    assert (use.overlaps, use.late_max_us) == (1, 1_000)


def test_the_longest_of_many_is_found_across_the_edge_of_its_stretch():
    line = LineSchedule()
    ends_us = line.reserve_all((BUCKET_US + 3_000, 9_000), (4_000, 1_000), (0, 0))
    assert ends_us == [BUCKET_US + 3_000, 9_000]
    assert line.reserve(BUCKET_US + 3_000, 1_000, 0) == BUCKET_US - 1_000
