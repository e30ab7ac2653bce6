"""What commands write: never over their input, never over another thing, never half a file."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from pathlib import Path

import platformdirs
import pytest

from lss_motion.cli import play
from lss_motion.cli.main import main
from lss_motion.errors import InputError
from lss_motion.files.output import user_folder, write_output

ROBOT = """\
robot: test
defaults: {model: LSS-ST1, range_deg: [-90, 90], speed_max_deg_s: 180, accel_max_deg_s2: 600}
joints: {base: {id: 1}, elbow: {id: 2}}
"""
SHOW = """\
sequence: nod
robot: robot.yaml
keyframes:
  - {at_s: 0, deg: {base: 0, elbow: 0}}
  - {at_s: 0.4, deg: {base: 10}}
"""
LIST = "sequence: list\nrobot: robot.yaml\nplay: [{file: show.yaml}]\n"
MINE = "my notes\n"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("robot.yaml").write_text(ROBOT)
    Path("show.yaml").write_text(SHOW)
    Path("list.yaml").write_text(LIST)
    return tmp_path


def texts(folder):
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def run(*words):
    return play.main([*words[1:]]) if words[0] == "lss-play" else main([*words])


PLAY = ("lss-play", "show.yaml", "--virtual", "--quiet")
SOURCES = [
    (("export", "show.yaml", "--to", "csv", "-o"), "show.yaml"),
    (("export", "show.yaml", "--to", "ros", "-o"), "robot.yaml"),
    (("export", "list.yaml", "--to", "csv", "-o"), "show.yaml"),
    (("plan", "show.yaml", "--csv"), "show.yaml"),
    (("plan", "list.yaml", "--csv"), "show.yaml"),
    (("plan", "show.yaml", "--csv"), "robot.yaml"),
    (("compile", "show.lss", "--robot", "robot.yaml", "-o"), "show.lss"),
    (("import", "table.csv", "--robot", "robot.yaml", "-o"), "table.csv"),
    (("import", "table.csv", "--robot", "robot.yaml", "-o"), "robot.yaml"),
    (("gait", "walk.yaml", "-o"), "walk.yaml"),
    (("scan", "--robot", "robot.yaml", "--baud", "115200", "-o"), "robot.yaml"),
    (("configure", "robot.yaml", "--backup"), "robot.yaml"),
    (("identify", "--robot", "robot.yaml", "base", "--virtual", "-o"), "robot.yaml"),
    (("record", "--robot", "robot.yaml", "--virtual", "--seconds", "1", "-o"), "robot.yaml"),
    (("monitor", "robot.yaml", "--for", "0.1", "--csv"), "robot.yaml"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("words", "name"), SOURCES)
def test_no_command_overwrites_what_it_reads_not_even_when_forced(words, name, folder, capsys):
    Path("table.csv").write_text("t_s,base\n0,0\n1,20\n2,0\n")
    Path("walk.yaml").write_text("gait: walk\n")
    assert run("compile", "show.yaml", "-o", "show.lss") == 0
    Path("link").symlink_to(name)
    before = texts(folder)
    target = "other.lss" if words[0] == "compile" else "link"
    if target == "other.lss":
        Path(target).hardlink_to(name)
        before = texts(folder)
    for path in (name, target):
        assert run(*words, path, "--force") == 2
        assert f"{path}: is read by this command" in capsys.readouterr().err
    assert texts(folder) == before


@pytest.mark.parametrize("option", ["--report", "--truth", "--log"])
@pytest.mark.parametrize("name", ["show.yaml", "robot.yaml", "notes.txt"])
def test_a_show_replaces_neither_its_files_nor_other_ones(option, name, folder, capsys):
    Path("notes.txt").write_text(MINE)
    before = texts(folder)
    assert run(*PLAY, "--robot", "robot.yaml", option, name) == 2
    assert f"{name}: " in capsys.readouterr().err
    assert texts(folder) == before


OUTPUTS = [
    (("plan", "show.yaml", "--csv"), "out.csv"),
    (("plan", "show.yaml", "--plot"), "out.png"),
    (("compile", "show.yaml", "-o"), "out.lss"),
    (("export", "show.yaml", "-o"), "out.csv"),
    (("export", "show.yaml", "--to", "blender-csv", "-o"), "out.csv"),
    (("export", "show.yaml", "-o"), "out.json"),
    (("export", "show.yaml", "-o"), "out.yaml"),
    (("export", "show.yaml", "-o"), "out.lss"),
    ((*PLAY, "--report"), "out.json"),
    ((*PLAY, "--truth"), "out.csv"),
    ((*PLAY, "--log"), "out.log"),
    (("monitor", "robot.yaml", "--for", "0.1", "--quiet", "--csv"), "out.csv"),
    (("report", "done.json", "--plot"), "out.svg"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("words", "name"), OUTPUTS, ids=lambda value: " ".join(value[:1]))
def test_an_output_replaces_its_own_kind_only(words, name, folder, capsys):
    assert run(*PLAY, "--report", "done.json") == 0
    path = Path(name)
    for _ in range(2):
        assert run(*words, name) == 0
    made = path.read_bytes()
    assert len(made) > 20
    capsys.readouterr()
    path.write_text(MINE)
    assert run(*words, name) == 2
    assert f"{name}: exists already, and is no " in capsys.readouterr().err
    assert path.read_text() == MINE
    path.write_text("")
    assert run(*words, name) == 0
    assert len(path.read_bytes()) > 20
    if words[0] != "lss-play":
        path.write_text(MINE)
        assert run(*words, name, "--force") == 0
        assert path.read_text(errors="replace") != MINE


def test_two_outputs_with_one_name_are_refused(folder, capsys):
    assert run(*PLAY, "--report", "a.json", "--log", "a.json") == 2
    assert "a.json: is named for two outputs" in capsys.readouterr().err
    assert not Path("a.json").exists()


def test_a_link_stays_and_permissions_too(folder):
    (folder / "below").mkdir()
    target = folder / "below" / "table.csv"
    assert run("plan", "show.yaml", "--csv", str(target)) == 0
    target.chmod(0o640)
    old = target.read_bytes()
    Path("link.csv").symlink_to(target)
    assert run("plan", "show.yaml", "--csv", "link.csv", "--rate-hz", "10") == 0
    assert Path("link.csv").is_symlink()
    assert target.read_bytes() != old
    assert stat.S_IMODE(target.stat().st_mode) == 0o640
    assert [path.name for path in target.parent.iterdir()] == ["table.csv"]


def test_a_new_file_has_the_permissions_of_the_user(folder):
    previous = os.umask(0o027)
    try:
        assert run("plan", "show.yaml", "--csv", "new.csv") == 0
    finally:
        os.umask(previous)
    assert stat.S_IMODE(Path("new.csv").stat().st_mode) == 0o640


def test_a_name_as_long_as_the_system_allows_can_be_written(tmp_path):
    path = tmp_path / ("n" * 251 + ".csv")
    write_output(path, "t_s\n")
    assert path.read_text() == "t_s\n"


FULL = """\
import resource, signal, sys
from lss_motion.cli.main import main
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (200, 200))
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of file sizes")
def test_a_file_that_cannot_be_written_whole_leaves_the_old_one(folder):
    assert run("plan", "show.yaml", "--csv", "table.csv") == 0
    before = texts(folder)
    command = [sys.executable, "-c", FULL, "plan", "show.yaml", "--csv", "table.csv"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "table.csv: cannot be written: File too large" in done.stderr
    assert "Traceback" not in done.stderr
    assert texts(folder) == before


@pytest.mark.slow
@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="has no such name")
def test_standard_output_as_a_file_gets_the_table(folder):
    command = [sys.executable, "-m", "lss_motion.cli.main", "plan", "show.yaml"]
    command += ["--csv", "/dev/stdout"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout.startswith("t_s,base,elbow\n")
    with Path("caught.txt").open("w", encoding="utf-8") as caught:
        subprocess.run(command, stdout=caught, check=True)
    assert Path("caught.txt").read_text().startswith("t_s,base,elbow\n")


def test_a_folder_is_no_file(folder, capsys):
    assert run("plan", "show.yaml", "--csv", str(folder)) == 2
    assert "is a folder; name a file in it" in capsys.readouterr().err


@pytest.mark.parametrize("target", ["robot.yaml", "gone", "/dev/null"])
def test_the_simulator_replaces_no_link_of_others(target, folder, capsys):
    Path("lss").symlink_to(target)
    assert run("sim", "robot.yaml", "--link", "lss") == 2
    assert "lss exists already; choose another --link, or remove it first" in (
        capsys.readouterr().err
    )
    assert str(Path("lss").readlink()) == target


def test_the_check_of_a_new_file_comes_before_the_old_one_is_lost(tmp_path):
    path = tmp_path / "kept.yaml"
    path.write_text(MINE)

    def refused(made):
        assert made.read_text() == "bad\n"
        raise InputError("is bad")

    with pytest.raises(InputError, match="is bad"):
        write_output(path, "bad\n", check=refused)
    assert texts(tmp_path) == {"kept.yaml": MINE.encode()}


@pytest.mark.parametrize("chosen", [None, "/somewhere/else", "not/absolute", ""])
def test_the_folders_of_the_user_are_those_of_platformdirs(chosen, monkeypatch):
    for variable in ("XDG_CACHE_HOME", "XDG_STATE_HOME", "OWN_FOLDER"):
        monkeypatch.delenv(variable, raising=False)
        if chosen is not None and variable != "OWN_FOLDER":
            monkeypatch.setenv(variable, chosen)
    for kind, own in (
        ("cache", platformdirs.user_cache_path),
        ("state", platformdirs.user_state_path),
    ):
        found = user_folder("OWN_FOLDER", kind, "below")
        assert found == own("lss_motion", appauthor=False) / "below"
