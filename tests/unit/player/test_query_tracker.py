"""How long a servo takes to answer: learnt from its answers, and narrow enough to be of use."""

from __future__ import annotations

from random import Random

import pytest

from lss_motion.playing.player.query_tracker import (
    GRACE_NS,
    PATIENCE_NS,
    PATIENT_SPREAD,
    PROMPT_EVERY,
    REPLY_MAX_BYTES,
    REPLY_TIMEOUT_NS,
    SAMPLES_ENOUGH,
    SAMPLES_LEAST,
    SLOW_TIMEOUT_NS,
    STARVED_NS,
    STRAY_NS,
    WINDOW,
    WINDOW_MAX,
    ReplyLatency,
)
from lss_motion.protocol.framing import Command, Reply, encode

# ---- queries

ASK = Command(5, "QD")
US = 1000


def take_over(tracker, line, servo_id, waits_us=(200, 1000) * SAMPLES_LEAST, now_ns=0):
    """Let the tracker learn the latency of a servo; return when that is done."""
    for wait_us in waits_us:
        now_ns += 5_000_000
        tracker.send(Command(servo_id, "QD"), now_ns)
        reply = Reply(servo_id, "QD", 100)
        arrival_ns = line.free_ns + wait_us * US + line.time_ns(len(encode(reply)))
        assert tracker.receive(reply, arrival_ns)
        line.take()
        now_ns = arrival_ns
    return now_ns + 5_000_000


def test_an_answer_ends_the_question(tracker, line):
    tracker.send(ASK, 0)
    assert line.take() == b"#5QD\r"
    [(asked, reply)] = tracker.receive(Reply(5, "QD", 100), 2_000_000)
    assert asked.command is ASK
    assert asked.arrival_ns == line.time_ns(5)
    assert reply.value == 100
    assert (tracker.query_count, tracker.reply_count, tracker.strays) == (1, 1, 0)
    assert not tracker.is_waiting(5)


def test_an_answer_that_was_read_late_after_a_stall_is_no_latency(tracker, line):
    now_ns = take_over(tracker, line, 5)
    before = tracker.latency(5).latest_ns
    tracker.send(ASK, now_ns)
    [(_, reply)] = tracker.receive(Reply(5, "QD", 100), now_ns + 30_000_000_000)
    assert reply.value == 100, "the answer itself is used"
    assert tracker.latency(5).latest_ns == before


