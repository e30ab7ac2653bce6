"""Draws one joint under four ways of driving it, from simulated runs, into sequences/pictures.

    tools/run tools/draw_drives.py

Ours, one `D…T…` a keyframe, `D…T…` to each sample at 30 Hz, and bare `D` at 50 Hz in EM0 with FPC
3: the same show on the same simulated robot as `tools/bench.py horn`, one joint, a few seconds.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benches.horn import driven_horns, keyframe_writes, sample_writes
from benches.shows import lively_show, robot_of
from lss_motion.playing import api
from lss_motion.playing.run import perform

if TYPE_CHECKING:
    from numpy.typing import NDArray

    FloatArray = NDArray[np.float64]

PICTURE = Path(__file__).resolve().parent.parent / "sequences" / "pictures" / "drives.png"
JOINTS, SHOW_S, SEED = 18, 12.0, 1
SHOWN_S = (3.0, 8.0)
STEP_S = 0.01


def runs() -> tuple[FloatArray, FloatArray, dict[str, FloatArray]]:
    """Return times, the plan of one joint at them, and its horn under every way of driving."""
    robot = robot_of(JOINTS)
    sequence = lively_show(robot, SHOW_S, seed=SEED)
    trajectory = api.plan(sequence, robot)
    result = perform(api.compile(trajectory, robot), robot, is_virtual=True, trajectory=trajectory)
    assert result.truth is not None
    times_s = np.arange(*SHOWN_S, STEP_S)
    at = np.searchsorted(result.truth.times_s, times_s - STEP_S / 2)
    filtered = b"#254EM0\r#254FPC3\r"
    naive = {
        "one D…T… a keyframe": (b"", keyframe_writes(sequence, robot)),
        "D…T… to samples at 30 Hz": (b"", sample_writes(trajectory, robot, 30.0, is_timed=True)),
        "bare D at 50 Hz, EM0, FPC 3": (
            filtered,
            sample_writes(trajectory, robot, 50.0, is_timed=False),
        ),
    }
    horns = {"lss_motion": result.truth.horn_deg[at, 0]}
    for name, (settings, writes) in naive.items():
        horns[name] = driven_horns(robot, trajectory, settings, writes, times_s)[:, 0]
    return times_s, trajectory.sample(times_s)[:, 0], horns


def draw(path: Path) -> None:
    """Draw horn and plan, and below them what lies between."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    times_s, plan_deg, horns = runs()
    figure, (above, below) = plt.subplots(
        2, 1, figsize=(9.0, 6.0), sharex=True, layout="constrained", height_ratios=[3, 2]
    )
    above.plot(times_s, plan_deg, color="black", linewidth=3.5, alpha=0.25, label="plan")
    for index, (name, horn_deg) in enumerate(horns.items()):
        rms_deg = float(np.sqrt(np.mean((horn_deg - plan_deg) ** 2)))
        style = {"color": f"C{index}", "linewidth": 1.6 if index == 0 else 1.0}
        above.plot(times_s, horn_deg, label=f"{name}: RMS {rms_deg:.2f} deg", **style)
        below.plot(times_s, horn_deg - plan_deg, **style)
    above.set_ylabel("horn (deg)")
    above.legend(loc="upper left", fontsize="small", ncols=2)
    above.margins(y=0.25)
    below.set_ylabel("horn minus plan (deg)")
    below.set_xlabel("show time (s)")
    below.axhline(0.0, color="black", linewidth=0.5)
    above.set_title("One joint of 18 on one 115200 bps line, four ways of driving it (simulated)")
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURE)
