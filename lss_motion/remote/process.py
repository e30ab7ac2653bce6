"""The process that plays: `python -m lss_motion.remote.process FD [STOP_FD]`.

It reads one job from standard input, and how it is played, plays it, and sends the result to the
socket `FD`. When the other end is closed it does what the rule of the job says, by default it stops
and makes the robot safe: the socket of a killed process is closed by the system. Stops may also
come from the socket `STOP_FD`.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Protocol, runtime_checkable

from lss_motion.remote.link import Kind, Link
from lss_motion.remote.operator_end import Operator


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


def start_process(
    job: bytes, stop_end: socket.socket | None = None, **changes: object
) -> tuple[subprocess.Popen[bytes], socket.socket]:
    """Start the process that plays a `packed` job; return it and this end of its link.

    `changes` replace fields of the job, its `options` one by one. Stops may also be sent to the
    other end of `stop_end`, which stays open here.
    """
    own, other = socket.socketpair()
    top = str(Path(__file__).resolve().parents[2])
    paths = [top, *filter(None, [os.environ.get("PYTHONPATH")])]
    filenos = [end.fileno() for end in (other, stop_end) if end is not None]
    with ExitStack() as stack:
        stack.enter_context(other)
        job_file = stack.enter_context(tempfile.TemporaryFile())
        job_file.write(job)
        pickle.dump(changes, job_file)
        job_file.seek(0)
        process = subprocess.Popen(  # noqa: S603  (our own program)
            # -P: no module of the current folder is imported in place of an installed one.
            [sys.executable, "-P", "-m", "lss_motion.remote.process", *map(str, filenos)],
            pass_fds=filenos,
            stdin=job_file,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # Ctrl-C reaches this process only.
        )
    return process, own


def main() -> int:
    """Play the job on standard input, steered through the socket; return an exit code."""
    parent = os.getppid()
    links = [Link(socket.socket(fileno=int(number))) for number in sys.argv[1:]]
    link, stops = links[0], links[1] if len(links) > 1 else None
    job = _job()
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


def _job() -> Task:
    """Return the job on standard input, with the changes that follow it there."""
    # It comes from the process that started this one.
    job: Task = pickle.load(sys.stdin.buffer)  # noqa: S301
    changes: dict[str, Any] = pickle.load(sys.stdin.buffer)  # noqa: S301
    if not isinstance(job, Changeable):  # A robot without a show has nothing to change.
        return job
    options = {**job.options, **changes.pop("options", {})}
    changed: Task = replace(job, options=options, **changes)  # type: ignore[type-var]
    return changed


if __name__ == "__main__":
    sys.exit(main())
