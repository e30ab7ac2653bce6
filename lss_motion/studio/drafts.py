"""The texts of edited files, between the disk and the page: saved, recovered, never overwritten.

A draft knows what the disk had when it was read or saved. `save` is compare-and-swap: where the
disk has something else now, nothing is written, and the difference is shown. What is not saved lies
beside the file as a dot-file, and is found again after a crash.
"""

from __future__ import annotations

import difflib
import hashlib
import re
from contextlib import suppress
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.files.output import write_output
from lss_motion.files.source import bounded_data, text_of
from lss_motion.playing.remote import edit_messages as m
from lss_motion.studio.allowed import require_allowed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path

Stamp = tuple[int, int, int] | None
MARK: Final = "\ufeff"
DIFFERENCE_MAX: Final = 200
"""Lines of a difference that are shown."""
_HEAD: Final = re.compile(
    rb"# lss_motion: unsaved edits of [^\n]*; sha256 of the file: ([0-9a-f]*)\n"
)


def stamp_of(path: Path) -> Stamp:
    """Return what changes when a file does; None where there is none."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return found.st_mtime_ns, found.st_size, found.st_ino


def recovery_path(path: Path) -> Path:
    """Return where the unsaved edits of a file lie."""
    return path.with_name(f".{path.name}.unsaved")


class Draft:
    """One file that was edited."""

    def __init__(self, path: Path, data: bytes, stamp: Stamp) -> None:
        self.path, self.stamp = path, stamp
        self.kept: str | None = None
        """The text in the recovery file."""
        self.take(data)

    def take(self, data: bytes) -> None:
        """Take what the disk has; raises `InputError` if that is no text."""
        self.text = text_of(data, self.path)
        self.mark = MARK if data.decode("utf-8").startswith(MARK) else ""
        self.base = _digest(data)
        """Of what the disk had when it was read or saved."""
        self.disk: bytes | None = None
        """What the disk has, where that is neither the base nor our text."""

    @property
    def data(self) -> bytes:
        """The bytes of the text."""
        return (self.mark + self.text).encode("utf-8")

    @property
    def is_saved(self) -> bool:
        """Whether the disk has the same."""
        return _digest(self.data) == self.base

    def difference(self, name: str) -> tuple[str, ...]:
        """Return the lines that differ, from disk to ours."""
        lines = difflib.unified_diff(
            text_of(self.disk or b"", self.path).splitlines(),
            self.text.splitlines(),
            f"{name} on disk",
            f"{name} as edited here",
            n=1,
            lineterm="",
        )
        found = list(lines)
        more = (
            [f"… {len(found) - DIFFERENCE_MAX} more lines"] if len(found) > DIFFERENCE_MAX else []
        )
        return (*found[:DIFFERENCE_MAX], *more)


class Drafts:
    """All edited files below a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.recovered: list[Path] = []
        """Files whose edits were found after a server had ended without saving them."""
        self._drafts: dict[Path, Draft] = {}
        self._searched: set[Path] = set()

    def text(self, path: Path) -> str:
        """Return the text of a file as it is edited, or else as it is on disk."""
        draft = self._drafts.get(path)
        return text_of(bounded_data(path), path) if draft is None else draft.text

    def put(self, path: Path, text: str) -> None:
        """Give a file another text."""
        self._opened(path).text = text

    def open(self, path: Path) -> str:
        """Return the text of a file that is going to be edited."""
        return self._opened(path).text

    def __contains__(self, path: Path) -> bool:
        return path in self._drafts

    def unsaved(self) -> list[Draft]:
        """Return the files whose text is not that of the disk."""
        return [draft for draft in self._drafts.values() if not draft.is_saved]

    def state(self) -> m.Editing:
        """Return what is not saved, and what the disk has instead."""
        return m.Editing(
            unsaved=tuple(self.name(draft.path) for draft in self.unsaved()),
            conflicts=tuple(
                m.Conflict(file=name, difference=draft.difference(name))
                for draft in self._drafts.values()
                if draft.disk is not None
                for name in [self.name(draft.path)]
            ),
            recovered=tuple(map(self.name, self.recovered)),
        )

    def name(self, path: Path) -> str:
        """Return a file as clients know it."""
        return str(path.relative_to(self.folder))

    def save(self) -> list[Path]:
        """Write all that is not saved; raises `InputError` where the disk has changed."""
        waiting = self.unsaved()
        changed = [draft for draft in waiting if draft.disk is not None]
        if changed:
            name = self.name(changed[0].path)
            raise InputError(
                f"{name} has changed on disk; look at the difference and choose which to keep",
            )
        for draft in waiting:
            self._write(draft)
        return [draft.path for draft in waiting]

    def _write(self, draft: Draft) -> None:
        stamps: list[Stamp] = []

        def check(fresh: Path) -> None:
            if _digest(bounded_data(draft.path)) != draft.base:
                raise InputError("has just changed on disk; look at it again", path=draft.path)
            stamps.append(stamp_of(fresh))

        write_output(draft.path, draft.data, check=check)
        draft.base, draft.disk, draft.stamp = _digest(draft.data), None, stamps[0]
        self._forget(draft)

    def keep_ours(self, path: Path) -> None:
        """Let what the disk has, as it was shown, be what the next save replaces."""
        draft = self._conflict(path)
        disk = draft.disk or b""
        require_allowed(self.folder, path, text_of(disk, path), draft.text)
        draft.base, draft.disk = _digest(disk), None

    def keep_disk(self, path: Path) -> tuple[str, str]:
        """Take what the disk has; return the text before and after."""
        draft = self._conflict(path)
        before = draft.text
        draft.take(draft.disk or b"")
        return before, draft.text

    def look(self) -> dict[Path, tuple[str, str]]:
        """Look at the disk; return files that were taken from there: the text before and after.

        A change of a file with unsaved edits is a conflict instead.
        """
        taken = {}
        for draft in self._drafts.values():
            stamp = stamp_of(draft.path)
            if stamp == draft.stamp:
                continue
            draft.stamp = stamp
            try:
                data = bounded_data(draft.path)
                text_of(data, draft.path)
            except InputError:
                continue  # It is gone or no text: what is edited here stays.
            digest = _digest(data)
            if digest in (draft.base, _digest(draft.data)):
                draft.base, draft.disk = digest, None
            elif draft.is_saved:
                before = draft.text
                draft.take(data)
                taken[draft.path] = (before, draft.text)
            else:
                draft.disk = data
        return taken

    # ---- recovery

    def keep(self) -> bool:
        """Write what is not saved beside its file; return whether anything was written."""
        is_written = False
        for draft in self._drafts.values():
            if draft.is_saved:
                is_written |= self._forget(draft)
            elif draft.kept != draft.text:
                head = f"# lss_motion: unsaved edits of {draft.path.name}; sha256 of the file: "
                head = "".join(char if char.isprintable() else "?" for char in head)
                data = f"{head}{draft.base}\n".encode() + draft.data
                with suppress(InputError):  # A folder that cannot be written costs the safety only.
                    write_output(recovery_path(draft.path), data, like=draft.path)
                draft.kept, is_written = draft.text, True
        return is_written

    def recover(self, paths: Iterable[Path]) -> Iterator[tuple[Path, str, str]]:
        """Take the edits that lie beside these files; yield each with its text before and after.

        Edits that add what an edit may not add are left where they are.
        """
        for path in paths:
            if path in self._searched or path in self._drafts:
                continue
            self._searched.add(path)
            try:
                kept = bounded_data(recovery_path(path))
                found = _HEAD.match(kept)
                if found is None:
                    continue
                data = kept[found.end() :]
                stamp, disk = stamp_of(path), bounded_data(path)
                draft = Draft(path, disk, stamp)
                text = text_of(data, path)
                require_allowed(self.folder, path, draft.text, text)
            except InputError:
                continue
            before, draft.text = draft.text, text
            base = found[1].decode()
            if base != draft.base and before != text:
                draft.base, draft.disk = base, disk  # The file has changed since then.
            if draft.is_saved:
                self._remove(path)
                continue
            draft.kept = text
            self._drafts[path] = draft
            self.recovered.append(path)
            yield path, before, text

    def _forget(self, draft: Draft) -> bool:
        """Remove the recovery file of what is saved."""
        if draft.path in self.recovered:
            self.recovered.remove(draft.path)
        if draft.kept is None:
            return False
        draft.kept = None
        self._remove(draft.path)
        return True

    def _remove(self, path: Path) -> None:
        with suppress(OSError):
            recovery_path(path).unlink()

    def _opened(self, path: Path) -> Draft:
        draft = self._drafts.get(path)
        if draft is None:
            stamp = stamp_of(path)
            draft = self._drafts[path] = Draft(path, bounded_data(path), stamp)
        return draft

    def _conflict(self, path: Path) -> Draft:
        draft = self._drafts.get(path)
        if draft is None or draft.disk is None:
            raise InputError("has not changed on disk", path=self.name(path))
        return draft


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
