"""Frozen results as files: written small, compared file by file.

A file is `CASE/NAME.KIND`. The kind says what a difference means: `data` (bytes, instants, files),
`numbers` (values taken from texts) and `errors` (what a refused command says) must be the same; a
different `text` is for people to read.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

KINDS: Final = ("data", "numbers", "errors", "text")
MANIFEST: Final = "manifest.json"
WHOLE_MAX_BYTES: Final = 4000
"""A longer content is stored as its first lines and a hash of each block of lines."""
HEAD_LINES: Final = 20
HEAD_LINE_MAX_CHARS: Final = 160
BLOCK_LINES: Final = 500
SUMMARY: Final = "# summary: sha256 "


@dataclass(frozen=True, slots=True)
class Item:
    """One thing that a case did: `name` is unique in its case, `kind` is one of `KINDS`."""

    name: str
    kind: str
    content: str


@dataclass(slots=True)
class Comparison:
    """What differs between two folders, one line each. Only `failures` mean other behaviour."""

    failures: list[str] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)
    files_count: int = 0


def write_items(folder: Path, case: str, items: Iterable[Item], *, is_full: bool) -> None:
    """Write what a case did; long contents as summaries unless `is_full`."""
    (folder / case).mkdir(parents=True, exist_ok=True)
    for item in items:
        path = folder / case / f"{item.name}.{item.kind}"
        assert item.kind in KINDS, item.kind
        assert not path.exists(), f"{path} is written twice"
        content = item.content if is_full else summary(item.content)
        path.write_text(content, encoding="utf-8", newline="\n")


def write_manifest(folder: Path, facts: Mapping[str, object]) -> None:
    """Write what was run, so that only folders of the same cases are compared."""
    text = json.dumps(facts, indent=1, sort_keys=True) + "\n"
    (folder / MANIFEST).write_text(text, encoding="utf-8")


def summary(content: str) -> str:
    """Return a short content as it is, a long one as a hash, its first lines and block hashes."""
    size = len(content.encode())
    if size <= WHOLE_MAX_BYTES or content.startswith(SUMMARY):
        return content
    lines = content.splitlines()
    head = [_cut(line) for line in lines[:HEAD_LINES]]
    blocks = [
        f"# from line {start + 1}: {_digest(lines[start : start + BLOCK_LINES])} "
        f"{_cut(lines[start])}"
        for start in range(0, len(lines), BLOCK_LINES)
    ]
    digest = hashlib.sha256(content.encode()).hexdigest()
    first = f"{SUMMARY}{digest}, {len(lines)} lines, {size} bytes"
    return "\n".join([first, *head, *blocks]) + "\n"


def _cut(line: str) -> str:
    return line if len(line) <= HEAD_LINE_MAX_CHARS else line[:HEAD_LINE_MAX_CHARS] + " …"


def _digest(lines: list[str]) -> str:
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def compare_folders(
    a: Path, b: Path, pattern: str = "*", *, has_new_words: bool = False
) -> Comparison:
    """Return how folder `b` differs from `a`, for the cases that match `pattern`.

    With `has_new_words` what a refused command says is for people to read, as other texts. Raises
    `ValueError` for a folder that is not complete, or if the folders cannot be compared: other
    cases were run, or another version of Python or of a numeric library.
    """
    _check_manifests(a, b, is_part=pattern != "*")
    found = Comparison()
    names = {name for folder in (a, b) for name in _names(folder, pattern)}
    for name in sorted(names):
        found.files_count += 1
        difference = _difference(a / name, b / name)
        if difference is not None:
            is_text = name.endswith((".text", ".errors") if has_new_words else ".text")
            (found.texts if is_text else found.failures).append(f"{name}: {difference}")
    if not names:
        raise ValueError(f"no case matches {pattern!r}")
    return found


def _check_manifests(a: Path, b: Path, *, is_part: bool) -> None:
    """Raise `ValueError` unless both were written alike; a part may be written by `--only`."""
    read = []
    for folder in (a, b):
        path = folder / MANIFEST
        if not path.is_file():
            raise ValueError(f"{folder} holds no complete write: {MANIFEST} is not there")
        facts = json.loads(path.read_text(encoding="utf-8"))
        if is_part:
            facts["cases"] = facts["cases"].partition(",")[0]
        read.append(facts)
    for key in sorted(read[0].keys() & read[1].keys()):  # A library may be needed no more.
        first, second = read[0].get(key), read[1].get(key)
        if first != second:
            raise ValueError(f"the folders cannot be compared: {key} is {first} and {second}")


def _names(folder: Path, pattern: str) -> Iterator[str]:
    for path in folder.glob("*/*"):
        if fnmatchcase(path.parent.name, pattern):
            yield f"{path.parent.name}/{path.name}"


def _difference(a: Path, b: Path) -> str | None:
    """Return where two files differ first; None if they do not."""
    for path, other in ((a, b), (b, a)):
        if not path.exists():
            return f"only in {other.parent.parent}"
    first, second = (path.read_text(encoding="utf-8") for path in (a, b))
    if first.startswith(SUMMARY) != second.startswith(SUMMARY):  # One of them was written --full.
        first, second = summary(first), summary(second)
    if first == second:
        return None
    is_summary = first.startswith(SUMMARY) and second.startswith(SUMMARY)
    rows = list(zip(first.splitlines(), second.splitlines(), strict=False))
    for index, (one, other) in enumerate(rows[1:] if is_summary else rows, 1):
        if one != other:
            place = _place(index, one) if is_summary else f"line {index}"
            return f"{place}\n    - {one}\n    + {other}"
    counts = [len(text.splitlines()) for text in (first, second)]
    return f"{counts[0]} and {counts[1]} lines" if not is_summary else f"\n    {rows[0]}"


def _place(index: int, line: str) -> str:
    if index <= HEAD_LINES:
        return f"line {index}"
    start = line.removeprefix("# from line ").partition(":")[0]
    return f"within {BLOCK_LINES} lines from line {start} (write --full --only CASE for all)"
