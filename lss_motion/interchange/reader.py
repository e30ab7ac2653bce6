"""The interface of a reader (`Reader`), and the motion that it returns (`ForeignMotion`).

A motion has one channel per joint: values at increasing times, in the unit of the file. Most
formats contain poses at times; `motion_of_poses` turns these into channels.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np
from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.show.model import Interpolation, Keyframe

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.int32]


TENTHS_PER_DEG: Final = 10.0
"""Measure of `D` of an LSS (FACTS.md C1)."""

DIGITS: Final = 6
"""Decimals of times and angles: 1 us, and far below the resolution of a servo. Rounding also
removes noise such as -58.00000000000001."""

VALUES_MAX: Final = 4_000_000
"""Maximum number of values in a file: 20 joints at 100 Hz for half an hour; 64 MB as arrays."""

LABEL_MAX_CHARS: Final = 64
"""Maximum length of a label in a sequence file."""

FPS_MAX: Final = 1000.0
"""Maximum frame rate. Chosen: above any animation."""

STEP_DENSE_S: Final = 0.1
"""Samples closer than this come from a clock, not from a person. Chosen: 10 Hz."""

DENSE_MIN: Final = 12
"""Fewer samples than this are poses, even if they are close. Chosen: Robotis pages have up to 7."""


class Measure(StrEnum):
    """Measure of the values of a channel, as far as the file defines it."""

    DEG = "deg"
    RAD = "rad"
    US = "us"
    """Width of a servo pulse; its angle depends on the servo."""
    M = "m"
    """A distance in metres; its angle depends on the mechanics."""
    RAW = "raw"
    """A number whose meaning depends on the set-up of the other robot."""
    RAD_OR_M = "rad_or_m"
    """ROS and Webots use radians or, for sliding joints, metres; the file does not define which."""


DEG_PER_UNIT: Final[Mapping[Measure, float]] = {
    Measure.DEG: 1.0,
    Measure.RAD: math.degrees(1.0),
}
"""The units that are angles."""

BROADCAST_ID: Final = 254
"""Id to which all servos of a bus listen."""

_PRISMATIC: Final = re.compile(r"lift|prismatic|linear|slid|elevat|telescop|finger", re.IGNORECASE)


def unit_of_ros_joint(name: str) -> Measure:
    """Return radians, or `RAD_OR_M` if the name is that of a sliding joint."""
    return Measure.RAD_OR_M if _PRISMATIC.search(name) else Measure.RAD


class Channel(Struct, frozen=True, kw_only=True, eq=False):
    """One joint of the file: one value or more, at increasing times."""

    name: str
    unit: Measure
    times_s: FloatArray
    values: FloatArray
    servo_id: int | None = None
    """Id on the bus, in files with commands for LSS servos; `values` are then servo angles, as an
    LSS counts them (`TENTHS_PER_DEG`). The text does not tell of which family the servo is.
    `BROADCAST_ID`: every servo of the robot that has no channel of its own."""
    lines: IntArray | None = None
    """Line of each value, in text files."""

    def __post_init__(self) -> None:
        assert len(self.times_s) == len(self.values) > 0, self.name
        assert np.isfinite([self.times_s, self.values]).all(), self.name
        assert (np.diff(self.times_s) > 0.0).all(), self.name
        assert self.lines is None or len(self.lines) == len(self.values), self.name

    def line_at(self, at_s: float) -> int | None:
        """Return the line of the value next to `at_s`, if the file has lines."""
        if self.lines is None:
            return None
        after = int(np.clip(np.searchsorted(self.times_s, at_s), 0, len(self.times_s) - 1))
        before = max(0, after - 1)
        is_before = at_s - self.times_s[before] < self.times_s[after] - at_s
        return int(self.lines[before if is_before else after]) or None


class PoseNote(Struct, frozen=True, kw_only=True):
    """Properties of the pose at one time, besides its angles."""

    hold_s: float = 0.0
    label: str = ""
    ease: Interpolation | None = None


class ForeignMotion(Struct, frozen=True, kw_only=True, eq=False):
    """A motion as in its file, not yet for a robot; it has one channel or more.

    `notes` are by time. `comments` are for people: the origin of the motion, how ambiguous values
    were read, and what was not carried over. `is_recording`: the channels are samples taken by a
    clock, and represent the curve through them.
    """

    path: Path
    name: str
    channels: tuple[Channel, ...]
    notes: Mapping[float, PoseNote]
    ease: Interpolation = Interpolation.SMOOTH
    comments: tuple[str, ...] = ()
    is_recording: bool = False
    is_script: bool = False
    """The poses are the ends of commands for servos, each sent at the pose before."""

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The motion as keyframes in degrees; raises `InputError` if a unit is not an angle."""
        at_times: defaultdict[float, dict[str, float]] = defaultdict(dict)
        for channel in self.channels:
            if channel.unit not in DEG_PER_UNIT:
                raise InputError(
                    f"joint {channel.name!r} is given in {channel.unit}, which is not an "
                    "angle; define its scale in a map file (--make-map writes one to begin with)",
                    path=self.path,
                )
            values_deg = np.round(channel.values * DEG_PER_UNIT[channel.unit], DIGITS) + 0.0
            for at_s, deg in zip(channel.times_s.tolist(), values_deg.tolist(), strict=True):
                at_times[at_s][channel.name] = deg
        return tuple(self._keyframe(at_s, at_times[at_s]) for at_s in sorted(at_times))

    def _keyframe(self, at_s: float, deg: dict[str, float]) -> Keyframe:
        note = self.notes.get(at_s, PoseNote())
        return Keyframe(
            at_s=at_s,
            deg=deg,
            hold_s=note.hold_s,
            label=note.label,
            ease=note.ease or self.ease,
        )


