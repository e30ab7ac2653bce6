"""Where a show of several figures is, and how fast it goes on: one leg after the other.

Every leg is made `LEAD_NS` ahead. Its rate is that of the leader, or 1, times what a person asked
for and what the others are limited to while a figure does not play. No state but the present leg:
when to begin, limit and end is decided by the conductor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.playing.player.following import RUNNING_RATE, SLOW_RATE, SPEED_STEP
from lss_motion.stage.hosts.messages import NetworkLeg
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from lss_motion.playing.player.show_clock import LeaderPosition

LEAD_NS: Final = NS_PER_S
"""A leg takes effect this long after it was made. A message arrives in 80 ms even on a bad Wi-Fi,
and ten beats repeat it meanwhile."""
RATE_MAX: Final = 1.1
CHASE_NS: Final = NS_PER_S
"""Legs that follow the timecode are so far apart, as each is made a second ahead."""
OFF_S: Final = 1e-3
RATE_OFF: Final = 50e-6
"""The legs follow the timecode when it is further away than this. Chosen: half of the goal of 2 ms;
figures trim the rest away."""


class ShowLegs:
    """The present leg of a show; `newest` is None while none has begun."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all: another run begins."""
        self.newest: NetworkLeg | None = None
        self.speed = 1.0
        """The share of the speed of the plan that a person asked for."""
        self.is_paused = self.is_seeking = False
        """Whether it stands for a person, or until all robots are at the place of its leg."""
        self.limit = 1.0
        """What the others are limited to while a figure does not play."""
        self._led_rate = 1.0
        """That of a leader, if there is one."""
        self._chased_ns = -CHASE_NS

    def begin(self, start_s: float, leader: LeaderPosition | None, now_ns: int) -> NetworkLeg:
        """Make the first leg, from `start_s` or where the leader will be."""
        at_ns = now_ns + LEAD_NS
        show_s, rate = start_s, 1.0
        if leader is not None:
            show_s = leader.at_s(at_ns)
            rate = self._led_rate = min(leader.rate, RATE_MAX)
        self.newest = NetworkLeg(number=1, instant_ns=at_ns, show_s=show_s, rate=rate)
        return self.newest

    def show_s(self, now_ns: int) -> float | None:
        """Return the show time; None while none plays. Before its start it is negative."""
        return None if self.newest is None else self.newest.at_s(now_ns)

    def pause(self, now_ns: int, *, is_paused: bool) -> None:
        """Stand, or go on."""
        self.is_paused = is_paused
        self._rerate(now_ns)

    def set_rate(self, ratio: float, now_ns: int) -> float:
        """Play at this share of the speed of the plan; return the nearest that figures follow."""
        self.speed = followed_rate(ratio)
        self._rerate(now_ns)
        return self.speed

    def set_limit(self, ratio: float, now_ns: int) -> None:
        """Let the show be slower for a figure, or stand (0)."""
        self.limit = ratio
        self._rerate(now_ns)

    def seek(self, show_s: float, duration_s: float | None, now_ns: int) -> None:
        """Stand at another show time; raises `InputError` for one that is not in the show."""
        assert self.newest is not None, "a show plays"
        if not 0.0 <= show_s < (float("inf") if duration_s is None else duration_s):
            end = "" if duration_s is None else f", which ends at {duration_s:.1f} s"
            raise InputError(f"{show_s:g} s is not in the show{end}")
        self.is_seeking = True
        self._add(now_ns + LEAD_NS, show_s, 0.0)

    def end_seek(self, now_ns: int) -> None:
        """Go on from the place that was sought."""
        self.is_seeking = False
        self._rerate(now_ns)

    def chase(self, leader: LeaderPosition, now_ns: int) -> None:
        """Make another leg where the leader has left the present one.

        While the show is paused or slowed down for a figure, it is met only afterwards.
        """
        leg = self.newest
        if leg is None or now_ns < self._chased_ns + CHASE_NS:
            return
        at_ns = max(now_ns, leg.instant_ns) + CHASE_NS
        rate = leader.rate if leader.rate >= RUNNING_RATE else 0.0
        if rate == leg.rate == 0.0:
            return  # Both stand: figures rejoin when it runs again.
        off_s = leader.at_s(at_ns) - leg.at_s(at_ns)
        if abs(off_s) <= OFF_S and abs(rate - leg.rate) <= RATE_OFF:
            return
        self._chased_ns = now_ns
        if leg.instant_ns > now_ns:
            return  # One leg at a time: figures may not have got the last one yet.
        self._led_rate = min(rate, RATE_MAX)
        if self.is_paused or self.limit < 1.0:
            self._rerate(now_ns)
            return
        at_ns = now_ns + LEAD_NS
        at_s = leader.show_s + rate * (at_ns - leader.instant_ns) / NS_PER_S
        self._add(at_ns, at_s, self._led_rate)

    @property
    def _wanted_rate(self) -> float:
        slower = self.limit * self.speed
        if self.is_paused or self.is_seeking or slower == 0.0:
            return 0.0
        return self._led_rate if slower == 1.0 else self._led_rate * followed_rate(slower)

    def _rerate(self, now_ns: int) -> None:
        """Make a leg with the rate that is wanted, where the present one will have come to."""
        leg = self.newest
        if leg is not None and leg.rate != self._wanted_rate:
            at_ns = max(now_ns + LEAD_NS, leg.instant_ns)
            self._add(at_ns, leg.at_s(at_ns), self._wanted_rate)

    def _add(self, at_ns: int, show_s: float, rate: float) -> None:
        number = 1 if self.newest is None else self.newest.number + 1
        self.newest = NetworkLeg(number=number, instant_ns=at_ns, show_s=show_s, rate=rate)


def followed_rate(ratio: float) -> float:
    """Return the rate next to a ratio that figures follow as it is (`following.FollowRule`)."""
    slowest = min(max(ratio, SLOW_RATE), RUNNING_RATE - SPEED_STEP)
    slower = round(round(slowest / SPEED_STEP) * SPEED_STEP, 3)
    return slower if ratio - slower < 1.0 - ratio else 1.0
