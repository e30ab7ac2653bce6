"""Foreign motions the whole way: read, mapped, planned, compiled, played on the simulated robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from motion_table import map_for, robot_for

from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.interchange.importing import import_motion, imported, read_motion, read_motions
from lss_motion.interchange.mapping import load_map
from lss_motion.interchange.reader import ForeignMotion, Measure
from lss_motion.planning import shows
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.text import load_program, to_text
from lss_motion.planning.trajectory.planner import plan
from lss_motion.playing.api import export
from lss_motion.playing.run import perform
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "sequences"
MOTIONS = ROOT.parent / "shared" / "motions"

needs_motions = pytest.mark.skipif(
    not MOTIONS.is_dir(), reason="the collection of real motions is not here"
)

COUNTS = {
    "cheering.json": 1,
    "cheering_only_arms.json": 1,
    "throw.json": 1,
    "webots_op2_hand_high.motion": 1,
    "tiago_motions_no-ee.yaml": 10,
    "talos_motions.yaml": 56,
    "op3_motion_4095.bin": 55,
}
"""How many motions each file of the collection holds; counted by hand, or by other programs."""


@pytest.mark.slow
@needs_motions
@pytest.mark.parametrize("file", COUNTS)
def test_every_real_motion_is_planned_with_the_times_of_its_author(file, tmp_path) -> None:
    motions = read_motions(MOTIONS / file)
    assert len(motions) == COUNTS[file]
    for motion in motions:
        assert isinstance(motion, ForeignMotion)
        robot = robot_for(motion, tmp_path)
        if any(channel.unit is Measure.RAD_OR_M for channel in motion.channels):
            with pytest.raises(InputError, match="does not define whether its values are"):
                imported(motion, robot)
        sequence = imported(
            motion, robot, motion_map=load_map(map_for(motion, robot, tmp_path))
        ).sequence
        end_s = max((k.at_s or 0.0) + k.hold_s for k in sequence.keyframes)
        trajectory = plan(sequence, robot)
        assert trajectory.duration_s >= end_s - 1e-6
        if not trajectory.stretched:
            assert trajectory.duration_s == pytest.approx(end_s, abs=1e-6)
            for keyframe in sequence.keyframes:
                (planned_deg,) = trajectory.sample(np.array([keyframe.at_s]))
                for name, deg in keyframe.deg.items():
                    assert planned_deg[trajectory.joints.index(name)] == pytest.approx(
                        deg, abs=1e-5
                    )


@needs_motions
@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("cheering.json", "cheering"),
        ("webots_op2_hand_high.motion", "webots_op2_hand_high"),
        ("tiago_motions_no-ee.yaml", "wave"),
        ("talos_motions.yaml", "nod"),
        ("op3_motion_4095.bin", "see_rightup"),
    ],
)
def test_one_real_motion_of_every_format_plays(file: str, name: str, tmp_path: Path) -> None:
    motion = read_motion(MOTIONS / file, motion_name=name)
    robot = robot_for(motion, tmp_path)
    trajectory = plan(imported(motion, robot).sequence, robot)
    result = perform(
        compile_program(trajectory, robot), robot, is_virtual=True, trajectory=trajectory
    )
    assert result.report.outcome == "finished"
    assert result.report.timing.missed == 0
    assert result.report.played_s == pytest.approx(trajectory.duration_s, abs=0.01)
    for joint in result.report.joints.values():
        assert joint.horn_error_rms_deg < 1.0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "tolerance_deg"),
    [(name, deg) for name in ("wave", "show", "fastest") for deg in (0.0, 0.04)]
    + [("quadruped_trot", 0.0)],
)
def test_a_plan_that_goes_out_as_csv_comes_in_again_within_a_twentieth_degree(
    name, tolerance_deg, tmp_path
) -> None:
    """Also one that sits at its limits all the time: planned again, it is slowed nowhere."""
    sequence, robot = shows.load(EXAMPLES / f"{name}.yaml", None)
    before = plan(sequence, robot)
    path = tmp_path / "out.csv"
    path.write_text(export(before, "csv", rate_hz=100.0), encoding="utf-8")
    after = plan(import_motion(path, robot, tolerance_deg=tolerance_deg), robot)
    times_s = np.arange(int(before.duration_s * 1000.0)) / 1000.0
    error_deg = np.abs(after.sample(times_s) - before.sample(times_s))
    assert after.joints == before.joints
    assert not after.stretched
    assert error_deg.max() <= 0.05


def test_a_compiled_program_read_as_commands_is_nearly_what_it_was_compiled_from(tmp_path) -> None:
    """Nearly: the text does not say how the servos ramp, which the compiler allowed for."""
    robot = load_robot(EXAMPLES / "robots" / "desk_arm.yaml")
    before = plan(load_sequence(EXAMPLES / "wave.yaml"), robot)
    path = tmp_path / "wave.txt"
    path.write_text(to_text(compile_program(before, robot)), encoding="utf-8")
    sequence = imported(read_motion(path), robot).sequence
    errors_deg = [
        abs(deg - float(before.sample(np.array([keyframe.at_s]))[0, before.joints.index(name)]))
        for keyframe in sequence.keyframes
        for name, deg in keyframe.deg.items()
    ]
    assert len(errors_deg) > 100
    assert np.median(errors_deg) < 0.6
    assert max(errors_deg) < 6.0
    assert plan(sequence, robot).duration_s == pytest.approx(before.duration_s, rel=0.04)


SCRIPT = """\
#1D0T500
#2D0T500
delay(1000);
#1D300T1000
delay(1500);
#1D-300T2000
#2D450T1500
wait 2.5 s
#1D0T800 #2D0T800
sleep 1
"""
ARRIVALS = [(1, 300, 2.0), (2, 450, 4.0), (1, -300, 4.5), (1, 0, 5.8), (2, 0, 5.8)]
"""Servo, target in tenths, and instant at which each command of the script ends, in seconds."""


TOO_FAST = """\
#1D300T100
wait 100 ms
#1D0T100
wait 400 ms
"""
"""30 degrees there and back in 0.2 s, of which 600 deg/s² allow 1.5."""


@pytest.fixture
def two(tmp_path):
    """Return the file of a robot with the servos of `SCRIPT`."""
    path = tmp_path / "robot.yaml"
    path.write_text(
        "robot: two\ndefaults: {model: LSS-ST1, range_deg: [-170, 170], speed_max_deg_s: 180, "
        "accel_max_deg_s2: 600}\njoints: {pan: {id: 1}, tilt: {id: 2}}\n",
        encoding="utf-8",
    )
    return path


BACK_TO_BACK = """\
#1D300T900 #2D-100T700
wait 900 ms
#1D-300T900
wait 900 ms
#1D0T1000
sleep 1
"""
"""Each command replaces one that has not come to rest yet."""

OWN = [
    (1.5, 1, 300, 1000), (3.0, 1, -300, 2000), (3.0, 2, 450, 1500), (5.5, 1, 0, 800),
    (5.5, 2, 0, 800), (6.5, 1, 300, 900), (6.5, 2, -100, 700), (7.4, 1, -300, 900),
    (8.3, 1, 0, 1000),
]  # fmt: skip
"""Instant, servo, target and T of the commands of the script that are possible."""


def test_with_keep_time_the_commands_that_are_possible_come_out_again(two, tmp_path, stage) -> None:
    """The text goes through the command line and out again; servos receive its commands."""
    first, *rest = SCRIPT.partition("#1D300T1000\n")
    script, back = tmp_path / "script.txt", tmp_path / "back.lss"
    text = first + TOO_FAST + "".join(rest).replace("sleep 1\n", "sleep 1\n" + BACK_TO_BACK)
    script.write_text(text, encoding="utf-8")
    made = tmp_path / "made.yaml"
    given = ["import", str(script), "--robot", str(two), "-o", str(made), "--keep", "time"]
    assert main(given) == 0
    assert "interpolation: command" in made.read_text(encoding="utf-8")
    assert main(["export", str(made), "-o", str(back)]) == 0
    program, _ = load_program(back, load_robot)
    own = [
        (m.servo_id, m.target_wire, m.duration_ms) for m in program.moves if m.due_us > 1_400_000
    ]
    assert own == [command[1:] for command in OWN]
    due_s = np.array([1e-6 * move.due_us for move in program.moves])[-len(OWN) :]
    early_s = np.array([command[0] for command in OWN]) - due_s
    assert early_s.min() > 0.02
    assert early_s.max() < 0.028  # The lag of the servo, and 2 ms for the line.
    robot = load_robot(two)
    trajectory = plan(load_sequence(made, robot=robot), robot)
    played = stage.play(robot, program=program, has_feedback=False)
    sent = [line for line in played.moves() if line.endswith(b"T1000\r")]
    assert sent == [b"#1D300T1000\r", b"#1D0T1000\r"]
    truth = played.result.truth
    horn_off_deg = truth.horn_deg - trajectory.sample(truth.times_s)
    assert np.abs(horn_off_deg[truth.times_s > 1.5]).max() < 0.6


def test_the_commands_of_a_paced_script_come_out_with_their_targets_and_times(
    two, tmp_path
) -> None:
    """Without keep: time not with their T: the plan ramps at each end, and is followed."""
    path = tmp_path / "script.txt"
    path.write_text(SCRIPT, encoding="utf-8")
    robot = load_robot(two)
    trajectory = plan(import_motion(path, robot), robot)
    assert not trajectory.stretched
    assert trajectory.duration_s == pytest.approx(6.0)
    program = compile_program(trajectory, robot)
    ends = [
        (move.servo_id, move.target_wire, 1e-6 * move.due_us + 1e-3 * (move.duration_ms or 0))
        for move in program.moves
    ]
    for servo_id, target_wire, at_s in ARRIVALS:
        near_s = [abs(s - at_s) for i, wire, s in ends if (i, wire) == (servo_id, target_wire)]
        assert near_s, (servo_id, target_wire)
        assert min(near_s) < 0.1
        planned_deg = trajectory.sample(np.array([at_s]))[0, servo_id - 1]
        assert planned_deg == pytest.approx(target_wire / 10.0, abs=0.01)
    assert max(program.error_max_deg.values()) <= 0.25
