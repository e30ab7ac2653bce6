"""What the profiles of servos should do: references on a grid of instants, and limits of servos.

A reference is the plan of one joint in servo degrees, earlier by the lag of its servo. The fit of
each drive follows it within a tolerance. `References` and `LimitArrays` hold those of many servos
in flat arrays for the fit of timed moves.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct

from lss_motion.robot.profile import ramp_deg_s2

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.program.response import FloatArray, IntArray, SingleArray
    from lss_motion.robot.model import Joint, Response

GRID_S: Final = 0.005
"""Step of a reference. At 1000 deg/s² a reference bends by 0.003 deg within it, and steps of 1 ms
save no command that is worth five times the work (FACTS.md N9)."""
REST_MIN_S: Final = 0.02
"""A shorter standstill is treated as motion."""
STILL_ROUNDING_DEG: Final = 1e-6
"""Rounding error allowed when a position is compared with half a wire unit."""
DURATION_MAX_MS: Final = 9_999
"""The largest T that is sent. The documents name no limit; with four digits a move keeps to the 15
characters that an LSS-2IO on the bus tolerates (FACTS.md B4)."""
STILL_DEG: Final = 1e-7
"""A smaller change between two grid points counts as standing still."""
BEND_RATIO: Final = 0.2
"""A jump of the acceleration by this share of the ramp is worth a move of its own."""
AUTHORITY_STEPS: Final = 24
"""A correction needs spare ramp over this many grid steps ahead."""
AUTHORITY_LEAST_RATIO: Final = 0.01
"""A reference at its acceleration limit leaves no spare ramp; this keeps the division finite."""
TOLERANCE_MAX_DEG: Final = {"streamed": 0.2}
"""The largest tolerance by drive. Within a larger one, a target in EM0 that serves several steps
makes the first of them long and the others short, which no ramp of the servo evens out. Measured
(`streamed`): 2.2 times the acceleration limit with 0.4 deg, 5.2 with 1.6 deg, 1.3 with 0.2 deg."""
SEGMENT_MAX_S: Final = 1.5
"""The longest time that one move is relied on. Its successor repairs a lost command."""
AHEAD_MAX_STEPS: Final = round(SEGMENT_MAX_S / GRID_S)
"""The number of grid steps that a search looks ahead at most."""


class GivenCommand(NamedTuple):
    """A command that the servo should receive at `received_s`."""

    received_s: float
    target_wire: int
    duration_ms: int


class Reference(Struct, frozen=True, kw_only=True, dict=True):
    """What the profile of one servo should do: positions every `GRID_S` from `start_s` on.

    `given` are commands of the author in order, with which the profile does it.
    """

    start_s: float
    position_deg: FloatArray
    given: tuple[GivenCommand, ...] = ()

    @property
    def end_s(self) -> float:
        return self.time_s(len(self.position_deg) - 1)

    def time_s(self, index: int) -> float:
        return self.start_s + GRID_S * index

    def times_s(self, index: NDArray[np.intp]) -> FloatArray:
        times: FloatArray = self.start_s + GRID_S * index.astype(np.float64)
        return times

    def index(self, time_s: float) -> int:
        """Return the first index whose instant is not before `time_s`, inside the reference."""
        index = int(np.ceil((time_s - self.start_s) / GRID_S - 1e-9))
        return min(max(index, 0), len(self.position_deg) - 1)

    @cached_property
    def steps_deg(self) -> FloatArray:
        """Change of position from each grid point to the next; one fewer than there are points."""
        steps: FloatArray = np.diff(self.position_deg)
        return steps

    def rests(self) -> list[tuple[int, int]]:
        """Return `(first, last)` index of every standstill."""
        is_still = np.abs(self.steps_deg) < STILL_DEG
        edges = np.flatnonzero(np.diff(is_still, prepend=False, append=False)).tolist()
        least = round(REST_MIN_S / GRID_S)
        return [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]


class ServoLimits(Struct, frozen=True, kw_only=True):
    """The limits of the moves of one servo, in servo degrees, and the lattice of its targets."""

    position_min_deg: float
    position_max_deg: float
    speed_max_deg_s: float
    ramp_deg_s2: float
    wire_per_deg: float
    tolerance_deg: float
    response: Response
    wire_step: int = 1


def servo_limits(joint: Joint, tolerance_deg: float) -> ServoLimits:
    """Return the limits of a joint in servo degrees."""
    least_deg, most_deg = joint.servo_range_deg
    return ServoLimits(
        position_min_deg=least_deg,
        position_max_deg=most_deg,
        speed_max_deg_s=joint.speed_max_deg_s,
        ramp_deg_s2=joint.accel_max_deg_s2 if joint.drive == "streamed" else ramp_deg_s2(joint),
        wire_per_deg=joint.model.wire_per_deg,
        tolerance_deg=min(
            joint.tolerance_ratio * tolerance_deg, TOLERANCE_MAX_DEG.get(joint.drive, math.inf)
        ),
        response=joint.response,
        wire_step=joint.model.wire_step,
    )


class LimitArrays:
    """`ServoLimits` of many servos, an array a field, in one table so that `take` is fast."""

    def __init__(self, limits: Sequence[ServoLimits]) -> None:
        def column(name: str) -> FloatArray:
            return np.array([getattr(one, name) for one in limits], dtype=np.float64)

        per_deg = column("wire_per_deg")
        self._fill(
            np.stack(
                (
                    column("speed_max_deg_s"),
                    column("ramp_deg_s2"),
                    per_deg,
                    column("tolerance_deg"),
                    np.ceil(column("position_min_deg") * per_deg - 1e-6),
                    np.floor(column("position_max_deg") * per_deg + 1e-6),
                    np.array([one.response.t_law == "exact" for one in limits]),
                    np.array([one.response.retarget == "from_rest" for one in limits]),
                )
            )
        )

    def _fill(self, table: FloatArray) -> None:
        self._table = table
        self.speed_max_deg_s, self.ramp_deg_s2, self.wire_per_deg = table[:3]
        self.tolerance_deg, self.wire_min, self.wire_max = table[3:6]
        self.is_exact, self.forgets_speed = table[6:] != 0.0

    def take(self, chosen: IntArray) -> LimitArrays:
        """Return the limits of the `chosen` servos, in that order."""
        taken = object.__new__(LimitArrays)
        taken._fill(self._table.take(chosen, axis=1))
        return taken


class Points(NamedTuple):
    """Reference values at some grid points, and the ramp that is left there for corrections."""

    position_deg: SingleArray
    speed_deg_s: SingleArray
    up_deg_s2: SingleArray
    down_deg_s2: SingleArray


class References:
    """The references of many servos on one grid, one after the other in flat arrays."""

    def __init__(self, references: Sequence[Reference], limits: Sequence[ServoLimits]) -> None:
        assert len({(one.start_s, len(one.position_deg)) for one in references}) == 1, "one grid"
        self.start_s = references[0].start_s
        self.size = len(references[0].position_deg)
        self._padded_deg = np.empty(
            (len(references), self.size + AHEAD_MAX_STEPS), dtype=np.float32
        )
        points = np.empty((len(references), self.size, len(Points._fields)), dtype=np.float32)
        bends = []
        for joint, (one, limit) in enumerate(zip(references, limits, strict=True)):
            self._padded_deg[joint, : self.size] = one.position_deg
            self._padded_deg[joint, self.size :] = one.position_deg[-1]
            steps = np.zeros(self.size + 1, dtype=np.float32)
            steps[1:-1] = one.steps_deg
            accel, ramp = np.diff(steps) / np.float32(GRID_S * GRID_S), limit.ramp_deg_s2
            least = AUTHORITY_LEAST_RATIO * ramp
            columns = points[joint].T
            columns[0] = one.position_deg
            columns[1] = _speeds(steps)
            columns[2] = np.maximum(ramp - _ahead(np.maximum, accel), least)
            columns[3] = np.maximum(ramp + _ahead(np.minimum, accel), least)
            bends.append(joint * self.size + _bends(accel, ramp))
        self._points = points.reshape(-1, len(Points._fields))
        self._bends = np.concatenate([[-1], *bends, [len(references) * self.size]])
        self._reach = np.array(
            [[one.ramp_deg_s2, one.tolerance_deg, one.speed_max_deg_s] for one in limits],
            dtype=np.float32,
        ).T

    @property
    def end_s(self) -> float:
        return self.start_s + GRID_S * (self.size - 1)

    def first_index(self, times_s: FloatArray) -> IntArray:
        """Return the first index whose instant is not before `times_s`, also beyond the end."""
        index: IntArray = np.ceil((times_s - self.start_s) / GRID_S - 1e-9).astype(np.intp)
        return np.maximum(index, 0)

    def times_s(self, index: IntArray) -> FloatArray:
        return self.start_s + GRID_S * index.astype(np.float64)

    def _flat(self, joint: IntArray, index: IntArray) -> IntArray:
        """Return the index into the flat arrays of `index` of `joint`, at most the last point."""
        flat: IntArray = joint * self.size + np.minimum(index, self.size - 1)
        return flat

    def position_deg(self, joint: IntArray, index: IntArray) -> SingleArray:
        """Return positions of joints at grid points; beyond the end, the last position."""
        flat = joint * self._padded_deg.shape[1] + np.minimum(index, self.size - 1)
        return self._padded_deg.take(flat)

    def at(self, joint: IntArray, index: IntArray) -> Points:
        """Return the reference values of joints at grid points; beyond the end, the last ones."""
        flat = self._flat(joint, index)
        found = self._points.take(flat, axis=0)
        return Points(*np.ascontiguousarray(np.moveaxis(found, -1, 0)))

    def bend_before(self, joint: IntArray, index: IntArray) -> IntArray:
        """Return the last index up to `index` at which `joint` bends; -1 if there is none."""
        at = np.searchsorted(self._bends, self._flat(joint, index), side="right") - 1
        return np.maximum(self._bends[at] - joint * self.size, -1)

    def bend_after(self, joint: IntArray, index: IntArray) -> IntArray:
        """Return the first index from `index` on at which `joint` bends; the size if none."""
        at = np.searchsorted(self._bends, self._flat(joint, index), side="left")
        return np.minimum(self._bends[at] - joint * self.size, self.size)

    def reach(self, joint: IntArray) -> SingleArray:
        """Return ramps, tolerances and top speeds of joints, in rows."""
        return self._reach.take(joint, axis=1)

    def ahead_deg(self, joint: IntArray, first: IntArray, steps: int, stride: int) -> SingleArray:
        """Return positions, (steps, joints), every `stride` grid steps from `first` on.

        Beyond its end a reference keeps its last position. No more than `AHEAD_MAX_STEPS`.
        """
        assert steps * stride <= AHEAD_MAX_STEPS
        flat = joint * self._padded_deg.shape[1] + np.minimum(first, self.size - 1)
        return self._padded_deg.take(flat + (stride * np.arange(steps))[:, None])


def _speeds(steps_deg: SingleArray) -> SingleArray:
    """Return speeds by central differences, one-sided at the ends, of steps from and to rest."""
    speed = (steps_deg[1:] + steps_deg[:-1]) / np.float32(2.0 * GRID_S)
    speed[[0, -1]] *= 2.0
    return speed


def _ahead(most: np.ufunc, values: SingleArray) -> SingleArray:
    """Return the largest (or smallest) of each value and its `AUTHORITY_STEPS` - 1 successors."""
    found, other, covered = values.copy(), values.copy(), 1
    while covered < AUTHORITY_STEPS:
        step = min(covered, AUTHORITY_STEPS - covered)
        most(found[:-step], found[step:], out=other[:-step])
        other[-step:] = found[-step:]
        found, other = other, found
        covered += step
    return found


def _bends(accel_deg_s2: SingleArray, ramp_deg_s2: float) -> IntArray:
    """Return the grid points at which the acceleration jumps by `BEND_RATIO` of the ramp."""
    jump = np.abs(np.diff(accel_deg_s2, prepend=np.float32(0.0)))
    found: IntArray = np.flatnonzero(jump > BEND_RATIO * ramp_deg_s2)
    return found
