"""sACN packets as levels: those of another library, overtaken, of several sources, and lost."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lss_motion.errors import InputError
from lss_motion.stage.triggers import sacn
from lss_motion.stage.triggers.sacn import SacnPort
from lss_motion.stage.triggers.sources import AllowList, Gate

DESK, OTHER = bytes(range(16)), bytes(16)
THRESHOLDS = {"1/5": (127.0,), "300/512": (127.0,)}


def packet(levels=(), *, universe=1, source=DESK, sequence=0, priority=100, options=0, start=0):
    """Return a data packet as E1.31 table 4-1 has it, written without the code under test."""
    count = 1 + len(levels)
    size = 126 + len(levels)
    return (
        b"\x00\x10\x00\x00ASC-E1.17\x00\x00\x00"
        + struct.pack(">H", 0x7000 | (size - 16))
        + b"\x00\x00\x00\x04"
        + source
        + struct.pack(">H", 0x7000 | (size - 38))
        + b"\x00\x00\x00\x02"
        + b"desk".ljust(64, b"\0")
        + bytes((priority, 0, 0, sequence, options))
        + struct.pack(">H", universe)
        + struct.pack(">H", 0x7000 | (size - 115))
        + b"\x02\xa1\x00\x00\x00\x01"
        + struct.pack(">H", count)
        + bytes((start,))
        + bytes(levels)
    )


def test_a_packet_of_another_library_is_read():
    library = pytest.importorskip("sacn", reason="pip install sacn")
    data = library.messages.data_packet.DataPacket(
        tuple(DESK), "desk", 7, dmxData=tuple(range(255, -1, -1)), priority=120, sequence=9
    )
    read = sacn.packet_of(bytes(data.getBytes()))
    assert (read.source, read.universe, read.priority, read.sequence) == (DESK, 7, 120, 9)
    assert read.levels[:256] == bytes(range(255, -1, -1))


def test_what_carries_no_levels_is_left_out():
    assert sacn.packet_of(packet((1, 2), start=0xDD)) is None
    assert sacn.packet_of(packet((1, 2), options=0x80)) is None
    assert sacn.packet_of(packet((1, 2), options=0x40)).is_terminated
    assert sacn.packet_of(packet((1,), universe=300)).universe == 300
    for wrong in (b"", b"Art-Net\0", packet()[:100], packet((1, 2))[:-1], packet(universe=0)):
        with pytest.raises(InputError):
            sacn.packet_of(wrong)


@given(st.binary(max_size=300), st.integers(0, 160))
def test_no_bytes_do_any_harm(noise, keep):
    with contextlib.suppress(InputError):
        sacn.packet_of(packet((1, 2, 3))[:keep] + noise)


def level(value, **fields):
    return sacn.packet_of(packet((0, 0, 0, 0, value), **fields))


def test_levels_cross_a_threshold_once():
    levels = sacn.Levels(THRESHOLDS)
    assert levels.universes == (1, 300)
    given_levels = [200, 200, 0, 0, 128, 255, 121, 119, 130]
    crossed = [
        found
        for n, value in enumerate(given_levels)
        for found in levels.take(level(value, sequence=n), 0.02 * n)
    ]
    assert crossed == [("1/5", 0.0), ("1/5", 128.0), ("1/5", 119.0), ("1/5", 130.0)]
    assert levels.take(level(0, sequence=7), 1.0) == [], "an overtaken packet"
    assert levels.take(level(0, universe=2), 1.0) == []


def test_the_highest_priority_counts_and_then_the_highest_level():
    levels = sacn.Levels(THRESHOLDS)
    assert levels.take(level(0), 0.0) == []
    assert levels.take(level(255, source=OTHER, priority=50), 0.1) == []
    assert levels.take(level(255, source=OTHER, priority=100, sequence=1), 0.2) == [("1/5", 255.0)]
    assert levels.take(level(0, sequence=1), 0.3) == []
    ended = level(255, source=OTHER, sequence=2, options=0x40)
    assert levels.take(ended, 0.4) == [("1/5", 0.0)]


def test_a_source_that_comes_back_with_its_level_up_fires_nothing():
    levels = sacn.Levels(THRESHOLDS)
    levels.take(level(0), 0.0)
    assert levels.take(level(255, sequence=1), 0.1) == [("1/5", 255.0)]
    assert levels.take(level(255, sequence=9), 5.0) == []
    assert levels.take(level(0, sequence=10), 5.1) == [("1/5", 0.0)]
    for n in range(100):
        levels.take(level(0, source=bytes([n]) * 16), 6.0)
    assert len(levels._sources[1]) <= sacn.SOURCES_MAX


def test_a_port_on_the_loopback_sends_what_crosses():
    done, said = [], []

    async def run():
        gate = Gate("sACN", AllowList(["127.0.0.1"]), said.append, rate_hz=sacn.RATE_HZ)
        port = SacnPort("127.0.0.1", gate, lambda *found: done.append(found), port=0)
        port.watch(sacn.Levels(THRESHOLDS))
        await port.open()
        place = port._socket.getsockname()
        with (
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as desk,
            socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
        ):
            stranger.bind(("127.0.0.3", 0))
            stranger.sendto(packet((0, 0, 0, 0, 255)), place)
            for n, value in enumerate((0, 255)):
                desk.sendto(packet((0, 0, 0, 0, value), sequence=n), place)
            desk.sendto(b"noise", place)
            await asyncio.sleep(0.05)
        port.close()

    asyncio.run(run())
    ((operation, origin),) = done
    assert (operation.kind, operation.address, operation.value) == ("sacn", "1/5", 255.0)
    assert origin == "sACN 1/5 from 127.0.0.1"
    assert len(said) == 2
