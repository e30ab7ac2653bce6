"""Tests of `player.estimators`.

The lag of a horn from its readings: found, not mistaken for a load, and bounded.
Which of the last moves a servo has missed, from where its horn is.
"""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from lss_motion.player.estimators import (
    DEAD_S,
    ESTIMATE_S,
    GAIN_MAX,
    JUMP_MARGIN_DEG,
    LAG_MAX_S,
    MEMORY_S,
    MISMATCHES_MAX,
    OFFSET_MAX_DEG,
    OFFSET_RATE_DEG_S,
    OTHERS_MAX,
    QUERIES_MAX,
    SURE_S,
    Alternative,
    DisturbanceEstimator,
    LagEstimator,
    LostMoveDetector,
)
from lss_motion.robot.model import Response
from lss_motion.robot.profile import Profile

# ---- following


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


# ---- lag


def swung(lag_s, *, load_deg=0.0, noise_deg=0.1, seconds=6.0, hz=40.0, swing_deg=30.0):
    """Return the estimate after readings of a joint that swings once a second and a half."""
    random, lag = Random(1), LagEstimator()
    times_s = np.arange(0.0, seconds, 1.0 / hz)
    rate = 2.0 * np.pi / 1.5
    for time_s in times_s.tolist():
        now_deg, speed = swing_deg * np.sin(rate * time_s), swing_deg * rate * np.cos(rate * time_s)
        then_deg = swing_deg * np.sin(rate * (time_s - lag_s))
        load = load_deg * np.cos(np.radians(now_deg))
        measured_deg = then_deg - load + random.uniform(-noise_deg, noise_deg)
        lag.take(now_deg - measured_deg, float(speed), 1.0 / hz)
    return lag


@pytest.mark.parametrize("lag_s", [-0.015, 0.0, 0.01, 0.03, 0.05])
@pytest.mark.parametrize("load_deg", [0.0, 3.0])
def test_a_lag_is_found_whatever_the_load(lag_s, load_deg):
    assert swung(lag_s, load_deg=load_deg).estimate_s == pytest.approx(lag_s, abs=0.003)


def test_a_lag_as_assumed_moves_nothing():
    assert swung(0.0).extra_s == 0.0
    assert swung(0.03).extra_s == swung(0.03).estimate_s == pytest.approx(0.03, abs=0.003)
    assert 0.0 < swung(1.5 * DEAD_S).extra_s < 1.5 * DEAD_S


def test_no_estimate_goes_beyond_what_a_lag_can_be():
    assert swung(0.2).estimate_s == LAG_MAX_S
    assert swung(-0.2).estimate_s == -LAG_MAX_S


def test_at_rest_nothing_is_learnt_and_nothing_forgotten():
    lag = swung(0.03)
    known_s = lag.estimate_s
    for _ in range(4000):
        lag.take(2.0, 0.0, 0.02)
    assert lag.estimate_s == known_s


def test_one_reading_is_no_evidence():
    lag = LagEstimator()
    assert lag.estimate_s == 0.0
    lag.take(5.0, 100.0, 0.02)
    assert abs(lag.estimate_s) < 0.002


def driven(lag, lag_s, *speeds_deg_s, seconds, load_deg=0.0):
    """Read a horn that lags by `lag_s` at each of the speeds in turn, for so long in all."""
    for step in range(round(100 * seconds)):
        speed = speeds_deg_s[step % len(speeds_deg_s)]
        lag.take(load_deg + lag_s * speed, speed, 0.01)
    return lag.estimate_s


def test_half_a_second_to_and_fro_tells_the_lag():
    assert driven(LagEstimator(), 0.03, -100.0, 100.0, seconds=0.5) == pytest.approx(0.03, rel=0.05)


def test_a_slow_move_is_hardly_believed():
    assert 0.01 < driven(LagEstimator(), 0.03, -10.0, 10.0, seconds=2.0) < 0.02


