"""Maps: units, signs, names, errors, and the template of a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.interchange.mapping import load_map, map_template, mapped
from lss_motion.interchange.reader import Channel, ForeignMotion, Measure
from lss_motion.robot.servo_models import SERVO_MODELS

MOTION_PATH = Path("dance.json")


def motion(
    *channels: tuple[str, Measure, list[float]], is_recording: bool = False
) -> ForeignMotion:
    return ForeignMotion(
        path=MOTION_PATH,
        name="dance",
        channels=tuple(
            Channel(
                name=name,
                unit=unit,
                times_s=np.arange(len(values)) / 10.0,
                values=np.array(values, dtype=np.float64),
                servo_id=int(name[2:]) if name.startswith("ID") else None,
            )
            for name, unit, values in channels
        ),
        notes={},
        is_recording=is_recording,
    )


@pytest.mark.parametrize("name", ["id3", "servo 3", "Motor_3", "3"])
def test_a_map_to_begin_with_guesses_the_joint_by_the_id_of_its_servo(arm, name) -> None:
    robot = replace(arm, joints={**arm.joints, "base": replace(arm.joints["base"], servo_id=3)})
    robot = replace(robot, joints={n: robot.joints[n] for n in ("base",)})
    text = map_template(motion((name, Measure.DEG, [0.0, 1.0]), ("ID4", Measure.DEG, [0.0])), robot)
    assert f'"{name}": {{name: "base"}}  # 0 to 1 deg; guess: its servo has this id' in text
    assert '"ID4": {skip: true}' in text


def test_d_is_counted_as_the_servo_with_that_id_counts_it(arm) -> None:
    pro = replace(arm.joints["base"], servo_id=1, model=SERVO_MODELS["LSS-P-S1"])
    robot = replace(arm, joints={**arm.joints, "base": pro})
    content = motion(("ID1", Measure.DEG, [0.0, 300.0]), ("ID9", Measure.DEG, [0.0, 300.0]))
    made = mapped(replace(content, channels=content.channels[:1]), robot, None)
    (name,) = angles(made)
    assert angles(made)[name] == [0.0, 30.0]
    assert made.comments[-1].startswith("D of ID1 is read in units of 1/100 deg")
    assert "`scale: 10`" in made.comments[-1]
    assert "# 0 to 30 deg" in map_template(content, robot)


def angles(made: ForeignMotion) -> dict[str, list[float]]:
    return {c.name: [round(v, 6) for v in c.values.tolist()] for c in made.channels}


@pytest.fixture
def write_map(tmp_path: Path):
    def write(text: str):
        path = tmp_path / "map.yaml"
        path.write_text("joints:\n" + text, encoding="utf-8")
        return load_map(path)

    return write


def test_a_map_turns_values_into_joint_angles(arm, write_map) -> None:
    made = mapped(
        motion(("Head Pan", Measure.RAD, [0.0, np.pi / 2]), ("jaw", Measure.US, [1500.0, 2000.0])),
        arm,
        write_map(
            '  "Head Pan": {name: base, sign: -1, offset_deg: 5}\n'
            "  jaw: {name: elbow, scale: 0.09, offset_deg: -135}\n"
        ),
    )
    assert angles(made) == {"base": [5.0, -85.0], "elbow": [0.0, 45.0]}
    assert all(channel.unit is Measure.DEG for channel in made.channels)


def test_the_unit_of_a_map_replaces_the_unit_of_the_file(arm, write_map) -> None:
    content = motion(("base", Measure.DEG, [1.0]), ("lift", Measure.RAD_OR_M, [0.5]))
    made = mapped(content, arm, write_map("  base: {unit: rad}\n  lift: {unit: m, scale: 3600}\n"))
    assert angles(made) == {"base": [57.29578], "lift": [1800.0]}
    made = mapped(content, arm, write_map("  lift: {unit: rad}\n"))
    assert angles(made) == {"base": [1.0], "lift": [28.64789]}


def test_an_lss_id_becomes_the_joint_with_this_id(arm) -> None:
    made = mapped(motion(("ID5", Measure.DEG, [0.0, 30.0]), ("ID1", Measure.DEG, [7.0])), arm, None)
    assert angles(made) == {"elbow": [10.0, -20.0], "base": [7.0]}


def test_a_skipped_joint_is_listed_in_comments(arm, write_map) -> None:
    content = motion(("base", Measure.DEG, [1.0]), ("tail", Measure.RAW, [1.0]))
    made = mapped(content, arm, write_map("  tail: {skip: true}\n"))
    assert angles(made) == {"base": [1.0]}
    assert made.comments == ("Not carried over: joint tail, which the map skips",)


@pytest.mark.parametrize(
    ("unit", "words"),
    [
        (Measure.US, "microseconds of a servo pulse, which is not an angle; give `scale`"),
        (Measure.RAW, "units of its own robot, which is not an angle; give `scale`"),
        (Measure.RAD_OR_M, "does not define whether its values are radians or metres"),
    ],
)
def test_a_unit_without_an_angle_is_refused_without_a_map(arm, unit: Measure, words: str) -> None:
    with pytest.raises(InputError, match=words) as caught:
        mapped(motion(("lift", unit, [1.0]), ("base", unit, [1.0])), arm, None)
    assert len(caught.value.more) == 1
    assert caught.value.path == MOTION_PATH


@pytest.mark.parametrize(
    ("text", "line", "reason"),
    [
        ("  bass: {name: base}\n", 2, "the motion has no joint 'bass'; did you mean 'base'?"),
        ("  base: {name: elbo}\n", 2, "has no joint 'elbo'; did you mean 'elbow'?"),
        ("  base: {sign: 2}\n", 2, "must be 1 or -1"),
        ("  base: {scale: 0}\n", 2, "must be more than 0"),
        ("  base: {scale: .nan}\n", 2, "must be"),
        ("  base: {unit: grad}\n", 2, "is not allowed"),
        ("  base: {ofset_deg: 1}\n", 2, "unknown key 'ofset_deg'; did you mean 'offset_deg'?"),
        ("  base:\n", 2, "has no value"),
        ("  {}\n", 1, "must have 1 or more entries"),
    ],
)
def test_a_wrong_map_is_refused_with_its_line(arm, write_map, text, line, reason) -> None:
    with pytest.raises(InputError) as caught:
        mapped(motion(("base", Measure.DEG, [1.0])), arm, write_map(text))
    assert reason in str(caught.value)
    assert caught.value.path.name == "map.yaml"
    assert caught.value.line in {line, line + 1}


def test_two_joints_of_a_motion_cannot_become_one_joint(arm, write_map) -> None:
    content = motion(("base", Measure.DEG, [1.0]), ("b", Measure.DEG, [1.0]))
    with pytest.raises(
        InputError, match="2 joints of the motion become joint 'base'; only one can"
    ):
        mapped(content, arm, write_map("  b: {name: base}\n"))


def test_a_map_that_skips_everything_is_refused(arm, write_map) -> None:
    with pytest.raises(InputError, match="moves only joints that the map skips"):
        mapped(motion(("base", Measure.DEG, [1.0])), arm, write_map("  base: {skip: true}\n"))


def test_full_turns_of_an_encoder_that_wraps_are_removed_where_desired(arm) -> None:
    turning = [170.0, 178.0, -174.0, -166.0, -174.0, 178.0]
    content = motion(("base", Measure.DEG, turning), is_recording=True)
    offered = mapped(content, arm, None)
    assert angles(offered) == {"base": turning}
    assert offered.comments == (
        "Joint base jumps by a full turn 2 times, first at 0.2 s, as an encoder does that wraps. "
        "--unwrap removes the turns.",
    )
    made = mapped(content, arm, None, is_unwrapped=True)
    assert angles(made) == {"base": [170.0, 178.0, 186.0, 194.0, 186.0, 178.0]}
    assert made.comments == (
        "Joint base jumps by a full turn 2 times, first at 0.2 s. The turns were removed "
        "(--unwrap).",
    )


@pytest.mark.parametrize("passed", [[20.0], [100.0, -60.0]])
def test_values_that_were_read_while_the_encoder_wrapped_are_removed(arm, passed) -> None:
    turning = [170.0, 178.0, *passed, -174.0, -166.0]
    content = motion(("base", Measure.DEG, turning), is_recording=True)
    step_s = 0.02
    times_s = step_s * np.arange(len(turning))
    content = replace(content, channels=(replace(content.channels[0], times_s=times_s),))
    (own,) = mapped(content, arm, None, is_unwrapped=True).channels
    assert own.values.tolist() == [170.0, 178.0, 186.0, 194.0]
    expected_s = [0.0, 1.0, 2.0 + len(passed), 3.0 + len(passed)]
    assert own.times_s.tolist() == pytest.approx([step_s * n for n in expected_s])


def test_a_fast_motion_is_no_wrap(arm) -> None:
    quick = [0.0, 60.0, 120.0, 180.0, 120.0, 60.0, 0.0]
    content = motion(("base", Measure.DEG, quick), is_recording=True)
    made = mapped(content, arm, None, is_unwrapped=True)
    assert angles(made) == {"base": quick}
    assert made.comments == ()


def test_poses_a_full_turn_apart_are_not_changed(arm) -> None:
    made = mapped(motion(("base", Measure.DEG, [179.0, -179.0])), arm, None)
    assert angles(made) == {"base": [179.0, -179.0]}


def test_the_template_is_a_valid_map_with_marked_guesses(arm, write_map) -> None:
    content = motion(
        ("Base_Joint", Measure.RAD, [0.0, 1.0]),
        ("ID5", Measure.DEG, [0.0, 40.0]),
        ("lift", Measure.RAD_OR_M, [0.2]),
        ('odd "name"\n', Measure.RAW, [1.0]),
        ("PIN3", Measure.US, [1500.0]),
    )
    text = map_template(content, arm)
    entries = write_map(text.partition("joints:\n")[2]).entries
    assert entries["Base_Joint"].name == "base"
    assert (entries["ID5"].name, entries["ID5"].sign, entries["ID5"].offset_deg) == (
        "elbow",
        -1,
        10,
    )
    assert entries["lift"].name == "lift"
    assert entries['odd "name"\n'].skip
    assert entries["PIN3"].skip
    assert "guess: 180 deg over 500 to 2500 us" in text
    assert "add unit: rad, or unit: m and scale: degrees per metre" in text
    with pytest.raises(InputError, match="radians or metres"):
        mapped(content, arm, write_map(text.partition("joints:\n")[2]))


def test_a_template_maps_lss_ids_like_no_map(arm, write_map) -> None:
    content = motion(("ID5", Measure.DEG, [0.0, 40.0]), ("ID1", Measure.DEG, [7.0]))
    text = map_template(content, arm).partition("joints:\n")[2]
    assert angles(mapped(content, arm, write_map(text))) == angles(mapped(content, arm, None))
