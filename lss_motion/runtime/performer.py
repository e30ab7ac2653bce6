"""Functions and sounds of a show, in a process of their own, so that they never delay a command.

The player's process writes one JSON object a line to the standard input of this process and never
waits; a line that does not fit into the pipe is lost. The process carries out one line after the
other and writes a dot for each, so that the player can report at the end which were not done. It
runs as `python -m lss_motion.runtime.performer`.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import shutil
import subprocess
import sys
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError
from lss_motion.player.events import CueReached, Warned
from lss_motion.sequence.load import function_problem

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator
    from types import TracebackType

    from lss_motion.player.events import Event
    from lss_motion.sequence.model import Cue

SOUND_PLAYERS: Final = (
    ("pw-play",),
    ("paplay",),
    ("afplay",),
    ("ffplay", "-nodisp", "-autoexit", "-loglevel", "error"),
    ("mpv", "--no-video", "--really-quiet"),
    ("aplay", "-q"),
)
"""Programs that play a sound file; the first one installed is used. The last plays WAV only."""
DOTS_MAX: Final = 4096
CLOSE_S: Final = 5.0
"""The longest time that functions and sounds may take after the show."""
NAMED_MAX: Final = 5
"""A warning names this many that were not done, and counts the others."""


class Performer:
    """The player's end of the pipe. A context manager.

    Raises `InputError` for a function that does not exist.
    """

    def __init__(self, cues: Collection[Cue]) -> None:
        functions = list({(cue.run, cue.folder) for cue in cues if cue.run})
        self.lost: list[Cue] = []
        """Cues that did not fit into the pipe."""
        self.started: deque[Cue] = deque()
        """Cues that were started and are not done, oldest first."""
        self.warnings: list[str] = []
        if any(cue.sound for cue in cues) and sound_player() is None:
            names = ", ".join(words[0] for words in SOUND_PLAYERS)
            self.warnings.append(f"no sounds: none of {names} is installed")
        self._child = subprocess.Popen(
            [sys.executable, "-m", "lss_motion.runtime.performer"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C ends the player only; this ends with its pipe.
        )
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(json.dumps(functions).encode() + b"\n")
        self._child.stdin.flush()
        answer = self._child.stdout.readline().decode().strip()
        if answer != "ready":
            self._child.kill()
            self._child.communicate()
            raise InputError(answer or "the process for functions and sounds did not start")
        self._pipe_fd, self._dots_fd = self._child.stdin.fileno(), self._child.stdout.fileno()
        os.set_blocking(self._pipe_fd, False)
        os.set_blocking(self._dots_fd, False)

    def perform(self, cue: Cue) -> None:
        """Start a function or a sound; never waits."""
        if not cue.run and not cue.sound:
            return
        request = {"run": cue.run, "folder": cue.folder, "sound": cue.sound, "at_s": cue.at_s}
        line = json.dumps(request).encode() + b"\n"
        try:
            # A pipe takes up to 4096 bytes as a whole or not at all.
            os.write(self._pipe_fd, line)
        except (BlockingIOError, BrokenPipeError):
            self.lost.append(cue)
        else:
            self.started.append(cue)
        self._note_done()

    def unfinished(self) -> list[str]:
        """Return a warning, once closed, about everything that was started and not done."""
        left = [f"{_named(cue)} at {cue.at_s:g} s" for cue in (*self.started, *self.lost)]
        if not left:
            return []
        if self.started:
            left[0] += " (not at its end)"
        named = ", ".join(left[:NAMED_MAX])
        more = f" and {len(left) - NAMED_MAX} more" if len(left) > NAMED_MAX else ""
        return [
            f"not done: {named}{more}. Each waits until the one before it returns; after the show "
            f"there are {CLOSE_S:g} s. Let a slow function start a thread"
        ]

    def _note_done(self) -> None:
        """Read the dots, so that their pipe is never full; never waits."""
        with contextlib.suppress(BlockingIOError):
            while dots := os.read(self._dots_fd, DOTS_MAX):
                for _ in dots:
                    self.started.popleft()

    def __enter__(self) -> Performer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        with contextlib.suppress(OSError):
            self._child.stdin.close()
        try:
            self._child.wait(timeout=CLOSE_S if kind is None else 0.0)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        self._note_done()
        self._child.stdout.close()


def _named(cue: Cue) -> str:
    return f"run {cue.run}" if cue.run else f"sound {Path(cue.sound).name}"


@contextlib.contextmanager
def performing(
    cues: Collection[Cue], tell: Callable[[Event], None], *, is_virtual: bool
) -> Iterator[Callable[[Event], None]]:
    """Yield an event handler that starts functions and sounds, then calls `tell`.

    In virtual time none is started: an hour of sounds would play at once. Raises `InputError` for
    a function that does not exist.
    """
    if is_virtual:
        check_functions(cues)
    if is_virtual or not any(cue.run or cue.sound for cue in cues):
        yield tell
        return
    performer = Performer(cues)

    def perform_and_tell(event: Event) -> None:
        if isinstance(event, CueReached):
            performer.perform(event.cue)
        tell(event)

    try:
        with performer:
            for text in performer.warnings:
                tell(Warned(text))
            yield perform_and_tell
    finally:
        for text in performer.unfinished():
            tell(Warned(text))


def sound_player() -> tuple[str, ...] | None:
    """Return the command that plays the sound file given as its last argument, or None."""
    return next((words for words in SOUND_PLAYERS if shutil.which(words[0])), None)


def check_functions(cues: Iterable[Cue]) -> None:
    """Raise `InputError` for a function that does not exist, without running its module.

    A compiled program may have been moved away from the folder of its functions.
    """
    for run, folder in {(cue.run, cue.folder): None for cue in cues if cue.run}:
        if problem := function_problem(run, folder):
            raise InputError(f"run: {run!r} cannot be used: {problem}")


def load_function(run: str, folder: str) -> Callable[[float], Any]:
    """Return the function `module:function`; raises `InputError` if there is none."""
    module_name, _, name = run.partition(":")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        function = getattr(importlib.import_module(module_name), name)
    except Exception as error:
        raise InputError(
            f"run: {run!r} cannot be used: {type(error).__name__}: {error}. The module is searched "
            f"in {folder}, then among the installed ones"
        ) from error
    if not callable(function):
        raise InputError(f"run: {run!r} is no function")
    checked: Callable[[float], Any] = function
    return checked


def main() -> int:
    """Carry out the lines of standard input until it ends, then wait for the sounds."""
    # Output of a function, or of a program that it starts, goes to the screen, not to the player.
    replies, sys.stdout = os.fdopen(os.dup(1), "w"), sys.stderr
    os.dup2(2, 1)
    functions = {}
    try:
        for run, folder in json.loads(sys.stdin.readline()):
            functions[run, folder] = load_function(run, folder)
    except InputError as error:
        print(error, file=replies, flush=True)
        return error.exit_code
    print("ready", file=replies, flush=True)
    player = sound_player()
    sounds: list[subprocess.Popen[bytes]] = []
    for line in sys.stdin:
        request = json.loads(line)
        if request["sound"] and player is not None:
            words = [*player, request["sound"]]
            sounds.append(subprocess.Popen(words, stdin=subprocess.DEVNULL))  # noqa: S603
        if request["run"]:
            try:
                functions[request["run"], request["folder"]](request["at_s"])
            except Exception as error:  # noqa: BLE001  a function of the user may raise anything
                text = f"run: {request['run']}: {type(error).__name__}: {error}"
                print(text, file=sys.stderr)  # noqa: T201
        print(".", end="", file=replies, flush=True)
    for sound in sounds:
        sound.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
