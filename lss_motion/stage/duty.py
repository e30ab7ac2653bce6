"""Why a figure rests: duty, budgets, quiet hours, faults, an operator, and a start to come.

`Duty` holds every reason that there is at present. The figure rests while there is one. It decides
nothing about shows; `director` asks it, and tells it what happens.
"""

from __future__ import annotations

import math
from collections import deque
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from lss_motion.stage.triggering import end_of_span
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from datetime import datetime

    from lss_motion.robot.on_fault import Cause
    from lss_motion.stage.file import Budget, Retry
    from lss_motion.stage.model import Stage

CURRENT_MEAN_S: Final = 60.0
"""A budget of current is one of heat, and a servo warms up within minutes."""

SPEED_UP_RATIO: Final = 0.95
"""Shows are fast again below this share of `slow`, so that they do not change back and forth."""

WAIT_MAX_S: Final = 3600.0
"""Each attempt after a fault comes twice as late as the one before, but not later than this."""


class Reason(StrEnum):
    """Why the figure rests."""

    GO = "waits for GO"
    START_AT = "waits for its time to start"
    OPERATOR = "an operator sent it to rest"
    WORKED = "has worked long enough"
    HOT = "a servo is hot"
    CURRENT = "the current was high for a minute"
    QUIET = "quiet hours"
    RETRY = "waits after a fault"
    FAULT = "too many faults; a person must look, then wake it"


AT_ONCE: Final = frozenset(set(Reason) - {Reason.WORKED, Reason.QUIET})
"""For the others the show that plays is ended."""

NEEDS_PERSON: Final = frozenset({Reason.OPERATOR, Reason.FAULT})
"""What a person, or a cue, ends with `wake`."""


