"""OSC packets as values: written by another library, cut, flooded, and of other senders."""

from __future__ import annotations

import asyncio
import contextlib
import struct
from datetime import UTC, datetime

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pythonosc", reason='pip install "lss-motion[stage]"')

from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
from pythonosc.osc_message_builder import OscMessageBuilder
from pythonosc.osc_packet import OscPacket

from lss_motion.errors import InputError
from lss_motion.stage.triggers import osc
from lss_motion.stage.triggers.osc import SUBSCRIBED_S, SUBSCRIBERS_MAX, OscPort, Subscribers
from lss_motion.stage.triggers.sources import AllowList, Crossings, Gate

CUES = frozenset({"/hall/door", "/fader"})


def built(address, *arguments):
    builder = OscMessageBuilder(address)
    for one in arguments:
        builder.add_arg(one)
    return builder.build()


def bundle(at, *parts):
    builder = OscBundleBuilder(at)
    for part in parts:
        builder.add_content(part)
    return builder.build()


def keys_of(operation):
    """Return the keys of an operation that the message gave."""
    values = msgspec.to_builtins(operation)
    for key in ("id", "source"):
        values.pop(key, None)
    return {key: value for key, value in values.items() if value is not None}


def asked(address, *arguments, levels=None):
    (message,) = osc.messages_of(built(address, *arguments).dgram)
    found = osc.operation_of(message, CUES, levels)
    return found and keys_of(found)


def test_messages_of_bundles_come_in_order_with_their_time():
    inner = bundle(1_800_000_000.5, built("/b", 1), built("/c", "text", 2.5, True))
    data = bundle(IMMEDIATELY, built("/a"), inner).dgram
    assert osc.messages_of(data) == [
        osc.OscMessage("/a"),
        osc.OscMessage("/b", (1,), 1_800_000_000.5),
        osc.OscMessage("/c", ("text", 2.5, True), 1_800_000_000.5),
    ]
    assert osc.delay_s(osc.OscMessage("/b", (), 1000.5), 1000.0) == 0.5
    assert osc.delay_s(osc.OscMessage("/b", (), 990.0), 1000.0) == 0.0
    with pytest.raises(InputError, match="set the clocks"):
        osc.delay_s(osc.OscMessage("/b", (), 5000.0), 1000.0)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "no OSC message"),
        (b"hello\0\0\0", "no OSC message"),
        (b"/a", "no OSC message"),
        (b"/a\0\0,i\0\0\0\0", "cut"),
        (b"/a\0\0,qq\0", "unknown types"),
        (b"/a\0\0i\0\0\0", "unknown types"),
        (b"/\xff\0\0,i\0\0\0\0\0\1", "cut"),
        (b"/a\0\0,s\0\0", "cut"),
        (b"#bundle\0", "cut"),
        (b"#bundle\0" + bytes(7) + b"\1" + struct.pack(">i", -4), "wrong length"),
        (b"#bundle\0" + bytes(7) + b"\1" + struct.pack(">i", 8) + b"/a\0\0", "wrong length"),
        (b"#bundle\0" + bytes(7) + b"\1" + b"\0\0", "cut"),
        (b"/a\0\0" * 1000, "1500 bytes"),
    ],
)
def test_what_is_no_osc_is_refused(data, words):
    with pytest.raises(InputError, match=words):
        osc.messages_of(data)


def test_deep_and_long_bundles_are_refused():
    deep = built("/a")
    for _ in range(osc.DEPTH_MAX + 1):
        deep = bundle(IMMEDIATELY, deep)
    with pytest.raises(InputError, match="nested"):
        osc.messages_of(deep.dgram)
    many = bundle(IMMEDIATELY, *[built("/a")] * (osc.MESSAGES_MAX + 1))
    with pytest.raises(InputError, match="64 messages"):
        osc.messages_of(many.dgram)


@given(st.binary(max_size=200), st.sampled_from([b"", b"/a\0\0,", b"#bundle\0" + bytes(7) + b"\1"]))
def test_no_bytes_do_any_harm(noise, head):
    with contextlib.suppress(InputError):
        for message in osc.messages_of(head + noise):
            osc.operation_of(message, frozenset({"/a"}), Crossings({"/a": (0.5,)}))


