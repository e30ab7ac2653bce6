"""Gaits played on a simulated bus, closed loop on: what the feet did, from the horns' truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lss_motion.planning import shows
from lss_motion.playing.run import Observer, perform
from lss_motion.show.gait.kinematics import forward
from lss_motion.show.gait.load import load_gait
from lss_motion.show.gait.model import PATTERNS
from lss_motion.show.gait.pacing import joints_of, paced
from tests.tables import first_quick

EXAMPLES = Path(__file__).resolve().parents[2] / "sequences"
SLIP_MAX_MM = 0.6
"""Over the seeds 0 to 4 the worst foot of the dance slips by 0.31 to 0.55 mm: the noise decides."""
LIFT_ERROR_MAX_MM = 2.0
LEGS = {6: ("hexapod", "hexapod_walk"), 4: ("quadruped", "quadruped_trot")}
PATTERN_NAMES = [(legs, name) for legs, known in PATTERNS.items() for name in known]


class Walked:
    """A gait file that was played, its plan, and where its feet really were."""

    def __init__(self, path, controls=None):
        show = shows.prepare(path, None, loop=None if controls else 1)
        result = perform(
            show.program,
            show.robot,
            is_virtual=True,
            trajectory=show.trajectory,
            observer=Observer(controls=controls),
        )
        self.show, self.report = show, result.report
        self.gait = load_gait(path)
        truth = result.truth
        columns = [truth.joints.index(name) for name in joints_of(self.gait)]
        self.times_s = np.array([show.program.within(at_s) for at_s in truth.times_s.tolist()])
        self._angles_deg = truth.horn_deg[:, columns]

    def passages(self):
        """Yield the planned stances of each passage and the feet in the body, as they were."""
        start_s = 0.0
        for part in paced(self.gait, self.show.robot):
            end_s = start_s + part.duration_s
            chosen = (self.times_s >= start_s) & (self.times_s <= end_s)
            stance = part.passage.at((self.times_s[chosen] - start_s) / part.pace_ratio)
            angles = np.split(self._angles_deg[chosen], len(self.gait.legs), axis=1)
            feet = [forward(leg, own) for leg, own in zip(self.gait.legs, angles, strict=True)]
            yield stance, np.stack(feet, axis=1)
            start_s = end_s + part.hold_s

    def slip_max_mm(self):
        """Return how far a foot gets at most, while it stands, from where it began to."""
        worst_mm, stances = 0.0, 0
        for stance, feet in self.passages():
            strayed = np.full(stance.feet_mm.shape, np.nan)
            for index, down in enumerate(stance.is_down):
                ground = stance.feet_mm[index, down]
                strayed[index, down] = carried(feet[index, down], ground) - ground
            for leg in range(feet.shape[1]):
                down = stance.is_down[:, leg]
                edges = np.flatnonzero(np.diff(np.concatenate([[0], down, [0]])))
                for first, end in zip(edges[0::2], edges[1::2], strict=True):
                    moved = strayed[first:end, leg] - strayed[first, leg]
                    worst_mm = max(worst_mm, np.linalg.norm(moved[:, :2], axis=1).max())
                    stances += end - first > 1
        assert stances >= len(self.gait.legs), "nothing was judged"
        return worst_mm

    def lifts_mm(self):
        """Return how high each step of each foot went over the ground, with the body as planned."""
        lifts = []
        for stance, feet in self.passages():
            height = stance.feet_mm[..., 2] + (feet - stance.feet_in_body())[..., 2]
            for leg in range(feet.shape[1]):
                up = ~stance.is_down[:, leg]
                edges = np.flatnonzero(np.diff(np.concatenate([[0], up, [0]])))
                lifts += [
                    height[first:end, leg].max()
                    for first, end in zip(edges[0::2], edges[1::2], strict=True)
                ]
        return np.array(lifts)


def carried(feet, ground):
    """Return the feet where a rigid body puts them that fits `ground` best: feet carry it."""
    centre, middle = feet.mean(axis=0), ground.mean(axis=0)
    left, _, right = np.linalg.svd((feet - centre).T @ (ground - middle))
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return (feet - centre) @ left @ mirror @ right + middle


def assert_walked_well(walked):
    assert walked.report.outcome == "finished"
    assert walked.report.timing.missed == 0
    assert walked.report.buses["main"].replies > 500, "closed loop"
    assert walked.report.stretched == ()
    assert walked.slip_max_mm() < SLIP_MAX_MM


@pytest.mark.parametrize(("legs", "pattern"), first_quick(PATTERN_NAMES, 2))
def test_every_pattern_walks_without_slipping_and_lifts_its_feet(legs, pattern, tmp_path):
    robot, example = LEGS[legs]
    height_mm, step_mm = (80, 20) if legs == 6 else (140, 15)
    path = tmp_path / "gait.yaml"
    path.write_text(
        f"gait: {pattern}\nrobot: {EXAMPLES}/robots/{robot}.yaml\npattern: {pattern}\n"
        f"legs_from: {EXAMPLES}/{example}.yaml\nheight_mm: {height_mm}\n"
        f"step_height_mm: {step_mm}\ncycle_s: 0.5\n"
        "do:\n  - walk: {stride_mm: 40, turn_deg_s: 4, cycles: 1}\n"
    )
    walked = Walked(path)
    assert_walked_well(walked)
    lifts_mm = walked.lifts_mm()
    assert len(lifts_mm) >= 2 * legs
    assert np.abs(lifts_mm - step_mm).max() < LIFT_ERROR_MAX_MM


@pytest.mark.slow
@pytest.mark.parametrize("name", ["hexapod_walk", "hexapod_dance", "quadruped_trot"])
def test_every_example_is_performed_without_slipping(name):
    walked = Walked(EXAMPLES / f"{name}.yaml")
    assert_walked_well(walked)
    use = walked.show.program.line_use["main"]
    assert use.overlaps == 0
    assert use.utilisation_ratio < 0.35


class StopAtShowTime:
    """Controls that stop the show once it has come to `show_s`."""

    def __init__(self, show_s):
        self.show_s = show_s
        self.is_done = False

    def filenos(self):
        return []

    def act(self, player, now_ns):
        show = player.show
        if not self.is_done and show is not None and show.show_s(now_ns) >= self.show_s:
            self.is_done = True
            player.stop(now_ns)


def test_a_walk_without_end_goes_on_without_slipping_until_it_is_stopped(tmp_path):
    path = tmp_path / "gait.yaml"
    path.write_text(
        f"gait: ever\nrobot: {EXAMPLES}/robots/hexapod.yaml\nheight_mm: 80\ncycle_s: 1.0\n"
        f"legs_from: {EXAMPLES}/hexapod_walk.yaml\nstep_height_mm: 20\n"
        "do:\n  - walk: {forward_mm_s: 35, cycles: forever}\n"
    )
    stop = StopAtShowTime(9.0)
    walked = Walked(path, stop)
    assert stop.is_done
    repeat = walked.show.program.repeat
    assert repeat.to_us < 7_000_000, "it has gone on for more than a pass"
    assert walked.report.outcome == "stopped"
    assert walked.report.timing.missed == 0
    assert walked.slip_max_mm() < SLIP_MAX_MM
    # It stands where it was stopped, in the middle of a step, and does not fall.
    (part,) = paced(walked.gait, walked.show.robot)
    margin_mm = part.passage.at(walked.times_s[-1:] / part.pace_ratio).margin_mm()
    assert margin_mm[0] > 50.0
