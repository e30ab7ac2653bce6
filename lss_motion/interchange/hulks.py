"""Motion JSON of the HULKs humanoids: groups of joints in radians, durations in seconds.

The motion starts at `initial_positions`. Each keyframe is reached `duration` after the one before.
Older files have `frames` in place of `motion`, and conditions among them. Jumps have stiffnesses:
`{"positions", "stiffnesses"}` in place of the groups of joints, at the start and in each keyframe.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from msgspec import Struct

from lss_motion.interchange.fields import JsonFields, parsed_json, starts_json
from lss_motion.interchange.reader import Pose, Unit, motion_of_poses, summarised

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import ForeignMotion

START: Final = "initial_positions"
STIFFNESSES: Final = "stiffnesses"
"""Also found among the groups of joints, in `jump_left.json` of the team."""


class HulksReader(Struct, frozen=True):
    """Reads `{"initial_positions", "motion": [{"keyframes": [{"duration", "positions"}]}]}`.

    Positions may be `{"positions", "stiffnesses"}`, at the start and in each keyframe.

    The name of a joint is `group.joint`, such as `left_arm.elbow_roll`.
    """

    name: str = "hulks"

    def recognises(self, data: bytes) -> bool:
        if not starts_json(data, b"{") or b'"initial_positions"' not in data:
            return False
        return (b'"motion"' in data and b'"keyframes"' in data) or b'"frames"' in data

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion, ...]:
        fields = JsonFields(path)
        top = fields.mapping(parsed_json(path, data), "the file")
        values, left = _values(fields, top.get(START), START)
        poses = [Pose(at_s=0.0, values=values, place=START)]
        found = [f"{START}: {name}" for name in left]
        known = {START, "motion", "frames", "interpolation_mode"}
        found += [key for key in top if key not in known and top[key]]
        found += _mode(top)
        for where, part, key in _parts(fields, top):
            if part is not top:
                known = {"keyframes", "interpolation_mode"}
                found += [f"motion: {name}" for name in part if name not in known and part[name]]
                found += _mode(part)
            for index, listed in enumerate(fields.items(part, key, where or "the file")):
                place = f"{where}.{key}[{index}]".lstrip(".")
                keyframe = fields.mapping(listed, place)
                if keyframe and all(name.endswith("Condition") for name in keyframe):
                    found += keyframe
                    continue
                at_s = poses[-1].at_s + fields.duration(keyframe, "duration", place)
                values, left = _values(fields, keyframe.get("positions"), f"{place}.positions")
                poses.append(Pose(at_s=at_s, values=values, place=place))
                known = {"duration", "positions", "interpolation_mode"}
                left += [name for name in keyframe if name not in known]
                found += [f"keyframes: {name}" for name in left]
                found += _mode(keyframe)
        comments = (f"Imported from {path.name} (HULKs motion).", *summarised(found))
        return (motion_of_poses(path, path.stem, poses, unit_of=_unit, comments=comments),)


def _parts(fields: JsonFields, top: dict[str, object]) -> list[tuple[str, dict[str, object], str]]:
    """Return place, content and key of each list of keyframes."""
    if "motion" not in top:
        return [("", top, "frames")]
    entries = enumerate(fields.items(top, "motion", "the file"))
    places = [(f"motion[{number}]", entry) for number, entry in entries]
    return [(where, fields.mapping(entry, where), "keyframes") for where, entry in places]


def _mode(part: dict[str, object]) -> list[str]:
    mode = part.get("interpolation_mode")
    return [f"interpolation_mode {mode!s:.40}; the keys are joined smoothly"] if mode else []


def _values(fields: JsonFields, listed: object, where: str) -> tuple[dict[str, float], list[str]]:
    """Return the values by joint, and the names of what is no position."""
    groups = fields.mapping(listed, where)
    left_out: list[str] = []
    if "positions" in groups:
        left_out = [name for name in groups if name != "positions" and groups[name]]
        where = f"{where}.positions"
        groups = fields.mapping(groups["positions"], where)
    if STIFFNESSES in groups:
        left_out.append(STIFFNESSES)
    values = {
        f"{group}.{joint}": fields.plain_number(value, f"{where}.{group}.{joint}")
        for group, joints in groups.items()
        if group != STIFFNESSES
        for joint, value in fields.mapping(joints, f"{where}.{group}").items()
    }
    return values, left_out


def _unit(name: str) -> Unit:
    # A hand opens by a share from 0 to 1; all other joints rotate.
    return Unit.RAW if name.endswith(".hand") else Unit.RAD
