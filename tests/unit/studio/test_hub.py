"""The hub: who may do what, who operates, who is answered, and what a slow client gets."""

from __future__ import annotations

import asyncio
import json

import pytest

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.studio.access import Role
from lss_motion.studio.client import EVENTS_MAX, OPERATIONS_BURST, OPERATIONS_HZ, Allowance
from lss_motion.studio.hub import CLIENTS_MAX, OPERATOR_GRACE_S, OPERATOR_SILENT_S, Hub


class FakeDesk:
    """Notes what it is asked; `pause` is answered later, `seek` is refused."""

    def __init__(self):
        self.done, self.lost = [], 0

    def stop(self, *, is_emergency):
        self.done.append("estop" if is_emergency else "stop")

    def obey(self, operation, key):
        if isinstance(operation, m.Seek):
            raise InputError("nowhere")
        self.done.append((operation.op, key))
        return not isinstance(operation, m.Pause)

    def state(self):
        return ()

    def operator_lost(self):
        self.lost += 1


@pytest.fixture
def hub():
    def welcome(client):
        return m.Welcome(
            client=client.number,
            role=client.role.word,
            stop_origin="http://127.0.0.1:1",
            version="0",
            file="wave.yaml",
            kind="sequence",
            title="wave",
            is_network_readable=False,
        )

    hub = Hub(welcome)
    hub.desk = FakeDesk()
    return hub


def taken(client):
    """Return the events that wait for a client."""
    texts = [client._events.popleft() for _ in range(len(client._events))]
    return [json.loads(text) for text in texts]


def of(client, kind):
    return [event for event in taken(client) if event["event"] == kind]


OPERATIONS = [
    ("stop", {}, Role.VIEW),
    ("estop", {}, Role.VIEW),
    ("beat", {}, Role.VIEW),
    ("play", {}, Role.OPERATE),
    ("rearm", {}, Role.OPERATE),
    ("lease", {"want": "take"}, Role.OPERATE),
    ("jog", {"joint": "a", "speed_ratio": 1}, Role.OPERATE),
    ("pose.save", {"pose": "a", "is_new": True}, Role.EDIT),
    ("pair", {"role": "view"}, Role.EDIT),
]


@pytest.mark.parametrize("role", list(Role))
@pytest.mark.parametrize(("op", "fields", "needed"), OPERATIONS)
def test_the_table_of_roles(hub, role, op, fields, needed):
    client = hub.join(role, "a", 0.0)
    hub.receive(client, json.dumps({"op": op, "id": 5, **fields}), 0.0)
    events = taken(client)
    refused = [event for event in events if event["event"] == "refused"]
    assert bool(refused) == (role < needed)
    if refused:
        assert refused[0]["id"] == 5
        assert needed.word in refused[0]["text"]
        assert hub.desk.done == []


def test_one_client_operates_until_another_takes_over_and_all_may_stop(hub):
    first, second = (hub.join(Role.OPERATE, name, 0.0) for name in ("first", "second"))
    taken(first), taken(second)
    hub.receive(first, '{"op": "play", "id": 1}', 0.0)
    assert of(first, "lease")[0]["is_mine"]
    assert of(second, "lease") == [
        {"event": "lease", "holder": 1, "holder_name": "first", "is_mine": False}
    ]
    hub.receive(second, '{"op": "play", "id": 2}', 0.0)
    assert "first operates" in of(second, "refused")[0]["text"]
    hub.receive(second, '{"op": "estop", "id": 3}', 0.0)
    hub.receive(second, '{"op": "lease", "want": "take"}', 0.0)
    hub.receive(second, '{"op": "play", "id": 4}', 0.0)
    assert [one if isinstance(one, str) else one[0] for one in hub.desk.done] == [
        "play",
        "estop",
        "play",
    ]
    hub.receive(first, '{"op": "lease", "want": "release"}', 0.0)
    assert of(first, "lease")[-1]["holder"] == 2, "only its holder gives it back"


