"""Motion capture as BVH text: a skeleton, and a row of channels for each frame.

The channels of a rotation are angles about the axes of its joint, applied in the order of the file.
Each is offered as `joint.Zrotation`, in degrees. Servos of a figure seldom stand in that order, so
a joint with several rotations also offers its turn about each single axis as `joint.x`, `joint.y`
and `joint.z`: the twist of its whole rotation about that axis, whatever the order. A map file
chooses among them. Where the figure stands in the room is not carried over.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import (
    VALUES_MAX,
    Channel,
    Measure,
    Reader,
    motion_name,
    recording,
    summarised,
)

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray, ForeignMotion

HEADER: Final = "HIERARCHY"
CHANNELS_MAX: Final = 6
"""Of one joint: a position and a rotation."""
JOINTS_MAX: Final = 1_000
"""Chosen: a skeleton with fingers and face has about 150."""
FRAME_MIN_S: Final = 0.0005
"""Chosen: 2,000 frames a second, twice what the fastest cameras of motion capture deliver."""
FRAME_MAX_S: Final = 10.0
FRAMES_MAX: Final = VALUES_MAX
AXES: Final = "xyz"

_KIND: Final = re.compile(r"(x|y|z)(position|rotation)", re.IGNORECASE)
_FRAMES: Final = re.compile(r"frames\s*:\s*(\S+)", re.IGNORECASE)
_FRAME_TIME: Final = re.compile(r"frame\s*time\s*:\s*(\S+)", re.IGNORECASE)


def _is_bvh(data: bytes) -> bool:
    return text_head(data, 1024).lstrip().upper().startswith(HEADER.encode())


def _bvh_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    lines = TextLines.of(path, data)
    rows = list(lines.numbered())
    begin = next((n for n, (_, row) in enumerate(rows) if row.upper() == "MOTION"), None)
    if begin is None:
        lines.refuse(None, "has no line MOTION: it was cut off, or is a skeleton only")
    joints = _skeleton(lines, rows[:begin])
    frame_s, values = _frames(lines, rows[begin:], sum(len(joint.kinds) for joint in joints))
    times_s = np.arange(len(values), dtype=np.float64) * frame_s
    channels: list[Channel] = []
    left_out: list[str] = []
    column = 0
    for joint in joints:
        own = values[:, column : column + len(joint.kinds)]
        column += len(joint.kinds)
        if any(kind.lower().endswith("position") for kind in joint.kinds):
            left_out.append(f"the place of {joint.name} in the room")
        channels += _turns(joint, times_s, own)
    if not channels:
        lines.refuse(None, "has no channel that is a rotation")
    comments = (f"Imported from {path.name} (BVH motion capture).", *summarised(left_out))
    return (recording(path, motion_name(path), channels, comments=comments),)


BVH: Final = Reader("bvh", _is_bvh, _bvh_motions)
"""Reads `HIERARCHY … MOTION …`; degrees, at the frames' distance."""


class _BvhJoint(Struct, frozen=True):
    name: str
    kinds: tuple[str, ...]


def _skeleton(lines: TextLines, rows: Sequence[tuple[int, str]]) -> list[_BvhJoint]:
    """Return the joints in the order of their columns; raises `InputError`."""
    joints: dict[str, _BvhJoint] = {}
    name, depth = "", 0
    for number, row in rows[1:]:
        words = row.replace("{", " { ").replace("}", " } ").split()
        depth += words.count("{") - words.count("}")
        word = words[0].upper()
        if word == "END":
            name = ""
        elif word in {"ROOT", "JOINT"}:
            name = " ".join(word for word in words[1:] if word not in {"{", "}"})
            if not name or name in joints:
                lines.refuse(number, f"{words[0]} needs a name that no other joint has")
        elif word == "CHANNELS":
            joints[name] = _BvhJoint(name, _kinds(lines, number, words, name))
        elif word not in {"OFFSET", "{", "}"}:
            lines.refuse(number, f"{words[0]!r:.60} is not known here; BVH has ROOT, JOINT, OFFSET")
    if len(joints) > JOINTS_MAX:
        lines.refuse(None, f"has more than {JOINTS_MAX} joints, the maximum")
    if depth != 0:
        lines.refuse(rows[-1][0], "the skeleton does not close its braces")
    return [*joints.values()]


def _kinds(lines: TextLines, number: int, words: Sequence[str], name: str) -> tuple[str, ...]:
    kinds = tuple(words[2:])
    count = lines.whole(words[1], number, CHANNELS_MAX) if len(words) > 1 else 0
    known = {kind.lower() for kind in kinds if _KIND.fullmatch(kind)}
    if not name or not len(known) == len(kinds) == count:
        lines.refuse(
            number,
            "expected CHANNELS, their number, and as many different names such as Zrotation",
        )
    return kinds


def _frames(
    lines: TextLines, rows: Sequence[tuple[int, str]], columns: int
) -> tuple[float, FloatArray]:
    """Return the distance of frames, and the values, (frames, columns); raises `InputError`."""
    head = [row for _, row in rows[1:3]]
    count = _FRAMES.fullmatch(head[0]) if head else None
    distance = _FRAME_TIME.fullmatch(head[1]) if len(head) > 1 else None
    if count is None or distance is None:
        lines.refuse(rows[0][0], "MOTION must be followed by `Frames: N` and `Frame Time: seconds`")
    frames = lines.whole(count[1], rows[1][0], FRAMES_MAX)
    frame_s = lines.number(distance[1], rows[2][0], has_commas=True)
    if not FRAME_MIN_S <= frame_s <= FRAME_MAX_S:
        lines.refuse(rows[2][0], f"Frame Time is {frame_s:g} s; {FRAME_MIN_S:g} to 10 are allowed")
    poses = rows[3:]
    if not poses or columns == 0:
        lines.refuse(None, "has no frame, or no channel")
    if len(poses) != frames:
        lines.refuse(rows[1][0], f"promises {frames} frames, but has {len(poses)}: was it cut off?")
    if len(poses) * columns > VALUES_MAX:
        lines.refuse(None, f"has more than {VALUES_MAX:,} values, the maximum")
    values = np.empty((len(poses), columns), dtype=np.float64)
    for index, (number, row) in enumerate(poses):
        words = row.split()
        if len(words) != columns:
            lines.refuse(
                number, f"has {len(words)} values, but the skeleton has {columns} channels"
            )
        values[index] = [lines.number(word, number, has_commas=True) for word in words]
    return frame_s, values


def _turns(joint: _BvhJoint, times_s: FloatArray, values: FloatArray) -> list[Channel]:
    """Return the channels of a joint that are angles, without jumps of a whole turn."""
    turning = [n for n, kind in enumerate(joint.kinds) if kind.lower().endswith("rotation")]
    found = {joint.kinds[n]: values[:, n] for n in turning}
    if len(turning) > 1:
        from scipy.spatial.transform import Rotation  # 0.1 s of its own.

        order = "".join(joint.kinds[n][0].upper() for n in turning)
        quaternions = Rotation.from_euler(order, values[:, turning], degrees=True).as_quat()
        for number, axis in enumerate(AXES):
            turn_deg = np.degrees(2.0 * np.arctan2(quaternions[:, number], quaternions[:, 3]))
            found[axis] = np.remainder(turn_deg + 180.0, 360.0) - 180.0
    return [
        Channel(
            name=f"{joint.name}.{kind}",
            unit=Measure.DEG,
            times_s=times_s,
            values=np.unwrap(angles_deg, period=360.0),
        )
        for kind, angles_deg in found.items()
    ]
