from __future__ import annotations

import pytest

from lss_motion.player.following import OFFSET_MAX_DEG, OFFSET_RATE_DEG_S, Following


def read(following, measured_deg, read_s, *, expected_deg=0.0, speed_deg_s=0.0):
    return following.take(
        measured_deg,
        read_s,
        expected_deg=expected_deg,
        wanted_deg=expected_deg,
        speed_deg_s=speed_deg_s,
    )


def settled(**fields) -> Following:
    following = Following(speed_max_deg_s=100.0, **fields)
    for step in range(5):
        assert read(following, 0.0, 0.02 * step)
    return following


def test_one_wild_reading_moves_nothing():
    following = settled()
    assert not read(following, 70.0, 0.1)
    assert (following.offset_deg, following.measured_deg, following.rejected) == (0.0, 0.0, 1)
    assert following.error_max_deg == 0.0
    assert read(following, 0.1, 0.12)


def test_two_readings_that_agree_are_believed():
    following = settled()
    assert not read(following, 70.0, 0.1)
    assert read(following, 70.5, 0.12)
    assert following.measured_deg == 70.5


def test_two_wild_readings_that_disagree_are_not():
    following = settled()
    assert [read(following, deg, 0.1 + step / 50) for step, deg in enumerate([70, -60, 50])] == [
        False,
        False,
        False,
    ]
    assert following.offset_deg == 0.0


def test_a_wild_first_reading_moves_nothing_where_the_horn_stood_before_is_known():
    following = Following(speed_max_deg_s=100.0, standing_deg=0.0)
    assert not read(following, 70.0, 0.0)
    assert read(following, 0.2, 0.02) is False, "the two do not agree"
    assert read(following, 0.2, 0.04)
    assert following.error_max_deg == pytest.approx(0.2)
    assert abs(following.offset_deg) < 0.1


def test_a_horn_may_go_as_far_as_its_speed_allows():
    following = settled()
    assert read(following, 100.0, 0.08 + 1.0)


def test_a_constant_droop_is_learnt():
    following = settled()
    for step in range(100):
        read(following, -1.5, 0.1 + 0.02 * step)
    assert following.disturbance_deg == pytest.approx(1.5, abs=0.01)
    assert following.offset_deg == pytest.approx(1.5, abs=0.01)


def test_the_offset_is_bounded_and_changes_slowly():
    following = settled()
    before_deg, before_s = following.offset_deg, 0.08
    for step in range(400):
        read_s = 0.1 + 0.02 * step
        read(following, -4.5, read_s)
        change_deg = abs(following.offset_deg - before_deg)
        assert change_deg <= OFFSET_RATE_DEG_S * (read_s - before_s) + 1e-9
        before_deg, before_s = following.offset_deg, read_s
    assert following.offset_deg == OFFSET_MAX_DEG == following.offset_max_deg


def test_a_reading_on_the_way_counts_less_than_one_at_rest():
    slow, fast = settled(), settled()
    read(slow, -1.0, 0.1)
    read(fast, -1.0, 0.1, speed_deg_s=180.0)
    assert 0.0 < fast.disturbance_deg < 0.2 * slow.disturbance_deg


def test_errors_are_summed_up():
    following = settled()
    read(following, 3.0, 0.1)
    read(following, -4.0, 0.3)
    assert following.error_max_deg == 4.0
    assert following.error_rms_deg == pytest.approx((25.0 / 7.0) ** 0.5)
    assert Following(speed_max_deg_s=1.0).error_rms_deg == 0.0
