"""The firmware of one smart servo: it executes commands and replies to queries.

`Servo` is what the bus calls. `Settings` holds EEPROM and session values by the rows of the
family's table. `Readings` computes the replies to queries, in wire units. `Moves` turns motion
commands into orders to the motor.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.protocol.codec import language_table
from lss_motion.protocol.constants import (
    BROADCAST_ID,
    DEG_S_PER_RPM,
    PULSE_MAX_US,
    PULSE_MIN_US,
    RESET_S,
    Family,
    Status,
    status_codes,
)
from lss_motion.protocol.framing import DISABLED, Reply
from lss_motion.protocol.table import Form, ReplyShape, Suffix
from lss_motion.sim.profile import Chase, Halt, Limp, Motion, ProfileMove, Ramps, Wheel
from lss_motion.units import ns_from_s, s_from_ms

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from random import Random

    from lss_motion.protocol.framing import Command
    from lss_motion.protocol.table import FamilyTable, Row
    from lss_motion.robot.model import ServoModel
    from lss_motion.sim.motors import Motors
    from lss_motion.sim.physics import ServoSpec
    from lss_motion.sim.profile import Order


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

    def restore_factory(self) -> None:
        """Reset every configuration but the id.

        Assumed: no document states whether the id is kept. Servos without ids all have the same.
        """
        self.eeprom = {**self._factory, "ID": self.eeprom.get("ID")}

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
        return self.row(name).physical(value) * self.scale_ratio(name)

    def wire(self, name: str, physical: float) -> int:
        """Return a physical value in the units that the row has on the wire."""
        return self.row(name).wire(physical / self.scale_ratio(name))

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
        self._firmware = firmware
        self._random = random
        self._serial_number = f"{random.randrange(10**7, 10**8)}"
        self._last_target = 0
        is_pro = self._table.family is Family.LSS_PRO
        physics = motors.physics
        self._noise_deg = physics.noise_deg * (physics.pro_noise_ratio if is_pro else 1.0)
        self._measured: dict[str, Callable[[int], int | str | None]] = {
            "D": lambda now_ns: self._wire("D", self.position_deg(now_ns)),
            "DT": self._target,
            "P": self._pulse_us,
            "WD": lambda now_ns: self._wire("WD", self._speed_deg_s(now_ns)),
            "WR": lambda now_ns: round(self._speed_deg_s(now_ns) / DEG_S_PER_RPM),
            "S": lambda now_ns: round(self._speed_deg_s(now_ns) * self.pulse_us_per_deg()),
            "CS": lambda now_ns: self._wire("CS", self._speed_deg_s(now_ns)),
            "VT": lambda _: self._wire("VT", motors.travel_deg_s(index)),
            "Q": self._status,
            "V": lambda _: self._wire("V", motors.power.supply_v()),
            "T": lambda now_ns: self._wire("T", motors.temperature_c(index, now_ns)),
            "TP": lambda now_ns: self._wire("TP", motors.temperature_c(index, now_ns)),
            "TM": lambda now_ns: self._wire("TM", motors.temperature_c(index, now_ns)),
            "C": lambda _: self._wire("C", motors.current_ma(index) / 1000.0),
            "MS": lambda _: spec.model.name,
            "MC": lambda _: MODEL_CODES.get(spec.model.name, 0),
            "N": lambda _: self._serial_number,
            "F": lambda _: self._firmware,
            "FR": lambda _: self._firmware,
        }

    def value(self, row: Row, suffix: Suffix | None, now_ns: int) -> int | str | None:
        """Return what a query of `row` answers at `now_ns`; None: nothing after the keyword."""
        match suffix:
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
            case _ if row.name in self._answers:
                return self._answers[row.name]
            case _:
                measure = self._measured.get(row.name)
                if measure is not None:
                    return measure(now_ns)
                value = self._settings.read(row, is_configured=False)
                return 0 if value is None and row.reply_shape is ReplyShape.INTEGER else value

    def position_deg(self, now_ns: int) -> float:
        """Return the angle that the encoder shows, as the host sees angles."""
        raw_deg = self._motors.horn_deg(self._index, now_ns)
        scatter_deg = self._random.uniform(-1.0, 1.0) * self._noise_deg
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
        gyre = float(self._motors.gyre[self._index])
        return gyre * self._motors.horn_deg_s(self._index, now_ns)

    def _wire(self, name: str, physical: float) -> int:
        return self._settings.wire(name, physical)

    def _speed_in(self, row: Row, speed_deg_s: float) -> int:
        """Return a speed in the unit of `row`, which is SD's or, mirroring it, SR's."""
        if row.mirrors is not None:
            return row.wire(speed_deg_s / DEG_S_PER_RPM)
        return self._wire(row.name, speed_deg_s)


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
        """Execute the command of row `name`; return False if that row does not move a servo.

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
        self._order(now_ns, ProfileMove(raw_deg, self._session_ramps()), {})

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
        move = ProfileMove(raw_deg, ramps._replace(speed_deg_s=speed_deg_s), duration_s)
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
        """Return the ramps of AA, AD and SD. A value of 0 acts as the smallest step (assumed)."""
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
        return self._settings.degrees(name, value)

    def _modifiers(self, command: Command) -> dict[str, float]:
        """Return the modifiers in physical units; those that do not belong here do nothing."""
        table = self._settings.table
        allowed = table.row(command.keyword).modifiers
        return {
            name: row.physical(value) * self._settings.scale_ratios.get(name, 1.0)
            for name, value in command.modifiers
            if name in allowed
            and (row := table.modifiers[name]).firmware <= self._firmware
            and row.allows(value)
        }


