"""Where along the path each keyframe lies: the authored seconds, or what a move needs at least."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.trajectory.keys import is_timed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from lss_motion.robot.model import Robot
    from lss_motion.sequence.model import Sequence
    from lss_motion.trajectory.keys import Key

    FloatArray = NDArray[np.float64]

HOPELESS_RATIO: Final = 0.1
"""An authored move gets at least this share of the time that it needs alone. Chosen: such a move
is slowed tenfold anyway, and below this the numbers of the solver lose their footing (keys 1 ms
apart would need path rates near 0.002)."""

PASSING_RATIO: Final = 0.5
"""But never more than this share of the time at full speed: samples that a joint passes in motion
are closer than a move from rest to rest could be, and stay where their author put them. Chosen: no
sample of a motion within the limits is ever moved, nor one of a motion up to twice as fast."""

PATH_DECIMALS: Final = 9
"""Path positions are rounded to 1 ns, so that equal instants of different joints are equal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spacing:
    """Path position of each keyframe when it is reached and when its hold ends.

    `path_s` and `authored_s` map positions to authored times, piecewise linearly; without
    authored times they are equal and `pauses` are not part of the path.
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
    """Return how long moves from rest to rest take at the limits: a trapezoid or a triangle."""
    distance_deg = np.abs(move_deg)
    is_triangle = distance_deg <= speed_deg_s**2 / accel_deg_s2
    triangle_s = 2.0 * np.sqrt(distance_deg / accel_deg_s2)
    trapezoid_s = distance_deg / speed_deg_s + speed_deg_s / accel_deg_s2
    return np.where(is_triangle, triangle_s, trapezoid_s)


def spaced(sequence: Sequence, keys: Mapping[str, tuple[Key, ...]], robot: Robot) -> Spacing:
    """Return the spacing of the keyframes: authored if the sequence is timed, else as needed."""
    is_authored = is_timed(sequence)
    needs = _needs(keys, robot, is_authored=is_authored)
    if is_authored:
        return _timed(sequence, needs)
    reached_s = np.zeros(len(sequence.keyframes))
    previous_s = 0.0
    for index in range(len(reached_s)):
        for earlier, least_s in needs.get(index, ()):
            previous_s = max(previous_s, round(reached_s[earlier] + least_s, PATH_DECIMALS))
        reached_s[index] = previous_s
    ends_s = np.array([0.0, previous_s])
    return Spacing(reached_s=reached_s, left_s=reached_s, path_s=ends_s, authored_s=ends_s)


def _needs(
    keys: Mapping[str, tuple[Key, ...]], robot: Robot, *, is_authored: bool
) -> dict[int, list[tuple[int, float]]]:
    """For each keyframe: the keyframes that its joints come from, and how far apart they must be.

    Without an author's times that is how long the move takes.
    """
    needs: dict[int, list[tuple[int, float]]] = {}
    for name, own in keys.items():
        joint = robot.joints[name]
        moves_deg = np.diff([key.deg for key in own])
        least_s = least_move_s(moves_deg, joint.speed_max_deg_s, joint.accel_max_deg_s2)
        if is_authored:
            passing_s = PASSING_RATIO * np.abs(moves_deg) / joint.speed_max_deg_s
            least_s = np.minimum(HOPELESS_RATIO * least_s, passing_s)
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
        # Adding the extra only where there is some keeps authored times exact to the last bit.
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
