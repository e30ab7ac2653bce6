from random import Random

from lss_motion.sim.wire import PACKET_BYTES, Adapter, HostLine, ServoLine

MS = 1_000_000
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


def test_two_replies_that_follow_each_other_are_handed_over_together():
    line = ServoLine(100_000, Random(1), Adapter(0))
    first_ns, after_ns = line.send(b"*5Q6\r", 0), 3 * BYTE_NS
    second_ns = line.send(b"*5QD1443\r", first_ns + after_ns)
    third_ns = line.send(b"*5QT300\r", second_ns)
    assert line.next_end_ns() == second_ns
    assert line.read(second_ns) == b"*5Q6\r*5QD1443\r"
    assert line.next_end_ns() == third_ns
    line.send(b"*6Q6\r", third_ns + 5 * BYTE_NS)
    assert line.next_end_ns() == third_ns, "there is silence between them"


def test_whole_replies_come_byte_by_byte_as_well_and_an_overlap_damages_what_is_left():
    line = ServoLine(100_000, Random(1), Adapter(0))
    end_ns = line.send(b"*5QD1443\r", 0)
    assert line.read(2 * BYTE_NS + 1) == b"*5"
    line.send(b"*6Q6\r", 6 * BYTE_NS + BYTE_NS // 2)
    received = line.read(10**9)
    assert received[:4] == b"QD14"
    assert received[4:] != b"43\r"
    assert len(received) < len(b"QD1443\r*6Q6\r"), "bytes that began meanwhile are lost"
    assert end_ns == 9 * BYTE_NS


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


def behind_adapter(latency_ns, outages_ns=()):
    adapter = Adapter(latency_ns)
    adapter.start(0, outages_ns)
    return ServoLine(100_000, Random(1), adapter)


def test_bytes_wait_for_the_next_tick_of_the_timer():
    line = behind_adapter(16 * MS)
    line.send(b"*5Q6\r", 20 * MS)
    assert line.next_end_ns() == 32 * MS
    assert line.read(32 * MS - 1) == b""
    assert line.read(32 * MS) == b"*5Q6\r"
    assert line.next_end_ns() is None


def test_a_reply_that_a_tick_cuts_comes_in_two_pieces():
    line = behind_adapter(16 * MS)
    line.send(b"*5Q6\r", 16 * MS - 2 * BYTE_NS)
    assert line.read(16 * MS) == b"*5"
    assert line.read(32 * MS) == b"Q6\r"


def test_a_full_packet_does_not_wait():
    line = behind_adapter(16 * MS)
    line.send(bytes(PACKET_BYTES + 8), 0)
    full_ns = PACKET_BYTES * BYTE_NS
    assert line.next_end_ns() == full_ns
    assert line.read(full_ns - 1) == b""
    assert len(line.read(full_ns)) == PACKET_BYTES
    assert line.next_end_ns() == 16 * MS
    assert len(line.read(16 * MS)) == 8


def test_how_often_is_read_changes_nothing():
    def received(step_ns):
        line = behind_adapter(7 * MS)
        for index in range(40):
            line.send(b"*%dQD1234\r" % index, index * 3 * MS // 2)
        pieces = []
        for now_ns in range(0, 200 * MS, step_ns):
            pieces += [(now_ns // MS, byte) for byte in line.read(now_ns)]
        return pieces

    assert received(MS) == received(MS // 10)


def test_without_a_latency_bytes_come_one_by_one():
    line = behind_adapter(0)
    line.send(b"*5Q6\r", 0)
    assert [line.read(n * BYTE_NS) for n in range(1, 6)] == [b"*", b"5", b"Q", b"6", b"\r"]


def test_what_arrives_while_unplugged_is_lost():
    line = behind_adapter(0, [(2 * BYTE_NS, 4 * BYTE_NS)])
    line.send(b"*5Q6\r", 0)
    assert line.read(10 * BYTE_NS) == b"*6\r"


def test_a_bus_behind_a_slow_adapter_answers_60_questions_a_second(make_host):
    host = make_host(usb_latency_ns=16 * MS)
    for _ in range(60):
        assert host.ask("#5QG") == "*5QG1|"
    assert 0.95 < host.now_ns / 1e9 < 0.97
