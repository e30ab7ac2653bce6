"""What is sent after this program was held up, judged by bytes and horns."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.playing.player.events import PhaseEntered
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.sim.faults import Fault, FaultKind

S = 1_000_000_000
SPEED_DEG_S = 180.0
MOVE = re.compile(rb"#(\d+)D(-?\d+)(?:T\d+)?\r")
STALLS_S = (0.05, 0.2, 1.0, 5.0, 30.0)


def held_up(at_s, late_s):
    """Return a fault that strikes the first wait that ends in the time after `at_s`."""
    until_s = at_s + min(0.8 * late_s, 0.4)
    return Fault(kind=FaultKind.OVERSLEEP, at_s=at_s, until_s=until_s, late_s=late_s)


def steps(played):
    return [(fault.joint, fault.kind, fault.step) for fault in played.report.faults]


def wakes(played, at_s, late_s):
    """Return the instant at which the program sent again after the stall."""
    return min(ns for ns, _, _ in played.sent if ns >= (at_s + late_s) * S)


def moves_at_once(played, at_s, late_s):
    """Return how many moves each servo was sent at the first instant after the stall."""
    if not played.report.faults:
        instants: dict[int, Counter[bytes]] = {}
        for at_ns, _, data in played.sent:
            ids = (match[1] for match in MOVE.finditer(data))
            instants.setdefault(at_ns, Counter()).update(ids)
        return max(max(counts.values(), default=0) for counts in instants.values())
    return max(moves_after(played, wakes(played, at_s, late_s)).values(), default=0)


def moves_after(played, from_ns):
    """Return how many moves each servo was sent shortly after an instant, before settings."""
    counts: Counter[bytes] = Counter()
    for at_ns, _, data in played.sent:
        if at_ns >= from_ns:
            if b"EM" in data or at_ns > from_ns + S // 50:
                break
            counts.update(match[1] for match in MOVE.finditer(data))
    return counts


def assert_speeds_hold(played, slack=1.05):
    horns = played.bus.horn_deg(np.arange(0, played.bus.lines[-1][0], 5_000_000))
    speed = (horns[4:] - horns[:-4]) / 0.02
    assert np.abs(speed).max() <= slack * SPEED_DEG_S


@pytest.mark.parametrize(
    ("late_s", "at_s", "has_feedback"),
    [
        *((late_s, at_s, True) for late_s in STALLS_S for at_s in (1.9, 4.6)),
        *((late_s, at_s, False) for late_s in (0.2, 5.0) for at_s in (0.3, 1.9, 4.6)),
        (5.0, 0.3, True),
    ],
)
def test_after_a_stall_a_servo_gets_one_move_and_the_show_goes_on(
    stage, kit, late_s, at_s, has_feedback
):
    sequence = kit.sequence(2, 1.6, swing_deg=40.0, step_s=(0.3, 0.5), loop=3)
    played = stage.play(
        kit.robot(2, baud_bps=38400), sequence, faults=[held_up(at_s, late_s)],
        has_feedback=has_feedback, start_deg={"j0": 20.0, "j1": -10.0},
    )  # fmt: skip
    assert played.report.outcome == "finished"
    assert_speeds_hold(played)
    (end_deg,) = played.bus.horn_deg([played.bus.lines[-1][0]])
    assert np.abs(end_deg).max() < 1.0, "it ends where the plan ends"
    is_stall = late_s > 0.25 and at_s > 0.5
    assert steps(played) == [("", Cause.STALLED, FaultStep.RESUME)] * is_stall
    assert moves_at_once(played, at_s, late_s) <= 1


@pytest.mark.slow
def test_thirty_seconds_of_stall_send_no_queue_of_moves(stage, kit):
    robot = kit.robot(3, baud_bps=115200)
    sequence = kit.sequence(3, 6.0, swing_deg=60.0, step_s=(0.5, 0.9), loop=8)
    played = stage.play(robot, sequence, faults=[held_up(3.0, 30.0)], has_feedback=False)
    woke_ns = wakes(played, 3.0, 30.0)
    at_once = [data for ns, _, data in played.sent if woke_ns <= ns < woke_ns + S // 10]
    assert len(MOVE.findall(b"".join(at_once))) <= 3
    assert steps(played) == [("", Cause.STALLED, FaultStep.RESUME)]
    text = r"held up for (29.9|30.0)\d* s at \d\.\d\d s of the show: stopped \(Ctrl-Z\)"
    assert re.search(text, played.report.faults[0].cause)
    horns = played.bus.horn_deg(np.arange(woke_ns, woke_ns + S // 5, 5_000_000))
    assert np.abs(np.diff(horns, axis=0)).max() / 0.005 <= 30.0 * 1.1 + 40.0
    assert played.report.outcome == "finished"
    assert np.abs(played.horn_error_deg(from_s=40.0)).max() < 4.0
    assert_speeds_hold(played)


def test_a_stall_ends_the_show_where_the_robot_file_requires_it(stage, kit):
    robot = kit.robot(2, on_fault={Cause.STALLED: (FaultStep.HOLD,)})
    played = stage.play(robot, kit.sequence(2, 6.0), faults=[held_up(3.0, 5.0)])
    assert played.report.outcome == "fault"
    assert steps(played) == [("", Cause.STALLED, FaultStep.HOLD)]
    assert played.lines()[-1] == b"#254H\r"
    phases = [event.phase for event in played.events if isinstance(event, PhaseEntered)]
    assert phases[-3:] == ["stopping", "restoring", "done"]


def test_a_joint_far_off_its_plan_comes_back_and_does_not_swing_while_the_show_is_slowed(
    stage, kit
):
    """It came at full speed, could not brake, and swung by 23 deg past its plan."""
    sequence = kit.sequence(2, 1.6, swing_deg=40.0, step_s=(0.3, 0.5), loop=3)
    slowed = (lambda player, now_ns: player.phase == "playing" and now_ns > 4.95 * S, kit.rate(0.5))
    played = stage.play(
        kit.robot(2, baud_bps=38400), sequence, faults=[held_up(4.6, 0.2)], wishes=[slowed],
        start_deg={"j0": 20.0, "j1": -10.0},
    )  # fmt: skip
    assert played.report.outcome == "finished"
    assert steps(played) == []
    assert np.abs(played.horn_error_deg()).max() > 10.0, "it was far off"
    error_deg = played.horn_error_deg(from_s=3.55)
    assert error_deg[:, 1].max() < 8.0, "it hardly passes its plan"
    assert np.abs(played.horn_error_deg(from_s=4.0)).max() < 2.5


def test_a_key_pressed_in_a_stall_does_not_hide_it(stage, kit):
    """The key is taken when the program runs again: before the moves that were due."""
    sequence = kit.sequence(2, 6.0, swing_deg=40.0, step_s=(0.5, 0.8))
    woken = (lambda player, now_ns: player.phase == "playing" and now_ns > 4.5 * S, kit.rate(0.5))
    played = stage.play(kit.robot(2), sequence, faults=[held_up(3.0, 5.0)], wishes=[woken])
    assert len(played.acted_ns) == 1
    assert played.acted_ns[0] < 8.5 * S
    assert steps(played) == [("", Cause.STALLED, FaultStep.RESUME)]
    assert played.report.outcome == "finished"


def test_a_stall_while_nothing_is_due_is_a_warning(stage, kit):
    rest = kit.sequence(1, 3.0).keyframes[-1]
    sequence = replace(
        kit.sequence(1, 3.0), keyframes=(*kit.sequence(1, 3.0).keyframes, replace(rest, at_s=7.0))
    )
    played = stage.play(kit.robot(1), sequence, faults=[held_up(5.0, 0.5)])
    assert played.report.outcome == "finished"
    assert not played.report.faults
    assert ["No move was due meanwhile" in text for text in played.report.warnings] == [True]


def test_a_stall_that_begins_at_rest_and_ends_in_motion_is_one(stage, kit):
    swing = [(0.0, 0.0), (1.0, 40.0), (3.0, 40.0), (4.0, -20.0), (4.6, 20.0), (5.2, 0.0)]
    frames = tuple(Keyframe(deg={"j0": deg}, at_s=at_s) for at_s, deg in swing)
    played = stage.play(
        kit.robot(1), Sequence(name="rests", keyframes=frames), faults=[held_up(2.6, 2.5)]
    )
    assert played.report.outcome == "finished"
    assert steps(played) == [("", Cause.STALLED, FaultStep.RESUME)]
    assert_speeds_hold(played)
    (end_deg,) = played.bus.horn_deg([played.bus.lines[-1][0]])
    assert np.abs(end_deg).max() < 1.0


def test_a_stall_over_the_seam_of_a_loop_that_never_rests_goes_on_in_its_pass(stage, kit):
    swing = [(0.0, 0.0), (0.75, 30.0), (1.5, 0.0), (2.25, -30.0), (3.0, 0.0)]
    frames = tuple(Keyframe(deg={"j0": deg}, at_s=at_s) for at_s, deg in swing)
    sequence = Sequence(name="swing", keyframes=frames, loop=3)
    played = stage.play(kit.robot(1), sequence, faults=[held_up(3.1, 2.0)])
    assert played.report.outcome == "finished"
    assert steps(played) == [("", Cause.STALLED, FaultStep.RESUME)]
    assert_speeds_hold(played)
    horn_deg = played.bus.horn_deg(np.arange(5 * S, played.bus.lines[-1][0], 5_000_000))[:, 0]
    assert sum((horn_deg[:-1] <= 20.0) & (horn_deg[1:] > 20.0)) == 2, "two passes are left"
    assert abs(horn_deg[-1]) < 1.0


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["streamed", "stepped"])
@pytest.mark.parametrize("late_s", [0.1, 5.0])
def test_other_drives_get_one_target_after_a_stall(stage, kit, drive, late_s):
    fields = {"drive": drive, "baud_bps": 115200}
    if drive == "stepped":
        fields["model"] = SERVO_MODELS["LSS-2IO"]
    robot = kit.robot(2, **fields)
    sequence = kit.sequence(2, 4.0, swing_deg=40.0, step_s=(0.6, 0.9), loop=2)
    played = stage.play(robot, sequence, faults=[held_up(3.0, late_s)])
    assert played.report.outcome == "finished"
    (end_deg,) = played.bus.horn_deg([played.bus.lines[-1][0]])
    assert np.abs(end_deg).max() < 1.0
    assert moves_at_once(played, 3.0, late_s) <= 1
    if drive == "streamed":
        assert_speeds_hold(played, 1.15)


@pytest.mark.parametrize(
    ("line", "at_s", "into_s", "late_s", "servo_id", "seed"),
    [
        ((3, 115200), 4.9678, 0.0457, 0.40, 3, 320),
        ((3, 115200), 1.8637, 0.0760, 0.35, 3, 16),
        ((6, 38400), 4.0059, 0.0707, 0.35, 2, 149),
    ],
)
def test_a_servo_that_restarted_in_a_pause_of_the_host_keeps_its_limits(
    stage, kit, line, at_s, into_s, late_s, servo_id, seed
):
    count, baud_bps = line
    reset = Fault(kind=FaultKind.RESET, servo_id=servo_id, at_s=at_s, deaf_s=0.41)
    pause_s = at_s + into_s
    pause = Fault(kind=FaultKind.OVERSLEEP, at_s=pause_s, until_s=pause_s + 0.02, late_s=late_s)
    sequence = kit.sequence(count, 5.0, seed=7, swing_deg=85.0, step_s=(0.5, 0.7))
    robot = kit.robot(count, baud_bps=baud_bps)
    played = stage.play(robot, sequence, faults=[reset, pause], seed=seed)
    assert played.report.outcome == "finished"
    assert_speeds_hold(played)
