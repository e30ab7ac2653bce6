"""What a show asks its servos, counted: angles at a pace, targets once, health when it is due."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest

from lss_motion.playing.player.polling import AHEAD_NS
from lss_motion.playing.player.query_choice import (
    BY_NEED,
    HEALTH_LEAST,
    HEALTH_NS,
    ON_STAGE,
    RESTED_NS,
    RIDE_RATIO,
    STRAYED_DEG,
    UNCORRECTED_DEG,
    Pace,
)
from lss_motion.playing.player.query_tracker import STARVED_NS
from tests.unit.player.test_polling import KNOWN_NS, MS, PollingDesk, S, joints


def by_need(*joint_states, pace=BY_NEED, **fields):
    return PollingDesk(*joint_states, pace=pace, **fields)


def asked(desk, word, servo_id=1, from_ns=KNOWN_NS):
    """Return the instants at which a servo was asked for `word`."""
    return [at_ns for at_ns, _, one, own in desk.asked
            if (one, own) == (servo_id, word) and at_ns > from_ns]  # fmt: skip


def test_angles_are_queried_at_the_pace_and_health_four_times_a_second(kit):
    desk = by_need(*joints(kit, 6)).run(0, 4 * S)
    for servo_id in range(1, 7):
        own = asked(desk, "QD", servo_id, from_ns=0)
        assert len(own) == pytest.approx(4 * BY_NEED.steady_hz, abs=2)
        assert max(b - a for a, b in pairwise(own)) < 1.2 * S / BY_NEED.steady_hz
    words = Counter(word for *_, word in desk.asked)
    health = sum(count for word, count in words.items() if word not in ("QD", "QDT"))
    assert 6 * 4 * S / HEALTH_NS - 6 <= health <= 6 * 4 * S / HEALTH_NS / RIDE_RATIO
    assert words["Q"] == pytest.approx(health / 2, abs=6), "every other one is the status"


def test_a_pace_of_one_reading_a_second_is_kept_too(kit):
    desk = by_need(*joints(kit, 2), pace=Pace(1.0, 2.0)).run(0, 6 * S + 1)
    assert len(asked(desk, "QD", from_ns=KNOWN_NS)) in (6, 7)


def test_on_a_stage_a_joint_that_rests_is_polled_less_until_it_is_pushed(kit):
    first, second = joints(kit, 2)
    desk = by_need(first, second, pace=ON_STAGE).run(0, RESTED_NS + 8 * S)
    begin_ns = RESTED_NS + S
    early = [at_ns for at_ns in asked(desk, "QD", from_ns=0) if at_ns < RESTED_NS]
    assert len(early) == pytest.approx(2 * ON_STAGE.steady_hz, abs=2)
    for word in ("QD", "Q", "QT"):
        later = asked(desk, word, from_ns=begin_ns)
        assert len(later) == pytest.approx(7 * ON_STAGE.resting_hz * SHARES[word], abs=2)
    pushed_ns = RESTED_NS + 8 * S
    desk.values[1, "QD"] = 60
    desk.run(pushed_ns, pushed_ns + 2 * S)
    near = asked(desk, "QD", from_ns=pushed_ns)
    assert near[0] - pushed_ns < 0.4 * S
    assert len(near) > 1.4 * ON_STAGE.strayed_hz
    assert len(asked(desk, "QD", 2, from_ns=pushed_ns)) < 3 * ON_STAGE.resting_hz


SHARES = {"QD": 1.0, "Q": 1 / 2, "QT": 1 / 6}


def strayed(state, desk):
    desk.values[1, "QD"] = round(10 * (STRAYED_DEG + 0.3))


def uncorrected(state, desk):
    load_deg = 0.5 * (STRAYED_DEG + UNCORRECTED_DEG)
    desk.values[1, "QD"] = -round(10 * load_deg)
    state.disturbance.step_max_deg = 0.0
    for _ in range(500):
        state.disturbance.horn.take(-load_deg, (0.0, 0.0, 0.0, 0.0), 0.0, 0.1)


def in_doubt(state, desk):
    state.hold_back()
    desk.scheduler._release = lambda _: None


@pytest.mark.parametrize("make", [strayed, uncorrected, in_doubt])
def test_a_joint_is_queried_twice_as_often_while_its_readings_are_worth_more(kit, make):
    first, second = joints(kit, 2)
    desk = by_need(first, second)
    make(first, desk)
    desk.run(0, KNOWN_NS + S)
    assert len(asked(desk, "QD")) == pytest.approx(BY_NEED.strayed_hz, abs=4)
    assert len(asked(desk, "QD", 2)) == pytest.approx(BY_NEED.steady_hz, abs=1)


def test_the_target_of_each_move_is_queried_once_and_at_once(kit):
    joint_states = joints(kit, 6)
    desk = by_need(*joint_states).run(0, S)
    for number in range(10):
        at_ns = S + number * 100 * MS
        for state in joint_states:
            state.note_sent(at_ns, 100 + 50 * (number % 2), 400)
        desk.run(at_ns, at_ns + 100 * MS)
        for servo_id in range(1, 7):
            own = asked(desk, "QDT", servo_id, from_ns=at_ns)
            assert len(own) == 1
            reported_ns = 1.5e9 * joint_states[0].joint.response.loop_s
            assert at_ns + reported_ns <= own[0] < at_ns + reported_ns + 20 * MS


def test_no_query_is_overdue_on_an_idle_line(kit):
    """A line is starved if a query is due and does not leave, not if there is none."""
    desk = by_need(*joints(kit, 1)).run(0, S)
    gaps = [(a[0], b[0]) for a, b in pairwise(desk.asked) if b[0] - a[0] > 2 * STARVED_NS]
    assert gaps, "nothing is due for a while"
    desk.run(S, S + 1)
    next_ns = desk.scheduler.next_wakeup_ns(S)
    assert not desk.scheduler.is_starved(next_ns - 1)
    assert desk.scheduler.is_starved(next_ns + STARVED_NS)


def test_on_a_line_that_is_too_slow_angles_share_it_and_health_gets_its_part(kit):
    desk = by_need(*joints(kit, 40), baud_bps=9600).run(0, 4 * S)
    words = [word for *_, word in desk.asked]
    at = [index for index, word in enumerate(words) if word != "QD"]
    assert HEALTH_LEAST <= min(b - a for a, b in pairwise(at)) <= HEALTH_LEAST + 1
    counts = desk.counts(S)
    assert max(counts.values()) <= 2 * min(counts.values())


def test_a_doubt_does_not_wait_for_the_pace(kit):
    desk = by_need(*joints(kit, 3)).run(0, KNOWN_NS)
    desk.values[2, "Q"] = 9
    desk.run(KNOWN_NS, KNOWN_NS + S)
    first_ns, second_ns = asked(desk, "Q", 2)[:2]
    assert second_ns - first_ns < 5 * MS


def test_a_servo_that_falls_silent_is_asked_on_while_the_others_keep_their_pace(kit):
    desk = by_need(*joints(kit, 3)).run(0, KNOWN_NS)
    desk.values |= {(2, word): None for word in ("QD", "QDT", "Q", "QT", "QV", "QC")}
    desk.run(KNOWN_NS, KNOWN_NS + 1100 * MS)
    assert [name for name, _ in desk.scheduler.health.active_faults] == ["j1"]
    assert len(asked(desk, "QD", 1)) == pytest.approx(1.1 * BY_NEED.steady_hz, abs=2)


@pytest.mark.parametrize(("is_lossy", "hz"), [(False, 20.0), (True, 10.0)])
def test_a_streamed_joint_that_moves_is_queried_twice_as_often(kit, is_lossy, hz):
    """After an unnoticed restart nothing limits its speed but what its servo has stored."""
    state = kit.state(kit.joint("j0", 1, drive="streamed"))
    desk = by_need(state)
    if is_lossy:
        desk.scheduler._choice.note_timeout("main")
    desk.run(0, S)
    for step in range(50):
        state.note_sent(S + step * 20 * MS, 4 * step, None)
        place = round(10 * state.place(S + step * 20 * MS)[0])
        desk.values[1, "QD"] = place
        desk.run(S + step * 20 * MS, S + (step + 1) * 20 * MS)
    assert len(asked(desk, "QD", from_ns=S)) == pytest.approx(hz, abs=2)


def idle_until(desk):
    """Run until no query is in flight; return when the next is due."""
    now_ns = KNOWN_NS + S
    desk.run(0, now_ns)
    while True:
        desk.run(now_ns, now_ns + 1)
        next_ns = desk.scheduler.next_wakeup_ns(now_ns + 3 * AHEAD_NS)
        if desk.tracker.give_up_ns is None and next_ns is not None:
            return next_ns
        now_ns += MS // 4


def test_a_servo_that_is_due_soon_is_polled_behind_a_move(kit):
    desk = by_need(*joints(kit, 2))
    next_ns, begun = idle_until(desk), len(desk.asked)
    for early_ns in (2 * AHEAD_NS, AHEAD_NS // 2):
        assert len(desk.asked) == begun, "it is not due so soon"
        desk.line.send(b"#1D100T500\r", next_ns - early_ns)
        desk.behind(next_ns - early_ns)
    move_ns = desk.line.time_ns(len(b"#1D100T500\r"))
    at_ns, arrival_ns, _, word = desk.asked[begun]
    query_ns = desk.line.time_ns(len(b"#1QD\r"))
    assert (word, arrival_ns) == ("QD", at_ns + move_ns + query_ns)
    assert {one for *_, one, _ in desk.asked[begun:]} == {desk.asked[begun][2]}, "one servo"


@pytest.mark.parametrize("make", ["no room", "not reported", "late"])
def test_no_servo_is_polled_behind_a_move_if(kit, make):
    """The next move is due, it cannot report the target of its last one yet, queries are late."""
    (state,) = joints(kit, 1)
    desk = by_need(state)
    next_ns, begun, quiet_ns = idle_until(desk), len(desk.asked), None
    at_ns = next_ns - AHEAD_NS // 2
    if make == "no room":
        quiet_ns = at_ns + desk.line.time_ns(len(b"#1QD\r")) - 1
    elif make == "not reported":
        state.note_sent(at_ns, 100, 400)
        desk.line.sent_bytes += 1
    else:
        at_ns = next_ns + S // 5
    desk.behind(at_ns, quiet_ns)
    assert len(desk.asked) == begun
