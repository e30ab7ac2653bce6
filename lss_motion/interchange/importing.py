"""From a file of another tool to a sequence for one robot.

`import_motion` does these steps, which are usable alone: `read_motions` finds the reader that
recognises the file; `read_motion` selects one motion; `imported` maps it to joints of the robot and
reduces a recording to keys; `sequence_for` checks the result against the robot.
"""

# ruff: noqa: TC001 - public: `help` looks up the annotations.
from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.source import RECORDING_MAX_BYTES, read_data
from lss_motion.files.texts import counted, known_names
from lss_motion.interchange.bvh import BVH
from lss_motion.interchange.choregraphe import CHOREGRAPHE
from lss_motion.interchange.command_text import COMMANDS, CONSTANT_SPEED, command_reader
from lss_motion.interchange.csv import CSV
from lss_motion.interchange.d6a import D6A
from lss_motion.interchange.fields import utf8_of
from lss_motion.interchange.json_motions import (
    BITBOTS,
    BLENDER,
    BOTTANGO,
    HULKS,
    PYPOT,
    REACHY,
)
from lss_motion.interchange.label_files import AUDACITY, PAPAGAYO, PRAAT, RHUBARB, XLIGHTS
from lss_motion.interchange.labels import LabelStyle, label_sequence
from lss_motion.interchange.lerobot import LEROBOT
from lss_motion.interchange.mapping import UNWRAP_OFFER, MotionMap, mapped
from lss_motion.interchange.mcap_files import MCAP
from lss_motion.interchange.nubots import NUBOTS
from lss_motion.interchange.numpy_files import NUMPY
from lss_motion.interchange.opencat import OPENCAT
from lss_motion.interchange.poses import POSES
from lss_motion.interchange.reader import DIGITS, ForeignMotion, LabelTrack, PoseNote, RefusedMotion
from lss_motion.interchange.recorded import JointLimits, interpolated
from lss_motion.interchange.reduce import TOLERANCE_DEG, every_sample, reduced
from lss_motion.interchange.robotis import ROBOTIS_PAGES, ROBOTIS_TEXT
from lss_motion.interchange.ros import ROS
from lss_motion.interchange.step_tables import MAESTRO, PYPOSE, SSC32_TABLE, WEBOTS
from lss_motion.robot.model import Robot
from lss_motion.robot.profile import Profile, ramp_deg_s2
from lss_motion.show.check import joint_problems, jumps
from lss_motion.show.model import KEYFRAMES_MAX, TIME_MAX_S, Interpolation, Sequence
from lss_motion.show.parts import keeping

if TYPE_CHECKING:
    from collections.abc import Iterator
    from collections.abc import Sequence as SequenceOf

    from lss_motion.interchange.reader import Channel, Reader
    from lss_motion.interchange.reduce import KeyFit
    from lss_motion.robot.model import Joint
    from lss_motion.show.model import Keyframe


READERS: Final[tuple[Reader, ...]] = (
    D6A,
    LEROBOT,
    NUMPY,
    MCAP,
    RHUBARB,
    PAPAGAYO,
    PRAAT,
    XLIGHTS,
    AUDACITY,
    BITBOTS,
    HULKS,
    REACHY,
    PYPOT,
    BLENDER,
    BOTTANGO,
    CHOREGRAPHE,
    WEBOTS,
    BVH,
    ROBOTIS_TEXT,
    MAESTRO,
    SSC32_TABLE,
    PYPOSE,
    NUBOTS,
    ROS,
    CSV,
    COMMANDS,
    OPENCAT,
    POSES,
    ROBOTIS_PAGES,
)
"""In the order in which `recognises` is called: readers of special formats before general ones."""

FORMAT_NAMES: Final = tuple(reader.name for reader in READERS)
"""Allowed values of `format_name`."""


