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
        assert ours.findings == set(gestures.robot.joints)


def test_the_judge_finds_harm(gestures) -> None:
    plain = played(gestures, "", has_feedback=False)
    assert problems(plain, plain) == []
    worse = replace(plain, rms_deg=1.3 * plain.rms_deg, standing_deg=0.3, swings=3, speed_ratio=1.3)
    found = problems(worse, plain)
    assert [text.split()[0] for text in found] == ["stands", "swings", "RMS", "speed"]
