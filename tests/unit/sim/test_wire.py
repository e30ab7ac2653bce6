from random import Random

from lss_motion.sim.wire import Adapter, HostLine, ServoLine

BYTE_NS = 100_000  # at 100000 bps


def test_a_line_is_received_when_its_last_byte_has_arrived():
    line = HostLine(100_000)
    line.write(b"#5QD\r", 1000)
    assert list(line.lines) == [(1000 + 5 * BYTE_NS, b"#5QD\r")]


def test_bytes_queue_behind_earlier_ones_and_not_behind_an_idle_line():
    line = HostLine(100_000)
    line.write(b"#1H\r", 0)
    line.write(b"#2H\r#3H\r", 5)
    line.write(b"#4H\r", 20 * BYTE_NS)
    assert [time_ns // BYTE_NS for time_ns, _ in line.lines] == [4, 8, 12, 24]


def test_a_line_in_pieces_arrives_with_its_last_piece():
    line = HostLine(100_000)
    line.write(b"#5Q", 0)
    assert not line.lines
    line.write(b"D\r", 10 * BYTE_NS)
    assert list(line.lines) == [(12 * BYTE_NS, b"#5QD\r")]


def test_rates_that_divide_no_second_do_not_drift():
    line = HostLine(115_200)
    for _ in range(1000):
        line.write(b"#12D-450T50\r", 0)
    assert line.backlog_ns(0) == -(-12 * 1000 * 10 * 10**9 // 115_200)


def test_a_host_that_never_ends_its_line_fills_no_memory():
    line = HostLine(115_200)
    for _ in range(100):
        line.write(b"x" * 1000, 0)
    line.write(b"\r", 0)
    assert len(line.lines[0][1]) <= 5000


def test_replies_arrive_byte_by_byte_and_never_early():
    line = ServoLine(100_000, Random(1), Adapter(0))
    assert line.send(b"*5Q6\r", 1000) == 1000 + 5 * BYTE_NS
    assert line.next_end_ns() == 1000 + 5 * BYTE_NS
    assert line.read(1000 + BYTE_NS - 1) == b""
    assert line.read(1000 + 3 * BYTE_NS) == b"*5Q"
    assert line.read(1000 + 5 * BYTE_NS) == b"6\r"
    assert line.next_end_ns() is None


def test_replies_that_overlap_damage_each_other_and_lose_bytes():
    line = ServoLine(100_000, Random(1), Adapter(0))
    line.send(b"*5QD1443\r", 0)
    line.send(b"*6QD-900\r", 250_000)
    received = line.read(10**9)
    assert received.startswith(b"*5")
    assert b"QD" not in received
    assert len(received) < 18


def test_a_reply_that_begins_when_another_ends_is_whole():
    line = ServoLine(100_000, Random(1), Adapter(0))
    end_ns = line.send(b"*5Q6\r", 0)
    line.send(b"*6Q6\r", end_ns)
    assert line.read(10**9) == b"*5Q6\r*6Q6\r"
