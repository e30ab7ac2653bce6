from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lss_motion.maintenance.hands_on import Reading
from lss_motion.maintenance.take import Take, sequence_of
from lss_motion.robot.load import load_robot
from lss_motion.sequence.load import load_sequence
from lss_motion.sequence.write import write_sequence
from lss_motion.trajectory.planner import plan

ARM = Path(__file__).resolve().parents[3] / "sequences" / "robots" / "desk_arm.yaml"
SECOND = 1_000_000_000


@pytest.fixture
def arm():
    return load_robot(ARM)


def readings(curve, *, joint="base", start_ns=5 * SECOND, seconds=3.0):
    times_s = np.arange(0.003, seconds, 0.02)
    return [Reading(joint, start_ns + int(t * 1e9), float(curve(t))) for t in times_s]


def wave(t):
    return 30.0 * np.sin(t) ** 2


def test_poses_and_stretches_follow_each_other_at_a_sober_pace(arm, tmp_path):
    take = Take(("base", "elbow"))
    take.drop({"base": -45.04, "elbow": 10.0})
    take.start(5 * SECOND)
    take.add([*readings(wave), *readings(lambda t: -20.0, joint="elbow")])
    take.finish()
    take.drop({"base": 60.0, "elbow": -20.0})
    made = sequence_of(take, arm, "mixed", tolerance_deg=0.5)
    path = tmp_path / "mixed.yaml"
    write_sequence(made.sequence, path, comments=made.comments)
    trajectory = plan(load_sequence(path, arm), arm)
    assert not trajectory.stretched
    labels = [k.label for k in made.sequence.keyframes if k.label]
    assert labels == ["pose 1", "pose 3"]
    start_s = next(m.planned_s for m in trajectory.marks if not m.label) + 0.1
    times_s = np.arange(0.1, 2.7, 0.01)
    planned_deg = trajectory.sample(start_s + times_s)[:, trajectory.joints.index("base")]
    assert np.abs(planned_deg - [wave(t) for t in times_s]).max() < 0.6
    between_deg_s = np.abs(trajectory.sample(np.arange(0.0, start_s, 0.01), 1)).max()
    assert between_deg_s <= 2.0 * arm.approach_speed_deg_s  # A smooth move peaks at 1.5 times.
    end = trajectory.sample(np.array([trajectory.duration_s]))[0]
    assert end[trajectory.joints.index("base")] == pytest.approx(60.0)


def test_two_stretches_are_joined_at_rest(arm):
    take = Take(("base",))
    for start_s in (5, 20):
        take.start(start_s * SECOND)
        take.add(readings(wave, start_ns=start_s * SECOND))
        take.finish()
    made = sequence_of(take, arm, "twice", tolerance_deg=0.5)
    trajectory = plan(made.sequence, arm)
    assert 2 * 3.0 + 0.5 < trajectory.duration_s < 2 * 3.6 + 2.0
    assert not trajectory.stretched
    assert len(made.fits) == 2


def test_angles_beyond_the_range_are_cut_off_and_it_is_said(arm):
    take = Take(("gripper",))
    take.drop({"gripper": 75.0})
    take.start(5 * SECOND)
    take.add(readings(lambda t: 40.0 + 30.0 * np.sin(t), joint="gripper"))
    take.finish()
    made = sequence_of(take, arm, "far", tolerance_deg=1.0)
    assert any("gripper was up to 15.0 deg beyond" in comment for comment in made.comments)
    assert plan(made.sequence, arm).sample(np.arange(0.0, 6.0, 0.01)).max() <= 60.0 + 1e-6


def test_what_is_read_counts_only_while_recording_and_can_be_forgotten():
    take = Take(("base",))
    take.add(readings(wave))
    assert take.recorded_s == 0.0
    take.start(5 * SECOND)
    take.add(readings(wave, start_ns=4 * SECOND, seconds=0.9))  # Before it began.
    assert take.recorded_s == 0.0
    take.finish()
    assert not take.parts
    assert not take.undo()
    take.start(5 * SECOND)
    take.add(readings(wave))
    assert take.recorded_s == pytest.approx(3.0, abs=0.03)
    assert take.undo()
    assert (take.running, take.parts) == (None, [])
