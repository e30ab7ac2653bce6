"""Files of other tools as sequences for one robot."""

from __future__ import annotations

import json
import re
import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.interchange.importing import (
    FORMAT_NAMES,
    import_motion,
    imported,
    read_motion,
    read_motions,
    sequence_for,
)
from lss_motion.interchange.reader import Pose, motion_of_poses
from lss_motion.robot.load import load_robot
from lss_motion.show.load import load_sequence
from lss_motion.show.model import Timing
from lss_motion.show.write import write_sequence

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot

ROOT = Path(__file__).resolve().parents[3]
MOTIONS = ROOT.parent / "shared" / "motions"
FIGURE = ROOT / "sequences/robots/figure.yaml"


@pytest.fixture(scope="module")
def figure() -> Robot:
    return load_robot(FIGURE)


def motion_file(folder: Path, **goals_deg: float) -> Path:
    keyframes = [
        {"duration": 1.5, "pause": 0.5, "goals": {"HeadPan": 10.0}, "name": "look"},
        {"duration": 1.0, "pause": 0.0, "goals": {"HeadPan": -10.0, **goals_deg}, "name": "away"},
    ]
    path = folder / "look.json"
    path.write_text(json.dumps({"name": "look", "keyframes": keyframes}), encoding="utf-8")
    return path


def test_a_motion_becomes_an_authored_sequence_for_the_robot(tmp_path: Path, figure: Robot) -> None:
    path = motion_file(tmp_path, HeadTilt=5.0)
    sequence = import_motion(path, figure)
    assert (sequence.name, sequence.timing, sequence.loop) == ("look", Timing.AUTHORED, 1)
    assert sequence.robot_path == FIGURE
    assert [keyframe.at_s for keyframe in sequence.keyframes] == [1.5, 3.0]
    assert sequence.keyframes[1].deg == {"HeadPan": -10.0, "HeadTilt": 5.0}
    assert import_motion(path, figure, format_name="bitbots") == sequence


def test_an_imported_motion_is_written_and_read_back_unchanged(
    tmp_path: Path, figure: Robot
) -> None:
    motion = read_motion(motion_file(tmp_path))
    sequence = sequence_for(motion, figure)
    write_sequence(sequence, tmp_path / "look.yaml", comments=motion.comments)
    assert load_sequence(tmp_path / "look.yaml") == sequence
    text = (tmp_path / "look.yaml").read_text(encoding="utf-8")
    assert "# Imported from look.json (Bit-Bots keyframes).\n" in text


def test_the_error_lists_everything_that_the_robot_cannot_do(tmp_path: Path, figure: Robot) -> None:
    path = motion_file(tmp_path, HeadTilt=61.0, Jaw=3.0, Tail=4.0)
    with pytest.raises(InputError) as caught:
        import_motion(path, figure)
    joints, tilt = str(caught.value).splitlines()
    assert joints.startswith(f"{path}: robot 'figure' does not have the joints Jaw, Tail; it has")
    assert tilt == (
        f"{path}: keyframe 2 (away) at 3 s: joint 'HeadTilt' at 61 deg is outside its range, "
        "-45 to 60 deg; --clip limits the angles to the range"
    )


def test_unknown_content_is_refused_with_the_known_formats(tmp_path: Path, figure: Robot) -> None:
    path = tmp_path / "other.json"
    path.write_text("{}", encoding="utf-8")
    with pytest.raises(InputError, match=f"can be read; there are: {', '.join(FORMAT_NAMES)}"):
        import_motion(path, figure)
    with pytest.raises(InputError, match="unknown motion format 'bitbot'; did you mean 'bitbots'"):
        import_motion(path, figure, format_name="bitbot")
    with pytest.raises(InputError, match="must have a list 'keyframes'"):
        import_motion(path, figure, format_name="bitbots")
    with pytest.raises(InputError, match="file not found"):
        import_motion(tmp_path / "nothing.json", figure)


@pytest.mark.parametrize("format_name", [None, "bitbots", "csv", "d6a", "praat"])
@pytest.mark.parametrize("data", [b"", b" \n"])
def test_an_empty_file_is_called_empty(tmp_path: Path, data: bytes, format_name) -> None:
    path = tmp_path / "nothing.bin"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_motions(path, format_name=format_name)
    assert caught.value.reason == "is empty; write or copy it again"


