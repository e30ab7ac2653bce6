"""What a reader of another tool's files is, and the motion that it returns.

Poses at times, as most formats give them, to a motion of channels.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np

from lss_motion.errors import InputError
from lss_motion.sequence.model import Interpolation, Keyframe

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]


DIGITS: Final = 6
"""Decimals kept: a microsecond, and far below what a servo resolves; -58.00000000000001 is -58."""

VALUES_MAX: Final = 4_000_000
"""Values of one file: 20 joints at 100 Hz for half an hour; as arrays, 64 MB with their times."""

LABEL_MAX_CHARS: Final = 64
"""The most that a sequence file takes as a label."""

STEP_DENSE_S: Final = 0.1
"""Samples closer than this were made by a clock, not by a person. Chosen: 10 Hz."""

DENSE_MIN: Final = 12
"""Fewer samples than this are poses, however close. Chosen: pages of Robotis have at most 7."""


class Unit(StrEnum):
    """What the values of a channel are, as far as the file tells."""

    DEG = "deg"
    RAD = "rad"
    US = "us"
    """Width of a servo pulse: what angle that is depends on the servo."""
    M = "m"
    """A distance: what angle that is depends on the mechanics."""
    RAW = "raw"
    """A number that only the robot's own set-up explains."""
    RAD_OR_M = "rad_or_m"
    """ROS and Webots give rotations in radians and lifts in metres, and do not say which."""


DEG_PER_UNIT: Final[Mapping[Unit, float]] = {Unit.DEG: 1.0, Unit.RAD: math.degrees(1.0)}
"""The units that are angles."""

_PRISMATIC: Final = re.compile(r"lift|prismatic|linear|slid|elevat|telescop|finger", re.IGNORECASE)


