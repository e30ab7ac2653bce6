"""Keyframe JSON of the Bit-Bots humanoids: goals in degrees, durations and pauses in seconds.

A keyframe is reached `duration` after the end of the pause before it (the first one: after the
start), and is held for `pause`. The file does not contain the pose before the first keyframe.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.interchange.fields import JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import Pose, motion_label, motion_of_poses, summarised

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

_ABOUT: Final = ("author", "description", "last_edited", "version")
"""Keys that are copied into comments, for people only."""

_KEYFRAME_KEYS: Final = frozenset({"duration", "pause", "goals", "name"})


class BitBotsReader(Struct, frozen=True):
    """Reads `{"name", "keyframes": [{"duration", "pause", "goals": {joint: deg}, "name"}]}`."""

    name: str = "bitbots"

    def recognises(self, data: bytes) -> bool:
        return starts_json(data, b"{") and b'"keyframes"' in data and b'"goals"' in data

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        return (self.read(path, data),)

    def read(self, path: Path, data: bytes) -> ForeignMotion:
        """Return the one motion of the file, or raise `InputError`."""
        fields = JsonFields(path)
        top = fields.mapping(parsed_json(path, data), "the file")
        entries = [
            fields.mapping(entry, f"keyframes[{index}]")
            for index, entry in enumerate(fields.items(top, "keyframes", "the file"))
        ]
        poses: list[Pose] = []
        for index, entry in enumerate(entries):
            end_s = poses[-1].at_s + poses[-1].hold_s if poses else 0.0
            poses.append(_pose(fields, entry, index, end_s))
        return motion_of_poses(
            path,
            motion_label(top.get("name")),
            poses,
            comments=(
                f"Imported from {path.name} (Bit-Bots keyframes).",
                *(f"{key}: {top[key]}" for key in _ABOUT if top.get(key)),
                *_not_carried(top, entries),
            ),
        )


def _pose(fields: JsonFields, entry: dict[str, object], index: int, end_s: float) -> Pose:
    where = f"keyframes[{index}]"
    duration_s = fields.duration(entry, "duration", where)
    if duration_s == 0.0 and index > 0:
        fields.refuse(f"{where}.duration is 0, but must be more than 0 s")
    goals = fields.mapping(entry.get("goals"), f"{where}.goals")
    if not goals:
        fields.refuse(f"{where}.goals names no joint")
    return Pose(
        at_s=end_s + duration_s,
        values={joint: fields.number(goals, joint, f"{where}.goals") for joint in goals},
        hold_s=fields.duration(entry, "pause", where),
        label=motion_label(entry.get("name")),
        place=where,
    )


def _not_carried(top: dict[str, object], entries: list[dict[str, object]]) -> tuple[str, ...]:
    """Return a comment for every key that has a value and is not imported."""
    known = {"name", "keyframes", *_ABOUT}
    found = [key for key, value in top.items() if key not in known and value]
    for entry in entries:
        found += [
            f"keyframes: {k}" for k, value in entry.items() if k not in _KEYFRAME_KEYS and value
        ]
    return summarised(found)
