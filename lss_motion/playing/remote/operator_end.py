"""What a process that moves servos knows of its client: operations in, events out, and its loss.

It never waits, and a client that floods it, or does not read, changes no move: a turn reads a
bounded number of bytes, and what finds no room is counted or dropped.
"""

from __future__ import annotations

import socket
from typing import TYPE_CHECKING, Final

from lss_motion.errors import InputError
from lss_motion.playing.remote import schema as m
from lss_motion.system.messages import Kind, PipeClosedError
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.system.messages import MessagePipe


TURN_MAX_BYTES: Final = 4096
"""So much is read in one turn of the player: a client that floods it costs no more time than
that (a few microseconds); the rest waits in the socket, and then in the client."""


class Operator:
    """The client at the other end of `link`, and the process that only stops behind `stops`.

    `is_orphan` returns whether the client's process has ended. The link does not show that where
    another process holds a copy of its end.
    """

    def __init__(
        self,
        link: MessagePipe,
        *,
        stops: MessagePipe | None = None,
        is_orphan: Callable[[], bool] = lambda: False,
    ) -> None:
        self.link = link
        self.is_cut = False
        """Whether the client is gone for good."""
        self._stops = stops
        self._is_orphan = is_orphan
        self._heard_ns: int | None = None
        self._is_flooded = False
        self._signals = 0
        self._lost_count = 0
        self._objects: list[bytes] = []

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait; no link that is flooded or closed."""
        links = [] if self.is_cut or self._is_flooded else [self.link]
        return [link.fileno() for link in (*links, self._stops) if link is not None]

    def new_stop_end(self) -> socket.socket | None:
        """Return the end of a pipe for stops, for a player that this process starts by itself.

        The process that only stops has the other end, so a stop needs no process between. None:
        there is none that only stops.
        """
        if self._stops is None:
            return None
        own, other = socket.socketpair()
        with other:
            self._stops.send_fileno(Kind.OBJECT, b"", other.fileno())
        return own

    def note_signal(self) -> None:
        """Note a signal to end."""
        self._signals += 1

    def take_signals(self) -> int:
        """Return how many signals came since the last call."""
        count, self._signals = self._signals, 0
        return count

    def take(self, now_ns: int) -> list[m.AnyOperation]:
        """Return the operations since the last call, stops first; refuse what is none."""
        return sorted(self._take_stops() + self._take(now_ns), key=_urgency)

    def take_objects(self) -> list[bytes]:
        """Return the pickled objects since the last call; the other end is our own program."""
        objects, self._objects = self._objects, []
        return objects

    def is_lost(self, now_ns: int, silent_s: float | None) -> bool:
        """Return whether the client is gone, or has sent nothing for `silent_s`."""
        self._heard_ns = now_ns if self._heard_ns is None else self._heard_ns
        is_silent = silent_s is not None and now_ns - self._heard_ns > ns_from_s(silent_s)
        return is_silent or self.is_cut

    def look_for_client(self) -> None:
        """Note if the process of the client has ended; a system call, so not on each turn."""
        self.is_cut = self.is_cut or self._is_orphan()

    def send(self, message: m.Message) -> None:
        """Send an event; count it if the client has not read for long, and tell it later."""
        if self._lost_count and not self.link.is_full:
            lost = m.Lost(count=self._lost_count)
            self._lost_count = 0
            self.link.send(Kind.EVENT, lost.to_json())
        if not self.link.send(Kind.EVENT, message.to_json()):
            self._lost_count += 1

    def offer(self, message: m.Message) -> None:
        """Send an event that is worthless later, if there is room."""
        self.link.offer(Kind.EVENT, message.to_json())

    def refuse(self, operation: m.Operation, why: str) -> None:
        """Answer an operation that has no effect."""
        self.send(m.Refused(id=operation.id, text=why))

    def accept(self, operation: m.AnyOperation) -> None:
        """Answer an operation that is carried out; what is repeated often gets no answer."""
        if not isinstance(operation, m.Beat | m.Follow | m.LeadJoints | m.SteerWalk):
            self.send(m.Accepted(id=operation.id, op=operation.op))

    def _take(self, now_ns: int) -> list[m.AnyOperation]:
        self._is_flooded = False
        if self.is_cut:
            return []
        try:
            arrived = self.link.receive(TURN_MAX_BYTES)
        except PipeClosedError:
            self.is_cut = True
            return []
        operations: list[m.AnyOperation] = []
        size = 0
        for kind, content in arrived:
            size += len(content)
            if kind is Kind.OBJECT:
                self._objects.append(content)
            if kind is not Kind.OPERATION:
                continue
            try:
                operations.append(m.parse_operation(content))
            except InputError as refused:
                self.send(m.Refused(id=0, text=str(refused)))
        if arrived:
            self._heard_ns = now_ns
            self._is_flooded = size > TURN_MAX_BYTES // 2
        return operations

    def _take_stops(self) -> list[m.AnyOperation]:
        """Return the stops that arrived on the link for them; it may be closed without harm."""
        if self._stops is None:
            return []
        try:
            arrived = self._stops.receive(TURN_MAX_BYTES)
        except PipeClosedError:
            self._stops = None
            return []
        found = [m.parse_operation(content) for kind, content in arrived if kind is Kind.OPERATION]
        return [operation for operation in found if isinstance(operation, m.Stop | m.Estop)]


def _urgency(operation: m.AnyOperation) -> int:
    """Return the place of an operation among those that arrived together."""
    return 0 if isinstance(operation, m.Estop) else 1 if isinstance(operation, m.Stop) else 2
