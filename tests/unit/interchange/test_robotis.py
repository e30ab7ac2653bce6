"""Robotis motions: `.mtn` text and binary pages."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.reader import ForeignMotion, RefusedMotion
from lss_motion.interchange.robotis import (
    NOT_KEYED,
    PAGE_BYTES,
    ROBOTIS_PAGES,
    ROBOTIS_TEXT,
    TORQUE_OFF,
)


def mtn(steps: str, *, enable: int = 2, play: str = "2 0 2 2.0 32", kind: str = "") -> str:
    flags = " ".join(["0", *["1"] * enable, *["0"] * (25 - enable)])
    return (
        f"type=motion\nversion=1.01\nenable={flags}\n{kind}page_begin\nname=\n"
        f"compliance={' '.join('5' * 26)}\nplay_param=0 0 1 1.0 32\npage_end\n"
        f"page_begin\nname=Bow\ncompliance={' '.join('5' * 26)}\nplay_param={play}\n{steps}"
        "page_end\n"
    )


def step(one: int, two: int, pause_s: float = 0.0, play_s: float = 1.0) -> str:
    return f"step=0 {one} {two} {' '.join(['0'] * 23)} {pause_s} {play_s}\n"


def test_mtn_times_are_divided_by_the_speed_and_pages_repeat(read_one) -> None:
    motion = read_one(ROBOTIS_TEXT, mtn(step(512, 0) + step(768, 1023, 0.5, 0.5)))
    first, second = motion.channels
    assert (motion.name, first.name, second.name) == ("Bow", "ID1", "ID2")
    assert first.times_s.tolist() == [0.5, 0.75, 1.5, 1.75]
    assert first.values.tolist() == [0.0, 75.0, 0.0, 75.0]
    assert second.values[0] == -150.0
    assert motion.notes[0.75].hold_s == 0.25
    assert "Not carried over: links to page 2 as next, page 0 as exit" in motion.comments


def test_the_other_text_pages_are_read_if_one_is_wrong() -> None:
    text = mtn(step(512, 512)) + mtn(step(512, 512, 0.0, 0.0)).partition("type=motion\n")[2]
    good, bad = ROBOTIS_TEXT.motions(Path("m"), text.encode())
    assert isinstance(good, ForeignMotion)
    assert isinstance(bad, RefusedMotion)
    assert "takes 0 s" in bad.error.reason
    assert bad.error.line is not None


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (mtn(step(1, 2)).removesuffix("page_end\n"), 9, "no page_end: the file is cut short"),
        (mtn("step=1 2 3\n"), 13, "3 values, but 28 are required"),
        (mtn(step(1, 2))[:-20], 13, "the file was cut off, copy it again"),
        (mtn(step(1, 2), play="0 0 1 0 32"), 12, "speed 0 must be more than 0"),
        (mtn(step(1, 2), play="0 0 1e9 1 32"), 12, "repeat 1e+09 is not in 0 to 255"),
        (mtn(step(1, 2), kind="motor_type=0 2" + " 0" * 24 + "\n"), 4, "servo 1 is of type 2"),
        (mtn("wave=1\n"), 13, "'wave' is no key of a page"),
        (mtn(""), None, "no page with a step"),
        ("type=motion\npage_end\n", 2, "page_end is not allowed here"),
    ],
)
def test_a_wrong_mtn_line_is_refused_with_its_number(refusal, text, line, reason) -> None:
    error = refusal(ROBOTIS_TEXT, text)
    assert (error.line, reason in error.reason) == (line, True), error


def test_a_position_beyond_the_servo_is_refused() -> None:
    (bad,) = ROBOTIS_TEXT.motions(Path("m"), mtn(step(1024, 0)).encode())
    assert isinstance(bad, RefusedMotion)
    assert "position 1024 of servo 1: 0 to 1023" in bad.error.reason


# -- binary pages ---------------------------------------------------------------------------------

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
    assert ROBOTIS_PAGES.recognises(data)
    (motion,) = ROBOTIS_PAGES.motions(PATH, data)
    assert isinstance(motion, ForeignMotion)
    (joint,) = motion.channels
    assert (motion.name, joint.name) == ("bow", "ID1")
    assert joint.times_s.tolist() == [0.25, 0.5, 0.875, 1.125]
    assert joint.values.tolist() == [0.0, 90.0, 0.0, 90.0]
    assert motion.notes[0.5].hold_s == 0.125
    assert "Not carried over: links to page 7 as next" in motion.comments


def test_positions_that_are_not_set_limp_or_invalid_are_left_out() -> None:
    first = {1: 2048, 2: NOT_KEYED | 100, 3: 1024, 4: 40192, 5: 0, 6: 2048}
    second = {1: 1024, 2: 3072, 3: TORQUE_OFF | 1024, 4: 0, 5: 0, 6: 40192}
    (motion,) = ROBOTIS_PAGES.motions(PATH, page((first, 0, 64), (second, 0, 64)))
    assert isinstance(motion, ForeignMotion)
    keys = {channel.name: channel.values.tolist() for channel in motion.channels}
    assert keys == {"ID1": [0.0, -90.0], "ID2": [90.0], "ID3": [-90.0], "ID6": [0.0]}
    comments = "\n".join(motion.comments)
    assert "ID3 goes limp" in comments
    assert "ID6 at 40192, which is not a position" in comments
    assert "ids 0, 4, 5, 7, " in comments
    assert "ID2 at" not in comments


def test_files_with_1024_positions_are_recognised() -> None:
    (coarse,) = ROBOTIS_PAGES.motions(PATH, page(({1: 512}, 0, 64), ({1: 768}, 0, 64)))
    assert isinstance(coarse, ForeignMotion)
    assert coarse.channels[0].values.tolist() == [0.0, 75.0]
    assert "1024 positions over 300 deg" in coarse.comments[0]


def test_the_other_pages_are_read_if_one_is_wrong() -> None:
    good = page(({1: 2048}, 0, 64))
    pages = [
        good,
        page(({1: 2048}, 0, 64), schedule=0),
        page(({1: 2048}, 0, 64), speed=0),
        page(({1: 2048}, 0, 0)),
        page(({1: 2048}, 0, 64), count=9),
        page(({1: NOT_KEYED}, 0, 64), name=b""),
    ]
    first, *refused = ROBOTIS_PAGES.motions(PATH, b"".join(pages))
    assert isinstance(first, ForeignMotion)
    reasons = [motion.error.reason for motion in refused if isinstance(motion, RefusedMotion)]
    assert len(reasons) == 5
    for reason, words in zip(
        reasons,
        ["schedule 0 gives speeds", "speed 0", "step 1: takes no time", "9 steps", "no joint"],
        strict=True,
    ):
        assert words in reason


def test_a_page_with_a_wrong_checksum_is_listed_and_not_read() -> None:
    broken = bytearray(page(({1: 2048}, 0, 64)))
    broken[100] ^= 1
    data = page(({1: 2048}, 0, 64)) * 2 + bytes(broken)
    first, second = ROBOTIS_PAGES.motions(PATH, data)
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
def test_another_kind_of_file_is_refused(data: bytes, reason: str) -> None:
    assert not ROBOTIS_PAGES.recognises(data)
    with pytest.raises(InputError, match=reason):
        ROBOTIS_PAGES.motions(PATH, data)


def test_a_file_whose_last_page_is_cut_says_so() -> None:
    data = (page(({1: 2048}, 0, 64)) * 3)[:-100]
    assert ROBOTIS_PAGES.recognises(data)
    with pytest.raises(InputError, match="1436 bytes are not 1 to 256 pages of 512: cut short"):
        ROBOTIS_PAGES.motions(PATH, data)


def test_mtn_numbers_may_have_decimal_commas(read_one) -> None:
    text = mtn(step(512, 0) + step(768, 1023, 0.5, 0.5))
    plain = read_one(ROBOTIS_TEXT, text)
    commas = text.replace("1.01", "1,01").replace("0.5", "0,5").replace("2.0", "2,0")
    motion = read_one(ROBOTIS_TEXT, commas)
    assert motion.channels[0].times_s.tolist() == plain.channels[0].times_s.tolist()
    assert motion.notes[0.75].hold_s == 0.25


@pytest.mark.parametrize(
    "tail", [b"\0\0\xfe\xffold bytes", b"page_end\n\xc0\xff", b" stray", b"\r\n\x1a"]
)
def test_garbage_after_the_last_page_is_listed_and_left_out(read_one, tail: bytes) -> None:
    text = mtn(step(512, 0) + step(768, 1023, 0.5, 0.5)).rstrip().encode()
    if tail.startswith(b"page_end"):
        text = text.removesuffix(b"page_end")
    motion = read_one(ROBOTIS_TEXT, text + tail)
    assert motion.channels[0].times_s.tolist() == [0.5, 0.75, 1.5, 1.75]
    listed = any("after the last page" in comment for comment in motion.comments)
    assert listed is (tail.strip() != b"\x1a")


def test_lines_outside_of_the_pages_are_listed(read_one) -> None:
    text = mtn(step(512, 0)).replace("page_end\npage_begin", "page_end zz\nwhat=1\npage_begin")
    comments = read_one(ROBOTIS_TEXT, text).comments
    assert "Not carried over: line 8, after page_end: 'zz'" in comments
    assert "Not carried over: line 9, outside of the pages: 'what=1'" in comments
