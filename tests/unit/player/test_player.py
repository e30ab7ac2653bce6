from __future__ import annotations

from lss_motion.player.player import GAP_NS, NAMED_MAX, StallDetector

S = 1_000_000_000


def test_only_a_long_delay_is_reported():
    gaps = StallDetector()
    assert gaps.text(9 * S, None) is None
    for wakeup_ns, now_ns, is_named in (
        (10 * S, 9 * S, False),
        (10 * S, 10 * S + GAP_NS - 1, False),
        (10 * S, 10 * S + GAP_NS, True),
        (None, 99 * S, False),
    ):
        gaps.expect(wakeup_ns)
        assert (gaps.text(now_ns, None) is not None) is is_named
        assert gaps.text(now_ns + S, None) is None, "it was named"


def test_delays_are_reported_with_length_and_show_time_up_to_a_maximum():
    gaps, texts = StallDetector(), []
    for _ in range(NAMED_MAX + 5):
        gaps.expect(2 * S)
        texts.append(gaps.text(5 * S, lambda _: 7.25))
    assert texts[0].startswith("this program was held up for 3.00 s, up to 7.25 s of the show")
    assert [text is None for text in texts] == [False] * NAMED_MAX + [True] * 5
    assert texts[NAMED_MAX - 1].endswith("Further delays are not reported")
