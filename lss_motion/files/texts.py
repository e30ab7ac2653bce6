"""Texts for people: similar names, counts, tables, durations; text that a terminal can show."""

from __future__ import annotations

import difflib
import io
import json
import math
import re
import sys
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


class ShownStream(io.TextIOWrapper):
    """A text stream on which nothing steers a terminal, whoever writes to it, except by `steer`."""

    def write(self, text: str) -> int:
        super().write(escaped(text))
        return len(text)

    def steer(self, control: str) -> None:
        """Write as it is what is known to be no text from outside."""
        super().write(control)


def show_standard_error() -> None:
    """Let nothing that a library, a warning or a traceback prints steer the terminal."""
    stream = sys.stderr
    if type(stream) is io.TextIOWrapper:
        sys.stderr = ShownStream(
            stream.buffer, stream.encoding, "backslashreplace", line_buffering=True
        )


def printable(text: str) -> str:
    """Return text from outside as one line of a file: a question mark for what is no character."""
    return "".join(char if char.isprintable() else "?" for char in text)


LISTED_MAX: Final = 20
"""A longer list does not help the reader."""
ALIKE_RATIO: Final = 0.5
"""So near must a name be that begins with the same letter: `anker` is an `anchor` (0.55), although
names are near from 0.6 on as a rule. Chosen."""
SCREEN_CHARS: Final = 80
"""Width of a terminal, as it opens everywhere."""
_COMMA: Final = re.compile(r"\s*([-+]?\d+),(\d+)\s*", re.ASCII)


def known_names(word: str, names: Iterable[str]) -> str:
    """Return a text with the name nearest to `word` and the list of all names."""
    choices = list(names)
    if not choices:
        return "there are none"
    by_lower = {name.lower(): name for name in reversed(choices)}
    alike = [name for name in by_lower if name[:1] == word[:1].lower()]
    near = difflib.get_close_matches(word.lower(), by_lower, n=1) or difflib.get_close_matches(
        word.lower(), alike, n=1, cutoff=ALIKE_RATIO
    )
    meant = f"did you mean {by_lower[near[0]]!r}? " if near else ""
    listed = ", ".join(choices[:LISTED_MAX])
    more = f" and {len(choices) - LISTED_MAX} more" if len(choices) > LISTED_MAX else ""
    return f"{meant}there are: {listed}{more}"


def counted(things: Sized | int, one: str, many: str | None = None, *, mark: str = "") -> str:
    """Return a count with its noun, such as `1 joint` or `5 joints`; `mark` divides thousands."""
    count = things if isinstance(things, int) else len(things)
    return f"{count:,} {one if count == 1 else many or one + 's'}".replace(",", mark)


def comma_text(text: object) -> str:
    """Return what to say of a number with a decimal comma, such as `0,5`; of all others nothing."""
    number = _COMMA.fullmatch(text) if isinstance(text, str) else None
    if number is None:
        return ""
    return f"; a decimal comma is written as a point: {number[1]}.{number[2]}"


def aligned(
    rows: Sequence[Sequence[str]],
    right: Container[int] = (),
    *,
    spare: Sequence[int] = (),
    most_chars: int = 0,
) -> list[str]:
    """Return the rows of a table as lines; the columns `right` are aligned to the right.

    Of lines that would be longer than `most_chars`, the columns `spare` are left out, one after the
    other, and then the texts of the first column are shortened; 0: lines may have any length.
    """
    widths = dict(enumerate(max(map(len, column)) for column in zip(*rows, strict=True)))

    def beyond() -> int:
        return sum(widths.values()) + 2 * (len(widths) - 1) - (most_chars or sys.maxsize)

    for column in spare:
        if beyond() > 0:
            del widths[column]
    if beyond() > 0:
        widths[0] = max(widths[0] - beyond(), 1)
    return [
        "  ".join(
            text.rjust(width) if column in right else text.ljust(width)
            for column, width in widths.items()
            for text in [_shortened(row[column], width)]
        ).rstrip()
        for row in rows
    ]


def _shortened(text: str, most_chars: int) -> str:
    return text if len(text) <= most_chars else f"{text[: most_chars - 1]}…"


def duration_text(duration_s: float) -> str:
    """Return a duration in seconds, or `forever` for an infinite one."""
    return "forever" if math.isinf(duration_s) else f"{duration_s:.3f} s"
