"""Requests the next plan of a walk before the current one runs out, and extends the show with it.

`Pilot.act` runs in the loop that plays, between two commands. It sends a request to a planner in
another process and takes the reply when it is there; it never waits. When a reply is too late, the
robot takes the steps to its stand that every plan ends with, and walks again from there.
"""

from __future__ import annotations

import math
from collections import deque
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import PlanningError
from lss_motion.playing.player.events import Phase
from lss_motion.playing.walking.planner import PlanRequest
from lss_motion.show.gait.stepping import STILL
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.walking.planner import PlanReply
    from lss_motion.show.gait.model import BodyPose
    from lss_motion.show.gait.stepping import Twist

PLANNING_GUESS_S: Final = 1.0
"""Planning time that is assumed before one was measured."""
PLANNING_RATIO: Final = 2.0
"""A request is sent this many times the longest of the last planning times before its boundary."""
PLANNING_MARGIN_S: Final = 0.05
PLANNINGS_KEPT: Final = 6
PLANNING_MAX_S: Final = 2.0
"""Longer planning times count as this: the planner was delayed once, and with an earlier request
the robot would react to the operator later for no benefit."""
SETTLE_S: Final = 0.1
"""Time in a stand before the next walk begins."""


class PlannerLink(Protocol):
    """The connection to a planner. No call waits."""

    def send(self, request: PlanRequest, now_ns: int) -> None:
        """Send a request; the reply to the one before must have been taken."""

    def poll(self, now_ns: int) -> PlanReply | None:
        """Return the reply once, or None while there is none.

        Raises `PlanningError` if no reply can come any more.
        """


class Pilot:
    """Keeps one player walking at `commanded`.

    `commanded_pose`: bring the body to this pose at the next stand; None: nothing to do.
    """

    def __init__(
        self,
        link: PlannerLink,
        *,
        phase_s: float,
        splice_s: float,
        planning_s: float = PLANNING_GUESS_S,
    ) -> None:
        """Steer by `link`; `phase_s` and `splice_s` are those of its planner.

        `planning_s` is the planning time to assume until one was measured.
        """
        self.commanded: Twist = STILL
        self.commanded_pose: BodyPose | None = None
        self.twist: Twist = STILL
        """The velocity of the plan that is walked."""
        self.late = 0
        """Replies that came too late."""
        self.taken = 0
        """Replies that extended the show."""
        self.reason = ""
        """Why the last request could not be planned; empty if it could."""
        self.lost: PlanningError | None = None
        """Why no more plans come. The show is closed then, and ends in a stand."""
        self._link = link
        self._phase_s = phase_s
        self._splice_s = splice_s
        self._planning_s: deque[float] = deque([planning_s], PLANNINGS_KEPT)
        self._sent_ns: int | None = None
        self._was_taken = False
        self._next_s: float | None = None
        self._end_s = 0.0

    @property
    def lead_s(self) -> float:
        """How long before a boundary the plan from there on is requested."""
        planning_s = PLANNING_RATIO * min(max(self._planning_s), PLANNING_MAX_S)
        return planning_s + PLANNING_MARGIN_S + self._splice_s

    def is_standing(self, show_s: float) -> bool:
        """Return whether the robot stands at `show_s`, and no walk is planned."""
        return self._next_s is None and show_s >= self._end_s

    def act(self, player: Player, now_ns: int) -> None:
        """Give the player the plan that has come, and request the next one when it is due."""
        try:
            self._act(player, now_ns)
        except PlanningError as error:
            self.lost = error
            player.close()

    def _act(self, player: Player, now_ns: int) -> None:
        if player.phase is not Phase.SHOW or player.show is None:
            return
        if self._sent_ns is not None:
            reply = self._link.poll(now_ns)
            if reply is None:
                return
            self._take(reply, self._sent_ns, player, now_ns)
        if not player.show.is_open or self.lost is not None:
            return
        request = self._due(player.show.show_s(now_ns))
        if request is not None:
            self._sent_ns = now_ns
            self._link.send(request, now_ns)

    def _take(self, reply: PlanReply, sent_ns: int, player: Player, now_ns: int) -> None:
        """Extend the show with a reply, unless it is too late."""
        self._planning_s.append(s_from_ns(now_ns - sent_ns))
        self._sent_ns = None
        self.reason = reply.reason
        self._was_taken = reply.extension is not None and player.extend(reply.extension, now_ns)
        if self._was_taken:
            self.taken += 1
            self.twist, self._next_s, self._end_s = reply.twist, reply.next_s, reply.end_s
            return
        self.late += reply.extension is not None
        self.twist, self._next_s = STILL, None

    def _due(self, show_s: float) -> PlanRequest | None:
        """Return the request that must be sent now, or None."""
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
