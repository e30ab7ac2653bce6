"""Tests of `playing.player.estimators`.

What a horn lacks: load, play and lag told apart, and none of it learnt from what explains nothing.
What is corrected at rest, and what is not.
Which way a joint turns, and whether its horn may stand within the play of its gears.
"""

from __future__ import annotations

import math
from itertools import pairwise
from random import Random

import numpy as np
import pytest

from lss_motion.playing.player.estimators import (
    JUMP_MARGIN_DEG,
    LAG_MAX_S,
    OFFSET_MAX_DEG,
    UNSEEN_DEG,
    DisturbanceEstimator,
    HornEstimator,
    Swing,
)
from lss_motion.playing.player.standing import (
    ATTEMPTS_MAX,
    PLAY_MAX_DEG,
    PUSH_S,
    READINGS_LEAST,
    STANDING_DEG,
    PushDetector,
    StandingCorrector,
)

# ---- readings


def read(disturbance, measured_deg, read_s, *, expected_deg=0.0, planned_deg=None):
    planned_deg = expected_deg if planned_deg is None else planned_deg
    elapsed_s = disturbance.take(
        measured_deg, read_s, expected_deg=expected_deg, planned_deg=planned_deg
    )
    return elapsed_s is not None


def settled(**fields) -> DisturbanceEstimator:
    disturbance = DisturbanceEstimator(speed_max_deg_s=100.0, **fields)
    for step in range(5):
        assert read(disturbance, 0.0, 0.02 * step)
    return disturbance


def test_one_wild_reading_is_rejected():
    disturbance = settled()
    assert not read(disturbance, 70.0, 0.1)
    assert (disturbance.measured_deg, disturbance.rejected) == (0.0, 1)
    assert disturbance.error_max_deg == 0.0
    assert read(disturbance, 0.1, 0.12)


def test_two_readings_that_agree_are_believed():
    disturbance = settled()
    assert not read(disturbance, 70.0, 0.1)
    assert read(disturbance, 70.5, 0.12)
    assert disturbance.measured_deg == 70.5


def test_two_wild_readings_that_disagree_are_not():
    disturbance = settled()
    angles = enumerate([70, -60, 50])
    believed = [read(disturbance, deg, 0.1 + step / 50) for step, deg in angles]
    assert believed == [False] * 3


def test_a_wild_first_reading_is_rejected_where_the_horn_stood_before_is_known():
    disturbance = DisturbanceEstimator(speed_max_deg_s=100.0, standing_deg=0.0)
    assert not read(disturbance, 70.0, 0.0)
    assert read(disturbance, 0.2, 0.02) is False, "the two do not agree"
    assert read(disturbance, 0.2, 0.04)
    assert disturbance.error_max_deg == pytest.approx(0.2)


def test_the_reach_is_what_the_speed_allows_since_then_and_a_margin_no_more():
    for far_deg, is_believed in ((10.0 + JUMP_MARGIN_DEG, True), (10.1 + JUMP_MARGIN_DEG, False)):
        disturbance = DisturbanceEstimator(speed_max_deg_s=100.0)
        read(disturbance, 0.0, 50.0)
        assert read(disturbance, far_deg, 50.1) is is_believed


def test_errors_are_summed_up_with_their_sign_kept():
    disturbance = settled()
    read(disturbance, 3.0, 0.1)
    assert disturbance.error_deg == -3.0
    read(disturbance, -4.0, 0.3)
    assert (disturbance.error_deg, disturbance.error_max_deg) == (4.0, 4.0)
    assert disturbance.error_rms_deg == pytest.approx((25.0 / 7.0) ** 0.5)
    read(disturbance, 3.0, 0.4, expected_deg=3.5, planned_deg=5.0)
    assert (disturbance.error_deg, disturbance.model_error_deg) == (2.0, 0.5)
    unread = DisturbanceEstimator(speed_max_deg_s=1.0)
    assert unread.error_deg == unread.error_max_deg == unread.error_rms_deg == 0.0


