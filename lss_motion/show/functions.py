"""The Python functions that a show names: found and described without running any of them.

A module is only looked up and parsed. `modules_beside` reads what lies beside a show and is run for
a function: a person agrees to these bytes, and no others are imported (`playing.show_modules`). A
module of Python's own library is never searched beside a show.
"""

from __future__ import annotations

import ast
import contextlib
import importlib
import sys
from collections import Counter
from importlib.machinery import PathFinder
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import note_unrepeatable, read_data
from lss_motion.files.texts import known_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from importlib.machinery import ModuleSpec

    from lss_motion.show.model import Cue

SOURCE: Final = ".py"
DYNAMIC: Final = frozenset({"__getattr__", "exec", "globals", "setattr", "vars"})
"""A module that uses one of these, or a star import, can have names that its source lacks."""


class ModuleSource(Struct, frozen=True):
    """A module beside a show, as it was read. That of a package without a file is empty."""

    folder: str
    name: str
    path: str
    data: bytes
    is_package: bool


class Call(Struct, frozen=True):
    """A function of a show, what is run for it, and how often it is called."""

    run: str
    modules: tuple[ModuleSource, ...]
    """What lies beside the show."""
    installed: Path | None
    """The file of a function that is installed."""
    count: int

    @property
    def files(self) -> list[Path]:
        """The files that are run for it."""
        own = [Path(source.path) for source in self.modules if source.data]
        return [*own, *([self.installed] if self.installed else [])]

    @property
    def text(self) -> str:
        """Function, files and count, for people."""
        where = ", ".join(map(str, self.files)) or "built into Python"
        times = "once" if self.count == 1 else f"{self.count} times"
        return f"{self.run} {times} ({where})"


def calls_of(cues: Iterable[Cue]) -> list[Call]:
    """Return the functions that are called; a loop that repeats them counts once."""
    counts = Counter((cue.run, cue.folder) for cue in cues if cue.run)
    calls = []
    for (run, folder), count in counts.items():
        modules = modules_beside(run, folder)
        installed = None if modules else _installed(run.partition(":")[0])
        calls.append(Call(run, modules, installed, count))
    return calls


def modules_of(cues: Iterable[Cue]) -> tuple[ModuleSource, ...]:
    """Return the modules beside shows that are run for their functions, each once, as they are."""
    modules = (one for call in calls_of(cues) for one in call.modules)
    return tuple({(one.folder, one.name): one for one in modules}.values())


def _installed(module_name: str) -> Path | None:
    """Return the file of an installed module."""
    spec = _found(module_name, "")
    origin = None if spec is None or spec.origin is None else Path(spec.origin)
    return origin if origin is not None and origin.is_file() else None


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
    top = module_name.partition(".")[0]
    if top in sys.stdlib_module_names and PathFinder.find_spec(top, [folder]) is not None:
        return f"{top!r} is a module of Python; give the one in {folder} another name"
    if spec.origin is None or not spec.origin.endswith(SOURCE):
        is_compiled = spec.origin is not None and _found_in(folder, module_name) is not None
        return f"{spec.origin} is no Python source; install what is compiled" if is_compiled else ""
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


def modules_beside(run: str, folder: str) -> tuple[ModuleSource, ...]:
    """Return the modules in `folder` that are run for `module:function`, by name.

    They are those that it imports from there, as far as sources name them, and their packages.
    """
    name = run.partition(":")[0]
    pending = [name, *_packages_of(name)]
    found: dict[str, ModuleSource] = {}
    seen: set[str] = set()
    while pending:
        module_name = pending.pop()
        if module_name in seen:
            continue
        seen.add(module_name)
        spec = _found_in(folder, module_name)
        if spec is None:
            continue
        if spec.origin is None:
            inner = list(spec.submodule_search_locations or ())
            found[module_name] = ModuleSource(folder, module_name, inner[0], b"", is_package=True)
        elif spec.origin.endswith(SOURCE):
            data = read_data(Path(spec.origin))
            is_package = spec.submodule_search_locations is not None
            found[module_name] = ModuleSource(folder, module_name, spec.origin, data, is_package)
            for imported in _imports(data, spec):
                pending += [imported, *_packages_of(imported)]
    return tuple(found[name] for name in sorted(found))


def _packages_of(module_name: str) -> list[str]:
    """Return the packages that are imported before a module."""
    parts = module_name.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]


def _imports(data: bytes, spec: ModuleSpec) -> Iterator[str]:
    """Yield every module that the source of a module names; some may be names inside of one."""
    try:
        tree = ast.parse(data)
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
    spec = _found_in(folder, module_name)
    return spec or _below(_installed_spec(module_name.partition(".")[0]), module_name)


def _found_in(folder: str, module_name: str) -> ModuleSpec | None:
    """Return the location of a module in a folder, where its first package is in there.

    A folder without `__init__.py` is a package only where no installed one has its name.
    """
    importlib.invalidate_caches()
    top = module_name.partition(".")[0]
    if not top or not folder or top in sys.stdlib_module_names:
        return None
    spec = PathFinder.find_spec(top, [folder])
    if spec is not None and spec.origin is None and _installed_spec(top) is not None:
        return None
    return _below(spec, module_name)


def _installed_spec(top: str) -> ModuleSpec | None:
    with contextlib.suppress(ValueError):  # Raised for a loaded module without a spec.
        return find_spec(top) if top else None
    return None


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
