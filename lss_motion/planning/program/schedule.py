"""All joints fitted at one tolerance, on the lines that they share.

A `Schedule` is the fit of all joints for one candidate: baud rates and a tolerance. `candidates`
yields what is tried, and in which order, until a show fits its lines. `closed_pass` joins the end
of a repeated pass to its begin: every servo continues as it began the pass.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from itertools import groupby
from operator import attrgetter
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import LineLoadError
from lss_motion.planning.program.drives import late_max_s, make_fitter
from lss_motion.planning.program.fit import (
    RIVALRY_S,
    TIGHT_TURN_S,
    TURN_S,
    TimedFit,
    microseconds,
)
from lss_motion.planning.program.line import LineSchedule, longest_move, sent_us
from lss_motion.planning.program.mates import lead_s, mated, mates_of
from lss_motion.planning.program.model import Move
from lss_motion.planning.program.moves import FittedJoint, fitted_profiles
from lss_motion.planning.program.reference_grid import servo_limits
from lss_motion.protocol.constants import BAUD_RATES_BPS
from lss_motion.units import s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from lss_motion.planning.program.drives import JointFitter
    from lss_motion.planning.program.fit import Grant
    from lss_motion.planning.program.model import Repeat
    from lss_motion.planning.program.moves import InitialMotion
    from lss_motion.planning.program.reference_grid import Reference
    from lss_motion.planning.program.response import IntArray
    from lss_motion.robot.model import Joint, Robot

RELAXED_RATIOS: Final = (1.0, 1.5, 2.5, 4.0, 6.0)
"""The factors by which the tolerance is relaxed, in this order, when the line is too slow."""
SLOWEST_SHARED_BPS: Final = 115_200
"""The usual rate (FACTS.md W23: the default of every library). A slower line has a fit of its own;
otherwise the usual rate would have moves further from the instants requested."""
POINTS_MAX: Final = 4_000_000
"""Points of references that are fitted at once, 20 bytes each. Chosen: ten minutes of 32 joints."""
US_PER_MS: Final = 1_000
STRETCH_MAX_US: Final = 10_000
"""A move may last this much longer than planned. Chosen: at 1000 deg/s² the horn is then 0.05 deg
off."""


class _Slot(NamedTuple):
    """The line time of the commands of one joint."""

    bus: str
    size_us: int
    late_max_us: int


class TooLateError(Exception):
    """A command found no slot in time, and the schedule was to give up then."""


class Schedule:
    """All joints at one tolerance. `is_tight`: some command is later than its drive allows.

    Streamed joints come first: a filter brakes if its targets come unevenly. Then stepped ones:
    their commands have fixed instants, while the fit of a timed joint compensates for every move
    that the line grants early.
    """

    def __init__(  # noqa: PLR0913  (the options of one fit)
        self,
        references: Mapping[str, Reference],
        robot: Robot,
        tolerance_deg: float,
        seams_s: Sequence[float] = (),
        *,
        initial: Mapping[str, InitialMotion] | None = None,
        lines: Mapping[str, LineSchedule] | None = None,
        turn_s: float = TURN_S,
        gives_up: bool = False,
        ratios: Mapping[str, float] | None = None,
        kept: Mapping[str, FittedJoint] | None = None,
    ) -> None:
        """Fit `references`, all on one grid; `seams_s`, `initial`, `turn_s` as for `TimedFit`.

        `ratios` multiplies the tolerance of single timed joints. `kept` holds joints that stay as
        another schedule of the same lines has them. `initial` holds timed joints only. `lines`
        holds the slots that are reserved already; no move is due before the references begin. With
        `gives_up`, raises `TooLateError` as soon as a command is later than its drive allows.
        """
        self.tolerance_deg = tolerance_deg
        self.fitted: dict[str, FittedJoint] = {}
        self.late_max_us = 0
        self.is_tight = False
        self._start_us = us_from_s(
            min((reference.start_s for reference in references.values()), default=0.0)
        )
        self._lines = {bus: (lines or {}).get(bus, LineSchedule()) for bus in robot.buses}
        self._initial, self._turn_s, self._gives_up = initial or {}, turn_s, gives_up
        self._ratios = ratios or {}
        mates = {} if self._initial else mates_of(references, robot)
        led = {mate for own in mates.values() for mate in own}
        fitted = {name: one for name, one in references.items() if name not in led}
        self._slots = {
            name: _Slot(
                robot.joints[name].bus,
                sum(slot_us(robot.joints[one], robot) for one in (name, *mates.get(name, ()))),
                us_from_s(late_max_s(robot.joints[name])),
            )
            for name in fitted
        }
        self._keep({name: one for name, one in (kept or {}).items() if name in fitted})
        left = {name: one for name, one in fitted.items() if name not in self.fitted}
        for drive in ("streamed", "stepped"):
            self._fit_each(
                {
                    name: make_fitter(robot.joints[name], reference, tolerance_deg, seams_s)
                    for name, reference in left.items()
                    if robot.joints[name].drive == drive
                }
            )
        timed = [robot.joints[name] for name in left if robot.joints[name].drive == "timed"]
        for joints in _at_once(timed, references):
            self._fit_timed(joints, references, tolerance_deg, seams_s)
        for leader, names in mates.items():
            own = robot.joints[leader]
            step_s = lead_s(own, self.fitted[leader], robot)
            for count, name in enumerate(names, start=1):
                self.fitted[name] = mated(
                    own, self.fitted[leader], robot.joints[name], references[name], count * step_s
                )

    def _keep(self, kept: Mapping[str, FittedJoint]) -> None:
        """Take the fits of joints as they are, with the slots that they have."""
        if not kept:
            return
        grant = self._grant_of(list(kept))
        joint = np.repeat(np.arange(len(kept)), [len(one.received_s) for one in kept.values()])
        received_us = microseconds(np.concatenate([one.received_s for one in kept.values()]))
        in_turn = np.argsort(received_us, kind="stable")
        grant(joint[in_turn], received_us[in_turn], received_us[in_turn])
        self.fitted |= kept

    def _fit_each(self, fitters: Mapping[str, JointFitter]) -> None:
        """Grant the commands of the fitters one by one, in the order of the instants requested."""
        queue: list[tuple[float, str]] = []
        for name, fitter in fitters.items():
            if (requested_s := fitter.request(None)) is not None:
                heapq.heappush(queue, (requested_s, name))
        last_s = dict.fromkeys(fitters, s_from_us(self._start_us))
        while queue:
            requested_s, name = heapq.heappop(queue)
            granted_us = self._grant(
                self._slots[name], us_from_s(requested_s), us_from_s(last_s[name])
            )
            last_s[name] = s_from_us(granted_us)
            fitters[name].grant(last_s[name])
            next_s = fitters[name].request(last_s[name])
            if next_s is not None:
                heapq.heappush(queue, (next_s, name))
        for name, fitter in fitters.items():
            received_s, target_wire = np.array(fitter.setpoints, float).reshape(-1, 2).T
            no_duration = np.full(len(received_s), np.nan)
            self.fitted[name] = FittedJoint(received_s, target_wire, no_duration, fitter.profile())

    def _fit_timed(
        self,
        joints: Sequence[Joint],
        references: Mapping[str, Reference],
        tolerance_deg: float,
        seams_s: Sequence[float],
    ) -> None:
        """Fit timed joints together; each run of the fit starts with the lines as they are now."""
        free = {name: line.copy() for name, line in self._lines.items()}
        before = self.late_max_us, self.is_tight

        def new_line() -> Grant:
            self._lines = {name: line.copy() for name, line in free.items()}
            self.late_max_us, self.is_tight = before
            return grant

        names = [joint.name for joint in joints]
        grant = self._grant_of(names)
        own = [references[name] for name in names]
        limits = [
            servo_limits(joint, tolerance_deg * self._ratios.get(joint.name, 1.0))
            for joint in joints
        ]
        initial = [self._initial[name] for name in names if name in self._initial]
        lines = [list(self._lines).index(joint.bus) for joint in joints]
        moves = TimedFit(own, limits, seams_s, initial, self._turn_s, lines).moves(new_line)
        made = fitted_profiles(moves, own, limits, initial)
        for index, (name, profile) in enumerate(zip(names, made, strict=True)):
            some = moves.of(index)
            self.fitted[name] = FittedJoint(
                some.received_s, some.target_wire, some.duration_ms, profile
            )

    def _grant_of(self, names: Sequence[str]) -> Grant:
        """Return the function that grants many moves at once, for joints numbered as in `names`."""
        buses, sizes_us, lates_us = zip(*(self._slots[name] for name in names), strict=True)
        size_us, allowed_us = np.array(sizes_us), np.array(lates_us)
        of_bus = np.array([list(self._lines).index(bus) for bus in buses])

        def grant(joint: IntArray, requested_us: IntArray, after_us: IntArray) -> IntArray:
            received_us, own_us, bus = np.empty_like(requested_us), size_us[joint], of_bus[joint]
            earliest_us = np.maximum(after_us - own_us, self._start_us)
            for index, line in enumerate(self._lines.values()):
                some = np.flatnonzero(bus == index)
                columns = (column[some] for column in (requested_us, own_us, earliest_us))
                received_us[some] = line.reserve_all(*columns)
            late_us = received_us - requested_us
            is_tight = bool(np.any(late_us > allowed_us[joint]))
            self._note_late(int(late_us.max(initial=0)), is_tight=is_tight)
            return received_us

        return grant

    def _grant(self, slot: _Slot, requested_us: int, after_us: int) -> int:
        """Reserve the line for the next move of a joint; return when its servo receives that move.

        Not before `after_us`, and at `requested_us` at the latest if there is a slot.
        """
        bus, size_us, late_max_us = slot
        earliest_us = max(after_us - size_us, self._start_us)
        received_us = self._lines[bus].reserve(requested_us, size_us, earliest_us)
        late_us = max(received_us - requested_us, 0)
        self._note_late(late_us, is_tight=late_us > late_max_us)
        return received_us

    def _note_late(self, late_us: int, *, is_tight: bool) -> None:
        """Record by how much moves are late, 0 for none, and whether a drive allows less."""
        self.late_max_us = max(self.late_max_us, late_us)
        self.is_tight = self.is_tight or is_tight
        if self._gives_up and self.is_tight:
            raise TooLateError


def _at_once(
    joints: Sequence[Joint], references: Mapping[str, Reference]
) -> Iterator[Sequence[Joint]]:
    """Yield joints that are fitted together: those of one line, and of more as memory allows."""
    some: list[Joint] = []
    points = 0
    for _, own in groupby(sorted(joints, key=attrgetter("bus")), key=attrgetter("bus")):
        more = list(own)
        added = sum(len(references[joint.name].position_deg) for joint in more)
        if some and points + added > POINTS_MAX:
            yield some
            some, points = [], 0
        some, points = some + more, points + added
    if some:
        yield some


def slot_us(joint: Joint, robot: Robot) -> int:
    """Return the line time of the longest move that the joint can be sent."""
    return sent_us(len(longest_move(joint)), robot.buses[joint.bus].baud_bps)


class Candidate(Struct, frozen=True):
    """One way to fit a show: as if for the lines of `robot`, with `ratio` times the tolerance."""

    robot: Robot
    ratio: float
    turn_s: float
    gives_up: bool

    def schedule(
        self,
        references: Mapping[str, Reference],
        tolerance_deg: float,
        seams_s: Sequence[float],
        ratios: Mapping[str, float] | None = None,
        kept: Mapping[str, FittedJoint] | None = None,
    ) -> Schedule:
        """Return the schedule of this candidate; raises `TooLateError` as `Schedule` does."""
        return Schedule(
            references,
            self.robot,
            self.ratio * tolerance_deg,
            seams_s,
            turn_s=self.turn_s,
            gives_up=self.gives_up,
            ratios=ratios,
            kept=kept,
        )


def candidates(robot: Robot, *, with_relaxed: bool) -> Iterator[Candidate]:
    """Yield what is tried, best first; the last of the relaxed ones never gives up.

    What fits a slower line fits a faster one, with the same moves received at the same instants. So
    every line of `SLOWEST_SHARED_BPS` or more is first taken for a slower one: a higher baud rate
    never needs more commands, at the same tolerance. Without this, since slots are granted one by
    one, the number of commands varies by a few in a hundred either way.

    A wider tolerance has no such rule. Each move is chosen so that it and its successor reach
    furthest, and the place where two moves reach furthest is not always the best start for the
    third: a little more room can move that choice past a better place. Neither the wire's lattice
    nor the slots cause it: one servo alone on a line that grants every request, with targets of
    0.00001 deg, takes 60 moves for the sine of `tools/bench.py compress` at 0.23 deg and 63 at 0.24
    (in tenths of a degree 61 at 0.22 and 62 at 0.23). So the next wider tolerance needs up to one
    move in twenty more, and one besides (measured; held by a property test). Only a fit for every
    narrower tolerance as well would rule it out, at as many times the work.
    """
    fastest_bps = max(bus.baud_bps for bus in robot.buses.values())
    rates = [rate for rate in sorted(BAUD_RATES_BPS) if SLOWEST_SHARED_BPS <= rate < fastest_bps]
    for rate in [*rates, fastest_bps]:
        buses = {n: replace(b, baud_bps=min(b.baud_bps, rate)) for n, b in robot.buses.items()}
        paced = replace(robot, buses=buses)
        yield Candidate(paced, 1.0, RIVALRY_S, gives_up=False)
        yield Candidate(paced, 1.0, TIGHT_TURN_S, gives_up=True)
    if with_relaxed:
        for ratio in RELAXED_RATIOS[1:]:
            is_last = ratio == RELAXED_RATIOS[-1]
            yield Candidate(robot, ratio, TIGHT_TURN_S, gives_up=not is_last)


def closed_pass(moves: Iterable[Move], repeat: Repeat, robot: Robot) -> list[Move]:
    """Return the moves until the end of the repeated pass, so that the pass can follow itself.

    Commands around the two seams fall differently, as the line allows. Where the last move of the
    pass would wait for its successor longer than planned, the move that is under way when the pass
    begins is sent again at its begin.
    """
    own: dict[tuple[str, int], list[Move]] = defaultdict(list)
    for move in moves:
        own[move.bus, move.servo_id].append(move)
    kept = [move for own_moves in own.values() for move in own_moves if move.due_us < repeat.to_us]
    for own_moves in own.values():
        again = _repeated_move(own_moves, repeat)
        if again is None or again.duration_ms is None:
            continue
        due_us = _free_us(_busy_us(kept, again.bus, repeat, robot), repeat.from_us, again, robot)
        if due_us >= min(m.due_us for m in own_moves if m.due_us >= repeat.from_us):
            continue  # The line is so full that the successor comes first.
        ends_us = again.due_us + again.duration_ms * US_PER_MS
        kept.append(
            Move(
                due_us=due_us,
                bus=again.bus,
                servo_id=again.servo_id,
                target_wire=again.target_wire,
                duration_ms=max(1, round((ends_us - due_us) / US_PER_MS)),
            )
        )
    return sorted(kept, key=lambda move: (move.due_us, move.bus, move.servo_id))


def _busy_us(
    moves: Iterable[Move], bus: str, repeat: Repeat, robot: Robot
) -> list[tuple[int, int]]:
    """Return when a line is busy after the first seam, with either pass before it."""
    period_us = repeat.to_us - repeat.from_us
    taken = []
    for move in moves:
        if move.bus != bus:
            continue
        end_us = move.due_us + sent_us(len(move.data), robot.buses[bus].baud_bps)
        if end_us > repeat.to_us:
            taken.append((move.due_us - period_us, end_us - period_us))
        if repeat.from_us < end_us:
            taken.append((move.due_us, end_us))
    return sorted(taken)


def _repeated_move(own_moves: list[Move], repeat: Repeat) -> Move | None:
    """Return the move under way at the first seam; None if the one at the second replaces it."""
    before = [move for move in own_moves if move.due_us < repeat.from_us]
    after_us = [m.due_us - repeat.from_us for m in own_moves if m.due_us >= repeat.from_us]
    planned_us = [m.due_us - repeat.to_us for m in own_moves if m.due_us >= repeat.to_us]
    if not before or not after_us or not planned_us:
        return None
    return before[-1] if after_us[0] - planned_us[0] > STRETCH_MAX_US else None


def _free_us(taken: list[tuple[int, int]], from_us: int, move: Move, robot: Robot) -> int:
    """Return the first instant from `from_us` on at which the line is free for `move`."""
    size_us = sent_us(len(move.data), robot.buses[move.bus].baud_bps)
    due_us = from_us
    for start_us, end_us in taken:
        if start_us >= due_us + size_us:
            break
        due_us = max(due_us, end_us)
    return due_us


def overload_error(
    schedule: Schedule,
    robot: Robot,
    *,
    from_s: float = 0.0,
    what: str = "the show",
    remedies: str = "a faster baud rate, joints on a second bus, or fewer joints moving at once",
) -> LineLoadError:
    """Return the error for a schedule that is tight: the load of the fullest line, and remedies.

    `from_s` is the instant from which on the commands are counted: the start of `what`.
    """
    commands: dict[str, int] = dict.fromkeys(robot.buses, 0)
    busy_us: dict[str, int] = dict.fromkeys(robot.buses, 0)
    span_s = 1e-3
    for name, fitted in schedule.fitted.items():
        joint = robot.joints[name]
        commands[joint.bus] += len(fitted.received_s)
        busy_us[joint.bus] += len(fitted.received_s) * slot_us(joint, robot)
        span_s = max(span_s, float(fitted.received_s.max(initial=from_s)) - from_s)
    worst = max(busy_us, key=lambda bus: busy_us[bus])
    ratio = s_from_us(busy_us[worst]) / span_s
    return LineLoadError(
        f"bus {worst!r} at {robot.buses[worst].baud_bps} bps cannot carry {what}: "
        f"{commands[worst]} commands need {ratio:.0%} of the line and some would be "
        f"{schedule.late_max_us / 1e3:.0f} ms late, even with a tolerance of "
        f"{schedule.tolerance_deg:.2g} deg. What would help: {remedies}",
        bus=worst,
        utilisation_ratio=ratio,
    )
