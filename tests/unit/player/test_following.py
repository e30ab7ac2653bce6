from __future__ import annotations

import pytest

from lss_motion.player.estimators import (
    ESTIMATE_S,
    GAIN_MAX,
    JUMP_MARGIN_DEG,
    OFFSET_MAX_DEG,
    OFFSET_RATE_DEG_S,
    DisturbanceEstimator,
)


def read(following, measured_deg, read_s, *, expected_deg=0.0, speed_deg_s=0.0):
    return following.take(
        measured_deg,
        read_s,
        expected_deg=expected_deg,
        wanted_deg=expected_deg,
        speed_deg_s=speed_deg_s,
    )


def settled(**fields) -> DisturbanceEstimator:
    following = DisturbanceEstimator(speed_max_deg_s=100.0, **fields)
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
    following = DisturbanceEstimator(speed_max_deg_s=100.0, standing_deg=0.0)
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
    unread = DisturbanceEstimator(speed_max_deg_s=1.0)
    assert unread.error_deg == unread.error_max_deg == unread.error_rms_deg == 0.0


def test_the_reach_is_what_the_speed_allows_since_then_and_a_margin_no_more():
    for far_deg, is_believed in ((10.0 + JUMP_MARGIN_DEG, True), (10.1 + JUMP_MARGIN_DEG, False)):
        following = DisturbanceEstimator(speed_max_deg_s=100.0)
        read(following, 0.0, 50.0)
        assert read(following, far_deg, 50.1) is is_believed


def test_the_first_reading_counts_as_much_as_one_may_and_moves_no_command_at_once():
    following = DisturbanceEstimator(speed_max_deg_s=100.0)
    read(following, -2.0, 5.0)
    assert following.disturbance_deg == pytest.approx(GAIN_MAX * 2.0)
    assert following.offset_deg == following.offset_max_deg == 0.0


def test_a_reading_counts_by_the_time_since_the_last_one_and_a_quarter_at_the_most():
    for elapsed_s, gain in ((0.009, 0.009 / ESTIMATE_S), (0.1, GAIN_MAX)):
        following = settled()
        read(following, -1.0, 0.08 + elapsed_s)
        assert following.disturbance_deg == pytest.approx(gain)


def test_at_its_half_speed_a_reading_counts_half():
    following = settled()
    read(following, -1.0, 0.2, speed_deg_s=-30.0)
    assert following.disturbance_deg == pytest.approx(GAIN_MAX / 2.0)


def test_the_error_is_how_far_the_horn_is_short_of_what_was_wanted():
    following = settled()
    assert following.error_deg == 0.0
    following.take(3.0, 0.1, expected_deg=3.5, wanted_deg=5.0, speed_deg_s=0.0)
    assert following.error_deg == pytest.approx(2.0)
    assert following.error_max_deg == pytest.approx(2.0)
    assert following.disturbance_deg > 0.0


def test_a_horn_that_was_set_down_elsewhere_is_read_anew_and_what_was_learnt_is_kept():
    following = settled()
    for step in range(40):
        read(following, -1.0, 0.1 + 0.02 * step)
    learnt_deg = following.offset_deg
    following.stand(60.0)
    assert (following.measured_deg, following.read_s, following.standing_deg) == (None, None, 60.0)
    assert read(following, 60.2, 1.0, expected_deg=61.2)
    assert following.offset_deg == learnt_deg > 0.5
    following.stand(-60.0)
    assert not read(following, 60.2, 1.1), "nothing stands there"
    following.stand(10.0)
    assert read(following, 10.1, 1.2), "and what was wild before is no witness"


def test_a_wild_reading_is_no_witness_once_another_was_believed():
    following = settled()
    assert not read(following, 70.0, 0.1)
    assert read(following, 0.0, 0.12)
    assert not read(following, 70.0, 0.14)


@pytest.mark.parametrize("pulled_deg", [-1.5, 1.5])
def test_what_is_known_for_sure_is_corrected_at_once(pulled_deg):
    following = settled()
    following.rest(pulled_deg)
    assert following.disturbance_deg == following.offset_deg == pulled_deg
    assert following.offset_max_deg == 1.5
    following.rest(0.5)
    assert (following.offset_deg, following.offset_max_deg) == (0.5, 1.5)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_even_what_is_known_for_sure_is_corrected_no_further_than_a_correction_may_go(sign):
    following = settled()
    following.rest(sign * 3.0 * OFFSET_MAX_DEG)
    assert following.offset_deg == sign * OFFSET_MAX_DEG
    assert following.disturbance_deg == sign * 3.0 * OFFSET_MAX_DEG


def test_a_reading_from_which_nothing_is_learnt_is_believed_and_counted():
    following = settled()
    assert following.take(1.0, 0.1, expected_deg=3.0, wanted_deg=3.0, speed_deg_s=0.0, learns=False)
    assert (following.readings, following.error_deg) == (6, 2.0)
    assert (following.disturbance_deg, following.offset_deg) == (0.0, 0.0)
