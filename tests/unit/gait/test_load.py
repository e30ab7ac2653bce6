from __future__ import annotations

import json

import jsonschema
import pytest

from lss_motion.errors import InputError
from lss_motion.files.yaml_source import read_yaml
from lss_motion.show.gait import is_gait_file
from lss_motion.show.gait.load import gait_schema, load_gait
from lss_motion.show.gait.model import BodyMove, BodyPose, LegKind, Walk, Wave

NAMES = ("hexapod_walk", "hexapod_dance", "quadruped_trot")
BASE = """\
gait: test
robot: {robots}/hexapod.yaml
legs_from: {examples}/hexapod_walk.yaml
height_mm: 80
cycle_s: 2.0
"""


@pytest.fixture
def write(kit, tmp_path):
    def write(text, base=BASE):
        path = tmp_path / "test.yaml"
        folders = {"{robots}": kit.examples / "robots", "{examples}": kit.examples}
        for word, folder in folders.items():
            base = base.replace(word, str(folder))
            text = text.replace(word, str(folder))
        path.write_text(base + text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def actions(write):
    """The actions of a gait with this `do` list."""
    return lambda *lines: load_gait(write("do:\n" + "".join(f"  - {x}\n" for x in lines))).actions


@pytest.fixture
def refused(write):
    """Return line and reason of every problem of a file."""

    def refused(text, base=BASE):
        with pytest.raises(InputError) as caught:
            load_gait(write(text, base))
        return [(error.line, error.reason) for error in (caught.value, *caught.value.more)]

    return refused


@pytest.mark.parametrize("name", NAMES)
def test_every_example_names_its_schema_fulfils_it_and_loads(kit, name):
    path = kit.examples / f"{name}.yaml"
    first, _, _ = path.read_text(encoding="utf-8").partition("\n")
    schema = path.parent / first.removeprefix("# yaml-language-server: $schema=")
    content = json.loads(schema.read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(content).validate(read_yaml(path).value)
    assert is_gait_file(path)
    assert load_gait(path).path == path


def test_the_schema_is_valid_and_knows_the_actions():
    schema = gait_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    assert "null" not in json.dumps(schema)
    assert not jsonschema.Draft202012Validator(schema).is_valid({"gait": "x", "do": [{"hop": {}}]})


def test_a_sequence_is_not_a_gait_file(kit):
    assert not is_gait_file(kit.examples / "wave.yaml")


def test_legs_come_in_the_order_of_patterns_with_their_defaults(kit):
    gait = load_gait(kit.examples / "quadruped_trot.yaml")
    names = ["left_front", "left_rear", "right_front", "right_rear"]
    assert [leg.name for leg in gait.legs] == names
    first = gait.legs[0]
    assert first.kind is LegKind.ABDUCTION
    assert first.lengths_mm == (52, 93.4, 90)
    assert (first.zero_deg, first.direction) == ((0, -74.5, 164.5), (1, -1, -1))
    assert first.joints == ("left_front_roll", "left_front_pitch", "left_front_knee")


def test_the_pattern_and_its_duty_have_defaults(write):
    gait = load_gait(write("do: [{stand: {}}]\n"))
    assert (gait.pattern.name, gait.duty, gait.sway_mm) == ("tripod", 0.5, 0.0)
    ripple = load_gait(write("pattern: ripple\nduty: 0.7\nsway_mm: 5\ndo: [{stand: {}}]\n"))
    assert (ripple.pattern.name, ripple.duty, ripple.sway_mm) == ("ripple", 0.7, 5.0)


def test_a_walk_is_as_long_as_its_time_its_distance_or_its_cycles(actions):
    timed, far, counted, strode = actions(
        "walk: {forward_mm_s: 20, for_s: 5.1}",
        "walk: {forward_mm_s: 30, left_mm_s: 40, turn_deg_s: 10, distance_mm: 250}",
        "walk: {left_mm_s: 30, cycles: 4, label: aside}",
        "walk: {stride_mm: -50, cycles: 1}",
    )
    assert (timed.cycles, timed.forward_mm_s, timed.label) == (3, 20.0, "walk")
    # 250 mm at 50 mm/s are 2.5 cycles: 3 at five sixths of the speed, on the same curve.
    assert (far.cycles, far.forward_mm_s) == (3, pytest.approx(25.0))
    assert far.turn_deg_s == pytest.approx(10 * 5 / 6)
    assert (counted.cycles, counted.left_mm_s, counted.label) == (4, 30.0, "aside")
    assert strode.forward_mm_s == -25.0


def test_the_longest_walk_is_looped_and_all_of_its_cycles_count(actions, write):
    short, long, other = actions(
        "walk: {forward_mm_s: 20, cycles: 30}",
        "walk: {forward_mm_s: 20, for_s: 3600}",
        "walk: {left_mm_s: 20, distance_mm: 2000}",
    )
    assert (short.cycles, short.more_cycles) == (30, 0)
    assert (long.cycles + long.more_cycles, long.cycles) == (1800, 7)
    assert (other.cycles, other.more_cycles) == (50, 0)
    (endless,) = actions("walk: {forward_mm_s: 20, cycles: forever}")
    assert endless.more_cycles is None
    # What is looped as a whole is laid out as a whole.
    looped = load_gait(write("loop: 2\ndo: [{walk: {forward_mm_s: 20, cycles: 50}}]\n"))
    assert looped.actions[0].more_cycles == 0


def test_layers_of_the_body_are_read_and_fit_into_a_cycle_that_is_looped(write, refused):
    layers = "layers: [{tilt_deg: [0, 5, 0], every_s: 0.75, start: 0.25}]\n"
    gait = load_gait(write(layers + "do: [{walk: {forward_mm_s: 20, cycles: 3}}]\n"))
    swing = BodyPose(tilt_deg=(0.0, 5.0, 0.0))
    assert gait.waves == (Wave(pose=swing, every_s=0.75, start_ratio=0.25),)
    endless = "do: [{walk: {forward_mm_s: 20, cycles: forever}}]\n"
    ((line, reason),) = refused(layers + endless)
    assert line == 6
    assert "a cycle holds whole swings" in reason
    assert load_gait(write(layers.replace("0.75", "0.5") + endless)).waves


def test_a_turn_has_its_angle_exactly(actions):
    (turn,) = actions("turn: {deg: -100, turn_deg_s: 30}")
    assert isinstance(turn, Walk)
    assert turn.cycles == 2
    assert turn.turn_deg_s * turn.cycles * 2.0 == pytest.approx(-100)


def test_standing_sitting_and_posing_are_moves_of_the_body(write):
    path = write(
        "sit_height_mm: 50\nstart: sitting\ndo:\n"
        "  - stand: {in_s: 2, hold_s: 0.5}\n"
        "  - pose: {shift_mm: [1, 2, 3], tilt_deg: [4, 5, 6]}\n"
        "  - sit: {label: down}\n"
    )
    gait = load_gait(path)
    sitting = BodyPose(shift_mm=(0.0, 0.0, -30.0))
    assert gait.start == sitting
    assert gait.actions == (
        BodyMove(pose=BodyPose(), in_s=2.0, hold_s=0.5, label="stand"),
        BodyMove(pose=BodyPose(shift_mm=(1, 2, 3), tilt_deg=(4, 5, 6)), in_s=1.0, label="pose"),
        BodyMove(pose=sitting, in_s=1.0, label="down"),
    )
    assert [action.line for action in gait.actions] == [9, 10, 11]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("do:\n  - {}\n", 7, "an action is one of stand, sit, pose, walk, turn; this has nothing"),
        ("do:\n  - {stand: {}, sit: {}}\n", 7, "this has stand, sit"),
        ("do:\n  - hop: {}\n", 7, "unknown key 'hop'"),
        ("do: []\n", 6, "must have 1 or more"),
        ("do:\n  - walk: {forward_mm_s: 9}\n", 7, "a walk has one of for_s, distance_mm, cycles"),
        ("do:\n  - walk: {cycles: 1, for_s: 3}\n", 7, "this has for_s and cycles"),
        ("do:\n  - walk: {cycles: 0}\n", 7, "a count from 1 to 1,000,000, or forever"),
        ("do:\n  - walk: {cycles: forever}\n  - stand: {}\n", 7, "nothing can follow"),
        ("loop: 2\ndo:\n  - walk: {cycles: forever}\n", 8, "without end cannot be looped"),
        ("do:\n  - walk: {turn_deg_s: 9, distance_mm: 50}\n", 7, "distance_mm needs a speed"),
        ("do:\n  - walk: {stride_mm: 9, forward_mm_s: 9, cycles: 1}\n", 7, "exclude each other"),
        ("do:\n  - walk: {forward_mm_s: fast, cycles: 1}\n", 7, "must be a number"),
        ("do:\n  - turn: {deg: 0}\n", 7, "turn by 0 deg"),
        ("do:\n  - sit: {}\n", 7, "sitting needs 'sit_height_mm'"),
        ("start: sitting\nsit_height_mm: 40\ndo:\n  - turn: {deg: 9}\n", 9, "the robot sits"),
        ("pattern: trot\ndo: [{stand: {}}]\n", 6, "'trot' is not for 6 legs; .*tripod"),
        ("pattern: tripot\ndo: [{stand: {}}]\n", 6, "did you mean 'tripod'"),
        ("duty: 0.3\ndo: [{stand: {}}]\n", 6, "must be 0.5 or more"),
        ("loop: 2\ndo: [{pose: {shift_mm: [0, 0, 5]}}]\n", 6, "a loop must end in the pose"),
        ("leg: {stance_mm: 5}\ndo: [{stand: {}}]\n", 6, "'leg' and 'legs_from' exclude"),
    ],
)  # fmt: skip
def test_a_wrong_gait_is_refused_with_line_and_reason(refused, text, line, words):
    import re

    found = refused(text)
    assert any(at == line and re.search(words, reason) for at, reason in found), found


