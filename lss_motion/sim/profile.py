"""The motion profiles of simulated servos.

The trapezoid of EM1 goes from any position and speed to a target, in closed form. The order classes
are the commands of the firmware to its motor; `Motion` is the state that the motor reports.
`Drives` gives each horn its phases: limp, a profile (EM1, wheel, hold) or the filter (EM0). Angles
are raw.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Literal, NamedTuple, assert_never

import numpy as np

from lss_motion.sim.physics import FILTER_TICKS, TICK_NS
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lss_motion.sim.motors import Horns
    from lss_motion.sim.physics import Physics


TINY_S = 1e-9
"""Phases shorter than this are left out: one nanosecond, the resolution of an instant."""


TINY_DEG = 1e-12
"""A horn this near to its target has arrived: a phase over the rest takes under 1 ns."""


class Phase(NamedTuple):
    """A time of constant acceleration. `duration_s` is infinite in the last phase."""

    duration_s: float
    position_deg: float
    speed_deg_s: float
    accel_deg_s2: float

    def end(self) -> tuple[float, float]:
        """Return position and speed at the end."""
        duration_s = self.duration_s
        speed_deg_s = self.speed_deg_s + self.accel_deg_s2 * duration_s
        return (
            self.position_deg + 0.5 * (self.speed_deg_s + speed_deg_s) * duration_s,
            speed_deg_s,
        )


class Ramps(NamedTuple):
    """The limits that shape a profile: magnitudes above 0."""

    speed_deg_s: float
    accel_deg_s2: float
    decel_deg_s2: float


def rest_at(position_deg: float) -> Phase:
    return Phase(math.inf, position_deg, 0.0, 0.0)


def plan_stop(
    position_deg: float, speed_deg_s: float, decel_deg_s2: float
) -> tuple[list[Phase], float]:
    """Return the phase that brakes to rest (none at rest), and its final position."""
    if abs(speed_deg_s) < decel_deg_s2 * TINY_S:
        return [], position_deg
    brake = Phase(
        abs(speed_deg_s) / decel_deg_s2,
        position_deg,
        speed_deg_s,
        -math.copysign(decel_deg_s2, speed_deg_s),
    )
    return [brake], brake.end()[0]


def plan_move(
    position_deg: float, speed_deg_s: float, target_deg: float, ramps: Ramps
) -> list[Phase]:
    """Return the phases that end at rest exactly on `target_deg`.

    One that moves the wrong way, or too fast to stop in time, brakes to rest first and comes
    back. One above the travel speed slows down to it with `decel_deg_s2`.
    """
    away = target_deg - position_deg
    overshoots = speed_deg_s**2 > 2.0 * ramps.decel_deg_s2 * abs(away) * (1.0 + 1e-9)
    if speed_deg_s != 0.0 and (speed_deg_s * away < 0.0 or overshoots):
        phases, position_deg = plan_stop(position_deg, speed_deg_s, ramps.decel_deg_s2)
        speed_deg_s = 0.0
    else:
        phases = []
    away_deg = target_deg - position_deg
    if abs(away_deg) > TINY_DEG:
        sign = math.copysign(1.0, away_deg)
        stretches = _trapezoid(abs(away_deg), abs(speed_deg_s), ramps)
        phases += _chained(position_deg, sign * abs(speed_deg_s), stretches, sign)
    phases.append(rest_at(target_deg))
    return phases


def plan_wheel(
    position_deg: float, speed_deg_s: float, target_deg_s: float, ramps: Ramps
) -> list[Phase]:
    """Return the phases that reach `target_deg_s` and keep it for ever."""
    phases: list[Phase] = []
    if speed_deg_s * target_deg_s < 0.0:
        phases, position_deg = plan_stop(position_deg, speed_deg_s, ramps.decel_deg_s2)
        speed_deg_s = 0.0
    faster = abs(target_deg_s) > abs(speed_deg_s)
    rate_deg_s2 = ramps.accel_deg_s2 if faster else ramps.decel_deg_s2
    change_deg_s = target_deg_s - speed_deg_s
    if abs(change_deg_s) > rate_deg_s2 * TINY_S:
        ramp = Phase(
            abs(change_deg_s) / rate_deg_s2,
            position_deg,
            speed_deg_s,
            math.copysign(rate_deg_s2, change_deg_s),
        )
        phases.append(ramp)
        position_deg = ramp.end()[0]
    phases.append(Phase(math.inf, position_deg, target_deg_s, 0.0))
    return phases


def travel_speed_deg_s(
    distance_deg: float,
    duration_s: float,
    speed_deg_s: float,
    ramps: Ramps,
    t_law: Literal["cruise", "exact"],
) -> float:
    """Return the travel speed that T requires, at most `ramps.speed_deg_s`.

    `speed_deg_s` is the present speed towards the target; it counts for `exact` only.
    """
    if t_law == "cruise":
        asked_deg_s = distance_deg / duration_s
    else:
        asked_deg_s = _exact_speed_deg_s(distance_deg, duration_s, max(speed_deg_s, 0.0), ramps)
    return min(asked_deg_s, ramps.speed_deg_s)


def _exact_speed_deg_s(
    distance_deg: float, duration_s: float, speed_deg_s: float, ramps: Ramps
) -> float:
    """Return the travel speed of the trapezoid that lasts `duration_s`, infinite if none does.

    The ramps cost (c - v)²/2a and c²/2d of the distance that c would make alone.
    """
    accel, decel = ramps.accel_deg_s2, ramps.decel_deg_s2
    slowing = duration_s - speed_deg_s / decel
    if slowing > 0.0:
        slower = (distance_deg - speed_deg_s**2 / (2.0 * decel)) / slowing
        if 0.0 < slower <= speed_deg_s:
            return slower
    square = 0.5 / accel + 0.5 / decel
    linear = duration_s + speed_deg_s / accel
    constant = distance_deg + speed_deg_s**2 / (2.0 * accel)
    discriminant = linear**2 - 4.0 * square * constant
    return math.inf if discriminant < 0.0 else (linear - math.sqrt(discriminant)) / (2.0 * square)


def _trapezoid(distance_deg: float, speed_deg_s: float, ramps: Ramps) -> list[tuple[float, float]]:
    """Return (duration, acceleration) of up to three phases over a distance ahead."""
    cruise_deg_s, accel, decel = ramps
    if speed_deg_s > cruise_deg_s:
        first_accel, first_rate = -decel, decel
        peak = cruise_deg_s
    else:
        first_accel, first_rate = accel, accel
        reach = (2.0 * decel * distance_deg * accel + decel * speed_deg_s**2) / (accel + decel)
        peak = min(cruise_deg_s, math.sqrt(max(reach, 0.0)))
        peak = max(peak, speed_deg_s)
    ramp_s = abs(peak - speed_deg_s) / first_rate
    ramps_deg = abs(peak**2 - speed_deg_s**2) / (2.0 * first_rate) + peak**2 / (2.0 * decel)
    cruise_s = max(distance_deg - ramps_deg, 0.0) / peak if peak > 0.0 else 0.0
    return [(ramp_s, first_accel), (cruise_s, 0.0), (peak / decel, -decel)]


def _chained(
    position_deg: float, speed_deg_s: float, stretches: list[tuple[float, float]], sign: float
) -> Iterator[Phase]:
    for duration_s, accel_deg_s2 in stretches:
        if duration_s > TINY_S:
            phase = Phase(duration_s, position_deg, speed_deg_s, sign * accel_deg_s2)
            yield phase
            position_deg, speed_deg_s = phase.end()


class Motion(IntEnum):
    """The state of a servo; the values are the status codes of LSS (FACTS.md S1)."""

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
class ProfileMove:
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


Order = ProfileMove | Chase | Wheel | Halt | Limp


FILTER_NS = FILTER_TICKS * TICK_NS

FILTER_SETTLED_DEG = 0.05
"""The EM0 filter ends on its target when this near: half of the wire's resolution. Assumed."""