@pytest.mark.parametrize(
    "text", ['{"keyframes": [{"dura', '{"keyframes": [{"duration": 1', '{"keyframes": [']
)
def test_json_that_was_cut_off_is_called_so(tmp_path: Path, text: str) -> None:
    path = tmp_path / "half.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_motions(path, format_name="bitbots")
    assert str(caught.value) == f"{path}:1: ends inside of its JSON: it was cut off"


def test_motions_with_the_same_name_get_numbers(tmp_path: Path) -> None:
    path = tmp_path / "two.ppr"
    path.write_text("d:1\nPose=a: 512\nSeq=s: a|250\nSeq=s: a|500\nSeq=s: a|50\n", "utf-8")
    assert [motion.name for motion in read_motions(path)] == ["s", "s (2)", "s (3)"]
    assert read_motion(path, motion_name="s (2)").keyframes[0].at_s == 0.5


@pytest.mark.parametrize("start_s", [1_700_000_000.25, -2.5])
def test_dates_and_negative_times_are_moved_to_start_at_0(tmp_path: Path, start_s) -> None:
    path = tmp_path / "log.csv"
    path.write_text(f"time_s,HeadPan\n{start_s},1\n{start_s + 0.5},2\n", encoding="utf-8")
    motion = read_motion(path)
    assert [keyframe.at_s for keyframe in motion.keyframes] == [0.0, 0.5]
    assert f"Times start at {start_s:f} s in the file and at 0 here." in motion.comments


def test_a_file_beyond_the_limit_is_refused(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("lss_motion.interchange.importing.RECORDING_MAX_BYTES", 100)
    path = tmp_path / "big.csv"
    path.write_text("t_s,HeadPan\n" + "0,1\n" * 50, encoding="utf-8")
    with pytest.raises(InputError, match="is larger than 0 MB, the most that is read"):
        read_motion(path)


@pytest.mark.parametrize(
    ("start", "part", "times", "reason"),
    [
        (b'{"framerate":1,"positions":{"0":[', b"[],", 8_100_000, "more than 4,000,000 values"),
        (b'{"framerate":1,"positions":{', b'"a":0,', 4_100_000, "more than 4,000,000 values"),
        (b"t_s,a\n", b"0,1\n", 5_100_000, "more than 5,000,000 lines"),
    ],
    ids=["lists", "keys", "lines"],
)
def test_too_many_small_values_are_refused_before_they_fill_the_memory(
    tmp_path: Path, start: bytes, part: bytes, times: int, reason: str
) -> None:
    """After parsing, each of these would need twenty times its size, or more."""
    path = tmp_path / "many"
    path.write_bytes(start + part * times)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=reason):
            read_motions(path)
        assert tracemalloc.get_traced_memory()[1] < 6 * path.stat().st_size
    finally:
        tracemalloc.stop()


def test_a_motion_longer_than_a_day_is_refused(tmp_path: Path, figure: Robot) -> None:
    path = motion_file(tmp_path)
    path.write_text(path.read_text(encoding="utf-8").replace("1.5", "86399"), encoding="utf-8")
    with pytest.raises(InputError, match=r"takes 86400\.5 s, more than a day"):
        import_motion(path, figure)


def test_more_keyframes_than_a_sequence_file_may_have_are_refused(figure: Robot) -> None:
    poses = [Pose(at_s=float(n), values={"HeadPan": 0.0}) for n in range(10_001)]
    with pytest.raises(InputError, match="has 10,001 keyframes, at most 10,000 are allowed"):
        sequence_for(motion_of_poses(Path("m"), "m", poses), figure)


def test_a_motion_that_jumps_is_refused(figure: Robot) -> None:
    poses = [
        Pose(at_s=0.0, values={"HeadPan": 0.0}, hold_s=1.0),
        Pose(at_s=1.0, values={"HeadPan": 5.0}),
    ]
    with pytest.raises(InputError, match="joint 'HeadPan' would have to go from 0 to 5 deg in no"):
        sequence_for(motion_of_poses(Path("m"), "m", poses), figure)


@pytest.mark.skipif(not MOTIONS.is_dir(), reason="the collection of real motions is not here")
def test_a_real_motion_keeps_its_times_and_angles_on_the_figure(
    tmp_path: Path, figure: Robot
) -> None:
    motion = read_motion(MOTIONS / "cheering_only_arms.json")
    sequence = sequence_for(motion, figure)
    times_s = [(keyframe.at_s, keyframe.hold_s) for keyframe in sequence.keyframes]
    assert times_s == [(2.0, 0.0), (3.0, 0.5), (4.5, 0.5), (7.0, 0.2), (10.2, 0.0)]
    assert sequence.keyframes[2].deg["LElbow"] == -58.0
    write_sequence(sequence, tmp_path / "cheering.yaml", comments=motion.comments)
    assert load_sequence(tmp_path / "cheering.yaml") == sequence


