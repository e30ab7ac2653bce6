"""The commands `report` and `replay`: what a run has left, and its second run.

`play` and `walk` print `report_lines` at the end of a show. The keys of a report are those of
`lss_motion.playing.report`. Events of a log are printed in the words that the screen showed.
"""

from __future__ import annotations

import contextlib
import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_command, print_json
from lss_motion.cli.dialog import print_event
from lss_motion.cli.messages import say
from lss_motion.cli.options import OPTIONS, add_options
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs
from lss_motion.files.source import RECORDING_MAX_BYTES, read_text
from lss_motion.files.texts import SCREEN_CHARS, aligned, counted
from lss_motion.playing.player import events
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.playing.log import Log, LogLine

DESCRIPTION: Final = """\
Print a report that lss-play or walk wrote with --report, draw it, or compare two reports.

  lss-motion report show.json
  lss-motion report show.json --plot show.png
  lss-motion report before.json after.json      the numbers that differ
"""

WELL_DEG: Final = 5.0
"""A joint that was never further off has played well: half of the default of following_deg."""

COMPARED: Final = ("timing", "buses", "joints")
"""The parts of two reports that are compared."""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_replay(commands)
    report = add_command(commands, "report", _report, DESCRIPTION)
    report.add_argument(
        "reports", type=Path, nargs="+", metavar="FILE", help="one report, or two to compare"
    )
    add_options(report, "--plot", help=f"{OPTIONS['--plot']['help']}; for one report only")
    add_options(report, "--json", "--verbose", "--force")


def _report(arguments: argparse.Namespace) -> int:
    if len(arguments.reports) > 2:
        raise InputError(f"{len(arguments.reports)} reports: give one, or two to compare")
    if arguments.plot is not None and len(arguments.reports) > 1:
        raise InputError("--plot draws one report; give one")
    outputs = [Output(arguments.plot, OutputKind.PICTURE)]
    require_outputs(outputs, sources=arguments.reports, is_forced=arguments.force)
    found = [_read_report(path) for path in arguments.reports]
    shown = [] if arguments.json else zip(arguments.reports, found, strict=True)
    for path, report in shown:
        with _complete(path):
            for line in report_lines(report, is_whole=arguments.verbose):
                say(line)
    if arguments.json:
        print_json(found[0] if len(found) == 1 else {"first": found[0], "second": found[1]})
    elif len(found) == 2:
        for line in _differences(*found):
            say(line)
    if arguments.plot is not None:
        with _complete(arguments.reports[0]):
            plot_report(found[0], arguments.plot)
    return EXIT_FINISHED


@contextlib.contextmanager
def _complete(path: Path) -> Iterator[None]:
    """Turn the errors of an incomplete report into an `InputError` about its file."""
    try:
        yield
    except InputError:
        raise
    except KeyError as error:
        raise InputError(
            f"is not a complete report of lss-play: {error.args[0]!r} is missing", path=path
        ) from error
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "is not a complete report of lss-play: a value has the wrong type", path=path
        ) from error


def _read_report(path: Path) -> dict[str, Any]:
    from lss_motion.playing.report import SCHEMA_VERSION

    text = read_text(path, RECORDING_MAX_BYTES)
    try:
        report = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"is not a report: {error}", path=path) from error
    if not isinstance(report, dict) or report.get("schema") != SCHEMA_VERSION:
        raise InputError(f"is not a report of lss-play (`schema: {SCHEMA_VERSION}`)", path=path)
    return report


def _differences(before: dict[str, Any], after: dict[str, Any]) -> Iterator[str]:
    """Yield a line for every number that differs between the reports, with its ratio."""
    rows = []
    for name, was in _numbers({key: before[key] for key in COMPARED}):
        is_now = dict(_numbers({key: after[key] for key in COMPARED})).get(name)
        if is_now is not None and is_now != was:
            ratio = f"{is_now / was:.2f} x" if was else ""
            rows.append((name, f"{was:g}", f"{is_now:g}", ratio))
    if not rows:
        yield "the numbers are the same"
        return
    rows.insert(0, ("", "first", "second", ""))
    yield from aligned(rows, right=(1, 2, 3))