def read_motion(
    path: Path | str,
    *,
    format_name: str | None = None,
    motion_name: str | None = None,
    wait_unit: Literal["ms", "s"] | None = None,
) -> ForeignMotion | LabelTrack:
    """Return one motion, or track of labels, of a file of another tool, not yet for a robot.

    `motion_name` is required if the file has several motions. `wait_unit` is that of the waits of
    command text which have none.
    """
    motions = read_motions(path, format_name=format_name, wait_unit=wait_unit)
    names = [motion.name for motion in motions]
    if motion_name is None and len(motions) == 1:
        chosen = motions[0]
    elif motion_name is None:
        listed = "\n".join(f"  {name}" for name in names)
        raise InputError(
            f"holds {len(motions)} motions; name one with --motion:\n{listed}", path=path
        )
    elif motion_name in names:
        chosen = motions[names.index(motion_name)]
    else:
        known = known_names(motion_name, names)
        raise InputError(f"has no motion {motion_name!r}; {known}", path=path)
    if isinstance(chosen, RefusedMotion):
        raise chosen.error
    return chosen


OTHERS: Final = (
    (
        b"CEventBar",
        "a show of Visual Show Automation (VSA)",
        "write its events as a CSV table, with a column time_s and one for each track",
    ),
)
"""Beginning of a file that cannot be read, what it is, and what to do."""
OTHERS_HEAD_BYTES: Final = 4096


def read_motions(
    path: Path | str,
    *,
    format_name: str | None = None,
    wait_unit: Literal["ms", "s"] | None = None,
) -> tuple[ForeignMotion | LabelTrack | RefusedMotion, ...]:
    """Return all motions, or tracks of labels, of a file of another tool, with unique names."""
    path = Path(path)
    if format_name is not None and format_name not in FORMAT_NAMES:
        known = known_names(format_name, FORMAT_NAMES)
        raise InputError(f"unknown motion format {format_name!r}; {known}")
    data = utf8_of(path, read_data(path, RECORDING_MAX_BYTES))
    if not data.strip():
        raise InputError("is empty; write or copy it again", path=path)
    for reader in READERS:
        if reader.name == format_name or (format_name is None and reader.recognises(data)):
            if wait_unit is not None and reader is not COMMANDS:
                raise InputError("has no waits: --wait-unit is for command text", path=path)
            chosen = reader if wait_unit is None else command_reader(wait_unit)
            return tuple(_distinct(chosen.motions(path, data)))
    for mark, kind, action in OTHERS:
        if format_name is None and mark in data[:OTHERS_HEAD_BYTES]:
            raise InputError(f"is {kind}, which is not read; {action}", path=path)
    raise InputError(
        f"is in no motion format that can be read; there are: {', '.join(FORMAT_NAMES)}; "
        "name one with --from to see what is wrong",
        path=path,
    )


def _distinct(
    motions: SequenceOf[ForeignMotion | LabelTrack | RefusedMotion],
) -> Iterator[ForeignMotion | LabelTrack | RefusedMotion]:
    """Yield the motions with unique names (a repeated name gets a number), and times from 0 on."""
    taken: set[str] = set()
    for motion in motions:
        name, number = motion.name, 2
        while name in taken:
            name, number = f"{motion.name} ({number})", number + 1
        taken.add(name)
        named = replace(motion, name=name)
        yield _from_zero(named) if isinstance(named, ForeignMotion) else named


def _from_zero(motion: ForeignMotion) -> ForeignMotion:
    """Return the motion with times of a show: dates and times before 0 are moved to start at 0."""
    start_s = min(float(channel.times_s[0]) for channel in motion.channels)
    if 0.0 <= start_s <= TIME_MAX_S:
        return motion
    return replace(
        motion,
        channels=tuple(
            replace(channel, times_s=np.round(channel.times_s - start_s, DIGITS))
            for channel in motion.channels
        ),
        notes={round(at_s - start_s, DIGITS): note for at_s, note in motion.notes.items()},
        comments=(*motion.comments, f"Times start at {start_s:f} s in the file and at 0 here."),
    )