@pytest.mark.skipif(not MOTIONS.is_dir(), reason="the collection of real motions is not here")
def test_real_motions_with_empty_extras_are_read_and_with_other_joints_refused(
    figure: Robot,
) -> None:
    assert len(import_motion(MOTIONS / "throw.json", figure).keyframes) == 4
    with pytest.raises(InputError, match=r"does not have the joints .*LKnee.* RKnee"):
        import_motion(MOTIONS / "cheering.json", figure)


CSV = "# made by hand\ntime_s,HeadPan,HeadTilt\n0,0,0\n1,5,70\n2,0,90\n3,0,0\n"


def test_an_angle_out_of_range_names_the_line_of_the_file(tmp_path: Path, figure: Robot) -> None:
    path = tmp_path / "table.csv"
    path.write_text(CSV, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        import_motion(path, figure)
    assert (caught.value.line, caught.value.path) == (5, path)
    assert "joint 'HeadTilt' at 90 deg is outside its range" in caught.value.reason
    assert "1 more keyframe of it" in caught.value.reason


@pytest.mark.parametrize(
    ("name", "text", "line"),
    [
        ("a.txt", "#1D0T500\ndelay(600)\n#1D900T1000\n", 3),
        ("a.motion", "#WEBOTS_MOTION,V1.0,HeadTilt\n00:00:000,0\n00:01:000,1.6\n", 3),
        ("a.csv", "time_s;servo;deg\n0;HeadTilt;0\n2;HeadTilt;0\n1;HeadTilt;99\n", 4),
        ("b.csv", "PROJECT;SEQUENCE;STEP;PIN0;T0;\nW;1;1;9;500;\nW;1;2;95;500;\n", 3),
        ("c.csv", "HeadTilt,HeadPan\n1,1\n88,1\n", 3),
    ],
)
def test_every_text_format_gives_the_line(tmp_path, figure, name, text, line) -> None:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    motion = read_motion(path)
    motion = replace(
        motion,
        channels=tuple(
            replace(c, name="HeadPan" if c.name == "HeadPan" else "HeadTilt", servo_id=None)
            for c in motion.channels
        ),
    )
    with pytest.raises(InputError) as caught:
        imported(motion, figure)
    assert caught.value.line == line, caught.value


def test_a_line_is_found_in_a_recording_that_was_reduced(tmp_path: Path, figure: Robot) -> None:
    rows = [f"{n / 50},{min(n, 100)}" for n in range(150)]
    path = tmp_path / "recording.csv"
    path.write_text("time_s,HeadTilt\n" + "\n".join(rows) + "\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        import_motion(path, figure)
    row = rows[(caught.value.line or 0) - 2]
    assert 60 < float(row.partition(",")[2]) <= 100


def test_clipped_angles_are_at_the_range_and_listed(tmp_path: Path, figure: Robot) -> None:
    path = tmp_path / "table.csv"
    path.write_text(CSV, encoding="utf-8")
    made = imported(read_motion(path), figure, is_clipped=True)
    assert [keyframe.deg["HeadTilt"] for keyframe in made.sequence.keyframes] == [0, 60, 60, 0]
    assert made.comments[-1] == (
        "Clipped: 2 of 4 angles of joint HeadTilt to its range of -45 to 60 deg; the farthest "
        "was 90 deg at 2 s, line 5."
    )


def test_an_encoder_that_wraps_is_named_where_its_turn_is_refused(tmp_path, figure) -> None:
    rows = [f"{n / 50},{(n * 2 + 180) % 360 - 180}" for n in range(120)]
    path = tmp_path / "recording.csv"
    path.write_text("time_s,HeadPan\n" + "\n".join(rows) + "\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        import_motion(path, figure)
    assert "--unwrap removes the turns" in str(caught.value)
    made = imported(read_motion(path), figure, is_unwrapped=True, is_clipped=True)
    assert any("The turns were removed (--unwrap)" in comment for comment in made.comments)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (bytes(12) + b"\0\0\0\1\0\0\0\xff\xff\1\0\x0f\0CEventBarLinear", "Visual Show Automation"),
    ],
)
def test_a_format_that_is_not_read_is_named_with_what_to_do(tmp_path, data, said) -> None:
    (tmp_path / "x").write_bytes(data)
    with pytest.raises(InputError, match=re.escape(said)):
        read_motions(tmp_path / "x")
