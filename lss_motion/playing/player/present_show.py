"""The present show of a run: its program, its clock once it has begun, and how it went.

Of a run with many shows, `PresentShow` also keeps which one is next, and where the joints are held
that no show moves. `summary_of` is how one show went, in a few numbers: for the log and for what
decides about the next one. A run may play thousands of shows, so it is small, has no traces, and is
made in less than a millisecond, between two moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from msgspec.structs import replace

from lss_motion.playing.player.events import JointSummary, Phase, ShowBegan, ShowOver, ShowSummary

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.program.splice import Extension
    from lss_motion.playing.player.events import Event, ShowOutcome
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.player.session import Session
    from lss_motion.playing.player.streamer import Streamer


class Start(NamedTuple):
    """A program and the show time from which it is played; None: its beginning."""

    program: Program | None
    """None: no show, all joints hold."""
    start_s: float | None


class PresentShow:
    """What a run plays now, on all joints that no added show moves."""

    def __init__(
        self,
        repertoire: Repertoire,
        session: Session,
        first: Program | None,
        start_s: float | None,
        *,
        is_open: bool,
    ) -> None:
        """Begin with the only program of the repertoire, or let `first` be the next one."""
        self._repertoire = repertoire
        self._session = session
        self.program = session.program
        """The program with all joints of the run; before the first show, what all need together."""
        self.own = repertoire.only
        """The program without the joints that it does not move; None: all hold."""
        self.start_s = start_s
        self.streamer: Streamer | None = None
        """The show itself, once it has begun."""
        self.next = None if self.own is not None else Start(first, start_s)
        """What is played once the robot stands, in place of this."""
        self.changes = 0
        """How often another program has taken the place of the one before it."""
        self.is_open = self.was_open = is_open
        """Whether the show may be extended, so that it does not end; and whether it began so."""
        self.is_held = False
        """Whether a show that is to begin stands before its start until `Player.run_from`."""
        self.held_deg: dict[str, float] = {}
        """Joint angles where the joints are to stand that no show moves."""
        self.ended_ns: int | None = None
        """When the show had ended but for its goal tolerances."""
        self.goal_ns: int | None = None
        """When the time of a joint to come within its goal tolerance is over."""
        self._began_ns: int | None = None
        """When it began; None: it has not, all hold, or the run ends with it: its report is that
        of the run."""

    @property
    def phase(self) -> Phase:
        """Return the phase in which this is played."""
        return Phase.STANDING if self.own is None else Phase.SHOW

    @property
    def joints(self) -> set[str]:
        """Return the joints that the show moves."""
        return set() if self.own is None else set(self.own.start_deg)

    @property
    def coming(self) -> Program | None:
        """Return the show, or that which takes its place; None: all hold."""
        return self.own if self.next is None else self.next.program

    def hold_at(self, servo_deg: Mapping[str, float]) -> None:
        """Hold the joints that no show moves at these servo angles."""
        joints = self._session.robot.joints
        self.held_deg = {name: joints[name].joint_deg(deg) for name, deg in servo_deg.items()}

    def change(self, outcome: ShowOutcome, last: Streamer | None, now_ns: int) -> list[Event]:
        """Let the next program take this place, where all joints stand; return what is reported.

        `last` has moved the joints until now.
        """
        assert self.next is not None
        events = self.over(outcome, now_ns)
        if last is not None:
            self.held_deg |= last.pose_deg(now_ns)
        (self.own, self.start_s), self.next = self.next, None
        self.changes += 1
        self.program = self._whole()
        self._session.change(self.program, self.start_s)
        self.streamer = self.ended_ns = self.goal_ns = None
        return events

    def hold_also(self, deg: Mapping[str, float]) -> None:
        """Hold these joints, of a show that is over, where they are."""
        self.held_deg |= deg
        if self.streamer is None:
            self.program = self._whole()
            self._session.hold(self.program)

    def _whole(self) -> Program:
        """Return the present program with all joints of the run."""
        if self.own is None:
            return self._repertoire.standing(self.held_deg)
        return self._repertoire.widened(self.own, self.held_deg)

    def begin(self, start_ns: int) -> Streamer:
        """Return the streamer of the show, which starts at `start_ns`."""
        self.streamer = self._session.begin(start_ns, is_open=self.is_open)
        return self.streamer

    def begun(self, now_ns: int) -> list[Event]:
        """Note that a show begins, if one does; return what is reported of it."""
        if self.streamer is not None or self.own is None or self._repertoire.only is not None:
            return []
        self._began_ns = now_ns
        return [ShowBegan(self.program.name, self.start_s or 0.0)]

    def over(self, outcome: ShowOutcome, now_ns: int) -> list[Event]:
        """Note that the show is over; return what is reported of it, if it has begun."""
        began_ns, self._began_ns = self._began_ns, None
        if self.streamer is None or began_ns is None:
            return []
        summary = summary_of(
            self.program,
            self.streamer,
            outcome=outcome,
            from_s=self.start_s or 0.0,
            began_ns=began_ns,
            ended_ns=now_ns,
            joints=self.joints,
        )
        return [ShowOver(summary)]

    def extend(self, extension: Extension, now_ns: int) -> bool:
        """Go on with `extension` from its splice on; False if it is too late.

        `program` keeps the moves that it had at the start.
        """
        if self.streamer is None or not self.streamer.extend(extension, now_ns):
            return False
        end_s, use = extension.duration_s, extension.line_use
        self.program = replace(self.program, duration_s=end_s, line_use=use)
        return True

    def close(self) -> None:
        """Accept no more extensions."""
        self.is_open = False
        if self.streamer is not None:
            self.streamer.close()


def summary_of(
    program: Program,
    show: Streamer,
    *,
    outcome: ShowOutcome,
    from_s: float,
    began_ns: int,
    ended_ns: int,
    joints: Collection[str],
    is_added: bool = False,
) -> ShowSummary:
    """Return the summary of a show that is over at `ended_ns` and has moved `joints`."""
    timing = show.statistics.timing()
    states = show.joint_states
    reached_s = min(max(show.show_s(ended_ns), 0.0), program.duration_s)
    return ShowSummary(
        name=program.name,
        outcome=outcome,
        is_added=is_added,
        from_s=from_s,
        reached_s=reached_s,
        began_ns=began_ns,
        ended_ns=ended_ns,
        commands=timing["commands"],
        missed=timing["missed"],
        late_max_us=timing["late_max_us"],
        joints={name: _joint(states[name]) for name in states if name in joints},
    )


def _joint(state: JointState) -> JointSummary:
    load = state.disturbance
    return JointSummary(
        error_rms_deg=round(load.error_rms_deg, 3),
        error_max_deg=round(load.error_max_deg, 3),
        resent=state.resent,
        temperature_max_c=state.temperature_max_c,
        voltage_min_v=state.voltage_min_v,
        current_max_a=state.current_max_a,
    )
