from __future__ import annotations

import random

import numpy as np
import pytest

from lss_motion.playing.player.show_clock import LeaderPosition, ShowClock

S = 1_000_000_000
START_NS = 7 * S


def ramped() -> ShowClock:
    """From 10 s of the show at 7 s of the run: 0.8 × for 2 s, then in 0.5 s to 1.6 ×, and on."""
    clock = ShowClock(START_NS, 10.0, 0.8)
    clock.ramp_to(1.6, START_NS + 2 * S, 0.5)
    return clock


def test_the_rate_is_known_at_every_instant_also_before_the_start_and_before_a_ramp():
    clock = ShowClock(1_000_000_000, 0.0, 1.0)
    assert clock.rate(999_999_999) == 1.0
    assert clock.rate(1_000_000_000) == 1.0
    clock.ramp_to(0.0, 2_000_000_000, 1.0)
    assert clock.rate(1_999_999_999) == 1.0
    assert clock.rate(2_500_000_000) == 0.5
    assert clock.rate(3_000_000_000) == 0.0
    assert clock.rate(4_000_000_000) == 0.0
    clock.ramp_to(0.8, 5_000_000_000, 0.5)
    assert clock.rate(5_125_000_000) == pytest.approx(0.2)


def test_show_time_is_what_its_rate_adds_up_to():
    clock = ShowClock(START_NS, 10.0, 0.8)
    now_ns, wanted_s = START_NS, 10.0
    for rate, at_ms, over_s in (
        (1.6, 2_000, 0.5),
        (0.0, 2_300, 0.4),
        (0.5, 4_000, 0.0),
        (1.0, 4_100, 1.0),
    ):
        while now_ns < START_NS + at_ms * S // 1000:
            wanted_s += 0.0005 * (clock.rate(now_ns) + clock.rate(now_ns + S // 1000))
            now_ns += S // 1000
            assert clock.show_s(now_ns) == pytest.approx(wanted_s, abs=2e-4)
        clock.ramp_to(rate, now_ns, over_s)
        assert clock.show_s(now_ns) == pytest.approx(wanted_s, abs=2e-4), (
            "a ramp begins where it was"
        )


def test_show_time_of_the_past_and_before_the_start_stays_known():
    clock = ramped()
    assert clock.show_s(START_NS - S) == pytest.approx(9.2)
    assert clock.show_s(START_NS) == 10.0
    assert clock.show_s(START_NS + S) == pytest.approx(10.8)
    assert clock.show_s(START_NS + 2 * S) == pytest.approx(11.6)
    assert clock.show_s(START_NS + 2_250_000_000) == pytest.approx(11.6 + 0.25 * 1.0)
    assert clock.show_s(START_NS + 2_500_000_000) == pytest.approx(11.6 + 0.5 * 1.2)
    assert clock.show_s(START_NS + 3_500_000_000) == pytest.approx(12.2 + 1.6)


def test_it_ramps_until_the_new_rate_is_reached_and_no_longer():
    clock = ramped()
    assert clock.is_ramping(START_NS + 2_499_999_999)
    assert not clock.is_ramping(START_NS + 2_500_000_000)
    assert not ShowClock(START_NS, 0.0, 1.0).is_ramping(START_NS)


def test_the_instant_of_a_show_time_is_when_it_is_reached():
    clock = ramped()
    for later_s in (0.0, 0.7, 30.0):
        show_s = 12.2 + later_s
        instant_ns = clock.instant_ns(show_s)
        assert instant_ns == pytest.approx(START_NS + 2.5 * S + later_s / 1.6 * S, abs=2)
        assert clock.show_s(instant_ns) == pytest.approx(show_s, abs=1e-8)
    slow = ShowClock(START_NS, 0.0, 0.1)
    assert slow.instant_ns(1.0) == START_NS + 10 * S
    assert ShowClock(START_NS, 0.0, 0.0).instant_ns(1.0) is None


@pytest.mark.parametrize(
    ("show_s", "now_s", "from_s"),
    [
        (13.8, 9.0, 3.5),  # reached at a steady rate
        (11.9, 9.0, 2.5),  # reached on the ramp: from its end on
        (13.8, 3.0, 3.0),  # not reached yet
    ],
)
def test_it_stands_from_when_the_show_was_there(show_s, now_s, from_s):
    clock = ramped()
    clock.stand_at(show_s, START_NS + round(now_s * S))
    from_ns = START_NS + round(from_s * S)
    assert [clock.show_s(from_ns + more_ns) for more_ns in (0, 1, 5 * S)] == [show_s] * 3
    assert clock.rate(from_ns) == clock.target_rate == 0.0
    assert not clock.is_ramping(from_ns)
    assert clock.show_s(from_ns - S // 1000) == ramped().show_s(from_ns - S // 1000)
    assert clock.instant_ns(99.0) is None


def test_a_clock_that_stands_stands_from_now_on():
    clock = ShowClock(START_NS, 10.0, 0.0)
    clock.stand_at(11.0, START_NS + S)
    assert clock.show_s(START_NS + S - 1) == 10.0
    assert clock.show_s(START_NS + S) == 11.0


def test_knots_are_every_change_of_the_rate_and_steps_in_its_ramps():
    clock = ramped()
    clock.ramp_to(0.0, START_NS + 4 * S, 0.0)
    knots = list(clock.knots(0, START_NS + 5 * S, 200_000_000))
    assert [(at_ns - START_NS) / S for at_ns, _ in knots] == [
        *(0.0, 2.0),
        *(2.0, 2.2, 2.4, 2.5, 4.0),
        *(4.0, 5.0),
    ]
    assert [show_s for _, show_s in knots] == [clock.show_s(at_ns) for at_ns, _ in knots]


def test_between_knots_show_time_is_nearly_a_straight_line():
    clock = ramped()
    clock.ramp_to(0.2, START_NS + 2_300_000_000, 0.7)  # before the other ramp is through
    until_ns = START_NS + 2_900_000_000  # and this one is not either
    at_ns, show_s = zip(*clock.knots(0, until_ns, 10_000_000), strict=True)
    assert at_ns[0] == START_NS
    assert at_ns[-1] == until_ns
    assert list(at_ns) == sorted(at_ns)
    assert at_ns[-1] > at_ns[-2], "once is enough"
    for now_ns in range(START_NS, until_ns, 1_234_567):
        assert np.interp(now_ns, at_ns, show_s) == pytest.approx(clock.show_s(now_ns), abs=1e-4)


def led(clock, seconds, *, ppm, noise_s=0.0, period_s=0.5, offset_s=0.0, start_s=0.0):
    """Follow a leader that is `ppm` fast; return the largest error after the first minute, in s."""
    rng, worst_s = random.Random(3), 0.0
    for turn in range(1, round(seconds / period_s)):
        now_ns = START_NS + round((start_s + turn * period_s) * S)
        elapsed_s = start_s + turn * period_s
        true_s = 10.0 + offset_s + elapsed_s * (1.0 + ppm * 1e-6)
        stated_s = true_s + rng.gauss(0.0, noise_s)
        clock.follow(LeaderPosition(now_ns, stated_s, 1.0 + ppm * 1e-6), now_ns)
        if elapsed_s > 60.0:
            worst_s = max(worst_s, abs(clock.show_s(now_ns) - true_s))
    return worst_s


@pytest.mark.parametrize("ppm", [200.0, -200.0])
def test_an_hour_behind_a_leader_costs_no_memory_and_stays_within_2_ms(ppm):
    clock = ShowClock(START_NS, 10.0, 1.0)
    assert led(clock, 3600.0, ppm=ppm, noise_s=0.0005) < 0.0005
    assert clock.show_s(START_NS + 3600 * S) == pytest.approx(
        10.0 + 3600 * (1 + ppm * 1e-6), abs=1e-3
    )
    assert len(list(clock.knots(0, START_NS + 3600 * S, S))) < 200
    now_ns = START_NS + 3600 * S
    assert clock.show_s(now_ns - 10 * S) == pytest.approx(clock.show_s(now_ns) - 10.0, abs=0.01)


def test_a_follower_is_trimmed_by_300_ppm_at_most_and_never_jumps():
    clock = ShowClock(START_NS, 10.0, 1.0)
    before_s = 10.0
    for turn in range(1, 400):
        now_ns = START_NS + turn * S // 10
        off_s = clock.follow(LeaderPosition(now_ns, 10.5 + turn / 10.0, 1.0), now_ns)
        assert off_s == pytest.approx(0.5, abs=0.02)
        show_s = clock.show_s(now_ns)
        assert 0.0 < show_s - before_s < 0.1 * (1.0 + 301e-6)
        before_s = show_s
    assert clock.instant_ns(before_s) == pytest.approx(now_ns, abs=10)
    assert clock.rate(now_ns) == clock.target_rate == 1.0, "a trim is no rate"


def test_a_clock_that_stands_or_ramps_is_not_trimmed_and_keeps_its_trim_over_a_pause():
    clock = ShowClock(START_NS, 10.0, 1.0)
    clock.follow(LeaderPosition(START_NS + S, 11.0, 1.0002), START_NS + S)
    assert clock.trim_ratio == pytest.approx(200e-6, rel=0.1)
    clock.ramp_to(0.0, START_NS + 2 * S, 0.4)
    assert clock.follow(LeaderPosition(START_NS + 2 * S, 12.0, 1.0), START_NS + 2 * S + 1) is None
    assert clock.follow(LeaderPosition(START_NS + 3 * S, 12.0, 1.0), START_NS + 3 * S) is None
    clock.ramp_to(1.0, START_NS + 4 * S, 0.4)
    at_ns = START_NS + 5 * S
    gained_s = clock.show_s(at_ns + 100 * S) - clock.show_s(at_ns) - 100.0
    assert gained_s == pytest.approx(0.02, rel=0.1)
    assert clock.instant_ns(clock.show_s(at_ns + S)) == pytest.approx(at_ns + S, abs=10)


def test_the_whole_course_of_a_show_is_known_although_legs_are_forgotten():
    clock = ShowClock(START_NS, 0.0, 1.0)
    wanted = []
    for minute in range(1, 60):
        now_ns = START_NS + 60 * minute * S
        wanted.append((now_ns, clock.show_s(now_ns)))
        clock.ramp_to(1.0 if minute % 2 else 0.5, now_ns, 0.5)
    until_ns = START_NS + 3600 * S
    at_ns, show_s = zip(*clock.course(until_ns, 10_000_000), strict=True)
    assert at_ns[0] == START_NS
    assert at_ns[-1] == until_ns
    assert (np.diff(at_ns) >= 0).all()
    for instant_ns, known_s in wanted:
        assert np.interp(instant_ns, at_ns, show_s) == pytest.approx(known_s, abs=1e-6)
