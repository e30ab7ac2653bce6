"""Runs whose shows meet the servos at the same phase of their control loops.

A servo takes a command up at its next control loop, up to 5 ms later, so that a horn at 350 deg/s
is 1.75 deg further or not. Where a show leaves no acceleration to spare, such distances add up. A
show with feedback begins at another instant than one without, and two runs that begin at other
phases differ by that more than by all corrections. So the second run is let go when its servos
are where those of the first one were.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.playing.player.events import Phase
from lss_motion.playing.run import Observer, perform
from lss_motion.sim.horns import FILTER_NS
from lss_motion.units import NS_PER_MS, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.run import Result
    from lss_motion.playing.runner import Tap
    from lss_motion.robot.model import Robot
    from lss_motion.sim.deviation import Deviation

LOOPS_NS: Final = FILTER_NS
"""After so long all loops of a servo are where they were: the filter of EM0 has the longest."""
ROUNDED_DEG: Final = 0.001
"""A report rounds angles to this."""
LEAST_NS: Final = 50 * NS_PER_MS
"""A show that was held begins no sooner."""


class Beginning:
    """Notes when a show begins, and lets it begin at the phase of another one: a `Controls`."""

    def __init__(self, other_ns: int | None = None, *, mark_s: float | None = None) -> None:
        """With `other_ns`, `origin_ns` of the run before, begin at its phase; else at once.

        At show time `mark_s` the instant is noted.
        """
        self.origin_ns: int | None = None
        """Instant of show time 0 on the clock of the run; None: the show has not begun."""
        self.mark_ns: int | None = None
        """Instant of show time `mark_s`, also of a show that was slowed before."""
        self._mark_s = mark_s
        self._other_ns = other_ns
        self._is_held = False

    def filenos(self) -> Sequence[int]:
        """Return none: nothing comes from outside."""
        return ()

    def act(self, player: Player, now_ns: int) -> None:
        """Hold the show before its start, and let it go, once; note the instant of the mark."""
        if self._mark_s is not None and self.mark_ns is None and player.show is not None:
            past_s = player.show.show_s(now_ns) - self._mark_s
            self.mark_ns = now_ns - ns_from_s(past_s) if past_s >= 0.0 else None
        if self._other_ns is not None and not self._is_held:
            self._is_held = True
            player.hold_before_start(now_ns)
        if self.origin_ns is not None or player.show is None or player.phase is not Phase.SHOW:
            return
        if self._other_ns is None:
            self.origin_ns = now_ns - ns_from_s(player.show.show_s(now_ns))
            return
        least_ns = now_ns + LEAST_NS - ns_from_s(player.show.begin_s)
        self.origin_ns = least_ns + (self._other_ns - least_ns) % LOOPS_NS
        player.run_from(s_from_ns(now_ns - self.origin_ns), now_ns)


def play_in_phase(
    program: Program,
    robot: Robot,
    trajectory: Trajectory,
    *,
    has_feedback: bool,
    seed: int = 0,
    deviation: Deviation | None = None,
    beginning: Beginning | None = None,
    make_tap: Callable[[int], Tap] | None = None,
) -> tuple[Result, int]:
    """Play a show in virtual time; return the result and the instant of show time 0.

    With a `Beginning` that knows that instant of another run, it begins at the phase of that one.
    """
    beginning = beginning or Beginning()
    result = perform(
        program,
        robot,
        is_virtual=True,
        seed=seed,
        has_feedback=has_feedback,
        trajectory=trajectory,
        deviation=deviation,
        observer=Observer(controls=beginning, make_tap=make_tap),
    )
    assert beginning.origin_ns is not None, "the show was not played"
    return result, beginning.origin_ns


def with_and_without_feedback(
    program: Program, robot: Robot, trajectory: Trajectory, *, seed: int = 0
) -> tuple[Result, Result]:
    """Play a show with feedback, then without from the same phase; both in virtual time."""
    show = program, robot, trajectory
    ours, begun_ns = play_in_phase(*show, has_feedback=True, seed=seed)
    other, _ = play_in_phase(*show, has_feedback=False, seed=seed, beginning=Beginning(begun_ns))
    return ours, other


def horn_rms_deg(result: Result, trajectory: Trajectory) -> float:
    """Return the RMS distance of all simulated horns from the plan."""
    truth = result.truth
    assert truth is not None, "the show was not played"
    columns = [trajectory.joints.index(name) for name in truth.joints]
    error_deg = truth.horn_deg - trajectory.sample(truth.times_s)[:, columns]
    return float(np.sqrt(np.mean(error_deg**2)))


def bound_ratios(program: Program, result: Result) -> dict[str, float]:
    """Return by joint the largest error of its simulated horn over the bound of the program."""
    joints = result.report.joints
    return {
        name: (joints[name].horn_error_max_deg or 0.0) / (bound_deg + ROUNDED_DEG)
        for name, bound_deg in program.bound_deg.items()
    }


def limit_ratios(
    robot: Robot, trajectory: Trajectory, result: Result, begin_ns: int
) -> tuple[float, float]:
    """Return the largest speed and acceleration of a horn, over its limits; by differences.

    `begin_ns` is the instant of show time 0; the robot has one bus.
    """
    bus = next(iter(result.simulated.values()))
    end_ns = begin_ns + ns_from_s(trajectory.duration_s)
    horn_deg = bus.horn_deg(range(begin_ns, end_ns, 5_000_000))
    smooth = (horn_deg[8:] - horn_deg[:-8]) / 0.04
    accel = (smooth[8:] - smooth[:-8]) / 0.04
    joints = list(robot.joints.values())
    speeds = np.abs(smooth).max(axis=0) / [joint.speed_max_deg_s for joint in joints]
    accels = np.abs(accel).max(axis=0) / [joint.accel_max_deg_s2 for joint in joints]
    return float(speeds.max()), float(accels.max())


def named_joints(robot: Robot, result: Result) -> frozenset[str]:
    """Return the joints whose response model a warning names as wrong."""
    return frozenset(
        name
        for name in robot.joints
        for text in result.report.warnings
        if f"lss-motion identify {name} " in text
    )
