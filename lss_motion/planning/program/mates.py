"""Servos that move one joint side by side: they get the same moves, close together on the line.

One of them, the leader, is fitted, with a slot that is long enough for the moves of all. The others
get each of its moves just before it, with the same target, and so much more T that all end
together. So the angle by which they fight each other is bounded by what a control tick, a slot and
one wire unit make; `fights` computes it for all phases of their control loops.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.planning.program.move_table import line_times_us, sizes_bytes
from lss_motion.planning.program.moves import (
    FittedJoint,
    nearest_wire,
    nearest_wires,
    profiles_from_rest,
    replayed,
)
from lss_motion.planning.program.reference_grid import GRID_S, LimitArrays, servo_limits
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.verify import make_profile
from lss_motion.units import MS_PER_S, US_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.planning.program.reference_grid import Reference
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.robot.model import Joint, Robot

PHASES: Final = 8
"""Phases of the control loop that are tried for each servo."""


def mates_of(names: Iterable[str], robot: Robot) -> dict[str, tuple[str, ...]]:
    """Return the servos that get the moves of a leader, by its name."""
    known = {*names}
    return {
        mechanism.servos[0]: mechanism.servos[1:]
        for mechanism in robot.mechanisms.values()
        if len(mechanism.joints) == 1 and mechanism.is_redundant and known >= {*mechanism.servos}
    }


def mated(
    leader: Joint, led: FittedJoint, mate: Joint, reference: Reference, before_s: FloatArray
) -> FittedJoint:
    """Return the moves of a mate: those of its leader, received `before_s` earlier."""
    limits = servo_limits(mate, 0.0)
    own = LimitArrays([limits]).take(np.zeros(len(led.received_s), dtype=np.intp))
    ideal_deg = leader.direction * (led.target_wire / leader.model.wire_per_deg - leader.zero_deg)
    target_deg = mate.zero_deg + mate.direction * ideal_deg
    step = limits.wire_step
    wire = nearest_wires(step * np.rint(target_deg * limits.wire_per_deg / step), own)
    received_s = led.received_s - before_s
    duration_ms = led.duration_ms + np.rint(MS_PER_S * before_s)
    begin_deg = nearest_wire(float(reference.position_deg[0]), limits) / limits.wire_per_deg
    profile = _profile(mate, begin_deg, received_s, wire, duration_ms)
    return FittedJoint(received_s, wire, duration_ms, profile)


def _profile(
    joint: Joint,
    begin_deg: float,
    received_s: FloatArray,
    wire: FloatArray,
    duration_ms: FloatArray,
) -> PiecewiseProfile:
    """Return the profile that moves make of one servo which stands at `begin_deg`."""
    if joint.drive != "timed":
        profile = make_profile(joint, begin_deg)
        targets_deg = wire / joint.model.wire_per_deg
        for at_s, target_deg in zip(received_s.tolist(), targets_deg.tolist(), strict=True):
            profile.retarget(at_s, target_deg, None)
        return PiecewiseProfile(profile.pieces())
    limits, begins = [servo_limits(joint, 0.0)], np.array([begin_deg])
    index = np.zeros(len(received_s), dtype=np.intp)
    moves = replayed(index, received_s, wire, duration_ms, begins, LimitArrays(limits))
    return profiles_from_rest(moves, limits, begins)[0]


def lead_s(leader: Joint, led: FittedJoint, robot: Robot) -> FloatArray:
    """Return the line time of each move of a leader: so much earlier its mate receives it."""
    ids = np.full(len(led.received_s), leader.servo_id)
    size = sizes_bytes(ids, led.target_wire, led.duration_ms)
    baud = np.full(len(size), robot.buses[leader.bus].baud_bps)
    return np.asarray(line_times_us(size, baud) / US_PER_S)


def fights(
    fitted: Mapping[str, FittedJoint], references: Mapping[str, Reference], robot: Robot
) -> dict[str, float]:
    """Return the largest angle by which servos of one joint are apart, by mechanism.

    It is that of servos as assumed, whatever the phases of their control loops, in degrees of ideal
    servos.
    """
    found = {}
    for mechanism in robot.mechanisms.values():
        if mechanism.servos[0] not in mates_of(fitted, robot):
            continue
        low = high = None
        for name in mechanism.servos:
            for angles in _phases_deg(robot.joints[name], fitted[name], references[name]):
                low = angles if low is None else np.minimum(low, angles)
                high = angles if high is None else np.maximum(high, angles)
        assert low is not None
        assert high is not None
        found[mechanism.name] = float((high - low).max())
    return found


def _phases_deg(joint: Joint, own: FittedJoint, reference: Reference) -> Iterable[FloatArray]:
    """Yield the ideal angles of a servo on the grid for each phase of its control loop."""
    count = len(reference.position_deg)
    loop_s = joint.response.loop_s if joint.drive == "timed" else 0.0
    begin_deg = float(own.profile.table[1][0])
    for phase in range(PHASES if loop_s else 1):
        late_s = (loop_s * phase / PHASES - own.received_s) % loop_s if loop_s else 0.0
        profile = _profile(
            joint, begin_deg, own.received_s + late_s, own.target_wire, own.duration_ms
        )
        angles = profile.on_grid(reference.start_s, GRID_S, count)
        yield joint.direction * (angles - joint.zero_deg)
