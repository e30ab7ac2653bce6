"""How one show of a run went, in a few numbers: for the log and for who decides what is next.

A run may play thousands of shows. So this is small, has no traces, and is made in less than a
millisecond, between two moves.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

    ShowOutcome = Literal["finished", "left", "stopped", "fault"]


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSummary:
    """How one joint followed the plan, as measured by its servo; None: it did not report it."""

    error_rms_deg: float
    error_max_deg: float
    resent: int
    temperature_max_c: float | None
    voltage_min_v: float | None
    current_max_a: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class ShowSummary:
    """One show that was played: instants on the run clock, places in show time."""

    name: str
    outcome: ShowOutcome
    """`left`: another show took its place before its end."""
    is_added: bool
    """Whether it was played beside another show, on joints of its own."""
    from_s: float
    reached_s: float
    """Where a show that was left can go on: the `start_s` of `Player.change_to`."""
    began_ns: int
    ended_ns: int
    commands: int
    missed: int
    late_max_us: int
    joints: Mapping[str, JointSummary]
