"""Small files that would cost much: refused before the work, with a line, or done at once.

The far end is judged in a process of its own whose memory is bounded: it must answer, not die.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {base: {id: 1}, elbow: {id: 2}}
"""
FRAMES = """\
keyframes:
  - {at_s: 0, deg: {base: 0, elbow: 0}}
  - {at_s: 0.4, deg: {base: 10}}
  - {at_s: 0.8, deg: {base: 0}}
"""
HEAD = "sequence: s\nrobot: robot.yaml\n"
MEMORY_MAX_BYTES = 3_000_000_000
"""Address space of a command: a fifth of it is used by an ordinary one, 7.5 GB were by these."""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("robot.yaml").write_text(ROBOT)
    Path("nod.yaml").write_text(HEAD + FRAMES)
    Path("turn.yaml").write_text(
        HEAD + "keyframes:\n  - {at_s: 0, deg: {base: 0}}\n  - {at_s: 0.4, deg: {base: 10}}\n"
    )
    Path("looped.yaml").write_text(HEAD + "loop: 1000000\n" + FRAMES)
    Path("list.yaml").write_text(HEAD + "play:\n  - {file: turn.yaml, times: 1000}\n")
    return tmp_path


def run(*words, feed=None):
    def bound():
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_MAX_BYTES, MEMORY_MAX_BYTES))

    done = subprocess.run(
        [sys.executable, "-m", "lss_motion.cli.main", *map(str, words)],
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=bound,
        input=feed,
        timeout=120,
    )
    assert "Traceback" not in done.stderr
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("command", ["check", "plan", "compile"])
def test_a_loop_of_a_million_passes_is_compiled_once(folder, command):
    code, out, errors = run(command, "looped.yaml")
    assert (code, errors) == (EXIT_FINISHED, "")
    assert "800000.000 s, one pass 0.800 s" in out or "repeat_us: 800000 1600000 999997" in out
    assert len(out) < 20_000


@pytest.mark.slow
def test_a_loop_of_the_command_line_is_compiled_once(folder):
    code, out, _ = run("play", "nod.yaml", "--loop", "1000000", "--dry-run")
    assert code == EXIT_FINISHED
    assert "800000.000 s" in out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "line", "said"),
    [
        ("play:\n  - {file: turn.yaml, times: 1000000}\n", 4, "times: comes to 2,000,000"),
        ("play:\n  - {file: nod.yaml, times: 1000000}\n", 4, "times: comes to 3,000,000"),
        ("play:\n  - {file: looped.yaml}\n", 4, "file: comes to 3,000,000 keyframes"),
        (
            "play:\n  - {pause_s: 1}\n  - {file: list.yaml, times: 100}\n",
            5,
            "times: comes to 200,000",
        ),
        ("play:\n" + "  - {file: list.yaml, times: 10}\n" * 3, 6, "times: comes to 60,000"),
        ("layers: [{file: turn.yaml}]\nloop: 1000000\n" + FRAMES, 4, "with layers it comes to 3,0"),
        ("layers:\n  - {file: looped.yaml}\n" + FRAMES, 3, "layers: comes to 3,000,000"),
        (
            "tracks:\n  blink:\n    loop: 1000000\n    " + FRAMES.replace("\n", "\n    ").strip(),
            5,
            "loop: comes to 3,000,000 keyframes",
        ),
    ],
)
def test_what_would_be_written_out_is_bounded_with_its_line(folder, text, line, said):
    Path("show.yaml").write_text(HEAD + text + "\n")
    code, _, errors = run("check", "show.yaml")
    assert code == EXIT_INPUT
    assert f"show.yaml:{line}: " in errors
    assert said in errors
    assert "at most 50,000 can be played as a part" in errors


@pytest.mark.slow
def test_a_day_of_thirty_joints_is_refused_before_it_is_planned(folder):
    joints = ", ".join(f"j{n}: {{id: {n + 1}}}" for n in range(30))
    Path("robot.yaml").write_text(ROBOT.replace("base: {id: 1}, elbow: {id: 2}", joints))
    deg = ", ".join(f"j{n}: {{}}" for n in range(30))
    frames = [
        f"  - {{at_s: {at_s}, deg: {{{deg.replace('{}', str(angle))}}}}}"
        for at_s, angle in ((0, 0), (40000, 5), (86400, 0))
    ]
    Path("day.yaml").write_text(HEAD + "keyframes:\n" + "\n".join(frames) + "\n")
    code, _, errors = run("check", "day.yaml")
    assert code == EXIT_INPUT
    assert "day.yaml:6: the keyframes end at 86,400 s; with 30 joints at most 16,667 s" in errors


