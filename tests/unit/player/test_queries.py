from __future__ import annotations

import pytest

from lss_motion.player.queries import STRAY_NS
from lss_motion.protocol.line import Command, Reply

ASK = Command(5, "QD")


def test_an_answer_ends_the_question(questioner, line):
    questioner.ask(ASK, 0)
    assert line.take() == b"#5QD\r"
    asked = questioner.answer(Reply(5, "QD", 100), 2_000_000)
    assert asked.command is ASK
    assert asked.heard_ns == line.time_ns(5)
    assert (questioner.asked_count, questioner.answered_count, questioner.strays) == (1, 1, 0)
    assert questioner.is_free(5, 2_000_000)


@pytest.mark.parametrize(
    "reply",
    [Reply(6, "QD", 1), Reply(5, "QT", 1), Reply(5, "Q", 6), Reply(None, "QD", 1)],
    ids=["other servo", "other word", "part of the word", "no sender"],
)
def test_what_does_not_fit_the_question_is_a_stray(questioner, reply):
    questioner.ask(ASK, 0)
    assert questioner.answer(reply, 2_000_000) is None
    assert questioner.strays == 1
    assert questioner.answer(Reply(5, "QD", 7), 2_000_000) is not None


def test_an_answer_before_the_servo_heard_the_question_is_a_stray(questioner, line):
    questioner.ask(ASK, 0)
    assert questioner.answer(Reply(5, "QD", 100), line.time_ns(5) - 1) is None
    assert questioner.strays == 1


def test_only_the_question_for_an_id_may_be_answered_without_a_sender(questioner):
    questioner.ask(Command(5, "QID"), 0)
    assert questioner.answer(Reply(None, "QID", 5), 2_000_000) is not None


def test_a_question_is_given_up_after_its_time_and_not_before(questioner):
    questioner.ask(ASK, 0)
    give_up_ns = questioner.asked.give_up_ns
    assert questioner.expire(give_up_ns - 1) is None
    assert questioner.expire(give_up_ns).command is ASK
    assert questioner.expire(give_up_ns) is None
    assert questioner.timeouts == 1


def test_a_late_answer_is_never_taken_for_the_next(questioner):
    """The servo is left alone until its answer can no longer come; others are asked meanwhile."""
    questioner.ask(ASK, 0)
    given_up_ns = questioner.asked.give_up_ns
    questioner.expire(given_up_ns)
    assert not questioner.is_free(5, given_up_ns + STRAY_NS - 1)
    assert questioner.is_free(6, given_up_ns)
    questioner.ask(Command(6, "QD"), given_up_ns)
    assert questioner.answer(Reply(5, "QD", 999), given_up_ns + 2_000_000) is None
    assert questioner.strays == 1
    assert questioner.answer(Reply(6, "QD", 1), given_up_ns + 3_000_000).command.servo_id == 6
    assert questioner.is_free(5, given_up_ns + STRAY_NS)


def test_there_is_one_question_at_a_time(questioner):
    questioner.ask(ASK, 0)
    assert not questioner.is_free(6, 0)
    with pytest.raises(AssertionError, match="one question"):
        questioner.ask(Command(6, "QD"), 0)
