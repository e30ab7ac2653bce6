"""Mechanisms in robot files: what they become, and what is refused."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.planning.summaries import robot_lines
from lss_motion.robot.file import JointDefaults
from lss_motion.robot.load import load_robot
from lss_motion.robot.mechanisms import limits_along, places_of
from lss_motion.robot.model import NO_SERVO
from lss_motion.robot.transmission import FourBar, Grid, Linear, LinkageCurve

if TYPE_CHECKING:
    from pathlib import Path

HEAD = """\
robot: head
defaults: {model: LSS-HS1, speed_max_deg_s: 120, accel_max_deg_s2: 500}
joints:
  turret: {id: 1, ratio: 2.5, range_deg: [-60, 60]}
  jaw: {id: 2, range_deg: [0, 22], linkage: {joint_deg: [0, 5, 12, 22], servo_deg: [-8, 6, 30, 71]}}
  lid: {id: 3, range_deg: [0, 60], linkage: {kind: four_bar, crank_mm: 10, rod_mm: 34, rocker_mm: 14, base_mm: 36, offset_deg: 12}}
  tilt: {range_deg: [-20, 25]}
  roll: {range_deg: [-15, 15]}
  arm: {range_deg: [-90, 90]}
  yaw: {range_deg: [-30, 30]}
  pitch: {range_deg: [-20, 20]}
mechanisms:
  neck: {kind: differential, joints: [tilt, roll], servos: {left: {id: 5}, right: {id: 6, direction: -1}}, matrix: [[1.8, 1.2], [1.8, -1.2]]}
  shoulder: {kind: pair, joint: arm, servos: {front: {id: 7}, back: {id: 8, direction: -1, zero_deg: 0.4}}}
  eyes: {kind: table, joints: [yaw, pitch], servos: {a: {id: 9}, b: {id: 10}}, file: eyes.csv}
