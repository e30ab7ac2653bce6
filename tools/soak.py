"""Plays for long in virtual time, and says whether the player grows or drifts.

tools/run tools/soak.py                an hour
tools/run tools/soak.py --minutes 5    five minutes of it

Three joints swing without end on a simulated bus. Every minute of the show the memory that the
player and its program hold is counted (what the simulator keeps for its judges grows, and is not),
and the show clock is held against the run clock; at the end, so are the horns against the plan.
"""

from __future__ import annotations

import argparse
import math
import sys
import tracemalloc
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

from benches.shows import robot_of
from lss_motion.playing import api
from lss_motion.playing.run import Observer, perform
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from lss_motion.playing.player.player import Player

JOINTS: Final = 3
BAUD_BPS: Final = 19_200
"""What a run costs is its questions, and they fill the line."""
MINUTE_S: Final = 60.0
GROWTH_MAX_RATIO: Final = 1.1
"""Of the memory after two minutes: by then every buffer that is bounded is full."""
DRIFT_MAX_S: Final = 1e-6
HORN_RMS_MAX_DEG: Final = 0.3
HELD: Final = (
    tracemalloc.Filter(inclusive=True, filename_pattern="*/lss_motion/player/*"),
    tracemalloc.Filter(inclusive=True, filename_pattern="*/lss_motion/program/*"),
)


class Minutes:
    """Controls that take a measurement every minute of the show, and stop it after the last."""

    def __init__(self, minutes: int) -> None:
        self.bytes_held: list[int] = []
        self.drift_s = 0.0
        self._minutes = minutes
        self._began: tuple[int, float] | None = None

    def filenos(self) -> list[int]:
        return []

    def act(self, player: Player, now_ns: int) -> None:
        show = player.show
        if show is None or len(self.bytes_held) >= self._minutes:
            return
        show_s = show.show_s(now_ns)
        if self._began is None:
            self._began = (now_ns, show_s)
        if show_s < MINUTE_S * (len(self.bytes_held) + 1):
            return
        began_ns, began_s = self._began
        drift_s = abs(show_s - began_s - s_from_ns(now_ns - began_ns))
        self.drift_s = max(self.drift_s, drift_s)
        held = tracemalloc.take_snapshot().filter_traces(HELD).statistics("filename")
        self.bytes_held.append(sum(one.size for one in held))
        held_kb = self.bytes_held[-1] / 1024
        print(f"{len(self.bytes_held)} min: {held_kb:.0f} kB held", flush=True)
        if len(self.bytes_held) >= self._minutes:
            player.stop(now_ns)


def main() -> int:
    """Play; return 1 if the player grew, drifted, or led the horns astray."""
    parser = argparse.ArgumentParser(
        prog="tools/soak.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--minutes", type=int, default=60, metavar="N")
    arguments = parser.parse_args()
    robot = robot_of(JOINTS, baud_bps=BAUD_BPS)
    trajectory = api.plan(_swing(list(robot.joints)), robot)
    program = api.compile(trajectory, robot)
    minutes = Minutes(arguments.minutes)
    tracemalloc.start()
    result = perform(
        program,
        robot,
        is_virtual=True,
        trajectory=trajectory,
        observer=Observer(controls=minutes),
    )
    joints = result.report.joints.values()
    rms_deg = float(np.sqrt(np.mean([joint.horn_error_rms_deg**2 for joint in joints])))
    first = minutes.bytes_held[min(1, len(minutes.bytes_held) - 1)]
    growth = minutes.bytes_held[-1] / first
    timing = result.report.timing
    print(
        f"{arguments.minutes} min, {timing.commands} commands, {timing.missed} missed: "
        f"memory {growth:.3f} times that of the second minute, {1e6 * minutes.drift_s:.3f} us of "
        f"drift, horns {rms_deg:.3f} deg RMS"
    )
    is_well = growth <= GROWTH_MAX_RATIO and minutes.drift_s <= DRIFT_MAX_S
    return 0 if is_well and rms_deg <= HORN_RMS_MAX_DEG else 1


def _swing(names: list[str]) -> Sequence:
    """Return a loop without end in which all joints swing, each in its own time."""
    frames = []
    for index in range(13):
        deg = {
            n: 30.0 * math.sin(2.0 * math.pi * (k + 1) * index / 12) for k, n in enumerate(names)
        }
        frames.append(Keyframe(at_s=float(index), deg=deg))
    return Sequence(name="swing", keyframes=tuple(frames), loop=None)


if __name__ == "__main__":
    sys.exit(main())
