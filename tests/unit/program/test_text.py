from __future__ import annotations

import re

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.program.text import cue_line, from_text, load_program, read_cue, to_text
from lss_motion.planning.program.verify import profiles
from lss_motion.planning.trajectory.model import Mark
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.show.model import Cue

TEXT = """\
# lss_motion program 1
# name: wave
# robot: bench
# duration_us: 2000000
# tolerance_deg: 0.2
# start_deg: j0=0 a=b=1.5
# mark: 500000 hello
-20000 main #1D100T500
-20000 main #2D15T40
1500000 main #1D-900T1000
"""


@pytest.fixture
def robot(kit):
    return kit.robot(kit.joint(), kit.joint("a=b", 2))


@pytest.mark.parametrize("loop", [1, None])
def test_a_compiled_program_survives_its_text_form(kit, loop):
    robot = kit.robot(kit.joint(), kit.joint("j1", 2, direction=-1, zero_deg=7.5))
    rows = [(0.0, {"j0": 0.0, "j1": 3.3}), (1.0, {"j0": 50.0}), (3.0, {"j0": 0.0, "j1": 3.3})]
    program = compile_program(kit.plan(kit.keys(*rows, loop=loop), robot), robot)
    text = to_text(program)
    again = from_text(text, robot)
    assert to_text(again) == text
    assert again.moves == program.moves
    assert again.repeat == program.repeat
    assert again.duration_s == program.duration_s
    assert again.start_deg == pytest.approx(program.start_deg)
    assert again.line_use == program.line_use


def test_the_text_form_is_as_its_docstring_shows(robot):
    program = from_text(TEXT, robot)
    assert to_text(program) == TEXT
    assert program.start_deg == {"j0": 0.0, "a=b": 1.5}
    assert [mark.label for mark in program.marks] == ["hello"]
    assert program.moves[-1].data == b"#1D-900T1000\r"


def test_marks_keep_any_label_that_a_sequence_may_have(robot, tmp_path):
    labels = ["", " spaced ", "Grüße 🤖", "a: b # c"]
    marks = tuple(
        Mark(label=label, authored_s=None, planned_s=float(index), is_anchor=False)
        for index, label in enumerate(labels)
    )
    path = tmp_path / "marks.lss"
    program = replace(from_text(TEXT, robot), marks=marks)
    path.write_text(to_text(program), "utf-8")
    again, _ = load_program(path, lambda _: robot, robot_path=tmp_path)
    assert again.marks == marks


def test_comments_and_blank_lines_are_ignored(robot):
    commented = TEXT.replace("-20000 main #2", "\n# slowly now\n   \n-20000 main #2")
    assert from_text(commented, robot).moves == from_text(TEXT, robot).moves


@pytest.mark.parametrize(
    ("line", "wrong", "message"),
    [
        (1, "# something else", "the first line must be"),
        (8, "-20000 main #1D100", "joint 'j0' is timed: its D needs a T"),
        (8, "-20000 main #1D100T500 #2D5T5", "is not of the form"),
        (8, "soon main #1D100T500", "is not of the form"),
        (8, "-20000 other #1D100T500", "no servo 1 on bus 'other'"),
        (8, "-20000 main #9D100T500", "no servo 9 on bus 'main'"),
        (8, "-20000 main #1D950T500", "'j0' would go to 95.0 deg, allowed -90 to 90 deg"),
        (8, "-20000 main #1D100T0", "T0 is not in 1 to"),
        (8, "-20000 main #1D100T99999999", "T99999999 is not in 1 to"),
        (9, "-20001 main #2D15T40", "in order of time"),
        (10, "2000001 main #1D-900T1000", "due after the end"),
        (7, "# mark: soon hello", "'soon' is not a whole number"),
        (2, "", "`# name: …` is missing"),
        (4, "# duration_us: long", "'long' is not a whole number"),
        (4, "# duration_us: forever", "needs `# repeat_us: FROM TO`"),
        (
            7,
            "# repeat_us: 0 1000",
            "needs `FROM TO TIMES`; or `FROM TO` with `duration_us: forever`",
        ),
        (5, "# tolerance_deg: nan", "'nan' is not a number"),
        (6, "# start_deg: j0=0 elbow=1", "no joint 'elbow'"),
        (6, "# start_deg: j0=0 a=b=91", "outside of its range"),
        (6, "# start_deg: j0=0", "lacks the joint with id 2"),
        (6, "# start_deg: j0=x a=b=1", "'x' is not a number"),
    ],
)
def test_every_bad_line_is_named_with_its_place(robot, tmp_path, line, wrong, message):
    lines = TEXT.splitlines()
    lines[line - 1] = wrong
    path = tmp_path / "bad.lss"
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        from_text("\n".join(lines), robot, path=path)
    is_header = 1 < line < 7 or wrong.startswith("# repeat")
    assert str(caught.value).startswith(f"{path}:{1 if is_header else line}: ")


