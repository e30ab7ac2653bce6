"""Which servo is polled for what and when, and the use of the answers; the servos are a table."""

from __future__ import annotations

from collections import Counter
from itertools import groupby, pairwise
from types import MappingProxyType

import numpy as np
import pytest
from msgspec.structs import replace

from lss_motion.planning.trajectory.model import WaitPoint
from lss_motion.playing.player.cues import POLL_PERIOD_NS, Waiting
from lss_motion.playing.player.health import SILENT_QUERIES
from lss_motion.playing.player.polling import (
    BACKLOG_BYTES,
    LATE_NS,
    REST_MAX_NS,
    REST_RATIO,
    PollScheduler,
)
from lss_motion.playing.player.query_choice import (
    FILL_RATIO,
    HEALTH_KEYWORDS,
    HEALTH_LEAST,
    HEALTH_NS,
    LONGEST_NS,
    VISIT_NS,
)
from lss_motion.playing.player.query_tracker import STARVED_NS, STRAY_NS, QueryTracker, SerialLine
from lss_motion.playing.player.servo_model import PROMPT_LEAST, READ_BACK_NS, Probe
from lss_motion.playing.player.show_clock import ShowClock
from lss_motion.protocol.framing import Command, CommandParser, Reply, encode
from lss_motion.robot.model import Bus, Sensor
from lss_motion.robot.on_fault import Cause
from lss_motion.robot.servo_models import SERVO_MODELS
from lss_motion.show.model import Wait

MS, S = 1_000_000, 1_000_000_000
WAITS_NS = (300_000, 1_100_000)
"""Latencies of the servos, in turn."""
KNOWN_NS = 200 * MS
"""By then it is known how the servos answer."""
NO_PROBES = MappingProxyType({})
HEALTHY = {"Q": 6, "QT": 300, "QV": 12000, "QC": 200, "QA": 100}


def planned_deg(state, at_ns):
    """Return where a horn is that is on its course: that was the plan."""
    return state.profile.at(at_ns / 1e9 - state.lead_s)[0]


class PollingDesk:
    """A scheduler and the servos that answer it, in virtual time."""

    def __init__(
        self,
        *joint_states,
        baud_bps=115200,
        waiting=None,
        waits_ns=WAITS_NS,
        probes=NO_PROBES,
        pace=None,
    ):
        self._waits_ns = waits_ns
        self.joint_states = {state.joint.name: state for state in joint_states}
        self.line = SerialLine(Bus(name="main", port="sim://", baud_bps=baud_bps, firmware=370))
        self.tracker = QueryTracker(self.line)
        self.waiting = waiting or Waiting([], {}, 0.0)
        trackers = {"main": self.tracker}
        self.scheduler = PollScheduler(self.joint_states, trackers, self.waiting, probes, pace)
        self.asked = []
        """`(handed over ns, arrival ns, servo id, keyword)`."""
        self.values = {}
        """Answers by `(id, keyword)`, instead of those of `HEALTHY`; None: no answer."""
        self._free_ns = self._reply_ns = 0
        self._parser = CommandParser()
        self._coming = []

    def run(self, from_ns, until_ns, *, quiet_until_ns=lambda _: None, late_ns=0):
        now_ns = from_ns
        while now_ns < until_ns:
            while self._coming and self._coming[0][0] <= now_ns:
                arrival_ns, reply = self._coming.pop(0)
                self.scheduler.receive("main", reply, arrival_ns, planned_deg)
            self.ask(now_ns, quiet_until_ns(now_ns))
            wakeup_ns = self.scheduler.next_wakeup_ns(now_ns)
            wakeups_ns = [] if wakeup_ns is None else [wakeup_ns + late_ns]
            wakeups_ns += [arrival_ns for arrival_ns, _ in self._coming[:1]]
            wakeups_ns += [ns for ns in [quiet_until_ns(now_ns)] if ns is not None]
            now_ns = max(min(wakeups_ns, default=until_ns), now_ns + 1)
        return self

    def ask(self, now_ns, quiet_until_ns=None):
        self.scheduler.poll(now_ns, quiet_until_ns)
        self._hand_over(now_ns)

    def behind(self, now_ns, quiet_until_ns=None):
        """Poll behind moves that leave now."""
        self.line.take()
        self.scheduler.poll_behind(now_ns, quiet_until_ns)
        self._free_ns = self.line.free_ns - self.line.time_ns(len(self.line.out))
        self._hand_over(now_ns)

    def _hand_over(self, now_ns):
        for command in self._parser.feed(self.line.take()):
            size_bytes = len(encode(command))
            self._free_ns = max(self._free_ns, now_ns) + self.line.time_ns(size_bytes)
            self.asked.append((now_ns, self._free_ns, command.servo_id, command.keyword))
            self._answer(command)

    def _answer(self, command):
        key = (command.servo_id, command.keyword)
        value = self.values.get(key, HEALTHY.get(command.keyword, self._angle(command)))
        if value is None:
            return
        reply = Reply(command.servo_id, command.keyword, None if value == "" else value)
        begins_ns = max(self._free_ns + self._waits_ns[len(self.asked) % 2], self._reply_ns)
        self._reply_ns = begins_ns + self.line.time_ns(len(encode(reply)))
        self._coming.append((self._reply_ns, reply))

    def _angle(self, command):
        own = [t for t in self.joint_states.values() if t.joint.servo_id == command.servo_id]
        if not own:
            return None
        if command.keyword == "QDT":
            return round(10 * own[0].profile.target_deg)
        return round(10 * planned_deg(own[0], self._free_ns))

    def counts(self, from_ns=0):
        """Return the number of position queries to each servo."""
        since = (entry for entry in self.asked if entry[0] > from_ns)
        return Counter(one for *_, one, word in since if word == "QD")


