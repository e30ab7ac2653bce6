"""What the server of a stage does besides that of the studio.

It receives triggers (`inlets`, `api`), keeps the player running (`keeper`), passes on what happens
(OSC, MQTT, web hook, metrics, systemd), and takes new files between shows.
"""

from __future__ import annotations

import asyncio
import json
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any, Final

from msgspec import Struct, field

from lss_motion import __version__
from lss_motion.errors import LssMotionError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.message import Telemetry
from lss_motion.stage.model import TriggerKind
from lss_motion.stage.triggers.mqtt import WebHook, discovery
from lss_motion.stage.triggers.sources import AllowList, Complaints, Gate
from lss_motion.studio.api import Api, marked
from lss_motion.studio.inlets import ALWAYS, Inlets, addresses
from lss_motion.studio.keeper import Keeper, Seen
from lss_motion.studio.metrics import Metrics
from lss_motion.system.service import Notifier

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.routing import BaseRoute

    from lss_motion.stage.model import Stage
    from lss_motion.studio.keeper import Failure
    from lss_motion.studio.studio import Studio

SILENT_S: Final = 15.0
"""A player that tells nothing for so long hangs: systemd is told nothing, and starts all anew."""
API_ALLOWED: Final = ("0.0.0.0/0", "::/0")
"""Everyone with the token."""


class ServiceOptions(Struct, frozen=True, kw_only=True):
    """What `lss-motion serve` was given, besides the options of the studio."""

    starts: bool = True
    """Start the stage by itself, without a client."""
    note: Callable[[str], None] = print
    notifier: Notifier = field(default_factory=lambda: Notifier(None, None))


