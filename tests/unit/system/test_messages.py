"""A pipe: whole messages in order, nothing waits, telemetry is dropped and events are kept."""

from __future__ import annotations

import random
import socket
from typing import Any

import numpy as np
import pytest
from msgspec import Struct

from lss_motion.system.messages import Kind, MessagePipe, PipeClosedError, TypedPipe


@pytest.fixture
def ends():
    own, other = socket.socketpair()
    with own, other:
        own.setblocking(False)
        other.setblocking(False)
        yield MessagePipe(own, outbox_max_bytes=5000), MessagePipe(other), own


def test_messages_arrive_whole_and_in_order_however_they_are_cut(ends):
    _, link, raw = ends
    sent = [(Kind.EVENT, bytes([n]) * n) for n in range(40)]
    data = b"".join(k.value + len(c).to_bytes(4, "little") + c for k, c in sent)
    chooser, got = random.Random(5), []
    while data:
        size = chooser.randint(1, 30)
        raw.send(data[:size])
        data = data[size:]
        got += link.receive()
    assert got == sent


def test_a_client_that_does_not_read_gets_all_events_but_no_old_telemetry(ends):
    player, client, _ = ends
    count = 0
    while not player.is_full:
        player.send(Kind.EVENT, b"e" * 1000)
        count += 1
    assert not player.offer(Kind.TELEMETRY, b"old")
    player.send(Kind.EVENT, b"last")
    got = []
    while len(got) < count + 1:
        got += client.receive()
        player.flush()
    assert [kind for kind, _ in got] == [Kind.EVENT] * (count + 1)
    assert got[-1][1] == b"last"
    assert player.offer(Kind.TELEMETRY, b"new")
    assert client.receive() == [(Kind.TELEMETRY, b"new")]


def test_what_is_kept_is_bounded_and_what_is_lost_is_counted(ends):
    player, _, _ = ends
    while player.send(Kind.EVENT, b"e" * 1000):
        pass
    assert player.dropped == 1
    assert len(player._outbox) < 5000 + 2 * 1005


def test_the_end_of_the_other_end_is_noticed_after_its_last_message(ends):
    player, client, raw = ends
    player.send(Kind.EVENT, b"bye")
    raw.close()
    assert client.receive() == [(Kind.EVENT, b"bye")]
    with pytest.raises(PipeClosedError):
        client.receive()
    assert not client.send(Kind.OPERATION, b"x")


class MeasuredValue(Struct, frozen=True, tag=True):
    angle_deg: float
    values: dict[str, Any]


def test_numbers_of_numpy_are_sent_as_what_they_are():
    own, other = socket.socketpair()
    with own, other:
        values = {"count": np.int64(3), "is_on": np.bool_(True), "name": np.str_("elbow")}
        TypedPipe(MessagePipe(own)).send(MeasuredValue(np.float64(1.5), values))
        got = TypedPipe(MessagePipe(other), MeasuredValue).receive()
    assert got == [MeasuredValue(1.5, {"count": 3, "is_on": True, "name": "elbow"})]


@pytest.mark.parametrize("data", [b"?\x00\x00\x00\x00", b"e\xff\xff\xff\xff"])
def test_what_is_no_message_ends_the_pipe(ends, data):
    _, client, raw = ends
    raw.send(data)
    with pytest.raises(PipeClosedError):
        client.receive()
