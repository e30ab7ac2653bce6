"""Tests of `playing.player.streamer`.

One program, move by move: what leaves when, at any rate of the show, and where that leads.
In which order moves leave when joints lag differently, and what is passed by or replaced.
How a timed joint that is not on its plan gets back there.
A streamed joint that is off its program: judged by what the filter of its servo then does.
"""

from __future__ import annotations

import math
import re
from itertools import count, pairwise
from random import Random

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning.program.model import Driving, Move, Program, Repeat
from lss_motion.planning.program.response import PiecewiseProfile
from lss_motion.planning.program.splice import Extension
from lss_motion.planning.program.verify import profiles
from lss_motion.planning.trajectory.model import WaitPoint
from lss_motion.playing.player import rate_ramps
from lss_motion.playing.player.joint_state import RETRIES_MAX
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.playing.player.rate_ramps import JOIN_S, guide, on_time_s, send_deferred
from lss_motion.playing.player.show_clock import EARLY_MAX_US, DueMoves, ShowClock
from lss_motion.playing.player.streamer import ARRIVAL_MAX_S, SETTLE_S, Streamer
from lss_motion.protocol.framing import Reply
from lss_motion.robot.model import Bus, Sensor
from lss_motion.show.model import Wait
from tests.filters import FILTER_S, felt, staircase
from tests.timed_moves import MOVE, timed, travel

# ---- streamer

MS, S = 1_000_000, 1_000_000_000
START_NS = 7 * S
"""On the run clock; all instants below are seconds after it."""
END_S = 2.2


def move(due_s, target_deg, lasts_s=0.8, servo_id=1):
    lasts_ms = None if lasts_s is None else round(1000 * lasts_s)
    return Move(round(1e6 * due_s), "main", servo_id, round(10 * target_deg), lasts_ms)


THERE_AND_BACK = (move(0.1, 40.0), move(1.2, -20.0))


class StreamedShow:
    """A streamer on a line, in virtual time."""

    def __init__(
        self,
        kit,
        moves=THERE_AND_BACK,
        *,
        joint=None,
        others=(),
        start_s=None,
        has_feedback=False,
        **fields,
    ):
        """With feedback, too, no query is sent."""
        joint = joint or kit.joint("j0", 1)
        standing_deg = dict.fromkeys(["j0", *(other.name for other in others)], 0.0)
        sensors = {"eye": Sensor(name="eye", servo_id=209, bus="main")}
        self.robot = kit.robot(joint, *others, sensors=sensors)
        streamed = {"j0": Driving("streamed", joint.filter_count)}
        self.program = Program(
            name="show",
            robot="bench",
            moves=moves,
            start_deg=standing_deg,
            tolerance_deg=0.2,
            drives=streamed if joint.drive == "streamed" else {},
            **{"duration_s": END_S, **fields},
        )
        self.line = SerialLine(Bus(name="main", port="sim://", baud_bps=115200, firmware=370))
        self.streamer = Streamer(
            self.program,
            self.robot,
            trackers={"main": QueryTracker(self.line)},
            standing_deg=standing_deg,
            has_feedback=has_feedback,
            start_ns=START_NS,
            start_s=start_s,
        )
        if has_feedback:
            self.streamer.scheduler.poll = lambda *_: None
        self.sent = []
        """`(s, line)` of all that was handed over."""
        self.places = []
        """`(s, show s, where the profile of j0 is, where the plan has it)`."""
        self.now_ns = START_NS

    @property
    def state(self):
        return self.streamer.joint_states["j0"]

    @property
    def now_s(self):
        return (self.now_ns - START_NS) / 1e9

    def run(self, until_s, *, late_s=0.0):
        """Do all that is due until then; the host wakes `late_s` too late."""
        until_ns = START_NS + round(1e9 * until_s)
        while self.now_ns < until_ns:
            self.step()
            wakeup_ns = self.streamer.next_wakeup_ns(self.now_ns)
            assert wakeup_ns is None or wakeup_ns > self.now_ns
            next_ns = until_ns if wakeup_ns is None else wakeup_ns + round(1e9 * late_s)
            self._look(min(next_ns, until_ns))
            self.now_ns = min(next_ns, until_ns)
        return self

    def step(self):
        self.streamer.advance(self.now_ns)
        self.sent += [(self.now_s, part + b"\r") for part in self.line.take().split(b"\r")[:-1]]

    def _look(self, until_ns):
        clock, state = self.streamer.clock, self.state
        for at_ns in range(self.now_ns, until_ns, 5 * MS):
            show_s = clock.show_s(at_ns)
            wanted_deg = state.plan.at(self.program.within(show_s))[0]
            self.places.append(
                ((at_ns - START_NS) / 1e9, show_s, state.place(at_ns)[0], wanted_deg)
            )

    def off_deg(self, from_s=0.0):
        """Return how far the profile was off the course of the plan, at the most."""
        return max(abs(own - plan) for at_s, _, own, plan in self.places if at_s >= from_s)

    def speeds_deg_s(self):
        return np.diff([own for _, _, own, _ in self.places]) / 0.005


def waits_at(at_s, timeout_s):
    wait = Wait(sensor="eye", side="below", threshold=300.0, timeout_s=timeout_s)
    return WaitPoint(at_s=at_s, wait=wait)


def set_rate(stage, rate):
    stage.streamer.set_rate(rate, stage.now_ns)


def test_every_move_leaves_when_it_is_due_as_it_is(kit):
    stage = StreamedShow(kit).run(3.0)
    assert stage.sent == [(0.1, THERE_AND_BACK[0].data), (1.2, THERE_AND_BACK[1].data)]
    timing = stage.streamer.statistics.timing()
    assert (timing["commands"], timing["missed"], timing["late_max_us"]) == (2, 0, 0)
    assert stage.off_deg() < 0.05


@pytest.mark.parametrize("is_starved", [False, True])
def test_questions_wait_until_the_moves_have_left_unless_they_have_waited_too_long(kit, is_starved):
    dense = [move(0.1 + 0.02 * number, 40.0) for number in range(10)]
    stage, last_sent_ns = StreamedShow(kit, dense, has_feedback=True), set()
    stage.streamer.scheduler.poll = lambda *_: last_sent_ns.add(stage.now_ns)
    stage.streamer.scheduler.is_starved = lambda _: is_starved
    behind_ns = set()
    stage.streamer.scheduler.poll_behind = lambda *_: behind_ns.add(stage.now_ns)
    stage.run(0.3)
    sent_ns = {START_NS + round(1e9 * at_s) for at_s, _ in stage.sent}
    assert len(sent_ns) == len(dense)
    assert sent_ns & last_sent_ns == (sent_ns if is_starved else set())
    assert {at_ns + 1 for at_ns in sent_ns} <= last_sent_ns
    assert behind_ns == (set() if is_starved else sent_ns)