def test_one_way_at_two_speeds_tells_a_lag_from_a_load():
    found_s = driven(LagEstimator(), 0.03, 40.0, 120.0, seconds=4.0, load_deg=3.0)
    assert found_s == pytest.approx(0.03, rel=0.05)


def test_what_was_found_counts_a_third_after_so_much_motion():
    lag = LagEstimator()
    driven(lag, 0.04, -100.0, 100.0, seconds=20.0)
    assert driven(lag, 0.0, -100.0, 100.0, seconds=MEMORY_S) == pytest.approx(0.04 / 2.72, rel=0.05)


def test_creeping_for_a_minute_forgets_little():
    lag = swung(0.03)
    assert driven(lag, 0.03, -2.0, 2.0, seconds=60.0) == pytest.approx(0.03, rel=0.1)


# ---- hearing

UNIT_DEG, LOOP_S = 0.1, 0.005
MOVES = ((0.0, 30.0, 0.5), (0.4, -20.0, 0.6), (0.7, 40.0, 0.8))


def profile_of(*moves):
    profile = Profile(0.0, ramp_deg_s2=800.0, speed_max_deg_s=200.0, response=Response())
    for arrival_s, target_deg, duration_s in moves:
        profile.retarget(arrival_s, target_deg, duration_s)
    return profile


def judged(received, *, until_s=1.6, noise=lambda time_s: 0.0, hz=100.0):
    """Return when a horn on the course of `received` is found on another, and that course.

    All of `MOVES` were sent.
    """
    truth, said, lost_moves, commanded = (
        profile_of(*received),
        profile_of(),
        LostMoveDetector(UNIT_DEG, LOOP_S),
        0,
    )
    time_s = 0.0
    while time_s < until_s:
        while commanded < len(MOVES) and MOVES[commanded][0] <= time_s:
            lost_moves.commanded(said.copy(), *MOVES[commanded])
            said.retarget(*MOVES[commanded])
            commanded += 1
        measured_deg = truth.at(time_s)[0] + noise(time_s)
        found = lost_moves.judge(time_s, said.at(time_s)[0], measured_deg)
        if found is not None:
            return time_s, found
        time_s += 1.0 / hz
    return None


def test_a_servo_that_received_all_moves_is_never_doubted():
    assert judged(MOVES) is None
    assert judged(MOVES, noise=lambda time_s: 0.4 if int(1000 * time_s) % 3 else -0.4) is None


@pytest.mark.parametrize("missed", [0, 1, 2])
def test_the_move_that_was_missed_is_known_soon_after_the_courses_part(missed):
    received = [one for index, one in enumerate(MOVES) if index != missed]
    time_s, found = judged(received)
    truth, said = profile_of(*received), profile_of(*MOVES)
    parted_s = next(
        t / 1000 for t in range(1600) if abs(truth.at(t / 1000)[0] - said.at(t / 1000)[0]) > 1.0
    )
    assert parted_s < time_s < parted_s + 0.12
    if missed == len(MOVES) - 1 or MOVES[missed + 1][0] > time_s:
        received = [one for one in received if one[0] <= time_s]
    assert found.at(time_s)[0] == pytest.approx(profile_of(*received).at(time_s)[0], abs=1e-9)


def test_one_wrong_reading_is_no_proof():
    """A damaged number that lies on the course without the last move."""
    alone, said = profile_of(*MOVES[:2]), profile_of(*MOVES)

    def noise(time_s):
        return alone.at(time_s)[0] - said.at(time_s)[0] if round(100 * time_s) == 100 else 0.0

    assert abs(noise(1.0)) > 3.0
    assert judged(MOVES, noise=noise) is None


