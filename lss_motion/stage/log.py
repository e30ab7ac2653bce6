"""What is kept of each night: events as JSON lines with the time of day, and bytes at a fault.

    {"t": "2026-10-30T21:14:03.120+01:00", "kind": "fired", "cue": "door", "text": "cue door: …"}

A night is a few hundred kilobytes. Files begin anew each day and at a bounded size, and the oldest
are deleted, so that the folder has at most `max_bytes`. A disk that is full loses lines, not
shows; the first line after it says how many. `StageLog.take_texts` tells people at once.

`Records` makes the records of what a stage has done and refused; equal refusals that follow each
other are counted, so that a storm of triggers does not fill the disk. `Writer` writes. `StageLog`
hands records to a process of its own (`main`), for which the player never waits; in virtual time it
writes itself. `Ring` keeps the last seconds of bytes in memory; at a fault they become a file that
`lss-motion replay` shows.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections import deque
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.playing.log import VERSION, LineTap, LogHead, encode_line
from lss_motion.stage import orders
from lss_motion.stage.duty import Reason
from lss_motion.system.messages import TypedPipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import serve
from lss_motion.system.real_time import lower_priority
from lss_motion.units import NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lss_motion.playing.log import LogLine
    from lss_motion.stage.director import Director
    from lss_motion.stage.model import LogRule, Stage
    from lss_motion.system.messages import MessagePipe

    Record = dict[str, Any]

PREFIX: Final = "stage-"
FAULT_PREFIX: Final = "fault-"
FILES_LEAST: Final = 8
"""The folder holds at least so many files, so that deleting the oldest loses an eighth at most."""

HELD_MAX_BYTES: Final = 4 * 1024 * 1024
"""The most that is kept for the writing process: hours of events, or two rings."""

RING_MAX_BYTES: Final = 1024 * 1024
"""Chosen: two minutes of three busy joints; of more joints, fewer seconds."""

CLOSE_S: Final = 10.0


class LogRecord(Struct, frozen=True):
    """What is handed to the process that writes: a line of JSON, or a file of its own."""

    values: dict[str, Any]


class Written(Struct, frozen=True):
    """What became of the records so far: the answer of the process that writes."""

    trouble: str = ""
    """Why the last one was not written; empty: it was."""
    lost: int = 0
    """How many were not, in all."""


class Writer:
    """Writes lines to the files of a folder; it survives a full disk."""

    def __init__(self, folder: Path, max_bytes: int) -> None:
        self._folder = folder
        self._max_bytes = max_bytes
        self._path: Path | None = None
        self._size = 0
        self.lost = 0
        """Lines that the disk did not take since the last that it took."""
        self.written = Written()

    def write(self, record: Mapping[str, Any]) -> None:
        """Append a record to the file of its day. One with `dump` becomes a file of its own."""
        try:
            self._write(record)
        except OSError as error:
            self.lost += 1
            self._path = None
            self.written = Written(why_not_written(self._folder, error), self.written.lost + 1)
        else:
            self.written = Written("", self.written.lost)

    def _write(self, record: Mapping[str, Any]) -> None:
        if "dump" in record:
            self._dump(str(record["dump"]), str(record["content"]))
            return
        if self.lost:
            text = f"{self.lost} lines were lost: the disk took none"
            self._append({"t": record["t"], "kind": "lost", "text": text, "count": self.lost})
            self.lost = 0
        self._append(record)

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


TAIL_BYTES: Final = 65_536
"""The end of a log in which its last line is looked for."""


def last_written(folder: Path) -> datetime | None:
    """Return when the last line of a log was written; None: there is no line that can be read."""
    for file in sorted(folder.glob(f"{PREFIX}*.jsonl"), reverse=True):
        lines: list[bytes] = []
        with contextlib.suppress(OSError), file.open("rb") as opened:
            opened.seek(max(0, opened.seek(0, os.SEEK_END) - TAIL_BYTES))
            lines = opened.read().splitlines()
        for line in reversed(lines):
            with contextlib.suppress(ValueError, KeyError, TypeError):
                return datetime.fromisoformat(json.loads(line)["t"])
    return None


def why_not_written(folder: Path, error: OSError) -> str:
    """Return for people why a log cannot be written to a folder."""
    if isinstance(error, FileExistsError | NotADirectoryError):
        return f"{folder} is not a folder"
    return f"{folder}: {error.strerror or error}"


def why_not_writable(folder: Path) -> str | None:
    """Return why a log could not be written to a folder now, which need not exist; else None."""
    try:
        return _why_not_writable(folder)
    except OSError as error:
        return why_not_written(folder, error)


def _why_not_writable(folder: Path) -> str | None:
    there = next((one for one in (folder, *folder.parents) if one.exists()), folder)
    if not there.is_dir():
        return f"{there} is not a folder"
    newest = max(there.glob(f"{PREFIX}*.jsonl"), default=None) if there == folder else None
    for one, rights in ((there, os.W_OK | os.X_OK), (newest, os.W_OK)):
        if one is not None and not os.access(one, rights):
            return f"{one} may not be written"
    return "the disk is full" if shutil.disk_usage(there).free == 0 else None


class StageLog:
    """Takes records, and never waits; use it as a context manager."""

    def __init__(self, rule: LogRule, *, is_virtual: bool = False) -> None:
        self.seen = last_written(rule.folder)
        """When the process before this one has written last."""
        self._writer = Writer(rule.folder, rule.max_bytes) if is_virtual else None
        self._lost = self._dropped = 0
        """Records that the process did not take: since the last that it took, and in all."""
        self._written = self._told = Written()
        self._child: ChildProcess[Written] | None = None
        if not is_virtual:
            folder, max_bytes = str(rule.folder.absolute()), str(rule.max_bytes)
            self._child = ChildProcess(
                __name__, folder, max_bytes, receives=Written, outbox_max_bytes=HELD_MAX_BYTES
            )

    def write(self, record: Mapping[str, Any]) -> None:
        """Keep a record."""
        if self._writer is not None:
            self._writer.write(record)
        if self._child is None:
            return
        if self._lost and "t" in record:
            text = f"{self._lost} lines were lost: the disk was too slow"
            lost = {"t": record["t"], "kind": "lost", "text": text, "count": self._lost}
            if self._child.send(LogRecord(lost)):
                self._lost = 0
        if not self._child.send(LogRecord(dict(record))):
            self._lost += 1
            self._dropped += 1

    def take_texts(self, *, is_last: bool = False) -> list[str]:
        """Return what people have to know since the last call: the log cannot be written, or can.

        `is_last`: say once more what is lost in all.
        """
        if self._writer is not None:
            self._written = self._writer.written
        elif self._child is not None and not is_last:
            for written in self._child.receive():
                self._written = written
        trouble, lost = self._written.trouble, self._written.lost + self._dropped
        if self._dropped and not trouble and self._child is not None and self._child.has_ended:
            trouble = "the process that writes it has ended"
        told, is_changed = self._told, trouble != self._told.trouble
        lines = counted(range(lost), "line")
        self._told = Written(trouble, told.lost if trouble else lost)
        if is_last and lost:
            return [f"{lines} of the log could not be written" + (trouble and f": {trouble}")]
        if trouble:
            return [f"the log cannot be written: {trouble}"] if is_changed else []
        return [f"the log is written; {lines} of it could not be"] if lost > told.lost else []

    def __enter__(self) -> StageLog:
        return self

    def __exit__(self, *_: object) -> None:
        """Wait until everything is written, for `CLOSE_S` at most."""
        if self._child is not None:
            self._child.end(CLOSE_S, self._note_written)

    def _note_written(self, written: Written) -> None:
        self._written = written


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
    typed: TypedPipe[LogRecord] = TypedPipe(pipe, LogRecord)
    told = writer.written

    def write(record: LogRecord) -> None:
        nonlocal told
        writer.write(record.values)
        if writer.written.trouble != told.trouble:
            told = writer.written
            typed.send(told)

    serve(typed, write)
    if writer.written != told:
        typed.send(writer.written)
    return 1 if writer.lost else 0


REFUSED_NS: Final = 60 * NS_PER_S
"""Equal refusals are counted, and noted this often."""
REFUSALS_MAX: Final = 1000
"""Different refusals that are counted at a time."""


def must_restart(reason: str) -> tuple[str, str]:
    """Return kind and text of the record of newer files for which the stage must begin anew."""
    return "must_restart", f"new files; the stage begins anew: {reason}"


def renewed(changed: Iterable[str]) -> tuple[str, str]:
    """Return kind and text of the record of newer files with which the stage goes on."""
    names = ", ".join(sorted(changed))
    return "renewed", "new files are played from now on" + (f"; changed: {names}" if names else "")


@dataclass(slots=True)
class CueState:
    """What a cue has done so far."""

    fired: int = 0
    fired_ns: int | None = None
    refused: str = ""
    """Why it was refused since it has fired last."""


class Records:
    """The records of one stage; `write` gets each with the time of day that `wall` returns."""

    def __init__(
        self, stage: Stage, wall: Callable[[], datetime], write: Callable[[Record], None]
    ) -> None:
        self._stage, self._wall, self._write = stage, wall, write
        self._about: dict[str, CueState] = {cue.name: CueState() for cue in stage.cues}
        self._refusals: dict[tuple[str, str], list[int]] = {}
        self._counted_ns: int | None = None

    def renew(self, stage: Stage) -> None:
        """Go on with a newer stage file."""
        self._stage = stage
        for cue in stage.cues:
            self._about.setdefault(cue.name, CueState())

    def note(self, kind: str, text: str, **more: object) -> None:
        """Keep what happened, with the time of day."""
        wall = self._wall().astimezone(self._stage.zone)
        self._write(
            {"t": wall.isoformat(timespec="milliseconds"), "kind": kind, "text": text, **more}
        )

    def note_order(self, note: orders.Note, now_ns: int) -> None:
        """Keep what the director has noted."""
        if note.kind == "refused":
            self._count_refusal(note)
            return
        if note.kind == "fired":
            about = self._about.setdefault(note.fields["cue"], CueState())
            about.fired, about.fired_ns, about.refused = about.fired + 1, now_ns, ""
        self.note(note.kind, note.text, **note.fields)

    def _count_refusal(self, note: orders.Note) -> None:
        """Note a refusal; equal ones that follow are only counted for a while."""
        cue, reason = note.fields["cue"], note.fields["reason"]
        self._about.setdefault(cue, CueState()).refused = reason
        key = (cue, reason.partition(",")[0])
        if key in self._refusals or len(self._refusals) >= REFUSALS_MAX:
            self._refusals.setdefault(("others", "many refusals"), [0])
            self._refusals.get(key, self._refusals[("others", "many refusals")])[0] += 1
            return
        self._refusals[key] = [0]
        self.note("refused", note.text, cue=cue, reason=reason, count=1)

    def note_waiting(self, director: Director, now_ns: int) -> None:
        """Note the shows of cues that have fired, but are not played: the stage has ended."""
        for one in (*director.queue, *director.left):
            self.note_order(orders.not_played(one.cue, one.show, "the stage has ended"), now_ns)

    def note_counts(self, now_ns: int, *, is_last: bool = False) -> None:
        """Note how often cues were refused since the first time, once a minute."""
        if self._counted_ns is None:
            self._counted_ns = now_ns
        if not is_last and now_ns < self._counted_ns + REFUSED_NS:
            return
        self._counted_ns = now_ns
        for (cue, reason), (count,) in self._refusals.items():
            if count:
                text = f"cue {cue} refused {count} more times: {reason}"
                self.note("refused", text, cue=cue, reason=reason, count=count)
        self._refusals.clear()

    def state_of(self, director: Director, now_ns: int) -> Record:
        """Return what operators see of the director: fields of `playing.remote.stage_messages`."""
        main = director.main
        return {
            "show": None if main is None else main.show,
            "cause": "" if main is None else "idle" if main.cue is None else main.cue.name,
            "added": tuple(one.show for one in director.added),
            "queue": tuple(one.show for one in director.queue),
            "left": tuple(one.show for one in director.left),
            "next_go": director.next_go(),
            "reasons": tuple(director.duty.reasons.values()),
            "cues": tuple(
                {
                    "name": cue.name,
                    "on": cue.on.text,
                    "when": director.cron.when(cue.on, self._stage.duty.quiet),
                    "plays": ", ".join(cue.shows) or cue.deed or "",
                    "is_enabled": director.enabled[cue.name],
                    "fired": about.fired,
                    "last_fired_s": None
                    if about.fired_ns is None
                    else round(s_from_ns(now_ns - about.fired_ns), 1),
                    "refused": about.refused,
                }
                for cue in self._stage.cues
                for about in [self._about[cue.name]]
            ),
        }


def state_word(director: Director, before: str) -> str:
    """Return the state of a stage in a word; `before`: while its robot is not connected."""
    main = director.main
    if Reason.FAULT in director.duty.reasons:
        return "given_up"
    if not director.is_connected:
        return before
    is_idle = main is None or main.cue is None or main.is_ready
    if director.duty.reasons and is_idle:
        return "rests"
    return "idle" if is_idle else "plays"
