"""The process that calls the functions of a show and plays its sounds.

It is sent the functions first (`LoadFunctions`), then each cue that is reached (`PerformCue`). It
carries out one after the other, and sends a `PerformerNews`.

Whatever functions print is read here, so that it never reaches the screen of the show. A second
process, forked before any function is loaded, waits for the end of a pipe of its own: if the player
was killed, it ends this process and all that it has started.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, TextIO

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.show_modules import ShowModules
from lss_motion.show.functions import ModuleSource  # noqa: TC001  (msgspec reads it)
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import serve, wait_for

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from lss_motion.system.messages import MessagePipe

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


def load_function(run: str) -> Callable[[float], Any]:
    """Return the function `module:function`; raises `InputError` if there is none."""
    module_name, _, name = run.partition(":")
    try:
        function = getattr(importlib.import_module(module_name), name)
    except (Exception, SystemExit) as error:
        raise InputError(
            f"run: {run!r} cannot be used: {type(error).__name__}: {error}. The module is searched "
            f"beside its show, then among the installed ones"
        ) from error
    if not callable(function):
        raise InputError(f"run: {run!r} is no function")
    checked: Callable[[float], Any] = function
    return checked


class LoadFunctions(Struct, frozen=True, tag=True):
    """The functions of the show, each with the folder of its module, and the modules there."""

    functions: tuple[tuple[str, str], ...]
    modules: tuple[ModuleSource, ...]


class PerformCue(Struct, frozen=True, tag=True):
    """Call a function of the show, or play a sound."""

    run: str
    folder: str
    sound: str
    at_s: float


PerformerOrder = LoadFunctions | PerformCue


class Loading(Struct, frozen=True, tag=True):
    """A module is being imported."""

    run: str


class Loaded(Struct, frozen=True, tag=True):
    """All functions are there; or why not: then the process ends."""

    problem: str = ""


class CueDone(Struct, frozen=True, tag=True):
    """A cue is done; that of a sound is done when the sound has begun."""


class CueFailed(Struct, frozen=True, tag=True):
    """A function raised, or a sound could not be played."""

    text: str


class Printed(Struct, frozen=True, tag=True):
    """A line that a function or a sound has printed."""

    text: str


class SoundsPlaying(Struct, frozen=True, tag=True):
    """So many sounds are playing."""

    count: int


PerformerNews = Loading | Loaded | CueDone | CueFailed | Printed | SoundsPlaying


class Reports:
    """Sends news to the player, from any thread. A printed line that finds no room is dropped."""

    def __init__(self, pipe: TypedPipe[PerformerOrder]) -> None:
        self._pipe = pipe
        self._lock = threading.Lock()

    def send(self, news: PerformerNews) -> None:
        with self._lock:
            if isinstance(news, Printed) and not wait_for((), 0.0, writable=[self._pipe.fileno()]):
                return
            self._pipe.send(news)

    def copy_lines(self, stream: Iterable[str]) -> str:
        """Report every line of `stream` until it ends; return the last one."""
        last = ""
        for line in stream:
            last = line.strip()[:LINE_MAX_CHARS] or last
            self.send(Printed(line.rstrip()[:LINE_MAX_CHARS]))
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
            process = subprocess.Popen(  # noqa: S603, TID251  (a fixed program and the author's file)
                [*self._player, path],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
            )
        except OSError as error:
            self._reports.send(CueFailed(f"sound {path}: {error.strerror}"))
            return
        self._count(1)
        thread = threading.Thread(target=self._wait, args=(process, path), daemon=True)
        thread.start()
        self._threads.append(thread)

    def wait(self) -> None:
        for thread in self._threads:
            thread.join()

    def _wait(self, process: subprocess.Popen[str], path: str) -> None:  # noqa: TID251
        assert process.stdout is not None
        last = self._reports.copy_lines(process.stdout)
        if code := process.wait():
            name, program = Path(path).name, Path(str(process.args[0])).name  # type: ignore[index]
            why = f": {last}" if last else ""
            text = f"sound {name}: {program} ended with exit code {code}{why}"
            self._reports.send(CueFailed(text))
        self._count(-1)

    def _count(self, change: int) -> None:
        self._playing += change
        self._reports.send(SoundsPlaying(self._playing))


def main(pipe: MessagePipe, player_pid: str, guard_fd: str) -> int:
    """Carry out the orders until the pipe ends, then wait for the sounds."""
    _guard(int(player_pid), int(guard_fd))
    typed: TypedPipe[PerformerOrder] = TypedPipe(pipe, PerformerOrder)
    reports = Reports(typed)
    printed = _captured(reports)
    sys.dont_write_bytecode = True
    stage = _Functions(reports)
    try:
        serve(typed, stage.obey)
    except InputError as error:
        reports.send(Loaded(str(error)))
        return error.exit_code
    stage.sounds.wait()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os.dup2(0, 1)
    os.dup2(0, 2)
    printed.join(LOOK_S)  # A program that a function has started may still hold the pipe.
    return 0


class _Functions:
    """The functions and sounds of a show; carries out one order after the other."""

    def __init__(self, reports: Reports) -> None:
        self.sounds = Sounds(reports)
        self._reports = reports
        self._functions: dict[tuple[str, str], Callable[[float], Any]] = {}
        self._modules = ShowModules(())

    def obey(self, order: PerformerOrder) -> None:
        """Carry out an order; raises `InputError` for a function that cannot be loaded."""
        if isinstance(order, LoadFunctions):
            self._modules = ShowModules(order.modules)
            sys.meta_path.insert(0, self._modules)
            for run, folder in order.functions:
                self._reports.send(Loading(run))
                self._modules.enter(folder)
                self._functions[run, folder] = load_function(run)
            self._reports.send(Loaded())
            return
        if order.sound:
            self.sounds.play(order.sound)
        if order.run:
            self._modules.enter(order.folder)
            try:
                self._functions[order.run, order.folder](order.at_s)
            except (Exception, SystemExit) as error:  # noqa: BLE001  a function may raise anything
                where = f"run {order.run} at {order.at_s:g} s"
                text = f"{where}: {type(error).__name__}: {error}"[:LINE_MAX_CHARS]
                self._reports.send(CueFailed(text))
        self._reports.send(CueDone())


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


def _guard(player_pid: int, guard_fd: int) -> None:
    """Fork the process that ends all others of this group when the player is gone.

    A function may hang in code that lets no thread run, so a thread could not do this. `guard_fd`
    is the end of a pipe, of which the player holds the other one.
    """
    if not hasattr(os, "fork"):
        return
    if os.fork():
        os.close(guard_fd)
        return
    with contextlib.suppress(BaseException):
        os.closerange(0, guard_fd)
        os.closerange(guard_fd + 1, 64)
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        wait_for([guard_fd], math.inf)  # The player has closed its end, or was killed.
        end_s = time.monotonic() + 2.0 * CLOSE_S
        while _is_alive(player_pid) and time.monotonic() < end_s:
            wait_for((), LOOK_S)
    os.killpg(0, signal.SIGKILL)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True
