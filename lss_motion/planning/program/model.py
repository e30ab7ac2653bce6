"""The compiled show as a value: which bytes leave on which bus at which instant.

A `Program` never changes after it is compiled or read. The player sends its moves; the verifier
computes from the same moves what every servo will do.
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from itertools import count
from pathlib import Path
from typing import Final, NamedTuple, TypeVar

from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import counted, duration_text, known_names
from lss_motion.planning.program.line import LineUse
from lss_motion.planning.trajectory.model import GivenUp, Mark, SlowSpan, WaitPoint
from lss_motion.protocol.framing import encode_move
from lss_motion.robot.model import Drive, Joint, Robot
from lss_motion.robot.on_fault import Escalations
from lss_motion.show.model import Cue
from lss_motion.units import NS_PER_US, line_time_ns, s_from_us, us_from_s

T = TypeVar("T")

TOLERANCE_DEG: Final = 0.2
"""How far the predicted horn may be from the plan (FACTS.md A18)."""


class Move(NamedTuple):
    """One `D` command of a program. `due_us` is the show time at which its first byte leaves.

    `target_wire` is in the wire unit of the servo's family. A timed move lasts `duration_ms` from
    the instant at which the servo receives its last byte; None for the other drives, whose `D` has
    no T.
    """

    due_us: int
    bus: str
    servo_id: int
    target_wire: int
    duration_ms: int | None

    @property
    def data(self) -> bytes:
        return encode_move(self.servo_id, self.target_wire, self.duration_ms)


class Repeat(Struct, frozen=True, kw_only=True):
    """A part of the written program that is played `times`; None: until the show is stopped.

    What is written after the part is played after its last time, so much later.
    """

    from_us: int
    to_us: int
    times: int | None = None

    @property
    def period_us(self) -> int:
        return self.to_us - self.from_us

    @property
    def added_us(self) -> int:
        """How much longer the show is than it is written; 0 for one that never ends."""
        return 0 if self.times is None else (self.times - 1) * self.period_us


class Driving(Struct, frozen=True):
    """How a joint is commanded; `filter_count` is the FPC of a streamed joint, else 0."""

    drive: Drive
    filter_count: int = 0


TIMED: Final = Driving("timed")


def driving_of(robot: Robot, names: Iterable[str]) -> dict[str, Driving]:
    """Return how the joints that are not timed are commanded."""
    driving = {}
    for name in names:
        drive = robot.joints[name].drive
        assert drive != "auto", "`choices` has replaced it"
        count = robot.joints[name].filter_count if drive == "streamed" else 0
        driving[name] = Driving(drive, count)
    return {name: chosen for name, chosen in driving.items() if chosen != TIMED}


class Program(Struct, frozen=True, kw_only=True, dict=True):
    """Moves in order of `due_us`, and what the player needs to start and judge the show.

    Show time 0 is the start of the plan. Moves may be due before it, since they lead the horn.
    """

    name: str
    robot: str
    robot_path: Path | None = None
    moves: Sequence[Move]
    duration_s: float
    """Show time at which the last horn arrives; `math.inf` for a show that never ends."""
    start_deg: Mapping[str, float]
    """Angles at which the joints of the show must stand before it starts."""
    tolerance_deg: float
    drives: Mapping[str, Driving] = field(default_factory=dict)
    """The drives of the joints that are not timed."""
    drive_reasons: Mapping[str, str] = field(default_factory=dict)
    """Why a joint got its drive, as a text, for the joints with `drive: auto`."""
    repeat: Repeat | None = None
    marks: tuple[Mark, ...] = ()
    cues: tuple[Cue, ...] = ()
    """What is not motion, in order of the show time at which it happens."""
    waits: tuple[WaitPoint, ...] = ()
    """Where the show clock stands still until a sensor passes its threshold."""
    stretched: tuple[SlowSpan, ...] = ()
    given_up: tuple[GivenUp, ...] = ()
    line_use: Mapping[str, LineUse] = field(default_factory=dict)
    on_fault: Escalations = field(default_factory=dict)
    """The reactions to faults in which this show differs from its robot."""
    error_max_deg: Mapping[str, float] = field(default_factory=dict)
    """Largest distance, per joint, between the predicted horn and the plan."""
    bound_deg: Mapping[str, float] = field(default_factory=dict)
    """The largest to expect of a servo that is as assumed: its control tick may come sooner or
    later, and its horn follow as a first-order lag does."""
    fight_deg: Mapping[str, float] = field(default_factory=dict)
    """The largest angle by which servos of one joint are apart, by mechanism, on servos that are as
    assumed."""

    def __repr__(self) -> str:
        """Return one line: name, duration and counts."""
        duration = duration_text(self.duration_s)
        counts = f"{counted(self.start_deg, 'joint')}, {counted(self.moves, 'move')}"
        return f"Program({self.name!r}, {duration}, {counts})"

    def to_text(self, *, folder: Path | None = None) -> str:
        """Return the text form of the program, as `lss-motion compile` writes it.

        With `folder`, the robot file is named relative to it. `planning.program.text.from_text`
        reads it.
        """
        from lss_motion.planning.program.text import to_text

        return to_text(self, folder=folder)

    @property
    def is_endless(self) -> bool:
        """True if the show is played until it is stopped."""
        return self.repeat is not None and self.repeat.times is None

    @cached_property
    def pass_s(self) -> float:
        """Show time after which every part of the program has been played once."""
        if self.repeat is None:
            return self.duration_s
        if self.repeat.times is None:
            return s_from_us(self.repeat.to_us)
        return self.duration_s - s_from_us(self.repeat.added_us)

    def within(self, show_s: float) -> float:
        """Return the instant of the written program that is played at `show_s`."""
        if self.repeat is None or show_s < s_from_us(self.repeat.to_us):
            return show_s
        added_s = s_from_us(self.repeat.added_us)
        if self.repeat.times is not None and show_s >= s_from_us(self.repeat.to_us) + added_s:
            return show_s - added_s
        start_s = s_from_us(self.repeat.from_us)
        return start_s + math.fmod(show_s - start_s, s_from_us(self.repeat.period_us))

    def instant_of(self, place: float | str) -> float:
        """Return the show time of a place: a time within the show, or the label of a keyframe.

        A label stands for its first keyframe. Raises `InputError` for a place that does not exist.
        """
        if isinstance(place, str):
            named = {mark.label: mark.planned_s for mark in reversed(self.marks) if mark.label}
            if place not in named:
                known = known_names(place, reversed(named))
                raise InputError(f"no keyframe has the label {place!r}; {known}")
            return named[place]
        if not 0.0 <= place < self.duration_s:
            raise InputError(
                f"{place:g} s is not in the show, which ends at {self.duration_s:.3f} s"
            )
        return place

    def unrolled(self, from_s: float = 0.0) -> Iterator[tuple[int, Move]]:
        """Yield `(due_us, move)` in order of time, without end if the show has none.

        Passes of the repeated part that have ended before `from_s` may be left out.
        """
        if self.repeat is None:
            yield from ((move.due_us, move) for move in self.moves)
            return
        first = bisect_left(self.moves, self.repeat.from_us, key=lambda move: move.due_us)
        end = bisect_left(self.moves, self.repeat.to_us, key=lambda move: move.due_us)
        yield from ((move.due_us, move) for move in self.moves[:end])
        again = self.moves[first:end]
        for shift_us in self._shifts_us(from_s) if again else ():
            yield from ((move.due_us + shift_us, move) for move in again)
        added_us = self.repeat.added_us
        yield from ((move.due_us + added_us, move) for move in self.moves[end:])

    def _shifts_us(self, from_s: float = 0.0) -> Iterator[int]:
        """Yield how much later the part is played each time but the first.

        Of the times that have ended before `from_s`, all but the last two are left out: what began
        in them is under way.
        """
        assert self.repeat is not None
        times = self.repeat.times
        ended = (us_from_s(from_s) - self.repeat.to_us) // self.repeat.period_us
        first = max(1, ended - 1)
        counts = count(first) if times is None else range(min(first, times), times)
        return (number * self.repeat.period_us for number in counts)

    def repeated(self, times: int) -> Program:
        """Return the program with all moves written out and its part played `times`."""
        if self.repeat is None:
            return self
        fewer = replace(self, repeat=replace(self.repeat, times=times))
        moves = tuple(move._replace(due_us=due_us) for due_us, move in fewer.unrolled())
        return replace(fewer, moves=moves, repeat=None)

    def unrolled_marks(self, from_s: float = 0.0) -> Iterator[tuple[float, Mark]]:
        """Yield `(show time, mark)` in order, without end if the show has none; as `unrolled`."""
        marks = [(mark.planned_s, mark.planned_s, mark) for mark in self.marks]
        return self._unrolled(marks, from_s)

    def unrolled_cues(self, from_s: float = 0.0) -> Iterator[tuple[float, Cue]]:
        """Yield `(show time at which it starts, cue)` in order, as `unrolled_marks`."""
        return self._unrolled([(cue.start_s, cue.at_s, cue) for cue in self.cues], from_s)

    def unrolled_waits(self, from_s: float = 0.0) -> Iterator[tuple[float, WaitPoint]]:
        """Yield `(show time, wait)` in order, as `unrolled_marks`."""
        return self._unrolled([(point.at_s, point.at_s, point) for point in self.waits], from_s)

    def _unrolled(
        self, items: list[tuple[float, float, T]], from_s: float
    ) -> Iterator[tuple[float, T]]:
        """Yield items in order of their starts, given `(start, instant, item)` in show time.

        An item whose lead begins before the pass of its instant starts in the pass before.
        """
        if self.repeat is None:
            yield from sorted(((start_s, item) for start_s, _, item in items), key=_instant)
            return
        begin_s, to_s = s_from_us(self.repeat.from_us), s_from_us(self.repeat.to_us)
        again = [
            (start_s if start_s >= begin_s else start_s + to_s - begin_s, item)
            for start_s, at_s, item in items
            if begin_s <= at_s < to_s
        ]
        early = {id(item) for start_s, at_s, item in items if start_s < begin_s <= at_s}
        first = [(start_s, item) for start_s, at_s, item in items if at_s < to_s]
        first += [(start_s, item) for start_s, item in again if id(item) in early]
        yield from sorted(first, key=_instant)
        again.sort(key=_instant)
        for shift_us in self._shifts_us(from_s) if again else ():
            shift_s = s_from_us(shift_us)
            yield from ((start_s + shift_s, item) for start_s, item in again)
        # One that starts before the end of the part has been started by its last time.
        added_s = s_from_us(self.repeat.added_us)
        rest = [(start_s + added_s, item) for start_s, _, item in items if start_s >= to_s]
        yield from sorted(rest, key=_instant)


def _instant(due: tuple[float, T]) -> float:
    return due[0]


def target_deg(joint: Joint, target_wire: int) -> float:
    """Return the servo angle of `target_wire`."""
    return target_wire / joint.model.wire_per_deg


def received_us(move: Move, baud_bps: int) -> int:
    """Return when the last byte of `move` reaches the servos, if it leaves when it is due."""
    return move.due_us + line_time_ns(len(move.data), baud_bps) // NS_PER_US
