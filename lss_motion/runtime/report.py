"""The report of a run: what was late, what was corrected, what failed.

`make_report` collects the numbers from a player. `write_report` writes them as the JSON object of
`lss-play --report`. The attributes of the classes here are the keys of that object, in the same
order; a change of a name or of a meaning needs another `SCHEMA_VERSION`.
"""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Final

from lss_motion.files.output import write_output
from lss_motion.files.source import counted
from lss_motion.player.joint_state import Statistics
from lss_motion.units import LINE_BITS_PER_BYTE, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from lss_motion.player.events import Faulted
    from lss_motion.player.joint_state import JointState
    from lss_motion.player.player import Player
    from lss_motion.program.model import Program
    from lss_motion.runtime.sound_choice import SoundReport
    from lss_motion.trajectory.model import GivenUp, SlowSpan

SCHEMA_VERSION: Final = 1
_NUMBERS: Final = re.compile(r"\[([-\d.,e\s]+)\]")


@dataclass(frozen=True, kw_only=True)
class TimingReport:
    """When commands left the host, compared with the instants at which they were due."""

    commands: int
    missed: int
    """Commands that were never sent because they were too late."""
    late_p50_us: int
    late_p99_us: int
    late_max_us: int
    late_histogram_us: tuple[tuple[int, int], ...]
    """`(up to, count)`: commands that were late by at most `up to` and more than the one before."""


@dataclass(frozen=True, kw_only=True)
class BusReport:
    """Bytes and replies of one bus."""

    baud_bps: int
    tx_utilisation_ratio: float
    queries: int
    replies: int
    timeouts: int
    garbage: int
    """Bytes or packets that no reply format matches."""
    rejected: int
    """Replies to no open query, and values that the servo cannot have reached."""
    query_rate_hz: float


@dataclass(frozen=True, kw_only=True)
class TraceReport:
    """Readings of a joint, evenly spread over the run: seconds since its start, joint degrees."""

    at_s: tuple[float, ...]
    planned_deg: tuple[float, ...]
    measured_deg: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class JointReport:
    """How one joint followed the plan, as measured by its servo."""

    readings: int
    error_rms_deg: float
    error_max_deg: float
    offset_max_deg: float
    """The largest correction that was added to a target."""
    predicted_error_max_deg: float | None
    lag_extra_s: float
    """The measured lag of the servo beyond that of the robot file."""
    resent: int
    """Moves that the servo did not execute and that were sent a second time."""
    temperature_max_c: float | None
    voltage_min_v: float | None
    current_max_a: float | None
    trace: TraceReport
    horn_error_rms_deg: float | None = None
    """Distance of the simulated horn from the plan. None, and not in the JSON, where unknown."""
    horn_error_max_deg: float | None = None


@dataclass(frozen=True, kw_only=True, repr=False)
class Report:
    """The numbers of one run. `to_dict` gives them as the JSON object of `--report`."""

    schema: int = SCHEMA_VERSION
    sequence: str
    robot: str
    simulated: bool
    outcome: str
    """`finished`, `stopped`, `fault` or `lost`."""
    planned_s: float | None
    """Duration of the plan; None if it repeats until it is stopped."""
    played_s: float
    """Show time that was reached, at most that of the plan."""
    run_s: float
    """Duration of the run in real or virtual time, setup and approach included."""
    tolerance_deg: float
    timing: TimingReport
    buses: Mapping[str, BusReport]
    joints: Mapping[str, JointReport]
    """Empty when the run ended before the show started."""
    stretched: tuple[SlowSpan, ...]
    given_up: tuple[GivenUp, ...]
    faults: tuple[Faulted, ...]
    warnings: tuple[str, ...]
    sound: SoundReport | None = None
    """None: the show has no sounds, or was played in virtual time."""

    def __repr__(self) -> str:
        """Return one line: names, outcome and counts."""
        counts = ", ".join(
            (
                counted(self.joints, "joint"),
                f"{self.timing.commands} commands",
                f"{self.timing.missed} missed",
                counted(self.faults, "fault"),
            )
        )
        return f"Report({self.sequence!r}: {self.outcome} after {self.played_s:.2f} s, {counts})"

    def to_dict(self) -> dict[str, Any]:
        """Return the report as the object that `json.dumps` writes."""
        found = asdict(self)
        for joint in found["joints"].values():
            for key in ("horn_error_rms_deg", "horn_error_max_deg"):
                if joint[key] is None:
                    del joint[key]
        return found


