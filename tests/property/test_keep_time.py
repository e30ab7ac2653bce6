"""Random motions with `keep: time` against the least squared deviation on a fine grid."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.model import Interpolation, Keyframe, Sequence
from tests.joints import joint
from tests.least_deviation import optimum

MOTIONS = 24
RELENTLESS = (7039, 7071)
"""Here the joint is at its acceleration limit for several seconds, and keeps a reserve."""
RATIO = 1.01
RMS_DEG = 0.002
"""Deviations that differ by less are equal: the optimum itself is sampled."""


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


def robot_of(*joints) -> Robot:
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="face", path=None, buses={"main": bus}, joints={j.name: j for j in joints})


def any_motion(seed: int) -> tuple[Sequence, Robot]:
    """Return the keys of a joint, most moves up to eight times too fast, and a calm end."""
    random = np.random.default_rng(seed)
    speed, accel = float(random.uniform(90.0, 360.0)), float(random.uniform(300.0, 1500.0))
    reach = round(float(random.uniform(20.0, 120.0)), 1)
    ease = Interpolation(str(random.choice(["smooth", "smooth", "linear", "spline"])))
    own = joint(
        "jaw",
        1,
        position_min_deg=-reach,
        position_max_deg=reach,
        speed_max_deg_s=speed,
        accel_max_deg_s2=accel,
    )
    frames = [Keyframe(at_s=0.0, deg={"jaw": 0.0})]
    at_s = 0.5
    for _ in range(int(random.integers(3, 25))):
        gap_s = float(random.choice([0.06, 0.1, 0.15, 0.3, 0.7]))
        at_s = round(at_s + gap_s, 3)
        most_deg = accel * gap_s**2 / 4.0 * float(random.uniform(0.3, 8.0))
        deg = round(float(np.clip(random.normal(0.0, most_deg), -reach, reach)), 1)
        hold_s = float(random.choice([0.0, 0.0, 0.0, 0.2]))
        frames.append(Keyframe(at_s=at_s, deg={"jaw": deg}, hold_s=hold_s, ease=ease))
        at_s += hold_s
    calm_s = round(at_s + 2.0 + 2.0 * reach / speed, 2)
    frames.append(Keyframe(at_s=calm_s, deg={"jaw": 0.0}, ease=ease))
    sequence = Sequence(name=f"any {seed}", keyframes=tuple(frames), keeps_time=frozenset({"jaw"}))
    return sequence, robot_of(own)


def asked_of(sequence: Sequence, robot: Robot):
    """Return the motion that a servo without limits would make."""
    (own,) = robot.joints.values()
    free = replace(
        own,
        position_min_deg=-9e3,
        position_max_deg=9e3,
        turns="by_hand",
        speed_max_deg_s=1e7,
        accel_max_deg_s2=1e10,
    )
    trajectory = plan(replace(sequence, keeps_time=frozenset()), robot_of(free))
    assert trajectory.stretched == ()
    return lambda times_s: trajectory.sample(times_s)[:, 0]


def check_limits(trajectory, robot: Robot) -> None:
    """Assert the limits by differences of angles at 1 kHz."""
    (own,) = robot.joints.values()
    times_s = 0.001 * np.arange(-3, round(trajectory.duration_s * 1000.0) + 4)
    deg = trajectory.sample(times_s)[:, 0]
    assert own.position_min_deg - 1e-6 <= deg.min() <= deg.max() <= own.position_max_deg + 1e-6
    assert np.abs(np.diff(deg)).max() <= 1e-3 * own.speed_max_deg_s * 1.0001
    assert np.abs(np.diff(deg, 2)).max() <= 1e-6 * own.accel_max_deg_s2 * 1.0001


def rms(deviation_deg: np.ndarray) -> float:
    return float(np.sqrt(np.mean(deviation_deg**2)))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [*range(MOTIONS), *RELENTLESS])
def test_the_deviation_is_within_a_hundredth_of_the_least(seed):
    sequence, robot = any_motion(seed)
    asked = asked_of(sequence, robot)
    trajectory = plan(sequence, robot)
    check_limits(trajectory, robot)
    assert trajectory.duration_s == pytest.approx(sequence.keyframes[-1].at_s, abs=1e-9)
    best = optimum(asked, trajectory.duration_s, robot.joints["jaw"])
    assert best is not None
    times_s, best_deg = best
    own = trajectory.sample(times_s)[:, 0] - asked(times_s)
    assert rms(own) <= RATIO * rms(best_deg - asked(times_s)) + RMS_DEG
    # What is more than the reported degrees off is reported.
    reported_deg = np.full(len(times_s), 0.11)
    for span in trajectory.given_up:
        inside = (times_s >= span.from_s - 0.01) & (times_s <= span.to_s + 0.01)
        reported_deg[inside] = 1.005 * span.by_deg + 0.02
    assert (np.abs(own) <= reported_deg).all()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(MOTIONS, MOTIONS + 12))
def test_exact_keys_are_met_or_refused_as_on_the_fine_grid(seed):
    sequence, robot = any_motion(seed)
    random = np.random.default_rng(seed)
    frames = list(sequence.keyframes)
    for index in random.choice(len(frames), 3).tolist():
        frames[index] = replace(frames[index], is_exact=True, hold_s=0.0)
    asked_sequence = replace(sequence, keyframes=tuple(frames))
    exact = [(frame.at_s, frame.deg["jaw"]) for frame in frames if frame.is_exact]
    asked = asked_of(asked_sequence, robot)
    jaw = robot.joints["jaw"]
    duration_s = frames[-1].at_s
    if optimum(asked, duration_s, jaw, exact=exact, ratio=0.99) is None:
        if optimum(asked, duration_s, jaw, exact=exact, ratio=1.01) is None:
            with pytest.raises(PlanningError, match="cannot be exact"):
                plan(asked_sequence, robot)
        return
    trajectory = plan(asked_sequence, robot)
    check_limits(trajectory, robot)
    for at_s, deg in exact:
        assert trajectory.sample(np.array([at_s]))[0, 0] == pytest.approx(deg, abs=0.011)
