"""A jaw that keeps its time beside a neck that is late, judged at the horns."""

from __future__ import annotations

import numpy as np

from lss_motion.show.model import Keyframe, Sequence
from lss_motion.sim.physics import Physics

SPEED_DEG_S, ACCEL_DEG_S2 = 180.0, 600.0
EXACT_S = (2.3, 3.3)


def speech() -> Sequence:
    """Return syllables of irregular length, most too fast, and a turn of the neck in no time."""
    random = np.random.default_rng(7)
    frames = [Keyframe(at_s=0.0, deg={"j0": 0.0, "j1": 0.0})]
    at_s = 0.5
    while at_s < 4.0:
        for deg in (float(random.uniform(8.0, 25.0)), 0.0):
            at_s = round(at_s + float(random.uniform(0.06, 0.18)), 2)
            frames.append(Keyframe(at_s=at_s, deg={"j0": round(deg, 1)}))
    # At these two the lips must be closed, whatever it takes.
    frames += [Keyframe(at_s=at, deg={"j0": 0.0}, is_exact=True, hold_s=0.05) for at in EXACT_S]
    frames = [f for f in frames if f.is_exact or all(abs(f.at_s - t) > 0.12 for t in EXACT_S)]
    frames += [Keyframe(at_s=1.0, deg={"j1": 0.0}), Keyframe(at_s=1.1, deg={"j1": 80.0})]
    frames.append(Keyframe(at_s=5.0, deg={"j0": 0.0, "j1": 0.0}))
    frames.sort(key=lambda frame: frame.at_s)
    return Sequence(name="speech", keyframes=tuple(frames), keeps_time=frozenset({"j0"}))


def test_the_horn_of_a_jaw_is_in_time_within_its_limits(stage, kit):
    robot = kit.robot(2, baud_bps=115200)
    played = stage.play(robot, speech(), physics=Physics(noise_deg=0.0))
    assert played.report.outcome == "finished"
    assert played.report.timing.missed == 0
    assert [(span.joint, span.limit) for span in played.report.stretched] == [
        ("j1", "acceleration")
    ]
    assert {span.joint for span in played.report.given_up} == {"j0"}
    truth = played.result.truth
    jaw = truth.horn_deg[:, 0]
    speed, accel = played.speeds(played.bus.lines[0][0], played.bus.lines[-1][0])
    assert np.abs(speed[:, 0]).max() <= 1.05 * SPEED_DEG_S
    assert np.abs(accel[:, 0]).max() <= 1.1 * ACCEL_DEG_S2
    # The best fit of the horn to the plan is not shifted in time.
    shifts_s = np.arange(-0.1, 0.1001, 0.005)
    inner = (truth.times_s > 0.6) & (truth.times_s < 4.4)
    errors = [
        np.mean((jaw[inner] - played.trajectory.sample(truth.times_s[inner] + by)[:, 0]) ** 2)
        for by in shifts_s
    ]
    assert abs(shifts_s[int(np.argmin(errors))]) <= 0.0101
    assert np.sqrt(min(errors)) < 0.4
    for at_s in EXACT_S:
        closed = (truth.times_s > at_s) & (truth.times_s < at_s + 0.05)
        assert np.abs(jaw[closed]).max() < 0.6


def test_horns_follow_a_motion_that_is_at_its_limit_all_the_time(stage, kit):
    """With no reserve of acceleration the servo falls behind, turn by turn."""
    frames = [Keyframe(at_s=0.0, deg={"j0": 0.0, "j1": 0.0})]
    frames += [
        Keyframe(
            at_s=round(0.5 + k / 3.0, 4), deg={"j0": 25.0 * (k % 2), "j1": 80.0 * (k % 2) - 40.0}
        )
        for k in range(1, 31)
    ]
    frames.append(Keyframe(at_s=12.0, deg={"j0": 0.0, "j1": 0.0}))
    sequence = Sequence(name="nod", keyframes=tuple(frames), keeps_time=frozenset({"j0", "j1"}))
    played = stage.play(kit.robot(2, baud_bps=115200), sequence)
    assert played.report.outcome == "finished"
    assert np.sqrt(np.mean(played.horn_error_deg() ** 2, axis=0)).max() < 0.6
