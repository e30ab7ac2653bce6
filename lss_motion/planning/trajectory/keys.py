"""A sequence joint by joint: the keys of each joint, checked, and their positions along the path.

The path position is in seconds (`_s`). If the author's times count (`is_timed`), it is the authored
time, plus what must be added where keys are too close together. Otherwise keyframes lie between
rests as far apart as their points (chord lengths), so that the spacing of keys in the file does not
shape the curve; from rest to rest as far as the moves need at least.
"""

from __future__ import annotations

import itertools
import math
from difflib import get_close_matches
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.show.model import Interpolation, Timing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Keyframe, Sequence

    FloatArray = NDArray[np.float64]


SAME_INSTANT_S: Final = 1e-9
"""Times closer than this are one instant. Chosen: a thousandth of a program's unit of time."""

SAME_ANGLE_DEG: Final = 1e-9
"""Angles closer than this are equal. Chosen: far below the unit on the bus."""

STEP_RATIO: Final = 1.0 + 1e-6
"""One step of a servo, and rounding of the angles in a file."""

HOPELESS_RATIO: Final = 0.1
"""An authored move gets at least this share of the duration that it needs alone. Chosen: such a
move is slowed tenfold anyway, and smaller shares make the solver inaccurate (keys 1 ms apart would
need path rates near 0.002)."""

PASSING_RATIO: Final = 0.5
"""That least duration is never above this share of the duration at full speed, because samples of
a motion are closer together than moves from rest to rest could be. Chosen: samples of a motion
within the limits keep their times, and so do those of a motion up to twice as fast."""

STOPPING: Final = (Interpolation.LINEAR, Interpolation.HOLD, Interpolation.COMMAND)
"""Moves that begin and end at rest."""

PATH_DECIMALS: Final = 9
"""Path positions are rounded to 1 ns, so that equal instants of different joints compare equal."""


class Key(Struct, frozen=True, kw_only=True):
    """One joint's angle at one keyframe (`index`), kept for `hold_s`."""

    index: int
    deg: float
    hold_s: float
    ease: Interpolation
    slope_deg_s: float = math.nan
    """The slope with which the author lets the joint pass; NaN: the curve finds it."""
    is_stop: bool = False
    """The joint comes to rest here, although the author does not hold it."""
    delay_s: float = 0.0
    """The joint reaches the key so much later than the keyframe is, in path seconds."""

    @property
    def is_held(self) -> bool:
        """Whether the joint rests at the key, however short."""
        return self.hold_s > 0.0 or self.is_stop


def is_timed(sequence: Sequence) -> bool:
    """Return whether the author's times count; False: only the order of the keyframes counts."""
    if sequence.timing is Timing.FASTEST:
        return False
    return any(keyframe.at_s is not None for keyframe in sequence.keyframes)


def keys_by_joint(sequence: Sequence, robot: Robot) -> dict[str, tuple[Key, ...]]:
    """Return the keys of every joint in the sequence, in the order of the robot.

    Raises one `InputError` with all problems of the sequence.
    """
    problems = _problems(sequence, robot)
    has_times = is_timed(sequence)
    keys: dict[str, list[Key]] = {}
    for index, keyframe in enumerate(sequence.keyframes):
        for joint, deg in keyframe.deg.items():
            key = Key(
                index=index,
                deg=deg,
                hold_s=keyframe.hold_s,
                ease=keyframe.ease,
                slope_deg_s=keyframe.slope_deg_s.get(joint, math.nan),
            )
            own = keys.setdefault(joint, [])
            if own and has_times and (problem := _clash(own[-1], key, joint, sequence)):
                problems.append(problem)
            own.append(key)
    if sequence.loop != 1:
        problems += [
            InputError(
                f"the sequence is looped, but joint {joint!r} ends a pass at {own[-1].deg:g} deg "
                f"and starts it at {own[0].deg:g} deg: let the last keyframe return it",
                line=sequence.keyframes[own[-1].index].line,
                path=sequence.path,
            )
            for joint, own in keys.items()
            if abs(own[-1].deg - own[0].deg) > SAME_ANGLE_DEG
        ]
    problems += [
        InputError(
            f"joint {joint!r} moves with the ease command, which only joints that keep their time "
            "can do: write keep: time, or choose another ease",
            line=sequence.keyframes[key.index].line,
            path=sequence.path,
        )
        for joint, own in keys.items()
        if joint not in sequence.keeps_time
        for key in own[1:]
        if key.ease is Interpolation.COMMAND
    ][:1]
    if problems:
        first, *more = problems
        raise InputError(first.reason, path=first.path, line=first.line, more=more)
    return {joint: tuple(keys[joint]) for joint in robot.joints if joint in keys}


