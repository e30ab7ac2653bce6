"""Gait → Sequence: what `lss-play` plays when it is given a gait file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.gait.load import is_gait_file, load_gait
from lss_motion.gait.pacing import action_at, joints_of, paced
from lss_motion.sequence.model import Interpolation, Keyframe, Sequence, Timing
from lss_motion.sequence.timing import KEYFRAMES_MAX

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.gait.model import Gait
    from lss_motion.gait.pacing import Paced
    from lss_motion.robot.model import Robot

TIME_DECIMALS = 6
"""Key times are rounded to a microsecond, for people to read."""


def sequence_of(gait: Gait, robot: Robot) -> Sequence:
    """Return the keyframes that make `robot` do what `gait` says; raises what `paced` raises.

    Only the joints of the legs are keyed. The sequence starts and ends at rest.
    """
    return sequence_from(gait, paced(gait, robot))


def gait_as_sequence(path: Path, robot: Robot) -> Sequence | None:
    """Return the keyframes of the gait file at `path`; None if it is none.

    Raises what `load_gait` and `paced` raise.
    """
    return sequence_of(load_gait(path, robot), robot) if is_gait_file(path) else None


def sequence_from(gait: Gait, passages: tuple[Paced, ...]) -> Sequence:
    """Return the keyframes of passages that `paced` returned for `gait`."""
    names = joints_of(gait)
    keyframes: list[Keyframe] = []
    start_s = 0.0
    for part in passages:
        owners = [action_at(part.passage, at_s) for at_s in part.times_s.tolist()]
        is_labelled: set[int] = set()
        rows = part.angles_deg.tolist()
        times_s = (part.times_s * part.pace_ratio).tolist()
        # Where a passage joins the one before, they share the key, unless a hold lies between.
        for index in range(1 if keyframes else 0, len(rows)):
            is_last = index == len(rows) - 1
            action = part.actions[owners[index]]
            is_first = owners[index] not in is_labelled
            is_labelled.add(owners[index])
            keyframes.append(
                Keyframe(
                    deg=dict(zip(names, rows[index], strict=True)),
                    at_s=round(start_s + times_s[index], TIME_DECIMALS),
                    hold_s=part.hold_s if is_last else 0.0,
                    ease=Interpolation.SPLINE,
                    label=action.label if is_first else "",
                    line=action.line,
                )
            )
        start_s = (keyframes[-1].at_s or 0.0) + part.hold_s
    if len(keyframes) > KEYFRAMES_MAX:
        raise InputError(
            f"the gait comes to {len(keyframes):,} keyframes, at most {KEYFRAMES_MAX:,} are "
            "planned in one piece; walk fewer cycles, and loop, or steer it with `lss-motion walk`",
            path=gait.path,
        )
    return Sequence(
        name=gait.name,
        keyframes=tuple(keyframes),
        path=gait.path,
        robot_path=gait.robot_path,
        timing=Timing.AUTHORED,
        loop=gait.loop,
    )