SWING_DEG: Final = 1e-6
"""Tolerance for rounding of a spline. A servo resolves 0.01 deg at best."""

SWING_STEPS: Final = 8
"""Angles looked at between two samples: a spline of few keys leaves its range beside the middle."""


class Imported(Struct, frozen=True, kw_only=True):
    """A motion as a sequence for one robot. `fit` is the result of the reduction of a recording."""

    sequence: Sequence
    comments: tuple[str, ...]
    fit: KeyFit | None = None


def import_motion(
    path: Path | str,
    robot: Robot,
    *,
    format_name: str | None = None,
    motion_name: str | None = None,
    motion_map: MotionMap | None = None,
    tolerance_deg: float = TOLERANCE_DEG,
    is_unwrapped: bool = False,
    is_clipped: bool = False,
) -> Sequence:
    """Return the motion in a file of another tool as a sequence for `robot`.

    Without `format_name` the content decides. The times of the file are kept. A joint stays at its
    first key until the time of that key; the player moves it there before the show starts. Raises
    `InputError` for a file that cannot be read, for joints that the robot does not have, and for
    angles outside their range, unless `is_clipped`. `is_unwrapped` removes the full turns of
    encoders that wrap.
    """
    motion = read_motion(path, format_name=format_name, motion_name=motion_name)
    return imported(
        motion,
        robot,
        motion_map=motion_map,
        tolerance_deg=tolerance_deg,
        is_unwrapped=is_unwrapped,
        is_clipped=is_clipped,
    ).sequence


def imported(
    motion: ForeignMotion | LabelTrack,
    robot: Robot,
    *,
    motion_map: MotionMap | None = None,
    tolerance_deg: float = TOLERANCE_DEG,
    ease: Interpolation = Interpolation.SPLINE,
    is_unwrapped: bool = False,
    is_clipped: bool = False,
    keeps_time: bool = False,
) -> Imported:
    """Return `motion` for `robot`. A recording is reduced to keys; tolerance 0 keeps all samples.

    The options are for motions; of labels, `labels.label_sequence` has others.

    Where a recording keeps the limits of the robot, the spline through its keys keeps them too.

    `ease` is the interpolation between the keys of a recording. A spline needs about the
    acceleration of the recording itself. A smooth curve needs two to three times as much, so it is
    slowed down more often, but it never goes beyond a key (measured on example shows and on random
    motion).

    `keeps_time`: its joints keep every instant. The commands of a script are then left to the
    servos (ease `command`), so that the program holds the same ones where they are possible.
    """
    if isinstance(motion, LabelTrack):
        sequence, comments = label_sequence(motion, robot, LabelStyle())
        return Imported(sequence=sequence, comments=comments)
    fit: KeyFit | None = None
    own = mapped(motion, robot, motion_map, is_unwrapped=is_unwrapped)
    if is_clipped:
        own = clipped(own, robot)
    if own.is_recording and tolerance_deg == 0.0:
        own = every_sample(own, ease)
    elif own.is_recording:
        recorded = own
        own, fit = reduced(recorded, tolerance_deg, ease, _limits(robot))
        if ease is Interpolation.SPLINE and (joint := _swings_out(own, recorded, robot)):
            own, fit = reduced(recorded, tolerance_deg, Interpolation.SMOOTH, _limits(robot))
            own = replace(own, comments=(*own.comments, _smooth_instead(joint)))
    elif own.ease is Interpolation.SPLINE and (joint := _swings_out(own, own, robot)):
        comments = (*own.comments, _smooth_instead(joint))
        own = replace(own, ease=Interpolation.SMOOTH, comments=comments)
    if keeps_time and own.is_script:
        own = _left_to_servos(own, robot)
    sequence = sequence_for(own, robot)
    if keeps_time:
        sequence = keeping(sequence, is_time=True)
    return Imported(sequence=sequence, comments=own.comments, fit=fit)


