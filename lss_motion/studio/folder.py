"""What lies in the folder of a show: shows, robots and sounds, by the names that files use."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterator

SOUNDS: Final = frozenset({".wav", ".flac", ".ogg", ".mp3"})
"""What `sound:` of a show names (`show.file.EventEntry`)."""
DEPTH_MAX: Final = 2
FILES_MAX: Final = 500
"""Folders below, and files, that are listed. Chosen: what a person still looks through."""
HEAD_BYTES: Final = 65_536
_KIND: Final = re.compile(rb'(?m)^(?:\{\s*)?"?(sequence|gait|stage|joints)"?\s*:')
KINDS: Final = {
    b"sequence": "sequences",
    b"gait": "gaits",
    b"stage": "stages",
    b"joints": "robots",
}


def listed(folder: Path) -> dict[str, list[str]]:
    """Return the files of a folder by their kind, each as files of the folder name it."""
    found: dict[str, list[str]] = {kind: [] for kind in ("sounds", *KINDS.values())}
    for count, path in enumerate(_files(folder)):
        if count == FILES_MAX:
            break
        kind = _kind(path)
        if kind is not None:
            found[kind].append(path.relative_to(folder).as_posix())
    return {kind: sorted(names) for kind, names in found.items()}


def joints_of(value: dict[str, Any]) -> dict[str, list[float] | None]:
    """Return the joints of a robot file, each with its range where the file names one itself."""
    joints, defaults = value.get("joints"), value.get("defaults")
    shared = defaults.get("range_deg") if isinstance(defaults, dict) else None
    if not isinstance(joints, dict):
        return {}
    return {
        str(name): own.get("range_deg", shared) if isinstance(own, dict) else shared
        for name, own in joints.items()
    }


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder that may be listed, those of the folder itself first."""
    for top, folders, names in os.walk(folder):
        depth = len(Path(top).relative_to(folder).parts)
        folders[:] = (
            sorted(one for one in folders if not one.startswith((".", "_")))
            if depth < DEPTH_MAX
            else []
        )
        for name in sorted(names):
            suffix = Path(name).suffix.lower()
            if not name.startswith(".") and suffix in {*SOUNDS, ".yaml", ".yml"}:
                yield Path(top, name)


def _kind(path: Path) -> str | None:
    if path.suffix.lower() in SOUNDS:
        return "sounds"
    try:
        with path.open("rb") as file:
            found = _KIND.search(file.read(HEAD_BYTES))
    except OSError:
        return None
    return None if found is None else KINDS[found[1]]
