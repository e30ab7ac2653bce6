"""Letting time pass on open ports: what the servos say meanwhile is dropped."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.player.events import Event


class Pause:
    """Drives nothing until `until_ns`, for the runner."""

    def __init__(self, until_ns: int) -> None:
        self._until_ns = until_ns
        self._is_over = False

    def data_to_send(self, now_ns: int) -> Mapping[str, bytes]:
        self._is_over = now_ns >= self._until_ns
        return {}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        pass

    def next_wakeup_ns(self) -> int | None:
        return None if self._is_over else self._until_ns

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}