def _left_to_servos(script: ForeignMotion, robot: Robot) -> ForeignMotion:
    """Return a script with the ease `command`; it lasts until the last servos are at rest."""
    ends_s = [0.0]
    for channel in script.channels:
        joint = robot.joints.get(channel.name)
        if joint is not None and len(channel.times_s) > 1 and joint.drive == "timed":
            ends_s.append(_rests_s(channel, joint))
    last_s = max(float(channel.times_s[-1]) for channel in script.channels)
    note = script.notes.get(last_s, PoseNote())
    hold_s = max(note.hold_s, math.ceil((max(ends_s) - last_s) * 1e3) / 1e3)
    comments = [comment for comment in script.comments if comment != CONSTANT_SPEED]
    comments.append("Each servo carries its commands out by itself (ease: command).")
    return replace(
        script,
        ease=Interpolation.COMMAND,
        notes={**script.notes, last_s: replace(note, hold_s=hold_s)},
        comments=tuple(comments),
    )


def _rests_s(channel: Channel, joint: Joint) -> float:
    """Return when the servo of a script that it carries out comes to rest."""
    servo = Profile(
        float(channel.values[0]),
        ramp_deg_s2=ramp_deg_s2(joint),
        speed_max_deg_s=joint.speed_max_deg_s,
        response=joint.response,
    )
    poses = zip(channel.times_s.tolist(), channel.values.tolist(), strict=True)
    for (from_s, from_deg), (to_s, to_deg) in pairwise(poses):
        if to_deg != from_deg:
            servo.retarget(from_s, to_deg, to_s - from_s)
    return max(piece.start_s for piece in servo.pieces())


def clipped(motion: ForeignMotion, robot: Robot) -> ForeignMotion:
    """Return a motion in joints of `robot` within their ranges; comments list what was not.

    Joints that the robot does not have stay as they are; `sequence_for` refuses them.
    """
    channels: list[Channel] = []
    comments: list[str] = []
    for channel in motion.channels:
        joint = robot.joints.get(channel.name)
        if joint is None:
            channels.append(channel)
            continue
        low, high = joint.position_min_deg, joint.position_max_deg
        within = np.clip(channel.values, low, high)
        beyond = np.abs(channel.values - within)
        if beyond.any():
            worst = int(np.argmax(beyond))
            at_s = float(channel.times_s[worst])
            line = channel.line_at(at_s)
            comments.append(
                f"Clipped: {np.count_nonzero(beyond)} of {len(within)} angles of joint "
                f"{channel.name} to its range of {low:g} to {high:g} deg; the farthest was "
                f"{channel.values[worst]:.6g} deg at {at_s:g} s"
                f"{f', line {line}' if line else ''}."
            )
        channels.append(replace(channel, values=within))
    return replace(motion, channels=tuple(channels), comments=(*motion.comments, *comments))


def _limits(robot: Robot) -> dict[str, JointLimits]:
    return {
        name: JointLimits(
            speed_deg_s=joint.speed_max_deg_s,
            accel_deg_s2=joint.accel_max_deg_s2,
            range_deg=(joint.position_min_deg, joint.position_max_deg),
        )
        for name, joint in robot.joints.items()
    }


def _smooth_instead(joint: str) -> str:
    return f"A spline would swing joint {joint} out of its range: smooth instead."


def _swings_out(keys: ForeignMotion, recorded: ForeignMotion, robot: Robot) -> str:
    """Return a joint whose keys are within its range but whose spline leaves it, or ""."""
    for own, samples in zip(keys.channels, recorded.channels, strict=True):
        joint = robot.joints.get(own.name)
        if joint is None or len(own.times_s) < 2:
            continue
        low, high = joint.position_min_deg, joint.position_max_deg
        places = np.arange(len(samples.times_s))
        finely = np.linspace(0, places[-1], SWING_STEPS * places[-1] + 1)
        times_s = np.interp(finely, places, samples.times_s)
        angles_deg = interpolated(Interpolation.SPLINE, own.times_s, own.values, times_s)
        is_inside = low <= own.values.min() and own.values.max() <= high
        if (
            is_inside
            and not low - SWING_DEG <= angles_deg.min() <= angles_deg.max() <= high + SWING_DEG
        ):
            return joint.name
    return ""


