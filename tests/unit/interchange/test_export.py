"""Plans as text for other tools, and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from lss_motion.cli.exchange import FORMATS_IN, FORMATS_OUT, KINDS, MCAP, PROGRAM, SKETCH, SUFFIXES
from lss_motion.interchange.export import EXPORT_NAMES, PlanSamples, exported
from lss_motion.interchange.importing import FORMAT_NAMES, READERS
from lss_motion.interchange.reader import ForeignMotion


@pytest.fixture
def samples() -> PlanSamples:
    times_s = np.arange(51) / 25.0
    angles = np.stack([30.0 * np.sin(times_s), -times_s], axis=1)
    speeds = np.stack([30.0 * np.cos(times_s), -np.ones(51)], axis=1)
    return PlanSamples(
        name="sway",
        joints=("base", "elbow"),
        rate_hz=25.0,
        times_s=times_s,
        angles_deg=angles,
        speeds_deg_s=speeds,
    )


@pytest.mark.parametrize(
    ("name", "error_deg"),
    [("csv", 5e-5), ("ros", 5e-5), ("blender-csv", 5e-5), ("blender-json", 0.05)],
)
def test_an_export_is_recognised_and_read_back(samples, name, error_deg) -> None:
    data = exported(samples, name).encode()
    reader = next(reader for reader in READERS if reader.recognises(data))
    (motion,) = reader.motions(Path("sway"), data)
    assert isinstance(motion, ForeignMotion)
    assert [channel.name for channel in motion.channels] == ["base", "elbow"]
    for column, channel in enumerate(motion.channels):
        np.testing.assert_allclose(channel.times_s, samples.times_s, atol=1e-6)
        angles = [keyframe.deg[channel.name] for keyframe in motion.keyframes]
        np.testing.assert_allclose(angles, samples.angles_deg[:, column], atol=error_deg + 1e-9)


def test_a_ros_trajectory_has_speeds_and_whole_nanoseconds(samples) -> None:
    message = yaml.safe_load(exported(samples, "ros"))
    point = message["points"][1]
    assert message["joint_names"] == ["base", "elbow"]
    assert point["time_from_start"] == {"sec": 0, "nanosec": 40_000_000}
    assert message["points"][25]["time_from_start"] == {"sec": 1, "nanosec": 0}
    assert point["velocities"][1] == pytest.approx(np.radians(-1.0), abs=1e-6)


def test_the_command_line_names_the_formats_that_there_are() -> None:
    assert tuple(FORMATS_IN.split(", ")) == FORMAT_NAMES
    assert (*EXPORT_NAMES, PROGRAM, SKETCH, MCAP) == FORMATS_OUT
    assert set(SUFFIXES.values()) <= set(FORMATS_OUT)
    assert set(KINDS) == set(FORMATS_OUT)
