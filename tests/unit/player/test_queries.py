from __future__ import annotations

from random import Random

import pytest

from lss_motion.player.queries import GRACE_NS, STRAY_NS, WINDOW_MAX
from lss_motion.player.turnaround import REPLY_TIMEOUT_NS, SAMPLES_LEAST, Turnaround
from lss_motion.protocol.line import Command, Reply, encode

ASK = Command(5, "QD")
US = 1000


def learn(questioner, line, servo_id, waits_us=(200, 1000) * SAMPLES_LEAST, now_ns=0):
    """Let the questioner learn how quick a servo is; return when that is done."""
    for wait_us in waits_us:
        now_ns += 5_000_000
        questioner.ask(Command(servo_id, "QD"), now_ns)
        reply = Reply(servo_id, "QD", 100)
        arrival_ns = line.free_ns + wait_us * US + line.time_ns(len(encode(reply)))
        assert questioner.answer(reply, arrival_ns)
        line.take()
        now_ns = arrival_ns
    return now_ns + 5_000_000


def test_an_answer_ends_the_question(questioner, line):
    questioner.ask(ASK, 0)
    assert line.take() == b"#5QD\r"
    [(asked, reply)] = questioner.answer(Reply(5, "QD", 100), 2_000_000)
    assert asked.command is ASK
    assert asked.heard_ns == line.time_ns(5)
    assert reply.value == 100
    assert (questioner.asked_count, questioner.answered_count, questioner.strays) == (1, 1, 0)
    assert not questioner.is_waiting(5)


@pytest.mark.parametrize(
    "reply",
    [Reply(6, "QD", 1), Reply(5, "QT", 1), Reply(5, "Q", 6), Reply(None, "QD", 1)],
    ids=["other servo", "other word", "part of the word", "no sender"],
)
def test_what_does_not_fit_the_question_is_a_stray(questioner, reply):
    questioner.ask(ASK, 0)
    assert not questioner.answer(reply, 2_000_000)
    assert questioner.strays == 1
    assert questioner.answer(Reply(5, "QD", 7), 2_000_000)


def test_an_answer_before_the_servo_heard_the_question_is_a_stray(questioner, line):
    questioner.ask(ASK, 0)
    assert not questioner.answer(Reply(5, "QD", 100), line.time_ns(5) - 1)
    assert questioner.strays == 1


def test_only_the_question_for_an_id_may_be_answered_without_a_sender(questioner):
    questioner.ask(Command(5, "QID"), 0)
    assert questioner.answer(Reply(None, "QID", 5), 2_000_000)


def test_a_question_is_given_up_after_its_time_and_not_before(questioner):
    questioner.ask(ASK, 0)
    give_up_ns = questioner.give_up_ns
    assert questioner.expire(give_up_ns - 1) == []
    assert [asked.command for asked in questioner.expire(give_up_ns)] == [ASK]
    assert questioner.expire(give_up_ns) == []
    assert questioner.timeouts == 1
    assert questioner.give_up_ns is None


def test_a_known_servo_is_given_up_sooner(questioner, line):
    questioner.ask(ASK, 0)
    unknown_ns = questioner.give_up_ns
    questioner.expire(unknown_ns)
    now_ns = learn(questioner, line, 6)
    questioner.ask(Command(6, "QD"), now_ns)
    assert 10_000_000 < questioner.give_up_ns - now_ns < GRACE_NS + 4_000_000 < unknown_ns


def test_a_late_answer_is_never_taken_for_the_next(questioner):
    """The servo is left alone until its answer can no longer come; others are asked meanwhile."""
    questioner.ask(ASK, 0)
    given_up_ns = questioner.give_up_ns
    questioner.expire(given_up_ns)
    assert questioner.earliest_ns(5, 5) == given_up_ns + STRAY_NS
    assert questioner.earliest_ns(6, 5) <= given_up_ns
    questioner.ask(Command(6, "QD"), given_up_ns)
    assert not questioner.answer(Reply(5, "QD", 999), given_up_ns + 2_000_000)
    assert questioner.strays == 1
    [(asked, _)] = questioner.answer(Reply(6, "QD", 1), given_up_ns + 3_000_000)
    assert asked.command.servo_id == 6


def test_an_answer_that_is_owed_ends_with_the_answer_to_anything_else(questioner):
    """However late: the servo keeps the order, so what it owed has come or never will."""
    questioner.ask(ASK, 0)
    now_ns = questioner.give_up_ns
    questioner.expire(now_ns)
    assert questioner.owes(5, "QD")
    assert not questioner.owes(5, "QT")
    now_ns += 10 * STRAY_NS
    questioner.ask(Command(5, "QT"), now_ns)
    assert not questioner.answer(Reply(5, "QD", 999), now_ns + 1_000_000)
    questioner.answer(Reply(5, "QT", 300), now_ns + 2_000_000)
    assert not questioner.owes(5, "QD")