def test_a_horn_that_was_set_down_elsewhere_is_read_anew_and_what_was_learnt_is_kept():
    disturbance = settled()
    disturbance.horn.rest(1.5, 0.0)
    disturbance.aim(0.0, 0.0, math.inf)
    learnt_deg = disturbance.offset_deg
    disturbance.stand_at(60.0)
    assert (disturbance.measured_deg, disturbance.read_s) == (None, None)
    assert disturbance.standing_deg == 60.0
    assert read(disturbance, 60.2, 1.0, expected_deg=61.2)
    assert disturbance.offset_deg == learnt_deg > 1.4
    disturbance.stand_at(-60.0)
    assert not read(disturbance, 60.2, 1.1), "nothing stands there"
    disturbance.stand_at(10.0)
    assert read(disturbance, 10.1, 1.2), "and what was wild before is no witness"


def test_a_wild_reading_is_no_witness_once_another_was_believed():
    disturbance = settled()
    assert not read(disturbance, 70.0, 0.1)
    assert read(disturbance, 0.0, 0.12)
    assert not read(disturbance, 70.0, 0.14)


# ---- corrections


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_correction_goes_no_further_and_no_faster_than_it_may(sign):
    disturbance = settled()
    disturbance.horn.rest(sign * 3.0 * OFFSET_MAX_DEG, 0.0)
    disturbance.aim(0.0, 0.0, 0.5)
    assert disturbance.offset_deg == sign * 0.5
    disturbance.aim(0.0, 0.0, math.inf)
    assert disturbance.offset_deg == sign * OFFSET_MAX_DEG
    assert disturbance.offset_max_deg == OFFSET_MAX_DEG


def test_in_em0_one_correction_is_no_more_than_a_step_allows():
    disturbance = settled(step_max_deg=0.2)
    disturbance.horn.rest(2.0, 0.0)
    disturbance.aim(0.0, 0.0, math.inf)
    assert disturbance.offset_deg == 0.2


# ---- load, play and lag

HZ = 15.0
"""Readings of a joint a second, as the player asks for them."""


def swung(
    *, lag_s=0.0, load_deg=0.0, play_deg=0.0, noise_deg=0.1, seconds=8.0, swing_deg=30.0,
    error=lambda angle_deg, speed_deg_s: 0.0,
):  # fmt: skip
    """Return what is learnt of a horn that swings once in a second and a half."""
    random, horn, rate = Random(1), HornEstimator(), 2.0 * math.pi / 1.5
    for time_s in np.arange(0.0, seconds, 1.0 / HZ).tolist():
        late_s = time_s - horn.lag_s
        plain, lagged = (swing_deg * math.sin(rate * at_s) for at_s in (time_s, late_s))
        speed = swing_deg * rate * math.cos(rate * late_s)
        then = swing_deg * math.sin(rate * (time_s - lag_s))
        way = math.copysign(1.0, math.cos(rate * late_s))
        load = load_deg * math.cos(math.radians(then)) + 0.5 * play_deg * way
        scatter = random.uniform(-noise_deg, noise_deg) - error(then, speed)
        horn.take(then - load + scatter, (plain, lagged, speed, swing_deg * rate), way, 1.0 / HZ)
    return horn


@pytest.mark.parametrize("lag_s", [-0.01, 0.0, 0.03, 0.05])
@pytest.mark.parametrize("load_deg", [0.0, 3.0, 6.0])
def test_lag_and_load_are_told_apart(lag_s, load_deg):
    horn = swung(lag_s=lag_s, load_deg=load_deg)
    assert horn.lag_s == pytest.approx(lag_s, abs=0.004)
    assert horn.load_deg(0.0, 0.0) == pytest.approx(load_deg, abs=0.25)
    assert horn.load_deg(30.0, 0.0) == pytest.approx(load_deg * math.cos(math.pi / 6), abs=0.4)


def test_a_lag_as_assumed_moves_nothing_and_a_clear_one_all_of_it():
    assert swung().early_s == 0.0
    assert swung(lag_s=0.03).early_s == pytest.approx(0.03, abs=0.004)


def test_no_lag_is_corrected_beyond_its_bound():
    assert swung(lag_s=0.2).lag_s == LAG_MAX_S
    assert swung(lag_s=-0.2).lag_s == -LAG_MAX_S


def test_errors_that_a_lag_does_not_explain_send_nothing_earlier():
    """A motor too weak for the fast half of a swing to one side, for one."""
    weak = swung(error=lambda angle_deg, speed_deg_s: 8.0 if angle_deg > 20.0 else 0.0)
    assert weak.explained_ratio < 0.3
    assert weak.early_s == 0.0


