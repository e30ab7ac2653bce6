"""Keeps a stage running: when its player starts, ends for new files, and is given up.

    next_deed(...)     what is to be done now: `start`, `renew`, or nothing
    note_renewed(...)  takes whether the player goes on with new files
    note_end(...)      takes how the player ended

Pure: time and state are arguments. The director in the player begins again after faults; what is
decided here is the rest: a player that could not begin or is gone, and files that have changed. A
stop is kept until a person has armed again and started.
"""

from __future__ import annotations

from typing import Final, Literal

from msgspec import Struct

from lss_motion.errors import EXIT_INPUT, EXIT_UNREACHABLE

RESTING: Final = frozenset({"idle", "rests", "waits_for_port", "given_up"})
"""States of a stage in which new files may take the place of the old ones: no show is cut short."""
PAUSE_S: Final = 5.0
PAUSE_MAX_S: Final = 60.0
"""Between attempts to start a player that is gone: twice as long each time."""
PROVEN_S: Final = 600.0
"""A player that has lived so long begins the count anew."""
CALM_S: Final = 1.0
"""New files are taken when they have not changed for so long: an editor may write several."""

Deed = Literal["start", "renew"]


class Failure(Struct, frozen=True):
    """Why a stage cannot go on: the program ends with this."""

    text: str
    exit_code: int


class Seen(Struct, frozen=True, kw_only=True):
    """What the keeper needs to know of the server."""

    plan: str | None
    """Of the last good files; None: there are none."""
    is_running: bool
    is_latched: bool
    state: str
    """Of the stage, as its player last reported it."""


class Keeper:
    """The player of one stage."""

    def __init__(self) -> None:
        self.failure: Failure | None = None
        self.is_wanted = True
        """False after a stop, until someone starts the stage again."""
        self._has_run = False
        self._plan: str | None = None
        """Of the player that runs, or has ended last."""
        self._newest: str | None = None
        self._changed_s = self._started_s = self._next_s = 0.0
        self._attempts = 0
        self._needs_new_files = self._is_ending = False
        """`_is_ending`: the player is to go on with new files, or to end for them."""
        self._renewing: str | None = None

    @property
    def has_new_files(self) -> bool:
        """Whether newer files wait for the end of what plays."""
        return self._newest is not None and self._newest != self._plan

    def note_connected(self) -> None:
        """Note that the servos were there once: from now on nothing ends the program."""
        self._has_run = True

    def next_deed(self, seen: Seen, now_s: float) -> Deed | None:
        """Return what is to be done now."""
        if seen.plan != self._newest:
            self._newest, self._changed_s = seen.plan, now_s
        if seen.is_latched:
            self.is_wanted = False
        if seen.is_running:
            if not self.has_new_files or self._is_ending or now_s < self._changed_s + CALM_S:
                return None
            if seen.state not in RESTING or seen.is_latched:
                return None
            self._is_ending = True
            self._renewing = seen.plan
            return "renew"
        is_stuck = self._needs_new_files and not self.has_new_files
        if seen.plan is None or not self.is_wanted or is_stuck or now_s < self._next_s:
            return None
        return "start"

    def note_start(self, plan: str | None, now_s: float) -> None:
        """Note that the player was started with these files."""
        self._plan, self._started_s = plan, now_s
        self.is_wanted, self._needs_new_files = True, False

    def note_renewed(self, *, is_taken: bool) -> None:
        """Note that the player goes on with the new files, or cannot now: a show plays."""
        self._is_ending = False
        if is_taken:
            self._plan = self._renewing

    def note_end(self, error: str | None, exit_code: int | None, now_s: float) -> str | None:
        """Note that the player has ended; return what is to be told to people, if anything."""
        was_ending, self._is_ending = self._is_ending, False
        if was_ending and error is None:
            self._next_s = now_s
            return None
        if error is None:
            self.is_wanted = False  # It was stopped, or has nothing more to play.
            return None
        if not self._has_run:
            self.failure = Failure(error, exit_code or EXIT_UNREACHABLE)
            return error
        if exit_code == EXIT_INPUT:
            self._needs_new_files = True
            return f"{error}; the stage begins again when a file has changed"
        self._attempts = 0 if now_s - self._started_s > PROVEN_S else self._attempts + 1
        pause_s = min(PAUSE_S * 2 ** max(self._attempts - 1, 0), PAUSE_MAX_S)
        self._next_s = now_s + pause_s
        return f"{error}; the stage begins again in {pause_s:.0f} s"
