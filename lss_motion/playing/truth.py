"""What the simulated horns really did, sampled while the show plays.

The show clock forgets its past, so `TruthRecorder` takes the samples as they come, a few seconds
behind the show, and writes them to a file that the system removes. So an hour takes no memory. If
there is no room for that file, they stay in memory.
"""

from __future__ import annotations

import io
import itertools
import math
import tempfile
from typing import IO, TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.files.output import write_output
from lss_motion.files.texts import counted
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.sim.bus import SimBus

TRUTH_STEP_S: Final = 0.01
"""The truth is sampled at 100 Hz of show time."""
PORTION_NS: Final = 2 * NS_PER_S
BEHIND_NS: Final = 5 * NS_PER_S
"""Samples are taken so long after their instant. A stall or a wait changes the show clock of a past
instant, but none that is longer ago."""


class Truth(Struct, frozen=True, kw_only=True):
    """The angles of the simulated horns: joint degrees, (n, joints), at show times.

    Of a robot with mechanisms also those of the servos behind them, as `servo:NAME`, in degrees of
    ideal servos.
    """

    times_s: NDArray[np.float64]
    joints: tuple[str, ...]
    horn_deg: NDArray[np.float64]

    def __repr__(self) -> str:
        return f"Truth({counted(self.times_s, 'sample')} of {', '.join(self.joints)})"


