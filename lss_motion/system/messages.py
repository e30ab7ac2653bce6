"""A pipe of messages between two processes of this package, for an end that must never wait.

A message is one byte with its kind, four bytes with its length (little-endian), and its content.
What the socket does not take at once is kept, up to a bound. `MessagePipe` moves whole messages;
`TypedPipe` moves values: the `Struct`s of one tagged union each way.
"""

from __future__ import annotations

import contextlib
import pickle
import socket
import struct
from collections import deque
from enum import Enum
from typing import Any, Final, Generic, TypeVar

import msgspec

_HEAD: Final = struct.Struct("<cI")
READ_BYTES: Final = 65536
OUTBOX_MAX_BYTES: Final = 1 << 20
"""Messages for an end that does not read. Chosen: some thousand events, more than a show has."""
MESSAGE_MAX_BYTES: Final = 1 << 28
"""A longer message is no message of ours. A program of hours has some megabytes."""
FILENOS_MAX: Final = 8
"""File numbers that may arrive with one read; they are sent one by one."""


class Kind(bytes, Enum):
    """What a message holds."""

    OPERATION = b"o"
    EVENT = b"e"
    TELEMETRY = b"t"
    MESSAGE = b"m"
    """A `Struct` of a tagged union, as MessagePack: numbers stay exact, and may be infinite."""
    DATA = b"d"
    """Bytes as they are."""
    OBJECT = b"p"
    """A Python object, pickled: a job for a process, and its result. Only ever between this program
    and a process that it has started itself."""


class PipeClosedError(Exception):
    """The other end is closed, or sends what is no message."""


