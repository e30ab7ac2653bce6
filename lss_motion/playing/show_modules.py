"""Imports the modules of a show from the bytes that were read when a person agreed to them.

No folder of a show is searched for modules: a file beside it that is named like a module of Python
would be imported in its place, and a file could be exchanged after a person has agreed. Each folder
has modules of its own, since shows of a play list may name theirs alike.
"""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from importlib.machinery import PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType

    from lss_motion.show.functions import ModuleSource


class _BytesLoader(SourceFileLoader):
    """Loads one module from its bytes; no file is read, nor bytecode beside it."""

    def __init__(self, source: ModuleSource) -> None:
        super().__init__(source.name, source.path)
        self._source = source

    def get_data(self, _path: Any) -> bytes:  # noqa: ANN401  (as its base class)
        return self._source.data

    def path_stats(self, path: Any) -> Any:  # noqa: ANN401
        raise OSError(path)

    def is_package(self, _fullname: str) -> bool:
        return self._source.is_package


class ShowModules(MetaPathFinder):
    """Finds the modules of the folder that was entered last."""

    def __init__(self, sources: Iterable[ModuleSource]) -> None:
        self._sources: dict[str, dict[str, ModuleSource]] = {}
        for source in sources:
            self._sources.setdefault(source.folder, {})[source.name] = source
        self._folder = ""
        self._imported: dict[str, dict[str, ModuleType]] = {}
        """By folder, its modules that are not in `sys.modules` now."""

    def enter(self, folder: str) -> None:
        """Let imports find the modules of `folder`, and those of no other."""
        if folder == self._folder:
            return
        own = [name for name in self._sources.get(self._folder, ()) if name in sys.modules]
        self._imported[self._folder] = {name: sys.modules.pop(name) for name in own}
        self._folder = folder
        sys.modules.update(self._imported.pop(folder, {}))

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        source = self._sources.get(self._folder, {}).get(name)
        if source is not None:
            inside: list[str] | None = [] if source.is_package else None
            return spec_from_file_location(
                name, source.path, loader=_BytesLoader(source), submodule_search_locations=inside
            )
        is_beside = path is None and PathFinder.find_spec(name, [self._folder]) is not None
        if is_beside and PathFinder.find_spec(name) is None:
            raise ModuleNotFoundError(
                f"{name} lies beside the show, but is no Python source that an import statement of "
                f"its functions names; so nobody has agreed to it",
                name=name,
            )
        return None
