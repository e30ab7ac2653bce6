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


def read(disturbance, measured_deg, read_s, *, expected_deg=0.0, speed_deg_s=0.0):
    return disturbance.take(
        measured_deg,
        read_s,
        expected_deg=expected_deg,
        planned_deg=expected_deg,
        speed_deg_s=speed_deg_s,
    )


def settled(**fields) -> DisturbanceEstimator:
    disturbance = DisturbanceEstimator(speed_max_deg_s=100.0, **fields)
    for step in range(5):
        assert read(disturbance, 0.0, 0.02 * step)
    return disturbance


def test_one_wild_reading_moves_nothing():
    disturbance = settled()
    assert not read(disturbance, 70.0, 0.1)
    assert (disturbance.offset_deg, disturbance.measured_deg, disturbance.rejected) == (0.0, 0.0, 1)
    assert disturbance.error_max_deg == 0.0
    assert read(disturbance, 0.1, 0.12)


def test_two_readings_that_agree_are_believed():
    disturbance = settled()
    assert not read(disturbance, 70.0, 0.1)
    assert read(disturbance, 70.5, 0.12)
    assert disturbance.measured_deg == 70.5


def test_two_wild_readings_that_disagree_are_not():
    disturbance = settled()
    assert [read(disturbance, deg, 0.1 + step / 50) for step, deg in enumerate([70, -60, 50])] == [
        False,
        False,
        False,
    ]
    assert disturbance.offset_deg == 0.0


def test_a_wild_first_reading_moves_nothing_where_the_horn_stood_before_is_known():
    disturbance = DisturbanceEstimator(speed_max_deg_s=100.0, standing_deg=0.0)
    assert not read(disturbance, 70.0, 0.0)
    assert read(disturbance, 0.2, 0.02) is False, "the two do not agree"
    assert read(disturbance, 0.2, 0.04)
    assert disturbance.error_max_deg == pytest.approx(0.2)
    assert abs(disturbance.offset_deg) < 0.1


def test_a_horn_may_go_as_far_as_its_speed_allows():
    disturbance = settled()
    assert read(disturbance, 100.0, 0.08 + 1.0)


def test_a_constant_droop_is_learnt():
    disturbance = settled()
    for step in range(100):
        read(disturbance, -1.5, 0.1 + 0.02 * step)
    assert disturbance.estimate_deg == pytest.approx(1.5, abs=0.01)
    assert disturbance.offset_deg == pytest.approx(1.5, abs=0.01)


def test_the_offset_is_bounded_and_changes_slowly():
    disturbance = settled()
    before_deg, before_s = disturbance.offset_deg, 0.08
    for step in range(400):
        read_s = 0.1 + 0.02 * step
        read(disturbance, -4.5, read_s)
        change_deg = abs(disturbance.offset_deg - before_deg)
        assert change_deg <= OFFSET_RATE_DEG_S * (read_s - before_s) + 1e-9
        before_deg, before_s = disturbance.offset_deg, read_s
    assert disturbance.offset_deg == OFFSET_MAX_DEG == disturbance.offset_max_deg


def test_a_reading_on_the_way_counts_less_than_one_at_rest():
    slow, fast = settled(), settled()
    read(slow, -1.0, 0.1)
    read(fast, -1.0, 0.1, speed_deg_s=180.0)
    assert 0.0 < fast.estimate_deg < 0.2 * slow.estimate_deg


def test_errors_are_summed_up():
    disturbance = settled()
    read(disturbance, 3.0, 0.1)
    read(disturbance, -4.0, 0.3)
    assert disturbance.error_max_deg == 4.0
    assert disturbance.error_rms_deg == pytest.approx((25.0 / 7.0) ** 0.5)
    unread = DisturbanceEstimator(speed_max_deg_s=1.0)
    assert unread.error_deg == unread.error_max_deg == unread.error_rms_deg == 0.0


def test_the_reach_is_what_the_speed_allows_since_then_and_a_margin_no_more():
    for far_deg, is_believed in ((10.0 + JUMP_MARGIN_DEG, True), (10.1 + JUMP_MARGIN_DEG, False)):
        disturbance = DisturbanceEstimator(speed_max_deg_s=100.0)
        read(disturbance, 0.0, 50.0)
        assert read(disturbance, far_deg, 50.1) is is_believed


