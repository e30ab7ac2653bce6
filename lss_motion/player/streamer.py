"""Plays one program: moves on time, questions in the gaps, corrections, and the show clock's rate.

At rate 1, the moves of the program are sent as they fall due. While the rate ramps (a pause, a
resume, a change of speed) or is steady below 1, moves made on the spot follow the same course at
the rate of the moment, so that no joint leaves its path: the ramps of a servo do not slow down
with the show, so the program's own moves would. When the rate is 1 again, every joint is sent the
move of the program that is under way, with what is left of its time.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from lss_motion.player.approach import with_room
from lss_motion.player.catching_up import on_time_s, rejoin, tell_owed
from lss_motion.player.due import DueMoves
from lss_motion.player.leading import lead
from lss_motion.player.ramps import RAMP_TICK_NS, ramp_periods, ramp_s, spot_moves
from lss_motion.player.readings import Reader
from lss_motion.player.show_clock import ShowClock
from lss_motion.player.statistics import Statistics
from lss_motion.player.track import Track, make_tracks
from lss_motion.player.waiting import Waiting
from lss_motion.units import NS_PER_MS, US_PER_S, ns_from_s, s_from_ns, s_from_us, us_from_s

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.line import Line
    from lss_motion.player.queries import Questioner
    from lss_motion.program.growth import Extension
    from lss_motion.program.model import Move, Program
    from lss_motion.protocol.line import Reply
    from lss_motion.robot.model import Robot

SETTLE_S: Final = 0.15
"""After the last horn should have arrived: time for the servo's own settling."""
PLAN_HISTORY_S: Final = 5.0
"""How long a plan that grows remembers what it was: longer than any answer may take."""
ON_TIME_NS: Final = NS_PER_MS // 2
"""Later than this, and T is computed anew; below, it would not change T."""


