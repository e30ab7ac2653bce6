"""robot.yaml → `Robot`: merged and default values, and refused files with their lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.playing.player.handshake import session_commands
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import encode
from lss_motion.robot.load import load_robot
from lss_motion.robot.model import Bus, Response, Robot
from lss_motion.robot.on_fault import DEFAULTS, Cause, FaultStep
from lss_motion.robot.profile import ramp_deg_s2, ramp_setting_deg_s2

ROOT = Path(__file__).resolve().parents[3]

START = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints:
"""


@pytest.fixture
def robot_path(tmp_path: Path) -> Path:
    return tmp_path / "robot.yaml"


def load(path: Path, text: str) -> Robot:
    path.write_text(text, encoding="utf-8")
    return load_robot(path)


def refusals(path: Path, text: str) -> list[tuple[int | None, str]]:
    with pytest.raises(InputError) as caught:
        load(path, text)
    return [(error.line, error.reason) for error in (caught.value, *caught.value.more)]


def test_the_desk_arm_reads_as_it_is_written() -> None:
    robot = load_robot(ROOT / "sequences/robots/desk_arm.yaml")
    assert robot.name == "desk_arm"
    assert list(robot.joints) == ["base", "shoulder", "elbow", "wrist", "gripper"]
    bus = Bus(name="main", port="sim://", baud_bps=115200, firmware=370, pro_firmware=370)
    assert robot.buses == {"main": bus}
    shoulder = robot.joints["shoulder"]
    assert (shoulder.servo_id, shoulder.bus, shoulder.direction) == (2, "main", -1)
    assert shoulder.model.name == "LSS-HT1"
    assert (shoulder.position_min_deg, shoulder.position_max_deg) == (-90.0, 90.0)
    assert (shoulder.speed_max_deg_s, shoulder.accel_max_deg_s2) == (180.0, 600.0)
    assert robot.poses["home"]["elbow"] == -60.0
    assert robot.end == "hold"


def test_a_joint_has_the_line_of_each_field_also_of_a_default(robot_path: Path) -> None:
    arm = load(robot_path, START + "  arm:\n    id: 1\n    speed_max_deg_s: 90\n").joints["arm"]
    assert (arm.lines["model"], arm.lines["speed_max_deg_s"]) == (2, 6)


def test_a_robot_file_needs_only_joints(robot_path: Path) -> None:
    robot = load(
        robot_path,
        "robot: one\njoints:\n  a: {id: 0, model: LSS-P-S1, range_deg: [-1, 1], "
        "speed_max_deg_s: 5, accel_max_deg_s2: 17}\n",
    )
    assert robot.path == robot_path
    assert robot.buses["main"].port == "sim://"
    assert robot.joints["a"].bus == "main"
    assert robot.joints["a"].model.wire_per_deg == 100
    assert robot.joints["a"].accel_max_deg_s2 == 17.0, "AA of an LSS-PRO counts in hundredths"
    assert [robot.buses["main"].firmware_of(family) for family in Family] == [370, 780, 370]
    assert robot.joints["a"].following_deg == 10.0
    assert robot.joints["a"].response == Response()
    assert robot.approach_speed_deg_s == 30.0


def test_a_stiffness_changes_the_ramps_that_a_joint_can_have(robot_path: Path) -> None:
    """The horn must not exceed the limit of the joint, whatever AS makes of AA and AD."""
    for stiffness, setting, ramp in ((0, 600, 600.0), (4, 400, 585.6), (-4, 870, 594.2)):
        text = START + f"  a: {{id: 1, settings: {{AS: {stiffness}}}}}\n"
        joint = load(robot_path, text).joints["a"]
        assert ramp_setting_deg_s2(joint) == setting
        assert ramp_deg_s2(joint) == pytest.approx(ramp, abs=0.1)
        assert joint.accel_max_deg_s2 == pytest.approx(ramp, abs=0.1)
        assert joint.accel_max_deg_s2 <= 600.0


PRO_JOINT = (
    "joints:\n  a: {id: 1, model: LSS-P-M1, range_deg: [-90, 90], speed_max_deg_s: 90, "
    "accel_max_deg_s2: 57}\n"
)


