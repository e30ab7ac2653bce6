from __future__ import annotations

from itertools import pairwise
from random import Random

import numpy as np
import pytest

from lss_motion.planning.program.line import (
    TURNAROUND_US,
    LineSchedule,
    line_use,
    longest_move,
    reading_rate_hz,
    sent_us,
    with_phases,
)
from tests.tables import titled


def best_end_us(slots_us, latest_end_us, size_us, earliest_us):
    """Return the slot that `reserve` must return, from all places next to another slot."""

    def is_free(start_us):
        return all(stop <= start_us or start >= start_us + size_us for start, stop in slots_us)

    ends_us = [latest_end_us, *(start for start, _ in slots_us if start <= latest_end_us)]
    end_us = max(end for end in ends_us if is_free(end - size_us))
    if end_us - size_us >= earliest_us:
        return end_us
    after_us = max(earliest_us, latest_end_us - size_us)
    starts_us = [after_us, *(stop for _, stop in slots_us if stop >= after_us)]
    return min(start for start in starts_us if is_free(start)) + size_us


def random_requests(random, count, step_us):
    """Return requests, half of them near the same instants; coarse steps leave exact gaps."""
    for _ in range(count):
        size_us = random.choice((1_000, 1_041, 5_000, 20_000, 1))
        request_us = random.randrange(-1, 12) * 500_000
        request_us += random.choice((-1, 0, 1, random.randrange(-30_000, 30_000, step_us)))
        early_us = random.choice((-3_000, 0, 1, 2_000, 40_000))
        yield request_us, size_us, request_us - size_us - early_us


@pytest.mark.parametrize("seed", range(6))
def test_every_slot_is_the_best_free_one(seed):
    random, line, slots_us = Random(seed), LineSchedule(), []
    for request in random_requests(random, 160, (1, 500)[seed % 2]):
        requested_us = best_end_us(slots_us, *request)
        other = line.copy()
        assert line.reserve(*request) == requested_us, request
        assert other.reserve(*request) == requested_us, (
            "a copy has the same slots, and no later ones"
        )
        slots_us.append((requested_us - request[1], requested_us))


def reserved_us(line, *requests):
    return line.reserve_all(*(np.array(column) for column in zip(*requests, strict=True))).tolist()


@pytest.mark.parametrize("seed", range(6))
def test_many_slots_never_overlap_and_are_late_only_if_they_must_be(seed):
    random, line, slots_us = Random(seed), LineSchedule(), []
    late = 0
    for count in (1, 90, 2, 40, 7):
        requests = list(random_requests(random, count, (1, 500)[seed % 2]))
        ends_us = reserved_us(line, *requests)
        slots_us += [
            (end - request[1], end) for end, request in zip(ends_us, requests, strict=True)
        ]
        for end_us, request in zip(ends_us, requests, strict=True):
            own_us = (end_us - request[1], end_us)
            assert own_us[0] >= request[2], "never before its earliest"
            others_us = [slot for slot in slots_us if slot != own_us]
            assert len(others_us) == len(slots_us) - 1
            if end_us > request[0]:
                late += 1
                assert best_end_us(others_us, *request) > request[0]
    edges_us = [edge for slot in sorted(slots_us) for edge in slot]
    assert edges_us == sorted(edges_us)
    assert 20 < late < 120, "both are looked at"


def test_of_two_overlapping_requests_the_earlier_one_goes_first():
    assert reserved_us(LineSchedule(), (9_000, 1_000, 0), (9_500, 1_000, 0)) == [8_500, 9_500]
    assert reserved_us(LineSchedule(), (9_500, 1_000, 0), (9_000, 1_000, 0)) == [9_500, 8_500]


def test_a_request_that_cannot_move_earlier_keeps_its_place():
    requests = [(9_000, 1_000, 7_800), (9_500, 1_000, 0), (9_600, 1_000, 8_600)]
    assert reserved_us(LineSchedule(), *requests) == [9_000, 8_000, 10_000]


def test_a_request_displaced_by_a_blocked_one_overlaps_no_slot():
    line = LineSchedule()
    assert [line.reserve(5_000, 1_000, 0), line.reserve(7_500, 700, 0)] == [5_000, 7_500]
    assert reserved_us(line, (6_000, 1_000, 0), (7_000, 1_000, 0)) == [4_000, 6_800]


def test_a_request_moved_before_one_slot_also_moves_before_the_next():
    line = LineSchedule()
    for end_us in (9_000, 7_500):
        line.reserve(end_us, 1_000, 0)
    assert reserved_us(line, (10_000, 1_000, 0), (10_050, 1_000, 0)) == [6_500, 10_050]


