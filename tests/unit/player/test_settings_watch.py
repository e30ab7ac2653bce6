from __future__ import annotations

import pytest

from lss_motion.playing.player.servo_model import (
    HOLD_SIGNS,
    READ_BACK_NS,
    CommonSilence,
    Probe,
    ServoSettings,
)

S = 1_000_000_000
PROBES = (Probe("QAA", 60, 100), Probe("QSD", 1800, 3600))


@pytest.fixture
def doubted():
    return set()


@pytest.fixture
def state(kit, doubted):
    state = kit.state(kit.joint())
    state.settings = ServoSettings(state.joint, PROBES, doubted)
    return state


def test_the_first_sign_asks_at_once_and_a_few_in_a_row_hold_the_moves_back(state, doubted):
    assert state.settings.urgent is None
    for number in range(1, HOLD_SIGNS + 1):
        state.doubt(1000 * number)
        state.doubt(1000 * number)
        assert state.settings.urgent == PROBES[number % 2].keyword, "each time another"
        assert state.takes_moves is (number < HOLD_SIGNS)
    assert state.take_probe("QAA", 60) is None
    assert not doubted
    assert state.release() is False, "no move was due"
    assert state.takes_moves


def test_a_limp_servo_is_held_back_at_once(state):
    state.doubt(1, HOLD_SIGNS)
    assert not state.takes_moves


def test_the_answer_before_the_show_twice_is_a_restart(state):
    assert state.take_probe("QSD", 3600) is None
    assert not state.takes_moves
    text = state.take_probe("QSD", 3600)
    assert "servo 1 answers 3600 to QSD, it was set to 1800" in text


def test_a_restart_that_is_proved_takes_no_more_queries_from_the_others(state, doubted):
    for _ in range(2):
        state.take_probe("QSD", 3600)
    state.doubt(5)
    assert state.take_probe("QSD", 1800) is None, "the recovery reads its settings anew"
    assert (state.settings.urgent, state.settings.read_back(10 * S)) == (None, None)
    assert not doubted
    assert not state.settings.has_settings


def test_settings_are_read_back_in_turn_when_no_other_query_did(state):
    for now_s, word in ((1.0, "QAA"), (1.31, "QSD"), (1.62, "QAA")):
        now_ns = round(now_s * S)
        assert state.settings.read_back(now_ns) == word
        state.settings.note_query("QD", now_ns)
        assert state.settings.read_back(now_ns) == word
        state.settings.note_query(word, now_ns)
        assert state.settings.read_back(now_ns + READ_BACK_NS - 1) is None


def test_a_damaged_answer_is_none(state, doubted):
    for value in (180, 800, 80, None, 1000, 8):
        assert state.take_probe("QSD", value) is None
        assert state.takes_moves
        assert doubted == {"j0"}, "it is asked again"
    assert state.take_probe("QSD", 8) is None, "the same again"
    assert not state.takes_moves
    assert state.take_probe("QSD", 8) is not None, "it is set to something else"


def test_a_servo_whose_settings_a_restart_does_not_change_is_never_in_doubt(kit):
    state = kit.state(kit.joint())
    state.doubt(1, HOLD_SIGNS)
    assert (state.settings.keywords, state.settings.read_back(9 * S)) == ((), None)
    assert state.settings.has_settings
    assert state.takes_moves


def test_moves_that_were_held_back_are_sent_on_release(state, line):
    state.doubt(1, HOLD_SIGNS)
    state.send(line, 10.0, 0.5, 5)
    assert (line.take(), state.held_back) == (b"", 1)
    assert state.release() is True
    state.send(line, 10.0, 0.5, 5)
    assert line.take() == b"#1D100T500\r"


def test_servos_that_fall_silent_together_are_told_from_those_that_are_silent_by_themselves():
    silence = CommonSilence()
    assert [silence.unanswered(one) for one in (1, 2, 1, 2)] == [False, False, False, True]
    silence.answered(3)
    assert not any(silence.unanswered(one) for one in (1, 2, 1, 2, 1, 2))
    assert [silence.unanswered(one) for one in (3, 4, 3, 5)] == [False, False, False, True]
    silence.answered(1)
    assert [silence.unanswered(one) for one in (1, 1, 1, 6, 2, 6)] == [False] * 5 + [True]
