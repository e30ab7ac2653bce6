"""The report of a show as text."""

from __future__ import annotations

from typing import Any


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
