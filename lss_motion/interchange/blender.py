"""JSON of the Blender add-on for servo animation: one position per frame and servo.

Version 2 has a list of `{"<servo id>": position}`, version 1 has a list of positions per servo. A
servo that is missing in a frame keeps its position. The unit of the positions depends on the set-up
of the animator (often microseconds, or ticks of a PWM board), so a map must define it. Files that
this package wrote contain the unit in `unit`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.interchange.fields import JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import (
    DIGITS,
    FPS_MAX,
    VALUES_MAX,
    Channel,
    Unit,
    recording,
    summarised,
)

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray, ForeignMotion

TENTHS: Final = "0.1 deg"
"""Value of `unit` in exported files, an addition of this package: joint angles in 0.1 deg."""

_ABOUT: Final = ("description", "file", "scene", "armature")
_KNOWN: Final = frozenset(
    {*_ABOUT, "fps", "frames", "seconds", "bones", "positions", "servos", "unit", "names"}
)


class BlenderReader(Struct, frozen=True):
    """Reads `{"fps", "positions": [{id: position}]}` and `{"fps", "servos": {id: {...}}}`."""

    name: str = "blender"

    def recognises(self, data: bytes) -> bool:
        is_object = starts_json(data, b"{") and b'"positions"' in data
        return is_object and b'"fps"' in data

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        fields = JsonFields(path)
        top = fields.mapping(parsed_json(path, data), "the file")
        fps = fields.number(top, "fps", "the file")
        if not 0.0 < fps <= FPS_MAX:
            fields.refuse(f"fps is {fps:g}, but must be more than 0 and at most {FPS_MAX:g}")
        columns = _by_servo(fields, top) if "servos" in top else _by_frame(fields, top)
        is_exported = top.get("unit") == TENTHS
        channels = [
            Channel(
                name=name,
                unit=Unit.DEG if is_exported else Unit.RAW,
                times_s=np.round(frames / fps, DIGITS),
                values=values / 10.0 if is_exported else values,
            )
            for name, (frames, values) in columns.items()
        ]
        comments = (
            f"Imported from {path.name} (Blender servo animation, {fps:g} frames a second).",
            *(f"{key}: {top[key]}" for key in _ABOUT if isinstance(top.get(key), str)),
            *summarised([key for key in top if key not in _KNOWN and top[key]]),
        )
        return (recording(path, path.stem, channels, comments=comments),)


_Columns = dict[str, "tuple[FloatArray, FloatArray]"]


def _by_servo(fields: JsonFields, top: dict[str, object]) -> _Columns:
    columns: _Columns = {}
    for servo, entry in fields.mapping(top["servos"], "servos").items():
        where = f"servos.{servo:.40}"
        listed = fields.items(fields.mapping(entry, where), "positions", where)
        values = [fields.plain_number(v, f"{where}.positions[{i}]") for i, v in enumerate(listed)]
        columns[servo] = (np.arange(len(values), dtype=np.float64), np.array(values))
    if not columns:
        fields.refuse("servos names no servo")
    return columns


def _by_frame(fields: JsonFields, top: dict[str, object]) -> _Columns:
    """Return frames and positions of each servo; missing positions repeat the one before."""
    frames = [
        fields.mapping(entry, f"positions[{index}]")
        for index, entry in enumerate(fields.items(top, "positions", "the file"))
    ]
    names = fields.mapping(top.get("names", {}), "names")
    servos = dict.fromkeys(servo for frame in frames for servo in frame)
    if not servos:
        fields.refuse("positions names no servo in any frame")
    if len(servos) * len(frames) > VALUES_MAX:
        fields.refuse(f"{len(servos)} servos in {len(frames)} frames: more than {VALUES_MAX:,}")
    columns: _Columns = {}
    for servo in servos:
        first = next(index for index, frame in enumerate(frames) if servo in frame)
        values: list[float] = []
        for index, frame in enumerate(frames[first:], start=first):
            given = servo in frame
            values.append(
                fields.number(frame, servo, f"positions[{index}]") if given else values[-1]
            )
        name = names.get(servo)
        frame_numbers = np.arange(first, len(frames), dtype=np.float64)
        columns[name if isinstance(name, str) else servo] = (frame_numbers, np.array(values))
    return columns
