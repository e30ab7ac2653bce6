"""Messages over a stream socket, for an end that must never wait.

A message is one byte with its kind, four bytes with its length (little-endian), and its content.
What the socket does not take at once is kept. Telemetry is sent only if nothing is kept, so a
client that does not read gets the newest state later, not a queue of old ones.
"""

from __future__ import annotations

import contextlib
import struct
from enum import Enum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    import socket

_HEAD: Final = struct.Struct("<cI")
READ_BYTES: Final = 65536
OUTBOX_MAX_BYTES: Final = 1 << 20
"""Events for a client that does not read. Chosen: some thousand of them, more than a show has."""
MESSAGE_MAX_BYTES: Final = 1 << 28
"""A longer message is no message of ours. A program of hours has some megabytes."""
TURN_MAX_BYTES: Final = 4096
"""So much is read in one turn of the player: a client that floods it costs no more time than
that (a few microseconds); the rest waits in the socket, and then in the client."""


class Kind(bytes, Enum):
    """What a message holds."""

    OPERATION = b"o"
    EVENT = b"e"
    TELEMETRY = b"t"
    OBJECT = b"p"
    """A Python object, pickled: a job for the player process, and its result. Only ever between
    this program and the process that it has started itself."""


class BrokenLinkError(Exception):
    """The other end is closed, or sends what is no message."""


class Link:
    """One end. `send` and `receive` never wait, unless the socket is blocking."""

    def __init__(self, end: socket.socket) -> None:
        self._socket = end
        self._inbox = bytearray()
        self._outbox = bytearray()
        self.dropped = 0
        """Messages that found no room."""
        self.is_closed = False
        """Whether the other end is gone."""

    def fileno(self) -> int:
        return self._socket.fileno()

    def set_blocking(self, *, is_blocking: bool, timeout_s: float | None = None) -> None:
        """Let `send` and `receive` wait, at most for `timeout_s`, or not."""
        self._socket.settimeout(timeout_s if is_blocking else 0.0)

    @property
    def is_full(self) -> bool:
        """Whether bytes are kept that the socket did not take."""
        return bool(self._outbox)

    def send(self, kind: Kind, content: bytes) -> bool:
        """Send a message that must arrive; return False if too much is kept already."""
        if self.is_closed:
            return False
        if len(self._outbox) > OUTBOX_MAX_BYTES:
            self.dropped += 1
            return False
        self._outbox += _HEAD.pack(kind.value, len(content)) + content
        self.flush()
        return True

    def offer(self, kind: Kind, content: bytes) -> bool:
        """Send a message that is worthless later; return False if it was dropped instead."""
        if self.is_closed or self._outbox:
            return False
        return self.send(kind, content)

    def flush(self) -> None:
        """Give the socket what it takes."""
        if not self._outbox or self.is_closed:
            return
        try:
            del self._outbox[: self._socket.send(self._outbox)]
        except BlockingIOError:
            pass
        except OSError:
            self.is_closed = True
            self._outbox.clear()

    def receive(self, limit_bytes: int = READ_BYTES) -> list[tuple[Kind, bytes]]:
        """Return the messages that have arrived, from at most `limit_bytes` more bytes.

        Raises `BrokenLinkError` when the other end is closed and all it sent was returned.
        """
        data = None
        with contextlib.suppress(BlockingIOError, InterruptedError):
            try:
                data = self._socket.recv(limit_bytes)
            except ConnectionError:
                data = b""
        if data is not None:
            self._inbox += data
            self.is_closed = self.is_closed or not data
        messages = self._take()
        if self.is_closed and not messages:
            raise BrokenLinkError("the other end is closed")
        return messages

    def _take(self) -> list[tuple[Kind, bytes]]:
        """Return the whole messages of the inbox."""
        messages, start = [], 0
        while len(self._inbox) >= start + _HEAD.size:
            kind, size = _HEAD.unpack_from(self._inbox, start)
            if size > MESSAGE_MAX_BYTES:
                raise BrokenLinkError(f"a message of {size} bytes")
            end = start + _HEAD.size + size
            if len(self._inbox) < end:
                break
            try:
                messages.append((Kind(kind), bytes(self._inbox[start + _HEAD.size : end])))
            except ValueError:
                raise BrokenLinkError(f"a message of the unknown kind {kind!r}") from None
            start = end
        del self._inbox[:start]
        return messages

    def close(self) -> None:
        """Close this end."""
        self.is_closed = True
        self._socket.close()
