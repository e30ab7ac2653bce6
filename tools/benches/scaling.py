"""How the costs grow with the number of joints and the length of the show.

Cold plans, compiled, and their commands played to a simulated bus, in processor time; growth is the
exponent of the straight line through the logarithms. What streaming costs is measured on a real
clock, with the servos in another process.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Final, TypeVar

import numpy as np

from benches.behind_pty import robot_behind_pty
from benches.plan import empty_cache
from benches.shows import lively_show, robot_of
from benches.table import Row, core_seconds
from lss_motion.playing import api
from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.playing.run import Observer, perform
from lss_motion.sim.bus import bus_from_robot
from lss_motion.units import NS_PER_US, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.player.events import Event
    from lss_motion.robot.model import Robot

Done = TypeVar("Done")

JOINTS: Final = (1, 6, 18, 40)
LENGTHS_S: Final = (1.0, 10.0, 60.0)
LONG_S: Final = 600.0
FULL_LENGTHS_S: Final = (*LENGTHS_S, LONG_S, 3600.0)
USUAL_JOINTS: Final = 18
FITTED_FROM_S: Final = 10.0
"""Shorter shows cost what any call costs."""
GROWTH_TARGET: Final = 1.15
"""Linear, and what caches that are too small add."""

REPEATS: Final = 3
ENOUGH_S: Final = 1.0
"""A cost is measured `REPEATS` times unless it has taken so long before."""

STREAMED_S: Final = 3.0
START_S: Final = 1.0
"""The simulated servos are powered this long before the show."""


def measure() -> list[Row]:
    """Return growth up to ten minutes, and what streaming costs."""
    return _measured({(n, s) for n in JOINTS for s in LENGTHS_S} | {(USUAL_JOINTS, LONG_S)})


def measure_full() -> list[Row]:
    """Return the same with all shows of up to an hour."""
    return _measured({(n, s) for n in JOINTS for s in FULL_LENGTHS_S})


def _measured(grid: set[tuple[int, float]]) -> list[Row]:
    _costs_s(USUAL_JOINTS, LENGTHS_S[1])  # Imports are no cost of a show.
    rows = _growth(grid)
    costs = {count: _streamed(_program(count), robot_of(count)) for count in JOINTS}
    rows += [
        Row(
            what=f"streaming {count} joints at 115200 bps",
            ours=f"{cost.core_ratio:.1%} of a core, {cost.answers_hz:.0f} answers/s",
            reference=f"late p99 {cost.late_p99_us} us",
        )
        for count, cost in costs.items()
    ]
    return rows


# ---- growth


def _growth(grid: set[tuple[int, float]]) -> list[Row]:
    taken_s = {point: _costs_s(*point) for point in sorted(grid)}
    rows = []
    for index, what in enumerate(("planning", "compiling", "simulating its commands")):
        for joints in JOINTS:
            lengths = [length_s for count, length_s in sorted(grid) if count == joints]
            costs = [taken_s[joints, length_s][index] for length_s in lengths]
            fitted = [(s, c) for s, c in zip(lengths, costs, strict=True) if s >= FITTED_FROM_S]
            rows.append(_growth_row(f"{what}, {joints} joints", lengths, costs, fitted, "s"))
        longest_s = LENGTHS_S[-1]
        costs = [taken_s[joints, longest_s][index] for joints in JOINTS]
        fitted = list(zip(JOINTS, costs, strict=True))[1:]
        rows.append(_growth_row(f"{what}, {longest_s:g} s", JOINTS, costs, fitted, "joints"))
    return rows


def _growth_row(
    what: str,
    sizes: list[float] | tuple[int, ...],
    costs_s: list[float],
    fitted: list[tuple[float, float]],
    unit: str,
) -> Row:
    logs = np.log(np.array(fitted))
    exponent = float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])
    return Row(
        what=what,
        ours=", ".join(f"{cost:.2g}" for cost in costs_s) + " s",
        reference=", ".join(f"{size:g}" for size in sizes) + f" {unit}",
        ratio=exponent,
        target=f"exponent <= {GROWTH_TARGET:g}",
        is_met=exponent <= GROWTH_TARGET,
    )


def _costs_s(joints: int, length_s: float) -> tuple[float, float, float]:
    """Return processor time of planning cold, compiling, and simulating the commands."""
    robot = robot_of(joints)
    show = lively_show(robot, length_s, seed=1, infeasible_ratio=0.05)

    def plan() -> Trajectory:
        with empty_cache():
            return api.plan(show, robot)

    planned, planning_s = _cost(plan)
    program, compiling_s = _cost(lambda: api.compile(planned, robot))
    _, simulating_s = _cost(lambda: _simulate(program, robot))
    return planning_s, compiling_s, simulating_s


def _cost(do: Callable[[], Done]) -> tuple[Done, float]:
    """Return what comes of a call, and its processor time: the median where it is short."""
    taken_s: list[float] = []
    done: list[Done] = []
    while len(taken_s) < REPEATS and sum(taken_s) < ENOUGH_S:
        done.clear()
        taken_s.append(core_seconds(lambda: done.append(do())))
    return done[0], statistics.median(taken_s)


def _simulate(program: Program, robot: Robot) -> None:
    bus = bus_from_robot(robot, "main", seed=0)
    for move in program.moves:
        bus.write(move.data, ns_from_s(START_S) + move.due_us * NS_PER_US)
    bus.advance(ns_from_s(START_S + program.duration_s))


# ---- streaming


@dataclass(frozen=True)
class Streaming:
    """What playing a show cost: share of a core, readings, lateness at the port."""

    core_ratio: float
    answers_hz: float
    late_p99_us: int


@cache
def _program(joints: int) -> Program:
    robot = robot_of(joints)
    with empty_cache():
        return api.compile(api.plan(lively_show(robot, STREAMED_S, seed=1), robot), robot)


def _streamed(program: Program, robot: Robot) -> Streaming:
    """Play on a real clock; the servos are in another process."""
    used_s: list[float] = []

    def note(event: Event) -> None:
        if isinstance(event, PhaseEntered):
            used_s.append(time.process_time())
            phases.append(event.phase)

    phases: list[Phase] = []
    with robot_behind_pty(robot) as (real, _):
        report = perform(program, real, observer=Observer(on_event=note)).report
    assert report.outcome == "finished", report
    shown = phases.index(Phase.SHOW)
    played_s = report.played_s
    return Streaming(
        core_ratio=(used_s[shown + 1] - used_s[shown]) / played_s,
        answers_hz=report.buses["main"].query_rate_hz,
        late_p99_us=report.timing.late_p99_us,
    )