def test_addresses_are_operations():
    assert asked("/hall/door") == {"op": "trigger", "kind": "osc", "address": "/hall/door"}
    assert asked("/hall/door", 1)["value"] == 1.0
    assert asked("/hall/door", 0.0) is None
    assert asked("/hall/door", False) is None
    levels = Crossings({"/fader": (0.5,)})
    moved = [asked("/fader", value, levels=levels) for value in (0.2, 0.6, 0.9, 0.4)]
    assert [one and round(one["value"], 1) for one in moved] == [None, 0.6, None, 0.4]
    assert asked("/lss/go", 1) == asked("/lss/go") == {"op": "go"}
    assert asked("/lss/stop", 0) is None
    assert asked("/lss/estop") == {"op": "estop"}
    assert asked("/lss/rest") == {"op": "stage.rest"}
    assert asked("/lss/arm/scare") == {"op": "arm", "cue": "scare"}
    assert asked("/lss/show/wave") == {"op": "stage.play", "show": "wave"}
    assert asked("/lss/rate", 0.5) == {"op": "rate", "ratio": 0.5}
    assert asked("/lss/seek", "wave") == {"op": "seek", "to": "wave"}
    assert asked("/lss/seek", 3) == {"op": "seek", "to": 3.0}
    assert asked("/lss/cue", "scare") == asked("/lss/cue/scare") == {"op": "cue", "label": "scare"}
    assert asked("/lss/cue/scare", 0) is None
    assert asked("/lss/enable/scare", 0) == {"op": "enable", "cue": "scare", "is_enabled": False}
    assert asked("/lss/enable/scare")["is_enabled"] is True
    for wrong in (("/lss/rearm",), ("/lss/rate", 7.0), ("/lss/go/now",), ("/else",), ("/lss/cue",)):
        with pytest.raises(InputError):
            asked(*wrong)


def test_what_is_sent_is_read_by_another_library():
    packets = [osc.packet_of(f"/lss/joint/j{n}", [n + 0.5]) for n in range(60)]
    bundles = osc.bundle_of(packets, 500)
    assert all(len(one) <= 500 for one in bundles)
    read = [timed.message for one in bundles for timed in OscPacket(one).messages]
    assert [(one.address, one.params) for one in read] == [
        (f"/lss/joint/j{n}", [n + 0.5]) for n in range(60)
    ]
    assert OscPacket(osc.packet_of("/lss/state", ["plays"])).messages[0].message.params == ["plays"]


def test_who_subscribes_gets_angles_for_a_minute_at_its_rate():
    both = Subscribers([("10.0.0.9", 9001)])
    assert both.add(("127.0.0.1", 9002), 5.0, 0.0)
    assert len(both.due(0.0)) == 2
    assert both.due(0.15) == [("10.0.0.9", 9001)]
    assert ("127.0.0.1", 9002) in both.due(0.2)
    assert len(both.all(SUBSCRIBED_S + 0.1)) == 1
    both.remove(("10.0.0.9", 9001))
    assert both.all(0.0) == [("10.0.0.9", 9001)]
    added = [both.add(("127.0.0.1", n), 1.0, 100.0) for n in range(1, 20)]
    assert sum(added) == SUBSCRIBERS_MAX - 1


class OscClient(asyncio.DatagramProtocol):
    """Another program with a UDP socket."""

    def __init__(self):
        self.got = []

    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, addr):
        found = OscPacket(data).messages
        self.got += [(one.message.address, one.message.params) for one in found]


def test_a_port_carries_out_at_the_time_of_a_bundle_and_answers_its_sender():
    done, said = [], []

    async def run():
        loop = asyncio.get_running_loop()
        gate = Gate("OSC", AllowList(["127.0.0.1/32"]), said.append)
        port = OscPort(
            gate,
            lambda operation, origin: done.append((loop.time(), operation.op, origin)),
            cues=CUES,
            state=lambda: {"state": "plays", "show_s": 1.5},
        )
        await port.open(("127.0.0.1", 0))
        _, client = await loop.create_datagram_endpoint(OscClient, remote_addr=port.place)
        _, stranger = await loop.create_datagram_endpoint(
            OscClient, local_addr=("127.0.0.2", 0), remote_addr=port.place
        )
        stranger.transport.sendto(built("/lss/estop").dgram)
        begun_s, at_s = loop.time(), datetime.now(UTC).timestamp() + 0.2
        client.transport.sendto(bundle(at_s, built("/hall/door", 1)).dgram)
        client.transport.sendto(built("/lss/go").dgram)
        client.transport.sendto(b"\0garbage")
        client.transport.sendto(built("/lss/subscribe").dgram)
        await asyncio.sleep(0.3)
        port.send_joints({"jaw": 12.5})
        port.send_joints({"jaw": 99.0})
        port.send_event("fault", "jaw hot")
        await asyncio.sleep(0.02)
        for one in (port, client.transport, stranger.transport):
            one.close()
        return begun_s, client.got

    begun_s, got = asyncio.run(run())
    assert [(op, origin) for _, op, origin in done] == [
        ("go", "OSC /lss/go from 127.0.0.1"),
        ("trigger", "OSC /hall/door from 127.0.0.1"),
    ]
    assert done[0][0] - begun_s < done[1][0] - begun_s
    assert done[1][0] - begun_s >= 0.2
    assert got == [
        ("/lss/state", ["plays"]),
        ("/lss/show_s", [1.5]),
        ("/lss/joint/jaw", [12.5]),
        ("/lss/event", ["fault", "jaw hot"]),
    ]
    assert len(said) == 2
    assert "127.0.0.2" in said[0]
