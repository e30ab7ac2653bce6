"""Maps the joints of another robot to joints of a robot file: name, unit, sign, scale, offset.

`MapFile` and `MapEntry` are the keys of a map file, `load_map` reads one, `mapped` applies it, and
`map_template` writes one to begin with.
"""

from __future__ import annotations

import json
import re
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.keys import FILE_VERSION, VERSION, Check, Field, FileModel, Name, Version
from lss_motion.files.texts import known_names, printable
from lss_motion.files.validation import validate
from lss_motion.files.yaml_source import Mistake, read_yaml
from lss_motion.interchange.reader import (
    BROADCAST_ID,
    DEG_PER_UNIT,
    TENTHS_PER_DEG,
    Channel,
    Measure,
    summarised,
)
from lss_motion.robot.linkage_file import AngleDeg  # noqa: TC001  (read when it is checked)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.files.yaml_source import YamlSource
    from lss_motion.interchange.reader import FloatArray, ForeignMotion
    from lss_motion.robot.model import Joint, Robot


TURN_DEG: Final = 360.0

WRAP_MIN_DEG: Final = 270.0
"""Two samples of a recording this far apart mean that the encoder wrapped: at 10 Hz the motion
would be 2700 deg/s, and the fastest servo reaches 600 deg/s (FACTS.md E1)."""

WRAP_SPEED_DEG_S: Final = 1500.0
"""A step faster than this is no motion: 2.5 times the fastest servo (FACTS.md E1)."""

WRAP_STEPS_MAX: Final = 4
"""Chosen: most steps of one wrap, at a reading that is filtered over some samples."""

PULSE_DEG_PER_US: Final = 0.09
PULSE_OFFSET_DEG: Final = -135.0
"""A usual RC servo, as a guess in templates: 180 deg over 500 to 2500 us, 0 deg at 1500 us."""


_NUMBER: Final = re.compile(r"(?:id|servo|motor|pin)?[ _-]?(\d{1,3})", re.ASCII | re.IGNORECASE)
"""A name that is no more than the number of a servo."""

SCALE_MAX: Final = 1e6
"""Degrees per unit: a spindle of 1 mm per turn has 360,000 deg per metre."""


def _check_sign(sign: int) -> int:
    if sign not in {1, -1}:
        raise ValueError("must be 1 or -1")
    return sign


class MapEntry(FileModel, title="mapped joint"):
    """One joint: `angle = offset_deg + sign * scale * value`; angles are values in degrees."""

    name: Name | None = Field(
        default=None, description="Joint of the robot. Default: the same name."
    )
    skip: bool = Field(default=False, description="Leave this joint out.")
    unit: Literal["deg", "rad", "us", "m", "raw"] | None = Field(
        default=None, description="Measure of the values. Default: the unit of the file."
    )
    sign: Annotated[int, Check(_check_sign)] = Field(
        default=1, description="-1 if the joint of the robot turns the other way."
    )
    scale: float | None = Field(
        default=None,
        gt=0.0,
        le=SCALE_MAX,
        description="Degrees per unit; needed if the unit is not an angle.",
    )
    offset_deg: AngleDeg = Field(default=0.0, description="Angle of the joint at value 0.")


class MapFile(FileModel, title="map file"):
    """How the joints of a motion file become joints of a robot."""

    version: Version = Field(default=FILE_VERSION, description=VERSION)
    joints: dict[str, MapEntry] = Field(min_length=1)
    others: Literal["keep", "skip"] = Field(
        default="keep",
        description="Joints that are not named here keep their names, or are left out.",
    )


class MotionMap(Struct, frozen=True):
    """The content of a map file, with its line numbers."""

    entries: Mapping[str, MapEntry]
    source: YamlSource
    skips_others: bool = False


def load_map(path: Path) -> MotionMap:
    """Return the map in the file at `path`, or raise `InputError` with file and line."""
    source = read_yaml(path)
    content, problems, _ = validate(MapFile, source)
    if problems or content is None:
        raise source.error(problems)
    return MotionMap(content.joints, source, skips_others=content.others == "skip")


