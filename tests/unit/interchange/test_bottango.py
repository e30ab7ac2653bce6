"""Bottango: Bezier curves in time, signals of effectors, several controllers and animations."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lss_motion.interchange.json_motions import BOTTANGO
from lss_motion.interchange.reader import Measure

EASED = "sC,10,1000,2000,0,500,0,8192,-500,0"
STRAIGHT = "sC,10,3000,300,8192,100,-2730.6667,0,-100,2730.6667"


def controller(*commands: str, name: str = "head", setup: str = "") -> dict[str, object]:
    return {
        "Controller Name": name,
        "Setup": {"Controller Setup Commands": "rSVPin,10,1000,2000,3000,1500\n" + setup},
        "Animations": [
            {
                "Animation Name": "nod",
                "Animation Commands": "\n".join(commands) + "\n",
                "Animation Loop Commands": "",
            }
        ],
    }


def test_a_curve_runs_between_the_signals_of_its_effector(read_one) -> None:
    motion = read_one(BOTTANGO, json.dumps([controller(EASED, STRAIGHT)]))
    (servo,) = motion.channels
    assert (motion.name, servo.name, servo.unit) == ("nod", "10", Measure.US)
    assert motion.is_recording
    at = dict(zip(servo.times_s.tolist(), servo.values.tolist(), strict=True))
    assert (at[1.0], at[3.0], at[3.3]) == (1000.0, 2000.0, 1000.0)
    # The control points of the first are level and symmetric, so it is halfway in the middle.
    assert np.interp(2.0, servo.times_s, servo.values) == pytest.approx(1500.0, abs=0.1)
    assert np.interp(1.2, servo.times_s, servo.values) < 1100.0
    # Those of the second divide it in thirds: a straight line.
    line = servo.times_s >= 3.0
    straight = 2000.0 - 1000.0 * (servo.times_s[line] - 3.0) / 0.3
    np.testing.assert_allclose(servo.values[line], straight, atol=0.01)


def test_between_curves_an_effector_keeps_its_signal(read_one) -> None:
    later = "sC,10,5000,100,8192,0,0,0,0,0"
    (servo,) = read_one(BOTTANGO, json.dumps([controller(EASED, later)])).channels
    still = (servo.times_s >= 3.0) & (servo.times_s <= 5.0)
    assert np.ptp(servo.values[still]) == 0.0
    assert servo.times_s[still].tolist() == [3.0, 4.99, 5.0]


def test_a_group_of_curves_stands_in_one_line(read_one) -> None:
    setup = "rSVI2C,64,2,2000,1000,3000,1500\n"
    group = "sSY,sC,10,0,100,0,25,0,8192,-25,0;642,0,100,0,25,0,8192,-25,0;"
    motion = read_one(BOTTANGO, json.dumps([controller(group, setup=setup)]))
    first, second = motion.channels
    assert (first.name, second.name) == ("10", "642")
    assert first.values[-1] == 2000.0
    assert second.values[[0, -1]].tolist() == [2000.0, 1000.0]  # max below min: it turns round.


def test_effectors_of_several_controllers_have_different_names(read_one) -> None:
    content = [controller(EASED), controller(EASED, name="arm")]
    motion = read_one(BOTTANGO, json.dumps(content))
    assert [channel.name for channel in motion.channels] == ["head/10", "arm/10"]


def test_commands_without_motion_are_listed_in_comments(read_one) -> None:
    content = controller(EASED, "sCT,myMedia,0,0", "sCC,3,0,1")
    content["Animations"][0]["Animation Loop Commands"] = EASED
    comments = read_one(BOTTANGO, json.dumps([content])).comments
    assert "Not carried over: commands sCT" in comments
    assert "Not carried over: commands sCC" in comments
    assert any("Animation Loop Commands" in comment for comment in comments)


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("sC,11,0,100,0,0,0,0,0,0", "Animations[0] command 1: effector '11' is not set up"),
        ("sC,10,0,100,0,0,0,0,0", "a curve has an id and 8 numbers, not 7"),
        ("sC,10,0,100,0,x,0,0,0,0", "'x' is not a number"),
        ("sC,10,0,nan,0,0,0,0,0,0", "'nan' is out of range"),
        ("sC,10,-5,100,0,0,0,0,0,0", "must lie between 0 s and a day"),
        ("sC,10,0,1e9,0,0,0,0,0,0", "out of range"),
        (f"{EASED}\nsC,10,1500,100,0,0,0,0,0,0", "two curves of '10' overlap at 1.5 s"),
        ("sCT,a,0", "no animation has a curve"),
    ],
)
def test_a_wrong_curve_is_refused_with_its_place(refusal, command: str, reason: str) -> None:
    assert reason in refusal(BOTTANGO, json.dumps([controller(command)])).reason


def test_a_curve_of_hours_has_at_most_500_samples(read_one) -> None:
    curves = ["sC,10,0,80000000,0,40000000,0,8192,-40000000,0"]
    (servo,) = read_one(BOTTANGO, json.dumps([controller(*curves)])).channels
    assert len(servo.times_s) < 600
    assert servo.times_s[-1] == 80_000.0
    assert np.interp(40_000.0, servo.times_s, servo.values) == pytest.approx(1500.0, abs=0.1)
