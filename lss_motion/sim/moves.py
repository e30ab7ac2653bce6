"""What a servo makes of the commands that move it: orders to its motor."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.protocol.constants import DEG_S_PER_RPM, PULSE_MAX_US, PULSE_MIN_US
from lss_motion.sim.orders import Chase, Halt, Limp, Move, Wheel
from lss_motion.sim.profile import Ramps
from lss_motion.sim.readings import PULSE_MID_US
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from lss_motion.protocol.line import Command
    from lss_motion.robot.model import ServoModel
    from lss_motion.sim.motors import Motors
    from lss_motion.sim.orders import Order
    from lss_motion.sim.readings import Readings
    from lss_motion.sim.settings import Settings

DUTY_MAX = 1023
"""Full motor duty of MMD and RDM (FACTS.md M11, M29)."""

MA_PER_A = 1000.0


class Moves:
    """The motion commands of servo `index`."""

    def __init__(
        self,
        index: int,
        motors: Motors,
        settings: Settings,
        readings: Readings,
        *,
        model: ServoModel,
        firmware: int,
    ) -> None:
        self._index = index
        self._motors = motors
        self._settings = settings
        self._readings = readings
        self._model = model
        self._firmware = firmware
        self._ramps: Ramps | None = None

    def obey(self, name: str, command: Command, now_ns: int) -> bool:
        """Do what the row `name` says; return False if that row does not move a servo.

        A command without the value that it needs does nothing.
        """
        value = command.value if isinstance(command.value, int) else None
        match name, value:
            case "L", _:
                self._order(now_ns, Limp(), {})
            case "H", _:
                self._order(now_ns, Halt(), {})
            case (("D" | "MD" | "P" | "M" | "WD" | "WR" | "MD_RAW"), None):
                pass
            case (("D" | "MD" | "P" | "M"), int()):
                self._go(command, self._asked_deg(name, value, now_ns), now_ns)
            case "WD", int():
                self._turn(command, self._degrees("WD", value), now_ns)
            case "WR", int():
                self._turn(command, value * DEG_S_PER_RPM, now_ns)
            case "MD_RAW", int():
                self._push(value, now_ns)
            case _:
                return False
        return True

    def start_at(self, seen_deg: float, now_ns: int) -> None:
        """Go to the first position, from `now_ns` on."""
        raw_deg = self._motors.raw_deg(self._index, seen_deg)
        self._order(now_ns, Move(raw_deg, self._session_ramps()), {})

    def forget_ramps(self) -> None:
        """Read AA, AD and SD anew before the next move."""
        self._ramps = None

    def _asked_deg(self, name: str, value: int, now_ns: int) -> float:
        """Return where a position command points, as the host sees angles."""
        readings = self._readings
        match name:
            case "P":
                pulse_us = min(max(value, PULSE_MIN_US), PULSE_MAX_US) - PULSE_MID_US
                return pulse_us / readings.pulse_us_per_deg()
            case "M":
                return readings.position_deg(now_ns) + value / readings.pulse_us_per_deg()
            case "MD":
                return readings.position_deg(now_ns) + self._degrees("MD", value)
            case _:
                return self._degrees("D", value)

    def _go(self, command: Command, seen_deg: float, now_ns: int) -> None:
        """Move to an angle as the host sees it, with the modifiers that belong to the command."""
        settings = self._settings
        modifiers = self._modifiers(command)
        if settings.number("LE"):
            low_deg, high_deg = settings.physical("LN"), settings.physical("LP")
            seen_deg = min(max(seen_deg, low_deg), high_deg)
        raw_deg = self._motors.raw_deg(self._index, seen_deg)
        if not self._has_profile():
            is_repeated = settings.session.get("IPE", 1) != 0
            chase = Chase(raw_deg, settings.number("FPC"), is_repeated)
            self._order(now_ns, chase, modifiers)
            return
        ramps = self._session_ramps()
        speed_deg_s = min(ramps.speed_deg_s, modifiers.get("SD", ramps.speed_deg_s))
        if "S" in modifiers:
            speed_deg_s = min(speed_deg_s, modifiers["S"] / self._readings.pulse_us_per_deg())
        duration_s = s_from_ms(modifiers["T"]) if "T" in modifiers else None
        move = Move(raw_deg, ramps._replace(speed_deg_s=speed_deg_s), duration_s)
        self._order(now_ns, move, modifiers)

    def _turn(self, command: Command, seen_deg_s: float, now_ns: int) -> None:
        ramps = self._session_ramps()
        speed_deg_s = min(max(seen_deg_s, -ramps.speed_deg_s), ramps.speed_deg_s)
        raw_deg_s = float(self._motors.gyre[self._index]) * speed_deg_s
        wheel = Wheel(raw_deg_s, ramps if self._has_profile() else None)
        self._order(now_ns, wheel, self._modifiers(command))

    def _push(self, duty: int, now_ns: int) -> None:
        """Turn with a share of the motor's power and nothing that controls it (RDM)."""
        duty = min(max(duty, -DUTY_MAX), DUTY_MAX)
        self._settings.session["MD_RAW"] = duty
        top_deg_s = float(self._motors.gyre[self._index]) * self._model.speed_max_deg_s
        self._order(now_ns, Wheel(top_deg_s * duty / DUTY_MAX, None, is_free=True), {})

    def _order(self, now_ns: int, order: Order, modifiers: dict[str, float]) -> None:
        limit: tuple[float, Halt | Limp] | None = None
        if "CL" in modifiers:  # It takes precedence over CH (FACTS.md M18).
            limit = (modifiers["CL"] * MA_PER_A, Limp())
        elif "CH" in modifiers:
            limit = (modifiers["CH"] * MA_PER_A, Halt())
        self._motors.limit_current(self._index, limit)
        self._motors.order(self._index, now_ns, order)

    def _has_profile(self) -> bool:
        """Return whether this is EM1; where there is no EM, it always is."""
        return self._settings.session.get("EM", 1) != 0

    def _session_ramps(self) -> Ramps:
        """Return what AA, AD and SD say. A value of 0 acts as the smallest step (assumed)."""
        if self._ramps is None:
            ratio = self._motors.physics.ramp_ratio
            self._ramps = Ramps(
                speed_deg_s=min(self._at_least_one("SD"), self._model.speed_max_deg_s),
                accel_deg_s2=ratio * self._at_least_one("AA"),
                decel_deg_s2=ratio * self._at_least_one("AD"),
            )
        return self._ramps

    def _at_least_one(self, name: str) -> float:
        return self._degrees(name, max(abs(self._settings.number(name)), 1))

    def _degrees(self, name: str, value: int) -> float:
        return self._settings.row(name).physical(value)

    def _modifiers(self, command: Command) -> dict[str, float]:
        """Return the modifiers in physical units; those that do not belong here do nothing."""
        table = self._settings.table
        allowed = table.row(command.keyword).modifiers
        return {
            name: row.physical(value)
            for name, value in command.modifiers
            if name in allowed
            and (row := table.modifiers[name]).firmware <= self._firmware
            and row.allows(value)
        }
