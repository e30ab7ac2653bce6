"""Currents, the common battery, heat, and motors that push in vain: all servos of one bus."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.sim.orders import SafeCause

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.sim.physics import Physics

TURNING_DEG_S = 1.0
"""A horn slower than this while it should move does not turn. Assumed."""


class Power:
    """Arrays over the servos, brought up to date once every control loop."""

    def __init__(self, physics: Physics, model_deg_s: NDArray[np.float64]) -> None:
        count = len(model_deg_s)
        self._physics = physics
        self._model_deg_s = model_deg_s
        self.duty_ratio = np.ones(count)
        self.strength_ratio = np.ones(count)
        self.motor_ma = np.zeros(count)
        self.stuck_s = np.zeros(count)
        self._is_any_stuck = False
        self._temperature_c = np.full(count, physics.ambient_c)
        self.top_deg_s = self._top_deg_s()

    def feel(
        self,
        passed_s: float,
        horn_deg_s: NDArray[np.float64],
        gap_deg: NDArray[np.float64],
        droop_deg: NDArray[np.float64],
        is_powered: NDArray[np.bool_],
    ) -> None:
        """Take in what the horns did in the last `passed_s`."""
        physics = self._physics
        self._temperature_c = self.temperatures_c(passed_s)
        running_ratio = np.abs(horn_deg_s) / self._model_deg_s
        held_ma = physics.running_ma * running_ratio + physics.load_ma_per_deg * np.abs(droop_deg)
        self.motor_ma = is_powered * held_ma
        behind = np.abs(gap_deg) > physics.stall_deg
        self._is_any_stuck = any(behind.tolist()) or any(self.stuck_s.tolist())
        if self._is_any_stuck:
            stalled = behind & is_powered & (np.abs(horn_deg_s) < TURNING_DEG_S)
            self.motor_ma = np.where(stalled, physics.stall_ma, self.motor_ma)
            self.stuck_s = np.where(stalled, self.stuck_s + passed_s, 0.0)
        self.top_deg_s = self._top_deg_s()

    def stuck(self) -> list[int]:
        """Return the servos that push in vain."""
        return np.flatnonzero(self.stuck_s).tolist() if self._is_any_stuck else []

    def safe_causes(self) -> list[tuple[int, SafeCause]]:
        """Return the servos that a safety limit stops now."""
        causes: list[tuple[int, SafeCause]] = []
        is_hot = self._temperature_c > self._physics.temperature_max_c
        if any(is_hot.tolist()):
            causes += [(index, SafeCause.TEMPERATURE) for index in np.flatnonzero(is_hot).tolist()]
        if not self._is_supplied():
            causes += [(index, SafeCause.VOLTAGE) for index in range(len(self.motor_ma))]
        if self._is_any_stuck:
            pushed = np.flatnonzero(self.stuck_s >= self._physics.safe_s).tolist()
            causes += [(index, SafeCause.CURRENT) for index in pushed]
        return causes

    def is_steady(self) -> bool:
        """Return whether nothing here can change what a servo does while all horns rest."""
        final_c = self._final_c()
        is_cool = all((final_c <= self._physics.temperature_max_c).tolist())
        return is_cool and not self._is_any_stuck

    def set_temperature(self, index: int, temperature_c: float) -> None:
        self._temperature_c[index] = temperature_c

    def temperatures_c(self, passed_s: float) -> NDArray[np.float64]:
        """Return the temperatures `passed_s` after the last `feel`, with currents unchanged."""
        final_c = self._final_c()
        remaining = math.exp(-passed_s / self._physics.heating_s)
        return final_c + (self._temperature_c - final_c) * remaining

    def supply_v(self) -> float:
        """Return the voltage at the servos: that of the battery less what all currents cost."""
        total_ma = self._physics.idle_ma * len(self.motor_ma) + float(np.add.reduce(self.motor_ma))
        return self._physics.supply_v - self._physics.supply_ohm * total_ma / 1000.0

    def _is_supplied(self) -> bool:
        return self._physics.supply_min_v <= self.supply_v() <= self._physics.supply_max_v

    def _top_deg_s(self) -> NDArray[np.float64]:
        ratio = self.supply_v() / self._physics.nominal_v
        return self._model_deg_s * self.duty_ratio * self.strength_ratio * ratio

    def _final_c(self) -> NDArray[np.float64]:
        amperes = self.motor_ma / 1000.0
        return self._physics.ambient_c + self._physics.heating_c_per_a2 * amperes * amperes
