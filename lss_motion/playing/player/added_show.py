"""Shows that are played beside the present one, on joints of their own and with own show clocks.

An `AddedShow` has its own approach, and its servos are polled by the streamer of the present show.
Where that asks all servos in a dialogue whether they have arrived, the readings of the approach
itself must do here, since the other joints move. `AddedShows` are those of one run, also those that
begin as soon as the present show plays or all joints hold.
"""

from __future__ import annotations

from enum import Enum, auto
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.playing.player.cues import Agenda
from lss_motion.playing.player.events import ShowBegan, ShowOver, Warned
from lss_motion.playing.player.repertoire import summary_of
from lss_motion.playing.player.session import Arrival
from lss_motion.units import NS_PER_MS, NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event, ShowOutcome
    from lss_motion.playing.player.repertoire import PresentShow, Repertoire
    from lss_motion.playing.player.session import Session
    from lss_motion.playing.player.streamer import Streamer

LINE_RATIO: Final = 0.85
"""Shows that are played together may use so much of a line, each in its busiest 100 ms, if these
fall together. Chosen: the rest is for queries, and for moves that wait for each other."""

COUNT_IN_NS: Final = 50 * NS_PER_MS
"""Time from the arrival of its joints to the first instant. Chosen: to prepare a show of a few
joints takes milliseconds."""
STILL_NS: Final = 100 * NS_PER_MS
"""Readings so long before the end of an approach are of joints at rest: it waits longer for them to
settle (`streamer.SETTLE_S`)."""
READINGS_NS: Final = 3 * NS_PER_S
"""The longest wait for readings of all joints. Chosen: each is read ten times a second, and a servo
that is silent is a fault before this."""


class _AddedStep(Enum):
    APPROACH = auto()
    SHOW = auto()
    BRAKE = auto()
    OVER = auto()


