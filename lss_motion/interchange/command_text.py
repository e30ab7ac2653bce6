"""Raw command text of serial servo controllers: SSC-32 `#5P1500T1000`, LSS `#5D900T1000`.

A line may begin with the instant of its command: seconds with a decimal point (logs of `--log`), or
whole microseconds (`.lss` programs). With instants, a command that arrives during a move starts at
the position that the servo has then. Without instants, commands to different servos start together,
and the next command to one of these servos starts when all of them have arrived.

`#254D…` moves all servos: those of the text, and all others of the robot (`BROADCAST_ID`).

Case and spaces between the parts of a command do not count, as on an SSC-32: `#5 p1500 t1000`.

Lines such as `wait 500 ms`, `pause 0.5`, `delay(500);` or `time.sleep(0.5)` are the clock of a
script: what follows is sent that long after what stands above was sent, arrived or not. `wait` and
`pause` are words of many programs, with seconds or milliseconds: where the text does not give the
unit, all bare whole numbers of the word decide.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np

from lss_motion.files.texts import counted
from lss_motion.interchange.fields import TextLines, text_head
from lss_motion.interchange.reader import (
    BROADCAST_ID,
    DIGITS,
    TENTHS_PER_DEG,
    VALUES_MAX,
    Channel,
    ForeignMotion,
    Measure,
    PoseNote,
    Reader,
    is_dense,
    motion_name,
    summarised,
    thinned,
)
from lss_motion.show.model import TIME_MAX_S, Interpolation
from lss_motion.units import s_from_ms, s_from_us

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

ID_MAX: Final = 250
"""Largest id of an LSS. An SSC-32 has 32 channels."""

_ALL: Final = f"ID{BROADCAST_ID}"

DURATION_MAX_MS: Final = 3_600_000
"""Chosen: one hour, longer than any single move."""

_MOVE: Final = re.compile(r"#(\d{1,3})([DP])(-?\d{1,7})", re.ASCII)
_PART: Final = re.compile(r"[#*](?=\d)[^#*]*", re.ASCII)
_OTHER: Final = re.compile(r"[#*]\d{1,3}([A-Z]{1,6})", re.ASCII)
_STAMP: Final = re.compile(r"(\d{1,12}|\d{1,9}\.\d{1,9})\s+(?:\S{1,64}\s+)??(?:[<>]\s+)?(?=[#*])")
_LETTER: Final = re.compile(
    r"(?<=\d)[ \t]{0,8}(SD|[DPST])[ \t]{0,8}(?=-?\d)", re.ASCII | re.IGNORECASE
)
"""A letter between two numbers of a command, with spaces as in the manual of the SSC-32."""
_TIME: Final = re.compile(r"T(\d{1,9})", re.ASCII)
_PLURAL: Final = re.compile(r"(?<=wait)s|(?<=speed)s|(?<=command)s")
_SPEED: Final = re.compile(r"SD?\d", re.ASCII)

_WAIT: Final = re.compile(
    r"\b(?:\w{1,20}\.)?(wait|pause|delay|sleep)(?:_(ms|s))?[\s(:=]{1,4}(\d{1,9}(?:[.,]\d{1,6})?)\s{0,4}"
    r"(?:(milliseconds?|msecs?|ms|seconds?|secs?|s)\b)?[\s)]{0,4};?",
    re.ASCII | re.IGNORECASE,
)
_IN_SECONDS: Final = frozenset({"sleep"})
"""As in a shell and in Python. `delay` is in ms, as in an Arduino sketch."""
_EITHER: Final = ("wait", "pause")
WAIT_MIN_MS: Final = 20
"""A whole number without a unit is seconds if no wait of the text has so much. Chosen: no servo
gets anywhere in less than 20 ms, and a wait of 20 s ends a script."""
_COMMENT: Final = re.compile(r"//.*|#(?!\d).*|^\s*[;%].*", re.ASCII)
_LOG_LINE: Final = re.compile(r"\d{1,9}\.\d{9} \S{1,64} ([><.=!~?#])(?: .*)?", re.ASCII)
"""A line of a log. Only those of bytes that were sent (`>`) or received (`<`) hold commands."""

CONSTANT_SPEED: Final = (
    "Each servo is assumed to move at constant speed for the time of its command."
)
"""Comment on the ease `linear` of a script."""

LISTED_MAX: Final = 10
"""Chosen: more lines without a meaning are counted only."""


class _ServoMove(NamedTuple):
    value: float
    start_s: float
    duration_s: float
    line: int


def command_reader(wait_unit: Literal["ms", "s"] | None = None) -> Reader:
    """Return what reads `#<id>D<tenths>T<ms>` (joints by id) and `#<ch>P<us>…T<ms>` (pulses).

    `wait_unit` is that of a `wait` or `pause` without one; None: decided by its numbers.
    """
    return Reader("commands", _is_command_text, partial(_command_motions, wait_unit))


def _is_command_text(data: bytes) -> bool:
    head = text_head(data, 8192).decode("utf-8", "replace").lstrip()
    return not head.startswith("#WEBOTS") and _MOVE.search(_plain(head)) is not None


def _command_motions(
    wait_unit: Literal["ms", "s"] | None, path: Path, data: bytes
) -> tuple[ForeignMotion, ...]:
    lines = TextLines.of(path, data)
    units = _bare_units(lines)
    if wait_unit is not None:
        units = dict.fromkeys(units, wait_unit)
    text = _CommandText(lines, units)
    for number, line in text.lines.numbered():
        text.read(number, line)
    return (text.motion(),)


COMMANDS: Final = command_reader()


def _plain(text: str) -> str:
    """Return a text with its commands in capitals and without spaces within them."""
    return _LETTER.sub(lambda letter: letter[1].upper(), text)


def _bare_units(lines: TextLines) -> dict[tuple[str, bool], str]:
    """Return the units of `wait` and `pause` where the text has none: fractions are seconds."""
    most = dict.fromkeys(_EITHER, 0)
    for _, line in lines.numbered():
        for wait in _WAIT.finditer(_COMMENT.sub("", line)):
            word, digits = wait[1].lower(), wait[3]
            if word in most and digits.isdigit() and not (wait[2] or wait[4]):
                most[word] = max(most[word], int(digits))
    whole = {(word, True): "ms" if count >= WAIT_MIN_MS else "s" for word, count in most.items()}
    return {**whole, **{(word, False): "s" for word in _EITHER}}


@dataclass(slots=True)
class _CommandText:
    """Collects the moves of a file, by servo."""

    lines: TextLines
    units: Mapping[tuple[str, bool], str]
    """The unit of each word of `_EITHER` that has none, by whether its number is whole."""
    moves: dict[str, list[_ServoMove]] = field(default_factory=dict)
    left_out: Counter[str] = field(default_factory=Counter)
    is_stamped: bool | None = None
    group: set[str] = field(default_factory=set)
    group_start_s: float = 0.0
    group_end_s: float = 0.0
    moves_count: int = 0
    assumed: dict[str, str] = field(default_factory=dict)
    """Words of waits whose unit the text does not give, and the unit that is assumed."""
    idle: list[str] = field(default_factory=list)
    """Lines that mean nothing."""
    is_paced: bool = False
    """Whether the text has waits."""
    is_stream: bool = False
    """Whether a command arrived before the move of its servo had ended."""

    def read(self, number: int, line: str) -> None:
        """Read all commands and waits of a line, in their order."""
        log_line = _LOG_LINE.fullmatch(line)
        if log_line and log_line[1] not in "><":
            return
        stamp = _STAMP.match(line)
        text = _COMMENT.sub("", line[stamp.end() :] if stamp else line)
        text = _plain(text.replace("\\r", "\r"))  # The log writes a CR so.
        start = 0
        has_meaning = log_line is not None or not text.strip()
        for wait in _WAIT.finditer(text):
            has_meaning |= self._commands(number, text[start : wait.start()], stamp)
            self._wait(number, wait, is_stamped=stamp is not None or self.is_stamped is True)
            start, has_meaning = wait.end(), True
        has_meaning |= self._commands(number, text[start:], stamp)
        if not has_meaning:
            self.idle.append(f"line {number}, which means nothing here: {line!r:.60}")

    def _wait(self, number: int, wait: re.Match[str], *, is_stamped: bool) -> None:
        """Let the clock of the script advance."""
        word, digits = wait[1].lower(), wait[3]
        unit = (wait[2] or wait[4] or "").lower()
        if not unit:
            unit = "s" if word in _IN_SECONDS or not digits.isdigit() else "ms"
            if word in _EITHER:
                unit = self.units[word, digits.isdigit()]
                self.assumed[f"{word} {digits}"] = unit
        value = self.lines.number(digits, number, has_commas=True)
        wait_s = s_from_ms(value) if unit.startswith("m") else value
        if is_stamped:
            self.left_out["waits, because the commands have instants"] += 1
            return
        self.is_paced = True
        self.group.clear()
        self.group_start_s += wait_s
        if self.group_start_s > TIME_MAX_S:
            self.lines.refuse(number, f"ends more than a day ({TIME_MAX_S:g} s) after the start")
        self.group_end_s = self.group_start_s

    def _commands(self, number: int, text: str, stamp: re.Match[str] | None) -> bool:
        """Read the commands in `text`; return whether there is one."""
        found = False
        for command in text.split("\r"):
            times = _TIME.findall(command)
            for part in _PART.findall(command):
                found = True
                move = _MOVE.match(part)
                if move is None:
                    other = _OTHER.match(part)
                    self.left_out[f"commands {part[0]}{other[1]}" if other else "noise"] += 1
                else:
                    # A group has one T at its end; a part may have its own T.
                    own = _TIME.findall(part) or times[-1:]
                    self._move(number, move, own[0] if own else "", stamp[1] if stamp else None)
                    self.left_out["speeds (S, SD)"] += _SPEED.search(part) is not None
        return found

    def _move(self, number: int, move: re.Match[str], time: str, stamp: str | None) -> None:
        if self.is_stamped not in {None, stamp is not None}:
            self.lines.refuse(number, "some commands have an instant and some have none")
        self.is_stamped = stamp is not None
        duration_ms = self.lines.whole(time or "0", number, DURATION_MAX_MS)
        if not duration_ms:
            self.lines.refuse(
                number,
                f"{move[0]!r} has no time (T), so its duration depends on the servo",
            )
        is_pulse = move[2] == "P"
        is_broadcast = not is_pulse and int(move[1]) == BROADCAST_ID
        servo = BROADCAST_ID if is_broadcast else self.lines.whole(move[1], number, ID_MAX)
        name = f"PIN{servo}" if is_pulse else f"ID{servo}"
        value = float(move[3]) if is_pulse else int(move[3]) / TENTHS_PER_DEG
        duration_s = s_from_ms(duration_ms)
        start_s = self._start(stamp, name, duration_s)
        if start_s + duration_s > TIME_MAX_S:
            self.lines.refuse(number, f"ends more than a day ({TIME_MAX_S:g} s) after the start")
        if name not in self.moves:
            earlier = [] if is_pulse else self.moves.get(_ALL, [])
            self.moves[name] = [*earlier]
            self.moves_count += len(earlier)
        moved = [own for own in self.moves if own.startswith("ID")] if is_broadcast else [name]
        for own in moved:
            self.moves[own].append(_ServoMove(value, start_s, duration_s, number))
        self.moves_count += len(moved)
        if self.moves_count > VALUES_MAX:
            self.lines.refuse(number, f"more than {VALUES_MAX:,} moves")

    def _start(self, stamp: str | None, name: str, duration_s: float) -> float:
        if stamp is not None:
            return float(stamp) if "." in stamp else s_from_us(int(stamp))
        is_taken = (
            any(own.startswith("ID") for own in self.group)
            if name == _ALL
            else (name.startswith("ID") and _ALL in self.group)
        )
        if is_taken or name in self.group:
            self.group.clear()
            self.group_start_s = self.group_end_s
        self.group.add(name)
        self.group_end_s = max(self.group_end_s, self.group_start_s + duration_s)
        return self.group_start_s

    def motion(self) -> ForeignMotion:
        if not self.moves:
            self.lines.refuse(None, "has no command that moves a servo (#<id>D… or #<ch>P…)")
        channels = [self._channel(name, moves) for name, moves in self.moves.items()]
        has_pulses = any(channel.unit is Measure.US for channel in channels)
        title = "SSC-32 commands" if has_pulses else "LSS commands"
        order = "one group after the other"
        if self.is_paced:
            order = "paced by the waits of the text"
        if self.is_stamped:
            order = "at their instants"
        found = self.idle[:LISTED_MAX]
        if len(self.idle) > LISTED_MAX:
            found.append(
                f"{counted(len(self.idle) - LISTED_MAX, 'more line')} without a meaning here"
            )
        for what, count in sorted(self.left_out.items()):
            found += [f"{count} {what if count > 1 else _PLURAL.sub('', what, count=1)}"] * bool(
                count
            )
        found.append("positions of the servos before their first command: the text has none")
        path = self.lines.path
        # Moves that do not end before the next command are a curve. Whole moves are poses.
        is_recording = any(is_dense(channel.times_s) for channel in channels)
        return ForeignMotion(
            path=path,
            name=motion_name(path),
            channels=tuple(channels),
            notes=self._last_pause(channels),
            ease=Interpolation.SPLINE if is_recording or self.is_stream else Interpolation.LINEAR,
            comments=(
                f"Imported from {path.name} ({title}, {order}).",
                CONSTANT_SPEED,
                *(
                    f"`{wait}` is read as {unit}; if it is not, use --wait-unit "
                    f"{'s' if unit == 'ms' else 'ms'} or write the unit."
                    for wait, unit in self.assumed.items()
                ),
                *summarised(found),
            ),
            is_recording=is_recording,
            is_script=not is_recording and not self.is_stream,
        )

    def _last_pause(self, channels: list[Channel]) -> dict[float, PoseNote]:
        """Return the wait after the last move, as a hold of the last pose."""
        end_s = max(float(channel.times_s[-1]) for channel in channels)
        hold_s = round(self.group_start_s - end_s, DIGITS) if self.is_paced else 0.0
        return {end_s: PoseNote(hold_s=hold_s)} if hold_s > 0.0 else {}

    def _channel(self, name: str, moves: list[_ServoMove]) -> Channel:
        samples = np.array(list(self._samples(moves)))
        times_s, values = thinned(samples[:, 0], samples[:, 1])
        ends_s, at = np.unique(np.round(samples[:, 0], DIGITS), return_index=True)
        lines = samples[at[np.searchsorted(ends_s, times_s)], 2].astype(np.int32)
        is_pulse = name.startswith("PIN")
        return Channel(
            name=name,
            unit=Measure.US if is_pulse else Measure.DEG,
            times_s=times_s,
            values=values,
            lines=lines,
            servo_id=None if is_pulse else int(name[2:]),
        )

    def _samples(self, moves: list[_ServoMove]) -> Iterator[tuple[float, float, int]]:
        """Yield instant, position and line: the start of each command, and a target if reached."""
        from_value = moves[0].value
        last_s = -1.0
        for move, following in zip(moves, [*moves[1:], None], strict=True):
            if move.start_s < last_s:
                self.lines.refuse(move.line, "instants must not go back")
            if last_s >= 0.0:
                yield move.start_s, from_value, move.line
            last_s = move.start_s
            share = 1.0
            if following is not None and following.start_s < move.start_s + move.duration_s:
                share = max(0.0, following.start_s - move.start_s) / move.duration_s
                self.is_stream = True
            from_value += share * (move.value - from_value)
            if share == 1.0:
                yield move.start_s + move.duration_s, from_value, move.line