def joints(kit, count, **fields):
    return [kit.state(kit.joint(f"j{i}", i + 1, **fields)) for i in range(count)]


def test_every_servo_gets_health_queries_in_turn_and_position_queries_always(kit):
    desk = PollingDesk(*joints(kit, 3)).run(0, S)
    for servo_id in (1, 2, 3):
        own = [(at_ns, word) for at_ns, _, one, word in desk.asked if one == servo_id]
        health = [(at_ns, word) for at_ns, word in own if word != "QD"]
        words = [word for _, word in health]
        assert words == [HEALTH_KEYWORDS[i % len(HEALTH_KEYWORDS)] for i in range(len(words))]
        assert len(words) > 2 * len(HEALTH_KEYWORDS)
        assert words[:6] == ["Q", "QT", "Q", "QV", "Q", "QC"]
        assert all("QD" in (a, b) for (_, a), (_, b) in pairwise(own)), "one thing at a time"
        assert max(b - a for (a, _), (b, _) in pairwise(health)) < 1.2 * HEALTH_NS
        assert len(own) > 4 * len(health)
    counts = desk.counts()
    assert max(counts.values()) < 1.1 * min(counts.values())
    assert {state.temperature_max_c for state in desk.joint_states.values()} == {30.0}
    assert {state.voltage_min_v for state in desk.joint_states.values()} == {12.0}
    assert {state.current_max_a for state in desk.joint_states.values()} == {0.2}
    assert {state.status.value for state in desk.joint_states.values()} == {"holding"}


def test_a_slow_line_is_not_spent_on_health(kit):
    """With many servos there are no rows: all are visited."""
    desk = PollingDesk(*joints(kit, 40), baud_bps=9600).run(0, 4 * S)
    words = [word for *_, word in desk.asked]
    at = [index for index, word in enumerate(words) if word != "QD"]
    assert {b - a for a, b in pairwise(at)} == {HEALTH_LEAST}
    assert all(a[2] != b[2] for a, b in pairwise(desk.asked))


def test_a_single_servo_gets_few_health_queries_where_there_is_room(kit):
    desk = PollingDesk(*joints(kit, 1))
    desk.tracker.depth = lambda _: 1
    desk.run(0, S)
    health_ns = [at_ns for at_ns, *_, word in desk.asked if word != "QD"]
    assert np.diff(health_ns) == pytest.approx(HEALTH_NS, abs=5 * MS)


