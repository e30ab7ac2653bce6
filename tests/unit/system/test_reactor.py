"""The loop of a helper: messages, turns, and its end."""

from __future__ import annotations

import math
import socket
import subprocess
import sys
import time

import pytest
from msgspec import Struct

from lss_motion.system.messages import MessagePipe, TypedPipe
from lss_motion.system.reactor import serve, wait_for


class Count(Struct, frozen=True, tag=True):
    number: int


@pytest.fixture
def ends():
    own, other = socket.socketpair()
    with own, other:
        yield TypedPipe(MessagePipe(own), Count), TypedPipe(MessagePipe(other), Count)


def test_turns_go_on_while_no_message_comes_though_the_pipe_may_wait(ends):
    helper, _ = ends
    waits_s = iter([0.0, 0.01, 0.0, None])
    seen = []
    serve(helper, seen.append, lambda: next(waits_s))
    assert seen == []
    assert next(waits_s, "none is left") == "none is left"


def test_messages_are_obeyed_in_order_until_the_other_end_closes(ends):
    helper, starter = ends
    for number in range(3):
        starter.send(Count(number))
    starter.pipe.finish()
    seen = []
    serve(helper, seen.append)
    assert [one.number for one in seen] == [0, 1, 2]


def test_a_wait_ends_when_something_can_be_read_or_its_time_is_over(ends):
    helper, starter = ends
    began_s = time.monotonic()
    assert wait_for([helper.fileno()], 0.02) == []
    assert time.monotonic() - began_s > 0.015
    assert wait_for((), 0.0, writable=[helper.fileno()]) == [helper.fileno()]
    starter.send(Count(1))
    assert wait_for([helper.fileno()], math.inf) == [helper.fileno()]


def test_processes_can_be_imported_where_there_are_fewer_signals():
    """Windows has no SIGHUP."""
    code = "import signal; del signal.SIGHUP; import lss_motion.playing.remote.process"
    subprocess.run([sys.executable, "-c", code], check=True)