def _problems(sequence: Sequence, robot: Robot) -> list[InputError]:
    problems = [
        InputError(reason, path=sequence.path)
        for reason, is_wrong in (
            ("the sequence has no keyframes", not sequence.keyframes),
            (
                f"loop is {sequence.loop}, allowed 1 or more, or forever",
                sequence.loop is not None and sequence.loop < 1,
            ),
            (
                f"timing fit needs a duration above 0 s, not {sequence.fit_duration_s}",
                sequence.timing is Timing.FIT and not (sequence.fit_duration_s or 0.0) > 0.0,
            ),
        )
        if is_wrong
    ]
    needs_times = is_timed(sequence) or sequence.timing is Timing.AUTHORED
    earliest_s = 0.0
    for keyframe in sequence.keyframes:
        reasons = [*_angle_problems(keyframe, robot), *_time_problems(keyframe)]
        if needs_times and keyframe.at_s is None:
            reasons.append("no time, but timing authored needs one for every keyframe")
        if keyframe.is_anchor and not needs_times:
            reasons.append("an anchor needs a time that counts; use timing authored or fit")
        if needs_times and keyframe.at_s is not None:
            if keyframe.at_s < earliest_s:
                reasons.append(f"at {keyframe.at_s:g} s, but the one before is at {earliest_s:g} s")
            else:
                earliest_s = keyframe.at_s
        problems += [
            InputError(
                f"keyframe {named(keyframe)}: {reason}", path=sequence.path, line=keyframe.line
            )
            for reason in reasons
        ]
    return problems


def named(keyframe: Keyframe) -> str:
    """Return the name of a keyframe in messages: its label, else its time."""
    if keyframe.label:
        return repr(keyframe.label)
    return "without time" if keyframe.at_s is None else f"at {keyframe.at_s:g} s"


def _time_problems(keyframe: Keyframe) -> list[str]:
    reasons = []
    if keyframe.at_s is not None and not (math.isfinite(keyframe.at_s) and keyframe.at_s >= 0.0):
        reasons.append(f"time {keyframe.at_s} s, allowed 0 or more")
    if not (math.isfinite(keyframe.hold_s) and keyframe.hold_s >= 0.0):
        reasons.append(f"hold {keyframe.hold_s} s, allowed 0 or more")
    return reasons


def _angle_problems(keyframe: Keyframe, robot: Robot) -> list[str]:
    reasons = []
    for name, deg in keyframe.deg.items():
        joint = robot.joints.get(name)
        if joint is None:
            near = get_close_matches(name, robot.joints, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(robot.joints)}"
            reasons.append(f"no joint {name!r} in robot {robot.name!r}; {hint}")
        elif not joint.position_min_deg <= deg <= joint.position_max_deg:
            reasons.append(
                f"joint {name!r} at {deg:g} deg, "
                f"allowed {joint.position_min_deg:g} to {joint.position_max_deg:g} deg"
            )
    return reasons


