"""Programs that are extended while they play, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion.planning.program.model import Program
from lss_motion.planning.program.splice import initial_splice_state
from lss_motion.planning.trajectory.curves import cubics
from lss_motion.planning.trajectory.window import planned_window
from lss_motion.playing.run import Observer, perform


def wave(robot, from_s, to_s, swing_deg):
    """Every joint sways between `from_s` and `to_s`, at rest before and after."""
    times_s = np.arange(0.0, to_s + 0.5, 0.02)
    share = np.clip((times_s - from_s) / (to_s - from_s), 0.0, 1.0)[:, None]
    angles = swing_deg * np.sin(np.pi * share) ** 2 * np.ones(len(robot.joints))
    speeds = np.gradient(angles, 0.02, axis=0)
    speeds[-1] = 0.0
    return planned_window("wave", list(robot.joints), robot, cubics(times_s, angles, speeds))


class Extending:
    """Hands over extensions at show times; closes the show after the last."""

    def __init__(self, extensions):
        self._extensions, self.taken = list(extensions), []

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if player.show is None:
            return
        while self._extensions and player.show.show_s(now_ns) >= self._extensions[0][0]:
            self.taken.append(player.extend(self._extensions.pop(0)[1], now_ns))
            self.plan = player.show.joint_states["j0"].plan
            if not self._extensions:
                player.close()


def extended(kit, *parts):
    """Play `(handed over at, from, trajectory)`; returns controls, result and the extensions."""
    robot = kit.robot(2)
    program = Program(
        name="grows",
        robot=robot.name,
        moves=(),
        duration_s=0.0,
        start_deg=dict.fromkeys(robot.joints, 0.0),
        tolerance_deg=0.2,
    )
    splice_state, made = initial_splice_state(program, robot), []
    for at_s, from_s, trajectory in parts:
        extension = splice_state.extended(trajectory, starts_s=0.0, from_s=from_s)
        splice_state = splice_state.taken(extension)
        made.append((at_s, extension))
    controls = Extending(made)
    result = perform(
        program,
        robot,
        is_virtual=True,
        is_open=True,
        observer=Observer(controls=controls),
    )
    return controls, result, [extension for _, extension in made]


def test_what_is_still_to_be_played_before_a_splice_far_ahead_is_not_forgotten(kit):
    robot = kit.robot(2)
    first, second = wave(robot, 1.0, 7.5, 40.0), wave(robot, 1.0, 7.5, 40.0)
    controls, result, (early, _) = extended(kit, (0.5, 1.0, first), (1.5, 7.2, second))
    assert controls.taken == [True, True]
    for at_s in (1.6, 2.0, 5.0, 7.0):
        assert controls.plan.at(at_s) == pytest.approx(early.profiles["j0"].at(at_s), abs=1e-3)
    assert result.report.faults == ()
    assert max(joint.error_max_deg for joint in result.report.joints.values()) < 1.0


def test_an_extension_is_played_to_its_end_and_one_that_is_late_is_refused(kit):
    robot = kit.robot(2)
    early, late = wave(robot, 1.0, 3.0, 30.0), wave(robot, 1.0, 5.0, 60.0)
    controls, result, _ = extended(kit, (0.5, 1.0, early), (1.5, 1.2, late))
    assert controls.taken == [True, False]
    assert result.report.outcome == "finished"
    assert abs(result.truth.horn_deg.max() - 30.0) < 1.0
    assert np.abs(result.truth.horn_deg[-1]).max() < 0.5
