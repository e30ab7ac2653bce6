"""All joints fitted at one tolerance, on the lines that they share."""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from lss_motion.program.course import servo_limits
from lss_motion.program.drives import late_max_s, longest_move, make_fitter
from lss_motion.program.fit import TURN_S, Fit
from lss_motion.program.line import LineSchedule
from lss_motion.program.moves import references
from lss_motion.units import NS_PER_US, line_time_ns, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.program.batch import FloatArray, IntArray
    from lss_motion.program.course import Course
    from lss_motion.program.drives import JointFitter
    from lss_motion.program.moves import Begin
    from lss_motion.program.response import Reference
    from lss_motion.program.run import Grant
    from lss_motion.robot.model import Joint, Robot


@dataclass(frozen=True, slots=True)
class Fitted:
    """The moves of one joint in order, and the profile they make. A T of NaN is a bare `D`."""

    heard_s: FloatArray
    target_wire: FloatArray
    duration_ms: FloatArray
    reference: Reference


class _Slot(NamedTuple):
    """What the commands of one joint take of the line."""

    bus: str
    size_us: int
    late_max_us: int


class TooLateError(Exception):
    """A command found no slot in time: the attempt is worth nothing to whom said so before."""


class Attempt:
    """All joints at one tolerance. `is_tight`: some command is later than its drive allows.

    Joints that are not timed come first: their commands have fixed instants, while the fit of a
    timed joint makes up for every move that the line grants it early.
    """

    def __init__(
        self,
        courses: Mapping[str, Course],
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
        courses: Mapping[str, Course],
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
        moves = Fit(own, limits, seams_s, begins, self._turn_s).moves(new_line)
        made = references(moves, own, limits, begins)
        for index, (name, reference) in enumerate(zip(names, made, strict=True)):
            some = moves.of(index)
            self.fitted[name] = Fitted(some.heard_s, some.target_wire, some.duration_ms, reference)

    def _grant_of(self, names: Sequence[str]) -> Grant:
        """Return what does `_grant` for many moves at once, of joints that count `names`."""
        buses, sizes_us, lates_us = zip(*(self._slots[name] for name in names), strict=True)
        size_us, allowed_us = np.array(sizes_us), np.array(lates_us)
        of_bus = np.array([list(self._lines).index(bus) for bus in buses])

        def grant(joint: IntArray, wanted_us: IntArray, after_us: IntArray) -> IntArray:
            heard_us, own_us, bus = np.empty_like(wanted_us), size_us[joint], of_bus[joint]
            earliest_us = np.maximum(after_us - own_us, self._start_us)
            for index, line in enumerate(self._lines.values()):
                some = np.flatnonzero(bus == index)
                columns = (column[some] for column in (wanted_us, own_us, earliest_us))
                heard_us[some] = line.reserve_all(*columns)
            late_us = heard_us - wanted_us
            is_tight = bool(np.any(late_us > allowed_us[joint]))
            self._note_late(int(late_us.max(initial=0)), is_tight=is_tight)
            return heard_us

        return grant

    def _grant(self, slot: _Slot, wanted_us: int, after_us: int) -> int:
        """Reserve the line for the next move of a joint; return when that move is heard.

        It is not heard before `after_us`, and at `wanted_us` if possible at the latest.
        """
        bus, size_us, late_max_us = slot
        earliest_us = max(after_us - size_us, self._start_us)
        heard_us = self._lines[bus].reserve(wanted_us, size_us, earliest_us)
        late_us = max(heard_us - wanted_us, 0)
        self._note_late(late_us, is_tight=late_us > late_max_us)
        return heard_us

    def _note_late(self, late_us: int, *, is_tight: bool) -> None:
        """Note that moves are heard so late, 0 for none, and whether a drive allows less."""
        self.late_max_us = max(self.late_max_us, late_us)
        self.is_tight = self.is_tight or is_tight
        if self._gives_up is not None and (self.is_tight or (late_us and self._gives_up == "late")):
            raise TooLateError


def fitted_alone(joint: Joint, course: Course, tolerance_deg: float) -> Reference:
    """Return the profile that one joint's moves make if every one is heard when it is wanted."""
    if joint.drive == "timed":
        limits = servo_limits(joint, tolerance_deg)
        moves = Fit([course], [limits]).moves(
            lambda: lambda _joints, wanted_us, _after_us: wanted_us
        )
        return references(moves, [course], [limits])[0]
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
