"""What is kept of each night: events as JSON lines with the time of day, and bytes at a fault.

    {"t": "2026-10-30T21:14:03.120+01:00", "kind": "fired", "cue": "door", "text": "cue door: …"}

A night is a few hundred kilobytes. Files begin anew each day and at a bounded size, and the oldest
are deleted, so that the folder has at most `max_bytes`. A disk that is full loses lines, not
shows; the first line after it says how many.

`Writer` writes. `StageLog` hands records to a process of its own (`main`), for which the player
never waits; in virtual time it writes itself. `Ring` keeps the last seconds of bytes in memory; at
a fault they become a file that `lss-motion replay` shows.
"""

from __future__ import annotations

import json
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.playing.log import VERSION, LineTap, LogHead, encode_line
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve
from lss_motion.system.real_time import lower_priority
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.playing.log import LogLine
    from lss_motion.stage.model import LogRule
    from lss_motion.system.messages import MessagePipe

PREFIX: Final = "stage-"
FAULT_PREFIX: Final = "fault-"
FILES_LEAST: Final = 8
"""The folder holds at least so many files, so that deleting the oldest loses an eighth at most."""

HELD_MAX_BYTES: Final = 4 * 1024 * 1024
"""The most that is kept for the writing process: hours of events, or two rings."""

RING_MAX_BYTES: Final = 1024 * 1024
"""Chosen: two minutes of three busy joints; of more joints, fewer seconds."""

CLOSE_S: Final = 10.0


class Record(Struct, frozen=True):
    """What is handed to the process that writes: a line of JSON, or a file of its own."""

    values: dict[str, Any]


class Writer:
    """Writes lines to the files of a folder; it survives a full disk."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._path: Path | None = None
        self._size = 0
        self.lost = 0
        """Lines that the disk did not take since the last that it took."""

    def write(self, record: Mapping[str, Any]) -> None:
        """Append a record to the file of its day. One with `dump` becomes a file of its own."""
        try:
            if "dump" in record:
                self._dump(str(record["dump"]), str(record["content"]))
                return
            if self.lost:
                text = f"{self.lost} lines were lost: the disk took none"
                self._append({"t": record["t"], "kind": "lost", "text": text, "count": self.lost})
                self.lost = 0
            self._append(record)
        except OSError:
            self.lost += 1
            self._path = None

    def _append(self, record: Mapping[str, Any]) -> None:
        data = (json.dumps(record, ensure_ascii=False) + "\n").encode()
        day = f"{PREFIX}{record['t'][:10]}"
        limit = self._max_bytes // FILES_LEAST
        if (
            self._path is None
            or not self._path.name.startswith(day)
            or self._size + len(data) > limit
        ):
            self._begin(day)
        assert self._path is not None
        with self._path.open("ab", buffering=0) as file:
            written = file.write(data)
            if written < len(data):  # A disk that fills up takes a part: a broken line is no line.
                file.truncate(self._size)
                raise OSError("the disk is full")
        self._size += len(data)

    def _begin(self, day: str) -> None:
        """Begin the next file of a day, or go on with its last one; delete the oldest files."""
        self._folder.mkdir(parents=True, exist_ok=True)
        last = max(self._folder.glob(f"{day}-*.jsonl"), default=None)
        number = 0 if last is None else int(last.stem.rpartition("-")[2])
        if last is not None and last.stat().st_size > self._max_bytes // FILES_LEAST:
            number += 1
        self._path = self._folder / f"{day}-{number:04d}.jsonl"
        self._size = self._path.stat().st_size if self._path.exists() else 0
        self._prune(self._max_bytes // FILES_LEAST)

    def _dump(self, name: str, content: str) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)
        data = content.encode("utf-8")
        self._prune(len(data) + self._max_bytes // FILES_LEAST)
        path = self._folder / f"{FAULT_PREFIX}{name}.log"
        try:
            path.write_bytes(data)
        except OSError:
            path.unlink(missing_ok=True)
            raise

    def _prune(self, room: int) -> None:
        """Delete the oldest files until there is `room` below the limit."""
        files = [*self._folder.glob(f"{PREFIX}*.jsonl"), *self._folder.glob(f"{FAULT_PREFIX}*.log")]
        ages = sorted((file.stat().st_mtime_ns, file, file.stat().st_size) for file in files)
        total = sum(size for _, _, size in ages)
        for _, file, size in ages:
            if total + room <= self._max_bytes:
                return
            if file != self._path:
                file.unlink()
                total -= size


class StageLog:
    """Takes records, and never waits; use it as a context manager."""

    def __init__(self, rule: LogRule, *, is_virtual: bool = False) -> None:
        self._writer = Writer(rule.folder, rule.max_bytes) if is_virtual else None
        self._lost = 0
        self._child: ChildProcess[None] | None = None
        if not is_virtual:
            folder, max_bytes = str(rule.folder.absolute()), str(rule.max_bytes)
            self._child = ChildProcess(__name__, folder, max_bytes, outbox_max_bytes=HELD_MAX_BYTES)

    def write(self, record: Mapping[str, Any]) -> None:
        """Keep a record."""
        if self._writer is not None:
            self._writer.write(record)
        if self._child is None:
            return
        if self._lost and "t" in record:
            text = f"{self._lost} lines were lost: the disk was too slow"
            lost = {"t": record["t"], "kind": "lost", "text": text, "count": self._lost}
            if self._child.send(Record(lost)):
                self._lost = 0
        if not self._child.send(Record(dict(record))):
            self._lost += 1

    def flush(self) -> None:
        """Hand over what the process takes now."""
        if self._child is not None:
            self._child.pipe.flush()

    def __enter__(self) -> StageLog:
        return self

    def __exit__(self, *_: object) -> None:
        """Wait until everything is written, for `CLOSE_S` at most."""
        if self._child is not None:
            self._child.end(CLOSE_S)


class Ring(LineTap):
    """A `Tap` that keeps the last seconds of bytes, up to `RING_MAX_BYTES`, as lines of a log."""

    def __init__(self, kept_s: float) -> None:
        super().__init__()
        self._kept_ns = ns_from_s(kept_s)
        self._lines: deque[tuple[int, bytes]] = deque()
        self._size = 0

    def started(self, start_ns: int) -> Ring:
        """Begin anew: instants count from `start_ns`."""
        self._start_ns, self._size = start_ns, 0
        self._lines.clear()
        return self

    def turned(self, now_ns: int) -> None:
        """Nothing was sent; it is not kept."""

    def add(self, line: LogLine) -> None:
        """Keep a line until it is too old, or there are too many."""
        data = encode_line(line)
        self._lines.append((line.at_ns, data))
        self._size += len(data)
        while self._lines and (
            self._size > RING_MAX_BYTES or line.at_ns - self._lines[0][0] > self._kept_ns
        ):
            self._size -= len(self._lines.popleft()[1])

    def content(self) -> str:
        """Return the lines as a log without its beginning."""
        lines = [encode_line(LogHead(VERSION)), *(data for _, data in self._lines)]
        return b"".join(lines).decode("utf-8")


def main(pipe: MessagePipe, folder: str, max_bytes: str) -> int:
    """Write the records that arrive to a folder until the pipe ends."""
    lower_priority()
    writer = Writer(Path(folder), int(max_bytes))
    typed: TypedPipe[Record] = TypedPipe(pipe, Record)
    serve(typed, lambda record: writer.write(record.values))
    return 1 if writer.lost else 0
