"""The process that calls the functions of a show and plays its sounds.

It reads one JSON value a line from standard input: first the functions, then each cue that is
reached. It carries out one line after the other, and reports with one JSON object a line on
standard output:

    {"loading": "effects:fog"}     a module is being imported
    {"ready": true}                all functions are there; or {"problem": text}, and it ends
    {"done": true}                 a cue is done; that of a sound is done when the sound has begun
    {"failed": text}               a function raised, a sound could not be played
    {"printed": text}              a line that a function or a sound has printed
    {"sounds": 2}                  so many sounds are playing

Whatever functions print is read here, so that it never reaches the screen of the show. A second
process, forked before any function is loaded, waits for the end of standard input: if the player
was killed, it ends this process and all that it has started.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import select
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO

from lss_motion.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

SOUND_PLAYERS: Final = (
    ("pw-play",),
    ("paplay",),
    ("afplay",),
    ("ffplay", "-nodisp", "-autoexit", "-loglevel", "error"),
    ("mpv", "--no-video", "--really-quiet"),
    ("aplay", "-q"),
)
"""Programs that play a sound file; the first one installed is used. The last plays WAV only."""
CLOSE_S: Final = 5.0
"""The longest time that functions and sounds may take after the show."""
LOOK_S: Final = 0.1
LINE_MAX_CHARS: Final = 200
"""The rest of a longer line is not reported."""


def sound_player() -> tuple[str, ...] | None:
    """Return the command that plays the sound file given as its last argument, or None."""
    return next((words for words in SOUND_PLAYERS if shutil.which(words[0])), None)


def load_function(run: str, folder: str) -> Callable[[float], Any]:
    """Return the function `module:function`; raises `InputError` if there is none."""
    module_name, _, name = run.partition(":")
    if folder not in sys.path:
        sys.path.insert(0, folder)
    importlib.invalidate_caches()
    try:
        function = getattr(importlib.import_module(module_name), name)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"run: {run!r} cannot be used: {type(error).__name__}: {error}. The module is searched "
            f"in {folder}, then among the installed ones"
        ) from error
    if not callable(function):
        raise InputError(f"run: {run!r} is no function")
    checked: Callable[[float], Any] = function
    return checked


class Reports:
    """Writes reports to the player. A printed line that finds no room is dropped."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._lock = threading.Lock()

    def send(self, **report: object) -> None:
        line = json.dumps(report).encode() + b"\n"
        with self._lock, contextlib.suppress(BrokenPipeError):
            if "printed" in report and not select.select([], [self._fd], [], 0.0)[1]:
                return
            os.write(self._fd, line)  # Up to 4096 bytes are written as a whole.

    def copy_lines(self, stream: Iterable[str]) -> str:
        """Report every line of `stream` until it ends; return the last one."""
        last = ""
        for line in stream:
            last = line.strip()[:LINE_MAX_CHARS] or last
            self.send(printed=line.rstrip()[:LINE_MAX_CHARS])
        return last


class Sounds:
    """Sounds that are playing, each with a thread that waits for its end."""

    def __init__(self, reports: Reports) -> None:
        self._reports = reports
        self._player = sound_player()
        self._threads: list[threading.Thread] = []
        self._playing = 0

    def play(self, path: str) -> None:
        if self._player is None:
            return
        try:
            process = subprocess.Popen(  # noqa: S603  (a fixed program and the author's file)
                [*self._player, path],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
        except OSError as error:
            self._reports.send(failed=f"sound {path}: {error.strerror}")
            return
        self._count(1)
        thread = threading.Thread(target=self._wait, args=(process, path), daemon=True)
        thread.start()
        self._threads.append(thread)

    def wait(self) -> None:
        for thread in self._threads:
            thread.join()

    def _wait(self, process: subprocess.Popen[str], path: str) -> None:
        assert process.stdout is not None
        last = self._reports.copy_lines(process.stdout)
        if code := process.wait():
            name, program = Path(path).name, Path(str(process.args[0])).name  # type: ignore[index]
            why = f": {last}" if last else ""
            self._reports.send(failed=f"sound {name}: {program} ended with exit code {code}{why}")
        self._count(-1)

    def _count(self, change: int) -> None:
        self._playing += change
        self._reports.send(sounds=self._playing)


def main() -> int:
    """Carry out the lines of standard input until it ends, then wait for the sounds."""
    player_pid = int(sys.argv[1])
    _guard(player_pid)
    reports = Reports(os.dup(1))
    requests = os.fdopen(os.dup(0), encoding="utf-8")
    printed = _captured(reports)
    # Only sources are run: a person has agreed to what stands in them, not in stored bytecode.
    sys.pycache_prefix, sys.dont_write_bytecode = os.devnull, True
    functions = {}
    try:
        for run, folder in json.loads(requests.readline()):
            reports.send(loading=run)
            functions[run, folder] = load_function(run, folder)
    except InputError as error:
        reports.send(problem=str(error))
        return error.exit_code
    reports.send(ready=True)
    sounds = Sounds(reports)
    for line in requests:
        request = json.loads(line)
        if request["sound"]:
            sounds.play(request["sound"])
        if request["run"]:
            try:
                functions[request["run"], request["folder"]](request["at_s"])
            except (Exception, SystemExit) as error:  # noqa: BLE001  a function may raise anything
                where = f"run {request['run']} at {request['at_s']:g} s"
                reports.send(failed=f"{where}: {type(error).__name__}: {error}"[:LINE_MAX_CHARS])
        reports.send(done=True)
    sounds.wait()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(0, 1)
    os.dup2(0, 2)
    printed.join(LOOK_S)  # A program that a function has started may still hold the pipe.
    return 0


def _captured(reports: Reports) -> threading.Thread:
    """Report what this process and its programs print; give them an empty standard input."""
    read_fd, write_fd = os.pipe()
    null_fd = os.open(os.devnull, os.O_RDWR)
    os.dup2(null_fd, 0)
    os.dup2(write_fd, 1)
    os.dup2(write_fd, 2)
    os.close(null_fd)
    os.close(write_fd)
    sys.stdin = os.fdopen(os.dup(0))
    sys.stdout = _printing_to(1)
    sys.stderr = _printing_to(2)
    lines = os.fdopen(read_fd, encoding="utf-8", errors="replace")
    thread = threading.Thread(target=reports.copy_lines, args=(lines,), daemon=True)
    thread.start()
    return thread


def _printing_to(fd: int) -> TextIO:
    return os.fdopen(fd, "w", 1, encoding="utf-8", errors="replace", closefd=False)


def _guard(player_pid: int) -> None:
    """Fork the process that ends all others of this group when the player is gone.

    A function may hang in code that lets no thread run, so a thread could not do this.
    """
    if not hasattr(os, "fork") or os.fork():
        return
    with contextlib.suppress(BaseException):
        os.closerange(1, 64)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        poll = select.poll()
        poll.register(0, 0)
        poll.poll()  # Standard input hangs up: the player has closed it, or was killed.
        end_s = time.monotonic() + 2.0 * CLOSE_S
        while _is_alive(player_pid) and time.monotonic() < end_s:
            select.select([], [], [], LOOK_S)
    os.killpg(0, signal.SIGKILL)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
