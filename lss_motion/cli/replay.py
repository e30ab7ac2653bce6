"""The command `replay`: the content of a log of lss-play, and its second run.

Events are printed in the words that the screen showed during the run.
"""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.dialog import print_event
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError
from lss_motion.playing.player import events
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from lss_motion.cli.commands import Commands
    from lss_motion.playing.replay import Entry


DESCRIPTION: Final = """\
Print what a log of lss-play holds, or run it again.

  lss-motion replay show.log               bytes of each bus, events, commands of each servo
  lss-motion replay show.log --servo 5     every line to this servo, with its instant
  lss-motion replay show.log --again       the player runs through the log again

With --again the player of the same show gets the replies of the log, and its output is compared
with that of the log. Exit code 5: the player sent something else.
"""
DIFFERENCES_SHOWN: Final = 5


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    replay = add_command(commands, "replay", _replay, DESCRIPTION)
    replay.add_argument("log", type=Path, metavar="LOG", help="written by lss-play --log")
    replay.add_argument(
        "--servo", type=int, metavar="ID", help="print every line that was sent to this servo"
    )
    replay.add_argument(
        "--again", action="store_true", help="run the player again and compare its output"
    )


def _replay(arguments: argparse.Namespace) -> int:
    from lss_motion.playing.replay import read_log

    played, entries = read_log(arguments.log)
    if not entries or entries[-1].kind != "#":
        print(
            f"warning: {arguments.log} has no end: the player was killed, or still runs. At most "
            f"the last tenth of a second is missing",
            file=sys.stderr,
        )
    if arguments.again:
        return _again(arguments.log, played, entries)
    lines = (
        _lines_to(entries, arguments.servo) if arguments.servo is not None else _summary(entries)
    )
    for line in lines:
        print(line)
    return EXIT_FINISHED


def _again(path: Path, played: dict[str, Any], entries: list[Entry]) -> int:
    from lss_motion.planning import shows
    from lss_motion.playing.connection import with_port
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.replay import replay
    from lss_motion.playing.stored_limits import with_limits
    from lss_motion.robot.load import load_robot

    if "file" not in played:
        raise InputError("does not name the file that was played (`# played:`)", path=path)
    robot_path = None if played.get("robot") is None else Path(played["robot"])
    limits = played.get("limits", {})
    show = shows.prepare(
        Path(played["file"]),
        robot_path,
        speed_ratio=played.get("speed", 1.0),
        loop=played.get("loop"),
        is_following=played.get("is_following", False),
        read_robot=lambda path: with_limits(load_robot(path), limits),
    )
    robot = with_port(show.robot, played.get("port"))  # A simulated robot is asked for less.
    player = Player(
        Repertoire.single(show.program, robot),
        robot,
        has_feedback=played.get("has_feedback", True),
        start_s=played.get("start_s"),
        must_ask=played.get("must_ask", False),
        is_forced=played.get("is_forced", False),
    )
    result = replay(entries, player)
    count = len(result.differing)
    print(f"{path}: {result.compared} outputs compared, {count} differ")
    for entry, now in result.differing[:DIFFERENCES_SHOWN]:
        print(f"  line {entry.line}, {s_from_ns(entry.at_ns):.6f} s: {entry.text!r}, now {now!r}")
    return EXIT_NOT_FOLLOWED if count else EXIT_FINISHED


def _lines_to(entries: list[Entry], servo_id: int) -> list[str]:
    from lss_motion.playing.replay import sent_lines
    from lss_motion.protocol.constants import BROADCAST_ID
    from lss_motion.protocol.framing import Command, CommandParser

    parser = CommandParser(grouped=False)
    lines, ids = [], set()
    for at_ns, bus, line in sent_lines(entries):
        for item in parser.feed(line):
            if not isinstance(item, Command):
                continue
            ids.add(item.servo_id)
            if item.servo_id in (servo_id, BROADCAST_ID):
                text = line[:-1].decode("ascii", "replace")
                lines.append(f"{s_from_ns(at_ns):12.6f} {bus} {text}")
    if servo_id not in ids:
        there = ", ".join(map(str, sorted(ids - {BROADCAST_ID}))) or "none"
        raise InputError(f"no line of this log is for servo {servo_id}; it has lines for: {there}")
    return lines


