"""Gaits as sequences: alone, in play lists, and under layers."""

from __future__ import annotations

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.planning import shows
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing import api
from lss_motion.show.check import check_sequence
from lss_motion.show.gait.load import load_gait, sequence_from, sequence_of
from lss_motion.show.gait.model import LAID_OUT_CYCLES, BodyMove, BodyPose
from lss_motion.show.gait.pacing import joints_of, paced
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Interpolation, Timing
from lss_motion.show.write import write_sequence
from tests.tables import first_quick

NOD = BodyMove(pose=BodyPose(tilt_deg=(0, 5, 0)), in_s=1.0, hold_s=0.5, label="nod", line=3)
BACK = BodyMove(pose=BodyPose(), in_s=1.0, label="back", line=4)


def test_a_gait_becomes_keyframes_of_its_legs_with_labels_and_lines(kit):
    gait = kit.gait("tripod", NOD, BACK, kit.walk(20.0, cycles=2, label="go", line=5))
    robot = kit.robot(gait)
    sequence = sequence_of(gait, robot)
    check_sequence(sequence, robot)
    assert (sequence.timing, sequence.loop) == (Timing.AUTHORED, 1)
    assert (sequence.path, sequence.robot_path) == (gait.path, gait.robot_path)
    labelled = [(k.label, k.line) for k in sequence.keyframes if k.label]
    assert labelled == [("nod", 3), ("back", 4), ("go", 5)]
    assert {tuple(keyframe.deg) for keyframe in sequence.keyframes} == {joints_of(gait)}
    assert {keyframe.ease for keyframe in sequence.keyframes} == {Interpolation.SPLINE}
    assert [k.hold_s for k in sequence.keyframes if k.hold_s] == [0.5]
    held = next(k for k in sequence.keyframes if k.hold_s)
    assert held.at_s == 1.0
    times_s = [keyframe.at_s for keyframe in sequence.keyframes]
    assert times_s == sorted(set(times_s))
    expected_s = sum(part.duration_s + part.hold_s for part in paced(gait, robot))
    assert times_s[-1] == pytest.approx(expected_s, abs=1e-4)


def test_the_planner_slows_nothing_and_feet_keep_their_paths(kit):
    gait = kit.gait("tripod", kit.walk(200.0, turn_deg_s=20.0, cycles=3), cycle_s=0.5)
    robot = kit.robot(gait)
    (part,) = parts = paced(gait, robot)
    assert part.pace_ratio > 1.5
    trajectory = plan(sequence_from(gait, parts), robot)
    assert trajectory.stretched == ()
    assert trajectory.duration_s == pytest.approx(part.duration_s, abs=1e-4)
    own = trajectory.sample(part.times_s * part.pace_ratio)
    columns = [joints_of(gait).index(name) for name in trajectory.joints]
    np.testing.assert_allclose(own, part.angles_deg[:, columns], atol=1e-3)


def test_cycles_join_and_the_loop_closes_without_a_jump_of_speed(kit):
    gait = kit.gait("ripple", kit.walk(20.0, cycles=5), loop=3)
    trajectory = plan(sequence_of(gait, kit.robot(gait)), kit.robot(gait))
    cycle_s = gait.cycle_s * paced(gait, kit.robot(gait))[0].pace_ratio
    one_s = trajectory.duration_s / 3
    for seam_s in (2 * cycle_s, 3 * cycle_s, one_s, 2 * one_s):
        before, after = trajectory.sample(np.array([seam_s - 1e-6, seam_s + 1e-6]), 1)
        assert np.abs(after - before).max() < 1.0
    # Two steady cycles are one and the same motion.
    at = np.linspace(0.0, cycle_s, 50)
    first, second = trajectory.sample(2 * cycle_s + at), trajectory.sample(3 * cycle_s + at)
    assert np.abs(first - second).max() < 0.05