def test_a_lag_beside_errors_that_it_does_not_explain_is_corrected_less():
    """By the share that it explains, and by what is left: 3.5 deg in motion, or 28 ms."""
    horn = swung(lag_s=0.058, error=lambda angle_deg, speed_deg_s: 5.0 * math.sin(angle_deg))
    assert (0.3 < horn.explained_ratio < 0.6, 0.0 < horn.model_ratio < 0.7) == (True, True)
    assert 0.0 < horn.early_s < 0.6 * horn.lag_s
    assert swung(lag_s=0.058).early_s > 0.95 * horn.lag_s


def test_the_scatter_of_readings_in_slow_motion_is_no_wrong_model():
    """Half a degree at 12 deg/s would be 24 ms."""
    assert swung(swing_deg=3.0, noise_deg=0.5, seconds=20.0).model_ratio == 1.0


def resting(horn, load_deg, *, seconds, angle_deg=0.0, noise_deg=0.1, random=None):
    random = random or Random(2)
    before = None
    for _ in range(round(HZ * seconds)):
        measured = angle_deg - load_deg + random.uniform(-noise_deg, noise_deg)
        horn.take(measured, (angle_deg, angle_deg, 0.0, 0.0), 0.0, 1.0 / HZ)
        if before is not None:
            horn.note_scatter(measured - before, 1.0 / HZ)
        before = measured
    return horn


def test_a_load_at_rest_is_learnt_and_a_new_one_within_two_seconds_once_the_old_is_doubted():
    horn = resting(HornEstimator(), 1.5, seconds=1.0)
    assert horn.correction_deg(0.0, 0.0) == pytest.approx(1.5, abs=0.1)
    horn.doubt()
    assert resting(horn, 4.0, seconds=2.0).load_deg(0.0, 0.0) == pytest.approx(4.0, abs=0.3)


def test_scatter_moves_no_correction():
    """Readings that scatter by half a degree: their first mean is off by more than that."""
    for seed in range(20):
        horn = resting(HornEstimator(), 0.0, seconds=4.0, noise_deg=0.5, random=Random(seed))
        assert abs(horn.correction_deg(0.0, 0.0)) < 0.1
        assert math.sqrt(horn.noise_deg2) == pytest.approx(0.29, abs=0.1)


def test_one_strange_reading_counts_little():
    horn = resting(HornEstimator(), 1.0, seconds=2.0)
    horn.take(-7.0, (0.0, 0.0, 0.0, 0.0), 0.0, 1.0 / HZ)
    assert horn.load_deg(0.0, 0.0) == pytest.approx(1.0, abs=0.1)


def test_errors_by_timing_say_little_about_the_load():
    """What is wrong in fast motion must not be corrected at rest."""
    horn = swung(error=lambda angle_deg, speed_deg_s: 4.0 if speed_deg_s > 60.0 else 0.0)
    resting(horn, 0.0, seconds=1.0)
    assert abs(horn.correction_deg(0.0, 0.0)) < 0.3


def test_the_play_of_the_gears_shows_on_either_way():
    horn = swung(play_deg=1.5)
    assert horn.load_deg(0.0, 1.0) == pytest.approx(0.75, abs=0.3)
    assert horn.load_deg(0.0, -1.0) == pytest.approx(-0.75, abs=0.3)


@pytest.mark.parametrize(
    ("without_deg", "effect_deg", "worth"),
    [
        pytest.param(2.0, 2.0, 1.0, id="it takes all of the error away"),
        pytest.param(1.0, 2.0, 0.0, id="as much is left, on the other side"),
        pytest.param(1.6, 2.0, 0.6, id="in between"),
        pytest.param(1.2, -4.0, 0.0, id="it went wrong: the joint had no acceleration to spare"),
        pytest.param(3.0, 0.0, 1.0, id="nothing was corrected"),
    ],
)
def test_corrections_are_used_as_far_as_they_help(without_deg, effect_deg, worth):
    horn = HornEstimator()
    for _ in range(200):
        horn.judge_effect(without_deg, effect_deg, 0.1)
    assert horn.worth_ratio == pytest.approx(worth, abs=0.05)


