"""MIDI, Art-Net and FPP messages: fixtures written down by hand, both ways, and garbage."""

from __future__ import annotations

import random
import struct

import pytest

from lss_motion.stage.timecode import messages as m
from lss_motion.stage.timecode.messages import MtcDecoder
from lss_motion.stage.timecode.timecode import (
    CODED,
    FPS_25,
    FPS_29_97_DROP,
    FPS_30,
    Timecode,
    timecode_of,
)


def messages(data):
    return [data[at : at + 2] for at in range(0, len(data), 2)]


def test_eight_quarter_frames_are_the_label_of_the_frame_of_the_first():
    decoder = MtcDecoder()
    pieces = messages(bytes.fromhex("F10A F110 F128 F130 F147 F150 F162 F172"))
    read = [r for n, piece in enumerate(pieces) for r in decoder.take(piece, 10 * n)]
    assert {reading.timecode for reading in read} == {Timecode(2, 7, 8, 10)}
    assert {reading.rate for reading in read} == {FPS_25}
    assert {reading.direction for reading in read} == {1}
    assert [(r.instant_ns, r.past_frames) for r in read] == [(10 * n, n / 4) for n in range(8)]


@pytest.mark.parametrize("rate", CODED, ids=lambda rate: rate.name)
def test_what_is_sent_is_read_in_every_rate_and_a_lost_piece_gives_no_wrong_label(rate):
    decoder, luck = MtcDecoder(), random.Random(5)
    first = Timecode(23, 59, 58, 4).frame(rate)
    labels, read = set(), []
    for quarter in range(8 * 40):
        frame = first + quarter // 8 * 2
        labels.add(timecode_of(frame, rate))
        if luck.random() < 0.02:
            continue
        message = m.quarter_frame(frame, quarter % 8, rate)
        read += decoder.take(message, quarter)
    assert len(read) > 8 * 25
    assert {reading.timecode for reading in read} <= labels
    for reading in read:
        frame = first + reading.instant_ns / 4
        assert reading.timecode.frame(rate) + reading.past_frames == pytest.approx(
            frame % rate.frames_per_day
        )


def test_backward_pieces_are_backward_and_a_locate_stands():
    decoder = MtcDecoder()
    pieces = messages(bytes.fromhex("F10A F110 F128 F130 F147 F150 F162 F172"))[::-1]
    read = [r for n, piece in enumerate(pieces * 2) for r in decoder.take(piece, n)]
    assert {reading.direction for reading in read} == {-1}
    assert {reading.timecode for reading in read} == {Timecode(2, 7, 8, 10)}
    located = decoder.take(bytes.fromhex("F07F7F0101 61 02 03 04 F7"), 9)
    assert [(r.timecode, r.rate, r.direction) for r in located] == [
        (Timecode(1, 2, 3, 4), FPS_30, 0)
    ]
    assert m.locate(Timecode(1, 2, 3, 4), FPS_30).hex() == "f07f7f010161020304f7"


def test_an_art_net_packet_is_the_one_of_the_standard():
    packet = b"Art-Net\0" + bytes.fromhex("0097 000E 0000 02 3B 09 17 02")
    assert m.artnet_packet(Timecode(23, 9, 59, 2), FPS_29_97_DROP) == packet
    read = m.read_artnet(packet)
    assert read == (Timecode(23, 9, 59, 2), FPS_29_97_DROP, 0)
    dropped = bytearray(packet)
    dropped[14:16] = 1, 0  # 23:09:00;01 does not exist.
    assert m.read_artnet(bytes(dropped)) is None


def test_an_fpp_packet_is_the_one_of_its_sources():
    packet = b"FPPD\x01" + struct.pack("<HBBIf", 19, 2, 0, 500, 12.5) + b"show.fseq"
    assert m.read_fpp(packet) is None, "the name has no end"
    packet = b"FPPD\x01" + struct.pack("<HBBIf", 20, 2, 0, 500, 12.5) + b"show.fseq\0"
    read = m.read_fpp(packet)
    assert read == ("sync", "sequence", 500, 12.5, "show.fseq")
    assert m.fpp_packet(read) == packet


@pytest.mark.parametrize("read", [m.read_artnet, m.read_fpp])
def test_garbage_is_no_packet_and_raises_nothing(read):
    luck = random.Random(7)
    good = [
        m.artnet_packet(Timecode(1, 2, 3, 4), FPS_25),
        m.fpp_packet(m.FppReading("sync", "media", 1, 2.0, "a.mp3")),
    ]
    for _ in range(4000):
        data = bytearray(luck.choice(good))
        for _ in range(luck.randrange(1, 6)):
            data[luck.randrange(len(data))] = luck.randrange(256)
        found = read(bytes(data[: luck.randrange(len(data) + 1)]))
        if found is not None and read is m.read_artnet:
            assert found.timecode.is_valid(found.rate)
        elif found is not None:
            assert 0.0 <= found.seconds <= 86400.0
    nan = b"FPPD\x01" + struct.pack("<HBBIf", 12, 2, 0, 5, float("nan")) + b"a\0"
    assert m.read_fpp(nan) is None


def test_midi_garbage_raises_nothing_and_gives_only_labels_that_exist():
    luck, decoder = random.Random(11), MtcDecoder()
    for number in range(20000):
        size = luck.choice((0, 1, 2, 2, 2, 2, 10, 12))
        message = bytes(luck.randrange(256) for _ in range(size))
        if size == 2:
            message = bytes((0xF1, luck.randrange(256)))
        for reading in decoder.take(message, number):
            assert reading.timecode.is_valid(reading.rate)
