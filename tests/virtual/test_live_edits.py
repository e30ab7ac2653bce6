"""Edits of a show while it plays: spliced or refused, judged at the simulated horns."""

from __future__ import annotations

import pytest
from campaign.live_edits import EditedRun, planned, run_of
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.program.live_edit import live_edit
from lss_motion.show.model import Cue, Keyframe, Sequence, Wait
from tests.virtual.conftest import make_robot

ROBOT = make_robot(2, baud_bps=115200)
FRAMES = (
    Keyframe(at_s=0.0, deg={"j0": 0.0, "j1": 0.0}),
    Keyframe(at_s=2.0, deg={"j0": 30.0}),
    Keyframe(at_s=4.0, deg={"j0": 0.0, "j1": 20.0}),
    Keyframe(at_s=6.0, deg={"j0": 25.0}),
    Keyframe(at_s=8.0, deg={"j0": 0.0, "j1": 0.0}),
)
CUES = tuple(Cue(at_s=at_s, say=f"at {at_s:g}") for at_s in (0.5, 1.5, 3.0, 7.0))
SHOW = Sequence(name="s", keyframes=FRAMES, events=CUES)


def with_key(index, show=SHOW, **fields):
    frames = list(show.keyframes)
    frames[index] = replace(frames[index], **fields)
    return replace(show, keyframes=tuple(frames))


TURNED = with_key(3, deg={"j0": -25.0})


def test_an_edit_ahead_is_played_and_the_rest_is_as_it_was():
    run = EditedRun(ROBOT, SHOW, [(1.0, 0.3, 0.2, TURNED)])
    assert run.refused == []
    (edit,) = run.spliced
    assert 1.3 < edit.splice_s < 4.0
    horn = run.horns()["j0"]
    assert horn.min() == pytest.approx(-25.0, abs=1.0), "the edit was played"
    assert horn.max() == pytest.approx(30.0, abs=1.0), "what was before it, too"
    assert run.said == [cue.say for cue in CUES], "each event once"
    assert run.broken() == []


def test_a_show_that_becomes_longer_plays_to_its_new_end_with_its_events():
    longer = replace(
        TURNED,
        keyframes=(*TURNED.keyframes[:-1], replace(TURNED.keyframes[-1], at_s=10.0)),
        events=(*CUES[:-1], replace(CUES[-1], at_s=9.0)),
    )
    run = EditedRun(ROBOT, SHOW, [(1.0, 0.3, 0.2, longer)])
    assert len(run.spliced) == 1
    assert run.playing.program.duration_s == pytest.approx(10.0, abs=0.2)
    assert run.said == [cue.say for cue in CUES]
    assert run.broken() == []


def test_one_edit_follows_the_other():
    second = with_key(2, TURNED, deg={"j0": 0.0, "j1": -20.0})
    third = with_key(3, second, deg={"j0": 40.0})
    edits = [(0.2, 0.1, 0.05, TURNED), (0.6, 0.1, 0.05, second), (1.2, 0.1, 0.05, third)]
    run = EditedRun(ROBOT, SHOW, edits)
    assert (len(run.spliced), run.refused) == (3, [])
    assert run.horns()["j1"].min() == pytest.approx(-20.0, abs=1.0)
    assert run.horns()["j0"].max() == pytest.approx(40.0, abs=1.0)
    assert run.broken() == []


def test_what_was_edited_is_also_where_the_show_is_sent_back_to():
    """The player has the whole edited program: a way back plays the edit again."""
    sought = []

    class Seeking(EditedRun):
        def act(self, player, now_ns):
            super().act(player, now_ns)
            show = player.show
            if self.spliced and not sought and show is not None and show.show_s(now_ns) > 6.5:
                sought.append(now_ns)
                player.seek(5.0, now_ns)

    run = Seeking(ROBOT, SHOW, [(1.0, 0.3, 0.2, TURNED), (99.0, 0.0, 0.0, TURNED)])
    assert len(sought) == 1
    (bus,) = run.result.simulated.values()
    horn = run.horns()["j0"]
    after = horn[(sought[0] - bus.lines[0][0]) // 5_000_000 + 400 :]
    assert after.min() == pytest.approx(-25.0, abs=1.0)
    assert run.broken() == []


@pytest.mark.parametrize(
    ("edits", "why"),
    [
        ([(7.0, 0.3, 0.1, with_key(1, deg={"j0": 60.0}))], None),
        ([(5.0, 0.3, 0.1, TURNED)], "would have to jump"),
        ([(7.9, 0.3, 0.1, TURNED)], "before a splice"),
        ([(1.0, 0.0, 0.9, TURNED)], "too late for the splice"),
        ([(1.0, 0.3, 0.1, replace(SHOW, events=CUES[:-1]))], "other events"),
        ([(1.0, 0.3, 0.1, replace(SHOW, events=(replace(CUES[0], at_s=7.5), *CUES[1:])))], "past"),
        ([(1.0, 0.3, 0.1, replace(SHOW, loop=None))], "again and again"),
        ([(1.0, 0.3, 0.1, with_key(4, deg={"j0": 0.0}))], None),
    ],
)
def test_what_cannot_be_is_refused_and_the_show_goes_on_as_it_was(edits, why):
    run = EditedRun(ROBOT, SHOW, edits)
    assert run.broken() == []
    if why is None:
        assert len(run.spliced) == 1
    else:
        assert why in run.refused[0]
        assert run.spliced == []
        assert run.said == [cue.say for cue in CUES]


def test_waits_other_joints_and_mechanisms_are_refused():
    plain = planned(SHOW, ROBOT)
    less = planned(
        Sequence(name="s", keyframes=tuple(replace(k, deg={"j0": 0.0}) for k in FRAMES)), ROBOT
    )
    waiting = replace(
        plain,
        program=replace(plain.program, waits=(Wait(sensor="x", side="above", threshold=1.0),)),
    )
    for edited, why in ((less, "other joints"), (waiting, "waits for a sensor")):
        with pytest.raises(InputError, match=why):
            live_edit(plain, edited, ROBOT, reached_s=1.0, plan=b"")


@pytest.mark.parametrize("seed", range(8))
def test_edits_of_random_shows_break_no_limit_and_stop_nothing(seed):
    assert run_of(seed).broken() == []


@pytest.mark.slow
@pytest.mark.parametrize("block", range(10))
def test_many_edits_of_random_shows_break_no_limit_and_stop_nothing(block):
    texts = {seed: run_of(seed).broken() for seed in range(1000 + 20 * block, 1020 + 20 * block)}
    assert {seed: text for seed, text in texts.items() if text} == {}
