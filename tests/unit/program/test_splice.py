from __future__ import annotations

import numpy as np
import pytest

from lss_motion.errors import LineLoadError
from lss_motion.planning.program.line import line_use
from lss_motion.planning.program.model import Program, received_us, target_deg
from lss_motion.planning.program.splice import initial_splice_state
from lss_motion.planning.trajectory.curves import cubics
from lss_motion.planning.trajectory.window import planned_window
from lss_motion.robot.profile import Profile, profile_lead_s
from lss_motion.units import s_from_ms, s_from_us

TOLERANCE_DEG = 0.1
STEP_S = 0.02


def swing(robot, seed, *, from_s, length_s, before=None):
    """All joints follow sums of sines; a smooth change to another sum begins at `from_s`.

    Returns times, angles and speeds; those before `from_s` come from `before`.
    """
    random = np.random.default_rng(seed)
    names = list(robot.joints)
    times_s = np.arange(0.0, from_s + length_s, STEP_S)
    speed_rad_s, phase = random.uniform(1.0, 3.0, len(names)), random.uniform(0.0, 6.0, len(names))

    def reference(at_s):
        u = np.clip((at_s - from_s) / 0.5, 0.0, 1.0)
        v = np.clip((from_s + length_s - 0.2 - at_s) / 1.0, 0.0, 1.0)
        fade = (u**3 * (10 - 15 * u + 6 * u * u) * v**3 * (10 - 15 * v + 6 * v * v))[:, None]
        return fade * 15.0 * np.sin(speed_rad_s * at_s[:, None] + phase)

    angles = reference(times_s)
    if before is not None:
        old = np.array([np.interp(times_s, before[0], column) for column in before[1].T]).T
        u = np.clip((times_s - from_s) / 0.8, 0.0, 1.0)
        angles += old * (1.0 - u**3 * (10 - 15 * u + 6 * u * u))[:, None]
    return (
        times_s,
        angles,
        np.gradient(angles, STEP_S, axis=0) * (np.arange(len(times_s)) > 0)[:, None],
    )


def planned(robot, motion):
    times_s, angles, speeds = motion
    speeds[-1] = 0.0
    return planned_window("swing", list(robot.joints), robot, cubics(times_s, angles, speeds))


def standing_program(robot, tolerance_deg):
    """Return a program without moves, whose joints stand at 0."""
    return Program(
        name="standing",
        robot=robot.name,
        moves=(),
        duration_s=0.0,
        start_deg=dict.fromkeys(robot.joints, 0.0),
        tolerance_deg=tolerance_deg,
    )


@pytest.fixture
def spliced(kit):
    """Return a robot, the moves of a program that was extended twice while it moved, the plans."""
    robot = kit.robot(*(kit.joint(f"j{i}", i + 1) for i in range(6)))
    program = standing_program(robot, TOLERANCE_DEG)
    splice_state, motion, played, plans = initial_splice_state(program, robot), None, [], []
    for seed, from_s in enumerate((1.0, 1.9, 2.6)):
        motion = swing(robot, seed, from_s=from_s, length_s=3.0, before=motion)
        trajectory = planned(robot, motion)
        extension = splice_state.extended(trajectory, starts_s=0.0, from_s=from_s)
        splice_state = splice_state.taken(extension)
        played = [move for move in played if move.due_us < extension.from_us]
        played += extension.moves
        plans.append((extension, trajectory))
    return robot, played, plans


def test_spliced_moves_continue_without_a_stop_near_the_last_plan(spliced):
    """Judged by an independent profile that receives the remaining moves one by one."""
    robot, played, plans = spliced
    extension, trajectory = plans[-1]
    times_s = np.arange(0.5, extension.duration_s, 0.002)
    for column, (name, joint) in enumerate(robot.joints.items()):
        profile = Profile(
            0.0,
            ramp_deg_s2=int(joint.accel_max_deg_s2),
            speed_max_deg_s=joint.speed_max_deg_s,
            response=joint.response,
        )
        for move in played:
            if move.servo_id == joint.servo_id:
                received_s = s_from_us(received_us(move, robot.buses[move.bus].baud_bps))
                profile.retarget(
                    received_s, target_deg(joint, move.target_wire), s_from_ms(move.duration_ms)
                )
        where = np.array([profile.at(at_s)[0] for at_s in times_s])
        wanted = (
            joint.servo_deg(0.0)
            + joint.direction * (trajectory.sample(times_s + profile_lead_s(joint))[:, column])
        )
        late = times_s > extension.from_us * 1e-6
        assert np.abs(where - wanted)[late].max() < 2.5 * TOLERANCE_DEG
        np.testing.assert_allclose(
            extension.profiles[name].sample(times_s[late]), where[late], atol=1e-3
        )


def test_the_line_never_carries_two_commands_at_once_around_a_splice(spliced):
    robot, played, plans = spliced
    for bus in robot.buses.values():
        slots = [
            (move.due_us, received_us(move, bus.baud_bps) - move.due_us)
            for move in played
            if move.bus == bus.name
        ]
        assert len(slots) > 50
        assert line_use(bus.name, bus.baud_bps, slots).overlaps == 0
    for extension, _ in plans:
        assert min(move.due_us for move in extension.moves) >= extension.from_us


def test_an_extension_ends_at_rest_on_its_plan(spliced):
    robot, _, plans = spliced
    extension, trajectory = plans[0]
    end = trajectory.sample(np.array([trajectory.duration_s]))[0]
    for name, at_deg in zip(trajectory.joints, end, strict=True):
        position_deg, speed = extension.profiles[name].at(extension.duration_s + 0.1)
        assert speed == 0.0
        assert position_deg == pytest.approx(robot.joints[name].servo_deg(at_deg), abs=0.06)


def test_an_extension_that_is_not_taken_changes_nothing(spliced):
    robot, _, plans = spliced
    program = standing_program(robot, TOLERANCE_DEG)
    splice_state = initial_splice_state(program, robot)
    other = planned(robot, swing(robot, 77, from_s=1.0, length_s=2.0))
    splice_state.extended(other, starts_s=0.0, from_s=1.0)
    again = splice_state.extended(plans[0][1], starts_s=0.0, from_s=1.0)
    assert [*again.moves] == [*plans[0][0].moves]


def test_an_extension_for_a_line_that_is_too_slow_is_refused_with_advice(kit):
    robot = kit.robot(*(kit.joint(f"j{i}", i + 1) for i in range(24)), baud_bps=9600)
    program = standing_program(robot, 0.02)
    trajectory = planned(robot, swing(robot, 3, from_s=1.0, length_s=3.0))
    with pytest.raises(LineLoadError, match="faster baud rate"):
        initial_splice_state(program, robot).extended(trajectory, starts_s=0.0, from_s=1.0)
