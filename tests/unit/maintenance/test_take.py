"""Takes: recorded poses and sections, cleaned of noise and damage, as a sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lss_motion.maintenance.take import (
    HAND_DEG_S2,
    STEP_S,
    Take,
    at_rest,
    cleaned,
    sequence_of,
    within,
)
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.hands_mapping import JointReading
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence
from lss_motion.show.write import write_sequence

ARM = Path(__file__).resolve().parents[3] / "sequences" / "robots" / "desk_arm.yaml"
SECOND = 1_000_000_000


@pytest.fixture
def arm():
    return load_robot(ARM)


def readings(curve, *, joint="base", start_ns=5 * SECOND, seconds=3.0):
    times_s = np.arange(0.003, seconds, 0.02)
    return [JointReading(joint, start_ns + int(t * 1e9), float(curve(t))) for t in times_s]


def wave(t):
    return 30.0 * np.sin(t) ** 2


def test_poses_and_sections_follow_each_other_at_approach_speed(arm, tmp_path):
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


def test_two_sections_are_joined_at_rest(arm):
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


def test_angles_beyond_the_range_are_cut_off_with_a_comment(arm):
    take = Take(("gripper",))
    take.drop({"gripper": 75.0})
    take.start(5 * SECOND)
    take.add(readings(lambda t: 40.0 + 30.0 * np.sin(t), joint="gripper"))
    take.finish()
    made = sequence_of(take, arm, "far", tolerance_deg=1.0)
    assert any("gripper was up to 15.0 deg beyond" in comment for comment in made.comments)
    assert plan(made.sequence, arm).sample(np.arange(0.0, 6.0, 0.01)).max() <= 60.0 + 1e-6


def test_readings_count_only_while_recording_and_can_be_undone():
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


def read(seed: int, rate_hz: float = 40.0):
    """A hand's motion as a servo reports it: uneven times, tenths of a degree, 0.1 deg noise."""
    rng = np.random.default_rng(seed)
    times_s = np.cumsum(rng.uniform(0.7, 1.3, int(4 * rate_hz))) / rate_hz
    true_deg = true_at(times_s)
    return times_s, np.round(true_deg + rng.uniform(-0.1, 0.1, len(times_s)), 1)


def true_at(times_s):
    return 40.0 * np.sin(2.0 * np.pi * 0.4 * times_s) + 5.0 * np.sin(2.0 * np.pi * times_s)


@pytest.mark.parametrize("seed", range(5))
def test_a_clean_recording_is_even_and_nearer_to_the_truth_than_the_readings(seed) -> None:
    times_s, readings_deg = read(seed)
    clean = cleaned(times_s, readings_deg)
    assert np.allclose(np.diff(clean.times_s), STEP_S)
    inside = (clean.times_s > 0.2) & (clean.times_s < times_s[-1] - 0.2)
    off_deg = clean.angles_deg[inside] - true_at(clean.times_s[inside])
    assert np.abs(off_deg).max() < 0.25
    assert 0.02 < clean.noise_deg < 0.15


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("damage_deg", [3.0, -9.0, 80.0, -900.0])
def test_damaged_readings_leave_no_trace(seed, damage_deg) -> None:
    times_s, readings_deg = read(seed)
    damaged = readings_deg.copy()
    hit = np.random.default_rng(seed + 100).choice(len(damaged), 8, replace=False)
    damaged[hit] += damage_deg
    clean = cleaned(times_s, damaged)
    inside = (clean.times_s > 0.2) & (clean.times_s < times_s[-1] - 0.2)
    off_deg = clean.angles_deg[inside] - true_at(clean.times_s[inside])
    assert np.abs(off_deg).max() < 1.5
    assert np.sqrt(np.mean(off_deg**2)) < 0.4


@pytest.mark.parametrize("place", [1, 30, 60, 61, 158])
@pytest.mark.parametrize("damage_deg", [4.0, 36.0, -80.0])
def test_a_damaged_reading_beside_a_gap_leaves_no_trace(place, damage_deg) -> None:
    """Its neighbour, with short times on both sides, is further beyond what a hand can do."""
    times_s = np.cumsum(np.where(np.arange(160) == 61, 0.16, 0.008))
    damaged = np.round(true_at(times_s), 1)
    damaged[place] += damage_deg
    clean = cleaned(times_s, damaged)
    assert np.abs(clean.angles_deg - true_at(clean.times_s))[1:-1].max() < 1.5


def test_a_fast_push_is_recorded_as_it_is() -> None:
    """300 deg/s within 0.15 s, and back."""
    times_s = np.arange(400) / 100.0
    speed_deg_s = 300.0 * np.interp(times_s, [1.0, 1.15, 1.3, 1.45, 1.6], [0, 1, 0, -1, 0])
    pushed_deg = np.cumsum(speed_deg_s) / 100.0
    clean = cleaned(times_s, np.round(pushed_deg, 1))
    assert np.ptp(pushed_deg) > 40.0
    assert np.abs(np.interp(times_s, clean.times_s, clean.angles_deg) - pushed_deg).max() < 1.0


def test_the_hardest_motion_of_a_hand_is_not_taken_for_damage() -> None:
    times_s = np.arange(200) / 50.0
    shake_deg = 10.0 * np.cos(2.0 * np.pi * 2.5 * times_s)
    assert (2.0 * np.pi * 2.5) ** 2 * 10.0 < HAND_DEG_S2
    clean = cleaned(times_s, shake_deg)
    assert np.ptp(clean.angles_deg[20:-20]) > 18.0


def test_a_recording_that_is_cut_off_in_motion_starts_and_ends_at_rest() -> None:
    times_s = np.round(np.arange(100) * STEP_S, 6)
    longer_s, angles_deg = at_rest(times_s, 90.0 * times_s, 300.0)
    assert longer_s[0] == pytest.approx(-0.3)
    assert longer_s[-1] == pytest.approx(0.99 + 0.3)
    speeds = np.diff(angles_deg) / STEP_S
    assert abs(speeds[0]) < 5.0
    assert abs(speeds[-1]) < 5.0
    assert np.abs(np.diff(speeds)).max() / STEP_S < 310.0
    assert speeds.max() == pytest.approx(90.0, abs=0.01)
    still_s, still_deg = at_rest(times_s, np.full(100, 7.0), 300.0)
    assert (still_s.tolist(), still_deg.tolist()) == (times_s.tolist(), [7.0] * 100)


def test_a_motion_beyond_the_range_is_bent_back_without_a_corner() -> None:
    times_s = np.arange(400) * STEP_S
    angles_deg = 60.0 * np.sin(times_s)
    kept = within(angles_deg, -90.0, 50.0)
    assert 49.0 < kept.max() <= 50.0
    assert np.abs(np.diff(kept, 2)).max() / STEP_S**2 < 700.0
    far = angles_deg < 35.0
    assert np.abs(kept - angles_deg)[far].max() < 0.01
    np.testing.assert_array_equal(within(angles_deg, -90.0, 59.8), np.minimum(angles_deg, 59.8))