class TruthRecorder:
    """Samples the horns of a show; compares them with `trajectory`, if there is one."""

    def __init__(
        self, robot: Robot, buses: Mapping[str, SimBus], trajectory: Trajectory | None
    ) -> None:
        self._figure, self._robot = robot, robot.servo_robot
        self._buses = buses
        self._trajectory = trajectory
        if trajectory is not None and robot.servos:
            from lss_motion.planning.trajectory.servo_motion import with_servos

            self._trajectory = with_servos(trajectory, robot)
        self._servos: tuple[str, ...] = ()
        self._joints: tuple[str, ...] = ()
        self._file: IO[bytes] | None = None
        self._rest: list[NDArray[np.float64]] | None = None
        """All rows, if the file took no more."""
        self._count = 0
        self._next: int | None = None
        """Number of the next sample, from show time 0."""
        self._since_ns = self._last_ns = 0
        self._squares: NDArray[np.float64] | None = None
        self._largest: NDArray[np.float64] | None = None

    def turn(self, player: Player, now_ns: int) -> None:
        """Take the samples of a while ago, if there are enough of them."""
        if player.show is None or now_ns < self._last_ns + PORTION_NS:
            return
        self._last_ns = now_ns
        self._sample(player, now_ns - BEHIND_NS)

    def finish(self, player: Player) -> Truth | None:
        """Take the remaining samples and return all; None if there was no show."""
        if player.show is None or player.show_ended_ns is None:
            return None
        self._sample(player, player.show_ended_ns)
        width = 1 + len(self._joints)
        rows: NDArray[np.float64] = np.empty((0, width))
        if self._rest is not None:
            rows = np.concatenate(self._rest)
        elif self._file is not None:
            rows = np.memmap(self._file, np.float64, "r", shape=(self._count, width))
        self.close()
        return Truth(times_s=rows[:, 0], joints=self._joints, horn_deg=rows[:, 1:])

    def close(self) -> None:
        """Close the file; what `finish` returned stays."""
        if self._file is not None:
            self._file.close()

    def errors_deg(self) -> dict[str, tuple[float, float]] | None:
        """Return RMS and largest distance from the plan by joint; None if there is no plan."""
        if self._squares is None or self._largest is None or self._trajectory is None:
            return None
        planned = [name for name in self._trajectory.joints if name in self._joints]
        rms = np.sqrt(self._squares / self._count)
        return {
            name: (float(rms[column]), float(self._largest[column]))
            for column, name in enumerate(planned)
        }

    def _sample(self, player: Player, until_ns: int) -> None:
        assert player.show is not None
        self._servos = tuple(player.program.start_deg)
        if not self._figure.servos:
            self._joints = self._servos
        knots = list(player.show.clock.knots(self._since_ns, until_ns, 10 * NS_PER_MS))
        self._since_ns = until_ns
        start = 0
        for index, (before, after) in enumerate(itertools.pairwise(knots), start=1):
            if after[0] == before[0] and after[1] != before[1]:  # The show was sent elsewhere.
                self._sample_between(knots[start:index], player.program.duration_s)
                # At this instant the robot is not there yet. Before time 0 nothing is to be done.
                first = math.floor(after[1] / TRUTH_STEP_S + 1e-6) + 1
                start, self._next = index, max(first, 0)
        self._sample_between(knots[start:], player.program.duration_s)

    def _sample_between(self, knots: list[tuple[int, float]], duration_s: float) -> None:
        """Take the samples of a part of the run in which show time did not jump."""
        if not knots:
            return
        instants = np.array([instant for instant, _ in knots], dtype=np.int64)
        shown_s = np.array([show_s for _, show_s in knots])
        if self._next is None:
            self._next = math.ceil(max(float(shown_s[0]), 0.0) / TRUTH_STEP_S - 1e-6)
        last_s = min(float(shown_s[-1]), duration_s)
        last = math.floor(last_s / TRUTH_STEP_S + 1e-6)
        if last < self._next:
            return
        times_s = TRUTH_STEP_S * np.arange(self._next, last + 1, dtype=np.float64)
        self._next = last + 1
        shown_s += 1e-9 * np.arange(len(shown_s))  # Keeps the order where the show stood still.
        at_ns = np.interp(times_s, shown_s, (instants - instants[0]).astype(np.float64))
        self._append(times_s, self._horn_deg(instants[0] + at_ns.astype(np.int64)))

    def _horn_deg(self, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
        from lss_motion.sim.bus import servos_of

        horn = np.empty((len(times_ns), len(self._servos)))
        for bus_name, bus in self._buses.items():
            on_bus = servos_of(self._robot, bus_name)
            servo_deg = bus.horn_deg(times_ns)
            for column, name in enumerate(self._servos):
                joint = self._robot.joints[name]
                if joint.bus == bus_name:
                    angles = servo_deg[:, on_bus.index(name)]
                    horn[:, column] = joint.direction * (angles - joint.zero_deg)
        return horn if not self._figure.servos else self._with_joints(horn)

    def _with_joints(self, servo_deg: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the joints of ideal servos, (n, servos), and after them those behind mechanisms.

        The columns of the latter are called `servo:NAME`.
        """
        from lss_motion.planning.trajectory.servo_motion import joints_and_servos

        self._joints, found = joints_and_servos(self._servos, servo_deg, self._figure)
        return found

    def _append(self, times_s: NDArray[np.float64], horn: NDArray[np.float64]) -> None:
        self._keep(np.column_stack([times_s, horn]))
        self._count += len(times_s)
        if self._trajectory is None:
            return
        planned_deg = self._trajectory.sample(times_s)
        columns = [
            (self._joints.index(name), column)
            for column, name in enumerate(self._trajectory.joints)
            if name in self._joints
        ]
        error = np.stack([horn[:, own] - planned_deg[:, column] for own, column in columns], axis=1)
        squares, largest = (error**2).sum(axis=0), np.abs(error).max(axis=0)
        if self._squares is None or self._largest is None:
            self._squares, self._largest = squares, largest
        else:
            self._squares, self._largest = (
                self._squares + squares,
                np.maximum(self._largest, largest),
            )

    def _keep(self, rows: NDArray[np.float64]) -> None:
        """Write rows to the file; a disk that is full ends no show."""
        if self._rest is not None:
            self._rest.append(rows)
            return
        data = rows.tobytes()
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115  (see `close`)
            is_written = self._file.write(data) == len(data)
        except OSError:
            is_written = False
        if not is_written:
            kept = np.empty((0, rows.shape[1]))
            if self._count and self._file is not None:
                shape = (self._count, rows.shape[1])
                kept = np.array(np.memmap(self._file, np.float64, "r", shape=shape))
            self._rest = [kept, rows]


def write_truth(truth: Truth, path: Path) -> None:
    """Write `t_s,<joint>…,servo:<servo>…` at 100 Hz of show time, in degrees."""
    header = ",".join(["t_s", *truth.joints])
    table = np.column_stack([truth.times_s, truth.horn_deg])
    formats = ["%.2f"] + ["%.3f"] * len(truth.joints)
    text = io.StringIO()
    np.savetxt(text, table, fmt=formats, delimiter=",", header=header, comments="")
    write_output(path, text.getvalue())
