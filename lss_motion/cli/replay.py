"""`lss-motion replay` and `lss-motion report`: what a log and a report say, offline.

The events of a log as a person reads them: the words that they had on the screen.
"""

from __future__ import annotations

import ast
import contextlib
import json
import math
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_json, print_json
from lss_motion.cli.play import tell
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError
from lss_motion.player import events
from lss_motion.robot.on_fault import Cause, FaultStep
from lss_motion.sequence.model import Cue
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from lss_motion.runtime.replay import Entry


REPLAY_HELP = """\
Without options: what went over each bus, what happened, and how often each servo was told and
asked what. --servo shows every line that a servo heard, with its instant. --again makes the
player of the same show live through the log, and says whether it would send the same bytes; exit
code 5 if not."""
SHOWN_DIFFERENCES: Final = 5
COMPARED: Final = ("timing", "buses", "joints")
"""The parts of two reports that are set side by side."""


def add_to(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add `replay` and `report`."""
    replay = commands.add_parser(
        "replay",
        help="show what a log of lss-play holds, or play it again",
        description=REPLAY_HELP,
    )
    replay.add_argument("log", type=Path, metavar="LOG", help="written by lss-play --log")
    replay.add_argument("--servo", type=int, metavar="ID", help="all that this servo heard")
    replay.add_argument("--again", action="store_true", help="the player's decisions, once more")
    replay.set_defaults(handler=_replay)
    report = commands.add_parser("report", help="print a report of lss-play, or compare two")
    report.add_argument("reports", type=Path, nargs="+", metavar="FILE", help="one or two")
    report.add_argument(
        "--plot", type=Path, metavar="F.png", help="draw it (one report); the suffix says how"
    )
    add_json(report)
    report.set_defaults(handler=_report)


def _replay(arguments: argparse.Namespace) -> int:
    from lss_motion.runtime.replay import read_log

    played, entries = read_log(arguments.log)
    if not entries or entries[-1].kind != "#":
        print(
            f"warning: {arguments.log} is cut, its end is missing: the player was killed, or plays "
            f"on. At most its last tenth of a second is lost",
            file=sys.stderr,
        )
    if arguments.again:
        return _again(arguments.log, played, entries)
    lines = _servo(entries, arguments.servo) if arguments.servo is not None else _summary(entries)
    for line in lines:
        print(line)
    return EXIT_FINISHED


def _again(path: Path, played: dict[str, Any], entries: list[Entry]) -> int:
    from lss_motion.cli import shows
    from lss_motion.maintenance.limits import with_limits
    from lss_motion.player.player import Player
    from lss_motion.robot.load import load_robot
    from lss_motion.runtime.replay import replay

    if "file" not in played:
        raise InputError("says not what was played (`# played:`)", path=path)
    robot_path = None if played.get("robot") is None else Path(played["robot"])
    limits = played.get("limits", {})
    show = shows.prepare(
        Path(played["file"]),
        robot_path,
        speed_ratio=played.get("speed", 1.0),
        loop=played.get("loop"),
        read_robot=lambda path: with_limits(load_robot(path), limits),
    )
    player = Player(
        show.program,
        show.robot,
        has_feedback=played.get("has_feedback", True),
        start_s=played.get("start_s"),
        must_ask=played.get("must_ask", False),
    )
    result = replay(entries, player)
    count = len(result.differing)
    print(f"{path}: asked {result.compared} times, the player decided otherwise {count} times")
    for entry, now in result.differing[:SHOWN_DIFFERENCES]:
        print(f"  line {entry.line}, {s_from_ns(entry.at_ns):.6f} s: {entry.text!r}, now {now!r}")
    return EXIT_NOT_FOLLOWED if count else EXIT_FINISHED


def _servo(entries: list[Entry], servo_id: int) -> list[str]:
    from lss_motion.protocol.constants import BROADCAST_ID
    from lss_motion.protocol.line import Command, CommandParser
    from lss_motion.runtime.replay import sent_lines

    parser = CommandParser(grouped=False)
    lines, ids = [], set()
    for at_ns, bus, line in sent_lines(entries):
        for item in parser.feed(line):
            if not isinstance(item, Command):
                continue
            ids.add(item.servo_id)
            if item.servo_id in (servo_id, BROADCAST_ID):
                said = line[:-1].decode("ascii", "replace")
                lines.append(f"{s_from_ns(at_ns):12.6f} {bus} {said}")
    if servo_id not in ids:
        there = ", ".join(map(str, sorted(ids - {BROADCAST_ID}))) or "none"
        raise InputError(f"no line of this log is for servo {servo_id}; there are: {there}")
    return lines


def _summary(entries: list[Entry]) -> Iterator[str]:
    from collections import Counter

    from lss_motion.protocol.line import Command, CommandParser
    from lss_motion.runtime.replay import sent_lines

    end_ns = entries[-1].at_ns if entries else 0
    yield f"{s_from_ns(end_ns):.3f} s"
    for bus in sorted({entry.bus for entry in entries if entry.kind in "><"}):
        sent, came = (
            sum(len(entry.data) for entry in entries if entry.bus == bus and entry.kind == way)
            for way in "><"
        )
        yield f"bus {bus}: {sent} bytes to the servos, {came} from them"
    for entry in entries:
        texts = {"=": [f"asked for {entry.text}"], "?": [f"lost: {entry.text}"]}.get(entry.kind, [])
        for text in event_lines(entry.text) if entry.kind == "!" else texts:
            yield f"{s_from_ns(entry.at_ns):12.6f} {text}"
    counts: dict[tuple[str, int], Counter[str]] = {}
    parser = CommandParser(grouped=False)
    for _, bus, line in sent_lines(entries):
        for item in parser.feed(line):
            if isinstance(item, Command):
                counts.setdefault((bus, item.servo_id), Counter())[item.keyword] += 1
    for (bus, servo_id), words in sorted(counts.items()):
        told = ", ".join(f"{word} {count}" for word, count in words.most_common())
        yield f"servo {servo_id} on {bus}: {told}"


def _report(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.report import plot_report, report_lines

    if len(arguments.reports) > 2:
        raise InputError(f"{len(arguments.reports)} reports: give one, or two to compare")
    if arguments.plot is not None and len(arguments.reports) > 1:
        raise InputError("--plot draws one report; give one")
    found = [_read_report(path) for path in arguments.reports]
    shown = [] if arguments.json else zip(arguments.reports, found, strict=True)
    for path, report in shown:
        with _whole(path):
            for line in report_lines(report):
                print(line)
    if arguments.json:
        print_json(found[0] if len(found) == 1 else {"first": found[0], "second": found[1]})
    elif len(found) == 2:
        for line in _differences(*found):
            print(line)
    if arguments.plot is not None:
        with _whole(arguments.reports[0]):
            plot_report(found[0], arguments.plot)
    return EXIT_FINISHED


@contextlib.contextmanager
def _whole(path: Path) -> Iterator[None]:
    """Blame the report at `path` for what of it is missing or of the wrong kind."""
    try:
        yield
    except InputError:
        raise
    except KeyError as error:
        raise InputError(
            f"no whole report of lss-play: {error.args[0]!r} is missing", path=path
        ) from error
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(
            "no whole report of lss-play: something in it is of the wrong kind", path=path
        ) from error


def _read_report(path: Path) -> dict[str, Any]:
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"cannot read the report: {error.strerror}", path=path) from error
    except ValueError as error:
        raise InputError(f"not a report: {error}", path=path) from error
    if not isinstance(report, dict) or report.get("schema") != 1:
        raise InputError("not a report of lss-play (`schema: 1`)", path=path)
    return report


def _differences(before: dict[str, Any], after: dict[str, Any]) -> Iterator[str]:
    """Yield every number that is in both reports and not the same, with its change."""
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
    widths = [max(len(row[column]) for row in rows) for column in range(4)]
    for name, was_text, now_text, ratio in rows:
        yield (
            f"{name:{widths[0]}}  {was_text:>{widths[1]}}  {now_text:>{widths[2]}}  "
            f"{ratio:>{widths[3]}}"
        ).rstrip()


def _numbers(part: Any, name: str = "") -> Iterator[tuple[str, float]]:  # noqa: ANN401  JSON
    if isinstance(part, dict):
        for key, value in part.items():
            yield from _numbers(value, f"{name} {key}".strip())
    elif isinstance(part, int | float) and not isinstance(part, bool) and math.isfinite(part):
        yield name, float(part)


_ENUM: Final = re.compile(r"<(\w+)\.\w+: ('[^']*')>")
"""How Python writes a member of an enumeration of words."""
_MADE: Final[dict[str, Callable[..., Any]]] = {
    kind.__name__: kind
    for kind in (
        events.Checked,
        events.CueReached,
        events.Faulted,
        events.Found,
        events.MarkPassed,
        events.PhaseEntered,
        events.Waited,
        events.Warned,
        events.Phase,
        Cause,
        Cue,
        FaultStep,
    )
}


def event_lines(logged: str) -> list[str]:
    """Return what is to be said of an event of a log, or the event as it stands if it is strange.

    One servo a line would drown the rest: of what was found, only the number is said.
    """
    text = logged.encode("ascii").decode("unicode_escape")
    try:
        event = _made(ast.parse(_ENUM.sub(r"\1(\2)", text), mode="eval").body)
        lines: list[str] = []
        if isinstance(event, events.Checked):
            return [f"checked {len(event.servos)} servos"]
        if isinstance(event, events.MarkPassed) and not event.label:
            return [f"{event.show_s:.2f} s a keyframe"]
        tell(event, lambda line: lines.append(line.strip()))
    except (SyntaxError, ValueError, TypeError, KeyError, AttributeError):
        return [text]
    return lines or [text]


def _made(node: ast.expr) -> Any:  # noqa: ANN401  (an event, or a part of one)
    """Return what was written down, made of nothing but the kinds of events and their parts."""
    match node:
        case ast.Call(func=ast.Name(id=name)):
            fields = {key.arg or "": _made(key.value) for key in node.keywords}
            return _MADE[name](*map(_made, node.args), **fields)
        case ast.Tuple():
            return tuple(map(_made, node.elts))
        case _:
            return ast.literal_eval(node)
