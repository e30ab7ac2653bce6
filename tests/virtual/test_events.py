"""What is not motion: when it is set off, judged at the servos and in what the player says."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing.player.events import CueReached, MarkPassed
from lss_motion.show.model import Cue, PlaylistStep, Sequence
from lss_motion.units import line_time_ns

RED, BLUE, WHITE = 1, 3, 7
COMMAND_US = line_time_ns(len(b"#12D-450T50\r"), 115200) // 1000


def cues_of(played):
    return [(event.cue, event.show_s) for event in played.events if isinstance(event, CueReached)]


def marks_of(played):
    return [(event.label, event.show_s) for event in played.events if isinstance(event, MarkPassed)]


def leds(played):
    """Return show time and line of every colour that a servo received."""
    clock = played.result.player.show.clock
    return [(clock.show_s(at_ns), line) for at_ns, line in played.bus.lines if b"LED" in line]


@pytest.mark.parametrize("has_feedback", [True, False])
def test_colours_come_at_their_time_between_the_moves_and_go_after_the_show(
    stage, kit, has_feedback
):
    """All joints at once: the orders are spread over the gaps, and no command is late for them."""
    robot = kit.robot(18, baud_bps=57600)
    every = tuple((name, BLUE) for name in robot.joints)
    show = replace(kit.sequence(18, 4.0), events=(Cue(at_s=2.0, led=every),))
    played = stage.play(robot, show, has_feedback=has_feedback)
    lit = [(at_s, line) for at_s, line in leds(played) if line.endswith(b"LED%d\r" % BLUE)]
    assert {line for _, line in lit} == {b"#%dLED%d\r" % (i + 1, BLUE) for i in range(18)}
    assert all(2.0 < at_s < 2.2 for at_s, _ in lit)
    assert played.report.timing.late_max_us <= COMMAND_US
    restored = [line for _, line in leds(played)[-18:]]
    assert set(restored) == {b"#%dLED%d\r" % (i + 1, WHITE) for i in range(18)}
    assert played.lines()[-1] == b"#254H\r"


@pytest.mark.parametrize("has_feedback", [True, False])
def test_marks_and_cues_come_in_every_pass_at_their_time(stage, kit, has_feedback):
    show = replace(kit.sequence(3, 3.0, loop=3), events=(Cue(at_s=1.0, say="hello"),))
    played = stage.play(sequence=show, has_feedback=has_feedback)
    labels = [label for label, _ in marks_of(played)]
    assert labels.count("start") == labels.count("end") == 3
    said = [show_s for _, show_s in cues_of(played)]
    assert said == pytest.approx([1.0, 4.0, 7.0], abs=0.2)
    times_s = [show_s for _, show_s in marks_of(played)]
    assert times_s == sorted(times_s)
    period_s = played.result.player.program.duration_s / 3
    starts_s = [show_s for label, show_s in marks_of(played) if label == "start"]
    assert starts_s == pytest.approx([0.0, period_s, 2 * period_s], abs=0.2)


def test_a_loop_without_end_reports_the_same_in_every_pass(stage, kit):
    """A sound at the start of a pass is set off in the pass before, by its lead."""
    events = (Cue(at_s=0.0, sound="a.wav", lead_s=0.2), Cue(at_s=2.0, say="x"))
    show = replace(kit.sequence(2, 3.0, loop=None), events=events)
    played = stage.play(kit.robot(2), show, wishes=[(kit.in_show(10.0), kit.stop)])
    said = [show_s for cue, show_s in cues_of(played) if cue.say]
    received = [show_s for cue, show_s in cues_of(played) if cue.sound]
    assert len(said) == 3
    assert len(received) == 4
    for times_s in (said, received):
        periods_s = [b - a for a, b in pairwise(times_s)]
        assert periods_s[-1] == pytest.approx(periods_s[0], abs=0.1)
        assert periods_s[-1] == pytest.approx(3.0, abs=0.3)


def test_where_the_plan_is_slower_cues_come_later(stage, kit):
    slow = kit.sequence(3, 3.0)
    frames = tuple(replace(f, at_s=f.at_s / 10) for f in slow.keyframes)
    show = replace(slow, keyframes=frames, events=(Cue(at_s=frames[1].at_s, say="now"),))
    played = stage.play(sequence=show)
    [(_, show_s)] = cues_of(played)
    reached_s = dict(marks_of(played))[frames[1].label]
    assert show_s == pytest.approx(reached_s, abs=1e-6)
    assert reached_s > 1.5 * frames[1].at_s


def test_the_steps_of_a_play_list_bring_their_cues(stage, kit):
    part = replace(kit.sequence(2, 3.0), events=(Cue(at_s=1.0, say="part"),))
    show = Sequence(
        name="list",
        play=(PlaylistStep(sequence=part, times=2), PlaylistStep(pause_s=1.0)),
        events=(Cue(at_s=0.5, say="list"),),
    )
    played = stage.play(kit.robot(2), show)
    said = [(cue.say, show_s) for cue, show_s in cues_of(played)]
    assert [what for what, _ in said] == ["list", "part", "part"]
    assert [at_s for _, at_s in said] == pytest.approx([0.5, 1.0, 4.0], abs=0.2), said


def test_a_show_from_its_middle_leaves_out_what_was_before(stage, kit):
    events = (Cue(at_s=1.0, say="before"), Cue(at_s=3.0, say="after"))
    show = replace(kit.sequence(2, 4.0), events=events)
    played = stage.play(kit.robot(2), show, start_s=2.0)
    assert [cue.say for cue, _ in cues_of(played)] == ["after"]


def test_a_pause_delays_cues_with_the_show(stage, kit):
    show = replace(kit.sequence(2, 3.0), events=(Cue(at_s=2.0, led=(("j0", RED),)),))
    wishes = [
        (kit.in_show(1.0), kit.rate(0.0)),
        (lambda player, now_ns: now_ns > 4e9, kit.rate(1.0)),
    ]
    played = stage.play(kit.robot(2), show, wishes=wishes)
    [at_s] = [at_s for at_s, line in leds(played) if line == b"#1LED%d\r" % RED]
    assert 2.0 < at_s < 2.1
    assert np.abs(played.horn_error_deg()).max() < 3.0


def test_an_event_after_the_end_is_refused(stage, kit):
    show = replace(kit.sequence(2, 3.0), events=(Cue(at_s=9.0, say="x", line=12),))
    with pytest.raises(InputError, match="never reached") as caught:
        stage.compile(kit.robot(2), show)
    assert caught.value.line == 12


def test_a_function_that_is_not_there_is_refused_in_virtual_time_as_well(stage, kit):
    show = replace(kit.sequence(1, 2.0), events=(Cue(at_s=1.0, run="nomodule:f", folder="/"),))
    with pytest.raises(InputError, match="run: 'nomodule:f' cannot be used"):
        stage.play(kit.robot(1), show)
