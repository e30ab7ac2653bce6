"""Backup files: every setting that servos store, to be written back as it was.

Settings stand there as wire values, so that nothing depends on what a unit is taken to be; the
comments say what they mean.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from lss_motion.files.source import known_names
from lss_motion.files.yaml_source import Problem, read_yaml
from lss_motion.maintenance.discovery import family_of
from lss_motion.maintenance.settings import value_text
from lss_motion.protocol.codec import storable

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from lss_motion.maintenance.settings import Values

OFF: Final = "off"
"""How a first position that is switched off stands in the file."""

_HEAD: Final = """\
# What {count} servos stored; written by `lss-motion configure --backup`. To write it back:
# `lss-motion configure --restore THIS_FILE`. The values are those of the wire.
backup: 1
servos:
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoBackup:
    """The settings of one servo, and how to know it again."""

    bus: str
    servo_id: int
    model: str
    serial_number: str = ""
    settings: Values = field(default_factory=dict)


def backup_text(servos: Iterable[ServoBackup]) -> str:
    """Return the text of a backup file."""
    servos = list(servos)
    text = _HEAD.format(count=len(servos))
    for kept in servos:
        text += f"  - bus: {_quoted(kept.bus)}\n    id: {kept.servo_id}\n"
        text += f"    model: {_quoted(kept.model)}\n"
        text += f"    serial_number: {_quoted(kept.serial_number)}\n    settings:\n"
        rows = storable(family_of(kept.model))
        for name, wire in kept.settings.items():
            row = rows[name]
            shown = f"{name}: {_quoted(OFF) if wire is None else wire}"
            text += f"      {shown:16}# {row.meaning}: {value_text(row, wire)}\n"
    return text


def read_backup(path: Path) -> list[ServoBackup]:
    """Return the servos of a backup file. Raises `InputError` with file and line."""
    from lss_motion.files.validation import validate
    from lss_motion.maintenance.backup_file import BackupFile

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


def _quoted(text: str) -> str:
    return f'"{text}"'
