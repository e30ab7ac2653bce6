"""Webots, Robotis text, Maestro XML, SSC-32 tables and PyPose: one small file each."""

from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.interchange.maestro import MaestroReader
from lss_motion.interchange.pypose import PyPoseReader
from lss_motion.interchange.reader import ForeignMotion, RefusedMotion, Unit
from lss_motion.interchange.robotis import RobotisTextReader
from lss_motion.interchange.ssc32_table import Ssc32TableReader
from lss_motion.interchange.webots import WebotsReader

WEBOTS = """\
#WEBOTS_MOTION,V1.0,ArmL,ArmR,Lift
00:00:000,Rest,-0.5,0.2,0
00:01:500,Up,*,0.4,*
01:00:000,Rest,-0.5,0.2,0
"""


def test_a_webots_star_keys_nothing(read_one) -> None:
    motion = read_one(WebotsReader(), WEBOTS)
    left, right, lift = motion.channels
    assert left.times_s.tolist() == [0.0, 60.0]
    assert right.times_s.tolist() == [0.0, 1.5, 60.0]
    assert right.values.tolist() == [0.2, 0.4, 0.2]
    assert (right.unit, lift.unit) == (Unit.RAD, Unit.RAD_OR_M)
    assert motion.notes[1.5].label == "Up"


def test_line_ends_and_a_byte_order_mark_change_nothing(read_one) -> None:
    plain = read_one(WebotsReader(), WEBOTS)
    for content in (
        b"\xef\xbb\xbf" + WEBOTS.encode(),
        WEBOTS.replace("\n", "\r\n").encode(),
        WEBOTS.replace("\n", "\r").encode(),
    ):
        other = read_one(WebotsReader(), content)
        assert [c.values.tolist() for c in other.channels] == [
            c.values.tolist() for c in plain.channels
        ]


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("*,0.4,*", "0.4", 3, "2 values for 3 joints"),
        ("00:01:500", "1.5", 3, "'1.5' is not a time of the form mm:ss:mmm"),
        ("0.4", "nan", 3, "'nan' is not a number"),
        ("0.4", "1e999", 3, "'1e999' is out of all bounds"),
        ("01:00:000", "00:01:000", 4, "times must increase, but this is 1 s after 1.5 s"),
        ("ArmL,ArmR", "ArmL,ArmL", 1, "every joint needs a name of its own"),
        (",ArmL,ArmR,Lift", "", 1, "the first line must be"),
    ],
)
def test_a_wrong_webots_line_is_refused_with_its_number(refusal, old, new, line, reason) -> None:
    error = refusal(WebotsReader(), WEBOTS.replace(old, new))
    assert (error.line, reason in error.reason) == (line, True), error


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
    motion = read_one(RobotisTextReader(), mtn(step(512, 0) + step(768, 1023, 0.5, 0.5)))
    first, second = motion.channels
    assert (motion.name, first.name, second.name) == ("Bow", "ID1", "ID2")
    assert first.times_s.tolist() == [0.5, 0.75, 1.5, 1.75]
    assert first.values.tolist() == [0.0, 75.0, 0.0, 75.0]
    assert second.values[0] == -150.0
    assert motion.notes[0.75].hold_s == 0.25
    assert "Not carried over: links to page 2 as next, page 0 as exit" in motion.comments


def test_a_page_that_is_wrong_does_not_refuse_the_others() -> None:
    text = mtn(step(512, 512)) + mtn(step(512, 512, 0.0, 0.0)).partition("type=motion\n")[2]
    good, bad = RobotisTextReader().motions(Path("m"), text.encode())
    assert isinstance(good, ForeignMotion)
    assert isinstance(bad, RefusedMotion)
    assert "takes 0 s" in bad.error.reason
    assert bad.error.line is not None


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (mtn(step(1, 2)).removesuffix("page_end\n"), 9, "no page_end: the file is cut short"),
        (mtn("step=1 2 3\n"), 13, "3 values where 28 belong"),
        (mtn(step(1, 2), play="0 0 1 0 32"), 12, "speed 0 must be more than 0"),
        (mtn(step(1, 2), play="0 0 1e9 1 32"), 12, "repeat 1e+09 is not in 0 to 255"),
        (mtn(step(1, 2), kind="motor_type=0 2" + " 0" * 24 + "\n"), 4, "servo 1 is of type 2"),
        (mtn("wave=1\n"), 13, "'wave' is no key of a page"),
        (mtn(""), None, "no page with a step"),
        ("type=motion\npage_end\n", 2, "stands where no page can end"),
    ],
)
def test_a_wrong_mtn_line_is_refused_with_its_number(refusal, text, line, reason) -> None:
    error = refusal(RobotisTextReader(), text)
    assert (error.line, reason in error.reason) == (line, True), error


def test_a_position_beyond_the_servo_is_refused() -> None:
    (bad,) = RobotisTextReader().motions(Path("m"), mtn(step(1024, 0)).encode())
    assert isinstance(bad, RefusedMotion)
    assert "position 1024 of servo 1: 0 to 1023" in bad.error.reason


MAESTRO = """\
<!--Pololu Maestro servo controller settings file-->
<UscSettings version="1">
  <Channels>
    <Channel name="pan" mode="Servo" speed="0" acceleration="0" neutral="6000" range="1905" />
    <Channel name="" mode="Servo" speed="20" acceleration="0" />
  </Channels>
  <Sequences>
    <Sequence name="look">
      <Frame name="left" duration="500">4000 6000</Frame>
      <Frame name="right" duration="1000">8000 0</Frame>
    </Sequence>
    <Sequence name="rest">
      <Frame name="middle" duration="500">6000 6000</Frame>
    </Sequence>
  </Sequences>
  <Script ScriptDone="true">goto begin</Script>
</UscSettings>
"""