LEG = "{kind: coxa-femur-tibia, lengths_mm: [54, 80, 116], stance_mm: 145}"
HEAD = f"""\
gait: test
robot: {{robots}}/hexapod.yaml
height_mm: 80
do: [{{stand: {{}}}}]
leg: {LEG}
"""


def leg(side, place, rest="", x=0):
    joints = ", ".join(f"{side}_{place}_{part}" for part in ("coxa", "femur", "tibia"))
    y = 60 if side == "left" else -60
    return f"  {side}_{place}: {{joints: [{joints}], hip_mm: [{x}, {y}], yaw_deg: 90{rest}}}\n"


FOUR = [
    leg("left", "front", x=9), leg("left", "rear"), leg("right", "front", x=9), leg("right", "rear")
]  # fmt: skip
REAR = FOUR[3]


@pytest.mark.parametrize(
    ("legs", "words"),
    [
        ([FOUR[0], FOUR[2]], "two legs balances by feedback"),
        (FOUR[:3], "3 legs; 4 or 6 are supported"),
        ([*FOUR[:3], leg("left", "middle")], "as many legs on the left"),
        ([*FOUR[:3], REAR.replace("rear_tibia", "rare_tibia")],
         "did you mean 'right_rear_tibia'"),
        ([*FOUR[:3], REAR.replace("rear_tibia", "rear_coxa")],
         "already one of leg 'right_rear'"),
        ([*FOUR[:3], leg("right", "rear", ", kind: wheel")], "unknown kind 'wheel'"),
        ([*FOUR[:3], leg("right", "rear", ", knee: back")], "'knee' has no meaning for coxa"),
        ([*FOUR[:3], REAR.replace(", yaw_deg: 90", "")], "no 'yaw_deg'"),
        ([*FOUR[:3], leg("right", "rear", ", direction: [1, 2, 1]")], "each must be 1 or -1"),
    ],
)  # fmt: skip
def test_wrong_legs_are_refused_with_the_reason(refused, legs, words):
    found = refused("legs:\n" + "".join(legs), HEAD)
    assert any(words in reason for _, reason in found), found


