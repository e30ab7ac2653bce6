"""What is done about what is wrong: warn, slow the show, wait and resume, hold, let go."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.player.events import Faulted
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from lss_motion.robot.model import Robot
    from lss_motion.robot.on_fault import Ladders

SLOW_EVERY_NS: Final = NS_PER_S // 2
"""Chosen: a change of rate takes 0.3 s, and its effect must be seen before the next."""
SLOW_RATIO: Final = 0.5
SLOW_RATE_LEAST: Final = 0.1
"""A joint that cannot follow a tenth of its speed does not follow."""
RESUMES_MAX: Final = 10
"""Chosen: a line that breaks oftener than this in a show is broken."""


@dataclass(slots=True)
class _Climb:
    """Where one trouble stands on its ladder, and since when."""

    steps: tuple[FaultStep, ...]
    place: int
    since_ns: int

    @property
    def step(self) -> FaultStep:
        return self.steps[self.place]

    @property
    def is_last(self) -> bool:
        return self.place + 1 == len(self.steps)


class Ladder:
    """Takes the steps of every trouble, one after the other. `faults` is what it came to.

    `rate_max` is the rate of the show clock that the troubles allow.
    """

    def __init__(self, robot: Robot, show: Ladders) -> None:
        self.faults: list[Faulted] = []
        self.rate_max = 1.0
        self._robot = robot
        self._show = show
        self._climbs: dict[tuple[str, Cause], _Climb] = {}
        self._slowed_ns: int | None = None
        self._resumes = 0

    @property
    def is_idle(self) -> bool:
        """Return whether there is no trouble, nor anything left to be done about an earlier one."""
        return not self._climbs and self._slowed_ns is None

    def judge(self, troubles: Mapping[tuple[str, Cause], str], now_ns: int) -> list[Faulted]:
        """Return the steps to be taken now, given what is wrong now."""
        for gone in [trouble for trouble in self._climbs if trouble not in troubles]:
            del self._climbs[gone]
        taken = []
        for (joint, cause), text in troubles.items():
            climb = self._climbs.get((joint, cause))
            if climb is None:
                taken.append(self.begin(joint, cause, text, now_ns))
            elif now_ns >= self._next_ns(climb) and not climb.is_last:
                climb.place, climb.since_ns = climb.place + 1, now_ns
                taken.append(self._take(joint, cause, text, climb.step))
        self._slow(now_ns)
        return taken

    def taken_up(self, troubles: Collection[tuple[str, Cause]]) -> set[str]:
        """Return the joints that were only warned of as silent, answer, and are to be resumed."""
        silent = {
            name
            for (name, cause), climb in self._climbs.items()
            if cause is Cause.SILENT and climb.step is not FaultStep.RESUME
        }
        back = {name for name in silent if (name, Cause.SILENT) not in troubles}
        for name in sorted(back):
            steps = self._robot.ladder(Cause.RESTARTED, self._robot.joints[name], self._show)
            if FaultStep.RESUME not in steps or self._resumes >= RESUMES_MAX:
                back.remove(name)
        self._resumes += len(back)
        return back

    def begin(self, joint: str, cause: Cause, text: str, now_ns: int) -> Faulted:
        """Take the first step about a trouble. `joint` is empty for that of a port."""
        steps = self._robot.ladder(cause, self._robot.joints.get(joint), self._show)
        if self._resumes >= RESUMES_MAX and FaultStep.RESUME in steps:
            steps = tuple(step for step in steps if step is not FaultStep.RESUME) or (
                FaultStep.HOLD,
            )
        self._resumes += FaultStep.RESUME in steps
        self._climbs[joint, cause] = climb = _Climb(steps, 0, now_ns)
        return self._take(joint, cause, text, climb.step)

    def give_up(self, joint: str, cause: Cause, text: str) -> Faulted:
        """Take the step after `resume` about what did not come back: at the least, hold."""
        steps = self._robot.ladder(cause, self._robot.joints.get(joint), self._show)
        after = steps[steps.index(FaultStep.RESUME) + 1 :] if FaultStep.RESUME in steps else ()
        return self._take(joint, cause, text, next(iter(after), FaultStep.HOLD))

    def forget(self) -> None:
        """Begin at the foot of every ladder, as after all has been put right."""
        self._climbs.clear()
        self.rate_max, self._slowed_ns = 1.0, None

    def next_wakeup_ns(self) -> int | None:
        """Return when `judge` has something to do, if nothing is heard till then."""
        wakeups_ns = [self._next_ns(climb) for climb in self._climbs.values() if not climb.is_last]
        if self._slowed_ns is not None:
            wakeups_ns.append(self._slowed_ns + SLOW_EVERY_NS)
        return min(wakeups_ns, default=None)

    def _next_ns(self, climb: _Climb) -> int:
        return climb.since_ns + ns_from_s(self._robot.patience_s)

    def note(self, joint: str, cause: Cause, text: str, step: FaultStep) -> Faulted:
        """Keep in mind a step that was taken about a trouble; return it."""
        return self._take(joint, cause, text, step)

    def _take(self, joint: str, cause: Cause, text: str, step: FaultStep) -> Faulted:
        fault = Faulted(joint, text, cause, step)
        same = [i for i, f in enumerate(self.faults) if (f.joint, f.kind) == (joint, cause)]
        if not same:
            self.faults.append(fault)
        elif list(FaultStep).index(step) >= list(FaultStep).index(self.faults[same[0]].step):
            self.faults[same[0]] = fault
        return fault

    def _slow(self, now_ns: int) -> None:
        if self._slowed_ns is not None and now_ns < self._slowed_ns + SLOW_EVERY_NS:
            return
        if any(climb.step is FaultStep.SLOW for climb in self._climbs.values()):
            self.rate_max = max(SLOW_RATIO * self.rate_max, SLOW_RATE_LEAST)
            self._slowed_ns = now_ns
        elif self.rate_max < 1.0:
            self.rate_max = min(self.rate_max / SLOW_RATIO, 1.0)
            self._slowed_ns = now_ns
        else:
            self._slowed_ns = None
