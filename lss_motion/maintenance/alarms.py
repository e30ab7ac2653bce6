"""When somebody should look: a servo that is hot, overloaded, badly supplied, stuck or silent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lss_motion.maintenance.look import (
    BAD_STATUS,
    CURRENT_MAX_A,
    HOT_C,
    SUPPLY_MAX_V,
    SUPPLY_MIN_V,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.maintenance.watch import Reading


@dataclass(frozen=True, slots=True, kw_only=True)
class Thresholds:
    """Beyond these a servo is told of. The defaults and their sources are in `look`."""

    temperature_max_c: float = HOT_C
    current_max_a: float = CURRENT_MAX_A
    supply_min_v: float = SUPPLY_MIN_V
    supply_max_v: float = SUPPLY_MAX_V

    def alarms(self, reading: Reading) -> list[tuple[str, str]]:
        """Return kind and text of everything that is wrong with a servo now."""
        name = reading.target.name
        found = []
        if reading.is_silent:
            return [("silent", f"{name} does not answer")]
        if reading.status in BAD_STATUS and reading.status is not None:
            found.append(("status", f"{name}: {reading.status.value}"))
        if reading.temperature_c is not None and reading.temperature_c >= self.temperature_max_c:
            found.append(
                (
                    "temperature",
                    f"{name}: {reading.temperature_c:.0f} °C, from {self.temperature_max_c:g} on "
                    f"it is too hot",
                )
            )
        if reading.current_a is not None and reading.current_a > self.current_max_a:
            found.append(
                ("current", f"{name}: {reading.current_a:.2f} A, more than {self.current_max_a:g}")
            )
        if reading.voltage_v is not None and not (
            self.supply_min_v <= reading.voltage_v <= self.supply_max_v
        ):
            found.append(
                (
                    "voltage",
                    f"{name}: {reading.voltage_v:.1f} V, not {self.supply_min_v:g} to "
                    f"{self.supply_max_v:g}",
                )
            )
        return found


class Alarms:
    """Remembers what is wrong, so that each thing is told once until it is over."""

    def __init__(self, thresholds: Thresholds) -> None:
        self._thresholds = thresholds
        self.active: dict[tuple[str, str], str] = {}
        """Servo and kind → text, newest words."""

    def update(self, readings: Iterable[Reading]) -> list[str]:
        """Return the texts of what has begun to be wrong since the last call."""
        now = {
            (reading.target.name, kind): text
            for reading in readings
            for kind, text in self._thresholds.alarms(reading)
        }
        fresh = [text for key, text in now.items() if key not in self.active]
        self.active = now
        return fresh
