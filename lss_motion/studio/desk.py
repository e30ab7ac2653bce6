"""Carries out what clients ask: the show, the file, and the stop that is kept.

One process at a time owns the ports of the robot: it plays a show, or moves the robot without one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import InputError
from lss_motion.remote import schema as m
from lss_motion.studio.playing import PlayerProcess

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from lss_motion.remote.player_end import OnLost
    from lss_motion.studio.document import Document
    from lss_motion.studio.hub import Hub
    from lss_motion.studio.planner import Reply
    from lss_motion.studio.stop import StopKind
    from lss_motion.studio.stopping import StopProcess

REPLAYED: Final = ("started", "checked", "rate", "ended")
"""Events of the running show that a client gets which comes later: the newest of each."""
WARNINGS_MAX: Final = 50
"""Warnings and faults of the running show that a client gets which comes later."""
TROUBLE: Final = ("warned", "fault")


@dataclass(frozen=True, slots=True, kw_only=True)
class DeskOptions:
    """What the person at the computer decided when the server was started."""

    on_lost: OnLost = "go_on"
    may_run: bool = False


class Desk:
    """Obeys operations. One for each server."""

    def __init__(self, hub: Hub, stops: StopProcess, options: DeskOptions) -> None:
        self.document: Document | None = None
        self.pair: Callable[[m.RoleName], m.Pairing] | None = None
        """Makes a pairing code; raises `InputError` where no other device can come."""
        self._hub, self._stops, self._options = hub, stops, options
        stops.on_latch = self.note_latch
        self._player: PlayerProcess | None = None
        self._on_free: Callable[[], None] | None = None
        self._state = m.PlayerChanged(
            state="idle", is_latched=False, plan=None, show_s=None, text=""
        )
        self._kept: dict[str, str] = {}
        self._trouble: list[str] = []

    # ---- called by the hub

    def state(self) -> Iterable[m.Message]:
        """Return the state of everything, for a client that has come."""
        assert self.document is not None
        return (self.document.message(), self._state, self._robot_message())

    def replay(self) -> Iterable[str]:
        """Return what has happened in the running show, for a client that has come."""
        return (*self._kept.values(), *self._trouble)

    def stop(self, *, is_emergency: bool) -> None:
        """Stop whatever moves, and stay stopped until `rearm`."""
        kind: StopKind = "estop" if is_emergency else "stop"
        if self._player is not None:
            self._player.send(m.Estop() if is_emergency else m.Stop())
        self._stops.latch(kind)
        self.note_latch(kind)

    def note_latch(self, kind: StopKind) -> None:
        """Note a stop that another way has carried out."""
        word = "emergency stop" if kind == "estop" else "stop"
        text = f"{word}: nothing moves before it is armed again"
        state = "stopping" if self._player is not None else self._state.state
        self._change(state=state, is_latched=True, text=text)

    def obey(self, operation: m.AnyOperation, key: int) -> bool:
        """Carry an operation out; see `hub.Desk`."""
        assert self.document is not None
        match operation:
            case m.Play():
                self._play(operation)
            case m.Go() | m.Pause() | m.Resume() | m.Rate() | m.Seek():
                return self._forward(operation, key)
            case m.Rearm():
                self._rearm()
            case m.Load():
                self._require_free()
                self.document.load(operation.path)
            case m.Pair() if self.pair is not None:
                self._hub.tell(key, self.pair(operation.role))
            case _:
                raise InputError(f"{operation.op} is not possible here")
        return True

    def operator_lost(self) -> None:
        """Do what the rule says about an operator that is gone."""
        if self._player is None or self._options.on_lost == "go_on":
            return
        warned = m.Warned(text=f"the operator is gone: the show does {self._options.on_lost!r}")
        self._hub.broadcast(warned)
        self._player.send(m.Stop() if self._options.on_lost == "stop" else m.Pause())

    # ---- called by the server

    @property
    def player(self) -> PlayerProcess | None:
        """The process that owns the ports of the robot, if there is one."""
        return self._player

    def document_changed(self) -> None:
        """Tell the clients the state of the file."""
        assert self.document is not None
        self._hub.broadcast(self.document.message())

    def close(self, on_free: Callable[[], None]) -> None:
        """Stop what moves; call back when the ports are free."""
        if self._player is None:
            on_free()
            return
        self._on_free = on_free
        self._player.send(m.Stop())

    # ---- the show

    def _play(self, operation: m.Play) -> None:
        self._require_armed()
        self._require_free()
        reply = self._plan()
        if operation.plan is not None and operation.plan != reply.plan:
            raise InputError("the plan has changed since then; look at it, then play")
        if reply.functions and not self._options.may_run:
            names = ", ".join(dict.fromkeys(reply.functions))
            raise InputError(
                f"the show calls Python functions ({names}); read them, then start the studio "
                f"with --allow-run"
            )
        self._kept, self._trouble = {}, []
        self._player = PlayerProcess(
            reply.job,
            self._stops,
            on_event=self._take,
            on_telemetry=self._hub.offer_telemetry,
            on_end=self._note_end,
            on_lost=self._options.on_lost,
            options={
                "start_s": operation.from_s,
                "must_ask": not reply.is_simulated,
                "may_run": self._options.may_run,
            },
        )
        self._change(state="starting", plan=reply.plan, text="")
        self._hub.broadcast(self._robot_message())

    def _plan(self) -> Reply:
        """Return the last good plan; raises `InputError` that says why there is none."""
        assert self.document is not None
        good, newest = self.document.good, self.document.newest
        if good is not None and good.plan is not None:
            return good
        if newest.problems:
            path, line, text = newest.problems[0]
            raise InputError(f"there is no plan: {text}", path=path, line=line)
        if newest.kind == "robot" and good is not None:
            raise InputError("this is a robot file, which has no show; open a sequence or a gait")
        raise InputError("the show is being planned; wait a moment")

    def _forward(self, operation: m.ShowOperation, key: int) -> bool:
        if self._player is None:
            raise InputError("no show plays now")
        self._player.send(operation.model_copy(update={"id": key}))
        return False

    def _rearm(self) -> None:
        if self._player is not None:
            raise InputError("the robot is being stopped; wait until it has ended")
        self._stops.rearm()
        self._change(is_latched=False, text="")

    def _require_armed(self) -> None:
        if self._state.is_latched:
            raise InputError("it was stopped; arm it again first (rearm)")

    def _require_free(self) -> None:
        if self._player is not None:
            raise InputError("a show plays; stop it first")

    # ---- what the player sends

    def _take(self, event: dict[str, Any], text: str) -> None:
        kind = event["event"]
        if kind == "health":
            self._hub.offer("health", text)
            return
        if kind in ("accepted", "refused"):  # 0: a stop of ours, which is answered already.
            self._hub.answer(event["id"], event.get("text"))
            return
        if kind in REPLAYED:
            self._kept[kind] = text
        if kind in TROUBLE and len(self._trouble) < WARNINGS_MAX:
            self._trouble.append(text)
        self._hub.broadcast_text(text)
        self._follow(kind, event)

    def _follow(self, kind: str, event: dict[str, Any]) -> None:
        """Keep the state of the player in step with its events."""
        match kind:
            case "phase" if event["phase"] == "ready":
                self._change(state="ready")
            case "phase" if event["phase"] == "playing" and self._state.state != "paused":
                self._change(state="playing")
            case "phase" if event["phase"] in ("stopping", "restoring"):
                self._change(state="stopping")
            case "rate":
                self._change(state="paused" if event["is_paused"] else "playing")
            case "ended" if event["outcome"] == "lost" and event["report"] is None:
                self._change(state="gone", text=event["error"])
            case "ended":
                self._change(state="ended", text=event["error"] or event["outcome"])

    def _note_end(self, player: PlayerProcess) -> None:
        assert player is self._player
        self._player = None
        for key in self._hub.unanswered():
            self._hub.answer(key, "the show has ended")
        self._hub.broadcast(self._robot_message())
        if self._on_free is not None:
            self._on_free()

    def _change(self, **fields: object) -> None:
        changed = self._state.model_copy(update=fields)
        if changed != self._state:
            self._state = changed
            self._hub.broadcast(changed)

    def _robot_message(self) -> m.RobotChanged:
        assert self.document is not None
        reply = self.document.good or self.document.newest
        return m.RobotChanged(
            state="off" if self._player is None else "playing",
            port=reply.port,
            is_simulated=reply.is_simulated,
            joints={},
            text="",
        )
