"""Sequences of which only a part is looped."""

from __future__ import annotations

import math

import numpy as np
import pytest

from lss_motion.errors import InputError
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.playlist import all_marks
from lss_motion.planning.trajectory.verify import verify
from lss_motion.show.model import Sequence

PERIOD_S = 1.0
KEYS = 16


def turning(frame, *, loop=3, span_s=(2.0, 3.0), off_deg=0.0, **more):
    """Rests, swings into a sine of one second a pass, five passes of it, and out to rest."""
    at = np.arange(0, 5 * KEYS + 1) / KEYS
    wave = 10.0 * np.sin(2.0 * math.pi * at / PERIOD_S) * np.clip(at, 0.0, 1.0)
    wave *= np.clip(5.0 - at, 0.0, 1.0)
    frames = [
        frame(float(at_s), ease="spline", label=f"{at_s:g}" if at_s in (0.0, 2.5, 5.0) else "",
              base=float(deg + off_deg * (at_s > 2.5)))
        for at_s, deg in zip(at, wave, strict=True)
    ]  # fmt: skip
    return Sequence(name="turning", keyframes=tuple(frames), loop=loop, loop_span_s=span_s, **more)


def test_the_part_is_looped_and_the_rest_played_once(frame, make_robot):
    robot = make_robot()
    once = plan(turning(frame, loop=1), robot)
    looped = plan(turning(frame, loop=4), robot)
    assert looped.duration_s == pytest.approx(once.duration_s + 3 * PERIOD_S)
    at_s = np.arange(0.0, looped.duration_s, 0.01)
    passed = np.clip(np.floor(at_s - 2.0), 0.0, 3.0)
    for order, tolerance in ((0, 1e-3), (1, 0.05)):
        wanted = once.sample(at_s - passed * PERIOD_S, order)
        np.testing.assert_allclose(looped.sample(at_s, order), wanted, atol=tolerance)
    assert looped.sample(np.array([-1.0, 99.0]), 1).max() == 0.0
    knots_s = looped.knots_until(looped.duration_s)
    assert np.abs(np.diff(np.unique(knots_s.round(9)))).max() <= 1.0 / KEYS + 1e-6
    verify(looped, robot)


def test_a_part_that_is_looped_forever_has_no_end(frame, make_robot):
    endless = plan(turning(frame, loop=None), make_robot())
    assert endless.duration_s == math.inf
    far_s = 3600.0 + np.linspace(2.0, 3.0, 30)
    near_deg, far_deg = endless.sample(far_s - 3600.0), endless.sample(far_s)
    np.testing.assert_allclose(far_deg, near_deg, atol=1e-3)


def test_the_times_of_the_keyframes_are_those_of_the_show(frame, make_robot):
    found = all_marks(plan(turning(frame, loop=4), make_robot()), math.inf)
    assert [(m.label, round(m.planned_s, 6)) for m in found if m.label] == [
        ("0", 0.0), ("2.5", 2.5), ("5", 8.0)
    ]  # fmt: skip
    endless = all_marks(plan(turning(frame, loop=None), make_robot()), 5.0)
    assert [(m.label, round(m.planned_s, 6)) for m in endless if m.label] == [
        ("0", 0.0), ("2.5", 2.5), ("2.5", 3.5), ("2.5", 4.5)
    ]  # fmt: skip


def test_the_speed_ratio_holds_for_the_part(frame, make_robot):
    slow = plan(turning(frame, loop=4, speed_ratio=0.5), make_robot())
    assert slow.duration_s == pytest.approx(2.0 * 8.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"off_deg": 5.0}, "must end as it begins, but joint 'base' is at .* deg at its beginning"),
        ({"span_s": (2.0, 2.5)}, r"'base' is at \d\d\.\d+ deg/s at its beginning"),
        ({"span_s": (6.0, 7.0)}, "lies after the end, at 5.000 s"),
    ],
)
def test_a_part_that_does_not_end_as_it_begins_is_refused(frame, make_robot, changes, words):
    with pytest.raises(InputError, match=words):
        plan(turning(frame, **changes), make_robot())
