"""The command `replay`: the content of a log of lss-play, and its second run.

Events are printed in the words that the screen showed during the run.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.dialog import print_event
from lss_motion.cli.messages import say
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError
from lss_motion.files.texts import counted
from lss_motion.playing.player import events
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.playing.log import Log, LogLine


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
    from lss_motion.playing.log import SentLine
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.repertoire import Repertoire
    from lss_motion.playing.replay import replay
    from lss_motion.playing.stored_limits import with_limits
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
    robot = with_port(show.robot, played.port)  # A simulated robot is asked for less.
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
