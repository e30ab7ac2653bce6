"""Laws of planning that hold for every robot and every sequence."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import HealthCheck, given, reject, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.curves import peaks
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.verify import verify
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Interpolation, Keyframe, Layer, PlaylistStep, Sequence, Timing

if TYPE_CHECKING:
    from lss_motion.planning.trajectory.model import Trajectory

MODEL = SERVO_MODELS["LSS-ST1"]
RANGE_DEG = 3600.0
LEGAL_RATIO = 1.00005
SIZES_DEG = (0.01, 1.0, 30.0, 170.0, 700.0)
LAWS = settings(
    max_examples=settings().max_examples // 4,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
# `command` is for joints that keep their time: tests/unit/interchange judges it.
EASES = st.sampled_from([ease for ease in Interpolation if ease is not Interpolation.COMMAND])


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path_factory.mktemp("plans")))


@st.composite
def robots(draw: st.DrawFn) -> Robot:
    count = draw(st.integers(1, 12))
    joints = {
        f"joint{index}": Joint(
            name=f"joint{index}",
            servo_id=index,
            bus="main",
            model=MODEL,
            position_min_deg=-RANGE_DEG,
            position_max_deg=RANGE_DEG,
            turns="by_hand",
            speed_max_deg_s=draw(st.floats(3.6, 360.0)),
            accel_max_deg_s2=draw(st.floats(20.0, 2000.0)),
        )
        for index in range(count)
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="any", path=None, buses={"main": bus}, joints=joints)


@st.composite
def keyframes(
    draw: st.DrawFn,
    robot: Robot,
    *,
    least_step_s: float = 0.0,
    sizes_deg: tuple[float, ...] = SIZES_DEG,
) -> list[Keyframe]:
    """Keyframes in order of time, with holds that end before the next begins."""
    frames = []
    at_s = 0.0
    for index in range(draw(st.integers(1, 12))):
        names = draw(st.lists(st.sampled_from(list(robot.joints)), min_size=1, unique=True))
        hold_s = draw(st.sampled_from([0.0, 0.0, 0.1, 1.0]))
        size_deg = draw(st.sampled_from(sizes_deg))
        frames.append(
            Keyframe(
                deg={name: round(size_deg * draw(st.floats(-1.0, 1.0)), 3) for name in names},
                at_s=at_s,
                hold_s=hold_s,
                ease=draw(EASES),
                label=f"frame {index}",
            )
        )
        step_s = draw(st.sampled_from([0.0, 0.001, 0.05, 0.3, 1.0, 5.0]))
        at_s += hold_s + max(step_s, least_step_s)
    return frames


def returning(frames: list[Keyframe]) -> tuple[Keyframe, ...]:
    """The keyframes and one more, at which every joint is where it started."""
    start: dict[str, float] = {}
    for frame in reversed(frames):
        start.update(frame.deg)
    end_s = (frames[-1].at_s or 0.0) + frames[-1].hold_s + 1.0
    return (*frames, Keyframe(deg=start, at_s=end_s, label="back"))


def is_legal(trajectory: Trajectory, robot: Robot) -> bool:
    """Whether the path can be followed at the authored times."""
    speed, accel = (peak.max(axis=0) for peak in peaks(trajectory.first.path))
    joints = [robot.joints[name] for name in trajectory.joints]
    return all(
        speed[column] <= LEGAL_RATIO * joint.speed_max_deg_s
        and accel[column] <= LEGAL_RATIO * joint.accel_max_deg_s2
        for column, joint in enumerate(joints)
    )


@LAWS
@given(st.data(), robots(), st.sampled_from([Timing.AUTHORED, Timing.FASTEST]))
def test_no_limit_is_broken_and_every_key_is_reached(
    data: st.DataObject, robot: Robot, timing: Timing
) -> None:
    frames = tuple(data.draw(keyframes(robot)))
    trajectory = plan(Sequence(name="any", keyframes=frames, timing=timing), robot)
    verified = verify(trajectory, robot)
    assert max(verified.speed_ratio, verified.accel_ratio) <= 1.001
    for mark, frame in zip(trajectory.marks, frames, strict=True):
        reached = trajectory.sample(np.array([mark.planned_s]))[0]
        for name, deg in frame.deg.items():
            assert reached[trajectory.joints.index(name)] == pytest.approx(deg, abs=1e-6)


@LAWS
@given(st.data(), robots(), st.integers(1, 5) | st.none(), st.sampled_from(list(Timing)[:2]))
def test_loops_break_no_limit_at_their_seams(
    data: st.DataObject, robot: Robot, loop: int | None, timing: Timing
) -> None:
    frames = returning(data.draw(keyframes(robot)))
    trajectory = plan(Sequence(name="any", keyframes=frames, loop=loop, timing=timing), robot)
    verify(trajectory, robot)
    if trajectory.is_periodic:
        seam_s = trajectory.first.duration_s
        around = trajectory.sample(np.array([seam_s - 1e-9, seam_s]), 1)
        assert around[0] == pytest.approx(around[1], abs=1e-3)


@LAWS
@given(st.data(), robots())
def test_a_legal_path_keeps_the_authored_times_exactly(data: st.DataObject, robot: Robot) -> None:
    frames = data.draw(keyframes(robot, least_step_s=0.3, sizes_deg=(0.01, 1.0, 2.0)))
    sequence = Sequence(name="any", keyframes=tuple(frames))
    # Slow the show down until the path itself is within the limits.
    for _ in range(8):
        trajectory = plan(sequence, robot)
        if is_legal(trajectory, robot):
            break
        frames = [replace(frame, at_s=2.0 * (frame.at_s or 0.0)) for frame in frames]
        sequence = Sequence(name="any", keyframes=tuple(frames))
    else:
        pytest.fail("a show this slow must be legal")
    assert not trajectory.stretched
    for mark in trajectory.marks:
        assert mark.planned_s == pytest.approx(mark.authored_s, abs=1e-6)


@LAWS
@given(st.data(), robots(), st.floats(1.0, 5.0))
def test_fit_takes_as_long_as_wanted(data: st.DataObject, robot: Robot, ratio: float) -> None:
    frames = tuple(
        Keyframe(deg=frame.deg, hold_s=frame.hold_s, ease=frame.ease)
        for frame in data.draw(keyframes(robot))
    )
    fastest = plan(Sequence(name="any", keyframes=frames, timing=Timing.FASTEST), robot)
    moving_s = fastest.duration_s - sum(frame.hold_s for frame in frames)
    wanted_s = fastest.duration_s * ratio + 0.01
    if moving_s < 1e-6:
        return
    fitted = plan(
        Sequence(name="any", keyframes=frames, timing=Timing.FIT, fit_duration_s=wanted_s), robot
    )
    assert fitted.duration_s == pytest.approx(wanted_s, abs=1e-3)


@LAWS
@given(st.data(), robots())
def test_smooth_and_linear_never_go_beyond_the_keys(data: st.DataObject, robot: Robot) -> None:
    frames = [
        frame for frame in data.draw(keyframes(robot)) if frame.ease is not Interpolation.SPLINE
    ]
    if not frames:
        return
    trajectory = plan(Sequence(name="any", keyframes=tuple(frames)), robot)
    deg = trajectory.sample(np.linspace(0.0, trajectory.duration_s, 2000))
    for column, name in enumerate(trajectory.joints):
        keys = [frame.deg[name] for frame in frames if name in frame.deg]
        assert min(keys) - 1e-9 <= deg[:, column].min()
        assert deg[:, column].max() <= max(keys) + 1e-9


def parts_of(data: st.DataObject, robot: Robot, **more: object) -> list[Sequence]:
    """Sequences for different joints of the robot."""
    names = data.draw(st.permutations(list(robot.joints)))
    cut = data.draw(st.integers(0, len(names)))
    groups = [group for group in (names[:cut], names[cut:]) if group]
    found = []
    for number, group in enumerate(groups):
        own = replace(robot, joints={name: robot.joints[name] for name in group})
        frames = tuple(data.draw(keyframes(own)))
        loop = data.draw(st.sampled_from([1, 1, 2, None]))
        if loop != 1:
            frames = returning(list(frames))
        found.append(Sequence(name=f"part{number}", keyframes=frames, loop=loop, **more))
    return found


@LAWS
@given(st.data(), robots())
def test_tracks_beside_each_other_break_no_limit_and_keep_their_keys(
    data: st.DataObject, robot: Robot
) -> None:
    tracks = parts_of(data, robot)
    show = Sequence(name="all", tracks=tuple(tracks))
    if all(track.loop is None for track in tracks) and len(tracks) > 1:
        periods_s = [plan(track, robot).middle.duration_s for track in tracks]
        if not math.lcm(*(round(1e6 * period_s) for period_s in periods_s)) <= 6e8:
            with pytest.raises(PlanningError, match="do not meet again"):
                plan(show, robot)
            return
    trajectory = plan(show, robot)
    verify(trajectory, robot)
    for track in tracks:
        alone = plan(track, robot)
        times_s = np.linspace(0.0, alone.first.duration_s, 50)[:-1]
        columns = [trajectory.joints.index(name) for name in alone.joints]
        if track.loop is not None or trajectory.loop is None:
            beside = trajectory.sample(times_s)[:, columns]
            assert beside == pytest.approx(alone.sample(times_s), abs=1e-9)


@LAWS
@given(st.data(), robots())
def test_a_play_list_breaks_no_limit_and_begins_every_step_where_it_should(
    data: st.DataObject, robot: Robot
) -> None:
    parts = [replace(part, loop=part.loop or 2) for part in parts_of(data, robot)]
    steps = [PlaylistStep(sequence=part, times=data.draw(st.integers(1, 3))) for part in parts]
    steps.insert(data.draw(st.integers(0, len(steps))), PlaylistStep(pause_s=0.5))
    steps = data.draw(st.permutations([*steps, PlaylistStep(sequence=parts[0], move_s=0.1)]))
    loop = data.draw(st.sampled_from([1, 2, None]))
    trajectory = plan(Sequence(name="list", play=tuple(steps), loop=loop), robot)
    verify(trajectory, robot)
    ends_s = trajectory.first.duration_s
    start, end = trajectory.sample(np.array([0.0, ends_s - 1e-9]))
    assert loop == 1 or start == pytest.approx(end, abs=1e-3)


@pytest.mark.slow
@LAWS
@given(st.data(), robots(), st.sampled_from(["override", "add"]), st.floats(0.0, 1.0))
def test_the_limits_hold_for_the_sum_of_layers(
    data: st.DataObject, robot: Robot, mode: str, weight: float
) -> None:
    base = Sequence(name="base", keyframes=tuple(data.draw(keyframes(robot))))
    keyed = {name for frame in base.keyframes for name in frame.deg}
    sizes_deg = (0.01, 1.0, 30.0)
    frames = data.draw(keyframes(robot, least_step_s=0.05, sizes_deg=sizes_deg))
    top = Layer(
        sequence=Sequence(name="top", keyframes=tuple(frames)),
        joints=tuple(name for name in robot.joints if name in keyed),
        mode="add" if mode == "add" else "override",
        weight=weight,
        from_s=data.draw(st.floats(0.0, 3.0)),
        to_s=data.draw(st.floats(3.5, 9.0)),
        fade_s=data.draw(st.sampled_from([0.05, 0.5, 3.0])),
    )
    try:
        trajectory = plan(replace(base, layers=(top,)), robot)
    except PlanningError as error:
        # A spline may overshoot the range of a joint, which is refused.
        overshoots = any(frame.ease is Interpolation.SPLINE for frame in (*base.keyframes, *frames))
        if not overshoots or "would be at" not in str(error):
            raise
        reject()
    verified = verify(trajectory, robot)
    assert max(verified.speed_ratio, verified.accel_ratio) <= 1.001
    alone = plan(base, robot)
    start = alone.sample(np.zeros(1))[0]
    columns = [trajectory.joints.index(name) for name in alone.joints]
    assert trajectory.sample(np.zeros(1))[0, columns] == pytest.approx(start, abs=1e-6)
