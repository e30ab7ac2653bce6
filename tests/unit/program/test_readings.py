from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lss_motion.errors import LineLoadError
from lss_motion.program.compile import compile_program
from lss_motion.program.line import TURNAROUND_US, reading_rate_hz

QUERY_US = 5 * 87 - 1
"""`#1QD` and its end at 115200 bps, rounded up."""


def slots(*pairs):
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def test_on_an_idle_line_the_answers_are_what_takes_the_time(kit):
    reply_us = 9 * 87 - 1  # *1QD-900 and its end
    expected_hz = 1e6 / (TURNAROUND_US + reply_us)
    assert reading_rate_hz([kit.joint()], 115200, slots()) == pytest.approx(expected_hz, rel=1e-2)
    four = [kit.joint(f"j{index}", index) for index in range(4)]
    assert reading_rate_hz(four, 115200, slots()) == pytest.approx(expected_hz / 4, rel=1e-2)
    assert reading_rate_hz([], 115200, slots()) == float("inf")


def test_a_gap_too_short_for_a_question_counts_for_nothing(kit):
    joints = [kit.joint()]
    full = slots(*((at, 10_000 - QUERY_US + 1) for at in range(0, 3_000_000, 10_000)))
    assert reading_rate_hz(joints, 115200, full) == 0.0
    wide = slots(*((at, 10_000 - QUERY_US - 1) for at in range(0, 3_000_000, 10_000)))
    assert reading_rate_hz(joints, 115200, wide) == pytest.approx(100.0, abs=1.0)


@pytest.mark.parametrize("seed", range(20))
def test_as_many_questions_as_promised_can_be_sent_in_any_second(kit, seed):
    """Against a line that is asked on whenever a question fits before the next command."""
    random = np.random.default_rng(seed)
    own, at_us = [], 0
    while at_us < 4_000_000:
        at_us += int(random.choice([300, 2_000, 30_000])) if random.random() < 0.8 else 0
        size_us = int(random.integers(500, 20_000))
        own.append((at_us, size_us))
        at_us += size_us
    asked_us = []
    for (due_us, size_us), (next_us, _) in pairwise(own):
        free_us = due_us + size_us
        asked_us += range(free_us + QUERY_US, next_us + 1, QUERY_US)
    asked_us = np.array(asked_us)
    starts_us = np.arange(0, 2_900_000, 997)
    counts = np.searchsorted(asked_us, starts_us + 1_000_000) - np.searchsorted(asked_us, starts_us)
    promised = reading_rate_hz([kit.joint()], 115200, slots(*own))
    answered = 1e6 / TURNAROUND_US
    assert promised <= counts.min() + 1
    assert promised >= min(answered / 2, counts.min() - 2) - 1


def busy(kit, rate_min_hz):
    """A line of which commands take more than half in the worst second."""
    joints = [kit.joint(f"j{index}", index + 1) for index in range(12)]
    robot = kit.robot(*joints, baud_bps=19200)
    bus = replace(robot.buses["main"], reading_rate_min_hz=rate_min_hz)
    robot = replace(robot, buses={"main": bus})
    return kit.plan(kit.lively(list(robot.joints), 4.0), robot), robot


def test_the_tolerance_is_relaxed_until_the_joints_can_be_read_often_enough(kit):
    trajectory, robot = busy(kit, 0.0)
    freely = compile_program(trajectory, robot)
    found_hz = freely.line_use["main"].reading_rate_hz
    _, stricter = busy(kit, 1.02 * found_hz)
    program = compile_program(trajectory, stricter)
    assert program.line_use["main"].reading_rate_hz >= 1.02 * found_hz
    assert program.tolerance_deg > freely.tolerance_deg


def test_what_cannot_be_read_often_enough_is_refused_with_figures(kit):
    trajectory, robot = busy(kit, 500.0)
    with pytest.raises(LineLoadError) as caught:
        compile_program(trajectory, robot)
    said = str(caught.value)
    assert "each joint could be read" in said
    assert "times, not 500" in said
    assert "reading_rate_min_hz" in said
    assert caught.value.bus == "main"
