"""A long loop is compiled once and repeated: the horns do what they do when it is written out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.program import compile as compiler
from lss_motion.planning.program.text import from_text
from lss_motion.planning.program.verify import verify_program
from lss_motion.playing import api
from lss_motion.playing.player.events import CueReached, MarkPassed
from lss_motion.show.model import Cue, Keyframe
from tests.tables import first_quick

PASSES = 9


def looped(kit, *, in_motion=False, cues=()):
    """Return a show of `PASSES` passes of 3 s, which rest between passes, or move on."""
    sequence = kit.sequence(2, 3.0, loop=PASSES)
    if in_motion:
        swing = [(0.0, 0.0), (0.75, 30.0), (1.5, 0.0), (2.25, -30.0), (3.0, 0.0)]
        frames = [Keyframe(deg={"j0": deg, "j1": -deg}, at_s=at_s) for at_s, deg in swing]
        sequence = replace(sequence, keyframes=tuple(frames))
    return replace(sequence, events=tuple(cues))


def both(stage, kit, monkeypatch, sequence):
    """Return the program written out, the one that repeats a pass, and the plan."""
    robot = kit.robot(2, speed_max_deg_s=180.0)
    whole, trajectory = stage.compile(robot, sequence)
    assert whole.repeat is None
    monkeypatch.setattr(compiler, "WRITTEN_MAX_S", 1.0)
    short = api.compile(trajectory, robot)
    assert short.repeat is not None
    return robot, whole, short, trajectory


@pytest.mark.parametrize("in_motion", first_quick([True, False]))
def test_the_horns_move_as_if_every_pass_were_written(stage, kit, monkeypatch, in_motion):
    sequence = looped(kit, in_motion=in_motion)
    robot, whole, short, trajectory = both(stage, kit, monkeypatch, sequence)
    assert len(short.moves) < 0.6 * len(whole.moves)
    assert short.duration_s == pytest.approx(whole.duration_s, abs=1e-5)
    found = []
    for program in (whole, short):
        played = stage.play(robot, program=program)
        assert played.report.outcome == "finished"
        assert played.report.timing.missed == 0
        truth = played.result.truth
        found.append(truth.horn_deg - trajectory.sample(truth.times_s))
        speed, _ = played.speeds(0, played.bus.lines[-1][0])
        assert np.abs(speed).max() <= 1.02 * 180.0
    rms = [float(np.sqrt(np.mean(error**2))) for error in found]
    assert rms[1] <= 1.1 * rms[0]
    seams_s = trajectory.first.duration_s + trajectory.middle.duration_s * np.arange(PASSES - 1)
    for seam_s in seams_s:
        near = slice(int(100 * (seam_s - 0.3)), int(100 * (seam_s + 0.3)))
        assert np.abs(found[1][near]).max() <= np.abs(found[0][near]).max() + 0.2


def test_moves_marks_and_cues_come_as_often_as_written_out(stage, kit, monkeypatch):
    cues = [
        Cue(at_s=0.05, say="soon", lead_s=0.2),
        Cue(at_s=1.0, say="one"),
        Cue(at_s=3.0, say="e"),
    ]
    sequence = looped(kit, cues=cues)
    _, whole, short, _ = both(stage, kit, monkeypatch, sequence)
    shown = [[(round(at_s, 4), cue.say) for at_s, cue in p.unrolled_cues()] for p in (whole, short)]
    assert sorted(shown[0]) == sorted(shown[1])
    assert [at_s for at_s, _ in shown[1]] == sorted(at_s for at_s, _ in shown[1])
    assert len(shown[1]) == 3 * PASSES
    marks = [
        sorted((round(at_s, 4), mark.label) for at_s, mark in program.unrolled_marks())
        for program in (whole, short)
    ]
    assert marks[0] == marks[1]
    moves = [due_us for due_us, _ in short.unrolled()]
    assert moves == sorted(moves)
    assert moves[-1] == pytest.approx(whole.moves[-1].due_us, abs=100_000)


def test_a_played_loop_tells_every_pass(stage, kit, monkeypatch):
    sequence = looped(kit, cues=[Cue(at_s=1.0, say="one")])
    robot, _, short, _ = both(stage, kit, monkeypatch, sequence)
    played = stage.play(robot, program=short)
    reached = [event for event in played.events if isinstance(event, CueReached)]
    assert [round(event.show_s, 1) for event in reached] == [1.0 + 3.0 * n for n in range(PASSES)]
    ends = [e for e in played.events if isinstance(e, MarkPassed) and e.label == "end"]
    assert len(ends) == PASSES


@pytest.mark.parametrize("start_s", first_quick([13.5, 4.0, 22.5, 25.5]))
def test_a_show_can_begin_in_any_pass(stage, kit, monkeypatch, start_s):
    sequence = looped(kit)
    robot, whole, short, _ = both(stage, kit, monkeypatch, sequence)
    ends = []
    for program in (whole, short):
        played = stage.play(robot, program=program, start_s=start_s)
        assert played.report.outcome == "finished"
        truth = played.result.truth
        ends.append((truth.times_s[0], truth.times_s[-1], truth.horn_deg[:50]))
    assert ends[0][0] == pytest.approx(ends[1][0], abs=0.02)
    assert ends[0][1] == pytest.approx(ends[1][1], abs=0.02)
    assert np.abs(ends[0][2] - ends[1][2]).max() < 1.0


def test_the_text_of_a_repeated_program_reads_back(stage, kit, monkeypatch):
    sequence = looped(kit, cues=[Cue(at_s=1.0, say="one")])
    robot, _, short, _ = both(stage, kit, monkeypatch, sequence)
    text = short.to_text()
    assert f"# repeat_us: 3000000 6000000 {PASSES - 3}\n" in text
    again = from_text(text, robot)
    verify_program(again, robot)
    assert again.to_text() == text
    assert [*again.unrolled()] == [*short.unrolled()]
    assert again.duration_s == short.duration_s


@pytest.mark.parametrize(
    ("was", "now", "said"),
    [
        (" 6\n", " 1\n", "allows 2 to 1,000,000 TIMES"),
        (" 6\n", " 9999999\n", "allows 2 to 1,000,000 TIMES"),
        (" 6\n", " 9\n", "repeats more than `# duration_us:` allows"),
        (" 6\n", "\n", "needs `FROM TO TIMES`"),
        (" 6\n", " x\n", "'x' is not a whole number"),
    ],
)
def test_a_wrong_repetition_is_refused(stage, kit, monkeypatch, was, now, said):
    robot, _, short, _ = both(stage, kit, monkeypatch, looped(kit))
    text = short.to_text()
    assert was in text
    with pytest.raises(InputError, match=said):
        from_text(text.replace(was, now, 1), robot)


def test_a_million_passes_cost_as_little_as_four(stage, kit):
    sequence = replace(looped(kit, cues=[Cue(at_s=1.0, say="one")]), loop=1_000_000)
    program, _ = stage.compile(kit.robot(2), sequence)
    few, _ = stage.compile(kit.robot(2), replace(sequence, loop=4))
    assert len(program.moves) <= 1.2 * len(few.moves)
    assert len(program.marks) == len(few.marks)
    assert program.duration_s == pytest.approx(3e6)
    assert not math.isinf(program.pass_s)
    at_s = 3.0 * 700_000 + 1.25
    assert program.within(at_s) == pytest.approx(4.25, abs=1e-3)
    assert program.within(3e6 - 0.5) == pytest.approx(11.5, abs=1e-3)
