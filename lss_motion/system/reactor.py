"""What waits: one call for file numbers and time, and the loop of every helper process.

    ready = wait_for([port.fileno()], 0.02)
    serve(pipe, obey, turn)

The player's loop (`playing.runner`) waits through its clock, which waits here in real time.

A helper process begins with `begin`. Signals that end a program do nothing there: a helper ends
when its pipe does, after its last work, and a service manager that signals a whole group must not
take the log from a player that still sends its last bytes.
"""

from __future__ import annotations

import importlib
import math
import select
import signal
import sys
import time
from typing import TYPE_CHECKING, Final, TypeVar

if TYPE_CHECKING:
    import socket
    from collections.abc import Callable, Collection
    from types import FrameType

    from lss_motion.system.messages import TypedPipe

Message = TypeVar("Message")

ENDING: Final = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that end a program, but not its helpers."""


def wait_for(
    readable: Collection[int], left_s: float, *, writable: Collection[int] = ()
) -> list[int]:
    """Wait until one of the file numbers is ready, for `left_s` at most; return those that are."""
    if sys.platform == "win32" and not readable and not writable:
        time.sleep(left_s)  # noqa: TID251  (Windows refuses a select without sockets.)
        return []
    timeout_s = None if left_s == math.inf else left_s
    can_read, can_write, _ = select.select(readable, writable, (), timeout_s)  # noqa: TID251
    return [*can_read, *can_write]


def serve(
    pipe: TypedPipe[Message],
    obey: Callable[[Message], None],
    turn: Callable[[], float | None] = lambda: math.inf,
) -> None:
    """Call `obey` with each message, and `turn` before each wait, until the other end closes.

    `turn` returns how long the next wait may take, in seconds; None: this is finished.
    """
    while (left_s := turn()) is not None and not pipe.has_ended:
        if wait_for([pipe.fileno()], left_s):
            for message in pipe.receive():
                obey(message)


def begin() -> None:
    """Run the module that the arguments name in this process, and end it.

    The arguments are the module, the file number of this end of the pipe, and words for
    `main(pipe, *words)` of the module, whose result is the exit code.
    """
    from lss_motion.files.texts import show_standard_error
    from lss_motion.system.messages import MessagePipe  # programs without helpers do without

    show_standard_error()
    for number in ENDING:
        signal.signal(number, _do_nothing)
    module_name, fileno, *words = sys.argv[1:]
    pipe = MessagePipe(_own_end(fileno))
    sys.exit(importlib.import_module(module_name).main(pipe, *words))


def _own_end(fileno: str) -> socket.socket:
    """Return this end of the pipe. On Windows, standard input describes it."""
    import socket

    if sys.platform == "win32":
        return socket.fromshare(sys.stdin.buffer.read())
    end = socket.socket(fileno=int(fileno))
    end.set_inheritable(False)  # For programs that are started here.
    return end


def _do_nothing(_number: int, _frame: FrameType | None) -> None:
    """Take a signal. A handler, unlike SIG_IGN, is not inherited by programs."""
