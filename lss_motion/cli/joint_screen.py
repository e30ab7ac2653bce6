"""A few lines that stay on the terminal while joints are in somebody's hands."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Final

from lss_motion.cli.messages import put
from lss_motion.units import NS_PER_S, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Sequence

    from lss_motion.maintenance.hands_on import HandsOn
    from lss_motion.robot.model import Joint

FRAME_NS: Final = NS_PER_S // 8
BAR_CHARS: Final = 31
NEAR_DEG: Final = 1.0
"""So near to an end of its range a joint is shown as being there."""


class Screen:
    """Draws on standard error if that is a terminal; what is said goes to standard output."""

    def __init__(self) -> None:
        self._is_live = sys.stderr.isatty()
        self._next_ns = 0
        self._drawn_count = 0

    def say(self, text: str) -> None:
        """Print a line for good, above what is drawn."""
        self._clear()
        put(text)

    def show(self, lines: Sequence[str], now_ns: int) -> None:
        """Draw the lines in place of those before, if it is time."""
        if not self._is_live or now_ns < self._next_ns:
            return
        self._next_ns = now_ns + FRAME_NS
        self._clear()
        put("\n".join(lines), sys.stderr)
        self._drawn_count = len(lines)

    def _clear(self) -> None:
        if self._drawn_count:
            put(f"\x1b[{self._drawn_count}A\x1b[J", sys.stderr, end="")
        self._drawn_count = 0


def joint_lines(hands_on: HandsOn, now_ns: int, chosen: str = "") -> list[str]:
    """Return a line for every joint: angle, place in its range, limp or not, age of the reading."""
    width = max(len(joint.name) for joint in hands_on.joints)
    lines = []
    for joint in hands_on.joints:
        reading = hands_on.readings.get(joint.name)
        if reading is None:
            continue
        mark = ">" if joint.name == chosen else " "
        state = "limp" if joint.name in hands_on.limp else "    "
        age_ms = 1000.0 * s_from_ns(now_ns - reading.at_ns)
        late = f"  {age_ms:.0f} ms ago" if age_ms > 200.0 else ""
        place = f"{_bar(joint, reading.deg)} {_at_limit(joint, reading.deg)}"
        lines.append(f"{mark} {joint.name:{width}} {reading.deg:8.1f} {place} {state}{late}")
    return lines


def _bar(joint: Joint, deg: float) -> str:
    low, high = joint.position_min_deg, joint.position_max_deg
    at = round((min(max(deg, low), high) - low) / (high - low) * (BAR_CHARS - 1))
    return f"{low:6.0f} |{'-' * at}#{'-' * (BAR_CHARS - 1 - at)}| {high:<6.0f}"


def _at_limit(joint: Joint, deg: float) -> str:
    if deg < joint.position_min_deg - NEAR_DEG or deg > joint.position_max_deg + NEAR_DEG:
        return "BEYOND"
    is_near = min(deg - joint.position_min_deg, joint.position_max_deg - deg) < NEAR_DEG
    return "LIMIT " if is_near else "      "
