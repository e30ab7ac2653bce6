"""What a run keeps does not grow with its length: only the record of the simulator does."""

from __future__ import annotations

import gc
import tracemalloc

import pytest

from lss_motion.playing import api
from lss_motion.playing.player import estimators
from lss_motion.playing.run import Observer, perform

LOOKS_S = (15.0, 45.0)
KEPT_MAX_BYTES = 16_384
"""In between some 400 readings are accepted: 50 bytes each would show."""


class Looking:
    """Takes snapshots of the memory at instants of the run, and stops it after the last."""

    def __init__(self):
        self.snapshots = []

    def filenos(self):
        return []

    def act(self, player, now_ns):
        if now_ns < LOOKS_S[len(self.snapshots)] * 1e9:
            return
        gc.collect()
        self.snapshots.append(tracemalloc.take_snapshot())
        if len(self.snapshots) == len(LOOKS_S):
            self.filenos, self.act = list, lambda *_: None
            player.stop(now_ns)


@pytest.mark.slow
def test_the_player_keeps_nothing_of_each_line_and_reading(kit, monkeypatch):
    monkeypatch.setattr(estimators, "POINTS_MAX", 40)
    robot = kit.robot(2, baud_bps=115_200)
    program = api.compile(api.plan(kit.sequence(2, 6.0, loop=10_000), robot), robot)
    looking = Looking()
    tracemalloc.start(4)
    try:
        perform(program, robot, is_virtual=True, observer=Observer(controls=looking))
    finally:
        tracemalloc.stop()
    early, late = looking.snapshots
    grown = [
        one
        for one in late.compare_to(early, "traceback")
        if not any("/sim/" in frame.filename for frame in one.traceback)
        and not any("tracemalloc" in frame.filename for frame in one.traceback)
    ]
    kept = sum(one.size_diff for one in grown)
    assert kept < KEPT_MAX_BYTES, "\n".join(map(str, grown[:5]))
