"""Moves in columns, one by one made when they are asked for: tens of thousands cost nothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, overload

import numpy as np

from lss_motion.program.model import Move

if TYPE_CHECKING:
    from lss_motion.program.batch import FloatArray, Index, IntArray

MADE_AT_ONCE: Final = 256
"""So many moves are made at once, so that whoever plays them never waits for all."""


@dataclass(frozen=True, slots=True, eq=False)
class MoveTable(Sequence[Move]):
    """Moves, an element each; `bus` counts `buses`. Equal to any sequence of the same moves."""

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

    __hash__ = None  # type: ignore[assignment]  # As of a list.

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
