"""Draws how well horns follow at how many readings a second, into sequences/pictures.

    tools/run tools/draw_readings.py

A lively show of 18 simulated joints, disturbed in several ways: without feedback, at fixed rates,
by need (what a show does), and as often as the line allows. About three minutes of one core.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Final

import numpy as np

from benches.shows import lively_show, robot_of
from lss_motion.playing import api
from lss_motion.playing.player.query_choice import BY_NEED, Pace
from lss_motion.playing.run import perform
from lss_motion.sim.deviation import Deviation

PICTURE: Final = Path(__file__).resolve().parent.parent / "sequences" / "pictures" / "readings.png"
JOINTS, SHOW_S = 18, 10.0
SEEDS: Final = (4,)
RATES_HZ: Final = (1.0, 2.0, 5.0, 10.0, 20.0)
CASES: Final = {
    "as assumed": Deviation(),
    "lag +30 ms": Deviation(lag_s=0.03),
    "1 % of commands lost": Deviation(lost_ratio=0.01),
    "droop 3°": Deviation(droop_deg=3.0),
    "all of them": Deviation(lag_s=0.03, droop_deg=3.0, backlash_deg=1.0, lost_ratio=0.01),
}

Point = tuple[float, float]
"""Readings a second and joint; RMS of all horns in degrees."""


def measured(pace: Pace | None, deviation: Deviation, *, has_feedback: bool = True) -> Point:
    """Play the shows and return what was read, and how far the horns were off."""
    rates_hz, errors_deg = [], []
    for seed in SEEDS:
        robot = robot_of(JOINTS)
        trajectory = api.plan(lively_show(robot, SHOW_S, seed=seed), robot)
        result = perform(
            api.compile(trajectory, robot), robot, is_virtual=True, seed=seed, pace=pace,
            trajectory=trajectory, deviation=deviation, has_feedback=has_feedback,
        )  # fmt: skip
        joints = result.report.joints.values()
        rates_hz += [joint.readings / result.report.played_s for joint in joints]
        errors_deg += [joint.horn_error_rms_deg or 0.0 for joint in joints]
    return float(np.mean(rates_hz)), float(np.sqrt(np.mean(np.square(errors_deg))))


def draw(path: Path) -> None:
    """Draw one curve for each disturbance, and print its points."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    figure, axes = plt.subplots(figsize=(9.0, 4.8), layout="constrained")
    for index, (name, deviation) in enumerate(CASES.items()):
        fixed = [measured(Pace(hz, hz), deviation) for hz in RATES_HZ]
        full = measured(None, deviation)
        need = measured(BY_NEED, deviation)
        _, open_deg = measured(BY_NEED, deviation, has_feedback=False)
        print(f"{name}: without {open_deg:.2f}; {fixed}; full {full}; by need {need}", flush=True)
        colour = f"C{index}"
        axes.plot(*zip(*fixed, full, strict=True), "o-", ms=3, color=colour, label=name)
        axes.plot(*need, "*", ms=13, color=colour)
        axes.plot(0.5, open_deg, "x", ms=7, color=colour)
    axes.plot([], [], "k*", ms=10, label="by need: what a show does")
    axes.plot([], [], "kx", label="without feedback")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("readings of a joint a second (the last point: as many as the line carries)")
    axes.set_ylabel("horn from plan, RMS (deg)")
    for axis, ticks in (
        (axes.xaxis, (1, 2, 5, 10, 20, 50)),
        (axes.yaxis, (0.1, 0.2, 0.5, 1, 2, 4)),
    ):
        axis.set_ticks(ticks)
        axis.set_major_formatter(ScalarFormatter())
        axis.set_minor_formatter(NullFormatter())
    axes.legend(fontsize="small", ncols=2)
    axes.grid(visible=True, which="both", alpha=0.25)
    axes.set_title(f"{JOINTS} joints on one 115200 bps line, lively show (simulated)")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
