"""The Python functions that a show names: found and described without running any of them.

A module is only looked up and parsed. `function_files` lists the files that a person agrees to when
a show may call its functions.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
from collections import Counter
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.record import note_unrepeatable
from lss_motion.files.source import read_data
from lss_motion.files.texts import known_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from importlib.machinery import ModuleSpec

    from lss_motion.show.model import Cue

DYNAMIC: Final = frozenset({"__getattr__", "exec", "globals", "setattr", "vars"})
"""A module that uses one of these, or a star import, can have names that its source lacks."""


class Call(Struct, frozen=True):
    """A function of a show, the files that are run for it, and how often it is called."""

    run: str
    files: tuple[Path, ...]
    count: int

    @property
    def text(self) -> str:
        """Function, files and count, for people."""
        where = ", ".join(map(str, self.files)) or "built into Python"
        times = "once" if self.count == 1 else f"{self.count} times"
        return f"{self.run} {times} ({where})"


def calls_of(cues: Iterable[Cue]) -> list[Call]:
    """Return the functions that are called; a loop that repeats them counts once."""
    counts = Counter((cue.run, cue.folder) for cue in cues if cue.run)
    return [
        Call(run, tuple(function_files(run, folder)), count)
        for (run, folder), count in counts.items()
    ]


def call_lines(cues: Iterable[Cue]) -> list[str]:
    """Return a line for each function that a show calls."""
    return [f"runs Python: {call.text}" for call in calls_of(cues)]


def function_problem(run: str, folder: str) -> str:
    """Return why `module:function` cannot be called; an empty text if no reason was found.

    The module is searched in `folder`, then among those installed. It is not run. The process that
    calls the functions imports it before a show in real time moves, and finds the other errors.
    """
    note_unrepeatable()  # Where Python finds modules is not recorded.
    module_name, _, name = run.partition(":")
    spec = _found(module_name, folder)
    if spec is None:
        return f"there is no module {module_name!r} in {folder}, nor is one installed"
    if spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    try:
        tree = ast.parse(read_data(Path(spec.origin)))
    except InputError as error:
        return str(error)
    except (SyntaxError, ValueError, RecursionError) as error:
        line = f":{error.lineno}" if isinstance(error, SyntaxError) else ""
        return f"{spec.origin}{line} is no Python: {error.args[0]}"
    if name in (names := _names(tree)) or names & DYNAMIC:
        return ""
    functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    return f"{spec.origin} has no function {name!r}; {known_names(name, functions)}"


def function_files(run: str, folder: str) -> list[Path]:
    """Return the files that are run for `module:function`, sorted: of its module and packages.

    Of a module in `folder` also those that it imports from there, as far as its source names them.
    """
    name = run.partition(":")[0]
    pending = [name, *_packages_of(name)]
    files: set[Path] = set()
    seen: set[str] = set()
    while pending:
        module_name = pending.pop()
        if module_name in seen:
            continue
        seen.add(module_name)
        spec = _found(module_name, folder) if name.startswith(module_name) else None
        spec = spec or _found_in(folder, module_name)
        if spec is None or spec.origin is None or not Path(spec.origin).is_file():
            continue
        path = Path(spec.origin)
        files.add(path)
        if path.suffix == ".py" and path.is_relative_to(folder):
            for imported in _imports(path, spec):
                pending += [imported, *_packages_of(imported)]
    return sorted(files)


def _packages_of(module_name: str) -> list[str]:
    """Return the packages that are imported before a module."""
    parts = module_name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]


def _imports(path: Path, spec: ModuleSpec) -> Iterator[str]:
    """Yield every module that the source of a module names; some may be names inside of one."""
    try:
        tree = ast.parse(read_data(path))
    except (SyntaxError, ValueError, RecursionError):  # It cannot be run either.
        return
    package = spec.name if spec.submodule_search_locations is not None else spec.parent or ""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join(
                [*(above if node.level else ()), *([node.module] if node.module else [])]
            )
            yield base
            yield from (f"{base}.{alias.name}" for alias in node.names)


def _found(module_name: str, folder: str) -> ModuleSpec | None:
    """Return the location of a module, in the folder or installed.

    No package is imported for it, as `find_spec` would do.
    """
    importlib.invalidate_caches()
    top = module_name.partition(".")[0]
    if PathFinder.find_spec(top, [folder]) is not None:
        return _found_in(folder, module_name)
    spec = None
    with contextlib.suppress(ValueError):  # Raised for a loaded module without a spec.
        spec = find_spec(top)
    return _below(spec, module_name)


def _found_in(folder: str, module_name: str) -> ModuleSpec | None:
    top = module_name.partition(".")[0]
    return _below(PathFinder.find_spec(top, [folder]), module_name) if top else None


def _below(spec: ModuleSpec | None, module_name: str) -> ModuleSpec | None:
    """Return the location of a module, given that of its first package."""
    path, *inner = module_name.split(".")
    for name in inner:
        if spec is None or spec.submodule_search_locations is None:
            return None
        path = f"{path}.{name}"
        spec = PathFinder.find_spec(path, list(spec.submodule_search_locations))
    return spec


def _names(tree: ast.Module) -> set[str]:
    """Return every name that a module can have, and those of `DYNAMIC` that it uses."""
    names = set()
    for node in ast.walk(tree):
        match node:
            case ast.FunctionDef() | ast.AsyncFunctionDef() | ast.ClassDef():
                names.add(node.name)
            case ast.Name() if isinstance(node.ctx, ast.Store) or node.id in DYNAMIC:
                names.add(node.id)
            case ast.alias():
                names.add("globals" if node.name == "*" else node.asname or node.name)
            case _:
                pass
    return names