@pytest.mark.parametrize(
    ("edges", "message"),
    [("5 5", "FROM before TO"), ("5", "FROM TO"), ("a 9", "not a whole number")],
)
def test_a_repeat_must_be_a_stretch_of_time(robot, edges, message):
    endless = TEXT.replace("_us: 2000000", f"_us: forever\n# repeat_us: {edges}")
    with pytest.raises(InputError, match=message):
        from_text(endless, robot)


def test_the_robots_file_is_found_beside_the_program(robot, tmp_path):
    robot = replace(robot, path=tmp_path / "robots" / "bench.yaml")
    program = replace(from_text(TEXT, robot), robot_path=robot.path)
    folder = tmp_path / "shows"
    folder.mkdir()
    path = folder / "wave.lss"
    path.write_text(to_text(program, folder=folder))
    assert "# robot_file: ../robots/bench.yaml\n" in path.read_text()
    loaded = []
    again, found = load_program(path, lambda named: loaded.append(named) or robot)
    assert [named.resolve() for named in loaded] == [robot.path]
    assert found is robot
    assert again.moves == program.moves


def test_another_robot_may_be_given_and_is_required_if_none_is_named(robot, tmp_path):
    path, other = tmp_path / "wave.lss", tmp_path / "other.yaml"
    path.write_text(TEXT)
    with pytest.raises(InputError, match="add a line `# robot_file: PATH`, or give --robot"):
        load_program(path, lambda _: robot)
    loaded = []
    load_program(path, lambda named: loaded.append(named) or robot, robot_path=other)
    assert loaded == [other]


@pytest.mark.parametrize("content", [b"", b"\xff\xfe\x00", b"sequence: wave\n"])
def test_a_file_that_is_no_program_is_refused_before_a_robot_is_loaded(tmp_path, content):
    path = tmp_path / "not.lss"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"not a program|is a binary file"):
        load_program(path, lambda _: pytest.fail("a robot was loaded"))


def test_a_missing_file_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="file not found"):
        load_program(tmp_path / "none.lss", lambda _: pytest.fail("a robot was loaded"))


def test_the_reactions_to_faults_survive_the_text_form(robot):
    ladders = {Cause.ASTRAY: (FaultStep.WARN,), Cause.SILENT: (FaultStep.RESUME, FaultStep.LIMP)}
    text = to_text(replace(from_text(TEXT, robot), on_fault=ladders))
    assert "# on_fault: astray=warn silent=resume,limp\n" in text
    assert from_text(text, robot).on_fault == ladders


@pytest.mark.parametrize(
    ("ladder", "message"),
    [("astry=warn", "did you mean 'astray'"), ("astray=", "step '' is not known"),
     ("astray=hold,warn", "nothing comes after hold")],
)  # fmt: skip
def test_a_wrong_ladder_is_named(robot, ladder, message):
    wrong = TEXT.replace("# tolerance", f"# on_fault: {ladder}\n# tolerance")
    with pytest.raises(InputError, match=message):
        from_text(wrong, robot)


