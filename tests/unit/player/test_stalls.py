from __future__ import annotations

from lss_motion.playing.player.player import GAP_NS, NAMED_MAX, StallDetector

S = 1_000_000_000


def test_only_a_long_delay_is_a_gap():
    gaps = StallDetector()
    assert gaps.gap_ns(9 * S) == 0
    for wakeup_ns, now_ns, gap_ns in (
        (10 * S, 9 * S, 0),
        (10 * S, 10 * S + GAP_NS - 1, 0),
        (10 * S, 10 * S + GAP_NS, GAP_NS),
        (None, 99 * S, 0),
    ):
        gaps.wakeup_ns = wakeup_ns
        assert gaps.gap_ns(now_ns) == gap_ns
        assert gaps.gap_ns(now_ns + S) == 0, "it was named"


def test_delays_are_reported_with_their_length_up_to_a_maximum():
    gaps = StallDetector()
    texts = [gaps.warning(3 * S) for _ in range(NAMED_MAX + 5)]
    assert texts[0].startswith("this program was held up for 3.00 s: stopped (Ctrl-Z)")
    assert [text is None for text in texts] == [False] * NAMED_MAX + [True] * 5
    assert texts[NAMED_MAX - 1].endswith("Further delays are not reported")
