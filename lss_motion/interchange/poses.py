"""Poses at times, as most formats give them, to a motion of channels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.errors import InputError
from lss_motion.interchange.reader import (
    DIGITS,
    Channel,
    ForeignMotion,
    Note,
    Unit,
    is_dense,
    motion_label,
)
from lss_motion.sequence.model import Interpolation

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from lss_motion.interchange.reader import FloatArray


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