def test_the_units_of_a_robot_file_reach_the_bytes_of_its_servos(robot_path: Path) -> None:
    usual = load(robot_path, "robot: one\n" + PRO_JOINT).joints["a"]
    own = load(
        robot_path, "robot: one\nunits: {speed_deg_s: 0.1, accel_deg_s2: 10}\n" + PRO_JOINT
    ).joints["a"]
    assert [encode(command) for command in session_commands([usual])] == [
        b"#1EM1\r", b"#1AA5700\r", b"#1AD5700\r", b"#1SD9000\r",
    ]  # fmt: skip
    assert [encode(command) for command in session_commands([own])] == [
        b"#1EM1\r", b"#1AA5\r", b"#1AD5\r", b"#1SD900\r",
    ]  # fmt: skip
    assert own.accel_max_deg_s2 == 50.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("units: {speed_deg_s: 0.1}\n" + START + "  a: {id: 1}\n", "no joint is one (model LSS-P-"),
        ("units: {speed_deg_s: 0.2}\nrobot: one\n" + PRO_JOINT, "must be one of 10, 1, 0.1, 0.01"),
        ("units: {position_deg: 10}\nrobot: one\n" + PRO_JOINT, "must be 1 or less"),
        ("units: {sped_deg_s: 0.1}\nrobot: one\n" + PRO_JOINT, "speed_deg_s"),
    ],
)
def test_units_that_no_servo_has_are_refused(robot_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError) as caught:
        load(robot_path, text)
    assert said in str(caught.value)


RC = START + (
    "  a: {id: 209, model: LSS-2IO, range_deg: [-83, 80], speed_max_deg_s: 300, zero_deg: 0.5,"
    " pulse_us: [500, 2500]}\n"
)


def test_an_rc_servo_with_its_own_pulses_gets_degrees_of_its_own(robot_path: Path) -> None:
    """1500 us is its middle; 45 deg are 2000 us, and D is 0 at 1472 us, 90 deg at 2400 us."""
    joint = load(robot_path, RC).joints["a"]
    for angle_deg, wire in ((-0.5, 30), (44.5, 510), (-79.5, -820)):
        command = make_command(joint.model.language, 209, "D", joint.servo_deg(angle_deg))
        assert command.value == wire
        assert round(joint.servo_deg(angle_deg) * joint.model.wire_per_deg / 10) * 10 == wire


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("[-83, 80]", "[-83, 85]", "to 85.5 deg; an LSS-2IO turns its servos by -86.0 to 81.0"),
        ("[500, 2500]", "[2500, 500]", "pulse_us must rise"),
        ("[500, 2500]", "[500]", "pulse_us"),
        ("LSS-2IO", "LSS-ST1", "pulse_us is for an RC servo on an LSS-2IO"),
    ],
)
def test_pulses_that_do_not_fit_are_refused(
    robot_path: Path, old: str, new: str, said: str
) -> None:
    with pytest.raises(InputError) as caught:
        load(robot_path, RC.replace(old, new))
    assert said in str(caught.value)


def test_a_joint_wins_over_defaults_key_by_key(robot_path: Path) -> None:
    robot = load(
        robot_path,
        "robot: two\n"
        "defaults:\n"
        "  {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600,\n"
        "   direction: -1, zero_deg: 5, settings: {AS: -2, AH: 3}, response: {lag_s: 0.1}}\n"
        "joints:\n"
        "  a: {id: 1, direction: 1, settings: {AH: 0}, response: {t_law: exact}}\n"
        "  b: {id: 2}\n",
    )
    a, b = robot.joints["a"], robot.joints["b"]
    assert (a.direction, b.direction) == (1, -1)
    assert (a.settings, b.settings) == ({"AS": -2, "AH": 0}, {"AS": -2, "AH": 3})
    assert a.response == Response(lag_s=0.1, t_law="exact")
    assert b.response == Response(lag_s=0.1)
    assert (a.servo_deg(10.0), b.servo_deg(10.0)) == (15.0, -5.0)


