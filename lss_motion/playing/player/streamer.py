"""Streams one program: moves on time, queries in the gaps, corrections, and rate changes.

At rate 1, the moves of the program are sent when they are due (`DueMoves`), each earlier by the lag
of its joint. While the rate ramps (pause, resume, change of speed) or is steady below 1, spot moves
follow the same course at the present rate, so that no joint leaves its path: the ramps of a servo
do not slow down with the show, so the program's own moves would leave it. When the rate is 1 again,
every joint is sent the move of the program that is under way, with the rest of its time.

Streamed joints: `rate_ramps.guide` leads a joint that is off its program along its path, one filter
step at a time. It is off because targets were late or cut by its limits, or because the rate is not
1. Each target is computed at run time: as far as the plan goes in the next step, and a little more
to close in on it. `Setpoints` cuts what exceeds the limits. At rate 1 these targets leave when the
moves of the program would: a change between two sets of instants makes some filters use a target
twice, or not at all.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import dropwhile
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.planning.program.line import longest_move
from lss_motion.playing.player.cues import Waiting
from lss_motion.playing.player.joint_state import LONGEST_NS, JointState, make_joint_states
from lss_motion.playing.player.polling import LATE_NS, PollScheduler
from lss_motion.playing.player.query_choice import BY_NEED
from lss_motion.playing.player.rate_ramps import (
    RAMP_TICK_NS,
    SPOT_WAIT_NS,
    RampPeriods,
    Spot,
    first_guide_ns,
    guide,
    is_off_course,
    on_time_s,
    ramp_s,
    rejoin,
    send_deferred,
    spot_move,
    tick_spots,
)
from lss_motion.playing.player.show_clock import (
    Due,
    DueMoves,
    ShowClock,
    Statistics,
    earliest_after,
)
from lss_motion.units import (
    NS_PER_MS,
    US_PER_S,
    ns_from_s,
    s_from_ns,
    s_from_us,
    us_from_s,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.planning.program.model import Move, Program
    from lss_motion.planning.program.splice import Extension
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.player.query_tracker import QueryTracker
    from lss_motion.playing.player.servo_model import Probe
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Robot


SETTLE_S: Final = 0.15
"""Time after the last horn should have arrived, for the servo's own settling."""
SETTLE_NS: Final = ns_from_s(SETTLE_S)
DOUBT_S: Final = 3.0
"""Longest wait at the end for a servo that may have restarted, which takes 1.25 s (FACTS.md R4)."""
ARRIVAL_MAX_S: Final = s_from_ns(LONGEST_NS) + 1.0
"""Longest wait for servos to rest after the end of a program, whatever they answer: the longest T
of a move sent at the end, and a second."""
PLAN_HISTORY_S: Final = 5.0
"""A plan that is extended keeps this much of its past: longer than any answer may take."""
REST_LEAST_NS: Final = 300 * NS_PER_MS
"""A joint whose plan moves on sooner than this is not corrected at rest: its next move will be."""
PRE_ROLL_S: Final = 1.0
"""A show that waits for its start stands this long before it, since some cues are early: sounds by
their lead, lights by the order in which they are sent."""
ON_TIME_NS: Final = NS_PER_MS // 2
"""If a move leaves later than this, T is computed anew; a smaller delay would not change T."""


def _early_us(by_address: Mapping[tuple[str, int], JointState], move: Move) -> int:
    """Return by how much a move leaves earlier than the program says.

    It is no method: a streamer that refers to itself would stay in memory, since the garbage
    collector is off during a run, and an evening has thousands of them.
    """
    return us_from_s(by_address[move.bus, move.servo_id].early_s)


