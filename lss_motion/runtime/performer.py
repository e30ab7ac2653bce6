"""Functions and sounds of a show, in a process of their own: they can never delay a command.

The player's process writes one JSON object a line to its standard input and never waits; what a
full pipe does not take is lost. One is done after the other, and a dot comes back for each that is
done, so that the player can say at the end what was not. Run as
`python -m lss_motion.runtime.performer`.
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
"""Programs that play a sound file, the first that the system has. The last knows WAV only."""
DOTS_MAX: Final = 4096
CLOSE_S: Final = 5.0
"""After the show, functions and sounds may go on for so long."""
NAMED_MAX: Final = 5
"""So many that were not done are named; of more it is said how many."""


class Performer:
    """The player's end. A context manager; raises `InputError` for a function that is not there."""

    def __init__(self, cues: Collection[Cue]) -> None:
        wanted = list({(cue.run, cue.folder) for cue in cues if cue.run})
        self.lost: list[Cue] = []
        """What the full pipe did not take."""
        self.begun: deque[Cue] = deque()
        """What was set off and is not done, oldest first."""
        self.warnings: list[str] = []
        if any(cue.sound for cue in cues) and sound_player() is None:
            names = ", ".join(words[0] for words in SOUND_PLAYERS)
            self.warnings.append(f"no sounds: none of {names} is installed")
        self._child = subprocess.Popen(
            [sys.executable, "-m", "lss_motion.runtime.performer"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C is for the player; this ends when it is told to.
        )
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(json.dumps(wanted).encode() + b"\n")
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
        """Set off a function or a sound; never waits."""
        if not cue.run and not cue.sound:
            return
        said = {"run": cue.run, "folder": cue.folder, "sound": cue.sound, "at_s": cue.at_s}
        line = json.dumps(said).encode() + b"\n"
        try:
            # Up to 4096 bytes a pipe takes a line as a whole or not at all.
            os.write(self._pipe_fd, line)
        except (BlockingIOError, BrokenPipeError):
            self.lost.append(cue)
        else:
            self.begun.append(cue)
        self._note_done()

    def unfinished(self) -> list[str]:
        """Return, once this is closed, what was not done of all that was set off: a warning."""
        left = [f"{_named(cue)} at {cue.at_s:g} s" for cue in (*self.begun, *self.lost)]
        if not left:
            return []
        if self.begun:
            left[0] += " (not at its end)"
        named = ", ".join(left[:NAMED_MAX])
        more = f" and {len(left) - NAMED_MAX} more" if len(left) > NAMED_MAX else ""
        return [
            f"not done: {named}{more}. Each waits until the one before it returns; after the show "
            f"there are {CLOSE_S:g} s. Let a slow function start a thread"
        ]

    def _note_done(self) -> None:
        """Take in the dots, so that their pipe is never full; never waits."""
        with contextlib.suppress(BlockingIOError):
            while dots := os.read(self._dots_fd, DOTS_MAX):
                for _ in dots:
                    self.begun.popleft()

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
    """Yield what is to be told of events: it sets off functions and sounds, then tells `tell`.

    In virtual time nothing is set off: an hour of sounds would come at once. Raises `InputError`
    for a function that is not there.
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
    """Return the command that plays a sound file when its path follows; None: there is none."""
    return next((words for words in SOUND_PLAYERS if shutil.which(words[0])), None)


def check_functions(cues: Iterable[Cue]) -> None:
    """Raise `InputError` for a function that is not there, without running its module.

    A compiled program may have left its folder.
    """
    for run, folder in {(cue.run, cue.folder): None for cue in cues if cue.run}:
        if problem := function_problem(run, folder):
            raise InputError(f"run: {run!r} cannot be used: {problem}")


def load_function(run: str, folder: str) -> Callable[[float], Any]:
    """Return the function `module:function`; raise `InputError` if there is none."""
    module_name, _, name = run.partition(":")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        function = getattr(importlib.import_module(module_name), name)
    except Exception as error:
        raise InputError(
            f"run: {run!r} cannot be used: {type(error).__name__}: {error}. The module is looked "
            f"for in {folder}, then among those installed"
        ) from error
    if not callable(function):
        raise InputError(f"run: {run!r} is no function")
    checked: Callable[[float], Any] = function
    return checked


def main() -> int:
    """Do what comes in until there is no more, then wait for the sounds."""
    # What a function prints, or a program that it starts, goes to the screen, not to the player.
    answers, sys.stdout = os.fdopen(os.dup(1), "w"), sys.stderr
    os.dup2(2, 1)
    functions = {}
    try:
        for run, folder in json.loads(sys.stdin.readline()):
            functions[run, folder] = load_function(run, folder)
    except InputError as error:
        print(error, file=answers, flush=True)
        return error.exit_code
    print("ready", file=answers, flush=True)
    player = sound_player()
    sounds: list[subprocess.Popen[bytes]] = []
    for line in sys.stdin:
        said = json.loads(line)
        if said["sound"] and player is not None:
            words = [*player, said["sound"]]
            sounds.append(subprocess.Popen(words, stdin=subprocess.DEVNULL))  # noqa: S603
        if said["run"]:
            try:
                functions[said["run"], said["folder"]](said["at_s"])
            except Exception as error:  # noqa: BLE001  whatever a function of the user raises
                text = f"run: {said['run']}: {type(error).__name__}: {error}"
                print(text, file=sys.stderr)  # noqa: T201
        print(".", end="", file=answers, flush=True)
    for sound in sounds:
        sound.wait()
    return 0


if __name__ == "__main__":
    sys.exit(main())
