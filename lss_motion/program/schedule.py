"""All joints fitted at one tolerance, on the lines that they share.

What is tried, and in which order, until a show fits its lines.

Where a pass that is repeated joins itself: every servo goes on as it began the pass.

How often the servos of a line can be asked where they are, between the commands of a program.

A query leaves only if the line is free again before the next command is due, so what counts are the
whole queries that fit into each gap. Answers come on a line of their own, one after the other.

Chooses the drive of joints whose robot file says `drive: auto`, and says why.

Each drive that the servo can do is fitted, alone, and predicted: how far its horn would be from the
plan, with what nobody can know about the servo added. That is the instant, within its control loop
or within its filter's period, at which it takes up a command.
"""

from __future__ import annotations

import heapq
import math
from collections import defaultdict
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from lss_motion.program.drives import late_max_s, longest_move, make_fitter
from lss_motion.program.fit import RIVALRY_S, TURN_S, TimedFit
from lss_motion.program.line import LineSchedule
from lss_motion.program.model import Move
from lss_motion.program.moves import fitted_profiles
from lss_motion.program.reference import GRID_S, servo_limits
from lss_motion.protocol.constants import BAUD_RATES_BPS
from lss_motion.protocol.line import Command, Reply, encode
from lss_motion.robot.servo_models import FAMILIES, FILTER_FIRMWARE_MIN, can_be_streamed
from lss_motion.units import NS_PER_US, US_PER_S, line_time_ns, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from lss_motion.program.drives import JointFitter
    from lss_motion.program.fit import Grant
    from lss_motion.program.model import Repeat
    from lss_motion.program.moves import Begin
    from lss_motion.program.reference import Reference
    from lss_motion.program.response import FloatArray, IntArray, PiecewiseProfile
    from lss_motion.robot.model import Drive, Joint, Robot

    ReferencesOf = Callable[[Robot], Mapping[str, Reference]]


@dataclass(frozen=True, slots=True)
class Fitted:
    """The moves of one joint in order, and the profile they make. A T of NaN is a bare `D`."""

    heard_s: FloatArray
    target_wire: FloatArray
    duration_ms: FloatArray
    reference: PiecewiseProfile


class _Slot(NamedTuple):
    """What the commands of one joint take of the line."""

    bus: str
    size_us: int
    late_max_us: int


class TooLateError(Exception):
    """A command found no slot in time: the attempt is worth nothing to whom said so before."""