class Duty:
    """The reasons for a rest, and the speed of shows."""

    def __init__(self, stage: Stage) -> None:
        self._rule = stage.duty
        self.faults = Attempts(stage.retry)
        self.reasons: dict[Reason, str] = {}
        """Each with its text: in words, until when."""
        self.start_at: datetime | None = None
        self.rate = 1.0
        self._worked_ns = 0
        self._ticked_ns: int | None = None
        self._until_ns: dict[Reason, int] = {}
        self._current_a: float | None = None
        self._current_ns = 0

    def renew(self, stage: Stage) -> None:
        """Go on with other rules; what was counted and begun stays."""
        self._rule = stage.duty
        self.faults.rule = stage.retry

    # ---- what happens

    def begin(self, reason: Reason, detail: str = "") -> None:
        """Rest for a reason."""
        self.reasons[reason] = f"{reason} {detail}".strip()

    def end(self, reason: Reason) -> None:
        """Note that a reason is gone."""
        self.reasons.pop(reason, None)
        self._until_ns.pop(reason, None)

    def wake(self) -> bool:
        """End the rests that need a person; return whether there was one."""
        found = [reason for reason in NEEDS_PERSON if reason in self.reasons]
        for reason in found:
            self.end(reason)
        if Reason.FAULT in found:
            self.faults.forget()
        return bool(found)

    def tick(self, now_ns: int, wall: datetime, local: datetime, *, is_moving: bool) -> None:
        """Take the time: `local` is the time of day; `is_moving`: a show plays."""
        if self._ticked_ns is not None and is_moving:
            self._worked_ns += now_ns - self._ticked_ns
        self._ticked_ns = now_ns
        for reason, until_ns in list(self._until_ns.items()):
            if now_ns >= until_ns:
                self.end(reason)
        if self.start_at is not None and wall >= self.start_at:
            self.start_at = None
            self.end(Reason.START_AT)
        end = end_of_span(local.time(), self._rule.quiet)
        if end is None:
            self.end(Reason.QUIET)
        else:
            self.begin(Reason.QUIET, f"(until {end:%H:%M})")
        work_s = self._rule.work_s
        if work_s is not None and s_from_ns(self._worked_ns) >= work_s:
            self._worked_ns = 0
            self._rest_until(Reason.WORKED, now_ns, self._rule.rest_s)

    def measured(
        self, temperature_c: float | None, current_a: float | None, now_ns: int, who: str = ""
    ) -> None:
        """Take the temperature of the hottest servo, `who`, and the current of all of them."""
        rates = [self._budget(Reason.HOT, self._rule.temperature_c, temperature_c, who)]
        if current_a is not None:
            self._average(current_a, now_ns)
        rates.append(self._budget(Reason.CURRENT, self._rule.current_a, self._current_a, ""))
        known = [rate for rate in rates if rate is not None]
        if known:
            self.rate = min(known)

    def relax(self, now_ns: int) -> None:
        """Let rests by budget end after a while: of limp servos nothing is measured."""
        for reason in (Reason.HOT, Reason.CURRENT):
            if reason in self.reasons:
                self._rest_until(reason, now_ns, self._rule.rest_s)
        self._current_a = None

    def failed(self, cause: Cause | None, now_ns: int) -> bool:
        """Take a fault that ended a run; return whether the stage begins again by itself."""
        wait_s = self.faults.wait_s(cause, now_ns)
        if wait_s is None:
            self.end(Reason.RETRY)
            self.begin(Reason.FAULT)
            return False
        self._rest_until(Reason.RETRY, now_ns, wait_s)
        return True

    def next_ns(self) -> int | None:
        """Return when a reason ends by itself; None: none does."""
        return min(self._until_ns.values(), default=None)

    @property
    def is_urgent(self) -> bool:
        """Whether the show that plays is to be ended."""
        return any(reason in AT_ONCE for reason in self.reasons)

    def _rest_until(self, reason: Reason, now_ns: int, rest_s: float) -> None:
        self._until_ns[reason] = now_ns + ns_from_s(rest_s)
        self.begin(reason, f"(for {rest_s:.0f} s)")

    def _average(self, current_a: float, now_ns: int) -> None:
        if self._current_a is None:
            self._current_a = 0.0  # A mean of a minute: the first seconds do not fill it.
            self._current_ns = now_ns
            return
        share = 1.0 - math.exp(-s_from_ns(now_ns - self._current_ns) / CURRENT_MEAN_S)
        self._current_a += share * (current_a - self._current_a)
        self._current_ns = now_ns

    def _budget(
        self, reason: Reason, budget: Budget | None, value: float | None, who: str
    ) -> float | None:
        """Begin or end the rest of a budget; return the rate that it allows, None: as before."""
        if budget is None or value is None:
            return None
        if value > budget.rest:
            self.begin(
                reason, f"({who} {value:.1f}, allowed is {budget.rest:g})".replace("( ", "(")
            )
        elif value < budget.slow and reason in self.reasons:
            self.end(reason)
        if value > budget.slow:
            return self._rule.slow_ratio
        return 1.0 if value < SPEED_UP_RATIO * budget.slow else self.rate


class Attempts:
    """How often the stage has begun again after faults, and whether it may once more."""

    def __init__(self, rule: Retry) -> None:
        self.rule = rule
        self._past: deque[tuple[int, Cause | None]] = deque()

    def wait_s(self, cause: Cause | None, now_ns: int) -> float | None:
        """Note a fault; return how long to wait before the next attempt, None: make none."""
        within_ns = ns_from_s(self.rule.within_s)
        while self._past and now_ns - self._past[0][0] > within_ns:
            self._past.popleft()
        of_kind = sum(past is cause for _, past in self._past)
        allowed = 0 if cause is None else self.rule.allowed(cause)
        if of_kind >= allowed or len(self._past) >= self.rule.total:
            return None
        self._past.append((now_ns, cause))
        return min(self.rule.wait_s * 2.0**of_kind, max(self.rule.wait_s, WAIT_MAX_S))

    def forget(self) -> None:
        """Begin anew, since a person has looked."""
        self._past.clear()
