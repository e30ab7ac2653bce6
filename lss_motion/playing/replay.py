"""Reads a log: what each servo was sent, and the player's decisions, made again and compared."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Literal, cast

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.files.source import read_text
from lss_motion.playing.log import FIRST_LINE
from lss_motion.playing.player.show_clock import Leg
from lss_motion.playing.runner import SAFE
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from lss_motion.playing.player.player import Player

    LineKind = Literal[">", "<", ".", "=", "!", "~", "?", "#"]

_LINE: Final = re.compile(r"(\d{1,9})\.(\d{9}) (\S+) ([><.=!~?#])(?: (.*))?")


LOG_MAX_BYTES: Final = 500_000_000
"""The most that is read of a log. A show of 18 joints writes about 100 MB an hour."""


class Entry(Struct, frozen=True):
    """One line of a log. `data` are the bytes of a `>` or `<` line, `text` is its raw content."""

    at_ns: int
    bus: str
    kind: LineKind
    text: str
    line: int

    @property
    def data(self) -> bytes:
        return self.text.encode("ascii").decode("unicode_escape").encode("latin-1")


@dataclass(slots=True)
class Replayed:
    """How many decisions of the player were compared with the log, and which differ."""

    compared: int = 0
    differing: list[tuple[Entry, bytes]] = field(default_factory=list)
    """Line of the log, and the bytes that the player sends now instead."""


def read_log(path: Path) -> tuple[dict[str, Any], list[Entry]]:
    """Return how the show was played, and all lines. Raises `InputError` for another file.

    A last line without its end is dropped: a log may end in a crash.
    """
    text = read_text(path, LOG_MAX_BYTES)
    lines = text.split("\n")[:-1]
    if not lines or lines[0] != FIRST_LINE:
        raise InputError(
            f"not a log: the first line must be `{FIRST_LINE}`; `lss-play SHOW --log F` writes one",
            path=path,
            line=1,
        )
    played: dict[str, Any] = {}
    entries = []
    for number, line in enumerate(lines[1:], start=2):
        if line.startswith("# played: "):
            played = _played(line.removeprefix("# played: "), path, number)
        elif match := _LINE.fullmatch(line):
            at_ns = int(match[1]) * NS_PER_S + int(match[2])
            entries.append(
                Entry(at_ns, match[3], cast("LineKind", match[4]), match[5] or "", number)
            )
        else:
            raise InputError(f"{line[:60]!r} is no line of a log", path=path, line=number)
    return played, entries


def _played(text: str, path: Path, line: int) -> dict[str, Any]:
    try:
        played = json.loads(text)
    except ValueError as error:
        raise InputError(f"`# played:` holds no JSON: {error}", path=path, line=line) from error
    if not isinstance(played, dict):
        raise InputError("`# played:` holds no JSON object", path=path, line=line)
    return played


def sent_lines(entries: list[Entry]) -> Iterator[tuple[int, str, bytes]]:
    """Yield instant, bus and bytes of every line that was sent to servos."""
    rest: dict[str, bytes] = {}
    for entry in entries:
        if entry.kind == ">":
            *lines, rest[entry.bus] = (rest.get(entry.bus, b"") + entry.data).split(b"\r")
            yield from ((entry.at_ns, entry.bus, line + b"\r") for line in lines)


def replay(entries: list[Entry], player: Player) -> Replayed:
    """Feed the log to `player`: the same instants, answers and requests; compare what it sends.

    The player must be made from the same show and robot. Nothing is sent to a port.
    """
    result, index = Replayed(), 0
    while index < len(entries):
        entry = entries[index]
        index += 1
        match entry.kind:
            case "<":
                player.receive_data(entry.bus, entry.data, entry.at_ns)
            case "=":
                _apply_request(player, entry)
            case "~":
                index = _apply_note(entry, entries, index, player, result)
            case "." | ">":
                sent = dict(player.data_to_send(entry.at_ns))
                result.compared += 1
                group = [entry] if entry.kind == ">" else []
                while index < len(entries) and _is_same_write(entry, entries[index]):
                    group.append(entries[index])
                    index += 1
                for logged in group:
                    if (now := sent.pop(logged.bus, b"")) != logged.data:
                        result.differing.append((logged, now))
                result.differing += [(entry, data) for data in sent.values()]
                while player.next_event() is not None:
                    pass
                player.next_wakeup_ns()  # It polls what is overdue by then, as in the run.
            case _:
                pass
    return result


def _apply_note(
    entry: Entry, entries: list[Entry], index: int, player: Player, result: Replayed
) -> int:
    """Repeat a `~` line before `index`; return the index of the next line to repeat."""
    if entry.text == SAFE:
        return _compare_safe(entries, index, player, result)
    _apply_port(player, entry)
    return index


def _compare_safe(entries: list[Entry], index: int, player: Player, result: Replayed) -> int:
    """Compare the safe bytes in the line at `index`; return the index after it."""
    if index < len(entries) and (logged := entries[index]).kind == ">":
        result.compared += 1
        if (now := player.safe_bytes().get(logged.bus, b"")) != logged.data:
            result.differing.append((logged, now))
        index += 1
    return index


def _apply_port(player: Player, entry: Entry) -> None:
    word, _, reason = entry.text.partition(" ")
    match word:
        case "lost":
            reason = reason.encode("ascii").decode("unicode_escape")
            player.port_lost(entry.bus, reason, entry.at_ns)
        case "found":
            player.port_found(entry.bus)
        case _:
            raise InputError(
                f"{entry.text!r} is nothing that a port does (lost, found or safe)",
                line=entry.line,
            )


def _is_same_write(entry: Entry, other: Entry) -> bool:
    return entry.kind == other.kind == ">" and entry.at_ns == other.at_ns and entry.bus != other.bus


def _apply_request(player: Player, entry: Entry) -> None:
    word, _, value = entry.text.partition(" ")
    match word:
        case "go":
            player.go()
        case "rate":
            player.set_rate(float(value), entry.at_ns)
        case "follow":
            show_s, rate, *style = map(float, value.split())
            player.follow(Leg(entry.at_ns, show_s, rate), entry.at_ns, *style)
        case "seek":
            player.seek(float(value), entry.at_ns)
        case "run_from":
            player.run_from(float(value), entry.at_ns)
        case "hold_before_start":
            player.hold_before_start(entry.at_ns)
        case "sound":
            player.lose_sound(json.loads(value), entry.at_ns)
        case "stop":
            player.stop(entry.at_ns)
        case "abort":
            player.abort(entry.at_ns)
        case _:
            raise InputError(
                f"{entry.text!r} is not a request (go, rate, follow, sound, stop or abort)",
                line=entry.line,
            )
