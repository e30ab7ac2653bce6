"""Moves of joints that are off their plan: they join it again within their limits.

For timed joints, T is the time at travel speed, and the ramps of the servo come on top of it. So
`rejoin`, `send_deferred` and `on_time_s` compute the T of a joint that is off its plan from its way
and its speed, not from what is left of T.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from lss_motion.playing.player.joint_state import LONGEST_NS, REST_DEG_S, JointState
from lss_motion.units import ns_from_s, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.playing.player.serial_line import SerialLine
    from lss_motion.playing.player.show_clock import ShowClock

JOIN_S: Final = 0.1
"""Time in which a joint that has lost a move catches up, if its limits allow it. Chosen."""


def rejoin(
    state: JointState,
    line: SerialLine,
    clock: ShowClock,
    within: Callable[[float], float],
    now_ns: int,
) -> None:
    """Send the rest of the move under way to a servo that has lost it.

    A joint that is behind travels faster until it meets the plan; from there the rest of the move
    is deferred. `within` turns a show time into one of the plan.
    """
    assert state.active is not None
    arrival_ns = line.arrival_ns(len(state.active.data), now_ns)
    planned_deg, planned_deg_s = state.plan.at(within(clock.show_s(arrival_ns)))
    position_deg, own_deg_s = state.place(arrival_ns)
    planned_way_deg = state.target_deg - planned_deg
    way_deg = state.target_deg + state.disturbance.offset_deg - position_deg
    sense, ramp_deg_s2 = math.copysign(1.0, way_deg), state.limits.ramp_deg_s2
    travel_deg_s = _travel_deg_s(state, within(state.begun_s(line)))
    # Distance that it loses while it speeds up, less the distance that the plan loses.
    slower_deg_s = max(0.0, travel_deg_s - sense * own_deg_s)
    planned_slower_deg_s = max(0.0, travel_deg_s - sense * planned_deg_s)
    behind_deg = abs(way_deg) - abs(planned_way_deg)
    behind_deg += 0.5 * (slower_deg_s**2 - planned_slower_deg_s**2) / ramp_deg_s2
    faster_deg_s = _faster_deg_s(state, travel_deg_s, behind_deg)
    left_s = state.left_s(line, clock, now_ns)
    is_on_its_way = way_deg * planned_way_deg > 0.0 and travel_deg_s > REST_DEG_S
    if not is_on_its_way or faster_deg_s <= 0.0:
        state.send_active(line, left_s, now_ns)
        return
    state.send_active(line, abs(way_deg) / (travel_deg_s + faster_deg_s), now_ns)
    # The distance lost while it speeds up comes back while it slows down.
    joins_s = slower_deg_s / ramp_deg_s2 + behind_deg / faster_deg_s
    if joins_s < left_s:
        state.defer(arrival_ns + ns_from_s(joins_s), state.target_deg, travel_deg_s)


def _faster_deg_s(state: JointState, travel_deg_s: float, behind_deg: float) -> float:
    """Return by how much faster than `travel_deg_s` a joint travels to catch up."""
    if behind_deg <= state.joint.unit_deg:
        return 0.0
    return min(
        state.limits.speed_max_deg_s - travel_deg_s,
        behind_deg / JOIN_S,
        math.sqrt(behind_deg * state.limits.ramp_deg_s2),
    )


def _travel_deg_s(state: JointState, begun_s: float) -> float:
    """Return the travel speed between the ramps of the move that began at `begun_s`."""
    move = state.active
    assert move is not None
    assert move.duration_ms is not None
    planned_deg, _ = state.plan.at(begun_s)
    travel_deg_s = abs(state.target_deg - planned_deg) / s_from_ms(move.duration_ms)
    return min(travel_deg_s, state.limits.speed_max_deg_s)


def send_deferred(state: JointState, line: SerialLine, now_ns: int) -> None:
    """Send the deferred target: a timed joint travels on as planned, within the longest T."""
    assert state.deferred is not None
    _, target_deg, travel_deg_s = state.deferred
    way_deg = target_deg + state.disturbance.offset_deg - state.place(now_ns)[0]
    left_s = min(abs(way_deg) / travel_deg_s, s_from_ns(LONGEST_NS))
    state.send(line, target_deg, left_s, now_ns)


def on_time_s(
    state: JointState, line: SerialLine, show_s: Callable[[int], float], now_ns: int
) -> float:
    """Return the time that the move under way has to travel if sent on time; 0 if it has no T.

    That is its T, unless the move reverses the joint. Then its target may be near and T short, and
    a small distance of the profile from the plan would change the travel speed many times over. So
    the speed of the plan is kept instead of its end; also where only the profile reverses, since it
    is ahead of the plan and too fast to stop at the target. `show_s` turns an instant into one of
    the plan.
    """
    move = state.active
    assert move is not None
    if move.duration_ms is None:
        return 0.0
    arrival_ns, target_deg = line.arrival_ns(len(move.data), now_ns), state.target_deg
    planned_deg, speed_deg_s = state.plan.at(show_s(arrival_ns))
    planned_way_deg = target_deg - planned_deg
    position_deg, own_deg_s = state.place(arrival_ns)
    way_deg = target_deg + state.disturbance.offset_deg - position_deg
    planned_s = s_from_ms(move.duration_ms)
    if not planned_way_deg:
        return planned_s
    kept_s = planned_s * abs(way_deg / planned_way_deg)
    if speed_deg_s * planned_way_deg < 0.0 < way_deg * planned_way_deg:
        return kept_s
    stop_deg = 0.5 * own_deg_s * abs(own_deg_s) / state.limits.ramp_deg_s2
    return min(planned_s, kept_s) if (way_deg - stop_deg) * own_deg_s < 0.0 else planned_s
