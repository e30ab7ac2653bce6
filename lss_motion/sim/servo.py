"""The firmware of one smart servo: it executes commands and replies to queries.

`Servo` is what the bus calls. `Moves` turns motion commands into orders to the motor, `RcInput`
pulses in RC mode.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.protocol.codec import language_table
from lss_motion.protocol.constants import (
    BROADCAST_ID,
    DEG_S_PER_RPM,
    PULSE_MAX_US,
    PULSE_MIN_US,
    RESET_S,
    Blink,
    Family,
    Led,
)
from lss_motion.protocol.framing import DISABLED, Reply
from lss_motion.protocol.table import Form, ReplyShape
from lss_motion.sim.profile import FilterMove, Halt, Motion, PowerOff, ProfileMove, Ramps, Wheel
from lss_motion.sim.readings import PULSE_HALF_US, PULSE_MID_US, Readings, Settings
from lss_motion.units import ns_from_s, s_from_ms

if TYPE_CHECKING:
    from collections.abc import Mapping
    from random import Random

    from lss_motion.protocol.framing import Command
    from lss_motion.protocol.table import Row
    from lss_motion.robot.model import ServoModel
    from lss_motion.sim.motors import Motors
    from lss_motion.sim.physics import ServoSpec
    from lss_motion.sim.profile import Order


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
                self._order(now_ns, PowerOff(), {})
            case "H", _:
                self._order(now_ns, Halt(), {})
            case (("D" | "MD" | "P" | "M" | "WD" | "WR" | "MD_RAW"), None):
                pass
            case "D", int():
                self._go(command, self._settings.degrees("D", value), now_ns)
            case (("MD" | "P" | "M"), int()):
                self._go(command, self._asked_deg(name, value, now_ns), now_ns)
            case "WD", int():
                self._turn(command, self._settings.degrees("WD", value), now_ns)
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

    def wheel_at(self, speed_ratio: float, now_ns: int) -> None:
        """Turn without end at that share of the largest speed, from `now_ns` on."""
        ramps = self._session_ramps()
        raw_deg_s = self._motors.gyre[self._index] * speed_ratio * ramps.speed_deg_s
        self._order(now_ns, Wheel(raw_deg_s, ramps), {})

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
            case _:
                return readings.position_deg(now_ns) + self._settings.degrees("MD", value)

    def _go(self, command: Command, seen_deg: float, now_ns: int) -> None:
        """Move to an angle as the host sees it, with the modifiers that belong to the command."""
        settings = self._settings
        modifiers = self._modifiers(command)
        if settings.session.get("LE"):
            low_deg, high_deg = settings.physical("LN"), settings.physical("LP")
            seen_deg = min(max(seen_deg, low_deg), high_deg)
        raw_deg = self._motors.raw_deg(self._index, seen_deg)
        if not self._has_profile():
            is_repeated = settings.session.get("IPE", 1) != 0
            chase = FilterMove(raw_deg, settings.number("FPC"), is_repeated)
            self._order(now_ns, chase, modifiers)
            return
        ramps = self._session_ramps()
        if "SD" in modifiers and modifiers["SD"] < ramps.speed_deg_s:
            ramps = ramps._replace(speed_deg_s=modifiers["SD"])
        if "S" in modifiers:
            speed_deg_s = modifiers["S"] / self._readings.pulse_us_per_deg()
            ramps = ramps._replace(speed_deg_s=min(ramps.speed_deg_s, speed_deg_s))
        duration_s = s_from_ms(modifiers["T"]) if "T" in modifiers else None
        self._order(now_ns, ProfileMove(raw_deg, ramps, duration_s), modifiers)

    def _turn(self, command: Command, seen_deg_s: float, now_ns: int) -> None:
        ramps = self._session_ramps()
        speed_deg_s = min(max(seen_deg_s, -ramps.speed_deg_s), ramps.speed_deg_s)
        raw_deg_s = self._motors.gyre[self._index] * speed_deg_s
        wheel = Wheel(raw_deg_s, ramps if self._has_profile() else None)
        self._order(now_ns, wheel, self._modifiers(command))

    def _push(self, duty: int, now_ns: int) -> None:
        """Turn with a share of the motor's power and nothing that controls it (RDM)."""
        duty = min(max(duty, -DUTY_MAX), DUTY_MAX)
        self._settings.session["MD_RAW"] = duty
        top_deg_s = self._motors.gyre[self._index] * self._model.speed_max_deg_s
        self._order(now_ns, Wheel(top_deg_s * duty / DUTY_MAX, None, is_free=True), {})

    def _order(self, now_ns: int, order: Order, modifiers: dict[str, float]) -> None:
        limit: tuple[float, Halt | PowerOff] | None = None
        if "CL" in modifiers:  # It takes precedence over CH (FACTS.md M18).
            limit = (modifiers["CL"] * MA_PER_A, PowerOff())
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
            physics = self._motors.physics
            stiffness = self._settings.number("AS")
            ratio = physics.ramp_ratio * physics.ramp_per_stiffness_ratio**stiffness
            self._ramps = Ramps(
                speed_deg_s=min(self._at_least_one("SD"), self._model.speed_max_deg_s),
                accel_deg_s2=ratio * self._at_least_one("AA"),
                decel_deg_s2=ratio * self._at_least_one("AD"),
            )
        return self._ramps

    def _at_least_one(self, name: str) -> float:
        return self._settings.degrees(name, max(abs(self._settings.number(name)), 1))

    def _modifiers(self, command: Command) -> dict[str, float]:
        """Return the modifiers in physical units; those that do not belong here do nothing."""
        if not command.modifiers:
            return {}
        table = self._settings.table
        allowed = table.by_keyword[command.keyword][1].modifiers
        return {
            name: row.physical(value) * self._settings.scale_ratios.get(name, 1.0)
            for name, value in command.modifiers
            if name in allowed
            and (row := table.modifiers[name]).firmware <= self._firmware
            and row.allows(value)
        }


