"""One joint while a program is played: what it was told, where it is, what it is told next."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lss_motion.player.following import Following
from lss_motion.program.compile import lead, servo_limits
from lss_motion.program.model import Move, ramp_deg_s2
from lss_motion.program.response import Profile, Reference
from lss_motion.units import MS_PER_S, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from lss_motion.program.cone import ServoLimits
    from lss_motion.protocol.constants import Status
    from lss_motion.robot.model import Joint

HISTORY_S = 2.0
"""How long what the profile did is kept: longer than any answer may take."""


@dataclass(slots=True)
class Track:
    """One joint. Angles are servo degrees; instants are of the run clock.

    `plan` is the profile over show time if all goes well; `profile` is the profile over run time
    after all that was really sent.
    """

    joint: Joint
    plan: Reference
    profile: Profile
    following: Following
    limits: ServoLimits
    lead_s: float
    active: Move | None = None
    """The move of the program that is under way, or was last."""
    status: Status | None = None
    temperature_max_c: float | None = None
    voltage_min_v: float | None = None
    answered_ns: int | None = None
    astray_since_ns: int | None = None
    silent_asks: int = 0

    def place(self, heard_ns: int) -> tuple[float, float]:
        """Return position and speed of the profile at `heard_ns`, after all that was sent."""
        return self.profile.at(s_from_ns(heard_ns))

    def wire_for(self, target_deg: float) -> int:
        """Return the wire value next to `target_deg` plus the correction, inside the range."""
        limits = self.limits
        corrected = target_deg + self.following.offset_deg
        inside = min(max(corrected, limits.position_min_deg), limits.position_max_deg)
        return round(inside * limits.wire_per_deg)

    def duration_for(self, target_wire: int, heard_ns: int, left_s: float) -> int:
        """Return T: what is left, but never so short that the joint's speed limit breaks."""
        target_deg = target_wire / self.limits.wire_per_deg
        position_deg, _ = self.place(heard_ns)
        least_s = abs(target_deg - position_deg) / self.limits.speed_max_deg_s
        return max(1, round(MS_PER_S * left_s), -int(-MS_PER_S * least_s // 1))

    def moved(self, heard_ns: int, target_wire: int, duration_ms: int) -> None:
        """Note that the servo hears `D target T duration` at `heard_ns`."""
        heard_s = s_from_ns(heard_ns)
        self.profile.retarget(
            heard_s, target_wire / self.limits.wire_per_deg, s_from_ms(duration_ms)
        )
        self.profile.forget_before(heard_s - HISTORY_S)


def make_track(joint: Joint, plan: Reference, position_deg: float, tolerance_deg: float) -> Track:
    """Return the track of a joint whose servo stands at `position_deg` (servo degrees)."""
    return Track(
        joint=joint,
        plan=plan,
        profile=Profile(
            position_deg,
            ramp_deg_s2=ramp_deg_s2(joint),
            speed_max_deg_s=joint.speed_max_deg_s,
            response=joint.response,
        ),
        following=Following(speed_max_deg_s=joint.speed_max_deg_s, standing_deg=position_deg),
        limits=servo_limits(joint, tolerance_deg),
        lead_s=lead(joint),
    )