class RefusedMotion(Struct, frozen=True, kw_only=True):
    """A motion that cannot be read, with the reason; other motions of the file may be readable."""

    name: str
    error: InputError


class Span(Struct, frozen=True):
    """A label from `from_s` to `to_s`; both are equal at an instant."""

    from_s: float
    to_s: float
    text: str
    line: int | None = None


class LabelTrack(Struct, frozen=True, kw_only=True):
    """Labels of a sound as in their file: words, sounds of speech, shapes of a mouth.

    One span or more, in order of their beginnings, none before 0. They become motion by poses of a
    robot, see `labels`.
    """

    path: Path
    name: str
    spans: tuple[Span, ...]
    comments: tuple[str, ...] = ()
    is_mouth: bool = False
    """The format holds nothing but shapes of a mouth."""
    sound: str = ""
    """Name of the sound file, where the file of the labels has it."""
    assumed_fps: float | None = None
    """The file counts frames and does not give their rate: this one was assumed."""

    def __post_init__(self) -> None:
        starts_s = [span.from_s for span in self.spans]
        assert starts_s, self.name
        assert starts_s == sorted(starts_s), self.name
        assert starts_s[0] >= 0.0, self.name
        assert all(span.from_s <= span.to_s < math.inf for span in self.spans), self.name


class Reader(Struct, frozen=True):
    """A reader of one format. It never executes content of a file."""

    name: str
    """Name of the format, for `--from`."""
    recognises: Callable[[bytes], bool]
    """Returns whether the content looks like this format."""
    motions: Callable[[Path, bytes], tuple[ForeignMotion | LabelTrack | RefusedMotion, ...]]
    """Returns the motions, or tracks of labels, in the content, one or more, in the file's order.

    Raises `InputError` and nothing else. The path is used only in its text; `lerobot` looks for the
    description of the dataset in the folders above it.
    """


def motion_label(name: object) -> str:
    """Return a name as a label that a sequence file allows, or ""."""
    if not isinstance(name, str):
        return ""
    return "".join(char if char.isprintable() else " " for char in name)[:LABEL_MAX_CHARS].strip()


def motion_name(path: Path, name: str = "") -> str:
    """Return `name` as the name of a motion, or the name of the file if `name` is empty."""
    return motion_label(name) or motion_label(path.stem) or "motion"


Found = TypeVar("Found", ForeignMotion, LabelTrack)


