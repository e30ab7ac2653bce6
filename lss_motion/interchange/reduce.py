"""Reduces a dense recording to few keys whose interpolation stays within a tolerance.

`reduced` is the entry. `recorded` has the recording of a joint and the curve through its keys, as
it will be played. `rough_keys` and `refined_keys` find keys whose angles are samples: they start
with the ends and the rests, are added until the curve fits, then those that are not needed are
removed, and the others moved so that more of them can be removed. `shared_keys` lets joints share
times. `fitted_keys` finds fewer with fitted angles, at shared instants; where it does not, as with
some splines that keep limits, the samples are taken.

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
from lss_motion.interchange.reader import DIGITS, Measure
from lss_motion.interchange.recorded import (
    BSPLINE_SHIFT_MAX_DEG,
    bspline_values,
    curve_of,
    interpolated,
)
from lss_motion.show.model import KEYFRAMES_MAX, Interpolation

if TYPE_CHECKING:
    from collections.abc import Mapping
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from lss_motion.interchange.reader import Channel, ForeignMotion
    from lss_motion.interchange.recorded import JointLimits, Recorded

    FloatArray = NDArray[np.float64]
    IntArray = NDArray[np.intp]

APART: Final = 4
"""Distance, in keys, of keys that are tried at the same time. Removing a key changes a smooth curve
from two keys before it to two keys after it, and a spline only little beyond that."""

PULL: Final = 6
"""Distance, in keys, at which a key still changes a spline: by 0.27 to the power of 6, 0.04 %."""

REST_MIN_S: Final = 0.25
"""A joint at rest for this long was put there; both ends of the rest are the first keys."""

FAR_APART: Final = 12
"""As `APART`, for the last pass: splines do not influence each other over this distance, because
each key leaves a quarter of a change, so 0.02 % here."""

SHIFTS: Final = (-16, -8, -4, -2, -1, 1, 2, 4, 8, 16)
"""Shifts of a key, in samples, that are tried to reduce the error."""

ROUNDS: Final = 2
"""Rounds of moving keys and removing the keys that are no longer needed."""

SWEEPS_MAX: Final = 12
"""Rounds of removing keys. Measured: the last rounds remove less than 0.1 % of the keys."""


def rough_keys(curve: Recorded) -> IntArray:
    """Return samples that fit as keys, close to the smallest number."""
    if float(np.abs(curve.values - curve.key_values[0]).max()) <= curve.tolerance_deg:
        return np.zeros(1, dtype=np.intp)
    keys = _grown(curve)
    if not curve.fits(keys):
        return keys  # There are too few candidates; the caller reports that.
    return without_plain_keys(curve, keys, APART)


def refined_keys(curve: Recorded, keys: IntArray) -> IntArray:
    """Return fewer keys: keys are moved so that more of them can be removed."""
    if len(keys) == 1 or not curve.fits(keys):
        return keys
    for _ in range(ROUNDS):
        shifted = _shifted(curve, keys)
        if not curve.fits(shifted):
            break  # Rare: shifts of adjacent splines add up.
        keys = without_plain_keys(curve, shifted, APART)
    return without_plain_keys(curve, keys, FAR_APART)


def shared_keys(curves: SequenceOf[Recorded], keys: SequenceOf[IntArray]) -> list[IntArray]:
    """Return keys at fewer different times: joints use the times of joints with more keys."""
    result = list(keys)
    taken_s = np.empty(0)
    for index in sorted(range(len(keys)), key=lambda index: -len(keys[index])):
        curve, own = curves[index], keys[index]
        there = np.flatnonzero(np.isin(curve.times_s, taken_s) & curve.candidates)
        if len(own) > 2 and len(there) and curve.fits(own):
            own = without_plain_keys(curve, _moved_to(curve, own, there), APART)
        result[index] = own
        taken_s = np.union1d(taken_s, curve.times_s[own])
    return result


def _moved_to(curve: Recorded, keys: IntArray, there: IntArray) -> IntArray:
    """Return the keys with as many of them as fit at the samples `there`.

    A key moves to the nearest of these samples, else to the next on its other side, else it gives
    way to both.
    """
    for way in (_nearer, _farther, _both):
        for phase in range(APART):
            inner = np.flatnonzero(~np.isin(keys, there))
            tried = inner[(inner > 0) & (inner < len(keys) - 1) & (inner % APART == phase)]
            while len(tried):
                at = np.searchsorted(there, keys[tried])
                before = there[np.maximum(at - 1, 0)]
                after = there[np.minimum(at, len(there) - 1)]
                places = way(keys[tried], before, after)
                moved = np.union1d(np.delete(keys, tried), places)
                moved = moved[(moved >= keys[0]) & (moved <= keys[-1])]
                worst_deg = np.maximum.reduceat(curve.error_deg(moved), keys)
                is_bad = _is_near_bad(worst_deg > curve.tolerance_deg, tried)
                if not is_bad.any():
                    keys = moved
                    break
                tried = tried[~is_bad]
    return keys


def _nearer(keys: IntArray, before: IntArray, after: IntArray) -> IntArray:
    return np.where(np.abs(keys - before) <= np.abs(after - keys), before, after)


def _farther(keys: IntArray, before: IntArray, after: IntArray) -> IntArray:
    return np.where(np.abs(keys - before) <= np.abs(after - keys), after, before)


def _both(_keys: IntArray, before: IntArray, after: IntArray) -> IntArray:
    return np.concatenate([before, after])


def _grown(curve: Recorded) -> IntArray:
    """Return keys that fit: first the rests, then the worst sample of every bad span."""
    is_candidate = curve.candidates
    rests = _rests(curve)
    keys = np.union1d([0, len(curve.times_s) - 1], rests[is_candidate[rests]])
    while True:
        error_deg = curve.error_deg(keys)
        bad = np.maximum.reduceat(error_deg, keys[:-1]) > curve.tolerance_deg
        is_open = is_candidate.copy()
        is_open[keys] = False
        error_deg[~is_open] = -1.0
        worst_deg = np.maximum.reduceat(error_deg, keys[:-1])
        bad |= _around(bad & (worst_deg < 0.0))
        spans = np.repeat(np.arange(len(keys) - 1), np.diff(keys))
        is_worst = (error_deg[: keys[-1]] == worst_deg[spans]) & (bad & (worst_deg >= 0.0))[spans]
        found = np.flatnonzero(is_worst)
        if not len(found):
            return keys
        _, first_of_span = np.unique(spans[found], return_index=True)
        keys = np.union1d(keys, found[first_of_span])


def _around(is_full: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the spans near full bad spans; a new key in one of them changes the bad one too."""
    reach = np.ones(2 * PULL + 1)
    return np.asarray(np.convolve(is_full, reach)[PULL:-PULL] > 0.0)


