"""One computer's session with the others: zenoh, and nothing else of this package imports it.

zenoh has threads. They put what arrives into a queue (`Peer.take`), with the instant at which it
arrived; a question about the clock is answered by the thread itself. Nothing here waits for the
network: what finds no room is dropped, since every message is repeated.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct

from lss_motion.errors import BusError, InputError, install_command
from lss_motion.stage.hosts.messages import (
    MESSAGE_MAX_BYTES,
    ClockAnswer,
    ClockQuestion,
    hash_of,
    packed,
    parse,
)
from lss_motion.stage.hosts.plans import PLAN_MAX_BYTES
from lss_motion.stage.hosts.settings import check_settings, json_of
from lss_motion.system.closing import Closing

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.stage.hosts.settings import NetworkSettings

INBOX_MAX: Final = 2000
"""Messages that were not taken yet; newer ones are dropped. Chosen: 200 figures for two seconds."""
FETCH_S: Final = 20.0
"""An answer may take so long: 64 MB over a slow Wi-Fi."""

What = Literal["message", "alive", "gone", "content", "no content"]


class Arrival(Struct, frozen=True):
    """What arrived: below the name of the stage, at this instant of the own clock."""

    what: What
    key: str
    content: bytes
    at_ns: int


class Peer(Closing):
    """An open session. `clock_id` is the process whose clock is told to those who ask."""

    def __init__(
        self,
        settings: NetworkSettings,
        *,
        clock_id: str = "",
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open the session; raises `InputError` for settings, `BusError` where it fails."""
        check_settings(settings)
        try:
            import zenoh
        except ModuleNotFoundError:
            raise InputError(
                f"shows on several computers need a package: {install_command('network')}"
            ) from None
        self._zenoh = zenoh
        self._now_ns = now_ns
        self._top = settings.stage
        self._clock_id = clock_id
        self._inbox: queue.Queue[Arrival] = queue.Queue(INBOX_MAX)
        self._fetching: set[str] = set()
        self._kept: list[Any] = []
        self.dropped = 0
        """Messages that found no room in the inbox."""
        self.sent_bytes = self.received_bytes = 0
        try:
            self._session = zenoh.open(zenoh.Config.from_json5(json_of(settings)))
        except Exception as error:  # noqa: BLE001  (zenoh raises its own, and panics)
            raise BusError(f"the network of stage {settings.stage!r}: {error}") from None

    # ---- what arrives

    def take(self, timeout_s: float) -> list[Arrival]:
        """Return what has arrived; wait for it, at most so long."""
        found: list[Arrival] = []
        with contextlib.suppress(queue.Empty):
            found.append(self._inbox.get(timeout=timeout_s))
            while True:
                found.append(self._inbox.get_nowait())
        return found

    def subscribe(self, key: str) -> None:
        """Receive messages with this key; `*` stands for a name."""
        handler = self._session.declare_subscriber(f"{self._top}/{key}", self._message)
        self._kept.append(handler)

    def watch(self, key: str) -> None:
        """Receive `alive` and `gone` of the tokens with this key."""
        handler = self._session.liveliness().declare_subscriber(
            f"{self._top}/{key}", self._token, history=True
        )
        self._kept.append(handler)

    def announce(self, key: str) -> None:
        """Let others know that this process lives."""
        self._kept.append(self._session.liveliness().declare_token(f"{self._top}/{key}"))

    def answer_clock(self) -> None:
        """Answer questions about the clock, at once and in zenoh's thread."""
        handler = self._session.declare_subscriber(f"{self._top}/figure/*/clock", self._clock)
        self._kept.append(handler)

    def serve(self, content_of: Callable[[str], bytes | None]) -> None:
        """Answer queries for content by its hash."""

        def answer(query: Any) -> None:  # noqa: ANN401  (zenoh is imported when it is needed)
            name = str(query.key_expr).rpartition("/")[2]
            content = content_of(name)
            if content is not None:
                self.sent_bytes += len(content)
                query.reply(query.key_expr, content)
            query.drop()

        self._kept.append(self._session.declare_queryable(f"{self._top}/plan/*", answer))

    def _message(self, sample: Any) -> None:  # noqa: ANN401
        at_ns = self._now_ns()
        content = sample.payload.to_bytes()
        self.received_bytes += len(content)
        if len(content) <= MESSAGE_MAX_BYTES:
            self._put("message", str(sample.key_expr), content, at_ns)

    def _token(self, sample: Any) -> None:  # noqa: ANN401
        is_alive = sample.kind == self._zenoh.SampleKind.PUT
        what: What = "alive" if is_alive else "gone"
        self._put(what, str(sample.key_expr), b"", self._now_ns())

    def _clock(self, sample: Any) -> None:  # noqa: ANN401
        received_ns = self._now_ns()
        name = str(sample.key_expr).split("/")[2]
        with contextlib.suppress(InputError):
            asked = parse(ClockQuestion, sample.payload.to_bytes(), 200)
            answer = ClockAnswer(
                asked_ns=asked.asked_ns,
                received_ns=received_ns,
                answered_ns=self._now_ns(),
                instance=self._clock_id,
            )
            self.send(f"clock/{name}", packed(answer))

    def _put(self, what: What, key: str, content: bytes, at_ns: int) -> None:
        try:
            self._inbox.put_nowait(Arrival(what, key.removeprefix(f"{self._top}/"), content, at_ns))
        except queue.Full:
            self.dropped += 1

    # ---- what is sent

    def send(self, key: str, content: bytes) -> None:
        """Send a message, or drop it where the network takes none."""
        zenoh = self._zenoh
        self.sent_bytes += len(content)
        with contextlib.suppress(zenoh.ZError):
            self._session.put(
                f"{self._top}/{key}",
                content,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.REAL_TIME,
                express=True,
            )

    def fetch(self, name: str) -> None:
        """Ask for content by its hash; it arrives as `content`, checked, or as `no content`."""
        if name in self._fetching:
            return
        self._fetching.add(name)
        threading.Thread(target=self._fetch, args=(name,), daemon=True).start()

    def _fetch(self, name: str) -> None:
        found = None
        try:
            for reply in self._session.get(f"{self._top}/plan/{name}", timeout=FETCH_S):
                if reply.ok is None:
                    continue
                content = reply.ok.payload.to_bytes()
                self.received_bytes += len(content)
                if len(content) <= PLAN_MAX_BYTES and hash_of(content) == name:
                    found = content
                    break
        except self._zenoh.ZError:
            pass
        finally:
            self._fetching.discard(name)
        what: What = "no content" if found is None else "content"
        self._put(what, f"{self._top}/plan/{name}", found or b"", self._now_ns())

    def close(self) -> None:
        """Leave the network."""
        for handler in reversed(self._kept):
            with contextlib.suppress(Exception):
                handler.undeclare()
        with contextlib.suppress(Exception):
            self._session.close()  # type: ignore[no-untyped-call]