def make_report(
    player: Player,
    *,
    run_s: float,
    is_simulated: bool,
    outcome: str,
    warnings: Sequence[str] = (),
    sound: SoundReport | None = None,
    horn_error_deg: Mapping[str, tuple[float, float]] | None = None,
) -> Report:
    """Return the report of a run that took `run_s` in all, from the first query on.

    `horn_error_deg` holds, by joint, the RMS and the largest distance of the simulated horn from
    the plan.
    """
    program, show = player.program, player.show
    statistics = show.statistics if show is not None else Statistics()
    errors_deg = horn_error_deg or {}
    return Report(
        sequence=program.name,
        robot=program.robot,
        simulated=is_simulated,
        outcome=outcome,
        planned_s=None if math.isinf(program.duration_s) else round(program.duration_s, 6),
        played_s=round(_played_s(player), 6),
        run_s=round(run_s, 3),
        tolerance_deg=program.tolerance_deg,
        timing=TimingReport(
            **statistics.timing(), late_histogram_us=tuple(statistics.histogram_us())
        ),
        buses={name: _bus(player, name, run_s) for name in player.lines},
        joints={
            name: _joint(track, program, errors_deg.get(name))
            for name, track in (show.joint_states if show is not None else {}).items()
        },
        stretched=tuple(program.stretched),
        given_up=tuple(program.given_up),
        faults=tuple(player.faults),
        warnings=tuple(warnings),
        sound=sound,
    )


def _played_s(player: Player) -> float:
    """Return the show time that was reached, at most the duration of the plan."""
    if player.show is None or player.show_ended_ns is None:
        return 0.0
    reached_s = max(0.0, player.show.show_s(player.show_ended_ns))
    return min(reached_s, player.program.duration_s)


def _bus(player: Player, name: str, run_s: float) -> BusReport:
    line, tracker = player.lines[name], player.trackers[name]
    reader = player.show.scheduler if player.show is not None else None
    busy_s = line.sent_bytes * LINE_BITS_PER_BYTE / line.bus.baud_bps
    return BusReport(
        baud_bps=line.bus.baud_bps,
        tx_utilisation_ratio=round(busy_s / run_s, 4) if run_s > 0.0 else 0.0,
        queries=tracker.query_count,
        replies=tracker.reply_count,
        timeouts=tracker.timeouts,
        garbage=line.garbage,
        rejected=tracker.strays + (reader.rejected[name] if reader is not None else 0),
        query_rate_hz=round(tracker.query_count / run_s, 1) if run_s > 0.0 else 0.0,
    )


def _joint(
    track: JointState, program: Program, horn_error_deg: tuple[float, float] | None
) -> JointReport:
    following = track.disturbance
    predicted_deg = program.error_max_deg.get(track.joint.name)
    rms_deg, max_deg = horn_error_deg or (None, None)
    return JointReport(
        readings=following.readings,
        error_rms_deg=round(following.error_rms_deg, 3),
        error_max_deg=round(following.error_max_deg, 3),
        offset_max_deg=round(following.offset_max_deg, 3),
        predicted_error_max_deg=None if predicted_deg is None else round(predicted_deg, 3),
        lag_extra_s=round(track.lag.estimate_s, 4),
        resent=track.resent,
        temperature_max_c=track.temperature_max_c,
        voltage_min_v=track.voltage_min_v,
        current_max_a=track.current_max_a,
        trace=_trace(track),
        horn_error_rms_deg=None if rms_deg is None else round(rms_deg, 3),
        horn_error_max_deg=None if max_deg is None else round(max_deg, 3),
    )


def _trace(track: JointState) -> TraceReport:
    points = track.trace.points
    columns = zip(*points, strict=True) if points else ([], [], [])
    at_s, planned_deg, measured_deg = (tuple(round(x, 3) for x in column) for column in columns)
    return TraceReport(at_s=at_s, planned_deg=planned_deg, measured_deg=measured_deg)


def write_report(report: Report, path: Path) -> None:
    """Write a report as JSON, each list of numbers on one line. Raises `InputError`."""
    text = json.dumps(report.to_dict(), indent=1)
    text = _NUMBERS.sub(lambda found: "[" + " ".join(found[1].split()) + "]", text)
    write_output(path, text + "\n")


def run_seconds(started_ns: int, ended_ns: int) -> float:
    """Return the duration of a run in seconds."""
    return s_from_ns(ended_ns - started_ns)
