"""Which joint must be where, and when: a sequence seen joint by joint, checked for sense."""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.sequence.model import Timing

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Interpolation, Keyframe, Sequence

SAME_INSTANT_S: Final = 1e-9
"""Times closer than this are one instant. Chosen: a thousandth of what the line can express."""

SAME_ANGLE_DEG: Final = 1e-9
"""Angles closer than this are equal. Chosen: a 10^7th of the wire's unit."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Key:
    """One joint's angle at one keyframe (`index`), kept for `hold_s`."""

    index: int
    deg: float
    hold_s: float
    ease: Interpolation


def is_timed(sequence: Sequence) -> bool:
    """Whether the author's times count (False: only the order of the keyframes does)."""
    if sequence.timing is Timing.FASTEST:
        return False
    return any(keyframe.at_s is not None for keyframe in sequence.keyframes)


def keys_by_joint(sequence: Sequence, robot: Robot) -> dict[str, tuple[Key, ...]]:
    """Return the keys of every joint that the sequence names, in the order of the robot.

    Raises `InputError`, with everything that is wrong, for what cannot be meant.
    """
    problems = _problems(sequence, robot)
    has_times = is_timed(sequence)
    keys: dict[str, list[Key]] = {}
    for index, keyframe in enumerate(sequence.keyframes):
        for joint, deg in keyframe.deg.items():
            key = Key(index=index, deg=deg, hold_s=keyframe.hold_s, ease=keyframe.ease)
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
    """Return how messages call a keyframe: its label, else its time."""
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
    """Return what is wrong if `key` comes while the joint is still held at another angle."""
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
