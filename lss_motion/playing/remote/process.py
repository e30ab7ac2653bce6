"""The process that plays: `python -m lss_motion.playing.remote.process FD [STOP_FD] [MODULE …]`.

It imports the modules, and waits for one job: a file with it, and with how it is played, is passed
over the socket `FD`. It plays the job and sends the result to the same socket. When the other end
is closed it does what the rule of the job says, by default it stops and makes the robot safe: the
socket of a killed process is closed by the system. Stops may also come from the socket `STOP_FD`.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol, runtime_checkable

from msgspec.structs import replace

from lss_motion.playing.remote.operator_end import Operator
from lss_motion.system.messages import Kind, MessagePipe

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
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start a process that waits for its job (`give_job`); return it and this end of its link.

    It imports `modules` meanwhile. It ends when its link is closed.
    """
    own, other = socket.socketpair()
    top = str(Path(__file__).resolve().parents[2])
    paths = [top, *filter(None, [os.environ.get("PYTHONPATH")])]
    filenos = [end.fileno() for end in (other, stop_end) if end is not None]
    with other:
        process = subprocess.Popen(  # noqa: S603  (our own program)
            # -P: no module of the current folder is imported in place of an installed one.
            [
                sys.executable,
                "-P",
                "-m",
                "lss_motion.playing.remote.process",
                *map(str, filenos),
                *modules,
            ],
            pass_fds=filenos,
            stdin=subprocess.DEVNULL,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # Ctrl-C reaches this process only.
        )
    return process, own


def give_job(own: socket.socket, job: bytes, **changes: object) -> None:
    """Let a process that waits play a `packed` job; if it has ended, its link shows that.

    `changes` replace fields of the job, its `options` one by one.
    """
    with tempfile.TemporaryFile() as job_file:
        job_file.write(job)
        pickle.dump(changes, job_file)
        job_file.seek(0)
        with contextlib.suppress(OSError):
            socket.send_fds(own, [b"j"], [job_file.fileno()])


def start_process(
    job: bytes, stop_end: socket.socket | None = None, **changes: object
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start the process that plays a `packed` job; return it and this end of its link.

    The `changes`: see `give_job`. Stops may also be sent to the other end of `stop_end`, which
    stays open here.
    """
    process, own = begin_process(stop_end)
    give_job(own, job, **changes)
    return process, own


def main() -> int:
    """Play the job that comes over the socket, steered through it; return an exit code."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Without a job it ends without a word.
    parent = os.getppid()
    words = sys.argv[1:]
    ends = [socket.socket(fileno=int(word)) for word in words if word.isdigit()]
    for word in words[len(ends) :]:
        importlib.import_module(word)
    job = _job(ends[0])
    if job is None:
        return 0
    links = [MessagePipe(end) for end in ends]
    link, stops = links[0], links[1] if len(links) > 1 else None
    for one in links:
        one.set_blocking(is_blocking=False)
    operator = Operator(link, stops=stops, is_orphan=lambda: os.getppid() != parent)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda _number, _frame: operator.note_signal())
    outcome = job.run(operator)
    link.set_blocking(is_blocking=True, timeout_s=SEND_S)
    link.send(Kind.OBJECT, pickle.dumps(outcome))
    while link.is_full and not link.is_closed:
        link.flush()
    link.close()
    return 0


def _job(end: socket.socket) -> Task | None:
    """Wait for the job, and return it with its changes; None: the link was closed before."""
    _, filenos, _, _ = socket.recv_fds(end, 1, 1)
    if not filenos:
        return None
    with open(filenos[0], "rb") as file:  # noqa: PTH123  (a file that was passed)
        # It comes from the process that started this one.
        job: Task = pickle.load(file)  # noqa: S301
        changes: dict[str, Any] = pickle.load(file)  # noqa: S301
    if not isinstance(job, Changeable):  # A robot without a show has nothing to change.
        return job
    options = {**job.options, **changes.pop("options", {})}
    changed: Task = replace(job, options=options, **changes)  # type: ignore[type-var]
    return changed


if __name__ == "__main__":
    sys.exit(main())
