"""The motion of servos along a path of joints, as further rows of limits.

A servo behind a fixed ratio needs none: the limits of its joint hold those of the servo
(`robot.mechanisms.scaled_joint`). Behind a linkage, a differential or a table, position and motion
of a servo follow from those of several joints or from where the joint is: g(q(s)), with the
derivatives of that (`Mechanism.derivatives`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.planning.trajectory.curves import peaks

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.curves import Path
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]

PEAK_STEP_S: Final = 0.004
PEAK_PARTS: Final = 16
"""Steps in which the largest speed and acceleration of a servo in a segment are looked for: at most
4 ms, at least sixteen a segment. Between them both grow by less than `PEAK_SLACK` of the limit
(measured over random robots)."""
PEAK_SLACK: Final = 5e-4
PEAK_BLOCK: Final = 200_000


class RowGroup(Struct, frozen=True):
    """The servos of one mechanism, and the columns of its joints."""

    mechanism: Mechanism
    columns: tuple[int, ...]


class ServoRows(Struct, frozen=True, kw_only=True):
    """Servos whose motion is not a fixed multiple of that of one joint."""

    groups: tuple[RowGroup, ...]
    speed_max_deg_s: FloatArray
    accel_max_deg_s2: FloatArray

    def labels(self) -> list[tuple[str, str]]:
        """Return a joint and the servo as a person calls it, of each row."""
        return [
            (group.mechanism.joints[0], group.mechanism.servo_label(servo))
            for group in self.groups
            for servo in group.mechanism.servos
        ]

    def place(self, row: int, joint_deg: FloatArray) -> list[tuple[str, float]]:
        """Return the joints of the servo in a row, and their angles among those of a place."""
        for group in self.groups:
            if row < len(group.mechanism.servos):
                angles = joint_deg[list(group.columns)].tolist()
                return list(zip(group.mechanism.joints, angles, strict=True))
            row -= len(group.mechanism.servos)
        raise IndexError(row)

    def slopes(
        self, joint_deg: FloatArray, first: FloatArray, second: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return both derivatives of every servo along the path, (n, servos), of those of joints.

        The results are those of the joints with the servos as further columns.
        """
        firsts, seconds = [first], [second]
        for group in self.groups:
            own = (values[:, list(group.columns)] for values in (joint_deg, first, second))
            speed, accel = group.mechanism.derivatives(*own)
            firsts.append(speed)
            seconds.append(accel)
        return np.concatenate(firsts, axis=1), np.concatenate(seconds, axis=1)

    def peaks(self, path: Path) -> tuple[FloatArray, FloatArray]:
        """Return the largest |first| and |second| derivative of each segment and column.

        Those of joints are exact, those of servos at most `PEAK_SLACK` too small before that is
        added.
        """
        speed, accel = peaks(path)
        lengths_s = path.segment_lengths_s
        counts = np.maximum(np.ceil(lengths_s / PEAK_STEP_S), PEAK_PARTS).astype(np.intp) + 1
        rows = len(self.speed_max_deg_s)
        found = np.zeros((2, len(lengths_s), rows))
        ends = np.cumsum(counts)
        low = 0
        while low < len(counts):
            done = int(ends[low - 1]) if low else 0
            high = max(low + 1, int(np.searchsorted(ends, done + PEAK_BLOCK)))
            own = np.repeat(np.arange(low, high), counts[low:high])
            starts = np.concatenate([[0], np.cumsum(counts[low:high])[:-1]])
            within = np.arange(len(own)) - np.repeat(starts, counts[low:high])
            share = within / np.repeat(counts[low:high] - 1, counts[low:high])
            at_s = path.knots_s[own] + share * lengths_s[own]
            both = self.slopes(path.evaluate(at_s), *path.slopes(at_s, own))
            for order, values in enumerate(both):
                most = np.maximum.reduceat(np.abs(values[:, -rows:]), starts, axis=0)
                found[order, low:high] = most
            low = high
        found *= 1.0 + PEAK_SLACK
        return (
            np.concatenate([speed, found[0]], axis=1),
            np.concatenate([accel, found[1]], axis=1),
        )


def servo_rows(joints: Sequence[str], robot: Robot) -> ServoRows | None:
    """Return the rows of the servos that `joints` move; None: there are none."""
    groups = tuple(
        RowGroup(mechanism, tuple(joints.index(name) for name in mechanism.joints))
        for mechanism in robot.mechanisms.values()
        if not mechanism.is_scaled and robot.servos and set(mechanism.joints) <= {*joints}
    )
    if not groups:
        return None
    servos = [robot.servos[name] for group in groups for name in group.mechanism.servos]
    return ServoRows(
        groups=groups,
        speed_max_deg_s=np.array([servo.speed_max_deg_s for servo in servos]),
        accel_max_deg_s2=np.array([servo.accel_max_deg_s2 for servo in servos]),
    )


SERVO_ROOM_RATIO: Final = 0.97
"""Share of the limits of servos behind mechanisms that is planned with: an averaged motion of the
joints is no average of that of servos, whose limits it may exceed. Measured: by up to 0.4 %."""


def with_servo_room(robot: Robot) -> Robot:
    """Return the robot with room at the servos behind mechanisms; the verifier has the limits."""
    servos = {
        name: replace(
            servo,
            speed_max_deg_s=SERVO_ROOM_RATIO * servo.speed_max_deg_s,
            accel_max_deg_s2=SERVO_ROOM_RATIO * servo.accel_max_deg_s2,
        )
        for name, servo in robot.servos.items()
    }
    return replace(robot, servos=servos) if servos else robot