def _clash(held: Key, key: Key, joint: str, sequence: Sequence) -> InputError | None:
    """Return the problem if `key` comes while the joint is still held at another angle."""
    free_s = (sequence.keyframes[held.index].at_s or 0.0) + held.hold_s
    at_s = sequence.keyframes[key.index].at_s or 0.0
    if at_s >= free_s - SAME_INSTANT_S or abs(key.deg - held.deg) <= SAME_ANGLE_DEG:
        return None
    return InputError(
        f"keyframe at {at_s:g} s: joint {joint!r} cannot be at {key.deg:g} deg, it is "
        f"held at {held.deg:g} deg until {free_s:g} s: come later or hold shorter",
        path=sequence.path,
        line=sequence.keyframes[key.index].line,
    )


class Spacing(Struct, frozen=True, kw_only=True):
    """Path positions at which each keyframe is reached, and at which its hold ends.

    `path_s` and `authored_s` map positions to authored times, piecewise linearly. Without
    authored times both are equal, and holds are not part of the path.
    """

    reached_s: FloatArray
    left_s: FloatArray
    path_s: FloatArray
    authored_s: FloatArray

    @property
    def length_s(self) -> float:
        return float(self.path_s[-1])

    def authored(self, path_s: FloatArray) -> FloatArray:
        """Return the authored time of path positions."""
        return np.interp(path_s, self.path_s, self.authored_s)


def least_move_s(move_deg: FloatArray, speed_deg_s: float, accel_deg_s2: float) -> FloatArray:
    """Return the least durations of moves from rest to rest: trapezoids or triangles of speed."""
    distance_deg = np.abs(move_deg)
    is_triangle = distance_deg <= speed_deg_s**2 / accel_deg_s2
    triangle_s = 2.0 * np.sqrt(distance_deg / accel_deg_s2)
    trapezoid_s = distance_deg / speed_deg_s + speed_deg_s / accel_deg_s2
    return np.where(is_triangle, triangle_s, trapezoid_s)


class Margins(Struct, frozen=True):
    """What a motion that is smoothed afterwards needs: longer rests, and keys that are shifted.

    Smoothing spreads a motion by `half_s` of its joint into the rests around it, so the rest is
    planned so much longer on each side. A key that is passed in motion would be missed by the
    smoothed motion; `shifts_deg`, by joint and keyframe, is added to its angle. At `stops` the
    joint comes to rest, because its keys are too close together for a shift. `delays_s` moves keys
    of a joint along the path, so that the smoothed motion turns when the keyframe is reached.
    """

    half_s: Mapping[str, float] = field(default_factory=dict)
    shifts_deg: Mapping[tuple[str, int], float] = field(default_factory=dict)
    stops: frozenset[tuple[str, int]] = frozenset()
    delays_s: Mapping[tuple[str, int], float] = field(default_factory=dict)

    def applied(self, joint: str, own: tuple[Key, ...]) -> tuple[Key, ...]:
        """Return the keys of a joint with their shifts, stops and delays."""
        return tuple(
            replace(
                key,
                deg=key.deg + self.shifts_deg.get((joint, key.index), 0.0),
                is_stop=(joint, key.index) in self.stops,
                delay_s=self.delays_s.get((joint, key.index), 0.0),
            )
            for key in own
        )


NO_MARGINS: Final = Margins()


def rests_at(
    deg: FloatArray,
    is_held: NDArray[np.bool_],
    eases: tuple[Interpolation, ...],
    slopes_deg_s: FloatArray,
) -> NDArray[np.bool_]:
    """Return for each key of a joint whether the joint rests there or stops at a corner."""
    is_rest = is_held.copy()
    is_rest[[0, -1]] = True
    is_passed = np.nan_to_num(slopes_deg_s) != 0.0
    is_still = np.abs(np.diff(deg)) <= SAME_ANGLE_DEG
    is_still &= ~(is_passed[1:] | is_passed[:-1])
    is_still |= np.array([ease in STOPPING for ease in eases[1:]], dtype=np.bool_)
    is_rest[1:] |= is_still
    is_rest[:-1] |= is_still
    return is_rest


def _rests(own: tuple[Key, ...]) -> NDArray[np.bool_]:
    return rests_at(
        np.array([key.deg for key in own]),
        np.array([key.is_held for key in own]),
        tuple(key.ease for key in own),
        np.array([key.slope_deg_s for key in own]),
    )


