"""What one smart servo keeps and what it answers: its settings and its readings.

`Settings` holds EEPROM and session values by the rows of the family's table. `Readings` computes
the replies to queries, in wire units.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.constants import (
    DEG_S_PER_RPM,
    PULSE_MAX_US,
    PULSE_MIN_US,
    Family,
    Status,
    status_codes,
)
from lss_motion.protocol.table import ReplyShape, Suffix
from lss_motion.sim.profile import Motion

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from random import Random

    from lss_motion.protocol.table import FamilyTable, Row
    from lss_motion.sim.motors import Motors
    from lss_motion.sim.physics import ServoSpec

SAME_SCALE: Final = {"MD": "D", "DT": "D", "VT": "SD", "CS": "SD"}
"""Rows in the units of another one."""


class Settings:
    """Wire values by row name. A setting in another unit writes the row that it mirrors."""

    def __init__(
        self,
        table: FamilyTable,
        firmware: int,
        factory: Mapping[str, int],
        eeprom: Mapping[str, int],
    ) -> None:
        self.table = table
        self._rows = {row.name: row for row in table.rows if not row.is_modifier}
        self._firmware = firmware
        self._factory: dict[str, int | None] = {
            row.name: factory.get(row.name, row.default)
            for row in table.rows
            if (row.actions or row.configs) and row.mirrors is None
        }
        self.eeprom = {**self._factory, **eeprom}
        self.session = dict(self.eeprom)
        self.scale_ratios: dict[str, float] = {}
        """Faults (`wrong_scale`): one unit on the wire is so many times that of the documents."""

    def restart(self) -> None:
        self.session = dict(self.eeprom)

    def restore_factory(self, kept: Mapping[str, int | None] = MappingProxyType({})) -> None:
        """Reset every configuration but `kept`, the id and the baud rate as well (FACTS.md R13)."""
        self.eeprom = {**self._factory, **kept}

    def row(self, name: str) -> Row:
        return self._rows[name]

    def factory(self, name: str) -> int:
        return self._factory.get(name) or 0

    def number(self, name: str) -> int:
        """Return a session value as it is on the wire; 0 where there is none."""
        return self.session.get(name) or 0

    def physical(self, name: str) -> float:
        """Return a session value in the physical unit of its row."""
        return self.degrees(name, self.number(name))

    def degrees(self, name: str, value: int) -> float:
        """Return a wire value in the physical unit of a row."""
        ratio = self.scale_ratio(name) if self.scale_ratios else 1.0
        return self._rows[name].physical(value) * ratio

    def wire(self, name: str, physical: float) -> int:
        """Return a physical value in the units that the row has on the wire."""
        if self.scale_ratios:
            physical /= self.scale_ratio(name)
        return self._rows[name].wire(physical)

    def scale_ratio(self, name: str) -> float:
        """Return how many times the unit of the documents a unit of this servo is.

        The row T is the temperature; the modifier of that name has its scale in `Moves`.
        """
        return self.scale_ratios.get(SAME_SCALE.get(name, name), 1.0) if name != "T" else 1.0

    def write(self, row: Row, value: int | None, *, is_config: bool) -> bool:
        """Store a value as the servo would; return whether it was taken."""
        if value is not None:
            kept = row.kept(value)
            too_new = row.choices is not None and row.choices.get(value, 0) > self._firmware
            if kept is None or too_new:
                return False
            value = kept
        if row.mirrors is not None:
            row, value = self.row(row.mirrors), self._mirrored(row, value)
        if row.name == "SD" and value is not None:
            value = min(value, self._factory["SD"] or value)
        if is_config:
            self.eeprom[row.name] = value
        self.session[row.name] = value
        return True

    def read(self, row: Row, *, is_configured: bool) -> int | None:
        """Return what a query of this row answers."""
        values = self.eeprom if is_configured or not row.sets_session else self.session
        if row.mirrors is None:
            return values.get(row.name)
        stored = self.row(row.mirrors)
        wire = values.get(stored.name)
        return None if wire is None else round(stored.physical(wire) / DEG_S_PER_RPM)

    def _mirrored(self, row: Row, value: int | None) -> int | None:
        assert row.mirrors is not None
        if value is None:
            return None
        return self.row(row.mirrors).wire(row.physical(value) * DEG_S_PER_RPM)


PULSE_MID_US = 1500
PULSE_HALF_US = 1000
"""1500 µs is the middle and ±1000 µs the ends of the angular range (FACTS.md C11)."""

STATUS_OF = {
    Motion.LIMP: Status.LIMP,
    Motion.FREE_MOVING: Status.FREE_MOVING,
    Motion.ACCELERATING: Status.ACCELERATING,
    Motion.TRAVELING: Status.TRAVELING,
    Motion.DECELERATING: Status.DECELERATING,
    Motion.HOLDING: Status.HOLDING,
    Motion.OUTSIDE_LIMITS: Status.OUTSIDE_LIMITS,
    Motion.STUCK: Status.STUCK,
    Motion.BLOCKED: Status.BLOCKED,
    Motion.SAFE_MODE: Status.SAFE_MODE,
}


MODEL_CODES: Final = {"LSS-ST1": 1, "LSS-HS1": 2, "LSS-HT1": 3}
"""Answers to QM. Assumed: the maker does not publish its codes."""


class Readings:
    """The answers of servo `index`. Positions scatter as its encoder does."""

    def __init__(
        self,
        index: int,
        motors: Motors,
        settings: Settings,
        *,
        spec: ServoSpec,
        firmware: int,
        random: Random,
    ) -> None:
        self._index = index
        self._motors = motors
        self._settings = settings
        self._table: FamilyTable = settings.table
        self._answers = spec.answers
        self._wire = settings.wire
        self._firmware = firmware
        self._random = random
        self.serial_number = f"{random.randrange(10**7, 10**8)}"
        self._last_target = 0
        self.has_usb = False
        """Whether the host talks to this servo by USB, and to the others through it."""
        is_pro = self._table.family is Family.LSS_PRO
        physics = motors.physics
        self._noise_deg = physics.noise_deg * (physics.pro_noise_ratio if is_pro else 1.0)
        measured: dict[str, Callable[[int], int | str | None]] = {
            "D": lambda now_ns: self._wire("D", self.position_deg(now_ns)),
            "DT": self._target,
            "P": self._pulse_us,
            "WD": lambda now_ns: self._wire("WD", self._speed_deg_s(now_ns)),
            "WR": lambda now_ns: round(self._speed_deg_s(now_ns) / DEG_S_PER_RPM),
            "S": lambda now_ns: round(self._speed_deg_s(now_ns) * self.pulse_us_per_deg()),
            "CS": lambda now_ns: self._wire("CS", self._speed_deg_s(now_ns)),
            "VT": lambda _: self._wire("VT", motors.travel_deg_s(index)),
            "Q": self._status,
            "V": lambda now_ns: self._wire("V", motors.supply_v(now_ns)),
            "T": lambda now_ns: self._wire("T", motors.temperature_c(index, now_ns)),
            "TP": lambda now_ns: self._wire("TP", motors.temperature_c(index, now_ns)),
            "TM": lambda now_ns: self._wire("TM", motors.temperature_c(index, now_ns)),
            "C": lambda now_ns: self._wire("C", motors.current_ma(index, now_ns) / 1000.0),
            "MS": lambda _: spec.model.name,
            "MC": lambda _: MODEL_CODES.get(spec.model.name, 0),
            "N": lambda _: self.serial_number,
            "F": lambda _: self._firmware,
            "FR": lambda _: self._firmware,
            "UC": lambda _: int(self.has_usb),
        }
        self.measured = {name: take for name, take in measured.items() if name not in spec.answers}
        """What the servo measures or is, by row name: the answers to queries without suffix."""

    def value(self, row: Row, suffix: Suffix | None, now_ns: int) -> int | str | None:
        """Return what a query of `row` answers at `now_ns`; None: nothing after the keyword."""
        match suffix:
            case None:
                return self._plain(row, now_ns)
            case Suffix.CAUSE:
                return int(self._motors.safe_cause[self._index])
            case Suffix.FULL_VERSION:
                return f"{self._firmware}.0.0"
            case Suffix.INSTANTANEOUS:
                return self._speed_in(row, self._speed_deg_s(now_ns))
            case Suffix.TARGET:
                return self._speed_in(row, self._motors.travel_deg_s(self._index))
            case Suffix.CONFIGURED:
                return self._settings.read(row, is_configured=True)
            case _:
                return self._plain(row, now_ns)

    def _plain(self, row: Row, now_ns: int) -> int | str | None:
        if row.name in self._answers:
            return self._answers[row.name]
        measure = self.measured.get(row.name)
        if measure is not None:
            return measure(now_ns)
        value = self._settings.read(row, is_configured=False)
        return 0 if value is None and row.reply_shape is ReplyShape.INTEGER else value

    def position_deg(self, now_ns: int) -> float:
        """Return the angle that the encoder shows, as the host sees angles."""
        raw_deg = self._motors.horn_deg(self._index, now_ns)
        scatter_deg = (2.0 * self._random.random() - 1.0) * self._noise_deg
        return self._motors.seen_deg(self._index, raw_deg) + scatter_deg

    def pulse_us_per_deg(self) -> float:
        range_deg = self._settings.physical("AR") or self._table.row("QAR").physical(1)
        return PULSE_HALF_US / (range_deg / 2.0)

    def _pulse_us(self, now_ns: int) -> int:
        """Return the position as a pulse; a negative end point where it is outside (FACTS C11)."""
        pulse_us = PULSE_MID_US + self.position_deg(now_ns) * self.pulse_us_per_deg()
        if pulse_us < PULSE_MIN_US:
            return -PULSE_MIN_US
        return -PULSE_MAX_US if pulse_us > PULSE_MAX_US else round(pulse_us)

    def _target(self, now_ns: int) -> int | None:
        """Return the target; without one nothing, or what it last was where a number is due."""
        target_deg = self._motors.target_deg(self._index, now_ns)
        if target_deg is not None:
            self._last_target = self._wire("D", self._motors.seen_deg(self._index, target_deg))
        elif self._table.row("QDT").reply_shape is ReplyShape.OPTIONAL:
            return None
        return self._last_target

    def _status(self, now_ns: int) -> int:
        motion = self._motors.motion(self._index, now_ns)
        if motion in {Motion.LIMP, Motion.HOLDING} and self._is_outside(now_ns):
            motion = Motion.OUTSIDE_LIMITS
        status = STATUS_OF[motion]
        codes = status_codes(self._table.family, self._firmware)
        return codes.index(status if status in codes else Status.ERROR)

    def _is_outside(self, now_ns: int) -> bool:
        """Return whether the horn rests outside its software limits.

        Assumed: status 7 ("outside limits", FACTS.md S3) means the software limits.
        """
        settings = self._settings
        if not settings.number("LE"):
            return False
        seen_deg = self._motors.seen_deg(self._index, self._motors.horn_deg(self._index, now_ns))
        return not settings.physical("LN") <= seen_deg <= settings.physical("LP")

    def _speed_deg_s(self, now_ns: int) -> float:
        return self._motors.gyre[self._index] * self._motors.horn_deg_s(self._index, now_ns)

    def _speed_in(self, row: Row, speed_deg_s: float) -> int:
        """Return a speed in the unit of `row`, which is SD's or, mirroring it, SR's."""
        if row.mirrors is not None:
            return row.wire(speed_deg_s / DEG_S_PER_RPM)
        return self._wire(row.name, speed_deg_s)
