"""OpenCat skills: postures, gaits, behaviours with loops, and errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.interchange.importing import READERS
from lss_motion.interchange.opencat import DELAY_S, GAIT_FRAME_S, JUMP_S, OPENCAT, STEP_S
from lss_motion.interchange.reader import ForeignMotion, RefusedMotion

POSTURE = "const int8_t up[] PROGMEM = {1, 0, 0, 1,\n 1,2,3,4,5,6,7,8,9,10,11,12,13,14,15,16,};\n"
GAIT = (
    "const int8_t wkF[] PROGMEM = {\n2, 0, 5, 2, // two frames, {ratio 2}\n"
    "  10, 0, 0, 0, 0, 0, 0, -50,\n  20, 0, 0, 0, 0, 0, 0, 50,\n};\n"
)
TAIL = "0,0,0,0,0,0,0,0,0,0,0,0,0,0,0"
BEHAVIOUR = (
    "/* a\n comment */ const int8_t hi[] PROGMEM = {\n-3, 0, 0, 1,\n 1, 2, 3,\n"
    f" 0,{TAIL}, 8, 2, 0, 0,\n 40,{TAIL}, 8, 0, 0, 0,\n 0,{TAIL}, 0, 0, 2, 10,\n}};\n"
)


def test_each_array_is_a_motion_with_its_name() -> None:
    up, walk, hi = OPENCAT.motions(Path("m"), (POSTURE + GAIT + BEHAVIOUR).encode())
    assert (up.name, walk.name, hi.name) == ("up", "wkF", "hi")
    assert isinstance(up, ForeignMotion)
    assert {channel.name: channel.values.tolist() for channel in up.channels}["J15"] == [16.0]


def test_a_page_of_the_skill_library_has_a_bare_array_and_is_recognised() -> None:
    page = (
        b"# Up\n\nModel: Bittle\n\n# Token\nK\n\n# Data\n\n{ \n1, 0, 0, 1,\n"
        + b"30, " * 16
        + b"\n};\n"
    )
    assert OPENCAT.recognises(page)
    (up,) = OPENCAT.motions(Path("m"), page)
    assert isinstance(up, ForeignMotion)
    assert [channel.values.tolist() for channel in up.channels] == [[30.0]] * 16
    assert not OPENCAT.recognises(b'{\n  "poses": [[1, 2, 3, 4, 5]]\n}\n')


def test_older_files_have_arrays_of_characters() -> None:
    text = POSTURE.replace("const int8_t", "#define NYBBLE\n\nconst char").encode()
    assert next(reader for reader in READERS if reader.recognises(text)).name == "opencat"
    (up,) = OPENCAT.motions(Path("m"), text)
    assert isinstance(up, ForeignMotion)
    assert [float(channel.values[0]) for channel in up.channels] == [float(n) for n in range(1, 17)]
    assert not OPENCAT.recognises(b'const char name[] = {"1, 2, 3"};\n')


def test_the_last_joints_walk_and_come_back_to_the_first_frame(read_one) -> None:
    motion = read_one(OPENCAT, GAIT)
    assert [channel.name for channel in motion.channels] == [f"J{n}" for n in range(8, 16)]
    assert motion.channels[0].values.tolist() == [20.0, 40.0, 20.0]
    assert motion.channels[7].values.tolist() == [-100.0, 100.0, -100.0]
    assert motion.channels[0].times_s.tolist() == [0.0, GAIT_FRAME_S, 2 * GAIT_FRAME_S]
    assert "Not carried over: roll 0, pitch 5" in motion.comments
    assert any(f"assumed to take {GAIT_FRAME_S:g} s" in text for text in motion.comments)


def test_a_behaviour_repeats_its_loop_and_waits_its_delays(read_one) -> None:
    motion = read_one(OPENCAT, BEHAVIOUR)
    head = motion.channels[0]
    assert head.values.tolist() == [0.0, 40.0, 0.0, 40.0, 0.0, 40.0, 0.0]
    way_s = 40 / (8 / 4) * STEP_S
    expected, at_s = [0.0], 2 * DELAY_S
    for _ in range(3):
        expected += [at_s := at_s + way_s, at_s := at_s + JUMP_S]
    assert head.times_s.tolist() == pytest.approx(expected)
    assert motion.notes[0.0].hold_s == 2 * DELAY_S
    assert "Not carried over: frame 3: trigger at axis 2, 10 deg" in motion.comments


def test_an_endless_loop_is_played_once(read_one) -> None:
    motion = read_one(OPENCAT, BEHAVIOUR.replace("1, 2, 3", "1, 2, -1"))
    assert len(motion.channels[0].values) == 3
    assert "Not carried over: the endless loop: it is played once" in motion.comments


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("0, -50", "-50", "do not make 2 frames"),
        ("-50", "-150", "'-150' is not a whole number from -128 to 127"),
        ("2, 0, 5, 2", "0, 0, 5, 2", "no skill"),
        ("2, 0, 5, 2", "2, 0, 5, 0", "ratio 0 must be 1 or more"),
        ("10, 0", "1-0, 0", "'1-0' is not a number"),
    ],
)
def test_a_wrong_array_is_refused_alone_with_its_line(old, new, reason) -> None:
    text = POSTURE + GAIT.replace(old, new)
    good, bad = OPENCAT.motions(Path("m"), text.encode())
    assert isinstance(good, ForeignMotion)
    assert isinstance(bad, RefusedMotion)
    assert (bad.error.line, reason in bad.error.reason) == (3, True), bad.error


def test_a_text_without_arrays_is_refused(refusal) -> None:
    assert "has no array of numbers" in refusal(OPENCAT, "int8_t x[] = f();").reason


def test_an_array_that_was_cut_off_is_listed_and_refused() -> None:
    walk, hi = OPENCAT.motions(Path("m"), (GAIT + BEHAVIOUR)[:-20].encode())
    assert isinstance(walk, ForeignMotion)
    assert isinstance(hi, RefusedMotion)
    assert hi.name == "hi"
    assert str(hi.error) == "m:7: this array has no end: the file was cut off"


def test_numbers_after_the_frames_of_the_header_are_left_out(read_one) -> None:
    row = "10, 0, 0, 0, 0, 0, 0, -50,\n"
    walk = f"const int8_t w[] PROGMEM = {{\n2, 0, 0, 1,\n{row}{row}{row}}};\n"
    motion = read_one(OPENCAT, walk)
    assert [channel.name for channel in motion.channels] == [f"J{n}" for n in range(8, 16)]
    assert len(motion.channels[0].values) == 3
    assert "Not carried over: 8 numbers after the 2 frames" in motion.comments
    up = read_one(OPENCAT, POSTURE.replace("16,}", "16, 0, 0, 0}"))
    assert [channel.values.tolist() for channel in up.channels] == [[n] for n in range(1, 17)]
    assert "Not carried over: 3 numbers after the 1 frame" in up.comments
    hi = read_one(OPENCAT, BEHAVIOUR.replace("{\n-3", "{\n-2").replace("1, 2, 3", "0, 0, 0"))
    assert hi.channels[0].values.tolist() == [0.0, 40.0]
    assert "Not carried over: 20 numbers after the 2 frames" in hi.comments
