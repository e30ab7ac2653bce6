"""What a run came to, as the JSON object that `lss-play --report` writes."""

from __future__ import annotations

import json
import math
import re
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError
from lss_motion.player.joint_state import Statistics
from lss_motion.units import LINE_BITS_PER_BYTE, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from lss_motion.player.joint_state import JointState
    from lss_motion.player.player import Player
    from lss_motion.program.model import Program

SCHEMA_VERSION: Final = 1
_NUMBERS: Final = re.compile(r"\[([-\d.,e\s]+)\]")


def make_report(
    player: Player,
    *,
    run_s: float,
    is_simulated: bool,
    outcome: str,
    warnings: Sequence[str] = (),
    horn_error_deg: Mapping[str, tuple[float, float]] | None = None,
) -> dict[str, Any]:
    """Return the report of a run that took `run_s` in all, from the first question on.

    `horn_error_deg`: per joint RMS and largest distance of the simulated horn from the plan.
    """
    program, show = player.program, player.show
    statistics = show.statistics if show is not None else Statistics()
    report: dict[str, Any] = {
        "schema": SCHEMA_VERSION,
        "sequence": program.name,
        "robot": program.robot,
        "simulated": is_simulated,
        "outcome": outcome,
        "planned_s": None if math.isinf(program.duration_s) else round(program.duration_s, 6),
        "played_s": round(_played_s(player), 6),
        "run_s": round(run_s, 3),
        "tolerance_deg": program.tolerance_deg,
        "timing": {**statistics.timing(), "late_histogram_us": statistics.histogram_us()},
        "buses": {name: _bus(player, name, run_s) for name in player.lines},
        "joints": {},
        "stretched": [asdict(stretch) for stretch in program.stretched],
        "faults": [
            {"joint": f.joint, "cause": f.cause, "kind": f.kind, "step": f.step}
            for f in player.faults
        ],
        "warnings": list(warnings),
    }
    for name, track in (show.joint_states if show is not None else {}).items():
        report["joints"][name] = _joint(track, program)
        if horn_error_deg is not None and name in horn_error_deg:
            rms_deg, max_deg = horn_error_deg[name]
            report["joints"][name]["horn_error_rms_deg"] = round(rms_deg, 3)
            report["joints"][name]["horn_error_max_deg"] = round(max_deg, 3)
    return report


def _played_s(player: Player) -> float:
    """Return the show time that was reached, never more than the plan's."""
    if player.show is None or player.show_ended_ns is None:
        return 0.0
    reached_s = max(0.0, player.show.show_s(player.show_ended_ns))
    return min(reached_s, player.program.duration_s)


def _bus(player: Player, name: str, run_s: float) -> dict[str, Any]:
    line, questioner = player.lines[name], player.trackers[name]
    reader = player.show.scheduler if player.show is not None else None
    busy_s = line.sent_bytes * LINE_BITS_PER_BYTE / line.bus.baud_bps
    return {
        "baud_bps": line.bus.baud_bps,
        "tx_utilisation_ratio": round(busy_s / run_s, 4) if run_s > 0.0 else 0.0,
        "queries": questioner.query_count,
        "replies": questioner.reply_count,
        "timeouts": questioner.timeouts,
        "garbage": line.garbage,
        "rejected": questioner.strays + (reader.rejected[name] if reader is not None else 0),
        "query_rate_hz": round(questioner.query_count / run_s, 1) if run_s > 0.0 else 0.0,
    }


def _joint(track: JointState, program: Program) -> dict[str, Any]:
    following = track.disturbance
    predicted_deg = program.error_max_deg.get(track.joint.name)
    return {
        "readings": following.readings,
        "error_rms_deg": round(following.error_rms_deg, 3),
        "error_max_deg": round(following.error_max_deg, 3),
        "offset_max_deg": round(following.offset_max_deg, 3),
        "predicted_error_max_deg": None if predicted_deg is None else round(predicted_deg, 3),
        "lag_extra_s": round(track.lag.estimate_s, 4),
        "said_again": track.resent,
        "temperature_max_c": track.temperature_max_c,
        "voltage_min_v": track.voltage_min_v,
        "current_max_a": track.current_max_a,
        "trace": _trace(track),
    }


def _trace(track: JointState) -> dict[str, list[float]]:
    """Return readings of the whole show, evenly: seconds since its start, and joint degrees."""
    points = track.trace.points
    columns = zip(*points, strict=True) if points else ([], [], [])
    at_s, planned_deg, measured_deg = ([round(x, 3) for x in column] for column in columns)
    return {"at_s": at_s, "planned_deg": planned_deg, "measured_deg": measured_deg}


def write_report(report: Mapping[str, Any], path: Path) -> None:
    """Write a report as JSON, each list of numbers on one line. Raises `InputError`."""
    text = json.dumps(report, indent=1)
    text = _NUMBERS.sub(lambda found: "[" + " ".join(found[1].split()) + "]", text)
    try:
        path.write_text(text + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot write the report: {error.strerror}", path=path) from error


def run_seconds(started_ns: int, ended_ns: int) -> float:
    """Return the duration of a run in seconds."""
    return s_from_ns(ended_ns - started_ns)
