"""Scripts of the NUbots, and errors."""

from __future__ import annotations

import pytest

from lss_motion.interchange.nubots import NUBOTS
from lss_motion.interchange.reader import Measure

SCRIPT = """\
- targets:
    - id: HEAD_PITCH
      position: 0
      gain: 30
      torque: 100
    - id: HEAD_YAW
      position: -0.5
  duration: 190
- duration: 90
  targets:
    - gain: 30
      position: 0.5
      id: HEAD_YAW
"""


@pytest.mark.parametrize("text", [SCRIPT, "frames:\n" + SCRIPT])
def test_a_frame_is_reached_its_duration_after_the_one_before(read_one, text: str) -> None:
    motion = read_one(NUBOTS, text)
    pitch, yaw = motion.channels
    assert (pitch.name, pitch.unit) == ("HEAD_PITCH", Measure.RAD)
    assert (yaw.times_s.tolist(), yaw.values.tolist()) == ([0.19, 0.28], [-0.5, 0.5])
    assert "Not carried over: gain of the targets" in motion.comments


@pytest.mark.parametrize(
    ("old", "new", "line", "reason"),
    [
        ("duration: 90", "duration: 0", 9, "a duration must be more than 0 ms"),
        ("duration: 90", "time: 90", 9, "frame 2 needs a 'duration' and 'targets'"),
        ("position: 0.5", "place: 0.5", 11, "a target needs an 'id' and a 'position'"),
        ("position: 0.5", "position: x", 12, "'x' is not a number"),
        ("HEAD_PITCH", "HEAD_YAW", 6, "frame 1 has 'HEAD_YAW' twice"),
        ("gain: 30\n      position", "gain: [30\n      position", 12, "not YAML"),
    ],
)
def test_a_wrong_script_is_refused_with_its_line(refusal, old, new, line, reason) -> None:
    error = refusal(NUBOTS, SCRIPT.replace(old, new))
    assert (error.line, reason in error.reason) == (line, True), error
