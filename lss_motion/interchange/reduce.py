"""Reduces a dense recording to few keys whose interpolation stays within a tolerance.

`reduced` is the entry. `recorded` has the recording of a joint and the curve through its keys, as
it will be played. `sample_keys` finds keys whose angles are samples, `fitted_keys` fewer of them
with fitted angles, at instants that the joints share.

A recording has one ease for all its keys. Measured on 37 motions (Talos, Tiago, OP3, two of
bit-bots and one of Webots), sampled at 50 Hz in tenths of a degree, the best ease for each
joint would save 9.0 % of 1,374 keys at 1 degree and 1.5 % of 917 at 5 degrees. The fewest keys
in each 2 s of each joint, as if a change of ease cost no key, are 17.0 % and 10.7 % less: an
ease per key saves less.
"""

from __future__ import annotations

import math
from collections import defaultdict
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import counted
from lss_motion.interchange.fitted_keys import fitted_together, without_spare_keys
from lss_motion.interchange.reader import DIGITS, Unit
from lss_motion.interchange.recorded import (
    BSPLINE_SHIFT_MAX_DEG,
    bspline_values,
    curve_of,
    interpolated,
)
from lss_motion.interchange.sample_keys import (
    refined_keys,
    rough_keys,
    shared_keys,
    without_plain_keys,
)
from lss_motion.show.model import KEYFRAMES_MAX, Interpolation

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from lss_motion.interchange.reader import Channel, ForeignMotion
    from lss_motion.interchange.recorded import Curve, Limits

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]


TOLERANCE_DEG: Final = 1.0
"""Default of `--tolerance-deg`: the largest error of the keys. Less than an eye sees on a figure,
more than the backlash of a servo."""

ANGLE_DECIMALS: Final = 4
"""Decimals of most keys: easy to read, and finer than a servo resolves."""

CLOSE_S: Final = 0.1
"""Keys closer than this have `DIGITS` decimals, because rounding to 4 would change the acceleration
(by 6 deg/s² for keys 10 ms apart, by 0.06 deg/s² for 100 ms)."""

EDGE_DEG: Final = 0.01
"""A joint this close to the end of its range has keys with `DIGITS` decimals, so that rounding does
not move the spline out of the range."""

ROUNDING_DEG: Final = 0.5 * 10.0**-ANGLE_DECIMALS

MORE_RATIO: Final = 1.25
"""Fitted keys may begin at so many times the instants of sample keys: a tenth falls away later."""


class KeyFit(Struct, frozen=True, kw_only=True):
    """Result of a reduction; the errors are measured at every sample of the recording."""

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
) -> tuple[ForeignMotion, KeyFit]:
    """Return a recording in degrees reduced to few keys, at times of samples, and its `KeyFit`.

    Keys of different joints are at the same times where the tolerance allows. Where the recording
    keeps the `limits` of its joint, a spline through the keys keeps them too.
    Raises `InputError` if even as many keyframes as a sequence may have exceed the tolerance.
    """
    assert all(channel.unit is Unit.DEG for channel in motion.channels), "map it first"
    curves = [
        curve_of(channel, tolerance_deg, ease, (limits or {}).get(channel.name))
        for channel in motion.channels
    ]
    curves, keys_of = _few_keys(curves, motion)
    channels: list[Channel] = []
    for channel, curve, keys in zip(motion.channels, curves, keys_of, strict=True):
        own_lines = None if channel.lines is None else channel.lines[keys]
        values = _rounded(curve, keys)
        channels.append(
            replace(channel, times_s=curve.times_s[keys], values=values, lines=own_lines)
        )
    times_s = np.unique(np.concatenate([channel.times_s for channel in channels]))
    fit = _fit(motion, channels, ease, len(times_s))
    if len(times_s) > KEYFRAMES_MAX or fit.error_max_deg > tolerance_deg + ROUNDING_DEG:
        raise InputError(
            f"needs more than {KEYFRAMES_MAX:,} keyframes: joint {fit.joint!r} would be "
            f"{fit.error_max_deg:.2f} deg off at {fit.at_s:.3f} s, {tolerance_deg:g} deg are "
            "allowed; give a larger --tolerance-deg, or cut the recording into parts",
            path=motion.path,
        )
    notes = {at_s: note for at_s, note in motion.notes.items() if at_s in set(times_s.tolist())}
    lost = sum(bool(note.label) for note in motion.notes.values()) - sum(
        bool(note.label) for note in notes.values()
    )
    comments = (
        *motion.comments,
        *([f"Not carried over: {counted(lost, 'name')} of poses"] if lost else []),
    )
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