class Lamp(NamedTuple):
    """What the LED of a servo shows."""

    colour: Led
    is_blinking: bool


BLINK_OF: Final = {
    Motion.LIMP: Blink.LIMP,
    Motion.HOLDING: Blink.HOLDING,
    Motion.ACCELERATING: Blink.ACCELERATING,
    Motion.DECELERATING: Blink.DECELERATING,
    Motion.FREE_MOVING: Blink.FREE,
    Motion.TRAVELING: Blink.TRAVELING,
}
"""The states in which CLB lets the LED blink (FACTS.md C9)."""

RC_WHEEL: Final = 2
"""CRC2: a pulse is a speed, 1500 us is rest, and the ends of the range are the top speed. Assumed;
the page of the RC modes is not among our sources."""
RC_ESCAPE_FIRMWARE: Final = 362
"""First firmware that leaves RC mode after 30 s of a high level (FACTS.md V1)."""


class RcInput:
    """RC mode of servo `index`: pulses in place of the bus (FACTS.md R14)."""

    def __init__(
        self, index: int, motors: Motors, settings: Settings, readings: Readings, firmware: int
    ) -> None:
        self.is_on = settings.number("CRC") != 0
        self._index = index
        self._motors = motors
        self._settings = settings
        self._readings = readings
        self._can_escape = firmware >= RC_ESCAPE_FIRMWARE
        self._low_ns = 0

    def start(self, now_ns: int) -> None:
        self.is_on = self._settings.number("CRC") != 0
        self._low_ns = now_ns

    def is_deaf(self, now_ns: int) -> bool:
        """Return whether the bus is ignored. A line that is high for 30 s ends RC mode."""
        if not self.is_on:
            return False
        high_ns = ns_from_s(self._motors.physics.rc_escape_s)
        if self._can_escape and now_ns - self._low_ns >= high_ns:
            self.is_on = False
            self._settings.eeprom["CRC"] = self._settings.session["CRC"] = 0
        return self.is_on

    def note_line(self, now_ns: int) -> None:
        """Note a low level: a byte or a pulse."""
        if not self.is_deaf(now_ns) or not self._can_escape:
            return
        self._low_ns = now_ns

    def go_to_first(self, moves: Moves, now_ns: int) -> None:
        """Go to the first position and hold it for up to 2 s; without one stay limp."""
        first_us = self._settings.session.get("FP")
        if first_us is not None:
            self._aim(first_us, moves, now_ns)
            self._limp_later(now_ns)

    def take_pulse(self, pulse_us: int | None, moves: Moves, now_ns: int) -> None:
        self.note_line(now_ns)
        if not self.is_on:
            return
        self._motors.cancel(self._index, now_ns)
        if pulse_us is None:
            self._limp_later(now_ns)
        else:
            self._aim(pulse_us, moves, now_ns)

    def _aim(self, pulse_us: int, moves: Moves, now_ns: int) -> None:
        away_us = min(max(pulse_us, PULSE_MIN_US), PULSE_MAX_US) - PULSE_MID_US
        if self._settings.number("CRC") == RC_WHEEL:
            moves.wheel_at(away_us / PULSE_HALF_US, now_ns)
        else:
            moves.start_at(away_us / self._readings.pulse_us_per_deg(), now_ns)

    def _limp_later(self, now_ns: int) -> None:
        limp_ns = now_ns + ns_from_s(self._motors.physics.rc_limp_s)
        self._motors.order(self._index, limp_ns, PowerOff())


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
        self.deaf_until_ns = 0
        self._rc = RcInput(index, motors, self.settings, self._readings, firmware)
        self._armed: str | None = None
        self._apply_session(0)

    def connect_usb(self) -> None:
        """Be the servo at the end of the USB cable."""
        self._readings.has_usb = True

    def power_up(self, now_ns: int) -> None:
        """Start with the stored values: RC mode, and a first position (FACTS.md R6, R14)."""
        self._rc.start(now_ns)
        if self._rc.is_on:
            self._rc.go_to_first(self._moves, now_ns)
        elif self.settings.session.get("FD") is not None:
            self._moves.start_at(self.settings.physical("FD"), now_ns)

    def take_pulse(self, pulse_us: int | None, now_ns: int) -> None:
        """Take RC pulses of that width from now on; None: they end. Only RC mode obeys them."""
        if self._rc.is_on:
            self._rc.take_pulse(pulse_us, self._moves, now_ns)

    @property
    def is_in_rc_mode(self) -> bool:
        return self._rc.is_on

    def note_line(self, now_ns: int) -> None:
        """Note that bytes are on the line, so that it is not constantly high."""
        self._rc.note_line(now_ns)

    def lamp(self, now_ns: int) -> Lamp:
        """Return what its LED shows (FACTS.md C9, S4)."""
        motion = self._motors.motion(self.index, now_ns)
        if motion is Motion.SAFE_MODE:
            return Lamp(Led.RED, is_blinking=True)
        blink = BLINK_OF.get(motion, Blink(0))
        return Lamp(
            Led(self.settings.number("LED")),
            is_blinking=bool(self.settings.number("LB") & blink),
        )

    @property
    def family(self) -> Family:
        return self._table.family

    def is_listening(self, now_ns: int) -> bool:
        return now_ns >= self.deaf_until_ns and not (self._rc.is_on and self._rc.is_deaf(now_ns))

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
            measure = self._readings.measured.get(row.name)
            if measure is None or command.value is not None:
                return self._answer(command, row, now_ns)
            return Reply(self.servo_id, command.keyword, measure(now_ns))
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
        self.deaf_until_ns = now_ns + ns_from_s(deaf_s)
        self.settings.restart()
        self.servo_id = self.settings.number("ID")
        self.baud_bps = self.settings.number("B") or self.baud_bps
        self._motors.reset(self.index, now_ns)
        self._apply_session(now_ns)
        self.power_up(self.deaf_until_ns)

    def renew(self, settings: Mapping[str, int], now_ns: int, deaf_s: float) -> None:
        """Restart with `settings`, and those of the factory but for the id and the baud rate."""
        own = {name: self.settings.eeprom[name] for name in ("ID", "B")}
        self.settings.restore_factory({**own, **settings})
        self.reset(now_ns, deaf_s)

    def exchange(self, settings: Mapping[str, int], now_ns: int, deaf_s: float) -> None:
        """Be another servo at the same place from now on."""
        self._readings.serial_number = f"{(int(self._readings.serial_number) + 1):08}"
        self.renew(settings, now_ns, deaf_s)

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
        self._apply_duty(now_ns)

    def _apply(self, row: Row, now_ns: int) -> None:
        match row.name:
            case "AA" | "AD" | "SD" | "SR":
                self._moves.forget_ramps()
            case "G" | "O":
                self._apply_frame()
            case "AS" | "AH":
                self._moves.forget_ramps()
                self._apply_stiffness(now_ns)
            case "MMD":
                self._apply_duty(now_ns)
            case "SM":
                self._apply_duty(now_ns)
                self._apply_stiffness(now_ns)
            case "FD" | "FP":  # CFP and CFD overwrite each other (FACTS.md C16).
                self.settings.eeprom["FP" if row.name == "FD" else "FD"] = None
            case _:
                pass

    def _apply_frame(self) -> None:
        self._motors.gyre[self.index] = float(self.settings.number("G") or 1)
        self._motors.origin_deg[self.index] = self.settings.physical("O")

    def _apply_stiffness(self, now_ns: int) -> None:
        physics = self._motors.physics
        stiffer = self.settings.number("AS")
        firmer = self.settings.number("AH") - self.settings.factory("AH")
        self._motors.set_stiffness(
            self.index,
            now_ns,
            lag_ratio=physics.lag_per_stiffness_ratio**-stiffer,
            holding_ratio=physics.droop_per_stiffness_ratio**-firmer / self._torque_ratio(),
        )

    def _torque_ratio(self) -> float:
        """Return the share of the torque that the step mode leaves (SM; FACTS.md P8)."""
        halvings = math.log2((self.settings.number("SM") or 1) / (self.settings.factory("SM") or 1))
        return float(self._motors.physics.torque_per_step_mode_ratio**halvings)

    def _apply_duty(self, now_ns: int) -> None:
        duty = self.settings.session.get("MMD")
        ratio = 1.0 if duty is None else duty / DUTY_MAX
        steps = self.settings.number("SM")
        if steps:
            ratio *= self.settings.factory("SM") / steps
        self._motors.set_duty(self.index, now_ns, ratio)