class Schedule:
    """All joints at one tolerance. `is_tight`: some command is later than its drive allows.

    Joints that are not timed come first: their commands have fixed instants, while the fit of a
    timed joint makes up for every move that the line grants it early.
    """

    def __init__(
        self,
        courses: Mapping[str, Reference],
        robot: Robot,
        tolerance_deg: float,
        seams_s: Sequence[float] = (),
        *,
        begins: Mapping[str, Begin] | None = None,
        lines: Mapping[str, LineSchedule] | None = None,
        turn_s: float = TURN_S,
        gives_up: Literal["late", "tight"] | None = None,
    ) -> None:
        """Fit `courses`, all on one grid. `seams_s`, `begins` (of timed joints), `turn_s`: `Fit`.

        `lines` holds what is reserved already; no move is due before the courses begin. With
        `gives_up`, raises `TooLateError` as soon as a command is late: `"tight"`, later than its
        drive allows.
        """
        self.tolerance_deg = tolerance_deg
        self.fitted: dict[str, Fitted] = {}
        self.late_max_us = 0
        self.is_tight = False
        self._start_us = us_from_s(
            min((course.start_s for course in courses.values()), default=0.0)
        )
        self._lines = {bus: (lines or {}).get(bus, LineSchedule()) for bus in robot.buses}
        self._begins, self._turn_s, self._gives_up = begins or {}, turn_s, gives_up
        self._slots = {
            name: _Slot(
                robot.joints[name].bus,
                slot_us(robot.joints[name], robot),
                us_from_s(late_max_s(robot.joints[name])),
            )
            for name in courses
        }
        is_timed = {name: robot.joints[name].drive == "timed" for name in courses}
        self._fit_each(
            {
                name: make_fitter(robot.joints[name], course, tolerance_deg, seams_s)
                for name, course in courses.items()
                if not is_timed[name]
            }
        )
        if any(is_timed.values()):
            timed = [robot.joints[name] for name in courses if is_timed[name]]
            self._fit_timed(timed, courses, tolerance_deg, seams_s)

    def _fit_each(self, fitters: Mapping[str, JointFitter]) -> None:
        """Have the fitters' commands granted one by one, whoever comes first in time."""
        queue: list[tuple[float, str]] = []
        for name, fitter in fitters.items():
            if (wanted_s := fitter.wanted(None)) is not None:
                heapq.heappush(queue, (wanted_s, name))
        last_s = dict.fromkeys(fitters, s_from_us(self._start_us))
        while queue:
            wanted_s, name = heapq.heappop(queue)
            granted_us = self._grant(
                self._slots[name], us_from_s(wanted_s), us_from_s(last_s[name])
            )
            last_s[name] = s_from_us(granted_us)
            fitters[name].grant(last_s[name])
            next_s = fitters[name].wanted(last_s[name])
            if next_s is not None:
                heapq.heappush(queue, (next_s, name))
        for name, fitter in fitters.items():
            columns = zip(*fitter.moves, strict=True) if fitter.moves else ((), (), ())
            heard_s, target_wire, duration_ms = (np.array(column, float) for column in columns)
            reached = fitter.reference()
            self.fitted[name] = Fitted(heard_s, target_wire, duration_ms, reached)

    def _fit_timed(
        self,
        joints: Sequence[Joint],
        courses: Mapping[str, Reference],
        tolerance_deg: float,
        seams_s: Sequence[float],
    ) -> None:
        """Fit all timed joints together; where that is tried again, the line is as it was."""
        free = {name: line.copy() for name, line in self._lines.items()}
        before = self.late_max_us, self.is_tight

        def new_line() -> Grant:
            self._lines = {name: line.copy() for name, line in free.items()}
            self.late_max_us, self.is_tight = before
            return grant

        names = [joint.name for joint in joints]
        grant = self._grant_of(names)
        own = [courses[name] for name in names]
        limits = [servo_limits(joint, tolerance_deg) for joint in joints]
        begins = [self._begins[name] for name in names if name in self._begins]
        moves = TimedFit(own, limits, seams_s, begins, self._turn_s).moves(new_line)
        made = fitted_profiles(moves, own, limits, begins)
        for index, (name, reference) in enumerate(zip(names, made, strict=True)):
            some = moves.of(index)
            self.fitted[name] = Fitted(some.heard_s, some.target_wire, some.duration_ms, reference)

    def _grant_of(self, names: Sequence[str]) -> Grant:
        """Return what does `_grant` for many moves at once, of joints that count `names`."""
        buses, sizes_us, lates_us = zip(*(self._slots[name] for name in names), strict=True)
        size_us, allowed_us = np.array(sizes_us), np.array(lates_us)
        of_bus = np.array([list(self._lines).index(bus) for bus in buses])

        def grant(joint: IntArray, wanted_us: IntArray, after_us: IntArray) -> IntArray:
            received_us, own_us, bus = np.empty_like(wanted_us), size_us[joint], of_bus[joint]
            earliest_us = np.maximum(after_us - own_us, self._start_us)
            for index, line in enumerate(self._lines.values()):
                some = np.flatnonzero(bus == index)
                columns = (column[some] for column in (wanted_us, own_us, earliest_us))
                received_us[some] = line.reserve_all(*columns)
            late_us = received_us - wanted_us
            is_tight = bool(np.any(late_us > allowed_us[joint]))
            self._note_late(int(late_us.max(initial=0)), is_tight=is_tight)
            return received_us

        return grant

    def _grant(self, slot: _Slot, wanted_us: int, after_us: int) -> int:
        """Reserve the line for the next move of a joint; return when that move is heard.

        It is not heard before `after_us`, and at `wanted_us` if possible at the latest.
        """
        bus, size_us, late_max_us = slot
        earliest_us = max(after_us - size_us, self._start_us)
        received_us = self._lines[bus].reserve(wanted_us, size_us, earliest_us)
        late_us = max(received_us - wanted_us, 0)
        self._note_late(late_us, is_tight=late_us > late_max_us)
        return received_us

    def _note_late(self, late_us: int, *, is_tight: bool) -> None:
        """Note that moves are heard so late, 0 for none, and whether a drive allows less."""
        self.late_max_us = max(self.late_max_us, late_us)
        self.is_tight = self.is_tight or is_tight
        if self._gives_up is not None and (self.is_tight or (late_us and self._gives_up == "late")):
            raise TooLateError


