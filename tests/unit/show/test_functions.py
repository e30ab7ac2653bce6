"""The files that are run for a function of a show, found without running them."""

from __future__ import annotations

import pytest

from lss_motion.show.functions import function_files


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
    files = function_files(run, str(tmp_path))
    assert [str(file.relative_to(tmp_path)) for file in files] == found


def test_the_file_of_an_installed_function_is_named(tmp_path):
    assert [file.name for file in function_files("json:loads", str(tmp_path))] == ["__init__.py"]
