"""The trials of one joint on its bus: moves on time, queries in between; holds however it ends.

`Experiment` is a `JointRun`. Phases: prepare (settings of the session), hold, the trials, and
however they end, restore the settings and hold.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

from lss_motion.errors import LssMotionError
from lss_motion.maintenance.identify.joint_run import JointRun, State, not_arrived
from lss_motion.maintenance.identify.trials import (
    Kind,
    PlannedMove,
    Recording,
    TrialPlan,
    make_trials,
)
from lss_motion.playing.player import handshake
from lss_motion.robot.profile import ramp_setting_deg_s2
from lss_motion.units import ns_from_s, s_from_ms

if TYPE_CHECKING:
    from lss_motion.maintenance.identify.joint_run import PolledReading
    from lss_motion.maintenance.identify.trials import Window
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.model import Joint, Robot


HOLD_MS: Final = 300
"""T of the first command, whose target is the present angle."""
DITHER_S: Final = 0.02
"""Trials begin at instants spread evenly over this time, so that they meet the control loops of the
servo, whose period is some milliseconds, at every phase."""
GOLDEN_RATIO: Final = 0.6180339887498949


class Experiment(JointRun):
    """Measures one joint. `error` is set if that failed, `is_stopped` if a person ended it."""

    def __init__(
        self, joint: Joint, robot: Robot, answers: Answers, window: Window, *, standing_deg: float
    ) -> None:
        """`answers` are for `handshake.questions`; the joint stands at `standing_deg` (servo)."""
        super().__init__(joint, robot, answers, window, standing_deg=standing_deg)
        self.recording = Recording(window, float(ramp_setting_deg_s2(joint)), joint.speed_max_deg_s)
        orders = handshake.session_orders([joint], answers)
        orders += handshake.unconfirmed_orders([joint], answers)
        self._dialogue = self._ask([*handshake.settings_queries([joint]), *orders])
        self._plans: deque[TrialPlan] = deque()
        self._planned = 0
        self._droop_deg = 0.0

    @property
    def progress_ratio(self) -> float:
        """The share of the trials that are over."""
        return 1.0 - len(self._plans) / self._planned if self._planned else 0.0

    def _prepared(self, now_ns: int) -> None:
        self._take_answers()
        probes = handshake.probes([self.joint], self._answers)
        self._poller.watch(probes.get(self.joint.name, ()), now_ns)
        self.state = State.HOLD
        self._has_moved = True
        move = PlannedMove(0.0, self._standing_deg, HOLD_MS)
        self._begin(TrialPlan(Kind.STEP, (move,), s_from_ms(HOLD_MS)), now_ns)

    def _take(self, polled: PolledReading, now_ns: int) -> None:
        self.recording.turnarounds_s.append(polled.turnaround_s)
        super()._take(polled, now_ns)

    def _trial_over(self, now_ns: int) -> None:
        if self.error is None and self.state is State.HOLD:
            self._plan()
            self._rested_deg = self._trial.rest_deg()
        elif self.error is None:
            self.recording.trials.append(self._trial)
            self._check_arrival()
            self._rested_deg = self._trial.rest_deg()
            if self._trial.kind is Kind.FAST:
                self._plan()
        if self.error is not None:
            return
        if self._plans:
            dither_s = DITHER_S * (GOLDEN_RATIO * len(self._plans) % 1.0)
            self._begin(self._plans.popleft(), now_ns + ns_from_s(dither_s))
        else:
            self._restore()

    def _plan(self) -> None:
        """Plan all trials; after the fast ones, plan the remaining ones again."""
        left = len(self._plans)
        top_deg_s = math.inf
        if self.state is State.HOLD:
            self._droop_deg = self._target_deg - self._trial.rest_deg()
            self.state = State.TRIALS
        else:
            top_deg_s = max(trial.fastest_deg_s() for trial in self.recording.trials)
        try:
            plans = make_trials(
                self.joint,
                self.window,
                self._standing_deg,
                droop_deg=self._droop_deg,
                top_deg_s=top_deg_s,
            )
        except LssMotionError as error:
            self.error = error
            return
        self._planned = len(plans)
        self._plans = deque(plans[-left:])

    def _check_arrival(self) -> None:
        """Set the error if the horn did not move to its target."""
        cause = not_arrived(
            self.joint,
            way_deg=abs(self._target_deg - self._trial.start_deg),
            from_deg=self._rested_deg,
            rest_deg=self._trial.rest_deg(),
            target_deg=self._target_deg,
        )
        if cause:
            self.error = self.error or self._fault(cause)
