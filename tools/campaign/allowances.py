"""What the judge of the campaign allows: how exact it can be, and what which fault excuses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.sim.faults import RESTARTING, FaultKind
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from lss_motion.robot.model import Joint
    from lss_motion.sim.faults import Fault

STEP_NS: Final = 5_000_000
WINDOW: Final = 4
"""Speeds are differences over 20 ms: a servo's own loop is 5 ms, that of its filter 20 ms."""
SPEED_EXCESS: Final = 1.05
ACCEL_EXCESS: Final = 1.1
"""As in the tests of the player: what the simulator's loop of 5 ms adds."""
LAGS: Final = 3.0
"""After so many of its lags a horn does what its servo has told it, to a twentieth."""
RANGE_EXCESS_DEG: Final = 0.3
STOOD_NS: Final = NS_PER_S
"""A horn that something else has put outside of its range is led back from where it stood when it
was asked. That was within the last second: an approach begins half a second after its readings."""
RESTS_WITHIN_DEG: Final = 4.0
"""A finished show without a fault has its horns this near to its last pose: `following_deg` is 10
while it moves, and at its end a joint must have arrived (3 deg), besides noise."""
TELLING_S: Final = 1.5
"""A fault that begins later than this before the end of the run need not have been noticed."""
READ_BACK_S: Final = 0.5
NOTICE_S: Final = 1.5
"""Times after a restarted servo answers again, and after its restart; the later one counts. It has
the ramps that it has stored; the host cannot know of it at once. Its speed is judged all the same:
a move may bring its own."""
UNNOTICED_RATIO: Final = 1.5
UNNOTICED_S: Final = 1.0
"""A restart of some 20 ms that no query meets is found by the next read-back (0.3 s, on a full line
0.5 s). Until then the servo has its stored limits, and moves that were computed for a servo in full
motion: a joint that stands still goes faster. The last one ends half a second later."""

WORD_KINDS: Final = {
    FaultKind.CORRUPT_COMMAND,
    FaultKind.SHORT_COMMAND,
    FaultKind.MERGED_COMMAND,
}
"""With these a servo receives bytes that were not sent: the player cannot control its horn."""
MISSED_KINDS: Final = {
    FaultKind.LOST_COMMAND,
    FaultKind.CLOGGED,
    FaultKind.BLOCKED_PORT,
    FaultKind.UNPLUGGED,
    FaultKind.DEAF,
    *RESTARTING,
}
"""With these a servo loses lines, and receives the next: a timed one keeps its limits
all the same, for they are set in it; one in EM0 has none."""
GONE_KINDS: Final = {FaultKind.UNPLUGGED, FaultKind.BLOCKED_PORT}
"""With these no byte reaches the servos."""
BODY_KINDS: Final = {FaultKind.STUCK, FaultKind.WEAK, FaultKind.HOT, FaultKind.LOW_VOLTAGE}
"""With these a horn does what the motor makes of it."""

LYING_KINDS: Final = {FaultKind.CORRUPT_REPLY, FaultKind.SHORT_REPLY}
LYING_RATIO: Final = 0.5
"""With so many damaged answers two of them lie alike, and a joint in EM0, which is told first where
it stands, is then told a wrong place; a timed one goes slowly from wherever it is."""


def is_moved_otherwise(joint: Joint, fault: Fault) -> bool:
    """Return whether a fault lets a servo make something else of the bytes that it receives.

    It has another scale, or another host sends it commands. A host that only asks moves no horn.
    """
    if fault.kind is FaultKind.WRONG_SCALE:
        return fault.servo_id in (None, joint.servo_id)
    return (
        fault.kind is FaultKind.SECOND_MASTER
        and fault.bus in (None, joint.bus)
        and not fault.text.lstrip("#0123456789").startswith("Q")
    )