def test_an_answer_may_wait_once_the_latency_is_known_and_then_shows_none(tracker, line):
    now_ns = take_over(tracker, line, 5, waits_us=(200, 1000) * (SAMPLES_ENOUGH // 2))
    latest_ns = tracker.latency(5).latest_ns
    patient = 0
    for _ in range(PROMPT_EVERY):
        tracker.send(ASK, now_ns, is_patient=True)
        reads_ns = tracker.reads_ns(now_ns)
        known = tracker.latency(5)
        late_ns = line.free_ns + known.latest_ns + known.spread_ns // PATIENT_SPREAD
        late_ns += line.time_ns(tracker.reply_bytes(5, "QD"))
        assert reads_ns in (None, late_ns + PATIENCE_NS)
        assert tracker.reads_ns(late_ns + PATIENCE_NS) is None
        patient += reads_ns is not None
        now_ns = late_ns + PATIENCE_NS if reads_ns else line.free_ns + 1_100 * US
        assert tracker.receive(Reply(5, "QD", 100), now_ns)
    assert patient == PROMPT_EVERY - 1
    assert tracker.latency(5).latest_ns <= latest_ns, "only prompt answers show a latency"
    tracker.send(ASK, now_ns)
    assert tracker.reads_ns(now_ns) is None


def test_the_last_query_of_each_servo_and_starvation_are_known(tracker):
    assert (tracker.last_sent_ns(5), tracker.last_sent_ns(6)) == (0, 0)
    assert tracker.starves_ns == STARVED_NS
    tracker.send(ASK, 7 * STARVED_NS)
    assert (tracker.last_sent_ns(5), tracker.last_sent_ns(6)) == (7 * STARVED_NS, 0)
    assert tracker.starves_ns == 8 * STARVED_NS
    assert 10_000 * US <= STARVED_NS <= 50_000 * US


@pytest.mark.parametrize(
    "reply",
    [Reply(6, "QD", 1), Reply(5, "QT", 1), Reply(5, "Q", 6), Reply(None, "QD", 1)],
    ids=["other servo", "other word", "part of the word", "no sender"],
)
def test_what_does_not_fit_the_question_is_a_stray(tracker, reply):
    tracker.send(ASK, 0)
    assert not tracker.receive(reply, 2_000_000)
    assert tracker.strays == 1
    assert tracker.receive(Reply(5, "QD", 7), 2_000_000)


def test_an_answer_before_the_query_has_arrived_is_a_stray(tracker, line):
    tracker.send(ASK, 0)
    assert not tracker.receive(Reply(5, "QD", 100), line.time_ns(5) - 1)
    assert tracker.strays == 1


def test_only_the_question_for_an_id_may_be_answered_without_a_sender(tracker):
    tracker.send(Command(5, "QID"), 0)
    assert tracker.receive(Reply(None, "QID", 5), 2_000_000)


def test_a_question_is_given_up_after_its_time_and_not_before(tracker):
    tracker.send(ASK, 0)
    give_up_ns = tracker.give_up_ns
    assert tracker.expire(give_up_ns - 1) == []
    assert [asked.command for asked in tracker.expire(give_up_ns)] == [ASK]
    assert tracker.expire(give_up_ns) == []
    assert tracker.timeouts == 1
    assert tracker.give_up_ns is None


def test_a_known_servo_is_given_up_sooner(tracker, line):
    tracker.send(ASK, 0)
    unknown_ns = tracker.give_up_ns
    tracker.expire(unknown_ns)
    now_ns = take_over(tracker, line, 6)
    tracker.send(Command(6, "QD"), now_ns)
    assert 10_000_000 < tracker.give_up_ns - now_ns < GRACE_NS + 4_000_000 < unknown_ns


def test_a_servo_that_answers_too_late_is_present(tracker):
    tracker.send(ASK, 0)
    assert tracker.last_reply_ns(5) is None
    now_ns = tracker.give_up_ns
    tracker.expire(now_ns)
    assert not tracker.receive(Reply(5, "QT", 300), now_ns + US)
    assert tracker.last_reply_ns(5) is None, "nobody asked for that"
    assert not tracker.receive(Reply(5, "QD", 100), now_ns + 2 * US)
    assert tracker.last_reply_ns(5) == now_ns + 2 * US


def test_a_late_answer_is_never_taken_for_the_next(tracker):
    """The servo is not polled until its answer can no longer come; others are meanwhile."""
    tracker.send(ASK, 0)
    given_up_ns = tracker.give_up_ns
    tracker.expire(given_up_ns)
    assert tracker.earliest_ns(5, 5) == given_up_ns + STRAY_NS
    assert tracker.earliest_ns(6, 5) <= given_up_ns
    tracker.send(Command(6, "QD"), given_up_ns)
    assert not tracker.receive(Reply(5, "QD", 999), given_up_ns + 2_000_000)
    assert tracker.strays == 1
    [(asked, _)] = tracker.receive(Reply(6, "QD", 1), given_up_ns + 3_000_000)
    assert asked.command.servo_id == 6


def test_an_answer_that_is_owed_ends_with_the_answer_to_anything_else(tracker):
    """However late: the servo keeps the order, so an overdue answer has come or never will."""
    tracker.send(ASK, 0)
    now_ns = tracker.give_up_ns
    tracker.expire(now_ns)
    assert tracker.is_overdue(5, "QD")
    assert not tracker.is_overdue(5, "QT")
    now_ns += 10 * STRAY_NS
    tracker.send(Command(5, "QT"), now_ns)
    assert not tracker.receive(Reply(5, "QD", 999), now_ns + 1_000_000)
    tracker.receive(Reply(5, "QT", 300), now_ns + 2_000_000)
    assert not tracker.is_overdue(5, "QD")


def test_an_unknown_servo_is_polled_alone_with_one_query_at_a_time(tracker):
    tracker.send(ASK, 0)
    assert tracker.earliest_ns(5, 5) is None
    assert tracker.earliest_ns(6, 5) is None


def test_a_known_servo_gets_many_queries_but_no_more_than_its_buffer_holds(tracker, line):
    now_ns = take_over(tracker, line, 5)
    count = 0
    while (earliest_ns := tracker.earliest_ns(5, 5)) is not None:
        assert earliest_ns <= now_ns
        tracker.send(ASK, now_ns)
        count += 1
    assert 3 <= count <= WINDOW_MAX


def test_a_second_servo_is_polled_so_that_answers_never_collide(tracker, line):
    take_over(tracker, line, 5, (200, 1000) * 16)
    now_ns = take_over(tracker, line, 6, (200, 1000) * 16, now_ns=10**9)
    tracker.send(ASK, now_ns)
    arrival_ns = line.free_ns
    begins_ns = tracker.earliest_ns(6, 5)
    slowest_ns = arrival_ns + 1000 * US + line.time_ns(len(b"*5QD100\r"))
    quickest_ns = begins_ns + line.time_ns(5) + 200 * US
    assert slowest_ns <= quickest_ns <= slowest_ns + 1_500_000
    assert begins_ns < slowest_ns, "it is asked while the first one still answers"


def row(tracker, now_ns, keywords=("QD", "QD", "QD", "Q")):
    for keyword in keywords:
        tracker.send(Command(5, keyword), now_ns)
    return tracker.give_up_ns - GRACE_NS


def test_a_row_that_is_answered_whole_is_believed_in_order(tracker, line):
    now_ns = row(tracker, take_over(tracker, line, 5))
    for value in (1, 2, 3):
        assert tracker.receive(Reply(5, "QD", value), now_ns) == []
    believed = tracker.receive(Reply(5, "Q", 6), now_ns)
    assert [reply.value for _, reply in believed] == [1, 2, 3, 6]
    arrival_ns = [asked.arrival_ns for asked, _ in believed]
    assert arrival_ns == sorted(set(arrival_ns))


@pytest.mark.parametrize("values", [(1, 2), (1, 1, 2, 3), ()], ids=["lost", "double", "none"])
def test_a_row_with_unequal_numbers_of_queries_and_answers_is_rejected(tracker, line, values):
    now_ns = row(tracker, take_over(tracker, line, 5))
    for value in values:
        assert tracker.receive(Reply(5, "QD", value), now_ns) == []
    believed = tracker.receive(Reply(5, "Q", 6), now_ns)
    assert [reply.keyword for _, reply in believed] == ["Q"]
    lost = 3 - min(len(values), 3)
    assert len(tracker.expire(now_ns)) == lost == tracker.timeouts
    assert tracker.give_up_ns is None


def test_a_row_without_its_last_answer_is_rejected(tracker, line):
    row(tracker, take_over(tracker, line, 5))
    give_up_ns = tracker.give_up_ns - GRACE_NS
    for value in (1, 2, 3):
        assert tracker.receive(Reply(5, "QD", value), give_up_ns) == []
    assert [asked.command.keyword for asked in tracker.expire(give_up_ns + STRAY_NS)] == ["Q"]
    assert tracker.strays == 3


def test_a_servo_that_fails_is_trusted_less_and_then_no_more(tracker, line):
    now_ns = take_over(tracker, line, 5, (200, 1000) * 16)
    assert tracker.depth(5) > 8
    for depth in (32, 16):
        tracker.send(ASK, now_ns)
        now_ns = tracker.give_up_ns
        tracker.expire(now_ns)
        assert tracker.depth(5) == depth
        now_ns += STRAY_NS
    assert not tracker.latency(5).is_known
    assert tracker.latency(5).latest_ns == REPLY_TIMEOUT_NS


def test_a_servo_whose_answer_comes_after_it_was_given_up_gets_more_time(tracker, line):
    wait_ns = REPLY_TIMEOUT_NS + 10_000_000
    tracker.send(ASK, 0)
    tracker.expire(tracker.give_up_ns)
    assert tracker.receive(Reply(5, "QD", 100), line.time_ns(5) + wait_ns) == []
    now_ns = line.time_ns(5) + wait_ns + 2 * STRAY_NS
    tracker.send(Command(5, "QT"), now_ns)
    assert tracker.give_up_ns > now_ns + line.time_ns(5) + wait_ns
    assert tracker.receive(Reply(5, "QT", 250), now_ns + line.time_ns(5) + wait_ns)


def test_an_answer_that_comes_behind_the_next_query_shows_that_the_servo_is_slow(tracker, line):
    tracker.send(ASK, 0)
    given_up_ns = tracker.give_up_ns
    tracker.expire(given_up_ns)
    tracker.send(Command(5, "QAD"), given_up_ns)
    wait_ns = REPLY_TIMEOUT_NS + 20_000_000
    assert tracker.receive(Reply(5, "QD", 100), line.time_ns(5) + wait_ns) == []
    arrival_ns = given_up_ns + line.time_ns(6)
    assert tracker.expire(arrival_ns + wait_ns) == []
    assert tracker.receive(Reply(5, "QAD", 32), arrival_ns + wait_ns)


def test_a_late_answer_to_an_earlier_query_does_not_reject_a_row(tracker, line):
    now_ns = take_over(tracker, line, 5, (200, 1000) * 16)
    tracker.send(Command(5, "QDT"), now_ns)
    tracker.expire(now_ns := tracker.give_up_ns)
    now_ns = row(tracker, now_ns + STRAY_NS, ("QD", "QD", "QT"))
    assert tracker.receive(Reply(5, "QDT", 7), now_ns) == []
    assert all(tracker.receive(Reply(5, "QD", value), now_ns) == [] for value in (1, 2))
    believed = tracker.receive(Reply(5, "QT", 300), now_ns)
    assert [reply.value for _, reply in believed] == [1, 2, 300]


def test_an_answer_from_long_ago_says_nothing_of_how_slow_a_servo_is(tracker):
    tracker.send(ASK, 0)
    tracker.expire(tracker.give_up_ns)
    tracker.receive(Reply(5, "QD", 100), 2 * SLOW_TIMEOUT_NS)
    assert tracker.latency(5).latest_ns == REPLY_TIMEOUT_NS


STEADY_US = (400,) * SAMPLES_LEAST
"""Waits of a servo that always takes as long."""
ANSWER = b"*5QD100\r"


def test_nothing_is_known_about_a_servo_without_queries(tracker):
    assert tracker.is_waiting(5) is False
    assert tracker.give_up_ns is tracker.shortest_latency_ns is None
    assert (tracker.depth(5), tracker.quiet_until_ns(5)) == (1, 0)
    assert tracker.reply_bytes(5, "QD") == REPLY_MAX_BYTES
    assert tracker.earliest_ns(5, 5) <= 0
    tracker.send(ASK, 0)
    assert tracker.is_waiting(5) is True


def test_a_longer_answer_by_one_digit_is_always_allowed_for(tracker, line):
    take_over(tracker, line, 5, STEADY_US)
    assert tracker.reply_bytes(5, "QD") == len(ANSWER) + 1
    assert tracker.reply_bytes(5, "QT") == tracker.reply_bytes(6, "QD") == REPLY_MAX_BYTES


def test_every_row_that_is_answered_whole_doubles_the_next(tracker, line):
    now_ns, depths = 0, []
    for _ in range(8):
        now_ns = take_over(tracker, line, 5, (400,), now_ns)
        depths.append(tracker.depth(5))
    assert depths == [2, 4, 8, 16, 32, 64, 64, 64]


def given_up(tracker, now_ns, command=ASK):
    """Poll without an answer; return when the servo may be polled again."""
    tracker.send(command, now_ns)
    now_ns = tracker.give_up_ns
    tracker.expire(now_ns)
    assert tracker.quiet_until_ns(command.servo_id) == now_ns + STRAY_NS
    return now_ns + STRAY_NS


def test_only_failures_in_a_row_make_a_servo_unknown(tracker, line):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    for _ in range(3):
        now_ns = given_up(tracker, now_ns)
        assert tracker.latency(5).is_known
        now_ns = take_over(tracker, line, 5, (400,), now_ns)
    given_up(tracker, given_up(tracker, now_ns))
    assert not tracker.latency(5).is_known


def test_a_servo_that_never_answers_still_gets_single_queries(tracker):
    given_up(tracker, given_up(tracker, 0))
    assert tracker.depth(5) == 1


def test_an_unknown_servo_has_thirty_milliseconds_and_the_longest_answer(tracker, line):
    tracker.send(ASK, 0)
    assert tracker.give_up_ns == line.time_ns(5) + REPLY_TIMEOUT_NS + line.time_ns(REPLY_MAX_BYTES)


def test_a_known_servo_has_what_it_took_so_far_and_some_grace(tracker, line):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    tracker.send(ASK, now_ns)
    end_ns = now_ns + line.time_ns(5) + 400 * US + line.time_ns(len(ANSWER) + 1)
    assert tracker.give_up_ns == end_ns + GRACE_NS


def test_the_next_answer_is_waited_for_from_the_last_one_on(tracker, line):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    for keyword in ("QD", "QT", "QV"):
        tracker.send(Command(5, keyword), now_ns)
    arrival_ns = now_ns + line.time_ns(5)
    [(_, reply)] = tracker.receive(
        Reply(5, "QD", 100), arrival_ns + 400 * US + line.time_ns(len(ANSWER))
    )
    assert reply.value == 100, "there is no other question that it could answer"
    late_ns = now_ns + 9_000_000
    assert [reply.keyword for _, reply in tracker.receive(Reply(5, "QT", 300), late_ns)] == ["QT"]
    assert tracker.give_up_ns == late_ns + line.time_ns(REPLY_MAX_BYTES) + GRACE_NS
    assert [reply.value for _, reply in tracker.receive(Reply(5, "QV", 1), late_ns)] == [1]


def test_of_two_servos_the_first_to_be_given_up_counts(tracker, line):
    for servo_id in (5, 6):
        now_ns = take_over(tracker, line, servo_id, STEADY_US, now_ns=servo_id * 10**9)
    tracker.send(ASK, now_ns)
    first_ns = tracker.give_up_ns
    tracker.send(Command(6, "QD"), tracker.earliest_ns(6, 5))
    assert tracker.give_up_ns == first_ns
    assert [asked.command.servo_id for asked in tracker.expire(first_ns)] == [5]
    assert tracker.give_up_ns > first_ns


@pytest.mark.parametrize(("wait_us", "count"), [(100, 3), (2_000, 5), (20_000, WINDOW_MAX)])
def test_so_many_questions_fly_that_the_servo_never_waits_for_one(tracker, line, wait_us, count):
    # The shortest answer, nine bytes with its spare digit, takes 781 us.
    now_ns = take_over(tracker, line, 5, (wait_us,) * SAMPLES_LEAST)
    tracker.send(Command(5, "QMS"), now_ns)
    name_ns = line.time_ns(len(b"*5QMSLSS-ST1\r"))
    tracker.receive(Reply(5, "QMS", "LSS-ST1"), line.free_ns + wait_us * US + name_ns)
    asked = 0
    while tracker.earliest_ns(5, 5) is not None:
        tracker.send(ASK, now_ns)
        asked += 1
    assert asked == count


def test_the_second_servo_answers_after_the_latest_answer_of_the_first(tracker, line):
    for servo_id in (5, 6, 7):
        now_ns = take_over(tracker, line, servo_id, STEADY_US, now_ns=servo_id * 10**9)
    tracker.send(ASK, now_ns)
    end_ns = tracker.give_up_ns - GRACE_NS
    begins_ns = tracker.earliest_ns(6, 5)
    assert begins_ns == end_ns - 400 * US - line.time_ns(5)
    tracker.send(Command(6, "QD"), begins_ns)
    assert tracker.earliest_ns(7, 5) is None, "two servos are enough"
    assert tracker.earliest_ns(5, 5) is None, "it is the turn of the other"
    assert tracker.earliest_ns(6, 5) is not None


@pytest.mark.parametrize(("first", "second"), [(5, 6), (6, 5)])
def test_two_servos_fly_together_only_if_both_are_known(tracker, line, first, second):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    tracker.send(Command(first, "QD"), now_ns)
    assert tracker.earliest_ns(second, 5) is None


def test_the_shortest_wait_of_any_servo_is_known(tracker, line):
    take_over(tracker, line, 5, (700, 300, 900))
    assert tracker.shortest_latency_ns == 300 * US
    take_over(tracker, line, 6, (250, 800), now_ns=10**9)
    take_over(tracker, line, 7, (500,), now_ns=2 * 10**9)
    assert tracker.shortest_latency_ns == 250 * US


def test_latency_is_measured_on_idle_servos_only(tracker, line):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    for _ in range(3):
        tracker.send(ASK, now_ns)
    arrival_ns, size_ns = line.free_ns, line.time_ns(len(ANSWER))
    first_ns = arrival_ns - 2 * line.time_ns(5) + 400 * US + size_ns
    for arrival_ns in (first_ns, first_ns + size_ns, first_ns + 2 * size_ns):
        tracker.receive(Reply(5, "QD", 100), arrival_ns)
    assert (tracker.latency(5).earliest_ns, tracker.latency(5).latest_ns) == (
        400 * US,
        400 * US,
    )


def test_an_answer_just_before_the_next_query_arrives_leaves_the_servo_idle(tracker, line):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    tracker.send(ASK, now_ns)
    tracker.send(Command(5, "QT"), now_ns + 2_000_000)
    tracker.receive(Reply(5, "QD", 100), line.free_ns)
    wait_ns = 300 * US + line.time_ns(len(b"*5QT300\r"))
    tracker.receive(Reply(5, "QT", 300), line.free_ns + wait_ns)
    assert tracker.shortest_latency_ns == 300 * US


def test_an_answer_after_a_lost_one_shows_nothing_of_how_quick_the_servo_is(tracker, line):
    now_ns = take_over(tracker, line, 5, STEADY_US)
    tracker.send(ASK, now_ns)
    tracker.send(Command(5, "QT"), now_ns)
    tracker.receive(Reply(5, "QT", 300), line.free_ns + 200 * US + line.time_ns(8))
    assert tracker.shortest_latency_ns == 400 * US


def test_an_answer_may_begin_as_soon_as_the_query_has_arrived(tracker, line):
    tracker.send(ASK, 0)
    assert tracker.receive(Reply(5, "QD", 100), line.time_ns(5))


def test_a_late_answer_shows_that_the_servo_is_slower_than_estimated(tracker, line):
    now_ns = given_up(tracker, take_over(tracker, line, 5, STEADY_US))
    tracker.receive(Reply(5, "QT", 300), now_ns)
    assert tracker.latency(5).is_known, "nobody asked for that"
    tracker.receive(Reply(5, "QD", 100), now_ns)
    assert not tracker.latency(5).is_known
    assert tracker.strays == 2


def test_no_servo_answers_without_its_name_but_for_its_id(tracker):
    tracker.send(Command(1, "QD"), 0)
    assert not tracker.receive(Reply(None, "QD", 100), 2_000_000)
    assert not tracker.receive(Reply(None, "QID", 1), 2_000_000)
    assert tracker.receive(Reply(1, "QD", 100), 2_000_000)


@pytest.mark.parametrize(
    ("values", "strays"),
    [((1, 2), 2), ((1, 1, 2, 3), 4), ((1, 2, 3), 0)],
    ids=["lost", "double", "whole"],
)
def test_a_doubtful_row_is_thrown_away_and_the_next_is_shorter(tracker, line, values, strays):
    now_ns = row(tracker, take_over(tracker, line, 5, (400,) * 6))
    for value in values:
        tracker.receive(Reply(5, "QD", value), now_ns)
    tracker.receive(Reply(5, "Q", 6), now_ns)
    assert tracker.strays == strays
    assert tracker.depth(5) == (32 if strays else 64)


def test_two_equal_queries_are_not_accepted_before_the_row_is_over(tracker, line):
    now_ns = row(tracker, take_over(tracker, line, 5), ("QD", "QD", "Q"))
    assert tracker.receive(Reply(5, "QD", 1), now_ns) == []
    assert tracker.receive(Reply(5, "QD", 2), now_ns) == []
    assert [reply.value for _, reply in tracker.receive(Reply(5, "Q", 6), now_ns)] == [1, 2, 6]


# ---- turnaround


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


def test_no_answer_begins_before_its_query_has_arrived():
    assert known(taught(100, 900, 100, 900)) == (True, 0, 1700 * US, 100 * US)
    assert known(taught(*[-20] * SAMPLES_LEAST)) == (True, 0, 0, 0)


def test_an_answer_of_long_ago_is_forgotten():
    assert known(taught(9000, *[400] * WINDOW)) == (True, 400 * US, 400 * US, 400 * US)


def test_a_servo_that_has_changed_its_ways_is_learnt_anew():
    latency = taught(*[400] * WINDOW)
    latency.forget()
    assert known(latency) == known(ReplyLatency())
