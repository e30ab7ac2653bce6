"""CSV: wide and long, separators, decimal commas, gaps, frames, and errors."""

from __future__ import annotations

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.csv import CSV
from lss_motion.interchange.importing import read_motions
from lss_motion.interchange.mapping import mapped
from lss_motion.interchange.reader import ForeignMotion, Measure
from lss_motion.show.model import Interpolation

WIDE = "time_s,base_deg,elbow_rad,jaw_us,lift\n0,1,0.5,1500,7\n0.5,2,,1600,8\n1,3,1.5,1700,9\n"


def test_the_ending_of_a_column_is_its_unit(read_one) -> None:
    motion = read_one(CSV, WIDE)
    units = {channel.name: channel.unit for channel in motion.channels}
    assert units == {
        "base": Measure.DEG,
        "elbow": Measure.RAD,
        "jaw": Measure.US,
        "lift": Measure.DEG,
    }
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
    (base,) = read_one(CSV, data).channels
    assert (base.times_s.tolist(), base.values.tolist()) == ([0.0, 0.5], [1.5, 2.0])


def test_a_long_table_has_a_row_for_each_key_in_any_order(read_one) -> None:
    text = "time_s,servo,deg,ease,who\n1,a,10,linear,x\n0,a,5,,x\n1,b,3,,x\n0,a,5,,x\n"
    motion = read_one(CSV, text)
    a, b = motion.channels
    assert (a.times_s.tolist(), a.values.tolist()) == ([0.0, 1.0], [5.0, 10.0])
    assert b.times_s.tolist() == [1.0]
    assert motion.keyframes[1].ease is Interpolation.LINEAR
    assert "Not carried over: column who" in motion.comments


def test_a_dense_table_is_a_recording(read_one) -> None:
    rows = "".join(f"{n / 50},{n}\n" for n in range(100))
    assert read_one(CSV, "t_s,base\n" + rows).is_recording


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
    error = refusal(CSV, text)
    assert (error.line, reason in error.reason) == (line, True), error


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ("t_s,base\n0,1\n".encode("utf-16"), "a text file in UTF-8 is needed"),
        (b"t_s,b\xe4se\n0,1\n", "byte 0xe4 is not UTF-8"),
    ],
)
def test_another_encoding_is_refused(refusal, data: bytes, reason: str) -> None:
    assert reason in refusal(CSV, data).reason


def test_leading_blanks_change_nothing(read_one) -> None:
    motion = read_one(CSV, "\n  # made by hand\n  # fps: 25\n   frame,a_deg\n  0,1\n 1,2\n")
    assert motion.channels[0].times_s.tolist() == [0.0, 0.04]


