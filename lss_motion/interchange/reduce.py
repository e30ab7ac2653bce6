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
from lss_motion.interchange.key_choice import Curve, refined_keys, rough_keys
from lss_motion.interchange.reader import DIGITS, Unit
from lss_motion.interchange.samples import EVENING_MAX_DEG, drive, evened
from lss_motion.sequence.model import Interpolation
from lss_motion.sequence.timing import KEYFRAMES_MAX

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.interchange.interpolant import FloatArray, IntArray
    from lss_motion.interchange.reader import Channel, ForeignMotion

TOLERANCE_DEG: Final = 1.0
"""How far keys may lead away from a recording, if nobody says otherwise (issue: `--tolerance-deg`).
Below what an eye sees on a figure, above the backlash of a servo."""

ANGLE_DECIMALS: Final = 4
"""Keys are written with these: a person can read them, and no servo resolves them."""

CLOSE_S: Final = 0.1
"""Keys this close are written with `DIGITS`: there rounding to 4 would be seen in the acceleration
(10 ms apart, 6 deg/s²; 100 ms apart, 0.06 deg/s²)."""

EDGE_DEG: Final = 0.01
"""A joint that comes this near to the end of its range has all its keys written with `DIGITS`, so
that rounding swings no spline beyond it."""

ROUNDING_DEG: Final = 0.5 * 10.0**-ANGLE_DECIMALS

EVENING_RATIO: Final = 0.5
"""The most of the tolerance that is spent on keys beside their samples. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a joint may be asked for: speed, acceleration, and where it may be."""

    speed_deg_s: float
    accel_deg_s2: float
    range_deg: tuple[float, float]


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
    motion: ForeignMotion,
    tolerance_deg: float,
    ease: Interpolation,
    limits: Mapping[str, Limits] | None = None,
) -> tuple[ForeignMotion, Fit]:
    """Return a recording in degrees with the fewest keys, at times of samples, and how it fits.

    Where the recording keeps the `limits` of its joint, so does a spline through its keys. Raises
    `InputError` where as many keyframes as a sequence may have cannot stay within the tolerance.
    """
    assert all(channel.unit is Unit.DEG for channel in motion.channels), "map it first"
    curves = [
        _curve(channel, tolerance_deg, ease, (limits or {}).get(channel.name))
        for channel in motion.channels
    ]
    rough = [rough_keys(curve) for curve in curves]
    start_s, end_s, count = _span(motion, rough)
    if count > KEYFRAMES_MAX:
        # Too many different times: the joints share as many as a sequence may have.
        step_s = (end_s - start_s) / (KEYFRAMES_MAX - 2)
        curves = [replace(curve, step_s=step_s) for curve in curves]
        rough = [rough_keys(curve) for curve in curves]
    channels: list[Channel] = []
    for channel, curve, found in zip(motion.channels, curves, rough, strict=True):
        keys = refined_keys(curve, found)
        channels.append(replace(channel, times_s=curve.times_s[keys], values=_rounded(curve, keys)))
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


def every_sample(motion: ForeignMotion, ease: Interpolation) -> ForeignMotion:
    """Return a recording in degrees with all its samples as keys."""
    return replace(
        motion,
        channels=tuple(
            replace(c, values=evened(c.times_s, c.values, EVENING_MAX_DEG))
            if ease is Interpolation.SPLINE
            else c
            for c in motion.channels
        ),
        ease=ease,
    )


def _curve(
    channel: Channel, tolerance_deg: float, ease: Interpolation, limit: Limits | None
) -> Curve:
    times_s, values = channel.times_s, channel.values
    key_values = values
    most = (np.full(len(values), math.inf),) * 2
    range_deg = (-math.inf, math.inf)
    if ease is Interpolation.SPLINE and limit is not None:
        key_values = evened(times_s, values, min(EVENING_MAX_DEG, EVENING_RATIO * tolerance_deg))
        speed, accel = drive(times_s, values)
        most = np.maximum(speed, limit.speed_deg_s), np.maximum(accel, limit.accel_deg_s2)
        range_deg = (
            min(limit.range_deg[0], float(key_values.min())),
            max(limit.range_deg[1], float(key_values.max())),
        )
    return Curve(
        times_s=times_s,
        values=values,
        key_values=key_values,
        speed_max_deg_s=most[0],
        accel_max_deg_s2=most[1],
        tolerance_deg=tolerance_deg,
        ease=ease,
        range_deg=range_deg,
    )


def _rounded(curve: Curve, keys: IntArray) -> FloatArray:
    """Return the angles of keys with as many decimals as they need."""
    times_s, values = curve.times_s[keys], curve.key_values[keys]
    low_deg, high_deg = curve.range_deg
    if values.min() < low_deg + EDGE_DEG or values.max() > high_deg - EDGE_DEG:
        return np.round(values, DIGITS)
    is_close = np.diff(times_s) < CLOSE_S
    is_close = np.append(is_close, False) | np.append(False, is_close)
    return np.where(is_close, np.round(values, DIGITS), np.round(values, ANGLE_DECIMALS))


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
