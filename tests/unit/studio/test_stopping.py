"""The latch: one process writes it, the server reads it, and it outlives that process."""

import asyncio
import socket
from typing import ClassVar

import pytest

from lss_motion.playing.remote import schema as m
from lss_motion.studio import stopping
from lss_motion.studio.latch import Latch, latch_file
from lss_motion.studio.stop import Latched, RearmPlayers, Stopper, StopPlayers
from lss_motion.studio.stopping import StopProcess
from lss_motion.system.messages import Kind, MessagePipe


@pytest.fixture
def memory():
    with latch_file() as file:
        yield file


def test_a_latch_is_kept_in_memory_that_both_processes_see(memory):
    owner, reader = Latch(memory.fileno()), Latch(memory.fileno())
    assert reader.kind is None
    owner.keep("stop")
    assert reader.kind == "stop"
    owner.keep("estop")
    owner.keep("stop")
    assert reader.kind == "estop", "it is not lessened"
    owner.clear()
    assert reader.kind is None


def operations(end):
    pipe = MessagePipe(end)
    pipe.set_blocking(is_blocking=False)
    return [
        m.parse_operation(content).op for kind, content in pipe.receive() if kind is Kind.OPERATION
    ]


def test_a_stop_process_that_is_started_again_stops_who_starts_meanwhile(memory):
    async def run():
        ends = [socket.socketpair() for _ in range(2)]
        players = [socket.socketpair() for _ in range(2)]
        first, second = (
            Stopper(MessagePipe(own), Latch(memory.fileno()), lambda: None) for own, _ in ends
        )
        first._take(players[0][0])
        first.stop("stop")
        second._take(players[1][0])  # It has not been told anything.
        found = [operations(player) for _, player in players]
        for pair in (*ends, *players):
            asyncio.get_running_loop().remove_reader(pair[0].fileno())
            for one in pair:
                one.close()
        return found

    assert asyncio.run(run()) == [["stop"], ["stop"]]


class Child:
    """Stands for the process: the test says when it does what it was asked."""

    all: ClassVar[list] = []

    def __init__(self, module, *words, receives, inherits):
        self.sent, self.answers, self.has_ended = [], [], False
        own, self.other = socket.socketpair()
        self.pipe = MessagePipe(own)
        self.latch = Latch(int(words[0]))
        Child.all.append(self)

    def fileno(self):
        return self.pipe.fileno()

    def exit_code(self):
        return 1

    def send(self, message):
        self.sent.append(message)

    def receive(self):
        answers, self.answers = self.answers, []
        return answers

    def do(self, message):
        if isinstance(message, RearmPlayers):
            self.latch.clear()
        else:
            self.latch.keep(message.kind)
        self.answers.append(Latched(self.latch.kind))


@pytest.fixture
def stops(monkeypatch):
    monkeypatch.setattr(stopping, "ChildProcess", Child)
    monkeypatch.setattr(stopping, "RESTART_S", 0.0)
    Child.all.clear()

    def run(script):
        async def inside():
            own = StopProcess("settings", [])
            told = []
            own.on_latch = lambda: told.append(own.latch)
            try:
                await script(own, told)
            finally:
                own.close()
                for child in Child.all:
                    child.pipe.close()
                    child.other.close()

        asyncio.run(inside())

    return run


def test_what_the_server_asked_for_counts_until_the_process_has_done_it(stops):
    async def script(own, told):
        child = Child.all[0]
        own.stop("estop")
        assert own.latch == "estop", "the process may stand still"
        own.stop("stop")
        assert child.sent[1:] == [StopPlayers("estop"), StopPlayers("estop")]
        own.rearm()
        assert own.latch is None
        for message in child.sent[1:]:
            child.do(message)
        own._read()
        assert told[-1] is None
        assert own.latch is None

    stops(script)


def test_a_stop_that_came_to_the_process_is_read_also_before_it_is_told(stops):
    async def script(own, told):
        child = Child.all[0]
        child.do(StopPlayers("stop"))
        assert own.latch == "stop"
        own._read()
        assert told == ["stop"]
        own.rearm()
        child.do(StopPlayers("estop"))  # Pressed while the rearm is on its way.
        child.do(child.sent[-1])
        child.do(StopPlayers("stop"))
        own._read()
        assert own.latch == "stop"

    stops(script)


def test_a_process_that_is_started_again_finds_the_latch_and_gets_what_was_not_done(stops):
    async def script(own, _told):
        first = Child.all[0]
        own.stop("stop")
        first.do(first.sent[-1])
        own._read()
        first.has_ended = True
        own._read()
        await asyncio.sleep(0.01)
        second = Child.all[1]
        assert second.sent == ["settings"], "it is in the memory"
        assert second.latch.kind == own.latch == "stop"
        own.rearm()
        second.has_ended = True
        own._read()
        await asyncio.sleep(0.01)
        assert Child.all[2].sent == ["settings", RearmPlayers()]

    stops(script)