def test_a_written_gait_loads_as_the_same_sequence(kit, tmp_path):
    gait = kit.gait("trot", kit.walk(20.0, cycles=1), BACK)
    sequence = sequence_of(gait, kit.robot(gait))
    write_sequence(sequence, tmp_path / "s.yaml")
    assert load_sequence(tmp_path / "s.yaml") == sequence
    endless = replace(kit.walk(20.0, cycles=LAID_OUT_CYCLES), more_cycles=None)
    sequence = sequence_of(replace(gait, actions=(endless,)), kit.robot(gait))
    write_sequence(sequence, tmp_path / "s.yaml")
    assert load_sequence(tmp_path / "s.yaml") == sequence


@pytest.mark.parametrize("pattern", first_quick(["tripod", "wave", "trot", "crawl"]))
def test_the_middle_of_a_long_walk_is_looped_without_a_seam(kit, pattern):
    robot_gait = kit.gait(pattern)
    robot = kit.robot(robot_gait)
    laid_out = kit.walk(20.0, turn_deg_s=4.0, cycles=LAID_OUT_CYCLES)
    walk = replace(laid_out, more_cycles=5)
    gait = replace(robot_gait, actions=(kit.walk(10.0, cycles=2), walk, NOD, BACK))
    long = replace(gait, actions=(kit.walk(10.0, cycles=2), replace(walk, cycles=12, more_cycles=0),
                                  NOD, BACK))  # fmt: skip
    looped = plan(sequence_of(gait, robot), robot)
    whole = plan(sequence_of(long, robot), robot)
    assert looped.loop == 6
    assert looped.duration_s == pytest.approx(whole.duration_s, abs=2e-3)
    at_s = np.arange(0.0, whole.duration_s, 0.02)
    assert np.abs(looped.sample(at_s) - whole.sample(at_s)).max() < 0.1
    seams_s = np.array([looped.pass_start_s(index) for index in range(1, 6)])
    before, after = looped.sample(seams_s - 1e-6, 1), looped.sample(seams_s + 1e-6, 1)
    assert np.abs(before).max() > 1.0
    assert np.abs(after - before).max() < 0.2


def test_a_walk_without_end_is_one_cycle_that_is_looped(kit):
    walk = replace(kit.walk(20.0, cycles=LAID_OUT_CYCLES), more_cycles=None)
    gait = kit.gait("ripple", walk)
    sequence = sequence_of(gait, kit.robot(gait))
    assert sequence.loop is None
    from_s, to_s = sequence.loop_span_s
    pace_ratio = paced(gait, kit.robot(gait))[0].pace_ratio
    assert to_s - from_s == pytest.approx(gait.cycle_s * pace_ratio, abs=2e-6)
    assert len(sequence.keyframes) < 600
    assert plan(sequence, kit.robot(gait)).duration_s == np.inf


def test_more_keyframes_than_are_planned_in_one_piece_are_refused(kit):
    gait = kit.gait("tripod", kit.walk(20.0, cycles=700))
    with pytest.raises(InputError, match="keyframes, at most 10,000"):
        sequence_of(gait, kit.robot(gait))


@pytest.fixture(autouse=True)
def _cache(monkeypatch, tmp_path):
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


@pytest.fixture
def folder(kit, tmp_path):
    """A hexapod with a head, a short walk, a nod of its head, and room for a show."""
    robot = (kit.examples / "robots" / "hexapod.yaml").read_text()
    head = "joints:\n  head: {id: 30, range_deg: [-60, 60]}\n"
    (tmp_path / "robot.yaml").write_text(robot.replace("joints:\n", head, 1))
    (tmp_path / "walk.yaml").write_text(
        f"gait: steps\nrobot: robot.yaml\nlegs_from: {kit.examples}/hexapod_walk.yaml\n"
        "height_mm: 80\ncycle_s: 1.6\nstep_height_mm: 15\n"
        "do:\n  - walk: {forward_mm_s: 25, cycles: 2}\n"
    )
    (tmp_path / "look.yaml").write_text(
        "sequence: look\nrobot: robot.yaml\nkeyframes:\n  - {at_s: 0, deg: {head: 0}}\n"
        "  - {at_s: 1.2, deg: {head: 40}}\n  - {at_s: 2.4, deg: {head: 0}}\nloop: 2\n"
    )
    return tmp_path


