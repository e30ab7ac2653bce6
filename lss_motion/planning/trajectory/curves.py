"""Paths: the curve of each joint between its keys, for each ease, as piecewise cubics.

The path position has the unit of seconds (`_s`): for authored shows it is the authored time.

Everything here is over the path position; time, speed limits and rates come later (`retime`). Only
`hold` uses the joint's limits: its move starts as late as they allow; and `command` its ramps.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import force_setattr, replace

from lss_motion.planning.trajectory.commands import carried_out
from lss_motion.planning.trajectory.keys import (
    PATH_DECIMALS,
    SAME_ANGLE_DEG,
    least_move_s,
    rests_at,
)
from lss_motion.show.model import FLOWING, LINEAR_RAMP_RATIO, Interpolation
from lss_motion.show.splines import clamped_slopes, distinct, monotone_slopes, runs

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.commands import CarriedOut
    from lss_motion.planning.trajectory.keys import Key, Spacing
    from lss_motion.robot.model import Joint, Robot

    FloatArray = NDArray[np.float64]

ANGLE_DECIMALS: Final = 9
"""Angles are rounded to this, so that a difference by rounding alone is no move."""

REST_SHARE_MAX: Final = 0.98
"""A move gives at most this share of its length to the rests around it. `spacing_of` makes it long
enough; keys that only rounding keeps apart have no more to give."""

DELAY_SHARE_MAX: Final = 0.4
"""A key moves along the path by at most this share of the way to the next, which may move as far
towards it."""


class JointKeys(Struct, frozen=True):
    """The keys of one joint along the path: where each is reached and left, its angle and its ease.

    `eases[k]` shapes the move that ends at key k.
    """

    reached_s: FloatArray
    left_s: FloatArray
    deg: FloatArray
    is_held: NDArray[np.bool_]
    eases: tuple[Interpolation, ...]
    slopes_deg_s: FloatArray
    """With which the author lets the joint pass; NaN: the curve finds it."""

    @property
    def lengths_s(self) -> FloatArray:
        return self.reached_s[1:] - self.left_s[:-1]

    @property
    def secants_deg_s(self) -> FloatArray:
        return np.diff(self.deg) / self.lengths_s

    def are(self, *kinds: Interpolation) -> NDArray[np.bool_]:
        """Return for each move whether its ease is one of `kinds`."""
        return np.array([ease in kinds for ease in self.eases[1:]], dtype=np.bool_)


def joint_keys(own: tuple[Key, ...], spacing: Spacing) -> JointKeys:
    """Return the keys with their path positions; a key within an earlier hold is merged with it."""
    reached_s: list[float] = []
    left_s: list[float] = []
    is_held: list[bool] = []
    kept: list[Key] = []
    for key in own:
        at_s, until_s = float(spacing.reached_s[key.index]), float(spacing.left_s[key.index])
        if kept and at_s <= left_s[-1]:
            left_s[-1] = max(left_s[-1], until_s)
            is_held[-1] |= key.is_held
        else:
            reached_s.append(at_s)
            left_s.append(until_s)
            is_held.append(key.is_held)
            kept.append(key)
    angles_deg = np.array([key.deg for key in kept], dtype=np.float64)
    by_s = _delays_s(kept, np.array(reached_s), np.array(left_s))
    return JointKeys(
        np.array(reached_s) + by_s,
        np.array(left_s) + by_s,
        np.asarray(np.round(angles_deg, ANGLE_DECIMALS), dtype=np.float64),
        np.array(is_held),
        tuple(key.ease for key in kept),
        np.array([key.slope_deg_s for key in kept]),
    )


def _delays_s(own: Sequence[Key], reached_s: FloatArray, left_s: FloatArray) -> FloatArray:
    """Return the delay of each key, at most a share of the way to its neighbours."""
    delays_s = np.array([key.delay_s for key in own])
    if not delays_s.any():
        return delays_s
    room_s = DELAY_SHARE_MAX * (reached_s[1:] - left_s[:-1])
    least_s, most_s = np.append(0.0, -room_s), np.append(room_s, 0.0)
    return np.asarray(np.round(np.clip(delays_s, least_s, most_s), PATH_DECIMALS))


def with_longer_rests(
    keys: JointKeys, half_s: float, *, is_from_rest: bool = True, is_to_rest: bool = True
) -> JointKeys:
    """Return the keys, each rest of them reached `half_s` earlier and left so much later.

    `is_from_rest` and `is_to_rest` False: the pass begins or ends in motion.
    """
    if half_s <= 0.0:
        return keys
    is_rest = rests_at(keys.deg, keys.is_held, keys.eases, keys.slopes_deg_s)
    is_rest[0] &= is_from_rest
    is_rest[-1] &= is_to_rest
    is_move = np.abs(np.diff(keys.deg)) > SAME_ANGLE_DEG
    rests = is_rest[:-1].astype(np.float64) + is_rest[1:]
    most_s = REST_SHARE_MAX * keys.lengths_s / np.maximum(rests, 1.0)
    most_s = np.where(is_move, np.minimum(half_s, most_s), 0.0)
    reached_s, left_s = keys.reached_s.copy(), keys.left_s.copy()
    left_s[:-1] += np.where(is_rest[:-1], most_s, 0.0)
    reached_s[1:] -= np.where(is_rest[1:], most_s, 0.0)
    return replace(
        keys,
        reached_s=np.asarray(np.round(reached_s, PATH_DECIMALS)),
        left_s=np.asarray(np.round(left_s, PATH_DECIMALS)),
        is_held=keys.is_held | is_rest,
    )


def seam_slope_deg_s(keys: JointKeys, length_s: float) -> float:
    """Return the slope of a joint where one pass joins the next; 0 where the joint rests there."""
    if (
        len(keys.deg) < 2
        or keys.reached_s[0] > 0.0
        or keys.reached_s[-1] < length_s
        or keys.is_held[[0, -1]].any()
        or keys.eases[1] not in FLOWING
        or keys.eases[-1] not in FLOWING
    ):
        return 0.0
    lengths_s, secants = keys.lengths_s, keys.secants_deg_s
    return float(monotone_slopes(lengths_s[[-1, 0]], secants[[-1, 0]])[0])


def build_path(
    keys: Mapping[str, JointKeys],
    robot: Robot,
    length_s: float,
    *,
    start_slopes: Mapping[str, float] | None = None,
    end_slopes: Mapping[str, float] | None = None,
) -> Path:
    """Return the path of one pass. `start_slopes` and `end_slopes`: joint to slope, 0 if absent."""
    pieces = [
        _pieces(
            own,
            robot.joints[name],
            length_s,
            (start_slopes or {}).get(name, 0.0),
            (end_slopes or {}).get(name, 0.0),
        )
        for name, own in keys.items()
    ]
    starts_s = distinct(np.concatenate([starts for starts, _ in pieces]))
    coefficients = np.empty((len(starts_s), 4, len(pieces)))
    for column, (own_starts_s, cubics) in enumerate(pieces):
        chosen = np.searchsorted(own_starts_s, starts_s, side="right") - 1
        coefficients[:, :, column] = shifted(cubics[chosen], starts_s - own_starts_s[chosen])
    return Path(
        knots_s=np.append(starts_s, max(length_s, float(starts_s[-1]))), coefficients=coefficients
    )


def shifted(cubics: FloatArray, by_s: FloatArray) -> FloatArray:
    """Return the same cubics around an origin that lies `by_s` later."""
    constant, linear, square, cube = cubics.T
    return np.stack(
        [
            constant + by_s * (linear + by_s * (square + by_s * cube)),
            linear + by_s * (2.0 * square + by_s * 3.0 * cube),
            square + by_s * 3.0 * cube,
            cube,
        ],
        axis=1,
    )


def _pieces(
    keys: JointKeys, joint: Joint, length_s: float, start_slope: float, end_slope: float
) -> tuple[FloatArray, FloatArray]:
    """Return starts and cubics of one joint's pieces, in order, from 0 to `length_s`."""
    slopes = _slopes(keys, start_slope, end_slope)
    is_flowing = keys.are(*FLOWING)
    commands = commands_of(keys, joint, length_s)
    is_linear = keys.are(Interpolation.LINEAR, Interpolation.COMMAND)
    is_linear[commands.covered] = False
    moving = [
        _flowing(keys, slopes, np.flatnonzero(is_flowing)),
        _linear(keys, np.flatnonzero(is_linear)),
        _late(keys, joint, np.flatnonzero(keys.are(Interpolation.HOLD))),
    ]
    still = np.zeros((len(keys.deg) + 1, 4))
    still[:, 0] = keys.deg[[0, *range(len(keys.deg))]]
    still_starts_s = np.concatenate([[0.0], keys.reached_s])
    still_ends_s = np.concatenate([keys.reached_s[:1], keys.left_s])
    still_ends_s[-1] = max(length_s, still_ends_s[-1])
    starts_s = np.concatenate([still_starts_s, *(starts for starts, _, _ in moving)])
    ends_s = np.concatenate([still_ends_s, *(ends for _, ends, _ in moving)])
    cubics = np.concatenate([still, *(cubics for _, _, cubics in moving)])
    starts_s = commands.after(starts_s)  # A rest begins when the servo has come to rest.
    starts_s = np.concatenate([starts_s, commands.starts_s])
    ends_s = np.concatenate([ends_s, commands.ends_s])
    cubics = np.concatenate([cubics, commands.cubics])
    is_kept = ends_s > starts_s
    if not is_kept.any():
        return still_starts_s[:1], still[:1]
    order = np.argsort(starts_s[is_kept], kind="stable")
    return starts_s[is_kept][order], cubics[is_kept][order]


