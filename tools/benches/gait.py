"""How fast and how cleanly the example robots walk: judged at simulated horns, closed loop on.

The hexapod walks tripod at 115200 bps, with the stride and cycle at which it is fastest; what
holds it back is named. Every pattern is walked with several seeds of the simulated servos: how far
standing feet slip, and how high stepping feet go.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from benches.table import Row
from lss_motion.errors import InputError
from lss_motion.planning.shows import GAIT_TOLERANCE_DEG
from lss_motion.playing import api
from lss_motion.playing.run import perform
from lss_motion.robot.load import load_robot
from lss_motion.show.gait.kinematics import forward
from lss_motion.show.gait.load import load_gait, sequence_from
from lss_motion.show.gait.model import PATTERNS, BodyPose, Walk
from lss_motion.show.gait.pacing import paced

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.report import Report
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.pacing import Paced

    FloatArray = NDArray[np.float64]

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
FILES = {6: "hexapod_walk.yaml", 4: "quadruped_trot.yaml"}
SEEDS = 3
STRIDES_MM = tuple(range(20, 401, 10))
SLIP_TARGET_MM = 0.5
LIFT_TARGET_MM = 2.0
SEAM_TARGET_DEG_S = 1.0
SEAM_S = 1e-6
QUICK_S = 0.2
"""A cycle that no servo can do, so that the gait is as fast as they allow."""


@dataclass(frozen=True, kw_only=True)
class Walked:
    """One walk: plan, report, and where horns and feet really were."""

    gait: Gait
    part: Paced
    trajectory: Trajectory
    report: Report
    tolerance_deg: float
    line_ratio: float
    slip_mm: float
    lift_error_mm: float


def measure() -> list[Row]:
    """Return the speed of the tripod and what limits it, and slip and clearance per pattern."""
    return _measured(SEEDS)


def measure_short() -> list[Row]:
    """Return the same with a single seed."""
    return _measured(1)


def _measured(seeds: int) -> list[Row]:
    gait, robot = _example(6, "tripod")
    fastest, stride_mm = _fastest(gait, robot)
    run = _walked(fastest, robot, seed=0)
    cycle_s = fastest.cycle_s * run.part.pace_ratio
    limit = f"{run.part.limit} of {run.part.joint}"
    if run.tolerance_deg > GAIT_TOLERANCE_DEG:
        limit = f"the line: at {run.tolerance_deg:.2f} deg it carries {run.part.limit}"
    seam_deg_s = _seam_deg_s(run)
    rows = [
        Row(what="tripod, fastest", ours=f"{stride_mm / cycle_s:.0f} mm/s",
            reference=f"{stride_mm} mm in {cycle_s:.2f} s"),
        Row(what="what limits it", ours=limit),
        Row(what="line used for commands", ours=f"{run.line_ratio:.0%}",
            reference=f"{run.report.buses['main'].query_rate_hz:.0f} queries/s"),
        Row(what="slip at its fastest", ours=f"{run.slip_mm:.2f} mm"),
        Row(what="jump at the seam of cycles", ours=f"{seam_deg_s:.2g} deg/s",
            target=f"< {SEAM_TARGET_DEG_S:g} deg/s", is_met=seam_deg_s < SEAM_TARGET_DEG_S),
    ]  # fmt: skip
    for legs, known in PATTERNS.items():
        for name in known:
            rows += _pattern_rows(legs, name, seeds)
    return rows


def _pattern_rows(legs: int, name: str, seeds: int) -> list[Row]:
    gait, robot = _example(legs, name)
    walk = Walk(forward_mm_s=80.0, left_mm_s=0.0, turn_deg_s=8.0, cycles=1)
    gait = replace(gait, cycle_s=0.5, actions=(walk,), step_height_mm=20.0 if legs == 6 else 15.0)
    runs = [_walked(gait, robot, seed=seed) for seed in range(seeds)]
    slip_mm = max(run.slip_mm for run in runs)
    lift_mm = max(run.lift_error_mm for run in runs)
    return [
        Row(what=f"{name} ({legs} legs): slip of standing feet", ours=f"{slip_mm:.2f} mm",
            reference=f"{seeds} seeds", target=f"< {SLIP_TARGET_MM} mm",
            is_met=slip_mm < SLIP_TARGET_MM),
        Row(what=f"{name} ({legs} legs): height of steps", ours=f"± {lift_mm:.2f} mm",
            target=f"± {LIFT_TARGET_MM:g} mm", is_met=lift_mm < LIFT_TARGET_MM),
    ]  # fmt: skip


def _example(legs: int, name: str) -> tuple[Gait, Robot]:
    gait = load_gait(EXAMPLES / FILES[legs])
    assert gait.robot_path is not None
    pattern = PATTERNS[legs][name]
    foot_mm = 130.0
    gait = replace(
        gait,
        pattern=pattern,
        duty=pattern.duty_ratio,
        sway_mm=pattern.sway_ratio * foot_mm,
        start=BodyPose(),
    )
    return gait, load_robot(gait.robot_path)


def _fastest(gait: Gait, robot: Robot) -> tuple[Gait, int]:
    """Return the gait with the stride at which it is fastest."""
    best, best_mm, best_mm_s = gait, 0, 0.0
    for stride_mm in STRIDES_MM:
        walk = Walk(forward_mm_s=stride_mm / QUICK_S, left_mm_s=0.0, turn_deg_s=0.0, cycles=4)
        quick = replace(gait, cycle_s=QUICK_S, actions=(walk,))
        try:
            (part,) = paced(quick, robot)
        except InputError:
            break
        if (speed_mm_s := walk.forward_mm_s / part.pace_ratio) > best_mm_s:
            best, best_mm, best_mm_s = quick, stride_mm, speed_mm_s
    return best, best_mm


def _walked(gait: Gait, robot: Robot, *, seed: int) -> Walked:
    parts = paced(gait, robot)
    trajectory = api.plan(sequence_from(gait, parts), robot)
    program = api.compile(trajectory, robot, tolerance_deg=GAIT_TOLERANCE_DEG)
    result = perform(program, robot, is_virtual=True, seed=seed, trajectory=trajectory)
    assert result.truth is not None
    times_s, horn_deg = result.truth.times_s, result.truth.horn_deg
    (part,) = parts
    inside = times_s <= part.duration_s
    stance = part.passage.at(times_s[inside] / part.pace_ratio)
    feet = np.stack(
        [
            forward(leg, horn_deg[inside][:, [result.truth.joints.index(n) for n in leg.joints]])
            for leg in gait.legs
        ],
        axis=1,
    )
    height_mm = stance.feet_mm[..., 2] + (feet - stance.feet_in_body())[..., 2]
    lifts = [height_mm[span, leg].max() for leg, span in _spans(~stance.is_down)]
    return Walked(
        gait=gait,
        part=part,
        trajectory=trajectory,
        report=result.report,
        tolerance_deg=program.tolerance_deg,
        line_ratio=program.line_use["main"].utilisation_ratio,
        slip_mm=_slip_mm(feet, stance.feet_mm, stance.is_down),
        lift_error_mm=float(np.abs(np.array(lifts) - gait.step_height_mm).max()),
    )


def _spans(is_true: NDArray[np.bool_]) -> list[tuple[int, slice]]:
    """Return every unbroken stretch of every leg."""
    found = []
    for leg, column in enumerate(is_true.T):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], column, [0]])))
        found += [(leg, slice(a, b)) for a, b in zip(edges[0::2], edges[1::2], strict=True)]
    return found


def _slip_mm(feet: FloatArray, ground: FloatArray, is_down: NDArray[np.bool_]) -> float:
    """Return how far a foot gets at most, while it stands, from where it began to.

    The body is where it fits best over the feet that stand: they carry it.
    """
    strayed = np.full(ground.shape, np.nan)
    for index, down in enumerate(is_down):
        own, wanted = feet[index, down], ground[index, down]
        centre, middle = own.mean(axis=0), wanted.mean(axis=0)
        left, _, right = np.linalg.svd((own - centre).T @ (wanted - middle))
        mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
        strayed[index, down] = (own - centre) @ left @ mirror @ right + middle - wanted
    slips = [
        np.linalg.norm((strayed[span, leg] - strayed[span.start, leg])[:, :2], axis=1).max()
        for leg, span in _spans(is_down)
    ]
    return float(max(slips))


def _seam_deg_s(run: Walked) -> float:
    """Return by how much a joint's velocity jumps at most where one cycle follows another."""
    cycle_s = run.gait.cycle_s * run.part.pace_ratio
    seams_s = cycle_s * np.arange(1, int(run.trajectory.duration_s / cycle_s))
    after = run.trajectory.sample(seams_s + SEAM_S, 1)
    before = run.trajectory.sample(seams_s - SEAM_S, 1)
    return float(np.abs(after - before).max())
