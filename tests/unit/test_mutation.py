from __future__ import annotations

import re

import pytest
from mutate import EXPLAINED, ROOT, TARGETS, explanations
from mutation.mutants import mutants_of, sampled

SOURCE = '''
"""Text."""
LIMIT: int = 3

def share(a: float, b: float) -> float | None:
    """More text."""
    if not a < b:
        raise ValueError(f"{a} is not below {b}, by {a - b}")
    assert b > 0
    return a / b
'''


def test_each_mutant_changes_one_thing_and_can_be_run():
    found = {mutant.name: mutant.code for mutant in mutants_of(SOURCE, "share.py")}
    assert list(found) == [
        "module: `LIMIT: int = 3` -> `LIMIT: int = 6`",
        "share: `if not a < b:` -> `if a < b:`",
        "share: `if not a < b:` -> `if not a <= b:`",
        "share: `if not a < b:` -> `if not a >= b:`",
        "share: `raise ValueError(f'{a} is not below {b}, by {a - b}')` -> `pass`",
        "share: `return a / b` -> `return None`",
        "share: `return a / b` -> `return a * b`",
    ]
    module: dict[str, object] = {}
    exec(found["share: `return a / b` -> `return a * b`"], module)
    assert module["share"](2.0, 4.0) == 8.0
    with pytest.raises(ValueError, match="below"):
        module["share"](4.0, 2.0)


def test_a_sample_is_from_all_over_the_module_and_the_same_for_the_same_seed():
    mutants = mutants_of(SOURCE, "share.py")
    for seed in range(20):
        first, second, third = sampled(mutants, 3, seed)
        assert first in mutants[:2]
        assert second in mutants[2:4]
        assert third in mutants[4:]
    chosen = [[one.name for one in sampled(mutants, 3, seed)] for seed in range(20)]
    assert chosen == [[one.name for one in sampled(mutants, 3, seed)] for seed in range(20)]
    assert {name for names in chosen for name in names} == {one.name for one in mutants}
    assert sampled(mutants, 9, 0) == mutants


def test_a_reason_is_for_all_mutants_right_above_it():
    assert explanations("# text\n\na\nb\n    why\n    so\nc\n    no\n") == {
        "a": "why so",
        "b": "why so",
        "c": "no",
    }
    with pytest.raises(ValueError, match="no reason below: d"):
        explanations("c\n    no\nd\n")


def test_every_explained_mutant_names_a_function_of_a_module_that_is_mutated():
    keys = explanations(EXPLAINED.read_text(encoding="utf-8"))
    assert keys
    for key in keys:
        module, _, rest = key.partition(" ")
        assert module in TARGETS, key
        name = rest.partition(": ")[0].rpartition(".")[2]
        source = (ROOT / "lss_motion" / f"{module}.py").read_text(encoding="utf-8")
        assert name == "module" or re.search(rf"^ *(def|class) {name}\b", source, re.MULTILINE), key


def test_every_mutated_module_and_its_tests_exist():
    for module, tests in TARGETS.items():
        assert (ROOT / "lss_motion" / f"{module}.py").is_file()
        assert all((ROOT / test).exists() for test in tests)