def commands_of(keys: JointKeys, joint: Joint, end_s: float) -> CarriedOut:
    """Return what the servo of the joint makes of the moves with the ease `command`."""
    is_command = keys.are(Interpolation.COMMAND)
    return carried_out(keys.reached_s, keys.left_s, keys.deg, is_command, joint, end_s)


def _slopes(keys: JointKeys, start_slope: float, end_slope: float) -> FloatArray:
    """Return the slope at each key: 0 at holds, at corners and where the direction turns.

    A slope that the author gives is taken where the joint passes the key.
    """
    slopes = np.zeros(len(keys.deg))
    if len(slopes) < 2:
        return slopes
    is_flowing = keys.are(*FLOWING)
    is_passed = ~keys.is_held[1:-1] & is_flowing[1:] & is_flowing[:-1]
    found = monotone_slopes(keys.lengths_s, keys.secants_deg_s)
    given = keys.slopes_deg_s[1:-1]
    is_found = np.isnan(given)
    slopes[1:-1] = np.where(is_passed, np.where(is_found, found, given), 0.0)
    slopes[0], slopes[-1] = start_slope, end_slope
    is_spline = keys.are(Interpolation.SPLINE)
    inner = is_spline[1:] & is_spline[:-1] & is_passed & is_found
    for first, last in runs(inner):
        knots = slice(first, last + 2)
        slopes[knots] = clamped_slopes(
            keys.lengths_s[first : last + 1],
            keys.secants_deg_s[first : last + 1],
            start=float(slopes[first]),
            end=float(slopes[last + 1]),
        )
    return slopes


