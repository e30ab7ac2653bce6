"""Whether the function of an event is there, as far as that is seen without running its module."""

from __future__ import annotations

import ast
import contextlib
import importlib
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.spelling import known_names

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

DYNAMIC: Final = frozenset({"__getattr__", "exec", "globals", "setattr", "vars"})
"""A module with one of these, or with a star import, may have names that its text does not show."""


def function_problem(run: str, folder: str) -> str:
    """Return why `module:function` cannot be called, or nothing.

    The module is looked for in `folder`, then among those installed. What only running it would
    show is not found: the process that runs functions does that, before a show in real time moves.
    """
    module_name, _, name = run.partition(":")
    spec = _find(module_name, folder)
    if spec is None:
        return f"there is no module {module_name!r} in {folder}, nor is one installed"
    if spec.origin is None or not spec.origin.endswith(".py"):
        return ""
    try:
        tree = ast.parse(Path(spec.origin).read_bytes())
    except (SyntaxError, ValueError) as error:
        line = f":{error.lineno}" if isinstance(error, SyntaxError) else ""
        return f"{spec.origin}{line} is no Python: {error.args[0]}"
    except OSError as error:
        return f"{spec.origin} cannot be read: {error.strerror}"
    if name in (names := _names(tree)) or names & DYNAMIC:
        return ""
    functions = [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]
    return f"{spec.origin} has no function {name!r}; {known_names(name, functions)}"


def _find(module_name: str, folder: str) -> ModuleSpec | None:
    """Return where a module is. No package is imported on the way, as `find_spec` would do."""
    importlib.invalidate_caches()
    path, *inner = module_name.split(".")
    spec = PathFinder.find_spec(path, [folder])
    if spec is None:
        with contextlib.suppress(ValueError):  # Of a module that was made without one.
            spec = find_spec(path)
    for name in inner:
        if spec is None or spec.submodule_search_locations is None:
            return None
        path = f"{path}.{name}"
        spec = PathFinder.find_spec(path, list(spec.submodule_search_locations))
    return spec


def _names(tree: ast.Module) -> set[str]:
    """Return every name that a module may have, and those of `DYNAMIC` that it uses."""
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
