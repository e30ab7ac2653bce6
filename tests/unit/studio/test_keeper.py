"""When the player of a stage starts, ends for new files, and is given up."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from lss_motion.studio.keeper import PAUSE_MAX_S, PROVEN_S, Keeper, Seen

OFF = Seen(plan="a", is_running=False, is_latched=False, state="off")
IDLE = Seen(plan="a", is_running=True, is_latched=False, state="idle")
PLAYS = replace(IDLE, state="plays")


def started(at_s=0.0):
    keeper = Keeper()
    assert keeper.next_deed(OFF, at_s) == "start"
    keeper.note_start("a", at_s)
    keeper.note_connected()
    return keeper


def test_it_starts_with_a_plan_and_not_while_a_stop_is_kept():
    keeper = Keeper()
    assert keeper.next_deed(replace(OFF, plan=None), 0.0) is None
    assert keeper.next_deed(OFF, 0.0) == "start"
    latched = started()
    assert latched.next_deed(replace(OFF, is_latched=True), 1.0) is None
    latched.note_end(None, None, 1.0)
    assert latched.next_deed(OFF, 100.0) is None, "armed again, but not started"


@pytest.mark.parametrize("state", ["plays", "connecting"])
def test_new_files_wait_for_the_end_of_a_show(state):
    keeper = started()
    new = replace(PLAYS, plan="b", state=state)
    assert [keeper.next_deed(new, at) for at in (1.0, 5.0, 60.0)] == [None, None, None]
    assert keeper.has_new_files
    assert keeper.next_deed(replace(new, state="idle", is_latched=True), 61.0) is None


def test_new_files_are_taken_once_they_are_calm():
    keeper = started()
    new = replace(IDLE, plan="b")
    assert keeper.next_deed(new, 10.0) is None
    assert keeper.next_deed(replace(new, plan="c"), 10.8) is None
    assert keeper.next_deed(replace(new, plan="c"), 11.5) is None
    assert keeper.next_deed(replace(new, plan="c"), 12.0) == "renew"
    assert keeper.next_deed(replace(new, plan="c"), 12.5) is None, "it is asked already"
    assert keeper.note_end(None, None, 13.0) is None
    assert keeper.next_deed(replace(OFF, plan="c"), 13.0) == "start"
    keeper.note_start("c", 13.0)
    assert not keeper.has_new_files


def test_a_player_that_goes_on_with_new_files_is_not_started_again():
    keeper = started()
    new = replace(IDLE, plan="b")
    keeper.next_deed(new, 10.0)
    assert keeper.next_deed(new, 12.0) == "renew"
    keeper.note_renewed(is_taken=False)
    assert keeper.has_new_files, "a show has just begun"
    assert keeper.next_deed(new, 13.0) == "renew"
    newer = replace(IDLE, plan="c")
    assert keeper.next_deed(newer, 13.2) is None
    keeper.note_renewed(is_taken=True)
    assert keeper.has_new_files, "changed again meanwhile"
    assert keeper.next_deed(newer, 15.0) == "renew"
    keeper.note_renewed(is_taken=True)
    assert not keeper.has_new_files
    assert keeper.next_deed(newer, 99.0) is None


def test_files_with_an_error_change_nothing():
    keeper = started()
    assert keeper.next_deed(IDLE, 100.0) is None


def test_a_player_that_is_gone_is_started_again_ever_more_slowly():
    keeper, now_s, pauses_s = started(), 10.0, []
    for _ in range(7):
        text = keeper.note_end("gone", None, now_s)
        assert text.startswith("gone; the stage begins again in ")
        begun_s = now_s
        while keeper.next_deed(OFF, now_s) is None:
            now_s += 0.5
        pauses_s.append(now_s - begun_s)
        keeper.note_start("a", now_s)
    assert pauses_s == [5.0, 10.0, 20.0, 40.0, PAUSE_MAX_S, PAUSE_MAX_S, PAUSE_MAX_S]
    keeper.note_end("gone", None, now_s + PROVEN_S + 1)
    assert keeper.next_deed(OFF, now_s + PROVEN_S + 6) == "start"


def test_a_stage_that_cannot_begin_ends_the_program():
    keeper = Keeper()
    keeper.note_start("a", 0.0)
    keeper.note_end("no port", 4, 1.0)
    assert (keeper.failure.text, keeper.failure.exit_code) == ("no port", 4)


def test_files_that_the_player_refuses_are_not_tried_twice():
    keeper = started()
    assert "when a file has changed" in keeper.note_end("wrong", 2, 5.0)
    assert keeper.next_deed(OFF, 500.0) is None
    assert keeper.next_deed(replace(OFF, plan="b"), 501.0) == "start"