def test_an_unknown_servo_is_asked_alone_and_one_thing_at_a_time(questioner):
    questioner.ask(ASK, 0)
    assert questioner.earliest_ns(5, 5) is None
    assert questioner.earliest_ns(6, 5) is None


def test_a_known_servo_is_asked_many_things_but_no_more_than_it_can_keep(questioner, line):
    now_ns = learn(questioner, line, 5)
    count = 0
    while (earliest_ns := questioner.earliest_ns(5, 5)) is not None:
        assert earliest_ns <= now_ns
        questioner.ask(ASK, now_ns)
        count += 1
    assert 3 <= count <= WINDOW_MAX


def test_a_second_servo_is_asked_so_that_answers_never_meet(questioner, line):
    learn(questioner, line, 5, (200, 1000) * 16)
    now_ns = learn(questioner, line, 6, (200, 1000) * 16, now_ns=10**9)
    questioner.ask(ASK, now_ns)
    heard_ns = line.free_ns
    begins_ns = questioner.earliest_ns(6, 5)
    slowest_ns = heard_ns + 1000 * US + line.time_ns(len(b"*5QD100\r"))
    quickest_ns = begins_ns + line.time_ns(5) + 200 * US
    assert slowest_ns <= quickest_ns <= slowest_ns + 1_500_000
    assert begins_ns < slowest_ns, "it is asked while the first one still answers"


def row(questioner, now_ns, keywords=("QD", "QD", "QD", "Q")):
    for keyword in keywords:
        questioner.ask(Command(5, keyword), now_ns)
    return questioner.give_up_ns - GRACE_NS


def test_a_row_that_is_answered_whole_is_believed_in_order(questioner, line):
    now_ns = row(questioner, learn(questioner, line, 5))
    for value in (1, 2, 3):
        assert questioner.answer(Reply(5, "QD", value), now_ns) == []
    believed = questioner.answer(Reply(5, "Q", 6), now_ns)
    assert [reply.value for _, reply in believed] == [1, 2, 3, 6]
    heard_ns = [asked.heard_ns for asked, _ in believed]
    assert heard_ns == sorted(set(heard_ns))


@pytest.mark.parametrize("values", [(1, 2), (1, 1, 2, 3), ()], ids=["lost", "double", "none"])
def test_a_row_in_which_answers_and_questions_do_not_pair_up_says_nothing(questioner, line, values):
    now_ns = row(questioner, learn(questioner, line, 5))
    for value in values:
        assert questioner.answer(Reply(5, "QD", value), now_ns) == []
    believed = questioner.answer(Reply(5, "Q", 6), now_ns)
    assert [reply.keyword for _, reply in believed] == ["Q"]
    lost = 3 - min(len(values), 3)
    assert len(questioner.expire(now_ns)) == lost == questioner.timeouts
    assert questioner.give_up_ns is None


def test_without_the_last_answer_a_row_says_nothing(questioner, line):
    row(questioner, learn(questioner, line, 5))
    give_up_ns = questioner.give_up_ns - GRACE_NS
    for value in (1, 2, 3):
        assert questioner.answer(Reply(5, "QD", value), give_up_ns) == []
    assert [asked.command.keyword for asked in questioner.expire(give_up_ns + STRAY_NS)] == ["Q"]
    assert questioner.strays == 3


def test_a_servo_that_fails_is_trusted_less_and_then_no_more(questioner, line):
    now_ns = learn(questioner, line, 5, (200, 1000) * 16)
    assert questioner.depth(5) > 8
    for depth in (32, 16):
        questioner.ask(ASK, now_ns)
        now_ns = questioner.give_up_ns
        questioner.expire(now_ns)
        assert questioner.depth(5) == depth
        now_ns += STRAY_NS
    assert not questioner.turnaround(5).is_known
    assert questioner.turnaround(5).latest_ns == REPLY_TIMEOUT_NS


@pytest.mark.parametrize("bounds_us", [(200, 1000), (300, 310), (1000, 16000)])
def test_the_next_turnaround_is_rarely_outside_of_what_was_learnt(bounds_us):
    random, outside, judged = Random(4), 0, 0
    for _ in range(200):
        turnaround = Turnaround()
        for _ in range(40):
            waited_ns = random.randint(bounds_us[0] * US, bounds_us[1] * US)
            if turnaround.is_known:
                judged += 1
                is_in = turnaround.earliest_ns <= waited_ns <= turnaround.latest_ns
                outside += not is_in
            turnaround.take(waited_ns)
        spread_ns = (bounds_us[1] - bounds_us[0]) * US
        assert turnaround.spread_ns <= 1.3 * spread_ns
    assert outside < 0.01 * judged
