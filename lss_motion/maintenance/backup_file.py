"""The keys of a backup file. Importing this module imports pydantic: import it to read one."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from lss_motion.files.validation import FileModel, Name, Text
from lss_motion.protocol.constants import ID_MAX


class ServoEntry(FileModel, title="servo"):
    """What one servo stored, and how to know it again."""

    bus: Name = Field(description="Name of the bus in the robot file.")
    id: int = Field(ge=0, le=ID_MAX, description="Id of the servo.")
    model: Text = Field(description="What QMS says.")
    serial_number: Text | Literal[""] = Field(default="", description="What QN says.")
    settings: dict[Text, int | Literal["off"]] = Field(
        description="Wire values by keyword; off: no first position."
    )


class BackupFile(FileModel, title="backup file"):
    """The settings of some servos."""

    backup: Literal[1] = Field(description="Form of the file.")
    servos: Annotated[list[ServoEntry], Field(min_length=1)]
