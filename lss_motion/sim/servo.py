"""The firmware of one smart servo: what it does and answers when it hears a command."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.families import FAMILY_TABLES
from lss_motion.protocol.family import Family
from lss_motion.protocol.line import DISABLED, Reply
from lss_motion.protocol.table import Answer, Form
from lss_motion.sim.moves import DUTY_MAX, Moves
from lss_motion.sim.physics import RESET_NS
from lss_motion.sim.readings import Readings
from lss_motion.sim.settings import Settings

if TYPE_CHECKING:
    from random import Random

    from lss_motion.protocol.line import Command
    from lss_motion.protocol.table import Row
    from lss_motion.sim.motors import Motors
    from lss_motion.sim.physics import ServoSpec

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
        table = FAMILY_TABLES[spec.model.family]
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

    def is_listening(self, now_ns: int) -> bool:
        return now_ns >= self._deaf_until_ns and not self._is_rc

    def obey(self, command: Command, now_ns: int) -> Reply | None:
        """Act on one command heard at `now_ns`; return the answer to a query.

        What the servo does not know, it passes over in silence.
        """
        armed, self._armed = self._armed, None
        found = self._table.by_keyword.get(command.keyword)
        if found is None or found[1].firmware > self._firmware:
            return None
        form, row = found
        match form, row.name:
            case Form.QUERY, _:
                return self._answer(command, row, now_ns)
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
        return None

    def reset(self, now_ns: int) -> None:
        """Restart: deaf for 1.25 s, limp, session values forgotten; then the first position."""
        self._deaf_until_ns = now_ns + RESET_NS
        self.settings.restart()
        self.servo_id = self.settings.number("ID")
        self.baud_bps = self.settings.number("B") or self.baud_bps
        self._is_rc = self.settings.number("CRC") != 0
        self._motors.reset(self.index, now_ns)
        self._apply_session(now_ns)
        if self.settings.session.get("FD") is not None and not self._is_rc:
            self._moves.start_at(self.settings.physical("FD"), self._deaf_until_ns)

    def _answer(self, command: Command, row: Row, now_ns: int) -> Reply:
        suffix = None
        if isinstance(command.value, int) and row.suffixes is not None:
            suffix = row.suffixes.get(command.value)
        value = self._readings.value(row, suffix, now_ns)
        if value is None and row.answer is Answer.DISABLED:
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
        is_needless = value is None and row.answer is Answer.DISABLED
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
