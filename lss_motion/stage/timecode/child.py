"""A process of this package with a pipe each way, that opens a device before it is used.

It writes `{"ready": text}` or `{"failed": text}` first, and ends when its standard input does.
`Child` is the end of who started it; `serve` and `write` are used in the process itself.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Callable

OPEN_S: Final = 10.0
"""The longest time that a device may take to open."""
READ_BYTES: Final = 65536
END_S: Final = 1.0


class Child:
    """One process. `take` and `send` never wait."""

    def __init__(self, module: str, argument: str, *, waits: bool = True) -> None:
        """Start it, and wait until it is ready; `text` is empty if it failed, or is not yet."""
        self.text = ""
        """What was opened, for a person."""
        self.problems: list[str] = []
        """Why it failed, not yet taken by `take_problems`."""
        self._rest = b""
        self._has_failed = False
        self._process: subprocess.Popen[bytes] | None = subprocess.Popen(  # noqa: S603
            # -P: no module of the current folder is imported in place of an installed one.
            [sys.executable, "-P", "-m", module, argument],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # Drivers print there whatever they try.
            start_new_session=True,  # Ctrl-C ends the player only; this ends with its pipe.
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._in_fd, self._out_fd = self._process.stdin.fileno(), self._process.stdout.fileno()
        os.set_blocking(self._in_fd, False)
        os.set_blocking(self._out_fd, False)
        end_s = time.monotonic() + OPEN_S
        while waits and not self.text and self._process is not None:
            left_s = max(end_s - time.monotonic(), 0.0)
            if not select.select([self._out_fd], [], [], left_s)[0]:
                self.problems.append(f"it does not open within {OPEN_S:g} s")
                self.close()
            self.take()
        if waits and not self.text:
            self.close()

    def filenos(self) -> list[int]:
        """Return what ends a wait."""
        return [] if self._process is None else [self._out_fd]

    def take(self) -> list[dict[str, Any]]:
        """Return what it has written since the last call."""
        if self._process is None:
            return []
        try:
            data = os.read(self._out_fd, READ_BYTES)
        except BlockingIOError:
            return []
        if not data:
            if not self._has_failed:
                self.problems.append("its process has ended")
            self.close()
            return []
        *lines, self._rest = (self._rest + data).split(b"\n")
        found: list[dict[str, Any]] = [json.loads(line) for line in lines]
        self.problems += [str(values["failed"]) for values in found if "failed" in values]
        self._has_failed = self._has_failed or bool(self.problems)
        self.text = next((str(values["ready"]) for values in found if "ready" in values), self.text)
        return found

    def take_problems(self) -> list[str]:
        """Return why it cannot go on, since the last call."""
        problems, self.problems = self.problems, []
        return problems

    def send(self, **command: object) -> bool:
        """Write a command; False if its pipe is full."""
        if self._process is None:
            return True
        try:
            # A pipe takes up to 4096 bytes as a whole or not at all.
            os.write(self._in_fd, json.dumps(command).encode() + b"\n")
        except BlockingIOError:
            return False
        except BrokenPipeError:
            self.take()
        return True

    def close(self) -> None:
        """End the process."""
        process, self._process = self._process, None
        if process is None:
            return
        assert process.stdin is not None
        assert process.stdout is not None
        with contextlib.suppress(OSError):
            process.stdin.close()
        try:
            process.wait(END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        process.stdout.close()


def serve(run: Callable[[str, int], None]) -> int:
    """Call `run` in the process of a `Child` with its argument and the pipe to `write` to."""
    out_fd = os.dup(1)
    os.dup2(2, 1)  # What libraries print must not come between the lines.
    run(sys.argv[1], out_fd)
    return 0


def write(out_fd: int, **values: object) -> None:
    """Write one line, which `Child.take` returns."""
    os.write(out_fd, json.dumps(values).encode() + b"\n")
