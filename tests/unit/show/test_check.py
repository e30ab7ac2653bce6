"""Checks of a sequence against a robot, and of loops."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.show.check import check_sequence, loop_problem
from lss_motion.show.model import Keyframe, Sequence


def test_a_sequence_fits_a_robot_that_has_its_joints_and_ranges(folder: Path) -> None:
    keyframes = (Keyframe(at_s=0.0, deg={"base": 90.0, "elbow": -90.0}),)
    check_sequence(Sequence(name="s", keyframes=keyframes), load_robot(folder / "robot.yaml"))


def test_every_joint_and_angle_that_does_not_fit_is_named_with_its_line(folder: Path) -> None:
    keyframes = (
        Keyframe(at_s=0.0, deg={"base": 90.1, "elbow": 0.0}, line=4),
        Keyframe(at_s=1.0, deg={"wrist": 1.0}, line=6),
    )
    sequence = Sequence(name="s", keyframes=keyframes, path=Path("s.yaml"))
    with pytest.raises(InputError) as caught:
        check_sequence(sequence, load_robot(folder / "robot.yaml"))
    assert str(caught.value).splitlines() == [
        "s.yaml:4: joint 'base' at 90.1 deg is outside its range, -90 to 90 deg",
        "s.yaml:6: unknown joint 'wrist'; there are: base, elbow",
    ]


def test_a_joint_may_be_keyed_first_and_last_in_any_keyframe_of_a_loop() -> None:
    keyframes = [
        Keyframe(deg={"base": 0.0}),
        Keyframe(deg={"elbow": 5.0}),
        Keyframe(deg={"base": 9.0, "elbow": 7.0}),
        Keyframe(deg={"base": 0.0}),
        Keyframe(deg={"elbow": 5.0}),
    ]
    assert loop_problem(keyframes) == ""
    assert "elbow starts at 5 and ends at 7 deg" in loop_problem(keyframes[:-1])


def test_a_loop_in_which_nothing_happens_is_refused() -> None:
    still = Keyframe(deg={"base": 1.0})
    assert "must take time" in loop_problem([still, still])
    assert loop_problem([still, Keyframe(deg={"base": 1.0}, hold_s=0.5)]) == ""
    assert loop_problem([still, Keyframe(deg={"base": 2.0}), still]) == ""
