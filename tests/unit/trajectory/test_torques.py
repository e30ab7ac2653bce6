"""What a plan asks of the servos of a robot with masses: torque, current, heat."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.check_json import show_as_json
from lss_motion.planning.shows import prepare
from lss_motion.planning.summaries import plan_lines
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.plot import plot
from lss_motion.planning.trajectory.torques import (
    ServoAssumptions,
    load_lines,
    plan_load,
    torque_curves,
)
from lss_motion.robot.dynamics import GRAVITY_M_S2
from lss_motion.robot.load import load_robot
from lss_motion.show.model import Keyframe, Sequence

ARM = """\
robot: arm
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {elbow: {id: 1}, wrist: {id: 2}}
"""
BAR = """\
figure:
  arm: {joint: elbow, axis: -y, length_mm: 300, mass_kg: 0.4}
  hand: {parent: arm, joint: wrist, axis: x, length_mm: 10}
"""


def load(tmp_path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    return load_robot(path)


def lift(robot, *angles_deg, every_s=1.0, **more):
    frames = tuple(
        Keyframe(at_s=index * every_s, deg={"elbow": deg}) for index, deg in enumerate(angles_deg)
    )
    return plan(Sequence(name="lift", keyframes=frames, **more), robot)


def bar_n_m(trajectory, times_s):
    """Return what lifts a thin even bar of 300 mm and 0.4 kg; the round ends are neglected."""
    deg, deg_s2 = (trajectory.sample(times_s, order)[:, 0] for order in (0, 2))
    weight = 0.4 * GRAVITY_M_S2 * 0.15 * np.cos(np.radians(deg))
    return weight + 0.4 * 0.3**2 / 3.0 * np.radians(deg_s2), weight


@pytest.mark.parametrize("voltage_v", [12.0, 7.4])
def test_the_hardest_instant_of_a_bar_is_that_of_its_formula(tmp_path, voltage_v):
    robot = load(tmp_path, ARM + BAR + f"supply: {{voltage_v: {voltage_v}}}\n")
    trajectory = lift(robot, -80.0, 60.0, -20.0, 0.0)
    found = plan_load(trajectory, robot)
    times_s = np.linspace(0.0, trajectory.duration_s, 6001)
    torque, weight = bar_n_m(trajectory, times_s)
    share = voltage_v / 12.0
    speed = trajectory.sample(times_s, 1)[:, 0]
    has = 1.373 * share * np.clip(1.0 - np.sign(torque) * speed / (360.0 * share), 0.01, 1.0)
    elbow, wrist = found.servos
    assert elbow.ratio == pytest.approx((np.abs(torque) / has).max(), rel=0.01)
    assert elbow.at_s == pytest.approx(times_s[(np.abs(torque) / has).argmax()], abs=0.01)
    assert elbow.has_n_m == pytest.approx(np.interp(elbow.at_s, times_s, has), rel=0.01)
    assert elbow.holds_n_m == pytest.approx(weight.max(), rel=1e-3)
    assert elbow.holds_ratio == pytest.approx(weight.max() / 1.373 / share, rel=1e-3)
    assert elbow.gives_way_deg == pytest.approx(5.0 * elbow.holds_ratio)
    assert wrist.torque_n_m == pytest.approx(0.0, abs=1e-9)
    assert found.weightless == ("hand",)
    lines = load_lines(found)
    is_warned = any(line.startswith("warning: elbow at ") for line in lines)
    assert is_warned is (elbow.ratio > 1.0)


def test_a_servo_that_the_load_drives_holds_back_with_all_it_has(tmp_path):
    """Down at half of the top speed it has all its torque, up half of it."""
    robot = load(tmp_path, ARM.replace("180, ", "360, ") + BAR)
    trajectory = lift(robot, 80.0, -80.0, 80.0)
    times_s = np.linspace(0.0, trajectory.duration_s, 801)
    torque, least, most = torque_curves(trajectory, robot, times_s)["elbow"]
    speed = trajectory.sample(times_s, 1)[:, 0]
    assert torque == pytest.approx(bar_n_m(trajectory, times_s)[0], abs=2e-3)
    assert most == pytest.approx(1.373 * np.clip(1.0 - speed / 360.0, 0.01, 1.0))
    assert least == pytest.approx(-1.373 * np.clip(1.0 + speed / 360.0, 0.01, 1.0))


@pytest.mark.parametrize(
    ("joint", "share", "faster"),
    [("{id: 1, ratio: 1.6}", 0.625, 1.6), ("{id: 1, linkage: LINKAGE}", 0.5, 2.0)],
)
def test_a_servo_behind_a_transmission_does_the_same_work(tmp_path, joint, share, faster):
    linkage = "{joint_deg: [-90, -30, 30, 90], servo_deg: [-180, -60, 60, 180]}"
    text = ARM.replace("{id: 1}", joint.replace("LINKAGE", linkage)) + BAR
    robot = load(tmp_path, text.replace("speed_max_deg_s: 180", "speed_max_deg_s: 100"))
    plain = load(tmp_path, ARM.replace("speed_max_deg_s: 180", "speed_max_deg_s: 100") + BAR)
    trajectory = lift(robot, -60.0, 60.0)
    geared, straight = plan_load(trajectory, robot), plan_load(lift(plain, -60.0, 60.0), plain)
    one = next(found for found in geared.servos if "elbow" in found.servo)
    other = straight.servos[0]
    assert one.holds_n_m == pytest.approx(share * other.holds_n_m, rel=1e-4)
    speed = float(trajectory.sample(np.array([one.at_s]), 1)[0, 0])
    assert abs(one.speed_deg_s) == pytest.approx(faster * abs(speed), rel=1e-3)
    assert one.torque_n_m / one.has_n_m == pytest.approx(math.copysign(one.ratio, one.torque_n_m))


def test_two_servos_of_one_joint_share_its_torque(tmp_path):
    pair = (
        "joints: {elbow: {}, wrist: {id: 2}}\n"
        "mechanisms:\n  lift:\n    kind: pair\n    joint: elbow\n"
        "    servos: {left: {id: 3}, right: {id: 4, direction: -1}}\n"
    )
    robot = load(tmp_path, ARM.replace("joints: {elbow: {id: 1}, wrist: {id: 2}}\n", pair) + BAR)
    alone = load(tmp_path, ARM + BAR)
    shared, whole = (plan_load(lift(one, -60.0, 60.0), one) for one in (robot, alone))
    halves = {one.servo: one.holds_n_m for one in shared.servos}
    assert halves["left servo of lift"] == pytest.approx(whole.servos[0].holds_n_m / 2.0, rel=1e-4)
    assert halves["right servo of lift"] == pytest.approx(whole.servos[0].holds_n_m / 2.0, rel=1e-4)


def test_the_current_is_that_of_all_servos_and_is_held_against_the_supply(tmp_path):
    robot = load(tmp_path, ARM + BAR + "supply: {current_max_a: 0.7}\n")
    trajectory = lift(robot, -60.0, 0.0, -60.0)
    found = plan_load(trajectory, robot)
    times_s = np.arange(0.0, trajectory.duration_s, 0.005)
    torque, _ = bar_n_m(trajectory, times_s)
    speed = np.abs(trajectory.sample(times_s, 1)[:, 0])
    whole_a = 2 * 0.07 + 1.5 * np.abs(torque) / 1.373 + 0.13 * speed / 360.0
    assert found.current_max_a == pytest.approx(whole_a.max(), rel=0.01)
    assert found.current_mean_a == pytest.approx(whole_a.mean(), rel=0.01)
    assert any("the supply gives 0.7 A" in line for line in load_lines(found))
    enough = replace(robot, supply=replace(robot.supply, current_max_a=2.0))
    assert not any("supply gives" in line for line in load_lines(plan_load(trajectory, enough)))


@pytest.mark.parametrize("hold_s", [1.0, 40.0, 400.0])
def test_heat_is_that_of_a_motor_which_repeats_the_show(tmp_path, hold_s):
    """Against the same first-order law, stepped through pass after pass."""
    robot = load(tmp_path, ARM + BAR.replace("0.4", "0.8"))
    frames = (Keyframe(at_s=0.0, deg={"elbow": 0.0}, hold_s=hold_s),)
    rest = tuple(Keyframe(at_s=hold_s + at, deg={"elbow": deg}) for at, deg in ((2, 89), (4, 0)))
    trajectory = plan(Sequence(name="hold", keyframes=(*frames, *rest)), robot)
    assumed = ServoAssumptions(heating_c_per_a2=45.0)
    found = plan_load(trajectory, robot, assumed).servos[0]
    step_s = 0.1
    times_s = np.arange(0.0, trajectory.duration_s, step_s)
    torque = 2.0 * bar_n_m(trajectory, times_s)[0]
    speed = np.abs(trajectory.sample(times_s, 1)[:, 0])
    motor_a2 = (1.5 * np.abs(torque) / 1.373 + 0.13 * speed / 360.0) ** 2
    warmer, now_s, hot_s, most = 0.0, 0.0, None, 0.0
    for _ in range(math.ceil(3000.0 / trajectory.duration_s)):
        for square in motor_a2:
            warmer += (45.0 * square - warmer) * step_s / 300.0
            now_s += step_s
            most = max(most, warmer)
            if hot_s is None and 25.0 + warmer > 75.0:
                hot_s = now_s
    assert found.warmest_c == pytest.approx(25.0 + most, abs=1.0)
    assert (found.hot_after_s is None) is (hot_s is None)
    assert found.hot_after_s is None or found.hot_after_s == pytest.approx(hot_s, rel=0.03, abs=2.0)
    is_said = any("elbow is hot after" in line for line in load_lines(plan_load(trajectory, robot)))
    assert is_said is (plan_load(trajectory, robot).servos[0].hot_after_s is not None)


def test_what_is_not_known_of_a_model_is_said_and_never_too_much(tmp_path):
    robot = load(tmp_path, ARM.replace("LSS-ST1", "LSS-P-S1").replace("180,", "90,") + BAR)
    found = plan_load(lift(robot, -20.0, 20.0), robot)
    elbow = found.servos[0]
    assert (elbow.ratio, elbow.has_n_m, elbow.hot_after_s, elbow.gives_way_deg) == (None,) * 4
    assert elbow.holds_n_m == pytest.approx(0.4 * GRAVITY_M_S2 * 0.15, rel=1e-3)
    lines = "\n".join(load_lines(found))
    assert "what an LSS-P-S1 has is not known" in lines
    assert "warning" not in lines


def test_a_robot_without_masses_has_no_such_lines_and_one_on_feet_is_not_judged(tmp_path):
    lines = []
    for figure in ("", BAR.replace(", mass_kg: 0.4", ""), BAR.replace("300,", "300, foot: true,")):
        robot = load(tmp_path, ARM + figure)
        assert plan_load(lift(robot, -20.0, 20.0), robot) is None
        lines.append(plan_lines(lift(robot, -20.0, 20.0), robot))
    assert lines[0] == lines[1] == lines[2]
    assert not any("load" in line for line in lines[0])


def test_a_wrong_urdf_file_is_a_line_of_the_plan_and_stops_nothing_else(tmp_path):
    robot = load(tmp_path, ARM + "urdf: {file: none.urdf}\n")
    lines = plan_lines(lift(robot, -20.0, 20.0), robot)
    assert any(line.startswith("warning: torques are not known: ") for line in lines)
    with pytest.raises(InputError):
        plan_load(lift(robot, -20.0, 20.0), robot)


def test_check_and_picture_have_the_load(tmp_path, monkeypatch):
    (tmp_path / "robot.yaml").write_text(ARM + BAR.replace("0.4", "1.2"))
    (tmp_path / "lift.yaml").write_text(
        "sequence: lift\nrobot: robot.yaml\nkeyframes:\n  - {at_s: 0, deg: {elbow: -60}}\n"
        "  - {at_s: 1, deg: {elbow: 0}}\n"
    )
    show = prepare(tmp_path / "lift.yaml", None)
    found = show_as_json(show)["load"]
    assert [one["servo"] for one in found["servos"]] == ["elbow", "wrist"]
    assert found["servos"][0]["ratio"] > 1.0
    drawn = []
    monkeypatch.setattr(
        "lss_motion.planning.trajectory.plot.save", lambda figure, _: drawn.append(figure)
    )
    plot(show.trajectory, show.robot, tmp_path / "lift.png")
    titles = [axis.get_title(loc="left") for axis in drawn[0].axes]
    assert "torque of servo, N·m" in titles
