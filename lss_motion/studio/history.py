"""Undo and redo: two stacks of steps, each with what it replaced in the text of each file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.yaml_edit import Splice

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

STEPS_MAX: Final = 2000
"""Chosen: a long day of edits."""
CHARS_MAX: Final = 32_000_000
"""Characters that all steps hold at most; the oldest steps go first."""


class Step(Struct, frozen=True):
    """One step: what it is called, and what it replaced. `gesture`: the one that it is part of."""

    word: str
    splices: Mapping[Path, Splice]
    gesture: str | None = None

    @property
    def chars(self) -> int:
        """How many characters it holds."""
        return sum(len(one.removed) + len(one.inserted) for one in self.splices.values())


class History:
    """The steps that were done, and those that were undone."""

    def __init__(self) -> None:
        self._done: list[Step] = []
        self._undone: list[Step] = []

    @property
    def undo_word(self) -> str | None:
        """What `undo` would undo."""
        return self._done[-1].word if self._done else None

    @property
    def redo_word(self) -> str | None:
        """What `redo` would do again."""
        return self._undone[-1].word if self._undone else None

    def add(
        self,
        word: str,
        changed: Mapping[Path, tuple[str, str]],
        gesture: str | None = None,
    ) -> None:
        """Keep a step: each file with its text before and after; what was undone is forgotten."""
        last = self._done[-1] if self._done and not self._undone else None
        before = {path: old for path, (old, _) in changed.items()}
        after = {path: new for path, (_, new) in changed.items()}
        if last is not None and gesture is not None and last.gesture == gesture:
            self._done.pop()
            kept = {path: one for path, one in last.splices.items() if path not in before}
            first = {
                path: last.splices[path].inverse().apply(old) if path in last.splices else old
                for path, old in before.items()
            }
            splices = {path: Splice.between(first[path], after[path]) for path in first}
            step = Step(word, {**kept, **splices}, gesture)
        else:
            splices = {path: Splice.between(before[path], after[path]) for path in before}
            step = Step(word, splices, gesture)
        self._undone.clear()
        self._done.append(step)
        while len(self._done) > STEPS_MAX or (
            len(self._done) > 1 and sum(one.chars for one in self._done) > CHARS_MAX
        ):
            del self._done[0]

    def undo(self, text_of: Callable[[Path], str]) -> dict[Path, str]:
        """Return the texts before the last step; raises `InputError` if there is none."""
        if not self._done:
            raise InputError("there is nothing to undo")
        step = self._done[-1]
        texts = {path: one.inverse().apply(text_of(path)) for path, one in step.splices.items()}
        self._undone.append(self._done.pop())
        return texts

    def redo(self, text_of: Callable[[Path], str]) -> dict[Path, str]:
        """Return the texts after the step that was undone last."""
        if not self._undone:
            raise InputError("there is nothing to redo")
        step = self._undone[-1]
        texts = {path: one.apply(text_of(path)) for path, one in step.splices.items()}
        self._done.append(self._undone.pop())
        return texts
