"""The server's end of the planner process: the latest request wins.

Requests are sent at once; the planner takes the newest that has arrived. One that is busy for
`PATIENCE_S` with a request that is no longer wanted is killed and started again: its answer would
only delay the one that is. A planner that stands still or is killed delays nothing else.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import pickle
import socket
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.studio.planner import Reply, Request
from lss_motion.system.messages import Kind, MessagePipe, PipeClosedError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

PATIENCE_S: Final = 2.0
"""Starting a planner takes a second of processor time (measured: 0.9 s)."""
FAILURES_MAX: Final = 2
"""A request at which the planner ends so often is not tried again."""
DIED: Final = (
    "the planner process has ended while it worked on this file; save the file to try again"
)


def start_module(
    module: str, filenos: Sequence[int], stdin: int | None = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start a module of ours as a process that inherits these file numbers as its arguments."""
    top = str(Path(__file__).resolve().parents[2])
    paths = [top, *filter(None, [os.environ.get("PYTHONPATH")])]
    return subprocess.Popen(  # noqa: S603  (our own program)
        # -P: no module of the current folder is imported in place of an installed one.
        [sys.executable, "-P", "-m", module, *map(str, filenos)],
        pass_fds=list(filenos),
        stdin=stdin,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        start_new_session=True,  # Ctrl-C reaches the server only.
    )


class Planner:
    """The planner process. `on_reply` gets the reply to the newest request, and no other."""

    def __init__(self, on_reply: Callable[[Reply], None]) -> None:
        self._on_reply = on_reply
        self._process: subprocess.Popen[bytes] | None = None
        self._link: MessagePipe | None = None
        self._wanted: Request | None = None
        """The newest request, until it is answered."""
        self._number = self._failures = 0
        self._impatience: asyncio.TimerHandle | None = None

    @property
    def is_busy(self) -> bool:
        """Whether a request has no answer yet."""
        return self._wanted is not None

    @property
    def pid(self) -> int | None:
        """The planner process, where it runs."""
        return None if self._process is None else self._process.pid

    def ask(self, request: Request) -> None:
        """Plan this; answers to earlier requests are dropped."""
        is_stale = self._wanted is not None
        self._number += 1
        self._failures = 0
        self._wanted = replace(request, number=self._number)
        self._send()
        if is_stale and self._impatience is None:
            loop = asyncio.get_running_loop()
            self._impatience = loop.call_later(PATIENCE_S, self._lose_patience)

    def close(self) -> None:
        """End the planner process."""
        self._wanted = None
        self._end()

    def _send(self) -> None:
        if self._link is None:
            self._start()
        assert self._link is not None
        self._link.send(Kind.OBJECT, pickle.dumps(self._wanted))

    def _start(self) -> None:
        own, other = socket.socketpair()
        own.setblocking(False)  # noqa: FBT003
        with other:
            self._process = start_module("lss_motion.studio.planner", [other.fileno()])
        self._link = MessagePipe(own)
        asyncio.get_running_loop().add_reader(own.fileno(), self._read)

    def _read(self) -> None:
        assert self._link is not None
        try:
            arrived = self._link.receive()
        except PipeClosedError:
            self._end()
            self._after_death()
            return
        for _, content in arrived:
            reply = pickle.loads(content)  # noqa: S301  (from our own process)
            self._be_patient()
            if self._wanted is not None and reply.number == self._wanted.number:
                self._wanted = None
                self._on_reply(reply)

    def _after_death(self) -> None:
        """Try once more what the planner worked on when it ended, then give up."""
        if self._wanted is None:
            return
        self._failures += 1
        if self._failures < FAILURES_MAX:
            self._send()
            return
        request, self._wanted = self._wanted, None
        problem = (str(request.path), None, DIED)
        self._on_reply(Reply(number=request.number, problems=(problem,), files=(request.path,)))

    def _lose_patience(self) -> None:
        """Start another planner if this one still works on what is not wanted."""
        self._impatience = None
        if self._wanted is not None:
            self._end()
            self._send()

    def _be_patient(self) -> None:
        if self._impatience is not None:
            self._impatience.cancel()
            self._impatience = None

    def _end(self) -> None:
        self._be_patient()
        link, self._link = self._link, None
        process, self._process = self._process, None
        if link is not None:
            asyncio.get_running_loop().remove_reader(link.fileno())
            link.close()
        if process is not None:
            process.kill()  # It owns nothing that must be given back, and may stand still.
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(PATIENCE_S)
