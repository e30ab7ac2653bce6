from __future__ import annotations

import pytest

from lss_motion.runtime.clock import MonotonicClock, VirtualClock


def test_virtual_time_passes_only_when_told_to():
    clock = VirtualClock(5)
    assert [clock.now_ns(), clock.now_ns()] == [5, 5]
    clock.advance_to(3_600_000_000_000)
    assert clock.now_ns() == 3_600_000_000_000


def test_virtual_time_does_not_go_back():
    clock = VirtualClock(5)
    with pytest.raises(AssertionError, match="backwards"):
        clock.advance_to(4)


def test_real_time_does_not_go_back():
    clock = MonotonicClock()
    assert clock.now_ns() <= clock.now_ns()
