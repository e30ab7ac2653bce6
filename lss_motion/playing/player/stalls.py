"""Detects that the process of the player was held up when something was due."""

from __future__ import annotations

from typing import Final

from lss_motion.units import NS_PER_S, s_from_ns

GAP_NS: Final = NS_PER_S // 4
"""A shorter delay is no stall. Chosen: four times the delay at which a move counts as missed
(`quantize.LATEST_ARRIVAL_S`), and longer than any wait on a busy host that was measured."""
NAMED_MAX: Final = 10
"""Number of delays that are reported. On a host that is too slow, every move would be one."""
STALL_REASON: Final = (
    "stopped (Ctrl-Z), asleep, or without processor time (lss-motion doctor, --real-time)"
)


def stall_text(gap_ns: int, show_s: float | None) -> str:
    """Return the text of the fault after a stall in which moves were due."""
    where = "" if show_s is None else f" at {show_s:.2f} s of the show"
    return (
        f"this program was held up for {s_from_ns(gap_ns):.2f} s{where}: {STALL_REASON}. The moves "
        f"of that time were not sent"
    )


class StallDetector:
    """Detects that the process was stopped or got no processor time when something was due."""

    def __init__(self) -> None:
        self.wakeup_ns: int | None = None
        """When the player must be called at the latest; its owner sets it."""
        self._named = 0

    def gap_ns(self, now_ns: int) -> int:
        """Return by how much the call at `now_ns` is too late; 0: not by `GAP_NS`."""
        wakeup_ns, self.wakeup_ns = self.wakeup_ns, None
        gap_ns = 0 if wakeup_ns is None else now_ns - wakeup_ns
        return gap_ns if gap_ns >= GAP_NS else 0

    def warning(self, gap_ns: int) -> str | None:
        """Return the warning about a delay in which no move was due; None: there were enough."""
        if self._named == NAMED_MAX:
            return None
        self._named += 1
        last = ". Further delays are not reported" if self._named == NAMED_MAX else ""
        return (
            f"this program was held up for {s_from_ns(gap_ns):.2f} s: {STALL_REASON}. No move was "
            f"due meanwhile{last}"
        )
