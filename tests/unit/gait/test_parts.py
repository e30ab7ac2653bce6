"""Gaits inside of shows: in play lists, under layers, and where they cannot be."""

from __future__ import annotations

import numpy as np
import pytest

from lss_motion import api
from lss_motion.cli import shows
from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.gait.load import load_gait
from lss_motion.gait.to_sequence import sequence_of
from lss_motion.trajectory.planner import plan


@pytest.fixture(autouse=True)
def _cache(monkeypatch, tmp_path):
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


@pytest.fixture
def folder(kit, tmp_path):
    """A hexapod with a head, a short walk, a nod of its head, and room for a show."""
    robot = (kit.examples / "robots" / "hexapod.yaml").read_text()
    (tmp_path / "robot.yaml").write_text(robot + "  head: {id: 30, range_deg: [-60, 60]}\n")
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


def test_a_gait_in_a_play_list_is_walked_as_it_is_alone(folder):
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


def test_a_gait_lies_on_top_of_a_show_as_a_layer(folder):
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


def test_a_fault_in_a_gait_of_a_play_list_names_the_gaits_own_line(folder, capsys):
    text = (folder / "walk.yaml").read_text().replace("forward_mm_s: 25", "forward_mm_s: 900")
    (folder / "walk.yaml").write_text(text)
    assert main(["check", str(show(folder, "play:\n  - {file: walk.yaml}\n"))]) == 2
    assert f"{folder / 'walk.yaml'}:8: leg" in capsys.readouterr().err


def test_shows_that_walk_are_compiled_as_closely_as_gaits(folder):
    path = show(folder, "play:\n  - {file: walk.yaml}\n")
    assert shows.walks(shows.load(path, None)[0])
    assert not shows.walks(shows.load(folder / "look.yaml", None)[0])


def test_python_loads_gaits_like_sequences(folder):
    assert api.load_sequence(folder / "walk.yaml").name == "steps"
    assert len(api.load_sequence(folder / "walk.yaml").keyframes) > 20