class Streamer:
    """Streams one program from its first to its last move. Owns no port and no clock."""

    def __init__(  # noqa: PLR0913  (what one program needs)
        self,
        program: Program,
        robot: Robot,
        *,
        trackers: Mapping[str, QueryTracker],
        standing_deg: Mapping[str, float],
        has_feedback: bool,
        start_ns: int,
        start_s: float | None = None,
        probes: Mapping[str, Sequence[Probe]] = MappingProxyType({}),
        pace: Pace | None = BY_NEED,
        beside: Sequence[Streamer] = (),
        is_polling: bool = True,
    ) -> None:
        """Start `program` at `start_ns`. `standing_deg`: servo angles where the servos stand.

        `probes` show whether a servo has restarted; without one it is not examined for that.
        `beside`: streamers of other joints, without `is_polling`, whose servos are polled here.
        """
        self.is_open = False
        """While its owner keeps it open, the show does not end with the program: it is extended."""
        self._program = program
        self._lines = lines = {bus: tracker.line for bus, tracker in trackers.items()}
        first_s = s_from_us(min((m.due_us for m in program.moves), default=0))
        begin_s = min(0.0, first_s) if start_s is None else start_s
        self.begin_s = begin_s
        """Show time before which every joint rests."""
        origin_s = s_from_ns(start_ns) - begin_s
        self.joint_states = make_joint_states(
            program,
            robot,
            standing_deg,
            origin_s,
            has_feedback=has_feedback,
        )
        self._by_address = {(t.joint.bus, t.joint.servo_id): t for t in self.joint_states.values()}
        self._resending: set[str] = set()
        """Joints that are sent a target besides the program's: deferred, or to guide them."""
        for state in self.joint_states.values():
            state.report_resends(self._resending)
        self._periods = RampPeriods(self.joint_states.values(), lines)
        self.clock = ShowClock(start_ns, begin_s, 1.0)
        self.statistics = Statistics()
        self._early_us = partial(_early_us, self._by_address)
        self._moves = DueMoves(program.unrolled(begin_s), self._early_us)
        self._tick_ns: int | None = None
        self._spots: list[Spot] = []
        self._back_at_s: float | None = None
        self.has_moved = self.is_late = self.has_waited = False
        """Whether in the last call of `advance` moves left, one of them was late, or a wait for a
        sensor began or ended."""
        self.waiting = Waiting(program.unrolled_waits(begin_s), robot.sensors, begin_s)
        self._beside = tuple(beside)
        scheduler = PollScheduler(self.all_states(), trackers, self.waiting, probes, pace)
        self.scheduler = scheduler if has_feedback and is_polling else None
        if start_s is not None:
            self._begin_at(start_ns)

    def show_s(self, now_ns: int) -> float:
        return self.clock.show_s(now_ns)

    # ---- streamers of other joints on the same lines

    def play_beside(self, others: Sequence[Streamer]) -> None:
        """Poll the servos of these streamers from now on, in place of those before.

        Their joints are sent no move from here.
        """
        self._beside = tuple(others)
        self._suspend_lent()
        if self.scheduler is not None:
            self.scheduler = self.scheduler.renewed(self.all_states())

    def adopt(self, joint_states: Mapping[str, JointState]) -> None:
        """Take these states in place of its own: another streamer has moved their joints."""
        for name, state in joint_states.items():
            self.joint_states[name] = state
            self._by_address[state.joint.bus, state.joint.servo_id] = state
            state.report_resends(self._resending)

    def _suspend_lent(self) -> None:
        for name in (name for other in self._beside for name in other.joint_states):
            if name in self.joint_states:
                self.joint_states[name].drive(is_driven=False)

    def all_states(self) -> dict[str, JointState]:
        """Return the states of all joints; a streamer beside this one comes first."""
        states = dict(self.joint_states)
        for other in self._beside:
            states |= other.joint_states
        return states

    def _owner(self, state: JointState) -> Streamer:
        """Return the streamer that moves the joint of a state."""
        name = state.joint.name
        owners = (one for one in self._beside if one.joint_states.get(name) is state)
        return next(owners, self)

    def all_pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return the joint angles of all plans, also of the streamers beside this one."""
        pose_deg = self.pose_deg(now_ns)
        for other in self._beside:
            pose_deg |= other.pose_deg(now_ns)
        return pose_deg

    def find_state(self, address: tuple[str, int]) -> JointState | None:
        """Return the state of the joint with this bus and servo id, if it is moved here."""
        return self._by_address.get(address)

    def _expected_deg(self, state: JointState, instant_ns: int) -> float:
        return self._owner(state).planned_deg(state, instant_ns)

    @property
    def _has_any_moved(self) -> bool:
        return self.has_moved or (
            bool(self._beside) and any(other.has_moved for other in self._beside)
        )

    # ---- its state

    @property
    def rate_wanted(self) -> float:
        """The last rate given to `set_rate`."""
        is_standing = self.waiting.next_s < math.inf and self.waiting.is_standing
        return self.waiting.rate_after if is_standing else self.clock.target_rate

    def is_finished(self, now_ns: int) -> bool:
        """Return whether the show is over and every servo at rest; false during a pause."""
        show_s, end_s = self.clock.show_s(now_ns), self._program.duration_s + SETTLE_S
        if show_s < end_s or self.is_open:
            return False
        if self.clock.target_rate == 0.0 and not self.clock.is_ramping(now_ns):
            return False
        if self._has_doubts() and show_s < end_s + DOUBT_S:
            return False
        return show_s >= end_s + ARRIVAL_MAX_S or self._has_arrived(now_ns)

    def _has_doubts(self) -> bool:
        """Return whether a servo that is driven may have restarted."""
        doubted = () if self.scheduler is None else self.scheduler.doubted
        own = (self.joint_states[name] for name in doubted if name in self.joint_states)
        return any(state.is_driven for state in own)

    def is_standing(self, now_ns: int) -> bool:
        """Return whether a ramp to rate 0 has ended and every horn should be at rest."""
        settled_ns = self.clock.ramp_end_ns + ns_from_s(SETTLE_S)
        is_still = self.clock.target_rate == 0.0 and now_ns >= settled_ns
        is_over = now_ns >= settled_ns + ns_from_s(ARRIVAL_MAX_S)
        return is_still and (is_over or self._has_arrived(now_ns))

    def is_resting(self, now_ns: int) -> bool:
        """Return whether every servo should be at rest at its target, with no ramp under way."""
        return self._tick_ns is None and self._has_arrived(now_ns)

    def _has_arrived(self, now_ns: int) -> bool:
        """Return whether every servo should be at rest at its target.

        Targets that were sent late, or cut by a speed limit, take longer.
        """
        return (
            not self._resends_ns()
            and not self._spots
            and all(t.is_at_rest(now_ns) for t in self.joint_states.values())
        )

    def extend(self, extension: Extension, now_ns: int, whole: Program | None = None) -> bool:
        """Replace what is due from the splice of `extension` on; False if it is too late.

        `whole`: the program with the extension in it, for who goes back in it.
        """
        from_s = s_from_us(extension.from_us)
        show_s = self.clock.show_s(now_ns)
        if show_s >= from_s:
            return False
        self._moves.replace_from(extension.from_us, extension.moves)
        self._program = whole or replace(self._program, duration_s=extension.duration_s)
        for name, later in extension.profiles.items():
            state = self.joint_states[name]
            state.extend_plan(later, show_s - PLAN_HISTORY_S)
        return True

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Ramp the show clock to `rate` (0 to 1), as gently as the joints' limits require."""
        if rate == self.rate_wanted:
            return
        if self.waiting.is_standing:
            self.waiting.rate_after = rate
            return
        change = abs(rate - self.clock.rate(now_ns))
        over_s = ramp_s(
            self.joint_states.values(), self._program, self.clock.show_s(now_ns), change
        )
        self.clock.ramp_to(rate, now_ns, over_s)
        self._tick_ns = now_ns

    def leave_out(self, names: Iterable[str]) -> None:
        """Send no move to the joints `names`, and moves to all others."""
        for name, state in self.joint_states.items():
            state.drive(is_driven=name not in names)
        self._suspend_lent()
        for other in self._beside:
            other.leave_out(names)

    def jump_to(self, show_s: float, now_ns: int) -> None:
        """Stand at `show_s`. For a show that stands; an approach and `resume` must follow."""
        self.clock.jump_to(show_s, now_ns)
        self._tick_ns, self._spots = None, []
        for state in self.joint_states.values():
            state.leave_move()
        self._moves = DueMoves(self._program.unrolled(show_s), self._early_us)
        self.waiting.begin_at(self._program.unrolled_waits(show_s), show_s)
        self._skip_due(now_ns)

    def hold_before_start(self, now_ns: int) -> None:
        """Stand before the first instant of the show, with nothing due. For a show not begun."""
        self.clock.jump_to(self.begin_s - PRE_ROLL_S, now_ns)

    def run_from(self, show_s: float, now_ns: int) -> None:
        """Run, and be at `show_s` now: at most at the first instant of the show."""
        self.clock.run_from(show_s, now_ns)

    def ramp_over_s(self, change: float, now_ns: int) -> float:
        """Return how long a change of the rate by so much would take now."""
        show_s = self.clock.show_s(now_ns)
        return ramp_s(self.joint_states.values(), self._program, show_s, change)

    def pose_at(self, show_s: float) -> dict[str, float]:
        """Return the joint angles of the plan at a show time."""
        at_s = self._program.within(show_s)
        joint_states = self.joint_states.items()
        return {name: t.joint.joint_deg(t.plan.at(at_s)[0]) for name, t in joint_states}

    def pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return the joint angles of the plan: after a ramp to rate 0, every joint stands there."""
        joint_states = self.joint_states.items()
        return {name: t.joint.joint_deg(self.planned_deg(t, now_ns)) for name, t in joint_states}

    def resume(self, standing_deg: Mapping[str, float], left_out: Iterable[str]) -> None:
        """Go on at rate 0, with servos that an approach sent to `standing_deg` (servo angles)."""
        for name, servo_deg in standing_deg.items():
            self.joint_states[name].stand_at(servo_deg)
        self.leave_out(left_out)
        if self.scheduler is not None:
            self.scheduler = self.scheduler.renewed()

    # ---- sending

    def advance(self, now_ns: int) -> None:
        """Hand over to the lines what must leave by now: moves, and queries to one servo of a bus.

        To choose queries takes time, so others follow in the next call, after the moves have left.
        On a host that is always late, moves are due in every call; then all follow in the same one.
        """
        self.has_moved = self.is_late = self.has_waited = False
        if self._tick_ns is not None:
            self._advance_ramp(now_ns)
        elif self.clock.target_rate > 0.0:
            self._send_all_due(now_ns)
        if self.waiting.next_s < math.inf:
            self._wait(now_ns)
        if self._resending:
            self._resend_due(now_ns)
        if self._spots:
            self._send_spots(now_ns)
        if self.scheduler is None:
            return
        if not self._has_any_moved or self.scheduler.is_starved(now_ns):
            self.scheduler.poll(now_ns, self.quiet_ns(now_ns))
        elif not (self.is_late or any(other.is_late for other in self._beside)):
            self.scheduler.poll_behind(now_ns, self.quiet_ns(now_ns))

    def next_wakeup_ns(self, now_ns: int) -> int | None:
        """Return when `advance` must be called again at the latest."""
        look_ns = polls_ns = back_ns = None
        if self.scheduler is not None:
            if self._has_any_moved and self.scheduler.look_ahead(now_ns, self.quiet_ns(now_ns)):
                look_ns = now_ns + 1
            polls_ns = self.scheduler.next_wakeup_ns(now_ns)
        clock, waiting, next_ns = self.clock, self.waiting, self._tick_ns
        if next_ns is None and clock.target_rate == 0.0:
            next_ns = clock.ramp_end_ns + SETTLE_NS
        elif next_ns is None:
            next_ns = self._moves.first_ns(clock, waiting.next_s)
            if next_ns is None:
                next_ns = self._end_ns()
            if waiting.back_s and not waiting.is_waiting:
                back_ns = clock.instant_ns(waiting.next_s - waiting.back_s)
        resends_ns = self._resends_ns() if self._resending else ()
        return earliest_after(now_ns, (look_ns, polls_ns, next_ns, back_ns, *resends_ns))

    def _end_ns(self) -> int | None:
        """Return when the next wait or the end of the show is reached; None: there is no end."""
        is_last = self.waiting.next_s == math.inf
        end_s = self._program.duration_s + SETTLE_S if is_last else self.waiting.next_s
        return None if end_s == math.inf else self.clock.instant_ns(end_s)

    def hold_back(self, now_ns: int, *, is_long: bool) -> None:
        """Send no move to servos that may have restarted in a pause, until they answer as set."""
        if self.scheduler is not None:
            self.scheduler.hold_back(now_ns, is_long=is_long)

    def receive(self, bus: str, reply: Reply, ended_ns: int, now_ns: int) -> None:
        """Use a reply that ended at `ended_ns`, shortly before `now_ns`."""
        if self.scheduler is not None:
            self.scheduler.receive(bus, reply, ended_ns, self._expected_deg)
            if reply.keyword == "QD" and reply.servo_id is not None:
                for streamer in (*self._beside, self):
                    state = streamer.find_state((bus, reply.servo_id))
                    if state is not None:
                        streamer.correct_standing(state, now_ns)
                        break
            while self.scheduler.to_resend:
                state = self.scheduler.to_resend.popitem()[1]
                self._owner(state).resend_lost(state, now_ns)

    def correct_standing(self, state: JointState, now_ns: int) -> None:
        """Send a joint that rests off its plan a correction, unless its plan moves on soon."""
        if self._tick_ns is not None or not state.may_stand(s_from_ns(now_ns)):
            return
        if self.clock.rate(now_ns) != 1.0 or not state.takes_moves or state.resend_ns is not None:
            return
        planned_deg = self.planned_deg(state, now_ns)
        later_deg = self.planned_deg(state, now_ns + REST_LEAST_NS)
        if abs(later_deg - planned_deg) > state.joint.unit_deg:
            return
        offset_deg = state.standing_offset_deg(now_ns)
        if offset_deg is not None:
            line = self._lines[state.joint.bus]
            state.correct_standing(line, offset_deg, planned_deg, now_ns)

    def _wait(self, now_ns: int) -> None:
        """Stop the show where it waits for a sensor; go on when the wait is over."""
        back_s = self.waiting.back_s
        state = self.waiting.advance(self.clock, now_ns)
        self.has_waited = state is not None
        if back_s:
            if state == "again":  # Its moves leave once more.
                from_s = self.waiting.next_s - back_s
                written = self._program.unrolled(from_s)
                again = dropwhile(lambda due: due[0] < us_from_s(from_s), written)
                self._moves = DueMoves(again, self._early_us)
                self._back_at_s = from_s
        elif state == "begun" and self._tick_ns is not None:
            self._tick_ns = None
            self._follow_course(now_ns, RAMP_TICK_NS, 0)
        elif state in ("met", "timeout") and 0.0 < self.clock.target_rate < 1.0:
            self._tick_ns = now_ns
            self._advance_ramp(now_ns)

    def take_way_back(self) -> float | None:
        """Return to where the show has gone back since the last call, for idle motion."""
        back_at_s, self._back_at_s = self._back_at_s, None
        return back_at_s

    def quiet_ns(self, now_ns: int) -> int | None:
        """Return until when no move is due; None: no move is planned."""
        due_ns = self.due_ns()
        return now_ns if due_ns is not None and due_ns < now_ns else due_ns

    def due_ns(self) -> int | None:
        """Return when the next move is due, also in the past; None: no move is planned."""
        due_ns = self._tick_ns
        if due_ns is None and self.clock.target_rate > 0.0:
            due_ns = self._moves.first_ns(self.clock, self.waiting.next_s)
        if self._resending or self._beside:
            others_ns = [*self._resends_ns(), *(other.due_ns() for other in self._beside)]
            due_ns = min([ns for ns in (due_ns, *others_ns) if ns is not None], default=None)
        return due_ns

    def halt(self, since_ns: int, now_ns: int) -> None:
        """Brake after a stall: the show stands since `since_ns`, when a move was due.

        What was due meanwhile is due again when the rate is raised.
        """
        if not self.waiting.is_standing:
            self.clock.halt(since_ns)
        self._tick_ns, self._spots = None, []
        for state in self.joint_states.values():
            state.halt(self._lines[state.joint.bus], now_ns)
        for other in self._beside:
            other.halt(since_ns, now_ns)

    def _send_all_due(self, now_ns: int) -> None:
        """Send the moves that are due; of several for one joint only the latest.

        A servo that receives several at once obeys the last only, as late as they keep the line.
        Several are due at once after a stall, and where a joint turns out to lag more than before.
        """
        moves, clock, before_s = self._moves, self.clock, self.waiting.next_s
        due: list[tuple[int, Due]] = []
        while (due_ns := moves.first_ns(clock, before_s)) is not None and due_ns <= now_ns:
            due.append((due_ns, moves.pop()))
        if not due:
            return
        latest = {(one.move.bus, one.move.servo_id): one.number for _, one in due}
        for due_ns, one in due:
            self.has_moved = True
            self.is_late |= now_ns - due_ns > LATE_NS
            if latest[one.move.bus, one.move.servo_id] == one.number:
                self._send_due(one.due_us, one.move, now_ns, now_ns - due_ns)
            elif now_ns - due_ns > ON_TIME_NS:
                self.statistics.left_out()

    def _send_due(self, due_us: int, move: Move, now_ns: int, late_ns: int) -> None:
        state = self._by_address[move.bus, move.servo_id]
        state.begin_move(move if move.due_us == due_us else move._replace(due_us=due_us))
        if self._spots:
            self._spots = [spot for spot in self._spots if spot.state is not state]
        line = self._lines[move.bus]
        if line.free_ns > now_ns:
            late_ns += line.free_ns - now_ns
        self.statistics.sent(late_ns)
        left_s = state.left_s(line, self.clock, now_ns)
        state.aim(max(left_s, 0.0), now_ns)
        if late_ns <= ON_TIME_NS:
            left_s = on_time_s(state, line, self._plan_s, now_ns)
        if state.guide_ns is not None:
            self._guide(state, now_ns)
        else:
            state.send_active(line, left_s, now_ns)
            self._set_guiding(state, now_ns)

    def _guide(self, state: JointState, now_ns: int) -> None:
        """Send a guiding target now."""
        line, period_ns = self._lines[state.joint.bus], self._guide_period_ns(state, now_ns)
        guide(state, line, self.planned_deg, now_ns, period_ns, is_even=self._is_even)
        self._set_guiding(state, now_ns)

    def _set_guiding(self, state: JointState, now_ns: int) -> None:
        """Guide a joint at the instants of its program, where that has any.

        Each change between instants of the program and others makes some filters use one target
        twice or not at all.
        """
        if state.guide_ns is not None and self._is_even:
            state.guide_at(now_ns + self._guide_period_ns(state, now_ns))

    def _guide_period_ns(self, state: JointState, now_ns: int) -> int:
        """Return the time to the next guiding target: a part of that to the program's next move."""
        period_ns = self._periods.guide_ns(state.joint.bus)
        if not self._is_even:
            return period_ns
        servo = (state.joint.bus, state.joint.servo_id)
        next_us = self._moves.next_us(servo, US_PER_S * self.waiting.next_s)
        if next_us is None:
            return period_ns
        next_ns = (self.clock.instant_ns(s_from_us(next_us)) or 0) - now_ns
        return next_ns // math.ceil(next_ns / period_ns) if next_ns > 0 else period_ns

    @property
    def _is_even(self) -> bool:
        """Whether the program's own moves leave: at a steady rate of 1."""
        return self._tick_ns is None and self.clock.target_rate == 1.0

    def resend_lost(self, state: JointState, now_ns: int) -> None:
        """Send the rest of a move that its servo has lost; a ramp sends all anew anyway."""
        if self._tick_ns is not None or self.clock.target_rate < 1.0:
            return
        if state.active is None or not state.takes_moves or not state.may_retry():
            return
        if state.joint.drive == "streamed":
            state.guide_at(now_ns)
            return
        line = self._lines[state.joint.bus]
        rejoin(state, line, self.clock, self._program.within, now_ns)

    def _resends_ns(self) -> list[int]:
        """Return the instants of deferred and guiding targets."""
        if not self._resending:
            return []
        resends_ns = [self.joint_states[name].resend_ns for name in self._resending]
        return [resend_ns for resend_ns in resends_ns if resend_ns is not None]

    def _resend_due(self, now_ns: int) -> None:
        for name, state in self.joint_states.items():
            if name not in self._resending:
                continue
            if state.resend_ns is None or state.resend_ns > now_ns:
                continue
            self.statistics.sent(now_ns - state.resend_ns)
            if state.deferred is not None:
                send_deferred(state, self._lines[state.joint.bus], now_ns)
            else:
                self._guide(state, now_ns)

    # ---- the rate ramps

    def _advance_ramp(self, now_ns: int) -> None:
        assert self._tick_ns is not None
        if now_ns < self._tick_ns:
            return
        self._skip_due(now_ns)
        late_ns = now_ns - self._tick_ns
        if self.clock.is_ramping(now_ns) or 0.0 < self.clock.target_rate < 1.0:
            period_ns = self._periods.tick_ns()
            if self.clock.is_ramping(now_ns):
                # A last tick shortly before the end would put twice as much on the line.
                left_ns = self.clock.ramp_end_ns - now_ns
                period_ns = left_ns // max(1, left_ns // period_ns)
            self._follow_course(now_ns, period_ns, late_ns)
            self._tick_ns = now_ns + period_ns
            return
        self._tick_ns = None
        if self.clock.target_rate == 0.0:
            self._follow_course(now_ns, RAMP_TICK_NS, late_ns)
        else:
            self._take_up(now_ns, late_ns)

    def _begin_at(self, now_ns: int) -> None:
        """Start in the middle of the program: from rest, with a ramp of the rate from 0."""
        self.clock = ShowClock(now_ns, self.clock.show_s(now_ns), 0.0)
        self._skip_due(now_ns)
        self.set_rate(1.0, now_ns)

    def _skip_due(self, now_ns: int) -> None:
        """Mark the moves that the show has passed as under way, without sending them."""
        for due_us, move in self._moves.pass_by(US_PER_S * self.clock.show_s(now_ns)):
            state = self._by_address[move.bus, move.servo_id]
            state.begin_move(move._replace(due_us=due_us))

    def _take_up(self, now_ns: int, late_ns: int) -> None:
        """Send every joint the rest of the move under way, now that the rate is steady."""
        self._spots = [
            Spot(state, now_ns, 0, late_ns)
            for state in self.joint_states.values()
            if state.active is not None and state.guide_ns is None
        ]

    def _send_rest(self, spot: Spot, now_ns: int) -> None:
        """Send a joint the rest of its move under way, unless it has arrived."""
        state = spot.state
        left_s = state.left_s(self._lines[state.joint.bus], self.clock, now_ns)
        position_deg, speed_deg_s = state.place(now_ns)
        off_deg = abs(state.target_deg - position_deg)
        if left_s > 0.0 or off_deg > state.joint.unit_deg or speed_deg_s != 0.0:
            self.statistics.sent(spot.late_ns)
            left_s = max(left_s, s_from_ns(RAMP_TICK_NS))
            state.send_active(self._lines[state.joint.bus], left_s, now_ns)

    def _follow_course(self, now_ns: int, period_ns: int, late_ns: int) -> None:
        """Lead every joint that is off its course there in one period; guide those streamed."""
        self._spots = []
        ahead_ns, rate = now_ns + 2 * period_ns, self.clock.target_rate
        for state in self.joint_states.values():
            if state.joint.drive != "streamed":
                state.leave_program(now_ns)
                self._spots += tick_spots(state, self.planned_deg, rate, now_ns, period_ns, late_ns)
            elif state.guide_ns is None and is_off_course(
                state, self.planned_deg, now_ns, ahead_ns
            ):
                line = self._lines[state.joint.bus]
                state.leave_program(first_guide_ns(state, line, now_ns))

    def _send_spots(self, now_ns: int) -> None:
        """Send the spot moves of a tick, between the targets of guided joints on their buses.

        A filter brakes if its target is late. A move that finds no gap for long goes all the same.
        """
        spots, self._spots = self._spots, []
        for spot in spots:
            state, line = spot.state, self._lines[spot.state.joint.bus]
            arrival_ns = line.arrival_ns(len(longest_move(state.joint)), now_ns)
            next_ns = self._periods.next_guide_ns(state.joint.bus)
            if arrival_ns > next_ns and now_ns - spot.since_ns < SPOT_WAIT_NS:
                self._spots.append(spot)
                continue
            if not spot.period_ns:
                self._send_rest(spot, now_ns)
                continue
            move = spot_move(
                spot,
                line,
                now_ns=now_ns,
                planned_deg=self.planned_deg,
                ends_ns=self.clock.ramp_end_ns if self.clock.target_rate == 0.0 else None,
            )
            if move is not None:
                self.statistics.sent(spot.late_ns)
                state.send(line, move.aim_deg, move.left_s, now_ns)

    # ---- judging

    def planned_deg(self, state: JointState, instant_ns: int) -> float:
        """Return the horn angle of the plan; its profile is early by the lead of the joint."""
        return state.plan.at(self._plan_s(instant_ns, state.lead_s))[0]

    def _plan_s(self, instant_ns: int, early_s: float = 0.0) -> float:
        """Return the instant of the plan that is `early_s` before the show time of `instant_ns`."""
        return self._program.within(self.clock.show_s(instant_ns) - early_s)
