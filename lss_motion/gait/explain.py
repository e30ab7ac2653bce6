"""What a gait comes to, in words: how fast it is, what holds it back, how safely it stands."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from lss_motion.gait.model import Walk

if TYPE_CHECKING:
    from lss_motion.gait.model import Action, Gait
    from lss_motion.gait.pacing import Paced


def gait_lines(gait: Gait, passages: tuple[Paced, ...]) -> list[str]:
    """Return a line for the gait and one for each stretch from rest to rest, and its actions."""
    lasts_s = sum(part.duration_s + part.hold_s + more_s(gait, part) for part in passages)
    lasts = "without end" if lasts_s == math.inf else f"one pass {lasts_s:.2f} s"
    safe = "static" if gait.pattern.is_static else "dynamic"
    lines = [
        f"{gait.name}: {len(gait.legs)} legs, pattern {gait.pattern.name} ({safe}), duty "
        f"{gait.duty:.2f}, {lasts}"
    ]
    start_s = 0.0
    for part in passages:
        end_s = start_s + part.duration_s + more_s(gait, part)
        until = "on" if end_s == math.inf else f"to {end_s:.2f} s"
        lines.append(f"{start_s:.2f} s {until}: {_pace_text(part)}")
        lines += [f"  {_action_text(gait, action, part.pace_ratio)}" for action in part.actions]
        start_s = end_s + part.hold_s
    return lines


def more_s(gait: Gait, part: Paced) -> float:
    """Return how long the cycles take that are looped and not laid out; `math.inf`: for ever."""
    more = [own.more_cycles for own in part.actions if isinstance(own, Walk)]
    cycles = sum(math.inf if count is None else count for count in more)
    return cycles * gait.cycle_s * part.pace_ratio


def _pace_text(part: Paced) -> str:
    margin_mm, at_s = part.margin_min_mm, part.margin_min_s * part.pace_ratio
    text = f"body at least {margin_mm:.0f} mm inside of its feet (after {at_s:.2f} s)"
    if margin_mm < 0.0:
        text = f"body up to {-margin_mm:.0f} mm outside of its feet (after {at_s:.2f} s)"
    pace = "at the pace wanted"
    if part.pace_ratio > 1.0:
        pace = f"{part.pace_ratio:.3f} times slower, for {part.limit} of joint {part.joint!r}"
    return f"{pace}; {text}"


def _action_text(gait: Gait, action: Action, pace_ratio: float) -> str:
    place = "" if action.line is None else f" (line {action.line})"
    if not isinstance(action, Walk):
        hold = f", held {action.hold_s:g} s" if action.hold_s > 0.0 else ""
        return f"{action.label}{place}: in {action.in_s * pace_ratio:.2f} s{hold}"
    speed_mm_s = float(np.hypot(action.forward_mm_s, action.left_mm_s))
    moves = []
    if speed_mm_s > 0.0:
        moves.append(f"{speed_mm_s / pace_ratio:.1f} mm/s")
    if action.turn_deg_s != 0.0:
        moves.append(f"{action.turn_deg_s / pace_ratio:.1f} deg/s")
    cycle_s = gait.cycle_s * pace_ratio
    how = " and ".join(moves) or "on the spot"
    more = action.more_cycles
    count = "forever, in" if more is None else f"{action.cycles + more}"
    return f"{action.label}{place}: {how}, {count} cycles of {cycle_s:.2f} s"