def _numbers(part: Any, name: str = "") -> Iterator[tuple[str, float]]:  # noqa: ANN401  JSON
    if isinstance(part, dict):
        for key, value in part.items():
            yield from _numbers(value, f"{name} {key}".strip())
    elif isinstance(part, int | float) and not isinstance(part, bool) and math.isfinite(part):
        yield name, float(part)


def _sound_lines(sound: dict[str, Any] | None) -> list[str]:
    if not sound or not sound["device"]:
        return []
    line = f"sound on {sound['device']}: {sound['begun']} begun, {sound['dropouts']} dropouts"
    if sound["leads"]:
        line += f"; the show followed it within {1000.0 * sound['off_max_s']:.1f} ms"
    if sound["device_ppm"] is not None:
        line += f" ({sound['device_ppm']:+.0f} ppm)"
    return [line]


def report_lines(report: dict[str, Any], *, is_whole: bool = False) -> list[str]:
    """Return the lines that are printed at the end of a show.

    `is_whole`: with how late commands were and how the buses were used.
    """
    timing = report["timing"]
    planned = "endless" if report["planned_s"] is None else f"{report['planned_s']:.2f} s"
    simulated = ", simulated" if report["simulated"] else ""
    lines = [
        f"{report['sequence']}: {report['outcome']} after {report['played_s']:.2f} s of {planned}"
        f"{simulated}",
    ]
    if report["outcome"] == "finished":
        lines.append(_verdict(report["joints"], timing["missed"], timing["commands"]))
    if is_whole:
        lines += _traffic_lines(timing, report["buses"])
    lines += _joint_lines(report["joints"])
    lines += _sound_lines(report.get("sound"))
    for fault in report.get("faults", []):
        named = f"joint {fault['joint']!r} " if fault["joint"] else ""
        lines.append(f"fault: {named}{fault['cause']} ({fault['step']})")
    lines += [f"warning: {text}" for text in report.get("warnings", [])]
    return lines


def _verdict(joints: dict[str, Any], missed: int, commands: int) -> str:
    """Return how well a show was played that came to its end."""
    errors_deg = {
        name: max(
            joint["error_max_deg"] if joint["readings"] else 0.0,
            joint.get("horn_error_max_deg", 0.0),
        )
        for name, joint in joints.items()
        if joint["readings"] or "horn_error_max_deg" in joint
    }
    if missed:
        late = f"{missed} of {counted(commands, 'command')}"
        return f"played, but {late} could not be sent in time (see lss-motion doctor)"
    if not errors_deg:
        return "played; no joint was read: how far off they were is not known"
    worst = max(errors_deg, key=lambda name: errors_deg[name])
    unread = counted(len(joints) - len(errors_deg), "joint was", "joints were")
    others = f"; {unread} not read" if len(errors_deg) < len(joints) else ""
    if errors_deg[worst] > WELL_DEG:
        return f"played, but joint {worst!r} was up to {errors_deg[worst]:.1f}° off{others}"
    return f"played well: no joint more than {max(math.ceil(errors_deg[worst]), 1)}° off{others}"


def _traffic_lines(timing: dict[str, Any], buses: dict[str, Any]) -> Iterator[str]:
    yield (
        f"commands {timing['commands']}, missed {timing['missed']}, late p50 "
        f"{timing['late_p50_us']} us, p99 {timing['late_p99_us']} us, max "
        f"{timing['late_max_us']} us"
    )
    for name, bus in buses.items():
        yield (
            f"bus {name}: {bus['baud_bps']} bps, {bus['tx_utilisation_ratio']:.0%} sent, "
            f"{bus['queries']} queries, {bus['replies']} replies ({bus['query_rate_hz']:.0f}/s), "
            f"{bus['timeouts']} timeouts, {bus['garbage']} garbage, {bus['rejected']} rejected"
            + (f", {bus['unasked']} not asked for" if bus.get("unasked") else "")
        )


