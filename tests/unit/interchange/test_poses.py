"""Plain lists of poses: forms, times, units, and errors."""

from __future__ import annotations

import json

import pytest

from lss_motion.interchange.importing import READERS
from lss_motion.interchange.poses import POSES, STEP_S
from lss_motion.interchange.reader import Measure


def keys(motion) -> dict[str, list[tuple[float, float]]]:
    return {
        channel.name: list(zip(channel.times_s.tolist(), channel.values.tolist(), strict=True))
        for channel in motion.channels
    }


def test_objects_with_durations_and_pauses(read_one) -> None:
    content = [
        {"name": "up", "deg": {"a": 10}, "duration_s": 0.5, "hold_ms": 250},
        {"a": 20, "b_rad": 1.5, "duration_ms": 1000, "colour": "red"},
    ]
    motion = read_one(POSES, json.dumps(content))
    assert keys(motion) == {"a": [(0.5, 10.0), (1.75, 20.0)], "b": [(1.75, 1.5)]}
    assert [channel.unit for channel in motion.channels] == [Measure.DEG, Measure.RAD]
    assert (motion.notes[0.5].label, motion.notes[0.5].hold_s) == ("up", 0.25)
    assert "Not carried over: colour of the poses" in motion.comments


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ([[1, 2], [3, 4]], {"J1": [(0.0, 1.0), (STEP_S, 3.0)], "J2": [(0.0, 2.0), (STEP_S, 4.0)]}),
        (
            {"joints": ["a"], "fps": 20, "poses": [[1], [2], {"angles": [3]}]},
            {"a": [(0.0, 1.0), (0.05, 2.0), (0.1, 3.0)]},
        ),
        (
            [{"time": 1, "positions": {"a": 1}}, {"time": 4, "positions": {"a": 2}}],
            {"a": [(1.0, 1.0), (4.0, 2.0)]},
        ),
    ],
)
def test_forms_of_json(read_one, content, expected) -> None:
    assert keys(read_one(POSES, json.dumps(content))) == expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("10,20\n30,40\n", {"J1": [(0, 10), (1, 30)], "J2": [(0, 20), (1, 40)]}),
        ("# by hand\na,b_rad\n10,20\n30,40\n", {"a": [(0, 10), (1, 30)], "b": [(0, 20), (1, 40)]}),
        ("a;duration_ms\n1,5;500\n2,5;250\n", {"a": [(0.5, 1.5), (0.75, 2.5)]}),
        ("0,0\n30,40\n", {"J1": [(0, 0), (1, 30)], "J2": [(0, 0), (1, 40)]}),
        ("0,5;1,5\n-,5;2\n", {"J1": [(0, 0.5), (1, -0.5)], "J2": [(0, 1.5), (1, 2)]}),
        ("1.5e+00,.5\n-2e0,3\n", {"J1": [(0, 1.5), (1, -2)], "J2": [(0, 0.5), (1, 3)]}),
        ('name,a,b\nup,1,\n"down",2,3\n', {"a": [(0, 1), (1, 2)], "b": [(1, 3)]}),
        ("a\tduration_s\thold_s\n1\t1\t1\n2\t1\t0\n", {"a": [(1, 1), (3, 2)]}),
    ],
)
def test_rows_of_angles(read_one, text, expected) -> None:
    motion = read_one(POSES, text)
    assert keys(motion) == expected
    assert next(reader for reader in READERS if reader.recognises(text.encode())).name == "poses"


def test_the_column_of_names_becomes_labels(read_one) -> None:
    motion = read_one(POSES, "name;a;duration_s\nup;1,5;1\ndown;2;0,5\n")
    assert [note.label for note in motion.notes.values()] == ["up", "down"]
    assert keys(motion) == {"a": [(1, 1.5), (1.5, 2)]}


def test_poses_without_times_are_named_as_such(read_one) -> None:
    comments = read_one(POSES, "1,2\n3,4\n").comments
    assert f"The poses have no times: {STEP_S:g} s each." in comments


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ([{"a": 1, "time": 1}, {"a": 1}], "poses[1]: either all poses have an instant"),
        ([{"a": 1}, {"a_rad": 1}], "poses[1]: 'a' is in rad, before in deg"),
        ([{"a": 1, "time": 1}, {"a": 1, "time": 1}], "poses[1]: times must increase"),
        ([{"a": 1, "duration": -1}], "poses[0]: durations and pauses must be 0 s or more"),
        ([{"name": "x"}], "poses[0] has no angle"),
        ({"joints": ["a"], "poses": [[1, 2]]}, "poses[0] has 2 values for 1 joint"),
        ({"joints": "a", "poses": [[1, 2]]}, "joints must be a list of names"),
        ({"fps": 0, "poses": [[1, 2]]}, "fps 0 must be more than 0"),
        ([[1, "x"]], "poses[0][1] is 'x', but must be a number"),
        ([7], "poses[0] must be an object"),
    ],
)
def test_a_wrong_pose_is_refused_with_its_place(refusal, content, reason) -> None:
    assert reason in refusal(POSES, json.dumps(content)).reason


def test_a_wrong_row_is_refused_with_its_line(refusal) -> None:
    error = refusal(POSES, "a,b\n1,2\n3,x\n")
    assert (error.line, error.reason) == (3, "'x' is not a number")


def test_a_header_in_a_comment_and_units_in_brackets_are_read(read_one) -> None:
    motion = read_one(POSES, "# a (rad) duration (ms)\n0.0 500\n1.0 500\n")
    (a,) = motion.channels
    assert (a.name, a.unit, a.times_s.tolist()) == ("a", Measure.RAD, [0.5, 1.0])


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1700000000.00,0,10\n1700000000.05,1,11\n", "is it a time?"),
        ("when,a\n1700000000.00,0\n1700000000.05,1\n", "is it a time?"),
        ("delay,a\n5,0\n5,1\n", "is it a time?"),
        ("a (mm),b\n5,0\n5,1\n", "unit 'mm' is not read"),
    ],
)
def test_a_time_or_a_unit_that_is_not_understood_is_no_angle(refusal, text, reason) -> None:
    assert reason in refusal(POSES, text).reason


@pytest.mark.parametrize(
    "text",
    ["".join(f"{n * 20},{n % 3},7\n" for n in range(20)),
     "when,a\n" + "".join(f"{n / 50 + n % 2 / 500},{n}\n" for n in range(20)),
     json.dumps([[n / 50, n % 5] for n in range(20)])],
)  # fmt: skip
def test_what_increases_as_a_clock_is_no_joint_of_poses_without_times(refusal, text: str) -> None:
    assert POSES.recognises(text.encode())
    assert "increases evenly, as a time does" in refusal(POSES, text).reason


def test_a_joint_may_increase_evenly_where_the_poses_have_durations(read_one) -> None:
    rows = "".join(f"{n * 20},1.5\n" for n in range(20))
    motion = read_one(POSES, f"a,duration_s\n{rows}")
    assert motion.channels[0].times_s[-1] == pytest.approx(30.0)