def spacing_of(
    sequence: Sequence,
    keys: Mapping[str, tuple[Key, ...]],
    robot: Robot,
    margins: Margins = NO_MARGINS,
) -> Spacing:
    """Return the spacing of the keyframes: authored if the sequence is timed, else the least."""
    is_authored = is_timed(sequence)
    needs = _needs(keys, robot, margins, is_authored=is_authored)
    if is_authored:
        return _timed(sequence, needs)
    count = len(sequence.keyframes)
    reached_s = _apart(needs, count)
    chords_s = _apart(_chords(keys, robot), count)
    stops = np.flatnonzero(_all_rest(keys, count))
    for first, end in itertools.pairwise(stops.tolist()):
        chord_s, least_s = (at_s[end] - at_s[first] for at_s in (chords_s, reached_s))
        if end - first > 1 and chord_s > 0.0:
            own = slice(first + 1, end)
            shares = (chords_s[own] - chords_s[first]) / chord_s
            reached_s[own] = np.round(reached_s[first] + least_s * shares, PATH_DECIMALS)
    ends_s = np.array([0.0, reached_s[-1]])
    return Spacing(reached_s=reached_s, left_s=reached_s, path_s=ends_s, authored_s=ends_s)


def _apart(needs: Mapping[int, list[tuple[int, float]]], count: int) -> FloatArray:
    """Return the least positions of keyframes that are as far apart as needed."""
    reached_s = np.zeros(count)
    previous_s = 0.0
    for index in range(count):
        for earlier, least_s in needs.get(index, ()):
            previous_s = max(previous_s, round(reached_s[earlier] + least_s, PATH_DECIMALS))
        reached_s[index] = previous_s
    return reached_s


def _chords(
    keys: Mapping[str, tuple[Key, ...]], robot: Robot
) -> dict[int, list[tuple[int, float]]]:
    """Return for each keyframe the earlier ones, and how long the moves from them take at speed.

    Between rests keyframes are as far apart as that, in proportion: the shape of a curve then
    follows its points. The least durations of moves from rest to rest are those of many stops.
    """
    chords_s: dict[tuple[int, int], float] = {}
    for name, own in keys.items():
        for before, after in itertools.pairwise(own):
            chord_s = abs(after.deg - before.deg) / robot.joints[name].speed_max_deg_s
            pair = before.index, after.index
            chords_s[pair] = math.hypot(chords_s.get(pair, 0.0), chord_s)
    found: dict[int, list[tuple[int, float]]] = {}
    for (earlier, index), chord_s in chords_s.items():
        found.setdefault(index, []).append((earlier, chord_s))
    return found


def _all_rest(keys: Mapping[str, tuple[Key, ...]], count: int) -> NDArray[np.bool_]:
    """Return for each keyframe whether no joint moves there."""
    is_rest = np.ones(count, dtype=np.bool_)
    for own in keys.values():
        rests = _rests(own)
        for key, rests_here in zip(own, rests.tolist(), strict=True):
            is_rest[key.index] &= rests_here
        for before, after in itertools.pairwise(own):
            if abs(after.deg - before.deg) > SAME_ANGLE_DEG:
                is_rest[before.index + 1 : after.index] = False
    is_rest[[0, -1]] = True
    return is_rest


def _repeats(kept: Keyframe, frame: Keyframe, robot: Robot) -> bool:
    """Return whether a keyframe is the same as the one kept before it, but for less than a step."""
    is_told_apart = frame.hold_s > 0.0 or frame.is_anchor or frame.is_exact
    if is_told_apart or frame.ease != kept.ease or frame.deg.keys() != kept.deg.keys():
        return False
    return all(
        name in robot.joints
        and abs(deg - kept.deg[name]) <= STEP_RATIO * robot.joints[name].unit_deg
        for name, deg in frame.deg.items()
    )


