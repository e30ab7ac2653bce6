"""A joint that is at its acceleration limit for long is planned with a reserve, others are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning.program import compile as compiling
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory import retime, solver
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.retime import laid_out
from lss_motion.planning.trajectory.solver import is_legal, solve
from lss_motion.planning.trajectory.tracks import planned_track
from lss_motion.playing.run import perform
from lss_motion.robot.model import Bus, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence, Timing
from tests.joints import joint

HORN_DEG = 1.5


def robot_with(model="LSS-ST1", accel_max_deg_s2=600.0):
    bus = Bus(name="main", port="sim://", baud_bps=115_200, firmware=370)
    jaw = joint("jaw", model=SERVO_MODELS[model], accel_max_deg_s2=accel_max_deg_s2)
    return Robot(name="talker", path=Path("r.yaml"), buses={"main": bus}, joints={"jaw": jaw})


def jaw(keys, gap_s=0.15, deg=30.0, **fields):
    frames = [Keyframe(at_s=round(gap_s * k, 3), deg={"jaw": deg * (k % 2)}) for k in range(keys)]
    return Sequence(name="jaw", keyframes=tuple(frames), **fields)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


@pytest.fixture
def unreserved(monkeypatch):
    """Return what plans without any reserve."""

    def planned(sequence, robot):
        with monkeypatch.context() as patch:
            patch.setattr(retime, "_shares", lambda *_: None)
            return planned_track(sequence, robot)

    return planned


def accel_used(trajectory, robot):
    times_s = np.arange(0.01, trajectory.duration_s, 0.01)
    return np.abs(trajectory.sample(times_s, 2)[:, 0]) / robot.joints["jaw"].accel_max_deg_s2


def test_a_joint_at_its_limit_for_half_a_minute_stays_with_its_plan():
    robot = robot_with("LSS-P-S1")
    trajectory = planned_track(jaw(67), robot)
    program = compile_program(trajectory, robot)
    result = perform(program, robot, is_virtual=True, seed=1, trajectory=trajectory)
    assert trajectory.duration_s > 25.0
    assert result.report.outcome == "finished"
    assert not result.report.faults
    times_s, horn_deg = result.truth.times_s, result.truth.horn_deg[:, 0]
    off_deg = np.abs(horn_deg - trajectory.sample(times_s)[:, 0])
    assert off_deg.max() < HORN_DEG


@pytest.mark.parametrize("timing", [Timing.AUTHORED, Timing.FASTEST])
def test_long_motions_have_a_reserve_and_short_ones_are_exact(unreserved, timing):
    robot = robot_with()
    for keys, is_long in ((5, False), (30, True)):
        show = jaw(keys, timing=timing)
        if timing is Timing.FASTEST:
            frames = tuple(replace(frame, at_s=None) for frame in show.keyframes)
            show = replace(show, keyframes=frames)
        own, other = planned_track(show, robot), unreserved(show, robot)
        share = np.median(accel_used(own, robot)) / np.median(accel_used(other, robot))
        assert share == pytest.approx(0.995 if is_long else 1.0, abs=0.001)
        ratio = own.duration_s / other.duration_s
        assert 1.001 < ratio < 1.004 if is_long else ratio == 1.0


@pytest.mark.parametrize(("loop", "share"), [(2, 1.0), (40, 0.995), (None, 0.995)])
def test_short_passes_have_a_reserve_where_they_are_repeated_for_long(unreserved, loop, share):
    robot, show = robot_with(), jaw(3, loop=loop)
    used = []
    for planned in (planned_track, unreserved):
        cycle = planned(show, robot).middle
        times_s = np.arange(0.01, cycle.duration_s, 0.01)
        used.append(np.median(np.abs(cycle.sample(times_s, 2)[:, 0])) / 600.0)
    assert used[1] == pytest.approx(1.0, abs=0.005)
    assert used[0] / used[1] == pytest.approx(share, abs=0.001)


@pytest.mark.parametrize(("keys", "share"), [(6, 1.0), (24, 0.995), (50, 0.98)])
def test_a_joint_that_keeps_its_time_has_the_larger_reserve_only_after_8_s(keys, share):
    robot = robot_with()
    show = jaw(keys, gap_s=0.25, deg=60.0, keeps_time=frozenset({"jaw"}))
    used = accel_used(plan(show, robot), robot)
    assert used.max() == pytest.approx(share, abs=0.0015)
    assert np.quantile(used, 0.6) == pytest.approx(share, abs=0.0015)


def test_only_the_surroundings_of_a_reserve_are_solved_again(monkeypatch):
    """The jaw is at its limit in the middle of a long show that is as fast as possible."""
    robot = robot_with()
    calm = [deg for k in range(120) for deg in (12.0 * (k % 2), 20.0, 22.0)]
    degs = [*calm, *(30.0 * (k % 2) for k in range(30)), *calm]
    frames = tuple(Keyframe(deg={"jaw": deg}) for deg in degs)
    layout = laid_out(Sequence(name="jaw", keyframes=frames, timing=Timing.FASTEST), robot)
    whole = layout.task({})
    plain = solve(whole, 0.0, whole.path.length_s)
    cells = []
    counted = solver.fastest_squares

    def fastest_squares(grid_s, *args, **options):
        cells.append(len(grid_s) - 1)
        return counted(grid_s, *args, **options)

    shares = np.ones((len(whole.path.knots_s) - 1, 1))
    shares[len(calm) : len(calm) + 30] = 0.9
    task = replace(whole, accel_shares=shares)
    monkeypatch.setattr(solver, "fastest_squares", fastest_squares)
    again = solve(task, 0.0, whole.path.length_s, known=plain)
    assert sum(cells) < 0.2 * len(plain.squares)
    assert is_legal(task, again, 0)
    assert not is_legal(task, plain, 0)
    anew = solve(task, 0.0, whole.path.length_s)
    assert again.duration_s == pytest.approx(anew.duration_s, rel=1e-4)
    assert plain.duration_s < anew.duration_s * 0.999


def test_an_anchor_that_all_of_the_limit_meets_is_not_missed_for_a_reserve(unreserved):
    robot = robot_with()
    show = jaw(12)
    least_s = unreserved(show, robot).duration_s
    last = Keyframe(at_s=least_s + 0.01, deg={"jaw": 30.0}, is_anchor=True)
    show = replace(show, keyframes=(*show.keyframes[:-1], last))
    trajectory = planned_track(show, robot)
    assert trajectory.marks[-1].planned_s == pytest.approx(last.at_s, abs=0.001)
    assert planned_track(replace(show, loop=1), robot).duration_s < least_s * 1.005


def test_moves_that_lose_their_plan_are_chosen_again_at_another_tolerance(monkeypatch):
    """The motion is one that was found: that of another reserve keeps its plan at once."""
    robot = robot_with("LSS-HS1", accel_max_deg_s2=900.0)
    with monkeypatch.context() as patch:
        patch.setattr(retime, "RELENTLESS_SHARE", 0.98)
        trajectory = planned_track(jaw(100, gap_s=0.1), robot)
    with monkeypatch.context() as patch:
        patch.setattr(compiling, "RECOVERY_RATIOS", ())
        assert compile_program(trajectory, robot).bound_deg["jaw"] > 4.0
    assert compile_program(trajectory, robot).bound_deg["jaw"] < 1.3
