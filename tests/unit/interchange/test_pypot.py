"""pypot moves: order of samples, recordings, and errors."""

from __future__ import annotations

import json

import numpy as np
import pytest

from lss_motion.interchange.json_motions import PYPOT
from lss_motion.interchange.reader import Measure


def test_pypot_samples_are_sorted_by_their_real_times(read_one) -> None:
    positions = {"1.5": {"neck": [3.0, 0.0]}, "0.5": {"neck": [1.0, 9.0]}, "10": {"neck": [2, 0]}}
    motion = read_one(PYPOT, json.dumps({"framerate": 50.0, "positions": positions}))
    (neck,) = motion.channels
    assert neck.times_s.tolist() == [0.5, 1.5, 10.0]
    assert neck.values.tolist() == [1.0, 3.0, 2.0]
    assert neck.unit is Measure.DEG
    assert not motion.is_recording
    assert "Not carried over: recorded speeds" in motion.comments


def test_dense_pypot_samples_are_a_recording(read_one) -> None:
    positions = {str(index / 50): {"neck": [index, 0.0]} for index in range(100)}
    motion = read_one(PYPOT, json.dumps({"framerate": 50.0, "positions": positions}))
    assert motion.is_recording
    assert len(motion.channels[0].times_s) == 100


@pytest.mark.parametrize(
    ("positions", "reason"),
    [
        ({"soon": {"neck": [1.0, 0.0]}}, "positions.soon: the name must be a time"),
        ({"nan": {"neck": [1.0, 0.0]}}, "positions.nan is nan"),
        ({"1": {"neck": []}}, "positions.1.neck is []"),
        ({"1": {"neck": [None, 0.0]}}, "positions.1.neck is None"),
        ({"1": {"neck": [1.0, 0]}, "1.0": {"neck": [2.0, 0]}}, "times must increase"),
        ({"1": {}}, "moves no joint"),
        ({}, "moves no joint"),
        ([], "positions must be an object"),
    ],
)
def test_wrong_pypot_positions_are_refused_with_their_place(refusal, positions, reason) -> None:
    content = json.dumps({"framerate": 50.0, "positions": positions})
    assert reason in refusal(PYPOT, content).reason


@pytest.mark.slow
def test_ten_megabytes_of_samples_are_read(read_one) -> None:
    motors = ",".join(f'"joint_{n}":[12.34,0.0]' for n in range(20))
    rows = ",".join(f'"{index / 100}":{{{motors}}}' for index in range(20_000))
    text = f'{{"framerate":100,"positions":{{{rows}}}}}'
    motion = read_one(PYPOT, text)
    assert [len(channel.times_s) for channel in motion.channels] == [20_000] * 20
    np.testing.assert_array_equal(motion.channels[0].values, 12.34)
