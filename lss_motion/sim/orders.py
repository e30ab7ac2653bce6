"""What a servo's firmware asks of its motor, and what the motor reports back. Angles are raw."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lss_motion.sim.profile import Ramps


class Motion(IntEnum):
    """What a servo is doing; the values are the status codes of LSS (FACTS.md S1)."""

    LIMP = 1
    FREE_MOVING = 2
    ACCELERATING = 3
    TRAVELING = 4
    DECELERATING = 5
    HOLDING = 6
    OUTSIDE_LIMITS = 7
    STUCK = 8
    BLOCKED = 9
    SAFE_MODE = 10


class SafeCause(IntEnum):
    """Why a servo is in safe mode; the values are the answers to Q1 (FACTS.md S5)."""

    NONE = 0
    CURRENT = 1
    VOLTAGE = 2
    TEMPERATURE = 3


@dataclass(frozen=True, slots=True)
class Move:
    """Go to `target_deg` by the profile, in `duration_s` or at the travel speed of `ramps`."""

    target_deg: float
    ramps: Ramps
    duration_s: float | None = None


@dataclass(frozen=True, slots=True)
class Chase:
    """Go to `target_deg` through the EM0 filter.

    With `is_repeated` (IPE) the filter steps by itself every 20 ms, without once an order.
    """

    target_deg: float
    filter_count: int
    is_repeated: bool


@dataclass(frozen=True, slots=True)
class Wheel:
    """Turn for ever; without ramps (EM0) at full speed from one control loop to the next.

    `is_free`: a share of the motor's power and nothing that controls it (RDM).
    """

    speed_deg_s: float
    ramps: Ramps | None
    is_free: bool = False


@dataclass(frozen=True, slots=True)
class Halt:
    """Stop the profile at once where it is, and hold; the horn closes up within its lag."""


@dataclass(frozen=True, slots=True)
class Limp:
    """Take the power off. Friction keeps the horn where it is."""


Order = Move | Chase | Wheel | Halt | Limp
