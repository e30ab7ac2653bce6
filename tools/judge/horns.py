"""The rules about horns: where they are, how fast, how hard they speed up.

Margins: 0.5 deg beyond the range (load, noise of the encoder); 5 % and 2 deg/s above the speed over
20 ms; 10 % above the acceleration between two such spans. In EM0 a horn is stepped from target to
target: `filter_step_deg` within one step of the filter is added there (0.5 deg in 20 ms squared are
1250 deg/s2), and 20 % instead of 10 %, since the phase of the filter is not known. A motor without
power stops at once, and a servo that restarted a moment ago has the ramps that it stores (until
`ServoRecord.noticed_s`), so neither is judged by its acceleration. For the same reason it may be
half as fast again as its limit for a moment (`recording.UNNOTICED_RATIO`). RC servos of a 2IO jump;
only their range is judged.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from judge.recording import IO2, READ_BACK_S, UNNOTICED_RATIO
from judge.rules import Objection

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from judge.recording import JointRow, ServoRecord
    from judge.rules import Told

RANGE_SPARE_DEG: Final = 0.5
SPEED_RATIO: Final = 1.05
SPEED_SPARE_DEG_S: Final = 2.0
ACCEL_RATIO: Final = 1.1
FILTER_ACCEL_RATIO: Final = 1.2
SPAN_S: Final = 0.02
STOP_S: Final = 0.06
"""A horn that loses its power, or is commanded to halt, is still within this time."""
GAP_S: Final = 0.5
LAST_MOVE_S: Final = 0.5
"""The last move that was written before a restart showed ends within this time."""
RESTS_DEG_S: Final = 2.0


def about_horn(joint: JointRow, servo: ServoRecord, received: Told) -> Iterator[Objection]:
    """Judge the record of one horn, as far as the host's bytes moved it."""
    if servo.excuse or len(servo.horn_deg) < 2:
        return
    times_s = servo.horn_from_s + servo.step_s * np.arange(len(servo.horn_deg))
    shaft_deg = np.asarray(servo.horn_deg, dtype=np.float64)
    angles = joint.direction * (joint.gyre * (shaft_deg - joint.origin_deg) - joint.zero_deg)
    is_own = times_s < received.foreign_s
    yield from _range(joint, times_s[is_own], angles[is_own])
    if joint.family == IO2:
        return
    span = max(round(SPAN_S / servo.step_s), 1)
    if len(angles) <= 2 * span:
        return
    speed = (angles[span:] - angles[:-span]) / (span * servo.step_s)
    accel = (speed[span:] - speed[:-span]) / (span * servo.step_s)
    is_streamed = any(not move.has_profile for move in received.moves)
    fine = _judged(times_s, servo, received, is_streamed=is_streamed)
    fine &= is_own
    speed[~fine[span:]] = 0.0
    speed[_is_unnoticed(times_s, servo)[span:]] /= UNNOTICED_RATIO
    gentle = fine & _is_powered(times_s, servo, received)
    accel[~(gentle[2 * span :] & gentle[: -2 * span])] = 0.0
    accel_deg_s2 = joint.accel_deg_s2 * ACCEL_RATIO
    if is_streamed:
        step_deg_s2 = joint.filter_step_deg / SPAN_S**2
        accel_deg_s2 = (joint.accel_deg_s2 + step_deg_s2) * FILTER_ACCEL_RATIO
    for rule, values, limit, unit in (
        ("horn speed", speed, joint.speed_deg_s * SPEED_RATIO + SPEED_SPARE_DEG_S, "deg/s"),
        ("horn acceleration", accel, accel_deg_s2, "deg/s2"),
    ):
        worst = int(np.abs(values).argmax())
        if abs(values[worst]) > limit:
            yield Objection(rule, joint.name, float(times_s[worst]), f"{abs(values[worst]):.0f} "
                            f"{unit}, allowed is {limit:.0f}")  # fmt: skip


def _range(
    joint: JointRow, times_s: NDArray[np.float64], angles: NDArray[np.float64]
) -> Iterator[Objection]:
    """Judge where a horn is: inside of its range, once it has been inside."""
    out_deg = np.maximum(joint.low_deg - angles, angles - joint.high_deg)
    inside = np.flatnonzero(out_deg <= 0.0)
    if not len(inside):
        return
    after = out_deg[inside[0] :]
    worst = int(after.argmax())
    if after[worst] > RANGE_SPARE_DEG:
        at = inside[0] + worst
        yield Objection("horn range", joint.name, float(times_s[at]), f"{angles[at]:.1f} deg is "
                        f"out of {joint.low_deg:g} to {joint.high_deg:g} deg")  # fmt: skip


def _judged(
    times_s: NDArray[np.float64], servo: ServoRecord, received: Told, *, is_streamed: bool
) -> NDArray[np.bool_]:
    """Return at which instants a horn is judged: not where lost lines explain its motion.

    A timed move keeps its limits, whatever came before it; a bare `D` after a gap is a jump.
    """
    fine = np.ones(len(times_s), dtype=bool)
    spans = [(at_s, at_s) for at_s in servo.restarts]
    spans += received.gaps if is_streamed else []
    for from_s, until_s in spans if is_streamed else []:
        fine &= (times_s < from_s - SPAN_S) | (times_s > until_s + GAP_S)
    return fine


def _is_unnoticed(times_s: NDArray[np.float64], servo: ServoRecord) -> NDArray[np.bool_]:
    """Return at which instants a horn may be on a move that was written before a restart showed."""
    back, unnoticed = dict(servo.back), np.zeros(len(times_s), dtype=bool)
    for at_s in servo.restarts:
        until_s = back.get(at_s, at_s) + READ_BACK_S + LAST_MOVE_S
        unnoticed |= (times_s >= at_s) & (times_s < until_s)
    return unnoticed


def _is_powered(
    times_s: NDArray[np.float64], servo: ServoRecord, received: Told
) -> NDArray[np.bool_]:
    """Return at which instants the ramps of a horn are those that the host set."""
    powered = np.ones(len(times_s), dtype=bool)
    restarts = [move.restarted_s for move in received.moves if move.restarted_s is not None]
    for cut_s in received.powerless_s:
        powered &= (times_s < cut_s - STOP_S) | (times_s > cut_s + STOP_S)
    for at_s in {*restarts}:
        powered &= (times_s < at_s - STOP_S) | (times_s > servo.noticed_s(at_s))
    return powered


def about_rest(joint: JointRow, servo: ServoRecord, end_s: float) -> Iterator[Objection]:
    """Judge whether a horn rests at the end of the record."""
    if servo.excuse or joint.family == IO2 or len(servo.horn_deg) < 2:
        return
    last_deg, before_deg = servo.shaft_deg(end_s), servo.shaft_deg(end_s - 0.1)
    assert last_deg is not None
    assert before_deg is not None
    speed_deg_s = abs(last_deg - before_deg) / 0.1
    if speed_deg_s > RESTS_DEG_S:
        yield Objection("end", joint.name, end_s, f"its horn still moves, at {speed_deg_s:.0f} "
                        f"deg/s")  # fmt: skip
