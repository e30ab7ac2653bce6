"""Gaits in MuJoCo: laws of the judge itself, then what it says of our examples."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.planning import shows
from lss_motion.planning.gait_physics import PhysicsWorld, judged_walk
from lss_motion.planning.trajectory.planner import plan
from lss_motion.robot.load import load_robot
from lss_motion.show.gait.kinematics import Stance
from lss_motion.show.gait.load import sequence_from
from lss_motion.show.gait.pacing import TIP_RATIO_MIN, gait_lines, paced

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"
HEXAPOD, QUADRUPED = EXAMPLES / "hexapod_walk.yaml", EXAMPLES / "quadruped_trot.yaml"
SLOW = "do:\n  - walk: {stride_mm: 20, cycles: 2}\n"
STAND = "do:\n  - stand: {in_s: 1.0, hold_s: 1.0}\n"


@pytest.fixture
def judged(tmp_path):
    """Judge an example with other keys or actions; return gait, passages and verdict."""

    def judge(example: Path, do: str | None = None, world: PhysicsWorld | None = None, **keys):
        pytest.importorskip("mujoco", reason="pip install 'lss-motion[physics]'")
        gait, passages, trajectory, robot = planned(tmp_path, example, do, **keys)
        return gait, passages, judged_walk(gait, robot, passages, trajectory, world)

    return judge


def planned(folder: Path, example: Path, do: str | None = None, **keys):
    head, _, own = example.read_text().partition("do:\n")
    lines = [line for line in head.splitlines() if line.partition(":")[0] not in keys]
    lines += [f"{key}: {value}" for key, value in keys.items()]
    text = "\n".join(lines).replace("robots/", f"{EXAMPLES}/robots/")
    (folder / "gait.yaml").write_text(f"{text}\n{do or 'do:' + chr(10) + own}")
    gait, robot = shows.load_gait(folder / "gait.yaml", None, load_robot)
    passages = paced(gait, robot)
    return gait, passages, plan(sequence_from(gait, passages), robot), robot


def test_a_standing_robot_does_not_slide(judged):
    _, _, verdict = judged(HEXAPOD, STAND, start="standing")
    assert verdict.is_upright
    assert math.hypot(*verdict.walked_mm) < 1.0
    assert max(verdict.slip_mm.values()) < 1.0
    assert verdict.tilt_max_deg < 1.0


@pytest.mark.parametrize(("friction", "slides"), [(0.1, True), (0.5, False)])
def test_on_a_slope_it_slides_where_the_friction_is_less_than_the_tangent(judged, friction, slides):
    """The tangent of 10 degrees is 0.176."""
    world = PhysicsWorld(friction=friction, slope_deg=10.0)
    _, _, verdict = judged(HEXAPOD, STAND, world, start="standing")
    assert (verdict.walked_mm[0] < -50.0) is slides


@pytest.mark.parametrize("uphill", [1.0, -1.0])
@pytest.mark.parametrize(("share", "stands"), [(0.8, True), (1.25, False)])
def test_a_standing_robot_tips_over_on_the_slope_that_is_claimed(judged, share, stands, uphill):
    _, passages, verdict = judged(QUADRUPED, STAND, start="standing")
    assert verdict.is_upright
    slope_deg = uphill * share * passages[0].slope_max_deg
    _, _, verdict = judged(
        QUADRUPED, STAND, PhysicsWorld(friction=2.0, slope_deg=slope_deg), start="standing"
    )
    assert verdict.is_upright is stands


def test_a_slope_takes_height_times_tangent_of_the_margin(tmp_path):
    """The centre as a plumb line sees it on the slope: half of the margin is left at half of it."""
    _, passages, _, _ = planned(tmp_path, QUADRUPED, STAND, start="standing")
    part = passages[0]
    stance = part.passage.at(np.zeros(1))
    margin_mm, height_mm = float(stance.margin_mm()[0]), float(stance.shift_mm[0, 2])
    half = math.degrees(math.atan(0.5 * margin_mm / height_mm))
    moved = math.tan(math.radians(half)) * height_mm
    lower = msgspec.structs.replace(stance, places=stance.places + np.array([[0.0, moved, 0.0]]))
    feet = stance.feet_mm
    assert lower.margin_mm()[0] < margin_mm
    assert np.allclose(feet, lower.feet_mm)
    assert math.tan(math.radians(part.slope_max_deg)) == pytest.approx(2.0 * moved / height_mm)


def test_servos_that_are_too_weak_are_at_their_end(judged):
    _, _, strong = judged(HEXAPOD, STAND, start="standing")
    _, _, weak = judged(HEXAPOD, STAND, PhysicsWorld(strength=0.05), start="standing")
    assert strong.saturated_ratio < 0.01
    assert max(strong.torque_ratio.values()) < 0.6
    assert weak.saturated_ratio > 0.5


def test_the_hexapod_walks_to_where_it_was_planned(judged):
    _, passages, verdict = judged(HEXAPOD)
    assert verdict.is_upright
    assert math.hypot(*verdict.planned_mm) > 300.0
    assert verdict.off_mm < 15.0
    assert verdict.turned_deg == pytest.approx(verdict.planned_deg, abs=2.0)
    assert all(part.tip_ratio == 1.0 for part in passages)


def test_a_trot_gets_most_of_its_way(judged):
    _, passages, verdict = judged(QUADRUPED)
    assert verdict.is_upright
    assert verdict.walked_mm[0] > 0.6 * verdict.planned_mm[0]
    assert TIP_RATIO_MIN < passages[0].tip_ratio < 1.0


@pytest.mark.parametrize("pattern", ["pace", "bound"])
def test_what_goes_nowhere_is_predicted_with_the_values_in_use(judged, pattern):
    gait, passages, verdict = judged(QUADRUPED, pattern=pattern)
    assert verdict.walked_mm[0] < 0.2 * verdict.planned_mm[0]
    assert passages[0].tip_ratio < TIP_RATIO_MIN
    (warning,) = [line for line in gait_lines(gait, passages) if "it will not get far" in line]
    assert f"cycle_s (now {gait.cycle_s:g})" in warning
    assert f"step_height_mm (now {gait.step_height_mm:g})" in warning
    assert f"now {pattern}; crawl cannot tip" in warning


def test_the_time_to_tip_is_that_of_a_pendulum():
    """Compared with the equation of motion, integrated in small steps."""
    height_mm, depth_mm, away_mm, step_mm = 140.0, 6.0, 110.0, 12.0
    feet = np.array([[[100.0, 0.0, 0.0], [-100.0, 0.0, 0.0], [0.0, away_mm, 12.0]]])
    stance = Stance(
        places=np.array([[0.0, depth_mm, 0.0]]),
        shift_mm=np.array([[0.0, 0.0, height_mm]]),
        tilt_deg=np.zeros((1, 3)),
        feet_mm=feet,
        is_down=np.array([[True, True, False]]),
    )
    off_mm, speed, time_s, dt = depth_mm, 0.0, 0.0, 1e-5
    while (off_mm - depth_mm) / height_mm * away_mm < step_mm:
        speed += dt * 9810.0 / height_mm * off_mm
        off_mm += dt * speed
        time_s += dt
    assert stance.tip_s(step_mm)[0] == pytest.approx(time_s, rel=1e-3)


def test_a_static_pattern_that_would_fall_gets_advice_that_was_tried(tmp_path):
    with pytest.raises(Exception, match="would fall") as refused:
        planned(tmp_path, QUADRUPED, SLOW, pattern="crawl", sway_mm=0)
    advice = str(refused.value)
    assert "(now 0)" in advice
    sway_mm = float(advice.partition("sway_mm: ")[2].split()[0])
    planned(tmp_path, QUADRUPED, SLOW, pattern="crawl", sway_mm=sway_mm)


def test_without_the_extra_the_message_says_what_to_install(judged, monkeypatch, tmp_path):
    gait, passages, trajectory, robot = planned(tmp_path, HEXAPOD)
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match="physics"):
        judged_walk(gait, robot, passages, trajectory)


def test_the_command_prints_assumptions_and_refuses_them_alone(capsys):
    pytest.importorskip("mujoco", reason="pip install 'lss-motion[physics]'")
    assert main(["gait", str(HEXAPOD), "--physics", "--body-kg", "0.9"]) == 0
    out = capsys.readouterr().out
    assert "friction 0.8, body 0.9 kg" in out
    assert "upright;" in out
    assert main(["gait", str(HEXAPOD), "--friction", "0.5"]) == 2
    assert "--friction is for --physics" in capsys.readouterr().err
