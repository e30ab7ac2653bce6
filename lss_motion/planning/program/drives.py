"""The three drives behind one interface, and the choice between them for `drive: auto`.

  timed     `D…T…` in EM1                        `fit` (all joints together), `response`
  streamed  bare `D` through the filter of EM0   `streamed`
  stepped   whole degrees to an RC servo         `streamed`

For `drive: auto`, the joint is fitted alone with each drive that its servo supports. It is streamed
if that predicts a clearly smaller error of the horn (`WORTH_RATIO`), else timed. The prediction
includes what is unknown about a servo: the instant, within its control loop or within its filter's
period, at which it takes up a command.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final, Protocol

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.planning.program.fit import TimedFit
from lss_motion.planning.program.line import with_phases
from lss_motion.planning.program.moves import LATEST_ARRIVAL_S, fitted_profiles, standing_wire
from lss_motion.planning.program.reference_grid import GRID_S, servo_limits
from lss_motion.planning.program.streamed import PULSE_S, StepFitter, StreamFitter
from lss_motion.planning.program.verify import filter_profile
from lss_motion.robot.servo_models import (
    FAMILIES,
    FILTER_FIRMWARE_MIN,
    can_be_streamed,
    needs_filter,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from lss_motion.planning.program.moves import Setpoint
    from lss_motion.planning.program.reference_grid import Reference
    from lss_motion.planning.program.response import PiecewiseProfile
    from lss_motion.robot.model import Drive, Joint, Robot

    ReferencesOf = Callable[[Robot], Mapping[str, Reference]]

WORTH_RATIO: Final = 0.9
"""The predicted error of streaming must be smaller than this share of the error of timed moves.
Chosen: timed moves take less of the line, and the servo itself keeps their limits."""
UNKNOWN_RATIO: Final = 1.0 / math.sqrt(12.0)
"""RMS of an instant that is equally likely anywhere in a period, in periods."""


class JointFitter(Protocol):
    """Fits one joint, command by command, to the instants that a line grants.

    requested_s = fitter.request(None)           latest instant of the first command
    while requested_s is not None:
        fitter.grant(granted_s)                  when the servo receives it
        requested_s = fitter.request(granted_s)  latest instant of the next command
    """

    setpoints: list[Setpoint]

    def request(self, granted_s: float | None) -> float | None:
        """Return the latest instant for the receipt of the next command; None at the end."""
        ...

    def grant(self, granted_s: float) -> None:
        """Decide the pending command, now that the instant of its successor is known."""
        ...

    def profile(self) -> PiecewiseProfile:
        """Return the whole profile that the commands so far make."""
        ...


def make_fitter(
    joint: Joint, reference: Reference, tolerance_deg: float, seams_s: Sequence[float] = ()
) -> JointFitter:
    """Return the fitter of `reference` for `joint`, which is not timed (those: `fit.TimedFit`)."""
    limits = servo_limits(joint, tolerance_deg)
    if joint.drive == "streamed":
        start_deg = standing_wire(float(reference.position_deg[0]), limits) / limits.wire_per_deg
        return StreamFitter(reference, limits, filter_profile(joint, start_deg))
    assert joint.drive == "stepped"
    return StepFitter(reference, limits, seams_s)


def late_max_s(joint: Joint) -> float:
    """Return by how much a command may be late in a schedule that is not too tight.

    For a timed move, half of what its reach allows; the other half is left for the computer that
    plays it. For a streamed one, what still counts for the same step of the filter.
    """
    match joint.drive:
        case "streamed":
            return 0.5 * joint.response.filter_s
        case "stepped":
            return PULSE_S
        case _:
            return 0.5 * LATEST_ARRIVAL_S


class Choice(Struct, frozen=True, kw_only=True):
    """A robot without `auto`, and the reason for the drive of each joint that had it."""

    robot: Robot
    reasons: Mapping[str, str] = field(default_factory=dict)


def choices(robot: Robot, references: ReferencesOf, tolerance_deg: float) -> list[Choice]:
    """Return the choice that predicts best, then choices with fewer and fewer streamed joints.

    The last one streams only joints that cannot be timed. `references` returns the references for a
    robot; only joints that have one are compared.
    """
    opened = {n: j for n, j in robot.joints.items() if j.drive == "auto"}
    if not opened:
        return [Choice(robot=with_phases(robot))]
    timed = references(_with(robot, dict.fromkeys(opened, "timed")))
    streamed = references(_with(robot, dict.fromkeys(opened, "streamed")))
    drives: dict[str, Drive] = {}
    reasons: dict[str, str] = {}
    gains: dict[str, float] = {}
    for name, joint in opened.items():
        family, reason = FAMILIES[joint.model.family], _only(joint, robot)
        drives[name] = "streamed" if needs_filter(joint) else family.drives[0]
        if not reason and name in timed:
            by_ramps = predicted_deg(replace(joint, drive="timed"), timed[name], tolerance_deg)
            by_filter = predicted_deg(
                replace(joint, drive="streamed"), streamed[name], tolerance_deg
            )
            reason = f"timed predicts {by_ramps:.2f} deg RMS, streamed {by_filter:.2f} deg"
            if by_filter < WORTH_RATIO * by_ramps:
                drives[name] = "streamed"
                gains[name] = by_ramps - by_filter
        reasons[name] = f"{drives[name]}: {reason or 'the show does not move it'}"
    return _with_fewer(robot, drives, reasons, sorted(gains, key=lambda name: gains[name]))


def _with_fewer(
    robot: Robot, drives: Mapping[str, Drive], reasons: Mapping[str, str], by_gain: list[str]
) -> list[Choice]:
    """Return the choice, and then those that time half of the rest of `by_gain` each.

    Joints with the least gain are timed first.
    """
    found = [Choice(robot=_with(robot, drives), reasons=reasons)]
    while by_gain:
        cut = -(-len(by_gain) // 2)
        given_up, by_gain = by_gain[:cut], by_gain[cut:]
        drives = {**drives, **dict.fromkeys(given_up, "timed")}
        why = "timed: the line has no room to stream it;"
        reasons = {**reasons, **{n: f"{why} {reasons[n].partition(': ')[2]}" for n in given_up}}
        found.append(Choice(robot=_with(robot, drives), reasons=reasons))
    return found


def _with(robot: Robot, drives: Mapping[str, Drive]) -> Robot:
    """Return `robot` with other `drives`."""
    changed = {name: replace(robot.joints[name], drive=drive) for name, drive in drives.items()}
    return with_phases(replace(robot, joints={**robot.joints, **changed}))


def _only(joint: Joint, robot: Robot) -> str:
    """Return why a joint has only one drive; empty if it has a choice."""
    if needs_filter(joint):
        most = joint.model.accel_max_deg_s2
        return f"{joint.accel_max_deg_s2:g} deg/s² is more than its ramps can express, {most:g}"
    if "streamed" not in FAMILIES[joint.model.family].drives:
        return f"a {joint.model.name} supports no other drive"
    if not can_be_streamed(joint, robot.buses[joint.bus]):
        return f"streaming needs firmware {FILTER_FIRMWARE_MIN}"
    return ""


def predicted_deg(joint: Joint, reference: Reference, tolerance_deg: float) -> float:
    """Return the predicted RMS error of a joint's horn, fitted with a free line."""
    profile = fitted_alone(joint, reference, tolerance_deg)
    times_s = reference.start_s + GRID_S * np.arange(len(reference.position_deg), dtype=np.float64)
    error_deg = profile.sample(times_s) - reference.position_deg
    speed_deg_s = np.gradient(reference.position_deg, GRID_S)
    period_s = joint.response.filter_s if joint.drive == "streamed" else joint.response.loop_s
    unknown_deg = UNKNOWN_RATIO * period_s * speed_deg_s
    return float(np.sqrt(np.mean(error_deg**2) + np.mean(unknown_deg**2)))


def fitted_alone(joint: Joint, reference: Reference, tolerance_deg: float) -> PiecewiseProfile:
    """Return the profile of one joint's moves if each is received at the instant requested."""
    if joint.drive == "timed":
        limits = servo_limits(joint, tolerance_deg)
        moves = TimedFit([reference], [limits]).moves(
            lambda: lambda _joints, requested_us, _after_us: requested_us
        )
        return fitted_profiles(moves, [reference], [limits])[0]
    fitter = make_fitter(joint, reference, tolerance_deg)
    requested_s = fitter.request(None)
    while requested_s is not None:
        fitter.grant(requested_s)
        requested_s = fitter.request(requested_s)
    return fitter.profile()
