"""The process that plays: `python -m lss_motion.remote.process FD`, started by `handle.start`.

It reads one job from standard input, plays it, and sends the result to the socket `FD`. When the
other end is closed it stops and makes the robot safe, whatever the reason: the socket of a killed
process is closed by the system.
"""

from __future__ import annotations

import os
import pickle
import signal
import socket
import sys
from typing import Final

from lss_motion.remote.job import play
from lss_motion.remote.link import Kind, Link
from lss_motion.remote.player_end import Steering

SEND_S: Final = 5.0
"""The result is dropped if the client does not take it for so long."""


def main() -> int:
    """Play the job on standard input, steered through the socket; return an exit code."""
    end, parent = socket.socket(fileno=int(sys.argv[1])), os.getppid()
    link = Link(end)
    job = pickle.load(sys.stdin.buffer)  # noqa: S301  (from the process that started this one)
    end.setblocking(False)  # noqa: FBT003
    steering = Steering(link, job.rule, is_orphan=lambda: os.getppid() != parent)
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda _number, _frame: steering.note_signal())
    outcome = play(job, steering)
    end.settimeout(SEND_S)
    link.send(Kind.OBJECT, pickle.dumps(outcome))
    while link.is_full and not link.is_closed:
        link.flush()
    link.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
