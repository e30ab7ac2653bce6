"""How often the servos of a line can be asked where they are, between the commands of a program.

A query leaves only if the line is free again before the next command is due, so what counts are the
whole queries that fit into each gap. Answers come on a line of their own, one after the other.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.program.attempt import sent_us
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.units import US_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.program.batch import IntArray
    from lss_motion.robot.model import Joint

WINDOW_US: Final = US_PER_S
"""Readings are counted over a second: a joint that nobody heard of for so long is silent."""
TURNAROUND_US: Final = 1_800
"""From the end of a query to the start of its answer. Assumed: what the slowest firmware takes at
the most (FACTS.md W13, W14; not measured), with no two questions in flight."""


def reading_rate_hz(joints: Sequence[Joint], baud_bps: int, slots_us: IntArray) -> float:
    """Return how often each of `joints` can be read in the worst second of a line, all in turn.

    `slots_us`: `(due, size)` of every command, in order and disjoint. Infinite without joints.
    """
    if not joints:
        return float("inf")
    queries_us, replies_us = zip(*(_exchange_us(joint, baud_bps) for joint in joints), strict=True)
    answered = WINDOW_US / (TURNAROUND_US + sum(replies_us) / len(joints))
    return float(min(answered, _asked(max(queries_us), slots_us)) / len(joints))


def _asked(query_us: int, slots_us: IntArray) -> float:
    """Return how many queries fit between the commands of the worst second."""
    if not len(slots_us):
        return WINDOW_US / query_us
    due_us, size_us = slots_us.T
    opens_us = np.concatenate(([due_us[0] - 2 * WINDOW_US], due_us + size_us))
    ends_us = np.append(due_us, opens_us[-1] + 2 * WINDOW_US)
    fit = np.maximum(ends_us - opens_us, 0) // query_us
    full_us, total = opens_us + fit * query_us, np.cumsum(fit)
    # Queries that have left, as a line that climbs through each gap and is level elsewhere.
    instants_us = np.stack((opens_us, full_us), axis=1).ravel()
    left = np.stack((total - fit, total), axis=1).ravel().astype(np.float64)
    # Their number within a window stops falling where its end begins to climb, or its begin stops.
    edges_us = np.concatenate((opens_us, full_us + WINDOW_US, opens_us[:1] + WINDOW_US))
    edges_us = edges_us[(edges_us - WINDOW_US >= opens_us[0]) & (edges_us <= ends_us[-1])]
    within = np.interp(edges_us, instants_us, left)
    within -= np.interp(edges_us - WINDOW_US, instants_us, left)
    return float(within.min())


def _exchange_us(joint: Joint, baud_bps: int) -> tuple[int, int]:
    """Return the line time of asking a joint where it is, and of its longest answer."""
    ends_deg = map(joint.servo_deg, (joint.position_min_deg, joint.position_max_deg))
    wires = [round(end_deg * joint.model.wire_per_deg) for end_deg in ends_deg]
    replies = [encode(Reply(joint.servo_id, "QD", wire)) for wire in wires]
    query = encode(Command(joint.servo_id, "QD"))
    return sent_us(len(query), baud_bps), sent_us(max(map(len, replies)), baud_bps)