def test_no_servo_is_polled_behind_a_move_that_is_late(kit):
    stage, behind_ns = StreamedShow(kit, (move(0.1, 40.0), move(0.3, 20.0)), has_feedback=True), []
    stage.streamer.scheduler.is_starved = lambda _: False
    stage.streamer.scheduler.poll_behind = lambda now_ns, _: behind_ns.append(now_ns)
    for at_s in (0.1, 0.302):
        stage.now_ns = START_NS + round(at_s * 1e9)
        stage.step()
    assert [len(stage.sent), behind_ns] == [2, [START_NS + round(0.1e9)]]


def test_a_show_starts_with_what_is_due_before_its_time_0(kit):
    stage = StreamedShow(kit, (move(-0.05, 40.0), move(1.2, -20.0))).run(3.0)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx([0.0, 1.25])
    assert stage.streamer.show_s(START_NS) == -0.05
    assert stage.state.origin_s == pytest.approx(START_NS / 1e9 + 0.05)


def test_it_is_over_when_all_has_come_to_rest_and_not_before(kit):
    stage = StreamedShow(kit).run(END_S)
    assert stage.streamer.next_wakeup_ns(stage.now_ns) == START_NS + round(1e9 * (END_S + SETTLE_S))
    assert not stage.streamer.is_finished(stage.now_ns)
    assert not stage.streamer.is_finished(START_NS + round(1e9 * (END_S + SETTLE_S)) - 1)
    assert stage.streamer.is_finished(START_NS + round(1e9 * (END_S + SETTLE_S)))
    stage.streamer.is_open = True
    assert not stage.streamer.is_finished(START_NS + 10 * S)


def test_the_show_waits_for_moves_that_were_sent_late(kit):
    stage = StreamedShow(kit, (move(0.1, 40.0), move(2.0, -40.0))).run(1.9)
    stage.now_ns = START_NS + round(2.4e9)
    stage.step()
    assert not stage.streamer.is_finished(stage.now_ns)
    assert not stage.streamer.is_finished(START_NS + 3 * S)
    assert stage.streamer.is_finished(START_NS + round(3.5e9))


def test_all_joints_must_have_come_to_rest(kit):
    moves = (move(0.1, 40.0), move(0.2, 40.0, servo_id=2))
    stage = StreamedShow(kit, moves, others=[kit.joint("j1", 2)], duration_s=0.3).run(0.6)
    assert stage.streamer.joint_states["j0"].is_at_rest(START_NS + 1040 * MS)
    assert not stage.streamer.is_finished(START_NS + 1040 * MS)
    assert stage.streamer.is_finished(START_NS + 1200 * MS)


@pytest.mark.parametrize(("late_s", "said"), [(0.0004, b"T800"), (0.2, b"T600"), (0.9, b"T223")])
def test_a_late_move_has_what_is_left_of_its_time(kit, late_s, said):
    stage = StreamedShow(kit, (move(0.1, 40.0),)).run(0.05)
    stage.now_ns = START_NS + round(1e9 * (0.1 + late_s))
    stage.step()
    assert stage.sent[0][1] == b"#1D400%b\r" % said
    assert stage.streamer.statistics.max_ns == pytest.approx(1e9 * late_s, abs=10)


def test_a_move_that_waits_for_the_line_is_late_by_that(kit):
    stage = StreamedShow(kit, (move(0.1, 40.0),)).run(0.05)
    stage.line.send(b"." * 1200, START_NS + 100 * MS)
    stage.now_ns = START_NS + 100 * MS
    stage.step()
    assert stage.sent[0][1].endswith(b"#1D400T696\r")
    assert stage.streamer.statistics.max_ns == pytest.approx(104 * MS, rel=0.01)


def test_what_was_learnt_of_a_lag_lets_moves_leave_earlier(kit):
    stage = StreamedShow(kit)
    stage.state.early_s = 0.03
    stage.run(3.0)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx([0.07, 1.17])


def test_a_joint_that_lags_more_than_before_gets_the_latest_of_its_moves_only(kit):
    stage = StreamedShow(kit, tuple(move(1.0 + 0.01 * one, one, 0.2) for one in range(20)))
    stage.run(1.05)
    stage.state.early_s = 0.03
    stage.run(3.0)
    instants_s = [at_s for at_s, _ in stage.sent]
    assert len(set(instants_s)) == len(instants_s) == 17, "three moves are due together with others"
    assert stage.sent[-1][1].startswith(b"#1D190T")
    assert stage.streamer.statistics.missed == 0


def test_a_joint_that_is_left_out_is_sent_nothing_until_it_is_back(kit):
    stage = StreamedShow(kit)
    stage.streamer.leave_out({"j0"})
    stage.run(1.0)
    assert stage.sent == []
    stage.streamer.leave_out(())
    stage.run(3.0)
    assert [at_s for at_s, _ in stage.sent] == [1.2]


@pytest.mark.parametrize("at_s", [0.35, 0.6, 1.25])
def test_a_pause_brakes_on_the_path_stands_and_goes_on_from_there(kit, at_s):
    stage = StreamedShow(kit).run(at_s)
    set_rate(stage, 0.0)
    assert stage.streamer.rate_wanted == 0.0
    stage.run(at_s + 2.0)
    stands_s = max(t for t, _ in stage.sent)
    assert at_s + 0.2 < stands_s < at_s + 0.8
    clock = stage.streamer.clock
    assert not stage.streamer.is_standing(clock.ramp_end_ns)
    assert stage.streamer.is_standing(clock.ramp_end_ns + round(1e9 * SETTLE_S))
    assert not stage.streamer.is_finished(stage.now_ns), "it may go on"
    place_deg = stage.state.place(stage.now_ns)[0]
    (pose_deg,) = stage.streamer.pose_deg(stage.now_ns).values()
    horn_s = clock.show_s(stage.now_ns) - stage.state.lead_s
    assert pose_deg == pytest.approx(stage.state.plan.at(horn_s)[0])
    assert place_deg == pytest.approx(pose_deg, abs=0.1)
    assert len(stage.sent) < 30
    set_rate(stage, 1.0)
    stage.run(6.0)
    assert stage.off_deg() < 4.5
    assert np.abs(stage.speeds_deg_s()).max() <= 180.0
    assert stage.state.place(stage.now_ns) == (-20.0, 0.0)
    assert stage.streamer.is_finished(stage.now_ns)
    assert stage.streamer.clock.show_s(stage.now_ns) > END_S