class Mode(Enum):
    """The kind of drive of a horn."""

    LIMP = "limp"
    PROFILE = "profile"
    FILTER = "filter"
    FREE = "free"


class Drives:
    """Feeds `horns` with the phases of all servos. Every instant is one of the servo's loops."""

    def __init__(self, horns: Horns, physics: Physics, loop_phases_ns: Sequence[int]) -> None:
        count = len(loop_phases_ns)
        self.mode = [Mode.LIMP] * count
        self.is_powered = np.zeros(count, dtype=bool)
        self.travel_deg_s = [0.0] * count
        self._horns = horns
        self._physics = physics
        self._first_loop_ns = list(loop_phases_ns)
        self._target_deg: list[float | None] = [None] * count
        self._phases: list[deque[Phase]] = [deque() for _ in range(count)]
        self._filters: list[Chase | None] = [None] * count

    def start(self, now_ns: int) -> None:
        self._first_loop_ns = [now_ns + phase_ns for phase_ns in self._first_loop_ns]

    def loop_ns(self, index: int, heard_ns: int) -> int:
        """Return the first control loop of a servo from `heard_ns` on."""
        return heard_ns + (self._first_loop_ns[index] - heard_ns) % TICK_NS

    def take_up(self, index: int, now_ns: int, order: Order) -> None:
        """Begin an order from the present position and speed of the profile."""
        position_deg = self._horns.profile_deg(index, now_ns)
        speed_deg_s = self._horns.profile_deg_s(index, now_ns)
        if self.mode[index] is Mode.LIMP:  # Without a profile: from where the horn is.
            position_deg, speed_deg_s = float(self._horns.deg[index]), 0.0
        if self._physics.retarget == "from_rest":
            speed_deg_s = 0.0
        match order:
            case Limp():
                self.go_limp(index, now_ns)
            case Halt():
                self.hold(index, now_ns, position_deg)
            case Chase():
                self._chase(index, now_ns, position_deg, order)
            case ProfileMove():
                ramps = _timed(position_deg, speed_deg_s, order, self._physics.t_law)
                phases = plan_move(position_deg, speed_deg_s, order.target_deg, ramps)
                self.travel_deg_s[index] = ramps.speed_deg_s
                self._follow(index, now_ns, order.target_deg, phases)
            case Wheel(wheel_deg_s, wheel_ramps, is_free):
                self.travel_deg_s[index] = abs(wheel_deg_s)
                if wheel_ramps is None:
                    phases = [Phase(math.inf, position_deg, wheel_deg_s, 0.0)]
                else:
                    phases = plan_wheel(position_deg, speed_deg_s, wheel_deg_s, wheel_ramps)
                self._follow(index, now_ns, None, phases)
                if is_free:
                    self.mode[index] = Mode.FREE
            case _:
                assert_never(order)

    def _follow(
        self, index: int, now_ns: int, target_deg: float | None, phases: list[Phase]
    ) -> None:
        self._filters[index] = None
        self._target_deg[index] = target_deg
        self.mode[index] = Mode.PROFILE
        self.is_powered[index] = True
        self._start(index, now_ns, phases)

    def hold(self, index: int, now_ns: int, position_deg: float) -> None:
        """Hold a position from now on."""
        self._follow(index, now_ns, position_deg, [rest_at(position_deg)])

    def _chase(self, index: int, now_ns: int, position_deg: float, chase: Chase) -> None:
        self._filters[index] = chase
        self.mode[index] = Mode.FILTER
        self.is_powered[index] = True
        if not chase.is_repeated:
            self._start(index, now_ns, [rest_at(_filtered(position_deg, chase))])
        else:
            since_ns = now_ns - self._first_loop_ns[index]
            wait_s = s_from_ns(FILTER_NS - since_ns % FILTER_NS)
            self._start(index, now_ns, [Phase(wait_s, position_deg, 0.0, 0.0)])

    def go_limp(self, index: int, now_ns: int) -> None:
        """Take the power off, where the horn is."""
        self._filters[index] = None
        self._target_deg[index] = None
        self.mode[index] = Mode.LIMP
        self.is_powered[index] = False
        self._horns.release(index)
        self._start(index, now_ns, [rest_at(float(self._horns.deg[index]))])

    def _start(self, index: int, now_ns: int, phases: list[Phase]) -> None:
        self._phases[index] = deque(phases)
        self.next_phase(index, now_ns)

    def next_phase(self, index: int, now_ns: int) -> None:
        """Begin the phase that follows the one that ends now."""
        if self._phases[index]:
            self._horns.begin(index, now_ns, self._phases[index].popleft())
            return
        chase = self._filters[index]
        assert chase is not None, "only the filter makes its phases as it goes"
        position_deg = _filtered(self._horns.phases[index].position_deg, chase)
        wait_s = math.inf if position_deg == chase.target_deg else s_from_ns(FILTER_NS)
        self._horns.begin(index, now_ns, Phase(wait_s, position_deg, 0.0, 0.0))

    def motion(self, index: int, now_ns: int) -> Motion:
        """Return the state of a servo from its profile."""
        if self.mode[index] is Mode.LIMP:
            return Motion.LIMP
        if self.mode[index] is Mode.FREE:
            return Motion.FREE_MOVING
        speed_deg_s = self._horns.profile_deg_s(index, now_ns)
        accel_deg_s2 = self._horns.phases[index].accel_deg_s2
        if self.mode[index] is Mode.FILTER or speed_deg_s == accel_deg_s2 == 0.0:
            return Motion.HOLDING
        if accel_deg_s2 == 0.0:
            return Motion.TRAVELING
        is_faster = speed_deg_s * accel_deg_s2 >= 0.0
        return Motion.ACCELERATING if is_faster else Motion.DECELERATING

    def target_deg(self, index: int) -> float | None:
        """Return the target; in EM0 the present output of the filter (FACTS.md M9)."""
        if self.mode[index] is Mode.FILTER:
            return self._horns.phases[index].position_deg
        return self._target_deg[index]


def _timed(
    position_deg: float, speed_deg_s: float, move: ProfileMove, t_law: Literal["cruise", "exact"]
) -> Ramps:
    """Return the ramps of a move with the travel speed that its T requires."""
    away_deg = move.target_deg - position_deg
    if move.duration_s is None or away_deg == 0.0:
        return move.ramps
    towards_deg_s = math.copysign(1.0, away_deg) * speed_deg_s
    travel_deg_s = travel_speed_deg_s(
        abs(away_deg), move.duration_s, towards_deg_s, move.ramps, t_law
    )
    return move.ramps._replace(speed_deg_s=travel_deg_s)


def _filtered(position_deg: float, chase: Chase) -> float:
    """Return one step of the EM0 filter: `x = (x*(FPC-1)+target)/FPC` (FACTS.md M6)."""
    count = max(chase.filter_count, 1)
    stepped_deg = (position_deg * (count - 1) + chase.target_deg) / count
    is_near = abs(stepped_deg - chase.target_deg) < FILTER_SETTLED_DEG
    return chase.target_deg if is_near else stepped_deg
