"""Motion JSON of the HULKs humanoids: groups of joints in radians, durations in seconds.

The motion starts at `initial_positions`. Each keyframe is reached `duration` after the one before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from lss_motion.interchange.fields import JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import Pose, Unit, motion_of_poses, summarised

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion


@dataclass(frozen=True, slots=True)
class HulksReader:
    """Reads `{"initial_positions", "motion": [{"keyframes": [{"duration", "positions"}]}]}`.

    The name of a joint is `group.joint`, such as `left_arm.elbow_roll`.
    """

    name: str = "hulks"

    def recognises(self, data: bytes) -> bool:
        keys = (b'"initial_positions"', b'"motion"', b'"keyframes"')
        return starts_json(data, b"{") and all(key in data for key in keys)

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        fields = JsonFields(path)
        top = fields.mapping(parsed_json(path, data), "the file")
        start = _values(fields, top.get("initial_positions"), "initial_positions")
        poses = [Pose(at_s=0.0, values=start, place="initial_positions")]
        found = [key for key in top if key not in {"initial_positions", "motion"} and top[key]]
        for number, entry in enumerate(fields.items(top, "motion", "the file")):
            where = f"motion[{number}]"
            part = fields.mapping(entry, where)
            found += [f"motion: {key}" for key in part if key != "keyframes" and part[key]]
            for index, listed in enumerate(fields.items(part, "keyframes", where)):
                place = f"{where}.keyframes[{index}]"
                keyframe = fields.mapping(listed, place)
                duration_s = fields.duration(keyframe, "duration", place)
                values = _values(fields, keyframe.get("positions"), f"{place}.positions")
                at_s = poses[-1].at_s + duration_s
                poses.append(Pose(at_s=at_s, values=values, place=place))
                known = {"duration", "positions"}
                found += [f"keyframes: {key}" for key in keyframe if key not in known]
        comments = (f"Imported from {path.name} (HULKs motion).", *summarised(found))
        return (motion_of_poses(path, path.stem, poses, unit_of=_unit, comments=comments),)


def _values(fields: JsonFields, groups: object, where: str) -> dict[str, float]:
    return {
        f"{group}.{joint}": fields.plain_number(value, f"{where}.{group}.{joint}")
        for group, joints in fields.mapping(groups, where).items()
        for joint, value in fields.mapping(joints, f"{where}.{group}").items()
    }


def _unit(name: str) -> Unit:
    # A hand opens by a share from 0 to 1; all other joints rotate.
    return Unit.RAW if name.endswith(".hand") else Unit.RAD