def test_four_legs_of_that_kind_load_and_all_faults_are_found_in_one_run(write, refused):
    assert len(load_gait(write("legs:\n" + "".join(FOUR), HEAD)).legs) == 4
    two = [leg("left", "front", ", knee: back"), leg("left", "rear", ", kind: wheel"), *FOUR[2:]]
    assert [line for line, _ in refused("legs:\n" + "".join(two), HEAD)] == [7, 8]


HEX = "gait: x\nrobot: {robots}/hexapod.yaml\nheight_mm: 9\n"


@pytest.mark.parametrize(
    ("base", "words"),
    [
        ("gait: x\nrobot: {robots}/none.yaml\nheight_mm: 9\nlegs_from: a.yaml\n", "not found"),
        ("gait: x\nheight_mm: 9\nlegs_from: a.yaml\n", "no robot"),
        (HEX + "legs_from: a.yaml\n", "'a.yaml' not"),
        (HEX, "no legs"),
        (HEX +
         "legs_from: {examples}/hexapod_dance.yaml\n", "has no 'legs' of its own"),
        ("gait: x\nrobot: {robots}/desk_arm.yaml\nheight_mm: 9\n"
         "legs_from: {examples}/hexapod_walk.yaml\n", "unknown joint 'left_front_coxa'"),
    ],
)  # fmt: skip
def test_files_that_a_gait_names_must_exist_and_fit(refused, base, words):
    found = refused("do: [{stand: {}}]\n", base)
    assert any(words in reason for _, reason in found), found
