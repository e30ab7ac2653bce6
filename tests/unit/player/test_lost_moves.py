"""Which of the last moves a servo has missed, by its horn."""

from __future__ import annotations

import math

import pytest

from lss_motion.playing.player.servo_model import (
    MISMATCHES_MAX,
    OTHERS_MAX,
    PROMPT_LEAST,
    QUERIES_MAX,
    SURE_S,
    Alternative,
    LostMoveDetector,
)
from lss_motion.robot.model import Response
from lss_motion.robot.profile import Profile

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
        expected_deg, speed_deg_s = said.at(time_s)
        found = lost_moves.judge(time_s, expected_deg, measured_deg, speed_deg_s)
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
    lost_moves, said = LostMoveDetector(UNIT_DEG, LOOP_S, prompt=PROMPT_LEAST), profile_of()
    for one in MOVES:
        lost_moves.commanded(said.copy(), *one)
        said.retarget(*one)
    assert not lost_moves.is_doubtful
    for step in range(100):
        at_s = 0.8 + step / 100
        expected_deg, speed_deg_s = said.at(at_s)
        assert lost_moves.judge(at_s, expected_deg, 90.0, speed_deg_s) is None
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
    assert lost_moves.judge(1.0, expected_deg, free_deg, 0.0) is None, "one reading is no proof"
    assert lost_moves.is_doubtful is (found_deg is not None)
    found = lost_moves.judge(1.0 + 2.0 * SURE_S, expected_deg, free_deg, 0.0)
    assert (found and found.at(1.1)[0]) == found_deg
    assert not (found and lost_moves.alternatives), "what it is on is known, and doubted no more"


def test_what_one_control_tick_makes_of_a_fast_move_is_no_other_course():
    """At 300 deg/s a horn may be 1.5 deg behind and have received all moves."""
    lost_moves = doubting(2.15)
    for number in range(5):
        assert lost_moves.judge(1.0 + number * SURE_S, 0.0, 1.6, 300.0) is None
        assert not lost_moves.is_doubtful
    lost_moves = doubting(3.0)
    lost_moves.judge(1.0, 0.0, 2.8, 300.0)
    assert lost_moves.is_doubtful, "but further off it is"


def test_a_horn_that_crosses_another_course_twice_is_not_on_it():
    lost_moves = doubting(0.0)
    for number, free_deg in enumerate((0.0, 9.0, 0.0)):
        assert lost_moves.judge(1.0 + number * SURE_S, 20.0, free_deg, 0.0) is None
    assert lost_moves.judge(1.0 + 4 * SURE_S, 20.0, 0.0, 0.0) is not None


def test_a_course_that_a_reading_has_refuted_is_out():
    lost_moves = doubting(0.0)
    lost_moves.judge(1.0, 20.0, 20.0, 0.0)
    for number in range(1, 5):
        assert lost_moves.judge(1.0 + number * SURE_S, 20.0, 0.0, 0.0) is None
        assert not lost_moves.is_doubtful


def test_what_spoke_for_a_course_before_a_move_is_no_proof_after_it():
    lost_moves = doubting(0.0)
    lost_moves.judge(1.0, 20.0, 0.0, 0.0)
    lost_moves.commanded(standing(20.0), 1.0, 1.0, 1.0)
    assert lost_moves.judge(1.0 + 2.0 * SURE_S, 20.0, 0.0, 0.0) is None
    assert lost_moves.judge(1.0 + 4.0 * SURE_S, 20.0, 0.0, 0.0) is not None


def test_the_oldest_of_many_moves_counts_as_received():
    lost_moves = LostMoveDetector(UNIT_DEG, LOOP_S)
    for number in range(2 * OTHERS_MAX):
        lost_moves.commanded(standing(float(number)), 0.1 * number, 50.0, 1.0)
    begins_deg = [other.profile.at(0.0)[0] for other in lost_moves.alternatives]
    assert begins_deg == [float(number) for number in range(OTHERS_MAX, 2 * OTHERS_MAX)]


@pytest.fixture
def commanded():
    """Return detector and profile after all `MOVES`, the last of them at 0.7 s."""
    lost_moves, said = LostMoveDetector(UNIT_DEG, LOOP_S, prompt=PROMPT_LEAST), profile_of()
    for one in MOVES:
        lost_moves.commanded(said.copy(), *one)
        said.retarget(*one)
    return lost_moves, said


def test_a_servo_that_names_the_target_before_twice_has_missed_the_last_move(commanded):
    lost_moves, _ = commanded
    assert lost_moves.target_reported(0.71, -20.0) is None
    assert lost_moves.target_due_ns / 1e9 < 0.7 + 0.02, "it is asked again soon"
    found = lost_moves.target_reported(0.72, -20.0)
    assert found.at(1.2) == profile_of(*MOVES[:2]).at(1.2)
    assert not lost_moves.alternatives


