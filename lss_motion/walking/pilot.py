"""Who holds the reins: what is commanded now, and what has to be planned next, in good time.

Works beside the loop that plays: it asks a planner elsewhere and takes its answer when there is
one. It waits for nothing. When an answer comes too late, the robot walks to its stand by itself,
and the walk begins anew from there.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import PlanningError
from lss_motion.gait.stepping import STILL
from lss_motion.player.events import Phase
from lss_motion.units import s_from_ns
from lss_motion.walking.planner import PlanRequest

if TYPE_CHECKING:
    from lss_motion.gait.model import BodyPose
    from lss_motion.gait.stepping import Twist
    from lss_motion.player.player import Player
    from lss_motion.walking.planner import PlanReply

PLANNING_GUESS_S: Final = 1.0
"""How long planning may take before it has been measured."""
PLANNING_RATIO: Final = 2.0
"""It is asked for this much earlier than the slowest of the last plans took."""
PLANNING_MARGIN_S: Final = 0.05
PLANNINGS_KEPT: Final = 6
PLANNING_MAX_S: Final = 2.0
"""It is never asked for earlier than for a plan that takes this long: one that took longer was
held up, and who steers would wait for nothing."""
SETTLE_S: Final = 0.1
"""After a stand is reached, before another walk begins."""


class PlannerLink(Protocol):
    """The way to a planner. Neither call waits."""

    def send(self, request: PlanRequest, now_ns: int) -> None:
        """Have it planned; at most one thing at a time."""

    def poll(self, now_ns: int) -> PlanReply | None:
        """Return the answer to what was asked, once. Raises `PlanningError` if there is none."""


class Pilot:
    """Keeps one player walking at `commanded`; `commanded_pose` is the next pose of the body."""

    def __init__(
        self,
        link: PlannerLink,
        *,
        phase_s: float,
        splice_s: float,
        planning_s: float = PLANNING_GUESS_S,
    ) -> None:
        """Steer by `link`, whose planner is thought to take `planning_s`; the rest is its own."""
        self.commanded: Twist = STILL
        self.commanded_pose: BodyPose | None = None
        self.twist: Twist = STILL
        self.late = 0
        """Answers that came too late."""
        self.taken = 0
        self.reason = ""
        """Why the last wish could not be planned."""
        self.lost: PlanningError | None = None
        """Why nothing more is planned: the show is closed then, and ends in a stand."""
        self._link = link
        self._phase_s = phase_s
        self._splice_s = splice_s
        self._planning_s: deque[float] = deque([planning_s], PLANNINGS_KEPT)
        self._asked_ns: int | None = None
        self._was_taken = False
        self._next_s: float | None = None
        self._end_s = 0.0

    @property
    def lead_s(self) -> float:
        """How long before a boundary the stretch from there on is asked for."""
        planning_s = PLANNING_RATIO * min(max(self._planning_s), PLANNING_MAX_S)
        return planning_s + PLANNING_MARGIN_S + self._splice_s

    def is_standing(self, show_s: float) -> bool:
        return self._next_s is None and show_s >= self._end_s

    def act(self, player: Player, now_ns: int) -> None:
        """Take what has been planned, and have planned what is due."""
        try:
            self._act(player, now_ns)
        except PlanningError as error:
            self.lost = error
            player.close()

    def _act(self, player: Player, now_ns: int) -> None:
        if player.phase is not Phase.SHOW or player.show is None:
            return
        if self._asked_ns is not None:
            answer = self._link.poll(now_ns)
            if answer is None:
                return
            self._take(answer, player, now_ns)
        if not player.show.is_open or self.lost is not None:
            return
        request = self._due(player.show.show_s(now_ns))
        if request is not None:
            self._asked_ns = now_ns
            self._link.send(request, now_ns)

    def _take(self, answer: PlanReply, player: Player, now_ns: int) -> None:
        assert self._asked_ns is not None
        self._planning_s.append(s_from_ns(now_ns - self._asked_ns))
        self._asked_ns = None
        self.reason = answer.reason
        self._was_taken = answer.extension is not None and player.extend(answer.extension, now_ns)
        if self._was_taken:
            self.taken += 1
            self.twist, self._next_s, self._end_s = answer.twist, answer.next_s, answer.end_s
            return
        self.late += answer.extension is not None
        self.twist, self._next_s = STILL, None

    def _due(self, show_s: float) -> PlanRequest | None:
        if self._next_s is not None:
            if show_s < self._next_s - self.lead_s:
                return None
            commanded = STILL if self.commanded_pose is not None else self.commanded
            hold = math.ceil(self.lead_s / self._phase_s) if commanded != STILL else 1
            return PlanRequest(commanded=commanded, was_taken=self._was_taken, hold=hold)
        if show_s < self._end_s + SETTLE_S:
            return None
        pose, self.commanded_pose = self.commanded_pose, None
        if pose is None and self.commanded == STILL:
            return None
        return PlanRequest(
            commanded=self.commanded,
            was_taken=self._was_taken,
            begins_s=show_s + self.lead_s,
            hold=math.ceil(self.lead_s / self._phase_s),
            pose=pose,
        )
