"""Windows around edits: what a plan of the whole edited show is, where they are joined to it."""

from __future__ import annotations

import numpy as np
import pytest
from campaign.anchors import robot_of
from msgspec.structs import replace

from lss_motion.errors import PlanningError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.window import edited_window
from lss_motion.show.model import Keyframe, Sequence

STEP_S = 0.5
LONG_S = 30.0
EDITS = ("angle", "time", "ripple", "insert", "delete", "hold")


@pytest.fixture(autouse=True)
def _own_cache(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("LSS_MOTION_CACHE_DIR", str(tmp_path / "plans"))


def any_show(seed: int, rough: float) -> tuple:
    """Return a show of 30 s, a share of whose moves is too fast, and its robot."""
    random = np.random.default_rng(seed)
    names = tuple(f"j{index}" for index in range(int(random.integers(1, 7))))
    robot = robot_of(random, names)
    frames, deg = [], np.zeros(len(names))
    for at_s in np.arange(0.0, LONG_S, STEP_S).tolist():
        size = 60.0 if random.random() < rough else 10.0
        deg = np.clip(deg + size * random.uniform(-1.0, 1.0, len(names)), -90.0, 90.0)
        frames.append(Keyframe(at_s=at_s, deg=dict(zip(names, deg.round(1).tolist(), strict=True))))
    return Sequence(name="long", keyframes=tuple(frames)), robot


def edited(show: Sequence, edit: str, random: np.random.Generator) -> tuple:
    """Return the show with an edit, and from when to when it reaches."""
    frames = [*show.keyframes]
    index = int(random.integers(1, len(frames) - 1))
    frame = frames[index]
    at_s, name = float(frame.at_s), str(random.choice([*frame.deg]))
    by_s = float(random.uniform(-0.3, 0.3))
    match edit:
        case "angle":
            frames[index] = replace(frame, deg={**frame.deg, name: random.uniform(-60.0, 60.0)})
            by_s = 0.0
        case "time":
            frames[index] = replace(frame, at_s=at_s + by_s)
        case "ripple":
            frames[index:] = [replace(f, at_s=f.at_s + by_s) for f in frames[index:]]
        case "insert":
            by_s = 0.2
            new = Keyframe(at_s=at_s + by_s, deg={name: random.uniform(-60.0, 60.0)})
            frames.insert(index + 1, new)
        case "delete":
            del frames[index]
            by_s = 0.0
        case _:
            frames[index] = replace(frame, hold_s=0.3)
            by_s = 0.3
    ends_s = min(at_s, at_s + by_s), max(at_s, at_s + by_s)
    return replace(show, keyframes=tuple(frames)), *ends_s


@pytest.mark.parametrize("edit", EDITS)
@pytest.mark.parametrize("seed", range(4))
def test_a_window_that_is_joined_is_what_a_plan_of_the_whole_gives(seed: int, edit: str) -> None:
    show, robot = any_show(seed, rough=(0.0, 0.05, 0.2)[seed % 3])
    before = plan(show, robot)
    changed, from_s, to_s = edited(show, edit, np.random.default_rng([seed, EDITS.index(edit)]))
    after = plan(changed, robot)
    window = edited_window(changed, robot, before, from_s, to_s)
    assert window is not None
    assert window.is_joined
    planned = {mark.authored_s: mark.planned_s for mark in after.marks}
    assert window.marks
    for mark in window.marks:
        assert mark.planned_s == pytest.approx(planned[mark.authored_s], abs=1e-3)
    own_s = np.linspace(0.0, window.to_s - window.from_s, 500)
    inside = window.trajectory.sample(own_s)
    assert inside == pytest.approx(after.sample(own_s + window.from_s), abs=0.2)
    front_s = np.linspace(0.0, window.from_s, 200)
    assert before.sample(front_s) == pytest.approx(after.sample(front_s), abs=0.005)
    if window.to_s < after.duration_s - 1e-6:
        rest_s = np.linspace(window.to_s, after.duration_s, 200)
        moved = before.sample(rest_s - window.later_s)
        assert moved == pytest.approx(after.sample(rest_s), abs=0.005)
        assert window.to_s - window.from_s < 0.8 * LONG_S


def test_a_window_says_what_is_late_and_which_limit_binds() -> None:
    show, robot = any_show(1, rough=0.0)
    name = next(iter(robot.joints))
    frames = [*show.keyframes]
    frames[20] = replace(frames[20], deg={**frames[20].deg, name: 150.0}, is_anchor=True)
    changed = replace(show, keyframes=tuple(frames))
    window = edited_window(changed, robot, plan(show, robot), 10.0, 10.0)
    (late,) = [mark for mark in window.marks if mark.authored_s == pytest.approx(10.0)]
    assert late.planned_s > 10.1
    assert {span.joint for span in window.stretched} == {name}
    with pytest.raises(PlanningError, match="cannot be met"):
        plan(changed, robot)


def test_a_show_of_tracks_or_layers_has_no_window_but_a_track_has() -> None:
    show, robot = any_show(2, rough=0.0)
    whole = Sequence(name="tracks", tracks=(show,))
    assert edited_window(whole, robot, plan(whole, robot), 3.0, 3.0) is None
    (part,) = plan(whole, robot).first.parts
    assert edited_window(show, robot, part, 3.0, 3.0).is_joined


def test_the_robot_leaves_its_range_in_no_window() -> None:
    show, robot = any_show(3, rough=0.0)
    before = plan(show, robot)
    frames = [replace(f, ease="spline") for f in show.keyframes]
    name = next(iter(robot.joints))
    frames[30] = replace(frames[30], deg={**frames[30].deg, name: 178.9})
    frames[31] = replace(frames[31], deg={**frames[31].deg, name: 178.9})
    with pytest.raises(PlanningError, match="allowed -179 to 179"):
        edited_window(replace(show, keyframes=tuple(frames)), robot, before, 15.0, 15.5)
