from __future__ import annotations

from lss_motion.player.statistics import MISSED_NS, Statistics


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


def test_early_is_not_late():
    statistics = Statistics()
    statistics.sent(-5_000_000)
    assert statistics.timing()["late_max_us"] == 0


def test_later_than_a_move_reaches_is_missed():
    statistics = Statistics()
    for late_ns in (MISSED_NS, MISSED_NS + 1):
        statistics.sent(late_ns)
    assert statistics.timing()["missed"] == 1


def test_nothing_sent_is_all_zeros():
    assert set(Statistics().timing().values()) == {0}