@pytest.mark.parametrize(
    "cue",
    [
        Cue(at_s=1.5, led=(("elbow", 1), ("base", 0))),
        Cue(at_s=0.0, say='said "so" – now'),
        Cue(at_s=2.0, run="effects:fog", folder="/home/me/my show"),
        Cue(at_s=3.25, sound="/home/me/bell.wav", lead_s=0.1),
    ],
)
def test_a_cue_is_read_as_it_was_written(cue):
    text = cue_line(cue)
    assert text.isascii()
    assert read_cue(text, ["elbow", "base"]) == cue


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('x {"say": "a"}', "whole number of us"),
        ("1500000", "JSON object"),
        ("1500000 []", "JSON object"),
        ('1 {"led": {"bose": 1}}', "no joint 'bose'"),
        ('1 {"led": {"base": 8}}', "colours from 0 to 7"),
        ('1 {"sound": "a", "lead_s": -1}', "lead_s"),
        ('1 {"shout": "a"}', "a cue has"),
        ('1 {"say": 3}', "a cue has"),
    ],
)
def test_a_wrong_cue_is_refused_with_a_reason(text, words):
    with pytest.raises(ValueError, match=words):
        read_cue(text, ["base"])


def test_a_streamed_joint_may_be_sent_its_resting_place_again_after_the_end(kit):
    robot = kit.robot(kit.joint("j1", 2, drive="streamed"))
    program, _ = kit.compiled(robot)
    last_us = program.moves[-1].due_us
    text = to_text(replace(program, duration_s=(last_us - 100_000) / 1e6))
    assert from_text(text, robot).moves == program.moves
    text = to_text(replace(program, duration_s=(last_us - 600_000) / 1e6))
    with pytest.raises(InputError, match="due after the end"):
        from_text(text, robot)


def test_text_carries_the_drives_and_reads_them_back(kit):
    robot = kit.mixed(filter_count=6)
    program, _ = kit.compiled(robot)
    text = to_text(program)
    assert "# drives: j1=streamed:6 j2=stepped\n" in text
    other = replace(robot, joints={**robot.joints, "j1": kit.joint("j1", 2)})
    again = from_text(text, other)
    assert to_text(again) == text
    assert again.drives == program.drives
    assert again.moves == program.moves
    expected = profiles(program, robot)["j1"].sample(np.arange(0.0, 8.0, 0.1))
    assert profiles(again, other)["j1"].sample(np.arange(0.0, 8.0, 0.1)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("drives", "moves", "message"),
    [
        ("j1=streamed", "", "'j1=streamed' is neither"),
        ("j1=streamed:0", "", "'j1=streamed:0' is neither"),
        ("j1=timed", "", "'j1=timed' is neither"),
        ("j9=stepped", "", "no joint 'j9'"),
        ("j1=streamed:4", "0 main #2D10T500", "'j1' is streamed: its D takes no T"),
        ("j2=stepped", "0 main #209D15", "D15 is not a multiple of 10"),
        ("j1=stepped", "0 main #2D10", "an LSS-ST1 cannot be stepped"),
        ("j1=streamed:4", "0 main #209D10T50", "an LSS-2IO cannot be timed"),
        ("j2=streamed:4", "0 main #209D10", "an LSS-2IO cannot be streamed"),
    ],
)
def test_drives_that_do_not_fit_the_robot_are_refused(kit, drives, moves, message):
    head = "# lss_motion program 1\n# name: x\n# robot: bench\n# duration_us: 9\n"
    text = f"{head}# tolerance_deg: 0.2\n# start_deg: j0=0 j1=0 j2=0\n# drives: {drives}\n{moves}\n"
    with pytest.raises(InputError, match=message):
        from_text(text, kit.mixed())
