"""The settings of servos: queries, differences from the wanted values, commands to write, backups.

Values are wire values by the name of their row; None is a first position that is switched off.
A backup file holds them all, so that they can be written back unchanged however a unit is
interpreted; comments give the meaning of each value. `frame_of` and `moved_origin` are zero and
direction of a joint, computed from positions to which a person moved it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct, field

from lss_motion.errors import InputError
from lss_motion.files.keys import FILE_VERSION, VERSION, Field, FileModel, Name, Text, Version
from lss_motion.files.texts import known_names
from lss_motion.files.validation import validate
from lss_motion.files.yaml_source import Mistake, read_yaml
from lss_motion.playing.discovery import SETTINGS, family_of, physical_limits, with_limits
from lss_motion.playing.player.checks import expected_frame
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.codec import Language, language_table, storable
from lss_motion.protocol.constants import ID_MAX, Family, Led
from lss_motion.protocol.framing import DISABLED, Command
from lss_motion.protocol.lss_pro import UNITS, Units
from lss_motion.protocol.table import Device, ReplyShape, Suffix

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence
    from pathlib import Path

    from lss_motion.playing.player.handshake import Answers
    from lss_motion.protocol.table import Row
    from lss_motion.robot.model import Joint, Robot

Values = dict[str, int | None]

RC_MODE: Final = "CRC"
BAUD: Final = "B"
LEAVING: Final = (RC_MODE, BAUD)
"""A servo with one of these changed no longer answers on its line after a RESET."""
FRAME: Final = ("G", "O")
"""Direction and origin, which define what an angle means."""
FIRST: Final = ("FP", "FD")
"""The two first positions; writing one erases the other (FACTS.md C16)."""


class Target(Struct, frozen=True, kw_only=True):
    """A servo whose settings are read or written. `model` is the answer to `QMS`."""

    name: str
    bus: str
    servo_id: int
    model: str
    family: Family
    firmware: int | None
    """What it answers to QF; None: it did not answer."""
    units: Units = UNITS

    @property
    def language(self) -> Language:
        """What the tables of `protocol.codec` are found with."""
        return Language(self.family, self.units)

    @property
    def device(self) -> Device | None:
        """Return which part of a 2IO it is (FACTS.md B2); None: a smart servo."""
        if self.family is not Family.IO2:
            return None
        if self.model.endswith("-LED"):
            return Device.MASTER
        return Device.ANALOG if "-A" in self.model else Device.SERVO

    def rows(self, *, is_session: bool) -> Mapping[str, Row]:
        """Return the settings that can be read and written: stored, or those of the session."""
        return {
            name: row
            for name, row in storable(self.language).items()
            if row.queries
            and row.firmware <= (self.firmware or 0)
            and (not row.devices or self.device in row.devices)
            and (not is_session or row.actions)
        }


class SettingChange(Struct, frozen=True, kw_only=True):
    """A setting that differs from the wanted value."""

    target: Target
    row: Row
    had: int | None
    wanted: int | None

    def __str__(self) -> str:
        had, wanted = value_text(self.row, self.had), value_text(self.row, self.wanted)
        return f"{self.target.name}: {self.row.meaning} ({self.row.name}) {had} → {wanted}"


def questions(target: Target, rows: Mapping[str, Row], *, is_session: bool) -> list[Item]:
    """Return the queries for the stored values, or for those of the session."""
    items = []
    for row in rows.values():
        is_stored_asked = Suffix.CONFIGURED in (row.suffixes or {}).values() and not is_session
        command = Command(target.servo_id, row.queries[0], 1 if is_stored_asked else None)
        items.append(Item(bus=target.bus, command=command))
    return items


def values(target: Target, rows: Mapping[str, Row], answers: Answers) -> Values:
    """Return the values that answer `questions`; without an answer a setting is absent."""
    found: Values = {}
    for name, row in rows.items():
        address = (target.bus, target.servo_id, row.queries[0])
        value = answers.get(address)
        if isinstance(value, int):
            found[name] = value
        elif value == DISABLED and row.reply_shape is ReplyShape.DISABLED:
            found[name] = None
    return found


def changes(target: Target, had: Values, wanted: Mapping[str, int | None]) -> list[SettingChange]:
    """Return what must be written, in the order of writing.

    A setting that cannot be read back, such as RC mode, is always written. Of the two first
    positions, which overwrite each other, the wanted one is written last.
    """
    rows = storable(target.language)
    needed = [
        SettingChange(target=target, row=rows[name], had=had.get(name), wanted=wanted[name])
        for name in rows
        if name in wanted and (name not in had or had[name] != wanted[name])
    ]
    return sorted(needed, key=lambda change: change.wanted is not None and change.row.name in FIRST)


def orders(needed: Iterable[SettingChange], *, is_session: bool) -> list[Item]:
    """Return the commands that write changes."""
    items = []
    for change in needed:
        keyword = (change.row.actions if is_session else change.row.configs)[0]
        command = Command(change.target.servo_id, keyword, change.wanted)
        items.append(Item(bus=change.target.bus, command=command))
    return items


def goes_limp(change: SettingChange, *, is_session: bool) -> bool:
    """Return whether a servo goes limp while a change is written: for a RESET, or for safety."""
    return change.row.name in FRAME or (change.row.needs_reset and not is_session)


def limp_orders(needed: Iterable[SettingChange]) -> list[Item]:
    """Return the commands that release the servos whose angles change their meaning.

    A servo that holds a position might turn to that position in the new frame (FACTS.md R11).
    """
    return [
        Item(bus=target.bus, command=Command(target.servo_id, "L"))
        for target in {change.target for change in needed if change.row.name in FRAME}
    ]


def dangers(needed: Sequence[SettingChange], baud_bps: int) -> list[str]:
    """Return the reasons why changes would make a servo unreachable at `baud_bps`."""
    found = []
    for change in needed:
        servo = f"{change.target.name} (id {change.target.servo_id})"
        if change.row.name == RC_MODE and change.wanted:
            found.append(
                f"{servo}: in RC mode it receives nothing from the bus; only its button ends that"
            )
        if change.row.name == BAUD and change.wanted != baud_bps:
            found.append(
                f"{servo}: at {change.wanted} bps it would not receive this line, which runs at "
                f"{baud_bps}; --new-baud changes all servos of a line together"
            )
    return found


def value_text(row: Row, wire: int | None) -> str:
    """Return a value as text: with its unit, and with the name of a colour."""
    if wire is None:
        return "off"
    unit = f" {row.unit}" if row.unit else ""
    text = f"{row.physical(wire):.12g}{unit}"
    is_colour = row.name == "LED" and wire in {int(led) for led in Led}
    return f"{text} ({Led(wire).name.lower()})" if is_colour else text


MOVED_MIN_DEG: Final = 5.0
"""The smallest push that shows a direction. Chosen: far above backlash and noise, easy to do."""

ZERO_DECIMALS: Final = 1
"""Servos report tenths of a degree."""


class JointFrame(Struct, frozen=True, kw_only=True):
    """The relation of joint and servo angles: `servo_deg = zero_deg + direction * joint_deg`."""

    zero_deg: float
    direction: Literal[1, -1]


def frame_of(
    joint: Joint, *, servo_deg: float, pose_deg: float, pushed_deg: float | None
) -> JointFrame | None:
    """Return the frame of a joint that stands at `pose_deg` while its servo reports `servo_deg`.

    `pushed_deg` is the servo angle after a push towards larger joint angles, or None to keep the
    direction of the robot file. Returns None if the push was too small.
    """
    direction: Literal[1, -1] = joint.direction
    if pushed_deg is not None:
        if abs(pushed_deg - servo_deg) < MOVED_MIN_DEG:
            return None
        direction = 1 if pushed_deg > servo_deg else -1
    zero_deg = round(servo_deg - direction * pose_deg, ZERO_DECIMALS) + 0.0
    return JointFrame(zero_deg=zero_deg, direction=direction)


def stated_frame(joint: Joint, wires: Mapping[str, int]) -> dict[str, float]:
    """Return which settings `stored:` must state so that the file has those of the servo.

    `wires` are gyre (G) and origin (O) of the servo, in wire units.
    """
    rows, expected = storable(joint.model.language), expected_frame(joint)
    return {
        name: rows[name].physical(wire)
        for name, wire in wires.items()
        if name in expected and expected[name] != wire
    }


def moved_origin(joint: Joint, *, origin_wire: int, gyre: int, zero_deg: float) -> int:
    """Return the origin offset (wire unit) that makes the servo report 0 at its present `zero_deg`.

    A servo reports `gyre * (raw - origin)`; the offset is kept within half a turn.
    """
    row = language_table(joint.model.language).row("O")
    turn, moved = row.wire(360.0), origin_wire + gyre * row.wire(zero_deg)
    return (moved + turn // 2) % turn - turn // 2


OFF: Final = "off"
"""The value in the file of a first position that is switched off."""

_HEAD: Final = """\
# What {count} servos stored; written by `lss-motion configure --backup`. To write it back:
# `lss-motion configure --restore THIS_FILE`. The values are those of the wire.
backup: 1
servos:
"""


class ServoEntry(FileModel, title="servo"):
    """The stored settings of one servo, and what identifies it."""

    bus: Name = Field(description="Name of the bus in the robot file.")
    id: int = Field(ge=0, le=ID_MAX, description="Id of the servo.")
    model: Text = Field(description="The answer to QMS.")
    serial_number: Text | Literal[""] = Field(default="", description="The answer to QN.")
    settings: dict[Text, int | Literal["off"]] = Field(
        description="Wire values by keyword; off: no first position."
    )


class BackupFile(FileModel, title="backup file"):
    """The settings of some servos."""

    version: Version = Field(default=FILE_VERSION, description=VERSION)
    backup: Literal[1] = Field(description="Form of the file.")
    servos: list[ServoEntry] = Field(min_length=1)


class ServoBackup(Struct, frozen=True, kw_only=True):
    """The settings of one servo, and what identifies it."""

    bus: str
    servo_id: int
    model: str
    serial_number: str = ""
    settings: Values = field(default_factory=dict)


def backup_text(servos: Iterable[ServoBackup]) -> str:
    """Return the text of a backup file."""
    servos = list(servos)
    text = _HEAD.format(count=len(servos))
    for servo in servos:
        text += f"  - bus: {_quoted(servo.bus)}\n    id: {servo.servo_id}\n"
        text += f"    model: {_quoted(servo.model)}\n"
        text += f"    serial_number: {_quoted(servo.serial_number)}\n    settings:\n"
        rows = storable(family_of(servo.model))
        for name, wire in servo.settings.items():
            row = rows[name]
            shown = f"{name}: {_quoted(OFF) if wire is None else wire}"
            text += f"      {shown:16}# {row.meaning}: {value_text(row, wire)}\n"
    return text


def read_backup(path: Path) -> list[ServoBackup]:
    """Return the servos of a backup file. Raises `InputError` with file and line."""
    source = read_yaml(path)
    content, problems, _ = validate(BackupFile, source)
    servos = [] if content is None else content.servos
    for index, servo in enumerate(servos):
        rows = storable(family_of(servo.model))
        problems += [
            Mistake(
                ("servos", index, "settings", name),
                f"unknown setting {name!r}; {known_names(name, rows)}",
            )
            for name in servo.settings
            if name not in rows
        ]
    if problems or content is None:
        raise source.error(problems)
    return [
        ServoBackup(
            bus=servo.bus,
            servo_id=servo.id,
            model=servo.model,
            serial_number=servo.serial_number,
            settings={
                name: value if isinstance(value, int) else None
                for name, value in servo.settings.items()
            },
        )
        for servo in servos
    ]


def with_backup(robot: Robot, backup: Path | None) -> Robot:
    """Return the robot with the limits that its file leaves to the servos, from this backup."""
    if backup is None or not robot.unread:
        return robot
    return robot_from_backup(robot, read_backup(backup), backup)


def robot_from_backup(robot: Robot, kept: Iterable[ServoBackup], path: Path) -> Robot:
    """Return the robot with the limits that its servos stored when the backup was made.

    Raises `InputError` for a servo that the backup does not hold, and for a limit of 0.
    """
    stored = {(servo.bus, servo.servo_id): servo.settings for servo in kept}

    def wire(joint: Joint, name: str) -> int | None:
        return stored.get((joint.bus, joint.servo_id), {}).get(name)

    known = with_limits(robot, physical_limits(robot, wire))
    for joint in known.unread:
        raise InputError(
            f"holds no {' and '.join(n for key in sorted(joint.unread) for n in SETTINGS[key])} of "
            f"servo {joint.servo_id} on bus {joint.bus!r} (joint {joint.name!r}); make a new "
            f"backup",
            path=path,
        )
    return known


def _quoted(text: str) -> str:
    return f'"{text}"'
