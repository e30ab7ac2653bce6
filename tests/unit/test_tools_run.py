"""`tools/run` installs what a command needs, once, and says what is missing.

With a stand-in for Python that makes "environments" and notes what pip was asked to install.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PYTHON = """\
#!/bin/sh
case "$*" in
"-c import sys"*) ;;
"-m venv "*) mkdir -p "$3/bin"; cp "$0" "$3/bin/python"
    for name in lss-play pytest; do
        printf '#!/bin/sh\\necho "ran %s $*"\\n' $name >"$3/bin/$name"
        chmod +x "$3/bin/$name"
    done ;;
"-m pip --version") ;;
"-m pip install "*) echo "$*" >>"$NOTES"; echo "  Downloading numpy-2.0-any.whl (9 MB)"
    cat "$PIP_OUTPUT" 2>/dev/null && exit 1; exit 0 ;;
*) echo "ran python $*" ;;
esac
"""
UV = """\
#!/bin/sh
echo "uv $*" >>"$NOTES"
case "$1 $2" in
"venv --quiet") for last; do :; done; python3 -m venv "$last" ;;
"pip install") exit "$UV_EXIT" ;;
esac
"""

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell")


class Checkout:
    """A folder with tools/run and pyproject.toml, and a search path with the stand-ins."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "project"
        (self.folder / "tools").mkdir(parents=True)
        for name in ("tools/run", "pyproject.toml"):
            shutil.copy(ROOT / name, self.folder / name)
        self.bin = folder / "bin"
        self.bin.mkdir()
        self.add("python3", PYTHON)
        self.notes = folder / "notes"
        self.pip_output = folder / "pip_output"
        self.uv_exit = 0

    def add(self, name: str, text: str) -> None:
        (self.bin / name).write_text(text, encoding="utf-8")
        (self.bin / name).chmod(0o755)

    def run(self, *words: str) -> subprocess.CompletedProcess[str]:
        environment = {
            "PATH": f"{self.bin}{os.pathsep}/usr/bin{os.pathsep}/bin",
            "NOTES": str(self.notes),
            "PIP_OUTPUT": str(self.pip_output),
            "UV_EXIT": str(self.uv_exit),
        }
        return subprocess.run(
            [str(self.folder / "tools" / "run"), *words],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )

    def installed(self) -> list[str]:
        """Return what was installed since the last call, as `package`, `dev` or a line of uv."""
        if not self.notes.exists():
            return []
        lines = self.notes.read_text(encoding="utf-8").splitlines()
        self.notes.unlink()
        return [
            " ".join([*line.split()[:2], self._what(line.split()[-1])])
            if "pip install" in line
            else " ".join(line.split()[:2])
            for line in lines
        ]

    def _what(self, requirement: str) -> str:
        extras = requirement.removeprefix(str(self.folder))
        return extras.strip("[]") if extras else "package"


@pytest.fixture
def checkout(tmp_path: Path) -> Checkout:
    return Checkout(tmp_path)


def test_playing_installs_no_development_tools_and_only_once(checkout):
    done = checkout.run("lss-play", "wave.yaml")
    assert (done.returncode, done.stdout) == (0, "ran lss-play wave.yaml\n")
    assert checkout.installed() == ["-m pip package"]
    for words in (["lss-play"], ["python", "x"], ["tools/tsc.py"]):
        assert checkout.run(*words).returncode == 0
    assert checkout.installed() == []


def test_tests_and_the_gate_install_the_development_tools_which_are_enough_to_play(checkout):
    checkout.run("lss-play")
    assert checkout.installed() == ["-m pip package"]
    assert checkout.run("pytest", "-q").stdout == "ran pytest -q\n"
    assert checkout.installed() == ["-m pip dev"]
    for words in (["lss-play"], ["tools/check.py"], ["pytest"]):
        assert checkout.run(*words).returncode == 0
    assert checkout.installed() == []


def test_a_change_of_the_project_file_installs_again(checkout):
    checkout.run("pytest")
    checkout.installed()
    with (checkout.folder / "pyproject.toml").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    checkout.run("lss-play")
    assert checkout.installed() == ["-m pip package"]
    checkout.run("tools/check.py")
    assert checkout.installed() == ["-m pip dev"]