def test_a_correction_that_goes_wrong_is_dropped_at_once():
    horn = HornEstimator()
    for _ in range(60):
        horn.judge_effect(1.2, 1.2, 0.1)
    for _ in range(10):
        horn.judge_effect(1.2, -4.0, 0.05)
    assert horn.worth_ratio < 0.3


def moved_once(horn, behind_deg):
    """Let a joint that rests at 0 make a quick move, with its horn so far behind in motion."""
    for _ in range(10):
        horn.take(0.0, (0.0, 0.0, 0.0, 0.0), 0.0, 0.1)
    for step in range(1, 11):
        deg = 4.0 * step
        horn.take(deg - behind_deg * step / 10.0, (deg, deg, 80.0, 80.0), 1.0, 0.05)
    return horn.correction_deg(40.0, 1.0)


def test_what_a_first_quick_move_lacks_is_hardly_corrected_as_a_load():
    horn = HornEstimator()
    correction_deg = moved_once(horn, 8.0)
    assert horn.load_deg(40.0, 1.0) > 1.5
    assert 0.0 < correction_deg <= UNSEEN_DEG + 1e-9


def test_a_load_that_was_seen_at_rest_is_corrected_in_motion_at_once():
    horn = HornEstimator()
    for _ in range(10):
        horn.take(-3.0, (0.0, 0.0, 0.0, 0.0), 0.0, 0.1)
    assert horn.correction_deg(10.0, 1.0) > 2.0


def test_a_load_is_not_corrected_in_motion_where_the_model_is_wrong():
    right = swung(load_deg=3.0)
    assert right.model_ratio == 1.0
    wrong = swung(error=lambda angle_deg, speed_deg_s: 20.0 if speed_deg_s > 60.0 else 0.0)
    assert wrong.model_ratio == wrong.worth_ratio == 0.0


def test_a_model_that_explains_nothing_is_a_finding_and_a_right_one_none():
    assert swung().finding == swung(lag_s=0.03, load_deg=3.0).finding == ""
    assert "it lags 6" in swung(lag_s=0.065).finding
    wrong = swung(error=lambda angle_deg, speed_deg_s: 20.0 if speed_deg_s > 60.0 else 0.0)
    assert "neither load nor lag explains that" in wrong.finding


# ---- at rest


class Rest:
    """A horn that rests; `horn_deg` is where it is for a correction, with no plan but 0."""

    def __init__(self, horn_deg, *, noise_deg=0.05, is_modelled=True):
        self.is_modelled = is_modelled
        self.corrector, self.horn_deg, self.noise_deg = StandingCorrector(), horn_deg, noise_deg
        self.push, self.moved_s = PushDetector(), -1.0
        self.offset_deg, self.now_s, self.sent = 0.0, 0.0, []

    def read(self, count):
        for _ in range(count):
            self.now_s += 1.0 / HZ
            at_deg = self.horn_deg(self.offset_deg)
            off_deg = at_deg - self.offset_deg
            play_deg = PLAY_MAX_DEG if self.now_s < self.moved_s + 0.3 else 0.0
            self.push.take(off_deg, 0.0, self.now_s, self.noise_deg, (-play_deg, play_deg))
            self.corrector.take(-at_deg, self.now_s, self.noise_deg)
            if self.push.is_pushed:
                continue
            offset_deg = self.corrector.next_offset_deg(
                self.offset_deg, self.now_s, self.noise_deg, is_modelled=self.is_modelled
            )
            if offset_deg is not None:
                self.offset_deg = offset_deg
                self.moved_s = self.now_s
                self.sent.append(round(offset_deg, 3))
                self.corrector.await_rest()
        return self


def test_one_correction_brings_a_horn_to_its_plan():
    rest = Rest(lambda offset_deg: offset_deg - 1.2).read(30)
    assert rest.sent == [1.2]


def test_within_the_deadband_nothing_is_sent():
    assert Rest(lambda offset_deg: 0.99 * STANDING_DEG).read(50).sent == []


def test_few_readings_are_no_reason():
    assert Rest(lambda offset_deg: -1.2).read(READINGS_LEAST - 1).sent == []


def test_what_does_not_help_is_taken_back_and_the_rest_left_alone():
    rest = Rest(lambda offset_deg: -1.0).read(200)
    assert rest.sent == [1.0, 3.0, 4.0, 5.0, 0.0][-(ATTEMPTS_MAX + 1) :]
    assert rest.offset_deg == 0.0
    rest.corrector.begin()
    assert rest.read(READINGS_LEAST).sent[-1] == 1.0, "the next rest is another one"


