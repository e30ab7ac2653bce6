"""The server's end of the process that plays: operations there, events and telemetry back.

The player never waits for the server, and the server never for the player. A beat every half second
tells the player that its server is alive.
"""

from __future__ import annotations

import asyncio
import json
import socket
from typing import TYPE_CHECKING, Any, Final

import msgspec

from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.process import start_process
from lss_motion.system.messages import Kind, PipeClosedError

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.playing.remote.player_end import OnLost
    from lss_motion.studio.stopping import StopProcess

BEAT_S: Final = 0.5
SILENT_S: Final = 3.0
"""A server that sends nothing for so long is a lost operator. Chosen: six beats, since a busy
computer may delay one or two."""
GONE: Final = (
    "the process that plays has ended without a report; the servos come to rest by themselves"
)
SLEPT: Final = "the computer slept or the server stood still"


class PlayerProcess:
    """A process that plays one job, or moves a robot without a show.

    `on_event` gets each event as a dict and as its text, the last one with `event` = `ended`;
    `on_telemetry` gets frames; `on_end` is called once when the process has ended.
    """

    def __init__(
        self,
        job: bytes,
        stops: StopProcess,
        *,
        on_event: Callable[[dict[str, Any], str], None],
        on_telemetry: Callable[[bytes], None],
        on_end: Callable[[PlayerProcess], None],
        on_lost: OnLost,
        options: dict[str, Any],
    ) -> None:
        from lss_motion.playing.remote.player_end import LossRule

        self._on_event, self._on_telemetry, self._on_end = on_event, on_telemetry, on_end
        self._stops = stops
        self._has_ended = False
        self._stop_end, players_end = socket.socketpair()
        stops.add_player(self._stop_end)
        rule = LossRule(on_lost, silent_s=SILENT_S)
        with players_end:
            self._process = start_process(job, players_end, rule=rule, options=options)
        self._link = self._process.pipe
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._link.fileno(), self._read)
        self._timer = self._loop.call_later(BEAT_S, self._beat)

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, operation: m.Operation) -> None:
        """Send an operation; its answer is an event with the same `id`."""
        self._link.send(Kind.OPERATION, operation.to_json())

    def send_job(self, job: bytes) -> None:
        """Send a newer packed job to a process that can go on with it."""
        self._link.send(Kind.OBJECT, job)

    def _beat(self) -> None:
        self._timer = self._loop.call_later(BEAT_S, self._beat)
        self.send(m.Beat())

    def _read(self) -> None:
        try:
            arrived = self._link.receive()
        except PipeClosedError:
            self._end()
            return
        for kind, content in arrived:
            if kind is Kind.TELEMETRY:
                self._on_telemetry(content)
            elif kind is Kind.EVENT:
                event = json.loads(content)
                self._has_ended = self._has_ended or event["event"] == "ended"
                self._on_event(event, content.decode())

    def _end(self) -> None:
        """Note the end of the process, with or without its last event."""
        self._loop.remove_reader(self._link.fileno())
        self._timer.cancel()
        self._link.close()
        self._stops.drop_player(self._stop_end)
        if not self._has_ended:
            ended = m.Ended(outcome="lost", error=GONE, report=None)
            self._on_event(msgspec.to_builtins(ended), ended.to_json().decode())
        self._loop.create_task(self._reap())
        self._on_end(self)

    async def _reap(self) -> None:
        """Collect the process; it ends right after it has closed its link."""
        while self._process.exit_code() is None:
            await asyncio.sleep(0.05)
