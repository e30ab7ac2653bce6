"""The moves of a program in arrays, and their line times.

A `MoveTable` is a sequence of `Move` whose elements are created when they are read, so that a
program of tens of thousands of moves is cheap to build. `Columns` adds what depends on the robot.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, overload

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.planning.program.line import line_use, reading_rate_hz
from lss_motion.planning.program.model import Move
from lss_motion.protocol.framing import encode_move
from lss_motion.units import LINE_BITS_PER_BYTE, US_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.planning.program.line import LineUse
    from lss_motion.planning.program.moves import FittedJoint
    from lss_motion.planning.program.response import FloatArray, Index, IntArray
    from lss_motion.robot.model import Robot

MADE_AT_ONCE: Final = 256
"""Number of moves created at once, so that a player never waits for all of them."""

POWERS_OF_TEN: Final = np.array([10, 100, 1_000, 10_000, 100_000, 1_000_000, 10_000_000])
"""No angle and no T on the wire has more digits."""


@dataclass(frozen=True, slots=True, eq=False)
class MoveTable(Sequence[Move]):
    """Moves, an element each; equal to any sequence of the same moves. `bus` indexes `buses`."""

    due_us: IntArray
    bus: IntArray
    servo_id: IntArray
    target_wire: FloatArray
    duration_ms: FloatArray
    """NaN for a bare `D`."""
    buses: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.due_us)

    def __iter__(self) -> Iterator[Move]:
        for first in range(0, len(self), MADE_AT_ONCE):
            yield from self._made(slice(first, first + MADE_AT_ONCE))

    @overload
    def __getitem__(self, index: int) -> Move: ...

    @overload
    def __getitem__(self, index: slice) -> Sequence[Move]: ...

    def __getitem__(self, index: int | slice) -> Move | Sequence[Move]:
        if isinstance(index, slice):
            return self.take(index)
        at = range(len(self))[index]
        return self._made(slice(at, at + 1))[0]

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and [*self] == [*other]

    __hash__ = None  # type: ignore[assignment]  # As for a list.

    def take(self, chosen: Index) -> MoveTable:
        return MoveTable(
            self.due_us[chosen],
            self.bus[chosen],
            self.servo_id[chosen],
            self.target_wire[chosen],
            self.duration_ms[chosen],
            self.buses,
        )

    def _made(self, some: slice) -> list[Move]:
        is_bare = np.isnan(self.duration_ms[some])
        durations = np.where(is_bare, 0.0, self.duration_ms[some]).astype(np.intp).astype(object)
        durations[is_bare] = None
        fields = (
            self.due_us[some].tolist(),
            [self.buses[bus] for bus in self.bus[some].tolist()],
            self.servo_id[some].tolist(),
            self.target_wire[some].astype(np.intp).tolist(),
            durations.tolist(),
        )
        return list(map(Move._make, zip(*fields, strict=True)))


def table_of(moves: Sequence[Move]) -> MoveTable:
    """Return `moves` in columns."""
    if isinstance(moves, MoveTable):
        return moves
    fields = zip(*moves, strict=True) if moves else iter([()] * len(Move._fields))
    due_us, of_bus, servo_id, target_wire, duration_ms = fields
    buses = tuple(sorted(set(of_bus)))
    return MoveTable(
        np.array(due_us, dtype=np.intp),
        np.array([buses.index(name) for name in of_bus], dtype=np.intp),
        np.array(servo_id, dtype=np.intp),
        np.array(target_wire, dtype=np.float64),
        np.array(duration_ms, dtype=np.float64),
        buses,
    )


class Columns(Struct, frozen=True):
    """Moves, an element each. `joint` and `bus` are indices into those of the robot."""

    due_us: IntArray
    joint: IntArray
    bus: IntArray
    target_wire: FloatArray
    duration_ms: FloatArray
    """NaN for a bare `D`."""
    baud_bps: IntArray
    size_bytes: IntArray

    @property
    def sent_us(self) -> IntArray:
        """Line time of each move, rounded up to whole microseconds."""
        return line_times_us(self.size_bytes, self.baud_bps)

    @property
    def received_us(self) -> IntArray:
        """When the last byte of each move reaches the servos, if it leaves when it is due."""
        spent = self.size_bytes * (LINE_BITS_PER_BYTE * US_PER_S) // self.baud_bps
        received: IntArray = self.due_us + spent
        return received

    def take(self, chosen: Index) -> Columns:
        return Columns(
            self.due_us[chosen],
            self.joint[chosen],
            self.bus[chosen],
            self.target_wire[chosen],
            self.duration_ms[chosen],
            self.baud_bps[chosen],
            self.size_bytes[chosen],
        )


def moves_of(fitted: Mapping[str, FittedJoint], robot: Robot) -> MoveTable:
    """Return the moves of all joints in the order in which they are due.

    Each is due so that its last byte arrives at the instant that was granted.
    """
    if not fitted:
        return table_of(())
    joints = [robot.joints[name] for name in fitted]
    buses = tuple(sorted(robot.buses))
    each = [len(own.received_s) for own in fitted.values()]
    servo_id = np.repeat([joint.servo_id for joint in joints], each)
    bus = np.repeat([buses.index(joint.bus) for joint in joints], each)
    baud_bps = np.repeat([robot.buses[joint.bus].baud_bps for joint in joints], each)
    received_s, target_wire, duration_ms = (
        np.concatenate([getattr(own, name) for own in fitted.values()])
        for name in ("received_s", "target_wire", "duration_ms")
    )
    size_bytes = sizes_bytes(servo_id, target_wire, duration_ms)
    due_us = np.rint(received_s * US_PER_S).astype(np.intp) - line_times_us(size_bytes, baud_bps)
    order = np.lexsort((servo_id, bus, due_us))
    return MoveTable(due_us, bus, servo_id, target_wire, duration_ms, buses).take(order)


def sizes_bytes(servo_id: IntArray, target_wire: FloatArray, duration_ms: FloatArray) -> IntArray:
    """Return the lengths of the commands that `encode_move` returns; NaN is a bare `D`."""
    size = len(encode_move(0, 0, None)) - 2 + _digits(servo_id) + _digits(np.abs(target_wire))
    size += target_wire < 0.0
    timed = len("T") + _digits(np.nan_to_num(duration_ms))
    found: IntArray = size + np.where(np.isnan(duration_ms), 0, timed)
    return found


def _digits(whole: FloatArray | IntArray) -> IntArray:
    """Return the numbers of digits of whole numbers that are not negative."""
    found: IntArray = 1 + np.searchsorted(POWERS_OF_TEN, whole, side="right")
    return found


def line_times_us(size_bytes: IntArray, baud_bps: IntArray) -> IntArray:
    """Return the line times of so many bytes, rounded up to whole microseconds."""
    spent: IntArray = -(-size_bytes * (LINE_BITS_PER_BYTE * US_PER_S) // baud_bps)
    return spent


def columns_of(moves: Sequence[Move], robot: Robot) -> Columns:
    """Return `moves`, each to a servo of `robot`, in arrays."""
    table = table_of(moves)
    joints = list(robot.joints.values())
    numbers = {(joint.bus, joint.servo_id): index for index, joint in enumerate(joints)}
    ids = range(1 + max((joint.servo_id for joint in joints), default=0))
    index_of = np.array([[numbers.get((bus, one), -1) for one in ids] for bus in table.buses])
    joint = index_of[table.bus, table.servo_id] if len(table) else table.bus
    assert joint.min(initial=0) >= 0, "a move to a servo that is not there"
    buses = list(robot.buses)
    bus = np.array([buses.index(one.bus) for one in joints], dtype=np.intp)[joint]
    bauds = np.array([one.baud_bps for one in robot.buses.values()], dtype=np.intp)
    return Columns(
        table.due_us,
        joint,
        bus,
        table.target_wire,
        table.duration_ms,
        bauds[bus],
        sizes_bytes(table.servo_id, table.target_wire, table.duration_ms),
    )


def lines_use(moves: Sequence[Move], robot: Robot) -> dict[str, LineUse]:
    """Return how the moves use each bus: the check of the schedule, from the bytes alone."""
    columns = columns_of(moves, robot)
    slots_us = np.stack((columns.due_us, columns.sent_us), axis=1)
    joints = list(robot.joints.values())
    commanded = [joints[index] for index in np.flatnonzero(np.bincount(columns.joint)).tolist()]
    uses = {}
    for index, (name, bus) in enumerate(robot.buses.items()):
        own_us = slots_us[columns.bus == index]
        own = [joint for joint in commanded if joint.bus == name and joint.drive != "stepped"]
        use = line_use(name, bus.baud_bps, own_us)
        rate_hz = reading_rate_hz(own, bus.baud_bps, own_us)
        uses[name] = replace(use, reading_rate_hz=rate_hz)
    return uses
