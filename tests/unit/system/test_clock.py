from __future__ import annotations

import os

import pytest

from lss_motion.system.clock import MonotonicClock, VirtualClock

HOUR_NS = 3_600_000_000_000


def test_virtual_time_passes_only_when_it_is_set():
    clock = VirtualClock(5)
    assert [clock.now_ns(), clock.now_ns()] == [5, 5]
    clock.advance_to(HOUR_NS)
    assert clock.now_ns() == HOUR_NS


def test_virtual_time_does_not_go_back():
    clock = VirtualClock(5)
    with pytest.raises(AssertionError, match="backwards"):
        clock.advance_to(4)


def test_a_virtual_wait_ends_at_its_instant_and_a_past_one_at_once():
    clock = VirtualClock(5)
    for instant_ns, expected_ns in ((HOUR_NS, HOUR_NS), (4, HOUR_NS)):
        clock.wait_until(instant_ns)
        assert clock.now_ns() == expected_ns


def test_real_time_does_not_go_back():
    clock = MonotonicClock()
    assert clock.now_ns() <= clock.now_ns()


def test_a_real_wait_ends_long_before_a_far_instant():
    """Both return long before the hour; a test that hangs here has failed."""
    clock = MonotonicClock()
    start_ns = clock.now_ns()
    clock.wait_until(start_ns - 1)
    read_fd, write_fd = os.pipe()
    try:
        os.write(write_fd, b"*")
        clock.wait_until(start_ns + HOUR_NS, [read_fd])
        assert os.read(read_fd, 1) == b"*"
    finally:
        os.close(read_fd)
        os.close(write_fd)
    assert start_ns < clock.now_ns() < start_ns + HOUR_NS
