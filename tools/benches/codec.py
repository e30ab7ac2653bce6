"""How many lines a second can be encoded and parsed, next to what the fastest line carries."""

from __future__ import annotations

from benches.table import Row, interleaved
from lss_motion.protocol.framing import (
    Command,
    CommandParser,
    Reply,
    ReplyParser,
    encode,
    encode_move,
)

LINES = 20_000
REPEATS = 9
TARGET_PER_S = 200_000
LINE_BPS = 921_600
CHUNK_BYTES = 64
"""What a read of a busy port returns at a time."""


def measure() -> list[Row]:
    """Return lines a second for both directions."""
    commands = [Command(n % 40, "D", n % 3600 - 1800, (("T", 20 + n % 900),)) for n in range(LINES)]
    replies = [Reply(n % 40, "QD", n % 3600 - 1800) for n in range(LINES)]
    command_bytes = b"".join(map(encode, commands))
    reply_bytes = b"".join(map(encode, replies))

    def parse(parser: CommandParser | ReplyParser, data: bytes) -> None:
        count = sum(
            len(parser.feed(data[start : start + CHUNK_BYTES]))
            for start in range(0, len(data), CHUNK_BYTES)
        )
        assert count == LINES

    calls = {
        "encode a command": lambda: [encode(command) for command in commands],
        "encode a move (the player's way)": lambda: [
            encode_move(n % 40, n % 3600 - 1800, 20 + n % 900) for n in range(LINES)
        ],
        "parse commands": lambda: parse(CommandParser(), command_bytes),
        "parse replies": lambda: parse(ReplyParser(grouped=False), reply_bytes),
    }
    line_per_s = LINE_BPS / 10 / (len(reply_bytes) / LINES)
    rows = []
    for what, taken_s in zip(calls, interleaved(*calls.values(), repeats=REPEATS), strict=True):
        per_s = LINES / taken_s
        rows.append(
            Row(
                what=what,
                ours=f"{per_s:,.0f} lines/s",
                reference=f"{line_per_s:,.0f} lines/s on a {LINE_BPS} bps line",
                ratio=per_s / line_per_s,
                target=f">= {TARGET_PER_S:,} lines/s",
                is_met=per_s >= TARGET_PER_S,
            )
        )
    return rows