"""  # noqa: E501


def eyes(yaw: float, pitch: float) -> tuple[float, float]:
    return 1.2 * yaw + 0.8 * pitch + 0.004 * yaw * pitch, 1.2 * yaw - 0.8 * pitch + 0.003 * yaw**2


def eyes_csv() -> str:
    rows = ["yaw_deg,pitch_deg,a_deg,b_deg"]
    for yaw in np.linspace(-30, 30, 7):
        for pitch in np.linspace(-20, 20, 5):
            a, b = eyes(yaw, pitch)
            rows.append(f"{yaw:g},{pitch:g},{a:.6f},{b:.6f}")
    return "\n".join(rows) + "\n"


@pytest.fixture
def head(tmp_path: Path) -> Path:
    (tmp_path / "eyes.csv").write_text(eyes_csv(), encoding="utf-8")
    path = tmp_path / "head.yaml"
    path.write_text(HEAD, encoding="utf-8")
    return path


def test_a_robot_has_joints_and_servos(head: Path) -> None:
    robot = load_robot(head)
    assert list(robot.joints) == ["turret", "jaw", "lid", "tilt", "roll", "arm", "yaw", "pitch"]
    assert list(robot.servos) == [
        *("turret", "jaw", "lid", "neck.left", "neck.right", "shoulder.front", "shoulder.back"),
        *("eyes.a", "eyes.b"),
    ]
    assert robot.joints["tilt"].servo_id == NO_SERVO
    assert robot.joints["turret"].servo_id == 1
    back = robot.servos["shoulder.back"]
    assert (back.servo_id, back.direction, back.zero_deg) == (8, -1, 0.4)
    assert list(robot.servo_robot.joints) == list(robot.servos)
    assert robot.servo_robot.servo_robot is not robot
    with pytest.raises(InputError, match="nothing was sent"):
        robot.require_servos()
    robot.servo_robot.require_servos()


def test_limits_of_fixed_ratios_hold_on_both_sides(head: Path) -> None:
    text = HEAD.replace("ratio: 2.5", "ratio: 2.5, servo: {speed_max_deg_s: 100}")
    head.write_text(text, encoding="utf-8")
    robot = load_robot(head)
    assert robot.servos["turret"].speed_max_deg_s == 100.0
    assert robot.joints["turret"].speed_max_deg_s == pytest.approx(40.0)
    # Its ramps can express 1000 deg/s² at most, which is 400 of the joint, not the 500 of the file.
    assert robot.servos["turret"].accel_max_deg_s2 == 1000.0
    assert robot.joints["turret"].accel_max_deg_s2 == pytest.approx(400.0)


@pytest.mark.parametrize("name", ["jaw", "lid", "neck", "eyes", "shoulder", "turret"])
def test_derivatives_and_inverse_agree_with_the_angles(head: Path, name: str) -> None:
    robot = load_robot(head)
    mechanism = robot.mechanisms[name]
    joints = [robot.joints[joint] for joint in mechanism.joints]
    rng = np.random.default_rng(1)
    low = np.array([joint.position_min_deg for joint in joints])
    high = np.array([joint.position_max_deg for joint in joints])
    at_deg = low + (high - low) * rng.uniform(0.02, 0.98, (200, len(joints)))
    first = rng.normal(size=at_deg.shape)
    g, step = mechanism.transmission, 1e-4
    before, here, after = (g.servo_deg(at_deg + k * step * first) for k in (-1.0, 0.0, 1.0))
    slopes = np.einsum("nsj,nj->ns", g.slopes(at_deg), first)
    np.testing.assert_allclose((after - before) / (2 * step), slopes, atol=1e-5)
    bends = (after - 2 * here + before) / step**2
    np.testing.assert_allclose(g.bends(at_deg, first), bends, atol=2e-4)
    np.testing.assert_allclose(g.joint_deg(here), at_deg, atol=1e-7)


def test_a_four_bar_closes_where_it_says() -> None:
    bar = FourBar(crank_mm=10, rod_mm=34, rocker_mm=14, base_mm=36, offset_deg=12)
    curve = bar.curve(0.0, 60.0)
    at_deg = np.linspace(0.0, 60.0, 37)
    crank = np.radians(curve.servo_deg(at_deg[:, None])[:, 0] + bar.crank_deg(np.zeros(1))[0])
    rocker = np.radians(90.0 - 12.0 + at_deg)
    rod = np.hypot(
        36 + 14 * np.cos(rocker) - 10 * np.cos(crank), 14 * np.sin(rocker) - 10 * np.sin(crank)
    )
    np.testing.assert_allclose(rod, 34.0, atol=1e-6)


def test_outside_of_what_was_measured_a_curve_goes_on_straight() -> None:
    curve = LinkageCurve((0.0, 5.0, 12.0, 22.0), (-8.0, 6.0, 30.0, 71.0))
    far = curve.servo_deg(np.array([[22.0], [24.0], [26.0]]))[:, 0]
    assert far[2] - far[1] == pytest.approx(far[1] - far[0])
    assert curve.joint_deg(far[2:, None])[0, 0] == pytest.approx(26.0)


def test_a_pair_fights_by_what_its_servos_are_apart(head: Path) -> None:
    pair = load_robot(head).mechanisms["shoulder"]
    assert pair.fight_deg(np.array([[10.0, 10.0], [10.0, 10.6]])) == pytest.approx([0.0, 0.6])
    assert isinstance(pair.transmission, Linear)


def test_a_surface_goes_through_its_points(head: Path) -> None:
    grid = load_robot(head).mechanisms["eyes"].transmission
    assert isinstance(grid, Grid)
    at_deg = np.array([[-30.0, 20.0], [7.0, -3.0]])
    np.testing.assert_allclose(grid.servo_deg(at_deg), [eyes(*at) for at in at_deg], atol=1e-5)


def test_noise_in_a_table_is_told_with_its_cost_and_smoothed_on_request(head: Path) -> None:
    noisy = "joint_deg: [0, 4, 8, 12, 16, 20, 24], servo_deg: [0, 8.9, 15.3, 24.8, 31.2, 40.9, 48]"
    text = HEAD.replace("joint_deg: [0, 5, 12, 22], servo_deg: [-8, 6, 30, 71]", noisy)
    head.write_text(text, encoding="utf-8")
    (warning,) = [line for line in robot_lines(load_robot(head)) if "smooth_deg" in line]
    assert "warning: jaw: at joint angle" in warning
    assert "alone takes" in warning
    offer = warning.partition("`smooth_deg: ")[2].partition("`")[0]
    head.write_text(text.replace(noisy, f"{noisy}, smooth_deg: {offer}"), encoding="utf-8")
    robot = load_robot(head)
    lines = robot_lines(robot)
    assert not [line for line in lines if "warning" in line]
    assert len([line for line in lines if "smoothed, it is taken to be" in line]) == 7
    moved = robot.mechanisms["jaw"].moved_deg
    assert max(abs(now - was) for _, was, now in moved) <= float(offer) + 1e-6


TABLE = "joint_deg: [0, 5, 12, 22], servo_deg: [-8, 6, 30, 71]"
BAR = "crank_mm: 10, rod_mm: 34, rocker_mm: 14, base_mm: 36, offset_deg: 12"
NECK = "matrix: [[1.8, 1.2], [1.8, -1.2]]"

BAD = [
    (TABLE, "joint_deg: [0, 22], servo_deg: [-8, 71]", 5, "needs 3 points or more, and has 2"),
    (TABLE, "joint_deg: [0, 5, 22], servo_deg: [-8, 71]", 5, "has 2 angles and joint_deg has 3"),
    (TABLE, "joint_deg: [0, 12, 5, 22], servo_deg: [-8, 6, 30, 71]", 5, "5 follows 12"),
    (TABLE, "joint_deg: [0, 5, 12, 22], servo_deg: [-8, 6, 5, 71]", 5, "turns at joint angle 5"),
    (TABLE, "joint_deg: [1, 5, 12, 22], servo_deg: [-8, 6, 30, 71]", 5, "must cover range_deg"),
    (TABLE, "joint_deg: [0, 9, 10, 22], servo_deg: [0, 1, 60, 61]", 5, "turns or is flat at"),
    (TABLE, "joint_deg: [0, 5, 22]", 5, "'servo_deg' is missing"),
    (TABLE, f"{TABLE}, rod_mm: 3", 5, "'rod_mm' has no meaning in a linkage of kind table"),
    (TABLE, f"{TABLE}, smooth_deg: 1", 5, "smooth_deg needs 5 points or more"),
    (BAR, "crank_mm: 10, rod_mm: 12, rocker_mm: 14, base_mm: 36", 6, "the four-bar cannot close"),
    (BAR, "crank_mm: 10, rod_mm: 34, rocker_mm: 14", 6, "'base_mm' is missing"),
    (BAR, f"{BAR}, turns: away", 6, "four-bar cannot close at"),
    ("id: 1, ratio: 2.5", "id: 1, ratio: 2.5, linkage: {}", 4, "exclude each other"),
    ("id: 1, ratio: 2.5", "id: 1, ratio: 0", 4, "ratio"),
    ("ratio: 2.5", "servo: {speed_max_deg_s: 9}", 4, "neither ratio nor linkage"),
    ("ratio: 2.5", "ratio: 2.5, servo: {range_deg: [-90, 90]}", 4, "outside of its range_deg"),
    ("ratio: 2.5", "ratio: 2.5, servo: {speed_max_deg_s: 9999}", 4, "is faster than an LSS-HS1"),
    ("ratio: 2.5", "ratio: 2.5, speed_max_deg_s: servo", 4, "cannot be read from a servo"),
    (NECK, "matrix: [[1.8, 1.2], [1.8, 1.2]]", 13, "matrix is singular"),
    (NECK, "matrix: [[1.8, 1.2]]", 13, "must have 2 rows of 2 numbers"),
    (f", {NECK}", "", 13, "'matrix' is missing"),
    (NECK, f"{NECK}, ratio: 2", 13, "'ratio' has no meaning in a mechanism of kind differential"),
    ("joints: [tilt, roll]", "joints: [tilt, rol]", 13, "unknown joint 'rol'; did you mean 'roll'"),
    ("joints: [tilt, roll]", "joints: [tilt, arm]", 14, "joint 'arm' is in mechanism 'neck' alr"),
    ("joints: [tilt, roll]", "joint: tilt", 13, "has no 'joints'"),
    ("tilt: {", "tilt: {id: 44, ", 7, "joint 'tilt' is moved by mechanism 'neck', whose servos"),
    ("tilt: {", "tilt: {zero_deg: 4, ", 7, "whose servos have 'zero_deg'"),
    ("{left: {id: 5}", "{left: {id: 7}", 14, "both have id 7"),
    ("{left: {id: 5}", "{left: {id: 5, following_deg: 3}", 13, "belongs to the joint"),
    ("  neck: {", "  arm: {", 13, "a joint has this name"),
    ("  turret: {", "  neck.left: {", 13, "a joint has the name of this servo, 'neck.left'"),
    ("back: {id: 8,", "back: {id: 8, model: LSS-ST1,", 14, "must move alike, but model"),
    ("front: {id: 7}, ", "", 14, "a pair needs two servos"),
    ("file: eyes.csv", "file: eyes2.csv", 15, "file not found"),
    ("file: eyes.csv", "file: ../eyes.csv", 15, "below the folder of the robot file"),
    ("[yaw, pitch]", "[pitch, yaw]", 15, "pitch in it goes from"),
    ("yaw: {range_deg: [-30, 30]}", "yaw: {range_deg: [-40, 30]}", 15, "must cover range_deg"),
    (
        "arm: {range_deg",
        "other: {range_deg: [0, 1]}\n  arm: {range_deg",
        9,
        "no mechanism moves jo",
    ),
]


@pytest.mark.parametrize(("old", "new", "line", "reason"), BAD)
def test_what_is_wrong_is_told_with_its_line(
    head: Path, old: str, new: str, line: int, reason: str
) -> None:
    assert HEAD.count(old) == 1
    head.write_text(HEAD.replace(old, new), encoding="utf-8")
    if old == "[yaw, pitch]":
        csv = (head.parent / "eyes.csv").read_text(encoding="utf-8")
        (head.parent / "eyes.csv").write_text(csv.replace("-20", "-19"), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_robot(head)
    told = [caught.value, *caught.value.more]
    found = [one for one in told if reason in one.reason]
    assert found, "\n".join(map(str, told))
    assert found[0].line == line


VALUES = {
    "bus": "main",
    "model": "LSS-ST1",
    "direction": -1,
    "zero_deg": 1,
    "pulse_us": [500, 2500],
    "turns": "powered",
    "temperature_max_c": 50,
    "voltage_min_v": 7,
    "silent_s": 2,
    "settings": {"AH": 3},
    "stored": {"LED": 3},
    "drive": "timed",
    "filter_count": 5,
    "response": {"lag_s": 0.01},
}


@pytest.mark.parametrize(
    "key", [key for key in JointDefaults.__struct_fields__ if key not in ("given", "range_deg")]
)
def test_each_key_of_a_joint_counts_or_is_refused_where_servos_move_it(
    head: Path, key: str
) -> None:
    value = VALUES.get(key, 60)
    changed = HEAD.replace("tilt: {range", f"tilt: {{{key}: {json.dumps(value)}, range")
    head.write_text(changed, encoding="utf-8")
    if key in VALUES:
        with pytest.raises(InputError, match=f"whose servos have '{key}'"):
            load_robot(head)
    else:
        assert getattr(load_robot(head).joints["tilt"], key) == value


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda rows: rows[:1], "a smooth surface needs 4 or more"),
        (lambda rows: [*rows[:4], *rows[5:]], "lacks 1 place of the grid, such as -30, 10"),
        (lambda rows: [*rows, rows[3]], "eyes.csv:37: measures -30, 0 a second time"),
        (lambda rows: [*rows[:3], "1,2,x,4", *rows[3:]], "eyes.csv:4: must hold 4 numbers"),
        (lambda rows: ["yaw_deg,a_deg", *rows[1:]], "eyes.csv:1: needs one column 'pitch_deg'"),
        (lambda rows: [rows[0], *(f"{r.rsplit(',', 1)[0]},0" for r in rows[1:])], "turns or is f"),
    ],
)
def test_a_measured_grid_that_is_wrong(head: Path, change, reason: str) -> None:
    rows = eyes_csv().splitlines()
    (head.parent / "eyes.csv").write_text("\n".join(change(rows)), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_robot(head)
    assert reason in str(caught.value)
    assert caught.value.line == 15


@pytest.mark.parametrize("name", ["turret", "jaw", "lid", "tilt", "arm", "yaw"])
def test_the_limits_along_a_joint_are_those_of_its_servos_there(head: Path, name: str) -> None:
    """At them no servo exceeds its own, wherever the other joints stand, and one is at its own."""
    robot = load_robot(head)
    deg, speed, accel = limits_along(robot, name)
    joint = robot.joints[name]
    assert (deg[0], deg[-1]) == (joint.position_min_deg, joint.position_max_deg)
    (mechanism,) = [one for one in robot.mechanisms.values() if name in one.joints]
    servos = [robot.servos[one] for one in mechanism.servos]
    column = mechanism.joints.index(name)
    others = [robot.joints[one] for one in mechanism.joints]
    for at_deg, speed_deg_s, accel_deg_s2 in zip(deg, speed, accel, strict=True):
        places = places_of(others)
        places[:, column] = at_deg
        gains = np.abs(mechanism.transmission.slopes(places)[:, :, column]).max(axis=0)
        for limit, own, allowed in (
            (speed_deg_s, joint.speed_max_deg_s, [one.speed_max_deg_s for one in servos]),
            (accel_deg_s2, joint.accel_max_deg_s2, [one.accel_max_deg_s2 for one in servos]),
        ):
            least = min([own, *(most / gain for most, gain in zip(allowed, gains, strict=True))])
            assert limit == pytest.approx(least, rel=1e-9)