def test_a_horn_that_is_held_up_has_not_missed_anything():
    """It stands where neither course leads."""
    lost_moves, said = LostMoveDetector(UNIT_DEG, LOOP_S), profile_of()
    for one in MOVES:
        lost_moves.commanded(said.copy(), *one)
        said.retarget(*one)
    assert not lost_moves.is_doubtful
    for step in range(100):
        assert lost_moves.judge(0.8 + step / 100, said.at(0.8 + step / 100)[0], 90.0) is None
        assert not lost_moves.is_doubtful


def standing(deg):
    return Profile(deg, ramp_deg_s2=800.0, speed_max_deg_s=200.0, response=Response())


def doubting(*others_deg):
    """Return the detector of a servo that may as well stand at one of `others_deg`."""
    others = [Alternative(standing(deg)) for deg in others_deg]
    return LostMoveDetector(UNIT_DEG, LOOP_S, alternatives=others)


@pytest.mark.parametrize(
    ("expected_deg", "others_deg", "free_deg", "found_deg"),
    [
        pytest.param(20.0, (5.0, 0.0, -9.0), 0.2, 0.0, id="the nearest of several"),
        pytest.param(20.0, (0.0,), 3.0, 0.0, id="a weak motor, far from its own course"),
        pytest.param(0.0, (2.15,), 1.6, 2.15, id="a little off, near its own course"),
        pytest.param(0.0, (1.4,), 0.9, None, id="between two courses that have hardly parted"),
        pytest.param(0.0, (3.4,), 2.5, None, id="off both, near its own course"),
        pytest.param(20.0, (0.0,), 9.0, None, id="off both, far from its own course"),
    ],
)
def test_a_horn_that_stays_near_another_course_is_on_it(
    expected_deg, others_deg, free_deg, found_deg
):
    lost_moves = doubting(*others_deg)
    assert lost_moves.judge(1.0, expected_deg, free_deg) is None, "one reading is no proof"
    assert lost_moves.is_doubtful is (found_deg is not None)
    found = lost_moves.judge(1.0 + 2.0 * SURE_S, expected_deg, free_deg)
    assert (found and found.at(1.1)[0]) == found_deg
    assert not (found and lost_moves.alternatives), "what it is on is known, and doubted no more"


def test_a_horn_that_crosses_another_course_twice_is_not_on_it():
    lost_moves = doubting(0.0)
    for number, free_deg in enumerate((0.0, 9.0, 0.0)):
        assert lost_moves.judge(1.0 + number * SURE_S, 20.0, free_deg) is None
    assert lost_moves.judge(1.0 + 4 * SURE_S, 20.0, 0.0) is not None


def test_a_course_that_a_reading_has_refuted_is_out():
    lost_moves = doubting(0.0)
    lost_moves.judge(1.0, 20.0, 20.0)
    for number in range(1, 5):
        assert lost_moves.judge(1.0 + number * SURE_S, 20.0, 0.0) is None
        assert not lost_moves.is_doubtful


def test_what_spoke_for_a_course_before_a_move_is_no_proof_after_it():
    lost_moves = doubting(0.0)
    lost_moves.judge(1.0, 20.0, 0.0)
    lost_moves.commanded(standing(20.0), 1.0, 1.0, 1.0)
    assert lost_moves.judge(1.0 + 2.0 * SURE_S, 20.0, 0.0) is None
    assert lost_moves.judge(1.0 + 4.0 * SURE_S, 20.0, 0.0) is not None


def test_the_oldest_of_many_moves_counts_as_received():
    lost_moves = LostMoveDetector(UNIT_DEG, LOOP_S)
    for number in range(2 * OTHERS_MAX):
        lost_moves.commanded(standing(float(number)), 0.1 * number, 50.0, 1.0)
    begins_deg = [other.profile.at(0.0)[0] for other in lost_moves.alternatives]
    assert begins_deg == [float(number) for number in range(OTHERS_MAX, 2 * OTHERS_MAX)]


@pytest.fixture
def commanded():
    """Return detector and profile after all `MOVES`, the last of them at 0.7 s."""
    lost_moves, said = LostMoveDetector(UNIT_DEG, LOOP_S), profile_of()
    for one in MOVES:
        lost_moves.commanded(said.copy(), *one)
        said.retarget(*one)
    return lost_moves, said