def _joint_lines(joints: dict[str, Any]) -> list[str]:
    """Return the table of the joints; what was not measured is a dash, not a 0."""
    if not joints:
        return []
    rows = [["joint", "readings", "error rms", "max", "correction"]]
    has_truth = any("horn_error_rms_deg" in joint for joint in joints.values())
    rows[0] += ["true horn rms", "max", "(deg)"] if has_truth else ["(deg)"]
    for name, joint in joints.items():
        errors = [joint["error_rms_deg"], joint["error_max_deg"]]
        seen = [f"{deg:.2f}" for deg in errors] if joint["readings"] else ["-", "-"]
        row = [name, str(joint["readings"]), *seen, f"{joint['offset_max_deg']:.2f}"]
        true = [joint.get("horn_error_rms_deg"), joint.get("horn_error_max_deg")]
        row += ["" if deg is None else f"{deg:.2f}" for deg in true * has_truth]
        rows.append([*row, ""])
    return aligned(rows, right=range(1, 7), most_chars=SCREEN_CHARS)


WIDTH_IN: Final = 15.0

ROW_HEIGHT_IN: Final = 1.5

ROW_HEIGHT_MIN_IN: Final = 0.95
"""Rows are lower if there are many joints."""

LONG_S: Final = 60.0
WIDE_IN: Final = 26.0
"""A longer show has a wider picture."""

LATE_BARS_US: Final = tuple(1 << power for power in range(3, 13))
"""Bars that every picture has, as `playing.player.show_clock` counts them: to 4 ms, so that no bar
fills the picture."""
LINES_LEAST: Final = 3
"""Room for so many buses: the bar of one does not fill the picture."""

TIMELINE_ROW_IN: Final = 0.3
ANGLE_SHARE: Final = 0.6
"""Width of the timeline as a share of that of the picture."""

BOX: Final = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.0}
"""Behind a text that stands on a curve."""

PLANNED, MEASURED, ERROR, BAR = "#1f5fa8", "#e0701a", "#c0392b", "#9aa5b1"
"""Colours of the plan, the readings, the error between both, and of counts."""


def plot_report(report: dict[str, Any], path: Path) -> None:
    """Draw a report into `path`; the suffix sets the format.

    Raises `InputError` for a suffix that cannot be drawn, a file that cannot be written, and a
    report in which no joint was read.
    """
    from lss_motion.planning.picture import Instant, Timeline, new_figure, save

    joints = {
        name: joint
        for name, joint in report["joints"].items()
        if joint["trace"]["at_s"] or joint.get("plan", {}).get("at_s")
    }
    if not joints:
        raise InputError("no joint was read in this run, so there is nothing to draw")
    happened = report.get("timeline", [])
    timeline = Timeline(
        **{
            f"{kind}s": tuple(Instant(h["at_s"], h["text"]) for h in happened if h["kind"] == kind)
            for kind in ("keyframe", "anchor", "event")
        },
        holds_s=tuple((h["at_s"], h["at_s"] + h["hold_s"]) for h in happened if h["hold_s"] > 0.0),
    )
    row_in = max(ROW_HEIGHT_MIN_IN, min(ROW_HEIGHT_IN, 16.0 / len(joints)))
    width_in = WIDE_IN if report["played_s"] > LONG_S else WIDTH_IN
    top_in = TIMELINE_ROW_IN * timeline.rows + 0.2
    above_in = row_in * len(joints) + top_in + 0.8
    figure = new_figure(path, width_in, above_in + 2.8)
    halves = figure.subfigures(2, 1, squeeze=False, height_ratios=[above_in, 2.8])
    above, below = halves[:, 0]
    axes = above.subplots(
        len(joints) + 1,
        2,
        sharex=True,
        squeeze=False,
        width_ratios=[2.0, 1.0],
        height_ratios=[top_in, *([row_in] * len(joints))],
    )
    _show_limits(axes[0][0], joints)
    for axis in axes[0]:
        axis.axis("off")
    if timeline.rows:
        axes[0][0].axis("on")
        timeline.draw(axes[0][0], ANGLE_SHARE * width_in)
    for row, (name, joint) in zip(axes[1:], joints.items(), strict=True):
        _joint(row, name, joint)
        for axis in row:
            timeline.draw_lines(axis)
    axes[1][0].set_title("angle, deg: plan (line) and readings (dots)", fontsize=10, loc="left")
    axes[1][1].set_title("reading - plan, deg", fontsize=10, loc="left")
    for axis in axes[-1]:
        axis.set_xlabel("s since the start of the show", fontsize=8)
    if timeline.rows:
        above.legend(
            handles=timeline.handles(), loc="upper right", ncols=4, fontsize=8, frameon=False
        )
    late, lines = below.subplots(1, 2, width_ratios=[2.0, 1.0])
    draw_lateness(late, report["timing"])
    draw_buses(lines, report["buses"])
    simulated = ", simulated" if report["simulated"] else ""
    figure.suptitle(
        f"{report['sequence']} on {report['robot']}: {report['outcome']} after "
        f"{report['played_s']:.2f} s{simulated}",
        fontsize=11,
        x=0.01,
        ha="left",
    )
    save(figure, path)