def _rests(curve: Recorded) -> IntArray:
    """Return both ends of every rest: the joint stays within half the tolerance."""
    times_s = curve.times_s
    ends: list[int] = []
    first = 0
    low = high = float(curve.values[0])
    for index, value in enumerate(curve.values.tolist()):
        low, high = min(low, value), max(high, value)
        if high - low > 0.5 * curve.tolerance_deg:
            if times_s[index - 1] - times_s[first] >= REST_MIN_S:
                ends += [first, index - 1]
            first, low, high = index, value, value
    if times_s[-1] - times_s[first] >= REST_MIN_S:
        ends += [first, len(times_s) - 1]
    return np.array(ends, dtype=np.intp)


def without_plain_keys(curve: Recorded, keys: IntArray, apart: int = FAR_APART) -> IntArray:
    """Return the keys that are needed while all others stay; those `apart` are tried together."""
    for _ in range(SWEEPS_MAX):
        before = len(keys)
        for phase in range(apart):
            tried = np.arange(1 + phase, len(keys) - 1, apart)
            while len(tried):
                error_deg = curve.error_deg(np.delete(keys, tried))
                worst_deg = np.maximum.reduceat(error_deg, keys)
                is_bad = _is_near_bad(worst_deg > curve.tolerance_deg, tried)
                if not is_bad.any():
                    keys = np.delete(keys, tried)
                    break
                tried = tried[~is_bad]
        if len(keys) == before:
            break
    return keys


def _shifted(curve: Recorded, keys: IntArray) -> IntArray:
    """Return the keys, each moved to a sample nearby if that reduces the error."""
    is_candidate = curve.candidates
    keys = keys.copy()
    for phase in range(APART):
        tried = np.arange(1 + phase, len(keys) - 1, APART)
        if not len(tried):
            continue
        # Each key is judged by the samples from two keys before it to two keys after it.
        starts = keys[np.maximum(tried - APART // 2, 0)]
        starts[0] = 0
        best = np.add.reduceat(curve.error_deg(keys) ** 2, starts)
        for step in SHIFTS:
            moved = keys.copy()
            moved[tried] += step
            fits = (moved[tried] > keys[tried - 1]) & (moved[tried] < keys[tried + 1])
            fits &= is_candidate[np.clip(moved[tried], 0, len(curve.times_s) - 1)]
            moved[tried[~fits]] = keys[tried[~fits]]
            error_deg = curve.error_deg(moved)
            total = np.add.reduceat(error_deg**2, starts)
            is_within = np.maximum.reduceat(error_deg, starts) <= curve.tolerance_deg
            is_better = fits & is_within & (total < best)
            keys[tried[is_better]] = moved[tried[is_better]]
            best[is_better] = total[is_better]
    return keys


def _is_near_bad(bad_spans: NDArray[np.bool_], tried: IntArray) -> NDArray[np.bool_]:
    """Return which of the `tried` keys are the nearest to a bad span, and so its cause."""
    bad = np.flatnonzero(bad_spans)
    is_blamed = np.zeros(len(tried), dtype=np.bool_)
    # Span n lies between keys n and n + 1.
    after = np.clip(np.searchsorted(tried, bad + 1), 0, len(tried) - 1)
    before = np.maximum(after - 1, 0)
    is_nearer = bad - tried[before] <= tried[after] - bad - 1
    is_blamed[np.where(is_nearer, before, after)] = True
    return is_blamed


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
    limits: Mapping[str, JointLimits] | None = None,
) -> tuple[ForeignMotion, KeyFit]:
    """Return a recording in degrees reduced to few keys, at times of samples, and its `KeyFit`.

    Keys of different joints are at the same times where the tolerance allows. Where the recording
    keeps the `limits` of its joint, a spline through the keys keeps them too.
    Raises `InputError` if even as many keyframes as a sequence may have exceed the tolerance.
    """
    assert all(channel.unit is Measure.DEG for channel in motion.channels), "map it first"
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
    curves: SequenceOf[Recorded], motion: ForeignMotion
) -> tuple[list[Recorded], list[IntArray]]:
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


def _fewer(
    curves: list[Recorded], keys_of: list[IntArray]
) -> tuple[list[Recorded], list[IntArray]]:
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


def _rounded(curve: Recorded, keys: IntArray) -> FloatArray:
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
