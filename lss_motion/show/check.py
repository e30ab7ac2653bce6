"""Checks of keyframes: joints and ranges of the robot, moves that take no time, loops that close.

The functions yield or return reasons as texts for people; only `check_sequence` raises.
"""

from __future__ import annotations

from itertools import combinations, groupby, pairwise, product
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.show.model import FLOWING, Timing

if TYPE_CHECKING:
    from collections import abc

    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Keyframe, Sequence

SEAM_TOLERANCE_DEG: Final = 1e-6
"""Far below the finest unit of a servo (0.01 deg), far above rounding errors of sums."""

SAME_TIME_S: Final = 1e-6
"""Times closer than this are the same: far below a millisecond, above rounding errors of sums."""


def check_sequence(sequence: Sequence, robot: Robot, *, is_offset: bool = False) -> None:
    """Raise one `InputError` for all keys of joints that `robot` lacks or angles out of range.

    Tracks, steps and layers are checked as well. `is_offset`: the angles are added to others, so
    no range applies to them alone.
    """
    errors = list(_errors(sequence, robot, is_offset=is_offset))
    if errors:
        top = errors[0]
        raise InputError(top.reason, path=top.path, line=top.line, more=errors[1:])


def _errors(sequence: Sequence, robot: Robot, *, is_offset: bool) -> abc.Iterator[InputError]:
    for index, _, reason in joint_problems(sequence.keyframes, robot, is_offset=is_offset):
        yield InputError(reason, path=sequence.path, line=sequence.keyframes[index].line)
    for track in sequence.tracks:
        yield from _errors(track, robot, is_offset=is_offset)
    for step in sequence.play:
        if step.sequence is not None:
            yield from _errors(step.sequence, robot, is_offset=is_offset)
    for layer in sequence.layers:
        yield from _errors(layer.sequence, robot, is_offset=layer.mode == "add")


def joint_problems(
    keyframes: abc.Sequence[Keyframe], robot: Robot, *, is_offset: bool = False
) -> abc.Iterator[tuple[int, str, str]]:
    """Yield keyframe index, joint and reason of every key that `robot` cannot play."""
    for index, keyframe in enumerate(keyframes):
        for name, angle_deg in keyframe.deg.items():
            joint = robot.joints.get(name)
            if joint is None:
                yield index, name, f"unknown joint {name!r}; {known_names(name, robot.joints)}"
            elif not is_offset and (reason := joint.range_problem(angle_deg)):
                yield index, name, reason


def slope_problems(
    keyframes: abc.Sequence[Keyframe], timing: Timing
) -> abc.Iterator[tuple[int, str, str]]:
    """Yield keyframe index, joint and reason of every slope that no joint can have at its key."""
    own: dict[str, list[int]] = {}
    for index, frame in enumerate(keyframes):
        for name in frame.deg:
            own.setdefault(name, []).append(index)
    for index, frame in enumerate(keyframes):
        for name, slope in frame.slope_deg_s.items():
            if name not in frame.deg:
                yield index, name, f"{name} has no angle here; give it one, or remove the slope"
            elif slope and (reason := _slope_problem(keyframes, own[name], index, timing)):
                yield index, name, f"{name} {reason}"


def _slope_problem(
    keyframes: abc.Sequence[Keyframe], own: abc.Sequence[int], index: int, timing: Timing
) -> str:
    """Return why a joint whose keys are `own` cannot pass one of them in motion."""
    place = own.index(index)
    after = keyframes[own[min(place + 1, len(own) - 1)]]
    if timing is Timing.FASTEST:
        return "has a slope, but timing: fastest finds the speeds itself; give times, or remove it"
    if place in (0, len(own) - 1):
        return "begins and ends at rest; only keys between its first and last have a slope"
    if keyframes[index].hold_s > 0.0:
        return "is held here, so it stands; remove hold_s, or the slope"
    for frame in (keyframes[index], after):
        if frame.ease not in FLOWING:
            return (
                f"stops here by ease: {frame.ease}; the moves to and from a key with a slope are "
                "smooth or spline"
            )
    return ""


def jumps(keyframes: abc.Sequence[Keyframe]) -> abc.Iterator[tuple[int, str]]:
    """Yield index and reason of keyframes that move a joint in no time, at the end of a hold."""
    instants = [list(group) for _, group in groupby(enumerate(keyframes), _instant)]
    for earlier, later in pairwise(instants):
        for index, here in later:
            for reason in jumps_between([before for _, before in earlier], [here]):
                yield index, reason


def jumps_between(
    earlier: abc.Sequence[Keyframe], later: abc.Sequence[Keyframe]
) -> abc.Iterator[str]:
    """Yield reasons why joints cannot go from the end of one instant to the next one."""
    for before, here in product(earlier, later):
        if before.at_s is None or here.at_s is None:
            continue
        if abs(here.at_s - (before.at_s + before.hold_s)) >= SAME_TIME_S:
            continue
        for name in _differing(before, here):
            yield (
                f"joint {name!r} would have to go from {before.deg[name]:g} to "
                f"{here.deg[name]:g} deg in no time, because the keyframe before ends at "
                f"{here.at_s:g} s; shorten its hold_s or come later"
            )


def clashes(keyframes: abc.Sequence[Keyframe]) -> abc.Iterator[tuple[int, str]]:
    """Yield index and reason of keyframes at one instant that give a joint different angles."""
    for at_s, group in groupby(enumerate(keyframes), _instant):
        for (_, before), (index, here) in combinations(group if at_s is not None else (), 2):
            for name in _differing(before, here):
                yield (
                    index,
                    f"joint {name!r} is at {here.deg[name]:g} deg here and at "
                    f"{before.deg[name]:g} deg in line {before.line}, both at {at_s:g} s; "
                    "keep one of them",
                )


def _instant(numbered: tuple[int, Keyframe]) -> float | None:
    return numbered[1].at_s


def _differing(before: Keyframe, here: Keyframe) -> list[str]:
    """Return the joints to which both keyframes give an angle, and not the same."""
    return [
        name
        for name, angle_deg in here.deg.items()
        if abs(angle_deg - before.deg.get(name, angle_deg)) > SEAM_TOLERANCE_DEG
    ]


def loop_problem(keyframes: abc.Sequence[Keyframe]) -> str:
    """Return why these keyframes cannot be looped; an empty text if they can."""
    first: dict[str, float] = {}
    last: dict[str, float] = {}
    for keyframe in keyframes:
        first = {**keyframe.deg, **first}
        last = {**last, **keyframe.deg}
    open_joints = [
        f"{name} starts at {first[name]:g} and ends at {angle_deg:g} deg"
        for name, angle_deg in last.items()
        if abs(angle_deg - first[name]) > SEAM_TOLERANCE_DEG
    ]
    if open_joints:
        return (
            f"a loop must end where it began, but {', '.join(open_joints)}; "
            "add a final keyframe that returns to the first"
        )
    if not _takes_time(keyframes):
        return "a loop must take time; give more than one keyframe, or a hold_s"
    return ""


def _takes_time(keyframes: abc.Sequence[Keyframe]) -> bool:
    if any(keyframe.hold_s > 0.0 or (keyframe.at_s or 0.0) > 0.0 for keyframe in keyframes):
        return True
    seen: dict[str, float] = {}
    for keyframe in keyframes:
        for name, angle_deg in keyframe.deg.items():
            if seen.setdefault(name, angle_deg) != angle_deg:
                return True
    return False