def test_at_half_the_speed_the_path_is_the_same_and_the_moves_of_the_program_are_left_out(kit):
    stage = StreamedShow(kit)
    set_rate(stage, 0.5)
    stage.run(6.0)
    assert stage.off_deg() < 1.5
    ticks_s = [at_s for at_s, line in stage.sent if 1.0 < at_s < 1.5]
    assert np.diff(ticks_s) == pytest.approx(0.04, abs=1e-6)
    assert stage.state.place(stage.now_ns) == (-20.0, 0.0)
    assert stage.streamer.clock.show_s(stage.now_ns) == pytest.approx(3.0, abs=0.2)
    assert stage.streamer.is_finished(stage.now_ns)


def test_back_at_full_speed_the_move_under_way_is_taken_up_with_what_is_left_of_it(kit):
    stage = StreamedShow(kit, (move(0.1, 80.0, 2.0), move(2.6, -20.0)), duration_s=4.0)
    set_rate(stage, 0.5)
    stage.run(1.0)
    set_rate(stage, 1.0)
    stage.run(8.0)
    ramp_end_s = (stage.streamer.clock.ramp_end_ns - START_NS) / 1e9
    taken_up = [line for at_s, line in stage.sent if at_s >= ramp_end_s - 1e-9]
    assert len(taken_up) == 2, "what is left, and the next one"
    assert stage.streamer.statistics.timing()["commands"] == len(stage.sent)
    shown_s = stage.streamer.clock.show_s(stage.streamer.clock.ramp_end_ns)
    left_ms = int(MOVE.fullmatch(taken_up[0])[3])
    assert left_ms == pytest.approx(1000 * (2.1 - shown_s), abs=3)
    assert taken_up[1] == b"#1D-200T800\r"
    assert stage.off_deg() < 2.0


def test_a_late_tick_of_a_ramp_is_counted_and_the_last_one_ends_with_it(kit):
    stage = StreamedShow(kit).run(0.5)
    set_rate(stage, 0.0)
    stage.run(2.0, late_s=0.003)
    assert stage.streamer.statistics.max_ns == pytest.approx(3 * MS, abs=MS // 10)
    (pose_deg,) = stage.streamer.pose_deg(stage.now_ns).values()
    assert stage.state.place(stage.now_ns)[0] == pytest.approx(pose_deg, abs=0.1)
    assert stage.streamer.statistics.timing()["commands"] == len(stage.sent)
    ticks_s = sorted({at_s for at_s, _ in stage.sent if at_s > 0.5})
    assert min(b - a for a, b in pairwise(ticks_s)) > 0.02


def test_it_may_start_anywhere_from_rest(kit):
    stage = StreamedShow(kit, (move(0.1, 80.0, 2.0), move(2.6, -20.0)), start_s=0.6, duration_s=4.0)
    stage.state.stand_at(stage.state.plan.at(0.6)[0])
    clock = stage.streamer.clock
    assert clock.rate(START_NS) == 0.0
    assert clock.show_s(START_NS + 100 * MS) < 0.62
    stage.run(6.0)
    assert sum(at_s < 0.25 for at_s, _ in stage.sent) > 4
    assert stage.places[0][1] == pytest.approx(0.6)
    assert stage.off_deg() < 3.0
    assert stage.sent[-1][1] == b"#1D-200T800\r"
    assert stage.streamer.clock.show_s(stage.now_ns) == pytest.approx(6.6, abs=0.3)


def test_a_lost_move_is_sent_again_at_once(kit):
    stage = StreamedShow(kit, has_feedback=True)
    stage.run(0.4)
    stage.state.stand_at(0.0)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns, stage.now_ns)
    assert stage.state.resent == 1
    stage.run(3.0)
    assert [at_s for at_s, _ in stage.sent[:2]] == [0.1, 0.4]
    assert [MOVE.fullmatch(line)[2] for _, line in stage.sent] == [b"400"] * 3 + [b"-200"]
    assert 0.5 < stage.sent[2][0] < 0.9, "when it has met its plan"
    assert stage.off_deg(from_s=1.0) < 1.0


def lose(stage):
    """Let the servo stand at 0, whatever was sent, and the scheduler find that."""
    stage.state.stand_at(0.0)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns, stage.now_ns)


def test_a_move_that_is_always_lost_is_given_up_until_the_next_one(kit):
    stage = StreamedShow(
        kit, (move(0.1, 40.0), move(6.0, -20.0)), has_feedback=True, duration_s=8.0
    )
    for number in range(2 * RETRIES_MAX):
        stage.run(0.4 + 0.1 * number)
        lose(stage)
    stage.run(5.9)
    assert stage.state.resent == RETRIES_MAX
    stage.run(6.3)
    lose(stage)
    assert stage.state.resent == RETRIES_MAX + 1


@pytest.mark.parametrize("ends", ["show", "brake"])
def test_no_joint_that_never_rests_keeps_a_show_from_its_end(kit, ends):
    stage = StreamedShow(kit, has_feedback=True).run(END_S if ends == "show" else 0.5)
    if ends == "brake":
        set_rate(stage, 0.0)
        stage.run(1.5)
    from_ns = stage.now_ns
    is_over = stage.streamer.is_finished if ends == "show" else stage.streamer.is_standing
    stage.streamer._has_arrived = lambda _: False
    longest_ns = round(1e9 * (ARRIVAL_MAX_S + SETTLE_S))
    assert not is_over(from_ns + longest_ns - 3 * S)
    assert is_over(from_ns + longest_ns)


@pytest.mark.parametrize("rate", [0.0, 0.5])
def test_a_lost_move_is_not_sent_again_while_the_show_is_slowed_down(kit, rate):
    stage = StreamedShow(kit, has_feedback=True)
    stage.run(0.4)
    set_rate(stage, rate)
    stage.run(2.0)
    sent = len(stage.sent)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns, stage.now_ns)
    assert (stage.line.take(), stage.state.resent, len(stage.sent)) == (b"", 0, sent)
    assert stage.streamer.scheduler.to_resend == {}


