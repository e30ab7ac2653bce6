"""Words for people: the names near an unknown one, counts, durations."""

from __future__ import annotations

import difflib
import math
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable, Sized

LISTED_MAX: Final = 20
"""More names than this are a wall, not a help."""


def known_names(word: str, names: Iterable[str]) -> str:
    """Return which of `names` was probably meant and what there is to choose from."""
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
    """Return how many things there are, such as `1 joint` or `5 joints`."""
    return f"{len(things)} {one if len(things) == 1 else many or one + 's'}"


def duration_text(duration_s: float) -> str:
    """Return a duration in seconds, or `forever` for an infinite one."""
    return "forever" if math.isinf(duration_s) else f"{duration_s:.3f} s"