class AddedShow:
    """One show beside another. Its owner calls `advance` before it advances the other show."""

    def __init__(
        self, program: Program, start_s: float | None, session: Session, now_ns: int
    ) -> None:
        """Begin the approach at once. The joints of `program` must rest."""
        self.program = program
        self.astray: tuple[str, float, int] | None = None
        """The joint that did not arrive, by how much, and after how many approaches."""
        self._session = session
        self._start_s = start_s
        self._show: Streamer | None = None
        self._agenda = Agenda(program, session.robot)
        self._agenda.begin_at(start_s)
        self._began_ns: int | None = None
        self._finished_ns: int | None = None
        """When the approach had come to its end."""
        self._approaches = 0
        self._is_held = False
        """Whether all shows brake for a fault or a stop: nothing begins meanwhile."""
        self._step = _AddedStep.APPROACH
        session.note_standing(now_ns)
        self.streamer = self._approach(now_ns)

    @property
    def joints(self) -> set[str]:
        return set(self.program.start_deg)

    @property
    def is_over(self) -> bool:
        """Whether it has ended and its joints rest."""
        return self._step is _AddedStep.OVER

    @property
    def is_leaving(self) -> bool:
        return self._step in (_AddedStep.BRAKE, _AddedStep.OVER)

    def pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return where its joints are to be, or to begin."""
        if self._show is not None:
            return self._show.pose_deg(now_ns)
        return self._session.start_of(self.program, self._start_s)

    def advance(self, now_ns: int) -> list[Event]:
        """Hand over the moves that are due; return what has happened."""
        events: list[Event] = []
        if self._step is _AddedStep.SHOW:
            events += self._agenda.advance(self.streamer, self._session.lines, now_ns)
        self.streamer.advance(now_ns)
        if self._is_held:
            return events
        if self._step is _AddedStep.APPROACH and self.streamer.is_finished(now_ns):
            events += self._arrive(now_ns)
        elif self._step is _AddedStep.SHOW and self.streamer.is_finished(now_ns):
            events += self.end("finished", now_ns)
        elif self._step is _AddedStep.BRAKE and self.streamer.is_standing(now_ns):
            events += self.end("left", now_ns)
        return events

    def next_wakeup_ns(self, now_ns: int) -> int | None:
        """Return when `advance` must be called again at the latest."""
        wakeups_ns = [self.streamer.next_wakeup_ns(now_ns)]
        if self._step is _AddedStep.SHOW:
            wakeups_ns.append(self._agenda.wakeup_ns(self._show, self._session.lines, now_ns))
        return min((w for w in wakeups_ns if w is not None), default=None)

    # ---- what its owner decides

    def leave(self, now_ns: int) -> None:
        """Brake; then it is over."""
        if not self.is_leaving:
            self.streamer.set_rate(0.0, now_ns)
            self._step = _AddedStep.BRAKE

    def hold(self, now_ns: int) -> None:
        """Brake, and stand there until `go_on`."""
        self._is_held = True
        self.streamer.set_rate(0.0, now_ns)

    def set_rate(self, rate: float, rate_max: float, now_ns: int) -> None:
        """Play at `rate` as far as the faults allow it, which concerns the approach, too."""
        rate = min(rate, rate_max) if self._step is _AddedStep.SHOW else rate_max
        if not (self.is_leaving or self._is_held):
            self.streamer.set_rate(rate, now_ns)

    def go_on(self, now_ns: int) -> list[Event]:
        """Go on after an approach of all joints has led to `pose_deg`."""
        self._is_held = False
        if self._show is None:
            return self._begin(now_ns)
        self._session.resume(self._show, now_ns)
        self.streamer = self._show
        return []

    def end(self, outcome: ShowOutcome, now_ns: int) -> list[Event]:
        """Note that it is over; return what is reported of it."""
        self._step = _AddedStep.OVER
        began_ns, self._began_ns = self._began_ns, None
        if self._show is None or began_ns is None:
            return []
        summary = summary_of(
            self.program,
            self._show,
            outcome=outcome,
            from_s=self._start_s or 0.0,
            began_ns=began_ns,
            ended_ns=now_ns,
            joints=self.joints,
            is_added=True,
        )
        return [ShowOver(summary)]

    # ---- its approach

    def _approach(self, now_ns: int) -> Streamer:
        self._approaches += 1
        self._finished_ns = None
        pose_deg = self._session.start_of(self.program, self._start_s)
        left_out = self._session.left_out
        pose_deg = {name: deg for name, deg in pose_deg.items() if name not in left_out}
        return self._session.approach(pose_deg, now_ns, is_beside=True)

    def _arrive(self, now_ns: int) -> list[Event]:
        """Begin if every joint is where the show begins; else approach again, or give up."""
        session = self._session
        if self._finished_ns is None:
            self._finished_ns = now_ns
        if not session.has_feedback:
            return self._begin(now_ns)
        is_read = session.note_readings(self.streamer, s_from_ns(self._finished_ns - STILL_NS))
        if not is_read and now_ns < self._finished_ns + READINGS_NS:
            return []
        names = self.streamer.joint_states
        place_deg = {n: deg for n, deg in self.pose_deg(now_ns).items() if n in names}
        match session.judge_arrival(place_deg, self._approaches, now_ns):
            case Arrival.THERE, _, _:
                return self._begin(now_ns)
            case Arrival.AGAIN, _, _:
                self.streamer = self._approach(now_ns)
            case Arrival.ASTRAY, joint, off_deg:
                self.astray = joint, off_deg, self._approaches
                self._step = _AddedStep.OVER
        return []

    def _begin(self, now_ns: int) -> list[Event]:
        start_ns = now_ns + COUNT_IN_NS
        self.streamer = self._show = self._session.begin(
            self.program, self._start_s, start_ns, is_beside=True
        )
        self._step, self._began_ns = _AddedStep.SHOW, now_ns
        return [ShowBegan(self.program.name, self._start_s or 0.0, is_added=True)]


class AddedShows:
    """The added shows of one run, in the order in which they began."""

    def __init__(self, repertoire: Repertoire, session: Session, present: PresentShow) -> None:
        self.shows: list[AddedShow] = []
        self.is_together = False
        """After a recovery: one approach leads all joints to where their shows go on."""
        self._repertoire = repertoire
        self._session = session
        self._present = present
        self._waiting: list[tuple[Program, float | None]] = []

    @property
    def apart(self) -> Sequence[AddedShow]:
        """The shows that have streamers of their own now."""
        return () if self.is_together else self.shows

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the shows, also of those that have not begun."""
        programs = (*(one.program for one in self.shows), *(one for one, _ in self._waiting))
        return tuple(program.name for program in programs)

    def places(self, deg: Mapping[str, float], now_ns: int) -> dict[str, float]:
        """Return these joint angles, after a recovery with those at which the shows go on."""
        places_deg = dict(deg)
        for one in self.shows if self.is_together else ():
            own_deg = one.pose_deg(now_ns)
            places_deg |= {name: own_deg[name] for name in own_deg if name in deg}
        return places_deg

    def require(self, program: Program) -> None:
        """Raise `InputError` if `program` cannot be played beside the present show and these.

        If another show is to take the place of the present one, that counts.
        """
        self._repertoire.require(program)
        main = self._present.coming
        others = [
            *([] if main is None else [main]),
            *(one.program for one in self.shows if not one.is_leaving),
            *(one for one, _ in self._waiting),
        ]
        for other in others:
            if shared := [name for name in program.start_deg if name in other.start_deg]:
                raise InputError(
                    f"show {program.name!r} cannot be added: show {other.name!r} moves its joint "
                    f"{shared[0]!r}; play it in place of that show, or after it"
                )
        if what := why_not_beside(program):
            raise InputError(
                f"show {program.name!r} cannot be added: it {what}, which only the show that plays "
                f"alone can; play it in place of the other, or take that part out"
            )
        for bus, use in program.line_use.items():
            uses = [other.line_use[bus] for other in others if bus in other.line_use]
            ratio = sum(one.worst_100_ms_ratio for one in (*uses, use))
            if ratio > LINE_RATIO:
                raise InputError(
                    f"show {program.name!r} cannot be added: together the shows need "
                    f"{100.0 * ratio:.0f} % of line {bus!r} in their busiest 100 ms, and have "
                    f"{100.0 * LINE_RATIO:.0f} %; raise the baud rate, or use a second bus"
                )

    def add(self, program: Program, start_s: float | None) -> None:
        """Let a show begin at the next `begin_waiting`."""
        self._waiting.append((program, start_s))

    def begin_waiting(self, polling: Streamer | None, now_ns: int) -> list[Event]:
        """Begin the shows that were added, beside `polling`; return what is reported."""
        if self.is_together:
            return []
        events: list[Event] = []
        waiting, self._waiting = self._waiting, []
        for program, start_s in waiting:
            try:
                self.require(program)  # Another one may have come meanwhile.
            except InputError as refused:
                events.append(Warned(str(refused)))
                continue
            self.shows.append(AddedShow(program, start_s, self._session, now_ns))
        self._share_lines(polling)
        return events

    def leave(self, shows: Collection[AddedShow], now_ns: int) -> list[Event]:
        """Brake some of these; after a recovery all stand, so they are over at once."""
        events: list[Event] = []
        for one in shows:
            if self.is_together:
                events += one.end("left", now_ns)
                self.shows.remove(one)
            else:
                one.leave(now_ns)
        return events

    def end(self, name: str, now_ns: int) -> list[Event]:
        """Brake the show of this name, or let it not begin; return what is reported."""
        self._waiting = [waits for waits in self._waiting if waits[0].name != name]
        return self.leave([one for one in self.shows if one.program.name == name], now_ns)

    def end_all(self, outcome: ShowOutcome, now_ns: int) -> list[Event]:
        """Note that all shows are over; return what is reported."""
        events = [event for one in self.shows for event in one.end(outcome, now_ns)]
        self.shows.clear()
        return events

    def hold(self, now_ns: int) -> None:
        """Brake all, and stand there until `go_on`."""
        for one in self.apart:
            one.hold(now_ns)

    def come_together(self, polling: Streamer | None, now_ns: int) -> list[Event]:
        """Let one approach lead all joints, which stand; return what is reported."""
        events: list[Event] = []
        for one in [one for one in self.shows if one.is_leaving]:
            events += one.end("left", now_ns)
            self._take_back(one, polling, now_ns)
        self.is_together, self._session.beside = True, []
        return events

    def go_on(self, polling: Streamer | None, now_ns: int) -> list[Event]:
        """Go on where an approach of all joints has led them; return what is reported."""
        self.is_together = False
        events = [event for one in self.shows for event in one.go_on(now_ns)]
        self._share_lines(polling)
        return events

    def take_back(self, polling: Streamer | None, now_ns: int) -> None:
        """Let the present show hold the joints of those that are over."""
        self._share_lines(polling)
        for one in [one for one in self.apart if one.is_over]:
            self._take_back(one, polling, now_ns)

    def _take_back(self, one: AddedShow, polling: Streamer | None, now_ns: int) -> None:
        self.shows.remove(one)
        self._share_lines(polling)
        self._present.hold_also(one.streamer.pose_deg(now_ns))
        states = self._session.take_back(self._present.program, one.streamer, now_ns)
        streamers = [self._present.streamer]
        if polling is not self._present.streamer:
            streamers.append(polling)
        for streamer in filter(None, streamers):
            streamer.adopt(states)
            streamer.play_beside(self._session.beside)

    def _share_lines(self, polling: Streamer | None) -> None:
        """Let the servos of all these shows be polled by the streamer of the present one."""
        streamers = [one.streamer for one in self.apart]
        if streamers != self._session.beside:
            self._session.beside = streamers
            if polling is not None:
                polling.play_beside(streamers)


def why_not_beside(program: Program) -> str:
    """Return what only a program can do that plays alone; empty if this one can be added.

    A wait stops the show clock of the run, and the sounds are on one clock.
    """
    if program.waits:
        return "waits for a sensor"
    return "has sounds" if any(cue.sound for cue in program.cues) else ""
