"""Places commands on one serial line so that no two overlap, and checks the result independently.

Queries share the line: `reading_rate_hz` computes how often servos can be polled between the
commands of a program. A query leaves only if the line is free again before the next command is due,
so what counts are the whole queries that fit into each gap. Replies come on a line of their own,
one after the other.

Decision: every command is a line of its own, also where the firmware accepts group lines (370 and
later: `#1D0T100#2D0T100` and one CR). A group saves one byte for every command that has no gap
before it. On a lively show that is 0.5 to 1.5 % of what 18 joints send at 115200 bps and at most
2.5 % of what 32 send: less than half a percent of the line, since most commands stand alone at the
instants of their joints. In return the schedule would depend on when a servo takes up its part of a
group: at the next `#`, or with all others at the CR, which is later by the whole group. The
documents do not mention groups; real buses use them for queries (FACTS.md W17), but no result for
moves is known (W20). A wrong assumption costs the horn more than the bytes are worth, and a group
that lost one byte or its CR can lose more than one command.
"""

from __future__ import annotations

import math
from array import array
from bisect import bisect_left, bisect_right
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.planning.program.reference_grid import DURATION_MAX_MS
from lss_motion.protocol.framing import Command, Reply, encode, encode_move
from lss_motion.robot.servo_models import needs_filter
from lss_motion.units import NS_PER_US, US_PER_S, line_time_ns, us_from_s

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.planning.program.response import IntArray
    from lss_motion.robot.model import Bus, Joint, Robot

WORST_WINDOW_US = 100_000
"""Utilisation is also reported for the busiest 100 ms (FACTS.md A21)."""
LONG_AGO_US: Final = -(2**62)
"""Begin and end of a slot before all others, so that there always is a slot before."""

QUERY_BYTES: Final = 10
"""Room that is kept for a query between the targets of streamed joints."""
WINDOW_US: Final = US_PER_S
"""Readings are counted over a second: a joint without a reply for so long is silent."""
TURNAROUND_US: Final = 1_800
"""From the end of a query to the start of its reply. Assumed: the most that the slowest firmware
takes (FACTS.md W13, W14; not measured), with one query in flight."""


class LineSchedule:
    """The transmit side of one bus: reserved slots, disjoint, in microseconds of show time.

    Starts and ends lie in order in flat arrays. Single slots are mostly reserved in the order of
    time, at the end of these; many at once are searched side by side.
    """

    def __init__(self) -> None:
        self._starts_us = array("q", (LONG_AGO_US,))
        self._ends_us = array("q", (LONG_AGO_US,))

    def copy(self) -> LineSchedule:
        """Return an independent schedule with the same slots."""
        made = LineSchedule()
        made._starts_us, made._ends_us = self._starts_us[:], self._ends_us[:]
        return made

    def reserve(self, latest_end_us: int, size_us: int, earliest_us: int) -> int:
        """Reserve the latest free slot that ends by `latest_end_us`; return where it ends.

        If nothing is free after `earliest_us`, reserve the first free slot beyond `latest_end_us`;
        the caller sees from the returned end that it is late.
        """
        starts_us, ends_us = self._starts_us, self._ends_us
        end_us, start_us = latest_end_us, latest_end_us - size_us
        at = bisect_left(starts_us, end_us)
        while ends_us[at - 1] > start_us:
            at -= 1
            end_us = starts_us[at]
            start_us = end_us - size_us
        if start_us < earliest_us:
            start_us = max(earliest_us, latest_end_us - size_us)
            at = bisect_right(ends_us, start_us)
            while at < len(starts_us) and starts_us[at] < start_us + size_us:
                start_us = ends_us[at]
                at += 1
        starts_us.insert(at, start_us)
        ends_us.insert(at, start_us + size_us)
        return start_us + size_us

    def reserve_all(
        self, latest_end_us: IntArray, size_us: IntArray, earliest_us: IntArray
    ) -> IntArray:
        """Reserve one slot for each element, as `reserve` does, and return the ends.

        Where two requests overlap, the later one keeps its place and the other one goes before it.
        A request that would then start before its `earliest_us` is served before all others.
        """
        reserved_us = np.empty_like(latest_end_us)
        waiting = np.argsort(latest_end_us, kind="stable")
        while len(waiting):
            size, earliest = size_us[waiting], earliest_us[waiting]
            ends_us = self._latest_free_ends(latest_end_us[waiting], size)
            is_early = ends_us - size < earliest
            if not is_early.any():
                reserved_us[waiting] = ends_us
                self._keep(ends_us - size, ends_us)
                break
            for row in waiting[is_early].tolist():
                request = latest_end_us[row], size_us[row], earliest_us[row]
                reserved_us[row] = self.reserve(*map(int, request))
            waiting = waiting[~is_early]
        return reserved_us

    def _latest_free_ends(self, latest_end_us: IntArray, size_us: IntArray) -> IntArray:
        """Return the ends of slots that overlap neither each other nor a reserved slot.

        The requests are in order of time, and so are the slots.
        """
        starts_us, ends_us = (
            np.frombuffer(own, dtype=np.int64) for own in (self._starts_us, self._ends_us)
        )
        sent_us = np.cumsum(size_us)
        end_us, moved = _apart(latest_end_us, sent_us), np.arange(len(sent_us))
        while True:
            before = np.searchsorted(starts_us, end_us[moved]) - 1
            is_blocked = ends_us[before] > end_us[moved] - size_us[moved]
            if not is_blocked.any():
                return end_us
            freed_us = end_us.copy()
            freed_us[moved[is_blocked]] = starts_us[before[is_blocked]]
            freed_us = _apart(freed_us, sent_us)
            moved, end_us = np.flatnonzero(freed_us != end_us), freed_us

    def _keep(self, starts_us: IntArray, ends_us: IntArray) -> None:
        """Reserve slots that are free."""
        for own, new_us in ((self._starts_us, starts_us), (self._ends_us, ends_us)):
            own.frombytes(new_us.tobytes())
            np.frombuffer(own, dtype=np.int64).sort(kind="stable")


