"""What is tried, and in which order, until a show fits its lines."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.program.attempt import Attempt
from lss_motion.program.run import RIVALRY_S
from lss_motion.protocol.constants import BAUD_RATES_BPS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.program.course import Course
    from lss_motion.robot.model import Robot

RELAXED_RATIOS: Final = (1.0, 1.5, 2.5, 4.0, 6.0)
"""By how much the tolerance is relaxed, step by step, when the line is too slow."""
TIGHT_TURN_S: Final = 0.02
"""Where somebody was late for the line at first, when nobody waited for a turn, commands are placed
strictly in the order of time: a third more of them fit, in two to three times the time."""
SLOWEST_SHARED_BPS: Final = 115_200
"""The usual rate (FACTS.md W23: the default of every library). A slower line is fitted for itself
alone, or the usual one would pay for it with moves further from where they are wanted."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One way to fit a show: as if for the lines of `robot`, with `ratio` times the tolerance."""

    robot: Robot
    ratio: float
    turn_s: float
    gives_up: Literal["late", "tight"] | None

    def attempt(
        self, courses: Mapping[str, Course], tolerance_deg: float, seams_s: Sequence[float]
    ) -> Attempt:
        """Return the attempt; raises `TooLateError` as `Attempt` does."""
        return Attempt(
            courses,
            self.robot,
            self.ratio * tolerance_deg,
            seams_s,
            turn_s=self.turn_s,
            gives_up=self.gives_up,
        )


def trials(robot: Robot, *, with_relaxed: bool) -> Iterator[Trial]:
    """Yield what is tried, best first; the last of the relaxed ones never gives up.

    What fits a slower line fits a faster one, with the same moves heard at the same instants. So
    every line of `SLOWEST_SHARED_BPS` or more is first taken for a slower one: a higher baud rate
    never needs more commands, at the same tolerance. Left to chance, as slots are given one by one,
    it is a few in a hundred either way.

    A wider tolerance has no such rule. Each move is chosen so that it and its successor reach
    furthest, and where two moves end furthest is not always where the third has it best: a little
    more room can take that choice past a better place. Neither the wire's lattice nor the slots do
    it: one servo alone on a line that grants every wish, with targets of 0.00001 deg, takes 60
    moves for the sine of `tools/bench.py compress` at 0.23 deg and 63 at 0.24 (in tenths of a
    degree 61 at 0.22 and 62 at 0.23). So the next wider tolerance needs up to one move in twenty
    more, and one besides (measured; held by a property); only fitting for every narrower tolerance
    as well would rule it out, at as many times the work.
    """
    fastest_bps = max(bus.baud_bps for bus in robot.buses.values())
    rates = [rate for rate in sorted(BAUD_RATES_BPS) if SLOWEST_SHARED_BPS <= rate < fastest_bps]
    for rate in [*rates, fastest_bps]:
        buses = {n: replace(b, baud_bps=min(b.baud_bps, rate)) for n, b in robot.buses.items()}
        paced = replace(robot, buses=buses)
        yield Trial(paced, 1.0, RIVALRY_S, "late")
        yield Trial(paced, 1.0, TIGHT_TURN_S, "tight")
    if with_relaxed:
        for ratio in RELAXED_RATIOS[1:]:
            is_last = ratio == RELAXED_RATIOS[-1]
            yield Trial(robot, ratio, TIGHT_TURN_S, None if is_last else "tight")
