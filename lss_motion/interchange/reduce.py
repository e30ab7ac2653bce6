"""Dense recordings to the fewest keys whose interpolation stays within a tolerance.

The interpolation is the one that the planner follows between keys: this module knows its shape, so
that the error that it reports is that of the motion that will be played.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.errors import InputError
from lss_motion.interchange.interpolant import interpolated
from lss_motion.interchange.key_choice import refined_keys, rough_keys
from lss_motion.interchange.reader import Unit
from lss_motion.sequence.timing import KEYFRAMES_MAX

if TYPE_CHECKING:
    from lss_motion.interchange.key_choice import IntArray
    from lss_motion.interchange.reader import Channel, ForeignMotion
    from lss_motion.sequence.model import Interpolation

TOLERANCE_DEG: Final = 1.0
"""How far keys may lead away from a recording, if nobody says otherwise (issue: `--tolerance-deg`).
Below what an eye sees on a figure, above the backlash of a servo."""

ANGLE_DECIMALS: Final = 4
"""Keys are written with these: a person can read them, and no servo resolves them."""

ROUNDING_DEG: Final = 0.5 * 10.0**-ANGLE_DECIMALS


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How well keys stand for a recording: measured at every one of its samples."""

    samples_count: int
    keys_count: int
    keyframes_count: int
    error_max_deg: float
    error_rms_deg: float
    joint: str
    """The joint of the largest error, at `at_s`."""
    at_s: float


def reduced(
    motion: ForeignMotion, tolerance_deg: float, ease: Interpolation
) -> tuple[ForeignMotion, Fit]:
    """Return a recording in degrees with the fewest keys, all of them samples, and how it fits.

    Raises `InputError` where as many keyframes as a sequence may have cannot stay within the
    tolerance.
    """
    assert all(channel.unit is Unit.DEG for channel in motion.channels), "map it first"
    rough = [rough_keys(channel, tolerance_deg, ease, 0.0) for channel in motion.channels]
    start_s, end_s, count = _span(motion, rough)
    step_s = 0.0
    if count > KEYFRAMES_MAX:
        # Too many different times: the joints share as many as a sequence may have.
        step_s = (end_s - start_s) / (KEYFRAMES_MAX - 2)
        rough = [rough_keys(channel, tolerance_deg, ease, step_s) for channel in motion.channels]
    channels: list[Channel] = []
    for channel, found in zip(motion.channels, rough, strict=True):
        keys = refined_keys(channel, tolerance_deg, ease, step_s, found)
        values = np.round(channel.values[keys], ANGLE_DECIMALS)
        channels.append(replace(channel, times_s=channel.times_s[keys], values=values))
    times_s = np.unique(np.concatenate([channel.times_s for channel in channels]))
    fit = _fit(motion, channels, ease, len(times_s))
    if len(times_s) > KEYFRAMES_MAX or fit.error_max_deg > tolerance_deg + ROUNDING_DEG:
        raise InputError(
            f"is too lively for {KEYFRAMES_MAX:,} keyframes: joint {fit.joint!r} would be "
            f"{fit.error_max_deg:.2f} deg off at {fit.at_s:.3f} s, {tolerance_deg:g} deg are "
            "allowed; give a larger --tolerance-deg, or cut the recording in parts",
            path=motion.path,
        )
    notes = {at_s: note for at_s, note in motion.notes.items() if at_s in set(times_s.tolist())}
    lost = sum(bool(note.label) for note in motion.notes.values()) - sum(
        bool(note.label) for note in notes.values()
    )
    comments = (*motion.comments, *([f"Not carried over: {lost} names of poses"] if lost else []))
    return (
        replace(
            motion,
            channels=tuple(channels),
            notes=notes,
            ease=ease,
            comments=comments,
            is_recording=False,
        ),
        fit,
    )


def _span(motion: ForeignMotion, kept: list[IntArray]) -> tuple[float, float, int]:
    """Return the first and last time of the keys, and how many different ones there are."""
    times_s = np.unique(
        np.concatenate([c.times_s[keys] for c, keys in zip(motion.channels, kept, strict=True)])
    )
    return float(times_s[0]), float(times_s[-1]), len(times_s)


def _fit(
    motion: ForeignMotion, channels: list[Channel], ease: Interpolation, keyframes_count: int
) -> Fit:
    worst = (-1.0, "", 0.0)
    squares = 0.0
    samples_count = 0
    for whole, keys in zip(motion.channels, channels, strict=True):
        error_deg = np.abs(
            interpolated(ease, keys.times_s, keys.values, whole.times_s) - whole.values
        )
        at = int(np.argmax(error_deg))
        if error_deg[at] > worst[0]:
            worst = (float(error_deg[at]), whole.name, float(whole.times_s[at]))
        squares += float(error_deg @ error_deg)
        samples_count += len(error_deg)
    return Fit(
        samples_count=samples_count,
        keys_count=sum(len(channel.times_s) for channel in channels),
        keyframes_count=keyframes_count,
        error_max_deg=worst[0],
        error_rms_deg=math.sqrt(squares / samples_count),
        joint=worst[1],
        at_s=worst[2],
    )
