"""Moves that the experiment of `identify` does not make: very small ones, and those of EM0."""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.maintenance.careful import top_deg_s
from lss_motion.maintenance.identify.joint_run import Experiment, ExperimentState
from lss_motion.maintenance.identify.trials import PlannedMove, SentMove, TrialKind, TrialPlan
from lss_motion.protocol.framing import encode_move
from lss_motion.robot.file import FILTER_COUNT_MAX
from lss_motion.units import MS_PER_S, s_from_ms, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.maintenance.identify.trials import MotionWindow, Trial
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.robot.model import Joint, Robot

MOVES: Final = 4
"""Moves of each size, out and back in turn: a damaged reading is then one of many."""
FILTER_COUNT_LEAST: Final = 4
"""Fewer steps of the filter are not separated from the lag of the horn."""
LEAST_MS: Final = 300
"""A shorter T would make a small move fast."""


class SmallMoves(Experiment):
    """Moves out and back by each of `sizes_deg`; a horn that does not follow is a result."""

    def __init__(
        self,
        joint: Joint,
        robot: Robot,
        answers: Answers,
        window: MotionWindow,
        *,
        standing_deg: float,
        sizes_deg: Sequence[float],
    ) -> None:
        """`sizes_deg` have the sign of the end of the range that is further away."""
        super().__init__(joint, robot, answers, window, standing_deg=standing_deg)
        self._sizes_deg = sizes_deg
        self._top_deg_s = top_deg_s(joint, robot)

    def _plan(self) -> None:
        if self.state is not ExperimentState.HOLD:
            return
        self.state = ExperimentState.TRIALS
        plans = []
        for size_deg in self._sizes_deg:
            duration_ms = self._duration_ms(abs(size_deg))
            for number in range(MOVES):
                target_deg = self._standing_deg + (0.0 if number % 2 else size_deg)
                move = PlannedMove(0.0, target_deg, duration_ms)
                plans.append(TrialPlan(TrialKind.STEP, (move,), self._ends_s(duration_ms)))
        self._plans = deque(plans)
        self._planned = len(plans)

    def _duration_ms(self, way_deg: float) -> int:
        return max(LEAST_MS, math.ceil(MS_PER_S * way_deg / self._top_deg_s))

    def _ends_s(self, duration_ms: int) -> float:
        """Return the latest end of a move: its T, and the ramps that may come on top."""
        return 2.0 * s_from_ms(duration_ms)

    def _check_arrival(self) -> None:
        """Judge nothing here: how far the horn came is what is measured."""

    def trials_of(self, size_deg: float) -> list[Trial]:
        """Return the trials of one size."""
        at = list(self._sizes_deg).index(size_deg)
        return self.recording.trials[MOVES * at : MOVES * (at + 1)]


def streamed(joint: Joint, robot: Robot, way_deg: float) -> Joint:
    """Return the joint in EM0, with a filter whose first step is within the speed of a careful run.

    The first step of a move is its way divided by FPC (FACTS.md M6).
    """
    steps = abs(way_deg) / (joint.response.filter_s * top_deg_s(joint, robot))
    count = min(max(math.ceil(steps), FILTER_COUNT_LEAST), FILTER_COUNT_MAX)
    return replace(joint, drive="streamed", filter_count=count)


class FilterMoves(SmallMoves):
    """The same of a `streamed` joint: each target goes through the filter of the servo."""

    def _ends_s(self, duration_ms: int) -> float:
        del duration_ms
        return 8.0 * self.joint.filter_count * self.joint.response.filter_s

    def _send(self, move: PlannedMove, now_ns: int) -> None:
        wire = round(move.target_deg * self.joint.model.wire_per_deg)
        data = encode_move(self.joint.servo_id, wire, None)
        received_ns = self._line.send(data, now_ns)
        self._target_deg = wire / self.joint.model.wire_per_deg
        received_s = s_from_ns(received_ns - self._began_ns)
        self._trial.sent.append(SentMove(received_s, self._target_deg, 0.0))