class StageService:
    """The service of one stage; made inside of a running loop."""

    def __init__(self, studio: Studio, options: ServiceOptions) -> None:
        self.studio, self._options = studio, options
        self.metrics = Metrics()
        self.keeper = Keeper()
        self.keeper.is_wanted = options.starts
        self.inlets = Inlets(self.take, self.note, self._told)
        gate = Gate("HTTP", AllowList((*ALWAYS, *API_ALLOWED)), self.note)
        self.api = Api(gate, self._ask, self.state, self.metrics.text)
        self._hook: WebHook | None = None
        self._stage: Stage | None = None
        self._state: dict[str, Any] = {"state": "off", "show": None}
        self._joints: tuple[str, ...] = ()
        self._show_s = 0.0
        self.log_text = ""
        """What is wrong, or was, with the log of the stage; empty: all is written."""
        self._received_s = self._now_s()
        self._refusals = Complaints("refused", self.note)
        self._said_waiting = False
        self._known: object = None
        self._problems: object = ()
        studio.desk.watch = self._watch
        studio.hub.on_telemetry = self._take_telemetry
        options.notifier.ready()

    # ---- called by the server

    def routes(self) -> list[BaseRoute]:
        """Return the routes of the HTTP interface."""
        return self.api.routes()

    @property
    def failure(self) -> Failure | None:
        """Why the program ends; None: it goes on."""
        return self.keeper.failure

    def look(self) -> None:
        """Take new files, start or end the player, tell systemd; called twice a second."""
        self._look_at_files()
        self._keep()
        if self._is_alive():
            self._options.notifier.beat()
        self._options.notifier.status(self._status())

    async def close(self) -> None:
        """Close the sources; wait for the last alerts."""
        self._options.notifier.stopping()
        await self.inlets.close()
        if self._hook is not None:
            await self._hook.close()

    # ---- what arrives

    def take(self, operation: m.AnyOperation, origin: str) -> None:
        """Carry out what a source has received; note what is refused."""
        source = origin.partition(" ")[0]

        def answer(refusal: str | None) -> None:
            self.metrics.messages.labels(source, "refused" if refusal else "accepted").inc()
            if refusal is not None:
                self._refusals.add(f"{origin}: {refusal}", self._now_s())

        self._ask(operation, origin, answer)

    def _ask(
        self, operation: m.AnyOperation, origin: str, answer: Callable[[str | None], None]
    ) -> None:
        if isinstance(operation, m.Stop | m.Estop):
            self.note(f"{operation.op} by {origin}")
        if isinstance(operation, m.Play | m.Go):
            self.keeper.is_wanted = True
        self.studio.hub.ask(marked(operation, origin), answer)

    def state(self) -> dict[str, Any]:
        """Return the state of the stage, for `GET /state`."""
        document = self.studio.document
        return {
            **self._state,
            "show_s": round(self._show_s, 3),
            "is_latched": self.studio.desk.is_latched,
            "has_new_files": self.keeper.has_new_files,
            "log": self.log_text,
            "errors": [f"{path}:{line}: {text}" for path, line, text in document.newest.problems],
            "version": __version__,
        }

    def _told(self) -> dict[str, float | str]:
        show = self._state["show"]
        return {"state": self._state_word(), "show": show or "", "show_s": self._show_s}

    def _state_word(self) -> str:
        if self.studio.desk.is_latched:
            return "stopped"
        return "off" if self.studio.desk.player is None else str(self._state["state"])

    # ---- files

    def _look_at_files(self) -> None:
        document = self.studio.document
        newest, good = document.newest, document.good
        if newest.problems and newest.problems != self._problems:
            more = "" if good is None else "; the stage goes on with the last good files"
            for path, line, text in newest.problems[:5]:
                self.note(f"{path}:{'' if line is None else f'{line}:'} {text}{more}")
        self._problems = newest.problems
        if good is None or good is self._known or good.stage is None:
            return
        self._known = good
        if changed := self.studio.desk.changed_functions(good):
            self.note(
                f"{', '.join(changed)} changed since --allow-run was given: its functions are "
                f"called as they were; read it, then start lss-motion serve again"
            )
        stage = self._stage = good.stage
        self.api.names = addresses(stage, TriggerKind.HTTP)
        self.inlets.use(stage)
        hook = stage.alerts.webhook
        self._hook = None if hook is None else WebHook(hook, self.note)

    def _keep(self) -> None:
        good, desk = self.studio.document.good, self.studio.desk
        seen = Seen(
            plan=None if good is None else good.plan,
            is_running=desk.player is not None,
            is_latched=desk.is_latched,
            state=str(self._state["state"]),
        )
        deed = self.keeper.next_deed(seen, self._now_s())
        is_waiting = seen.is_running and self.keeper.has_new_files
        if is_waiting and not self._said_waiting:
            self.note("the files have changed: they are played when this show has ended")
        self._said_waiting = is_waiting
        if deed == "renew":
            desk.renew_run()
        elif deed == "start":
            self._start(seen.plan)

    def _start(self, plan: str | None) -> None:
        self.keeper.note_start(plan, self._now_s())
        self._received_s = self._now_s()
        try:
            self.studio.desk.start()
        except LssMotionError as refused:
            self._end(str(refused), refused.exit_code)

    def _end(self, error: str | None, exit_code: int | None) -> None:
        self._state = {**self._state, "state": "off", "show": None}
        self.metrics.note_state("off")
        text = self.keeper.note_end(error, exit_code, self._now_s())
        if text is not None:
            self.note(text)
            self.alert("player", text)
        self._tell_state()

    # ---- what happens

    def _watch(self, event: dict[str, Any]) -> None:
        """Pass on an event of the player."""
        self._received_s = self._now_s()
        self.metrics.take(event)
        match event["event"]:
            case "started":
                self._joints = tuple(event["joints"])
            case "checked":
                self.keeper.note_connected()
            case "stage":
                self._state = {key: value for key, value in event.items() if key != "event"}
                self._tell_state()
            case "stage_note":
                self._pass_on(event)
            case "ended":
                self._end(event["error"], event.get("exit_code"))

    def _pass_on(self, note: dict[str, Any]) -> None:
        kind, text = note["kind"], note["text"]
        if kind in ("renewed", "busy"):
            self.keeper.note_renewed(is_taken=kind == "renewed")
        elif kind == "must_restart":
            self.studio.desk.end_run()
        if kind == "log":
            self.log_text = text
        if not text:
            return  # Figures for the log.
        self._options.note(text)
        if self.inlets.osc is not None:
            self.inlets.osc.send_event(kind, text)
        if self.inlets.mqtt is not None:
            self.inlets.mqtt.tell(
                f"{self.inlets.mqtt.base}/event", json.dumps({"kind": kind, "text": text})
            )
        if kind in ("alert", "log"):
            self.alert(kind, text)

    def _tell_state(self) -> None:
        if self.inlets.osc is not None:
            self.inlets.osc.send_state()
        link, stage = self.inlets.mqtt, self._stage
        if link is None or stage is None:
            return
        topic, text = discovery(stage.name, [cue.name for cue in stage.cues], __version__)
        link.keep(topic, text)
        kept = {key: value for key, value in self.state().items() if key != "show_s"}
        link.keep(f"{link.base}/state", json.dumps({**kept, "state": self._state_word()}))
        for cue in self._state.get("cues", ()):
            word = "ON" if cue["is_enabled"] else "OFF"
            link.keep(f"{link.base}/enabled/{cue['name']}", word)

    def _take_telemetry(self, frame: bytes) -> None:
        """Pass the angles on by OSC, where a servo was read the measured ones."""
        self._received_s = self._now_s()
        telemetry = Telemetry.from_bytes(frame)
        self._show_s = telemetry.show_s
        if self.inlets.osc is None or len(self._joints) != len(telemetry.angles_deg):
            return
        deg = {}
        for name, (planned_deg, _, read_deg) in zip(
            self._joints, telemetry.angles_deg, strict=True
        ):
            deg[name] = planned_deg if read_deg != read_deg else read_deg  # noqa: PLR0124  (NaN)
        self.inlets.osc.send_joints(deg)

    def alert(self, kind: str, text: str) -> None:
        """Send an alert to people elsewhere."""
        stage = self._stage
        if stage is None:
            return
        content = {
            "stage": stage.name,
            "kind": kind,
            "text": text,
            "at": datetime.now(UTC).isoformat(timespec="seconds"),
        }
        if self._hook is not None:
            self._hook.send(content)
        if stage.alerts.mqtt is not None and self.inlets.mqtt is not None:
            self.inlets.mqtt.tell(stage.alerts.mqtt, json.dumps(content))

    def note(self, text: str) -> None:
        """Print what the server has noted, and show it on the pages as a warning."""
        self._options.note(text)
        self.studio.hub.broadcast(m.WarningRaised(text=text))

    # ---- systemd

    def _is_alive(self) -> bool:
        is_running = self.studio.desk.player is not None
        return not is_running or self._now_s() - self._received_s < SILENT_S

    def _status(self) -> str:
        show = self._state["show"]
        return f"{self._state_word()}{'' if not show else f': {show}'}"

    @staticmethod
    def _now_s() -> float:
        return asyncio.get_running_loop().time()
