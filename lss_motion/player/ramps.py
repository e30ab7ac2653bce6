"""How gently the rate of the show clock changes, and what joints are told meanwhile."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.program.wording import LATEST_ARRIVAL_S
from lss_motion.protocol.line import encode_move
from lss_motion.units import NS_PER_MS, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping

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


class SpotMove(NamedTuple):
    """A move for one joint, made on the spot: servo degrees, and the run time that it has."""

    track: Track
    aim_deg: float
    left_s: float


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


def spot_moves(
    tracks: Iterable[Track],
    lines: Mapping[str, Line],
    *,
    now_ns: int,
    period_ns: int,
    planned_deg: Callable[[Track, int], float],
    ends_ns: int | None,
) -> Iterator[SpotMove]:
    """Yield a move for every joint that is off its course, to be on it in one period.

    `ends_ns` is when the course comes to rest, if it does: moves from there on reach no further.
    Each is to be sent before the next one is asked for, since it keeps the line busy.
    """
    for track in tracks:
        heard_ns = lines[track.joint.bus].heard_ns(0, now_ns)
        ahead_ns = heard_ns + ns_from_s(track.ahead_s(s_from_ns(period_ns)) + track.lead_s)
        aim_deg = planned_deg(track, ahead_ns)
        position_deg, speed_deg_s = track.place(heard_ns)
        way_deg = aim_deg + track.following.offset_deg - position_deg
        unit_deg = 1.0 / track.limits.wire_per_deg
        if abs(way_deg) < unit_deg and abs(speed_deg_s) < 1.0:
            continue
        travel_deg_s = min(abs(way_deg) / s_from_ns(period_ns), track.limits.speed_max_deg_s)
        is_last = ends_ns is not None and ahead_ns >= ends_ns
        if track.joint.drive != "timed":
            if not is_last:
                aim_deg = track.chased(aim_deg, heard_ns, s_from_ns(period_ns))
            yield SpotMove(track, aim_deg, 0.0)
            continue
        if not is_last:
            beyond_deg = travel_deg_s * LATEST_ARRIVAL_S
            beyond_deg += 0.5 * travel_deg_s * travel_deg_s / track.limits.ramp_deg_s2
            aim_deg += math.copysign(beyond_deg, way_deg)
            way_deg += math.copysign(beyond_deg, way_deg)
        yield SpotMove(track, aim_deg, abs(way_deg) / max(travel_deg_s, 1.0))
