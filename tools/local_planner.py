"""A walk planner in the same process, for virtual time: each reply takes a given time.

`tools/campaign walks` and the virtual tests of walking use it in place of `PlannerProcess`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.playing.walking.planner import PlanReply, PlanRequest, WalkPlanner


class LocalPlanner:
    """A `PlannerLink` that replies `takes_s()` seconds after a request."""

    def __init__(self, planner: WalkPlanner, takes_s: Callable[[], float]) -> None:
        self._planner = planner
        self._takes_s = takes_s
        self._reply: PlanReply | None = None
        self._ready_ns = 0

    def send(self, request: PlanRequest, now_ns: int) -> None:
        """Plan `request` now; the reply is ready later."""
        self._reply = self._planner.plan(request)
        self._ready_ns = now_ns + ns_from_s(self._takes_s())

    def poll(self, now_ns: int) -> PlanReply | None:
        """Return the reply once, when it is ready."""
        if now_ns < self._ready_ns:
            return None
        reply, self._reply = self._reply, None
        return reply
