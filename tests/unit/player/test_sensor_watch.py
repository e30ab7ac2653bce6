"""Sensors that are watched are read all evening, also while shows play."""

from __future__ import annotations

from lss_motion.playing.player.cues import READINGS_MAX, WATCH_PERIOD_NS, SensorWatch
from lss_motion.robot.model import Sensor

DOOR = Sensor(name="door", servo_id=203, bus="main", kind="GP2Y0A21YK0F")
LAMP = Sensor(name="lamp", servo_id=204, bus="main", kind="raw")
FAR = Sensor(name="far", servo_id=203, bus="other")


def test_each_sensor_is_asked_once_in_a_period_the_longest_overdue_first():
    watch = SensorWatch([DOOR, LAMP, FAR])
    asked = []
    for now_ns in range(0, 3 * WATCH_PERIOD_NS, WATCH_PERIOD_NS // 10):
        question = watch.query("main", now_ns)
        if question is not None:
            asked.append((question.servo_id, question.keyword, now_ns * 10 // WATCH_PERIOD_NS))
            watch.note_query_sent("main", question.servo_id, now_ns)
    assert [(who, at) for who, _, at in asked] == [
        (203, 0), (204, 1), (203, 10), (204, 11), (203, 20), (204, 21),
    ]  # fmt: skip
    assert watch.query("other", 0).servo_id == 203
    assert min(watch.wakeups_ns()) == 3 * WATCH_PERIOD_NS


def test_readings_are_those_of_its_sensors_and_are_bounded():
    watch = SensorWatch([DOOR])
    watch.take_reply("main", 203, 312)
    watch.take_reply("main", 203, None)
    watch.take_reply("main", 204, 7)
    watch.take_reply("other", 203, 8)
    assert watch.take_readings() == [("door", 312)]
    assert watch.take_readings() == []
    for number in range(2 * READINGS_MAX):
        watch.take_reply("main", 203, number)
    assert len(watch.take_readings()) == READINGS_MAX
