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
LED_NS: Final = 20 * NS_PER_MS
"""A streamed joint that is led gets one for every step of its filter (FACTS.md M6): over two
steps with one target the filter is quick in the first and slow in the second."""
RAMP_LINE_RATIO: Final = 0.5
"""Moves made on the spot take no more of the line than this; where there are streamed joints, half
of it is theirs."""
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


class RampPeriods(NamedTuple):
    """How often joints can be told where to go: those that are led, and all others."""

    led_ns: int
    tick_ns: int


def ramp_periods(tracks: Collection[Track], lines: Mapping[str, Line]) -> RampPeriods:
    """Return how often every joint can be told where to go."""
    streamed = [track for track in tracks if track.joint.drive == "streamed"]
    others = [track for track in tracks if track.joint.drive != "streamed"]
    share = 0.5 if streamed and others else 1.0
    return RampPeriods(
        led_ns=max(LED_NS, round(_busiest_ns(streamed, lines) / share)),
        tick_ns=max(RAMP_TICK_NS, round(_busiest_ns(others, lines) / share)),
    )


def _busiest_ns(tracks: Collection[Track], lines: Mapping[str, Line]) -> float:
    """Return over how long one move for each of `tracks` may be spread on the busiest line."""
    busiest_ns = max(
        sum(
            line.time_ns(len(encode_move(track.joint.servo_id, -18000, _duration_ms(track))))
            for track in tracks
            if track.joint.bus == bus
        )
        for bus, line in lines.items()
    )
    return busiest_ns / RAMP_LINE_RATIO


def _duration_ms(track: Track) -> int | None:
    return 1000 if track.joint.drive == "timed" else None


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
    Each is to be sent before the next one is asked for, since it keeps the line busy. Streamed
    joints are led (`leading.lead`).
    """
    for track in tracks:
        if track.joint.drive == "streamed":
            continue
        is_stepped = track.joint.drive == "stepped"
        heard_ns = lines[track.joint.bus].heard_ns(0, now_ns)
        # A jump is right in the middle of the time for which it holds.
        ahead_ns = heard_ns + (period_ns // 2 if is_stepped else period_ns)
        ahead_ns += ns_from_s(track.lead_s)
        aim_deg = planned_deg(track, ahead_ns)
        position_deg, speed_deg_s = track.place(heard_ns)
        way_deg = aim_deg + track.following.offset_deg - position_deg
        unit_deg = 1.0 / track.limits.wire_per_deg
        if abs(way_deg) < unit_deg and abs(speed_deg_s) < 1.0:
            continue
        if is_stepped:
            yield SpotMove(track, aim_deg, 0.0)
            continue
        travel_deg_s = min(abs(way_deg) / s_from_ns(period_ns), track.limits.speed_max_deg_s)
        if ends_ns is None or ahead_ns < ends_ns:
            beyond_deg = travel_deg_s * LATEST_ARRIVAL_S
            beyond_deg += 0.5 * travel_deg_s * travel_deg_s / track.limits.ramp_deg_s2
            aim_deg += math.copysign(beyond_deg, way_deg)
            way_deg += math.copysign(beyond_deg, way_deg)
        yield SpotMove(track, aim_deg, abs(way_deg) / max(travel_deg_s, 1.0))
