"""No function of a show is imported before a person has agreed to it, by any command."""

from __future__ import annotations

import json
import os
import py_compile
import subprocess
import sys
from pathlib import Path

import pytest

from lss_motion.cli import dialog, play, serving
from lss_motion.cli.main import main
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_INTERRUPTED, InputError
from lss_motion.files import cache
from lss_motion.playing import api

pytestmark = pytest.mark.realtime

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {base: {id: 1}}
"""
SHOW = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {base: 0}}
  - {at_s: 0.2, deg: {base: 3}}
events: [{at_s: 0.1, run: "effects:fog"}]
"""
EFFECTS = """\
from pathlib import Path
import helper
Path(__file__).with_name("imported").touch()
def fog(at_s):
    Path(__file__).with_name("called").touch()
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LSS_MOTION_STATE_DIR", str(tmp_path / "state"))
    for name, text in {
        "robot.yaml": ROBOT,
        "show.yaml": SHOW,
        "effects.py": EFFECTS,
        "helper.py": "number = 1\n",
        "list.yaml": "sequence: list\nrobot: robot.yaml\nplay: [{file: show.yaml}]\n",
        "layered.yaml": SHOW.replace("events:", "layers: [{file: show.yaml}]\n#"),
    }.items():
        Path(name).write_text(text)
    return tmp_path


def ran(folder):
    """Return what the module did, and forget it."""
    made = {name for name in ("imported", "called") if (folder / name).exists()}
    for name in made:
        (folder / name).unlink()
    return made


def played(*words):
    return play.main(["show.yaml", "--quiet", *words])


@pytest.mark.parametrize(
    "words",
    [
        ["check", "show.yaml"],
        ["check", "show.yaml", "--json"],
        ["plan", "list.yaml"],
        ["compile", "layered.yaml"],
        ["export", "show.yaml", "-o", "show.csv"],
        ["play", "show.yaml", "--dry-run"],
        ["play", "show.yaml", "--virtual", "--quiet"],
    ],
    ids=" ".join,
)
def test_no_command_but_play_imports_a_module(words, folder):
    assert main(words) == EXIT_FINISHED
    assert ran(folder) == set()


@pytest.mark.parametrize("name", ["show.yaml", "list.yaml", "layered.yaml", "show.lss"])
def test_check_lists_the_functions_of_a_file(name, folder, capsys):
    assert main(["compile", "show.yaml", "-o", "show.lss"]) == EXIT_FINISHED
    assert main(["check", name]) == EXIT_FINISHED
    files = f"({folder}/effects.py, {folder}/helper.py)"
    assert f"runs Python: effects:fog once {files}\n" in capsys.readouterr().out
    assert main(["check", name, "--json"]) == EXIT_FINISHED
    (call,) = json.loads(capsys.readouterr().out)["functions"]
    assert (call["run"], call["count"]) == ("effects:fog", 1)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["show.yaml", "list.yaml", "layered.yaml", "show.lss"])
def test_without_a_terminal_a_show_with_functions_is_refused(name, folder, capsys):
    assert main(["compile", "show.yaml", "-o", "show.lss"]) == EXIT_FINISHED
    assert play.main([name, "--quiet", "--yes"]) == EXIT_INPUT
    errors = capsys.readouterr().err
    assert f"{name}: calls 1 Python function on this computer (effects:fog)" in errors
    assert "nothing was played. Read them, then run it in a terminal, or add --allow-run" in errors
    assert ran(folder) == set()
    assert play.main([name, "--quiet", "--allow-run"]) == EXIT_FINISHED
    assert ran(folder) == {"imported", "called"}
    assert play.main([name, "--quiet"]) == EXIT_INPUT


def test_a_person_is_asked_once_for_each_file_and_content(folder, at_keyboard, monkeypatch, capsys):
    at_keyboard("n\n")
    assert played() == EXIT_INTERRUPTED
    errors = capsys.readouterr().err
    assert f"  effects:fog once ({folder}/effects.py, {folder}/helper.py)\n" in errors
    assert "[y/N] no: nothing was played" in errors
    assert ran(folder) == set()
    at_keyboard("y\n")
    assert played() == EXIT_FINISHED
    assert ran(folder) == {"imported", "called"}
    monkeypatch.undo()
    monkeypatch.chdir(folder)
    monkeypatch.setenv("LSS_MOTION_STATE_DIR", str(folder / "state"))
    capsys.readouterr()
    assert played() == EXIT_FINISHED
    assert ran(folder) == {"imported", "called"}
    assert "allow it" not in capsys.readouterr().err
    for name in ("show.yaml", "effects.py", "helper.py"):
        text = Path(name).read_text()
        Path(name).write_text(text + "\n# changed\n")
        assert played() == EXIT_INPUT
        assert ran(folder) == set()
        Path(name).write_text(text)
    Path("copy.yaml").write_text(SHOW)
    assert play.main(["copy.yaml", "--quiet"]) == EXIT_INPUT
    assert played() == EXIT_FINISHED


def test_an_answer_that_somebody_else_has_written_allows_nothing(folder, at_keyboard):
    at_keyboard("y\n")
    assert played() == EXIT_FINISHED
    key, kept = folder / "state" / cache.KEY_NAME, folder / "state" / dialog.FILE_NAME
    theirs = kept.read_text()
    key.unlink()
    cache.mark_of([], may_make_key=True)  # What follows is what they wrote with a key of theirs.
    at_keyboard("n\n")
    assert played() == EXIT_INTERRUPTED
    assert kept.read_text() == theirs
    ran(folder)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="files have no mode here")
@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_a_secret_that_others_may_open_is_none(folder, mode):
    stage = folder / "stage.yaml"
    token = serving._token(stage, is_new=False)
    assert serving._token(stage, is_new=False) == token
    (path,) = (folder / "state" / "tokens").iterdir()
    path.chmod(mode)
    other = serving._token(stage, is_new=False)
    assert other != token
    assert serving._token(stage, is_new=False) == other
    assert path.stat().st_mode & 0o077 == 0


@pytest.mark.slow
@pytest.mark.parametrize("damage", [b"", b"[]", b"\xff\xfe", b"{" * 100_000])
def test_a_damaged_memory_asks_again(damage, folder, at_keyboard):
    at_keyboard("y\n")
    assert played() == EXIT_FINISHED
    kept = folder / "state" / dialog.FILE_NAME
    kept.write_bytes(damage)
    at_keyboard("n\n")
    assert played() == EXIT_INTERRUPTED


@pytest.mark.slow
def test_stored_bytecode_is_not_run_in_place_of_the_source(folder):
    """A module beside the show can come with bytecode that says something else than its source."""
    Path("evil.py").write_text("from pathlib import Path\nPath('evil').touch()\ndef fog(at_s): 0\n")
    cached = Path("__pycache__", f"effects.{sys.implementation.cache_tag}.pyc")
    py_compile.compile(
        "evil.py",
        str(cached),
        invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH,
    )
    assert played("--allow-run") == EXIT_FINISHED
    assert not Path("evil").exists()
    assert ran(folder) == {"imported", "called"}


@pytest.mark.slow
def test_modules_of_the_current_folder_replace_no_installed_ones(folder):
    """The processes of a show import the standard library, whatever lies beside the show."""
    for name in ("json", "signal", "contextlib", "bisect", "email"):
        Path(f"{name}.py").write_text("from pathlib import Path\nPath('stolen').touch()\n")
    Path("effects.py").write_text("import urllib.request\n" + EFFECTS)
    code = "import sys; sys.path.pop(0); from lss_motion.cli.play import main; main(sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", code, "show.yaml", "--log", "a.log", "--allow-run"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(Path(api.__file__).parents[1])},
    )
    assert done.returncode == 0, done.stderr
    assert ran(folder) == {"imported", "called"}
    assert not Path("stolen").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["effects.py", "helper.py"])
def test_what_is_exchanged_after_a_person_has_agreed_is_not_run(name, folder, at_keyboard):
    """A symbolic link that leads elsewhere by the time of the import, as a file that is written."""
    text = Path(name).read_text()
    Path("good").write_text(text)
    Path("evil").write_text("from pathlib import Path\nPath('evil_ran').touch()\n" + text)
    Path(name).unlink()
    Path(name).symlink_to("good")
    at_keyboard("y\n")
    asked = dialog.agrees

    def agree_then_exchange(*words):
        answer = asked(*words)
        Path(name).unlink()
        Path(name).symlink_to("evil")
        return answer

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dialog, "agrees", agree_then_exchange)
        assert played() == EXIT_FINISHED
    assert ran(folder) == {"imported", "called"}
    assert not Path("evil_ran").exists()
    at_keyboard("n\n")
    assert played() == EXIT_INTERRUPTED  # It is another file now.


@pytest.mark.slow
def test_a_module_that_no_statement_names_is_not_imported(folder, capfd):
    Path("hidden.py").write_text("from pathlib import Path\nPath('hidden_ran').touch()\n")
    load = "    import importlib; importlib.import_module('hid' + 'den')\n"
    Path("effects.py").write_text("def fog(at_s):\n" + load)
    assert play.main(["show.yaml", "--allow-run"]) == EXIT_FINISHED
    assert not Path("hidden_ran").exists()
    assert "hidden lies beside the show" in capfd.readouterr().out


@pytest.mark.slow
def test_shows_of_two_folders_have_modules_of_their_own(folder):
    """Both name theirs alike."""
    Path("other").mkdir()
    for name in ("robot.yaml", "show.yaml", "effects.py", "helper.py"):
        Path("other", name).write_text(Path(name).read_text())
    Path("list.yaml").write_text(
        "sequence: list\nrobot: robot.yaml\nplay: [{file: show.yaml}, {file: other/show.yaml}]\n"
    )
    assert play.main(["list.yaml", "--quiet", "--allow-run"]) == EXIT_FINISHED
    assert ran(folder) == {"imported", "called"}
    assert ran(folder / "other") == {"imported", "called"}


@pytest.mark.slow
def test_a_library_call_needs_consent_too(folder):
    robot = api.load_robot("robot.yaml")
    program = api.compile(api.plan(api.load_sequence("show.yaml"), robot), robot)
    with pytest.raises(InputError, match=r"would call Python functions \(effects:fog\)"):
        api.play(program, robot)
    assert ran(folder) == set()
    api.play(program, robot, is_virtual=True)
    assert ran(folder) == set()
    api.play(program, robot, allow_run=True)
    assert ran(folder) == {"imported", "called"}
