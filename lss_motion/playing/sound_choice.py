"""What a person chooses about the sounds of a show, also while it plays; and what came of them.

Apart from `playing.sounds`, so that a show without sounds loads nothing for them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

OFFSET_STEP_S: Final = 0.01
OFFSET_MAX_S: Final = 1.0


@dataclass(slots=True)
class SoundChoice:
    """The device, and how much later than the robot file says the sounds shall sound."""

    device: str = ""
    """Name of a device, or a part of it; empty: the default one."""
    is_off: bool = False
    leads: bool = True
    """The show follows the device. False: another clock leads the show, and the sounds follow it,
    resampled."""
    shift_s: float = 0.0
    is_kept: bool = False
    """The offset shall be kept for the next shows of this robot."""

    def shift(self, by_s: float) -> None:
        """Make all sounds later by `by_s`."""
        shifted_s = round(self.shift_s + by_s, 4)
        self.shift_s = max(-OFFSET_MAX_S, min(shifted_s, OFFSET_MAX_S))


@dataclass(kw_only=True)
class SoundReport:
    """What was heard of a show."""

    device: str = ""
    """Empty: players of the system were spawned, or nothing was played."""
    driver: str = ""
    latency_s: float | None = None
    """As the driver states it."""
    begun: int = 0
    leads: bool = False
    """Whether the show clock has followed the device."""
    off_max_s: float = 0.0
    """The largest distance between bed and show, 10 s after it began to follow and later."""
    device_ppm: float | None = None
    """How much faster than this computer's clock the device runs."""
    dropouts: int = 0
    offset_s: float = 0.0
    not_played: list[str] = field(default_factory=list)
    """Files that could not be played, or not to their end."""
