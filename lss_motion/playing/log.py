r"""A log of every byte in both directions with its instant, and of all events of a run.

    # lss_motion log 2
    # played: {"file": "/home/me/show.yaml", "speed": 1.0}
    0.001234567 main > #5QD\r
    0.004100210 main < *5QD132\r
    0.004180007 - .
    1.203004100 - = rate 0.5
    1.203104100 - ! MarkPassed(label='up', show_s=1.0)
    1.500000000 main ~ lost port /dev/ttyUSB0: the device is gone
    1.900000000 main ~ found
    1.203104100 - #

Times are seconds since the run began. The sign gives the kind of a line:

`>` sent to the servos, with the instant at which the bytes were due to leave; `<` received. One
line holds what was written or read at once, carriage returns as `\r`, other bytes as `\xNN`.
`.` the player had nothing to send. `=` input from a person. `!` an event. `~` a port: `lost` with
the reason, or `found`; `safe`: the next bytes are those after an error. `?` this many lines were
lost, because the disk was too slow. `#` the end; a log without it was cut off.

These lines are enough to repeat the decisions of the player (`playing.replay`).

The file is written by a process of its own, for which the player never waits and which survives
when the player is killed (`main`).
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.files.output import write_output
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve
from lss_motion.system.real_time import lower_priority
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from types import TracebackType

    from lss_motion.playing.player.events import Event
    from lss_motion.system.messages import MessagePipe

FIRST_LINE: Final = "# lss_motion log 2"
HELD_MAX_BYTES: Final = 4 * 1024 * 1024
"""The most that is kept for the writing process: ten seconds of a busy bus."""
PORTION_BYTES: Final = 4096
FLUSH_NS: Final = 100 * NS_PER_MS
"""Older lines than this have been handed to the writing process."""
CLOSE_S: Final = 10.0


class LogFailed(Struct, frozen=True):
    """Why the writing process could not write everything."""

    text: str


class ByteLog:
    """A `Tap` that writes to a file; use it as a context manager.

    `may_wait` is for virtual time, in which the disk is always too slow. Raises `InputError` for
    a file that cannot be written.
    """

    def __init__(
        self, path: Path, *, played: Mapping[str, Any] | None = None, may_wait: bool = False
    ) -> None:
        self._start_ns = self._flushed_ns = self._last_ns = 0
        self._lost = 0
        self.problem = ""
        """Once closed: why the file is not complete; empty if it is."""
        self._path = path
        head = FIRST_LINE + "\n" + (f"# played: {json.dumps(played)}\n" if played else "")
        write_output(path, head)
        self._held = bytearray()
        self._child: ChildProcess[LogFailed] = ChildProcess(
            __name__, str(path), receives=LogFailed, outbox_max_bytes=HELD_MAX_BYTES
        )
        self._child.pipe.set_blocking(is_blocking=may_wait)

    def started(self, start_ns: int) -> ByteLog:
        """Count the seconds from `start_ns`."""
        self._start_ns = self._flushed_ns = self._last_ns = start_ns
        return self

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        self._bytes(bus, ">", data, now_ns)

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        self._bytes(bus, "<", data, now_ns)

    def turned(self, now_ns: int) -> None:
        self._line("- .", now_ns)

    def happened(self, event: Event, now_ns: int) -> None:
        self._line(f"- ! {_escaped(repr(event))}", now_ns)

    def noted(self, bus: str, text: str, now_ns: int) -> None:
        self._line(f"{bus} ~ {_escaped(text)}", now_ns)

    def requested(self, text: str, now_ns: int) -> None:
        """Note input from a person: `go`, `rate 0.5`, `stop`, `abort`."""
        self._line(f"- = {text}", now_ns)

    def _bytes(self, bus: str, way: str, data: bytes, now_ns: int) -> None:
        self._line(f"{bus} {way} {_escaped(data.decode('latin-1'))}", now_ns)

    def _line(self, text: str, now_ns: int) -> None:
        self._last_ns = now_ns
        if len(self._held) >= PORTION_BYTES and not self._hand_over():
            self._lost += 1
            return
        seconds, left_ns = divmod(now_ns - self._start_ns, NS_PER_S)
        if self._lost:
            text = f"- ? {self._lost} lines lost\n{seconds}.{left_ns:09d} {text}"
            self._lost = 0
        self._held += f"{seconds}.{left_ns:09d} {text}\n".encode("ascii")
        if len(self._held) >= PORTION_BYTES or now_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = now_ns
            self._hand_over()

    def _hand_over(self) -> bool:
        """Give the writing process what is held; return whether it has room for that."""
        if not self._child.send_data(bytes(self._held)):
            return False
        self._held.clear()
        return True

    @contextlib.contextmanager
    def reporting_to(self, problems: list[str]) -> Iterator[ByteLog]:
        """Close the log at the end of the block; add why it is not complete, if it is not."""
        try:
            with self:
                yield self
        finally:
            if self.problem:
                problems.append(self.problem)

    def __enter__(self) -> ByteLog:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Wait until everything is in the file, for `CLOSE_S` at most."""
        self._child.pipe.set_blocking(is_blocking=False)
        self._line("- #", self._last_ns)
        self._child.send_data(bytes(self._held), is_last=True)
        reasons: list[LogFailed] = []
        code = self._child.end(CLOSE_S, reasons.append)
        if code != 0:
            why = "the disk is too slow" if code is None else "the process that writes it has ended"
            why = next((one.text for one in reasons), why)
            self.problem = f"{self._path}: the log is not complete: {why}"


def _escaped(text: str) -> str:
    return text.encode("unicode_escape").decode("ascii")


def main(pipe: MessagePipe, path: str) -> int:
    """Append what arrives to a file until the pipe ends.

    When the file takes no more, report the reason and drop the rest: a log with a gap would
    mislead.
    """
    lower_priority()
    typed: TypedPipe[bytes] = TypedPipe(pipe, Any)
    problem: OSError | None = None
    try:
        with Path(path).open("ab", buffering=0) as file:

            def append(chunk: bytes) -> None:
                while chunk:
                    chunk = chunk[file.write(chunk) :]

            serve(typed, append)
    except OSError as error:
        problem = error
        serve(typed, lambda _: None)
    if problem is None:
        return 0
    typed.send(LogFailed(text=problem.strerror or str(problem)))
    return 1
