"""A helper process: messages both ways, its end, and what is left when either side dies."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import pytest
from msgspec import Struct

from lss_motion.system.process import ChildProcess

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="kills processes by signals")


class EchoAsked(Struct, frozen=True, tag=True):
    text: str


class EchoSlept(Struct, frozen=True, tag=True):
    pass


class EchoAnswered(Struct, frozen=True, tag=True):
    text: str
    at_s: float = float("inf")


@pytest.fixture
def echo(tmp_path, monkeypatch):
    """Return a function that starts a process which answers each message."""
    (tmp_path / "echoing.py").write_text(ECHO)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    started = []

    def start(*words, **options):
        child = ChildProcess("echoing", *words, receives=EchoAnswered, **options)
        started.append(child)
        return child

    yield start
    for child in started:
        child.close()


ECHO = """\
import sys, time
from msgspec import Struct
from lss_motion.system.messages import TypedPipe
from lss_motion.system.reactor import serve

class EchoAsked(Struct, frozen=True, tag=True):
    text: str
class EchoSlept(Struct, frozen=True, tag=True):
    pass
class EchoAnswered(Struct, frozen=True, tag=True):
    text: str
    at_s: float = float("inf")

def main(pipe, *words):
    typed = TypedPipe(pipe, EchoAsked | EchoSlept)
    def obey(message):
        if isinstance(message, EchoSlept):
            time.sleep(100.0)
        if message.text == "print":
            print("printed", flush=True)
        typed.send(EchoAnswered(message.text + "".join(words)))
    serve(typed, obey)
    typed.send(EchoAnswered("bye"))
    return 7
"""


def test_messages_go_both_ways_and_the_last_ones_come_at_the_end(echo):
    child = echo("!")
    child.send(EchoAsked("hello"))
    assert child.receive_within(20.0) == [EchoAnswered("hello!")], "infinity stays infinite"
    child.send(EchoAsked("again"))
    found = []
    assert child.end(20.0, found.append) == 7
    assert found == [EchoAnswered("again!"), EchoAnswered("bye")]
    assert child.end(20.0) == 7, "another end changes nothing"
    assert not child.send(EchoAsked("late"))


def test_what_is_kept_for_a_slow_process_arrives_before_its_end(echo):
    child = echo(outbox_max_bytes=1 << 22)
    count = 3000
    for _ in range(count):
        assert child.send(EchoAsked("x" * 1000))
    assert child.pipe.is_full
    found = []
    assert child.end(60.0, found.append) == 7
    assert len(found) == count + 1


def test_a_process_that_hangs_is_killed_in_bounded_time(echo):
    child = echo()
    child.send(EchoSlept())
    began_s = time.monotonic()
    assert child.end(0.5) is None
    assert time.monotonic() - began_s < 5.0
    with pytest.raises(ProcessLookupError):
        os.kill(child.pid, 0)


def test_the_death_of_the_process_is_noticed_and_raises_nothing(echo):
    child = echo()
    os.kill(child.pid, signal.SIGKILL)
    assert child.receive_within(20.0) == []
    assert child.has_ended
    assert not child.send(EchoAsked("x")) or not child.send(EchoAsked("y"))
    assert child.end(5.0) == -signal.SIGKILL


def test_signals_that_end_a_program_do_not_end_its_helper(echo):
    child = echo()
    child.send(EchoAsked("a"))
    child.receive_within(20.0)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(child.pid, number)
    child.send(EchoAsked("b"))
    assert child.receive_within(20.0) == [EchoAnswered("b")]
    assert os.getsid(child.pid) == child.pid, "Ctrl-C does not reach it at all"


def test_what_a_quiet_process_prints_is_no_message_and_not_seen(echo, capfd):
    child = echo(is_quiet=True)
    child.send(EchoAsked("print"))
    assert child.receive_within(20.0) == [EchoAnswered("print")]
    assert capfd.readouterr() == ("", "")


def test_a_message_of_another_type_is_dropped(echo):
    child = echo()
    child.send(EchoAnswered("not asked"))
    child.send(EchoAsked("asked"))
    assert child.receive_within(20.0) == [EchoAnswered("asked")]


def test_a_process_ends_when_its_program_is_killed(tmp_path, echo):
    code = (
        "import os\n"
        "from lss_motion.system.process import ChildProcess\n"
        "child = ChildProcess('echoing')\n"
        "print(child.pid, flush=True)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    killed = subprocess.run(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, check=False
    )
    pid = int(killed.stdout.split()[0])
    for _ in range(400):
        try:
            os.kill(pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.05)
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)
