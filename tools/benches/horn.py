"""Where the simulated horns were against the plan: ours, and the three usual ways to drive them.

All on the same simulated robot with its sober defaults: 18 servos at 115200 bps, 60 s.
(a) one `D…T…` a keyframe, (b) `D…T…` to each sample at 30 Hz without looking ahead, (c) bare `D`
at 50 Hz in EM0 with FPC 3, as most walking robots do.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion.playing import api
from lss_motion.playing.player.query_choice import BY_NEED
from lss_motion.playing.run import perform
from lss_motion.protocol.framing import encode_move
from lss_motion.sim.bus import bus_from_robot
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence

SHOW_S = 60.0
JOINTS = 18
START_S = 1.0
"""The simulated servos are powered this long before the show."""
RMS_TARGET_DEG = 0.3
MAX_TARGET_DEG = 1.5
LINE_TARGET_RATIO = 0.35
READINGS_TARGET_HZ = 0.95 * BY_NEED.steady_hz
"""Moves come first: a query may wait for those of an instant, which shifts the later ones too."""
BETTER_TARGET = 10.0


def measure() -> list[Row]:
    """Return RMS of horn against plan for all four ways, the line use and the reading rate."""
    robot = robot_of(JOINTS)
    sequence = lively_show(robot, SHOW_S, seed=1)
    trajectory = api.plan(sequence, robot)
    program = api.compile(trajectory, robot)
    result = perform(program, robot, is_virtual=True, trajectory=trajectory)
    joints = result.report.joints.values()
    rms_deg = float(np.sqrt(np.mean([joint.horn_error_rms_deg**2 for joint in joints])))
    max_deg = max(joint.horn_error_max_deg for joint in joints)
    use = program.line_use["main"].utilisation_ratio
    reading_hz = min(joint.readings for joint in joints) / trajectory.duration_s
    rows = [
        Row(what="RMS of all horns", ours=f"{rms_deg:.3f} deg", target=f"<= {RMS_TARGET_DEG} deg",
            is_met=rms_deg <= RMS_TARGET_DEG),
        Row(what="largest error", ours=f"{max_deg:.2f} deg", target=f"<= {MAX_TARGET_DEG} deg",
            is_met=max_deg <= MAX_TARGET_DEG),
        Row(what="line used for commands", ours=f"{use:.1%}",
            reference=f"{program.line_use['main'].commands} commands",
            target=f"<= {LINE_TARGET_RATIO:.0%}", is_met=use <= LINE_TARGET_RATIO),
        Row(what="readings of the least read joint", ours=f"{reading_hz:.1f} /s",
            target=f">= {READINGS_TARGET_HZ:g} /s", is_met=reading_hz >= READINGS_TARGET_HZ),
    ]  # fmt: skip
    ways = {
        "(a) one D…T… a keyframe": (b"", keyframe_writes(sequence, robot)),
        "(b) D…T… to samples at 30 Hz": (
            b"",
            sample_writes(trajectory, robot, 30.0, is_timed=True),
        ),
        "(c) bare D at 50 Hz, EM0, FPC 3": (
            b"#254EM0\r#254FPC3\r",
            sample_writes(trajectory, robot, 50.0, is_timed=False),
        ),
    }
    for name, (settings, writes) in ways.items():
        other_deg = _driven_rms_deg(robot, trajectory, settings, writes)
        rows.append(
            Row(
                what=f"RMS of {name}",
                ours=f"{rms_deg:.3f} deg",
                reference=f"{other_deg:.3f} deg",
                ratio=other_deg / rms_deg,
                target=f">= {BETTER_TARGET:g} x smaller",
                is_met=other_deg / rms_deg >= BETTER_TARGET,
            )
        )
    return rows


def keyframe_writes(sequence: Sequence, robot: Robot) -> Iterator[tuple[float, bytes]]:
    """Yield `(instant, bytes)`: at every key of a joint, the move to its next one."""
    keys: dict[str, list[tuple[float, float]]] = {name: [] for name in robot.joints}
    for frame in sequence.keyframes:
        assert frame.at_s is not None
        for name, angle in frame.deg.items():
            keys[name].append((frame.at_s, angle))
    moves = []
    for name, listed in keys.items():
        for (from_s, _), (to_s, angle) in pairwise(listed):
            data = encode_move(
                robot.joints[name].servo_id, round(10 * angle), round(1e3 * (to_s - from_s))
            )
            moves.append((from_s, data))
    yield from sorted(moves)


def sample_writes(
    trajectory: Trajectory, robot: Robot, rate_hz: float, *, is_timed: bool
) -> Iterator[tuple[float, bytes]]:
    """Yield, `rate_hz` times a second, every joint's next sample, with T or bare."""
    period_s = 1.0 / rate_hz
    times_s = np.arange(0.0, trajectory.duration_s + period_s, period_s)
    ahead = trajectory.sample(times_s + (period_s if is_timed else 0.0))
    duration_ms = round(1e3 * period_s) if is_timed else None
    for time_s, angles in zip(times_s, ahead, strict=True):
        yield (
            float(time_s),
            b"".join(
                encode_move(robot.joints[name].servo_id, round(10 * angle), duration_ms)
                for name, angle in zip(trajectory.joints, angles, strict=True)
            ),
        )


def _driven_rms_deg(
    robot: Robot,
    trajectory: Trajectory,
    settings: bytes,
    writes: Iterator[tuple[float, bytes]],
) -> float:
    times_s = np.arange(0.0, trajectory.duration_s, 0.01)
    horn = driven_horns(robot, trajectory, settings, writes, times_s)
    return _rms(horn - trajectory.sample(times_s))


def driven_horns(
    robot: Robot,
    trajectory: Trajectory,
    settings: bytes,
    writes: Iterator[tuple[float, bytes]],
    times_s: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return all horns at show times, (n, joints), after `settings` and the timed `writes`."""
    bus = bus_from_robot(robot, "main", seed=0)
    bus.record()
    bus.advance(0)
    bus.write(settings, ns_from_s(0.1))
    bus.write(b"".join(encode_move(j.servo_id, 0, 100) for j in robot.joints.values()),
              ns_from_s(0.2))  # fmt: skip
    for time_s, data in writes:
        bus.write(data, ns_from_s(START_S + time_s))
    bus.advance(ns_from_s(START_S + trajectory.duration_s + 0.5))
    return bus.horn_deg([ns_from_s(START_S + time_s) for time_s in times_s])


def _rms(error: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(error**2)))