def test_the_first_reading_counts_as_much_as_one_may_and_moves_no_command_at_once():
    disturbance = DisturbanceEstimator(speed_max_deg_s=100.0)
    read(disturbance, -2.0, 5.0)
    assert disturbance.estimate_deg == pytest.approx(GAIN_MAX * 2.0)
    assert disturbance.offset_deg == disturbance.offset_max_deg == 0.0


def test_a_reading_counts_by_the_time_since_the_last_one_and_a_quarter_at_the_most():
    for elapsed_s, gain in ((0.009, 0.009 / ESTIMATE_S), (0.1, GAIN_MAX)):
        disturbance = settled()
        read(disturbance, -1.0, 0.08 + elapsed_s)
        assert disturbance.estimate_deg == pytest.approx(gain)


def test_at_its_half_speed_a_reading_counts_half():
    disturbance = settled()
    read(disturbance, -1.0, 0.2, speed_deg_s=-30.0)
    assert disturbance.estimate_deg == pytest.approx(GAIN_MAX / 2.0)


def test_the_error_is_how_far_the_horn_is_short_of_what_was_wanted():
    disturbance = settled()
    assert disturbance.error_deg == 0.0
    disturbance.take(3.0, 0.1, expected_deg=3.5, planned_deg=5.0, speed_deg_s=0.0)
    assert disturbance.error_deg == pytest.approx(2.0)
    assert disturbance.error_max_deg == pytest.approx(2.0)
    assert disturbance.estimate_deg > 0.0


def test_a_horn_that_was_set_down_elsewhere_is_read_anew_and_what_was_learnt_is_kept():
    disturbance = settled()
    for step in range(40):
        read(disturbance, -1.0, 0.1 + 0.02 * step)
    learnt_deg = disturbance.offset_deg
    disturbance.stand_at(60.0)
    assert (disturbance.measured_deg, disturbance.read_s, disturbance.standing_deg) == (
        None,
        None,
        60.0,
    )
    assert read(disturbance, 60.2, 1.0, expected_deg=61.2)
    assert disturbance.offset_deg == learnt_deg > 0.5
    disturbance.stand_at(-60.0)
    assert not read(disturbance, 60.2, 1.1), "nothing stands there"
    disturbance.stand_at(10.0)
    assert read(disturbance, 10.1, 1.2), "and what was wild before is no witness"


def test_a_wild_reading_is_no_witness_once_another_was_believed():
    disturbance = settled()
    assert not read(disturbance, 70.0, 0.1)
    assert read(disturbance, 0.0, 0.12)
    assert not read(disturbance, 70.0, 0.14)


@pytest.mark.parametrize("droop_deg", [-1.5, 1.5])
def test_what_is_known_for_sure_is_corrected_at_once(droop_deg):
    disturbance = settled()
    disturbance.rest(droop_deg)
    assert disturbance.estimate_deg == disturbance.offset_deg == droop_deg
    assert disturbance.offset_max_deg == 1.5
    disturbance.rest(0.5)
    assert (disturbance.offset_deg, disturbance.offset_max_deg) == (0.5, 1.5)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_even_what_is_known_for_sure_is_corrected_no_further_than_a_correction_may_go(sign):
    disturbance = settled()
    disturbance.rest(sign * 3.0 * OFFSET_MAX_DEG)
    assert disturbance.offset_deg == sign * OFFSET_MAX_DEG
    assert disturbance.estimate_deg == sign * 3.0 * OFFSET_MAX_DEG


def test_a_reading_from_which_nothing_is_learnt_is_believed_and_counted():
    disturbance = settled()
    assert disturbance.take(
        1.0, 0.1, expected_deg=3.0, planned_deg=3.0, speed_deg_s=0.0, learns=False
    )
    assert (disturbance.readings, disturbance.error_deg) == (6, 2.0)
    assert (disturbance.estimate_deg, disturbance.offset_deg) == (0.0, 0.0)
