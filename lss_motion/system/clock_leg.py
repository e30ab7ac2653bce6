"""A piece of the show clock: show time as a function of the run clock, until its rate changes.

The player makes legs (`playing.player.show_clock`); the process that plays sounds is told them
(`sound.mixer`), so that both have the same show time.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from lss_motion.units import NS_PER_S

RATE_BAND: Final = 0.05
"""A sound whose show runs at a rate further than this from 1 is not played: resampled, it would not
sound right."""


class ClockLeg(Struct, frozen=True):
    """From `start_ns` the rate changes evenly from `from_rate` to `to_rate` over `ramp_ns`.

    Before `start_ns` the rate is `from_rate`. The trim makes the show faster by `trim_ratio`, to
    follow a leader; it is no part of the rates.
    """

    start_ns: int
    start_s: float
    from_rate: float
    to_rate: float
    ramp_ns: int
    trim_ratio: float = 0.0

    @property
    def ramp_end_ns(self) -> int:
        return self.start_ns + self.ramp_ns

    def rate(self, at_ns: float) -> float:
        """Return the rate at an instant, without the trim."""
        elapsed_ns = at_ns - self.start_ns
        if elapsed_ns >= self.ramp_ns:
            return self.to_rate
        if elapsed_ns <= 0.0:
            return self.from_rate
        share = elapsed_ns / self.ramp_ns
        return self.from_rate + share * (self.to_rate - self.from_rate)

    def show_s(self, at_ns: float) -> float:
        """Return the show time at an instant."""
        elapsed_s = (at_ns - self.start_ns) / NS_PER_S
        ramp_s = self.ramp_ns / NS_PER_S
        if elapsed_s <= 0.0:
            passed_s = self.from_rate * elapsed_s
        elif elapsed_s < ramp_s:
            change = 0.5 * (self.to_rate - self.from_rate) * elapsed_s * elapsed_s / ramp_s
            passed_s = self.from_rate * elapsed_s + change
        else:
            ramped_s = 0.5 * (self.from_rate + self.to_rate) * ramp_s
            passed_s = ramped_s + self.to_rate * (elapsed_s - ramp_s)
        return self.start_s + (1.0 + self.trim_ratio) * passed_s
