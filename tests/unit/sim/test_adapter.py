from random import Random

from lss_motion.sim.wire import PACKET_BYTES, Adapter, ServoLine

MS = 1_000_000
BYTE_NS = 100_000  # at 100000 bps


def make(latency_ns, outages_ns=()):
    adapter = Adapter(latency_ns)
    adapter.start(0, outages_ns)
    return ServoLine(100_000, Random(1), adapter)


def test_bytes_wait_for_the_next_tick_of_the_timer():
    line = make(16 * MS)
    line.send(b"*5Q6\r", 20 * MS)
    assert line.next_end_ns() == 32 * MS
    assert line.read(32 * MS - 1) == b""
    assert line.read(32 * MS) == b"*5Q6\r"
    assert line.next_end_ns() is None


def test_a_reply_that_a_tick_cuts_comes_in_two_pieces():
    line = make(16 * MS)
    line.send(b"*5Q6\r", 16 * MS - 2 * BYTE_NS)
    assert line.read(16 * MS) == b"*5"
    assert line.read(32 * MS) == b"Q6\r"


def test_a_full_packet_does_not_wait():
    line = make(16 * MS)
    line.send(bytes(PACKET_BYTES + 8), 0)
    full_ns = PACKET_BYTES * BYTE_NS
    assert line.next_end_ns() == full_ns
    assert line.read(full_ns - 1) == b""
    assert len(line.read(full_ns)) == PACKET_BYTES
    assert line.next_end_ns() == 16 * MS
    assert len(line.read(16 * MS)) == 8


def test_how_often_is_read_changes_nothing():
    def received(step_ns):
        line = make(7 * MS)
        for index in range(40):
            line.send(b"*%dQD1234\r" % index, index * 3 * MS // 2)
        pieces = []
        for now_ns in range(0, 200 * MS, step_ns):
            pieces += [(now_ns // MS, byte) for byte in line.read(now_ns)]
        return pieces

    assert received(MS) == received(MS // 10)


def test_without_a_latency_bytes_come_one_by_one():
    line = make(0)
    line.send(b"*5Q6\r", 0)
    assert [line.read(n * BYTE_NS) for n in range(1, 6)] == [b"*", b"5", b"Q", b"6", b"\r"]


def test_what_arrives_while_unplugged_is_lost():
    line = make(0, [(2 * BYTE_NS, 4 * BYTE_NS)])
    line.send(b"*5Q6\r", 0)
    assert line.read(10 * BYTE_NS) == b"*6\r"


def test_a_bus_behind_a_slow_adapter_answers_60_questions_a_second(make_host):
    host = make_host(usb_latency_ns=16 * MS)
    for _ in range(60):
        assert host.ask("#5QG") == "*5QG1|"
    assert 0.95 < host.now_ns / 1e9 < 0.97