def test_the_deferred_rest_of_a_move_is_dropped_when_the_show_brakes(kit):
    stage = StreamedShow(kit, has_feedback=True).run(0.4)
    stage.state.stand_at(0.0)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns, stage.now_ns)
    assert stage.state.deferred is not None, "it catches up, and then has the rest of the move"
    set_rate(stage, 0.0)
    stage.run(3.0)
    assert stage.state.deferred is None
    assert stage.streamer.is_standing(stage.now_ns)
    pose_deg = stage.streamer.pose_deg(stage.now_ns)["j0"]
    assert stage.state.place(stage.now_ns)[0] == pytest.approx(pose_deg, abs=0.2)


def test_a_joint_that_is_left_out_has_no_deferred_target_and_does_not_delay_the_end(kit):
    stage = StreamedShow(kit, has_feedback=True).run(0.4)
    stage.state.stand_at(0.0)
    stage.streamer.leave_out({"j0"})
    sent = len(stage.sent)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns, stage.now_ns)
    stage.run(END_S + SETTLE_S)
    assert (len(stage.sent), stage.state.resent) == (sent, 0)
    stage.state.stand_at(-20.0)
    assert stage.streamer.is_finished(stage.now_ns)


def test_a_show_that_repeats_goes_on_and_is_never_over(kit):
    moves = (move(0.1, 40.0), move(1.1, 0.0))
    repeat = Repeat(from_us=0, to_us=2_000_000)
    stage = StreamedShow(kit, moves, duration_s=math.inf, repeat=repeat).run(9.0)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx(
        [0.1, 1.1, 2.1, 3.1, 4.1, 5.1, 6.1, 7.1, 8.1]
    )
    assert stage.off_deg() < 0.05
    assert not stage.streamer.is_finished(stage.now_ns)


@pytest.mark.parametrize("is_met", [True, False])
def test_it_stands_at_a_wait_until_that_is_met_or_its_time_is_over(kit, is_met):
    stage = StreamedShow(kit, waits=(waits_at(1.1, timeout_s=2.0),), has_feedback=True).run(2.0)
    assert [at_s for at_s, _ in stage.sent] == [0.1]
    assert stage.streamer.clock.show_s(stage.now_ns) == 1.1
    assert stage.streamer.rate_wanted == 1.0
    assert not stage.streamer.is_finished(stage.now_ns)
    if is_met:
        for _ in range(2):
            stage.streamer.waiting.take_reply("main", 209, 100)
    stage.run(6.0)
    goes_on_s = 2.1 if is_met else 3.2
    assert [at_s for at_s, _ in stage.sent] == pytest.approx([0.1, goes_on_s], abs=0.01)
    states = [notice.state for notice in stage.streamer.waiting.take_notices()]
    assert states == ["begun", "met" if is_met else "timeout"]


def test_a_rate_that_is_set_during_a_wait_holds_after_it(kit):
    stage = StreamedShow(kit, waits=(waits_at(1.1, timeout_s=1.0),), has_feedback=True).run(1.5)
    set_rate(stage, 0.5)
    assert stage.streamer.rate_wanted == 0.5
    assert stage.streamer.clock.target_rate == 0.0
    stage.run(6.0)
    assert stage.streamer.clock.show_s(stage.now_ns) == pytest.approx(1.1 + 0.5 * 3.9, abs=0.01)
    assert stage.off_deg() < 1.5


def test_what_is_not_due_yet_may_be_replaced(kit):
    stage = StreamedShow(kit)
    stage.streamer.is_open = True
    stage.run(0.5)
    moves = (move(1.0, 40.0), move(1.5, 60.0))
    whole = replace(stage.program, moves=(*THERE_AND_BACK[:1], *moves))
    table = profiles(whole, stage.robot)["j0"].table
    later = PiecewiseProfile.of(tuple(column[table[0] > 0.95] for column in table))
    planned_deg, _ = stage.state.plan.at(0.5)
    extension = Extension(
        from_us=1_000_000, moves=moves, duration_s=3.0, profiles={"j0": later}, line_use={},
        tolerance_deg=0.2,
    )  # fmt: skip
    assert stage.streamer.extend(extension, stage.now_ns)
    stage.run(1.2)
    assert stage.state.plan.at(0.5)[0] == pytest.approx(planned_deg), "an answer may be so old"
    assert not stage.streamer.extend(extension, stage.now_ns), "that would be too late"
    stage.run(2.6)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx([0.1, 1.0, 1.5])
    assert stage.off_deg() < 0.1
    stage.streamer.is_open = False
    assert not stage.streamer.is_finished(stage.now_ns)
    stage.run(3.0 + SETTLE_S)
    assert stage.streamer.is_finished(stage.now_ns)


def test_lines_are_quiet_until_the_next_move(kit):
    stage = StreamedShow(kit).run(0.5)
    assert stage.streamer.quiet_ns(stage.now_ns) == START_NS + 1200 * MS
    stage.state.defer(START_NS + 800 * MS, 40.0)
    assert stage.streamer.quiet_ns(stage.now_ns) == START_NS + 800 * MS
    assert stage.streamer.next_wakeup_ns(stage.now_ns) == START_NS + 800 * MS
    stage.state.deferred = None
    stage.run(1.5)
    assert stage.streamer.quiet_ns(stage.now_ns) is None
    stage.state.defer(START_NS + 1600 * MS, 5.0)
    assert stage.streamer.quiet_ns(stage.now_ns) == START_NS + 1600 * MS
    assert stage.streamer.quiet_ns(START_NS + 1700 * MS) == START_NS + 1700 * MS


