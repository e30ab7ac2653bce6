"""Leads a streamed joint that is off its program along its path, one step of its filter at a time.

It is off because its targets were late, or held back by its limits, or because the rate of the
show is not 1. Its next target is made on the spot: as far as its plan goes in the next step, and a
little further to close up on it. What is too much for its limits, `Setpoints` takes off.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.player.setpoints import closing_deg
from lss_motion.program.filtered import FilterProfile
from lss_motion.protocol.line import encode_move
from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.player.line import Line
    from lss_motion.player.track import Track

ON_PROGRAM_RATIO: Final = 1.0
"""Nearer to its plan than this share of its program's tolerance, a joint is on it again."""


def lead(
    track: Track,
    line: Line,
    planned_deg: Callable[[Track, int], float],
    now_ns: int,
    period_ns: int,
    *,
    is_even: bool,
) -> None:
    """Tell a joint where to go, and note when to tell it again: every `period_ns`, if that can be.

    That ends when it rests where its plan does, or, where the rate of the show `is_even` at 1, when
    it is so near to its plan that the move of the program that is under way does the same.
    """
    profile, limits = track.profile, track.limits
    assert isinstance(profile, FilterProfile), "only streamed joints are led"
    here_wire = round(track.place(now_ns)[0] * limits.wire_per_deg)
    size = len(encode_move(track.joint.servo_id, here_wire, None))
    step = profile.acts_on(s_from_ns(line.heard_ns(size, now_ns)))
    steps = max(1, round(s_from_ns(period_ns) / profile.period_s))
    from_s = profile.step_s(step) - 0.5 * profile.period_s
    from_deg = _wanted_deg(track, planned_deg, from_s)
    to_deg = _wanted_deg(track, planned_deg, from_s + steps * profile.period_s)
    off_deg = from_deg - profile.value(step - 1)
    is_near = abs(off_deg) <= ON_PROGRAM_RATIO * limits.tolerance_deg
    if is_even and is_near and track.active is not None:
        track.send_active(line, 0.0, now_ns)
        return
    target_deg = to_deg
    is_at_rest = from_deg == to_deg and abs(off_deg) <= 1.0 / limits.wire_per_deg
    if not is_at_rest:
        way_deg = to_deg - from_deg + closing_deg(off_deg, limits)
        target_deg = profile.value(step - 1) + way_deg / (1.0 - profile.keep_ratio**steps)
    track.send(line, target_deg - track.following.offset_deg, 0.0, now_ns)
    if not is_at_rest:
        track.led_ns = ns_from_s(profile.hear_s(step + steps)) - line.time_ns(size)


def _wanted_deg(track: Track, planned_deg: Callable[[Track, int], float], at_s: float) -> float:
    """Return where the filter of a joint should be then: ahead of the horn, and corrected."""
    at_ns = ns_from_s(at_s + track.lead_s + track.early_s)
    wanted_deg = planned_deg(track, at_ns) + track.following.offset_deg
    return min(max(wanted_deg, track.limits.position_min_deg), track.limits.position_max_deg)
