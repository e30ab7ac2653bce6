"""What is kept for a picture covers a show of any length evenly, in bounded room."""

from __future__ import annotations

from itertools import pairwise

import pytest

from lss_motion.player.joint_state import POINTS_MAX, Trace


@pytest.mark.parametrize("count", [1, POINTS_MAX, POINTS_MAX + 1, 54_321])
def test_few_points_cover_the_whole_evenly(count):
    trace = Trace()
    for index in range(count):
        trace.add(float(index), 2.0 * index, 3.0 * index)
    at_s = [point[0] for point in trace.points]
    steps = {after - before for before, after in pairwise(at_s)}
    assert at_s[0] == 0.0
    assert steps <= {float(trace.stride)}
    assert count - 1 - at_s[-1] < trace.stride
    assert min(count, POINTS_MAX / 2) <= len(at_s) <= POINTS_MAX
    assert all(point == (t, 2.0 * t, 3.0 * t) for t, point in zip(at_s, trace.points, strict=True))