def test_a_streamed_joint_is_led_through_a_pause_and_then_has_its_own_moves_again(kit):
    joint = kit.joint("j0", 2, drive="streamed")
    steps_s = np.arange(0.1043, 2.0, 0.02)  # Where its filter is assumed to take them.
    moves = [move(s, 30.0 * np.sin(3.0 * (s - 0.1)), None, servo_id=2) for s in steps_s]
    stage = StreamedShow(kit, moves, joint=joint).run(0.5)
    set_rate(stage, 0.0)
    stage.run(2.0)
    assert stage.streamer.is_standing(stage.now_ns)
    ramp_s = [at_s for at_s, _ in stage.sent if 0.52 < at_s < 0.78]
    assert np.diff(ramp_s) == pytest.approx(0.02, abs=2e-3), "with every step of its filter"
    still = len(stage.sent)
    stage.run(2.5)
    assert len(stage.sent) == still, "nothing is said while it stands"
    set_rate(stage, 1.0)
    stage.run(6.0)
    ramp_s = [at_s for at_s, _ in stage.sent if 2.7 < at_s < 2.8]
    assert len(ramp_s) > 3
    assert np.diff(ramp_s) == pytest.approx(0.02, abs=2e-3)
    own = {one.data for one in moves}
    assert all(line in own for at_s, line in stage.sent if at_s > 3.5)
    assert min(np.diff([at_s for at_s, _ in stage.sent if at_s > 2.6])) > 0.01
    assert stage.streamer.statistics.timing()["commands"] == len(stage.sent)
    assert stage.streamer.statistics.max_ns < MS
    assert stage.off_deg() < 1.0
    assert stage.streamer.is_finished(stage.now_ns)


def test_after_a_recovery_it_goes_on_at_rate_0_from_where_servos_were_sent(kit):
    stage = StreamedShow(kit, has_feedback=True)
    stage.run(0.4)
    set_rate(stage, 0.0)
    stage.run(2.0)
    stage.streamer.leave_out({"j0"})
    before = stage.streamer.scheduler
    place_deg = stage.state.place(stage.now_ns)[0]
    stage.streamer.resume({"j0": place_deg + 0.3}, ())
    assert stage.state.place(stage.now_ns) == (place_deg + 0.3, 0.0)
    assert stage.streamer.scheduler is not before
    stage.streamer.scheduler.poll = lambda *_: None
    set_rate(stage, 1.0)
    stage.run(6.0)
    assert stage.state.place(stage.now_ns) == (-20.0, 0.0)
    assert re.fullmatch(rb"#1D-200T\d+\r", stage.sent[-1][1])


def test_a_joint_at_rest_in_its_place_is_sent_nothing_when_a_pause_ends(kit):
    moves = (move(0.1, 40.0), move(2.0, -20.0))
    stage = StreamedShow(kit, moves, duration_s=3.0).run(1.0)
    set_rate(stage, 0.0)
    stage.run(2.0)
    set_rate(stage, 1.0)
    stage.run(5.0)
    assert [line for _, line in stage.sent] == [one.data for one in moves]


def test_in_a_pause_it_wakes_when_it_stands_and_is_not_over_even_at_its_end(kit):
    stage = StreamedShow(kit).run(END_S + 0.05)
    set_rate(stage, 0.0)
    stage.step()
    while stage.streamer.clock.is_ramping(stage.now_ns):
        stage.now_ns = stage.streamer.next_wakeup_ns(stage.now_ns)
        stage.step()
    settled_ns = stage.streamer.clock.ramp_end_ns + round(1e9 * SETTLE_S)
    assert stage.streamer.next_wakeup_ns(stage.now_ns) == settled_ns
    assert stage.streamer.show_s(settled_ns) > END_S + SETTLE_S
    assert not stage.streamer.is_finished(settled_ns)


def test_a_small_change_of_the_rate_takes_no_longer_than_it_must(kit):
    stage = StreamedShow(kit, (move(0.1, 80.0),)).run(0.5)
    set_rate(stage, 0.9)
    assert stage.streamer.clock.ramp_end_ns - stage.now_ns == 300 * MS


def test_between_two_ticks_of_a_slower_show_lines_are_quiet(kit):
    stage = StreamedShow(kit)
    set_rate(stage, 0.5)
    stage.run(0.71)
    wakeup_ns = stage.streamer.next_wakeup_ns(stage.now_ns)
    assert stage.streamer.quiet_ns(stage.now_ns) == wakeup_ns < stage.now_ns + 40 * MS


def test_what_is_left_out_owes_nothing_and_the_others_what_they_owe(kit):
    stage = StreamedShow(kit)
    stage.state.defer(START_NS + S, 5.0)
    stage.streamer.leave_out(())
    assert stage.state.resend_ns == START_NS + S
    stage.streamer.leave_out({"j0"})
    assert stage.state.resend_ns is None


def test_the_scheduler_polls_while_lines_are_quiet_and_receives_every_answer(kit):
    stage, calls = StreamedShow(kit, has_feedback=True), []
    stage.streamer.scheduler.poll = lambda *args: calls.append(args)
    stage.streamer.scheduler.receive = lambda *args: calls.append(args[:3])
    stage.step()
    assert calls == [(START_NS, START_NS + 100 * MS)]
    reply = Reply(1, "QD", 5)
    stage.streamer.receive("main", reply, START_NS + MS, START_NS + MS)
    assert calls[1:] == [("main", reply, START_NS + MS)]


def test_before_its_first_move_a_servo_cannot_have_missed_one(kit):
    stage = StreamedShow(kit, has_feedback=True).run(0.05)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns, stage.now_ns)
    assert (stage.line.take(), stage.state.resent) == (b"", 0)


@pytest.mark.parametrize("is_met", [True, False])
def test_a_slower_show_stands_at_a_wait_on_its_path_and_goes_on_as_slowly(kit, is_met):
    waits = (waits_at(0.6, timeout_s=2.0),)
    stage = StreamedShow(kit, waits=waits, has_feedback=True)
    set_rate(stage, 0.5)
    stage.run(2.5)
    assert stage.streamer.show_s(stage.now_ns) == 0.6
    (pose_deg,) = stage.streamer.pose_deg(stage.now_ns).values()
    assert stage.state.place(stage.now_ns)[0] == pytest.approx(pose_deg, abs=0.1)
    if is_met:
        for _ in range(2):
            stage.streamer.waiting.take_reply("main", 209, 100)
    stage.run(8.0)
    assert stage.off_deg() < 4.0
    begins_s = 2.5 if is_met else 3.0
    assert min(at_s for at_s, _ in stage.sent if at_s > 2.0) == pytest.approx(begins_s, abs=0.3)
    assert stage.state.place(stage.now_ns) == (-20.0, 0.0)


def test_before_the_first_move_another_rate_sends_nothing(kit):
    stage = StreamedShow(kit, (move(2.0, 40.0),), duration_s=3.0)
    set_rate(stage, 0.5)
    stage.run(0.5)
    set_rate(stage, 1.0)
    stage.run(5.0)
    assert [line for _, line in stage.sent] == [b"#1D400T800\r"]


