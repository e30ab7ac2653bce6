"""Labels and seconds."""

from __future__ import annotations

import pytest

from lss_motion.errors import InputError
from lss_motion.stage.timecode.timecode import (
    FPS_29_97_DROP,
    RATES,
    Timecode,
    read_rate,
    read_timecode,
    timecode_of,
)


def counted(rate, from_frame, count):
    """Labels by counting, with the rule of drop-frame as SMPTE 12M words it."""
    label = list(timecode_of(from_frame, rate))
    for _ in range(count):
        yield Timecode(*label)
        label[3] += 1
        for place, most in ((3, rate.labels), (2, 60), (1, 60)):
            if label[place] == most:
                label[place], label[place - 1] = 0, label[place - 1] + 1
        label[0] %= 24
        if rate.is_drop and label[2] == 0 and label[3] == 0 and label[1] % 10:
            label[3] = 2


@pytest.mark.parametrize("rate", RATES.values(), ids=RATES)
def test_labels_are_counted_as_the_standard_says_over_the_day(rate):
    for start in (0, 1795, 17980, 107890, rate.frames_per_day - 40):
        for number, label in enumerate(counted(rate, start, 80)):
            frame = (start + number) % rate.frames_per_day
            assert timecode_of(frame, rate) == label
            assert label.is_valid(rate)
            assert label.frame(rate) == frame


def test_drop_frame_agrees_with_the_clock():
    hour = Timecode(1, 0, 0, 0)
    assert hour.frame(FPS_29_97_DROP) == 107892
    assert hour.at_s(FPS_29_97_DROP) == pytest.approx(3600.0, abs=0.005)
    assert not Timecode(0, 1, 0, 1).is_valid(FPS_29_97_DROP)
    assert Timecode(0, 10, 0, 1).is_valid(FPS_29_97_DROP)


def test_texts_are_read_and_refused():
    assert read_timecode("01:02:03:10") == (1, 2, 3, 10)
    assert read_timecode("1:02:03;10") == (1, 2, 3, 10)
    assert read_timecode("10:00:00") == (10, 0, 0, 0)
    assert read_rate("29.97DF").is_drop
    for text in ("", "1:2", "25:00:00:00", "00:00:00:30", "1e3", "00:61:00:00"):
        with pytest.raises(InputError, match="no timecode"):
            read_timecode(text)
    with pytest.raises(InputError, match="no frame rate"):
        read_rate("26")
