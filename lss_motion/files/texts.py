"""Texts for people: similar names, counts, tables, durations; text that a terminal can show."""

from __future__ import annotations

import difflib
import json
import math
from typing import TYPE_CHECKING, Final
from unicodedata import category

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence, Sized

HIDDEN: Final = frozenset({"Cc", "Cf", "Cs", "Zl", "Zp"})
"""Unicode categories of what a terminal obeys or cannot show: controls, directions of writing,
halves of characters, separators of lines."""
SHOWN: Final = "\n\t\u200c\u200d"
"""What of them stays: ends of lines, tabs, and the joiners of some scripts."""


def escaped(text: str, *, as_json: bool = False) -> str:
    """Return text as a terminal may get it: what would steer the terminal is written as an escape.

    With `as_json` the text is JSON, and stays the same JSON.
    """
    if text.isprintable():
        return text
    return "".join(
        char
        if char.isprintable() or char in SHOWN or category(char) not in HIDDEN
        else json.dumps(char)[1:-1]
        if as_json
        else char.encode("unicode_escape").decode("ascii")
        for char in text
    )


def printable(text: str) -> str:
    """Return text from outside as one line of a file: a question mark for what is no character."""
    return "".join(char if char.isprintable() else "?" for char in text)


LISTED_MAX: Final = 20
"""A longer list does not help the reader."""


def known_names(word: str, names: Iterable[str]) -> str:
    """Return a text with the name nearest to `word` and the list of all names."""
    choices = list(names)
    if not choices:
        return "there are none"
    by_lower = {name.lower(): name for name in reversed(choices)}
    near = difflib.get_close_matches(word.lower(), by_lower, n=1)
    meant = f"did you mean {by_lower[near[0]]!r}? " if near else ""
    listed = ", ".join(choices[:LISTED_MAX])
    more = f" and {len(choices) - LISTED_MAX} more" if len(choices) > LISTED_MAX else ""
    return f"{meant}there are: {listed}{more}"


def counted(things: Sized, one: str, many: str | None = None) -> str:
    """Return a count with its noun, such as `1 joint` or `5 joints`."""
    return f"{len(things)} {one if len(things) == 1 else many or one + 's'}"


def aligned(rows: Sequence[Sequence[str]], right: Container[int] = ()) -> list[str]:
    """Return the rows of a table as lines; the columns `right` are aligned to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            text.rjust(width) if column in right else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def duration_text(duration_s: float) -> str:
    """Return a duration in seconds, or `forever` for an infinite one."""
    return "forever" if math.isinf(duration_s) else f"{duration_s:.3f} s"
