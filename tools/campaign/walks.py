"""Walking robots that are steered at random.

Commands come at random instants, also while the last is still blended; some plans come too late.
The independent judge (`tools/judge`) looks at bytes and horns; besides, each run must end in its
stand, and no foot that stands may slip.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from local_planner import LocalPlanner
from msgspec.structs import replace

from campaign import Told
from campaign.outside import objections_to
from campaign.witness import Witness
from lss_motion.planning import shows
from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform
from lss_motion.playing.walking.pilot import Pilot
from lss_motion.playing.walking.planner import WalkPlanner
from lss_motion.show.gait.kinematics import forward
from lss_motion.show.gait.model import PATTERNS, BodyPose
from lss_motion.show.gait.steering import slowed_to_limits
from lss_motion.show.gait.stepping import STILL, Twist

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from lss_motion.playing.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait

SEEDS: Final = 4
"""Each robot and pattern once."""
EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
ROBOTS = (("hexapod_walk.yaml", "tripod"), ("quadruped_trot.yaml", "trot"),
          ("hexapod_walk.yaml", "ripple"), ("quadruped_trot.yaml", "crawl"))  # fmt: skip
TOP = {
    6: Twist(forward_mm_s=45.0, left_mm_s=35.0, turn_deg_s=12.0),
    4: Twist(forward_mm_s=25.0, left_mm_s=12.0, turn_deg_s=8.0),
}
LATE_RATIO = 0.03
STOP_RATIO = 0.1
TAKES_S = 0.25
"""A plan takes this long, or, if it is late, 30 times as long."""
STAND_DEG = 0.5
SLIP_MAX_MM = 1.0
"""Between two feet that stand: twice what one may."""


@dataclass
class Run:
    """One robot, steered `commands` times at random."""

    gait: Gait
    robot: Robot
    seed: int
    commands: int
    tolerance_deg: float = shows.GAIT_TOLERANCE_DEG
    witness: Witness = field(default_factory=Witness)

    def __post_init__(self) -> None:
        self.random = np.random.default_rng(self.seed)
        self.gait, self.top = slowed_to_limits(self.gait, self.robot, TOP[len(self.gait.legs)])
        self.planner = WalkPlanner(self.gait, self.robot, self.tolerance_deg)
        self.pilot = Pilot(
            LocalPlanner(self.planner, self._takes_s),
            phase_s=self.planner.phase_s,
            splice_s=self.planner.splice_s,
        )
        self.given, self._next_s = 0, 1.0

    def _takes_s(self) -> float:
        return TAKES_S * (30.0 if self.random.random() < LATE_RATIO else 1.0)

    # ---- controls

    def filenos(self) -> list[int]:
        return []

    def act(self, player: Player, now_ns: int) -> None:
        if player.phase is Phase.SHOW and player.show is not None:
            show_s = player.show.show_s(now_ns)
            if self.given >= self.commands:
                self.pilot.commanded = STILL
                if self.pilot.is_standing(show_s - 1.0):
                    player.close()
            elif show_s >= self._next_s:
                self._wish(show_s)
        self.pilot.act(player, now_ns)
        self.witness.act(player, now_ns)

    def _wish(self, show_s: float) -> None:
        self.given += 1
        self._next_s = show_s + self.random.uniform(0.2, 1.5)
        ahead, left, turn = self.random.uniform(-1.0, 1.0, 3).tolist()
        self.pilot.commanded = Twist(
            forward_mm_s=ahead * self.top.forward_mm_s,
            left_mm_s=left * self.top.left_mm_s,
            turn_deg_s=turn * self.top.turn_deg_s,
        )
        if self.random.random() < STOP_RATIO:
            self.pilot.commanded = STILL

    # ---- judging

    def faults(self) -> list[str]:
        """Play it; return what went wrong."""
        result = perform(
            self.planner.program,
            self.robot,
            is_virtual=True,
            seed=self.seed,
            observer=Observer(controls=self, make_tap=lambda _: self.witness),
            is_open=True,
        )
        assert result.truth is not None
        self.report = result.report
        horn_deg, names = result.truth.horn_deg, result.truth.joints
        found = []
        if result.report.outcome != "finished" or result.report.timing.missed:
            found.append(f"outcome {result.report.outcome}: {result.report.faults}")
        found += objections_to(self.robot, (), self.witness, result)
        stand = np.array([self.planner.program.start_deg[name] for name in names])
        off_deg = float(np.abs(horn_deg[-1] - stand).max())
        if off_deg > STAND_DEG:
            found.append(f"ends {off_deg:.2f} deg off its stand")
        self.slip_mm = self._slip_mm(horn_deg, names)
        if self.slip_mm > SLIP_MAX_MM and self.tolerance_deg <= shows.GAIT_TOLERANCE_DEG:
            found.append(f"feet that stand move {self.slip_mm:.2f} mm apart")
        if self.pilot.reason:
            found.append(self.pilot.reason)
        if self.pilot.taken < self.commands // 6:
            found.append(f"only {self.pilot.taken} stretches were walked")
        return found

    def _slip_mm(self, horn_deg: np.ndarray, names: Sequence[str]) -> float:
        """Return how much the distance of two feet changes at most while both stand.

        A foot stands while it is on the plane of the lowest three or two; heights in the body.
        """
        feet = np.stack(
            [
                forward(leg, horn_deg[:, [names.index(name) for name in leg.joints]])
                for leg in self.gait.legs
            ],
            axis=1,
        )
        down = feet[:, :, 2] < -self.gait.height_mm + 0.5
        worst = 0.0
        for first in range(feet.shape[1]):
            for second in range(first):
                both = down[:, first] & down[:, second]
                apart = np.linalg.norm(feet[:, first] - feet[:, second], axis=1)
                edges = np.flatnonzero(np.diff(np.concatenate([[0], both, [0]])))
                for begin, end in zip(edges[0::2], edges[1::2], strict=True):
                    # Lifting and landing feet are near the ground a little before and after.
                    kept = apart[begin + 8 : end - 8]
                    if len(kept) > 10:
                        worst = max(worst, float(np.ptp(kept)))
        return worst


def run_of(seed: int, commands: int, tolerance_deg: float) -> Run:
    """Return the run of one robot and pattern, in turn."""
    file, name = ROBOTS[seed % len(ROBOTS)]
    gait, robot = shows.load_gait(EXAMPLES / file, None)
    pattern = PATTERNS[len(gait.legs)][name]
    sway_mm = 22.0 if pattern.sway_ratio else 0.0
    gait = replace(
        gait, pattern=pattern, duty=pattern.duty_ratio, sway_mm=sway_mm, start=BodyPose()
    )
    return Run(gait, robot, seed, commands, tolerance_deg)


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind."""
    parser.add_argument("--commands", type=int, default=50, metavar="N", help="of each walk")
    parser.add_argument(
        "--tolerance-deg",
        type=float,
        default=shows.GAIT_TOLERANCE_DEG,
        metavar="DEG",
        help="of the compiler; above that of gaits, slip is not judged",
    )


def play(seed: int, options: argparse.Namespace) -> Told:
    """Steer one walk."""
    run = run_of(seed, options.commands, options.tolerance_deg)
    broken = tuple(run.faults())
    line = (
        f"{run.gait.pattern.name}, {run.given} commands in {run.report.played_s:.0f} s, "
        f"{run.pilot.taken} stretches, {run.pilot.late} late, slip {run.slip_mm:.2f} mm"
    )
    return Told(run.report.outcome, broken, line=line)