def unit_of_ros_joint(name: str) -> Unit:
    """Return radians, unless the name speaks of a joint that may well move in metres."""
    return Unit.RAD_OR_M if _PRISMATIC.search(name) else Unit.RAD


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Channel:
    """One joint as the file knows it: at least one value, at increasing times."""

    name: str
    unit: Unit
    times_s: FloatArray
    values: FloatArray
    servo_id: int | None = None
    """The id on the bus, for files that speak to Lynxmotion servos; then `values` are its angles"""

    def __post_init__(self) -> None:
        assert len(self.times_s) == len(self.values) > 0, self.name
        assert np.isfinite([self.times_s, self.values]).all(), self.name
        assert (np.diff(self.times_s) > 0.0).all(), self.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Note:
    """What a file says about the pose at one time beside its angles."""

    hold_s: float = 0.0
    label: str = ""
    ease: Interpolation | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForeignMotion:
    """A motion as its file tells it, for no robot yet; with one channel or more.

    `notes` are by time. `comments` are for people: where the motion comes from, how ambiguous
    things were read, and what could not be carried over. `is_recording`: the channels are samples
    that a clock took, and stand for the curve through them.
    """

    path: Path
    name: str
    channels: tuple[Channel, ...]
    notes: Mapping[float, Note]
    ease: Interpolation = Interpolation.SMOOTH
    comments: tuple[str, ...] = ()
    is_recording: bool = False

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The motion as keyframes in degrees; raises `InputError` where a unit is no angle."""
        at_times: defaultdict[float, dict[str, float]] = defaultdict(dict)
        for channel in self.channels:
            if channel.unit not in DEG_PER_UNIT:
                raise InputError(
                    f"joint {channel.name!r} is given in {channel.unit}, which is no angle; "
                    "say what it means in a map file (--make-map writes one to begin with)",
                    path=self.path,
                )
            values_deg = np.round(channel.values * DEG_PER_UNIT[channel.unit], DIGITS) + 0.0
            for at_s, deg in zip(channel.times_s.tolist(), values_deg.tolist(), strict=True):
                at_times[at_s][channel.name] = deg
        return tuple(self._keyframe(at_s, at_times[at_s]) for at_s in sorted(at_times))

    def _keyframe(self, at_s: float, deg: dict[str, float]) -> Keyframe:
        note = self.notes.get(at_s, Note())
        return Keyframe(
            at_s=at_s,
            deg=deg,
            hold_s=note.hold_s,
            label=note.label,
            ease=note.ease or self.ease,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedMotion:
    """One motion of several in a file that cannot be read, and why; the others can."""

    name: str
    error: InputError


class Reader(Protocol):
    """One format. Neither method runs anything that a file contains."""

    @property
    def name(self) -> str:
        """What `--from` calls the format."""
        ...

    def recognises(self, data: bytes) -> bool:
        """Return whether a file with this content is worth reading as this format."""
        ...

    def motions(self, path: Path, data: bytes) -> tuple[ForeignMotion | RefusedMotion, ...]:
        """Return the motions in `data`, one or more, in the file's order.

        Raises `InputError` and nothing else; `path` is only for its words.
        """
        ...


def motion_label(name: object) -> str:
    """Return a name as a label that a sequence file takes."""
    if not isinstance(name, str):
        return ""
    return "".join(char if char.isprintable() else " " for char in name)[:LABEL_MAX_CHARS].strip()


def read_or_refused(name: str, read: Callable[[], ForeignMotion]) -> ForeignMotion | RefusedMotion:
    """Return what `read` returns, or its `InputError` as the refusal of this one motion."""
    try:
        return read()
    except InputError as error:
        return RefusedMotion(name=name, error=error)


def is_dense(times_s: FloatArray) -> bool:
    """Return whether these are samples of a clock rather than poses of a person."""
    return len(times_s) >= DENSE_MIN and float(np.median(np.diff(times_s))) <= STEP_DENSE_S


def summarised(found: Sequence[str]) -> tuple[str, ...]:
    """Return a comment for every kind of thing that could not be carried over, once."""
    return tuple(f"Not carried over: {what}" for what in dict.fromkeys(found))


@dataclass(frozen=True, slots=True, kw_only=True)
class Pose:
    """Values to be reached at one time, and kept for `hold_s`; `place` is for error messages."""

    at_s: float
    values: Mapping[str, float]
    hold_s: float = 0.0
    label: str = ""
    place: str = ""
    line: int | None = None


def motion_of_poses(
    path: Path,
    name: str,
    poses: Sequence[Pose],
    *,
    unit_of: Callable[[str], Unit] = lambda _: Unit.DEG,
    comments: Sequence[str] = (),
) -> ForeignMotion:
    """Return the motion through `poses`, whose times must increase, else `InputError`.

    It is a recording where the poses are dense and nothing is held.
    """
    if not any(pose.values for pose in poses):
        raise InputError(f"motion {name!r} moves no joint", path=path)
    times_s = [round(pose.at_s, DIGITS) for pose in poses]
    _check_times(path, poses, times_s)
    columns: dict[str, tuple[list[float], list[float]]] = {}
    for at_s, pose in zip(times_s, poses, strict=True):
        for joint, value in pose.values.items():
            own_times_s, values = columns.setdefault(joint, ([], []))
            own_times_s.append(at_s)
            values.append(value)
    holds = any(pose.hold_s for pose in poses)
    return ForeignMotion(
        path=path,
        name=motion_label(name) or motion_label(path.stem) or "motion",
        channels=tuple(
            Channel(
                name=joint,
                unit=unit_of(joint),
                times_s=np.array(own_times_s),
                values=np.array(values),
            )
            for joint, (own_times_s, values) in columns.items()
        ),
        notes={
            at_s: Note(hold_s=round(pose.hold_s, DIGITS), label=motion_label(pose.label))
            for at_s, pose in zip(times_s, poses, strict=True)
            if pose.hold_s or pose.label
        },
        comments=tuple(comments),
        is_recording=not holds and is_dense(np.array(times_s)),
    )


def recording(
    path: Path,
    name: str,
    channels: Sequence[Channel],
    *,
    comments: Sequence[str] = (),
    ease: Interpolation = Interpolation.SMOOTH,
) -> ForeignMotion:
    """Return a motion whose channels are samples, each at its own times."""
    return ForeignMotion(
        path=path,
        name=motion_label(name) or motion_label(path.stem) or "motion",
        channels=tuple(channels),
        notes={},
        ease=ease,
        comments=tuple(comments),
        is_recording=True,
    )


def thinned(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return samples at increasing times, rounded; of those at one time, the first."""
    times_s = np.round(times_s, DIGITS)
    is_new = np.concatenate([[True], np.diff(np.maximum.accumulate(times_s)) > 0.0])
    return times_s[is_new], values[is_new]


def _check_times(path: Path, poses: Sequence[Pose], times_s: Sequence[float]) -> None:
    end_s = -math.inf
    for pose, at_s in zip(poses, times_s, strict=True):
        place = f"{pose.place}: " if pose.place else ""
        if at_s <= end_s:
            raise InputError(
                f"{place}times must increase, but this is {at_s:g} s after {end_s:g} s",
                path=path,
                line=pose.line,
            )
        end_s = at_s