def show(folder, text):
    (folder / "show.yaml").write_text(f"sequence: show\nrobot: robot.yaml\n{text}")
    return folder / "show.yaml"


def test_a_gait_in_a_play_list_moves_as_it_does_alone(folder):
    path = show(folder, "play:\n  - {pause_s: 0.5}\n  - {file: walk.yaml, times: 2}\n")
    sequence, robot = shows.load(path, None)
    listed = plan(sequence, robot)
    alone = plan(sequence_of(load_gait(folder / "walk.yaml"), robot), robot)
    times_s = np.linspace(0.0, alone.duration_s, 500)
    columns = [listed.joints.index(name) for name in alone.joints]
    for start_s in (0.5, 0.5 + alone.duration_s):
        np.testing.assert_allclose(
            listed.sample(times_s + start_s)[:, columns], alone.sample(times_s), atol=1e-3
        )
    assert listed.duration_s == pytest.approx(0.5 + 2.0 * alone.duration_s)


def test_a_head_looks_around_while_the_legs_walk(folder):
    path = show(
        folder,
        "play:\n  - {file: walk.yaml}\n"
        "layers:\n  - {file: look.yaml, mode: override, joints: [head], fade_s: 0.1}\n",
    )
    sequence, robot = shows.load(path, None)
    trajectory = plan(sequence, robot)
    alone = plan(sequence_of(load_gait(folder / "walk.yaml"), robot), robot)
    times_s = np.linspace(0.0, alone.duration_s, 500)
    columns = [trajectory.joints.index(name) for name in alone.joints]
    np.testing.assert_allclose(
        trajectory.sample(times_s)[:, columns], alone.sample(times_s), atol=0.01
    )
    assert trajectory.sample(times_s)[:, trajectory.joints.index("head")].max() > 35.0


def test_a_gait_can_be_a_layer_of_a_show(folder):
    path = show(
        folder,
        "keyframes:\n  - {at_s: 0, deg: {head: 0}}\n  - {at_s: 6, deg: {head: 20}}\n"
        "layers:\n  - {file: walk.yaml, mode: override, from_s: 1}\n",
    )
    sequence, robot = shows.load(path, None)
    trajectory = plan(sequence, robot)
    coxa = trajectory.joints.index("left_front_coxa")
    assert np.ptp(trajectory.sample(np.linspace(1.0, 5.0, 200))[:, coxa]) > 5.0


def test_a_gait_cannot_be_added_to_other_angles(folder):
    path = show(
        folder,
        "keyframes:\n  - {at_s: 0, deg: {head: 0}}\n  - {at_s: 6, deg: {head: 20}}\n"
        "layers:\n  - {file: walk.yaml, mode: add}\n",
    )
    with pytest.raises(InputError, match=r"walk\.yaml.*cannot be added"):
        shows.load(path, None)


def test_an_error_in_a_gait_of_a_play_list_names_the_line_of_the_gait_file(folder, capsys):
    text = (folder / "walk.yaml").read_text().replace("forward_mm_s: 25", "forward_mm_s: 900")
    (folder / "walk.yaml").write_text(text)
    assert main(["check", str(show(folder, "play:\n  - {file: walk.yaml}\n"))]) == 2
    assert f"{folder / 'walk.yaml'}:8: leg" in capsys.readouterr().err


def test_shows_with_gaits_are_recognised(folder):
    path = show(folder, "play:\n  - {file: walk.yaml}\n")
    assert shows.walks(shows.load(path, None)[0])
    assert not shows.walks(shows.load(folder / "look.yaml", None)[0])


def test_python_loads_gaits_like_sequences(folder):
    assert api.load_sequence(folder / "walk.yaml").name == "steps"
    assert len(api.load_sequence(folder / "walk.yaml").keyframes) > 20