def merged(sequence: Sequence, robot: Robot) -> tuple[Sequence, tuple[int, ...]]:
    """Return the sequence without keyframes that repeat, and for each keyframe which one it is now.

    Without authored times a keyframe all of whose joints are within one step of their servos from
    the keyframe kept before it is the same one, if no hold and no other ease tells it apart. The
    last keyframe is kept instead of those that are the same.
    """
    frames = sequence.keyframes
    if is_timed(sequence) or sequence.timing is Timing.AUTHORED or len(frames) < 3:
        return sequence, tuple(range(len(frames)))
    kept: list[int] = []
    now_of: list[int] = []
    for index, frame in enumerate(frames):
        is_last = index == len(frames) - 1
        if not kept or not _repeats(frames[kept[-1]], frame, robot):
            kept.append(index)
        elif is_last and len(kept) > 1 and frames[kept[-1]].hold_s == 0.0:
            kept[-1] = index
        elif is_last:
            kept.append(index)
        now_of.append(len(kept) - 1)
    if len(kept) == len(frames):
        return sequence, tuple(range(len(frames)))
    return replace(sequence, keyframes=tuple(frames[index] for index in kept)), tuple(now_of)


def authored_spacing(sequence: Sequence) -> Spacing:
    """Return the spacing at exactly the authored times, however little time a move has."""
    return _timed(sequence, {})


def _needs(
    keys: Mapping[str, tuple[Key, ...]], robot: Robot, margins: Margins, *, is_authored: bool
) -> dict[int, list[tuple[int, float]]]:
    """Return for each keyframe pairs: an earlier keyframe, and the least path distance from it.

    Without authored times the distance is the least duration of the move between the two.
    """
    needs: dict[int, list[tuple[int, float]]] = {}
    for name, own in keys.items():
        joint = robot.joints[name]
        moves_deg = np.diff([key.deg for key in own])
        least_s = least_move_s(moves_deg, joint.speed_max_deg_s, joint.accel_max_deg_s2)
        if is_authored:
            passing_s = PASSING_RATIO * np.abs(moves_deg) / joint.speed_max_deg_s
            least_s = np.minimum(HOPELESS_RATIO * least_s, passing_s)
        if half_s := margins.half_s.get(name, 0.0):
            is_rest = _rests(own)
            rests_s = np.where(is_rest, half_s, 0.0)
            least_s = np.where(least_s > 0.0, least_s + rests_s[1:] + rests_s[:-1], least_s)
        for before, after, seconds in zip(own, own[1:], least_s.tolist(), strict=False):
            needs.setdefault(after.index, []).append((before.index, seconds))
    return needs


def _timed(sequence: Sequence, needs: Mapping[int, list[tuple[int, float]]]) -> Spacing:
    count = len(sequence.keyframes)
    at_s = np.array([keyframe.at_s or 0.0 for keyframe in sequence.keyframes])
    holds_s = np.array([keyframe.hold_s for keyframe in sequence.keyframes])
    authored_s = np.round(np.stack([at_s, at_s + holds_s], axis=1), PATH_DECIMALS).ravel()
    order = np.argsort(authored_s, kind="stable")
    path_s = np.zeros(2 * count)
    last_s = last_authored_s = 0.0
    for event in order.tolist():
        # Where nothing was added so far, the difference is exactly 0 and authored times stay exact.
        position_s = authored_s[event] + (last_s - last_authored_s)
        index, is_end = divmod(event, 2)
        if not is_end:
            for earlier, least_s in needs.get(index, ()):
                floor_s = path_s[2 * earlier + 1] + least_s
                if floor_s > position_s:
                    position_s = round(floor_s, PATH_DECIMALS)
        path_s[event] = last_s = position_s
        last_authored_s = authored_s[event]
    path_s = np.round(path_s, PATH_DECIMALS)
    return Spacing(
        reached_s=path_s[0::2],
        left_s=path_s[1::2],
        path_s=np.concatenate([[0.0], path_s[order]]),
        authored_s=np.concatenate([[0.0], authored_s[order]]),
    )
