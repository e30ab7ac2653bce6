"""The reference show: the same motion at three speeds, of which one judges what the others teach.

The model of each joint is fitted to the logs of the slow and the fast show, as `identify --from`
does, and predicts every reading of the middle one, which it has not seen.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec.structs import replace

from lss_motion.errors import PlaybackError
from lss_motion.maintenance.identify.response_fit import HYPOTHESES, ResponseShape, horn_deg
from lss_motion.maintenance.identify.show_fit import identify_from_show
from lss_motion.maintenance.identify.show_pieces import ShowRecording
from lss_motion.maintenance.identify.trials import make_window
from lss_motion.planning.program.compile import compile_program
from lss_motion.planning.trajectory.planner import plan
from lss_motion.show.model import Keyframe, Sequence

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.maintenance.field.measure import Figures
    from lss_motion.maintenance.identify.estimate import Identified
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Joint, Robot

SPEEDS: Final = (1.0, 0.7, 0.5)
"""Shares of the full speed. The middle one is kept out of the fit."""
HELD_OUT: Final = 0.7
KEYS: Final = 28
GAP_S: Final = (0.45, 0.9)
"""Times between keys at full speed. Chosen: a joint is then in motion nearly all the time, which is
what tells its ramps (`show_pieces`)."""
GOLDEN_RATIO: Final = 0.6180339887498949
BEHIND_S: Final = 3.0
"""A show that is appended to another one begins so long after it."""


def reference_show(
    robot: Robot, standing_deg: Mapping[str, float], span_deg: float, speed: float
) -> tuple[Program, Trajectory]:
    """Return the show of joints that stand at `standing_deg` (servo) and come back there."""
    windows = {
        name: make_window(robot.joints[name], deg, span_deg) for name, deg in standing_deg.items()
    }
    frames, at_s = [_frame(robot, standing_deg, 0.0)], 1.0
    for number in range(1, KEYS + 1):
        places = {}
        for index, (name, window) in enumerate(windows.items()):
            share = (GOLDEN_RATIO * number * (index + 1) + 0.5 * (number % 2)) % 1.0
            margin_deg = window.margin_deg() + 0.15 * window.room_deg
            room_deg = window.room_deg - 2.0 * margin_deg
            places[name] = window.low_deg + margin_deg + share * room_deg
        frames.append(_frame(robot, places, at_s / speed))
        at_s += GAP_S[0] + (GAP_S[1] - GAP_S[0]) * (GOLDEN_RATIO * 7.0 * number % 1.0)
    frames.append(_frame(robot, standing_deg, (at_s + 1.0) / speed))
    show = Sequence(name="reference", keyframes=tuple(frames), loop=1)
    trajectory = plan(show, robot)
    return compile_program(trajectory, robot), trajectory


def _frame(robot: Robot, servo_deg: Mapping[str, float], at_s: float) -> Keyframe:
    deg = {name: robot.joints[name].joint_deg(angle) for name, angle in servo_deg.items()}
    return Keyframe(deg=deg, at_s=round(at_s, 3), label=f"at {at_s:.2f}")


def judged(logs: Mapping[float, Mapping[str, ShowRecording]]) -> Figures:
    """Return by joint what the fit to two shows predicts of the third; `logs` are by speed.

    `rms_deg` is what the readings of the third are off from the fitted model, `assumed_rms_deg`
    from the model of the robot file. A joint that did not move enough is left out.
    """
    figures: Figures = {}
    taught = [speed for speed in logs if speed != HELD_OUT]
    for name, held in logs[HELD_OUT].items():
        parts = [logs[speed][name] for speed in taught if name in logs[speed]]
        try:
            found = identify_from_show(appended(parts))
        except PlaybackError:
            continue
        own: dict[str, Any] = {
            "rms_deg": predicted_rms_deg(held, found),
            "assumed_rms_deg": predicted_rms_deg(held, assumed(held.joint, found)),
            "noise_deg": found.noise_deg,
            "delay_s": list(found.delay_s),
            "ramp_deg_s2": list(found.accel_deg_s2),
            "ramp_set_deg_s2": found.ramp_deg_s2,
            "retarget": list(found.retarget),
            "t_law": list(found.t_law),
            "unsure": sorted(found.unsure),
            "readings": len(held.times_s),
        }
        figures[name] = own
    return figures


def appended(parts: list[ShowRecording]) -> ShowRecording:
    """Return shows of one joint as one, with a break between two."""
    whole = ShowRecording(parts[0].joint, parts[0].ramp_deg_s2)
    for part in parts:
        ends_s = [move.received_s for move in whole.moves[-1:]] + whole.times_s[-1:]
        shift_s = max(ends_s) + BEHIND_S if ends_s else 0.0
        if shift_s:
            whole.breaks_s.append(shift_s - 0.5 * BEHIND_S)
        whole.breaks_s += [time_s + shift_s for time_s in part.breaks_s]
        whole.moves += [move._replace(received_s=move.received_s + shift_s) for move in part.moves]
        whole.times_s += [time_s + shift_s for time_s in part.times_s]
        whole.readings_deg += part.readings_deg
        whole.turnarounds_s += part.turnarounds_s
    return whole


def assumed(joint: Joint, found: Identified) -> Identified:
    """Return `found` with the response of the robot file in place of what was found."""
    response = joint.response
    ramp = type(found.accel_deg_s2)(joint.ramp_ratio * found.ramp_deg_s2, 0.0)
    measured = type(found.delay_s)
    return replace(
        found,
        lag_s=measured(response.lag_s, 0.0),
        dead_s=measured(0.5 * response.loop_s, 0.0),
        accel_deg_s2=ramp,
        decel_deg_s2=ramp,
        retarget=found.retarget._replace(value=response.retarget),
        t_law=found.t_law._replace(value=response.t_law),
        droop_deg=(0.0, 0.0, 0.0),
    )


def predicted_rms_deg(recording: ShowRecording, found: Identified) -> float:
    """Return how far the readings of a show are off from a model, root mean square.

    It begins at rest, with the first reading after which a move was received.
    """
    joint, moves = recording.joint, recording.moves
    times_s, readings_deg = np.array(recording.times_s), np.array(recording.readings_deg)
    is_in = times_s <= moves[-1].received_s + 1.0
    for break_s in recording.breaks_s:
        is_in &= times_s < break_s if break_s > moves[0].received_s else times_s >= break_s
    shape = ResponseShape(
        found.accel_deg_s2.value, found.decel_deg_s2.value, joint.speed_max_deg_s, found.lag_s.value
    )
    hypothesis = next(one for one in HYPOTHESES if one == (found.retarget.value, found.t_law.value))
    start_deg = moves[0].target_deg
    delays_s = [found.dead_s.value] * len(moves)
    horn, _ = horn_deg(times_s[is_in], start_deg, moves, delays_s, shape, hypothesis)
    low, middle, high = (joint.direction * deg for deg in found.droop_deg)
    at = (np.array([joint.joint_deg(deg) for deg in horn.tolist()]) - found.low_deg) / max(
        found.high_deg - found.low_deg, 1e-9
    )
    droop = low + at * (4.0 * middle - 3.0 * low - high + at * 2.0 * (low + high - 2.0 * middle))
    off_deg = horn - droop - readings_deg[is_in]
    is_moving = times_s[is_in] > moves[0].received_s + 0.5
    return math.sqrt(float(np.mean(off_deg[is_moving] ** 2))) if is_moving.any() else math.nan