def _apart(latest_end_us: IntArray, sent_us: IntArray) -> IntArray:
    """Return the ends of slots so that each ends before the next one starts.

    The requests are in order; `sent_us` is the line time of all slots up to each.
    """
    free_us = np.minimum.accumulate((latest_end_us - sent_us)[::-1])[::-1]
    ends_us: IntArray = free_us + sent_us
    return ends_us


class LineUse(Struct, frozen=True, kw_only=True):
    """How a program uses one bus: the result of the check of its finished schedule."""

    bus: str
    baud_bps: int
    commands: int
    utilisation_ratio: float
    """Share of the time from the first to the last byte in which the line sends commands."""
    worst_100_ms_ratio: float
    overlaps: int
    """Commands that are due before their predecessor has left. A correct schedule has none."""
    late_max_us: int
    """The longest time that a command waits for the line."""
    reading_rate_hz: float = math.inf
    """How often each joint can be polled for its position in the worst second."""


def line_use(bus: str, baud_bps: int, slots_us: Sequence[tuple[int, int]] | IntArray) -> LineUse:
    """Return the use of a line on which each `(due, size)` in microseconds is sent in order.

    Independent of how the slots were found: it replays them on a queue.
    """
    slots = np.asarray(slots_us, dtype=np.intp).reshape(-1, 2)
    due_us, size_us = slots[np.lexsort((slots[:, 1], slots[:, 0]))].T
    sent_us = np.cumsum(size_us)
    before_us = sent_us - size_us
    leaves_us = np.maximum.accumulate(due_us - before_us) + before_us
    late_us = leaves_us - due_us
    first = np.searchsorted(due_us, due_us - WORST_WINDOW_US, side="right")
    in_window_us = sent_us - before_us[first]
    length_us = WORST_WINDOW_US
    if len(slots):
        length_us = max(int(leaves_us[-1] + size_us[-1] - due_us[0]), WORST_WINDOW_US)
    return LineUse(
        bus=bus,
        baud_bps=baud_bps,
        commands=len(slots),
        utilisation_ratio=float(size_us.sum()) / length_us,
        worst_100_ms_ratio=min(1.0, float(in_window_us.max(initial=0)) / WORST_WINDOW_US),
        overlaps=int(np.count_nonzero(late_us)),
        late_max_us=int(late_us.max(initial=0)),
    )


def reading_rate_hz(joints: Sequence[Joint], baud_bps: int, slots_us: IntArray) -> float:
    """Return how often each of `joints` can be read in the worst second of a line, all in turn.

    `slots_us`: `(due, size)` of every command, in order and disjoint. Infinite without joints.
    """
    if not joints:
        return float("inf")
    queries_us, replies_us = zip(*(_exchange_us(joint, baud_bps) for joint in joints), strict=True)
    answered = WINDOW_US / (TURNAROUND_US + sum(replies_us) / len(joints))
    return float(min(answered, _queries_in_worst_second(max(queries_us), slots_us)) / len(joints))


