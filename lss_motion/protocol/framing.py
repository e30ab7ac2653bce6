"""Bytes ⇄ commands and replies: the grammar that all three bus languages share.

One command or one reply is one line:

    command   # <id> <KEYWORD> [<value>] { <MODIFIER> <value> } CR        #5D1443T500
    reply     * [<id>] <KEYWORD> [<value>] CR                             *5QD1443
    group     several of them before one CR                               #0QD0QC0#5QD0

`#…` or `*…` up to the next start byte is a section. The parsers accept any bytes in any chunks and
never raise. The tables of the families define the keywords and their values.
"""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import groupby
from typing import TYPE_CHECKING, Final, NamedTuple, TypeVar

from msgspec import Struct

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

LINE_MAX_BYTES: Final = 64
"""Longest section that the parsers read. Chosen: twice the longest section that the documents
allow, `#254MD-32768T65535SD65535CH65535`. A group line may be longer than that."""

TEXT_REPLIES: Final = ("QMS", "QN")
"""Queries whose reply has text directly after the keyword (`*5QMSLSS-HS1`). A serial number keeps
its leading zeros and may contain letters (FACTS.md C15)."""

DISABLED: Final = "DIS"
"""The value of a first position that is not set (FACTS.md C16)."""

TEXT_COMMAND: Final = "CRC"
"""The only command whose value may be text (`#5CRC*`, FACTS.md R14)."""


class Command(NamedTuple):
    """A command of the host. `keyword` is upper case. A query has its suffix as value (`QSD2`)."""

    servo_id: int
    keyword: str
    value: int | str | None = None
    modifiers: tuple[tuple[str, int], ...] = ()


class Reply(NamedTuple):
    """A reply of a servo. `servo_id` is None in `*QID5`; `value` is None in `*5QDT`."""

    servo_id: int | None
    keyword: str
    value: int | str | None = None


ItemT = TypeVar("ItemT", Command, Reply)


class Garbage(Struct, frozen=True):
    """Received bytes that are not a valid line. Callers count them."""

    data: bytes


def encode(item: Command | Reply) -> bytes:
    """Return the exact bytes of one line with its CR. The values were checked in `codec`."""
    value = "" if item.value is None else item.value
    if isinstance(item, Command):
        if not item.modifiers:
            return f"#{item.servo_id}{item.keyword}{value}\r".encode("ascii")
    elif item.servo_id is not None:
        return f"*{item.servo_id}{item.keyword}{value}\r".encode("ascii")
    return _section(item) + b"\r"


@lru_cache(maxsize=1024)
def encode_query(query: Command) -> bytes:
    """Return the same bytes as `encode`, faster: the same few queries are sent all the time."""
    return encode(query)


def size_of(reply: Reply) -> int:
    """Return the size of `encode(reply)` in bytes, faster."""
    servo_id = "" if reply.servo_id is None else reply.servo_id
    value = "" if reply.value is None else reply.value
    return len(f"*{servo_id}{reply.keyword}{value}\r")


def encode_move(servo_id: int, position_wire: int, duration_ms: int | None) -> bytes:
    """Return the same bytes as `encode` for a `D` with or without `T`, faster, for the player."""
    if duration_ms is None:
        return b"#%dD%d\r" % (servo_id, position_wire)
    return b"#%dD%dT%d\r" % (servo_id, position_wire, duration_ms)


def encode_group(items: Sequence[Command] | Sequence[Reply]) -> bytes:
    """Return one line of many sections (firmware 370: FACTS.md W17).

    Adjacent queries to one servo share a section; a `0` separates their keywords.
    """
    return b"".join(_joined(list(run)) for _, run in groupby(items, _section_key)) + b"\r"


def encode_joined(replies: Sequence[Reply]) -> bytes:
    """Return the line in which a servo replies to a group, `*15QD960T400` (FACTS.md W18)."""
    first, *others = replies
    values = ("" if reply.value is None else reply.value for reply in others)
    tail = "".join(
        f"{reply.keyword.removeprefix('Q')}{value}"
        for reply, value in zip(others, values, strict=True)
    )
    return encode(first).removesuffix(b"\r") + tail.encode("ascii") + b"\r"