def test_maestro_targets_are_quarters_of_microseconds_reached_at_the_end_of_a_frame() -> None:
    look, rest = MaestroReader().motions(Path("m"), MAESTRO.encode())
    assert isinstance(look, ForeignMotion)
    pan, second = look.channels
    assert (look.name, rest.name) == ("look", "rest")
    assert (pan.name, pan.unit, second.name) == ("pan", Unit.US, "channel1")
    assert (pan.times_s.tolist(), pan.values.tolist()) == ([0.5, 1.5], [1000.0, 2000.0])
    assert second.values.tolist() == [1500.0]
    assert "Not carried over: channel1 is switched off" in look.comments
    assert "Not carried over: speed and acceleration of channel1" in look.comments


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("</UscSettings>", "", 18, "not XML"),
        ('duration="500">4000', 'duration="soon">4000', 9, "'soon' is not a whole number"),
        ('duration="500">4000', ">4000", 9, "'' is not a whole number"),
        ('version="1">', 'version="1">&bomb;', 2, "not XML"),
        ("<UscSettings", "<!DOCTYPE a [<!ENTITY b 'c'>]><UscSettings", 2, "document type"),
    ],
)
def test_wrong_maestro_xml_is_refused_with_its_line(refusal, old, new, line, reason) -> None:
    error = refusal(MaestroReader(), MAESTRO.replace(old, new, 1))
    assert (error.line, reason in error.reason) == (line, True), error


def test_a_maestro_script_is_not_read(refusal) -> None:
    text = MAESTRO[: MAESTRO.index("  <Sequences>")] + "</UscSettings>\n"
    assert "scripts are programs" in refusal(MaestroReader(), text).reason


def ssc32(*rows: str) -> str:
    return "PROJECT;SEQUENCE;STEP;PIN0;PIN1;PIN2;T0;T1;T2;TMAX;INFO1\n" + "\n".join(rows) + "\n"


def test_ssc32_pins_take_their_own_times_and_wait_for_each_other(read_one) -> None:
    text = ssc32("Wave;1;1;0;10;-90;1000;500;1000;", "Wave;1;2;0;20,5;90;1000;1000;250;")
    motion = read_one(Ssc32TableReader(), text)
    first, second = motion.channels
    assert (first.name, second.name) == ("PIN1", "PIN2")
    assert first.times_s.tolist() == [0.5, 1.0, 2.0]
    assert first.values.tolist() == [10.0, 10.0, 20.5]
    assert second.times_s.tolist() == [1.0, 1.25, 2.0]
    assert "Not carried over: PIN0, which stay at 0" in motion.comments


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        (ssc32("Wave;1;1;0;10;-90;1000"), 2, "7 fields, at least 9 are needed"),
        (ssc32("Wave;1;1;0;x;-90;1000;500;1000"), None, ""),
        (ssc32(), 1, "has no step"),
        (ssc32("a").replace(";T2", ""), 1, "column T2 is missing"),
    ],
)
def test_a_wrong_ssc32_row_is_refused_with_its_line(text, line, reason) -> None:
    if reason:
        with pytest.raises(InputError) as caught:
            Ssc32TableReader().motions(Path("m"), text.encode())
        assert (caught.value.line, reason in caught.value.reason) == (line, True)
    else:
        (bad,) = Ssc32TableReader().motions(Path("m"), text.encode())
        assert isinstance(bad, RefusedMotion)
        assert str(bad.error) == "m:2: 'x' is not a number"


PYPOSE = """\
droid:2
Pose=up: 512, 612
Pose=down: 512, 412
Seq=nod: up|250, down|500
Seq=once: down|100
"""


def test_pypose_sequences_play_their_poses() -> None:
    nod, once = PyPoseReader().motions(Path("m"), PYPOSE.encode())
    assert isinstance(nod, ForeignMotion)
    still, moved = nod.channels
    assert (nod.name, once.name, still.name, moved.name) == ("nod", "once", "ID1", "ID2")
    assert moved.times_s.tolist() == [0.25, 0.75]
    assert moved.values.tolist() == [100 * 300 / 1024, -100 * 300 / 1024]
    assert [note.label for note in nod.notes.values()] == ["up", "down"]


def test_pypose_resolutions_may_differ_from_servo_to_servo(read_one) -> None:
    text = "droid:2:1024,4096\nPose=a: 512, 3072\nSeq=s: a|250\n"
    motion = read_one(PyPoseReader(), text)
    assert [channel.values.tolist() for channel in motion.channels] == [[0.0], [90.0]]


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("512, 612", "512", 2, "1 positions for 2 servos"),
        ("droid:2", "droid:2:77", 1, "resolution 77 is not 1024 or 4096"),
        ("Pose=down: ", "Pose=down ", 3, "is neither"),
        ("512, 612", "512, -3", 2, "'-3' is not a whole number"),
        ("Seq=nod: up|250, down|500\nSeq=once: down|100\n", "", None, "has no sequence"),
    ],
)
def test_a_wrong_pypose_line_is_refused_with_its_number(refusal, old, new, line, reason) -> None:
    error = refusal(PyPoseReader(), PYPOSE.replace(old, new))
    assert (error.line, reason in error.reason) == (line, True), error


def test_a_pypose_sequence_of_unknown_poses_is_refused_alone() -> None:
    bad, good = PyPoseReader().motions(Path("m"), PYPOSE.replace("nod: up", "nod: op").encode())
    assert isinstance(bad, RefusedMotion)
    assert "step 1 names pose 'op', which is not there" in bad.error.reason
    assert isinstance(good, ForeignMotion)