def test_each_client_gets_its_own_answers_now_or_later(hub):
    first, second = (hub.join(Role.OPERATE, "x", 0.0) for _ in range(2))
    hub.receive(first, '{"op": "seek", "to": 1, "id": 8}', 0.0)
    assert of(first, "refused") == [{"event": "refused", "id": 8, "text": "nowhere"}]
    hub.receive(first, '{"op": "pause", "id": 9}', 0.0)
    assert of(first, "accepted") == []
    (key,) = hub.unanswered()
    hub.answer(key)
    hub.answer(key)
    assert of(first, "accepted") == [{"event": "accepted", "id": 9, "op": "pause"}]
    assert of(second, "accepted") == []
    for text in ('{"op": "fly", "id": 3}', '{"id": true}', "[", b"\xff", "x" * 9000):
        hub.receive(first, text, 0.0)
    assert [event["id"] for event in of(first, "refused")] == [3, 0, 0, 0, 0]


def test_an_operator_that_is_gone_is_lost_after_a_while_unless_it_gave_back(hub):
    def tick(now_s):
        hub.beat(now_s)
        return hub.desk.lost

    client = hub.join(Role.OPERATE, "x", 0.0)
    hub.receive(client, '{"op": "play"}', 0.0)
    hub.leave(client, 10.0)
    assert tick(10.0 + OPERATOR_GRACE_S - 0.1) == 0
    assert tick(10.0 + OPERATOR_GRACE_S) == 1
    assert tick(99.0) == 1
    client = hub.join(Role.OPERATE, "x", 100.0)
    hub.receive(client, '{"op": "play"}', 100.0)
    hub.leave(client, 101.0)
    client = hub.join(Role.OPERATE, "x", 102.0)
    hub.receive(client, '{"op": "lease", "want": "take"}', 102.0)
    assert tick(101.0 + OPERATOR_GRACE_S) == 1, "it came back"
    assert tick(102.0 + OPERATOR_SILENT_S) == 1
    assert tick(102.1 + OPERATOR_SILENT_S) == 2, "a laptop that sleeps sends nothing"
    assert of(client, "lease")[-1]["holder"] is None
    hub.receive(client, '{"op": "lease", "want": "take"}', 200.0)
    hub.receive(client, '{"op": "lease", "want": "release"}', 200.0)
    assert tick(300.0) == 2


def test_events_keep_their_order_and_a_client_that_is_too_slow_is_closed(hub):
    fast, slow = (hub.join(Role.VIEW, "x", 0.0) for _ in range(2))

    async def next_of(client):
        return await client.next()

    taken(fast)
    hub.offer_telemetry(b"old")
    hub.broadcast(m.WarningRaised(text="a"))
    hub.offer_telemetry(b"new")
    hub.broadcast(m.WarningRaised(text="b"))
    got = [asyncio.run(next_of(fast)) for _ in range(3)]
    assert [json.loads(text)["text"] for text in got[:2]] == ["a", "b"]
    assert got[2] == b"new"
    late = hub.join(Role.VIEW, "x", 0.0)
    taken(late)
    assert asyncio.run(next_of(late)) == b"new", "where the robot stands, also when it is over"
    for _ in range(EVENTS_MAX):
        hub.broadcast(m.WarningRaised(text="c"))
        taken(fast)
    assert asyncio.run(next_of(slow)) is None
    assert not fast.is_overrun


def test_clients_are_counted_and_bounded(hub):
    most = CLIENTS_MAX[Role.VIEW]
    clients = [hub.join(Role.VIEW, "x", 0.0) for _ in range(most)]
    assert hub.join(Role.VIEW, "x", 0.0) is None
    hub.leave(clients[0], 0.0)
    assert of(clients[1], "links")[-1] == {"event": "links", "clients": most - 1}


def test_who_only_looks_takes_no_place_of_an_operator(hub):
    while hub.join(Role.VIEW, "x", 0.0) is not None:
        pass
    for role in (Role.OPERATE, Role.EDIT):
        joined = [hub.join(role, "x", 0.0) for _ in range(CLIENTS_MAX[role] + 1)]
        assert joined.index(None) == CLIENTS_MAX[role]


def test_a_client_that_floods_is_read_at_a_steady_rate():
    allowance, now_s, count = Allowance(0.0), 0.0, 0
    while now_s < 10.0:
        now_s += allowance.take(now_s) + 1e-6
        count += 1
    assert count == pytest.approx(OPERATIONS_BURST + 10.0 * OPERATIONS_HZ, rel=0.01)
