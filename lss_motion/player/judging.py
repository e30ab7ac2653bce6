"""What an answer of a servo says about its joint: where it is on its course, and on which one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.player.track import REST_DEG_S
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from lss_motion.player.track import Track


def wants_target(track: Track, now_ns: int) -> bool:
    """Return whether the servo is to be asked for its target."""
    return track.hearing is not None and track.hearing.wants_target(s_from_ns(now_ns))


def take_target(track: Track, target_deg: float, asked_s: float) -> bool:
    """Take in the target of a servo that heard the question at `asked_s`.

    Return whether it has missed a move: then the profile of `track` is the one it is really on.
    """
    assert track.hearing is not None
    other = track.hearing.named(asked_s, target_deg)
    if other is not None:
        track.profile = other
    return other is not None


def take_position(
    track: Track, measured_deg: float, read_s: float, planned_deg: float
) -> bool | None:
    """Take in where a horn was at `read_s`; None: that was not believed.

    Return whether its servo has missed a move, as `take_target` does.
    """
    assert track.hearing is not None
    before_s = track.following.read_s
    profile_deg, speed_deg_s = track.profile.at(read_s - track.lead_s)
    course_s = read_s - track.lead_s - track.lag.extra_s
    expected_deg, _ = track.profile.at(course_s)
    free_deg = measured_deg + track.following.disturbance_deg
    other = track.hearing.judge(course_s, expected_deg, free_deg)
    believed = track.following.take(
        measured_deg,
        read_s,
        expected_deg=expected_deg,
        wanted_deg=planned_deg,
        speed_deg_s=speed_deg_s,
        learns=not track.hearing.is_doubtful,
    )
    if not believed:
        return None
    if other is not None:
        track.profile = other
    elif before_s is not None and not track.hearing.is_doubtful:
        track.lag.take(profile_deg - measured_deg, speed_deg_s, read_s - before_s)
        if track.setpoints is None or abs(speed_deg_s) < REST_DEG_S:
            track.early_s = track.lag.extra_s
    return other is not None