@pytest.mark.parametrize(
    ("joints", "line", "reason"),
    [
        ("  a: {id: 1, range_deg: [9, -9]}", 4, "range_deg must rise, but goes from 9 to -9"),
        ("  a: {id: 1, range_deg: [5, 5]}", 4, "range_deg must rise, but goes from 5 to 5"),
        ("  a: {id: 1, range_deg: [1, 2, 3]}", 4, "must have 2 or fewer entries"),
        ("  a: {id: 1, range_deg: [0, .nan]}", 4, "must be a finite number"),
        ("  a: {id: 1, range_deg: [0, .inf]}", 4, "must be a finite number"),
        ("  a: {id: 1, range_deg: [0, 1e6]}", 4, "must be 36000 or less"),
        ("  a: {id: '1'}", 4, "joints.a.id ('1'): must be a whole number"),
        ("  a: {id: true}", 4, "joints.a.id (true): must be a whole number"),
        ("  a: {id: 251}", 4, "must be 250 or less"),
        ("  a: {id: -1}", 4, "must be 0 or more"),
        ("  a: {}", 4, "'id' is missing"),
        ("  a: 3", 4, "must hold keys and values"),
        ("  a: {id: 1, direction: 0}", 4, "must be 1 or -1"),
        ("  a: {id: 1, direction: true}", 4, "must be a whole number"),
        ("  a: {id: 1, speed_max_deg_s: '9'}", 4, "must be a number"),
        ("  a: {id: 1, speed_max_deg_s: true}", 4, "must be a number"),
        ("  a: {id: 1, speed_max_deg_s: 0}", 4, "0.1 or more, or `servo`"),
        ("  a: {id: 1, speed_max_deg_s: .inf}", 4, "must be a number"),
        ("  a: {id: 1, accel_max_deg_s2: servos}", 4, "0.1 or more, or `servo`"),
        ("  a: {id: 1, model: LSS-2IO, speed_max_deg_s: servo}", 4, "on a 2IO has no limits"),
        ("  a: {id: 1, drive: streamed, accel_max_deg_s2: servo}", 4, "do not act while it is"),
        ("  a: {id: 1, speed_max_deg_s: 361}", 4, "faster than an LSS-ST1 can turn"),
        ("  a: {id: 1, accel_max_deg_s2: 1001}", 4, "more than the ramps of the servo (AA, AD)"),
        ("  a: {id: 1, drive: stepped}", 4, "whole degrees are for the RC servos of an LSS-2IO"),
        ("  a: {id: 1, model: LSS-P-S1, drive: streamed}", 4, "no document gives an LSS-PRO the"),
        ("  a: {id: 1, model: LSS-2IO, drive: timed}", 4, "an RC servo has no T"),
        ("  a: {id: 1, model: LSS-2IO, zero_deg: 1}", 4, "servo would go to 91 deg"),
        ("  a: {id: 1, drive: fast}", 4, "timed, streamed, stepped, auto"),
        ("  a: {id: 1, filter_count: 0}", 4, "must be 1 or more"),
        ("  a: {id: 1, model: LSS-ST2}", 4, "did you mean 'LSS-ST1'?"),
        ("  a: {id: 1, sped_max_deg_s: 9}", 4, "did you mean 'speed_max_deg_s'?"),
        ("  a: {id: 1, bus: man}", 4, "unknown bus 'man'; did you mean 'main'?"),
        ("  a: {id: 1, settings: {AX: 1}}", 4, "unknown setting 'AX'"),
        ("  a: {id: 1, settings: {AS: 11}}", 4, "AS 11 must be -10 to 10"),
        ("  a: {id: 1, settings: {AS: 1.5}}", 4, "must be a whole number"),
        ("  a: {id: 1, model: LSS-P-S1, settings: {AS: 1}}", 4, "unknown setting 'AS'"),
        ("  a: {id: 1, response: {retarget: fly}}", 4, "there are: keep_speed, from_rest"),
        ("  a: {id: 1, response: {lag_s: -1}}", 4, "must be 0 or more"),
        ("  a: {id: 1, following_deg: 0}", 4, "must be more than 0"),
        ("  a b: {id: 1}", 4, "a name has no blanks"),
        ('  "a\\x1b": {id: 1}', 4, "U+001B"),
        ("  a: {id: 1}\nposes: {p: {b: 1}}", 5, "unknown joint 'b'"),
        ("  a: {id: 1}\nposes: {p: {a: 90.1}}", 5, "joint 'a' at 90.1 deg is outside its range"),
        ("  a: {id: 1}\nposes: {p: {}}", 5, "must have 1 or more entries"),
        ("  a: {id: 1}\nbuses: {}", 5, "must have 1 or more entries"),
        ("  a: {id: 1}\nbuses: {x: {baud_bps: 100}}", 5, "must be one of 9600, 19200"),
        (
            "  a: {id: 1}\nbuses: {x: {baud_bps: 921600, firmware: 368}}",
            5,
            "needs firmware 369 or later",
        ),
        (
            "  a: {id: 1, bus: x}\nbuses:\n  x: {port: COM1}\n  y: {port: COM1}",
            7,
            "port 'COM1' already carries bus 'x'",
        ),
        ("  a: {id: 1}\nbuses: {x: {}, y: {}}", 4, "has no 'bus', and there are several: x, y"),
        ("  a: {id: 1}\nsensor: {}", 5, "unknown key 'sensor'"),
        ("  a: {id: 1}\nend: float", 5, "there are: hold, limp"),
        ("  a: {id: 1}\nrobot: again", 5, "'robot' is given twice, first in line 1"),
        ("  a: {id: 1}\napproach_speed_deg_s:", 5, "has no value"),
    ],
)
def test_a_wrong_entry_is_refused_with_line_and_reason(
    robot_path: Path, joints: str, line: int, reason: str
) -> None:
    ((found_line, found_reason),) = refusals(robot_path, START + joints + "\n")
    assert found_line == line
    assert reason in found_reason


