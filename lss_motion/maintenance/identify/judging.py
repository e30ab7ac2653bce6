"""Where a horn must not be: the words for it, or nothing while all is well."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from lss_motion.maintenance.identify.plan import Window
    from lss_motion.robot.model import Joint

ARRIVED_RATIO: Final = 0.5
"""A horn that made less than this share of its way is held by something."""
WAY_LEAST_DEG: Final = 2.0
"""Shorter ways are not judged: a load or play may take them up."""
GUARD_DEG: Final = 2.0
"""Readings this far outside the window end it: more than noise, less than harm."""


def not_arrived(
    joint: Joint, *, way_deg: float, from_deg: float, rest_deg: float, target_deg: float
) -> str:
    """Return what to say of a horn that rested at `from_deg`, was told to go, and now rests."""
    if way_deg < WAY_LEAST_DEG or abs(rest_deg - from_deg) >= ARRIVED_RATIO * way_deg:
        return ""
    return (
        f"was told to go to {joint.joint_deg(target_deg):.1f} deg and stays at "
        f"{joint.joint_deg(rest_deg):.1f} deg: it is blocked, or its load is too heavy. Free it, "
        f"and begin again"
    )


def outside(joint: Joint, window: Window, reading_deg: float) -> str:
    """Return what to say of a horn at `reading_deg`."""
    if window.low_deg - GUARD_DEG <= reading_deg <= window.high_deg + GUARD_DEG:
        return ""
    low, high = sorted((joint.joint_deg(window.low_deg), joint.joint_deg(window.high_deg)))
    return (
        f"is at {joint.joint_deg(reading_deg):.1f} deg and was to stay within {low:.1f} to "
        f"{high:.1f} deg"
    )
