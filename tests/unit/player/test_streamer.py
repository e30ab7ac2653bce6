"""One program, move by move: what leaves when, at any rate of the show, and where that leads."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from lss_motion.player.query_tracker import QueryTracker
from lss_motion.player.serial_line import SerialLine
from lss_motion.player.streamer import SETTLE_S, Streamer
from lss_motion.program.model import Driving, Move, Program, Repeat
from lss_motion.program.response import PiecewiseProfile
from lss_motion.program.splice import Extension
from lss_motion.program.verify import profiles
from lss_motion.protocol.line import Reply
from lss_motion.robot.model import Bus, Sensor
from lss_motion.sequence.model import Wait
from lss_motion.trajectory.model import WaitPoint
from tests.timed_moves import MOVE

MS, S = 1_000_000, 1_000_000_000
START_NS = 7 * S
"""On the run clock; all instants below are seconds after it."""
END_S = 2.2


def move(due_s, target_deg, lasts_s=0.8, servo_id=1):
    lasts_ms = None if lasts_s is None else round(1000 * lasts_s)
    return Move(round(1e6 * due_s), "main", servo_id, round(10 * target_deg), lasts_ms)


THERE_AND_BACK = (move(0.1, 40.0), move(1.2, -20.0))


class Stage:
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
        """With feedback, too, no question is asked."""
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
            lines={"main": self.line},
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
        """`(s, show s, where the profile of j0 is, where the plan wants it)`."""
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
    stage = Stage(kit).run(3.0)
    assert stage.sent == [(0.1, THERE_AND_BACK[0].data), (1.2, THERE_AND_BACK[1].data)]
    timing = stage.streamer.statistics.timing()
    assert (timing["commands"], timing["missed"], timing["late_max_us"]) == (2, 0, 0)
    assert stage.off_deg() < 0.05


@pytest.mark.parametrize("is_starved", [False, True])
def test_questions_wait_until_the_moves_have_left_unless_they_have_waited_too_long(kit, is_starved):
    dense = [move(0.1 + 0.02 * number, 40.0) for number in range(10)]
    stage, last_sent_ns = Stage(kit, dense, has_feedback=True), set()
    stage.streamer.scheduler.poll = lambda *_: last_sent_ns.add(stage.now_ns)
    stage.streamer.scheduler.is_starved = lambda _: is_starved
    stage.run(0.3)
    sent_ns = {START_NS + round(1e9 * at_s) for at_s, _ in stage.sent}
    assert len(sent_ns) == len(dense)
    assert sent_ns & last_sent_ns == (sent_ns if is_starved else set())
    assert {at_ns + 1 for at_ns in sent_ns} <= last_sent_ns


def test_a_show_starts_with_what_is_due_before_its_time_0(kit):
    stage = Stage(kit, (move(-0.05, 40.0), move(1.2, -20.0))).run(3.0)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx([0.0, 1.25])
    assert stage.streamer.show_s(START_NS) == -0.05
    assert stage.state.origin_s == pytest.approx(START_NS / 1e9 + 0.05)


def test_it_is_over_when_all_has_come_to_rest_and_not_before(kit):
    stage = Stage(kit).run(END_S)
    assert stage.streamer.next_wakeup_ns(stage.now_ns) == START_NS + round(1e9 * (END_S + SETTLE_S))
    assert not stage.streamer.is_finished(stage.now_ns)
    assert not stage.streamer.is_finished(START_NS + round(1e9 * (END_S + SETTLE_S)) - 1)
    assert stage.streamer.is_finished(START_NS + round(1e9 * (END_S + SETTLE_S)))
    stage.streamer.keep_open()
    assert not stage.streamer.is_finished(START_NS + 10 * S)


def test_what_was_told_late_is_waited_for(kit):
    stage = Stage(kit, (move(0.1, 40.0), move(2.0, -40.0))).run(1.9)
    stage.now_ns = START_NS + round(2.4e9)
    stage.step()
    assert not stage.streamer.is_finished(stage.now_ns)
    assert not stage.streamer.is_finished(START_NS + 3 * S)
    assert stage.streamer.is_finished(START_NS + round(3.5e9))


def test_all_joints_must_have_come_to_rest(kit):
    moves = (move(0.1, 40.0), move(0.2, 40.0, servo_id=2))
    stage = Stage(kit, moves, others=[kit.joint("j1", 2)], duration_s=0.3).run(0.6)
    assert stage.streamer.joint_states["j0"].is_at_rest(START_NS + 1040 * MS)
    assert not stage.streamer.is_finished(START_NS + 1040 * MS)
    assert stage.streamer.is_finished(START_NS + 1200 * MS)


@pytest.mark.parametrize(("late_s", "said"), [(0.0004, b"T800"), (0.2, b"T600"), (0.9, b"T223")])
def test_a_late_move_has_what_is_left_of_its_time(kit, late_s, said):
    stage = Stage(kit, (move(0.1, 40.0),)).run(0.05)
    stage.now_ns = START_NS + round(1e9 * (0.1 + late_s))
    stage.step()
    assert stage.sent[0][1] == b"#1D400%b\r" % said
    assert stage.streamer.statistics.max_ns == pytest.approx(1e9 * late_s, abs=10)


def test_a_move_that_waits_for_the_line_is_late_by_that(kit):
    stage = Stage(kit, (move(0.1, 40.0),)).run(0.05)
    stage.line.send(b"." * 1200, START_NS + 100 * MS)
    stage.now_ns = START_NS + 100 * MS
    stage.step()
    assert stage.sent[0][1].endswith(b"#1D400T696\r")
    assert stage.streamer.statistics.max_ns == pytest.approx(104 * MS, rel=0.01)


def test_what_was_learnt_of_a_lag_lets_moves_leave_earlier(kit):
    stage = Stage(kit)
    stage.state.early_s = 0.03
    stage.run(3.0)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx([0.07, 1.17])


def test_a_joint_that_is_left_out_is_told_nothing_until_it_is_back(kit):
    stage = Stage(kit)
    stage.streamer.leave_out({"j0"})
    stage.run(1.0)
    assert stage.sent == []
    stage.streamer.leave_out(())
    stage.run(3.0)
    assert [at_s for at_s, _ in stage.sent] == [1.2]


@pytest.mark.parametrize("at_s", [0.35, 0.6, 1.25])
def test_a_pause_brakes_on_the_path_stands_and_goes_on_from_there(kit, at_s):
    stage = Stage(kit).run(at_s)
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
    stage = Stage(kit)
    set_rate(stage, 0.5)
    stage.run(6.0)
    assert stage.off_deg() < 1.5
    ticks_s = [at_s for at_s, line in stage.sent if 1.0 < at_s < 1.5]
    assert np.diff(ticks_s) == pytest.approx(0.04, abs=1e-6)
    assert stage.state.place(stage.now_ns) == (-20.0, 0.0)
    assert stage.streamer.clock.show_s(stage.now_ns) == pytest.approx(3.0, abs=0.2)
    assert stage.streamer.is_finished(stage.now_ns)


def test_back_at_full_speed_the_move_under_way_is_taken_up_with_what_is_left_of_it(kit):
    stage = Stage(kit, (move(0.1, 80.0, 2.0), move(2.6, -20.0)), duration_s=4.0)
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
    stage = Stage(kit).run(0.5)
    set_rate(stage, 0.0)
    stage.run(2.0, late_s=0.003)
    assert stage.streamer.statistics.max_ns == pytest.approx(3 * MS, abs=MS // 10)
    (pose_deg,) = stage.streamer.pose_deg(stage.now_ns).values()
    assert stage.state.place(stage.now_ns)[0] == pytest.approx(pose_deg, abs=0.1)
    assert stage.streamer.statistics.timing()["commands"] == len(stage.sent)
    ticks_s = sorted({at_s for at_s, _ in stage.sent if at_s > 0.5})
    assert min(b - a for a, b in pairwise(ticks_s)) > 0.02


def test_it_may_start_anywhere_from_rest(kit):
    stage = Stage(kit, (move(0.1, 80.0, 2.0), move(2.6, -20.0)), start_s=0.6, duration_s=4.0)
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


def test_what_a_servo_has_not_heard_is_said_again_at_once(kit):
    stage = Stage(kit, has_feedback=True)
    stage.run(0.4)
    stage.state.stand_at(0.0)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns)
    assert stage.state.resent == 1
    stage.run(3.0)
    assert [at_s for at_s, _ in stage.sent[:2]] == [0.1, 0.4]
    assert [MOVE.fullmatch(line)[2] for _, line in stage.sent] == [b"400"] * 3 + [b"-200"]
    assert 0.5 < stage.sent[2][0] < 0.9, "when it has met its plan"
    assert stage.off_deg(from_s=1.0) < 1.0


@pytest.mark.parametrize("rate", [0.0, 0.5])
def test_but_not_while_the_show_is_slowed_down_since_all_is_said_again_anyway(kit, rate):
    stage = Stage(kit, has_feedback=True)
    stage.run(0.4)
    set_rate(stage, rate)
    stage.run(2.0)
    sent = len(stage.sent)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns)
    assert (stage.line.take(), stage.state.resent, len(stage.sent)) == (b"", 0, sent)
    assert stage.streamer.scheduler.to_resend == {}


def test_what_it_is_owed_of_that_is_over_when_the_show_brakes(kit):
    stage = Stage(kit, has_feedback=True).run(0.4)
    stage.state.stand_at(0.0)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns)
    assert stage.state.deferred is not None, "it catches up, and then has the rest of the move"
    set_rate(stage, 0.0)
    stage.run(3.0)
    assert stage.state.deferred is None
    assert stage.streamer.is_standing(stage.now_ns)
    pose_deg = stage.streamer.pose_deg(stage.now_ns)["j0"]
    assert stage.state.place(stage.now_ns)[0] == pytest.approx(pose_deg, abs=0.2)


def test_one_that_is_left_out_is_owed_nothing_and_does_not_keep_the_show(kit):
    stage = Stage(kit, has_feedback=True).run(0.4)
    stage.state.stand_at(0.0)
    stage.streamer.leave_out({"j0"})
    sent = len(stage.sent)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns)
    stage.run(END_S + SETTLE_S)
    assert (len(stage.sent), stage.state.resent) == (sent, 0)
    stage.state.stand_at(-20.0)
    assert stage.streamer.is_finished(stage.now_ns)


def test_a_show_that_repeats_goes_on_and_is_never_over(kit):
    moves = (move(0.1, 40.0), move(1.1, 0.0))
    repeat = Repeat(from_us=0, to_us=2_000_000)
    stage = Stage(kit, moves, duration_s=math.inf, repeat=repeat).run(9.0)
    assert [at_s for at_s, _ in stage.sent] == pytest.approx(
        [0.1, 1.1, 2.1, 3.1, 4.1, 5.1, 6.1, 7.1, 8.1]
    )
    assert stage.off_deg() < 0.05
    assert not stage.streamer.is_finished(stage.now_ns)


@pytest.mark.parametrize("is_met", [True, False])
def test_it_stands_at_a_wait_until_that_is_met_or_its_time_is_over(kit, is_met):
    stage = Stage(kit, waits=(waits_at(1.1, timeout_s=2.0),), has_feedback=True).run(2.0)
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


def test_what_is_asked_for_during_a_wait_holds_after_it(kit):
    stage = Stage(kit, waits=(waits_at(1.1, timeout_s=1.0),), has_feedback=True).run(1.5)
    set_rate(stage, 0.5)
    assert stage.streamer.rate_wanted == 0.5
    assert stage.streamer.clock.target_rate == 0.0
    stage.run(6.0)
    assert stage.streamer.clock.show_s(stage.now_ns) == pytest.approx(1.1 + 0.5 * 3.9, abs=0.01)
    assert stage.off_deg() < 1.5


def test_what_is_not_due_yet_may_be_replaced(kit):
    stage = Stage(kit)
    stage.streamer.keep_open()
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
    stage.streamer.close()
    assert not stage.streamer.is_finished(stage.now_ns)
    stage.run(3.0 + SETTLE_S)
    assert stage.streamer.is_finished(stage.now_ns)


def test_lines_are_quiet_until_the_next_move(kit):
    stage = Stage(kit).run(0.5)
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
    steps_s = np.arange(0.1, 2.0, 0.02)
    moves = [move(s, 30.0 * np.sin(3.0 * (s - 0.1)), None, servo_id=2) for s in steps_s]
    stage = Stage(kit, moves, joint=joint).run(0.5)
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
    stage = Stage(kit, has_feedback=True)
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


def test_a_joint_that_rests_at_its_place_is_told_nothing_when_a_pause_ends(kit):
    moves = (move(0.1, 40.0), move(2.0, -20.0))
    stage = Stage(kit, moves, duration_s=3.0).run(1.0)
    set_rate(stage, 0.0)
    stage.run(2.0)
    set_rate(stage, 1.0)
    stage.run(5.0)
    assert [line for _, line in stage.sent] == [one.data for one in moves]


def test_in_a_pause_it_wakes_when_it_stands_and_is_not_over_even_at_its_end(kit):
    stage = Stage(kit).run(END_S + 0.05)
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
    stage = Stage(kit, (move(0.1, 80.0),)).run(0.5)
    set_rate(stage, 0.9)
    assert stage.streamer.clock.ramp_end_ns - stage.now_ns == 300 * MS


def test_between_two_ticks_of_a_slower_show_lines_are_quiet(kit):
    stage = Stage(kit)
    set_rate(stage, 0.5)
    stage.run(0.71)
    wakeup_ns = stage.streamer.next_wakeup_ns(stage.now_ns)
    assert stage.streamer.quiet_ns(stage.now_ns) == wakeup_ns < stage.now_ns + 40 * MS


def test_what_is_left_out_owes_nothing_and_the_others_what_they_owe(kit):
    stage = Stage(kit)
    stage.state.defer(START_NS + S, 5.0)
    stage.streamer.leave_out(())
    assert stage.state.resend_ns == START_NS + S
    stage.streamer.leave_out({"j0"})
    assert stage.state.resend_ns is None


def test_the_reader_asks_while_lines_are_quiet_and_hears_every_answer(kit):
    stage, calls = Stage(kit, has_feedback=True), []
    stage.streamer.scheduler.poll = lambda *args: calls.append(args)
    stage.streamer.scheduler.receive = lambda *args: calls.append(args[:3])
    stage.step()
    assert calls == [(START_NS, START_NS + 100 * MS)]
    reply = Reply(1, "QD", 5)
    stage.streamer.receive("main", reply, START_NS + MS)
    assert calls[1:] == [("main", reply, START_NS + MS)]


def test_before_its_first_move_a_servo_cannot_have_missed_one(kit):
    stage = Stage(kit, has_feedback=True).run(0.05)
    stage.streamer.scheduler.to_resend["j0"] = stage.state
    stage.streamer.receive("main", Reply(9, "QD", 0), stage.now_ns)
    assert (stage.line.take(), stage.state.resent) == (b"", 0)


@pytest.mark.parametrize("is_met", [True, False])
def test_a_slower_show_stands_at_a_wait_on_its_path_and_goes_on_as_slowly(kit, is_met):
    waits = (waits_at(0.6, timeout_s=2.0),)
    stage = Stage(kit, waits=waits, has_feedback=True)
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


def test_before_the_first_move_another_rate_says_nothing(kit):
    stage = Stage(kit, (move(2.0, 40.0),), duration_s=3.0)
    set_rate(stage, 0.5)
    stage.run(0.5)
    set_rate(stage, 1.0)
    stage.run(5.0)
    assert [line for _, line in stage.sent] == [b"#1D400T800\r"]
