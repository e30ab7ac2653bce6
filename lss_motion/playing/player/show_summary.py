"""How one show of a run went, in a few numbers: for the log and for who decides what is next.

A run may play thousands of shows. So this is small, has no traces, and is made in less than a
millisecond, between two moves.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.playing.player.events import JointSummary, ShowSummary

if TYPE_CHECKING:
    from collections.abc import Collection

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import ShowOutcome
    from lss_motion.playing.player.joint_state import JointState
    from lss_motion.playing.player.streamer import Streamer


def summary_of(
    program: Program,
    show: Streamer,
    *,
    outcome: ShowOutcome,
    from_s: float,
    began_ns: int,
    ended_ns: int,
    joints: Collection[str],
    is_added: bool = False,
) -> ShowSummary:
    """Return the summary of a show that is over at `ended_ns` and has moved `joints`."""
    timing = show.statistics.timing()
    states = show.joint_states
    reached_s = min(max(show.show_s(ended_ns), 0.0), program.duration_s)
    return ShowSummary(
        name=program.name,
        outcome=outcome,
        is_added=is_added,
        from_s=from_s,
        reached_s=reached_s,
        began_ns=began_ns,
        ended_ns=ended_ns,
        commands=timing["commands"],
        missed=timing["missed"],
        late_max_us=timing["late_max_us"],
        joints={name: _joint(states[name]) for name in states if name in joints},
    )


def _joint(state: JointState) -> JointSummary:
    load = state.disturbance
    return JointSummary(
        error_rms_deg=round(load.error_rms_deg, 3),
        error_max_deg=round(load.error_max_deg, 3),
        resent=state.resent,
        temperature_max_c=state.temperature_max_c,
        voltage_min_v=state.voltage_min_v,
        current_max_a=state.current_max_a,
    )
