from __future__ import annotations

from random import Random

import pytest

from lss_motion.player.joint_state import MISSED_NS, Statistics


def test_lateness_becomes_percentiles():
    statistics = Statistics()
    for late_us in range(100):
        statistics.sent(1000 * late_us)
    assert statistics.timing() == {
        "commands": 100,
        "missed": 0,
        "late_p50_us": 50,
        "late_p99_us": 99,
        "late_max_us": 99,
    }


def test_percentiles_are_right_to_a_bin_and_an_hour_takes_no_more_room_than_a_minute():
    random = Random(1)
    lates_ns = [int(random.lognormvariate(11.0, 1.5)) for _ in range(40_000)]
    statistics, sizes = Statistics(), []
    for index, late_ns in enumerate(lates_ns):
        statistics.sent(late_ns)
        if index in (20_000, 39_999):
            sizes.append(len(statistics._bins) + len(statistics.latest_ns))
    ordered_us, said = [late_ns / 1000 for late_ns in sorted(lates_ns)], statistics.timing()
    assert said["commands"] == len(lates_ns)
    assert said["late_p50_us"] == pytest.approx(ordered_us[20_000], rel=0.016, abs=1.0)
    assert said["late_p99_us"] == pytest.approx(ordered_us[39_600], rel=0.016, abs=1.0)
    assert said["late_max_us"] == int(ordered_us[-1])
    assert sizes[1] < 1.1 * sizes[0] < 1500
    assert list(statistics.latest_ns) == lates_ns[-100:]


@pytest.mark.parametrize("late_us", [129, 255, 1025, 4094, 20_000, 65_537])
def test_a_percentile_is_the_upper_end_of_a_narrow_bin(late_us):
    statistics = Statistics()
    for late_ns in (1000 * late_us, 1000 * late_us, 10**9):
        statistics.sent(late_ns)
    assert late_us <= statistics.timing()["late_p50_us"] <= late_us * (1.0 + 2.0**-6)


def test_a_histogram_doubles_from_bar_to_bar_and_holds_every_move():
    statistics = Statistics()
    for late_us in [0] * 5 + [7, 20, 31, 33, 1000, 1500]:
        statistics.sent(1000 * late_us)
    assert statistics.histogram_us() == [(8, 6), (32, 2), (64, 1), (1024, 1), (2048, 1)]


def test_early_is_not_late():
    statistics = Statistics()
    statistics.sent(-5_000_000)
    assert statistics.max_ns == 0
    assert statistics.timing() | {"commands": 0} == Statistics().timing()


def test_later_than_a_move_reaches_is_missed():
    statistics = Statistics()
    for late_ns in (MISSED_NS, MISSED_NS + 1):
        statistics.sent(late_ns)
    assert statistics.timing()["missed"] == 1


def test_nothing_sent_is_all_zeros():
    assert set(Statistics().timing().values()) == {0}