class MessagePipe:
    """One end. `send` and `receive` never wait, unless the socket is blocking."""

    def __init__(
        self,
        end: socket.socket,
        *,
        outbox_max_bytes: int = OUTBOX_MAX_BYTES,
    ) -> None:
        self._socket = end
        self._inbox = bytearray()
        self._outbox = bytearray()
        self._outbox_max_bytes = outbox_max_bytes
        self.receives_filenos = False
        """Whether file numbers may arrive; reading takes longer then."""
        self.filenos: deque[int] = deque()
        """File numbers that arrived with messages (`send_fileno`), oldest first."""
        self.dropped = 0
        """Messages that found no room."""
        self.is_closed = False
        """Whether nothing can be sent any more: the other end is gone."""
        self._is_read = False
        """Whether the other end sends nothing more."""

    def fileno(self) -> int:
        return self._socket.fileno()

    def set_blocking(self, *, is_blocking: bool, timeout_s: float | None = None) -> None:
        """Let `send` and `receive` wait, at most for `timeout_s`, or not."""
        self._socket.settimeout(timeout_s if is_blocking else 0.0)

    @property
    def is_full(self) -> bool:
        """Whether bytes are kept that the socket did not take."""
        return bool(self._outbox)

    def send(self, kind: Kind, content: bytes, *, is_last: bool = False) -> bool:
        """Send a message that must arrive; return False if too much is kept already.

        The last message is kept whatever is kept already.
        """
        self.flush()
        if self.is_closed:
            return False
        if len(self._outbox) > self._outbox_max_bytes and not is_last:
            self.dropped += 1
            return False
        self._outbox += _HEAD.pack(kind.value, len(content)) + content
        self.flush()
        return not self.is_closed

    def offer(self, kind: Kind, content: bytes) -> bool:
        """Send a message that is worthless later; return False if it was dropped instead."""
        self.flush()
        if self.is_closed or self._outbox:
            return False
        return self.send(kind, content)

    def send_fileno(self, kind: Kind, content: bytes, fileno: int) -> bool:
        """Send a message and a file number with it, which the other end finds in `filenos`.

        Returns False if the socket does not take both now.
        """
        self.flush()
        if self.is_closed or self._outbox:
            return False
        data = _HEAD.pack(kind.value, len(content)) + content
        try:
            sent = socket.send_fds(self._socket, [data], [fileno])
        except OSError:
            return False
        self._outbox += data[sent:]
        return True

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

        Raises `PipeClosedError` when the other end is closed and all it sent was returned.
        """
        data = None
        with contextlib.suppress(BlockingIOError, InterruptedError):
            try:
                data = self._read(limit_bytes)
            except ConnectionError:
                data = b""
        if data is not None:
            self._inbox += data
            self._is_read = self._is_read or not data
        messages = self._take()
        if self._is_read and not messages:
            raise PipeClosedError("the other end is closed")
        return messages

    def receive_fileno(self) -> int | None:
        """Wait for the next message, which has no content, and return its file number.

        None: the other end is closed.
        """
        self.receives_filenos = True
        with contextlib.suppress(PipeClosedError):
            self.receive(_HEAD.size)
        self.receives_filenos = False
        return self.filenos.popleft() if self.filenos else None

    def _read(self, limit_bytes: int) -> bytes:
        if not self.receives_filenos:
            return self._socket.recv(limit_bytes)
        data, filenos, _, _ = socket.recv_fds(self._socket, limit_bytes, FILENOS_MAX)
        self.filenos += filenos
        return data

    def _take(self) -> list[tuple[Kind, bytes]]:
        """Return the whole messages of the inbox."""
        messages, start = [], 0
        while len(self._inbox) >= start + _HEAD.size:
            kind, size = _HEAD.unpack_from(self._inbox, start)
            if size > MESSAGE_MAX_BYTES:
                raise PipeClosedError(f"a message of {size} bytes")
            end = start + _HEAD.size + size
            if len(self._inbox) < end:
                break
            try:
                messages.append((Kind(kind), bytes(self._inbox[start + _HEAD.size : end])))
            except ValueError:
                raise PipeClosedError(f"a message of the unknown kind {kind!r}") from None
            start = end
        del self._inbox[:start]
        return messages

    def finish(self) -> None:
        """Tell the other end that nothing more comes; what it sends can still be received."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)

    def shut(self) -> None:
        """End both directions, also for a thread that waits in `receive`."""
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close this end."""
        self.is_closed = True
        self._socket.close()


Received = TypeVar("Received")


def plain(value: Any) -> Any:  # noqa: ANN401
    """Return a number of numpy as one of Python, and what is no JSON as a text."""
    return value.item() if hasattr(value, "item") else str(value)


_ENCODER: Final = msgspec.msgpack.Encoder(enc_hook=plain)


class TypedPipe(Generic[Received]):
    """A pipe on which the other end sends values of one type. Nothing raises.

    `receives` is that type: a tagged union of `Struct`s. Objects and bytes arrive as they were sent
    and need no `receives`.
    """

    def __init__(self, pipe: MessagePipe, receives: Any = None) -> None:  # noqa: ANN401  (a union)
        self.pipe = pipe
        self.has_ended = False
        """Whether the other end is gone, and all that it sent was returned."""
        self._decoder = msgspec.msgpack.Decoder(receives)

    def fileno(self) -> int:
        return self.pipe.fileno()

    def send(self, message: msgspec.Struct) -> bool:
        """Send what must arrive; return False if too much waits already, or the end is gone."""
        return self.pipe.send(Kind.MESSAGE, _ENCODER.encode(message))

    def offer(self, message: msgspec.Struct) -> bool:
        """Send what is worthless later; return False if nothing was sent."""
        return self.pipe.offer(Kind.MESSAGE, _ENCODER.encode(message))

    def send_data(self, data: bytes, *, is_last: bool = False) -> bool:
        """Send bytes that must arrive; see `MessagePipe.send`."""
        return self.pipe.send(Kind.DATA, data, is_last=is_last)

    def send_object(self, value: object) -> bool:
        """Send any value that can be pickled, which must arrive."""
        return self.pipe.send(Kind.OBJECT, pickle.dumps(value))

    def send_fileno(self, message: msgspec.Struct, fileno: int) -> bool:
        """Send a message and a file number with it; see `MessagePipe.send_fileno`."""
        return self.pipe.send_fileno(Kind.MESSAGE, _ENCODER.encode(message), fileno)

    def receive(self) -> list[Received]:
        """Return what has arrived, oldest first; what cannot be decoded is dropped."""
        if self.has_ended:
            return []
        try:
            arrived = self.pipe.receive()
        except (PipeClosedError, OSError):
            self.has_ended = True
            return []
        values = []
        for kind, content in arrived:
            with contextlib.suppress(msgspec.MsgspecError):
                values.append(self._value(kind, content))
        return values

    def _value(self, kind: Kind, content: bytes) -> Any:  # noqa: ANN401
        if kind is Kind.OBJECT:
            return pickle.loads(content)  # noqa: S301  (from a process of this program)
        return content if kind is Kind.DATA else self._decoder.decode(content)

    def close(self) -> None:
        """Close this end."""
        self.has_ended = True
        self.pipe.close()
