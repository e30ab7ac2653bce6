"""How long a servo takes to answer: learnt from its answers, and narrow enough to be of use."""

from __future__ import annotations

from random import Random

import pytest

from lss_motion.player.query_tracker import REPLY_TIMEOUT_NS, SAMPLES_LEAST, WINDOW, ReplyLatency

US = 1000


def taught(*waits_us):
    latency = ReplyLatency()
    for wait_us in waits_us:
        latency.take(wait_us * US)
    return latency


def known(latency):
    return latency.is_known, latency.earliest_ns, latency.latest_ns, latency.least_ns


@pytest.mark.parametrize("bounds_us", [(200, 1000), (300, 310), (1000, 16000)])
def test_the_next_turnaround_is_rarely_outside_of_what_was_learnt(bounds_us):
    random, outside, judged = Random(4), 0, 0
    for _ in range(200):
        latency = ReplyLatency()
        for _ in range(40):
            waited_ns = random.randint(bounds_us[0] * US, bounds_us[1] * US)
            if latency.is_known:
                judged += 1
                is_in = latency.earliest_ns <= waited_ns <= latency.latest_ns
                outside += not is_in
            latency.take(waited_ns)
        spread_ns = (bounds_us[1] - bounds_us[0]) * US
        assert latency.spread_ns <= 1.3 * spread_ns
    assert outside < 0.01 * judged


def test_before_a_few_answers_nothing_is_known():
    assert known(ReplyLatency()) == (False, 0, REPLY_TIMEOUT_NS, None)
    assert known(taught(*[400] * (SAMPLES_LEAST - 1))) == (False, 0, REPLY_TIMEOUT_NS, 400 * US)
    assert known(taught(*[400] * SAMPLES_LEAST)) == (True, 400 * US, 400 * US, 400 * US)


def test_a_servo_that_is_not_known_may_take_a_library_wait_and_the_timer_of_an_adapter():
    assert ReplyLatency().latest_ns >= 26_000 * US


def test_few_answers_leave_more_room_than_many():
    assert known(taught(*[400, 500] * 8)) == (True, 375 * US, 525 * US, 400 * US)
    assert taught(*[400, 500] * 4).spread_ns == 200 * US


def test_no_answer_begins_before_its_query_was_heard():
    assert known(taught(100, 900, 100, 900)) == (True, 0, 1700 * US, 100 * US)
    assert known(taught(*[-20] * SAMPLES_LEAST)) == (True, 0, 0, 0)


def test_an_answer_of_long_ago_is_forgotten():
    assert known(taught(9000, *[400] * WINDOW)) == (True, 400 * US, 400 * US, 400 * US)


def test_a_servo_that_has_changed_its_ways_is_learnt_anew():
    latency = taught(*[400] * WINDOW)
    latency.forget()
    assert known(latency) == known(ReplyLatency())