def test_play_takes_up_the_first_corrections():
    rest = Rest(lambda offset_deg: -0.6 + max(0.0, offset_deg - 1.0)).read(100)
    assert rest.sent[-1] == pytest.approx(1.6, abs=STANDING_DEG)
    assert abs(rest.horn_deg(rest.offset_deg)) <= STANDING_DEG


def test_without_a_load_two_corrections_are_enough_for_play():
    """The horn stands at one end of a play of 1.5 deg, and comes from the other."""
    rest = Rest(lambda offset_deg: -0.75 + max(0.0, offset_deg - 1.5)).read(60)
    assert rest.sent == [0.75, 2.25]


def test_play_of_which_a_move_corrected_too_much_needs_no_more():
    """The horn lies on the upper end of the play, and must come to the lower one."""
    rest = Rest(lambda offset_deg: max(-0.28, offset_deg - 0.75))
    rest.offset_deg = -1.03
    assert rest.read(60).sent == [-0.75, 0.75]


def test_readings_that_scatter_tell_that_play_took_a_correction_up():
    """No two rests of readings have the same mean; a tenth of a small error is less than that."""
    random = np.random.default_rng(2)

    def shaft(offset_deg):
        return max(-0.38, offset_deg - 0.9)

    for _ in range(20):
        rest = Rest(None, noise_deg=0.06)
        rest.horn_deg = lambda offset_deg: shaft(offset_deg) + random.normal(0.0, 0.06)
        rest.offset_deg = -1.05
        rest.read(40)
        assert abs(shaft(rest.offset_deg)) < 0.2
        assert len(rest.sent) <= 4


def test_a_small_error_takes_no_play_up_at_once():
    """A load makes the rest without corrections look like much play."""
    rest = Rest(lambda offset_deg: -0.2)
    rest.offset_deg = 2.5
    rest.read(200)
    assert max(rest.sent) < 2.5 + ATTEMPTS_MAX * 0.25
    assert rest.offset_deg == 2.5


def test_more_play_than_gears_have_is_not_taken_up_at_once():
    rest = Rest(lambda offset_deg: -0.3)
    rest.offset_deg = -3.0
    rest.read(60)
    assert max(abs(b - a) for a, b in pairwise([-3.0, *rest.sent[:3]])) == PLAY_MAX_DEG


def test_with_a_wrong_model_a_horn_that_turns_round_does_not_rest():
    """Its ramps are a tenth of those assumed: 100 deg/s2, while its model rests."""
    for is_modelled in (True, False):
        rest = Rest(None, noise_deg=0.4, is_modelled=is_modelled)
        rest.horn_deg = lambda _, rest=rest: 3.0 - 50.0 * (rest.now_s - 0.2) ** 2
        rest.read(int(0.4 * HZ))
        assert (rest.sent == []) is not is_modelled


def test_a_push_is_forgotten():
    rest = Rest(lambda offset_deg: 0.0).read(10)
    rest.horn_deg = lambda offset_deg: 6.0
    rest.read(7)
    assert rest.push.is_pushed
    rest.horn_deg = lambda offset_deg: 0.0
    rest.read(20)
    assert (rest.sent, rest.push.is_pushed) == ([], False)


def test_what_pushes_for_long_is_a_load():
    rest = Rest(lambda offset_deg: 0.0).read(10)
    rest.horn_deg = lambda offset_deg: offset_deg - 3.0
    rest.read(round(HZ * PUSH_S))
    assert rest.sent == []
    rest.read(4)
    assert rest.sent == [3.0]


def test_a_horn_on_its_way_is_neither_pushed_nor_corrected():
    rest = Rest(lambda offset_deg: 0.0)
    rest.horn_deg = lambda offset_deg: -3.0 * math.exp(-2.0 * rest.now_s)
    rest.read(9)
    assert (rest.sent, rest.push.is_pushed) == ([], False)


# ---- pushes


def pushes(offs_deg, *, load_deg=0.0, free_deg=(0.0, 0.0), noise_deg=0.05, step_s=0.05):
    """Return at which of these readings a horn counts as pushed."""
    push = PushDetector()
    found = []
    for index, off_deg in enumerate(offs_deg):
        push.take(off_deg, load_deg, step_s * index, noise_deg, free_deg)
        found.append(push.is_pushed)
    return found


