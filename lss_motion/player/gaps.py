"""Notices when nobody called the player for a while: the process was stopped, or had no time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable

GAP_NS: Final = NS_PER_S // 4
"""What is worth a word. Chosen: four times what makes a move count as missed
(`wording.LATEST_ARRIVAL_S`), and longer than any wait on a busy host that was measured."""
NAMED_MAX: Final = 10
"""On a host that is too slow, every move would be told of."""


class Gaps:
    """Knows when the player wanted to be called, and names each time when that was far later."""

    def __init__(self) -> None:
        self._wakeup_ns: int | None = None
        self._named = 0

    def expect(self, wakeup_ns: int | None) -> None:
        """Note when something will be due at the latest."""
        self._wakeup_ns = wakeup_ns

    def text(self, now_ns: int, show_s: Callable[[int], float] | None) -> str | None:
        """Return what to warn of, if a gap ends now; `show_s` says where the show is, if it is."""
        wakeup_ns, self._wakeup_ns = self._wakeup_ns, None
        if wakeup_ns is None or now_ns - wakeup_ns < GAP_NS or self._named == NAMED_MAX:
            return None
        self._named += 1
        gap_s = s_from_ns(now_ns - wakeup_ns)
        where = "" if show_s is None else f", up to {show_s(now_ns):.2f} s of the show"
        last = ". More of this is not told" if self._named == NAMED_MAX else ""
        return (
            f"this program was held up for {gap_s:.2f} s{where}, and what was due then left late: "
            f"stopped (Ctrl-Z), or without processor time (lss-motion doctor, --real-time){last}"
        )