USES = {
    "nothing is sent": ([], (0, 0.0, 0.0, 0, 0)),
    "commands, share, and the worst 100 ms": (
        [(0, 10_000), (10_000, 10_000), (500_000, 10_000), (990_000, 10_000)],
        (4, 0.04, 0.2, 0, 0),
    ),
    "overlaps, and the longest wait": (
        [(0, 1_000), (400, 1_000), (1_000, 1_000), (9_000, 1_000)], (4, 0.04, 0.04, 2, 1_000)
    ),
    "10 ms, 20 ms and, waiting for these, 30 ms of sending, from 0.5 s to 1.03 s": (
        [(1_000_000, 30_000), (500_000, 10_000), (980_000, 20_000)],
        (3, 60.0 / 530.0, 0.5, 0, 0),
    ),
    "commands that wait": ([(0, 90_000), (10_000, 60_000)], (2, 1.0, 1.0, 1, 80_000)),
    "of those due at once the shorter one is sent first": (
        [(0, 3_000), (0, 1_000)], (2, 0.04, 0.04, 1, 1_000)
    ),
}  # fmt: skip


@titled(("slots_us", "expected"), USES)
def test_the_use_of_a_line(slots_us, expected):
    use = line_use("main", 115200, slots_us)
    assert (use.bus, use.baud_bps) == ("main", 115200)
    found = use.commands, use.utilisation_ratio, use.worst_100_ms_ratio
    assert (*found, use.overlaps, use.late_max_us) == pytest.approx(expected)


QUERY_US = 5 * 87 - 1
"""`#1QD` and its end at 115200 bps, rounded up."""


def slots(*pairs):
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def test_on_an_idle_line_the_replies_limit_the_rate(kit):
    reply_us = 9 * 87 - 1  # *1QD-900 and its end
    expected_hz = 1e6 / (TURNAROUND_US + reply_us)
    assert reading_rate_hz([kit.joint()], 115200, slots()) == pytest.approx(expected_hz, rel=1e-2)
    four = [kit.joint(f"j{index}", index) for index in range(4)]
    assert reading_rate_hz(four, 115200, slots()) == pytest.approx(expected_hz / 4, rel=1e-2)
    assert reading_rate_hz([], 115200, slots()) == float("inf")


def test_a_gap_too_short_for_a_query_does_not_count(kit):
    joints = [kit.joint()]
    full = slots(*((at, 10_000 - QUERY_US + 1) for at in range(0, 3_000_000, 10_000)))
    assert reading_rate_hz(joints, 115200, full) == 0.0
    wide = slots(*((at, 10_000 - QUERY_US - 1) for at in range(0, 3_000_000, 10_000)))
    assert reading_rate_hz(joints, 115200, wide) == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("seed", range(20))
def test_the_promised_number_of_queries_fits_in_any_second(kit, seed):
    """Against a line on which a query is sent whenever it fits before the next command."""
    random = np.random.default_rng(seed)
    own, at_us = [], 0
    while at_us < 4_000_000:
        at_us += int(random.choice([300, 2_000, 30_000])) if random.random() < 0.8 else 0
        size_us = int(random.integers(500, 20_000))
        own.append((at_us, size_us))
        at_us += size_us
    sent_us = []
    for (due_us, size_us), (next_us, _) in pairwise(own):
        free_us = due_us + size_us
        sent_us += range(free_us + QUERY_US, next_us + 1, QUERY_US)
    sent_us = np.array(sent_us)
    starts_us = np.arange(0, 2_900_000, 997)
    counts = np.searchsorted(sent_us, starts_us + 1_000_000) - np.searchsorted(sent_us, starts_us)
    promised = reading_rate_hz([kit.joint()], 115200, slots(*own))
    answered = 1e6 / TURNAROUND_US
    assert promised <= counts.min() + 1
    assert promised >= min(answered / 2, counts.min() - 2) - 1


@pytest.mark.parametrize(
    ("count", "baud_bps", "gap_us"), [(2, 19_200, 7200), (4, 19_200, 0), (4, 115_200, 1200)]
)
def test_targets_of_streamed_joints_never_need_the_line_at_once(kit, count, baud_bps, gap_us):
    """Filters need them at even distances; then a move of another joint has its gap."""
    streamed = [kit.joint(f"j{i}", i + 1, drive="streamed") for i in range(count)]
    robot = with_phases(kit.robot(kit.joint("timed", 60), *streamed, baud_bps=baud_bps))
    slot_us = max(sent_us(len(longest_move(joint)), baud_bps) for joint in streamed)
    begins_us = [20_000 * robot.joints[joint.name].filter_phase_ratio for joint in streamed]
    assert min(b - a for a, b in pairwise(begins_us)) >= slot_us
    left_us = begins_us[0] + 20_000 - (begins_us[-1] + slot_us)
    assert left_us >= gap_us
