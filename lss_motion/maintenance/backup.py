"""Backup files: every setting that servos store, so that it can be written back unchanged.

The file holds wire values, so it does not depend on how a unit is interpreted; comments give the
meaning of each value.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct, field

from lss_motion.errors import InputError
from lss_motion.files.keys import Field, FileModel, Name, Text
from lss_motion.files.texts import known_names
from lss_motion.files.validation import validate
from lss_motion.files.yaml_source import Problem, read_yaml
from lss_motion.maintenance.settings import value_text
from lss_motion.playing.discovery import family_of
from lss_motion.playing.stored_limits import SETTINGS, physical_limits, with_limits
from lss_motion.protocol.codec import storable
from lss_motion.protocol.constants import ID_MAX

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from lss_motion.maintenance.settings import Values
    from lss_motion.robot.model import Joint, Robot

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
            Problem(
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
