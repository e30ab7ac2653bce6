"""Binary pages of Robotis humanoids: bits of positions, times, checksums, both resolutions."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.reader import ForeignMotion, RefusedMotion
from lss_motion.interchange.robotis import NOT_KEYED, PAGE_BYTES, TORQUE_OFF, RobotisPagesReader

PATH = Path("m.bin")
Step = tuple[dict[int, int], int, int]


def page(
    *steps: Step, name: bytes = b"bow", repeat: int = 1, speed: int = 32, schedule: int = 10,
    count: int | None = None, following: int = 0,
) -> bytes:  # fmt: skip
    data = bytearray(PAGE_BYTES)
    data[: len(name)] = name
    data[15], data[16], data[22], data[25] = repeat, schedule, speed, following
    data[20] = len(steps) if count is None else count
    for index, (positions, pause, time) in enumerate(steps):
        row = [positions.get(servo, NOT_KEYED) for servo in range(31)]
        struct.pack_into("<31HBB", data, 64 + 64 * index, *row, pause, time)
    data[31] = (0xFF - sum(data)) & 0xFF
    return bytes(data)


def test_times_are_in_128ths_of_a_second_by_speed_and_pages_repeat() -> None:
    data = page(({1: 2048}, 0, 64), ({1: 3072}, 32, 64), speed=64, repeat=2, following=7)
    assert RobotisPagesReader().recognises(data)
    (motion,) = RobotisPagesReader().motions(PATH, data)
    assert isinstance(motion, ForeignMotion)
    (joint,) = motion.channels
    assert (motion.name, joint.name) == ("bow", "ID1")
    assert joint.times_s.tolist() == [0.25, 0.5, 0.875, 1.125]
    assert joint.values.tolist() == [0.0, 90.0, 0.0, 90.0]
    assert motion.notes[0.5].hold_s == 0.125
    assert "Not carried over: links to page 7 as next" in motion.comments


def test_servos_that_are_not_keyed_limp_or_nonsense_are_left_out_and_told() -> None:
    first = {1: 2048, 2: NOT_KEYED | 100, 3: 1024, 4: 40192, 5: 0, 6: 2048}
    second = {1: 1024, 2: 3072, 3: TORQUE_OFF | 1024, 4: 0, 5: 0, 6: 40192}
    (motion,) = RobotisPagesReader().motions(PATH, page((first, 0, 64), (second, 0, 64)))
    assert isinstance(motion, ForeignMotion)
    keys = {channel.name: channel.values.tolist() for channel in motion.channels}
    assert keys == {"ID1": [0.0, -90.0], "ID2": [90.0], "ID3": [-90.0], "ID6": [0.0]}
    told = "\n".join(motion.comments)
    assert "ID3 goes limp" in told
    assert "ID6 at 40192, which is no position" in told
    assert "ids 0, 4, 5, 7, " in told
    assert "ID2 at" not in told


def test_files_of_1024_positions_are_told_from_those_of_4096() -> None:
    (coarse,) = RobotisPagesReader().motions(PATH, page(({1: 512}, 0, 64), ({1: 768}, 0, 64)))
    assert isinstance(coarse, ForeignMotion)
    assert coarse.channels[0].values.tolist() == [0.0, 75.0]
    assert "1024 positions over 300 deg" in coarse.comments[0]


def test_pages_that_are_wrong_do_not_refuse_the_others() -> None:
    good = page(({1: 2048}, 0, 64))
    pages = [
        good,
        page(({1: 2048}, 0, 64), schedule=0),
        page(({1: 2048}, 0, 64), speed=0),
        page(({1: 2048}, 0, 0)),
        page(({1: 2048}, 0, 64), count=9),
        page(({1: NOT_KEYED}, 0, 64), name=b""),
    ]
    first, *refused = RobotisPagesReader().motions(PATH, b"".join(pages))
    assert isinstance(first, ForeignMotion)
    reasons = [motion.error.reason for motion in refused if isinstance(motion, RefusedMotion)]
    assert len(reasons) == 5
    for reason, words in zip(
        reasons,
        ["schedule 0 gives speeds", "speed 0", "step 1: takes no time", "9 steps", "no joint"],
        strict=True,
    ):
        assert words in reason


def test_a_page_with_a_wrong_checksum_is_not_read_and_told() -> None:
    broken = bytearray(page(({1: 2048}, 0, 64)))
    broken[100] ^= 1
    data = page(({1: 2048}, 0, 64)) * 2 + bytes(broken)
    first, second = RobotisPagesReader().motions(PATH, data)
    assert isinstance(first, ForeignMotion)
    assert isinstance(second, ForeignMotion)
    assert "Not carried over: pages 2: wrong checksum" in first.comments


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "0 bytes are not 1 to 256 pages"),
        (page(({1: 2048}, 0, 64))[:-1], "511 bytes are not 1 to 256 pages"),
        (bytes(PAGE_BYTES), "no page with steps and a right checksum"),
        (bytes(PAGE_BYTES) * 257, "131584 bytes are not 1 to 256 pages"),
    ],
)
def test_what_is_no_such_file_is_refused(data: bytes, reason: str) -> None:
    assert not RobotisPagesReader().recognises(data)
    with pytest.raises(InputError, match=reason):
        RobotisPagesReader().motions(PATH, data)