@pytest.mark.parametrize(
    ("header", "first", "second"),
    [
        ("timestamp,a (deg)", "1700000000.00,1", "1700000000.05,2"),
        ("time (s),a", "0,1", "0.05,2"),
        ("Time [ms];a", "0;1", "50;2"),
        ("Time / s,a", "0,1", "0.05,2"),
        ("__time,a", "0,1", "0.05,2"),
        ("# time,a", "0,1", "0.05,2"),
        ("# made by hand\n# time (s) a (deg)", "0.0 1.0", "0.05 2.0"),
        ("time_ns,a", "1700000000000000000,1", "1700000000050000000,2"),
        ("timestamp_us,a", "0,1", "50000,2"),
        ("  time   a", "  0.00   1.0", "  0.05   2.0"),
        ("time;a", "00:00:01,00;1", "00:00:01,05;2"),
        ("time (hh:mm:ss),a", "23:00:00.00,1", "23:00:00.05,2"),
        ("datetime,a", "2024-05-01T10:00:00Z,1", "2024-05-01T10:00:00.050Z,2"),
        ("datetime,a", "2024-05-01 10:00:00,1", "2024-05-01 10:00:00.050,2"),
        ("Frame,Time (s),a", "0,0,1", "1,0.05,2"),
        ("date,a", "2024-05-01 10:00:00,1", "2024-05-01 10:00:00.050,2"),
        ("date,time,a", "2024-05-01,10:00:00,1", "2024-05-01,10:00:00.050,2"),
        ("Zeit [s];a", "0;1", "0,05;2"),
        ("time in ms,a", "0,1", "50,2"),
        ("sep=;\nt;a", "0;1", "0,05;2"),
        ("time,a\ns,deg", "0,1", "0.05,2"),
        ("Time\ta\n(ms)\t(deg)", "0\t1", "50\t2"),
        ("time,a\n# ms,deg", "0,1", "50,2"),
        ("time a\n[ms] [-]", "0 1", "50 2"),
        ("header.stamp.sec,header.stamp.nanosec,a", "4,980000000,1", "5,30000000,2"),
        ("secs,nsecs,a", "4,980000000,1", "5,30000000,2"),
    ],
)
def test_the_time_is_known_by_the_names_that_programs_give_it(
    read_one, header: str, first: str, second: str
) -> None:
    text = f"{header}\n{first}\n{second}\n"
    assert CSV.recognises(text.encode())
    (a,) = read_one(CSV, text).channels
    assert (a.name, a.unit, a.values.tolist()) == ("a", Measure.DEG, [1.0, 2.0])
    assert a.times_s[1] - a.times_s[0] == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize(
    "column",
    ["a (rad)", "a [rad]", "a_rad", "a {radians}", "a rad", "a/rad", "aRad", "a (RAD)", "a_Rad"],
)
def test_radians_are_radians_however_they_are_written(read_one, column: str) -> None:
    (a,) = read_one(CSV, f"t,{column}\n0,1\n").channels
    assert (a.name, a.unit) == ("a", Measure.RAD)


@pytest.mark.parametrize("name", ["head_turn", "left_s", "position[0]", "arm.pos", "second_finger"])
def test_a_name_that_only_looks_like_a_unit_is_a_joint(read_one, name: str) -> None:
    (a,) = read_one(CSV, f"t,{name}\n0,1\n").channels
    assert (a.name, a.unit) == (name, Measure.DEG)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("time,a (mm)\n0,1\n", "unit 'mm' is not read"),
        ("time,a_mrad\n0,1\n", "unit 'mrad' is not read"),
        ("time,a\ns,furlong\n0,1\n", "unit 'furlong' is not read"),
        ("time,a\nfortnights,deg\n0,1\n", "no column is the time"),
        ("time,a (rad/s)\n0,1\n", "no column is a joint"),
        ("time,a\nleft,right\n0,1\n", "'left' is not"),
        ("time (fortnights),a\n0,1\n", "no column is the time"),
        ("header.stamp.sec,a\n0,1\n", "no column is the time"),
        ("time,a\n10:20,1\n", "is not understood; write seconds"),
        ("time,a\n01:02:03:04,1\n", "is not understood; write seconds"),
        ("time (ms),a\n00:00:01,1\n", "is not understood; write seconds"),
        ("timestamp,a\n1700000000000,1\n", "give the unit"),
    ],
)
def test_a_unit_or_a_time_that_is_not_understood_is_refused(refusal, text, reason) -> None:
    assert CSV.recognises(text.encode())
    assert reason in refusal(CSV, text).reason


def test_the_values_of_a_long_table_may_have_their_unit_in_brackets(read_one) -> None:
    (a,) = read_one(CSV, "time (s),joint,position (rad)\n0,a,0.5\n1,a,1\n").channels
    assert (a.name, a.unit, a.values.tolist()) == ("a", Measure.RAD, [0.5, 1.0])


def test_a_comment_below_the_header_changes_nothing(read_one) -> None:
    (a,) = read_one(CSV, "time a\n# two rows\n0 1\n1 2\n").channels
    assert a.values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize("header", ["timestamp", "# time", "time (s)"])
