"""How far the horns of a program may be from the plan, on servos that are as assumed.

`horn_errors` gives two numbers for each joint. The first is the error of the moves: the response as
the robot file states it, a pure delay. The second bounds what the simulated servos do. It adds what
the response leaves open:

- the horn may follow its profile as a first-order lag does;
- a command is taken up half a control tick sooner or later (in EM0: half a step of the filter);
- a move that brakes keeps the distance that this makes at its begin until the next one;
- where the plan leaves no acceleration for corrections, such distances grow from move to move. This
  is computed for several phases of the control loop.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from lss_motion.planning.program.moves import profiles_from_rest, replayed
from lss_motion.planning.program.reference_grid import GRID_S, LimitArrays, servo_limits
from lss_motion.planning.program.response import lagged_deg

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.planning.program.moves import FittedJoint
    from lss_motion.planning.program.reference_grid import Reference
    from lss_motion.planning.program.response import FloatArray
    from lss_motion.robot.model import Joint

PHASES: Final = 8
"""Phases of the control loop that are tried. The distance between two of them is covered by that of
a horn at its speed."""
PHASES_LEAST: Final = 2
TRIED_MOVES: Final = 24_000
"""In a show with more moves fewer phases are tried, since the moves themselves arrive at all phases
of the loop: with two, ten minutes of 18 joints take 0.1 s more."""

TRIED_JOINTS: Final = 32
"""Joints that are tried side by side, in bounded memory. Chosen as `schedule.POINTS_MAX`."""
TIE_RATIO: Final = 1e-6
"""Rounding error of a start, in wire units."""


class HornError(NamedTuple):
    """Largest distances of a horn from the plan: by the moves, and the largest to expect."""

    moves_deg: float
    bound_deg: float


class _Fit(NamedTuple):
    joint: Joint
    fitted: FittedJoint
    reference: Reference


def horn_errors(
    fitted: Mapping[str, FittedJoint],
    references: Mapping[str, Reference],
    joints: Mapping[str, Joint],
    tolerance_deg: float,
) -> dict[str, HornError]:
    """Return the errors of all fitted joints."""
    fits = {name: _Fit(joints[name], one, references[name]) for name, one in fitted.items()}
    errors = {name: _error(fit) for name, fit in fits.items()}
    timed = [name for name, fit in fits.items() if fit.joint.drive == "timed"]
    if timed:
        count = sum(len(fits[name].fitted.received_s) for name in timed)
        phases = min(max(TRIED_MOVES // max(count, 1), PHASES_LEAST), PHASES)
        grown_deg = [
            apart_deg
            for first in range(0, len(timed), TRIED_JOINTS)
            for apart_deg in _grown_deg(
                [fits[name] for name in timed[first : first + TRIED_JOINTS]], tolerance_deg, phases
            )
        ]
        for name, apart_deg in zip(timed, grown_deg, strict=True):
            moves_deg, bound_deg = errors[name]
            errors[name] = HornError(moves_deg, max(bound_deg, apart_deg))
    return errors


def _error(fit: _Fit) -> HornError:
    joint, reference = fit.joint, fit.reference
    due_deg = reference.position_deg
    profile_deg = fit.fitted.profile.on_grid(reference.start_s, GRID_S, len(due_deg))
    moves_deg = float(np.abs(profile_deg - due_deg).max())
    if joint.drive == "stepped":
        return HornError(moves_deg, moves_deg)
    horn_deg = lagged_deg(profile_deg, GRID_S, joint.response.lag_s)
    apart_deg = np.abs(horn_deg - _later(due_deg, joint.response.lag_s))
    speed_deg_s = np.maximum(_speeds_deg_s(horn_deg), _begun_deg_s(fit, profile_deg))
    is_streamed = joint.drive == "streamed"
    tick_s = joint.response.filter_s if is_streamed else joint.response.loop_s
    apart_deg += 0.5 * tick_s * speed_deg_s
    bound_deg = max(moves_deg, float(apart_deg.max())) + _tied_deg(joint, float(due_deg[0]))
    return HornError(moves_deg, bound_deg)


def _tied_deg(joint: Joint, start_deg: float) -> float:
    """Return one wire unit if the start is amid two: the servo may stand on either; else 0."""
    rest = start_deg / joint.unit_deg % 1.0
    return joint.unit_deg if abs(rest - 0.5) < TIE_RATIO else 0.0


def _later(values: FloatArray, late_s: float) -> FloatArray:
    """Return values on the grid as they were `late_s` before; they did not change before."""
    steps, part = divmod(late_s / GRID_S, 1.0)
    padded = np.concatenate((np.full(int(steps) + 1, values[0]), values))[: len(values) + 1]
    found: FloatArray = part * padded[:-1] + (1.0 - part) * padded[1:]
    return found


def _speeds_deg_s(position_deg: FloatArray) -> FloatArray:
    found: FloatArray = np.abs(np.diff(position_deg, prepend=position_deg[0])) / GRID_S
    return found


def _begun_deg_s(fit: _Fit, profile_deg: FloatArray) -> FloatArray:
    """Return on the grid how fast the profile was when the move under way was received."""
    count = len(profile_deg)
    begins = np.ceil((fit.fitted.received_s - fit.reference.start_s) / GRID_S).astype(np.intp)
    begins = np.append(0, np.clip(begins, 0, count - 1))
    found: FloatArray = np.repeat(_speeds_deg_s(profile_deg)[begins], np.diff(begins, append=count))
    return found


def _grown_deg(fits: list[_Fit], tolerance_deg: float, phases: int) -> list[float]:
    """Return the largest error of each joint over the phases of its control loop."""
    received, rows = [], []
    for fit in fits:
        loop_s, own_s = fit.joint.response.loop_s, fit.fitted.received_s
        for phase in range(phases):
            late_s = (loop_s * (phase + 0.5) / phases - own_s) % loop_s if loop_s else 0.0
            received.append(own_s + late_s - 0.5 * loop_s)  # The reference leads by half a loop.
            rows.append(fit)
    limits = [servo_limits(fit.joint, tolerance_deg) for fit in rows]
    begins_deg = np.array([fit.fitted.profile.table[1][0] for fit in rows])
    moves = replayed(
        np.repeat(np.arange(len(rows)), [len(own_s) for own_s in received]),
        np.concatenate(received),
        np.concatenate([fit.fitted.target_wire for fit in rows]),
        np.concatenate([fit.fitted.duration_ms for fit in rows]),
        begins_deg,
        LimitArrays(limits),
    )
    made = profiles_from_rest(moves, limits, begins_deg)
    extremes_s = [times_s for fit in fits for times_s in [_extremes_s(fit)] * phases]
    apart = [
        max(
            _apart_deg(fit, profile.table[0][1:], profile.table[1][1:]),
            _apart_deg(fit, times_s, profile.sample(times_s)),
        )
        for fit, profile, times_s in zip(rows, made, extremes_s, strict=True)
    ]
    worst = np.array(apart).reshape(len(fits), phases).max(axis=1)
    return [float(one) + _between_deg(fit, phases) for one, fit in zip(worst, fits, strict=True)]


def _extremes_s(fit: _Fit) -> FloatArray:
    """Return when the distance of the profile from the plan is largest within its pieces.

    Another phase of the loop moves such an instant by no more than about a loop, which changes the
    distance there by next to nothing.
    """
    reference = fit.reference
    count = len(reference.position_deg)
    profile_deg = fit.fitted.profile.on_grid(reference.start_s, GRID_S, count)
    steps_deg = np.diff(profile_deg - reference.position_deg)
    turns = 1 + np.flatnonzero(steps_deg[:-1] * steps_deg[1:] < 0.0)
    return reference.start_s + GRID_S * turns.astype(np.float64)


def _apart_deg(fit: _Fit, times_s: FloatArray, position_deg: FloatArray) -> float:
    """Return the largest distance of the positions of a profile from the plan."""
    reference = fit.reference
    grid_s = reference.start_s + GRID_S * np.arange(len(reference.position_deg))
    is_inside = times_s <= grid_s[-1]
    due_deg = np.interp(times_s[is_inside], grid_s, reference.position_deg)
    return float(np.abs(position_deg[is_inside] - due_deg).max(initial=0.0))


def _between_deg(fit: _Fit, phases: int) -> float:
    """Return what the phases between those tried, and the shape of the lag, may add."""
    response, due_deg = fit.joint.response, fit.reference.position_deg
    shape_deg = lagged_deg(due_deg, GRID_S, response.lag_s) - _later(due_deg, response.lag_s)
    step_s = response.loop_s / phases
    return float(np.abs(shape_deg).max() + 0.5 * step_s * _speeds_deg_s(due_deg).max())
