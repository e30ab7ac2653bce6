from __future__ import annotations

import pytest

from lss_motion.protocol.framing import Reply


def test_bytes_leave_in_order_and_the_line_is_free_when_they_have(line):
    first_ns = line.send(b"#5QD\r", 1_000)
    assert first_ns == 1_000 + line.time_ns(5)
    assert line.arrival_ns(4, 2_000) == first_ns + line.time_ns(4)
    assert line.send(b"#6H\r", 2_000) == line.free_ns == first_ns + line.time_ns(4)
    assert line.take() == b"#5QD\r#6H\r"
    assert line.take() == b""
    assert line.sent_bytes == 9


def test_a_byte_takes_ten_bits(line):
    assert line.time_ns(1152) == 100_000_000


def test_replies_come_out_whole_and_the_rest_is_counted(line):
    assert line.receive(b"*5QD1", 0) == []
    replies = line.receive(b"44\rnoise\r*6Q6\r", 0)
    assert [reply for reply, _ in replies] == [Reply(5, "QD", 144), Reply(6, "Q", 6)]
    assert (line.replies, line.garbage) == (2, 1)


def test_two_replies_run_into_one_are_garbage_and_no_number(line):
    assert line.receive(b"*5QD1*6QD200\r", 0) == [(Reply(6, "QD", 200), 0)]
    assert line.garbage == 1


def test_a_reply_with_others_behind_it_ended_before_they_came(line):
    received = line.receive(b"*5QD144\r*6Q6\r*7QT300\r", 10**9)
    behind = [len(b"*6Q6\r*7QT300\r"), len(b"*7QT300\r"), 0]
    ended_ns = [10**9 - line.time_ns(size) for size in behind]
    assert [at_ns for _, at_ns in received] == pytest.approx(ended_ns, abs=2)