def _queries_in_worst_second(query_us: int, slots_us: IntArray) -> float:
    """Return how many queries fit between the commands of the worst second."""
    if not len(slots_us):
        return WINDOW_US / query_us
    due_us, size_us = slots_us.T
    opens_us = np.concatenate(([due_us[0] - 2 * WINDOW_US], due_us + size_us))
    ends_us = np.append(due_us, opens_us[-1] + 2 * WINDOW_US)
    fit = np.maximum(ends_us - opens_us, 0) // query_us
    full_us, total = opens_us + fit * query_us, np.cumsum(fit)
    # The number of queries sent so far rises through each gap and is constant elsewhere.
    instants_us = np.stack((opens_us, full_us), axis=1).ravel()
    left = np.stack((total - fit, total), axis=1).ravel().astype(np.float64)
    # The number within a window has its minima where the number at the window's end begins to
    # rise, or the number at its begin stops rising.
    edges_us = np.concatenate((opens_us, full_us + WINDOW_US, opens_us[:1] + WINDOW_US))
    edges_us = edges_us[(edges_us - WINDOW_US >= opens_us[0]) & (edges_us <= ends_us[-1])]
    within = np.interp(edges_us, instants_us, left)
    within -= np.interp(edges_us - WINDOW_US, instants_us, left)
    return float(within.min())


def _exchange_us(joint: Joint, baud_bps: int) -> tuple[int, int]:
    """Return the line times of a position query to a joint, and of its longest reply."""
    ends_deg = map(joint.servo_deg, (joint.position_min_deg, joint.position_max_deg))
    wires = [round(end_deg * joint.model.wire_per_deg) for end_deg in ends_deg]
    replies = [encode(Reply(joint.servo_id, "QD", wire)) for wire in wires]
    query = encode(Command(joint.servo_id, "QD"))
    return sent_us(len(query), baud_bps), sent_us(max(map(len, replies)), baud_bps)


def longest_move(joint: Joint) -> bytes:
    """Return the longest command that the joint can be sent."""
    duration_ms = DURATION_MAX_MS if joint.drive == "timed" else None
    return max(
        (
            encode_move(joint.servo_id, round(e * joint.model.wire_per_deg), duration_ms)
            for e in joint.servo_range_deg
        ),
        key=len,
    )


def with_phases(robot: Robot) -> Robot:
    """Return `robot` with the assumed steps of its filters apart, bus by bus.

    When the filter of a servo steps is unknown. Commands aim at the instants assumed, and a filter
    needs them at even distances. So no two joints of a bus need the line at the same time,
    and on a slow one they follow each other and leave room for a query or a move of another joint.
    """
    joints = dict(robot.joints)
    for bus in robot.buses.values():
        on_bus = [joint for joint in joints.values() if joint.bus == bus.name]
        own = [joint for joint in on_bus if _has_filter(joint)]
        if not own:
            continue
        period_us = min(us_from_s(joint.response.filter_s) for joint in own)
        slot_us = max(_slot_us(joint, bus) for joint in own)
        others_us = [_slot_us(joint, bus) for joint in on_bus if joint not in own]
        gap_us = max(sent_us(QUERY_BYTES, bus.baud_bps), *others_us, 0)
        left_us = period_us - slot_us - gap_us
        apart_us = max(slot_us, left_us / max(len(own) - 1, 1))
        apart_us = min(apart_us, period_us / len(own))
        for rank, joint in enumerate(own):
            phase_ratio = rank * apart_us / period_us
            joints[joint.name] = replace(joint, filter_phase_ratio=phase_ratio)
    return replace(robot, joints=joints)


def _slot_us(joint: Joint, bus: Bus) -> int:
    return sent_us(len(longest_move(joint)), bus.baud_bps)


def _has_filter(joint: Joint) -> bool:
    return joint.drive == "streamed" or (joint.drive == "auto" and needs_filter(joint))


def sent_us(size_bytes: int, baud_bps: int) -> int:
    """Return the line time of so many bytes in whole microseconds, rounded up."""
    return -(-line_time_ns(size_bytes, baud_bps) // NS_PER_US)
