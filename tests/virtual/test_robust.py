"""Feedback does no harm on robots that are not as assumed: a part of `tools/benches/robust.py`."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

from benches.random_pairs import pair
from benches.robust import cases, compared, played, problems


@pytest.fixture(scope="module")
def gestures():
    (case,) = cases(("LSS-ST1",), ("gestures",))
    return case


@pytest.mark.slow
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


@pytest.fixture(scope="module")
def slow():
    (case,) = cases(("LSS-ST1",), ("slow",))
    return case


def test_a_lag_is_corrected_in_slow_moves_too_and_named_nevertheless(slow) -> None:
    ours, other = compared(slow, "dead=80ms")
    assert (ours.rms_deg < 0.75 * other.rms_deg, problems(ours, other)) == (True, [])
    assert ours.findings >= {"j00", "j01", "j03"}, "j02 hardly moves"


def test_a_load_is_corrected_in_slow_moves_of_which_readings_scatter(slow) -> None:
    """0.2 deg at 4 deg/s would be an error of 50 ms, if it were one of timing."""
    ours = played(slow, "droop=3deg,noise=0.2deg", has_feedback=True, seed=2)
    assert (ours.rms_deg < 0.15, ours.max_deg < 0.5) == (True, True)


def test_play_is_corrected_for_the_way_that_the_plan_takes(slow) -> None:
    """Not for that of a move by which only the correction changes."""
    assert played(slow, "backlash=1.5deg", has_feedback=True, seed=3).standing_deg < 0.3


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


@pytest.mark.parametrize(
    ("seed", "words"),
    [
        *((seed, "") for seed in (3, 8, 12, 16, 30, 35)),  # From rest, and pushes.
        pytest.param(76, "from_rest", id="and is slowed in mid-move"),
        pytest.param(71, "from_rest", id="and is behind then: its move is as quick as before"),
        pytest.param(1178, "from_rest", id="and what it lacks in motion is no load at rest"),
        pytest.param(2195, "from_rest", id="nor in its first quick move"),
        pytest.param(137, "push=", id="one that meets a joint as it comes to rest"),
        pytest.param(1081, "push=", id="one of a joint that begins to wave"),
        pytest.param(1045, "push=", id="one in motion"),
        pytest.param(23, "dead=7ms", id="targets that are reported a tick later now and then"),
        pytest.param(98, "ramp=0.96", id="a wave without acceleration to spare"),
        pytest.param(181, "backlash", id="such a wave of a joint with play"),
        pytest.param(1175, "lag=+32ms", id="such a wave of a joint that lags"),
    ],
)
def test_feedback_does_no_harm_to_a_random_show(seed, words) -> None:
    found = pair(seed)
    assert (words in found.text, found.outcome) == (True, "finished")
    assert not found.does_harm, found
