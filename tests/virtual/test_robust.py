"""Feedback does no harm on robots that are not as assumed: a part of `tools/benches/robust.py`."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benches.robust import cases, compared, played, problems


@pytest.fixture(scope="module")
def gestures():
    (case,) = cases(("LSS-ST1",), ("gestures",))
    return case


@pytest.mark.parametrize("sim", ["ramp=0.1", "dead=60ms", "backlash=1.5deg", "droop=6deg"])
def test_with_feedback_no_horn_is_worse_and_none_stands_off_its_plan(sim, gestures) -> None:
    ours, other = compared(gestures, sim)
    assert problems(ours, other) == []
    if sim == "ramp=0.1":
        assert ours.observable == set(gestures.robot.joints)


@pytest.fixture(scope="module")
def lively():
    (case,) = cases(("LSS-P-S1",), ("lively",))
    return case


@pytest.mark.parametrize(("sim", "count"), [("motor=25%", 4), ("push=6deg", 0)])
def test_a_joint_is_named_if_its_servo_is_not_as_assumed_and_not_if_a_hand_pushes_it(
    sim, count, lively
) -> None:
    ours = played(lively, sim, has_feedback=True)
    assert (ours.unnamed, len(ours.observable), len(ours.findings)) == (set(), count, count)


def test_a_lag_is_named_in_slow_moves_too() -> None:
    (slow,) = cases(("LSS-P-S1",), ("slow",))
    ours = played(slow, "lag=+60ms", has_feedback=True)
    assert len(ours.observable) == 1
    assert ours.unnamed == set()


def test_the_judge_finds_harm(gestures) -> None:
    plain = played(gestures, "", has_feedback=False)
    assert problems(plain, plain) == []
    assert plain.is_model_right
    worse = replace(
        plain,
        rms_deg=1.3 * plain.rms_deg,
        standing_deg=0.3,
        swings=3,
        speed_ratio=1.3,
        observable={"j0"},
        findings={"j1"},
    )
    found = [text.split()[0] for text in problems(worse, plain)]
    assert found == ["stands", "swings", "unnamed", "misnamed", "RMS", "speed"]