def _few_keys(
    curves: SequenceOf[Curve], motion: ForeignMotion
) -> tuple[list[Curve], list[IntArray]]:
    """Return the curves with the angles of their keys, and the keys: fitted ones where fewer."""
    rough = [rough_keys(curve) for curve in curves]
    start_s, end_s, count = _span(motion, rough)
    if count > KEYFRAMES_MAX:
        # Too many different times: the joints share a grid of as many times as a sequence may have.
        step_s = (end_s - start_s) / (KEYFRAMES_MAX - 2)
        curves = [replace(curve, step_s=step_s) for curve in curves]
        rough = [rough_keys(curve) for curve in curves]
    refined = [refined_keys(curve, found) for curve, found in zip(curves, rough, strict=True)]
    made, keys_of = list(curves), shared_keys(curves, refined)
    groups: defaultdict[bytes, list[int]] = defaultdict(list)
    for index, (curve, keys) in enumerate(zip(curves, keys_of, strict=True)):
        if len(keys) > 2:
            groups[curve.times_s.tobytes()].append(index)
    for group in groups.values():
        own = [curves[at] for at in group], [keys_of[at] for at in group]
        for at, curve, keys in zip(group, *_fewer(*own), strict=True):
            made[at], keys_of[at] = curve, keys
    return made, keys_of


def _fewer(curves: list[Curve], keys_of: list[IntArray]) -> tuple[list[Curve], list[IntArray]]:
    """Return the keys of joints that were sampled together, fitted ones if there are fewer."""
    margin_deg = min(ROUNDING_DEG, 0.01 * curves[0].tolerance_deg)
    pairs = [
        without_spare_keys(curve, keys, margin_deg) if curve.fits(keys) else (curve, keys)
        for curve, keys in zip(curves, keys_of, strict=True)
    ]
    best = [curve for curve, _ in pairs], [keys for _, keys in pairs]
    instants = len(np.unique(np.concatenate(best[1])))
    found = fitted_together(curves, min(KEYFRAMES_MAX, round(MORE_RATIO * instants)), margin_deg)
    if found is not None and len(np.unique(np.concatenate(found[1]))) <= instants:
        best = found
    return best[0], [without_plain_keys(curve, keys) for curve, keys in zip(*best, strict=True)]


def every_sample(motion: ForeignMotion, ease: Interpolation) -> ForeignMotion:
    """Return a recording in degrees with all its samples as keys."""
    return replace(
        motion,
        channels=tuple(
            replace(c, values=bspline_values(c.times_s, c.values, BSPLINE_SHIFT_MAX_DEG))
            if ease is Interpolation.SPLINE
            else c
            for c in motion.channels
        ),
        ease=ease,
    )


def _rounded(curve: Curve, keys: IntArray) -> FloatArray:
    """Return the angles of the keys, rounded to the decimals that they need."""
    times_s, values = curve.times_s[keys], curve.key_values[keys]
    low_deg, high_deg = curve.range_deg
    if values.min() < low_deg + EDGE_DEG or values.max() > high_deg - EDGE_DEG:
        return np.round(values, DIGITS)
    is_close = np.diff(times_s) < CLOSE_S
    is_close = np.append(is_close, False) | np.append(False, is_close)
    return np.where(is_close, np.round(values, DIGITS), np.round(values, ANGLE_DECIMALS))


def _span(motion: ForeignMotion, kept: list[IntArray]) -> tuple[float, float, int]:
    """Return the first and the last time of all keys, and the number of different times."""
    times_s = np.unique(
        np.concatenate([c.times_s[keys] for c, keys in zip(motion.channels, kept, strict=True)])
    )
    return float(times_s[0]), float(times_s[-1]), len(times_s)


def _fit(
    motion: ForeignMotion, channels: list[Channel], ease: Interpolation, keyframes_count: int
) -> KeyFit:
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
    return KeyFit(
        samples_count=samples_count,
        keys_count=sum(len(channel.times_s) for channel in channels),
        keyframes_count=keyframes_count,
        error_max_deg=worst[0],
        error_rms_deg=math.sqrt(squares / samples_count),
        joint=worst[1],
        at_s=worst[2],
    )