def test_a_servo_that_may_take_moves_up_late_is_asked_again_before_one_counts_as_lost(commanded):
    lost_moves, said = commanded
    lost_moves.prompt = 0
    assert lost_moves.target_reported(0.72, -20.0) is None
    assert 0.8 < lost_moves.target_due_ns / 1e9 < 0.85, "it has not been asked since"
    assert lost_moves.target_reported(0.83, 40.0) is None
    lost_moves.commanded(said.copy(), 0.9, 10.0, 0.3)
    assert lost_moves.target_due_ns / 1e9 > 1.0, "it reports its targets late"
    assert lost_moves.target_reported(1.03, 40.0) is None, "the first time it may be late once more"
    assert lost_moves.target_reported(1.03, 40.0) is not None


@pytest.mark.parametrize("prompt", range(PROMPT_LEAST + 1))
def test_one_that_has_taken_moves_up_at_once_three_times_is_asked_again_at_once(prompt):
    first, said = LostMoveDetector(UNIT_DEG, LOOP_S), profile_of()
    for number in range(prompt):
        first.commanded(said.copy(), 0.1 * number, 10.0 + number, 0.1)
        said.retarget(0.1 * number, 10.0 + number, 0.1)
        first.target_reported(0.1 * number + 0.02, 10.0 + number)
    lost_moves = LostMoveDetector(UNIT_DEG, LOOP_S)
    lost_moves.take_over(first)  # As after a pause.
    lost_moves.commanded(said.copy(), 0.7, 40.0, 0.8)
    lost_moves.target_reported(0.71, said.target_deg)
    found = lost_moves.target_reported(0.72, said.target_deg)
    assert (found is not None) is (prompt >= PROMPT_LEAST == 3)


def test_one_that_takes_up_some_moves_a_control_tick_later_has_missed_none(commanded):
    """With a dead time of 7 ms its tick is 7 to 12 ms after a move."""
    lost_moves, said = commanded
    assert lost_moves.target_reported(0.708, -20.0) is None
    assert lost_moves.target_reported(0.716, 40.0) is None
    lost_moves.commanded(said.copy(), 0.9, 10.0, 0.3)
    assert lost_moves.target_due_ns / 1e9 > 0.912, "and is asked no sooner from now on"


def test_one_that_is_asked_again_is_so_even_if_no_query_was_left(commanded):
    lost_moves, _ = commanded
    lost_moves.prompt = 0
    for _ in range(QUERIES_MAX):
        lost_moves.count_target_query()
    assert lost_moves.target_reported(0.72, -20.0) is None
    assert 0.8 < lost_moves.target_due_ns / 1e9 < 0.85
    lost_moves.count_target_query()
    assert lost_moves.target_due_ns / 1e9 == math.inf, "once"


@pytest.mark.parametrize("off_deg", [-UNIT_DEG, 0.0, UNIT_DEG])
def test_a_servo_that_reports_its_target_has_received_the_last_move(commanded, off_deg):
    lost_moves, _ = commanded
    assert lost_moves.target_due_ns / 1e9 <= 0.72
    assert lost_moves.target_reported(0.72, 40.0 + off_deg) is None
    assert lost_moves.target_due_ns / 1e9 > 0.73
    # Without one of the moves before the last it would have the same target.
    assert len(lost_moves.alternatives) == 2
    assert all(other.profile.target_deg == 40.0 for other in lost_moves.alternatives)


def test_before_a_servo_starts_a_move_its_reported_target_is_ignored(commanded):
    lost_moves, _ = commanded
    assert lost_moves.target_due_ns / 1e9 > 0.701
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
        assert lost_moves.target_due_ns / 1e9 <= 0.72
        lost_moves.count_target_query()
    assert lost_moves.target_due_ns / 1e9 > 0.72


def test_a_servo_that_always_reports_other_targets_is_not_polled_for_ever():
    lost_moves, said = LostMoveDetector(UNIT_DEG, LOOP_S), profile_of()
    for number in range(MISMATCHES_MAX + 1):
        lost_moves.commanded(said.copy(), 0.1 * number, 10.0 + number, 0.2)
        assert (lost_moves.target_due_ns / 1e9 <= 0.1 * number + 0.02) is (number < MISMATCHES_MAX)
        lost_moves.target_reported(0.1 * number + 0.02, -50.0)


def test_a_servo_that_reported_its_target_in_between_is_polled_on():
    lost_moves = LostMoveDetector(UNIT_DEG, LOOP_S)
    for number in range(2 * MISMATCHES_MAX):
        lost_moves.commanded(standing(0.0), 0.1 * number, 10.0 + number, 0.2)
        assert lost_moves.target_due_ns / 1e9 <= 0.1 * number + 0.02
        is_named = number == MISMATCHES_MAX - 1
        lost_moves.target_reported(0.1 * number + 0.02, 10.0 + number if is_named else -50.0)


def test_a_target_two_units_off_is_another_one(commanded):
    lost_moves, said = commanded
    assert lost_moves.target_reported(0.72, 40.0 + 2.0 * UNIT_DEG) is None
    assert lost_moves.target_due_ns / 1e9 <= 0.73
    lost_moves.commanded(said.copy(), 0.9, 40.0 - 2.0 * UNIT_DEG, 0.3)
    assert lost_moves.target_due_ns / 1e9 <= 1.0


def test_a_move_to_the_same_target_needs_no_query(commanded):
    lost_moves, said = commanded
    lost_moves.commanded(said.copy(), 0.9, 40.0, 0.3)
    assert lost_moves.target_due_ns / 1e9 > 1.0