_Pieces = tuple["FloatArray", "FloatArray", "FloatArray"]


def _flowing(keys: JointKeys, slopes: FloatArray, moves: NDArray[np.intp]) -> _Pieces:
    """Return Hermite cubics between keys."""
    length_s, secant = keys.lengths_s[moves], keys.secants_deg_s[moves]
    before, after = slopes[moves], slopes[moves + 1]
    cubics = hermite(keys.deg[moves], secant, before, after, length_s)
    return keys.left_s[moves], keys.reached_s[moves + 1], cubics


def _linear(keys: JointKeys, moves: NDArray[np.intp]) -> _Pieces:
    ramps = np.full(len(moves), LINEAR_RAMP_RATIO)
    return _trapezoids(keys, moves, keys.left_s[moves], ramps)


def _late(keys: JointKeys, joint: Joint, moves: NDArray[np.intp]) -> _Pieces:
    """Return trapezoids at the joint's limits that end at the key.

    Where the time between the keys is too short for one, it fills that time.
    """
    distance_deg = np.abs(keys.deg[moves + 1] - keys.deg[moves])
    needed_s = least_move_s(distance_deg, joint.speed_max_deg_s, joint.accel_max_deg_s2)
    start_s = np.maximum(keys.reached_s[moves + 1] - needed_s, keys.left_s[moves])
    start_s = np.asarray(np.round(start_s, PATH_DECIMALS), dtype=np.float64)
    ramp_s = joint.speed_max_deg_s / joint.accel_max_deg_s2
    ramps = np.minimum(0.5, ramp_s / np.where(needed_s > 0.0, needed_s, 1.0))
    waits = np.zeros((len(moves), 4))
    waits[:, 0] = keys.deg[moves]
    starts_s, ends_s, cubics = _trapezoids(keys, moves, start_s, ramps)
    return (
        np.concatenate([keys.left_s[moves], starts_s]),
        np.concatenate([start_s, ends_s]),
        np.concatenate([waits, cubics]),
    )