def test_two_joints_with_one_id_on_one_bus_are_both_named(robot_path: Path) -> None:
    ((line, reason),) = refusals(robot_path, START + "  a: {id: 7}\n  b: {id: 7}\n")
    assert line == 5
    assert "joints 'a' and 'b' both have id 7 on bus 'main'" in reason


def test_one_id_on_two_buses_is_two_servos(robot_path: Path) -> None:
    text = START + "  a: {id: 7, bus: x}\n  b: {id: 7, bus: y}\nbuses: {x: {}, y: {}}\n"
    assert [joint.bus for joint in load(robot_path, text).joints.values()] == ["x", "y"]


def test_a_joint_without_a_limit_is_refused_with_the_place_for_it(robot_path: Path) -> None:
    found = refusals(robot_path, "robot: x\njoints:\n  a: {id: 1, model: LSS-ST1}\n")
    assert [line for line, _ in found] == [3, 3, 3]
    missing = ("range_deg", "speed_max_deg_s", "accel_max_deg_s2")
    for (_, reason), key in zip(found, missing, strict=True):
        assert reason == f"joint 'a' has no {key!r}; give it here or under 'defaults'"


def test_a_wrong_default_is_reported_once_at_its_own_line(robot_path: Path) -> None:
    text = START.replace("180", "400") + "  a: {id: 1}\n  b: {id: 2}\n"
    ((line, reason),) = refusals(robot_path, text)
    assert line == 2
    assert "faster than an LSS-ST1" in reason


def test_an_unreadable_default_is_reported_once(robot_path: Path) -> None:
    text = START.replace("180", "fast") + "  a: {id: 1}\n  b: {id: 2}\n"
    ((line, reason),) = refusals(robot_path, text)
    assert line == 2
    assert reason == "defaults.speed_max_deg_s ('fast'): must be a number, 0.1 or more, or `servo`"


def test_all_problems_of_a_file_come_in_one_run(robot_path: Path) -> None:
    found = refusals(
        robot_path,
        START
        + "  a: {id: 1, sped: 3}\n"
        + "  b: {id: 2, speed_max_deg_s: 999}\n"
        + "  c: {id: 2}\n"
        + "poses:\n"
        + "  p: {a: 3, z: 1}\n"
        + "  q: {b: fast}\n"
        + "end: never\n",
    )
    assert [line for line, _ in found] == [4, 5, 6, 8, 9, 10]


def test_an_error_in_one_joint_does_not_make_others_unknown(robot_path: Path) -> None:
    text = START + "  a: {id: one}\n  b: {id: 2}\nposes: {p: {a: 1, b: 1}}\n"
    assert [line for line, _ in refusals(robot_path, text)] == [4]


@pytest.mark.parametrize("key", ["robot", "joints"])
def test_name_and_joints_cannot_be_left_out(robot_path: Path, key: str) -> None:
    parts = {"robot": "robot: x\n", "joints": "joints: {a: {id: 1}}\n"}
    del parts[key]
    assert (1, f"{key!r} is missing") in refusals(robot_path, "".join(parts.values()))


PAIRS = START + "  l: {id: 1}\n  r: {id: 2}\n  m: {id: 3}\n"


def test_groups_and_mirror_images_are_read(robot_path: Path) -> None:
    text = PAIRS + "groups: {arms: [r, l]}\nmirror: {same: {m: m}, opposite: {l: r}}\n"
    robot = load(robot_path, text)
    assert robot.groups == {"arms": ("l", "r")}
    assert robot.mirror == {"m": ("m", 1), "l": ("r", -1), "r": ("l", -1)}


