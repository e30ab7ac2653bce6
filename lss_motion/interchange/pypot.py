"""Recorded moves of pypot (Poppy robots): degrees at measured times, in any order."""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec import Struct

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import Pose, motion_of_poses, summarised

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion


class PypotReader(Struct, frozen=True):
    """Reads `{"framerate", "positions": {"<seconds>": {motor: [deg, deg/s]}}}`."""

    name: str = "pypot"

    def recognises(self, data: bytes) -> bool:
        keys = (b'"framerate"', b'"positions"')
        return starts_json(data, b"{") and all(key in data for key in keys)

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        fields = JsonFields(path)
        top = fields.mapping(parsed_json(path, data), "the file")
        listed = fields.mapping(top.get("positions"), "positions")
        poses = sorted(
            (_pose(fields, key, positions) for key, positions in listed.items()),
            key=lambda pose: pose.at_s,
        )
        found = [key for key in top if key not in {"framerate", "positions"} and top[key]]
        comments = (
            f"Imported from {path.name} (pypot move): {counted(poses, 'sample')} at measured "
            "times.",
            *summarised(["recorded speeds", *found]),
        )
        return (motion_of_poses(path, path.stem, poses, comments=comments),)


def _pose(fields: JsonFields, key: str, positions: object) -> Pose:
    where = f"positions.{key:.40}"
    try:
        at_s = float(key)
    except ValueError:
        fields.refuse(f"{where}: the name must be a time in seconds")
    return Pose(
        at_s=fields.plain_number(at_s, where),
        values={
            motor: fields.plain_number(
                value[0] if isinstance(value, list) and value else value, f"{where}.{motor}"
            )
            for motor, value in fields.mapping(positions, where).items()
        },
        place=where,
    )
