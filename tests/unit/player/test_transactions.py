from __future__ import annotations

from itertools import pairwise

import pytest
from msgspec.structs import replace

from lss_motion.playing.player.handshake import (
    AGREE_TRIES,
    TRIES,
    UNEXPECTED_AGREEING,
    Dialogue,
    Item,
)
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.protocol.framing import Command, Reply


def ask(servo_id, keyword="QD", bus="main"):
    return Item(bus=bus, command=Command(servo_id, keyword))


def order(servo_id, keyword, value, bus="main"):
    return Item(bus=bus, command=Command(servo_id, keyword, value))


class TransactionBench:
    """Plays the time and the servos; `replies` maps a query to its answers and their instants."""

    def __init__(self, items, replies, kit, buses=("main",)):
        self.lines = {bus: SerialLine(kit.bus) for bus in buses}
        self.trackers = {bus: QueryTracker(line) for bus, line in self.lines.items()}
        self.dialogue = Dialogue(items, self.trackers)
        self.sent = []
        self._replies = replies
        self._coming = []

    def run(self, until_ns=10**10):
        now_ns = 0
        while not self.dialogue.is_finished:
            assert now_ns < until_ns, "it never ends"
            self.dialogue.advance(now_ns)
            for bus, line in self.lines.items():
                if data := line.take():
                    self.sent.append((now_ns, bus, data))
                    for wait_ns, reply in self._replies(bus, data):
                        self._coming.append((line.free_ns + wait_ns, bus, reply))
            self._coming.sort(key=lambda coming: coming[0])
            wakeup_ns = self.dialogue.next_wakeup_ns()
            if self._coming and (wakeup_ns is None or self._coming[0][0] <= wakeup_ns):
                now_ns, bus, reply = self._coming.pop(0)
                self.dialogue.receive(bus, reply, now_ns)
            elif wakeup_ns is not None:
                now_ns = max(now_ns + 1, wakeup_ns)
        return now_ns


def echo(bus, data):
    servo_id, keyword = int(data[1:2]), data[2:-1].decode()
    return [(1_000_000, Reply(servo_id, keyword, 10 * servo_id))] if "Q" in keyword else []


def test_questions_are_answered_and_orders_sent_in_their_order(kit):
    bench = TransactionBench([ask(1), order(1, "EM", 1), ask(2)], echo, kit)
    bench.run()
    assert [data for _, _, data in bench.sent] == [b"#1QD\r", b"#1EM1\r", b"#2QD\r"]
    assert bench.dialogue.answers == {("main", 1, "QD"): 10, ("main", 2, "QD"): 20}


def test_orders_are_sent_no_faster_than_the_line_carries_them(kit):
    bench = TransactionBench([order(1, "AA", 60) for _ in range(20)], echo, kit)
    end_ns = bench.run()
    starts_ns = [at_ns for at_ns, _, _ in bench.sent]
    assert end_ns >= 19 * bench.lines["main"].time_ns(7)
    for at_ns, successor_ns in pairwise(starts_ns):
        assert successor_ns - at_ns >= bench.lines["main"].time_ns(7)


def test_a_silent_servo_is_polled_again_and_then_given_up(kit):
    bench = TransactionBench(
        [ask(1), ask(2)], lambda bus, data: echo(bus, data) if b"#2" in data else [], kit
    )
    bench.run()
    assert [data for _, _, data in bench.sent] == [b"#1QD\r"] * TRIES + [b"#2QD\r"]
    assert bench.dialogue.answers == {("main", 2, "QD"): 20}
    assert bench.trackers["main"].timeouts == TRIES


def test_one_lost_answer_is_made_up_for(kit):
    tries = []

    def forgetful(bus, data):
        tries.append(data)
        return [] if len(tries) == 1 else echo(bus, data)

    bench = TransactionBench([ask(1), ask(1, "Q")], forgetful, kit)
    bench.run()
    assert tries == [b"#1QD\r", b"#1QD\r", b"#1Q\r"]
    assert set(bench.dialogue.answers) == {("main", 1, "QD"), ("main", 1, "Q")}