@pytest.mark.slow
@pytest.mark.parametrize("words", [["plan", "--csv"], ["export", "-o"]])
def test_a_table_of_a_million_passes_is_refused(folder, words):
    code, _, errors = run(words[0], "looped.yaml", words[1], "t.csv")
    assert code == EXIT_INPUT
    assert "would have 160,000,000 angles, at most 20,000,000 are written" in errors
    assert not Path("t.csv").exists()


COMMANDS = [
    ["check", "X"],
    ["check", "nod.yaml", "--robot", "X"],
    ["compile", "X"],
    ["gait", "X"],
    ["import", "X", "--robot", "robot.yaml", "-o", "o.yaml"],
    ["import", "nod.csv", "--robot", "robot.yaml", "--map", "X", "-o", "o.yaml"],
    ["report", "X"],
    ["replay", "X"],
    ["plan", "nod.yaml", "--truth", "X", "--plot", "p.png"],
    ["play", "nod.yaml", "--virtual", "--faults", "X"],
    ["check", "nod.yaml", "--robot-cache", "X", "--robot", "unread.yaml"],
    ["configure", "robot.yaml", "--restore", "X"],
    ["monitor", "X"],
]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["fifo", "/dev/zero", "/dev/urandom", "folder", "missing"])
@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_what_is_no_file_is_refused_at_once(folder, words, kind, capsys):
    from lss_motion.cli.main import main

    Path("nod.csv").write_text("t_s,base\n0,0\n1,5\n2,0\n")
    Path("unread.yaml").write_text(ROBOT.replace("180", "servo"))
    for suffix in (".yaml", ".lss"):
        name = f"x{suffix}"
        if kind == "fifo":
            os.mkfifo(name)
        elif kind == "folder":
            Path(name).mkdir()
        elif kind.startswith("/"):
            Path(name).symlink_to(kind)
        said = {
            "fifo": "is a device or a pipe; a file is needed",
            "folder": "is a folder; name a file in it",
            "missing": "file not found; check the name",
        }.get(kind, "is a device or a pipe; a file is needed")
        assert main([name if word == "X" else word for word in words]) == EXIT_INPUT
        assert f"{name}: {said}" in capsys.readouterr().err


def test_a_part_that_is_no_file_is_named_with_its_line(folder, capsys):
    from lss_motion.cli.main import main

    os.mkfifo("pipe.yaml")
    Path("show.yaml").write_text(HEAD + "play:\n  - {file: pipe.yaml}\n")
    assert main(["check", "show.yaml"]) == EXIT_INPUT
    assert "pipe.yaml: is a device or a pipe" in capsys.readouterr().err


@pytest.mark.slow
def test_files_of_many_bytes_are_not_read(folder, capsys):
    from lss_motion.cli.main import main

    for name, size in (("big.yaml", 16_000_001), ("big.csv", 64_000_001), ("big.lss", 2**28 + 1)):
        with Path(name).open("wb") as file:
            file.truncate(size)
        words = ["import", name, "--robot", "robot.yaml", "-o", "o.yaml"]
        assert main(words if name.endswith("csv") else ["check", name]) == EXIT_INPUT
        assert f"{name}: is larger than " in capsys.readouterr().err


def test_aliases_that_grow_are_refused_with_their_line(folder):
    lines = ["sequence: s", "robot: robot.yaml", "a: &a [x, x, x, x, x, x, x, x, x, x]"]
    for before, name in zip("abcdefgh", "bcdefghi", strict=True):
        lines.append(f"{name}: &{name} [{', '.join([f'*{before}'] * 10)}]")
    Path("bomb.yaml").write_text("\n".join(lines) + "\n")
    code, _, errors = run("check", "bomb.yaml")
    assert code == EXIT_INPUT
    assert "bomb.yaml:8: more than 1,000,000 keys and values" in errors