def _trapezoids(
    keys: JointKeys, moves: NDArray[np.intp], starts_s: FloatArray, ramps: FloatArray
) -> _Pieces:
    """Return rest-to-rest moves that end at the keys; `ramps` is each ramp's share of the move."""
    ends_s = keys.reached_s[moves + 1]
    from_deg, to_deg = keys.deg[moves], keys.deg[moves + 1]
    spent_s = ends_s - starts_s
    first_s = np.round(starts_s + ramps * spent_s, PATH_DECIMALS)
    second_s = np.round(ends_s - ramps * spent_s, PATH_DECIMALS)
    second_s = np.maximum(first_s, second_s)
    # Computed from the rounded positions, so that the pieces meet exactly.
    up_s, down_s = first_s - starts_s, ends_s - second_s
    speed = _ratio(to_deg - from_deg, spent_s - 0.5 * (up_s + down_s))
    nothing = np.zeros_like(speed)
    up = np.stack([from_deg, nothing, 0.5 * _ratio(speed, up_s), nothing], axis=1)
    cruise = np.stack([from_deg + 0.5 * speed * up_s, speed, nothing, nothing], axis=1)
    slowing = -0.5 * _ratio(speed, down_s)
    down = np.stack([to_deg - 0.5 * speed * down_s, speed, slowing, nothing], axis=1)
    return (
        np.concatenate([starts_s, first_s, second_s]),
        np.concatenate([first_s, second_s, ends_s]),
        np.concatenate([up, cruise, down]),
    )


def _ratio(value: FloatArray, by: FloatArray) -> FloatArray:
    return np.divide(value, by, out=np.zeros_like(value), where=by > 0.0)