def test_a_table_of_two_seconds_is_two_seconds_long(tmp_path, arm, header: str) -> None:
    rows = "".join(f"{1700000000 + n / 20:.2f},{n / 4:.3f},{10 - n / 4:.3f}\n" for n in range(41))
    (tmp_path / "stamp.csv").write_text(f"{header},base,elbow (deg)\n{rows}")
    (motion,) = read_motions(tmp_path / "stamp.csv")
    assert isinstance(motion, ForeignMotion)
    own = mapped(motion, arm, None)
    assert [channel.name for channel in own.channels] == ["base", "elbow"]
    assert [len(channel.times_s) for channel in own.channels] == [41, 41]
    assert own.channels[0].times_s[[0, -1]].tolist() == [0.0, pytest.approx(2.0)]


def test_the_time_of_a_plain_echo_of_ros_1_is_in_nanoseconds(read_one) -> None:
    text = "%time,a_rad\n1700000000000000000,1\n1700000000500000000,2\n"
    (a,) = read_one(CSV, text).channels
    assert a.times_s[1] - a.times_s[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    "column",
    ["a_vel", "a.velocity", "/states/a/velocity", "a_deg_s", "a (rad/s)", "a (deg/s^2)", "a_torque",
     "effort[0]", "field.velocity0", "a (dps)", "nsecs_per_s (rpm)"],
)  # fmt: skip
def test_speeds_and_forces_are_no_joints(read_one, column: str) -> None:
    motion = read_one(CSV, f"time_s,b_deg,{column}\n0,1,2\n1,2,3\n")
    assert [channel.name for channel in motion.channels] == ["b"]
    assert f"Not carried over: column {column}, which is no angle" in motion.comments


@pytest.mark.parametrize(
    "column", ["/joint_states/position[0]", "/joint_states/elbow/position", "field.position0"]
)
def test_positions_of_ros_topics_are_radians_and_that_is_said(read_one, column: str) -> None:
    motion = read_one(CSV, f"__time,{column}\n0,1\n1,2\n")
    assert motion.channels[0].unit is Measure.RAD
    assert f"Columns of ROS topics are radians (REP 103): {column}." in motion.comments


def test_a_row_of_units_is_no_row_of_values(read_one) -> None:
    motion = read_one(CSV, "time,joint,position\n[ms],,[rad]\n0,a,0.5\n500,a,1\n")
    (a,) = motion.channels
    assert (a.unit, a.times_s.tolist(), a.values.tolist()) == (Measure.RAD, [0.0, 0.5], [0.5, 1.0])
    a, b, c = read_one(CSV, "t_ms,a,b_rad,c\n-,rad,rad,\n0,1,2,3\n500,4,5,6\n").channels
    assert [one.unit for one in (a, b, c)] == [Measure.RAD, Measure.RAD, Measure.DEG]
    assert c.lines.tolist() == [3, 4]


def test_what_is_assumed_about_units_is_said(read_one) -> None:
    about = read_one(CSV, "time,a\n0,1\n1,2\n").comments
    assert "The times of column time have no unit and are read as seconds." in about
    assert not any("no unit" in text for text in read_one(CSV, "time,a\n0:00:01,1\n").comments)


def test_a_table_in_utf_16_is_read(tmp_path) -> None:
    (tmp_path / "t.txt").write_bytes("time_s\ta\n0\t1\n1\t2,5\n".encode("utf-16"))
    (motion,) = read_motions(tmp_path / "t.txt")
    assert isinstance(motion, ForeignMotion)
    assert motion.channels[0].values.tolist() == [1.0, 2.5]
    (tmp_path / "t.txt").write_bytes(b"\xff\xfea")
    with pytest.raises(InputError, match="is not UTF-16"):
        read_motions(tmp_path / "t.txt")


@pytest.mark.parametrize(("most", "is_said"), [(1.5, True), (30.0, False)])
def test_a_recording_that_may_be_in_radians_is_named(read_one, most: float, is_said: bool) -> None:
    rows = "".join(f"{n / 50},{most * n / 19},5\n" for n in range(20))
    about = read_one(CSV, f"time_s,a,b_deg\n{rows}").comments
    assert any("if they are radians" in text for text in about) is is_said
    assert not any("radians" in t for t in read_one(CSV, f"time_s,a_deg,b_deg\n{rows}").comments)
