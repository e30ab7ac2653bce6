"""Plays many programs in one run: the servos are checked and set up once, and stay so.

    change_to(program, now_ns)   plays another program in place of the present one
    stop(now_ns)                 ends the run, as in a run of one program

Between two shows the robot is never without a streamer. What plays brakes; an approach leads to the
start of the next program; or a program without moves holds all joints (`Phase.STANDING`), and the
servos are polled, corrected and watched as in a show. A joint that the present program does not
move stays where it is. Faults, stalls, lost ports, signals and stops work in every phase as they do
in a run of one program.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from lss_motion.errors import InputError
from lss_motion.player.cues import SensorWatch
from lss_motion.player.events import Phase, ShowBegan, ShowOver
from lss_motion.player.player import PLAYING, Player
from lss_motion.player.query_choice import BY_NEED
from lss_motion.player.show_summary import JointSummary, ShowSummary

if TYPE_CHECKING:
    from collections.abc import Collection

    from lss_motion.player.joint_state import JointState
    from lss_motion.player.preflight import Preflight
    from lss_motion.player.query_choice import Pace
    from lss_motion.player.repertoire import Repertoire
    from lss_motion.player.show_summary import ShowOutcome
    from lss_motion.player.streamer import Streamer
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Robot


class _Next(NamedTuple):
    """The program that takes the place of the present one; None: all joints hold."""

    program: Program | None
    start_s: float | None


class StagePlayer(Player):
    """Plays the programs of a repertoire, one after the other, until it is stopped."""

    def __init__(
        self,
        repertoire: Repertoire,
        robot: Robot,
        *,
        first: Program | None = None,
        has_feedback: bool = True,
        must_ask: bool = False,
        is_forced: bool = False,
        pace: Pace | None = BY_NEED,
    ) -> None:
        """Begin with `first`; None: all joints hold where they are. The others: see `Player`."""
        if first is not None:
            repertoire.require(first)
        super().__init__(
            repertoire.needs(first),
            robot,
            has_feedback=has_feedback,
            must_ask=must_ask,
            is_forced=is_forced,
            pace=pace,
        )
        self.repertoire = repertoire
        self.watched = SensorWatch(self.robot.sensors[name] for name in repertoire.watched)
        """The sensors of the repertoire that a caller watches."""
        self._session.watched = self.watched
        self._held_deg: dict[str, float] = {}
        """Joint angles where the joints are to stand that no show moves."""
        self._next: _Next | None = _Next(first, None)
        """What is played once the robot stands, in place of the present program."""
        self._played: Program | None = None
        """The present program, without the joints that it does not move; None: all hold."""
        self._began_ns: int | None = None
        """When the present show began; None: it has not, or nothing is played."""

    # ---- state

    @property
    def is_idle(self) -> bool:
        """Whether all joints hold, and no show is to come."""
        return self.phase is Phase.STANDING

    @property
    def moved_joints(self) -> set[str]:
        """The joints of the present show."""
        return set() if self._played is None else set(self._played.start_deg)

    @property
    def is_leaving(self) -> bool:
        return self._next is not None

    def show_s(self, now_ns: int) -> float:
        """Return the show time of the present show; 0 before it has begun."""
        return 0.0 if self.show is None else self.show.show_s(now_ns)

    # ---- commands

    def change_to(
        self, program: Program | None, now_ns: int, *, start_s: float | None = None
    ) -> None:
        """Play another program in place of the present one, from `start_s` on; None: only hold.

        What plays brakes; if it rests, the way to the new start begins at once. Raises `InputError`
        for a program that the run was not prepared for, and while it recovers or ends.
        """
        if program is not None:
            self.repertoire.require(program)
            start_s = None if start_s is None else program.instant_of(start_s)
        if self.phase in (Phase.RECOVER, Phase.STOP, Phase.RESTORE, Phase.DONE):
            raise InputError(f"no other show can begin now, the run is {self.phase.value}")
        self._note_stall(now_ns)
        self._next, self._seek_s = _Next(program, start_s), None
        is_resting = self._streamer is not None and self._streamer.is_resting(now_ns)
        if is_resting and self.phase in (*PLAYING, Phase.APPROACH):
            self._go_on(now_ns)
        else:
            self._leave(now_ns)

    def finish(self, now_ns: int) -> None:
        """End the run as one that was played to its end, so that it ends as the robot file says.

        What plays brakes. The joints of a robot with `end: limp` are limp then.
        """
        if self.outcome is None and self.phase is not Phase.DONE:
            self._end("finished", now_ns)

    def seek(self, place: float | str, now_ns: int) -> None:
        if self._show_phase is Phase.STANDING or self._next is not None:
            raise InputError("no show is played that could go to another place")
        super().seek(place, now_ns)

    # ---- from one program to the next

    def _connected(self, preflight: Preflight) -> None:
        super()._connected(preflight)
        joints = self.robot.joints
        standing_deg = self._session.standing_deg
        self._held_deg = {name: joints[name].joint_deg(deg) for name, deg in standing_deg.items()}

    def _go_on(self, now_ns: int) -> None:
        if self._next is None or self._next.program is not None:
            super()._go_on(now_ns)
            return
        self._session.note_standing(now_ns)
        self._change("left", now_ns)
        self._stand(now_ns)

    def _approach(self, now_ns: int) -> None:
        if self._next is not None:
            self._change("left", now_ns)
        super()._approach(now_ns)
        self._held_deg |= self._session.pose_deg(self.show, now_ns)

    def _after_show(self, now_ns: int) -> None:
        if self.phase is not Phase.SHOW:
            super()._after_show(now_ns)
            return
        self._next = _Next(None, None)
        self._change("fault" if self.outcome == "fault" else "finished", now_ns)
        self.outcome = None
        self._stand(now_ns)

    def _change(self, outcome: ShowOutcome, now_ns: int) -> None:
        """Take the next program in place of the present one, where all joints stand."""
        assert self._next is not None
        self._end_summary(outcome, now_ns)
        if (last := self._streamer or self.show) is not None:
            self._held_deg |= last.pose_deg(now_ns)
        (program, self.start_s), self._next = self._next, None
        self._played = program
        self.changes += 1
        self._show_phase = Phase.STANDING if program is None else Phase.SHOW
        whole = (
            self.repertoire.standing(self._held_deg)
            if program is None
            else self.repertoire.widened(program, self._held_deg)
        )
        self.program = whole
        self._session.change(whole, self.start_s)
        self._faults.escalation.change_show(whole.on_fault)
        self.show = self._ended_ns = self._goal_ns = None

    def _stand(self, now_ns: int) -> None:
        """Hold all joints where they are until the next show."""
        self._enter(Phase.STANDING)
        self.show = self._streamer = self._session.begin(now_ns, is_open=False)

    def _begin(self, now_ns: int) -> None:
        if self.show is None and self._show_phase is Phase.SHOW:
            self._began_ns = now_ns
            self._events.append(ShowBegan(self.program.name, self.start_s or 0.0))
        super()._begin(now_ns)

    def end_show(self, now_ns: int) -> None:
        super().end_show(now_ns)
        self._end_summary("fault" if self.outcome == "fault" else "stopped", now_ns)

    def _end_summary(self, outcome: ShowOutcome, now_ns: int) -> None:
        """Report the present show, if it has begun."""
        began_ns, self._began_ns = self._began_ns, None
        if self.show is not None and began_ns is not None:
            summary = summary_of(
                self.program,
                self.show,
                outcome=outcome,
                from_s=self.start_s or 0.0,
                began_ns=began_ns,
                ended_ns=now_ns,
                joints=self.moved_joints,
            )
            self._events.append(ShowOver(summary))


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
