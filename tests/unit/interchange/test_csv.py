"""CSV: wide and long, separators, decimal commas, gaps, frames, and errors."""

from __future__ import annotations

import pytest

from lss_motion.interchange.csv import CsvReader
from lss_motion.interchange.reader import Unit
from lss_motion.show.model import Interpolation

WIDE = "time_s,base_deg,elbow_rad,jaw_us,lift\n0,1,0.5,1500,7\n0.5,2,,1600,8\n1,3,1.5,1700,9\n"


def test_the_ending_of_a_column_is_its_unit(read_one) -> None:
    motion = read_one(CsvReader(), WIDE)
    units = {channel.name: channel.unit for channel in motion.channels}
    assert units == {"base": Unit.DEG, "elbow": Unit.RAD, "jaw": Unit.US, "lift": Unit.DEG}
    assert motion.channels[1].times_s.tolist() == [0.0, 1.0]
    assert motion.channels[0].values.tolist() == [1.0, 2.0, 3.0]
    assert "Columns without a unit are degrees: lift." in motion.comments
    assert not motion.is_recording


@pytest.mark.parametrize(
    "data",
    [
        b"\xef\xbb\xbft_s;base\r\n0;1,5\r\n0,5;2\r\n",
        b"t_ms\tbase_deg\n0\t1,5\n500\t2.0\n",
        b"# made by hand\n\n# fps: 2\nframe,base\n0,1.5\n1,2\n",
        b'"t_s","base"\n"0","1.5"\n0.5,2\n\n',
        b"Time,base,\n0,1.5,\n0.5,2,\n",
    ],
)
def test_separators_line_ends_marks_and_frames_give_the_same_motion(read_one, data: bytes) -> None:
    (base,) = read_one(CsvReader(), data).channels
    assert (base.times_s.tolist(), base.values.tolist()) == ([0.0, 0.5], [1.5, 2.0])


def test_a_long_table_has_a_row_for_each_key_in_any_order(read_one) -> None:
    text = "time_s,servo,deg,ease,who\n1,a,10,linear,x\n0,a,5,,x\n1,b,3,,x\n0,a,5,,x\n"
    motion = read_one(CsvReader(), text)
    a, b = motion.channels
    assert (a.times_s.tolist(), a.values.tolist()) == ([0.0, 1.0], [5.0, 10.0])
    assert b.times_s.tolist() == [1.0]
    assert motion.keyframes[1].ease is Interpolation.LINEAR
    assert "Not carried over: column who" in motion.comments


def test_a_dense_table_is_a_recording(read_one) -> None:
    rows = "".join(f"{n / 50},{n}\n" for n in range(100))
    assert read_one(CsvReader(), "t_s,base\n" + rows).is_recording


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("t_s,base\n0,1\n1,nan\n", 3, "'nan' is not a number"),
        ("t_s,base\n0,1\n1,inf\n", 3, "'inf' is not a number"),
        ("t_s,base\n0,1\n1,1e999\n", 3, "out of range"),
        ('t_s,base\n0,1\n1,"2,5"\n', 3, "'2,5' is not a number"),
        ("t_s,base\n0,1\n1,two\n", 3, "'two' is not a number"),
        ("t_s,base\n0,1\n0,2\n", 3, "times must increase, but 0 s follows 0 s"),
        ("t_s,base\n1,1\n0.5,2\n", 3, "times must increase"),
        ("t_s,base\n0,1\n1\n", 3, "1 cells, but the header has 2: is the file cut short?"),
        ("t_s,base\n0,1\n1,2,3\n", 3, "3 cells, but the header has 2"),
        ("t_s,base,base\n0,1,2\n", 1, "column 'base' occurs twice"),
        ("t_s,base_deg,base\n0,1,2\n", 1, "joint 'base' has two columns"),
        ("# x\nbase,elbow\n0,1\n", 2, "no column is the time; name it time_s"),
        ("frame,base\n0,1\n", 1, "frames need their rate"),
        ("# fps: 0\nframe,base\n0,1\n", 1, "fps 0 must be more than 0"),
        ("t_s,base\n", None, "has no row with a value"),
        ("t_s,base\n1,\n", None, "has no row with a value"),
        ("t_s,\n1,2\n", 1, "no column is a joint"),
        ("# only this\n", None, "has no header line"),
        ("t_s,servo,deg\n1,a,2\n1,a,3\n", 3, "'a' is already at 2 at 1 s"),
        ("t_s,servo,deg\n1,,2\n", 2, "names no joint"),
        ("t_s,servo,deg,ease\n1,a,2,liner\n", 2, "unknown ease 'liner'; did you mean 'linear'?"),
        ("t_s,servo,deg,ease\n1,a,2,hold\n1,b,2,linear\n", 3, "two eases at 1 s"),
        ("t_s,base\n0," + "1" * 50 + "\n", 2, "is not a number"),
        ('t_s,base\n0,"' + "1" * 200_000 + '"\n', 2, "no table: field larger than field limit"),
    ],
)
def test_a_wrong_row_is_refused_with_its_line(refusal, text, line, reason) -> None:
    error = refusal(CsvReader(), text)
    assert (error.line, reason in error.reason) == (line, True), error


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ("t_s,base\n0,1\n".encode("utf-16"), "a text file in UTF-8 is needed"),
        (b"t_s,b\xe4se\n0,1\n", "byte 0xe4 is not UTF-8"),
    ],
)
def test_another_encoding_is_refused(refusal, data: bytes, reason: str) -> None:
    assert reason in refusal(CsvReader(), data).reason


def test_leading_blanks_change_nothing(read_one) -> None:
    motion = read_one(CsvReader(), "\n  # made by hand\n  # fps: 25\n   frame,a_deg\n  0,1\n 1,2\n")
    assert motion.channels[0].times_s.tolist() == [0.0, 0.04]