def test_groups_and_mirror_images_of_unknown_joints_are_refused(robot_path: Path) -> None:
    text = PAIRS + "groups:\n  l: [m]\n  arms: [l, rr]\nmirror:\n  same: {l: r}\n"
    found = refusals(robot_path, text + "  opposite: {r: m, l: x}\n")
    assert found == [
        (8, "group 'l' has the name of a joint"),
        (9, "group 'arms': unknown joint 'rr'; did you mean 'r'? there are: l, r, m"),
        (12, "joint 'r' has a mirror image already; keep one"),
        (12, "joint 'l' has a mirror image already; keep one"),
    ]


@pytest.mark.parametrize(
    ("asked", "ramp_ratio", "accel_deg_s2", "setting"),
    [
        (600, 1.0, 600.0, 600),
        (600, 0.8, 600.0, 750),
        (600, 0.7, 595.0, 850),
        (1000, 0.7, 700.0, 1000),  # All that its ramps can express.
        (600, 1.3, 598.0, 460),
    ],
)
def test_ramps_are_set_so_that_the_joint_keeps_its_limit_at_any_ramp_ratio(
    tmp_path, asked, ramp_ratio, accel_deg_s2, setting
):
    from lss_motion.robot.profile import ramp_deg_s2, ramp_setting_deg_s2

    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: one\njoints:\n  pan: {id: 1, model: LSS-ST1, range_deg: [-9, 9], "
        f"speed_max_deg_s: 90, accel_max_deg_s2: {asked}, "
        f"response: {{ramp_ratio: {ramp_ratio}}}}}\n"
    )
    joint = load_robot(path).joints["pan"]
    assert joint.accel_max_deg_s2 == pytest.approx(accel_deg_s2)
    assert ramp_setting_deg_s2(joint) == setting
    assert ramp_deg_s2(joint) == pytest.approx(accel_deg_s2)
    assert ramp_deg_s2(joint) <= asked


def test_escalations_are_read_for_the_robot_and_for_a_joint(tmp_path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: arm\n"
        "on_fault: {astray: [warn, hold], lost_port: hold}\n"
        "resume_s: 4\n"
        "defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 90, "
        "accel_max_deg_s2: 300, temperature_max_c: 60}\n"
        "joints:\n"
        "  hand: {id: 1, silent_s: 2, on_fault: {blocked: limp}}\n"
        "  arm: {id: 2}\n"
    )
    robot = load_robot(path)
    hand, arm = robot.joints["hand"], robot.joints["arm"]
    assert robot.escalation(Cause.ASTRAY, arm, {}) == (FaultStep.WARN, FaultStep.HOLD)
    assert robot.escalation(Cause.BLOCKED, hand, {}) == (FaultStep.LIMP,)
    assert robot.escalation(Cause.BLOCKED, arm, {}) == DEFAULTS[Cause.BLOCKED]
    assert robot.escalation(Cause.LOST_PORT, None, {}) == (FaultStep.HOLD,)
    assert (robot.resume_s, hand.temperature_max_c, hand.silent_s) == (4.0, 60.0, 2.0)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("{astray: hld}", "step 'hld' is not known; did you mean 'hold'"),
        ("{astry: hold}", "unknown key 'astry'; did you mean 'astray'"),
        ("{astray: [hold, warn]}", "nothing comes after hold"),
        ("{astray: resume}", "nothing comes back from astray"),
        ("{lost_port: limp}", "a lost port takes no command"),
        ("{stalled: warn}", "is not where the show is, so there is no warn"),
        ("{lost_turn: warn}", "a joint in another turn cannot be driven, so there is no warn"),
        ("{astray: [warn, warn]}", "warn stands there twice"),
        ("{astray: []}", "names no step"),
        ("{astray: 3}", "step '3' is not known"),
    ],
)
def test_a_wrong_escalation_is_refused_with_its_line(tmp_path, text: str, hint: str) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: arm\njoints:\n  a: {id: 1, model: LSS-ST1, range_deg: [-90, 90], "
        f"speed_max_deg_s: 90, accel_max_deg_s2: 300}}\non_fault: {text}\n"
    )
    with pytest.raises(InputError) as caught:
        load_robot(path)
    assert str(caught.value).startswith(f"{path}:4: ")
    assert hint in str(caught.value)
