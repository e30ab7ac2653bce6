"""Saying lines and keeping every byte that comes back: for buses of which nothing is known yet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from lss_motion.player.events import Event


@dataclass(frozen=True, slots=True)
class Step:
    """Bytes to send, and how long to listen from then on."""

    data: bytes
    listen_ns: int


class Listening:
    """Works through `steps` on one bus, for the runner.

    `heard` has what came while each step was the last one sent; what an adapter holds back may
    stand with a later step.
    """

    def __init__(self, bus: str, steps: Sequence[Step]) -> None:
        self.heard = [b"" for _ in steps]
        self._bus = bus
        self._steps = steps
        self._next = 0
        self._until_ns: int | None = None

    def data_to_send(self, now_ns: int) -> Mapping[str, bytes]:
        if self._until_ns is not None and now_ns < self._until_ns:
            return {}
        if self._next == len(self._steps):
            self._until_ns = None
            return {}
        step = self._steps[self._next]
        self._next += 1
        self._until_ns = now_ns + step.listen_ns
        return {self._bus: step.data} if step.data else {}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        if self._next:
            self.heard[self._next - 1] += data

    def next_wakeup_ns(self) -> int | None:
        return self._until_ns

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}
