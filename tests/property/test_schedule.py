"""Properties of the schedule: what the line carries, when, and how much of it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from lss_motion.planning.program.compile import PREROLL_S, compile_program
from lss_motion.planning.program.drives import late_max_s
from lss_motion.planning.program.fit import RIVALRY_S, TIGHT_TURN_S
from lss_motion.planning.program.line import LineSchedule, line_use
from lss_motion.planning.program.model import received_us
from lss_motion.planning.program.move_table import moves_of, sizes_bytes
from lss_motion.planning.program.reference_grid import GRID_S, Reference
from lss_motion.planning.program.schedule import Schedule, slot_us
from lss_motion.planning.trajectory.planner import plan
from lss_motion.protocol.framing import encode_move
from lss_motion.robot.model import Bus, Joint, Robot
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.units import line_time_ns, us_from_s

LAWS = settings(
    max_examples=settings().max_examples // 4,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
FAST_BPS = (115_200, 230_400, 500_000, 921_600)
seeds = st.integers(0, 10_000)


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory, monkeypatch):
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path_factory.mktemp("plans")))


def robot_of(count, baud_bps):
    joints = {
        f"j{index}": Joint(
            name=f"j{index}",
            servo_id=5 + 13 * index,
            bus="main",
            model=SERVO_MODELS["LSS-ST1" if index % 3 else "LSS-P-S1"],
            position_min_deg=-90.0,
            position_max_deg=90.0,
            speed_max_deg_s=240.0,
            accel_max_deg_s2=800.0,
        )
        for index in range(count)
    }
    bus = Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370)
    return Robot(name="crowd", path=None, buses={"main": bus}, joints=joints)


def references_of(robot, seed):
    """Return references that start together, stop together half way, and swing in between."""
    random = np.random.default_rng(seed)
    time_s = np.arange(-PREROLL_S, 3.0, GRID_S)
    phase = np.clip((time_s % 1.5) / 1.2, 0.0, 1.0) * (time_s > 0.0)
    rise = phase * phase * (3.0 - 2.0 * phase)
    half = np.where(time_s < 1.5, 0.0, 1.0)
    return {
        name: Reference(
            start_s=-PREROLL_S, position_deg=random.uniform(-35.0, 35.0) * (half + rise)
        )
        for name in robot.joints
    }


class WatchedLine(LineSchedule):
    """Records its requests; the last one created holds the slots of the final moves."""

    last = None

    def __init__(self):
        super().__init__()
        self.windows_us = {}
        WatchedLine.last = self

    def copy(self):
        made = WatchedLine()
        made.windows_us = dict(self.windows_us)
        return made

    def reserve_all(self, latest_end_us, size_us, earliest_us):
        ends_us = super().reserve_all(latest_end_us, size_us, earliest_us)
        for end_us, *request in zip(ends_us, latest_end_us, size_us, earliest_us, strict=True):
            self.windows_us[end_us] = (request[2] + request[1], request[0])
        return ends_us


@LAWS
@given(seeds, st.integers(1, 14), st.sampled_from([19_200, 57_600, *FAST_BPS]))
@example(seed=1, count=14, baud_bps=9_600)
def test_every_command_is_due_inside_its_window_and_alone_on_its_line(seed, count, baud_bps):
    robot = robot_of(count, baud_bps)
    schedule = Schedule(references_of(robot, seed), robot, 0.2, lines={"main": WatchedLine()})
    moves = moves_of(schedule.fitted, robot)
    assert len(moves) >= count
    windows_us = WatchedLine.last.windows_us
    received_us_of = dict.fromkeys(range(256), us_from_s(-PREROLL_S))
    late_us, by_id = 0, {joint.servo_id: joint for joint in robot.joints.values()}
    for move in moves:
        end_us = received_us(move, baud_bps)
        end_us += end_us not in windows_us  # Lengths are whole microseconds, rounded up.
        opens_us, closes_us = windows_us[end_us]
        assert end_us >= opens_us
        assert end_us >= received_us_of[move.servo_id], (
            "not before its servo has received the one before"
        )
        received_us_of[move.servo_id] = end_us
        assert move.due_us >= end_us - slot_us(by_id[move.servo_id], robot), "nor before its slot"
        assert move.due_us >= us_from_s(-PREROLL_S)
        late_us = max(late_us, end_us - closes_us)
    assert late_us == schedule.late_max_us
    allowed_us = us_from_s(late_max_s(robot.joints["j0"]))
    assert schedule.is_tight == (late_us > allowed_us)
    if baud_bps >= FAST_BPS[0]:
        assert not schedule.is_tight
    sizes_us = [-(-line_time_ns(len(move.data), baud_bps) // 1000) for move in moves]
    slots_us = [(move.due_us, size_us) for move, size_us in zip(moves, sizes_us, strict=True)]
    assert line_use("main", baud_bps, slots_us).overlaps == 0


def on_two_lines(robot):
    """Return the robot with its joints on two lines in turn."""
    buses = {name: replace(robot.buses["main"], name=name) for name in ("left", "right")}
    joints = {
        name: replace(joint, bus=("left", "right")[index % 2])
        for index, (name, joint) in enumerate(robot.joints.items())
    }
    return replace(robot, buses=buses, joints=joints)


@LAWS
@given(seeds, st.integers(6, 24), st.sampled_from([57_600, 115_200]))
def test_a_line_does_not_wait_for_another(seed, count, baud_bps):
    robot = on_two_lines(robot_of(count, baud_bps))
    references = references_of(robot, seed)
    for turn_s in (RIVALRY_S, TIGHT_TURN_S):
        both = Schedule(references, robot, 0.2, turn_s=turn_s).fitted
        for bus in robot.buses:
            names = [name for name, joint in robot.joints.items() if joint.bus == bus]
            own = {name: references[name] for name in names}
            alone = Schedule(own, robot, 0.2, turn_s=turn_s).fitted
            for name in names:
                assert both[name].received_s.tolist() == alone[name].received_s.tolist()
                assert both[name].target_wire.tolist() == alone[name].target_wire.tolist()


def lively(robot, seed):
    """Return references that swing for 3 s, rest for 3 s, and make one slow move."""
    random = np.random.default_rng(seed)
    time_s = np.arange(-PREROLL_S, 9.0, GRID_S)
    swings = (time_s > 0.0) * (time_s < 3.0) * np.sin(np.pi * np.clip(time_s, 0.0, 3.0) / 3.0) ** 2
    slow = np.sin(np.pi * np.clip(time_s - 6.0, 0.0, 2.0) / 4.0) ** 2
    return {
        name: Reference(
            start_s=-PREROLL_S,
            position_deg=12.0 * swings * np.sin(random.uniform(6.0, 9.0) * time_s) + 10.0 * slow,
        )
        for name in robot.joints
    }


@settings(LAWS, max_examples=settings().max_examples // 8)
@given(seeds)
@example(seed=0)
@example(seed=1)
def test_only_where_commands_were_late_are_they_placed_in_order(seed):
    """A calm part after a crowded one is as on a free line, and the crowded one fits."""
    robot = robot_of(34, 115_200)
    references = lively(robot, seed)
    crowd = Schedule(references, robot, 0.2, turn_s=RIVALRY_S)
    free = Schedule({"j0": references["j0"]}, robot, 0.2, turn_s=RIVALRY_S)
    ordered = Schedule(references, robot, 0.2, turn_s=TIGHT_TURN_S)
    assert crowd.is_tight <= ordered.is_tight
    own_s, free_s = crowd.fitted["j0"].received_s, free.fitted["j0"].received_s
    assert own_s[own_s > 5.0].tolist() == pytest.approx(free_s[free_s > 5.0], abs=0.2)


@LAWS
@given(seeds, st.integers(2, 14))
def test_joints_that_are_kept_have_the_same_moves_and_the_others_the_rest_of_the_line(seed, count):
    robot = robot_of(count, 115_200)
    references = references_of(robot, seed)
    first = Schedule(references, robot, 0.2)
    kept = {name: one for name, one in first.fitted.items() if name != "j1"}
    again = Schedule(references, robot, 0.2, ratios={"j1": 0.6}, kept=kept)
    assert all(again.fitted[name] is one for name, one in kept.items())
    narrow_deg, wide_deg = (
        np.abs(
            each.fitted["j1"].profile.on_grid(
                -PREROLL_S, GRID_S, len(references["j1"].position_deg)
            )
            - references["j1"].position_deg
        ).max()
        for each in (again, first)
    )
    assert narrow_deg <= wide_deg + 0.1
    moves = moves_of(again.fitted, robot)
    sizes_us = [-(-line_time_ns(len(move.data), 115_200) // 1000) for move in moves]
    slots_us = [(move.due_us, size_us) for move, size_us in zip(moves, sizes_us, strict=True)]
    assert line_use("main", 115_200, slots_us).overlaps == 0


def show_of(robot, seed):
    """Return a show whose keys are too close together, for so many joints, for slow lines."""
    random = np.random.default_rng(seed)
    rows = [dict.fromkeys(robot.joints, 0.0)]
    rows += [{name: round(random.normal(0.0, 15.0), 1) for name in robot.joints} for _ in range(3)]
    frames = [Keyframe(at_s=0.6 * index, deg=row) for index, row in enumerate(rows)]
    return Sequence(name="crowd", keyframes=tuple(frames))


@settings(LAWS, max_examples=settings().max_examples // 8)
@given(seeds, st.sampled_from([2, 12, 30]), st.lists(st.sampled_from(FAST_BPS), min_size=2))
def test_a_higher_baud_rate_never_needs_more_commands(seed, count, rates):
    found = []
    for baud_bps in sorted(set(rates)):
        robot = robot_of(count, baud_bps)
        program = compile_program(plan(show_of(robot, seed), robot), robot)
        assert program.line_use["main"].overlaps == 0
        found.append((program.tolerance_deg, len(program.moves)))
    assert all(commands >= count for _, commands in found)
    tolerances_deg = [tolerance_deg for tolerance_deg, _ in found]
    assert tolerances_deg == sorted(tolerances_deg, reverse=True)
    for tolerance_deg in set(tolerances_deg):
        commands = [some for own_deg, some in found if own_deg == tolerance_deg]
        assert commands == sorted(commands, reverse=True)


@settings(LAWS, max_examples=settings().max_examples // 8)
@given(seeds, st.floats(0.1, 1.0), st.floats(1.0, 3.0))
def test_a_larger_tolerance_needs_hardly_ever_more_commands(seed, tolerance_deg, ratio):
    """`schedule.candidates` explains the exceptions. Three times the tolerance needs fewer."""
    robot = robot_of(3, 115_200)
    trajectory = plan(show_of(robot, seed), robot)
    narrow, wide, widest = (
        len(compile_program(trajectory, robot, tolerance_deg=tolerance_deg * by).moves)
        for by in (1.0, ratio, 3.0 * ratio)
    )
    assert wide <= 1.05 * narrow + 1
    assert widest <= wide


@given(
    st.lists(
        st.tuples(
            st.integers(0, 250), st.integers(-40_000, 40_000), st.none() | st.integers(1, 30_000)
        ),
        min_size=1,
    )
)
def test_lengths_in_arrays_are_those_of_the_bytes(moves):
    servo_id, target, duration = zip(*moves, strict=True)
    columns = np.array(servo_id), np.array(target, dtype=float), np.array(duration, dtype=float)
    assert sizes_bytes(*columns).tolist() == [len(encode_move(*move)) for move in moves]