# ---- due

ENDLESS = float("inf")


def move_of_due(due_us, servo_id=1):
    return Move(due_us=due_us, bus="main", servo_id=servo_id, target_wire=0, duration_ms=100)


def moves(*dues_us, servo_id=1):
    return [(due_us, move_of_due(due_us, servo_id)) for due_us in dues_us]


def left(due_moves, before_us=ENDLESS):
    found = []
    while due_moves.first(before_us) is not None:
        due = due_moves.pop()
        found.append((due.at_us, due.due_us))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_all_moves_leave_in_the_order_of_their_instants(seed):
    random = Random(seed)
    early_us = {servo_id: random.randint(-30_000, EARLY_MAX_US) for servo_id in range(6)}
    listed = sorted((random.randrange(2_000_000), random.randrange(6)) for _ in range(300))
    due_moves = DueMoves(
        iter([(due_us, move_of_due(due_us, servo_id)) for due_us, servo_id in listed]),
        lambda one: early_us[one.servo_id],
    )
    found = left(due_moves)
    assert [at_us for at_us, _ in found] == sorted(at_us for at_us, _ in found)
    assert sorted(found) == sorted((due - early_us[servo], due) for due, servo in listed)


def test_a_move_overtakes_none_of_its_servo_when_its_lag_is_believed_longer():
    """Seed 20098: damaged answers made a lag of 60 ms, and a joint went to and fro."""
    early_us = {1: 0, 2: 0}
    both = sorted(moves(*range(0, 400_000, 20_000)) + moves(*range(0, 400_000, 20_000), servo_id=2))
    due_moves = DueMoves(iter(both), lambda one: early_us[one.servo_id])
    found = []
    while due_moves.first(ENDLESS) is not None:
        found.append(due_moves.pop())
        early_us[1] = EARLY_MAX_US if len(found) % 8 < 4 else 0
    for servo_id in (1, 2):
        own = [due for due in found if due.move.servo_id == servo_id]
        assert [due.due_us for due in own] == list(range(0, 400_000, 20_000))
        assert all(0 <= due.due_us - due.at_us <= EARLY_MAX_US for due in own)
    assert [due.at_us for due in found] == sorted(due.at_us for due in found)
    assert len({due.due_us - due.at_us for due in found}) > 2


def test_a_walk_without_end_is_not_looked_through_to_its_end():
    endless = ((10_000 * number, move_of_due(10_000 * number)) for number in count())
    assert DueMoves(endless, lambda _: 500).first(ENDLESS).due_us == 0


def begun(seed):
    """Return moves of joints that lag differently, some of which have left; and what is to come.

    What is to come are `(due_us, servo_id)`, and how much earlier each servo's moves leave.
    """
    random = Random(seed)
    early_us = {servo_id: random.randint(-30_000, EARLY_MAX_US) for servo_id in range(6)}
    dues = sorted((random.randrange(1_000_000), servo_id) for servo_id in 25 * list(range(6)))
    due_moves = DueMoves(
        iter([(due_us, move_of_due(due_us, servo_id)) for due_us, servo_id in dues]),
        lambda one: early_us[one.servo_id],
    )
    for _ in range(40):
        due_moves.first(ENDLESS)
        due = due_moves.pop()
        dues.remove((due.due_us, due.move.servo_id))
    return due_moves, dues, early_us


@pytest.mark.parametrize("seed", range(5))
def test_what_was_passed_by_is_named_in_order_and_the_rest_leaves_in_order(seed):
    due_moves, dues, early_us = begun(seed)
    until_us = Random(seed).choice([dues[3][0], dues[20][0], dues[90][0]])
    passed = [(due_us, one.servo_id) for due_us, one in due_moves.pass_by(until_us)]
    assert passed == [one for one in dues if one[0] <= until_us]
    rest = [(due - early_us[servo], due) for due, servo in dues if due > until_us]
    assert left(due_moves) == sorted(rest)


@pytest.mark.parametrize("seed", range(5))
def test_what_was_due_before_a_replacement_still_leaves_in_order(seed):
    due_moves, dues, early_us = begun(seed)
    from_us = Random(seed).choice([dues[3][0], dues[20][0], dues[90][0]])
    due_moves.replace_from(from_us, [move_of_due(from_us + 7, 1)])
    kept = [one for one in dues if one[0] < from_us] + [(from_us + 7, 1)]
    assert left(due_moves) == sorted((due - early_us[servo], due) for due, servo in kept)


def test_what_is_due_after_a_wait_does_not_leave_before_it():
    due_moves = DueMoves(iter(moves(100, 1000, 1001)), lambda _: 500)
    assert left(due_moves, before_us=1001) == [(-400, 100), (500, 1000)]
    assert due_moves.first(1001) is None
    assert left(due_moves) == [(501, 1001)]


# ---- catching up

LATE_NS = 50_000_000
CLOCK = ShowClock(0, 0.0, 1.0)


def rejoin(state, line, show_s):
    """Say at rate 1 what is left of the move under way; return the bytes."""
    rate_ramps.rejoin(state, line, CLOCK, lambda show_s: show_s, round(1e9 * show_s))
    return line.take()