class Streamer:
    """One program from its first to its last move. Owns no port and no clock."""

    def __init__(
        self,
        program: Program,
        robot: Robot,
        *,
        lines: Mapping[str, Line],
        questioners: Mapping[str, Questioner],
        standing_deg: Mapping[str, float],
        has_feedback: bool,
        start_ns: int,
        start_s: float | None = None,
    ) -> None:
        """Start `program` at `start_ns`. `standing_deg`: servo angles where the servos stand."""
        self.is_open = False
        """While it is, the show does not end with the program: it may still be extended."""
        self._program = program
        self._lines = lines
        first_s = s_from_us(min((m.due_us for m in program.moves), default=0))
        begin_s = min(0.0, first_s) if start_s is None else start_s
        origin_s = s_from_ns(start_ns) - begin_s
        robot = with_room(robot, standing_deg)
        self.tracks = make_tracks(program, robot, standing_deg, origin_s, has_feedback=has_feedback)
        self._by_address = {(t.joint.bus, t.joint.servo_id): t for t in self.tracks.values()}
        self._periods = ramp_periods(self.tracks.values(), lines)
        self.clock = ShowClock(start_ns, begin_s, 1.0)
        self.statistics = Statistics()
        self._moves = DueMoves(program.unrolled(), self._early_us)
        self._tick_ns: int | None = None
        self._has_moved = False
        """Whether moves left in this turn."""
        self.waiting = Waiting(program.unrolled_waits(), robot.sensors, begin_s)
        reader = Reader(self.tracks, questioners, lines, self.waiting)
        self.reader = reader if has_feedback else None
        if start_s is not None:
            self._begin_at(start_ns)

    def show_s(self, now_ns: int) -> float:
        return self.clock.show_s(now_ns)

    @property
    def rate_wanted(self) -> float:
        """What `set_rate` was last asked for."""
        return self.waiting.rate_after if self.waiting.is_waiting else self.clock.target_rate

    def is_finished(self, now_ns: int) -> bool:
        """Return whether the show is over and all at rest; one that stands in between is not."""
        if self.is_open:
            return False
        if self.clock.target_rate == 0.0 and not self.clock.is_ramping(now_ns):
            return False
        is_over = self.clock.show_s(now_ns) >= self._program.duration_s + SETTLE_S
        return is_over and self._has_arrived(now_ns)

    def is_standing(self, now_ns: int) -> bool:
        """Return whether a ramp to rate 0 has ended and every horn should have come to rest."""
        settled_ns = self.clock.ramp_end_ns + ns_from_s(SETTLE_S)
        is_still = self.clock.target_rate == 0.0 and now_ns >= settled_ns
        return is_still and self._has_arrived(now_ns)

    def _has_arrived(self, now_ns: int) -> bool:
        """Return whether every servo should be at rest where it was told to go.

        What was told late, and what a speed limit held back, is on its way for longer.
        """
        return not self._again_ns() and all(t.is_at_rest(now_ns) for t in self.tracks.values())

    def extend(self, extension: Extension, now_ns: int) -> bool:
        """Replace what is due from the splice of `extension` on; False if it is too late."""
        from_s = s_from_us(extension.from_us)
        show_s = self.clock.show_s(now_ns)
        if not self.is_open or show_s >= from_s:
            return False
        self._moves.replace_from(extension.from_us, extension.moves)
        self._program = replace(self._program, duration_s=extension.duration_s)
        for name, later in extension.references.items():
            track = self.tracks[name]
            track.plan = track.plan.followed_by(later, show_s - PLAN_HISTORY_S)
        return True

    def set_rate(self, rate: float, now_ns: int) -> None:
        """Ramp the show clock to `rate` (0 to 1), as gently as the joints' limits ask."""
        if self.waiting.is_waiting:
            self.waiting.rate_after = rate
            return
        change = abs(rate - self.clock.rate(now_ns))
        over_s = ramp_s(self.tracks.values(), self._program, self.clock.show_s(now_ns), change)
        self.clock.ramp_to(rate, now_ns, over_s)
        self._tick_ns = now_ns

    def leave_out(self, names: Iterable[str]) -> None:
        """Send no move to these joints, and to all others again."""
        for name, track in self.tracks.items():
            track.is_driven = name not in names
            if not track.is_driven:
                track.owed = track.led_ns = None

    def pose_deg(self, now_ns: int) -> dict[str, float]:
        """Return where every joint is to stand after a ramp to rate 0: joint angles."""
        tracks = self.tracks.items()
        return {name: t.joint.joint_deg(self._planned_deg(t, now_ns)) for name, t in tracks}

    def resume(self, standing_deg: Mapping[str, float], left_out: Iterable[str]) -> None:
        """Go on at rate 0, with servos that somebody else sent to `standing_deg` (servo angles)."""
        for name, servo_deg in standing_deg.items():
            self.tracks[name].stand(servo_deg)
        self.leave_out(left_out)
        if self.reader is not None:
            self.reader = self.reader.anew()

    # ---- sending

    def advance(self, now_ns: int) -> None:
        """Hand over to the lines what must leave by now: moves, or else questions.

        Questions take time to choose: they follow in the next turn, when the moves have left. But
        on a host that is late every time, moves are due then as well.
        """
        self._has_moved = False
        if self._tick_ns is not None:
            self._advance_ramp(now_ns)
        elif self.clock.target_rate > 0.0:
            while (due_ns := self._next_due_ns()) is not None and due_ns <= now_ns:
                due = self._moves.pop()
                self._send_due(due.due_us, due.move, now_ns, now_ns - due_ns)
                self._has_moved = True
        self._wait(now_ns)
        self._tell_again(now_ns)
        if self.reader is not None and (not self._has_moved or self.reader.is_starved(now_ns)):
            self.reader.ask(now_ns, self.quiet_ns(now_ns))

    def next_wakeup_ns(self, now_ns: int) -> int | None:
        """Return when `advance` must be called again at the latest."""
        wakeups_ns = self._again_ns()
        if self._tick_ns is not None:
            wakeups_ns.append(self._tick_ns)
        elif self.clock.target_rate > 0.0:
            if (due_ns := self._next_due_ns()) is not None:
                wakeups_ns.append(due_ns)
            elif self.waiting.next_s < math.inf:
                wakeups_ns.append(self._instant_ns(self.waiting.next_s))
            elif not math.isinf(self._program.duration_s):
                end_ns = self.clock.instant_ns(self._program.duration_s + SETTLE_S)
                wakeups_ns += [] if end_ns is None else [end_ns]
        else:
            wakeups_ns.append(self.clock.ramp_end_ns + ns_from_s(SETTLE_S))
        if self.reader is not None:
            wakeups_ns += self.reader.wakeups_ns(now_ns)
            wakeups_ns += [now_ns + 1] if self._has_moved else []
        return min((w for w in wakeups_ns if w > now_ns), default=None)

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        if self.reader is not None:
            self.reader.receive(bus, reply, now_ns, self._planned_deg)
            while self.reader.unheard:
                self._say_again(self.reader.unheard.popitem()[1], now_ns)

    def _next_due_ns(self) -> int | None:
        """Return when the next move is due; None: none is, at least before the next wait."""
        due = self._moves.first(US_PER_S * self.waiting.next_s)
        return None if due is None else self._instant_ns(s_from_us(due.at_us))

    def _early_us(self, move: Move) -> int:
        """Return by how much a move is to leave earlier than the program says."""
        return us_from_s(self._by_address[move.bus, move.servo_id].early_s)

    def _instant_ns(self, show_s: float) -> int:
        instant_ns = self.clock.instant_ns(show_s)
        assert instant_ns is not None, "the show stands still"
        return instant_ns

    def _wait(self, now_ns: int) -> None:
        """Stand still where the show has to wait for a sensor; go on when that is over."""
        state = self.waiting.advance(self.clock, now_ns)
        if state == "begun" and self._tick_ns is not None:
            self._tick_ns = None
            self._follow_course(now_ns, RAMP_TICK_NS, 0)
        elif state in ("met", "timeout") and 0.0 < self.clock.target_rate < 1.0:
            self._tick_ns = now_ns
            self._advance_ramp(now_ns)

    def quiet_ns(self, now_ns: int) -> int | None:
        """Return until when the lines are free of moves; None: no move is planned."""
        quiet_ns = self._again_ns()
        if self._tick_ns is not None:
            quiet_ns.append(self._tick_ns)
        elif self.clock.target_rate > 0.0 and (due_ns := self._next_due_ns()) is not None:
            quiet_ns.append(due_ns)
        return max(min(quiet_ns), now_ns) if quiet_ns else None

    def _send_due(self, due_us: int, move: Move, now_ns: int, late_ns: int) -> None:
        track = self._by_address[move.bus, move.servo_id]
        track.active = move._replace(due_us=due_us)
        wait_ns = max(0, self._lines[move.bus].free_ns - now_ns)
        self.statistics.sent(late_ns + wait_ns)
        left_s = self._left_s(track, now_ns)
        if late_ns + wait_ns <= ON_TIME_NS:
            left_s = on_time_s(track, self._lines[move.bus], self._plan_s, now_ns)
        if track.led_ns is None:
            track.send_active(self._lines[track.joint.bus], left_s, now_ns)

    def _say_again(self, track: Track, now_ns: int) -> None:
        """Send what is left of a move that its servo has not heard; ramps say all again anyway."""
        if self._tick_ns is not None or self.clock.target_rate < 1.0:
            return
        if track.active is None or not track.is_driven:
            return
        track.said_again += 1
        line = self._lines[track.joint.bus]
        rejoin(track, line, self.clock, self._program.within, now_ns)

    def _left_s(self, track: Track, now_ns: int) -> float:
        return track.left_s(self._lines[track.joint.bus], self.clock, now_ns)

    def _again_ns(self) -> list[int]:
        """Return when joints are told what the limits did not let them be told at once."""
        return [ns for track in self.tracks.values() if (ns := track.again_ns) is not None]

    def _tell_again(self, now_ns: int) -> None:
        is_even = self._tick_ns is None and self.clock.target_rate == 1.0
        for track in self.tracks.values():
            if track.again_ns is None or track.again_ns > now_ns:
                continue
            self.statistics.sent(now_ns - track.again_ns)
            line = self._lines[track.joint.bus]
            if track.owed is not None:
                tell_owed(track, line, now_ns)
            else:
                lead(track, line, self._planned_deg, now_ns, self._periods.led_ns, is_even=is_even)

    # ---- the rate ramps

    def _advance_ramp(self, now_ns: int) -> None:
        assert self._tick_ns is not None
        if now_ns < self._tick_ns:
            return
        self._skip_due(now_ns)
        late_ns = now_ns - self._tick_ns
        if self.clock.is_ramping(now_ns) or 0.0 < self.clock.target_rate < 1.0:
            period_ns = self._periods.tick_ns
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
        """Take the moves that the show has passed as under way, without sending them."""
        for due_us, move in self._moves.pass_by(US_PER_S * self.clock.show_s(now_ns)):
            track = self._by_address[move.bus, move.servo_id]
            track.active = move._replace(due_us=due_us)

    def _take_up(self, now_ns: int, late_ns: int) -> None:
        """Send every joint what is left of the move under way, now that the rate is steady."""
        for track in self.tracks.values():
            if track.active is None or track.led_ns is not None:
                continue
            left_s = self._left_s(track, now_ns)
            position_deg, speed_deg_s = track.place(now_ns)
            off_deg = abs(track.target_deg - position_deg)
            if left_s > 0.0 or off_deg > track.joint.unit_deg or speed_deg_s != 0.0:
                self.statistics.sent(late_ns)
                left_s = max(left_s, s_from_ns(RAMP_TICK_NS))
                track.send_active(self._lines[track.joint.bus], left_s, now_ns)

    def _follow_course(self, now_ns: int, period_ns: int, late_ns: int) -> None:
        """Bring every joint that is off its course there in one period; lead those streamed."""
        for track in self.tracks.values():
            track.leave_program(now_ns)
        for track, aim_deg, left_s in spot_moves(
            self.tracks.values(),
            self._lines,
            now_ns=now_ns,
            period_ns=period_ns,
            planned_deg=self._planned_deg,
            ends_ns=self.clock.ramp_end_ns if self.clock.target_rate == 0.0 else None,
        ):
            self.statistics.sent(late_ns)
            track.send(self._lines[track.joint.bus], aim_deg, left_s, now_ns)

    # ---- judging

    def _planned_deg(self, track: Track, instant_ns: int) -> float:
        """Return where the plan wants the horn; its profile is early by the lead of the joint."""
        return track.plan.at(self._plan_s(instant_ns, track.lead_s))[0]

    def _plan_s(self, instant_ns: int, early_s: float = 0.0) -> float:
        """Return the instant of the plan that is so much before the show time of `instant_ns`."""
        return self._program.within(self.clock.show_s(instant_ns) - early_s)