def _summary(entries: list[Entry]) -> Iterator[str]:
    from collections import Counter

    from lss_motion.playing.replay import sent_lines
    from lss_motion.protocol.framing import Command, CommandParser

    end_ns = entries[-1].at_ns if entries else 0
    yield f"{s_from_ns(end_ns):.3f} s"
    for bus in sorted({entry.bus for entry in entries if entry.kind in "><"}):
        sent, received = (
            sum(len(entry.data) for entry in entries if entry.bus == bus and entry.kind == way)
            for way in "><"
        )
        yield f"bus {bus}: {sent} bytes sent, {received} received"
    for entry in entries:
        texts = {
            "=": [f"order: {entry.text}"],
            "~": [f"port {entry.bus}: {entry.text}"],
            "?": [f"lost: {entry.text}"],
        }.get(entry.kind, [])
        for text in event_lines(entry.text) if entry.kind == "!" else texts:
            yield f"{s_from_ns(entry.at_ns):12.6f} {text}"
    counts: dict[tuple[str, int], Counter[str]] = {}
    parser = CommandParser(grouped=False)
    for _, bus, line in sent_lines(entries):
        for item in parser.feed(line):
            if isinstance(item, Command):
                counts.setdefault((bus, item.servo_id), Counter())[item.keyword] += 1
    for (bus, servo_id), words in sorted(counts.items()):
        counted = ", ".join(f"{word} {count}" for word, count in words.most_common())
        yield f"servo {servo_id} on {bus}: {counted}"


_ENUM: Final = re.compile(r"<(\w+)\.\w+: ('[^']*')>")
"""A member of an enumeration of texts, as Python writes it."""


def event_lines(logged: str) -> list[str]:
    """Return the lines about an event of a log, or its raw text if it cannot be read.

    The result of the check is one line with the number of servos, not a table of them.
    """
    text = logged.encode("ascii").decode("unicode_escape")
    try:
        event = _made(ast.parse(_ENUM.sub(r"\1(\2)", text), mode="eval").body)
        lines: list[str] = []
        if isinstance(event, events.Checked):
            return [f"checked {len(event.servos)} servos"]
        if isinstance(event, events.MarkPassed) and not event.label:
            return [f"{event.show_s:.2f} s a keyframe"]
        print_event(event, lambda line: lines.append(line.strip()))
    except (SyntaxError, ValueError, TypeError, KeyError, AttributeError):
        return [text]
    return lines or [text]


def _made(node: ast.expr) -> Any:  # noqa: ANN401  (an event, or a part of one)
    """Return the value of an expression that holds only events and their parts."""
    match node:
        case ast.Call(func=ast.Name(id=name)):
            fields = {key.arg or "": _made(key.value) for key in node.keywords}
            return _kinds()[name](*map(_made, node.args), **fields)
        case ast.Tuple():
            return tuple(map(_made, node.elts))
        case _:
            return ast.literal_eval(node)


def _kinds() -> dict[str, Callable[..., Any]]:
    """Return the types that a log may hold, by name."""
    from lss_motion.robot.on_fault import Cause, FaultStep
    from lss_motion.show.model import Cue, SoundStyle

    kinds: tuple[type, ...] = (
        events.Checked,
        events.CueReached,
        events.Faulted,
        events.Found,
        events.MarkPassed,
        events.Noted,
        events.PhaseEntered,
        events.Waited,
        events.Warned,
        events.Phase,
        Cause,
        Cue,
        FaultStep,
        SoundStyle,
    )
    return {kind.__name__: kind for kind in kinds}