def mapped(
    motion: ForeignMotion,
    robot: Robot,
    motion_map: MotionMap | None,
    *,
    is_unwrapped: bool = False,
) -> ForeignMotion:
    """Return the motion in degrees of joints of `robot`.

    Joints that the map does not contain keep their names; `sequence_for` checks these. An LSS id
    becomes the joint that has this id, and `D` is counted as its servo counts it.
    `is_unwrapped` removes the full turns of encoders that wrap; without it a comment offers that.
    Raises `InputError` with every name of the map that does not exist, and every unit that is not
    an angle.
    """
    motion = _spread(motion, robot)
    entries = {} if motion_map is None else dict(motion_map.entries)
    if motion_map is not None:
        _check_map(motion_map, motion, robot)
    channels: list[Channel] = []
    motion, comments = _counted_by_servos(motion, robot, entries)
    reasons: list[str] = []
    for channel in motion.channels:
        entry = entries.get(channel.name)
        if entry is None and motion_map is not None and motion_map.skips_others:
            continue
        if entry is not None and entry.skip:
            comments += summarised([f"joint {channel.name}, which the map skips"])
            continue
        unit, reason = _unit(channel, entry)
        reasons += [reason] * bool(reason)
        joint, own, values = _own_joint(channel, entry, robot), channel, channel.values
        if unit in DEG_PER_UNIT:
            values_deg = values * DEG_PER_UNIT[unit]
            own, values, turns = _turns(motion, channel, values_deg, is_unwrapped=is_unwrapped)
            comments += turns
        if entry is not None:
            values = entry.offset_deg + entry.sign * (entry.scale or 1.0) * values
        elif joint is not None and channel.servo_id is not None:
            values = np.array([joint.joint_deg(value) for value in values.tolist()])
        name = (entry.name if entry else None) or (joint.name if joint else channel.name)
        channels.append(replace(own, name=name, unit=Measure.DEG, values=values, servo_id=None))
    reasons += _name_problems(motion, channels)
    if reasons:
        errors = [InputError(reason, path=motion.path) for reason in reasons]
        raise InputError(reasons[0], path=motion.path, more=errors[1:])
    return replace(motion, channels=tuple(channels), comments=(*motion.comments, *comments))


def _spread(motion: ForeignMotion, robot: Robot) -> ForeignMotion:
    """Return the motion with a channel for each servo that only broadcasts move."""
    listed = [channel.servo_id for channel in motion.channels]
    others = sorted({joint.servo_id for joint in robot.joints.values()} - {*listed})
    channels: list[Channel] = []
    for channel in motion.channels:
        if channel.servo_id == BROADCAST_ID:
            channels += [replace(channel, name=f"ID{own}", servo_id=own) for own in others]
        else:
            channels.append(channel)
    return replace(motion, channels=tuple(channels))


def _counted_by_servos(
    motion: ForeignMotion, robot: Robot, entries: Mapping[str, MapEntry]
) -> tuple[ForeignMotion, list[str]]:
    """Return the motion with `D` in the units of the servos, and a comment on those not of an LSS.

    Which servo received a command is known by its id only, so the joint with this id decides, else
    the one that the map names.
    """
    channels: list[Channel] = []
    counted: dict[float, list[str]] = {}
    for channel in motion.channels:
        entry = entries.get(channel.name)
        joint = _joint_with_id(channel, robot)
        if joint is None and entry is not None and channel.servo_id is not None:
            joint = robot.joints.get(entry.name or "")
        ratio = 1.0 if joint is None else TENTHS_PER_DEG / joint.model.wire_per_deg
        if joint is not None and ratio != 1.0:
            counted.setdefault(joint.model.wire_per_deg, []).append(channel.name)
        channels.append(replace(channel, values=ratio * channel.values))
    comments = [
        f"D of {', '.join(names)} is read in units of 1/{per_deg:g} deg, as the servos of this "
        "robot count; if the commands were written for LSS servos, which count tenths, add "
        f"`scale: {per_deg / TENTHS_PER_DEG:g}` in a map file (--make-map)."
        for per_deg, names in counted.items()
    ]
    return replace(motion, channels=tuple(channels)), comments


