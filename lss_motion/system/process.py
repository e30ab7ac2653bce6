"""A helper process: a module of this package in a process of its own, with a pipe of messages.

    child = ChildProcess("lss_motion.sound.device", receives=Report)
    child.send(Begin())              # never waits
    for report in child.receive():   # never waits
    child.receive_within(2.0)        # waits for so long at most
    code = child.end(1.5)            # no more messages; it ends within so long, or is killed

It gets ordinary priority where its starter has real-time priority (`real_time`), and lowers its own
where it may be late. It is a session of its own: Ctrl-C reaches the program only, which ends the
helper in its own time. If the program is killed, the system closes the pipe, and every helper ends
at the end of its pipe.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Generic

from lss_motion.system.closing import Closing
from lss_motion.system.messages import OUTBOX_MAX_BYTES, MessagePipe, Received, TypedPipe
from lss_motion.system.reactor import wait_for

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import msgspec

TOP: Final = str(Path(__file__).resolve().parents[2])
"""The folder of this package: the process finds the package where its starter has found it."""
BEGIN: Final = (
    "import sys; sys.path.insert(0, sys.argv.pop(1)); "
    "from lss_motion.system.reactor import begin; begin()"
)

KILL_S: Final = 2.0
"""The longest time that a killed process may take to end: a driver may hold it."""


class ChildProcess(Closing, Generic[Received]):
    """One process, in which `main(pipe, *words)` of `module` runs.

    Only `receive_within`, `wait` and `end` wait.
    """

    def __init__(
        self,
        module: str,
        *words: str,
        receives: Any = None,  # noqa: ANN401  (a union)
        inherits: Sequence[int] = (),
        is_quiet: bool = False,
        starts_programs: bool = False,
        outbox_max_bytes: int = OUTBOX_MAX_BYTES,
    ) -> None:
        """Start it. It inherits the file numbers `inherits`.

        `receives` is what it sends: see `TypedPipe`. `is_quiet` drops what it prints, as drivers do
        whatever they try. `starts_programs`: at its end, all programs that it has started are
        ended, too.
        """
        self._starts_programs = starts_programs
        self._is_closed = False
        own, other = socket.socketpair()
        is_windows = sys.platform == "win32"
        with other:
            self._process = subprocess.Popen(  # noqa: S603, TID251  (our own program, and the one place)
                # -P: no module of the current folder is imported in place of an installed one.
                [sys.executable, "-P", "-c", BEGIN, TOP, module, str(other.fileno()), *words],
                pass_fds=() if is_windows else (other.fileno(), *inherits),
                stdin=subprocess.PIPE if is_windows else subprocess.DEVNULL,
                stdout=subprocess.DEVNULL if is_quiet else None,
                stderr=subprocess.DEVNULL if is_quiet else None,
                start_new_session=True,
            )
            if sys.platform == "win32":
                assert self._process.stdin is not None
                with self._process.stdin as stdin:
                    stdin.write(other.share(self._process.pid))
        own.setblocking(False)  # noqa: FBT003
        pipe = MessagePipe(own, outbox_max_bytes=outbox_max_bytes)
        self._typed: TypedPipe[Received] = TypedPipe(pipe, receives)

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def pipe(self) -> MessagePipe:
        """The pipe, for messages of other kinds."""
        return self._typed.pipe

    @property
    def has_ended(self) -> bool:
        """Whether its pipe has ended, and all that it sent was returned."""
        return self._typed.has_ended

    def fileno(self) -> int:
        """Return what can be read when messages have arrived."""
        return self._typed.fileno()

    def exit_code(self) -> int | None:
        """Return how the process has ended; None: it has not."""
        return self._process.poll()

    def send(self, message: msgspec.Struct) -> bool:
        """Send what must arrive; return False if too much waits already, or it is gone."""
        return self._typed.send(message)

    def offer(self, message: msgspec.Struct) -> bool:
        """Send what is worthless later; return False if nothing was sent."""
        return self._typed.offer(message)

    def send_data(self, data: bytes, *, is_last: bool = False) -> bool:
        """Send bytes that must arrive; the last ones are kept whatever waits already."""
        return self._typed.send_data(data, is_last=is_last)

    def send_object(self, value: object) -> bool:
        """Send any value that can be pickled, which must arrive."""
        return self._typed.send_object(value)

    def send_fileno(self, message: msgspec.Struct, fileno: int) -> bool:
        """Send a message and a file number with it; return False if it does not take both now."""
        return self._typed.send_fileno(message, fileno)

    def receive(self) -> list[Received]:
        """Return what has arrived, oldest first; send what is kept."""
        self.pipe.flush()
        return self._typed.receive()

    def receive_within(self, left_s: float) -> list[Received]:
        """Return what arrives next; nothing after `left_s`, or if it has ended."""
        end_s = time.monotonic() + left_s
        while not self.has_ended and (left_s := end_s - time.monotonic()) > 0.0:
            writable = [self.fileno()] if self.pipe.is_full else []
            wait_for([self.fileno()], left_s, writable=writable)
            if arrived := self.receive():
                return arrived
        return []

    def wait(self, left_s: float | None = None) -> int | None:
        """Wait until the process has ended, for `left_s` at most; return as `exit_code` does."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(left_s)
        return self._process.poll()

    def end(self, ask_s: float, take: Callable[[Received], None] = lambda _: None) -> int | None:
        """Let it end, and kill it after `ask_s`; return its exit code, None if it was killed.

        What is kept for it is sent first, and `take` gets what it still sends. Another call changes
        nothing.
        """
        if self._is_closed:
            return self._process.returncode
        self._is_closed = True
        end_s = time.monotonic() + ask_s
        is_told = False
        while not self.has_ended and (left_s := end_s - time.monotonic()) > 0.0:
            if not is_told and not self.pipe.is_full:
                is_told = True
                self.pipe.finish()
            writable = [self.fileno()] if self.pipe.is_full else []
            wait_for([self.fileno()], left_s, writable=writable)
            for message in self.receive():
                take(message)
        code = self.wait(max(end_s - time.monotonic(), 0.0))
        if code is None or self._starts_programs:
            self._kill()
        for message in self.receive():
            take(message)
        self._typed.close()
        return code

    def close(self) -> None:
        """Kill it, whatever it does."""
        self.end(0.0)

    def _kill(self) -> None:
        if hasattr(os, "killpg"):
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
        else:
            self._process.kill()
        self.wait(KILL_S)
