"""Joints without a T: what the limits take off a target is said again, or led to."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import event, example, given
from hypothesis import strategies as st

from lss_motion.player.leading import lead
from lss_motion.player.line import Line
from lss_motion.player.setpoints import PHASES, Setpoints
from lss_motion.player.track import make_tracks
from lss_motion.program.course import servo_limits
from lss_motion.program.model import Driving, Program
from lss_motion.robot.model import Bus
from lss_motion.robot.models import SERVO_MODELS
from tests.joints import joint

JOINT = joint(servo_id=2, drive="streamed")
STEP_NS, FILTER_S, TOLERANCE_DEG = 20_000_000, 0.02, 0.2


def track_of(kit, joint):
    robot = kit.robot(joint)
    count = joint.filter_count if joint.drive == "streamed" else 0
    program = Program(
        name="still",
        robot=robot.name,
        moves=(),
        duration_s=1.0,
        start_deg={joint.name: 0.0},
        tolerance_deg=TOLERANCE_DEG,
        drives={joint.name: Driving(joint.drive, count)},
    )
    return make_tracks(program, robot, {joint.name: 0.0}, 0.0, has_feedback=True)[joint.name]


def led(track, planned_deg=None, *, now_ns=STEP_NS, baud_bps=115200, sent=None):
    """Lead a streamed joint along `planned_deg`, until it is where that ends."""
    line = Line(Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370))
    track.led_ns = now_ns
    while track.led_ns is not None:
        now_ns = max(track.led_ns, line.free_ns)
        lead(track, line, planned_deg, now_ns, STEP_NS, is_even=False)
        if sent is not None:
            sent.append((track.heard_ns, line.take()))
        assert now_ns < 10e9, "it arrives some time"
    return now_ns


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


def staircase(heard, count, phase_s, end_s):
    """Return what a filter that steps at `phase_s` and every 20 ms from there makes of targets."""
    value, values = 0.0, []
    for step in range(round((end_s - phase_s) / FILTER_S)):
        before = [deg for at_ns, deg in heard if at_ns / 1e9 <= phase_s + step * FILTER_S]
        value += ((before[-1] if before else 0.0) - value) / count
        values.append(value)
    return np.array(values)


def felt(values, lag_s=0.02):
    """Return the accelerations of a horn that lags behind a staircase, as differences of 20 ms."""
    second = np.diff(values, 2, prepend=[0.0, 0.0]) / FILTER_S**2
    ratio, last, found = 1.0 - np.exp(-FILTER_S / lag_s), 0.0, []
    for one in second:
        last += ratio * (one - last)
        found.append(last)
    return np.array(found)


def targets(sent):
    return [(at_ns, int(re.fullmatch(rb"#\d+D(-?\d+)\r", line)[1]) / 10) for at_ns, line in sent]


@pytest.mark.parametrize("target_deg", [80.0, -80.0])
def test_a_streamed_joint_that_is_led_far_keeps_its_limits_and_arrives(kit, target_deg):
    joint = kit.joint("j0", 2, drive="streamed", speed_max_deg_s=180.0, accel_max_deg_s2=600.0)
    track, sent = track_of(kit, joint), []
    end_ns = led(track, lambda *_: target_deg, sent=sent)
    assert 0.8 < end_ns / 1e9 < 1.6, "80 deg at 180 deg/s, and two ramps of 0.3 s"
    assert track.profile.at(end_ns / 1e9 + 1.0) == (target_deg, 0.0)
    for phase_s in np.arange(0.0, FILTER_S, 0.001):
        values = staircase(targets(sent), joint.filter_count, phase_s, end_ns / 1e9 + 0.5)
        assert np.abs(np.diff(values)).max() <= 180.0 * FILTER_S + 0.05
        assert np.abs(felt(values)).max() <= 1.1 * 600.0 + TOLERANCE_DEG / FILTER_S**2
        assert np.abs(values).max() <= 80.05, "it does not go beyond"


@given(
    st.lists(
        st.tuples(st.integers(1_000, 20_000), st.floats(-90.0, 90.0)), min_size=1, max_size=60
    ),
    st.sampled_from([2, 3, 5]),
)
@example(asked=[(20_000, 90.0)] * 60, count=3)
def test_whatever_is_asked_and_however_unevenly_no_filter_leaves_its_limits(asked, count):
    setpoints = Setpoints(0.0, count=count, limits=servo_limits(JOINT, TOLERANCE_DEG))
    at_us, heard = 0.3, []
    for gap_us, wanted_deg in asked:
        at_us += gap_us
        low_deg, high_deg = setpoints.allowed(at_us / 1e6)
        if high_deg - low_deg < 1e-9:
            event("the instants disagree")
            break
        target_deg = min(max(wanted_deg, low_deg, -90.0), high_deg, 90.0)
        setpoints.told(at_us / 1e6, target_deg)
        heard.append((1e3 * at_us, target_deg))
    for phase in range(PHASES):
        values = staircase(heard, count, phase * FILTER_S / PHASES, at_us / 1e6 + FILTER_S)
        assert np.abs(np.diff(values)).max(initial=0.0) <= 180.0 * FILTER_S + 0.05
        most_deg_s2 = 600.0 + (TOLERANCE_DEG + 0.05) / FILTER_S**2
        assert np.abs(felt(values)).max(initial=0.0) <= most_deg_s2


def test_a_target_that_the_plan_would_ask_for_is_said_as_it_is(kit):
    track = track_of(kit, kit.joint("j0", 2, drive="streamed"))
    assert told(track, 2.0) == [(STEP_NS, 2.0)]
    assert track.led_ns is None


def test_what_is_too_much_is_taken_off_and_the_joint_is_led(kit):
    track = track_of(kit, kit.joint("j0", 2, drive="streamed"))
    ((_, said_deg),) = told(track, 60.0)
    assert 2.0 < said_deg < 10.0
    acts_on = track.profile.acts_on
    assert acts_on(track.led_ns / 1e9) == acts_on(STEP_NS / 1e9) + 1, "with the next step"


def test_a_stepped_joint_jumps_no_further_than_its_speed_allows(kit):
    joint = kit.joint("j0", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    track = track_of(kit, replace(joint, speed_max_deg_s=100.0))
    said = told(track, 37.0)
    assert said[-1][1] == 37.0
    values = [0.0, *(deg for _, deg in said)]
    jumps = [b - a for a, b in pairwise(values)]
    assert max(jumps) <= 1.0 + 100.0 * 0.02
    assert said[-1][0] - said[0][0] >= 0.8 * 37.0 / 150.0 * 1e9


def test_correction_and_range_hold_for_bare_targets_too(kit):
    joint = kit.joint("j0", 2, drive="streamed", position_max_deg=20.0)
    track = track_of(kit, joint)
    track.following.offset_deg = 1.5
    now_ns = led(track, lambda *_: 10.0)
    assert track.profile.at(5.0) == (11.5, 0.0)
    led(track, lambda *_: 20.0, now_ns=now_ns + STEP_NS)
    assert track.profile.at(9.0) == (20.0, 0.0)


def test_a_servo_that_is_believed_to_go_on_for_ever_is_waited_for_as_long_as_the_longest_move(kit):
    # It took a garbled word for its target, and said so when it was asked.
    track = track_of(kit, kit.joint("j0", 1))
    track.moved(STEP_NS, 100_000, 200)
    assert not track.is_at_rest(STEP_NS + 9_000_000_000)
    assert track.is_at_rest(STEP_NS + 11_000_000_000)
