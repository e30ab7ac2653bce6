"""One joint while a program is played: what it was told, where it is, what it is told next."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from lss_motion.player.following import Following
from lss_motion.player.hearing import Hearing
from lss_motion.player.lag import Lag
from lss_motion.player.setpoints import make_setpoints
from lss_motion.player.trace import Trace
from lss_motion.program.course import DURATION_MAX_MS, servo_limits
from lss_motion.program.drives import lead
from lss_motion.program.filtered import FilterProfile
from lss_motion.program.model import heard_us
from lss_motion.program.predict import make_profile, profiles
from lss_motion.program.response import Profile
from lss_motion.program.step import PULSE_S
from lss_motion.program.wording import lattice
from lss_motion.protocol.line import encode_move
from lss_motion.units import MS_PER_S, ns_from_s, s_from_ms, s_from_ns, s_from_us

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.line import Line
    from lss_motion.player.setpoints import Setpoints
    from lss_motion.player.show_clock import ShowClock
    from lss_motion.program.course import ServoLimits
    from lss_motion.program.model import Move, Program
    from lss_motion.program.predict import ServoProfile
    from lss_motion.program.response import Reference
    from lss_motion.protocol.constants import Status
    from lss_motion.robot.model import Joint, Robot

REST_DEG_S = 1.0
"""Slower than this a servo is at rest: what is left of a filter's way is below a wire unit."""
REST_DEG = 0.5
"""And a timed one no further than this from its target. Chosen: what braking from that speed takes,
with room for what a lost move leaves."""
LONGEST_NS = ns_from_s(s_from_ms(DURATION_MAX_MS))
HISTORY_S = 2.0
"""How long what the profile did is kept: longer than any answer may take."""


class Owed(NamedTuple):
    """A target that a joint is to be told again."""

    again_ns: int
    target_deg: float
    travel_deg_s: float = math.inf
    """How fast it is to go there, for a joint that is told so."""


