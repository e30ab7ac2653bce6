"""The moves of a program in arrays, and what they take of their lines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.program.model import Move
from lss_motion.protocol.line import encode_move
from lss_motion.units import LINE_BITS_PER_BYTE, US_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.program.batch import FloatArray, Index, IntArray
    from lss_motion.robot.model import Robot


@dataclass(frozen=True, slots=True)
class Columns:
    """Moves, an element each. `joint` and `bus` count those of the robot, in its order."""

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
        """How long each keeps its line busy, rounded up to whole microseconds."""
        sent: IntArray = -(-self.size_bytes * (LINE_BITS_PER_BYTE * US_PER_S) // self.baud_bps)
        return sent

    @property
    def heard_us(self) -> IntArray:
        """When the last byte of each reaches the servos, if it leaves when it is due."""
        spent = self.size_bytes * (LINE_BITS_PER_BYTE * US_PER_S) // self.baud_bps
        heard: IntArray = self.due_us + spent
        return heard

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


def columns_of(moves: Sequence[Move], robot: Robot) -> Columns:
    """Return `moves`, every one to a servo of `robot`, in arrays."""
    joints = {(j.bus, j.servo_id): index for index, j in enumerate(robot.joints.values())}
    buses = list(robot.buses)
    of_bus = np.array([buses.index(j.bus) for j in robot.joints.values()], dtype=np.intp)
    bauds = np.array([bus.baud_bps for bus in robot.buses.values()], dtype=np.intp)
    fields = zip(*moves, strict=True) if moves else iter([()] * len(Move._fields))
    due_us, bus_names, servo_ids, targets, durations = fields
    joint = np.array([joints[key] for key in zip(bus_names, servo_ids, strict=True)], dtype=np.intp)
    bus = of_bus[joint]
    sizes = [len(encode_move(*what)) for what in zip(servo_ids, targets, durations, strict=True)]
    return Columns(
        np.array(due_us, dtype=np.intp),
        joint,
        bus,
        np.array(targets, dtype=np.float64),
        np.array(durations, dtype=np.float64),
        bauds[bus],
        np.array(sizes, dtype=np.intp),
    )
