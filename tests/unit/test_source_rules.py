"""The rules of the gate about source text: each finds the fault that it is for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from source_rules import (
    MODULE_LINES_MAX,
    SMALL_MODULE_LINES,
    SMALL_MODULES_MAX,
    citations,
    class_names,
    import_cycles,
    prose,
    sizes,
)

if TYPE_CHECKING:
    from pathlib import Path

LONG_ENOUGH = "x = 1\n" * SMALL_MODULE_LINES


@pytest.fixture
def write(tmp_path):
    """Write files of a repository; return its root."""

    def write(**files: str) -> Path:
        for name, text in files.items():
            path = tmp_path / name.replace("__", "/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path = path if path.suffix else path.with_suffix(".py")
            path.write_text(text)
        return tmp_path

    return write


def test_a_module_that_is_too_long_is_named(write):
    root = write(
        lss_motion__good="x = 1\n" * MODULE_LINES_MAX,
        lss_motion__long="x = 1\n" * (MODULE_LINES_MAX + 1),
    )
    assert sizes(root) == ["lss_motion/long.py: 701 lines, at most 700"]


def test_a_function_that_is_too_long_is_named(write):
    body = "    x = 1\n" * 70
    root = write(lss_motion__a=f"{LONG_ENOUGH}def f():\n{body}")
    assert sizes(root) == ["lss_motion/a.py:81: f has 71 lines, at most 70"]


def test_two_classes_of_one_name_are_named(write):
    root = write(
        lss_motion__a="class Frame: pass\nclass Other: pass\n",
        lss_motion__b="x = 1\nclass _Frame: pass\n",
    )
    assert class_names(root) == [
        "lss_motion/b.py:2: the class _Frame exists at lss_motion/a.py:1, too"
    ]


def test_too_many_small_modules_are_refused(write):
    few = {f"lss_motion__m{index}": "x = 1\n" for index in range(SMALL_MODULES_MAX)}
    root = write(**few, lss_motion__large=LONG_ENOUGH)
    (root / "lss_motion" / "__init__.py").write_text("")
    assert sizes(root) == []
    (fault,) = sizes(write(lss_motion__more="x = 1\n"))
    assert fault.startswith("26 modules have fewer than 80 lines, at most 25 may")
    assert "lss_motion/more.py (1)" in fault
    assert "large" not in fault


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ('"""Ask whom\n it concerns."""\n', 1, "whom"),
        ("x = 1\n# A. Nobody answers.\n", 2, "Nobody"),
        ('x = 1\n"""Of an attribute: somebody."""\n', 2, "somebody"),
        ("def f():\n    '''Text.\n\n    The servo who was asked.\n    '''\n", 4, "who was"),
        ("# a servo that knows who\n# did answer\n", 1, "who did"),
    ],
)
def test_words_for_persons_are_found_in_comments_and_docstrings(write, text, line, words):
    (fault,) = prose(write(tools__a=text))
    assert fault.startswith(f"tools/a.py:{line}: {words!r} in a comment or docstring")


def test_words_for_persons_may_stand_in_names_and_values(write):
    root = write(lss_motion__a="whom = 'nobody'  # an example\nprint('who is there # nobody')\n")
    assert prose(root) == []


def test_comments_that_are_apart_are_not_one_phrase(write):
    assert prose(write(tools__a="# see who\nx = 1\n# is here\n")) == []


@pytest.mark.parametrize(
    ("text", "unknown"),
    [
        ("# FACTS.md M6\n", []),
        ("# FACTS.md M6, W1\n", []),
        ("# FACTS.md M7\n", ["M7"]),
        ("x = 1  # (FACTS.md M6, M8 and W9)\n", ["M8", "W9"]),
        ('"""Text (FACTS.md\n    W16 to W19)."""\n', ["W16", "W19"]),
        ("# as FACTS.md\n# M9 has it\n", ["M9"]),
    ],
)
def test_a_citation_needs_its_row(write, text, unknown):
    root = write(tests__a=text)
    (root / "lss_motion").mkdir()
    (root / "lss_motion" / "FACTS.md").write_text("| M6 | a |\n| W1 | b, see M7 |\n")
    ids = [fault.split("no row ")[1] for fault in citations(root)]
    assert ids == unknown


def test_modules_that_import_each_other_when_loaded_are_a_cycle(write):
    root = write(
        lss_motion__a="from lss_motion import b\n",
        lss_motion__b="import lss_motion.p.c\n",
        lss_motion__p__c="try:\n    from lss_motion.a import f\nexcept ImportError:\n    pass\n",
        lss_motion__d="from lss_motion.e import g\n",
        lss_motion__e="class C:\n    from lss_motion.d import h\n",
    )
    cycles = {frozenset(fault.split(": ")[1].split(" -> ")) for fault in import_cycles(root)}
    assert cycles == {
        frozenset({"lss_motion.a", "lss_motion.b", "lss_motion.p.c"}),
        frozenset({"lss_motion.d", "lss_motion.e"}),
    }


def test_imports_that_wait_until_a_call_or_are_for_types_make_no_cycle(write):
    root = write(
        lss_motion__a="from lss_motion.b import f\n",
        lss_motion__b="def f():\n    from lss_motion import a\n",
        lss_motion__c="from lss_motion.a import f\n",
        lss_motion__d=(
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from lss_motion import e\n"
        ),
        lss_motion__e="from lss_motion.d import g\n",
    )
    assert import_cycles(root) == []
