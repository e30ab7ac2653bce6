"""What drives each horn: limp, a profile (EM1, wheel, hold) or the filter (EM0), phase by phase."""

from __future__ import annotations

import math
from collections import deque
from enum import Enum
from typing import TYPE_CHECKING, Literal, assert_never

import numpy as np

from lss_motion.sim.orders import Chase, Halt, Limp, Motion, Move, Order, Wheel
from lss_motion.sim.physics import FILTER_TICKS, TICK_NS
from lss_motion.sim.profile import (
    Phase,
    Ramps,
    plan_move,
    plan_wheel,
    rest_at,
    travel_speed_deg_s,
)
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.sim.horns import Horns
    from lss_motion.sim.physics import Physics

FILTER_NS = FILTER_TICKS * TICK_NS

FILTER_SETTLED_DEG = 0.05
"""The EM0 filter ends on its target when this near: half of the wire's resolution. Assumed."""


class Mode(Enum):
    """What drives a horn."""

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
        """Begin what `order` asks for, from the profile's present position and speed."""
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
            case Move():
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
        """Return what a servo does by the state of its profile."""
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
        """Return the target; in EM0 what the filter has made of it so far (FACTS.md M9)."""
        if self.mode[index] is Mode.FILTER:
            return self._horns.phases[index].position_deg
        return self._target_deg[index]


def _timed(
    position_deg: float, speed_deg_s: float, move: Move, t_law: Literal["cruise", "exact"]
) -> Ramps:
    """Return the ramps of a move with the travel speed that its T asks for."""
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
