"""Scripts of the NUbots: frames of targets in YAML, in radians, each with a duration in ms.

    - duration: 500
      targets:
        - {id: HEAD_YAW, position: 0.5, gain: 30, torque: 100}

A frame is reached `duration` after the one before it. Gains and torques are not carried over.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from lss_motion.files.source import text_of
from lss_motion.interchange.reader import Measure, Pose, Reader, motion_of_poses, summarised
from lss_motion.interchange.yaml_nodes import NodeFields, yaml_trees
from lss_motion.units import s_from_ms

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

_FRAME: Final = re.compile(rb"\btargets\"?:[\s\[{-]*\"?(id|position|gain|torque)\"?:")


def _is_nubots(data: bytes) -> bool:
    return b"duration" in data and _FRAME.search(data[:65_536]) is not None


def _nubots_motions(path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
    fields = NodeFields(path)
    top = next(yaml_trees(text_of(data, path), path))
    if isinstance(top.value, dict) and "frames" in top.value:
        top = top.value["frames"]
    poses: list[Pose] = []
    left_out: list[str] = []
    at_s = 0.0
    for number, node in enumerate(fields.items(top, "the file"), start=1):
        frame = fields.mapping(node, f"frame {number}")
        if not {"duration", "targets"} <= frame.keys():
            fields.refuse(node, f"frame {number} needs a 'duration' and 'targets'")
        duration_ms = fields.number(frame["duration"])
        if duration_ms < 0.0 or (duration_ms == 0.0 and poses):
            fields.refuse(frame["duration"], "a duration must be more than 0 ms")
        at_s += s_from_ms(duration_ms)
        values: dict[str, float] = {}
        for item in fields.items(frame["targets"], "'targets'"):
            target = fields.mapping(item, "a target")
            if not {"id", "position"} <= target.keys():
                fields.refuse(item, "a target needs an 'id' and a 'position'")
            joint = str(target["id"].value)
            if joint in values:
                fields.refuse(item, f"frame {number} has {joint!r:.60} twice")
            values[joint] = fields.number(target["position"])
            left_out += [f"{key} of the targets" for key in target if key not in {"id", "position"}]
        poses.append(Pose(at_s=at_s, values=values, place=f"frame {number}", line=node.line))
    comments = [f"Imported from {path.name} (NUbots script).", *summarised(left_out)]
    motion = motion_of_poses(path, "", poses, unit_of=lambda _: Measure.RAD, comments=comments)
    return (motion,)


NUBOTS: Final = Reader("nubots", _is_nubots, _nubots_motions)
"""Reads `[{duration, targets: [{id, position}]}]`, also below `frames`."""
