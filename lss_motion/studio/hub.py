"""The clients of the server, which of them operates, and the one order of what they ask.

Operations are obeyed in the order in which they are received, in one thread. Every client may stop;
everything else needs a role and the lease, which one client has. A free lease goes to the first
that operates. Edits of files need the role alone: their revisions keep two clients apart. `Hub`
knows no socket and no clock: time is an argument.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Final, Protocol

from lss_motion.errors import InputError, LssMotionError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.edit_messages import EditOperation
from lss_motion.studio.access import Role
from lss_motion.studio.client import TELEMETRY, Client

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

OPERATOR_SILENT_S: Final = 5.0
"""An operator that sends nothing for so long is lost: a page sends `beat` once a second."""
OPERATOR_GRACE_S: Final = 3.0
"""An operator that is gone may come back within this time: a page that is loaded again does."""
CLIENTS_MAX: Final = {Role.VIEW: 32, Role.OPERATE: 16, Role.EDIT: 16}
"""More of a role are refused; no role takes a place of another. Chosen: a class of students that
look, and a few persons at the robot, each with some pages."""
EDITS: Final = (m.PoseSave, m.Pair, EditOperation)
"""Operations that need the role `edit`."""
ALWAYS: Final = (m.Stop, m.Estop, m.Beat)
"""Operations that need no lease and no role."""


class OperationDesk(Protocol):
    """Carries operations out."""

    def stop(self, *, is_emergency: bool) -> None:
        """Stop whatever moves, and stay stopped until `rearm`."""

    def obey(self, operation: m.AnyOperation, key: int) -> bool:
        """Carry an operation out; return whether it is answered now.

        If not, the answer comes later through `Hub.answer` with this `key`. Raises `LssMotionError`
        with the reason for what is refused.
        """

    def state(self) -> Iterable[str]:
        """Return the events that tell a new client the state of everything, as JSON."""

    def operator_lost(self) -> None:
        """Do what the rule says about an operator that is gone."""


class Hub:
    """All clients of one server."""

    def __init__(self, make_welcome: Callable[[Client], m.Welcome]) -> None:
        self.desk: OperationDesk | None = None
        self.on_telemetry: Callable[[bytes], None] = lambda _: None
        self.telemetry: bytes | None = None
        """The newest, for a client that comes later: where the robot stands when a show is over."""
        self.clients: dict[int, Client] = {}
        self._make_welcome = make_welcome
        self._next_client = self._next_key = 1
        self._holder: int | None = None
        self._heard_s: dict[int, float] = {}
        self._lost_s: float | None = None
        """When the lease lost its holder without being given back."""
        self._is_operated = False
        """Whether there is an operator that can be lost."""
        self._waiting: dict[int, tuple[int, int, str]] = {}
        """Operations that are answered later: key → client, its id, the name."""
        self._askers: dict[int, Callable[[str | None], None]] = {}
        """What is called with the answer to an operation that is no client's."""

    # ---- clients

    def join(self, role: Role, name: str, now_s: float, place: int = 0) -> Client | None:
        """Add a client and tell it the state; None: its role has too many."""
        if sum(one.role is role for one in self.clients.values()) >= CLIENTS_MAX[role]:
            return None
        client = Client(self._next_client, role, name, place)
        self._next_client += 1
        self.clients[client.number] = client
        self._heard_s[client.number] = now_s
        client.send(self._make_welcome(client).to_json().decode())
        client.send(self._lease_for(client).to_json().decode())
        if self.desk is not None:
            for text in self.desk.state():
                client.send(text)
        if self.telemetry is not None:
            client.offer(TELEMETRY, self.telemetry)
        self.broadcast(self._links())
        return client

    def leave(self, client: Client, now_s: float) -> None:
        """Remove a client; the lease it held is free. Once is the same as twice."""
        if self.clients.pop(client.number, None) is None:
            return
        self._heard_s.pop(client.number, None)
        if self._holder == client.number:
            self._lost_s = now_s
            self._give_lease(None)
        self.broadcast(self._links())

    def broadcast(self, message: m.Message) -> None:
        """Send an event to every client."""
        self.broadcast_text(message.to_json().decode())

    def broadcast_text(self, text: str) -> None:
        """Send the JSON text of an event to every client."""
        for client in self.clients.values():
            client.send(text)

    def offer(self, kind: str, content: str | bytes) -> None:
        """Give every client a value of which only the newest counts."""
        for client in self.clients.values():
            client.offer(kind, content)

    def offer_telemetry(self, frame: bytes) -> None:
        """Give every client the newest telemetry."""
        self.telemetry = frame
        self.on_telemetry(frame)
        self.offer(TELEMETRY, frame)

    def beat(self, now_s: float) -> None:
        """Tell the clients that the server is alive; look whether its operator is."""
        self.offer("heartbeat", m.Heartbeat(server_s=round(now_s, 3)).to_json().decode())
        heard_s = None if self._holder is None else self._heard_s.get(self._holder)
        if heard_s is not None and now_s - heard_s > OPERATOR_SILENT_S:
            self._lost_s = now_s - OPERATOR_GRACE_S
            self._give_lease(None)
        is_lost = self._lost_s is not None and now_s - self._lost_s >= OPERATOR_GRACE_S
        if is_lost and self._is_operated:
            self._is_operated, self._lost_s = False, None
            if self.desk is not None:
                self.desk.operator_lost()

    # ---- operations

    def receive(self, client: Client, text: str | bytes, now_s: float) -> None:
        """Obey the operation of a client; answer it, now or later."""
        self._heard_s[client.number] = now_s
        try:
            operation = m.parse_operation(text, _most_bytes(client))
        except InputError as refused:
            self._refuse(client, _id_of(text, _most_bytes(client)), str(refused))
            return
        if isinstance(operation, m.Beat):
            return
        key, self._next_key = self._next_key, self._next_key + 1
        self._waiting[key] = (client.number, operation.id, operation.op)
        try:
            is_done = self._obey(client, operation, key)
        except LssMotionError as refused:
            self.answer(key, str(refused))
            return
        if is_done:
            self.answer(key)

    def ask(self, operation: m.AnyOperation, on_answer: Callable[[str | None], None]) -> None:
        """Obey an operation of another program; it needs no lease.

        `on_answer` is called with the reason if it is refused, now or later.
        """
        assert self.desk is not None
        if isinstance(operation, m.Stop | m.Estop):
            self.desk.stop(is_emergency=isinstance(operation, m.Estop))
            on_answer(None)
            return
        key, self._next_key = self._next_key, self._next_key + 1
        self._waiting[key] = (0, 0, operation.op)
        self._askers[key] = on_answer
        try:
            is_done = self.desk.obey(operation, key)
        except LssMotionError as refused:
            self.answer(key, str(refused))
            return
        if is_done:
            self.answer(key)

    def answer(self, key: int, refusal: str | None = None) -> None:
        """Answer an operation: it is accepted, or refused for this reason."""
        if (on_answer := self._askers.pop(key, None)) is not None:
            self._waiting.pop(key, None)
            on_answer(refusal)
            return
        number, id_, op = self._waiting.pop(key, (0, 0, ""))
        client = self.clients.get(number)
        if client is None:
            return
        if refusal is not None:
            self._refuse(client, id_, refusal)
        else:
            client.send(m.Accepted(id=id_, op=op).to_json().decode())

    def tell(self, key: int, message: m.Message) -> None:
        """Send an event to the client of an operation, before its answer."""
        client = self.clients.get(self._waiting.get(key, (0, 0, ""))[0])
        if client is not None:
            client.send(message.to_json().decode())

    def id_of(self, key: int) -> int:
        """Return the `id` that the client of an operation gave it."""
        return self._waiting.get(key, (0, 0, ""))[1]

    def unanswered(self) -> Iterator[int]:
        """Yield the keys of operations without an answer."""
        yield from list(self._waiting)

    def _obey(self, client: Client, operation: m.AnyOperation, key: int) -> bool:
        assert self.desk is not None
        if isinstance(operation, m.Stop | m.Estop):
            self.desk.stop(is_emergency=isinstance(operation, m.Estop))
            return True
        needed = Role.EDIT if isinstance(operation, EDITS) else Role.OPERATE
        if client.role < needed:
            raise InputError(f"{operation.op} needs the role {needed.word}; you may look, and stop")
        if isinstance(operation, m.Lease):
            self._lease(client, operation)
            return True
        if isinstance(operation, EditOperation):
            return self.desk.obey(operation, key)
        if self._holder is None:
            self._give_lease(client.number)
        if self._holder != client.number:
            raise InputError(f"{self._holder_name()} operates; take over first, or stop")
        return self.desk.obey(operation, key)

    def _refuse(self, client: Client, id_: int, text: str) -> None:
        client.send(m.Refused(id=id_, text=text).to_json().decode())

    # ---- the lease

    def _lease(self, client: Client, operation: m.Lease) -> None:
        if operation.want == "take":
            self._give_lease(client.number)
        elif self._holder == client.number:
            self._is_operated = False  # Given back on purpose: this operator is not lost.
            self._give_lease(None)

    def _give_lease(self, number: int | None) -> None:
        if number == self._holder:
            return
        self._holder = number
        if number is not None:
            self._is_operated, self._lost_s = True, None
        for client in self.clients.values():
            client.send(self._lease_for(client).to_json().decode())

    def _lease_for(self, client: Client) -> m.LeaseChanged:
        holder = self._holder
        return m.LeaseChanged(
            holder=holder,
            holder_name=None if holder is None else self._holder_name(),
            is_mine=holder == client.number,
        )

    def _holder_name(self) -> str:
        client = None if self._holder is None else self.clients.get(self._holder)
        return "another client" if client is None else client.name

    def _links(self) -> m.Links:
        return m.Links(clients=len(self.clients))


def _most_bytes(client: Client) -> int:
    """Return how long an operation of a client may be."""
    return m.EDIT_MAX_BYTES if client.role >= Role.EDIT else m.OPERATION_MAX_BYTES


def _id_of(text: str | bytes, most_bytes: int) -> int:
    """Return the `id` of what is no operation, so that its sender knows what was refused."""
    if len(text) > most_bytes:
        return 0
    try:
        value = json.loads(text)
    except (ValueError, RecursionError):
        return 0
    found = value.get("id") if isinstance(value, dict) else None
    return found if type(found) is int and found >= 0 else 0
