r"""A log of every byte in both directions with its instant, and of all events of a run.

    {"format":"lss_motion log","version":3,"played":{"file":"/home/me/show.yaml","speed":1.0}}
    ["sent",1234567,"main","#5QD\r"]
    ["received",4100210,"main","*5QD132\r"]
    ["turned",4180007]
    ["requested",1203004100,{"name":"rate","values":[0.5]}]
    ["happened",1203104100,{"type":"MarkPassed","label":"up","show_s":1.0}]
    ["port",1500000000,"main","lost","/dev/ttyUSB0: the device is gone"]
    ["port",1900000000,"main","found",""]
    ["ended",1903104100]

Each line is JSON. The first one says what was played. The others begin with their kind and the
nanoseconds since the run began:

`sent` to the servos, with the instant at which the bytes were due to leave, and `received`: the
bus, and what was written or read at once, one character a byte (Latin-1). `turned`: the player had
nothing to send. `requested` by a person, or by the leader that the show follows; `happened`: an
event (`playing.player.events`). `port`: it is `lost`, with the reason, or `found`; `safe`: the next
bytes are those after an error. `skipped`: this many lines are missing, because the disk was too
slow. `ended`: a log without it was cut off.

These lines are enough to repeat the decisions of the player (`playing.replay`). `log_schema` is
the JSON Schema of a line.

The file is written by a process of its own, for which the player never waits and which survives
when the player is killed (`main`).
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping  # noqa: TC003  (decoded by type)
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import msgspec
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.output import write_output
from lss_motion.files.source import read_text
from lss_motion.playing.player.events import Event, PlayerRequest  # noqa: TC001  (decoded by type)
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve
from lss_motion.system.real_time import lower_priority
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.system.messages import MessagePipe

VERSION: Final = 3
LOG_MAX_BYTES: Final = 500_000_000
"""The most that is read of a log. A show of 18 joints writes about 100 MB an hour."""
HELD_MAX_BYTES: Final = 4 * 1024 * 1024
"""The most that is kept for the writing process: ten seconds of a busy bus."""
PORTION_BYTES: Final = 4096
FLUSH_NS: Final = 100 * NS_PER_MS
"""Older lines than this have been handed to the writing process."""
CLOSE_S: Final = 10.0

PortState = Literal["lost", "found", "safe"]


class PlayedShow(Struct, frozen=True, kw_only=True):
    """What `lss-motion replay` needs to make the same player again."""

    file: str
    robot: str | None = None
    speed: float = 1.0
    loop: int | None = None
    start_s: float | None = None
    has_feedback: bool = True
    is_forced: bool = False
    port: str | None = None
    is_following: bool = False
    must_ask: bool = False
    limits: Mapping[str, Mapping[str, float]] = {}
    """By joint and name: what the servos answered where the robot file leaves it to them."""


class LogHead(Struct, frozen=True, omit_defaults=True, tag_field="format", tag="lss_motion log"):
    """The first line of a log. `played` is None where the show was one of many."""

    version: int
    played: PlayedShow | None = None


class _Line(Struct, frozen=True, array_like=True, gc=False):
    at_ns: int
    """Since the run began."""


class _BytesLine(_Line, frozen=True, array_like=True, gc=False):
    bus: str
    text: str
    """One character a byte (Latin-1)."""

    @property
    def data(self) -> bytes:
        return self.text.encode("latin-1")


class SentLine(_BytesLine, frozen=True, array_like=True, gc=False, tag="sent"):
    """Bytes that were due to leave for a bus at this instant."""


class ReceivedLine(_BytesLine, frozen=True, array_like=True, gc=False, tag="received"):
    """Bytes that were read from a bus at once."""


class TurnedLine(_Line, frozen=True, array_like=True, gc=False, tag="turned"):
    """A turn of the loop in which the player had nothing to send."""


class HappenedLine(_Line, frozen=True, array_like=True, gc=False, tag="happened"):
    """An event of the player."""

    event: Event


class RequestedLine(_Line, frozen=True, array_like=True, gc=False, tag="requested"):
    """What the player was asked for."""

    request: PlayerRequest


class PortLine(_Line, frozen=True, array_like=True, gc=False, tag="port"):
    """A port is lost or found; `safe`: the next bytes of its bus are those after an error."""

    bus: str
    state: PortState
    reason: str = ""


class SkippedLine(_Line, frozen=True, array_like=True, gc=False, tag="skipped"):
    """So many lines are missing here, because the disk was too slow."""

    count: int


class EndedLine(_Line, frozen=True, array_like=True, gc=False, tag="ended"):
    """The log is whole."""


LogLine = (
    SentLine
    | ReceivedLine
    | TurnedLine
    | HappenedLine
    | RequestedLine
    | PortLine
    | SkippedLine
    | EndedLine
)

_ENCODER: Final = msgspec.json.Encoder(enc_hook=float)
"""A number of numpy becomes one of JSON."""


def log_schema() -> dict[str, Any]:
    """Return the JSON Schema of a line of a log."""
    head_and_line, parts = msgspec.json.schema_components(
        (LogHead, LogLine), ref_template="#/$defs/{name}"
    )
    return {"anyOf": head_and_line, "$defs": parts}


def encode_line(line: LogHead | LogLine) -> bytes:
    """Return a line of a log with its end."""
    return _ENCODER.encode(line) + b"\n"


class LogFailed(Struct, frozen=True):
    """Why the writing process could not write everything."""

    text: str


class LineTap:
    """A `Tap` that makes lines of a log; `started` says from when their instants count."""

    def __init__(self) -> None:
        self._start_ns = 0

    def add(self, line: LogLine) -> None:
        raise NotImplementedError

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        self.add(SentLine(now_ns - self._start_ns, bus, data.decode("latin-1")))

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        self.add(ReceivedLine(now_ns - self._start_ns, bus, data.decode("latin-1")))

    def turned(self, now_ns: int) -> None:
        self.add(TurnedLine(now_ns - self._start_ns))

    def happened(self, event: Event, now_ns: int) -> None:
        self.add(HappenedLine(now_ns - self._start_ns, event))

    def requested(self, request: PlayerRequest, now_ns: int) -> None:
        self.add(RequestedLine(now_ns - self._start_ns, request))

    def noted(self, bus: str, state: PortState, now_ns: int, reason: str = "") -> None:
        self.add(PortLine(now_ns - self._start_ns, bus, state, reason))


class ByteLog(LineTap):
    """A `Tap` that writes to a file; use it as a context manager.

    `may_wait` is for virtual time, in which the disk is always too slow. Raises `InputError` for
    a file that cannot be written.
    """

    def __init__(
        self, path: Path, *, played: PlayedShow | None = None, may_wait: bool = False
    ) -> None:
        super().__init__()
        self._flushed_ns = self._last_ns = 0
        self._lost = 0
        self.problem = ""
        """Once closed: why the file is not complete; empty if it is."""
        self._path = path
        write_output(path, encode_line(LogHead(VERSION, played)))
        self._held = bytearray()
        self._child: ChildProcess[LogFailed] = ChildProcess(
            __name__, str(path), receives=LogFailed, outbox_max_bytes=HELD_MAX_BYTES
        )
        self._child.pipe.set_blocking(is_blocking=may_wait)

    def started(self, start_ns: int) -> ByteLog:
        """Count the time from `start_ns`."""
        self._start_ns = start_ns
        return self

    def add(self, line: LogLine) -> None:
        """Keep a line, and hand over what the writing process takes."""
        self._last_ns = line.at_ns
        if len(self._held) >= PORTION_BYTES and not self._hand_over():
            self._lost += 1
            return
        if self._lost:
            self._held += encode_line(SkippedLine(line.at_ns, self._lost))
            self._lost = 0
        _ENCODER.encode_into(line, self._held, -1)
        self._held += b"\n"
        if len(self._held) >= PORTION_BYTES or line.at_ns - self._flushed_ns >= FLUSH_NS:
            self._flushed_ns = line.at_ns
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

    def __exit__(self, *_error: object) -> None:
        """Wait until everything is in the file, for `CLOSE_S` at most."""
        self._child.pipe.set_blocking(is_blocking=False)
        self.add(EndedLine(self._last_ns))
        self._child.send_data(bytes(self._held), is_last=True)
        reasons: list[LogFailed] = []
        code = self._child.end(CLOSE_S, reasons.append)
        if code != 0:
            why = "the disk is too slow" if code is None else "the process that writes it has ended"
            why = next((one.text for one in reasons), why)
            self.problem = f"{self._path}: the log is not complete: {why}"


class Log(Struct, frozen=True):
    """A log that was read. `lines[0]` is line 2 of the file."""

    path: Path
    played: PlayedShow | None
    lines: list[LogLine]

    @property
    def is_whole(self) -> bool:
        return bool(self.lines) and isinstance(self.lines[-1], EndedLine)


_TEXT_FORM: Final = re.compile(r"# lss_motion log (\d{1,4})")
"""The first line of a log before version 3."""


def read_log(path: Path) -> Log:
    """Return the content of a log. Raises `InputError` for another file.

    A last line without its end is dropped: a log may end in a crash.
    """
    first, *rest = read_text(path, LOG_MAX_BYTES).split("\n")
    head = _head(first, path)
    decode = msgspec.json.Decoder(LogLine).decode
    lines: list[LogLine] = []
    for number, line in enumerate(rest[:-1], start=2):
        try:
            lines.append(decode(line))
        except msgspec.DecodeError as error:
            text = f"{line[:60]!r} is no line of a log: {error}"
            raise InputError(text, path=path, line=number) from error
    return Log(path, head.played, lines)


def _head(first: str, path: Path) -> LogHead:
    """Return the head of a log; refuse another file, and a log of another version."""
    if match := _TEXT_FORM.match(first):
        head = LogHead(int(match[1]))
    else:
        try:
            head = msgspec.json.decode(first, type=LogHead)
        except msgspec.DecodeError as error:
            raise InputError(
                'not a log: the first line must be `{"format":"lss_motion log",…}`: '
                f"{error}; `lss-play SHOW --log F` writes one",
                path=path,
                line=1,
            ) from error
    if head.version != VERSION:
        raise InputError(
            f"a log of version {head.version}; this lss-motion reads version {VERSION}: read it "
            "with the lss-motion that wrote it, or play the show again with --log",
            path=path,
            line=1,
        )
    return head


def main(pipe: MessagePipe, path: str) -> int:
    """Append what arrives to a file until the pipe ends.

    When the file takes no more, report the reason and drop the rest: a log with a gap would
    mislead.
    """
    lower_priority()
    typed: TypedPipe[bytes] = TypedPipe(pipe)
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
