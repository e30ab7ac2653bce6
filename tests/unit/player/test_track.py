"""Joints without a T: what the limits take off a target is said again, or led to."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from lss_motion.robot.models import SERVO_MODELS

STEP_NS = 20_000_000


def told(track, target_deg):
    """Say a target, and whatever is owed after that; return `(heard_ns, degrees)` of each."""
    now_ns, said = STEP_NS, []
    while True:
        wire = track.wire_for(target_deg, now_ns)
        track.moved(now_ns, wire, None)
        said.append((now_ns, wire / 10))
        if track.owed is None:
            return said
        now_ns, target_deg = track.owed
        assert len(said) < 200, "it arrives some time"


def test_a_target_that_the_plan_would_ask_for_is_said_as_it_is(kit):
    track = kit.track(kit.joint("j0", 2, drive="streamed"))
    assert told(track, 2.0) == [(STEP_NS, 2.0)]
    assert track.led_ns is None


def test_what_is_too_much_is_taken_off_and_the_joint_is_led(kit):
    track = kit.track(kit.joint("j0", 2, drive="streamed"))
    ((_, said_deg),) = told(track, 60.0)
    assert 2.0 < said_deg < 10.0
    acts_on = track.profile.acts_on
    assert acts_on(track.led_ns / 1e9) == acts_on(STEP_NS / 1e9) + 1, "with the next step"


def test_a_stepped_joint_jumps_no_further_than_its_speed_allows(kit):
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    track = kit.track(replace(joint, speed_max_deg_s=100.0))
    said = told(track, 37.0)
    assert said[-1][1] == 37.0
    values = [0.0, *(deg for _, deg in said)]
    jumps = [b - a for a, b in pairwise(values)]
    assert max(jumps) <= 1.0 + 100.0 * 0.02
    assert said[-1][0] - said[0][0] >= 0.8 * 37.0 / 150.0 * 1e9


def test_a_servo_that_is_believed_to_go_on_for_ever_is_waited_for_as_long_as_the_longest_move(kit):
    # It took a garbled word for its target, and said so when it was asked.
    track = kit.track(kit.joint("j0", 1))
    track.moved(STEP_NS, 100_000, 200)
    assert not track.is_at_rest(STEP_NS + 9_000_000_000)
    assert track.is_at_rest(STEP_NS + 11_000_000_000)