def read_or_refused(name: str, read: Callable[[], Found]) -> Found | RefusedMotion:
    """Return the result of `read`, or its `InputError` as the refusal of this motion."""
    try:
        return read()
    except InputError as error:
        return RefusedMotion(name=name, error=error)


def is_dense(times_s: FloatArray) -> bool:
    """Return whether these are samples taken by a clock, not poses set by a person."""
    return len(times_s) >= DENSE_MIN and float(np.median(np.diff(times_s))) <= STEP_DENSE_S


def summarised(found: Sequence[str]) -> tuple[str, ...]:
    """Return one comment for each different text in `found`: it was not carried over."""
    return tuple(f"Not carried over: {what}" for what in dict.fromkeys(found))


class Pose(Struct, frozen=True, kw_only=True):
    """Values to be reached at `at_s` and held for `hold_s`; `place` is for error messages."""

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
    unit_of: Callable[[str], Measure] = lambda _: Measure.DEG,
    comments: Sequence[str] = (),
) -> ForeignMotion:
    """Return the motion through `poses`; raise `InputError` if their times do not increase.

    It is a recording if the poses are dense and none is held.
    """
    if not any(pose.values for pose in poses):
        raise InputError(f"motion {name!r} moves no joint", path=path)
    times_s = [round(pose.at_s, DIGITS) for pose in poses]
    _check_times(path, poses, times_s)
    columns: dict[str, tuple[list[float], list[float], list[int]]] = {}
    for at_s, pose in zip(times_s, poses, strict=True):
        for joint, value in pose.values.items():
            own_times_s, values, lines = columns.setdefault(joint, ([], [], []))
            own_times_s.append(at_s)
            values.append(value)
            lines.append(pose.line or 0)
    holds = any(pose.hold_s for pose in poses)
    return ForeignMotion(
        path=path,
        name=motion_name(path, name),
        channels=tuple(
            Channel(
                name=joint,
                unit=unit_of(joint),
                times_s=np.array(own_times_s),
                values=np.array(values),
                lines=np.array(lines, dtype=np.int32) if any(lines) else None,
            )
            for joint, (own_times_s, values, lines) in columns.items()
        ),
        notes={
            at_s: PoseNote(hold_s=round(pose.hold_s, DIGITS), label=motion_label(pose.label))
            for at_s, pose in zip(times_s, poses, strict=True)
            if pose.hold_s or pose.label
        },
        comments=tuple(comments),
        is_recording=not holds and is_dense(np.array(times_s)),
    )


Curves = dict[str, dict[float, tuple[float, int]]]
"""Of each joint the value, and its line or 0, at each of its own times in any order."""


def motion_of_curves(
    path: Path,
    name: str,
    curves: Curves,
    unit_of: Callable[[str], Measure],
    *,
    comments: Sequence[str] = (),
) -> ForeignMotion:
    """Return the motion of joints that have times of their own; a recording if one is dense."""
    channels: list[Channel] = []
    for joint, own in curves.items():
        times_s = sorted(own)
        lines = [own[at_s][1] for at_s in times_s]
        channels.append(
            Channel(
                name=joint,
                unit=unit_of(joint),
                times_s=np.array(times_s),
                values=np.array([own[at_s][0] for at_s in times_s]),
                lines=np.array(lines, dtype=np.int32) if any(lines) else None,
            )
        )
    return ForeignMotion(
        path=path,
        name=motion_name(path, name),
        channels=tuple(channels),
        notes={},
        comments=tuple(comments),
        is_recording=any(is_dense(channel.times_s) for channel in channels),
    )


def recording(
    path: Path,
    name: str,
    channels: Sequence[Channel],
    *,
    comments: Sequence[str] = (),
    ease: Interpolation = Interpolation.SMOOTH,
) -> ForeignMotion:
    """Return a recording; each channel has its own sample times."""
    return ForeignMotion(
        path=path,
        name=motion_name(path, name),
        channels=tuple(channels),
        notes={},
        ease=ease,
        comments=tuple(comments),
        is_recording=True,
    )


def thinned(times_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rounded samples at increasing times; of samples at the same time, the first."""
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
