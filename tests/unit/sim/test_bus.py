import re

import pytest

from lss_motion.protocol.framing import ReplyParser
from lss_motion.sim.physics import Physics, Turnaround
from lss_motion.units import line_time_ns
from tests.tables import titled

SLOW = Turnaround(single_min_ns=1_500_000, single_max_ns=1_500_000)
BYTE_NS = 86_806  # at 115200 bps, rounded up
DIALOGUES = {
    "370 answers a group of queries in turn":
        ((0, 5, 10), {}, "#0QG0QLED0#5QG#10QG=*0QG1LED7|*5QG1|*10QG1|"),
    "text ends its line in a group": ((1, 2), {}, "#1QMS0QG0#2QG=*1QMSLSS-ST1|*1QG1|*2QG1|"),
    "before 370 only the last section of a line counts":
        ((5, 6), {"firmware": 368}, "#5LED1#6LED2 #5QLED=7 #6QLED=2"),
    "a group of moves moves all": ((1, 2), {}, "#1D100T250#2D200T250 1s #1QD=100 #2QD=200"),
    "a missing CR before a hash is forgiven": ((5,), {}, "#254FPC5#254CAS-6 #5QFPC=5 #5QAS1=-6"),
    "QID with a delay lets all speak":
        ((3, 1, 9), {"baud_bps": 921600}, "#254QID150=*1QID1|*3QID3|*9QID9|"),
    "slots order a broadcast query": (
        (3, 9),
        {"baud_bps": 500000},
        "#254SLOTCOUNT2 #3SLOT1 #9SLOT0 #254QG=*9QG1|*3QG1|",
    ),
    "368 answers a broadcast QID in its form": ((5,), {"firmware": 368}, "#254QID=*QID5|"),
    "370 answers a broadcast QID in its form": ((5,), {}, "#254QID=*5QID5|"),
    "367 has no FPC": ((5,), {"firmware": 367}, "#5QFPC="),
    "368 has FPC": ((5,), {"firmware": 368}, "#5QFPC=5"),
    "what is unknown is passed over in silence": ((5,), {}, "#5BANANA= #6QD="),
}  # fmt: skip


@titled(("ids", "line", "dialogue"), DIALOGUES)
def test_the_servos_on_a_bus_answer(make_host, make_servo, ids, line, dialogue):
    make_host(*(make_servo(number) for number in ids), **line).talk(dialogue)


def test_a_command_acts_when_its_last_byte_has_arrived(host):
    host.bus.write(b"#5LED3\r", 0)
    arrival_ns = 7 * 10 * 10**9 // 115200
    host.bus.advance(arrival_ns - 1_000)
    assert host.bus.lines == []
    host.bus.advance(arrival_ns + 1_000)
    assert [line for _, line in host.bus.lines] == [b"#5LED3\r"]
    assert host.bus.lines[0][0] == pytest.approx(arrival_ns, abs=1)


def test_a_reply_comes_after_the_turnaround_and_takes_its_line_time(make_host):
    host = make_host(physics=Physics(turnaround=SLOW))
    host.bus.write(b"#5Q\r", 0)
    end_ns = host.bus.next_arrival_ns()
    assert end_ns == pytest.approx(4 * BYTE_NS + 1_500_000 + 5 * BYTE_NS, abs=1000)
    assert host.bus.read(end_ns - BYTE_NS - 1000) == b"*5Q"
    assert host.bus.read(end_ns) == b"1\r"
    assert host.bus.next_arrival_ns() is None


@pytest.mark.parametrize(("firmware", "low_ms", "high_ms"), [(370, 0.2, 1.0), (368, 1.0, 1.8)])
def test_the_turnaround_is_that_of_the_firmware(make_host, firmware, low_ms, high_ms):
    host = make_host(firmware=firmware)
    waits_ms = []
    for _ in range(200):
        asked_ns = host.now_ns
        host.ask("#5Q")
        waits_ms.append((host.now_ns - asked_ns - 9 * BYTE_NS) / 1e6)
    assert low_ms <= min(waits_ms) + 1e-3 < low_ms + 0.1
    assert high_ms - 0.1 < max(waits_ms) <= high_ms + 1e-3


def test_several_queries_to_one_servo_are_answered_in_order(host):
    assert host.ask("#5QLED\r#5QG\r#5QAA") == "*5QLED7|*5QG1|*5QAA100|"


def test_queries_to_two_servos_at_once_collide(make_host, make_servo):
    host = make_host(make_servo(5), make_servo(6), baud_bps=9600)
    garbled = host.ask("#5QSD\r#6QSD")
    assert "*5QSD3600|*6QSD3600|" not in garbled
    assert host.ask("#5QSD") == "*5QSD3600|"


def test_a_broadcast_action_reaches_all_and_a_broadcast_query_is_answered_by_all(
    make_host, make_servo
):
    host = make_host(*(make_servo(number) for number in range(1, 7)))
    host.say("#254LED2")
    assert [host.ask(f"#{number}QLED") for number in (1, 6)] == ["*1QLED2|", "*6QLED2|"]
    answer = host.ask("#254QLED")
    assert answer
    assert answer.count("|") < 6