def far_off_deg(state, from_s, to_s, offset_deg=0.0):
    """Return by how much the profile is off the plan between two instants, at the most."""
    instants_s = np.arange(from_s, to_s, 0.005)
    pairs = [(state.profile.at(s)[0], state.plan.at(s)[0]) for s in instants_s]
    return max(abs(told_deg - planned_deg - offset_deg) for told_deg, planned_deg in pairs)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("late_ns", "offset_deg"), [(LATE_NS, 0.0), (LATE_NS, 1.0), (15_000_000, 0.0)]
)
def test_one_that_is_behind_goes_faster_until_it_meets_its_plan_and_arrives_on_time(
    kit, line, sign, late_ns, offset_deg
):
    state = timed(kit, travel(40.0 * sign))
    state.disturbance.offset_deg = offset_deg
    state.note_sent(late_ns, round(10 * (40.0 * sign + offset_deg)), 1000)
    behind_deg = sign * (offset_deg + state.plan.at(0.3)[0] - state.profile.at(0.3)[0])
    rejoin(state, line, 0.3)
    resend_ns = state.deferred.resend_ns
    assert state.resend_ns == resend_ns
    _, speed_deg_s = state.profile.at(resend_ns / 1e9)
    assert 0.4 < resend_ns / 1e9 < 0.46
    assert speed_deg_s == pytest.approx(sign * (40.0 + behind_deg / JOIN_S), abs=1.0)
    send_deferred(state, line, resend_ns)
    assert state.deferred is None
    slows_down_s = behind_deg / JOIN_S / state.limits.ramp_deg_s2
    assert far_off_deg(state, resend_ns / 1e9 + slows_down_s, 1.2, offset_deg) < 0.15


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("way_deg", "show_s", "arrival_s"),
    [
        (20.0, 0.05, None),
        (20.0, 0.5, None),
        (40.0, 0.2, None),
        (80.0, 0.05, None),
        (80.0, 0.2, None),
        (80.0, 0.2, 0.15),
        (80.0, 0.1, 0.05),
    ],
)
def test_one_that_rests_or_gathers_speed_meets_its_plan_and_does_not_pass_it(
    kit, line, sign, way_deg, show_s, arrival_s
):
    state = timed(kit, travel(way_deg * sign))
    if arrival_s is not None:
        state.note_sent(round(1e9 * arrival_s), round(10 * way_deg * sign), 1000)
    rejoin(state, line, show_s)
    resend_ns = state.deferred.resend_ns
    send_deferred(state, line, resend_ns)
    instants_s = np.arange(show_s, 1.2, 0.005)
    ahead_deg = [sign * (state.profile.at(s)[0] - state.plan.at(s)[0]) for s in instants_s]
    assert max(ahead_deg) < 0.2
    assert far_off_deg(state, resend_ns / 1e9 + 0.2, 1.2) < 0.2


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_is_far_behind_goes_as_fast_as_it_may(kit, line, sign):
    state = timed(kit, travel(80.0 * sign))
    assert rejoin(state, line, 0.3) == b"#1D%dT445\r" % (800 * sign)
    resend_ns = state.deferred.resend_ns
    send_deferred(state, line, resend_ns)
    assert state.deferred is None
    assert far_off_deg(state, 0.95, 1.2) < 0.2
    assert max(abs(state.profile.at(s)[1]) for s in np.arange(0.3, 1.2, 0.005)) <= 180.0


@pytest.mark.parametrize("show_s", [0.9, 1.5])
def test_one_that_cannot_meet_its_plan_any_more_arrives_as_soon_as_it_may(kit, line, show_s):
    state = timed(kit, travel(80.0))
    assert rejoin(state, line, show_s) == b"#1D800T445\r"
    assert state.deferred is None
    assert state.profile.at(show_s + 0.8) == (80.0, 0.0)


def test_one_whose_move_ends_where_it_began_has_the_rest_of_its_time(kit, line):
    back = travel(18.7, due_s=0.5, lasts_s=0.4)
    state = timed(kit, travel(40.0), back)
    state.begin_move(back)
    assert state.plan.at(state.begun_s(line))[0] == pytest.approx(18.7, abs=0.1)
    state.stand_at(40.0)
    assert rejoin(state, line, 0.6) == b"#1D187T300\r"
    assert state.deferred is None


def test_a_deferred_target_has_no_longer_t_than_any_move(kit, line):
    state = timed(kit, travel(80.0))
    state.defer(0, 80.0, 2.0)
    send_deferred(state, line, 0)
    assert line.take() == b"#1D800T9999\r"


def test_one_whose_plan_is_as_fast_as_it_may_go_has_the_rest_of_its_time(kit, line):
    state = timed(kit, travel(40.0), speed_max_deg_s=40.0)
    state.note_sent(LATE_NS, 400, 1000)
    assert re.fullmatch(rb"#1D400T7\d\d\r", rejoin(state, line, 0.3))
    assert state.deferred is None


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_is_turned_back_travels_as_fast_as_its_plan_however_far_off_it_is(kit, line, sign):
    there, back = travel(40.0 * sign), travel(-10.0 * sign, due_s=0.5, lasts_s=0.6)
    state = timed(kit, there, back)
    state.disturbance.offset_deg = 1.5
    state.note_sent(100_000_000, 400 * sign + 15, 1000)
    state.begin_move(back)
    state.send_active(line, on_time_s(state, line, CLOCK.show_s, 500_000_000), 500_000_000)
    for at_s in (0.7, 0.75, 0.8):
        assert state.profile.at(at_s)[1] == pytest.approx(state.plan.at(at_s)[1], abs=0.3)
    assert abs(state.plan.at(0.75)[1]) > 40.0, "it travels"


@pytest.mark.parametrize("sign", [1, -1])
def test_one_that_cannot_stop_at_its_target_comes_back_as_fast_as_its_plan_travels(kit, line, sign):
    """T of the plan would give it a fifth of that speed, as it is so near its target."""
    there, on = travel(40.0 * sign), travel(20.0 * sign, due_s=0.5, lasts_s=0.4)
    state = timed(kit, there, on)
    arrival_ns = line.arrival_ns(len(on.data), 500_000_000)
    planned_way_deg = 20.0 * sign - state.plan.at(CLOCK.show_s(arrival_ns))[0]
    for start_deg in (0.0, 20.0 * sign - 0.2 * planned_way_deg):
        state.stand_at(start_deg - (state.place(arrival_ns)[0] if start_deg else 0.0))
        state.note_sent(200_000_000, round(10 * (state.place(0)[0] + 60.0 * sign)), 1500)
    state.begin_move(on)
    time_s = on_time_s(state, line, CLOCK.show_s, 500_000_000)
    assert time_s == pytest.approx(0.2 * 0.4, rel=0.1)


def test_else_it_has_its_own_time(kit, line):
    there, back = travel(40.0), travel(0.0, due_s=0.5, lasts_s=0.4)
    state = timed(kit, there, back)

    def travels_s(move, show_s=0.5):
        state.begin_move(move)
        return on_time_s(state, line, lambda _: show_s, 500_000_000)

    state.stand_at(10.0)
    assert travels_s(back) != 0.4
    assert travels_s(back._replace(duration_ms=None)) == 0.0
    assert travels_s(there) == 1.0, "it goes on"
    assert travels_s(back._replace(target_wire=-50), -1.0) == 0.4, "the plan rests"
    assert travels_s(there, 3.0) == 1.0, "the plan is there"
    for beyond_deg in (0.0, -10.0):
        state.stand_at(beyond_deg)
        assert travels_s(back) == 0.4, "it has been there"


