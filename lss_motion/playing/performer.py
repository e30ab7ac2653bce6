"""Functions and sounds of a show, in a process of their own, so that they never delay a command.

The player's process sends each cue to that process (`playing.performer_process`) and never waits;
one that does not fit into the pipe is lost. It reads the news: what is done, what failed, what was
printed. Whatever way the show ends, no process is left: the whole process group is killed after the
show.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.playing.performer_process import (
    CLOSE_S,
    CueDone,
    CueFailed,
    Loaded,
    LoadFunctions,
    Loading,
    PerformCue,
    PerformerNews,
    Printed,
    SoundsPlaying,
)
from lss_motion.playing.player.events import CueReached, Warned
from lss_motion.show.functions import function_problem, modules_of
from lss_motion.system.process import ChildProcess

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.show.functions import ModuleSource
    from lss_motion.show.model import Cue

START_S: Final = 10.0
"""The longest time that importing the modules of the functions may take. Chosen: large libraries
take a few seconds on a small computer."""
HELD_MAX_BYTES: Final = 65536
"""Cues that wait for a slow function: some hundreds."""
PRINTED_MAX: Final = 10
"""So many of the last lines that functions and sounds have printed are reported."""
LOST_MAX: Final = 1000
NAMED_MAX: Final = 5
"""A warning names this many that were not done, and counts the others."""


class Performer:
    """The player's end of the pipes. A context manager.

    Raises `InputError` for a function that does not exist or is not imported in `START_S`.
    """

    def __init__(
        self, cues: Collection[Cue], modules: Sequence[ModuleSource] | None = None
    ) -> None:
        """`modules`: what a person has agreed to; None: what lies beside the show now."""
        functions = tuple(dict.fromkeys((cue.run, cue.folder) for cue in cues if cue.run))
        if modules is None:
            modules = modules_of(cues)
        self.lost: list[Cue] = []
        """The first cues that did not fit into the pipe, up to `LOST_MAX`."""
        self._lost_count = 0
        self.started: deque[Cue] = deque()
        """Cues that were started and are not done, oldest first."""
        self.warnings: deque[str] = deque()
        """Texts for a person that `take_warnings` has not returned yet."""
        self._printed: deque[str] = deque(maxlen=PRINTED_MAX)
        self._printed_count = 0
        self._playing = 0
        self._loading = ""
        self._is_ready, self._answer = False, ""
        guard_fd, self._guard_fd = os.pipe()
        self._child: ChildProcess[PerformerNews] = ChildProcess(
            *("lss_motion.playing.performer_process", str(os.getpid()), str(guard_fd)),
            receives=PerformerNews,
            inherits=[guard_fd],
            starts_programs=True,
            outbox_max_bytes=HELD_MAX_BYTES,
        )
        os.close(guard_fd)
        self._child.send(LoadFunctions(functions, tuple(modules)))
        if problem := self._problem():
            self._end(0.0)
            raise InputError(problem)

    def perform(self, cue: Cue) -> None:
        """Start a function or a sound; never waits."""
        if not cue.run and not cue.sound:
            return
        if self._child.send(PerformCue(cue.run, cue.folder, cue.sound, cue.at_s)):
            self.started.append(cue)
            return
        self._lost_count += 1
        if len(self.lost) < LOST_MAX:
            self.lost.append(cue)

    def take_warnings(self) -> list[str]:
        """Return what went wrong since the last call; never waits."""
        for news in self._child.receive():
            self._take(news)
        texts, self.warnings = list(self.warnings), deque()
        return texts

    def unfinished(self) -> list[str]:
        """Return warnings, once closed: what was not done, and what functions have printed."""
        texts = []
        left = [f"{_named(cue)} at {cue.at_s:g} s" for cue in (*self.started, *self.lost)]
        if left:
            if self.started:
                left[0] += " (not at its end)"
            named = ", ".join(left[:NAMED_MAX])
            count = len(self.started) + self._lost_count
            more = f" and {count - NAMED_MAX} more" if count > NAMED_MAX else ""
            texts.append(
                f"not done: {named}{more}. Each waits until the one before it returns; after the "
                f"show there are {CLOSE_S:g} s. Let a slow function start a thread"
            )
        if self._playing:
            texts.append(f"a sound was stopped that did not end {CLOSE_S:g} s after the show")
        if self._printed:
            shown = "".join(f"\n  {line}" for line in self._printed)
            lines = counted(self._printed_count, "line")
            texts.append(f"functions and sounds printed {lines}; the last:{shown}")
        return texts

    def _problem(self) -> str:
        """Wait until the functions are there, for `START_S`; return why they are not."""
        end_s = time.monotonic() + START_S
        while not self._is_ready and not self._answer:
            left_s = end_s - time.monotonic()
            if left_s <= 0.0:
                return (
                    f"run: {self._loading!r} cannot be used: importing its module takes more than "
                    f"{START_S:g} s"
                )
            for news in self._child.receive_within(left_s):
                self._take(news)
            if self._child.has_ended:
                name = f" while {self._loading!r} was imported" if self._loading else ""
                return f"the process for functions and sounds ended{name}"
        return self._answer

    def _take(self, news: PerformerNews) -> None:
        match news:
            case CueDone():
                self.started.popleft()
            case CueFailed():
                self.warnings.append(news.text)
            case Printed():
                self._printed.append(news.text)
                self._printed_count += 1
            case SoundsPlaying():
                self._playing = news.count
            case Loading():
                self._loading = news.run
            case Loaded():
                self._is_ready, self._answer = not news.problem, news.problem

    def __enter__(self) -> Performer:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._end(CLOSE_S if kind is None else 0.0)

    def _end(self, wait_s: float) -> None:
        """Wait for the process, then kill whatever is left of its group."""
        os.close(self._guard_fd)
        if code := self._child.end(wait_s, self._take):
            self.warnings.append(
                f"the process for functions and sounds ended with exit code {code}"
            )


def _named(cue: Cue) -> str:
    return f"run {cue.run}" if cue.run else f"sound {Path(cue.sound).name}"


@contextlib.contextmanager
def performing(
    cues: Collection[Cue],
    tell: Callable[[Event], None],
    *,
    is_virtual: bool,
    has_stream: bool = False,
    modules: Sequence[ModuleSource] | None = None,
) -> Iterator[Callable[[Event], None]]:
    """Yield an event handler that starts functions and sounds, then calls `tell`.

    In virtual time none is started: an hour of sounds would play at once. With `has_stream` the
    sounds are played elsewhere (`playing.sounds`). `modules`: see `Performer`. Raises `InputError`
    for a function that does not exist.
    """
    if has_stream:
        cues = [cue for cue in cues if cue.run]
    if is_virtual:
        check_functions(cues)
    if is_virtual or not any(cue.run or cue.sound for cue in cues):
        yield tell
        return
    performer = Performer(cues, modules)

    def warn() -> None:
        for text in performer.take_warnings():
            tell(Warned(text))

    def perform_and_tell(event: Event) -> None:
        if isinstance(event, CueReached) and not (has_stream and event.cue.sound):
            performer.perform(event.cue)
        tell(event)
        warn()

    try:
        with performer:
            warn()
            yield perform_and_tell
    finally:
        for text in [*performer.warnings, *performer.unfinished()]:
            tell(Warned(text))


def check_functions(cues: Iterable[Cue]) -> None:
    """Raise `InputError` for a function that does not exist, without running its module.

    A compiled program may have been moved away from the folder of its functions.
    """
    for run, folder in {(cue.run, cue.folder): None for cue in cues if cue.run}:
        if problem := function_problem(run, folder):
            raise InputError(f"run: {run!r} cannot be used: {problem}")
