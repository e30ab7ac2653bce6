"""The process that plays.

It imports some modules, and waits for one job: a file with it, and with how it is played, is passed
over its pipe. It plays the job and sends the result over the same pipe. When the other end is
closed it does what the rule of the job says, by default it stops and makes the robot safe: the pipe
of a killed process is closed by the system. Stops may also come over a second pipe.
"""

from __future__ import annotations

import importlib
import os
import pickle
import signal
import socket
import tempfile
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from msgspec.structs import replace

from lss_motion.playing.remote.operator_end import Operator
from lss_motion.system.messages import Kind, MessagePipe
from lss_motion.system.process import ChildProcess
from lss_motion.system.reactor import ENDING

if TYPE_CHECKING:
    from collections.abc import Sequence


class Task(Protocol):
    """What this process can do for a client: play a show, or move a robot without one."""

    def run(self, operator: Operator) -> object:
        """Do it, and send the last event; return the result for a client that takes it."""


@runtime_checkable
class Changeable(Protocol):
    """A dataclass with fields that may be changed when it is started, as `remote.job.Job`."""

    options: dict[str, Any]


SEND_S: Final = 5.0
"""The result is dropped if the client does not take it for so long."""


def packed(job: Task) -> bytes:
    """Return a job as bytes for `start_process`, for who starts it without looking inside."""
    return pickle.dumps(job)


def begin_process(
    stop_end: socket.socket | None = None, modules: Sequence[str] = ()
) -> ChildProcess[Any]:
    """Start a process that waits for its job (`give_job`).

    It imports `modules` meanwhile. It ends when its pipe is closed.
    """
    stops = [] if stop_end is None else [stop_end.fileno()]
    return ChildProcess(__name__, *map(str, stops), *modules, inherits=stops)


def give_job(process: ChildProcess[Any], job: bytes, **changes: object) -> None:
    """Let a process that waits play a `packed` job; if it has ended, its pipe shows that.

    `changes` replace fields of the job, its `options` one by one. The job is a file, so that
    nothing here waits until the process takes it.
    """
    with tempfile.TemporaryFile() as job_file:
        job_file.write(job)
        pickle.dump(changes, job_file)
        job_file.seek(0)
        process.pipe.send_fileno(Kind.OBJECT, b"", job_file.fileno())


def start_process(
    job: bytes, stop_end: socket.socket | None = None, **changes: object
) -> ChildProcess[Any]:
    """Start the process that plays a `packed` job.

    The `changes`: see `give_job`. Stops may also be sent to the other end of `stop_end`, which
    stays open here.
    """
    process = begin_process(stop_end)
    give_job(process, job, **changes)
    return process


def main(link: MessagePipe, *words: str) -> int:
    """Play the job that comes over the pipe, steered through it; return an exit code.

    The words are the file number of a pipe with stops, if there is one, and modules to import.
    """
    for number in ENDING:
        signal.signal(number, signal.SIG_DFL)  # Without a job it ends without a word.
    parent = os.getppid()
    stops: MessagePipe | None = None
    for word in words:
        if word.isdigit():
            stops = MessagePipe(socket.socket(fileno=int(word)))
            stops.set_blocking(is_blocking=False)
        else:
            importlib.import_module(word)
    job = _job(link)
    if job is None:
        return 0
    link.set_blocking(is_blocking=False)
    operator = Operator(link, stops=stops, is_orphan=lambda: os.getppid() != parent)
    for number in ENDING:
        signal.signal(number, lambda _number, _frame: operator.note_signal())
    outcome = job.run(operator)
    link.set_blocking(is_blocking=True, timeout_s=SEND_S)
    link.send(Kind.OBJECT, pickle.dumps(outcome))
    while link.is_full and not link.is_closed:
        link.flush()
    link.close()
    return 0


def _job(link: MessagePipe) -> Task | None:
    """Wait for the job, and return it with its changes; None: the pipe was closed before."""
    fileno = link.receive_fileno()
    if fileno is None:
        return None
    with open(fileno, "rb") as file:  # noqa: PTH123  (a file that was passed)
        # It comes from the process that started this one.
        job: Task = pickle.load(file)  # noqa: S301
        changes: dict[str, Any] = pickle.load(file)  # noqa: S301
    if not isinstance(job, Changeable):  # A robot without a show has nothing to change.
        return job
    options = {**job.options, **changes.pop("options", {})}
    changed: Task = replace(job, options=options, **changes)  # type: ignore[type-var]
    return changed