# ---- leading

STEP_NS, TOLERANCE_DEG, UNIT_DEG = 20_000_000, 0.2, 0.1


@pytest.fixture
def state(kit):
    return kit.state(kit.joint("j0", 2, drive="streamed"))


def led(
    state,
    planned_deg,
    *,
    until_s=None,
    now_ns=STEP_NS,
    period_ns=STEP_NS,
    is_even=False,
    baud_bps=115200,
):
    """Guide a joint along `planned_deg(instant_s)` until guiding ends, or until `until_s`.

    Return when it received which target: `(ns, degrees)`.
    """
    line = SerialLine(Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370))
    state.guide_at(now_ns)
    received = []

    def planned(_, at_ns):
        return planned_deg(at_ns / 1e9)

    while state.guide_ns is not None and (until_s is None or state.guide_ns < until_s * 1e9):
        now_ns = max(state.guide_ns, line.free_ns)
        guide(state, line, planned, now_ns, period_ns, is_even=is_even)
        target = re.fullmatch(rb"#2D(-?\d+)\r", line.take())
        received.append((state.last_arrival_ns, int(target[1]) / 10))
        assert now_ns < 10e9, "it arrives some time"
    return received


@pytest.mark.parametrize("target_deg", [80.0, -80.0])
def test_a_joint_that_is_led_far_keeps_its_limits_and_arrives(state, target_deg):
    received = led(state, lambda _: target_deg)
    end_s = received[-1][0] / 1e9
    assert 0.8 < end_s < 1.6, "80 deg at 180 deg/s, and two ramps of 0.3 s"
    assert state.profile.at(end_s + 1.0) == (target_deg, 0.0)
    for phase_s in np.arange(0.0, FILTER_S, 0.001):
        values = staircase(received, state.joint.filter_count, phase_s, end_s + 0.5)
        assert np.abs(np.diff(values)).max() <= 180.0 * FILTER_S + 0.05
        assert np.abs(felt(values)).max() <= 1.1 * 600.0 + TOLERANCE_DEG / FILTER_S**2
        assert np.abs(values).max() <= 80.05, "it does not go beyond"


def test_correction_and_range_hold_for_bare_targets_too(kit):
    state = kit.state(kit.joint("j0", 2, drive="streamed", position_max_deg=20.0))
    state.disturbance.offset_deg = 1.5
    received = led(state, lambda _: 10.0)
    assert state.profile.at(5.0) == (11.5, 0.0)
    led(state, lambda _: 20.0, now_ns=received[-1][0] + STEP_NS)
    assert state.profile.at(9.0) == (20.0, 0.0)


@pytest.mark.parametrize("speed_deg_s", [40.0, -40.0])
@pytest.mark.parametrize(("offset_deg", "early_s"), [(0.0, 0.0), (1.5, 0.015)])
def test_it_closes_up_on_a_plan_that_moves_and_keeps_to_it(state, speed_deg_s, offset_deg, early_s):
    state.disturbance.offset_deg, state.early_s = offset_deg, early_s
    led(state, lambda at_s: speed_deg_s * at_s, until_s=1.5)
    for at_s in np.arange(0.8, 1.45, 0.01):
        horn_s = at_s + state.lead_s + early_s
        position_deg, _ = state.profile.at(at_s)
        assert position_deg == pytest.approx(speed_deg_s * horn_s + offset_deg, abs=UNIT_DEG)


def test_where_the_line_is_busy_it_is_on_its_plan_after_every_second_step(state):
    received = led(state, lambda at_s: 40.0 * at_s, until_s=1.5, period_ns=2 * STEP_NS)
    steps = [state.profile.acts_on(at_ns / 1e9) for at_ns, _ in received]
    assert steps[1] - steps[0] <= 2, "no filter uses the first target a step longer"
    assert {b - a for a, b in pairwise(steps[1:])} == {2}
    for step in steps[-10:-1]:
        wanted_deg = 40.0 * (state.profile.step_s(step) - FILTER_S / 2 + state.lead_s)
        assert state.profile.value(step - 1) == pytest.approx(wanted_deg, abs=UNIT_DEG)


def test_guiding_targets_arrive_one_step_of_the_filter_after_another(state):
    """A filter whose target is late brakes by itself."""
    received = led(state, lambda at_s: -60.0 - 8.0 * at_s, until_s=1.5, baud_bps=19200)
    gaps_s = np.diff([at_ns / 1e9 for at_ns, _ in received])
    assert gaps_s.max() < FILTER_S + 1e-5
    assert gaps_s[10:] == pytest.approx(FILTER_S, abs=1e-5)


@pytest.mark.parametrize(("off_deg", "steps"), [(0.5, 4), (-2.0, 7), (5.0, 10)])
def test_what_is_near_closes_up_in_little_more_than_half_the_time_of_the_filter(
    state, off_deg, steps
):
    begun = state.profile.acts_on(led(state, lambda _: off_deg)[0][0] / 1e9) - 1
    assert state.profile.value(begun + steps) == pytest.approx(off_deg, abs=UNIT_DEG)
    count = state.joint.filter_count
    assert abs(off_deg) * (1.0 - 1.0 / count) ** steps > UNIT_DEG, "the filter alone is not there"


def move_to(target_deg):
    return Move(0, "main", 2, round(10 * target_deg), None)


def test_a_joint_that_is_on_its_plan_gets_the_move_of_the_program_and_is_led_no_more(state):
    state.begin_move(move_to(1.9))
    assert led(state, lambda _: 0.9 * TOLERANCE_DEG, is_even=True) == [(state.last_arrival_ns, 1.9)]
    assert state.resend_ns is None


@pytest.mark.parametrize(
    ("off_deg", "is_even", "active"),
    [
        (1.5 * TOLERANCE_DEG, True, move_to(1.9)),
        (-1.5 * TOLERANCE_DEG, True, move_to(1.9)),
        (0.9 * TOLERANCE_DEG, False, move_to(1.9)),
        (0.9 * TOLERANCE_DEG, True, None),
    ],
    ids=["too far", "too far back", "the show is slowed down", "no move of the program yet"],
)
def test_else_it_is_led_on(state, off_deg, is_even, active):
    state.begin_move(active)
    ((_, target_deg),) = led(state, lambda _: off_deg, is_even=is_even, until_s=0.021)
    assert abs(target_deg) < 1.0
    assert state.guide_ns is not None