def fitted_alone(joint: Joint, course: Reference, tolerance_deg: float) -> PiecewiseProfile:
    """Return the profile that one joint's moves make if every one is heard when it is wanted."""
    if joint.drive == "timed":
        limits = servo_limits(joint, tolerance_deg)
        moves = TimedFit([course], [limits]).moves(
            lambda: lambda _joints, wanted_us, _after_us: wanted_us
        )
        return fitted_profiles(moves, [course], [limits])[0]
    fitter = make_fitter(joint, course, tolerance_deg)
    wanted_s = fitter.wanted(None)
    while wanted_s is not None:
        fitter.grant(wanted_s)
        wanted_s = fitter.wanted(wanted_s)
    return fitter.reference()


def slot_us(joint: Joint, robot: Robot) -> int:
    """Return the line time of the longest move that the joint can be sent."""
    return sent_us(len(longest_move(joint)), robot.buses[joint.bus].baud_bps)


def sent_us(size_bytes: int, baud_bps: int) -> int:
    """Return the line time of so many bytes in whole microseconds, rounded up."""
    return -(-line_time_ns(size_bytes, baud_bps) // NS_PER_US)


RELAXED_RATIOS: Final = (1.0, 1.5, 2.5, 4.0, 6.0)
"""By how much the tolerance is relaxed, step by step, when the line is too slow."""
TIGHT_TURN_S: Final = 0.02
"""Where somebody was late for the line at first, when nobody waited for a turn, commands are placed
strictly in the order of time: a third more of them fit, in two to three times the time."""
SLOWEST_SHARED_BPS: Final = 115_200
"""The usual rate (FACTS.md W23: the default of every library). A slower line is fitted for itself
alone, or the usual one would pay for it with moves further from where they are wanted."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """One way to fit a show: as if for the lines of `robot`, with `ratio` times the tolerance."""

    robot: Robot
    ratio: float
    turn_s: float
    gives_up: Literal["late", "tight"] | None

    def attempt(
        self, courses: Mapping[str, Reference], tolerance_deg: float, seams_s: Sequence[float]
    ) -> Schedule:
        """Return the attempt; raises `TooLateError` as `Attempt` does."""
        return Schedule(
            courses,
            self.robot,
            self.ratio * tolerance_deg,
            seams_s,
            turn_s=self.turn_s,
            gives_up=self.gives_up,
        )


def candidates(robot: Robot, *, with_relaxed: bool) -> Iterator[Candidate]:
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
        yield Candidate(paced, 1.0, RIVALRY_S, "late")
        yield Candidate(paced, 1.0, TIGHT_TURN_S, "tight")
    if with_relaxed:
        for ratio in RELAXED_RATIOS[1:]:
            is_last = ratio == RELAXED_RATIOS[-1]
            yield Candidate(robot, ratio, TIGHT_TURN_S, None if is_last else "tight")


US_PER_MS: Final = 1_000

STRETCH_MAX_US: Final = 10_000
"""A move may last so much longer than planned. Chosen: at 1000 deg/s² the horn is 0.05 deg off."""


def closed_pass(moves: Iterable[Move], repeat: Repeat, robot: Robot) -> list[Move]:
    """Return the moves until the end of the repeated pass, so that it can follow itself.

    Commands around the two seams fall differently, as the line allows. Where the last move of the
    pass would have to wait for its successor longer than planned, the move that is under way when
    the pass begins is said again at its beginning.
    """
    own: dict[tuple[str, int], list[Move]] = defaultdict(list)
    for move in moves:
        own[move.bus, move.servo_id].append(move)
    kept = [move for mine in own.values() for move in mine if move.due_us < repeat.to_us]
    for mine in own.values():
        again = _said_again(mine, repeat)
        if again is None or again.duration_ms is None:
            continue
        due_us = _free_us(_taken(kept, again.bus, repeat, robot), repeat.from_us, again, robot)
        if due_us >= min(m.due_us for m in mine if m.due_us >= repeat.from_us):
            continue  # The line is so full that its successor comes first.
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


def _taken(moves: Iterable[Move], bus: str, repeat: Repeat, robot: Robot) -> list[tuple[int, int]]:
    """Return from when to when a line is busy after the first seam, with either pass before it."""
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


def _said_again(mine: list[Move], repeat: Repeat) -> Move | None:
    """Return the move under way at the first seam, if the one at the second cannot stand for it."""
    before = [move for move in mine if move.due_us < repeat.from_us]
    after_us = [m.due_us - repeat.from_us for m in mine if m.due_us >= repeat.from_us]
    planned_us = [m.due_us - repeat.to_us for m in mine if m.due_us >= repeat.to_us]
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


WINDOW_US: Final = US_PER_S
"""Readings are counted over a second: a joint that nobody heard of for so long is silent."""
TURNAROUND_US: Final = 1_800
"""From the end of a query to the start of its answer. Assumed: what the slowest firmware takes at
the most (FACTS.md W13, W14; not measured), with no two questions in flight."""


def reading_rate_hz(joints: Sequence[Joint], baud_bps: int, slots_us: IntArray) -> float:
    """Return how often each of `joints` can be read in the worst second of a line, all in turn.

    `slots_us`: `(due, size)` of every command, in order and disjoint. Infinite without joints.
    """
    if not joints:
        return float("inf")
    queries_us, replies_us = zip(*(_exchange_us(joint, baud_bps) for joint in joints), strict=True)
    answered = WINDOW_US / (TURNAROUND_US + sum(replies_us) / len(joints))
    return float(min(answered, _asked(max(queries_us), slots_us)) / len(joints))


def _asked(query_us: int, slots_us: IntArray) -> float:
    """Return how many queries fit between the commands of the worst second."""
    if not len(slots_us):
        return WINDOW_US / query_us
    due_us, size_us = slots_us.T
    opens_us = np.concatenate(([due_us[0] - 2 * WINDOW_US], due_us + size_us))
    ends_us = np.append(due_us, opens_us[-1] + 2 * WINDOW_US)
    fit = np.maximum(ends_us - opens_us, 0) // query_us
    full_us, total = opens_us + fit * query_us, np.cumsum(fit)
    # Queries that have left, as a line that climbs through each gap and is level elsewhere.
    instants_us = np.stack((opens_us, full_us), axis=1).ravel()
    left = np.stack((total - fit, total), axis=1).ravel().astype(np.float64)
    # Their number within a window stops falling where its end begins to climb, or its begin stops.
    edges_us = np.concatenate((opens_us, full_us + WINDOW_US, opens_us[:1] + WINDOW_US))
    edges_us = edges_us[(edges_us - WINDOW_US >= opens_us[0]) & (edges_us <= ends_us[-1])]
    within = np.interp(edges_us, instants_us, left)
    within -= np.interp(edges_us - WINDOW_US, instants_us, left)
    return float(within.min())


def _exchange_us(joint: Joint, baud_bps: int) -> tuple[int, int]:
    """Return the line time of asking a joint where it is, and of its longest answer."""
    ends_deg = map(joint.servo_deg, (joint.position_min_deg, joint.position_max_deg))
    wires = [round(end_deg * joint.model.wire_per_deg) for end_deg in ends_deg]
    replies = [encode(Reply(joint.servo_id, "QD", wire)) for wire in wires]
    query = encode(Command(joint.servo_id, "QD"))
    return sent_us(len(query), baud_bps), sent_us(max(map(len, replies)), baud_bps)


WORTH_RATIO: Final = 0.9
"""Streaming must predict this much better than timed moves. Chosen: those take less of the line,
and the servo itself keeps their limits."""
UNKNOWN_RATIO: Final = 1.0 / math.sqrt(12.0)
"""RMS of an instant that is equally likely anywhere in a period, in periods."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Choice:
    """A robot without `auto`, and why each of those joints is driven as it is."""

    robot: Robot
    reasons: Mapping[str, str] = field(default_factory=dict)


def choices(robot: Robot, courses: ReferencesOf, tolerance_deg: float) -> list[Choice]:
    """Return what predicts best first, then with fewer and fewer of its joints streamed.

    The last one streams only what cannot be timed. `courses` gives what the profiles of a robot
    have to do; only the joints of those are looked at.
    """
    opened = {n: j for n, j in robot.joints.items() if j.drive == "auto"}
    if not opened:
        return [Choice(robot=robot)]
    timed = courses(_with(robot, dict.fromkeys(opened, "timed")))
    streamed = courses(_with(robot, dict.fromkeys(opened, "streamed")))
    drives: dict[str, Drive] = {}
    reasons: dict[str, str] = {}
    gains: dict[str, float] = {}
    for name, joint in opened.items():
        family, reason = FAMILIES[joint.model.family], _only(joint, robot)
        drives[name] = "streamed" if _needs_filter(joint) else family.drives[0]
        if not reason and name in timed:
            by_ramps = predicted_deg(replace(joint, drive="timed"), timed[name], tolerance_deg)
            by_filter = predicted_deg(
                replace(joint, drive="streamed"), streamed[name], tolerance_deg
            )
            reason = f"timed predicts {by_ramps:.2f} deg RMS, streamed {by_filter:.2f} deg"
            if by_filter < WORTH_RATIO * by_ramps:
                drives[name] = "streamed"
                gains[name] = by_ramps - by_filter
        reasons[name] = f"{drives[name]}: {reason or 'the show does not move it'}"
    return _with_fewer(robot, drives, reasons, sorted(gains, key=lambda name: gains[name]))


def _with_fewer(
    robot: Robot, drives: Mapping[str, Drive], reasons: Mapping[str, str], by_gain: list[str]
) -> list[Choice]:
    """Return the choice, and those that time half of the rest of `by_gain`, least gain first."""
    found = [Choice(robot=_with(robot, drives), reasons=reasons)]
    while by_gain:
        cut = -(-len(by_gain) // 2)
        given_up, by_gain = by_gain[:cut], by_gain[cut:]
        drives = {**drives, **dict.fromkeys(given_up, "timed")}
        why = "timed: the line has no room to stream it;"
        reasons = {**reasons, **{n: f"{why} {reasons[n].partition(': ')[2]}" for n in given_up}}
        found.append(Choice(robot=_with(robot, drives), reasons=reasons))
    return found


def _with(robot: Robot, drives: Mapping[str, Drive]) -> Robot:
    changed = {name: replace(robot.joints[name], drive=drive) for name, drive in drives.items()}
    return replace(robot, joints={**robot.joints, **changed})


def _needs_filter(joint: Joint) -> bool:
    facts = FAMILIES[joint.model.family]
    return "streamed" in facts.drives and joint.accel_max_deg_s2 > facts.accel_max_deg_s2


def _only(joint: Joint, robot: Robot) -> str:
    """Return why the joint has no choice, or nothing if it has one."""
    if _needs_filter(joint):
        most = FAMILIES[joint.model.family].accel_max_deg_s2
        return f"{joint.accel_max_deg_s2:g} deg/s² is more than its ramps can express, {most:g}"
    if "streamed" not in FAMILIES[joint.model.family].drives:
        return f"a {joint.model.name} knows no other drive"
    if not can_be_streamed(joint, robot.buses[joint.bus]):
        return f"streaming needs firmware {FILTER_FIRMWARE_MIN}"
    return ""


def predicted_deg(joint: Joint, course: Reference, tolerance_deg: float) -> float:
    """Return the RMS of what a joint's horn will be off, fitted with nothing else on its line."""
    profile = fitted_alone(joint, course, tolerance_deg)
    times_s = course.start_s + GRID_S * np.arange(len(course.position_deg), dtype=np.float64)
    error_deg = profile.sample(times_s) - course.position_deg
    speed_deg_s = np.gradient(course.position_deg, GRID_S)
    period_s = joint.response.filter_s if joint.drive == "streamed" else joint.response.loop_s
    unknown_deg = UNKNOWN_RATIO * period_s * speed_deg_s
    return float(np.sqrt(np.mean(error_deg**2) + np.mean(unknown_deg**2)))
