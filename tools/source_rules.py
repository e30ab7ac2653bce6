"""Rules about the source text that ruff, mypy and import-linter do not check.

Each rule is a function that takes the root of the repository and returns one line of text for
each fault: file, line, what is wrong, what is allowed. `tools/check.py` prints them.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

MODULE_LINES_MAX: Final = 700
FUNCTION_LINES_MAX: Final = 70
"""40 is the aim; beyond 70 it is a fault."""
SMALL_MODULE_LINES: Final = 80
SMALL_MODULES_MAX: Final = 25
"""A concept that fills less than a page is usually a part of another module."""
DATA_MODULES: Final = frozenset({"lss.py", "lss_later.py", "lss_pro.py", "io2.py"})
"""Tables with one row a command: they are as long as the documents of the maker."""
ENTRY_MODULES: Final = frozenset({"__init__.py", "__main__.py"})
PACKAGE: Final = "lss_motion"
PROSE_FOLDERS: Final = (PACKAGE, "tools")
PERSON_WORDS: Final = re.compile(
    r"\b(whom|nobody|somebody|anybody|everybody|who\s+(?:is|was|are|were|has|have|had|does|did))\b",
    re.IGNORECASE,
)
FACT_ID: Final = r"[A-Z]\d+"
CITATION: Final = re.compile(
    rf"FACTS\.md[\s#]+({FACT_ID}(?:(?:,[\s#]*|[\s#]+(?:and|to)[\s#]+){FACT_ID})*)"
)
FACT_ROW: Final = re.compile(rf"^\| ({FACT_ID}) \|", re.MULTILINE)


def sizes(root: Path) -> list[str]:
    """Return the modules and functions that are too long, and the small modules if too many."""
    faults, small = [], []
    for path in _sources(root, PACKAGE):
        name, text = path.relative_to(root), _text(path)
        lines = text.count("\n")
        if lines > MODULE_LINES_MAX and path.name not in DATA_MODULES:
            faults.append(f"{name}: {lines} lines, at most {MODULE_LINES_MAX}")
        if lines < SMALL_MODULE_LINES and path.name not in ENTRY_MODULES:
            small.append(f"{name} ({lines})")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
                length = node.end_lineno - node.lineno + 1
                if length > FUNCTION_LINES_MAX:
                    faults.append(
                        f"{name}:{node.lineno}: {node.name} has {length} lines, "
                        f"at most {FUNCTION_LINES_MAX}"
                    )
    if len(small) > SMALL_MODULES_MAX:
        faults.append(
            f"{len(small)} modules have fewer than {SMALL_MODULE_LINES} lines, at most "
            f"{SMALL_MODULES_MAX} may; merge some: {', '.join(small)}"
        )
    return faults


def class_names(root: Path) -> list[str]:
    """Return the classes whose name, without underscores before it, stands at a second place."""
    faults, places = [], dict[str, str]()
    for path in _sources(root, PACKAGE):
        for node in ast.walk(ast.parse(_text(path))):
            if isinstance(node, ast.ClassDef):
                place = f"{path.relative_to(root)}:{node.lineno}"
                first = places.setdefault(node.name.lstrip("_"), place)
                if first != place:
                    faults.append(f"{place}: the class {node.name} exists at {first}, too")
    return faults


def prose(root: Path) -> list[str]:
    """Return the comments and docstrings that speak of machines as persons."""
    faults = []
    for folder in PROSE_FOLDERS:
        for path in _sources(root, folder):
            for line, text in _prose_of(_text(path)):
                faults += [
                    f"{path.relative_to(root)}:{line + text.count(chr(10), 0, found.start())}: "
                    f"{' '.join(found[0].split())!r} in a comment or docstring; name the part "
                    f"(servo, host, player, caller) and what it does"
                    for found in PERSON_WORDS.finditer(text)
                ]
    return faults


def citations(root: Path) -> list[str]:
    """Return the citations `FACTS.md M6` of facts that have no row in `lss_motion/FACTS.md`."""
    rows = set(FACT_ROW.findall(_text(root / PACKAGE / "FACTS.md")))
    faults = []
    for folder in (PACKAGE, "tools", "tests"):
        for path in _sources(root, folder):
            text = _text(path)
            for found in CITATION.finditer(text):
                line = text.count("\n", 0, found.start()) + 1
                faults += [
                    f"{path.relative_to(root)}:{line}: {PACKAGE}/FACTS.md has no row {fact}"
                    for fact in re.findall(FACT_ID, found[1])
                    if fact not in rows
                ]
    return faults


def import_cycles(root: Path) -> list[str]:
    """Return the cycles of modules that import each other when they are loaded.

    Imports in functions and under `if TYPE_CHECKING:` do not count.
    """
    paths = {_module_name(root, path): path for path in _sources(root, PACKAGE)}
    graph = {
        name: {
            target
            for node in _loaded_imports(ast.parse(_text(path)))
            for target in _targets(node, paths.keys())
            if target != name
        }
        for name, path in paths.items()
    }
    faults = []
    while True:
        try:
            TopologicalSorter(graph).prepare()
        except CycleError as error:
            cycle = error.args[1][::-1]  # each imports the next
            faults.append(f"modules import each other at run time: {' -> '.join(cycle)}")
            graph[cycle[0]].discard(cycle[1])  # to find the other cycles
        else:
            return faults


def _sources(root: Path, folder: str) -> list[Path]:
    return sorted((root / folder).rglob("*.py"))


def _text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def _prose_of(source: str) -> Iterator[tuple[int, str]]:
    """Yield the line and text of each comment and docstring, those of attributes included."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    yield from _joined(
        [(one.start[0], one.string.lstrip("# ")) for one in tokens if one.type == tokenize.COMMENT]
    )
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            yield node.lineno, node.value.value


def _joined(comments: list[tuple[int, str]]) -> Iterator[tuple[int, str]]:
    """Yield comments on consecutive lines as one text: a phrase may go on in the next line."""
    first, lines = 0, list[str]()
    for line, text in comments:
        if lines and line != first + len(lines):
            yield first, "\n".join(lines)
            lines = []
        if not lines:
            first = line
        lines.append(text)
    if lines:
        yield first, "\n".join(lines)


def _module_name(root: Path, path: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _loaded_imports(node: ast.AST) -> Iterator[ast.Import | ast.ImportFrom]:
    """Yield the imports that run when the module is loaded."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for other in child.orelse:
                yield from _loaded_imports(ast.Module([other], []))
        elif not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            yield from _loaded_imports(child)


def _targets(node: ast.Import | ast.ImportFrom, modules: Collection[str]) -> Iterator[str]:
    """Yield the modules of the package that an import loads."""
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in modules)
        return
    assert node.level == 0, "relative imports are not used"
    for alias in node.names:
        inner = f"{node.module}.{alias.name}"
        if inner in modules:
            yield inner
        elif node.module in modules:
            yield str(node.module)