def _own_joint(channel: Channel, entry: MapEntry | None, robot: Robot) -> Joint | None:
    """Return the joint that has the id of an LSS channel, if exactly one joint has it."""
    return None if entry is not None else _joint_with_id(channel, robot)


def _joint_with_id(channel: Channel, robot: Robot) -> Joint | None:
    if channel.servo_id is None:
        return None
    found = [joint for joint in robot.joints.values() if joint.servo_id == channel.servo_id]
    return found[0] if len(found) == 1 else None


def _unit(channel: Channel, entry: MapEntry | None) -> tuple[Measure, str]:
    """Return the unit of a channel, and the reason why it cannot be used, or ""."""
    unit = Measure(entry.unit) if entry is not None and entry.unit else channel.unit
    shown = f"joint {channel.name!r:.60}"
    if unit in DEG_PER_UNIT or (
        unit is not Measure.RAD_OR_M and entry is not None and entry.scale is not None
    ):
        return unit, ""
    if unit is Measure.RAD_OR_M:
        return unit, (
            f"{shown} may be a sliding joint, and the file does not define whether its values are "
            "radians or metres; add to a map file `unit: rad`, or `unit: m` and a `scale` in "
            "degrees per metre (--make-map writes one to begin with)"
        )
    return unit, (
        f"{shown} is given in {_UNIT_WORDS[unit]}, which is not an angle; give `scale`, in degrees "
        "per unit, and `offset_deg` in a map file (--make-map writes one to begin with)"
    )


_UNIT_WORDS: Final = {
    Measure.US: "microseconds of a servo pulse",
    Measure.M: "metres",
    Measure.RAW: "units of its own robot",
}


def _check_map(motion_map: MotionMap, motion: ForeignMotion, robot: Robot) -> None:
    names = [channel.name for channel in motion.channels]
    problems: list[Mistake] = []
    for name, entry in motion_map.entries.items():
        if name not in names:
            reason = f"the motion has no joint {name!r:.60}; {known_names(name, names)}"
            problems.append(Mistake(("joints", name), reason))
        elif entry.name is not None and entry.name not in robot.joints:
            known = known_names(entry.name, robot.joints)
            problems.append(
                Mistake(
                    ("joints", name, "name"),
                    f"robot {robot.name!r} has no joint {entry.name!r}; {known}",
                )
            )
    if problems:
        raise motion_map.source.error(problems)


def _name_problems(motion: ForeignMotion, channels: list[Channel]) -> Iterator[str]:
    names = [channel.name for channel in channels]
    if not names:
        yield f"motion {motion.name!r} moves only joints that the map skips"
    for name in dict.fromkeys(name for name in names if names.count(name) > 1):
        yield f"{names.count(name)} joints of the motion become joint {name!r}; only one can"


def _turns(
    motion: ForeignMotion, channel: Channel, values_deg: FloatArray, *, is_unwrapped: bool
) -> tuple[Channel, FloatArray, list[str]]:
    """Return channel and values without the full turns of an encoder, if desired, and a comment.

    An encoder that is read while it wraps may give values between both ends of its turn: a run of
    steps that no servo can make, in one direction, that add up to about a turn. The values inside
    of such a run are removed.
    """
    if not motion.is_recording:
        return channel, values_deg, []
    is_inside, turns = _wraps(channel.times_s, values_deg)
    starts = np.flatnonzero(turns)
    if not len(starts):
        return channel, values_deg, []
    at_s = float(channel.times_s[starts[0]])
    count = f"{len(starts)} time{'s' if len(starts) > 1 else ''}"
    what = f"Joint {channel.name} jumps by a full turn {count}, first at {at_s:g} s"
    if not is_unwrapped:
        return channel, values_deg, [f"{what}, as an encoder does that wraps. {UNWRAP_OFFER}"]
    kept = ~is_inside
    values_deg = (values_deg + TURN_DEG * np.cumsum(turns))[kept]
    own = replace(
        channel,
        times_s=channel.times_s[kept],
        values=channel.values[kept],
        lines=None if channel.lines is None else channel.lines[kept],
    )
    return own, values_deg, [f"{what}. The turns were removed (--unwrap)."]


UNWRAP_OFFER: Final = "--unwrap removes the turns."


