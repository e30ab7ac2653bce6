"""Legs and robots of the examples, and gaits for them."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from lss_motion.robot.load import load_robot
from lss_motion.show.gait.load import load_gait
from lss_motion.show.gait.model import PATTERNS, BodyPose, Walk

EXAMPLES = Path(__file__).resolve().parents[3] / "sequences"


class GaitKit:
    """Helpers of the tests, as a fixture: `conftest` modules cannot be imported by name."""

    examples = EXAMPLES

    @staticmethod
    def walk(forward_mm_s=0.0, left_mm_s=0.0, turn_deg_s=0.0, cycles=3, **fields):
        return Walk(
            forward_mm_s=forward_mm_s,
            left_mm_s=left_mm_s,
            turn_deg_s=turn_deg_s,
            cycles=cycles,
            **fields,
        )

    @staticmethod
    def gait(pattern="tripod", *actions, **fields):
        """A gait of the example robot that has this pattern, standing at first."""
        legs = 6 if pattern in PATTERNS[6] else 4
        name = {6: "hexapod_walk", 4: "quadruped_trot"}[legs]
        own = PATTERNS[legs][pattern]
        changes = {
            "pattern": own,
            "duty": own.duty_ratio,
            "start": BodyPose(),
            "sway_mm": 22.0 if own.sway_ratio else 0.0,
            "cycle_s": 1.5,
            "actions": actions or (GaitKit.walk(30.0),),
            **fields,
        }
        return replace(load_gait(EXAMPLES / f"{name}.yaml"), **changes)

    @staticmethod
    def robot(gait):
        return load_robot(gait.robot_path)


@pytest.fixture
def kit():
    return GaitKit