@pytest.mark.parametrize(
    ("protocol", "said"), [(0, "*15QG1T250|*5QG1T250|"), (1, "*15QG1T250*5QG1T250|")]
)
def test_the_replies_to_a_group_have_one_end_each_or_one_for_all(
    make_host, make_servo, protocol, said
):
    """Both shapes are in the parser tests of the maker's library for 370."""
    host = make_host(make_servo(15), make_servo(5))
    host.say(f"#254PROTOCOL{protocol}")
    answer = host.ask("#15QG0QT0#5QG0QT0")
    assert answer == said
    replies = ReplyParser().feed(answer.replace("|", "\r").encode())
    assert [(reply.servo_id, reply.keyword, reply.value) for reply in replies] == [
        (15, "QG", 1), (15, "QT", 250), (5, "QG", 1), (5, "QT", 250)
    ]  # fmt: skip


@pytest.mark.parametrize("baud_bps", [9600, 115200, 500000, 921600])
@pytest.mark.parametrize("protocol", [0, 1])
def test_two_replies_fit_into_one_slot_at_every_rate(make_host, make_servo, baud_bps, protocol):
    host = make_host(*(make_servo(number) for number in (3, 9, 12)), baud_bps=baud_bps)
    for line in ("#254SLOTCOUNT3", "#3SLOT1", "#9SLOT0", "#12SLOT2", f"#254PROTOCOL{protocol}"):
        host.say(line)
    end = "" if protocol else "|"
    texts = [re.escape(f"*{number}QV") + r"1\d{4}T250" for number in (9, 3, 12)]
    began_ns = host.now_ns
    assert re.fullmatch(re.escape(end).join(texts) + re.escape("|"), host.ask("#254QV0QT0"))
    least_ns = line_time_ns(11 + 3 * 24, baud_bps)
    assert host.now_ns - began_ns < 1_000_000 + least_ns, "a slot is no wider than replies need"


def test_the_servos_of_a_group_leave_a_gap(make_host, make_servo):
    servos = [make_servo(number) for number in range(18)]
    host = make_host(*servos, baud_bps=921600)
    host.ask("".join(f"#{number}QG0QLED0QAS" for number in range(18)))
    # Measured with a logic analyser, 18 servos and three queries each: 3 ms and 0.5 ms a servo.
    assert host.now_ns / 1e6 == pytest.approx(12.0, abs=1.5)


def test_a_servo_at_another_rate_receives_nothing(make_host, make_servo):
    host = make_host(make_servo(5, baud_bps=9600), make_servo(6))
    assert [host.ask("#5QG"), host.ask("#6QG")] == ["", "*6QG1|"]


def test_the_line_follows_the_rate_of_the_host_in_both_directions(make_host, make_servo):
    host = make_host(make_servo(5, baud_bps=9600), make_servo(6))
    host.ask("#6QG")  # A reply at the first rate: its times must not be those of the next.
    host.bus.set_host_rate(9600, host.now_ns)
    assert host.ask("#6QG") == ""
    started_ns = host.now_ns
    assert host.ask("#5QG") == "*5QG1|"
    line_s = len("#5QG\r*5QG1\r") * 10 / 9600
    assert line_s <= (host.now_ns - started_ns) / 1e9 <= line_s + 0.002


def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(make_host):
    def play(seed):
        host = make_host(seed=seed, physics=Physics())
        host.say("#5D450")
        return "".join(host.ask("#5QD\r#5QC") for _ in range(50)), host.now_ns

    assert play(1) == play(1)
    assert play(1) != play(2)


def test_looking_ahead_shows_a_reply_before_its_query_has_arrived(host):
    host.bus.write(b"#5D100\r#5QD\r", 0)
    end_ns = host.bus.next_arrival_ns()
    assert end_ns is not None
    assert end_ns > host.bus.backlog_ns(0) > 0
    assert host.bus.read(0) == b""
    assert host.bus.read(end_ns).startswith(b"*5QD")


@pytest.mark.parametrize("seed", range(20))
def test_the_next_arrival_is_the_earliest_even_if_its_query_came_later(make_host, make_servo, seed):
    def host():
        return make_host(make_servo(5), make_servo(6), seed=seed, baud_bps=921600)

    eager, patient = host(), host()
    for each in (eager, patient):
        each.bus.write(b"#5Q\r#6Q\r", 0)
    patient.bus.advance(patient.bus.backlog_ns(0))
    assert eager.bus.next_arrival_ns() == patient.bus.next_arrival_ns()


def test_bytes_that_are_no_line_do_no_harm(host):
    host.bus.write(bytes(range(256)) * 4 + b"\r", 0)
    host.wait_s(0.2)
    assert host.ask("#5QG") == "*5QG1|"
