"""The modules that are run for a function of a show, found without running them."""

from __future__ import annotations

from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from lss_motion.show.functions import calls_of, function_problem, modules_beside
from lss_motion.show.model import Cue


@pytest.mark.parametrize(
    ("run", "found"),
    [
        ("plain:f", ["plain.py"]),
        ("user:f", ["plain.py", "user.py"]),
        ("pack.inner:f", ["pack/__init__.py", "pack/base.py", "pack/inner.py"]),
        ("pack:f", ["pack/__init__.py", "pack/base.py"]),
        ("deep:f", ["deep.py", "pack/__init__.py", "pack/base.py", "pack/inner.py"]),
        ("ring:f", ["ring.py", "ring2.py"]),
        ("broken:f", ["broken.py"]),
        ("missing:f", []),
        ("time:sleep", []),
    ],
)
def test_the_files_of_a_function(run, found, tmp_path):
    (tmp_path / "pack").mkdir()
    for name, text in {
        "plain.py": "import os, json\n",
        "user.py": "def f(at_s):\n    import plain\n",
        "pack/__init__.py": "from . import base\n",
        "pack/base.py": "raise SystemExit('was run')\n",
        "pack/inner.py": "from .base import thing\nfrom .. import beyond\n",
        "deep.py": "from pack import inner\n",
        "ring.py": "import ring2\n",
        "ring2.py": "import ring\n",
        "broken.py": "def f(\n",
    }.items():
        (tmp_path / name).write_text(text)
    modules = modules_beside(run, str(tmp_path))
    assert [str(Path(one.path).relative_to(tmp_path)) for one in modules] == found
    assert [one.data for one in modules] == [Path(one.path).read_bytes() for one in modules]


def test_the_file_of_an_installed_function_is_named(tmp_path):
    (call,) = calls_of([Cue(at_s=0.0, run="json:loads", folder=str(tmp_path))])
    assert ([file.name for file in call.files], call.modules) == (["__init__.py"], ())


def test_a_module_of_python_is_never_searched_beside_a_show(tmp_path):
    for name in ("bisect.py", "effects.py"):
        (tmp_path / name).write_text("import bisect\ndef f(at_s): 0\n")
    (effects,) = modules_beside("effects:f", str(tmp_path))
    assert effects.name == "effects"
    problem = function_problem("bisect:f", str(tmp_path))
    assert problem == f"'bisect' is a module of Python; give the one in {tmp_path} another name"


def test_a_folder_named_like_an_installed_package_takes_nothing_from_it(tmp_path):
    (tmp_path / "msgspec").mkdir()
    (tmp_path / "msgspec" / "json.py").write_text("")
    (tmp_path / "own").mkdir()
    (tmp_path / "own" / "part.py").write_text("def f(at_s): 0\n")
    (tmp_path / "effects.py").write_text("import msgspec.json\nfrom own import part\n")
    names = [one.name for one in modules_beside("effects:f", str(tmp_path))]
    assert names == ["effects", "own", "own.part"]


def test_what_is_compiled_beside_a_show_is_refused(tmp_path):
    (tmp_path / f"effects{EXTENSION_SUFFIXES[0]}").write_bytes(b"")
    assert modules_beside("effects:f", str(tmp_path)) == ()
    assert "is no Python source; install" in function_problem("effects:f", str(tmp_path))