def _wraps(times_s: FloatArray, values_deg: FloatArray) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which values lie inside of a wrap, and the turns to be added from each value on."""
    is_inside = np.zeros(len(values_deg), dtype=np.bool_)
    turns = np.zeros(len(values_deg))
    steps_deg = np.diff(values_deg)
    is_fast = np.abs(steps_deg) > WRAP_SPEED_DEG_S * np.diff(times_s)
    is_fast |= np.abs(steps_deg) >= WRAP_MIN_DEG
    index = 0
    for first in np.flatnonzero(is_fast).tolist():
        if first < index:
            continue
        index = first + 1
        sign = steps_deg[first] > 0.0
        while (
            index < min(len(steps_deg), first + WRAP_STEPS_MAX)
            and is_fast[index]
            and (steps_deg[index] > 0.0) == sign
        ):
            index += 1
        change_deg = values_deg[index] - values_deg[first]
        if abs(change_deg) >= WRAP_MIN_DEG:
            is_inside[first + 1 : index] = True
            turns[index] -= np.round(change_deg / TURN_DEG)
    return is_inside, turns


def map_template(motion: ForeignMotion, robot: Robot) -> str:
    """Return a map file for the joints of `motion` to begin with. Guesses are marked."""
    of_file, of_robot = printable(motion.path.name), printable(robot.name)
    lines = [
        f"# Joints of {of_file} and their joints of robot {of_robot}:",
        "# angle = offset_deg + sign * scale * value; a value that is an angle is in degrees.",
        f"# Joints of the robot: {', '.join(robot.joints)}",
        "joints:",
    ]
    for channel in _counted_by_servos(_spread(motion, robot), robot, {})[0].channels:
        low, high = float(channel.values.min()), float(channel.values.max())
        joint = _guess(channel, robot)
        fields = [f"name: {json.dumps(joint, ensure_ascii=False)}"] if joint else ["skip: true"]
        words = [f"{low:.6g} to {high:.6g} {_TEMPLATE_UNITS.get(channel.unit, channel.unit)}"]
        if joint and channel.servo_id is None and joint == _by_number(channel.name, robot):
            words.append("guess: its servo has this id")
        if not joint:
            words.append("the robot has no joint of that name: skipped unless you name one")
        if channel.unit is Measure.US:
            fields += [f"scale: {PULSE_DEG_PER_US}", f"offset_deg: {PULSE_OFFSET_DEG}"]
            words.append("guess: 180 deg over 500 to 2500 us")
        elif channel.unit is Measure.RAD_OR_M:
            words.append("add unit: rad, or unit: m and scale: degrees per metre")
        elif channel.unit not in DEG_PER_UNIT:
            words.append("add scale: degrees per unit")
        elif channel.servo_id is not None and joint:
            own = robot.joints[joint]
            fields += [
                f"sign: {own.direction}",
                f"offset_deg: {-own.direction * own.zero_deg + 0.0:g}",
            ]
        key = json.dumps(channel.name, ensure_ascii=False)
        lines.append(f"  {key}: {{{', '.join(fields)}}}  # {printable('; '.join(words))}")
    return "\n".join([*lines, ""])


_TEMPLATE_UNITS: Final = {Measure.RAD_OR_M: "rad or m", Measure.RAW: "units of its own robot"}


def _guess(channel: Channel, robot: Robot) -> str:
    """Return the joint with this id or, apart from case and dashes, this name; else ""."""

    def plain(name: str) -> str:
        return "".join(char for char in name.lower() if char.isalnum()).removesuffix("joint")

    own = _own_joint(channel, None, robot)
    by_name = {plain(name): name for name in reversed(list(robot.joints))}
    by_name_or_id = by_name.get(plain(channel.name)) or _by_number(channel.name, robot)
    return own.name if own else by_name_or_id


def _by_number(name: str, robot: Robot) -> str:
    """Return the one joint whose servo has the id that a name such as `ID7` or `7` is; else ""."""
    number = _NUMBER.fullmatch(name)
    found = [
        joint.name
        for joint in robot.joints.values()
        if number is not None and joint.servo_id == int(number[1])
    ]
    return found[0] if len(found) == 1 else ""
