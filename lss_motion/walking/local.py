"""A planner in the same process, for virtual time: its answers take as long as they are told to."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.walking.planner import Answer, Planner, Request


class LocalLink:
    """Answers `takes_s()` seconds after it was asked."""

    def __init__(self, planner: Planner, takes_s: Callable[[], float]) -> None:
        self._planner = planner
        self._takes_s = takes_s
        self._answer: Answer | None = None
        self._ready_ns = 0

    def ask(self, request: Request, now_ns: int) -> None:
        self._answer = self._planner.answer(request)
        self._ready_ns = now_ns + ns_from_s(self._takes_s())

    def poll(self, now_ns: int) -> Answer | None:
        if now_ns < self._ready_ns:
            return None
        answer, self._answer = self._answer, None
        return answer
