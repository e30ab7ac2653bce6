"""Shows that are sent to another place while they play, judged at the horns."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.playing.player.events import MarkPassed, PhaseEntered

S = 1_000_000_000


def seek(to):
    return lambda player, now_ns: player.seek(to, now_ns)


def assert_limits_hold(played, robot, slack=1.06):
    """Judge speed and acceleration of every horn over the whole run."""
    end_ns = max(ns for ns, _, _ in played.sent)
    speed, accel = played.speeds(0, end_ns)
    for column, joint in enumerate(robot.joints.values()):
        # A fitted course of a filter oscillates within its tolerance, with every step.
        room = 0.2 / 0.02**2 if joint.drive == "streamed" else 0.0
        assert np.abs(speed[:, column]).max() <= slack * joint.speed_max_deg_s
        assert np.abs(accel[:, column]).max() <= 1.1 * joint.accel_max_deg_s2 + room


def phases(played):
    return [event.phase for event in played.events if isinstance(event, PhaseEntered)]


ENDED = ["playing", "restoring", "done"]


@pytest.mark.parametrize(
    ("drive", "at_s", "to_s"), [("timed", 0.8, 2.4), ("timed", 2.2, 0.6), ("streamed", 2.2, 0.6)]
)
def test_a_seek_is_no_step_and_the_show_goes_on_from_there(stage, kit, drive, at_s, to_s):
    robot = kit.robot(2, baud_bps=115200, drive=drive)
    show = kit.sequence(2, 4.0, step_s=(0.6, 0.9))
    played = stage.play(robot, show, wishes=[(kit.in_show(at_s), seek(to_s))])
    assert played.report.outcome == "finished"
    assert phases(played)[-6:] == ["playing", "seeking", "approaching", *ENDED]
    assert_limits_hold(played, robot)
    # From the place that was asked for, the horns follow the plan to its end.
    times_s = played.result.truth.times_s
    (jump,) = np.flatnonzero(np.abs(np.diff(times_s)) > 0.02)
    assert times_s[jump] == pytest.approx(at_s, abs=0.6)
    assert times_s[jump + 1] == pytest.approx(to_s, abs=0.021)
    assert times_s[-1] == pytest.approx(4.0, abs=0.021)
    error = played.result.truth.horn_deg - played.trajectory.sample(times_s)
    assert np.abs(error[jump + 1 :]).max() < 1.5


def test_a_seek_to_a_label_in_a_pause_stands_there_until_it_is_resumed(stage, kit):
    robot = kit.robot(1, baud_bps=115200)
    show = kit.sequence(1, 4.0, step_s=(0.6, 0.9))
    label, label_s = show.keyframes[3].label, show.keyframes[3].at_s
    stood = []

    def stands(player, now_ns):
        stood.append(now_ns)
        is_there = player.show.show_s(now_ns) == pytest.approx(label_s, abs=1e-6)
        return player.phase == "playing" and is_there and now_ns > stood[0] + 3 * S

    played = stage.play(
        robot,
        show,
        wishes=[
            (kit.in_show(0.5), kit.rate(0.0)),
            (lambda player, now_ns: player.show.is_standing(now_ns), seek(label)),
            (stands, kit.rate(1.0)),
        ],
    )
    assert phases(played)[-6:] == ["playing", "seeking", "approaching", *ENDED]
    resumed_ns = played.acted_ns[2]
    horn_deg = played.bus.horn_deg(np.array([resumed_ns - S // 2, resumed_ns]))[:, 0]
    assert horn_deg == pytest.approx(np.repeat(show.keyframes[3].deg["j0"], 2), abs=0.6)
    passed = [event.label for event in played.events if isinstance(event, MarkPassed)]
    assert passed[0] == "start"
    assert passed[2:] == [frame.label for frame in show.keyframes[3:]]


def test_a_show_without_end_is_sent_hours_ahead_and_back(stage, kit):
    robot = kit.robot(1, baud_bps=115200)
    show = kit.sequence(1, 4.0, step_s=(0.6, 0.9), loop=None)
    played = stage.play(
        robot,
        show,
        wishes=[
            (kit.in_show(1.0), seek(40_001.5)),
            (kit.in_show(40_003.0), seek(2.0)),
            (kit.in_show(2.5), kit.stop),
        ],
    )
    assert played.report.outcome == "stopped"
    assert phases(played).count("seeking") == 2
    assert_limits_hold(played, robot)
    # Hours ahead, the horn is where the plan of that pass is.
    at_ns = played.acted_ns[1]
    planned_deg = played.trajectory.sample([3.0])[0]
    assert played.bus.horn_deg(np.array([at_ns]))[0] == pytest.approx(planned_deg, abs=2.5)


def test_a_second_wish_while_the_robot_moves_there_counts(stage, kit):
    robot = kit.robot(1, baud_bps=115200)
    show = kit.sequence(1, 4.0, step_s=(0.6, 0.9))
    played = stage.play(
        robot,
        show,
        wishes=[
            (kit.in_phase("approaching"), seek(1.0)),  # before it has begun
            (kit.in_show(1.2), seek(3.0)),
            (kit.in_phase("seeking"), seek(0.5)),
            (kit.in_phase("approaching"), seek(2.5)),
        ],
    )
    assert played.report.outcome == "finished"
    times_s = played.result.truth.times_s
    jumps = np.flatnonzero(np.abs(np.diff(times_s)) > 0.02)
    assert times_s[[0, *(jumps + 1)]] == pytest.approx([1.0, 2.5], abs=0.021)
    assert_limits_hold(played, robot)


def test_what_is_not_in_the_show_or_comes_too_late_is_refused(stage, kit):
    robot = kit.robot(1, baud_bps=115200)
    refused = []

    def wish(to):
        def act(player, now_ns):
            with pytest.raises(InputError) as error:
                player.seek(to, now_ns)
            refused.append(str(error.value))

        return act

    played = stage.play(
        robot,
        kit.sequence(1, 3.0, step_s=(0.6, 0.9)),
        wishes=[
            (kit.in_show(0.5), wish(99.0)),
            (kit.in_show(0.5), wish("strat")),
            (kit.in_phase("restoring"), wish(1.0)),
        ],
    )
    assert played.report.outcome == "finished"
    assert "seeking" not in phases(played)
    assert refused[0] == "99 s is not in the show, which ends at 3.000 s"
    assert "did you mean 'start'" in refused[1]
    assert "restoring" in refused[2]


def test_a_fault_while_it_goes_there_leads_to_the_new_place(stage, kit):
    robot = kit.robot(2, baud_bps=115200)
    show = kit.sequence(2, 4.0, step_s=(0.6, 0.9))

    def lose_and_find(player, now_ns):
        player.port_lost("bus0", "unplugged", now_ns)
        player.port_found("bus0")

    played = stage.play(
        robot,
        show,
        wishes=[(kit.in_show(1.0), seek(2.5)), (kit.in_phase("seeking"), lose_and_find)],
    )
    assert played.report.outcome == "finished"
    times_s = played.result.truth.times_s
    (jump,) = np.flatnonzero(np.abs(np.diff(times_s)) > 0.02)
    assert times_s[jump + 1] == pytest.approx(2.5, abs=0.021)
    assert_limits_hold(played, robot)
