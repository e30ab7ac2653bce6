"""The package as others use it: names, versions, types and what an interpreter prints."""

from __future__ import annotations

import inspect
import pydoc
import rlcompleter
import subprocess
import sys
import typing
from importlib import resources
from pathlib import Path

import pytest

import lss_motion as lss
from lss_motion.errors import install_command
from lss_motion.planning.program.text import from_text

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
LINE_CHARS_MAX = 100


def test_dir_lists_every_public_name_and_each_can_be_used():
    names = dir(lss)
    assert set(lss.__all__) <= set(names)
    assert {"plan", "Trajectory", "__version__"} <= set(names)
    for name in names:
        getattr(lss, name)


def test_tab_completes_names_that_are_imported_on_first_use():
    """In an interpreter of its own: here the names may be imported already."""
    code = (
        "import rlcompleter, lss_motion\n"
        "completer = rlcompleter.Completer({'lss': lss_motion})\n"
        "print([completer.complete('lss.load_', i) for i in range(3)])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "lss.load_robot(" in done.stdout
    assert "lss.load_sequence(" in done.stdout
    assert rlcompleter.Completer({"lss": lss}).complete("lss.no_such_name", 0) is None


@pytest.mark.parametrize("name", lss.__all__)
def test_the_help_of_a_public_name_can_be_shown(name):
    value = getattr(lss, name)
    assert name in pydoc.render_doc(value)
    typing.get_type_hints(value)
    if isinstance(value, type) and issubclass(value, Exception) and "__init__" not in vars(value):
        return  # Python has no signature of an exception without an `__init__` of its own.
    assert inspect.signature(value, eval_str=True) is not None


def test_the_help_of_the_package_can_be_shown():
    text = pydoc.plain(pydoc.render_doc(lss))
    assert all(name in text for name in lss.__all__)


def test_type_checkers_find_the_types():
    assert resources.files("lss_motion").joinpath("py.typed").is_file()


@pytest.mark.parametrize("program", ["lss-motion", "lss-play"])
def test_a_program_prints_its_version(program):
    module = {"lss-motion": "main", "lss-play": "play"}[program]
    command = [sys.executable, "-m", f"lss_motion.cli.{module}", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == f"{program} {lss.__version__}\n"


@pytest.mark.parametrize("name", ["wave", "playlist", "tracks", "hexapod_walk"])
def test_large_values_print_as_one_line_with_name_and_counts(name):
    sequence = lss.load_sequence(EXAMPLES / f"{name}.yaml")
    assert sequence.robot_path is not None
    robot = lss.load_robot(sequence.robot_path)
    trajectory = lss.plan(sequence, robot)
    program = lss.compile(trajectory, robot)
    for value, stated in [
        (robot, (robot.name, f"{len(robot.joints)} joints")),
        (sequence, (sequence.name,)),
        (trajectory, (sequence.name, f"{trajectory.duration_s:.3f} s")),
        (program, (sequence.name, f"{len(program.moves)} moves")),
    ]:
        text = repr(value)
        assert "\n" not in text
        assert len(text) <= LINE_CHARS_MAX, text
        for part in (type(value).__name__, *stated):
            assert part in text, text


def test_a_show_is_loaded_planned_compiled_and_played_with_the_exported_functions():
    sequence = lss.load_sequence(EXAMPLES / "wave.yaml")
    robot = lss.load_robot(sequence.robot_path)
    program = lss.compile(lss.plan(sequence, robot), robot)
    assert from_text(program.to_text(), robot).moves == program.moves
    report = lss.play(program, robot, port="sim://", is_virtual=True)
    assert isinstance(report, lss.Report)
    assert (report.outcome, report.timing.missed) == ("finished", 0)
    assert report.timing.commands >= len(program.moves)
    assert len(repr(report)) <= LINE_CHARS_MAX


def test_what_a_sequence_holds_is_in_its_line():
    assert "keyframes, loop 3" in repr(lss.load_sequence(EXAMPLES / "wave.yaml"))
    assert "5 parts, 2 layers" in repr(lss.load_sequence(EXAMPLES / "playlist.yaml"))


@pytest.mark.parametrize(
    ("files", "folder", "command"),
    [
        ([], ".", "pip install 'lss-motion[sound,stage]'"),
        (["env/home"], ".", "pip install 'lss-motion[sound,stage]'"),
        (["env/pipx_metadata.json"], ".", "pipx install --force 'lss-motion[sound,stage]'"),
        (["env/home", "tools/run"], ".", "tools/run --with sound,stage"),
        (["env/home", "tools/run"], "env", "{root}/tools/run --with sound,stage"),
    ],
)
def test_the_command_that_adds_an_extra_fits_how_the_package_was_installed(
    files, folder, command, tmp_path, monkeypatch
):
    for name in ("env/x", *files):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "env"))
    monkeypatch.chdir(tmp_path / folder)
    assert install_command("sound", "stage") == command.format(root=tmp_path)
