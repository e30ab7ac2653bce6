"""Alerts to a web hook: JSON by POST, in a thread of its own, with a few attempts.

A hook that does not answer delays nothing: at most `WAITING_MAX` alerts wait, the oldest is
dropped.
"""

from __future__ import annotations

import asyncio
import json
import urllib.error
import urllib.request
from collections import deque
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

WAITING_MAX: Final = 32
TIMEOUT_S: Final = 10.0
ATTEMPTS: Final = 4
PAUSE_S: Final = 2.0
"""Before the second attempt; twice as long before each further one."""


class WebHook:
    """One address that gets alerts."""

    def __init__(self, url: str, note: Callable[[str], None], *, pause_s: float = PAUSE_S) -> None:
        self._url, self._note, self._pause_s = url, note, pause_s
        self._waiting: deque[bytes] = deque(maxlen=WAITING_MAX)
        self._task: asyncio.Task[None] | None = None

    def send(self, alert: Mapping[str, object]) -> None:
        """Send an alert soon; returns at once."""
        self._waiting.append(json.dumps(alert, ensure_ascii=False).encode())
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._send_all())

    async def close(self, wait_s: float = TIMEOUT_S) -> None:
        """Wait a while for what is being sent."""
        if self._task is not None:
            await asyncio.wait({self._task}, timeout=wait_s)
            self._task.cancel()

    async def _send_all(self) -> None:
        while self._waiting:
            body, problem = self._waiting.popleft(), None
            for attempt in range(ATTEMPTS):
                problem = await asyncio.to_thread(post, self._url, body)
                if problem is None:
                    break
                if attempt + 1 < ATTEMPTS:
                    await asyncio.sleep(self._pause_s * 2**attempt)
            else:
                self._note(f"alert: the web hook did not take it: {problem}")


def post(url: str, body: bytes) -> str | None:
    """Send a body; return what went wrong."""
    request = urllib.request.Request(  # noqa: S310  (the stage file names it)
        url, body, {"content-type": "application/json"}, method="POST"
    )
    try:
        with urllib.request.urlopen(request, timeout=TIMEOUT_S):  # noqa: S310
            return None
    except (OSError, ValueError) as error:  # HTTPError is an OSError, too.
        return str(error)
