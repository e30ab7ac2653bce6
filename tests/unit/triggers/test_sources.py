"""Whose messages are obeyed, how many, and which values cross a threshold."""

from __future__ import annotations

import asyncio

from lss_motion.stage.triggers.mqtt import WebHook
from lss_motion.stage.triggers.sources import (
    BURST,
    RATE_HZ,
    REPORT_S,
    SENDERS_MAX,
    AllowList,
    Complaints,
    Crossings,
    Gate,
)
from tests.network import web_hook


def test_only_addresses_of_the_list_may_send():
    allow = AllowList(["127.0.0.0/8", "::1/128", "192.168.1.7"])
    assert all(allow.has(one) for one in ("127.3.2.1", "::1", "192.168.1.7", "::ffff:127.0.0.1"))
    assert not any(allow.has(one) for one in ("192.168.1.8", "::2", "10.0.0.1", "x", "", "fe80::1"))


def test_a_flood_is_bounded_and_keeps_no_other_sender_out():
    said = []
    gate = Gate("OSC", AllowList(["127.0.0.0/8"]), said.append)
    taken = sum(gate.admits("127.0.0.1", 0.001 * n) for n in range(10_000))
    assert abs(taken - BURST - 10 * RATE_HZ) <= 2
    assert gate.admits("127.0.0.2", 10.0)
    assert not gate.admits("10.0.0.1", 10.0)
    assert gate.received == 10_002
    assert [text.split(" ")[1] for text in said] == ["127.0.0.1", "a"]
    for n in range(1000):  # Senders without number share one rate.
        gate.admits(f"127.1.{n // 250}.{n % 250}", 10.0)
    assert len(gate._limits) <= SENDERS_MAX + 1


def test_a_complaint_is_said_once_a_minute_with_its_count():
    said = []
    complaints = Complaints("OSC", said.append)
    for n in range(100):
        complaints.add("wrong", 0.1 * n)
    complaints.add("other", 5.0)
    complaints.add("wrong", REPORT_S + 1.0)
    assert said == ["OSC: wrong", "OSC: other", "OSC: wrong (100 times)"]
    for n in range(1000):
        complaints.add(f"cause {n}", 100.0)
    assert len(complaints.counts) < 100


def test_a_value_crosses_a_threshold_up_and_down_once():
    levels = Crossings({"1/5": (127.0,)}, hysteresis=8.0, is_state=True)
    seen = [255.0, 130.0, 125.0, 120.0, 118.0, 130.0, 126.0, 131.0, 0.0, 128.0]
    assert [value for value in seen if levels.take("1/5", value)] == [118.0, 130.0, 0.0, 128.0]
    levels.forget("1/5")
    assert not levels.take("1/5", 0.0), "the first level of a source is no change"
    assert not levels.take("2/5", 255.0)
    button = Crossings({"/a": (0.5, 0.8)})
    assert [value for value in (1.0, 1.0, 0.7, 0.0) if button.take("/a", value)] == [1.0, 0.7, 0.0]


def test_an_alert_is_posted_until_it_is_taken():
    said = []

    async def send(number):
        hook = WebHook(f"http://127.0.0.1:{number}/", said.append, pause_s=0.01)
        hook.send({"text": "elbow hot"})
        hook.send({"text": "port lost"})
        await hook.close()
        gone = WebHook("http://127.0.0.1:9/", said.append, pause_s=0.01)
        gone.send({"text": "never"})
        await gone.close()

    with web_hook(503) as (number, got):
        asyncio.run(send(number))
    assert [one["text"] for one in got] == ["elbow hot", "elbow hot", "port lost"]
    assert len(said) == 1
    assert "did not take it" in said[0]
