from __future__ import annotations

import numpy as np
import pytest

from lss_motion.planning.program.cones import Starts, open_cones
from lss_motion.planning.program.reference_grid import GRID_S, Reference, References, servo_limits
from lss_motion.planning.program.response import States
from tests.joints import joint

LIMITS = servo_limits(joint(), 0.2)


@pytest.mark.parametrize("block", [20, 50])
def test_cones_computed_in_blocks_equal_those_computed_at_once(block):
    random = np.random.default_rng(4)
    times_s = GRID_S * np.arange(1200)
    # Slow enough that some cones are open for long, each in another block.
    rows = [9.0 * np.sin(rate * times_s) for rate in (0.05, 0.3, 0.8, 2.0, 5.0)]
    references = References(
        [Reference(start_s=0.0, position_deg=row) for row in rows], [LIMITS] * 5
    )
    joint = np.repeat(np.arange(5), 40)
    state_s = random.uniform(0.1, 4.0, len(joint))
    first = references.first_index(state_s)
    at = references.at(joint, first)
    off_deg = random.uniform(-0.1, 0.1, len(joint))
    state = States(state_s, at.position_deg + off_deg, at.speed_deg_s.astype(np.float64))
    starts = Starts.of(references, joint, first, state)
    whole, parts = (open_cones(references, starts, 100, 3, size) for size in (100, block))
    assert len(np.unique(whole.held // block)) >= 2
    assert parts.held.tolist() == whole.held.tolist()
    for servo, held in enumerate(whole.held.tolist()):
        expected = whole.sides_deg_s[:held, :, servo]
        assert parts.sides_deg_s[:held, :, servo] == pytest.approx(expected, abs=1e-3)
