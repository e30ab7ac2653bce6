"""Carries out what clients ask: the show, the robot without one, the file, the stop that is kept.

One process at a time owns the ports of the robot (`playing.PlayerProcess`): it plays a show, lets
the operator move the robot, or finds its servos.
"""

from __future__ import annotations

import json
import pickle
import time
from collections import deque
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError, LssMotionError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote.edit_messages import EditOperation, Tried
from lss_motion.playing.remote.stage_messages import StageOperation
from lss_motion.studio.planner import SpliceRequest, file_digest
from lss_motion.studio.playing import PlayerProcess

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lss_motion.playing.remote.player_end import OnLost
    from lss_motion.show.functions import ModuleSource
    from lss_motion.studio.document import Document
    from lss_motion.studio.hub import Hub
    from lss_motion.studio.latch import StopKind
    from lss_motion.studio.planner import PlannerReply, SpliceResult, TrialResult
    from lss_motion.studio.stopping import StopProcess

MAINTENANCE: Final = "maintenance"
REPLAYED: Final = ("started", "checked", "rate", "ended")
"""Events of the running show that a client gets which comes later: the newest of each."""
WARNINGS_MAX: Final = 50
"""Warnings and faults of the running show that a client gets which comes later."""
TROUBLE: Final = ("warned", "fault")
MOVING: Final = ("playing", "standing")
"""Phases in which a show plays, or another may begin at any time."""
NOTES_MAX: Final = 50
"""Notes of a stage that a client gets which comes later: the newest."""
ROBOT: Final = "robot"
"""Only the newest state of the robot counts, so it is offered, not sent."""
SPLICE_MARGIN_S: Final = 1.5
"""What is due within this time stays as it is when an edit is taken into the show that plays: the
planner and the way to the player take less (measured: 0.2 s of CPU for 18 joints and 60 s)."""
Task = Literal["show", "live", "scan", "puppet"]
BUSY: Final[dict[Task, str]] = {
    "show": "a show plays; stop it first",
    "live": "the robot is connected; disconnect it first",
    "scan": "the servos are being searched; wait a moment",
    "puppet": "the joints follow a client; end that first (disconnect)",
}


LED: Final = frozenset({"show", "puppet"})
"""Tasks whose end is that of a player."""


class DeskOptions(Struct, frozen=True, kw_only=True):
    """What the person at the computer decided when the server was started."""

    on_lost: OnLost = "go_on"
    may_run: bool = False
    stage: Mapping[str, object] | None = None
    """Options of the job of a stage; it begins without `go`, also on a real robot."""


