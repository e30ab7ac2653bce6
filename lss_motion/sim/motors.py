"""The motors of all servos of one bus, simulated through time.

`Motors` executes orders, steps the common grid of control loops, as many at once as may be, and
applies safe mode. `Power`
computes currents, the voltage of the common battery, temperatures, and which motors are stalled.
All angles are raw: from the factory's zero, clockwise, over many turns.
"""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.protocol.constants import Family
from lss_motion.sim.hand import HAND_DEG_S
from lss_motion.sim.horns import BLOCK_NS, FOREVER_NS, SETTLED_DEG, Drives, Horns, Mode
from lss_motion.sim.physics import TICK_NS
from lss_motion.sim.profile import Halt, Motion, Order, PowerOff, SafeCause
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.sim.horns import HornHistory
    from lss_motion.sim.physics import Physics, ServoSpec


TURNING_DEG_S = 1.0
"""A horn slower than this while it should move does not turn. Assumed."""


class Power:
    """Arrays over the servos, brought up to date once every control loop."""

    def __init__(self, physics: Physics, model_deg_s: NDArray[np.float64]) -> None:
        count = len(model_deg_s)
        self._physics = physics
        self.battery_v = physics.supply_v
        """Voltage of the supply without load."""
        self._model_deg_s = model_deg_s
        self._duty_ratio = np.ones(count)
        self._strength_ratio = np.ones(count)
        self._nominal_deg_s = model_deg_s.copy()
        """Top speeds at the nominal voltage."""
        self.motor_ma = np.zeros(count)
        self.stuck_s = np.zeros(count)
        self._is_any_stuck = False
        self._temperature_c = np.full(count, physics.ambient_c)
        self._felt_v = self.supply_v()
        """Voltage at the servos at the last `feel`."""
        self.top_deg_s = self._top_deg_s()

    def feel(
        self,
        passed_s: float,
        horn_deg_s: NDArray[np.float64],
        gap_deg: NDArray[np.float64],
        droop_deg: NDArray[np.float64] | None,
        is_powered: NDArray[np.bool_],
    ) -> None:
        """Update from the motion of the horns in the last `passed_s`; no `droop_deg`: no load."""
        physics = self._physics
        self._temperature_c = self.temperatures_c(passed_s)
        held_ma = np.abs(horn_deg_s)
        held_ma /= self._model_deg_s
        held_ma *= physics.running_ma
        if droop_deg is not None:
            held_ma += physics.load_ma_per_deg * np.abs(droop_deg)
        self.motor_ma = np.multiply(is_powered, held_ma, out=held_ma)
        gaps_deg = gap_deg.tolist()
        is_any_behind = max(gaps_deg) > physics.stall_deg or min(gaps_deg) < -physics.stall_deg
        self._is_any_stuck = is_any_behind or (self._is_any_stuck and any(self.stuck_s.tolist()))
        if self._is_any_stuck:
            behind = np.abs(gap_deg) > physics.stall_deg
            stalled = behind & is_powered & (np.abs(horn_deg_s) < TURNING_DEG_S)
            self.motor_ma = np.where(stalled, physics.stall_ma, self.motor_ma)
            self.stuck_s = np.where(stalled, self.stuck_s + passed_s, 0.0)
        self._felt_v = self.supply_v()
        self.top_deg_s = self._top_deg_s()

    def feel_loops(self, horn_deg_s: NDArray[np.float64], is_powered: NDArray[np.bool_]) -> None:
        """Update from the speeds in many loops, a row each, without loads and stalled motors."""
        physics = self._physics
        motors_ma = is_powered * (np.abs(horn_deg_s) / self._model_deg_s * physics.running_ma)
        finals_c = self._final_c(np.concatenate([self.motor_ma[None], motors_ma[:-1]]))
        remaining = math.exp(-s_from_ns(TICK_NS) / physics.heating_s)
        powers = remaining ** np.arange(len(finals_c), -1.0, -1.0)
        self._temperature_c = powers[0] * self._temperature_c
        self._temperature_c += (1.0 - remaining) * (powers[1:] @ finals_c)
        self.motor_ma = motors_ma[-1]
        self._felt_v = self.supply_v()
        self.top_deg_s = self._top_deg_s()

    def sure_tops_deg_s(self) -> list[float] | None:
        """Return the speeds that motors reach whatever the others do; None: one may be stopped.

        So it is while no motor stalls or holds a load: then it draws at most its running current.
        """
        physics, count = self._physics, len(self.motor_ma)
        if self._is_any_stuck:
            return None
        most = float((self._nominal_deg_s / self._model_deg_s).max())
        most_ma = physics.running_ma * most * max(self.battery_v / physics.nominal_v, 1.0)
        high_v = self.battery_v - physics.supply_ohm * count * physics.idle_ma / 1000.0
        low_v = high_v - physics.supply_ohm * count * most_ma / 1000.0
        most_c = max(float(self._final_c(most_ma)), *self._temperature_c.tolist())
        is_supplied = physics.supply_min_v <= low_v <= high_v <= physics.supply_max_v
        if not is_supplied or most_c > physics.temperature_max_c:
            return None
        tops_deg_s: list[float] = (self._nominal_deg_s * (low_v / physics.nominal_v)).tolist()
        return tops_deg_s

    def stuck(self) -> list[int]:
        """Return the servos whose motors are stalled."""
        return np.flatnonzero(self.stuck_s).tolist() if self._is_any_stuck else []

    def safe_causes(self) -> list[tuple[int, SafeCause]]:
        """Return the servos that a safety limit stops now."""
        causes: list[tuple[int, SafeCause]] = []
        if max(self._temperature_c.tolist()) > self._physics.temperature_max_c:
            is_hot = self._temperature_c > self._physics.temperature_max_c
            causes += [(index, SafeCause.TEMPERATURE) for index in np.flatnonzero(is_hot).tolist()]
        if not self._is_supplied():
            causes += [(index, SafeCause.VOLTAGE) for index in range(len(self.motor_ma))]
        if self._is_any_stuck:
            pushed = np.flatnonzero(self.stuck_s >= self._physics.safe_s).tolist()
            causes += [(index, SafeCause.CURRENT) for index in pushed]
        return causes

    def is_steady(self) -> bool:
        """Return whether no limit can be reached while all horns rest."""
        final_c = self._final_c(self.motor_ma)
        is_cool = all((final_c <= self._physics.temperature_max_c).tolist())
        return is_cool and not self._is_any_stuck

    def set_temperature(self, index: int, temperature_c: float) -> None:
        self._temperature_c[index] = temperature_c

    def temperatures_c(self, passed_s: float) -> NDArray[np.float64]:
        """Return the temperatures `passed_s` after the last `feel`, with currents unchanged."""
        final_c = self._final_c(self.motor_ma)
        remaining = math.exp(-passed_s / self._physics.heating_s)
        temperature_c = self._temperature_c - final_c
        temperature_c *= remaining
        temperature_c += final_c
        return temperature_c

    def supply_v(self) -> float:
        """Return the voltage at the servos: the battery less the drop of all currents."""
        total_ma = self._physics.idle_ma * len(self.motor_ma) + float(np.add.reduce(self.motor_ma))
        return self.battery_v - self._physics.supply_ohm * total_ma / 1000.0

    def _is_supplied(self) -> bool:
        return self._physics.supply_min_v <= self._felt_v <= self._physics.supply_max_v

    def _top_deg_s(self) -> NDArray[np.float64]:
        ratio = self._felt_v / self._physics.nominal_v
        return self._nominal_deg_s * ratio

    def set_duty(self, index: int, ratio: float) -> None:
        """Let a motor reach that share of its top speed by its settings."""
        self._duty_ratio[index] = ratio
        self._nominal_deg_s = self._model_deg_s * self._duty_ratio * self._strength_ratio

    def weaken(self, index: int, ratio: float) -> None:
        """Let a motor reach that share of its top speed, since it is weak."""
        self._strength_ratio[index] = ratio
        self._nominal_deg_s = self._model_deg_s * self._duty_ratio * self._strength_ratio

    def _final_c(self, motor_ma: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the temperatures that motors would reach with these currents."""
        amperes = np.asarray(motor_ma) / 1000.0
        final_c = self._physics.heating_c_per_a2 * amperes * amperes
        return np.asarray(final_c + self._physics.ambient_c)


class Motors:
    """All motors of a bus, a pure function of time and of the orders.

    A servo takes up an order at its own next control loop; loops run every 5 ms with a phase of
    their own for each servo. Instants do not go back.
    """

    def __init__(
        self, specs: Sequence[ServoSpec], physics: Physics, loop_phases_ns: Sequence[int]
    ) -> None:
        count = len(specs)
        self.horns = Horns(specs, physics)
        self.power = Power(physics, np.array([float(spec.model.speed_max_deg_s) for spec in specs]))
        self.history: HornHistory | None = None
        self.gyre = [1.0] * count
        self.origin_deg = [0.0] * count
        self.safe_cause = [SafeCause.NONE] * count
        self._is_guarded = [spec.model.family is not Family.IO2 for spec in specs]
        self.physics = physics
        self._drives = Drives(self.horns, physics, loop_phases_ns)
        self._limits_ma: list[tuple[float, Halt | PowerOff] | None] = [None] * count
        self._dead_ns = ns_from_s(physics.dead_s)
        self._orders: list[tuple[int, int, int, Order]] = []
        self._order_count = 0
        self._tick_ns = 0
        self._followed_ns = 0
        """Up to when the drives are simulated: a bus may be ahead of what its host has read."""
        self._is_quiet = True
        self._start_ns = 0
        self._led = {index: spec.hand for index, spec in enumerate(specs) if spec.hand is not None}
        self._pushes = {i: spec.push for i, spec in enumerate(specs) if spec.push is not None}

    # -- time and orders ------------------------------------------------------------------------

    def start(self, now_ns: int) -> None:
        """Switch the power on at `now_ns`, the first instant."""
        self._tick_ns = self._start_ns = now_ns
        self._is_quiet = not (self._led or self._pushes)
        self.horns.start(now_ns)
        self._drives.start(now_ns)
        self._record(now_ns)

    def advance(self, now_ns: int) -> None:
        """Simulate all servos up to `now_ns`. The result does not depend on the number of calls."""
        self.follow(now_ns)
        self._close_block(self._followed_ns)

    def follow(self, now_ns: int) -> None:
        """Simulate the drives up to `now_ns`: orders and phases. Control loops may be owed."""
        horns, self._followed_ns = self.horns, max(now_ns, self._followed_ns)
        while True:
            order_ns = self._orders[0][0] if self._orders else FOREVER_NS
            if horns.block is None and now_ns >= self._tick_ns + TICK_NS:
                self._tick_until(min(order_ns, now_ns))
            end_ns = FOREVER_NS if horns.block is None else horns.next_end_ns
            due_ns = min(end_ns, order_ns)
            full_ns = FOREVER_NS if horns.block is None else self._tick_ns + BLOCK_NS
            if full_ns <= now_ns and full_ns <= due_ns:
                self._measure(full_ns)
            elif due_ns > now_ns:
                return
            elif due_ns == end_ns:
                self._end_phase(end_ns)
            else:
                self._take_order()

    def _take_order(self) -> None:
        """Take up the first of the orders, to which all that comes before it has been done."""
        taken_ns, _, index, order = heapq.heappop(self._orders)
        may_rest = self.horns.next_end_ns == FOREVER_NS
        is_switched = isinstance(order, PowerOff) or not self._drives.is_powered[index]
        if self.horns.block is None or may_rest or is_switched:
            self._disturb(index, taken_ns)
        else:
            self._catch_up(index, taken_ns)
        if self.safe_cause[index] is SafeCause.NONE:
            self._drives.take_up(index, taken_ns, order)
        if self.horns.block is not None and self.horns.block.is_held:
            self._close_block(taken_ns)

    def _end_phase(self, end_ns: int) -> None:
        """End the phase of a horn while loops are owed."""
        index = self.horns.end_ns.index(end_ns)
        self._catch_up(index, end_ns)
        if self.horns.block is not None and self.horns.block.is_held:
            self._close_block(end_ns)

    def order(self, index: int, received_ns: int, order: Order) -> None:
        """Give servo `index` an order; it starts at its first control loop from `received_ns`."""
        self._order_count += 1
        loop_ns = self._drives.loop_ns(index, received_ns + self._dead_ns)
        entry = (loop_ns, self._order_count, index, order)
        heapq.heappush(self._orders, entry)

    def cancel(self, index: int, now_ns: int) -> None:
        """Drop the orders of servo `index` that begin after `now_ns`."""
        self._orders = [entry for entry in self._orders if entry[2] != index or entry[0] <= now_ns]
        heapq.heapify(self._orders)

    def loop_ns(self, index: int, received_ns: int) -> int:
        """Return when servo `index` starts a command that it received at `received_ns`."""
        return self._drives.loop_ns(index, received_ns)

    def reset(self, index: int, now_ns: int) -> None:
        """Clear orders, safe mode and turns: the servo is limp, its position within ±180."""
        self._disturb(index, now_ns)
        self._orders = [entry for entry in self._orders if entry[2] != index]
        heapq.heapify(self._orders)
        self.horns.wrap(index)
        self.safe_cause[index] = SafeCause.NONE
        self.power.stuck_s[index] = 0.0
        self._limits_ma[index] = None
        self._drives.go_limp(index, now_ns)

    def set_stiffness(
        self, index: int, now_ns: int, *, lag_ratio: float, holding_ratio: float
    ) -> None:
        """Change how closely a horn follows, and how far its load pulls it."""
        self._disturb(index, now_ns)
        self.horns.set_lag(index, now_ns, self.physics.lag_s * lag_ratio)
        self.horns.holding_ratio[index] = holding_ratio

    def limit_current(self, index: int, limit: tuple[float, Halt | PowerOff] | None) -> None:
        """Set the current (mA) above which a stalled motor holds or goes limp."""
        self._limits_ma[index] = limit

    def jam(self, index: int, now_ns: int, *, is_jammed: bool) -> None:
        self._disturb(index, now_ns)
        self.horns.jam(index, is_jammed=is_jammed)

    def set_duty(self, index: int, now_ns: int, ratio: float) -> None:
        """Let a motor reach that share of its top speed by its settings."""
        self._close_block(now_ns)
        self.power.set_duty(index, ratio)

    def is_resting(self, now_ns: int) -> bool:
        """Return whether no horn moves or will move; `follow(now_ns)` has been called."""
        if not self.horns.is_moving():
            self._measure(now_ns)
        return self._is_quiet and not self._orders

    def weaken(self, index: int, now_ns: int, speed_ratio: float) -> None:
        """Limit a motor to that share of its top speed."""
        self._disturb(index, now_ns)
        self.power.weaken(index, speed_ratio)

    def supply(self, now_ns: int, battery_v: float | None) -> None:
        """Set the voltage of the supply without load; None: that of `physics`."""
        for index in range(len(self.safe_cause)):
            self._disturb(index, now_ns)
        self.power.battery_v = self.physics.supply_v if battery_v is None else battery_v

    def heat(self, index: int, now_ns: int, temperature_c: float) -> None:
        self._disturb(index, now_ns)
        self.power.set_temperature(index, temperature_c)

    # -- what a servo can measure of itself; `follow(now_ns)` has been called ---------------------

    def horn_deg(self, index: int, now_ns: int) -> float:
        self._catch_up(index, now_ns)
        return self.horns.shaft_deg(index)

    def horn_deg_s(self, index: int, now_ns: int) -> float:
        self._close_block(now_ns)
        self._catch_up(index, now_ns)
        return self.horns.deg_s[index]

    def motion(self, index: int, now_ns: int) -> Motion:
        """Return the state of the servo: its faults first, then its profile."""
        self._catch_up(index, now_ns)
        if self.safe_cause[index] is not SafeCause.NONE:
            return Motion.SAFE_MODE
        motion = self._drives.motion(index, now_ns)
        stuck_s = float(self.power.stuck_s[index])
        if motion is Motion.LIMP or stuck_s <= 0.0:
            return motion
        return Motion.BLOCKED if stuck_s >= self.physics.blocked_s else Motion.STUCK

    def target_deg(self, index: int, now_ns: int) -> float | None:
        """Return the target; in EM0 the present output of the filter (FACTS.md M9)."""
        self._catch_up(index, now_ns)
        return self._drives.target_deg(index)

    def travel_deg_s(self, index: int) -> float:
        """Return the travel speed of the last move."""
        return self._drives.travel_deg_s[index]

    def supply_v(self, now_ns: int) -> float:
        self._measure(now_ns)
        return self.power.supply_v()

    def current_ma(self, index: int, now_ns: int) -> float:
        self._measure(now_ns)
        return self.physics.idle_ma + float(self.power.motor_ma[index])

    def temperature_c(self, index: int, now_ns: int) -> float:
        self._measure(now_ns)
        return float(self.power.temperatures_c(s_from_ns(now_ns - self._tick_ns))[index])

    def seen_deg(self, index: int, raw_deg: float) -> float:
        """Return a raw angle as the host reads it: from the origin, in the gyre's direction."""
        return self.gyre[index] * (raw_deg - self.origin_deg[index])

    def raw_deg(self, index: int, seen_deg: float) -> float:
        return self.gyre[index] * seen_deg + self.origin_deg[index]

    # -- the grid ---------------------------------------------------------------------------------

    def _catch_up(self, index: int, now_ns: int) -> None:
        """Bring one horn to `now_ns`, through the ends of its phases."""
        horns = self.horns
        top_deg_s = math.inf if horns.block is not None else self.power.top_deg_s.item(index)
        while (end_ns := horns.end_ns[index]) <= now_ns:
            horns.coast(index, end_ns, top_deg_s)
            self._drives.next_phase(index, end_ns)
            horns.has_ended[index] = True
            if horns.block is not None:
                horns.block.looks.append((end_ns, index, math.nan))
        horns.coast(index, now_ns, top_deg_s)

    def _disturb(self, index: int, now_ns: int) -> None:
        """Leave rest, if there is rest, and bring one servo to `now_ns`.

        The grid, which stood still, is first put to its last point before `now_ns`.
        """
        self._close_block(now_ns)
        skipped = (now_ns - self._tick_ns) // TICK_NS
        if self._is_quiet and skipped > 0:
            self._step(self._tick_ns + skipped * TICK_NS)
        self._is_quiet = False
        self._catch_up(index, now_ns)

    def _close_block(self, now_ns: int) -> None:
        """Let each loop after `now_ns` act on the next one again."""
        self._measure(now_ns)
        if self.horns.block is not None:
            self.horns.close_block()

    def _measure(self, now_ns: int) -> None:
        """Compute the loops that are owed up to `now_ns`."""
        block = self.horns.block
        loops = None if block is None else block.loops(now_ns)
        if block is None or loops is None:
            return
        if not self.horns.is_moving():
            is_settled = np.abs(loops.gap_deg).max(axis=1) < SETTLED_DEG
            is_settled &= loops.ns >= block.last_phase_ns
            if is_settled.any():
                self._is_quiet = True
                loops = loops.first(int(is_settled.argmax()) + 1)
        block.measured(loops)
        self._tick_ns = block.ns
        self.power.feel_loops(loops.deg_s, self._drives.is_powered)
        if self.history is not None:
            self.history.extend(loops.ns, loops.deg)
        if self._is_quiet:
            self.horns.close_block()

    def _tick_until(self, now_ns: int) -> None:
        """Step the loops up to `now_ns`, or until they may be owed."""
        while not self._is_quiet and self.horns.block is None and self._tick_ns + TICK_NS <= now_ns:
            self._step(self._tick_ns + TICK_NS)

    def _step(self, now_ns: int) -> None:
        if min(self.horns.end_ns) <= now_ns:
            for index, end_ns in enumerate(self.horns.end_ns):
                if end_ns <= now_ns:
                    self._catch_up(index, now_ns)
        self.horns.sag(self._drives.is_powered)
        self.horns.step(now_ns, self.power.top_deg_s.tolist())
        if self._led:
            for index in list(self._led):
                self._lead(index, now_ns)
        if self._pushes:
            for index in list(self._pushes):
                self._push(index, now_ns)
        self._feel(now_ns)
        self._record(now_ns)
        self._is_quiet = (
            not (self._led or self._pushes)
            and not self.horns.is_moving()
            and self.horns.is_settled()
            and self.power.is_steady()
        )
        if self.horns.may_owe and not self._is_quiet:
            tops_deg_s = self.power.sure_tops_deg_s()
            if tops_deg_s is not None:
                self.horns.open_block(now_ns, tops_deg_s)

    def _lead(self, index: int, now_ns: int) -> None:
        """Move a horn by hand until the next point of the grid, or until the hand ends."""
        horns, time_s = self.horns, s_from_ns(now_ns + TICK_NS - self._start_ns)
        hand_deg = self._led[index].at(time_s)
        if hand_deg is None:
            horns.pull_deg[index] = 0.0
            if self._led[index].is_over(time_s):
                del self._led[index]
                if self._drives.mode[index] is Mode.LIMP:
                    horns.lead(index, now_ns, 0.0)
        elif self._drives.mode[index] is Mode.LIMP:
            horns.pull_deg[index] = 0.0
            speed_deg_s = (hand_deg - horns.deg[index]) / s_from_ns(TICK_NS)
            horns.lead(index, now_ns, min(max(speed_deg_s, -HAND_DEG_S), HAND_DEG_S))
        else:
            give = min(self.physics.hand_give_ratio * float(horns.holding_ratio[index]), 1.0)
            profile_deg, _ = horns.profile_at(index, now_ns)
            horns.pull_deg[index] = give * (hand_deg - profile_deg)

    def _push(self, index: int, now_ns: int) -> None:
        """Displace a horn until the next point of the grid, or let it go for good."""
        push, time_s = self._pushes[index], s_from_ns(now_ns + TICK_NS - self._start_ns)
        is_pushed = push.from_s <= time_s <= push.until_s
        self.horns.pull_deg[index] = self.gyre[index] * push.deg if is_pushed else 0.0
        if time_s > push.until_s + 2.0 * s_from_ns(TICK_NS):  # The horn has been let go.
            del self._pushes[index]

    def _feel(self, now_ns: int) -> None:
        """Let currents and heat act on the servos."""
        horns, power = self.horns, self.power
        passed_s = s_from_ns(now_ns - self._tick_ns)
        self._tick_ns = now_ns
        droop_deg = np.array(horns.droop_deg) if horns.may_droop else None
        deg_s, is_powered = np.array(horns.deg_s), self._drives.is_powered
        power.feel(passed_s, deg_s, np.array(horns.gap_deg), droop_deg, is_powered)
        for index in power.stuck():
            limit = self._limits_ma[index]
            if limit is not None and power.motor_ma[index] > limit[0]:
                self._give_way(index, now_ns, limit[1])
        for index, cause in power.safe_causes():
            if self.safe_cause[index] is SafeCause.NONE and self._is_guarded[index]:
                self.safe_cause[index] = cause
                self._give_way(index, now_ns, PowerOff())

    def _give_way(self, index: int, now_ns: int, order: Halt | PowerOff) -> None:
        self.power.stuck_s[index] = 0.0
        if isinstance(order, PowerOff):
            self._drives.go_limp(index, now_ns)
        else:
            self._drives.hold(index, now_ns, self.horns.deg[index])

    def _record(self, now_ns: int) -> None:
        if self.history is not None:
            self.history.append(now_ns, self.horns.shafts_deg())
