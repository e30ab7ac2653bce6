"""Shows that wait for a sensor: the robot stands until it says so, and then goes on."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError
from lss_motion.planning.program.text import from_text, to_text
from lss_motion.playing import api
from lss_motion.playing.player.events import CueReached, Waited
from lss_motion.protocol.table import Suffix
from lss_motion.robot.model import Sensor
from lss_motion.robot.on_fault import Cause
from lss_motion.show.model import Cue, Keyframe, PlaylistStep, Sequence, Wait
from lss_motion.sim.boards import SENSORS
from lss_motion.sim.faults import Fault, FaultKind

EXAMPLES = Path(__file__).parents[2] / "sequences"
EYE = Sensor(name="eye", servo_id=203, bus="bus0", kind="GP2Y0A41SK0F")
KNOB = Sensor(name="knob", servo_id=77, bus="bus0")
NEAR = Wait(sensor="eye", side="below", threshold=100.0)
STILL_DEG = 0.3
"""A standing horn with its noise, backlash and what is left of a move."""


def robot(kit, **fields):
    return replace(kit.robot(2, baud_bps=38400, **fields), sensors={"eye": EYE, "knob": KNOB})


def part(from_deg, to_deg):
    frames = (
        Keyframe(deg={"j0": from_deg, "j1": from_deg}, at_s=0.0),
        Keyframe(deg={"j0": to_deg, "j1": -to_deg}, at_s=1.0),
    )
    return Sequence(name="part", keyframes=frames)


def show(wait=NEAR, *, loop=1):
    steps = (
        PlaylistStep(sequence=part(0.0, 40.0)),
        PlaylistStep(wait=wait),
        PlaylistStep(sequence=part(40.0, 0.0)),
    )
    return Sequence(name="show", play=steps, loop=loop)


def sees(distance_mm, at_s):
    raw = SENSORS[Suffix.GP2Y0A41SK0F].raw(distance_mm)
    return Fault(kind=FaultKind.INPUT, at_s=at_s, servo_id=203, raw=raw)


def states(played):
    return [event.state for event in played.events if isinstance(event, Waited)]


def moves_ns(played):
    """Return when moves were received."""
    moves = set(played.moves())
    return [at_ns for at_ns, line in played.bus.lines if line in moves]


def waited_s(played):
    """Return from when to when the show stood, by what was asked of the sensor."""
    asked = [at_ns for at_ns, line in played.bus.lines if line == b"#203QA1\r"]
    return asked[0] / 1e9, asked[-1] / 1e9


def test_the_robot_stands_until_something_comes_near_and_then_goes_on(stage, kit):
    played = stage.play(robot(kit), show(), faults=[sees(250, 0.1), sees(60, 9.0)])
    assert played.report.outcome == "finished"
    assert states(played) == ["begun", "met"]
    from_s, to_s = waited_s(played)
    assert to_s == pytest.approx(9.0, abs=0.15)
    assert to_s - from_s > 4.0
    times_ns = np.arange(round((from_s + 0.2) * 1e9), round(to_s * 1e9), 10_000_000)
    horn_deg = played.bus.horn_deg(times_ns)
    assert np.ptp(horn_deg, axis=0).max() < STILL_DEG
    assert np.abs(horn_deg[:, 0] - 40.0).max() < 1.0
    assert not [at_ns for at_ns in moves_ns(played) if (from_s + 0.2) * 1e9 < at_ns < to_s * 1e9]
    error_deg = played.horn_error_deg()
    assert np.abs(error_deg).max() < 0.8, "the plan is followed on both sides of it"
    end_deg = played.bus.horn_deg(np.array([played.bus.lines[-1][0]]))[0, 0]
    assert abs(end_deg) < 1.0


def sway():
    frames = [
        Keyframe(deg={"j0": 40.0}, at_s=0.0),
        Keyframe(deg={"j0": 50.0}, at_s=0.8),
        Keyframe(deg={"j0": 40.0}, at_s=1.6),
    ]
    return Sequence(name="sway", keyframes=tuple(frames))


@pytest.mark.parametrize("loop", [1, 2])
def test_idle_motion_is_played_while_it_waits_and_left_at_its_end(stage, kit, loop):
    steps = (
        PlaylistStep(sequence=part(0.0, 40.0)),
        PlaylistStep(wait=NEAR, sequence=sway()),
        PlaylistStep(sequence=part(40.0, 0.0)),
    )
    idle = Sequence(name="show", play=steps, loop=loop)
    faults = [sees(250, 0.1), sees(60, 11.0)]
    played = stage.play(robot(kit), idle, faults=faults)
    assert played.report.outcome == "finished"
    assert played.report.timing.missed == 0
    assert states(played) == ["begun", "met"] * loop
    from_s = waited_s(played)[0]
    times_s = np.arange(from_s - 0.1, 16.0, 0.002)
    horn_deg, other_deg = played.bus.horn_deg((times_s * 1e9).astype(np.int64)).T
    is_up = horn_deg > 45.0
    ups = int(np.count_nonzero(np.diff(is_up.astype(int)) == 1))
    assert 3 <= ups <= 5, "it swings again and again"
    first_s = times_s[np.argmax(is_up)]
    waiting = (times_s > first_s) & (times_s < 11.0)
    assert horn_deg[waiting].min() > 39.0
    assert horn_deg[waiting].max() < 51.0
    assert np.ptp(other_deg[waiting]) < STILL_DEG
    left_s = times_s[(times_s > 11.0) & (other_deg > -38.0)][0]
    assert 11.0 < left_s < 11.0 + 3.0, "it is left when its pass is over"
    speed_deg_s = np.abs(np.gradient(horn_deg, times_s))
    limit = robot(kit).joints["j0"].speed_max_deg_s
    assert speed_deg_s.max() < 1.05 * limit + 5.0
    end_deg = played.bus.horn_deg(np.array([played.bus.lines[-1][0]]))[0, 0]
    assert abs(end_deg) < 1.0


def is_after(at_s):
    return lambda player, now_ns: player.phase == "playing" and now_ns > at_s * 1e9


def swaying(**fields):
    """Return the show whose idle motion says something at each swing."""
    idle = replace(sway(), events=(Cue(at_s=0.8, say="hm"),))
    steps = (
        PlaylistStep(sequence=part(0.0, 40.0)),
        PlaylistStep(wait=NEAR, sequence=idle),
        PlaylistStep(sequence=part(40.0, 0.0)),
    )
    return Sequence(name="show", play=steps, **fields)


def test_idle_motion_outlives_pauses_a_slow_show_a_stall_and_a_restart(stage, kit):
    wishes = [
        (is_after(4.0), kit.rate(0.0)),
        (is_after(5.0), kit.rate(1.0)),
        (is_after(6.2), kit.rate(0.5)),
        (is_after(9.0), kit.rate(1.0)),
    ]
    faults = [
        sees(250, 0.1),
        Fault(kind=FaultKind.OVERSLEEP, at_s=11.0, until_s=11.02, late_s=0.7),
        Fault(kind=FaultKind.RESET, servo_id=1, at_s=14.3, deaf_s=0.6),
        sees(60, 20.0),
    ]
    played = stage.play(robot(kit), swaying(), wishes=wishes, faults=faults)
    assert played.report.outcome == "finished"
    assert [fault.kind for fault in played.report.faults] == [Cause.STALLED, Cause.RESTARTED]
    assert states(played) == ["begun", "met"]
    from_s, to_s = waited_s(played)
    assert to_s == pytest.approx(20.0, abs=0.15)
    times_s = np.arange(from_s + 0.1, played.bus.lines[-1][0] / 1e9, 0.002)
    horn_deg, other_deg = played.bus.horn_deg((times_s * 1e9).astype(np.int64)).T
    waiting = times_s < to_s
    is_deaf = (times_s > 14.3) & (times_s < 17.0)
    assert horn_deg[waiting].min() > 39.0
    assert horn_deg[waiting].max() < 51.0
    assert np.ptp(other_deg[waiting]) < STILL_DEG
    assert np.abs(np.gradient(horn_deg, times_s))[~is_deaf].max() < 65.0
    assert abs(horn_deg[-1]) < 1.0
    # What is said at the end of each swing is said as often as the horn swings, and reported so.
    ups_s = times_s[1:][np.diff((horn_deg > 48.5).astype(int)) == 1]
    said = [event for event in played.events if isinstance(event, CueReached)]
    assert len(ups_s) >= 5
    assert len(said) == len(ups_s)
    reported_s = [one.at_s for one in played.report.timeline if one.text == "hm"]
    assert len(reported_s) == len(said)
    assert (np.diff(reported_s) > 1.0).all()


def test_a_person_may_stop_idle_motion(stage, kit):
    wishes = [(is_after(6.3), kit.stop)]
    played = stage.play(robot(kit), swaying(), wishes=wishes, faults=[sees(250, 0.1)])
    assert played.report.outcome == "stopped"
    assert played.lines()[-1] == b"#254H\r"
    stopped_s = played.acted_ns[0] / 1e9
    end_s = played.bus.lines[-1][0] / 1e9
    assert end_s - stopped_s < 1.0
    times_s = np.arange(stopped_s, end_s, 0.002)
    horn_deg = played.bus.horn_deg((times_s * 1e9).astype(np.int64))[:, 0]
    assert np.abs(np.diff(horn_deg)).max() / 0.002 < 65.0
    assert np.ptp(horn_deg[-25:]) < STILL_DEG


def test_a_program_with_idle_motion_is_read_as_it_was_written(kit):
    steps = (PlaylistStep(sequence=part(0.0, 40.0)), PlaylistStep(wait=NEAR, sequence=sway()))
    own = robot(kit)
    program = api.compile(api.plan(Sequence(name="show", play=steps), own), own)
    assert program.waits[0].back_s > 1.6
    again = from_text(to_text(program), own)
    assert again.waits[0].back_s == pytest.approx(program.waits[0].back_s)
    assert replace(again.waits[0], back_s=0.0) == replace(program.waits[0], back_s=0.0)


def test_it_goes_on_by_itself_after_the_timeout(stage, kit):
    played = stage.play(robot(kit), show(replace(NEAR, timeout_s=2.0)))
    assert played.report.outcome == "finished"
    assert states(played) == ["begun", "timeout"]
    from_s, to_s = waited_s(played)
    assert to_s - from_s == pytest.approx(2.0, abs=0.1)


def test_a_plain_input_is_compared_as_it_is(stage, kit):
    wait = Wait(sensor="knob", side="above", threshold=500.0)
    inputs = [
        Fault(kind=FaultKind.INPUT, at_s=s, servo_id=77, raw=raw)
        for s, raw in ((1.0, 500), (8.0, 501))
    ]
    played = stage.play(robot(kit), show(wait), faults=inputs)
    assert states(played) == ["begun", "met"]
    asked = [at_ns for at_ns, line in played.bus.lines if line == b"#77QA\r"]
    assert asked[-1] / 1e9 == pytest.approx(8.0, abs=0.15)


@pytest.mark.parametrize(("loop", "times"), [(2, 2), (None, 3)])
def test_every_pass_waits_again(stage, kit, loop, times):
    wishes = [(lambda player, now_ns: now_ns > 22e9, kit.stop)]
    played = stage.play(
        robot(kit),
        show(replace(NEAR, timeout_s=2.0), loop=loop),
        wishes=wishes if loop is None else (),
    )
    assert states(played) == ["begun", "timeout"] * times
    assert played.report.outcome == ("finished" if loop else "stopped")


def test_a_person_may_stop_a_robot_that_waits(stage, kit):
    played = stage.play(robot(kit), show(), wishes=[(lambda _, now_ns: now_ns > 9e9, kit.stop)])
    assert played.report.outcome == "stopped"
    assert played.lines()[-1] == b"#254H\r"
    assert states(played) == ["begun"]


def test_a_pause_outlasts_the_wait(stage, kit):
    wishes = [
        (
            lambda player, now_ns: player.show is not None and player.show.waiting.is_waiting,
            kit.rate(0.0),
        ),
        (lambda player, now_ns: now_ns > 12e9, kit.rate(1.0)),
    ]
    played = stage.play(robot(kit), show(), wishes=wishes, faults=[sees(60, 9.0)])
    assert played.report.outcome == "finished"
    assert states(played) == ["begun", "met"]
    moved_ns = moves_ns(played)
    assert not [at_ns for at_ns in moved_ns if 9.0e9 < at_ns < 12e9]
    assert [at_ns for at_ns in moved_ns if at_ns > 12e9]


def test_one_wrong_answer_does_not_set_it_off(stage, kit):
    blink = [sees(60, 9.0), sees(250, 9.03)]
    played = stage.play(robot(kit), show(replace(NEAR, timeout_s=6.0)), faults=blink)
    assert states(played) == ["begun", "timeout"]


def test_a_sensor_that_is_not_there_is_named_before_anything_moves(stage, kit):
    there = replace(robot(kit), sensors={})
    played = stage.play(robot(kit), show(), wired=there)
    assert isinstance(played.result.error, BusError)
    assert "sensor 'eye' (id 203 on bus 'bus0')" in str(played.result.error)
    assert played.moves() == []


def test_without_questions_it_cannot_wait(stage, kit):
    with pytest.raises(InputError, match="waits for a sensor"):
        stage.play(robot(kit), show(), has_feedback=False)


def test_a_wait_survives_the_text_form(stage, kit):
    for wait in (
        NEAR,
        replace(NEAR, timeout_s=0.25),
        Wait(sensor="knob", side="above", threshold=7.5),
    ):
        program, _ = stage.compile(robot(kit), show(wait))
        again = from_text(to_text(program), robot(kit))
        assert again.waits == program.waits
        assert [point.wait for point in again.waits] == [wait]
    with pytest.raises(InputError, match="no sensor 'eye'"):
        from_text(to_text(stage.compile(robot(kit), show())[0]), kit.robot(2))


def test_the_owl_of_the_examples_waits_for_a_visitor(stage):
    sequence = api.load_sequence(EXAMPLES / "visitor.yaml")
    program, _ = stage.compile(api.load_robot(sequence.robot_path), sequence)
    (point,) = program.waits
    assert point.wait == Wait(sensor="eye", side="below", threshold=500.0, timeout_s=3.0)
    assert min(move.due_us for move in program.moves) > 1e6 * point.at_s


def test_layers_do_not_wait(stage, kit):
    from lss_motion.show.model import Layer

    layer = Layer(sequence=part(0.0, 5.0), joints=("j0",), fade_s=0.5)
    with pytest.raises(InputError, match="put the layer"):
        stage.compile(robot(kit), replace(show(), layers=(layer,)))
