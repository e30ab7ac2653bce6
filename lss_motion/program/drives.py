"""The three drives behind one face: how each joint is fitted, led, and what of the line it takes.

timed     `D…T…` in EM1 · `fit` (all joints together), `response`
streamed  bare `D` through the filter of EM0 · `stream`, `filtered`
stepped   whole degrees to an RC servo · `step`
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lss_motion.program.quantize import LATEST_ARRIVAL_S, nearest_wire
from lss_motion.program.reference import DURATION_MAX_MS, servo_limits
from lss_motion.program.stepped import PULSE_S, StepFitter
from lss_motion.program.streamed import StreamFitter
from lss_motion.program.verify import filter_profile
from lss_motion.protocol.line import encode_move

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.program.moves import FittedMove
    from lss_motion.program.reference import Reference
    from lss_motion.program.response import PiecewiseProfile
    from lss_motion.robot.model import Joint


class JointFitter(Protocol):
    """Fits one joint, move by move, to instants that somebody else grants.

    wanted_s = fitter.wanted(None)           when the first move is to be heard at the latest
    while wanted_s is not None:
        fitter.grant(granted_s)              it will be heard then, if possible not later
        wanted_s = fitter.wanted(granted_s)  the same for its successor
    """

    moves: list[FittedMove]

    def wanted(self, granted_s: float | None) -> float | None:
        """Return when the next move is to be heard at the latest; None when none is needed."""
        ...

    def grant(self, granted_s: float) -> None:
        """Settle the pending move, now that its successor is known to be heard then."""
        ...

    def reference(self) -> PiecewiseProfile:
        """Return the whole profile that the moves so far make."""
        ...


def make_fitter(
    joint: Joint, course: Reference, tolerance_deg: float, seams_s: Sequence[float] = ()
) -> JointFitter:
    """Return what fits `course` with the drive of `joint`, which is not timed (`fit.Fit`)."""
    limits = servo_limits(joint, tolerance_deg)
    if joint.drive == "streamed":
        start_deg = nearest_wire(float(course.position_deg[0]), limits) / limits.wire_per_deg
        return StreamFitter(course, limits, filter_profile(joint, start_deg))
    assert joint.drive == "stepped"
    return StepFitter(course, limits, seams_s)


def profile_lead_s(joint: Joint) -> float:
    """Return by how much a joint's profile is earlier than its horn, in seconds.

    That is its servo's lag and, unless its model knows about that, half the control tick at which
    it takes up a command.
    """
    half_tick_s = 0.0 if joint.drive == "streamed" else 0.5 * joint.response.loop_s
    return joint.response.lag_s + half_tick_s


def late_max_s(joint: Joint) -> float:
    """Return by how much a command may be late in a schedule that is not too tight.

    For a timed move half of what its reach allows, so that the other half is left for the
    computer that plays it; for a streamed one, what still counts for the same step of the filter.
    """
    match joint.drive:
        case "streamed":
            return 0.5 * joint.response.filter_s
        case "stepped":
            return PULSE_S
        case _:
            return 0.5 * LATEST_ARRIVAL_S


def longest_move(joint: Joint) -> bytes:
    """Return the longest command that the joint can be sent."""
    duration_ms = DURATION_MAX_MS if joint.drive == "timed" else None
    ends = (joint.servo_deg(joint.position_min_deg), joint.servo_deg(joint.position_max_deg))
    return max(
        (
            encode_move(joint.servo_id, round(e * joint.model.wire_per_deg), duration_ms)
            for e in ends
        ),
        key=len,
    )