class _SectionParser:
    """The part that both parsers share: the incomplete last section, and the uncommon sections."""

    def __init__(self, *, grouped: bool = True) -> None:
        self._grouped = grouped
        self._rest = b""

    @property
    def has_unfinished(self) -> bool:
        """Whether bytes of a section are stored whose end has not come yet."""
        return bool(self._rest)

    def _section(
        self,
        data: bytes,
        match: re.Match[bytes],
        start: bytes,
        read: Callable[[bytes], list[ItemT]],
    ) -> list[ItemT | Garbage]:
        """Return the items of one piece of `data`; an incomplete last piece is stored."""
        piece, end = match.group(), match.end()
        if end == len(data) and not piece.endswith(b"\r"):
            self._rest = piece
            return []
        is_ended = piece.endswith(b"\r") or (self._grouped and data.startswith(start, end))
        found: list[ItemT] = read(piece) if is_ended else []
        items: list[ItemT | Garbage] = []
        if found and (self._grouped or len(found) == 1):
            items += found
        else:
            items.append(Garbage(piece))
        return items


class CommandParser(_SectionParser):
    """Bytes from a host → commands, in any chunks. Never raises; stores at most one section.

    `#` always starts a new section. With `grouped` (firmware 370) the section before it is read as
    well. Without (older firmware, 2IO), everything but one command before a CR is garbage.
    """

    def feed(self, chunk: bytes) -> list[Command | Garbage]:
        """Return the items that `chunk` completes, in order, however the bytes were cut."""
        data = self._rest + chunk
        self._rest = b""
        items: list[Command | Garbage] = []
        for match in _COMMAND_PIECE.finditer(data):
            if match[1] is not None:
                items.append(_common_command(*match.groups()))
                continue
            items.extend(self._section(data, match, b"#", _commands))
        return items


class ReplyParser(_SectionParser):
    """Bytes from the servos → replies, in any chunks. Never raises; stores at most one section.

    `*` always starts a new section, so noise does not hide the reply after it. With `grouped` the
    section before a `*` is read as well, and a section may hold several replies (FACTS.md W18).
    Pass False if no group was sent: replies that overlap then give garbage, not wrong numbers.
    """

    def feed(self, chunk: bytes) -> list[Reply | Garbage]:
        """Return the items that `chunk` completes, in order, however the bytes were cut."""
        data = self._rest + chunk
        self._rest = b""
        items: list[Reply | Garbage] = []
        for match in _REPLY_PIECE.finditer(data):
            servo_id, keyword, value = match.groups()
            if servo_id is not None:
                items.append(Reply(int(servo_id), str(keyword, "ascii"), int(value)))
                continue
            items.extend(self._section(data, match, b"*", _replies))
        return items


@lru_cache(maxsize=1024)
def commands_in(line: bytes, *, grouped: bool) -> tuple[Command, ...]:
    """Return the commands in one whole line, as a `CommandParser` reads them.

    The lines of queries are few, and come all the time, so they are kept.
    """
    match = _COMMAND_PIECE.fullmatch(line)
    if match is not None and match[1] is not None:
        return (_common_command(*match.groups()),)
    items = CommandParser(grouped=grouped).feed(line)
    return tuple(item for item in items if isinstance(item, Command))


# A piece ends before the next start byte, after a CR, or at `LINE_MAX_BYTES`. The first alternative
# of each pattern reads a common line at once, for speed. The others only cut the bytes into pieces.
_COMMAND_PIECE: Final = re.compile(
    rb"#([0-9]{1,5})([A-Za-z]{1,10})(-?[0-9]{1,11})?(?:[Tt]([0-9]{1,11}))?\r"
    rb"|#[^#\r]{0,%d}\r?|[^#\r]{1,%d}\r?|\r" % (LINE_MAX_BYTES - 2, LINE_MAX_BYTES - 1)
)
_REPLY_PIECE: Final = re.compile(
    rb"\*([0-9]{1,5})((?!%b)[A-Z]{1,10})(-?[0-9]{1,11})\r"
    rb"|\*[^*\r]{0,%d}\r?|[^*\r]{1,%d}\r?|\r"
    % ("|".join(TEXT_REPLIES).encode(), LINE_MAX_BYTES - 2, LINE_MAX_BYTES - 1)
)

_COMMAND_SECTION: Final = re.compile(rb"#([0-9]+)((?:[A-Z]+-?[0-9]+)*(?:[A-Z]+)?)\r?")
_COMMAND_PART: Final = re.compile(rb"([A-Z]+)(-?[0-9]+)?")
_COMMAND_TEXT: Final = re.compile(rb"#([0-9]+)%b([!-~]+)\r?" % TEXT_COMMAND.encode())

