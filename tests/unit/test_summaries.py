"""What `lss-motion check` says about a plan."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning.check_json import show_as_json
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.shows import Show
from lss_motion.planning.summaries import limit_uses, plan_lines, program_lines
from lss_motion.planning.trajectory import kept_plans
from lss_motion.planning.trajectory.model import motions_of
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.model import Bus, Robot
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Keyframe, Layer, Sequence, Timing
from tests.joints import joint


@pytest.fixture
def robot() -> Robot:
    joints = {
        name: joint(name, index, position_min_deg=-170.0, position_max_deg=170.0)
        for index, name in enumerate(("base", "elbow"))
    }
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370)
    return Robot(name="arm", path=None, buses={"main": bus}, joints=joints)


def show(*keys: tuple[float | None, float], **more) -> Sequence:
    frames = tuple(Keyframe(at_s=at_s, deg={"base": deg, "elbow": 0.0}) for at_s, deg in keys)
    return Sequence(name="show", keyframes=frames, **more)


def test_the_tightest_joint_and_its_margin_are_named(robot):
    # A Hermite cubic of 50 deg in 1 s: 75 deg/s in the middle, 300 deg/s² at its ends.
    lines = plan_lines(plan(show((0.0, 0.0), (1.0, 50.0)), robot), robot)
    assert (
        "tightest: joint 'base', acceleration 300 of 600 deg/s² at 0.000 s, 50% to spare" in lines
    )
    assert any("could run 1.41 times as fast, a pass in 0.709 s" in line for line in lines)


def test_what_is_said_about_speed_is_true(robot):
    sequence = show((0.0, 0.0), (1.0, 50.0), (2.5, -40.0))
    use = min(limit_uses(plan(sequence, robot), robot), key=lambda use: use.faster_ratio)
    ratio = math.floor(100.0 * use.faster_ratio) / 100.0
    for factor, is_on_curve in ((1.0, True), (1.02, False)):
        found = plan(replace(sequence, speed_ratio=factor * ratio), robot)
        (motion,) = {id(part): part for part in motions_of(found)}.values()
        assert bool(np.all(motion.clock.rates == 1.0)) == is_on_curve


def test_a_show_at_its_limits_says_so(robot):
    lines = plan_lines(plan(show((None, 0.0), (None, 90.0), timing=Timing.FASTEST), robot), robot)
    assert lines[-1] == "the show runs as fast as it can; faster would slow more of it down"
    assert "0% to spare" in lines[-2]


def test_a_stretched_span_is_told_with_what_was_asked_and_allowed(robot):
    lines = plan_lines(plan(show((0.0, 0.0), (0.2, 100.0), (4.0, 0.0)), robot), robot)
    (slower,) = [line for line in lines if line.startswith("slower")]
    assert "joint 'base' would need acceleration 15" in slower
    assert slower.endswith("allowed 600 deg/s²")


def talk(count: int = 24) -> Sequence:
    """Return moves that are too fast, each by another amount, and time to make up for them."""
    keys = [(0.0, 0.0)]
    for index in range(count):
        keys += [(index + 0.15, 30.0 + index), (index + 1.0, 0.0)]
    return show(*keys)


def test_totals_come_first_then_the_worst_ten(robot):
    trajectory = plan(talk(), robot)
    spans = sorted(trajectory.stretched, key=lambda span: -span.by_s)
    assert len(spans) > 20
    lines = plan_lines(trajectory, robot)
    total_s = sum(span.by_s for span in spans)
    assert lines[1] == (
        f"{len(spans)} spans slowed, {total_s:.3f} s in all, most by 'base' ({total_s:.3f} s)"
    )
    slower = [line for line in lines if line.startswith("slower: ")]
    assert slower == [f"slower: {span.text}" for span in spans[:10]]
    assert f"and {len(spans) - 10} more spans slowed less (check --all lists them)" in lines
    whole = plan_lines(trajectory, robot, is_whole=True)
    assert sum(line.startswith("slower: ") for line in whole) == len(spans)
    assert not any("--all" in line for line in whole)


def test_spans_that_are_slowed_by_less_than_is_shown_have_no_total_of_zero(robot):
    trajectory = plan(talk(2), robot)
    spans = tuple(replace(span, by_s=0.0002) for span in trajectory.stretched)
    lines = plan_lines(replace(trajectory, stretched=spans), robot)
    assert lines[1] == f"{len(spans)} spans slowed, by less than 0.001 s in all"


def test_the_latest_keyframes_are_named_with_their_lateness(robot):
    trajectory = plan(talk(), robot)
    late = sorted(
        (mark.planned_s - mark.authored_s, mark.authored_s)
        for mark in trajectory.marks
        if mark.planned_s - mark.authored_s > 0.001
    )
    lines = plan_lines(trajectory, robot)
    assert f"{len(late)} of 49 keyframes late, at most {late[-1][0]:.3f} s" in lines
    named = [line for line in lines if line.startswith("late: ")]
    assert len(late) > len(named) == 10
    assert named[0] == f"late: keyframe at {late[-1][1]:g} s is {late[-1][0]:.3f} s late"
    assert f"and {len(late) - 10} more keyframes less late (check --all lists them)" in lines
    whole = plan_lines(trajectory, robot, is_whole=True)
    assert sum(line.startswith("late: ") for line in whole) == len(late)


def test_a_late_layer_is_not_on_time(robot):
    jaw = show((0.0, 0.0), (0.1, 100.0), (3.0, 0.0))
    layer = Layer(sequence=jaw, joints=("base",), from_s=1.0)
    lines = plan_lines(plan(replace(show((0.0, 0.0), (6.0, 0.0)), layers=(layer,)), robot), robot)
    assert "every keyframe is on time" not in lines
    assert any(line.startswith("slower: 1.0") for line in lines)
    assert any(line.startswith("late: keyframe at 1.1 s is 0.") for line in lines)


def test_a_late_keyframe_is_named_with_its_file_and_line_from_the_cache_too(
    robot, tmp_path, monkeypatch
):
    monkeypatch.setattr(kept_plans, "PIECES_MIN", 0)
    head = "sequence: {name}\nkeyframes:\n  - {{at_s: 0, deg: {{base: 0}}}}\n"
    late = head + "  - {{at_s: 0.1, deg: {{base: 100}}}}\n  - {{at_s: 3, deg: {{base: 0}}}}\n"
    (tmp_path / "lay.yaml").write_text(late.format(name="lay"))
    show_file = tmp_path / "show.yaml"
    layers = "layers: [{{file: lay.yaml, mode: add, from_s: 4}}]\n"
    for comment, line in (("", 4), ("# one more line\n", 5), ("# one more line\n", 5)):
        show_file.write_text((comment + late + layers).format(name="show"))
        lines = plan_lines(plan(load_sequence(show_file, robot), robot), robot)
        named = [line.split(" is ")[0] for line in lines if line.startswith("late: ")]
        assert f"late: keyframe at 0.1 s (show.yaml:{line})" in named
        assert "late: keyframe at 4.1 s (lay.yaml:4)" in named


def test_passes_of_a_looped_part_are_not_lateness(robot):
    keys = ((0.0, 0.0), (2.0, 20.0), (4.0, 0.0), (6.0, 20.0), (8.0, 0.0))
    looped = plan(show(*keys, loop=3, loop_span_s=(0.0, 4.0)), robot)
    assert "every keyframe is on time" in plan_lines(looped, robot)


def test_a_hold_that_became_shorter_is_named(robot):
    frames = [
        Keyframe(at_s=0.0, deg={"base": 0.0}),
        Keyframe(at_s=0.2, deg={"base": 100.0}, hold_s=2.0, hold_may_shrink=True, label="up"),
        Keyframe(at_s=4.0, deg={"base": 0.0}),
    ]
    lines = plan_lines(plan(Sequence(name="show", keyframes=tuple(frames)), robot), robot)
    (shorter,) = [line for line in lines if line.startswith("shorter")]
    assert shorter.startswith("shorter: keyframe 'up' at 0.2 s is held 1.3")
    assert "instead of 2 s" in shorter
    kept = [replace(frame, hold_may_shrink=False) for frame in frames]
    lines = plan_lines(plan(Sequence(name="show", keyframes=tuple(kept)), robot), robot)
    assert not any(line.startswith("shorter") for line in lines)


def test_a_rest_that_became_shorter_is_named_unless_a_hold_keeps_it(robot):
    """The pause before standing up: two keyframes with the same angles."""
    keys = ((0.0, 0.0), (0.2, 100.0), (0.5, 100.0), (4.0, 0.0))
    lines = plan_lines(plan(show(*keys), robot), robot)
    (shorter,) = [line for line in lines if line.startswith("shorter")]
    assert shorter.startswith("shorter: the rest after keyframe at 0.2 s lasts 0.000 s instead")
    assert "of 0.3 s" in shorter
    frames = list(show(*keys).keyframes)
    frames[1] = replace(frames[1], hold_s=0.3)
    held = plan(Sequence(name="show", keyframes=tuple(frames)), robot)
    assert held.marks[2].planned_s - held.marks[1].planned_s == pytest.approx(0.3, abs=1e-6)
    assert not any(line.startswith("shorter") for line in plan_lines(held, robot))


def test_a_show_in_which_nothing_moves_says_so(robot):
    assert plan_lines(plan(show((0.0, 0.0), (1.0, 0.0)), robot), robot)[-1] == "nothing moves"


def test_the_pass_after_the_first_counts_too(robot):
    # The seam is passed at full speed, which only the second pass shows from its start.
    sequence = show((0.0, 0.0), (1.0, 40.0), (3.0, -40.0), (4.0, 0.0), loop=3)
    uses = {use.joint.name: use for use in limit_uses(plan(sequence, robot), robot)}
    assert uses["base"].accel_deg_s2 > 200.0
    assert uses["elbow"].speed_deg_s == 0.0


def jaw(step_s: float = 0.1, **more) -> Sequence:
    """Return a jaw that opens and closes 24 times; labels at its closures."""
    frames = [Keyframe(at_s=0.0, deg={"base": 0.0})]
    frames += [
        Keyframe(at_s=1.0 + step_s * k, deg={"base": 25.0 * (k % 2)}, label=f"m{k}")
        for k in range(1, 25)
    ]
    frames.append(Keyframe(at_s=6.0, deg={"base": 0.0, "elbow": 0.0}))
    return Sequence(name="jaw", keyframes=tuple(frames), keeps_time=frozenset({"base"}), **more)


def test_what_is_given_up_to_keep_the_time_is_told_with_the_turns_that_are_missed(robot):
    lines = plan_lines(plan(jaw(), robot), robot)
    assert "every keyframe is on time" in lines
    (total,) = [
        line for line in lines if line.startswith("angle given up to keep the time: 1 span")
    ]
    assert total.endswith("deg by 'base'")
    (span,) = [line for line in lines if line.startswith("less far: ")]
    assert "joint 'base' is up to 1" in span
    upper, lower = [line for line in lines if line.startswith("not reached: ")]
    assert "joint 'base' does not get as high as 12 turns: 25 deg at " in upper
    assert "joint 'base' does not get as low as 12 turns: 0 deg at " in lower
    assert upper.endswith(", and 9 more")
    assert lower.endswith(", and 9 more")
    assert "exact: true or a weight at a keyframe makes its joints get there" in lines
    whole = plan_lines(plan(jaw(), robot), robot, is_whole=True)
    _, lower = [line for line in whole if line.startswith("not reached: ")]
    for k in range(2, 24, 2):
        assert f"0 deg at {1.0 + 0.1 * k:.3f} s (m{k}) becomes 1" in lower
    assert lines[-1] == "the show runs as fast as it can; faster would give up more angle"


def test_json_has_what_is_given_up_and_the_program_keeps_it(robot):
    trajectory = plan(jaw(), robot)
    program = compile_program(trajectory, robot)
    content = show_as_json(Show(robot=robot, program=program, trajectory=trajectory))
    (span,) = content["given_up"]
    assert span["joint"] == "base"
    assert span["by_deg"] == pytest.approx(trajectory.given_up[0].by_deg)
    assert len(span["missed"]) == 24
    assert span["missed"][0]["label"] == "m1"
    json.dumps(content)


@pytest.mark.parametrize("bound_deg", [14.0, None])
def test_a_servo_that_would_fall_behind_is_named(robot, bound_deg):
    frames = [Keyframe(at_s=0.15 * k, deg={"base": 30.0 * (k % 2)}) for k in range(90)]
    sequence = Sequence(name="jaw", keyframes=tuple(frames))
    trajectory = plan(sequence, robot)
    program = compile_program(trajectory, robot)
    if bound_deg is not None:
        program = replace(program, bound_deg={"base": bound_deg})
    lines = program_lines(Show(robot=robot, program=program, trajectory=trajectory))
    behind = [line for line in lines if line.startswith("falls behind: joint 'base' by up to ")]
    assert len(behind) == (bound_deg is not None)
    assert all("(following_deg 10)" in line and "keep: time" in line for line in behind)
