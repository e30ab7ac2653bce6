"""Bytes that waited in a clogged line while their servo restarted and lost its limits.

The player that wrote them could not know of the restart, and no byte can be taken back. Bytes
written after the servo was back are judged: by then the player has found that it does not answer.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from lss_motion.sim.faults import RESTARTING, Fault, FaultKind
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    Lines = Sequence[tuple[int, bytes]]
    """Each with its instant."""

WAITING: Final = {FaultKind.CLOGGED, FaultKind.BLOCKED_PORT}
LIMITS: Final = re.compile(rb"#(\d+)AD\d+\r")
"""With AA and AD, which come one after the other, a servo has its limits again: from its next move
on, for the one that is under way ends with the ramps with which it began."""


def lawless_ns(
    servo_id: int, faults: Iterable[Fault], writes: Lines, received: Lines
) -> list[tuple[int, int]]:
    """Return from when until when a servo may follow such lines, as written and received."""
    own = [fault for fault in faults if fault.servo_id in (None, servo_id)]
    clogs = [fault for fault in own if fault.kind in WAITING]
    resets = [fault for fault in own if fault.kind in RESTARTING] if clogs else []
    written = list(_lines_of(writes)) if resets else []
    spans_ns = []
    for reset in resets:
        back_ns = ns_from_s(reset.at_s + reset.deaf_s)
        for received_ns, line in received:
            if received_ns < back_ns or not line.startswith(b"#%dD" % servo_id):
                continue
            written_ns = max((ns for ns, words in written if words == line and ns <= received_ns),
                             default=received_ns)  # fmt: skip
            if written_ns < back_ns and _is_within(clogs, written_ns, received_ns):
                spans_ns.append((received_ns, _limited_ns(servo_id, received, received_ns)))
    return spans_ns


def _lines_of(writes: Lines) -> Iterator[tuple[int, bytes]]:
    """Yield every line of what was written, with its instant."""
    for instant_ns, data in writes:
        for line in data.splitlines(keepends=True):
            yield instant_ns, line


def _is_within(clogs: Iterable[Fault], from_ns: int, until_ns: int) -> bool:
    """Return whether a line was clogged in that time."""
    return any(
        ns_from_s(clog.at_s) < until_ns and from_ns < ns_from_s(clog.until_s) for clog in clogs
    )


def _limited_ns(servo_id: int, received: Lines, from_ns: int) -> int:
    """Return when a servo begins its next move within limits, or when its lines end."""
    has_limits = False
    for received_ns, line in received:
        if received_ns > from_ns:
            said = LIMITS.fullmatch(line)
            has_limits |= said is not None and int(said[1]) == servo_id
            if has_limits and line.startswith(b"#%dD" % servo_id):
                return received_ns
    return received[-1][0]