@pytest.mark.parametrize("baud_bps", [19200, 115200])
def test_the_line_is_filled_with_answers(kit, baud_bps):
    desk = PollingDesk(*joints(kit, 2), baud_bps=baud_bps).run(0, S)
    reply_ns = desk.line.time_ns(len(b"*1QD0\r"))
    share = sum(1 for at_ns, *_ in desk.asked if at_ns > S // 4) * reply_ns / (0.75 * S)
    assert share > 0.85


@pytest.mark.parametrize("stray_deg", [0.0, 0.5])
def test_a_joint_is_polled_more_often_the_faster_it_moves_and_the_further_it_is_off(kit, stray_deg):
    joint_states = joints(kit, 8)
    other, desk = joint_states[1], PollingDesk(*joint_states)
    if stray_deg:
        desk.values[2, "QD"] = round(10 * stray_deg)
    else:
        other.note_sent(0, 800, 4000)  # 20 deg/s
    desk.run(0, S)
    rows = Counter(b[2] for a, b in pairwise(desk.asked) if b[0] > KNOWN_NS and a[2] != b[2])
    assert rows[2] / rows[1] == pytest.approx(2.0, rel=0.25)


@pytest.mark.parametrize("waits_ns", [WAITS_NS, (300_000, 5_000_000)])
@pytest.mark.parametrize("stray_deg", [0.0, 3.0, 9.0])
def test_all_servos_of_a_bus_are_visited_whatever_one_of_them_does(kit, stray_deg, waits_ns):
    joint_states = joints(kit, 4)
    desk = PollingDesk(*joint_states, waits_ns=waits_ns)
    if stray_deg:
        desk.values[1, "QD"] = round(10 * stray_deg)
    for index in range(8):
        joint_states[0].note_sent(index * 200 * MS, 400 * (index % 2), 200)
        desk.run(index * 200 * MS, (index + 1) * 200 * MS)
    for servo_id in (1, 2, 3, 4):
        own = [at_ns for at_ns, _, one, _ in desk.asked if one == servo_id]
        assert max(b - a for a, b in pairwise(own)) < 1.5 * VISIT_NS


def test_no_query_makes_a_move_late(kit):
    step_ns = 4 * MS
    desk = PollingDesk(*joints(kit, 2))
    desk.run(0, S // 3, quiet_until_ns=lambda now_ns: (now_ns // step_ns + 1) * step_ns)
    assert len(desk.asked) > 200
    for at_ns, arrival_ns, *_ in desk.asked:
        assert arrival_ns <= (at_ns // step_ns + 1) * step_ns


def test_an_unexpected_command_waits_for_no_more_than_one_other(kit):
    desk = PollingDesk(*joints(kit, 2), baud_bps=19200).run(0, S)
    assert len(desk.asked) > 150
    backlogs_ns = [arrival_ns - at_ns for at_ns, arrival_ns, *_ in desk.asked]
    assert max(backlogs_ns) <= desk.line.time_ns(BACKLOG_BYTES)
    assert max(backlogs_ns) > desk.line.time_ns(BACKLOG_BYTES - len(b"#1QD\r")), "and for that"


def test_on_a_full_line_an_overdue_servo_is_polled_all_the_same(kit):
    """Seed 32164: on a host that was always late, moves were always due, and no query was sent."""
    desk = PollingDesk(*joints(kit, 4)).run(0, KNOWN_NS)
    desk.values |= {(2, word): None for word in ("QD", "QDT", *HEALTHY)}
    begun, now_ns = len(desk.asked), KNOWN_NS
    while now_ns < KNOWN_NS + 3 * S:
        desk.run(now_ns, now_ns + 1, quiet_until_ns=lambda at_ns: at_ns)
        now_ns += 45 * MS
    asked = desk.asked[begun:]
    assert {one for *_, one, _ in asked} == {1, 2, 3, 4}
    assert set(desk.scheduler.health.active_faults) == {("j1", Cause.SILENT)}
    most = 3 * S // LONGEST_NS
    words = {one: [word for *_, other, word in asked if other == one] for one in (1, 3, 4)}
    for own in words.values():
        assert own.count("QD") <= most, "who answers is not missed"
        assert 2 <= len([word for word in own if word in HEALTHY]) <= 3, "one a second"
        assert "Q" in own
    instants_ns = sorted({at_ns for at_ns, *_ in asked})
    assert min(b - a for a, b in pairwise(instants_ns)) > STARVED_NS


def test_one_bus_without_queries_is_starved_if_it_has_servos_to_poll(kit):
    """On `blind` is an RC servo alone, which knows no answer but its last command."""
    buses, drives = ("left", "right", "blind"), ("timed", "timed", "stepped")
    lines = {
        name: SerialLine(Bus(name=name, port="sim://", baud_bps=115200, firmware=370))
        for name in buses
    }
    joint_states = {bus: kit.state(kit.joint(bus, 1)) for bus in buses}
    for state, bus, drive in zip(joint_states.values(), buses, drives, strict=True):
        state.joint = replace(state.joint, bus=bus, drive=drive)
    trackers = {name: QueryTracker(line) for name, line in lines.items()}
    scheduler = PollScheduler(joint_states, trackers, Waiting([], {}, 0.0))
    for name, is_starved in (("left", True), ("right", False)):
        trackers[name].send(Command(1, "QD"), S)
        assert scheduler.is_starved(S + 1) == is_starved


def test_silence_is_counted_from_the_last_answer_and_not_from_the_first_question(kit):
    """A servo that restarts between two phases is missed before it is back (seed 15857)."""
    desk = PollingDesk(*joints(kit, 2)).run(0, KNOWN_NS)
    desk.values |= {(1, word): None for word in ("QD", "QDT", *HEALTHY)}
    desk.run(KNOWN_NS, KNOWN_NS + 100 * MS)
    last_reply_ns = desk.tracker.last_reply_ns(1)
    assert KNOWN_NS - 50 * MS < last_reply_ns < KNOWN_NS + 50 * MS
    desk.scheduler = desk.scheduler.renewed()
    desk.run(KNOWN_NS + 300 * MS, last_reply_ns + S - 1)
    assert desk.scheduler.health.active_faults == {}
    desk.run(last_reply_ns + S, last_reply_ns + S + MS)
    assert set(desk.scheduler.health.active_faults) == {("j0", Cause.SILENT)}


def test_a_servo_that_answers_is_not_silent_whether_accepted_or_not(kit):
    desk = PollingDesk(*joints(kit, 2))
    for state in desk.joint_states.values():
        desk.scheduler.health.unanswered(state, 0, 0)
    for _ in range(2):
        desk.tracker.send(Command(1, "QD"), 0)
    desk.scheduler.receive("main", Reply(1, "QD", 7), 2 * MS, planned_deg)
    assert desk.scheduler.health.awaited.keys() == {"j1"}
    assert not desk.joint_states["j0"].trace.points, (
        "there is another question that it could answer"
    )
    desk.scheduler.receive("main", Reply(2, "QD", 7), 3 * MS, planned_deg)
    assert desk.scheduler.health.awaited.keys() == {"j1"}, "nobody asked"


def test_no_servo_waits_for_long_because_others_are_busier(kit):
    """One that restarts must be missed before it is back, whatever the others do meanwhile."""
    desk = PollingDesk(*joints(kit, 18), baud_bps=57600)
    desk.values |= {(servo_id, "QD"): 200 for servo_id in range(2, 19)}
    arrival_ns = [h for _, h, one, _ in desk.run(0, 4 * S).asked if one == 1 and h > KNOWN_NS]
    longest_ns = max(b - a for a, b in pairwise(arrival_ns))
    assert 0.8 * LONGEST_NS < longest_ns < 1.3 * LONGEST_NS


@pytest.mark.parametrize("late_ns", [LATE_NS // 2, 5 * MS, 100 * MS])
def test_a_host_that_wakes_late_is_left_alone_for_a_while(kit, late_ns):
    desk = PollingDesk(*joints(kit, 2)).run(0, KNOWN_NS)
    for state in desk.joint_states.values():
        for ask in range(SILENT_QUERIES):
            desk.scheduler.health.unanswered(state, KNOWN_NS + ask, KNOWN_NS)
    wakeup_ns = desk.scheduler.next_wakeup_ns(KNOWN_NS)
    begun, woken_ns = len(desk.asked), wakeup_ns + late_ns
    desk.run(woken_ns, woken_ns + 200 * MS)
    last_sent_ns = [at_ns - woken_ns for at_ns, *_ in desk.asked[begun:]]
    if late_ns >= STARVED_NS:
        assert last_sent_ns.pop(0) == 0, "one of those that did not answer is asked all the same"
    rest_ns = last_sent_ns[0]
    if late_ns < LATE_NS:
        assert rest_ns < 3 * MS
    else:
        assert rest_ns == pytest.approx(min(REST_RATIO * late_ns, REST_MAX_NS), abs=MS)


def test_what_is_done_between_two_wakeups_is_not_late(kit):
    desk = PollingDesk(*joints(kit, 2)).run(0, KNOWN_NS)
    wakeup_ns = desk.scheduler.next_wakeup_ns(KNOWN_NS)
    desk.ask(wakeup_ns)
    desk.ask(wakeup_ns + 5 * MS)
    desk.run(wakeup_ns + 5 * MS, wakeup_ns + 10 * MS)
    assert desk.asked[-1][0] > wakeup_ns + 7 * MS


def test_a_servo_is_soon_polled_for_its_target_and_a_lost_move_is_found(kit):
    first, second = joints(kit, 2)
    desk = PollingDesk(first, second).run(0, KNOWN_NS)
    for state in (first, second):
        state.lost_moves.prompt = PROMPT_LEAST
        state.note_sent(KNOWN_NS, 300, 1000)
    desk.values[2, "QDT"] = 0
    desk.run(KNOWN_NS, KNOWN_NS + 100 * MS)
    asked = [(at_ns, one) for at_ns, _, one, word in desk.asked if word == "QDT"]
    assert {one for _, one in asked} == {1, 2}
    assert max(at_ns for at_ns, _ in asked) < KNOWN_NS + 60 * MS
    assert desk.scheduler.to_resend == {"j1": second}
    assert second.profile.at(5.0)[0] == 0.0


@pytest.mark.parametrize("baud_bps", [9600, 115200])
def test_the_target_of_a_move_is_queried_once(kit, baud_bps):
    """A second query, before the first is answered, would tell nothing more."""
    state = kit.state(kit.joint())
    desk = PollingDesk(state, *joints(kit, 3)[1:], baud_bps=baud_bps).run(0, S)
    state.note_sent(S, 300, 900)
    desk.run(S, 2 * S)
    assert [word for *_, one, word in desk.asked if one == 1].count("QDT") == 1


def watched(kit, **fields):
    """Return a desk with two servos that have other settings after a restart, of three."""
    probes = {name: [Probe("QAA", 60, 100), Probe("QSD", 1800, 3600)] for name in ("j0", "j1")}
    desk = PollingDesk(*joints(kit, 3), probes=probes, **fields)
    for servo_id in (1, 2):
        desk.values |= {(servo_id, "QAA"): 60, (servo_id, "QSD"): 1800}
    return desk


def test_settings_are_read_back_on_a_slow_line_that_targets_and_readings_fill(kit):
    desk = watched(kit, baud_bps=9600)
    for at_ns in range(0, 3 * S, S // 10):
        for state in desk.joint_states.values():
            state.note_sent(at_ns, 10 + at_ns // S * 10 + at_ns // 100_000_000 % 2 * 5, 200)
        desk.run(at_ns, at_ns + S // 10)
    for servo_id in (1, 2):
        own = [at_ns for at_ns, _, one, word in desk.asked
               if one == servo_id and word in ("QAA", "QSD") and at_ns > KNOWN_NS]  # fmt: skip
        assert max(np.diff(own)) < 1.5 * READ_BACK_NS
    assert not any(one == 3 and word == "QAA" for *_, one, word in desk.asked)


def test_one_restart_lets_the_others_on_its_bus_be_examined_at_once(kit):
    desk = watched(kit).run(0, S // 2)
    desk.scheduler.doubt_all(["main"])
    assert desk.scheduler.doubted == {"j0", "j1"}
    assert all(state.takes_moves for state in desk.joint_states.values())
    count = len(desk.asked)
    desk.run(S // 2, S // 2 + 30 * MS)
    asked = [(one, word) for *_, one, word in desk.asked[count:]]
    assert {one for one, word in asked if word in ("QAA", "QSD")} == {1, 2}
    assert not desk.scheduler.doubted


def test_a_joint_in_em0_that_stands_while_its_model_moves_is_asked_for_its_settings(kit):
    """After a restart of 20 ms that no query met it was led on at factory speed for 0.2 s."""
    state = kit.state(kit.joint("j0", 1, drive="streamed"))
    desk = PollingDesk(state, probes={"j0": [Probe("QEM", 0, 1)]})
    desk.values |= {(1, "QEM"): 0, (1, "QD"): 0}
    desk.run(0, S)
    for step in range(8):
        state.note_sent(S + step * 20 * MS, 30 * step, None)
        desk.run(S + step * 20 * MS, S + (step + 1) * 20 * MS)
    asked = [word for at_ns, *_, word in desk.asked if at_ns > S]
    assert asked.count("QEM") >= 9, "7 in the usual turns"


def test_when_all_servos_fall_silent_all_are_held_back(kit):
    """Queries to the first that was noticed left none for the others, which got moves on."""
    probes = {f"j{i}": [Probe("QAA", 60, 100)] for i in range(6)}
    desk = PollingDesk(*joints(kit, 6), probes=probes)
    desk.values |= {(servo_id, "QAA"): 60 for servo_id in range(1, 7)}
    desk.run(0, S // 2)
    assert all(state.takes_moves for state in desk.joint_states.values())
    desk._coming.clear()
    desk._answer = lambda _: None
    desk.run(S // 2, S // 2 + 350 * MS)
    assert not any(state.takes_moves for state in desk.joint_states.values())


def silent(desk, *ids):
    """Let some servos answer nothing from now on."""
    answer = desk._answer
    desk._coming.clear()
    desk._answer = lambda command: None if command.servo_id in ids else answer(command)


def test_of_servos_that_fall_silent_together_one_that_was_not_polled_is_held_back(kit):
    """Timeouts of two that rest took all queries; the third had restarted, and got a move."""
    desk = PollingDesk(*joints(kit, 3), probes={"j2": [Probe("QAA", 60, 100)]})
    desk.values[3, "QAA"] = 60
    desk.run(0, S // 2)
    silent(desk, 1, 2)
    for number, servo_id in enumerate((1, 2, 1, 2)):
        assert desk.joint_states["j2"].takes_moves, number
        desk.scheduler._note_silence("main", servo_id, S // 2 + number)
    assert not desk.joint_states["j2"].takes_moves


def test_two_silent_servos_hold_no_others_back_that_answer(kit):
    probes = {f"j{i}": [Probe("QAA", 60, 100)] for i in range(6)}
    desk = PollingDesk(*joints(kit, 6), probes=probes)
    desk.values |= {(servo_id, "QAA"): 60 for servo_id in range(1, 7)}
    desk.run(0, S // 2)
    silent(desk, 1, 2)
    for at_ns in range(S // 2, S, 2 * MS):
        desk.run(at_ns, at_ns + 2 * MS)
        assert all(state.takes_moves for state in list(desk.joint_states.values())[2:])
    assert not any(desk.joint_states[name].takes_moves for name in ("j0", "j1"))


def test_a_servo_that_falls_silent_lets_the_others_of_its_bus_be_examined(kit):
    desk = watched(kit).run(0, S // 2)
    silent(desk, 1)
    doubts = []
    doubt_all = desk.scheduler.doubt_all
    desk.scheduler.doubt_all = lambda buses: doubts.append(list(buses)) or doubt_all(buses)
    desk.run(S // 2, S)
    assert doubts == [["main"]], "once"
    assert not desk.joint_states["j0"].takes_moves
    assert desk.joint_states["j1"].takes_moves


def test_a_limp_servo_is_held_back_until_its_settings_are_known(kit):
    (state,) = joints(kit, 1)
    desk = PollingDesk(state, probes={"j0": [Probe("QAA", 60, 100)]})
    desk.values[1, "QAA"] = 60
    desk.run(0, S // 2)
    desk.values |= {(1, "Q"): 1, (1, "QAA"): None}
    for at_ns in range(S // 2, S, MS):
        desk.run(at_ns, at_ns + MS)
        if any(ns > S // 2 and word == "Q" for ns, *_, word in desk.asked):
            break
    desk.run(at_ns + MS, at_ns + 5 * MS)
    assert desk.scheduler.doubted == {"j0"}
    assert not state.takes_moves, "at once"


def test_an_lss_that_was_sent_a_move_and_reports_no_target_is_held_back(kit):
    state = kit.state(kit.joint())
    desk = PollingDesk(state, probes={"j0": [Probe("QAA", 60, 100)]})
    desk.values |= {(1, "QAA"): 60}
    desk.run(0, S // 2)
    state.note_sent(S // 2, 300, 900)
    desk.values |= {(1, "QDT"): "", (1, "QAA"): None}
    desk.run(S // 2, S // 2 + 20 * MS)
    assert not state.takes_moves
    desk.values |= {(1, "QAA"): 60}
    desk.run(S // 2 + 20 * MS, S)
    assert state.takes_moves, "its settings are right"


def test_readings_that_tell_of_a_missed_move_are_passed_on(kit):
    (state,) = joints(kit, 1)
    desk = PollingDesk(state).run(0, KNOWN_NS)
    state.note_sent(KNOWN_NS, 300, 1000)
    desk.values[1, "QD"], desk.values[1, "QDT"] = 0, None
    desk.run(KNOWN_NS, KNOWN_NS + 200 * MS)
    assert desk.scheduler.to_resend == {"j0": state}


def test_a_doubt_is_settled_at_once(kit):
    desk = PollingDesk(*joints(kit, 3)).run(0, KNOWN_NS)
    desk.values[2, "Q"] = 9
    desk.run(KNOWN_NS, 2 * KNOWN_NS)
    own = [at_ns for at_ns, _, *question in desk.asked if question == [2, "Q"]]
    statuses = [at_ns for at_ns in own if at_ns > KNOWN_NS]
    assert statuses[1] - statuses[0] < 40 * MS
    assert desk.scheduler.health.active_faults.keys() == {("j1", Cause.BLOCKED)}


def test_an_rc_servo_gets_no_query(kit):
    joint = kit.joint("j1", 209, drive="stepped", model=SERVO_MODELS["LSS-2IO"])
    desk = PollingDesk(*joints(kit, 1), kit.state(joint)).run(0, KNOWN_NS)
    assert {one for _, _, one, _ in desk.asked} == {1}


def test_what_is_believed_is_kept_and_what_is_not_is_counted(kit):
    (state,) = joints(kit, 1)
    state.origin_s = 0.25
    desk = PollingDesk(state).run(0, S // 2)
    readings = state.disturbance.readings
    assert desk.counts()[1] - 20 <= readings <= desk.counts()[1]
    assert desk.scheduler.rejected == {"main": 0}
    assert len(state.trace.points) == readings
    assert state.trace.points[5][0] == pytest.approx(desk.asked[6][1] / 1e9 - 0.25, abs=0.01)
    desk.values[1, "QD"] = 850
    desk.run(S // 2, S // 2 + 30 * MS)
    assert desk.scheduler.rejected == {"main": 1}, "until it is said twice"
    anew = desk.scheduler.renewed()
    assert (anew.rejected, anew.health.active_faults) == ({"main": 1}, {})


@pytest.mark.parametrize("value", ["DIS", None])
def test_an_answer_without_a_number_is_ignored(kit, value):
    (state,) = joints(kit, 1)
    desk = PollingDesk(state)
    desk.ask(MS)
    desk.scheduler.receive("main", Reply(1, "QD", value), 3 * MS, planned_deg)
    assert desk.tracker.reply_count == 1
    assert (state.status, state.disturbance.readings) == (None, 0)


def test_a_servo_that_falls_silent_is_found_out_when_its_time_is_over(kit):
    desk = PollingDesk(*joints(kit, 2)).run(0, KNOWN_NS)
    for word in ("QD", *HEALTH_KEYWORDS):
        desk.values[2, word] = None
    desk.run(KNOWN_NS, KNOWN_NS + 900 * MS)
    assert desk.scheduler.health.awaited.keys() == {"j1"}
    assert desk.scheduler.health.active_faults == {}
    desk.run(KNOWN_NS + 900 * MS, KNOWN_NS + 1100 * MS)
    assert desk.scheduler.health.active_faults.keys() == {("j1", Cause.SILENT)}
    words = [word for at_ns, _, one, word in desk.asked if one == 2 and at_ns > KNOWN_NS + 100 * MS]
    assert len(set(words[:3])) == 3, "a late answer could be taken for that to the same question"
    assert desk.counts(KNOWN_NS)[1] > 300, "the other one is asked as ever"
    desk.values.clear()
    desk.run(KNOWN_NS + 1100 * MS, KNOWN_NS + 1300 * MS)
    assert (desk.scheduler.health.active_faults, desk.scheduler.health.awaited) == ({}, {})


def test_a_silent_servo_alone_on_its_bus_is_polled_on(kit):
    desk = PollingDesk(*joints(kit, 1)).run(0, KNOWN_NS)
    for word in ("QD", *HEALTH_KEYWORDS):
        desk.values[1, word] = None
    desk.run(KNOWN_NS, KNOWN_NS + S)
    last_sent_ns = [at_ns for at_ns, *_ in desk.asked if at_ns > KNOWN_NS + 20 * MS]
    assert len(last_sent_ns) > 5
    assert max(np.diff(last_sent_ns)) < 2 * STRAY_NS


def test_a_joint_that_is_read_off_its_course_is_astray(kit):
    (state,) = joints(kit, 1, following_deg=1.0)
    desk = PollingDesk(state)
    desk.values[1, "QD"] = 30
    desk.run(0, 700 * MS)
    assert desk.scheduler.health.active_faults.keys() == {("j0", Cause.ASTRAY)}


def test_a_row_is_as_long_as_it_must_be_for_answers_to_fill_their_line(kit):
    desk = PollingDesk(*joints(kit, 3), waits_ns=(300_000, 450_000)).run(0, S // 2)
    line, spread_ns = desk.line, desk.tracker.latency(1).spread_ns
    reply_ns, gap_ns = line.time_ns(len(b"*1QD00\r")), spread_ns // 2 + line.time_ns(1)
    shares = {count: count * reply_ns / (count * reply_ns + gap_ns) for count in range(1, 40)}
    least = min(count for count, share in shares.items() if share >= FILL_RATIO)
    rows = Counter(len(list(row)) for _, row in groupby(desk.asked, key=lambda entry: entry[2]))
    assert least > 2
    assert rows.most_common(1)[0][0] == least


def test_the_sensor_of_a_wait_is_polled_in_time_and_its_answer_is_used(kit):
    point = WaitPoint(at_s=0.5, wait=Wait(sensor="eye", side="below", threshold=300.0))
    sensor = Sensor(name="eye", servo_id=209, bus="main")
    waiting = Waiting([(0.5, point)], {"eye": sensor}, 0.0)
    desk = PollingDesk(*joints(kit, 2), waiting=waiting)
    desk.values[209, "QA"] = 500
    clock = ShowClock(0, 0.0, 1.0)
    desk.run(0, S // 2)
    assert not any(one == 209 for _, _, one, _ in desk.asked)
    assert waiting.advance(clock, S // 2) == "begun"
    desk.run(S // 2, S)
    last_sent_ns = [at_ns for at_ns, _, one, _ in desk.asked if one == 209]
    assert np.diff(last_sent_ns) == pytest.approx(POLL_PERIOD_NS, abs=3 * MS)
    assert waiting.advance(clock, S) is None
    desk.values[209, "QA"] = 200
    desk.run(S, S + 3 * POLL_PERIOD_NS)
    assert waiting.advance(clock, S + 3 * POLL_PERIOD_NS) == "met"
