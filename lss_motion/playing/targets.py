"""Joints that follow targets which come while the robot moves, at any rate: one limiter for all.

`TargetLimiter` stands between a source of targets (`live.set_target`, a gamepad, a playhead that is
dragged) and a `Player` that plays a program without moves (`live_program`). At each tick it extends
that program (`Player.extend`) by one ordinary move for each joint with a new target. The course
after a move is that of the servo itself (`robot.profile.trapezoid`), from where it is after all
that was sent: it speeds up, travels and brakes within the limits of the joint, and ends at rest on
its target. So whatever comes, or does not come, the joints keep their limits and come to rest.

A joint with T chases its target with a travel speed that takes it there in `TargetRule.smooth_s`,
or in as short a time as its speed limit allows. A joint without T jumps, and the player divides the
way into jumps that keep its speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.planning.program.line import longest_move
from lss_motion.planning.program.model import Driving, Move, Program
from lss_motion.planning.program.moves import nearest_wire
from lss_motion.planning.program.reference_grid import DURATION_MAX_MS, servo_limits
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.splice import Extension
from lss_motion.planning.program.streamed import PULSE_S
from lss_motion.planning.program.verify import driven
from lss_motion.playing.player.events import Phase
from lss_motion.playing.player.rate_ramps import RAMP_LINE_RATIO
from lss_motion.playing.player.repertoire import STANDING_TOLERANCE_DEG
from lss_motion.robot.profile import (
    DURATION_MIN_MS,
    Piece,
    Profile,
    profile_lead_s,
    ramp_deg_s2,
    trapezoid,
    travel_speed,
)
from lss_motion.robot.servo_models import FAMILIES
from lss_motion.units import (
    MS_PER_S,
    NS_PER_MS,
    NS_PER_US,
    US_PER_S,
    line_time_ns,
    ns_from_s,
    s_from_ms,
    s_from_ns,
    s_from_us,
    us_from_s,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.streamer import Streamer
    from lss_motion.robot.model import Joint, Robot

TICK_NS: Final = 20 * NS_PER_MS
"""A joint gets a move this often, if the line can carry it. Chosen: the control tick of a servo is
as long (FACTS.md M6), and more moves would change nothing."""
SOON_US: Final = 2
"""A move is due so long after now: one more than what rounds up to the next microsecond."""
QUERY_BYTES: Final = 8
"""The longest query that a move may have to wait for, such as `#254QFT` and its end."""
LIVE: Final = "live"
"""Name of the program of a robot that follows targets."""


class TargetRule(Struct, frozen=True, kw_only=True):
    """How joints follow targets.

    `idle_s`: without a target for so long all joints brake and hold; None: they go on to the last
    targets. `smooth_s`: a joint takes at least so long to a target, so that targets which come one
    after the other become one motion; 0: as fast as its limits allow.
    """

    idle_s: float | None = 0.2
    smooth_s: float = 0.1

    def __post_init__(self) -> None:
        """Raise `InputError` for a time that is none."""
        if self.idle_s is not None and not 0.0 < self.idle_s < math.inf:
            raise InputError(f"idle_s is {self.idle_s:g}; a time above 0 s, or None for no limit")
        if not 0.0 <= self.smooth_s <= 2.0:
            raise InputError(f"smooth_s is {self.smooth_s:g}; a time from 0 to 2 s")


def live_program(robot: Robot, standing_deg: Mapping[str, float]) -> Program:
    """Return the program without moves that `TargetLimiter` extends; joint angles.

    Raises `InputError` for a joint whose servo cannot brake as gently as its limit requires.
    """
    start_deg, drives = {}, {}
    for name, deg in standing_deg.items():
        joint = robot.joints[name]
        start_deg[name] = joint.within_deg(deg)
        if "timed" not in FAMILIES[joint.model.family].drives:
            drives[name] = Driving("stepped")
        elif ramp_deg_s2(joint) > joint.accel_max_deg_s2 * (1.0 + 1e-9):
            raise InputError(
                f"joint {name!r} cannot follow live targets: the gentlest ramp of its servo is "
                f"{ramp_deg_s2(joint):.0f} deg/s², its accel_max_deg_s2 is "
                f"{joint.accel_max_deg_s2:g}",
                path=robot.path,
            )
    return Program(
        name=LIVE,
        robot=robot.name,
        robot_path=robot.path,
        moves=(),
        duration_s=0.0,
        start_deg=start_deg,
        tolerance_deg=STANDING_TOLERANCE_DEG,
        drives=drives,
    )


def target_values(deg: Mapping[str, float], known: Iterable[str]) -> dict[str, float]:
    """Return targets as numbers; raises `InputError` for an unknown joint or what is no angle."""
    known, values = list(known), {}
    if not isinstance(deg, Mapping):
        raise InputError(f"{deg!r} names no joints; give them with their degrees: {{'elbow': 30}}")
    for name, angle in deg.items():
        if name not in known:
            raise InputError(f"unknown joint {name!r}; {known_names(name, known)}")
        try:
            values[name] = float(angle)
        except (TypeError, ValueError):
            raise InputError(f"joint {name!r}: {angle!r} is no angle in degrees") from None
        if not math.isfinite(values[name]):
            raise InputError(f"joint {name!r}: {angle!r} is no angle in degrees")
    return values


class _FollowingJoint:
    """One joint and its target. Servo angles, without the correction for the load."""

    def __init__(self, joint: Joint, standing_deg: float) -> None:
        self.joint = joint
        self.limits = servo_limits(joint, STANDING_TOLERANCE_DEG)
        self.wanted = self.sent = nearest_wire(standing_deg, self.limits)
        """The target, and the last one that was sent, in wire units."""
        self.received_us: int | None = None
        self.course = PiecewiseProfile([Piece(-math.inf, standing_deg, 0.0, 0.0)])
        """From the last move on, over show time."""
        # A joint that jumps has its speed with the first pulse.
        is_timed = joint.drive == "timed"
        self._ramp_deg_s2 = ramp_deg_s2(joint) if is_timed else joint.speed_max_deg_s / PULSE_S

    def want(self, joint_deg: float) -> None:
        """Take a target; one out of the range counts as the end of the range."""
        joint = self.joint
        self.wanted = nearest_wire(joint.servo_deg(joint.within_deg(joint_deg)), self.limits)

    def is_ready(self, state: JointState, now_ns: int) -> bool:
        """Return whether a move may be sent: at any time, unless the servo begins each at rest."""
        return self.joint.response.retarget != "from_rest" or state.is_at_rest(now_ns)

    def is_travelling(self, state: JointState, now_ns: int) -> bool:
        """Return whether the joint is on its way, and does not brake already."""
        place_deg, speed_deg_s = state.place(now_ns)
        target_deg = self.sent / self.limits.wire_per_deg
        if isinstance(state.profile, Profile):
            target_deg = state.profile.target_deg
        left_deg = abs(target_deg - place_deg - self._braking_deg(speed_deg_s))
        return left_deg > self.joint.unit_deg + abs(speed_deg_s) * self.joint.response.loop_s

    def _braking_deg(self, speed_deg_s: float) -> float:
        """Return how far the joint goes on while it brakes."""
        return 0.5 * speed_deg_s * abs(speed_deg_s) / self._ramp_deg_s2

    def chase(self, start: Piece, due_us: int, smooth_s: float) -> Move:
        """Return the move from `start` to the target, due then."""
        place_deg, speed_max_deg_s = start.position_deg, self.limits.speed_max_deg_s
        reach_deg = speed_max_deg_s * s_from_ms(DURATION_MAX_MS)
        wanted_deg = self.wanted / self.limits.wire_per_deg
        target_deg = min(max(wanted_deg, place_deg - reach_deg), place_deg + reach_deg)
        target = nearest_wire(target_deg, self.limits)
        target_deg = target / self.limits.wire_per_deg
        least_s = abs(target_deg - place_deg) / speed_max_deg_s
        if self.joint.response.t_law == "exact":  # Its T has the ramps in it.
            *_, last = trapezoid(start, target_deg, speed_max_deg_s, self._ramp_deg_s2)
            least_s = last.start_s - start.start_s
        return self._move(start, target, max(least_s, smooth_s), due_us)

    def brake(self, start: Piece, due_us: int) -> Move:
        """Return the move that brings the joint to rest as soon as its ramps allow.

        Its target is as far ahead as the servo needs if it receives it a control tick late.
        """
        place_deg, speed_deg_s = start.position_deg, start.speed_deg_s
        way_deg = self._braking_deg(speed_deg_s) + speed_deg_s * self.joint.response.loop_s
        self.wanted = nearest_wire(place_deg + way_deg, self.limits)
        lasts_s = abs(way_deg / speed_deg_s) if speed_deg_s else 0.0
        return self._move(start, self.wanted, lasts_s, due_us)

    def _move(self, start: Piece, target: int, lasts_s: float, due_us: int) -> Move:
        joint, duration_ms, travel_deg_s = self.joint, None, self.limits.speed_max_deg_s
        target_deg = target / self.limits.wire_per_deg
        if joint.drive == "timed":
            duration_ms = math.ceil(MS_PER_S * lasts_s - 1e-6)
            duration_ms = min(max(duration_ms, DURATION_MIN_MS), DURATION_MAX_MS)
            asked_deg_s = travel_speed(
                start, target_deg, s_from_ms(duration_ms), self._ramp_deg_s2, joint.response
            )
            travel_deg_s = min(travel_deg_s, asked_deg_s)
        self.course = PiecewiseProfile(
            trapezoid(start, target_deg, travel_deg_s, self._ramp_deg_s2)
        )
        self.sent, self.received_us = target, us_from_s(start.start_s)
        return Move(due_us, joint.bus, joint.servo_id, target, duration_ms)


class TargetLimiter:
    """Lets the joints of a player that plays `live_program` follow targets within their limits.

    `set` and `act` are called by the loop that plays; neither waits.
    """

    def __init__(self, program: Program, robot: Robot, rule: TargetRule | None = None) -> None:
        self._rule = rule or TargetRule()
        self._robot = robot = driven(robot, program)
        self._joints = {
            name: _FollowingJoint(robot.joints[name], robot.joints[name].servo_deg(deg))
            for name, deg in program.start_deg.items()
        }
        self.tick_ns = max(TICK_NS, *(round(ns / RAMP_LINE_RATIO) for ns in self._slots_ns()))
        """How often each joint gets a move at most."""
        self._heard_ns: int | None = None
        """When the last target came, until the joints have braked."""
        self._ticked_ns = -self.tick_ns
        self._leaves_ns = self._acted_ns = 0
        """When all moves so far have left but for those that are sent later than usual, which the
        next ones do not replace; and the last call of `act`."""

    def _slots_ns(self) -> list[int]:
        """Return how long one move for each joint takes on each bus."""
        slots_ns = dict.fromkeys(self._robot.buses, 0)
        for one in self._joints.values():
            slots_ns[one.joint.bus] += self._slot_us(one.joint) * NS_PER_US
        return list(slots_ns.values())

    def _slot_us(self, joint: Joint) -> int:
        baud_bps = self._robot.buses[joint.bus].baud_bps
        return line_time_ns(len(longest_move(joint)), baud_bps) // NS_PER_US + 1

    def latency_s(self, name: str) -> float:
        """Return the bound from `set` to the horn of a joint that begins to obey it.

        It holds at this load of the line, without faults and while the computer keeps time: until
        the next tick, the moves of all joints of its bus, a query on its way, the control tick of
        the servo, and its lag.
        """
        joint = self._robot.joints[name]
        line_ns = max(self._slots_ns())
        line_ns += line_time_ns(QUERY_BYTES, self._robot.buses[joint.bus].baud_bps)
        return s_from_ns(self.tick_ns + line_ns) + joint.response.loop_s + joint.response.lag_s

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait: nothing of this."""
        return ()

    def take_texts(self) -> Sequence[str]:
        """Return what a client should know: nothing of this."""
        return ()

    def set(self, deg: Mapping[str, float], now_ns: int) -> None:
        """Take new targets, joint angles; the newest of each joint counts.

        One out of the range counts as the end of the range. Raises `InputError`, and takes none,
        where one is for an unknown joint or no angle.
        """
        for name, angle in target_values(deg, self._joints).items():
            self._joints[name].want(angle)
        self._heard_ns = now_ns

    def act(self, player: Player, now_ns: int) -> None:
        """Extend the program by the moves to new targets, or brake when no more come."""
        acted_ns, self._acted_ns = self._acted_ns, now_ns
        show = player.show
        if self._heard_ns is None or show is None or not _takes_moves(player, show, now_ns):
            return
        if self._rule.idle_s is not None:
            idle_ns = self._heard_ns + ns_from_s(self._rule.idle_s)
            if now_ns >= idle_ns and acted_ns >= self._leaves_ns:
                self.brake(player, now_ns)
                return
            player.wake_at(max(idle_ns, self._leaves_ns))
        next_ns = max(self._ticked_ns + self.tick_ns, self._leaves_ns)
        if now_ns < next_ns or acted_ns < self._leaves_ns:
            player.wake_at(max(next_ns, now_ns + 1))
            return
        far = {name: one for name, one in self._joints.items() if one.wanted != one.sent}
        if far:
            states = show.joint_states
            ready = [one for name, one in far.items() if one.is_ready(states[name], now_ns)]
            self._extend(player, show, ready, now_ns)
            player.wake_at(now_ns + self.tick_ns)

    def brake(self, player: Player, now_ns: int) -> None:
        """Bring all joints to rest within their limits; they hold until the next target."""
        self._heard_ns = None
        show = player.show
        if show is None or not _takes_moves(player, show, now_ns):
            return
        states = show.joint_states
        moving = [
            one for name, one in self._joints.items() if one.is_travelling(states[name], now_ns)
        ]
        for one in self._joints.values():
            one.wanted = one.sent
        self._extend(player, show, moving, now_ns, is_braking=True)

    def _extend(
        self,
        player: Player,
        show: Streamer,
        joints: Sequence[_FollowingJoint],
        now_ns: int,
        *,
        is_braking: bool = False,
    ) -> None:
        """Send these joints to their targets, one after the other on each line, from now on."""
        if not joints:
            return
        base_us = math.floor(US_PER_S * show.show_s(now_ns)) + SOON_US
        queues_us = dict.fromkeys(self._robot.buses, 0)
        moves = []
        for one in joints:
            joint, state = one.joint, show.joint_states[one.joint.name]
            # It leaves earlier by the lag that was learnt; later where that is less than assumed.
            early_us = us_from_s(state.early_s)
            due_us = base_us + queues_us[joint.bus] + max(early_us, 0)
            if one.received_us is not None:
                due_us = max(due_us, one.received_us)
            queues_us[joint.bus] += self._slot_us(joint)
            received_us = due_us + self._slot_us(joint)
            received_ns = now_ns + (received_us - base_us - early_us) * NS_PER_US
            start = _start(state, received_ns, s_from_us(received_us), show.clock.rate(now_ns))
            if is_braking:
                moves.append(one.brake(start, due_us))
            else:
                moves.append(one.chase(start, due_us, self._rule.smooth_s))
        moves.sort()
        ends_s = (one.course.end_s + profile_lead_s(one.joint) for one in self._joints.values())
        extension = Extension(
            from_us=moves[0].due_us,
            moves=moves,
            duration_s=max(s_from_us(moves[-1].due_us), *ends_s),
            profiles={one.joint.name: one.course for one in joints},
            line_use={},
            tolerance_deg=STANDING_TOLERANCE_DEG,
        )
        is_taken = player.extend(extension, now_ns)
        assert is_taken, "it begins after now, and the show is open"
        self._ticked_ns = now_ns
        self._leaves_ns = now_ns + (SOON_US + max(queues_us.values())) * NS_PER_US


def _start(state: JointState, received_ns: int, at_s: float, rate: float) -> Piece:
    """Return where a joint is when it receives a move, by all that was sent; show time."""
    place_deg, speed_deg_s = state.place(received_ns)
    if state.joint.response.retarget == "from_rest":
        speed_deg_s = 0.0
    return Piece(at_s, place_deg - state.disturbance.offset_deg, speed_deg_s / rate, 0.0)


def _takes_moves(player: Player, show: Streamer, now_ns: int) -> bool:
    """Return whether the show goes on, also slower for a fault, and is open.

    While its rate changes, it must not change: the ramp of the rate is as gentle as it requires.
    """
    is_steady = show.clock.rate(now_ns) == show.clock.target_rate > 0.0
    return player.phase is Phase.SHOW and show.is_open and is_steady