def test_an_extra_is_installed_once_and_stays(checkout):
    done = checkout.run("--with", "studio")
    assert (done.returncode, done.stdout) == (0, "")
    assert "installing lss-motion with studio into .venv" in done.stderr
    assert checkout.installed() == ["-m pip studio"]
    checkout.run("lss-play")
    assert checkout.run("--with", "studio", "lss-play", "x").stdout == "ran lss-play x\n"
    assert checkout.installed() == []
    checkout.run("--with", "stage,sound", "lss-play")
    assert checkout.installed() == ["-m pip sound,stage,studio"]
    with (checkout.folder / "pyproject.toml").open("a", encoding="utf-8") as file:
        file.write("# changed\n")
    checkout.run("lss-play")
    assert checkout.installed() == ["-m pip sound,stage,studio"]


def test_the_development_tools_have_what_every_extra_needs(checkout):
    checkout.run("pytest")
    assert checkout.installed() == ["-m pip dev"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    names = {
        extra: {re.split("[>=;]", text)[0] for text in needed} for extra, needed in extras.items()
    }
    # Other programs that only judge: heavy, and skipped by the tests where they are missing.
    judges = names.pop("oracles")
    assert judges == {"pin", "yourdfpy"}
    assert all(needed <= names["dev"] for needed in names.values())


def test_an_extra_that_the_development_tools_may_lack_is_installed_beside_them(checkout):
    checkout.run("pytest")
    assert checkout.installed() == ["-m pip dev"]
    assert checkout.run("--with", "midi", "pytest").returncode == 0
    assert checkout.installed() == ["-m pip dev,midi"]
    assert checkout.run("--with", "midi", "lss-play").returncode == 0
    assert checkout.installed() == []


def test_an_unknown_extra_is_refused_with_those_that_there_are(checkout):
    done = checkout.run("--with", "studoi", "lss-play")
    assert done.returncode == 2
    assert "no extra 'studoi'; there are: mcap lerobot sound" in done.stderr
    assert checkout.installed() == []


def test_a_moved_environment_is_made_anew(checkout):
    checkout.run("lss-play")
    checkout.installed()
    (checkout.folder / ".venv" / "home").write_text("/elsewhere/.venv\n", encoding="utf-8")
    checkout.run("lss-play")
    assert checkout.installed() == ["-m pip package"]


def test_steps_are_shown_while_it_installs(checkout):
    shown = checkout.run("lss-play").stderr
    assert "installing lss-motion into .venv (once)" in shown
    assert "tools/run: Downloading numpy-2.0-any.whl (9 MB)" in shown
    assert checkout.run("lss-play").stderr == ""


def test_uv_installs_where_it_is_there(checkout):
    checkout.add("uv", UV)
    assert checkout.run("lss-play").stdout == "ran lss-play \n"
    assert checkout.installed() == ["uv venv", "uv pip package"]


def test_pip_installs_where_uv_fails(checkout):
    checkout.add("uv", UV)
    checkout.uv_exit = 2
    assert checkout.run("lss-play").stdout == "ran lss-play \n"
    assert checkout.installed() == ["uv venv", "uv pip package", "-m pip package"]


@pytest.mark.parametrize(
    ("output", "named"),
    [
        ("  error: command 'gcc' failed\n  ERROR: Failed building wheel for toppra\n", "compiler"),
        ("ERROR: Failed to build installable wheels for some (toppra)\n", "python3-dev\n"),
        ("  ERROR: Failed building wheel for python-rtmidi\n", "python3-dev libasound2-dev\n"),
        ("  x Failed to build `scipy==1.18`\n", "scipy could not be built"),
        ("ERROR: No matching distribution found for pyarrow>=15\n", "there is no pyarrow for"),
        ("WARNING: NewConnectionError\nERROR: No matching distribution found for x\n", "network"),
        ("ERROR: no space left\n", "the lines above say why"),
    ],
)
def test_a_failure_names_what_to_do_and_is_tried_again(checkout, output, named):
    checkout.pip_output.write_text(output, encoding="utf-8")
    done = checkout.run("lss-play")
    assert done.returncode == 1
    assert "ran lss-play" not in done.stdout
    assert output.strip().splitlines()[-1] in done.stderr
    assert named in done.stderr
    checkout.pip_output.unlink()
    assert checkout.run("lss-play").returncode == 0
