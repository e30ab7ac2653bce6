"""Errors for people: one line each on standard error, an exit code, never a traceback.

And lines for people while a robot moves: whatever becomes of the screen, it goes on.
"""

from __future__ import annotations

import contextlib
import io
import os
import re
import select
import sys
from collections import deque
from typing import TYPE_CHECKING, Final, TextIO

from lss_motion.errors import (
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    EXIT_OF_SIGNAL,
    InputError,
    LssMotionError,
)

if TYPE_CHECKING:
    from collections.abc import Callable

_PLACE = re.compile(r"\S+:\d+: ")
"""`file:line: ` at the start of a message says more than the name of the command."""
HELD_LINES_MAX: Final = 1000
"""What a screen that takes nothing is still shown when it does. Chosen: some pages."""


def put(text: str, stream: TextIO | None = None, *, end: str = "\n") -> None:
    """Print to `stream`, or standard output. Never raises `OSError`.

    A stream that cannot be written to (a full disk, a closed terminal) is given up: what else is
    printed there goes nowhere. Of standard output that is said on standard error.
    """
    stream = stream or sys.stdout
    try:
        print(text, end=end, file=stream, flush=True)
    except OSError as error:
        _give_up(stream)
        if stream is sys.stdout:
            reason = f"standard output cannot be written to ({error.strerror})"
            put(f"warning: {reason}; all goes on without it", sys.stderr)


def _give_up(stream: TextIO) -> None:
    """Let what else is printed to `stream` go nowhere."""
    with contextlib.suppress(OSError, ValueError):
        nowhere_fd = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere_fd, stream.fileno())
        os.close(nowhere_fd)


class Printer:
    """Standard output while a robot moves: nobody ever waits for it.

    Lines for which there is no room (a pager, Ctrl-S) come with a later one, or with `finish`.
    """

    def __init__(self) -> None:
        self._held: deque[str] = deque(maxlen=HELD_LINES_MAX)

    def say(self, text: str) -> None:
        self._held.append(text)
        while self._held and _has_room(sys.stdout):
            put(self._held.popleft())

    def finish(self) -> None:
        """Print all that is left; this may wait."""
        while self._held:
            put(self._held.popleft())


def ended_by(signal_number: int | None) -> int:
    """Return the exit code of a run that a person ended: by a signal, or else by a key."""
    return EXIT_INTERRUPTED if signal_number is None else EXIT_OF_SIGNAL + signal_number


def nothing(text: str) -> None:
    """Say nothing."""


def _has_room(stream: TextIO) -> bool:
    """Return whether a line can be written without waiting. A pipe takes 4096 bytes, or says no."""
    try:
        return bool(select.select([], [stream.fileno()], [], 0.0)[1])
    except (OSError, ValueError):  # Windows waits for sockets only.
        return True


def guarded(program: str, do: Callable[[], int]) -> int:
    """Run a command; turn what it raises on purpose into messages and an exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # "deg/s²" on a terminal that has no "²".
            stream.reconfigure(errors="replace")
    try:
        code = do()
        sys.stdout.flush()
    except LssMotionError as error:
        put("", end="")
        is_of_file = isinstance(error, InputError) and error.path is not None
        has_place = is_of_file or _PLACE.match(str(error)) is not None
        put(str(error) if has_place else f"{program}: {error}", sys.stderr)
        return error.exit_code
    except KeyboardInterrupt:
        put(f"{program}: interrupted", sys.stderr)
        return EXIT_INTERRUPTED
    except OSError as error:
        if error.filename is None:
            _give_up(sys.stdout)
        if isinstance(error, BrokenPipeError):  # `schema | head`: the reader has seen enough.
            return 0
        what = error.filename or "standard output"
        put(f"{program}: {what} cannot be used: {error.strerror or error}", sys.stderr)
        return EXIT_INPUT
    return code
