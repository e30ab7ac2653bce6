"""The report of a show, as text and as a picture.

The report of a show as text.

The report of a show as a picture: every joint's plan and readings, errors, lateness, lines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError
from lss_motion.picture import new_figure, save

if TYPE_CHECKING:
    from pathlib import Path


def report_lines(report: dict[str, Any]) -> list[str]:
    """Return the report as a person reads it at the end of a show."""
    timing = report["timing"]
    planned = "endless" if report["planned_s"] is None else f"{report['planned_s']:.2f} s"
    simulated = ", simulated" if report["simulated"] else ""
    lines = [
        f"{report['sequence']}: {report['outcome']} after {report['played_s']:.2f} s of {planned}"
        f"{simulated}",
        f"commands {timing['commands']}, missed {timing['missed']}, late p50 "
        f"{timing['late_p50_us']} us, p99 {timing['late_p99_us']} us, max "
        f"{timing['late_max_us']} us",
    ]
    for name, bus in report["buses"].items():
        lines.append(
            f"bus {name}: {bus['baud_bps']} bps, {bus['tx_utilisation_ratio']:.0%} sent, "
            f"{bus['queries']} queries, {bus['replies']} replies ({bus['query_rate_hz']:.0f}/s), "
            f"{bus['timeouts']} timeouts, {bus['garbage']} garbage, {bus['rejected']} rejected"
        )
    if report["joints"]:
        width = max(len(name) for name in [*report["joints"], "joint"])
        has_truth = any("horn_error_rms_deg" in joint for joint in report["joints"].values())
        head = f"{'joint':{width}}  readings  error rms   max  correction"
        lines.append(head + ("  true horn rms   max   (deg)" if has_truth else "  (deg)"))
        for name, joint in report["joints"].items():
            seen = (  # What nobody has measured is no 0.
                f"{joint['error_rms_deg']:9.2f} {joint['error_max_deg']:5.2f}"
                if joint["readings"]
                else f"{'-':>9} {'-':>5}"
            )
            line = (
                f"{name:{width}}  {joint['readings']:8d}  {seen}  {joint['offset_max_deg']:10.2f}"
            )
            if "horn_error_rms_deg" in joint:
                line += f"  {joint['horn_error_rms_deg']:13.2f} {joint['horn_error_max_deg']:5.2f}"
            lines.append(line)
    for fault in report.get("faults", []):
        named = f"joint {fault['joint']!r} " if fault["joint"] else ""
        lines.append(f"fault: {named}{fault['cause']} ({fault['step']})")
    lines += [f"warning: {text}" for text in report.get("warnings", [])]
    return lines


WIDTH_IN: Final = 15.0
ROW_HEIGHT_IN: Final = 1.5
ROW_HEIGHT_MIN_IN: Final = 0.95
"""Many joints get lower rows."""
PLANNED, MEASURED, ERROR, BAR = "#1f5fa8", "#e0701a", "#c0392b", "#9aa5b1"
"""Colours of the plan, the readings, the error between both, and of counts."""


def plot_report(report: dict[str, Any], path: Path) -> None:
    """Draw a report into `path`; the kind of picture is that of its suffix.

    Raises `InputError` for a suffix that cannot be drawn, a file that cannot be written, and a
    report in which no joint was read.
    """
    joints = {name: joint for name, joint in report["joints"].items() if joint["trace"]["at_s"]}
    if not joints:
        raise InputError("no joint was read in this run: there is nothing to draw")
    row_in = max(ROW_HEIGHT_MIN_IN, min(ROW_HEIGHT_IN, 16.0 / len(joints)))
    figure = new_figure(path, WIDTH_IN, 3.6 + row_in * len(joints))
    halves = figure.subfigures(2, 1, squeeze=False, height_ratios=[row_in * len(joints) + 0.8, 2.8])
    above, below = halves[:, 0]
    axes = above.subplots(len(joints), 2, sharex=True, squeeze=False, width_ratios=[2.0, 1.0])
    for row, (name, joint) in zip(axes, joints.items(), strict=True):
        _joint(row, name, joint)
    axes[0][0].set_title("angle, deg: planned and measured", fontsize=10, loc="left")
    axes[0][1].set_title("measured - planned, deg", fontsize=10, loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("s since the start of the show", fontsize=8)
    late, lines = below.subplots(1, 2, width_ratios=[2.0, 1.0])
    _lateness(late, report["timing"])
    _lines(lines, report["buses"])
    simulated = ", simulated" if report["simulated"] else ""
    figure.suptitle(
        f"{report['sequence']} on {report['robot']}: {report['outcome']} after "
        f"{report['played_s']:.2f} s{simulated}",
        fontsize=11,
        x=0.01,
        ha="left",
    )
    save(figure, path)


def _joint(row: Any, name: str, joint: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    angle, error = row
    trace = joint["trace"]
    off_deg = [
        measured - planned
        for planned, measured in zip(trace["planned_deg"], trace["measured_deg"], strict=True)
    ]
    angle.plot(trace["at_s"], trace["planned_deg"], color=PLANNED, linewidth=1.2)
    angle.plot(trace["at_s"], trace["measured_deg"], ".", color=MEASURED, markersize=2.0)
    angle.set_ylabel(name, fontsize=8)
    error.axhline(0.0, color=BAR, linewidth=0.6)
    error.plot(trace["at_s"], off_deg, color=ERROR, linewidth=0.7)
    text = f"RMS {joint['error_rms_deg']:.2f}, max {joint['error_max_deg']:.2f}"
    error.text(0.99, 0.95, text, transform=error.transAxes, fontsize=7, ha="right", va="top")
    for axis in row:
        axis.tick_params(labelsize=7)
        axis.grid(visible=True, linewidth=0.3)


def _lateness(axis: Any, timing: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    bars = timing["late_histogram_us"]
    axis.bar(range(len(bars)), [count for _, count in bars], color=BAR)
    axis.set_xticks(range(len(bars)), [f"≤{up_to}" for up_to, _ in bars], fontsize=7)
    axis.set_yscale("symlog", linthresh=1.0)
    axis.set_title(
        f"lateness of {timing['commands']} commands, us: p50 {timing['late_p50_us']}, "
        f"p99 {timing['late_p99_us']}, max {timing['late_max_us']}",
        fontsize=10,
        loc="left",
    )
    axis.tick_params(labelsize=7)


def _lines(axis: Any, buses: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    names = [f"{name} ({bus['baud_bps']} bps)" for name, bus in buses.items()]
    shares = [100.0 * bus["tx_utilisation_ratio"] for bus in buses.values()]
    axis.barh(names, shares, color=BAR)
    for index, bus in enumerate(buses.values()):
        text = f" {bus['query_rate_hz']:.0f} questions/s, {bus['timeouts']} unanswered"
        axis.text(0.0, index, text, fontsize=7, va="center")
    axis.set_xlim(0.0, 100.0)
    axis.set_title("line in use, %", fontsize=10, loc="left")
    axis.tick_params(labelsize=7)
