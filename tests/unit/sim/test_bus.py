import re

import pytest

from lss_motion.protocol.framing import ReplyParser
from lss_motion.sim.physics import Physics, Turnaround
from lss_motion.units import line_time_ns

SLOW = Turnaround(single_min_ns=1_500_000, single_max_ns=1_500_000)
BYTE_NS = 86_806  # at 115200 bps, rounded up


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


def test_a_group_of_queries_is_answered_in_turn_by_370(make_host, make_servo):
    servos = [make_servo(number) for number in (0, 5, 10)]
    host = make_host(*servos)
    assert host.ask("#0QG0QLED0#5QG#10QG") == "*0QG1LED7|*5QG1|*10QG1|"


@pytest.mark.parametrize(
    ("protocol", "said"),
    [(0, "*15QG1T250|*5QG1T250|"), (1, "*15QG1T250*5QG1T250|")],
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


def test_text_ends_its_line_in_a_group(make_host, make_servo):
    host = make_host(make_servo(1), make_servo(2))
    assert host.ask("#1QMS0QG0#2QG") == "*1QMSLSS-ST1|*1QG1|*2QG1|"


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


def test_before_370_only_the_last_section_of_a_line_counts(make_host, make_servo):
    host = make_host(make_servo(5), make_servo(6), firmware=368)
    host.say("#5LED1#6LED2")
    assert [host.ask("#5QLED"), host.ask("#6QLED")] == ["*5QLED7|", "*6QLED2|"]


def test_a_group_of_moves_moves_all(make_host, make_servo):
    host = make_host(make_servo(1), make_servo(2))
    host.say("#1D100T250#2D200T250")
    host.wait_s(1.0)
    assert [host.ask("#1QD"), host.ask("#2QD")] == ["*1QD100|", "*2QD200|"]


def test_a_missing_cr_before_a_hash_is_forgiven(host):
    host.say("#254FPC5#254CAS-6")
    assert [host.ask("#5QFPC"), host.ask("#5QAS1")] == ["*5QFPC5|", "*5QAS-6|"]


def test_qid_with_a_delay_lets_everybody_speak(make_host, make_servo):
    host = make_host(*(make_servo(number) for number in (3, 1, 9)), baud_bps=921600)
    assert host.ask("#254QID150") == "*1QID1|*3QID3|*9QID9|"


def test_slots_order_a_broadcast_query(make_host, make_servo):
    host = make_host(make_servo(3), make_servo(9), baud_bps=500000)
    for line in ("#254SLOTCOUNT2", "#3SLOT1", "#9SLOT0"):
        host.say(line)
    assert host.ask("#254QG") == "*9QG1|*3QG1|"


@pytest.mark.parametrize(("firmware", "answer"), [(368, "*QID5|"), (370, "*5QID5|")])
def test_a_broadcast_qid_is_answered_in_the_form_of_the_firmware(make_host, firmware, answer):
    assert make_host(firmware=firmware).ask("#254QID") == answer


def test_what_a_firmware_does_not_know_is_passed_over_in_silence(make_host):
    assert make_host(firmware=367).ask("#5QFPC") == ""
    assert make_host(firmware=368).ask("#5QFPC") == "*5QFPC5|"
    assert make_host().ask("#5BANANA") == ""
    assert make_host().ask("#6QD") == ""


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
