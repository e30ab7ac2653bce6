"""Plays a show on simulated robots that are worse than assumed: `lss-motion check FILE --robust`.

    assumed, *worse = trials(show)

Each trial is a run of `perform` in virtual time with feedback, judged at the horns. The faults that
it meets take the real steps of `on_fault`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from msgspec import Struct, to_builtins
from msgspec.structs import replace

from lss_motion.files.texts import counted
from lss_motion.planning.trajectory.servo_motion import joint_angles
from lss_motion.playing.connection import SIMULATED, with_port
from lss_motion.playing.report import planned_horn_deg
from lss_motion.playing.run import Observer, perform
from lss_motion.playing.truth import TRUTH_STEP_S
from lss_motion.sim.deviation import Deviation, deviation_from_text
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from lss_motion.planning.shows import Show
    from lss_motion.playing.player.events import Faulted
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.report import Report
    from lss_motion.playing.run import Result

    FloatArray = NDArray[np.float64]
    BoolArray = NDArray[np.bool_]

ASSUMED: Final = ""
"""The robot that is as assumed."""
WORSE: Final = (
    "lag=-10ms", "lag=+30ms", "lag=+60ms",
    "dead=30ms", "dead=60ms",
    "ramp=0.1", "ramp=0.5", "ramp=1.5",
    "t_law=exact", "retarget=from_rest",
    "t_ignored=50ms", "t_ignored=100ms", "t_least=100ms", "t_step=10ms",
    "motor=25%", "motor=50%",
    "backlash=1.5deg", "droop=3deg", "droop=6deg", "backlash=1.5deg,droop=3deg",
    "noise=0.5deg", "usb=16ms", "lost=1%", "corrupt=1%",
    "push=6deg",
    "lag=+30ms,dead=10ms,droop=3deg,backlash=1deg,noise=0.2deg,usb=16ms,lost=1%,corrupt=1%",
)  # fmt: skip
"""What a robot file may have wrong, each as bad as seen or feared; the last is all at once."""

PLAYED_S: Final = 60.0
"""No more of a show is played, so that all robots take minutes at the most."""
RUN_RATIO_MAX: Final = 4.0
RUN_MORE_S: Final = 30.0
"""A run that takes longer than `RUN_RATIO_MAX` times the show and this is stopped: it waits for a
sensor that is not simulated, or is slowed for good."""

HOLD_LEAST_S: Final = 2.0
"""A rest of the plan as long as this is a hold. It is judged from `SETTLED_S` after its begin until
`LEAD_S` before its end."""
SETTLED_S: Final = 1.5
LEAD_S: Final = 0.1
"""A horn that lags begins its next move so long before its plan does, at the most."""
STILL_DEG: Final = 1e-6
"""The plan rests where it changes by less in `TRUTH_STEP_S`."""
PUSH_S: Final = 2.0
"""A push comes so long after the begin of the longest hold."""
AFTER_PUSH_S: Final = 1.0
"""After a push a hold is judged again from then on."""
WATCH_NS: Final = 20 * NS_PER_MS


class RobustnessTrial(Struct, frozen=True, kw_only=True):
    """One run. Angles are None if no show was played, the standing error also without a hold."""

    sim: str
    """The words of `--sim` with which `lss-play --virtual` repeats the run; empty: as assumed."""
    outcome: str
    """`finished` (also at `PLAYED_S`), `fault`, `lost`, or `unfinished` after `RUN_RATIO_MAX`."""
    played_s: float
    """Show time that was reached."""
    rms_deg: float | None = None
    """Of all horns, from the plan."""
    max_deg: float | None = None
    max_joint: str = ""
    max_at_s: float | None = None
    standing_deg: float | None = None
    """The largest in a hold of the joint, once it had time to settle."""
    late_s: float
    """How far the show, or a command in it, fell behind the plan at the most; waits count."""
    faults: tuple[Faulted, ...]
    error: str = ""
    """Why the show could not begin or go on, where no joint is the cause."""

    @property
    def is_stopped(self) -> bool:
        """Return whether this robot did not play the show."""
        return self.outcome != "finished"

    @property
    def why(self) -> str:
        """Return what stopped the show."""
        if self.outcome == "unfinished":
            return (
                f"after {RUN_RATIO_MAX:g} times its duration and {RUN_MORE_S:g} s it still waits "
                "for a sensor, which is not simulated, or a fault slows it for good"
            )
        if self.error or not self.faults:
            return self.error or self.outcome
        return f"{self.faults[-1]} ({self.faults[-1].step})"


def trials(
    show: Show, texts: Sequence[str] = WORSE, *, played_s: float = PLAYED_S
) -> Iterator[RobustnessTrial]:
    """Yield the trial of the robot as assumed, then those of `texts`, as `--sim` has them.

    A push is moved into the longest hold. Of a longer show only the first `played_s` are played.
    """
    until_s = min(show.program.duration_s, played_s)
    show = replace(show, robot=with_port(show.robot, SIMULATED))
    run = _Run(show, ASSUMED, until_s)
    push_at_s = run.push_at_s()
    yield run.trial()
    for text in texts:
        is_pushed = "push=" in text and "push_at=" not in text
        words = f"{text},push_at={push_at_s:.2f}s" if is_pushed else text
        yield _Run(show, words, until_s).trial()


class _ShowTimeWatch:
    """Notes the show time over the run, and stops the run where it is over: a `Controls`."""

    def __init__(self, until_s: float, *, is_cut: bool) -> None:
        self.instants_ns: list[int] = []
        self.shown_s: list[float] = []
        self.has_given_up = False
        self._until_s = until_s
        self._most_ns = int(NS_PER_S * (RUN_RATIO_MAX * until_s + RUN_MORE_S))
        self._is_cut = is_cut
        self._is_over = False

    def filenos(self) -> Sequence[int]:
        """Return none: nothing comes from outside."""
        return ()

    def act(self, player: Player, now_ns: int) -> None:
        """Note the show time; stop at the end of what is played, or if it never comes."""
        if self._is_over or player.show is None or player.show_ended_ns is not None:
            return
        if self.instants_ns and now_ns < self.instants_ns[-1] + WATCH_NS:
            return
        show_s = player.show.show_s(now_ns)
        self.instants_ns.append(now_ns)
        self.shown_s.append(show_s)
        self._is_over = show_s >= self._until_s
        self.has_given_up = not self._is_over and now_ns > self.instants_ns[0] + self._most_ns
        if self.has_given_up or (self._is_over and self._is_cut):
            self._is_over = True
            player.stop(now_ns)

    def behind_s(self) -> float:
        """Return how far the show fell behind the run at the most."""
        if not self.instants_ns:
            return 0.0
        run_s = (np.array(self.instants_ns) - self.instants_ns[0]) / NS_PER_S
        return max(0.0, float(np.max(run_s - (np.array(self.shown_s) - self.shown_s[0]))))

    def run_s(self, show_s: FloatArray) -> FloatArray:
        """Return when these show times were first reached, from power-up."""
        reached_s = np.maximum.accumulate(np.array(self.shown_s))
        return np.interp(show_s, reached_s, np.array(self.instants_ns) / NS_PER_S)


class _Run:
    """One run of the show on the robot of a deviation."""

    def __init__(self, show: Show, text: str, until_s: float) -> None:
        self._show, self._text, self._until_s = show, text, until_s
        self._deviation: Deviation = deviation_from_text(text)
        self._watch = _ShowTimeWatch(until_s, is_cut=until_s < show.program.duration_s)
        self._result: Result[Report] = perform(
            show.program,
            self._show.robot,
            is_virtual=True,
            trajectory=show.trajectory,
            deviation=self._deviation,
            observer=Observer(controls=self._watch),
        )

    def push_at_s(self) -> float:
        """Return when a push would meet the longest hold, or else the middle; from power-up."""
        if not self._watch.instants_ns:
            return Deviation().push_at_s
        count = math.ceil(self._until_s / TRUTH_STEP_S)
        times_s = TRUTH_STEP_S * np.arange(count, dtype=np.float64)
        is_still: BoolArray = np.all(still(self._planned_deg(times_s)), axis=1)
        spans = list(rests(is_still))
        middle_s = 0.5 * self._until_s
        longest = max(spans, key=lambda span: span[1] - span[0], default=(middle_s, middle_s))
        return float(self._watch.run_s(np.array([longest[0] + PUSH_S]))[0])

    def trial(self) -> RobustnessTrial:
        """Return what the horns did, and what was done about it."""
        report, error = self._result.report, self._result.error
        outcome = report.outcome
        if outcome == "stopped":  # Only the watch stops it.
            outcome = "unfinished" if self._watch.has_given_up else "finished"
        late_s = max(self._watch.behind_s(), 1e-6 * report.timing.late_max_us)
        found = RobustnessTrial(
            sim=self._text,
            outcome=outcome,
            played_s=round(min(report.played_s, self._until_s), 3),
            late_s=round(late_s, 3),
            faults=report.faults,
            error="" if error is None else str(error),
        )
        truth = self._result.truth
        if truth is None or not np.any(truth.times_s <= self._until_s):
            return found
        is_played = truth.times_s <= self._until_s
        times_s = np.array(truth.times_s[is_played])
        planned_deg = self._planned_deg(times_s)
        horn_deg = truth.horn_deg[:, : planned_deg.shape[1]]  # Without the servos behind joints.
        error_deg = np.abs(np.array(horn_deg[is_played]) - planned_deg)
        row, column = np.unravel_index(int(error_deg.argmax()), error_deg.shape)
        standing_deg = error_deg[self._stands(times_s, planned_deg)]
        return replace(
            found,
            rms_deg=round(float(np.sqrt(np.mean(error_deg**2))), 3),
            max_deg=round(float(error_deg.max()), 3),
            max_joint=truth.joints[column],
            max_at_s=round(float(times_s[row]), 2),
            standing_deg=round(float(standing_deg.max()), 3) if standing_deg.size else None,
        )

    def _planned_deg(self, times_s: FloatArray) -> FloatArray:
        """Return the plan, (n, joints); that of a compiled program is what its servos should do."""
        player, trajectory = self._result.player, self._show.trajectory
        robot = self._show.robot
        assert player.show is not None
        names = list(player.program.start_deg)
        if trajectory is not None:
            planned_deg = trajectory.sample(times_s)
            if robot.servos:
                return planned_deg
            return planned_deg[:, [trajectory.joints.index(name) for name in names]]
        states = player.show.joint_states
        columns = [planned_horn_deg(states[name], player.program, times_s) for name in names]
        servo_deg = np.stack(columns, axis=1)
        return joint_angles(names, servo_deg, robot)[1] if robot.servos else servo_deg

    def _stands(self, times_s: FloatArray, planned_deg: FloatArray) -> BoolArray:
        """Return where each joint should stand, (n, joints), unless a hand pushes it."""
        stands: BoolArray = np.zeros(planned_deg.shape, dtype=np.bool_)
        is_still = still(planned_deg)
        for column in range(planned_deg.shape[1]):
            for from_s, until_s in rests(is_still[:, column]):
                first, last = from_s + SETTLED_S, until_s - LEAD_S
                chosen = slice(*np.round(np.array([first, last]) / TRUTH_STEP_S).astype(int))
                stands[chosen, column] = True
        if self._deviation.push_deg:
            at_s, pushed_s = self._watch.run_s(times_s), self._deviation.push_at_s
            until_s = pushed_s + self._deviation.push_for_s + AFTER_PUSH_S
            stands[(at_s > pushed_s - 0.05) & (at_s < until_s)] = False
        return stands


def still(planned_deg: FloatArray) -> BoolArray:
    """Return whether the plan rests from each sample to the next, (n - 1, joints)."""
    is_still: BoolArray = np.abs(np.diff(planned_deg, axis=0)) < STILL_DEG
    return is_still


def rests(is_still: BoolArray) -> Iterator[tuple[float, float]]:
    """Yield the holds: where steps of `TRUTH_STEP_S` are still for `HOLD_LEAST_S`; seconds."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_still, [False])).astype(int)))
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        if (last - first) * TRUTH_STEP_S >= HOLD_LEAST_S:
            yield first * TRUTH_STEP_S, last * TRUTH_STEP_S