ORDERED_FIRMWARE = 370
"""First firmware that orders replies: groups, slots, QID with a delay (FACTS.md W16 to W19)."""


class Servo:
    """One servo, number `index` of `motors`.

    Orders go to the motor, answers come back at once; the bus decides when they are sent.
    `baud_bps` is the rate it listens at; `sent_ns` when its last reply ends.
    """

    def __init__(
        self,
        spec: ServoSpec,
        index: int,
        motors: Motors,
        *,
        firmware: int,
        baud_bps: int,
        random: Random,
    ) -> None:
        table = language_table(spec.model.language)
        self.index = index
        self.servo_id = spec.servo_id
        self.baud_bps = spec.baud_bps or baud_bps
        self.random = random
        self.sent_ns = 0
        top_speed = table.row("SD").wire(spec.model.speed_max_deg_s)
        own = {"ID": self.servo_id, "B": self.baud_bps, **spec.eeprom}
        self.settings = Settings(table, firmware, {"SD": top_speed}, own)
        self._table = table
        self._firmware = firmware
        self._motors = motors
        self._readings = Readings(
            index, motors, self.settings, spec=spec, firmware=firmware, random=random
        )
        self._moves = Moves(
            index, motors, self.settings, self._readings, model=spec.model, firmware=firmware
        )
        self._deaf_until_ns = 0
        self._is_rc = False
        self._armed: str | None = None
        self._apply_session(0)

    @property
    def family(self) -> Family:
        return self._table.family

    def is_listening(self, now_ns: int) -> bool:
        return now_ns >= self._deaf_until_ns and not self._is_rc

    def obey(self, command: Command, now_ns: int) -> Reply | None:
        """Execute one command received at `now_ns`; return the reply to a query.

        The servo ignores commands that it does not have. After ECR1 it acknowledges the others by
        repeating them; the shape is assumed (FACTS.md C21).
        """
        armed, self._armed = self._armed, None
        found = self._table.by_keyword.get(command.keyword)
        if found is None or found[1].firmware > self._firmware:
            return None
        form, row = found
        if form is Form.QUERY:
            return self._answer(command, row, now_ns)
        is_acknowledged = self.settings.number("CR") != 0 and command.servo_id != BROADCAST_ID
        self._execute(command, form, row, armed, now_ns)
        if not is_acknowledged or not self.is_listening(now_ns):
            return None
        return Reply(self.servo_id, command.keyword, command.value)

    def _execute(
        self, command: Command, form: Form, row: Row, armed: str | None, now_ns: int
    ) -> None:
        """Execute an action or a configuration."""
        match form, row.name:
            case Form.ACTION, "RESET":
                self.reset(now_ns)
            case Form.ACTION, ("DEFAULT" | "UPDATE"):
                self._armed = row.name
            case Form.ACTION, "CONFIRM":
                self._confirm(armed, now_ns)
            case Form.ACTION, name if self._moves.obey(name, command, now_ns):
                pass
            case _:
                self._set(command, row, now_ns, is_config=form is Form.CONFIG)

    def reset(self, now_ns: int, deaf_s: float = RESET_S) -> None:
        """Restart: deaf for `deaf_s`, limp, session values forgotten; then the first position."""
        self._deaf_until_ns = now_ns + ns_from_s(deaf_s)
        self.settings.restart()
        self.servo_id = self.settings.number("ID")
        self.baud_bps = self.settings.number("B") or self.baud_bps
        self._is_rc = self.settings.number("CRC") != 0
        self._motors.reset(self.index, now_ns)
        self._apply_session(now_ns)
        if self.settings.session.get("FD") is not None and not self._is_rc:
            self._moves.start_at(self.settings.physical("FD"), self._deaf_until_ns)

    def store(self, settings: Mapping[str, int], now_ns: int) -> None:
        """Take wire values by row name at once, for the session and for every later start."""
        self.settings.eeprom |= settings
        self.settings.session |= settings
        self.servo_id = self.settings.number("ID")
        self._apply_session(now_ns)

    def rescale(self, name: str, scale_ratio: float, now_ns: int) -> None:
        """Take, and answer, a value in another unit from now on."""
        self.settings.scale_ratios[name] = scale_ratio
        self._apply_session(now_ns)

    def _answer(self, command: Command, row: Row, now_ns: int) -> Reply:
        suffix = None
        if isinstance(command.value, int) and row.suffixes is not None:
            suffix = row.suffixes.get(command.value)
        value = self._readings.value(row, suffix, now_ns)
        if value is None and row.reply_shape is ReplyShape.DISABLED:
            value = DISABLED
        sender: int | None = self.servo_id
        if command.keyword == "QID" and command.servo_id == BROADCAST_ID:
            sender = self._broadcast_sender()
        return Reply(sender, command.keyword, value)

    def _broadcast_sender(self) -> int | None:
        """Return the id that stands before the answer to `#254QID` (FACTS.md C5)."""
        if self._table.family is Family.LSS_PRO:
            return BROADCAST_ID
        return self.servo_id if self._firmware >= ORDERED_FIRMWARE else None

    def _set(self, command: Command, row: Row, now_ns: int, *, is_config: bool) -> None:
        value = command.value
        if row.name == "CRC" and value not in {1, 2}:
            value = 0  # Any other value, or none: stay in smart mode (FACTS.md R14).
        is_needless = value is None and row.reply_shape is ReplyShape.DISABLED
        if isinstance(value, int) or is_needless:
            number = value if isinstance(value, int) else None
            if self.settings.write(row, number, is_config=is_config):
                self._apply(row, now_ns)

    def _confirm(self, armed: str | None, now_ns: int) -> None:
        if armed == "DEFAULT":
            self.settings.restore_factory()
        if armed is not None:
            self.reset(now_ns)

    def _apply_session(self, now_ns: int) -> None:
        self._moves.forget_ramps()
        self._apply_frame()
        self._apply_stiffness(now_ns)
        self._apply_duty()

    def _apply(self, row: Row, now_ns: int) -> None:
        match row.name:
            case "AA" | "AD" | "SD" | "SR":
                self._moves.forget_ramps()
            case "G" | "O":
                self._apply_frame()
            case "AS" | "AH":
                self._apply_stiffness(now_ns)
            case "MMD":
                self._apply_duty()
            case "FD" | "FP":  # CFP and CFD overwrite each other (FACTS.md C16).
                self.settings.eeprom["FP" if row.name == "FD" else "FD"] = None
            case _:
                pass

    def _apply_frame(self) -> None:
        self._motors.gyre[self.index] = self.settings.number("G") or 1
        self._motors.origin_deg[self.index] = self.settings.physical("O")

    def _apply_stiffness(self, now_ns: int) -> None:
        physics = self._motors.physics
        stiffer = self.settings.number("AS")
        firmer = self.settings.number("AH") - self.settings.factory("AH")
        self._motors.set_stiffness(
            self.index,
            now_ns,
            lag_ratio=physics.lag_per_stiffness_ratio**-stiffer,
            holding_ratio=physics.droop_per_stiffness_ratio**-firmer,
        )

    def _apply_duty(self) -> None:
        duty = self.settings.session.get("MMD")
        self._motors.power.duty_ratio[self.index] = 1.0 if duty is None else duty / DUTY_MAX
