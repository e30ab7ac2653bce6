"""Which of several shows a cue plays: in turn, or at random without repeats."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from random import Random

    from lss_motion.stage.model import Cue


class Bags:
    """For each cue the shows that are still to come before all have been played."""

    def __init__(self, random: Random) -> None:
        self._random = random
        self._coming: dict[str, list[str]] = {}

    def next(self, cue: Cue) -> str:
        """Return the show that the cue plays next; it stays the next one until it is taken."""
        if len(cue.shows) == 1:
            return cue.shows[0]
        if not self._coming.get(cue.name):
            self._coming[cue.name] = self._filled(cue, None)
        return self._coming[cue.name][0]

    def take(self, cue: Cue) -> None:
        """Note that the next show is played."""
        if len(cue.shows) == 1:
            return
        last = self._coming[cue.name].pop(0)
        if not self._coming[cue.name]:
            self._coming[cue.name] = self._filled(cue, last)

    def _filled(self, cue: Cue, last: str | None) -> list[str]:
        """Return all shows of a cue; a random order does not begin with `last`."""
        shows = list(cue.shows)
        if cue.choice == "random":
            self._random.shuffle(shows)
            if shows[0] == last:
                other = self._random.randrange(1, len(shows))
                shows[0], shows[other] = shows[other], shows[0]
        return shows
