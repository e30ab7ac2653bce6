"""An hour of a stage of the campaign, and minutes in which all comes much more often."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from campaign import stages as tool

HURRY = 60.0
HOURS = 0.05


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    folder = tmp_path_factory.mktemp("weekend")
    return tool.weekend(HOURS, 2, folder, max_bytes=2_000_000, hurry=HURRY)


@pytest.mark.slow
def test_a_weekend_ends_safely_and_every_trigger_is_explained(outcome):
    assert tool.faults_of(outcome, 2_000_000) == []
    assert outcome.objections == Counter()
    assert outcome.looks > 500
    assert outcome.moves > 300
    assert outcome.runs >= 2
    assert outcome.plays >= 10
    assert outcome.triggers > 50


@pytest.mark.slow
def test_an_hour_of_the_weekend(tmp_path):
    """With a servo that falls silent, a hot one, and one that is stuck; the last is a rest."""
    hour = tool.weekend(1.0, 2, tmp_path, max_bytes=2_000_000)
    assert tool.faults_of(hour, 2_000_000) == []
    assert hour.looks > 15_000
    assert hour.plays > 10
    assert hour.triggers == hour.explained > 15
    assert len(hour.memory) >= 6


def test_what_a_weekend_must_not_show_is_named(outcome):
    bad = replace(
        outcome,
        hours=48.0,
        objections=Counter({"horn 1 moves too fast": 3}),
        explained=outcome.triggers - 1,
        log_bytes=3_000_000,
        memory=[tool.Memory(hour, 10**8 + 10**8 * hour, 10**6) for hour in range(5)],
    )
    found = "; ".join(tool.faults_of(bad, 2_000_000))
    for words in ("3 x horn 1 moves", "triggers, but", "bytes, allowed", "memory grows"):
        assert words in found


def test_the_judge_notices_moves_out_of_range_fast_horns_and_unsafe_ends():
    class WeekendBus:
        def __init__(self):
            self.deg = [0.0]
            self.motors = self.horns = self

        def advance(self, now_ns): ...

        def shafts_deg(self):
            return self.deg

    judge = tool.Judge({1: (-100.0, 100.0)}, [(-10.0, 10.0)], [100.0])
    bus = WeekendBus()
    judge.watch(bus)
    judge.sent("main", b"#1D90T500\r#1QD\r", 0)
    assert judge.objections == Counter()
    judge.sent("main", b"#1D-101T500\r", 0)
    for step, deg in enumerate((0.0, 5.0, 25.0)):
        bus.deg = [deg]
        judge.look((step + 1) * tool.LOOK_NS)
    run = type("Run", (), {"report": type("Report", (), {"outcome": "stopped"})})
    judge.end(run, 0)
    assert judge.objections == {
        "servo 1 was sent out of its range": 1,
        "horn 0 moves too fast": 1,
        "horn 0 is out of its range": 1,
        "the last bytes of a run are not the safe state": 1,
    }
    judge.sent("main", b"#254H\r", 0)
    judge.end(run, 0)
    assert judge.objections["the last bytes of a run are not the safe state"] == 1