class Path(Struct, frozen=True, kw_only=True):
    """Cubics of all joints over common knots.

    `coefficients[k, p, j]` belongs to the power p of (path_s - knots_s[k]) of joint j in segment
    k; degrees over seconds to the p. A segment at rest has exact zeros above power 0.
    """

    knots_s: FloatArray
    coefficients: FloatArray

    def __post_init__(self) -> None:
        # Stored power by power, because `_chosen` reads one power of many cubics.
        by_power = np.ascontiguousarray(np.moveaxis(self.coefficients, 1, 0))
        force_setattr(self, "coefficients", np.moveaxis(by_power, 0, 1))

    @property
    def length_s(self) -> float:
        return float(self.knots_s[-1] - self.knots_s[0])

    @property
    def segment_lengths_s(self) -> FloatArray:
        return np.diff(self.knots_s)

    @property
    def rests(self) -> NDArray[np.bool_]:
        """True for each segment in which no joint moves."""
        return np.asarray(~np.any(self.coefficients[:, 1:, :], axis=(1, 2)), dtype=np.bool_)

    def between(self, from_s: float, to_s: float) -> Path:
        """Return the part between two knots, or from the ones nearest to these positions."""
        first, last = (int(np.abs(self.knots_s - at_s).argmin()) for at_s in (from_s, to_s))
        return Path(
            knots_s=self.knots_s[first : last + 1], coefficients=self.coefficients[first:last]
        )

    def segments_of(self, path_s: FloatArray) -> NDArray[np.intp]:
        """Return the segment of every position; a knot belongs to the segment that it starts."""
        found = np.searchsorted(self.knots_s, path_s, side="right") - 1
        return np.clip(found, 0, len(self.knots_s) - 2)

    def evaluate(self, path_s: FloatArray) -> FloatArray:
        """Return the position, (n, joints)."""
        chosen = self.segments_of(path_s)
        local_s = (path_s - self.knots_s[chosen])[:, None]
        value = self._chosen(3, chosen)
        for power in (2, 1, 0):
            value *= local_s
            value += self._chosen(power, chosen)
        return value

    def _chosen(self, power: int, segments: NDArray[np.intp]) -> FloatArray:
        """Return the coefficient of that power of each chosen cubic, (n, joints).

        Reading power by power takes a quarter of the time of reading whole cubics.
        """
        return self.coefficients[:, power].take(segments, axis=0)

    def slopes(
        self, path_s: FloatArray, segments: NDArray[np.intp] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the first and the second derivative, (n, joints).

        `segments` gives the cubic of each position, for one-sided values at a knot.
        """
        chosen = self.segments_of(path_s) if segments is None else segments
        local_s = (path_s - self.knots_s[chosen])[:, None]
        cubed = self._chosen(3, chosen)
        cubed *= 3.0 * local_s
        squared = self._chosen(2, chosen)
        second = cubed + squared
        first = second + squared
        first *= local_s
        first += self._chosen(1, chosen)
        second *= 2.0
        return first, second


def cubics(knots_s: FloatArray, deg: FloatArray, speed: FloatArray) -> Path:
    """Return the cubics with those angles and speeds at their knots."""
    lengths_s = np.diff(knots_s)[:, None]
    secants = np.diff(deg, axis=0) / lengths_s
    coefficients = hermite(deg[:-1], secants, speed[:-1], speed[1:], lengths_s)
    return Path(knots_s=knots_s, coefficients=coefficients)


def hermite(
    start: FloatArray,
    secants: FloatArray,
    before: FloatArray,
    after: FloatArray,
    lengths_s: FloatArray,
) -> FloatArray:
    """Return cubics with those slopes `before` and `after` at their ends.

    Coefficients in rising powers along axis 1, from the value at the start and the mean slope.
    """
    square = (3.0 * secants - 2.0 * before - after) / lengths_s
    cube = (before + after - 2.0 * secants) / lengths_s**2
    return np.stack([start, before, square, cube], axis=1)


def concatenate(paths: Sequence[Path]) -> Path:
    """Return one path that runs through all of them; each starts where the last one ended."""
    starts_s = np.cumsum([0.0] + [path.length_s for path in paths])
    knots_s = [
        path.knots_s[:-1] - path.knots_s[0] + start_s
        for path, start_s in zip(paths, starts_s, strict=False)
    ]
    return Path(
        knots_s=np.concatenate([*knots_s, starts_s[-1:]]),
        coefficients=np.concatenate([path.coefficients for path in paths]),
    )


def out_of_range(
    path: Path, column: int, range_deg: tuple[float, float]
) -> list[tuple[float, float]]:
    """Return the knots behind which a joint is out of a range before the next, and how far."""
    angle, slope, bend, jerk = path.coefficients[:, :, column].T
    # Where it turns: at the roots of its derivative, or else at the ends of the cubics.
    root = np.sqrt(np.maximum(bend**2 - 3.0 * slope * jerk, 0.0))
    turns = np.stack([np.zeros_like(root), -bend - root, -bend + root])
    with np.errstate(divide="ignore", invalid="ignore"):
        turns[1:] = np.where(jerk == 0.0, -0.5 * slope / bend, turns[1:] / (3.0 * jerk))
    turns = np.clip(np.nan_to_num(turns, posinf=0.0, neginf=0.0), 0.0, path.segment_lengths_s)
    deg = angle + turns * (slope + turns * (bend + turns * jerk))
    out_deg = np.maximum(range_deg[0] - deg, deg - range_deg[1]).max(axis=0)
    is_out = out_deg > 0.0
    return list(zip(path.knots_s[:-1][is_out].tolist(), out_deg[is_out].tolist(), strict=True))


def peaks(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the largest |first| and |second| derivative of each segment and joint, exactly."""
    _, linear, square, cube = np.moveaxis(path.coefficients, 1, 0)
    length_s = path.segment_lengths_s[:, None]
    end_speed = (3.0 * cube * length_s + 2.0 * square) * length_s + linear
    with np.errstate(divide="ignore", invalid="ignore"):
        turn_s = -square / (3.0 * cube)
    is_inside = (cube != 0.0) & (turn_s > 0.0) & (turn_s < length_s)
    turn_s = np.where(is_inside, turn_s, 0.0)
    turn_speed = (3.0 * cube * turn_s + 2.0 * square) * turn_s + linear
    speed = np.maximum(np.abs(linear), np.maximum(np.abs(end_speed), np.abs(turn_speed)))
    accel = np.maximum(np.abs(2.0 * square), np.abs(6.0 * cube * length_s + 2.0 * square))
    return speed, accel
