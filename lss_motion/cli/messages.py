"""Text for people: errors as one line and an exit code, and lines while a robot moves.

A command raises `LssMotionError` for everything that a user can cause; `guarded` prints it without
a traceback. `say` prints, and nothing else does: no text from a file, a servo or another computer
reaches the terminal as it came. No output can stop or delay a moving robot: `put` never raises,
`Printer` never waits.
"""

from __future__ import annotations

import io
import re
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
from lss_motion.files.texts import ShownStream, escaped
from lss_motion.system.reactor import wait_for
from lss_motion.system.signals import exit_code, redirect_to_null

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.text import Text

_PLACE: Final = re.compile(r"\S+:\d+: ")
"""`file:line: ` at the start of a message: it replaces the name of the program."""
HELD_LINES_MAX: Final = 1000
"""The newest lines that are kept while standard output is blocked. Chosen: some pages."""


def guarded(program: str, do: Callable[[], int]) -> int:
    """Run a command; print the errors that it raises on purpose; return its exit code."""
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
    except KeyboardInterrupt as interrupt:
        put(f"{program}: interrupted", sys.stderr)
        return exit_code(interrupt)
    except OSError as error:
        if error.filename is None:
            redirect_to_null(sys.stdout)
        if isinstance(error, BrokenPipeError):  # `schema | head` closes the pipe early.
            return 0
        what = error.filename or "standard output"
        put(f"{program}: {what} cannot be used: {error.strerror or error}", sys.stderr)
        return EXIT_INPUT
    return code


def failures(write: Callable[..., None], *arguments: object) -> list[str]:
    """Call a function that writes a file; return why it could not, or nothing.

    For what is written after a robot has moved: the rest must still be printed and written.
    """
    try:
        write(*arguments)
    except InputError as error:
        return [str(error)]
    return []


def ended_by(signal_number: int | None) -> int:
    """Return the exit code of a run that a signal ended, or a key (None)."""
    return EXIT_INTERRUPTED if signal_number is None else EXIT_OF_SIGNAL + signal_number


def say(text: str, stream: TextIO | None = None, *, end: str = "\n", control: str = "") -> None:
    """Print to `stream`, or to standard output; raises `OSError` if it cannot be written.

    What would steer a terminal is printed as an escape, except `control`, which comes first.
    """
    stream = stream or sys.stdout
    if control:
        (stream.steer if isinstance(stream, ShownStream) else stream.write)(control)
    print(escaped(text), end=end, file=stream, flush=True)


def put(text: str, stream: TextIO | None = None, *, end: str = "\n", control: str = "") -> None:
    """Print as `say`, while a robot may move: never raises `OSError`.

    A stream that fails (a full disk, a closed terminal) is redirected to the null device. If it is
    standard output, a warning goes to standard error.
    """
    stream = stream or sys.stdout
    try:
        say(text, stream, end=end, control=control)
    except OSError as error:
        redirect_to_null(stream)
        if stream is sys.stdout:
            put(
                f"warning: standard output cannot be written ({error.strerror}); "
                "the run goes on without it",
                sys.stderr,
            )


def shown(text: str, style: str = "") -> Text:
    """Return the same text for rich, which draws tables and displays."""
    from rich.text import Text

    return Text(escaped(text), style)


def agrees(question: str, stream: TextIO | None = None) -> bool:
    """Ask a person; return whether the line that is typed says yes."""
    put(f"{question} [y/N] ", stream, end="")
    return sys.stdin.readline().strip().lower() in {"y", "yes"}


class StepLine:
    """The present step on standard error, where that is a terminal, in place of the one before."""

    def __init__(self) -> None:
        self._is_shown = sys.stderr.isatty()
        self._text = ""

    def show(self, text: str) -> None:
        """Show a step; an empty one clears the line."""
        if self._is_shown and text != self._text:
            self._text = text
            put(text, sys.stderr, end="", control="\r\x1b[K")


def discard(text: str) -> None:
    """Print nothing: the line printer of a quiet run."""


class Printer:
    """Standard output while a robot moves; it never waits.

    Lines that find no room (a pager, Ctrl-S) are printed with a later line or by `finish`.
    """

    def __init__(self) -> None:
        self._held: deque[str] = deque(maxlen=HELD_LINES_MAX)

    def print(self, text: str) -> None:
        """Print the lines held so far and this one, as far as there is room."""
        self._held.append(text)
        while self._held and _has_room(sys.stdout):
            put(self._held.popleft())

    def finish(self) -> None:
        """Print all lines that are left; this may wait."""
        while self._held:
            put(self._held.popleft())


def _has_room(stream: TextIO) -> bool:
    """Return whether a line can be written without waiting; a writable pipe takes 4096 bytes."""
    try:
        return bool(wait_for((), 0.0, writable=[stream.fileno()]))
    except (OSError, ValueError):  # Windows waits for sockets only.
        return True