def test_a_servo_that_names_the_target_before_has_missed_the_last_move(commanded):
    lost_moves, _ = commanded
    found = lost_moves.target_reported(0.72, -20.0)
    assert found.at(1.2) == profile_of(*MOVES[:2]).at(1.2)
    assert not lost_moves.alternatives


@pytest.mark.parametrize("off_deg", [-UNIT_DEG, 0.0, UNIT_DEG])
def test_a_servo_that_reports_its_target_has_received_the_last_move(commanded, off_deg):
    lost_moves, _ = commanded
    assert lost_moves.target_due_s <= 0.72
    assert lost_moves.target_reported(0.72, 40.0 + off_deg) is None
    assert lost_moves.target_due_s > 0.73
    # Without one of the moves before the last it would have the same target.
    assert len(lost_moves.alternatives) == 2
    assert all(other.profile.target_deg == 40.0 for other in lost_moves.alternatives)


def test_before_a_servo_starts_a_move_its_reported_target_is_ignored(commanded):
    lost_moves, _ = commanded
    assert lost_moves.target_due_s > 0.701
    assert lost_moves.target_reported(0.701, -20.0) is None
    assert len(lost_moves.alternatives) == 3


def test_a_target_that_was_never_sent_must_be_reported_twice(commanded):
    """The command may have been damaged, or the answer."""
    lost_moves, _ = commanded
    assert lost_moves.target_reported(0.72, 33.0) is None
    assert lost_moves.target_reported(0.73, -7.0) is None
    found = lost_moves.target_reported(0.74, -7.0)
    assert found.at(2.5)[0] == -7.0
    assert found.at(0.7) == profile_of(*MOVES[:2]).at(0.7)


def test_a_servo_that_does_not_answer_is_left_to_the_readings(commanded):
    lost_moves, _ = commanded
    for _ in range(QUERIES_MAX):
        assert lost_moves.target_due_s <= 0.72
        lost_moves.count_target_query()
    assert lost_moves.target_due_s > 0.72


def test_a_servo_that_always_reports_other_targets_is_not_polled_for_ever():
    lost_moves, said = LostMoveDetector(UNIT_DEG, LOOP_S), profile_of()
    for number in range(MISMATCHES_MAX + 1):
        lost_moves.commanded(said.copy(), 0.1 * number, 10.0 + number, 0.2)
        assert (lost_moves.target_due_s <= 0.1 * number + 0.02) is (number < MISMATCHES_MAX)
        lost_moves.target_reported(0.1 * number + 0.02, -50.0)


def test_a_servo_that_reported_its_target_in_between_is_polled_on():
    lost_moves = LostMoveDetector(UNIT_DEG, LOOP_S)
    for number in range(2 * MISMATCHES_MAX):
        lost_moves.commanded(standing(0.0), 0.1 * number, 10.0 + number, 0.2)
        assert lost_moves.target_due_s <= 0.1 * number + 0.02
        is_named = number == MISMATCHES_MAX - 1
        lost_moves.target_reported(0.1 * number + 0.02, 10.0 + number if is_named else -50.0)


def test_a_target_two_units_off_is_another_one(commanded):
    lost_moves, said = commanded
    assert lost_moves.target_reported(0.72, 40.0 + 2.0 * UNIT_DEG) is None
    assert lost_moves.target_due_s <= 0.73
    lost_moves.commanded(said.copy(), 0.9, 40.0 - 2.0 * UNIT_DEG, 0.3)
    assert lost_moves.target_due_s <= 1.0


def test_a_move_to_the_same_target_needs_no_query(commanded):
    lost_moves, said = commanded
    lost_moves.commanded(said.copy(), 0.9, 40.0, 0.3)
    assert lost_moves.target_due_s > 1.0
