from __future__ import annotations

from lss_motion.player.show_clock import ShowClock


def test_the_rate_is_known_at_every_instant_also_before_the_start_and_before_a_ramp():
    clock = ShowClock(1_000_000_000, 0.0, 1.0)
    assert clock.rate(999_999_999) == 1.0
    assert clock.rate(1_000_000_000) == 1.0
    clock.ramp_to(0.0, 2_000_000_000, 1.0)
    assert clock.rate(1_999_999_999) == 1.0
    assert clock.rate(2_500_000_000) == 0.5
    assert clock.rate(4_000_000_000) == 0.0
