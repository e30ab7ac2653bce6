"""Joints that a person moves, and the servos behind them: readings and targets.

Readings of several servos never have the same instant. `JointReadings` takes the angle of a joint
where all of its servos are known: at the latest reading of the one that was read first, between
the two readings of the others.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct

from lss_motion.robot.profile import Piece, ramp_deg_s2, trapezoid, travel_speed
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.playing.joint_view import JointView
    from lss_motion.robot.mechanism import FloatArray, Mechanism
    from lss_motion.robot.model import Robot

WAY_PLACES: Final = 9
"""Places of a way at which the speeds of joints are judged. Chosen: it is a few degrees long."""
HALVINGS: Final = 20
"""So often the way to a target that a servo cannot reach is halved: to a millionth of it."""
EDGE_DEG: Final = 1e-6
SPEED_NS: Final = NS_PER_S // 20
"""A speed is read over at least so long: readings have steps of 0.1 deg."""
ON_THE_WAY: Final = 25
"""Places of a predicted way. Chosen: a few degrees apart, or less."""
BEYOND_DEG: Final = 0.2
"""So far a joint may pass its range: noise of the readings from which the way is predicted."""


class JointReading(Struct, frozen=True):
    """The angle of a joint, in joint degrees, at the instant when its servo received the query."""

    joint: str
    at_ns: int
    deg: float


class JointReadings:
    """The readings of joints by those of their servos."""

    def __init__(self, view: JointView) -> None:
        self.latest: dict[str, JointReading] = {}
        """The latest of each joint."""
        self._view = view
        self._last: dict[str, tuple[JointReading, JointReading]] = {}
        """The last two readings of each servo."""
        self._seen: dict[str, deque[JointReading]] = {}
        """The readings of each servo over `SPEED_NS`."""
        self._told_ns: dict[str, int] = {}
        """By mechanism the instant of the last angles."""

    def speed_deg_s(self, servo: str) -> float:
        """Return the speed of a servo of a mechanism over the last `SPEED_NS`."""
        seen = self._seen[servo]
        passed_ns = seen[-1].at_ns - seen[0].at_ns
        return (seen[-1].deg - seen[0].deg) * NS_PER_S / passed_ns if passed_ns else 0.0

    def add(self, reading: JointReading) -> list[JointReading]:
        """Take a reading of a servo; return the angles of joints that are known by it."""
        mechanism = self._view.mechanism_of_servo(reading.joint)
        if mechanism is None:
            self.latest[reading.joint] = reading
            return [reading]
        before = self._last.get(reading.joint, (reading, reading))[1]
        self._last[reading.joint] = (before, reading)
        seen = self._seen.setdefault(reading.joint, deque())
        seen.append(reading)
        while len(seen) > 2 and reading.at_ns - seen[1].at_ns >= SPEED_NS:
            seen.popleft()
        own = [self._last[name] for name in mechanism.servos if name in self._last]
        at_ns = min(last.at_ns for _, last in own)
        if len(own) < len(mechanism.servos) or at_ns <= self._told_ns.get(mechanism.name, -1):
            return []
        self._told_ns[mechanism.name] = at_ns
        servo_deg = np.array([[_between(before, last, at_ns) for before, last in own]])
        angles = mechanism.transmission.joint_deg(servo_deg)[0].tolist()
        fresh = [
            JointReading(name, at_ns, deg)
            for name, deg in zip(mechanism.joints, angles, strict=True)
        ]
        self.latest |= {one.joint: one for one in fresh}
        return fresh


def _between(before: JointReading, last: JointReading, at_ns: int) -> float:
    """Return the angle of a servo at an instant between its last two readings."""
    if at_ns >= last.at_ns or last.at_ns == before.at_ns:
        return last.deg
    share = max(0.0, (at_ns - before.at_ns) / (last.at_ns - before.at_ns))
    return before.deg + share * (last.deg - before.deg)


class ServoTargets(Struct, frozen=True):
    """Where the servos of a mechanism go, in degrees of ideal servos, and how long at least."""

    joint_deg: dict[str, float]
    servo_deg: dict[str, float]
    least_s: float


def servo_targets(
    mechanism: Mechanism,
    robot: Robot,
    here_deg: Mapping[str, float],
    wanted_deg: Mapping[str, float],
    moved: str,
) -> ServoTargets:
    """Return the targets of servos for those of joints; `here_deg` is where the servos stand.

    Ranges hold at the joints and at every servo: `moved` goes as far as they allow. So do limits of
    speed, also where the joint is faster than its servo: that takes `least_s`.
    """
    g = mechanism.transmission
    servos = [robot.servos[name] for name in mechanism.servos]
    here = np.array([here_deg[name] for name in mechanism.servos])
    column = mechanism.joints.index(moved)
    aim = np.array([robot.joints[name].within_deg(wanted_deg[name]) for name in mechanism.joints])
    low = np.array([servo.position_min_deg for servo in servos]) - EDGE_DEG
    high = np.array([servo.position_max_deg for servo in servos]) + EDGE_DEG

    def is_inside(joint_deg: FloatArray) -> bool:
        servo_deg = g.servo_deg(joint_deg[None])[0]
        return bool(((servo_deg >= low) & (servo_deg <= high)).all())

    if not is_inside(aim):
        near, far = g.joint_deg(here[None])[0][column], aim[column]
        for _ in range(HALVINGS):
            aim[column] = 0.5 * (near + far)
            near, far = (aim[column], far) if is_inside(aim) else (near, aim[column])
        aim[column] = near
    target = np.clip(g.servo_deg(aim[None])[0], low + EDGE_DEG, high - EDGE_DEG)
    way = target - here
    places = g.joint_deg(here + np.linspace(0.0, 1.0, WAY_PLACES)[:, None] * way)
    rates = np.abs(np.linalg.pinv(g.slopes(places)) @ way).max(axis=0)
    servo_s = np.abs(way) / np.array([servo.speed_max_deg_s for servo in servos])
    joint_s = rates / np.array([robot.joints[name].speed_max_deg_s for name in mechanism.joints])
    return ServoTargets(
        joint_deg=dict(zip(mechanism.joints, aim.tolist(), strict=True)),
        servo_deg=dict(zip(mechanism.servos, target.tolist(), strict=True)),
        least_s=float(max(servo_s.max(), joint_s.max())),
    )


def leaves_ranges(
    mechanism: Mechanism,
    robot: Robot,
    standing: Mapping[str, tuple[float, float]],
    servo_deg: Mapping[str, float],
    duration_s: float,
) -> bool:
    """Return whether a move would take a joint out of its range on the way to its target.

    Servos that are `standing` (angle and speed) elsewhere than at rest do not move in step: each
    brakes first. The ranges of servos hold by themselves, since each goes to its own target.
    """
    pieces = []
    for name in mechanism.servos:
        servo, (deg, deg_s) = robot.servos[name], standing[name]
        start, ramp = Piece(0.0, deg, deg_s, 0.0), ramp_deg_s2(servo)
        asked = travel_speed(start, servo_deg[name], duration_s, ramp, servo.response)
        pieces.append(trapezoid(start, servo_deg[name], min(asked, servo.speed_max_deg_s), ramp))
    end_s = max(own[-1].start_s for own in pieces)
    times_s = np.linspace(0.0, end_s, ON_THE_WAY)
    way = np.array([[_at(own, at_s) for own in pieces] for at_s in times_s.tolist()])
    angles = mechanism.transmission.joint_deg(way)
    joints = [robot.joints[name] for name in mechanism.joints]
    here = angles[0]
    low = np.minimum([joint.position_min_deg for joint in joints], here) - BEYOND_DEG
    high = np.maximum([joint.position_max_deg for joint in joints], here) + BEYOND_DEG
    return bool(((angles < low) | (angles > high)).any())


def _at(pieces: Sequence[Piece], at_s: float) -> float:
    return max((one for one in pieces if one.start_s <= at_s), key=_begins).at(at_s)[0]


def _begins(piece: Piece) -> float:
    return piece.start_s
