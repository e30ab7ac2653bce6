"""Time lost by shows that are too fast for the limits: ours, plain toppra, and the least there is.

Random shows of `tools/campaign anchors`, without their anchors. Plain toppra follows the path at
most at the author's pace: it never makes up for what it has lost, but in rests. The least is that
of `campaign.reach`, which shares no code with the planner, with the largest rate of a late motion.
"""

from __future__ import annotations

import numpy as np
from campaign.anchors import any_show
from campaign.reach import Reach
from msgspec.structs import replace

from benches.plan import empty_cache
from benches.table import Row
from lss_motion.planning.trajectory.catch_up import PACE_MAX
from lss_motion.planning.trajectory.planner import plan
from lss_motion.planning.trajectory.retime import authored_clock, laid_out, slowed_windows, stops

SHOWS = 20
FIRST = 900_000
LATE_TARGET = 1.02


def measure() -> list[Row]:
    """Return the row: the lateness of all keys of all shows, summed."""
    ours_s = plain_s = least_s = 0.0
    for seed in range(FIRST, FIRST + SHOWS):
        show, robot = any_show(seed)
        frames = tuple(replace(frame, is_anchor=False) for frame in show.keyframes)
        show = replace(show, keyframes=frames)
        authored_s = np.array([frame.at_s or 0.0 for frame in frames])
        with empty_cache():
            marks = plan(show, robot).marks
        layout = laid_out(show, robot)
        task = layout.task({})
        windows = slowed_windows(task, stops(task), is_outline=False)
        clock = authored_clock(task.path, windows, (), layout.dues())
        ours_s += sum(mark.planned_s - (mark.authored_s or 0.0) for mark in marks)
        plain_s += float((clock.times_of(layout.spacing.reached_s) - authored_s).sum())
        least_s += sum(Reach(show, robot, PACE_MAX).lateness())
    keys = f"of the keys of {SHOWS} shows"
    return [
        Row(
            what="time lost: lateness of all keys of random shows",
            ours=f"{ours_s:.2f} s {keys}",
            reference=f"{plain_s:.2f} s plain toppra; {least_s:.2f} s the least",
            ratio=ours_s / least_s,
            target=f"<= {LATE_TARGET:g} x the least",
            is_met=ours_s <= LATE_TARGET * least_s,
        )
    ]
