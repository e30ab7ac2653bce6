"""Says what T a timed joint is told where it is not on its plan, so that it gets there.

T is for travelling at one speed: the ramps of the servo come on top of it. So what is left of a
move is judged by its way and its speed, and not by what is left of T.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from lss_motion.player.track import LONGEST_NS, REST_DEG_S, Owed
from lss_motion.units import ns_from_s, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.player.line import Line
    from lss_motion.player.show_clock import ShowClock
    from lss_motion.player.track import Track

JOIN_S: Final = 0.1
"""A joint that has missed a move catches up in about this time, if its limits allow. Chosen."""


def rejoin(
    track: Track, line: Line, clock: ShowClock, within: Callable[[float], float], now_ns: int
) -> None:
    """Send what the servo has missed of the move under way.

    A joint that is behind on its way travels faster until it meets the plan; from then on the rest
    of the move is owed. `within` turns a show time into one of the plan.
    """
    assert track.active is not None
    heard_ns = line.heard_ns(len(track.active.data), now_ns)
    planned_deg, planned_deg_s = track.plan.at(within(clock.show_s(heard_ns)))
    position_deg, own_deg_s = track.place(heard_ns)
    planned_way_deg = track.target_deg - planned_deg
    way_deg = track.target_deg + track.following.offset_deg - position_deg
    sense, ramp_deg_s2 = math.copysign(1.0, way_deg), track.limits.ramp_deg_s2
    travel_deg_s = _travel_deg_s(track, within(track.begun_s(line)))
    # Until both travel: what it falls behind while it speeds up, less what the plan does.
    slower_deg_s = max(0.0, travel_deg_s - sense * own_deg_s)
    planned_slower_deg_s = max(0.0, travel_deg_s - sense * planned_deg_s)
    behind_deg = abs(way_deg) - abs(planned_way_deg)
    behind_deg += 0.5 * (slower_deg_s**2 - planned_slower_deg_s**2) / ramp_deg_s2
    faster_deg_s = _faster_deg_s(track, travel_deg_s, behind_deg)
    left_s = track.left_s(line, clock, now_ns)
    is_on_its_way = way_deg * planned_way_deg > 0.0 and travel_deg_s > REST_DEG_S
    if not is_on_its_way or faster_deg_s <= 0.0:
        track.send_active(line, left_s, now_ns)
        return
    track.send_active(line, abs(way_deg) / (travel_deg_s + faster_deg_s), now_ns)
    # What it gains less while it speeds up it gains more while it slows down again.
    joins_s = slower_deg_s / ramp_deg_s2 + behind_deg / faster_deg_s
    if joins_s < left_s:
        track.owed = Owed(heard_ns + ns_from_s(joins_s), track.target_deg, travel_deg_s)


def _faster_deg_s(track: Track, travel_deg_s: float, behind_deg: float) -> float:
    """Return by how much faster than `travel_deg_s` a joint is to travel to close up."""
    if behind_deg <= track.joint.unit_deg:
        return 0.0
    return min(
        track.limits.speed_max_deg_s - travel_deg_s,
        behind_deg / JOIN_S,
        math.sqrt(behind_deg * track.limits.ramp_deg_s2),
    )


def _travel_deg_s(track: Track, begun_s: float) -> float:
    """Return how fast the move under way, begun at `begun_s`, is to travel between its ramps."""
    move = track.active
    assert move is not None
    assert move.duration_ms is not None
    planned_deg, _ = track.plan.at(begun_s)
    travel_deg_s = abs(track.target_deg - planned_deg) / s_from_ms(move.duration_ms)
    return min(travel_deg_s, track.limits.speed_max_deg_s)


def tell_owed(track: Track, line: Line, now_ns: int) -> None:
    """Send what a joint is owed: a timed one travels on as planned, but with no longer T."""
    assert track.owed is not None
    _, target_deg, travel_deg_s = track.owed
    way_deg = target_deg + track.following.offset_deg - track.place(now_ns)[0]
    left_s = min(abs(way_deg) / travel_deg_s, s_from_ns(LONGEST_NS))
    track.send(line, target_deg, left_s, now_ns)


def on_time_s(track: Track, line: Line, show_s: Callable[[int], float], now_ns: int) -> float:
    """Return how long the move under way, sent on time, is to travel; 0 if it has no T.

    That is its T, unless it turns the joint back. Its target may be near then, and T short: what
    the profile is off the plan would change the travel speed by many times. So the speed of the
    plan is kept instead of its end. `show_s` turns an instant into one of the plan.
    """
    move = track.active
    assert move is not None
    if move.duration_ms is None:
        return 0.0
    heard_ns = line.heard_ns(len(move.data), now_ns)
    planned_deg, speed_deg_s = track.plan.at(show_s(heard_ns))
    planned_way_deg = track.target_deg - planned_deg
    way_deg = track.target_deg + track.following.offset_deg - track.place(heard_ns)[0]
    planned_s = s_from_ms(move.duration_ms)
    if speed_deg_s * planned_way_deg >= 0.0 or way_deg * planned_way_deg <= 0.0:
        return planned_s
    return planned_s * way_deg / planned_way_deg
