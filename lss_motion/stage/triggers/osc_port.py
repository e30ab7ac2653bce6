"""The OSC port: receives triggers and operations, sends state and angles to those who subscribe.

`/lss/state` is answered to its sender. `/lss/subscribe [PORT] [HZ]` lets the sender get
`/lss/joint/NAME`, `/lss/state` and `/lss/event` for a minute; it repeats that while it wants more.
Nothing is ever sent to another address than that of the sender, or those of the stage file.
"""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final, cast

from lss_motion.stage.triggers import osc

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping
    from collections.abc import Set as AbstractSet

    from lss_motion.stage.triggers.sources import Crossings, Gate, Sink

SUBSCRIBED_S: Final = 60.0
SUBSCRIBERS_MAX: Final = 8
"""Chosen: a desk, a tablet, and some to spare; each gets every angle some times a second."""
RATE_HZ: Final = 10.0
RATE_MAX_HZ: Final = 40.0
"""As often as the player reports angles."""
PENDING_MAX: Final = 256
"""Messages that wait for their time."""
PORT_MAX: Final = 65535

Place = tuple[str, int]


@dataclass(slots=True)
class _Subscriber:
    until_s: float | None
    """None: for ever, as the stage file has it."""
    period_s: float
    next_s: float = 0.0


class Subscribers:
    """Who gets feedback, how often, and until when. Knows no clock and no socket."""

    def __init__(self, always: Iterable[Place] = ()) -> None:
        self._all = {place: _Subscriber(None, 1.0 / RATE_HZ) for place in always}

    def add(self, place: Place, rate_hz: float, now_s: float) -> bool:
        """Add or renew one; return False if there are too many."""
        self._drop(now_s)
        if place not in self._all and len(self._all) >= SUBSCRIBERS_MAX:
            return False
        old = self._all.get(place)
        is_kept = old is not None and old.until_s is None
        until_s = None if is_kept else now_s + SUBSCRIBED_S
        self._all[place] = _Subscriber(until_s, 1.0 / min(max(rate_hz, 0.1), RATE_MAX_HZ))
        return True

    def remove(self, place: Place) -> None:
        """Remove one, if it is not of the stage file."""
        if (own := self._all.get(place)) is not None and own.until_s is not None:
            del self._all[place]

    def all(self, now_s: float) -> list[Place]:
        """Return everyone."""
        self._drop(now_s)
        return list(self._all)

    def due(self, now_s: float) -> list[Place]:
        """Return whose next angles are due, and note that they get them."""
        self._drop(now_s)
        found = [place for place, one in self._all.items() if now_s >= one.next_s]
        for place in found:
            one = self._all[place]
            one.next_s = max(one.next_s + one.period_s, now_s + one.period_s / 2)
        return found

    def _drop(self, now_s: float) -> None:
        for place, one in list(self._all.items()):
            if one.until_s is not None and now_s > one.until_s:
                del self._all[place]