class Desk:
    """Obeys operations. One for each server."""

    def __init__(self, hub: Hub, stops: StopProcess, options: DeskOptions) -> None:
        self.document: Document | None = None
        self.pair: Callable[[m.RoleName], m.PairingCode] | None = None
        """Makes a pairing code; raises `InputError` where no other device can come."""
        self._hub, self._stops, self._options = hub, stops, options
        stops.on_latch = self.note_latch
        self._player: PlayerProcess | None = None
        self._task: Task = "show"
        """What the process does, if there is one."""
        self._next: Callable[[], None] | None = None
        """What begins when the process has ended; a stop forgets it."""
        self._on_free: Callable[[], None] | None = None
        self._state = m.PlayerChanged(state="idle", latch=None, plan=None, show_s=None, text="")
        self._robot = (
            m.RobotChanged(state="off", port="", is_simulated=False, joints={}, text="")
            .to_json()
            .decode()
        )
        self._noted: StopKind | None = None
        """The stop that is kept, as clients were told."""
        self._kept: dict[str, str] = {}
        self._agreed: tuple[ModuleSource, ...] | None = None
        """What lay beside the shows of the stage when it was begun first."""
        self._notes: deque[str] = deque(maxlen=NOTES_MAX)
        self.splice: Callable[[SpliceRequest], None] = lambda _: None
        """Asks the planner how the show that plays goes on as the edited one."""
        self._job = b""
        """What the process plays, with the edits that it has taken."""
        self._spliced: tuple[int, str, bytes] | None = None
        """An edit that the process has not answered yet: key, plan, and the job with it."""
        self._reached: tuple[float, float] | None = None
        """The show time that the process told last, and when."""
        self.watch: Callable[[dict[str, Any]], None] = lambda _: None
        """Called with each event of the process that plays."""
        self._trouble: list[str] = []
        self._end_state: dict[str, object] = {"state": "ended", "text": ""}
        self._outcome = ""
        self._end_text = ""
        """What is told when the process has ended: until then it owns the ports."""

    # ---- called by the hub

    def state(self) -> Iterable[str]:
        """Return the events with the state of everything, for a client that has come."""
        assert self.document is not None
        messages = (self.document.message(), self._state)
        return (
            *(message.to_json().decode() for message in messages),
            self._robot,
            *self._kept.values(),
            *self._trouble,
            *self._notes,
        )

    def stop(self, *, is_emergency: bool) -> None:
        """Stop whatever moves, and stay stopped until `rearm`."""
        kind: StopKind = "estop" if is_emergency else "stop"
        if self._player is not None:
            self._player.send(m.Estop() if is_emergency else m.Stop())
        self._stops.stop(kind)
        self.note_latch()

    def note_latch(self) -> None:
        """Tell the clients the stop that is kept, whichever way it came, or that none is."""
        before, self._noted = self._noted, self._stops.latch
        if self._noted == before:
            return  # The process has done what was asked for here.
        if self._noted is None:
            self._change(text="")
            return
        self._next = None
        is_show = self._player is not None and self._task in LED
        self._change(state="stopping" if is_show else self._state.state)

    def obey(self, operation: m.AnyOperation, key: int) -> bool:
        """Carry an operation out; see `hub.OperationDesk`."""
        assert self.document is not None
        if isinstance(operation, EditOperation):
            return self.document.edit(operation, key)
        match operation:
            case m.Puppeteer():
                return self._puppeteer(operation, key)
            case m.LeadJoints():
                self._lead(operation)
                return True
            case m.Disconnect() if self._task == "puppet" and self._player is not None:
                self.end_run()
                return True
            case _:
                return self._obey(operation, key)

    def _obey(self, operation: m.AnyOperation, key: int) -> bool:
        """Carry out what is asked of show, robot and server."""
        assert self.document is not None
        match operation:
            case m.Play() | m.TakeEdit():
                return self._begin(operation, key)
            case m.Go() | m.Pause() | m.Resume() | m.Rate() | m.Seek():
                return self._forward(operation, key, "show", "no show plays now")
            case _ if isinstance(operation, StageOperation):
                return self._forward(operation, key, "show", "the stage does not run; start it")
            case _ if isinstance(operation, m.RobotOperation):
                if isinstance(operation, m.PoseSave | m.MaintenanceAnswer):
                    self._require_same_robot_file()
                return self._forward(operation, key, "live", "the robot is off; connect it first")
            case m.Connect() | m.Scan():
                self._connect("live" if isinstance(operation, m.Connect) else "scan")
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

    def note_trial(self, result: TrialResult) -> None:
        """Answer an operation that asked what an edit would do."""
        assert self.document is not None
        if result.is_dropped:
            self._hub.answer(result.number, "something newer came first")
            return
        self._hub.tell(
            result.number,
            Tried(
                id=self._hub.id_of(result.number),
                revision=self.document.revision,
                problem=result.problem,
                window=result.window,
            ),
        )
        self._hub.answer(result.number)

    def operator_lost(self) -> None:
        """Do what the rule says about an operator that is gone; a robot without a show holds."""
        if self._player is None or self._task == "scan":
            return
        if self._task in ("live", "puppet"):
            self._player.send(m.Stop())
        elif self._options.on_lost != "go_on":
            done = "stops" if self._options.on_lost == "stop" else "pauses"
            self._hub.broadcast(m.WarningRaised(text=f"the operator is gone: the show {done}"))
            self._player.send(m.Stop() if self._options.on_lost == "stop" else m.Pause())

    # ---- called by the server

    @property
    def is_latched(self) -> bool:
        """Whether it was stopped, and is not armed again."""
        return self._stops.latch is not None

    def start(self) -> None:
        """Start the show or stage; raises `LssMotionError` that says why that is not possible."""
        self._require_armed()
        self._start_show(m.Play())

    def end_run(self) -> None:
        """Let the process that plays end as by a stop, but without keeping that stop."""
        if self._player is not None:
            self._player.send(m.Stop())

    def renew_run(self) -> None:
        """Let the process that plays go on with the newest plan, if it can; a note says so."""
        if self._player is not None:
            self._player.send_job(self._plan().job)

    @property
    def player(self) -> PlayerProcess | None:
        """The process that owns the ports of the robot, if there is one."""
        return self._player

    def document_changed(self) -> None:
        """Tell the clients the state of the file, and of its robot while that is off."""
        assert self.document is not None
        self._hub.broadcast(self.document.message())
        if self._player is None:
            self._tell_robot("off")

    def close(self, on_free: Callable[[], None]) -> None:
        """Stop what moves; call back when the ports are free."""
        if self._player is None:
            on_free()
            return
        self._next, self._on_free = None, on_free
        self._player.send(m.Stop())

    # ---- the show

    def _begin(self, operation: m.Play | m.TakeEdit, key: int) -> bool:
        if isinstance(operation, m.Play):
            return self._play(operation, key)
        self._splice(operation, key)
        return False

    def _play(self, operation: m.Play, key: int) -> bool:
        """Start the show; where the robot is connected, when that has ended."""
        self._require_armed()
        if self._player is None or self._task != "live":
            self._start_show(operation)
            return True
        self._player.send(m.Disconnect())

        def start() -> None:
            try:
                self._start_show(operation)
            except LssMotionError as refused:
                self._hub.answer(key, str(refused))
            else:
                self._hub.answer(key)

        self._next = start
        return False

    def _start_show(self, operation: m.Play) -> None:
        self._require_free()
        reply = self._plan()
        assert self.document is not None
        if reply.stage is not None and self._options.stage is None:
            raise InputError(f"this is a stage; {self.document.path.name} runs by lss-motion serve")
        if operation.plan is not None and operation.plan != self.document.plan:
            raise InputError("the plan has changed since then; look at it, then play")
        if reply.functions and not self._options.may_run:
            names = ", ".join(dict.fromkeys(reply.functions))
            raise InputError(
                f"the show calls Python functions ({names}); read them, then start the studio "
                f"with --allow-run"
            )
        modules = self._agreed_to(reply)
        self._kept, self._trouble = {}, []
        options: dict[str, Any] = {"may_run": self._options.may_run, "modules": modules}
        if reply.stage is None:
            options |= {"start_s": operation.from_s, "must_ask": not reply.is_simulated}
        else:
            options |= self._options.stage or {}
        self._job, self._spliced, self._reached = reply.job, None, None
        self._start(reply.job, "show", self._take_of_show, options)
        plan = reply.plan if reply.stage is None else None  # The plan of a stage is many.
        self._change(state="starting", plan=plan, text="")
        self._tell_robot("playing")

    def changed_functions(self, reply: PlannerReply) -> list[str]:
        """Return the files of functions that are called as they were when the stage was begun."""
        agreed = self._agreed
        return [] if agreed is None else [o.path for o in reply.modules if o not in agreed]

    def _agreed_to(self, reply: PlannerReply) -> tuple[ModuleSource, ...]:
        """Return what a show may call. A stage begins anew without a person.

        So it calls what a person agreed to with `--allow-run`: what lay beside its shows at first.
        """
        if reply.stage is None:
            return reply.modules
        if self._agreed is None:
            self._agreed = reply.modules
        known = {(one.folder, one.name) for one in self._agreed}
        if fresh := [o.path for o in reply.modules if (o.folder, o.name) not in known]:
            raise InputError(
                f"the shows call Python that was not there when --allow-run was given "
                f"({', '.join(fresh)}); read it, then start lss-motion serve again"
            )
        return self._agreed

    def _plan(self) -> PlannerReply:
        """Return the last good plan; raises `InputError` that says why there is none."""
        assert self.document is not None
        good, newest = self.document.good, self.document.newest
        if good is not None and good.plan is not None:
            return good
        if newest.problems:
            path, line, text = newest.problems[0]
            raise InputError(f"there is no plan: {text}", path=path, line=line)
        if newest.kind == "folder":
            raise InputError("nothing is open yet; open a show, or make one")
        if newest.kind == "robot" and good is not None:
            raise InputError("this is a robot file, which has no show; open a sequence or a gait")
        raise InputError("the show is being planned; wait a moment")

    def _splice(self, operation: m.TakeEdit, key: int) -> None:
        """Let the show that plays go on as the edited one, if the planner finds how."""
        assert self.document is not None
        if self._player is None or self._task != "show" or self._reached is None:
            raise InputError("no show plays now")
        reply = self._plan()
        if reply.stage is not None:
            raise InputError("a stage goes on with newer files by itself")
        if operation.plan != reply.plan or self.document.newest.problems:
            raise InputError("the plan has changed since then; look at it first")
        show_s, told_s = self._reached
        reached_s = max(show_s + time.monotonic() - told_s, 0.0) + SPLICE_MARGIN_S
        self.splice(
            SpliceRequest(number=key, plan=operation.plan, job=self._job, reached_s=reached_s)
        )

    def note_splice(self, result: SpliceResult) -> None:
        """Give the player the edit that the planner has found, or say why there is none."""
        if result.problem is not None or self._player is None:
            self._hub.answer(result.number, result.problem or "the show has ended")
            return
        self._spliced = result.number, result.plan, result.job
        operation = m.TakeEdit(id=result.number, plan=result.plan)
        self._player.send_job(pickle.dumps((operation, result.edit)))

    def _note_answer(self, event: dict[str, Any]) -> None:
        """Note that the process goes on with an edit, or does not."""
        if self._spliced is not None and event["id"] == self._spliced[0]:
            (_, plan, job), self._spliced = self._spliced, None
            if event["event"] == "accepted":
                self._job = job
                self._change(plan=plan)

    def _rearm(self) -> None:
        if self._player is not None:
            raise InputError("the robot is being stopped; wait until it has ended")
        self._stops.rearm()
        self.note_latch()

    # ---- the robot without a show

    def _connect(self, task: Task) -> None:
        assert self.document is not None
        self._require_armed()
        self._require_free()
        reply = self.document.newest if self.document.newest.robot else self.document.good
        if reply is None or not reply.live_job:
            raise InputError("the robot file is not read yet, or has an error; mend it first")
        self._trouble = []
        self._kept.pop(MAINTENANCE, None)
        job = reply.live_job if task == "live" else reply.scan_job
        self._start(job, task, self._take_of_robot, {})
        self._tell_robot("connecting")

    def _puppeteer(self, operation: m.Puppeteer, key: int) -> bool:
        """Let the joints of the connected robot follow a client, from where they were read."""
        assert self.document is not None
        self._require_armed()
        if self._player is None or self._task != "live":
            raise InputError("the robot is off; connect it first")
        reply = self.document.newest if self.document.newest.robot else self.document.good
        if reply is None or not reply.puppet_job:
            raise InputError("these joints cannot follow: see the Robot page")
        joints = json.loads(self._robot)["joints"]
        if unknown := sorted({*operation.joints} - joints.keys()):
            raise InputError(f"the robot has no joint {unknown[0]!r}")
        standing_deg = {
            name: one["deg"]
            for name, one in joints.items()
            if name in operation.joints or not one["is_limp"]
        }
        if not standing_deg:
            raise InputError("all joints are limp; name those that shall follow")
        if None in standing_deg.values():
            raise InputError("not every joint was read yet; wait a moment")
        job = reply.puppet_job
        self._player.send(m.Disconnect())

        def start() -> None:
            try:
                self._require_armed()
            except InputError as refused:
                self._hub.answer(key, str(refused))
                return
            self._kept, self._trouble = {}, []
            options = {"standing_deg": standing_deg}
            self._start(job, "puppet", self._take_of_show, options)
            self._change(state="starting", plan=None, text="")
            self._tell_robot("playing")
            self._hub.answer(key)

        self._next = start
        return False

    def _lead(self, operation: m.LeadJoints) -> None:
        """Pass targets on; the player answers only what it refuses."""
        if self._player is None or self._task != "puppet":
            raise InputError("no joints follow now; begin with puppeteer")
        self._player.send(operation)

    def _require_same_robot_file(self) -> None:
        """Refuse to write a robot file that has changed on disk since it was read."""
        assert self.document is not None
        reply = self.document.newest
        path = reply.robot_path
        if path is not None:
            self.document.expect_change(path)
        if path is not None and file_digest(path) != reply.robot_digest:
            raise InputError("has just changed on disk; look at it, then save again", path=path)

    # ---- the process

    def _start(
        self,
        job: bytes,
        task: Task,
        take: Callable[[dict[str, Any], str], None],
        options: dict[str, Any],
    ) -> None:
        self._task, self._end_text = task, ""
        self._hub.telemetry = None
        self._player = PlayerProcess(
            job,
            self._stops,
            on_event=take,
            on_telemetry=self._hub.offer_telemetry,
            on_end=self._note_end,
            on_lost=self._options.on_lost,
            options=options,
        )

    def _forward(self, operation: m.AnyOperation, key: int, task: Task, why: str) -> bool:
        """Send an operation to the process, which answers it."""
        if self._player is None or self._task != task:
            raise InputError(why)
        self._player.send(replace(operation, id=key))
        return False

    def _require_armed(self) -> None:
        if self.is_latched:
            raise InputError("it was stopped; arm it again first (rearm)")

    def _require_free(self) -> None:
        if self._player is not None:
            raise InputError(BUSY[self._task])

    def _take_of_show(self, event: dict[str, Any], text: str) -> None:
        """Pass an event of a show on."""
        kind = event["event"]
        self.watch(event)
        if kind == "health":
            if event["show_s"] is not None:
                self._reached = event["show_s"], time.monotonic()
            self._hub.offer("health", text)
            return
        if self._is_answer(event):
            return
        if kind == "stage":
            self._kept[kind] = text
            self._hub.offer(kind, text)
            self._show_plan_of(event["show"])
            return
        if kind in REPLAYED:
            self._kept[kind] = text
        self._pass_on(kind, text)
        self._follow(event)

    def _follow(self, event: dict[str, Any]) -> None:
        """Keep the state of the player in step with an event of a show."""
        match event["event"]:
            case "phase" if event["phase"] == "ready":
                self._change(state="ready")
            case "phase" if event["phase"] in MOVING and self._state.state != "paused":
                self._change(state="playing")
            case "phase" if event["phase"] in ("stopping", "restoring"):
                self._change(state="stopping")
            case "rate":
                self._change(state="paused" if event["is_paused"] else "playing")
            case "ended" if event["outcome"] == "lost" and event["report"] is None:
                self._end_state = {"state": "gone", "text": event["error"]}
            case "ended":
                self._end_state = {"state": "ended", "text": event["error"] or ""}
                self._outcome = event["outcome"]

    def _show_plan_of(self, show: str | None) -> None:
        """Let the clients see the plan of the present show of a stage."""
        assert self.document is not None
        before = self.document.plan
        self.document.shown = show
        if self.document.plan != before:
            self._hub.broadcast(self.document.message())

    def _take_of_robot(self, event: dict[str, Any], text: str) -> None:
        """Pass an event of a robot without a show on."""
        if event["event"] == "robot":
            self._robot = text
            self._hub.offer(ROBOT, text)
        elif event["event"] == "health":
            self._hub.offer("health", text)
        elif event["event"] == "ended":
            self._end_text = event["error"] or ""
        elif not self._is_answer(event):
            if event["event"] == MAINTENANCE:
                self._kept[MAINTENANCE] = text
            self._pass_on(event["event"], text)

    def _is_answer(self, event: dict[str, Any]) -> bool:
        """Pass the answer to an operation on to its client; return whether it was one."""
        is_answer = event["event"] in ("accepted", "refused")
        if is_answer:  # Its id is 0 for a stop of ours, which is answered already.
            self._note_answer(event)
            self._hub.answer(event["id"], event.get("text"))
        return is_answer

    def _pass_on(self, kind: str, text: str) -> None:
        if kind in TROUBLE and len(self._trouble) < WARNINGS_MAX:
            self._trouble.append(text)
        if kind == "stage_note":
            self._notes.append(text)
        self._hub.broadcast_text(text)

    def _note_end(self, player: PlayerProcess) -> None:
        assert player is self._player
        self._player = None
        begin, self._next = self._next, None
        if self._task in LED:
            self._change(**{**self._end_state, "text": self._end_state["text"] or self._outcome})
        self._tell_robot("off", self._end_text)
        if begin is not None:
            begin()
        for key in self._hub.unanswered():
            self._hub.answer(key, "it has ended before this was carried out")
        if self._on_free is not None:
            self._on_free()

    # ---- state

    def _change(self, **fields: object) -> None:
        changed = replace(self._state, **{"latch": self._stops.latch, **fields})
        if changed != self._state:
            self._state = changed
            self._hub.broadcast(changed)

    def _tell_robot(self, state: Literal["off", "connecting", "playing"], text: str = "") -> None:
        assert self.document is not None
        reply = self.document.newest if self.document.newest.robot else self.document.good
        self._robot = (
            m.RobotChanged(
                state=state,
                port="" if reply is None else reply.port,
                is_simulated=reply is not None and reply.is_simulated,
                joints={},
                text=text,
            )
            .to_json()
            .decode()
        )
        self._hub.offer(ROBOT, self._robot)