@pytest.mark.parametrize("late_ns", [45_000_000, 80_000_000, 130_000_000])
def test_a_late_answer_is_not_taken_for_the_answer_to_another_question(kit, late_ns):
    def late_once(bus, data):
        is_first = data == b"#1QD\r" and len(bench.sent) == 1
        return [(late_ns, Reply(1, "QD", 666))] if is_first else echo(bus, data)

    bench = TransactionBench([ask(1), ask(1, "Q"), ask(2)], late_once, kit)
    bench.run()
    assert bench.dialogue.answers[("main", 1, "QD")] == 10
    assert bench.trackers["main"].strays == 1


def test_buses_are_worked_through_side_by_side(kit):
    items = [ask(1, bus="a")] * 5 + [ask(2, bus="b")] * 5
    bench = TransactionBench(items, echo, kit, buses=("a", "b"))
    both_ns = bench.run()
    alone_ns = TransactionBench(items[:5], echo, kit, buses=("a", "b")).run()
    assert both_ns < 1.2 * alone_ns


def test_a_question_left_in_flight_by_what_came_before_answers_nothing_here(kit):
    bench = TransactionBench([ask(1), ask(2)], echo, kit)
    bench.trackers["main"].send(Command(1, "QD"), 0)
    bench.dialogue.receive("main", Reply(1, "QD", 666), 1_000_000)
    assert bench.dialogue.answers == {}
    bench.run()
    assert bench.dialogue.answers == {("main", 1, "QD"): 10, ("main", 2, "QD"): 20}


def sure(servo_id, within=0, keyword="QD"):
    command = Command(servo_id, keyword)
    return Item(bus="main", command=command, agree_within=within)


@pytest.mark.parametrize(
    ("values", "within", "believed"),
    [
        ([10, 10], 0, 10),
        ([666, 10, 11], 2, 11),
        ([10, 666, 10], 2, 10),
        (["LSS-ST1", "LSS-SX1", "LSS-ST1"], 0, "LSS-ST1"),
        ([None, None], 0, None),
    ],
)
def test_what_matters_is_believed_when_two_answers_agree(kit, values, within, believed):
    said = iter(values)
    bench = TransactionBench(
        [sure(1, within)], lambda bus, data: [(10**6, Reply(1, "QD", next(said)))], kit
    )
    bench.run()
    assert bench.dialogue.answers == {("main", 1, "QD"): believed}
    assert len(bench.sent) == len(values)


@pytest.mark.parametrize(
    ("values", "believed"),
    [
        ([-118, -117], -117),
        ([-11, -18, -118, -11, -119], -119),
        ([-11] * UNEXPECTED_AGREEING, -11),
        ([-11, -118, -11, -11, -18, -11], -11),
    ],
)
def test_a_joint_that_rests_is_elsewhere_when_more_answers_agree(kit, values, believed):
    """`-118` that lost a digit, twice, is no other place; a hand may have moved it."""
    said, item = iter(values), replace(sure(1, 20), expected=-118)
    bench = TransactionBench([item], lambda *_: [(10**6, Reply(1, "QD", next(said)))], kit)
    bench.run()
    assert bench.dialogue.answers == {("main", 1, "QD"): believed}
    assert len(bench.sent) == len(values)


def test_answers_that_never_agree_count_as_none(kit):
    wild = iter(range(0, 10_000, 100))
    bench = TransactionBench(
        [sure(1, 20)], lambda bus, data: [(10**6, Reply(1, "QD", next(wild)))], kit
    )
    bench.run()
    assert bench.dialogue.answers == {}
    assert len(bench.sent) == AGREE_TRIES


def test_a_servo_that_never_answered_does_not_get_the_other_queries(kit):
    items = [ask(1), ask(1, "QT"), ask(2), ask(1, "QV"), order(1, "EM", 1)]
    bench = TransactionBench(items, lambda bus, data: echo(bus, data) if b"#2" in data else [], kit)
    bench.run()
    assert [data for _, _, data in bench.sent] == [b"#1QD\r"] * TRIES + [b"#2QD\r", b"#1EM1\r"]
