"""What the commands do, from Python: the same numbers, and errors that name arguments."""

from __future__ import annotations

import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import lss_motion as lss
from lss_motion.cli import play
from lss_motion.cli.commands import COMMAND_GROUPS
from lss_motion.cli.main import main
from lss_motion.errors import PYTHON_NAMES

SEQUENCES = Path(__file__).resolve().parents[2] / "sequences"
WAVE = SEQUENCES / "wave.yaml"
ARM = SEQUENCES / "robots" / "desk_arm.yaml"


@pytest.fixture(scope="module")
def robot():
    return lss.load_robot(ARM)


@pytest.fixture(scope="module")
def trajectory(robot):
    return lss.plan(lss.load_sequence(WAVE), robot)


def printed(capsys, *words):
    assert main([str(word) for word in words]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", ["wave.yaml", "hexapod_walk.yaml"])
def test_check_returns_what_the_command_prints(capsys, name):
    found = lss.check(SEQUENCES / name)
    assert json.loads(json.dumps(found)) == json.loads(
        printed(capsys, "check", SEQUENCES / name, "--json")
    )


@pytest.mark.parametrize(
    "words",
    [
        ("check", SEQUENCES / "fastest.yaml"),
        ("check", SEQUENCES / "tracks.yaml"),
        ("check", SEQUENCES / "quadruped_trot.yaml"),
        ("check", ARM),
        ("report", WAVE),
    ],
)
def test_what_is_printed_as_json_is_as_its_schema_says(capsys, tmp_path, words):
    """And as it says only: a key that the schema does not know is refused here."""
    kind, path = words
    if kind == "check":
        found = json.loads(printed(capsys, "check", path, "--json"))
    else:
        report = tmp_path / "report.json"
        assert play.main([str(path), "--virtual", "--loop", "1", "--report", str(report)]) == 0
        capsys.readouterr()
        found = json.loads(report.read_text(encoding="utf-8"))
    schema = json.loads(printed(capsys, "schema", kind))
    for part in schema["$defs"].values():
        part["additionalProperties"] = part.get("additionalProperties", False)
    jsonschema.Draft202012Validator(schema).validate(found)
    assert found["schema"] == 1


def test_a_gait_is_printed_as_json(capsys):
    path = SEQUENCES / "quadruped_trot.yaml"
    found = json.loads(printed(capsys, "gait", path, "--json"))
    lines = printed(capsys, "gait", path).splitlines()
    assert f"one pass {found['duration_s']:.2f} s" in lines[0]
    assert json.loads(json.dumps(lss.gait(path))) == found
    assert len(found["legs"]) == 4
    walk, *_ = found["passages"]
    assert [action["label"] for action in walk["actions"]] == ["walk", "bend", "back"]
    assert f"body up to {-walk['margin_min_mm']:.0f} mm outside" in lines[1]


@pytest.mark.parametrize("format_name", ["csv", "ros", "blender-json"])
def test_export_returns_what_the_command_writes(capsys, tmp_path, trajectory, format_name):
    path = tmp_path / "out.txt"
    words = ("export", WAVE, "-o", path, "--to", format_name, "--rate-hz", 20)
    printed(capsys, *words)
    assert lss.export(trajectory, format_name, rate_hz=20) == path.read_text(encoding="utf-8")


def test_a_table_that_was_exported_comes_back(tmp_path, robot, trajectory):
    path = tmp_path / "wave.csv"
    path.write_text(lss.export(trajectory, "csv"), encoding="utf-8")
    again = lss.plan(lss.import_motion(path, robot, tolerance_deg=0.2), robot)
    times_s = np.linspace(0.0, 6.5, 200)
    columns = [again.joints.index(joint) for joint in trajectory.joints]
    away_deg = again.sample(times_s)[:, columns] - trajectory.sample(times_s)
    assert np.abs(away_deg).max() < 0.5


def test_a_simulated_play_has_the_true_errors_of_horns_also_of_a_worse_robot(robot, trajectory):
    program = lss.compile(trajectory, robot)
    assumed, late = (
        lss.play(
            program,
            robot,
            port="sim://",
            is_virtual=True,
            sim=sim,
            has_feedback=False,
            trajectory=trajectory,
        )
        for sim in ("", "lag=+60ms")
    )
    for joint in ("base", "wrist"):
        at_best = assumed.joints[joint].horn_error_rms_deg
        at_worst = late.joints[joint].horn_error_rms_deg
        assert 0.0 < at_best < 0.5
        assert at_worst > 2.0 * at_best


def test_scan_finds_the_servos_of_a_simulated_robot(robot):
    found = lss.scan(robot=robot, baud_bps=115200)
    assert {s.servo_id for s in found} == {j.servo_id for j in robot.joints.values()}
    assert all(servo.voltage_v and servo.voltage_v > 6.0 for servo in found)


def test_calibrate_gives_the_zero_with_which_a_joint_stands_at_its_pose(robot):
    with lss.connect(robot, is_virtual=True) as live:
        live.move_to({"elbow": 20})
        (zero_deg,) = lss.calibrate(live, {"elbow": 35.0}).values()
        stands_deg = live.read()["elbow"]
    joint = robot.joints["elbow"]
    angle_deg = (joint.servo_deg(stands_deg) - zero_deg) * joint.direction
    assert angle_deg == pytest.approx(35.0, abs=0.11)  # It is read in tenths.


@pytest.mark.slow
def test_identify_measures_a_joint_and_the_log_of_a_show_tells_the_same(tmp_path, robot):
    with lss.connect(robot, is_virtual=True) as live:
        found = lss.identify(live, "elbow")
    stated = robot.joints["elbow"].response
    assert found.lag_s.value == pytest.approx(stated.lag_s, abs=0.01)
    log = tmp_path / "wave.log"
    assert play.main([str(WAVE), "--virtual", "--loop", "1", "--quiet", "--log", str(log)]) == 0
    logged = lss.identify_log(log, robot)
    assert "base" not in logged, "it moves too little in this show"
    assert logged["shoulder"].delay_s.value == pytest.approx(found.delay_s.value, abs=0.02)


@pytest.mark.parametrize("times_s", [0.5, [0.5], (0.5, 1), range(3), np.float32(0.5), np.arange(4)])
def test_a_plan_takes_any_row_of_numbers(trajectory, times_s):
    rows = np.atleast_1d(np.asarray(times_s, dtype=float))
    assert trajectory.sample(times_s).shape == (len(rows), len(trajectory.joints))


WRONG = {
    "virtual time on a device": lambda robot, program: lss.play(
        program, robot, port="/dev/ttyUSB9", is_virtual=True
    ),
    "a worse device": lambda robot, program: lss.play(
        program, robot, port="/dev/ttyUSB9", sim="lag=+30ms"
    ),
    "an empty port": lambda robot, program: lss.play(program, robot, port=""),
    "no robot": lambda robot, program: lss.load_sequence(
        {"sequence": "x", "keyframes": [{"at_s": 0, "deg": {"base": 0}}]}
    ),
    "a rate that is too high": lambda robot, program: lss.export(
        lss.plan(lss.load_sequence(WAVE), robot), "csv", rate_hz=1e9
    ),
    "an unknown format": lambda robot, program: lss.export(
        lss.plan(lss.load_sequence(WAVE), robot), "cvs"
    ),
    "no motion": lambda robot, program: lss.import_motion(ARM, robot),
    "no time": lambda robot, program: lss.plan(lss.load_sequence(WAVE), robot).sample("soon"),
    "no number": lambda robot, program: lss.plan(lss.load_sequence(WAVE), robot).sample([np.nan]),
    "a third order": lambda robot, program: lss.plan(lss.load_sequence(WAVE), robot).sample(0, 3),
    "no such joint": lambda robot, program: lss.identify_log(WAVE, robot),
}


@pytest.mark.parametrize("what", WRONG)
def test_errors_are_ours_and_name_no_option_that_has_an_argument(robot, trajectory, what):
    program = lss.compile(trajectory, robot)
    with pytest.raises(lss.LssMotionError) as caught:
        WRONG[what](robot, program)
    said = str(caught.value)
    assert not [option for option in PYTHON_NAMES if f"{option} " in f"{said} "]


def test_options_of_a_command_that_is_shown_stay():
    from lss_motion.errors import InputError, in_python_words

    error = InputError(
        "use --virtual; `lss-play show.yaml --virtual` does it, or --port X; lss-play --force x, y"
    )
    assert str(in_python_words(error)) == (
        "use is_virtual=True; `lss-play show.yaml --virtual` does it, or port X; "
        "lss-play --force x, y"
    )


def test_the_guide_says_of_every_command_what_there_is_for_it_in_python():
    """Whatever its table names is there, and each command of both programs stands in it."""
    text = (SEQUENCES / "guides" / "python.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[^|]*) \| ([^|]*) \|$", text, re.MULTILINE)
    named = {word.split()[0] for row, _ in rows for word in re.findall(r"`([^`]+)`", row)}
    commands = {name for group in COMMAND_GROUPS.values() for name in group}
    assert named == commands | {"play"}
    for _, cell in rows:
        for name in re.findall(r"`lss\.(\w+)", cell):
            assert name in lss.__all__, name
        for name in re.findall(r"`live\.(\w+)", cell):
            assert hasattr(lss.Live, name), name
        for name in re.findall(r"`handle\.(\w+)", cell):
            assert hasattr(lss.Handle, name), name


def test_one_value_in_place_of_another_is_named(robot, trajectory):
    program = lss.compile(trajectory, robot)
    for call, text in (
        (
            lambda: lss.plan(str(WAVE), robot),
            "sequence: a sequence is needed here, not a str; load_sequence(path) reads",
        ),
        (lambda: lss.plan(robot, robot), "sequence: a sequence is needed here, not a Robot"),
        (
            lambda: lss.compile(program, robot),
            "trajectory: a trajectory is needed here, not a Program",
        ),
        (
            lambda: lss.play(trajectory, robot),
            "program: a program is needed here, not a Trajectory; compile(",
        ),
        (
            lambda: lss.start(program, str(ARM)),
            "robot: a robot is needed here, not a str; load_robot(path)",
        ),
        (lambda: lss.connect(None), "robot: a robot is needed here, not a NoneType"),
    ):
        with pytest.raises(lss.InputError) as refused:
            call()
        assert text in str(refused.value)


@pytest.mark.parametrize("wrong", [5, "elbow", ["elbow"]])
def test_what_names_no_joints_is_refused(robot, wrong):
    with lss.connect(robot, port="sim://", is_virtual=True) as live:
        for call in (live.set_target, live.move_to):
            with pytest.raises(lss.InputError, match="names no joints"):
                call(wrong)
        with pytest.raises(lss.InputError, match="is no angle"):
            live.move_to({"elbow": "x"})
