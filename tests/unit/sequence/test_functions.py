from __future__ import annotations

import sys

import pytest

from lss_motion.sequence.load import function_problem


@pytest.fixture
def problem(tmp_path):
    """Return what is said of `run` where `effects/lights.py` holds `text`."""

    def make(text, run="effects.lights:fog"):
        (tmp_path / "effects").mkdir(exist_ok=True)
        (tmp_path / "effects" / "__init__.py").write_text("raise SystemExit('was run')\n")
        (tmp_path / "effects" / "lights.py").write_text("import lss_motion.none\n" + text)
        return function_problem(run, str(tmp_path))

    return make


@pytest.mark.parametrize(
    "text",
    [
        "def fog(at_s): pass",
        "async def fog(at_s): pass",
        "if True:\n    fog = print",
        "from mist import fog",
        "from mist import steam as fog",
        "import fog",
        "class fog: pass",
        "from mist import *",
        "def __getattr__(name): return print",
        "globals()['fog'] = print",
    ],
)
def test_a_function_is_found_without_running_its_module(problem, text):
    before = set(sys.modules)
    assert problem(text) == ""
    assert not {name for name in set(sys.modules) - before if "effects" in name}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("def fogg(at_s): pass", "lights.py has no function 'fog'; did you mean 'fogg'?"),
        ("print(fog)", "lights.py has no function 'fog'; there are none"),
        ("from fog import mist", "has no function 'fog'"),
        ("def fog(at_s) pass", "lights.py:2 is no Python: "),
        ("\0", "lights.py"),
    ],
)
def test_what_is_wrong_with_a_module_is_said(problem, text, words):
    assert words in problem(text)


@pytest.mark.parametrize("run", ["effects.none:fog", "none:fog", "effects.lights.fog:fog"])
def test_a_module_that_is_not_there_is_named(problem, tmp_path, run):
    module = run.partition(":")[0]
    said = problem("", run)
    assert said == f"there is no module {module!r} in {tmp_path}, nor is one installed"


@pytest.mark.parametrize(
    "run", ["time:sleep", "math:sqrt", "json:dumps", "lss_motion.units:s_from_ns"]
)
def test_what_is_installed_may_be_used(problem, run):
    assert problem("", run) == ""