# ---- what is printed


def robust_lines(found: Sequence[RobustnessTrial], duration_s: float) -> list[str]:
    """Return the table of the trials, the robot as assumed first, then the worst first."""
    assumed, worse = found[0], sorted(found[1:], key=_badness, reverse=True)
    until_s = min(duration_s, PLAYED_S)
    which = f"the first {until_s:g} s" if until_s < duration_s else f"all {until_s:.1f} s"
    lines = [
        f"Played on {counted(worse, 'simulated robot')} worse than assumed: {which}, with feedback "
        "and on_fault.",
        "horn rms    max  standing (deg)  late s  faults  outcome          robot (--sim)",
        *(_line(one) for one in (assumed, *worse)),
    ]
    stopped = [one for one in (assumed, *worse) if one.is_stopped]
    if not stopped:
        lines.append("None of them would stop the show.")
    else:
        lines.append(f"{len(stopped)} of {len(found)} would stop the show:")
        lines += [f"  {one.sim or 'as assumed'}: {one.why}" for one in stopped]
    lines.append("The servos are simulated: a real robot may be better or worse than any of these.")
    return lines


def _badness(one: RobustnessTrial) -> tuple[bool, float]:
    return one.is_stopped, math.inf if one.rms_deg is None else one.rms_deg


def _line(one: RobustnessTrial) -> str:
    angles = (one.rms_deg, one.max_deg, one.standing_deg)
    rms, largest, standing = ("-" if angle is None else f"{angle:.2f}" for angle in angles)
    outcome = f"{one.outcome} at {one.played_s:.1f} s" if one.is_stopped else one.outcome
    return (
        f"{rms:>8} {largest:>6} {standing:>15}  {one.late_s:6.2f}  {len(one.faults):6d}  "
        f"{outcome:15}  {one.sim or 'as assumed'}"
    )


def robust_as_json(found: Sequence[RobustnessTrial], duration_s: float) -> dict[str, Any]:
    """Return `robust` of `check --robust --json`: the robot as assumed first, then by `WORSE`."""
    return {
        "simulated": True,
        "judged_s": min(duration_s, PLAYED_S),
        "is_whole": duration_s <= PLAYED_S,
        "robots": [to_builtins(one) | {"stops_the_show": one.is_stopped} for one in found],
    }