def test_a_push_counts_from_its_first_reading_on_until_the_horn_is_let_go():
    assert pushes([0.1, 0.0, -3.6, -3.7, -3.7, -1.0, -0.2]) == [0, 0, 1, 1, 1, 1, 0]
    assert pushes([-3.0, -3.0, -6.0, -6.1, -3.1, -3.0]) == [0, 0, 1, 1, 1, 0], "and a load pulls it"


def test_a_horn_that_was_let_go_is_not_back_at_the_first_reading_on_its_way():
    assert pushes([0.0, -4.4, -4.4, -2.2, 0.0]) == [0, 1, 1, 1, 0]


def test_a_push_that_grows_over_some_readings_is_one():
    assert pushes([0.0, 0.3, 0.7, 1.2, 1.8])[-1] == 1


def test_a_horn_that_comes_to_its_course_is_not_pushed():
    assert not any(pushes([-5.0, -5.0, -2.0, 0.0, 0.0]))


def test_nor_is_one_whose_load_was_taken_for_larger_than_it_is():
    """It comes to its profile, which is 5 deg off where its load should hold it."""
    assert not any(pushes([0.0, 0.0, 4.9, 5.0], load_deg=5.0))
    assert pushes([0.0, 0.0, -4.9, -5.0], load_deg=5.0)[-1] == 1


def test_in_motion_a_horn_may_be_late_and_on_either_side_of_its_play():
    assert not any(pushes([0.0, 0.0, -4.0, -4.0], free_deg=(-4.0, 1.0)))
    assert pushes([0.0, 0.0, 4.0, 4.0], free_deg=(-4.0, 1.0))[-1] == 1


def test_a_horn_that_is_pushed_is_not_back_while_its_motion_would_explain_some_of_it():
    push = PushDetector()
    for index, (off_deg, free_deg) in enumerate([(0.0, 0.0), (6.5, 0.0), (6.5, 7.0), (4.0, 7.0)]):
        push.take(off_deg, 0.0, 0.05 * index, 0.05, (-free_deg, free_deg))
    assert push.is_pushed


# ---- which way it turns, and whether within its play


def swing_over(*profile_deg):
    swing = Swing()
    for one_deg in profile_deg:
        swing.take(one_deg)
    return swing


@pytest.mark.parametrize(
    ("profile_deg", "way"),
    [
        ((), 0.0),
        ((0.4,), 0.0),
        ((0.6,), 1.0),
        ((2.0, 1.6), 1.0),
        ((2.0, 1.4), -1.0),
        ((0.6, 0.9, 1.2, 0.8), 1.0),
        ((0.6, 0.9, 1.2, 0.6), -1.0),
    ],
)
def test_a_profile_turns_round_where_it_comes_back_by_half_a_degree(profile_deg, way) -> None:
    assert swing_over(*profile_deg).way == way


@pytest.mark.parametrize(
    ("profile_deg", "half_play_deg", "share"),
    [
        ((20.0, 22.0, 20.0, 22.0), 0.0, 1.0),
        ((20.0, 22.0, 20.0, 22.0), 0.5, 0.0),
        ((20.0, 23.0, 20.0, 23.0), 0.5, 0.5),
        ((20.0, 24.0, 20.0, 24.0), 0.5, 1.0),
        ((20.0, 22.0, 20.0, 30.0), 0.5, 1.0),
        ((20.0, 30.0, 29.0), 0.5, 1.0),
        ((20.0, 30.0, 29.0, 30.0, 29.0), 0.5, 0.0),
    ],
)
def test_little_is_corrected_in_swings_of_about_the_play(profile_deg, half_play_deg, share) -> None:
    """The swing before the one under way counts, too: a reversal that just began is no swing."""
    assert swing_over(*profile_deg).share(half_play_deg) == pytest.approx(share)


def test_a_move_has_the_direction_of_its_way() -> None:
    assert swing_over(5.0, 2.0).way_of(10.2) == 1.0
    assert Swing().way_of(-10.2) == -1.0


def test_a_move_of_next_to_nothing_keeps_the_way_before() -> None:
    swing = swing_over(5.0, 2.0)
    assert swing.way_of(0.3) == -1.0