@dataclass(slots=True)
class Track:
    """One joint. Angles are servo degrees; instants are of the run clock.

    `plan` is the profile over show time if all goes well; `profile` is the profile over run time
    after all that was really sent.
    """

    joint: Joint
    plan: Reference
    profile: ServoProfile
    following: Following
    limits: ServoLimits
    lead_s: float
    origin_s: float = 0.0
    """When the show time was 0, on the run clock."""
    active: Move | None = None
    """The move of the program that is under way, or was last."""
    owed: Owed | None = None
    """When to say which target again, because the speed limit did not let it be said at once."""
    setpoints: Setpoints | None = None
    """What the filter of a streamed joint makes of its targets."""
    led_ns: int | None = None
    """When a streamed joint that is off its program is told next where to go; None: it is on it."""
    heard_ns: int | None = None
    """When the servo heard its last move."""
    said_again: int = 0
    """How often it was told again what it had missed."""
    status: Status | None = None
    temperature_max_c: float | None = None
    voltage_min_v: float | None = None
    current_max_a: float | None = None
    visited_ns: int | None = None
    """When it was last the turn of its servo to be asked."""
    health_ns: int | None = None
    health_count: int = 0
    """When it was last asked how it fares, and how often."""
    hearing: Hearing | None = None
    """What its servo may have missed; None: nobody judges that."""
    lag: Lag = field(default_factory=Lag)
    early_s: float = 0.0
    """By how much its moves leave earlier than the program says, for its lag. A joint in EM0 keeps
    it while it moves: an instant that creeps past a step of the filter, and nobody knows when it
    steps, leaves out a target or uses one twice, which is more than the acceleration allows."""
    trace: Trace = field(default_factory=Trace)
    is_driven: bool = True
    """Whether it is sent moves: not while nobody knows what its servo would make of them."""

    def stand(self, position_deg: float) -> None:
        """Note that the servo stands at `position_deg`, wherever it was before."""
        self.profile = make_profile(self.joint, position_deg, origin_s=self.origin_s)
        self.owed = self.led_ns = None
        self.setpoints = make_setpoints(self.joint, position_deg, self.limits)
        self.following.stand(position_deg)

    def leave_program(self, now_ns: int) -> None:
        """Note that moves made on the spot take the place of the program's: the rate is not 1.

        What a timed joint is owed of the program is over; a streamed one is led from now on.
        """
        if self.joint.drive == "timed":
            self.owed = None
        elif self.joint.drive == "streamed" and self.is_driven and self.led_ns is None:
            self.led_ns = now_ns

    def learn(self, earlier: Track) -> None:
        """Take over what was learnt about the same joint: what pulls at it, and how it lags."""
        self.lag, self.early_s = earlier.lag, earlier.lag.extra_s
        if self.hearing is not None and earlier.hearing is not None:
            self.hearing.denials = earlier.hearing.denials
        self.following.disturbance_deg = earlier.following.disturbance_deg
        self.following.offset_deg = earlier.following.offset_deg

    def place(self, heard_ns: int) -> tuple[float, float]:
        """Return position and speed of the profile at `heard_ns`, after all that was sent."""
        return self.profile.at(s_from_ns(heard_ns))

    def is_at_rest(self, now_ns: int) -> bool:
        """Return whether its servo should have come to rest; after the longest T it has anyway.

        What is believed of one that took a garbled word for its target may be that it goes on.
        """
        if self.heard_ns is not None and now_ns - self.heard_ns > LONGEST_NS:
            return True
        position_deg, speed_deg_s = self.place(now_ns)
        if isinstance(self.profile, Profile):  # Where it turns round, it is slow as well.
            off_deg = abs(position_deg - self.profile.target_deg)
            return abs(speed_deg_s) < REST_DEG_S and off_deg < REST_DEG
        return abs(speed_deg_s) < REST_DEG_S

    def wire_for(self, target_deg: float, heard_ns: int) -> int:
        """Return the wire value next to `target_deg` plus the correction, inside the range.

        A timed move keeps the speed limit by its T, the others by their target: what it takes off
        is owed, to be said again when the servo has come that far, or led to (`lead`).
        """
        corrected = target_deg + self.following.offset_deg
        wire = lattice(corrected, self.limits)
        low_deg, high_deg = self._reach(heard_ns)
        allowed = lattice(min(max(corrected, low_deg), high_deg), self.limits)
        is_held_back = allowed != wire
        if isinstance(self.profile, FilterProfile):
            next_s = self.profile.hear_s(self.profile.acts_on(s_from_ns(heard_ns)) + 1)
            self.led_ns = ns_from_s(next_s) if is_held_back else None
        else:
            again_ns = heard_ns + ns_from_s(PULSE_S)
            self.owed = Owed(again_ns, target_deg) if is_held_back else None
        return allowed

    @property
    def again_ns(self) -> int | None:
        """When it is to be told something again, whatever the program says."""
        return self.led_ns if self.owed is None else self.owed.again_ns

    def _reach(self, heard_ns: int) -> tuple[float, float]:
        """Return between which targets the limits allow one."""
        heard_s = s_from_ns(heard_ns)
        if self.setpoints is not None:
            return self.setpoints.allowed(heard_s)
        if self.joint.drive == "timed":
            return self.limits.position_min_deg, self.limits.position_max_deg
        passed_s = PULSE_S if self.heard_ns is None else heard_s - s_from_ns(self.heard_ns)
        reach_deg = self.limits.speed_max_deg_s * min(passed_s, 2.0 * PULSE_S)
        reach_deg += self.joint.unit_deg
        position_deg, _ = self.profile.at(heard_s)
        return position_deg - reach_deg, position_deg + reach_deg

    def begun_s(self, line: Line) -> float:
        """Return the show time at which the move under way is heard if all goes well."""
        assert self.active is not None
        return s_from_us(heard_us(self.active, line.bus.baud_bps))

    def left_s(self, line: Line, clock: ShowClock, now_ns: int) -> float:
        """Return how much run time is left to the move under way if it is sent now; 0 if no T."""
        move = self.active
        if move is None or move.duration_ms is None:
            return 0.0
        end_s = self.begun_s(line) + s_from_ms(move.duration_ms)
        heard_ns = line.heard_ns(len(move.data), now_ns)
        return (end_s - clock.show_s(heard_ns)) / clock.target_rate

    @property
    def target_deg(self) -> float:
        """The target of the move under way."""
        assert self.active is not None
        return self.active.target_wire / self.limits.wire_per_deg

    def send_active(self, line: Line, left_s: float, now_ns: int) -> None:
        """Send the move under way, with `left_s` to travel."""
        self.send(line, self.target_deg, left_s, now_ns)

    def duration_for(self, target_wire: int, heard_ns: int, left_s: float) -> int:
        """Return T: what is left, but never so short that the joint's speed limit breaks."""
        target_deg = target_wire / self.limits.wire_per_deg
        position_deg, _ = self.place(heard_ns)
        least_s = abs(target_deg - position_deg) / self.limits.speed_max_deg_s
        return max(1, round(MS_PER_S * left_s), -int(-MS_PER_S * least_s // 1))

    def send(self, line: Line, target_deg: float, left_s: float, now_ns: int) -> None:
        """Hand over the move to `target_deg` that has `left_s`, corrected and within the limits."""
        if not self.is_driven:
            return
        servo_id, is_timed = self.joint.servo_id, self.joint.drive == "timed"
        guess_ms = max(1, round(MS_PER_S * left_s)) if is_timed else None
        guess = encode_move(servo_id, round(target_deg * self.limits.wire_per_deg), guess_ms)
        heard_ns = line.heard_ns(len(guess), now_ns)
        target_wire = self.wire_for(target_deg, heard_ns)
        duration_ms = self.duration_for(target_wire, heard_ns, left_s) if is_timed else None
        data = encode_move(servo_id, target_wire, duration_ms)
        if self.led_ns is not None:
            self.led_ns -= line.time_ns(len(data))
        heard_ns = line.send(data, now_ns)
        self.moved(heard_ns, target_wire, duration_ms)

    def moved(self, heard_ns: int, target_wire: int, duration_ms: int | None) -> None:
        """Note that the servo hears `D target [T duration]` at `heard_ns`."""
        heard_s = s_from_ns(heard_ns)
        duration_s = None if duration_ms is None else s_from_ms(duration_ms)
        target_deg = target_wire / self.limits.wire_per_deg
        if self.hearing is not None and isinstance(self.profile, Profile):
            self.hearing.told(self.profile.copy(), heard_s, target_deg, duration_s)
        if self.setpoints is not None:
            self.setpoints.told(heard_s, target_deg)
        self.profile.retarget(heard_s, target_deg, duration_s)
        self.profile.forget_before(heard_s - HISTORY_S)
        self.heard_ns = heard_ns


def make_tracks(
    program: Program,
    robot: Robot,
    standing_deg: Mapping[str, float],
    origin_s: float,
    *,
    has_feedback: bool,
) -> dict[str, Track]:
    """Return the track of every joint of `program`; its servo stands at `standing_deg`.

    `origin_s` is when the show time is 0, on the run clock.
    """
    tracks = {}
    for name, plan in profiles(program, robot).items():
        joint, servo_deg = robot.joints[name], standing_deg[name]
        limits = servo_limits(joint, program.tolerance_deg)
        tracks[name] = Track(
            joint=joint,
            plan=plan,
            profile=make_profile(joint, servo_deg, origin_s=origin_s),
            setpoints=make_setpoints(joint, servo_deg, limits),
            following=Following(speed_max_deg_s=joint.speed_max_deg_s, standing_deg=servo_deg),
            limits=limits,
            lead_s=lead(joint),
            origin_s=origin_s,
            hearing=Hearing(joint.unit_deg, joint.response.loop_s) if has_feedback else None,
        )
    return tracks
