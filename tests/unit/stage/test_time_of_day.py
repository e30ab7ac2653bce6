"""Cron expressions on a wall clock that jumps, against a model that goes through every minute."""

from __future__ import annotations

from datetime import UTC, datetime, time, timedelta
from zoneinfo import ZoneInfo

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lss_motion.stage.model import CueTrigger, TriggerKind
from lss_motion.stage.triggering import CORRECTED, LATE, CronClock, clock_time, end_of_span

BERLIN = ZoneInfo("Europe/Berlin")
SPRING = datetime(2026, 3, 29, 1, 0, tzinfo=UTC)  # 02:00 becomes 03:00
AUTUMN = datetime(2026, 10, 25, 1, 0, tzinfo=UTC)  # 03:00 becomes 02:00


def fired(clock, expression, walls):
    """Return the walls at which the expression was due."""
    return [wall for wall in walls if expression in clock.due(wall)[0]]


def seconds(begin, span, step_s=20):
    count = int(span / timedelta(seconds=step_s))
    return [begin + timedelta(seconds=step_s * number) for number in range(count)]


@pytest.mark.parametrize(
    ("expression", "around", "times"),
    [
        ("30 2 * * *", SPRING, ["03:00"]),
        ("30 2 * * *", AUTUMN, ["02:30"]),
        ("0 3 * * *", SPRING, ["03:00"]),
        ("0 3 * * *", AUTUMN, ["03:00"]),
        ("*/30 * * * *", SPRING, ["01:00", "01:30", "03:00", "03:30", "04:00", "04:30"]),
        (
            "*/30 * * * *",
            AUTUMN,
            ["02:00", "02:30", "02:00", "02:30", "03:00", "03:30"],
        ),
        ("30 1-4 * * *", AUTUMN, ["02:30", "03:30"]),
    ],
)
def test_summer_time_begins_and_ends(expression, around, times):
    clock = CronClock([expression], BERLIN)
    walls = seconds(around - timedelta(minutes=90), timedelta(minutes=181))
    found = fired(clock, expression, walls)
    assert [wall.astimezone(BERLIN).strftime("%H:%M") for wall in found] == times


@given(
    steps=st.lists(st.tuples(st.floats(1, 4000), st.floats(-9000, 9000)), min_size=1, max_size=25),
    expression=st.sampled_from(["*/10 * * * *", "7 * * * *", "15 13 * * *", "0 12-14 * * *"]),
)
def test_no_minute_fires_twice_and_none_within_reach_is_left_out(steps, expression):
    """Each step waits, then sets the clock. The model keeps a set of all minutes gone through."""
    clock = CronClock([expression], UTC)
    wall = datetime(2026, 6, 1, 12, 0, 30, tzinfo=UTC)
    clock.due(wall)
    last = wall.replace(second=0)
    for wait_s, set_s in steps:
        for change_s in (wait_s, set_s):
            wall += timedelta(seconds=change_s)
            minute = wall.replace(second=0, microsecond=0)
            if last - minute > CORRECTED:
                last, expected = minute, False
            else:
                begin = max(last, minute - LATE)
                passed = []
                while begin < minute:
                    begin += timedelta(minutes=1)
                    passed.append(begin)
                expected = any(matches(expression, one) for one in passed)
                last = max(last, minute)
            assert (clock.due(wall)[0] == [expression]) is expected


def matches(expression, minute):
    """Read the expressions of this test by hand."""
    match expression:
        case "*/10 * * * *":
            return minute.minute % 10 == 0
        case "7 * * * *":
            return minute.minute == 7
        case "15 13 * * *":
            return (minute.hour, minute.minute) == (13, 15)
        case _:
            return minute.minute == 0 and minute.hour in (12, 13, 14)


def test_a_clock_that_is_set_says_so():
    clock = CronClock(["0 * * * *"], UTC)
    noon = datetime(2026, 1, 1, 12, 0, tzinfo=UTC)
    assert clock.due(noon) == ([], "")
    found, text = clock.due(noon + timedelta(days=365))
    assert "set forward by 365 days" in text
    assert found == ["0 * * * *"]
    assert "set back by" in clock.due(noon)[1]


def test_spans_of_a_day_go_through_midnight():
    night = [(time(23), time(8))]
    ends = [end_of_span(time(hour), night) for hour in (22, 23, 0, 7, 8, 12)]
    assert ends == [None, time(8), time(8), time(8), None, None]
    assert clock_time("24:10") is None


TIMES = ("0 * * * *", "0 9 6 1 *")


def test_the_next_time_is_one_at_which_the_cue_may_fire():
    clock = CronClock(["0 * * * *"], UTC)
    assert clock.coming("0 * * * *", ()) is None, "the time of day is not known yet"
    clock.due(datetime(2026, 1, 1, 12, 30, tzinfo=UTC))
    assert f"{clock.coming('0 * * * *', ()):%d %H:%M}" == "01 13:00"
    closed = [(time(11), time(19))]
    assert f"{clock.coming('0 * * * *', closed):%d %H:%M}" == "01 19:00", "after quiet hours"
    assert clock.coming("30 12 * * *", closed) is None, "always within them"
    said = [clock.when(CueTrigger(kind=TriggerKind.TIME, address=text), closed) for text in TIMES]
    assert said == ["next 19:00", "next 2026-01-06 09:00"]
