"""How gently the rate of the show clock changes, and how often joints are told of it meanwhile."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.line import encode_move
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from lss_motion.player.line import Line
    from lss_motion.player.track import Track
    from lss_motion.program.model import Program

RAMP_TICK_NS: Final = 40 * NS_PER_MS
"""At any rate but 1, every moving joint gets a move this often, if the line can carry it."""
RAMP_LINE_RATIO: Final = 0.5
"""Moves made on the spot take no more of the line than this."""
RAMP_LEAST_S: Final = 0.3
RAMP_ACCEL_RATIO: Final = 0.4
"""A change of rate takes no more than this share of any joint's acceleration. Chosen: a course at
its own limit leaves none, and is then left by 1 deg or 2 for the time of a ramp."""
RAMP_LOOK_S: Final = (0.0, 0.1, 0.2, 0.3, 0.4)
"""How far ahead the speeds of the course count for a ramp that begins now."""


def ramp_s(tracks: Collection[Track], program: Program, show_s: float, change: float) -> float:
    """Return over how long the rate may change by `change`, as gently as the limits ask."""
    over_s = RAMP_LEAST_S
    for track in tracks:
        spare_deg_s2 = RAMP_ACCEL_RATIO * track.limits.ramp_deg_s2
        for ahead_s in RAMP_LOOK_S:
            _, speed_deg_s = track.plan.at(program.within(show_s + ahead_s))
            over_s = max(over_s, abs(speed_deg_s) * change / spare_deg_s2)
    return over_s


def ramp_period_ns(tracks: Collection[Track], lines: Mapping[str, Line]) -> int:
    """Return how often every joint can be told where to go."""
    busiest_ns = max(
        sum(
            line.time_ns(len(encode_move(track.joint.servo_id, -18000, 1000)))
            for track in tracks
            if track.joint.bus == bus
        )
        for bus, line in lines.items()
    )
    return max(RAMP_TICK_NS, round(busiest_ns / RAMP_LINE_RATIO))