class OscPort(asyncio.DatagramProtocol):
    """One UDP port. `sink` takes operations; `state` returns what `/lss/state` answers."""

    def __init__(
        self,
        gate: Gate,
        sink: Sink,
        *,
        cues: AbstractSet[str] = frozenset(),
        levels: Crossings | None = None,
        state: Callable[[], Mapping[str, float | str]] = dict,
        always: Iterable[Place] = (),
    ) -> None:
        self.gate = gate
        self.cues, self.levels = cues, levels
        """What the stage file has now: addresses of cues, and thresholds of some."""
        self._sink, self._state = sink, state
        self._subscribers = Subscribers(always)
        self._transport: asyncio.DatagramTransport | None = None
        self._pending: set[asyncio.TimerHandle] = set()

    async def open(self, place: Place) -> None:
        """Open the port; raises `OSError`."""
        loop = asyncio.get_running_loop()
        await loop.create_datagram_endpoint(lambda: self, local_addr=place)

    @property
    def place(self) -> Place:
        """Address and port where it listens."""
        assert self._transport is not None
        host, port = self._transport.get_extra_info("sockname")[:2]
        return str(host), int(port)

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Keep the socket."""
        self._transport = cast("asyncio.DatagramTransport", transport)

    def error_received(self, exc: Exception) -> None:
        """Ignore what the system tells of a receiver that is not there."""

    def close(self) -> None:
        """Close the port, and forget what waits for its time."""
        for timer in self._pending:
            timer.cancel()
        self._pending.clear()
        if self._transport is not None:
            self._transport.close()

    # ---- receiving

    def datagram_received(self, data: bytes, addr: tuple[Any, ...]) -> None:
        """Carry out what a packet asks for, now or at its time."""
        now_s, place = self._now_s(), (str(addr[0]), int(addr[1]))
        if not self.gate.admits(place[0], now_s):
            return
        try:
            messages = osc.messages_of(data)
        except osc.OscError as error:
            self.gate.complaints.add(f"{error} (from {place[0]})", now_s)
            return
        for message in messages:
            self._take(message, place, now_s)

    def _take(self, message: osc.Message, place: Place, now_s: float) -> None:
        try:
            wait_s = osc.delay_s(message, datetime.now(UTC).timestamp())
        except osc.OscError as error:
            self.gate.complaints.add(f"{error} (from {place[0]})", now_s)
            return
        if not wait_s:
            self._obey(message, place)
            return
        if len(self._pending) >= PENDING_MAX:
            text = f"more than {PENDING_MAX} messages for later are ignored (from {place[0]})"
            self.gate.complaints.add(text, now_s)
            return

        def obey() -> None:
            self._pending.discard(timer)
            self._obey(message, place)

        timer = asyncio.get_running_loop().call_later(wait_s, obey)
        self._pending.add(timer)

    def _obey(self, message: osc.Message, place: Place) -> None:
        if message.address not in self.cues and self._is_query(message, place):
            return
        try:
            operation = osc.operation_of(message, self.cues, self.levels)
        except osc.OscError as error:
            self.gate.complaints.add(f"{error} (from {place[0]})", self._now_s())
            return
        if operation is not None:
            self._sink(operation, f"OSC {osc.shown(message.address)} from {place[0]}")

    def _is_query(self, message: osc.Message, place: Place) -> bool:
        """Answer a message that only asks; return whether it was one."""
        numbers = [one for one in message.arguments if isinstance(one, int | float)]
        port = int(numbers[0]) if numbers and 0 < numbers[0] <= PORT_MAX else place[1]
        to = (place[0], port)
        match message.address:
            case "/lss/state":
                self.send_state([to])
            case "/lss/subscribe":
                rate_hz = float(numbers[1]) if len(numbers) > 1 else RATE_HZ
                if self._subscribers.add(to, rate_hz, self._now_s()):
                    self.send_state([to])
                else:
                    text = f"more than {SUBSCRIBERS_MAX} subscribers: {to[0]} gets nothing"
                    self.gate.complaints.add(text, self._now_s())
            case "/lss/unsubscribe":
                self._subscribers.remove(to)
            case _:
                return False
        return True

    # ---- sending

    def send_state(self, places: Iterable[Place] | None = None) -> None:
        """Send the state to these, or to all who subscribe."""
        packets = [osc.packet_of(f"/lss/{name}", [value]) for name, value in self._state().items()]
        self._send(packets, self._subscribers.all(self._now_s()) if places is None else places)

    def send_event(self, kind: str, text: str) -> None:
        """Send what happened to all who subscribe."""
        packet = osc.packet_of("/lss/event", [kind, text])
        self._send([packet], self._subscribers.all(self._now_s()))

    def send_joints(self, deg: Mapping[str, float]) -> None:
        """Send the angles to those whose next ones are due."""
        if places := self._subscribers.due(self._now_s()):
            packets = [osc.packet_of(f"/lss/joint/{name}", [at]) for name, at in deg.items()]
            self._send(packets, places)

    def _send(self, packets: list[bytes], places: Iterable[Place]) -> None:
        """Send messages; one alone without a bundle, which simple receivers do not read."""
        assert self._transport is not None
        whole = packets if len(packets) == 1 else osc.bundle_of(packets)
        for place in places:
            for packet in whole:
                with contextlib.suppress(OSError):  # No route to it now.
                    self._transport.sendto(packet, place)

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()
