from __future__ import annotations

from pathlib import Path

import pytest

from lss_motion.errors import InputError
from lss_motion.robot.load import load_robot
from lss_motion.sim.bus import bus_from_robot
from lss_motion.sim.deviation import (
    WORDS,
    Deviation,
    deviation_from_text,
    deviation_text,
    read_deviation,
)

ARM = Path(__file__).resolve().parents[3] / "sequences" / "robots" / "desk_arm.yaml"
MS = 1_000_000


@pytest.fixture
def arm():
    return load_robot(ARM)


@pytest.fixture
def horn_deg(arm):
    """Return what sends one line to the base at 1 s; its horn at instants, ms after that."""

    def after(text, line, *times_ms):
        deviation = deviation_from_text(text)
        options = deviation.bus_options(arm)
        bus = bus_from_robot(arm, "main", faults=deviation.faults(arm), **options)
        bus.record()
        bus.advance(0)
        bus.write(b"#1D0\r", 500 * MS)
        bus.write(line.encode() + b"\r", 1000 * MS)
        bus.advance(4000 * MS)
        return bus.horn_deg([(1000 + ms) * MS for ms in times_ms])[:, 0]

    return after


MOVE = "#1D100T40"


def test_each_key_of_time_shows_at_the_horn(horn_deg):
    usual = horn_deg("", "#1D100T500", 250)[0]
    assert usual == pytest.approx(4.8, abs=0.6)
    assert horn_deg("dead=100ms", "#1D100T500", 350)[0] == pytest.approx(usual, abs=0.1)
    assert horn_deg("lag=+40ms", "#1D100T500", 250)[0] == pytest.approx(usual - 0.8, abs=0.2)
    assert horn_deg("t_least=500ms", MOVE, 250)[0] == pytest.approx(usual, abs=0.1)
    assert horn_deg("t_step=500ms", "#1D100T600", 250)[0] == pytest.approx(usual, abs=0.1)
    assert horn_deg("t_ignored=1s", "#1D100T500", 250)[0] > 9.0
    assert horn_deg("motor=1%", "#1D100T500", 500)[0] == pytest.approx(1.8, abs=0.2)


def test_load_play_and_push_show_at_the_horn(horn_deg):
    assert horn_deg("droop=3deg", "#1D0", 1000)[0] == pytest.approx(-3.0, abs=0.1)
    assert horn_deg("backlash=2deg", "#1D100T500", 2000)[0] == pytest.approx(9.0, abs=0.1)
    pushed = horn_deg("push=6deg,push_at=2s,push_for=500ms", "#1D0", 800, 1300, 1800)
    assert pushed == pytest.approx([0.0, 6.0, 0.0], abs=0.1)


def test_a_text_is_read_as_it_is_written():
    text = "lag=+30ms,dead=60ms,ramp=0.5,retarget=from_rest,droop=3deg,noise=0.5deg,lost=0.01"
    assert deviation_text(deviation_from_text(text)) == text
    assert deviation_from_text("motor=25%") == Deviation(motor_ratio=0.25)
    assert deviation_text(Deviation()) == "as assumed"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("lagg=3ms", "'lagg' is no key here; did you mean 'lag'?"),
        ("lag=30", "lag is '30': it needs a number with s or ms"),
        ("motor=250%", "motor is 250%: allowed is 0.01 to 1"),
        ("lag=-30ms", "lag is -30ms: allowed is -0.02s to 0.5s"),
        ("droop=nan", "droop is 'nan': it needs a number with deg"),
        ("t_law=fast", "t_law is 'fast'"),
        ("lag=1ms,lag=2ms", "lag is given twice"),
        ("push_at=2s", "push_at alone pushes nothing; give push, too: push=6deg"),
        ("lag=1ms,droop", "'droop' is not key=value"),
    ],
)
def test_a_wrong_text_says_what_is_allowed(text, said):
    with pytest.raises(InputError) as error:
        deviation_from_text(text)
    assert said in str(error.value)
    assert "ratio" not in str(error.value)


@pytest.mark.parametrize("key", [key for key, word in WORDS.items() if word.unit])
def test_the_bounds_of_a_key_are_written_as_they_are_typed(key):
    field = WORDS[key].field
    least, most = WORDS[key].bounds.split(" to ")
    push = "push=1deg," if key.startswith("push_") else ""
    for text, number in ((least, WORDS[key].least), (most, WORDS[key].most)):
        assert getattr(deviation_from_text(f"{push}{key}={text}"), field) == number


@pytest.mark.parametrize("text", ["", "lag", "lag:+30ms", "no.yaml"])
def test_what_is_neither_a_key_nor_a_file_is_told_the_keys(arm, text):
    with pytest.raises(InputError) as error:
        read_deviation(text, arm)
    assert f"{text!r} is neither key=value nor an existing file; keys are lag, dead," in str(
        error.value
    )


def test_a_file_has_the_same_keys_and_single_joints(arm, tmp_path):
    path = tmp_path / "worse.yaml"
    path.write_text("lag: +30ms\ndroop: 3\njoints:\n  elbow: {droop: 6deg, motor: 0.5}\n")
    deviation = read_deviation(str(path), arm)
    assert deviation.lag_s == 0.03
    options = deviation.bus_options(arm)
    assert (options["droop_deg"]["base"], options["droop_deg"]["elbow"]) == (3.0, 6.0)
    assert [fault.servo_id for fault in deviation.faults(arm)] == [arm.joints["elbow"].servo_id]
    path.write_text("lag: 30\njoints:\n  elbow: {lag: 6ms}\n  knee: {}\n")
    with pytest.raises(InputError) as error:
        read_deviation(str(path), arm)
    said = [str(one) for one in [error.value, *error.value.more]]
    assert [f"worse.yaml:{line}:" in text for line, text in zip((1, 3, 4), said, strict=True)]
    assert "lag is '30'" in said[0]
    assert "'lag' is no key here" in said[1]
    assert "has no joint 'knee'" in said[2]


def test_every_key_sets_a_field():
    assert {word.field for word in WORDS.values()} | {"joints"} == set(Deviation.__struct_fields__)