def _show_limits(axis: Any, joints: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    """Set the times that are drawn: those of all readings and plans."""
    parts = [part for joint in joints.values() for part in (joint["trace"], joint.get("plan"))]
    spans_s = [part["at_s"] for part in parts if part and part["at_s"]]
    first_s, last_s = min(at_s[0] for at_s in spans_s), max(at_s[-1] for at_s in spans_s)
    room_s = 0.01 * max(last_s - first_s, 0.1)
    axis.set_xlim(first_s - room_s, last_s + room_s)


def _joint(row: Any, name: str, joint: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    """Draw the plan as a line and readings as dots, and beside it their difference.

    A report of an earlier version has no plan: then the line joins what was planned at readings.
    A joint that was never read, such as an RC servo, has its plan alone.
    """
    import numpy as np

    from lss_motion.planning.picture import draw_curve

    angle, error = row
    trace, plan = joint["trace"], joint.get("plan", {"at_s": [], "deg": []})
    off_deg = [
        measured - planned
        for planned, measured in zip(trace["planned_deg"], trace["measured_deg"], strict=True)
    ]
    angle.plot(trace["at_s"], trace["measured_deg"], ".", color=MEASURED, markersize=2.4)
    line = plan if plan["at_s"] else {"at_s": trace["at_s"], "deg": trace["planned_deg"]}
    angle.plot(line["at_s"], line["deg"], color=PLANNED, linewidth=0.9)
    angle.set_ylabel(name, fontsize=8)
    error.axhline(0.0, color=BAR, linewidth=0.6)
    text = "not read"
    if off_deg:
        draw_curve(error, np.array(trace["at_s"]), np.array(off_deg), ERROR)
        text = f"RMS {joint['error_rms_deg']:.2f}, max {joint['error_max_deg']:.2f}"
    else:
        error.set_yticks([0.0])
    error.text(
        0.99, 0.95, text, transform=error.transAxes, fontsize=7, ha="right", va="top", bbox=BOX
    )
    for axis in row:
        axis.grid(visible=True, linewidth=0.3)
        _plain(axis)


def draw_lateness(axis: Any, timing: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    """Draw how many commands were how late, on a scale that is the same for small shows."""
    counts = dict(map(tuple, timing["late_histogram_us"]))
    up_to_us = sorted({*LATE_BARS_US, *counts})
    found = axis.bar(range(len(up_to_us)), [counts.get(us, 0) for us in up_to_us], color=BAR)
    axis.bar_label(found, [counts.get(us) or "" for us in up_to_us], fontsize=7)
    axis.set_xticks(range(len(up_to_us)), [f"≤{us}" for us in up_to_us], fontsize=7)
    axis.set_yscale("symlog", linthresh=1.0)
    axis.margins(y=0.15)
    axis.set_title(
        f"lateness of {counted(timing['commands'], 'command')}, us: p50 {timing['late_p50_us']}, "
        f"p99 {timing['late_p99_us']}, max {timing['late_max_us']}",
        fontsize=10,
        loc="left",
    )
    _plain(axis)


def draw_buses(axis: Any, buses: dict[str, Any]) -> None:  # noqa: ANN401  (axes)
    """Draw how much of each bus was used."""
    names = [f"{name}, {bus['baud_bps']} bps" for name, bus in buses.items()]
    shares = [100.0 * bus["tx_utilisation_ratio"] for bus in buses.values()]
    found = axis.barh(range(len(names)), shares, height=0.5, color=BAR)
    texts = [
        f" {share:.0f} %, {bus['query_rate_hz']:.0f} queries/s, {bus['timeouts']} timeouts"
        for share, bus in zip(shares, buses.values(), strict=True)
    ]
    axis.bar_label(found, texts, fontsize=7)
    axis.set_yticks(range(len(names)), names)
    axis.set_ylim(-0.5, max(len(names), LINES_LEAST) - 0.5)
    axis.set_xlim(0.0, 100.0)
    axis.set_title("line in use, %", fontsize=10, loc="left")
    _plain(axis)


def _plain(axis: Any) -> None:  # noqa: ANN401  (axes)
    axis.tick_params(labelsize=7)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


REPLAY_TEXT: Final = """\
Print what a log of lss-play holds, or run it again.

  lss-motion replay show.log               bytes of each bus, events, commands of each servo
  lss-motion replay show.log --servo 5     every line to this servo, with its instant
  lss-motion replay show.log --again       the player runs through the log again

With --again the player of the same show gets the replies of the log, and its output is compared
with that of the log. Exit code 5: the player sent something else.
"""
DIFFERENCES_SHOWN: Final = 5


def _add_replay(commands: Commands) -> None:
    replay = add_command(commands, "replay", _replay, REPLAY_TEXT)
    replay.add_argument("log", type=Path, metavar="LOG", help="written by lss-play --log")
    replay.add_argument(
        "--servo", type=int, metavar="ID", help="print every line that was sent to this servo"
    )
    replay.add_argument(
        "--again", action="store_true", help="run the player again and compare its output"
    )


def _replay(arguments: argparse.Namespace) -> int:
    from lss_motion.playing.log import read_log

    log = read_log(arguments.log)
    if not log.is_whole:
        say(
            f"warning: {arguments.log} has no end: the player was killed, or still runs. At most "
            f"the last tenth of a second is missing",
            sys.stderr,
        )
    if arguments.again:
        return _again(log)
    texts = (
        _lines_to(log.lines, arguments.servo)
        if arguments.servo is not None
        else _summary(log.lines)
    )
    for text in texts:
        say(text)
    return EXIT_FINISHED


def _again(log: Log) -> int:
    from lss_motion.planning import shows
    from lss_motion.playing.connection import with_port
    from lss_motion.playing.discovery import with_limits
    from lss_motion.playing.log import SentLine
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.replay import replay
    from lss_motion.robot.load import load_robot

    if (played := log.played) is None:
        raise InputError("does not name the file that was played", path=log.path)
    show = shows.prepare(
        Path(played.file),
        None if played.robot is None else Path(played.robot),
        speed_ratio=played.speed,
        loop=played.loop,
        is_following=played.is_following,
        read_robot=lambda path: with_limits(load_robot(path), played.limits),
    )
    robot = with_port(show.robot.servo_robot, played.port)  # A simulated robot is asked for less.
    player = Player(
        Repertoire.single(show.program, robot),
        robot,
        has_feedback=played.has_feedback,
        start_s=played.start_s,
        must_ask=played.must_ask,
        is_forced=played.is_forced,
    )
    result = replay(log.lines, player)
    count = len(result.differing)
    say(f"{log.path}: {counted(result.compared, 'output')} compared, {count} differ")
    for index, now in result.differing[:DIFFERENCES_SHOWN]:
        line = log.lines[index]
        was = line.data if isinstance(line, SentLine) else b""
        say(f"  line {index + 2}, {s_from_ns(line.at_ns):.6f} s: {was!r}, now {now!r}")
    return EXIT_NOT_FOLLOWED if count else EXIT_FINISHED


def _lines_to(lines: Sequence[LogLine], servo_id: int) -> list[str]:
    from lss_motion.playing.replay import sent_lines
    from lss_motion.protocol.constants import BROADCAST_ID
    from lss_motion.protocol.framing import Command, CommandParser

    parser = CommandParser(grouped=False)
    found, ids = [], set()
    for at_ns, bus, line in sent_lines(lines):
        for item in parser.feed(line):
            if not isinstance(item, Command):
                continue
            ids.add(item.servo_id)
            if item.servo_id in (servo_id, BROADCAST_ID):
                text = line[:-1].decode("ascii", "replace")
                found.append(f"{s_from_ns(at_ns):12.6f} {bus} {text}")
    if servo_id not in ids:
        there = ", ".join(map(str, sorted(ids - {BROADCAST_ID}))) or "none"
        raise InputError(f"no line of this log is for servo {servo_id}; it has lines for: {there}")
    return found


def _summary(lines: Sequence[LogLine]) -> Iterator[str]:
    from collections import Counter

    from lss_motion.playing.log import ReceivedLine, SentLine
    from lss_motion.playing.replay import sent_lines
    from lss_motion.protocol.framing import Command, CommandParser

    yield f"{s_from_ns(lines[-1].at_ns if lines else 0):.3f} s"
    traffic = {SentLine: Counter[str](), ReceivedLine: Counter[str]()}
    for line in lines:
        if isinstance(line, SentLine | ReceivedLine):
            traffic[type(line)][line.bus] += len(line.text)
    sent, received = traffic[SentLine], traffic[ReceivedLine]
    for bus in sorted({*sent, *received}):
        yield f"bus {bus}: {counted(sent[bus], 'byte')} sent, {received[bus]} received"
    for line in lines:
        for text in _happened(line):
            yield f"{s_from_ns(line.at_ns):12.6f} {text}"
    counts: dict[tuple[str, int], Counter[str]] = {}
    parser = CommandParser(grouped=False)
    for _, bus, data in sent_lines(lines):
        for item in parser.feed(data):
            if isinstance(item, Command):
                counts.setdefault((bus, item.servo_id), Counter())[item.keyword] += 1
    for (bus, servo_id), words in sorted(counts.items()):
        listed = ", ".join(f"{word} {count}" for word, count in words.most_common())
        yield f"servo {servo_id} on {bus}: {listed}"


def _happened(line: LogLine) -> list[str]:
    """Return what a person reads of a line that is not bytes."""
    from lss_motion.playing.log import HappenedLine, PortLine, RequestedLine, SkippedLine

    match line:
        case HappenedLine():
            return event_lines(line.event)
        case RequestedLine():
            return [f"order: {line.request.text}"]
        case PortLine():
            return [f"port {line.bus}: {line.state} {line.reason}".rstrip()]
        case SkippedLine():
            return [f"lost: {counted(line.count, 'line')} lost"]
        case _:
            return []


def event_lines(event: events.Event) -> list[str]:
    """Return the lines about an event.

    The result of the check is one line with the number of servos, not a table of them.
    """
    if isinstance(event, events.Checked):
        return [f"checked {counted(event.servos, 'servo')}"]
    if isinstance(event, events.MarkPassed) and not event.label:
        return [f"{event.show_s:.2f} s a keyframe"]
    if isinstance(event, events.ShowBegan):
        return [f"show {event.name} from {event.from_s:.2f} s"]
    if isinstance(event, events.ShowOver):
        return [f"show {event.summary.name}: {event.summary.outcome}"]
    lines: list[str] = []
    print_event(event, lambda line: lines.append(line.strip()))
    return lines