def sequence_for(motion: ForeignMotion, robot: Robot) -> Sequence:
    """Return a motion in joints of `robot` as a sequence; its units must be angles.

    Raises `InputError` with all reasons why the robot cannot play it.
    """
    count = len(np.unique(np.concatenate([channel.times_s for channel in motion.channels])))
    if count > KEYFRAMES_MAX:
        raise InputError(
            f"has {count:,} keyframes, at most {KEYFRAMES_MAX:,} are allowed", path=motion.path
        )
    keyframes = motion.keyframes
    errors = [
        *_unknown_joints(motion, robot),
        *_impossible_keyframes(motion, keyframes, robot),
    ]
    if errors:
        errors += [
            InputError(comment, path=motion.path)
            for comment in motion.comments
            if comment.endswith(UNWRAP_OFFER)
        ]
        raise InputError(errors[0].reason, path=motion.path, line=errors[0].line, more=errors[1:])
    return Sequence(name=motion.name, keyframes=keyframes, path=motion.path, robot_path=robot.path)


def _unknown_joints(motion: ForeignMotion, robot: Robot) -> Iterator[InputError]:
    unknown = [channel.name for channel in motion.channels if channel.name not in robot.joints]
    if unknown:
        yield InputError(
            f"robot {robot.name!r} does not have the joints {', '.join(unknown)}; it has "
            f"{', '.join(robot.joints)}; rename or skip them in a map file (--make-map writes one "
            "to begin with; `others: skip` leaves out the rest), or name another robot",
            path=motion.path,
        )


def _impossible_keyframes(
    motion: ForeignMotion, keyframes: tuple[Keyframe, ...], robot: Robot
) -> Iterator[InputError]:
    path = motion.path
    last_s = max((keyframe.at_s or 0.0) + keyframe.hold_s for keyframe in keyframes)
    if last_s > TIME_MAX_S:
        yield InputError(f"takes {last_s:g} s, more than a day ({TIME_MAX_S:g} s)", path=path)
    worst: dict[str, tuple[float, int, str]] = {}
    counts: dict[str, int] = {}
    for index, name, reason in joint_problems(keyframes, robot):
        joint = robot.joints.get(name)
        if joint is None:
            continue
        angle_deg = keyframes[index].deg[name]
        beyond_deg = max(joint.position_min_deg - angle_deg, angle_deg - joint.position_max_deg)
        counts[name] = counts.get(name, 0) + 1
        if name not in worst or beyond_deg > worst[name][0]:
            worst[name] = (beyond_deg, index, reason)
    by_name = {channel.name: channel for channel in motion.channels}
    for name, (_, index, reason) in worst.items():
        others = counts[name] - 1
        more = f" (the worst; {counted(others, 'more keyframe')} of it as well)" if others else ""
        line = by_name[name].line_at(keyframes[index].at_s or 0.0)
        text = f"{_keyframe_text(index, keyframes[index])}: {reason}{more}; {CLIP_OFFER}"
        yield InputError(text, path=path, line=line)
    for index, reason in jumps(keyframes):
        yield InputError(f"{_keyframe_text(index, keyframes[index])}: {reason}", path=path)


CLIP_OFFER: Final = "--clip limits the angles to the range"


def _keyframe_text(index: int, keyframe: Keyframe) -> str:
    name = f" ({keyframe.label})" if keyframe.label else ""
    return f"keyframe {index + 1}{name} at {keyframe.at_s:g} s"
