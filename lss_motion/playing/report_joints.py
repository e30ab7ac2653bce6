"""The report of servos behind mechanisms, as that of their joints.

Readings of servos become joints by least squares where there are more servos than joints; what is
left is the angle by which servos fight each other. Servos are read one after the other, so between
its readings the error of a servo is taken to change evenly.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.planning.summaries import joint_errors
from lss_motion.playing.report import FightReport, JointReport, TraceReport

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.report import Report
    from lss_motion.robot.mechanism import Mechanism
    from lss_motion.robot.model import Robot

    FloatArray = NDArray[np.float64]


class JointsSeen(Struct, frozen=True):
    """What the readings of the servos of a mechanism say about its joints, at the same instants."""

    at_s: FloatArray
    planned_deg: FloatArray
    measured_deg: FloatArray
    fight_deg: float | None
    """The largest one; None where there are as many joints as servos, or nothing was read."""


def measured(mechanism: Mechanism, servos: Sequence[JointReport]) -> JointsSeen | None:
    """Return the joints by the readings of all their servos; None: one was not read."""
    traces = [servo.trace for servo in servos]
    if any(len(trace.at_s) < 2 for trace in traces):
        return None
    first = max(trace.at_s[0] for trace in traces)
    last = min(trace.at_s[-1] for trace in traces)
    at_s = np.unique(np.concatenate([trace.at_s for trace in traces]))
    at_s = at_s[(at_s >= first) & (at_s <= last)]
    if not len(at_s):
        return None

    def evenly(values: Sequence[FloatArray]) -> FloatArray:
        pairs = zip(traces, values, strict=True)
        return np.column_stack([np.interp(at_s, trace.at_s, one) for trace, one in pairs])

    off = evenly([np.subtract(trace.measured_deg, trace.planned_deg) for trace in traces])
    planned = evenly([np.asarray(trace.planned_deg) for trace in traces])
    g = mechanism.transmission
    fight = None
    if mechanism.is_redundant:
        fight = float(mechanism.fight_deg(planned + off).max())
    return JointsSeen(at_s, g.joint_deg(planned), g.joint_deg(planned + off), fight)


def with_joints(
    report: Report,
    robot: Robot,
    program: Program,
    horn_error_deg: Mapping[str, tuple[float, float]] | None,
) -> Report:
    """Return the report of servos as that of the joints of `robot`, with the servos below."""
    if not robot.servos:
        return report
    joints, apart = joint_reports(report.joints, robot, horn_error_deg or {})
    fights = {
        name: FightReport(measured_max_deg=deg, bound_deg=round(program.fight_deg[name], 3))
        for name, deg in apart.items()
        if name in program.fight_deg
    }
    texts = [text for name, one in fights.items() if (text := _fight_text(name, one))]
    return replace(
        report,
        joints=joints,
        servos=report.joints,
        fights=fights,
        warnings=(*report.warnings, *texts),
    )


FIGHT_MIN_DEG: Final = 1.0
"""Servos that are less apart than this beyond what their moves explain are no finding. Chosen: the
play and the readings of two servos."""


def _fight_text(name: str, fight: FightReport) -> str:
    """Return what is wrong with a mechanism whose servos fight; empty: nothing is."""
    if fight.measured_max_deg <= fight.bound_deg + FIGHT_MIN_DEG:
        return ""
    return (
        f"mechanism {name!r}: its servos were up to {fight.measured_max_deg:.1f} deg apart, of "
        f"which their moves explain {fight.bound_deg:.1f}: they work against each other. Let the "
        f"robot go limp, read both, and put the difference into zero_deg of one"
    )


def joint_reports(
    servos: Mapping[str, JointReport],
    robot: Robot,
    horn_error_deg: Mapping[str, tuple[float, float]],
) -> tuple[dict[str, JointReport], dict[str, float]]:
    """Return the reports of joints by those of their servos, and the fight of each mechanism."""
    found: dict[str, JointReport] = {}
    fights: dict[str, float] = {}
    by_joint = {name: m for m in robot.mechanisms.values() for name in m.joints}
    for name in robot.joints:
        mechanism = by_joint.get(name)
        if mechanism is None:
            if name in servos:
                found[name] = servos[name]
        elif name not in found and {*mechanism.servos} <= servos.keys():
            own = [servos[servo] for servo in mechanism.servos]
            seen = measured(mechanism, own)
            if seen is not None and seen.fight_deg is not None:
                fights[mechanism.name] = round(seen.fight_deg, 3)
            for column, joint in enumerate(mechanism.joints):
                found[joint] = _joint(joint, column, mechanism, servos, robot, seen, horn_error_deg)
    return found, fights


def _joint(
    name: str,
    column: int,
    mechanism: Mechanism,
    servos: Mapping[str, JointReport],
    robot: Robot,
    seen: JointsSeen | None,
    horn_error_deg: Mapping[str, tuple[float, float]],
) -> JointReport:
    own = [servos[servo] for servo in mechanism.servos]

    def carried(key: str) -> float | None:
        values = {servo: getattr(servos[servo], key) for servo in mechanism.servos}
        if any(value is None for value in values.values()):
            return None
        return round(joint_errors(values, robot)[name], 3)

    def known(key: str) -> list[float]:
        return [getattr(one, key) for one in own if getattr(one, key) is not None]

    trace, rms, worst = TraceReport(at_s=(), planned_deg=(), measured_deg=()), 0.0, 0.0
    if seen is not None:
        planned, found = seen.planned_deg[:, column], seen.measured_deg[:, column]
        off = found - planned
        rms, worst = math.sqrt(float((off**2).mean())), float(np.abs(off).max())
        trace = TraceReport(
            at_s=tuple(np.round(seen.at_s, 3).tolist()),
            planned_deg=tuple(np.round(planned, 3).tolist()),
            measured_deg=tuple(np.round(found, 3).tolist()),
        )
    true_rms, true_max = horn_error_deg.get(name, (None, None))
    return JointReport(
        readings=min(one.readings for one in own),
        error_rms_deg=round(rms, 3),
        error_max_deg=round(worst, 3),
        offset_max_deg=carried("offset_max_deg") or 0.0,
        predicted_error_max_deg=carried("predicted_error_max_deg"),
        predicted_bound_deg=carried("predicted_bound_deg"),
        lag_extra_s=max((one.lag_extra_s for one in own), key=abs),
        resent=sum(one.resent for one in own),
        temperature_max_c=max(known("temperature_max_c"), default=None),
        voltage_min_v=min(known("voltage_min_v"), default=None),
        current_max_a=max(known("current_max_a"), default=None),
        trace=trace,
        horn_error_rms_deg=None if true_rms is None else round(true_rms, 3),
        horn_error_max_deg=None if true_max is None else round(true_max, 3),
    )
