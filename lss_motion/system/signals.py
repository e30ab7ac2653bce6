"""Signals that end a program at any instant without a traceback: Ctrl-C, `kill`, a closed terminal.

`as_program` is what the entry points call before anything heavy is imported. Until a port is open,
a signal ends the process at once: nothing moves and nothing has to be given back, and an exception
in the middle of an import or of compiled code would be printed by Python or lost. Inside `raising`
(a port is open) it raises `EndedBySignal`, so that the safe state is sent and the ports are closed.
At the end of the program it is ignored: the exit code stands already. A run that is controlled by
keys collects signals itself (`cli.terminal`).
"""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import sys
import time
from typing import TYPE_CHECKING, Final, TextIO

from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, EXIT_INTERRUPTED, EXIT_OF_SIGNAL

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import FrameType

ENDING: Final = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
    if hasattr(signal, name)
)
"""Signals that end a run: Ctrl-C, `kill`, a closed terminal (a dropped ssh session), Ctrl-\\."""
PATIENCE: Final = 3
"""So many more signals are ignored while a program sends the safe state and closes its ports, which
takes a second or two; the next one ends it at once."""
AGAIN_S: Final = 0.01
"""So long after its exception was dropped, a signal is sent again. Chosen: a destructor is over."""


class EndedBySignal(KeyboardInterrupt):
    """A signal ended the program. Like Ctrl-C, it passes every `except Exception`."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


def exit_code(interrupt: KeyboardInterrupt) -> int:
    """Return the exit code of a program that this exception ended."""
    return (
        EXIT_OF_SIGNAL + interrupt.number
        if isinstance(interrupt, EndedBySignal)
        else EXIT_INTERRUPTED
    )


def as_program(name: str, do: Callable[[], int]) -> int:
    """Run a whole program; return its exit code. For entry points only: it changes the process."""
    _open_missing_streams()
    handler = _Handler(name)
    before, sys.unraisablehook = sys.unraisablehook, handler.dropped
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup, or a job behind `&`
            signal.signal(number, handler)
    try:
        from lss_motion.files.texts import show_standard_error  # a signal may come meanwhile

        show_standard_error()
        code = do()
    except SystemExit as ended:  # argparse: --help, --version, a wrong argument
        code = ended.code if isinstance(ended.code, int) else EXIT_FINISHED
    finally:
        for number in ENDING:
            signal.signal(number, signal.SIG_IGN)
        sys.unraisablehook = before
    is_written = _flush(name)
    return code if is_written else code or EXIT_INPUT


@contextlib.contextmanager
def raising() -> Iterator[None]:
    """Let signals raise `EndedBySignal` inside this block, if `as_program` handles them."""
    handlers = {
        handler for number in ENDING if isinstance(handler := signal.getsignal(number), _Handler)
    }
    for handler in handlers:
        handler.begin()
    try:
        yield
    finally:
        for handler in handlers:
            handler.end()


class _Handler:
    """Ends the process, or raises inside `raising`: the first time `EndedBySignal`, then not."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._depth = 0
        self._count = 0
        self._thread_id = _thread.get_ident()

    def begin(self) -> None:
        self._depth += 1

    def end(self) -> None:
        self._depth -= 1
        if not self._depth:
            self._count = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        self._count += 1
        if not self._depth or self._count > 1 + PATIENCE:
            with contextlib.suppress(OSError):
                os.write(2, f"\n{self._name}: interrupted\n".encode())
            os._exit(EXIT_OF_SIGNAL + number)
        if self._count == 1:
            raise EndedBySignal(number)

    def dropped(self, unraisable: sys.UnraisableHookArgs) -> None:
        """Send the signal again if Python dropped `EndedBySignal`; else print what it dropped.

        It does so in destructors and in callbacks of weak references, such as those of imports.
        """
        ended = unraisable.exc_value
        if isinstance(ended, EndedBySignal) and self._depth:
            self._count = 0
            _thread.start_new_thread(self._send_again, (ended.number,))
        else:
            sys.__unraisablehook__(unraisable)

    def _send_again(self, number: int) -> None:
        time.sleep(AGAIN_S)  # noqa: TID251 (a thread that does nothing else)
        if hasattr(signal, "pthread_kill"):
            signal.pthread_kill(self._thread_id, number)  # It interrupts a wait of that thread.
        else:
            signal.raise_signal(number)


def redirect_to_null(stream: TextIO) -> None:
    """Drop everything that is printed to `stream` from now on."""
    with contextlib.suppress(OSError, ValueError):
        null_fd = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null_fd, stream.fileno())
        os.close(null_fd)


def _open_missing_streams() -> None:
    """Open the null device for a standard stream that is closed (`>&-`, a service).

    Otherwise the first port or file that is opened would get its number.
    """
    for fd, stream in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, stream) is None:
            null_fd = os.open(os.devnull, os.O_RDWR)
            if null_fd != fd:
                os.dup2(null_fd, fd)
                os.close(null_fd)
            setattr(sys, stream, os.fdopen(fd, "r" if fd == 0 else "w"))


def _flush(name: str) -> bool:
    """Write out what was printed; return False if that fails. A reader may go away (`| head`).

    A stream that fails here would fail again at the very end, where Python prints that itself.
    """
    is_written = True
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (OSError, ValueError) as error:
            redirect_to_null(stream)
            if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
                is_written = False
                with contextlib.suppress(OSError):
                    os.write(2, f"{name}: output cannot be written: {error.strerror}\n".encode())
    return is_written