_REPLY_SECTION: Final = re.compile(rb"\*([0-9]*)([ -~]+)\r?")
_REPLY_TEXT: Final = re.compile(rb"(%b)([ -~]*)" % "|".join(TEXT_REPLIES).encode())
_REPLY_DISABLED: Final = re.compile(rb"(Q[A-Z]+)(%b)" % DISABLED.encode())
_REPLY_CHANNELS: Final = re.compile(rb"(QA)((?:,[0-9]+)+)")
_REPLY_PART: Final = re.compile(rb"([A-Z]+)(-?[0-9]+(?:\.[0-9]+)*)?")


def _common_command(
    servo_id: bytes, keyword: bytes, value: bytes | None, duration_ms: bytes | None
) -> Command:
    """Return the command of a common line, from what the first alternative has found."""
    return Command(
        int(servo_id),
        str(keyword, "ascii").upper(),
        None if value is None else int(value),
        () if duration_ms is None else (("T", int(duration_ms)),),
    )


def _commands(piece: bytes) -> list[Command]:
    """Return the commands of one section; none if the section is not valid."""
    piece = piece.upper()
    match = _COMMAND_SECTION.fullmatch(piece)
    if match is None:
        text = _COMMAND_TEXT.fullmatch(piece)
        return [] if text is None else [Command(int(text[1]), TEXT_COMMAND, text[2].decode())]
    servo_id = int(match[1])
    commands: list[Command] = []
    for letters, digits in _COMMAND_PART.findall(match[2]):
        keyword, value = letters.decode(), int(digits) if digits else None
        if not commands or keyword.startswith("Q"):
            commands.append(Command(servo_id, keyword, value))
        elif value is None:
            return []  # A modifier without its value changes the meaning of the whole command.
        else:
            last = commands[-1]
            modifiers = (*last.modifiers, (keyword, value))
            commands[-1] = Command(servo_id, last.keyword, last.value, modifiers)
    return commands


def _replies(piece: bytes) -> list[Reply]:
    """Return the replies of one section; none if the section is not valid."""
    section = _REPLY_SECTION.fullmatch(piece)
    if section is None:
        return []
    servo_id = int(section[1]) if section[1] else None
    body = section[2]
    replies: list[Reply] = []
    position = 0
    while position < len(body):
        match = (
            _REPLY_TEXT.match(body, position)
            or _REPLY_DISABLED.match(body, position)
            or _REPLY_CHANNELS.match(body, position)
            or _REPLY_PART.match(body, position)
        )
        if match is None:
            return []
        keyword = match[1].decode()
        if replies and not keyword.startswith("Q"):
            keyword = "Q" + keyword  # `*15QD960T400` is the reply to QD and QT (FACTS.md W18).
        replies.append(Reply(servo_id, keyword, _reply_value(keyword, match[2])))
        position = match.end()
    return replies


def _reply_value(keyword: str, value: bytes | None) -> int | str | None:
    if not value:
        return None
    is_text = keyword in TEXT_REPLIES or value == DISABLED.encode() or set(value) & set(b".,")
    return value.decode() if is_text else int(value)


def _section(item: Command | Reply) -> bytes:
    servo_id = "" if item.servo_id is None else item.servo_id
    start = "#" if isinstance(item, Command) else "*"
    return f"{start}{servo_id}{_body(item)}".encode("ascii")


def _body(item: Command | Reply) -> str:
    value = "" if item.value is None else item.value
    if isinstance(item, Reply) or not item.modifiers:
        return f"{item.keyword}{value}"
    return f"{item.keyword}{value}" + "".join(f"{name}{given}" for name, given in item.modifiers)


def _section_key(item: Command | Reply) -> tuple[int | None, bool]:
    """Return the key that adjacent queries, or their replies, share if they share a section."""
    return item.servo_id, item.keyword.startswith("Q")


def _joined(run: Sequence[Command | Reply]) -> bytes:
    if len(run) == 1 or not run[0].keyword.startswith("Q"):
        return b"".join(map(_section, run))
    first, *others = (
        Command(item.servo_id, item.keyword, 0, item.modifiers)
        if isinstance(item, Command) and item.value is None
        else item
        for item in run
    )
    return _section(first) + "".join(map(_body, others)).encode("ascii")
