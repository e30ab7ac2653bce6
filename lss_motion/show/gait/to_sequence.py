"""Gait → `Sequence`: the keyframes that `lss-play` plays for a gait file."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.errors import InputError
from lss_motion.show.gait.model import LEAD_IN_CYCLES, Walk
from lss_motion.show.gait.pacing import action_at, joints_of, paced
from lss_motion.show.gait.passage import Walking
from lss_motion.show.model import KEYFRAMES_MAX, Interpolation, Keyframe, Sequence, Timing

if TYPE_CHECKING:
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced


class _Loop(NamedTuple):
    """How often a sequence is looped (None: forever), and which part of it (None: all)."""

    passes: int | None
    span_s: tuple[float, float] | None = None


TIME_DECIMALS: Final = 6
"""Key times are rounded to a microsecond, for readable files."""


def sequence_of(gait: Gait, robot: Robot) -> Sequence:
    """Return the keyframes of `gait` for `robot`; raises what `paced` raises.

    Only the joints of the legs are keyed. The sequence starts and ends at rest.
    """
    return sequence_from(gait, paced(gait, robot))


def sequence_from(gait: Gait, passages: tuple[Paced, ...]) -> Sequence:
    """Return the keyframes of passages that `paced` returned for `gait`."""
    names = joints_of(gait)
    keyframes: list[Keyframe] = []
    start_s, loop = 0.0, _Loop(gait.loop)
    for part in passages:
        owners = [action_at(part.passage, at_s) for at_s in part.times_s.tolist()]
        is_labelled: set[int] = set()
        rows = part.angles_deg.tolist()
        times_s = (part.times_s * part.pace_ratio).tolist()
        # The first key of a passage is the last one of the passage before.
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
        loop = _looped(gait, part, start_s) or loop
        start_s = (keyframes[-1].at_s or 0.0) + part.hold_s
    if len(keyframes) > KEYFRAMES_MAX:
        raise InputError(
            f"the gait has {len(keyframes):,} keyframes, at most {KEYFRAMES_MAX:,} are planned in "
            "one piece; only the longest walk of a gait without loop may be longer, so use shorter "
            "walks, or several gaits in a play list",
            path=gait.path,
        )
    return Sequence(
        name=gait.name,
        keyframes=tuple(keyframes),
        path=gait.path,
        robot_path=gait.robot_path,
        timing=Timing.AUTHORED,
        loop=loop.passes,
        loop_span_s=loop.span_s,
    )


def _looped(gait: Gait, part: Paced, start_s: float) -> _Loop | None:
    """Return the looped cycle of this passage; None if it has none."""
    for index, action in enumerate(part.actions):
        if not isinstance(action, Walk) or action.more_cycles == 0:
            continue
        assert isinstance(part.passage, Walking)
        steady_s = float(part.passage.begins_s[index]) + LEAD_IN_CYCLES * gait.cycle_s
        from_s, to_s = (
            round(start_s + part.pace_ratio * at_s, TIME_DECIMALS)
            for at_s in (steady_s, steady_s + gait.cycle_s)
        )
        more = action.more_cycles
        return _Loop(None if more is None else more + 1, (from_s, to_s))
    return None
