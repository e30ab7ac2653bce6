"""Makes the player's decisions again from a log, and compares them with those that it holds."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from lss_motion.errors import InputError
from lss_motion.planning import shows
from lss_motion.planning.program.text import load_program
from lss_motion.playing.log import (
    PortLine,
    ReceivedLine,
    RequestedLine,
    SentLine,
    TurnedLine,
)
from lss_motion.playing.player.events import PlayerRequest
from lss_motion.playing.player.show_clock import LeaderPosition

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from lss_motion.playing.log import Log, LogLine
    from lss_motion.playing.player.player import Player
    from lss_motion.robot.model import Robot


@dataclass(slots=True)
class Replayed:
    """How many decisions of the player were compared with the log, and which differ."""

    compared: int = 0
    differing: list[tuple[int, bytes]] = field(default_factory=list)
    """Index of the line of the log, and the bytes that the player sends now instead."""


def logged_robot(log: Log, read_robot: Callable[[Path], Robot]) -> Robot:
    """Return the robot of the show that wrote `log`."""
    if log.played is None:
        raise InputError("does not name the file that was played; add --robot FILE", path=log.path)
    if log.played.robot is not None:
        return read_robot(Path(log.played.robot))
    file = Path(log.played.file)
    reads = (
        load_program(file, read_robot)
        if shows.is_program(file)
        else shows.load(file, None, read_robot)
    )
    return reads[1]


def sent_lines(lines: Sequence[LogLine]) -> Iterator[tuple[int, str, bytes]]:
    """Yield instant, bus and bytes of every line that was sent to servos."""
    rest: dict[str, bytes] = {}
    for entry in lines:
        if isinstance(entry, SentLine):
            *whole, rest[entry.bus] = (rest.get(entry.bus, b"") + entry.data).split(b"\r")
            yield from ((entry.at_ns, entry.bus, line + b"\r") for line in whole)


def replay(lines: Sequence[LogLine], player: Player) -> Replayed:
    """Feed the log to `player`: the same instants, answers and requests; compare what it sends.

    The player must be made from the same show and robot. Nothing is sent to a port.
    """
    result, index = Replayed(), 0
    while index < len(lines):
        line = lines[index]
        index += 1
        match line:
            case ReceivedLine():
                player.receive_data(line.bus, line.data, line.at_ns)
            case RequestedLine():
                _request(player, line.request, line.at_ns)
            case PortLine(state="lost"):
                player.port_lost(line.bus, line.reason, line.at_ns)
            case PortLine(state="found"):
                player.port_found(line.bus)
            case PortLine(state="safe"):
                index = _compare_safe(lines, index, player, result)
            case TurnedLine() | SentLine():
                index = _compare_turn(lines, index - 1, player, result)
            case _:
                pass
    return result


def _compare_turn(lines: Sequence[LogLine], index: int, player: Player, result: Replayed) -> int:
    """Compare what one turn of the loop sent, from `index` on; return the index after it."""
    first, at_ns = index, lines[index].at_ns
    sent = dict(player.data_to_send(at_ns))
    result.compared += 1
    buses: set[str] = set()
    while (
        index < len(lines)
        and isinstance(line := lines[index], SentLine)
        and line.at_ns == at_ns
        and line.bus not in buses
    ):
        buses.add(line.bus)
        if (now := sent.pop(line.bus, b"")) != line.data:
            result.differing.append((index, now))
        index += 1
    result.differing += [(first, data) for data in sent.values()]
    while player.next_event() is not None:
        pass
    player.next_wakeup_ns()  # It polls what is overdue by then, as in the run.
    return max(index, first + 1)


def _compare_safe(lines: Sequence[LogLine], index: int, player: Player, result: Replayed) -> int:
    """Compare the safe bytes in the line at `index`; return the index after it."""
    if index < len(lines) and isinstance(line := lines[index], SentLine):
        result.compared += 1
        if (now := player.safe_bytes().get(line.bus, b"")) != line.data:
            result.differing.append((index, now))
        index += 1
    return index


def _request(player: Player, request: PlayerRequest, at_ns: int) -> None:
    """Call the player as it was called in the run."""
    match request:
        case PlayerRequest("go", ()):
            player.go()
        case PlayerRequest("rate", (float(rate),)):
            player.set_rate(rate, at_ns)
        case PlayerRequest("follow", (float(show_s), float(rate), *style)):
            player.follow(LeaderPosition(at_ns, show_s, rate), at_ns, *map(float, style))
        case PlayerRequest("seek", (float(show_s),)):
            player.seek(show_s, at_ns)
        case PlayerRequest("run_from", (float(show_s),)):
            player.run_from(show_s, at_ns)
        case PlayerRequest("hold_before_start", ()):
            player.hold_before_start(at_ns)
        case PlayerRequest("sound", (str(text),)):
            player.lose_sound(text, at_ns)
        case PlayerRequest("stop", ()):
            player.stop(at_ns)
        case _:
            raise InputError(f"the log has a request with wrong values: {request.text}")
