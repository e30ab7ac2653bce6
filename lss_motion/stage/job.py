"""What the process of the player does for a stage, and its client: the operations and the state.

`StageJob` is given to `playing.remote.process`, as `playing.remote.job.Job` is for one show.
`StageSteering` hands the triggers and wishes of the client to the director, and sends what the
stage does: each note as `stage_note`, and the whole state as `stage`, so that a client that comes
later needs only the last.
"""

from __future__ import annotations

import contextlib
import pickle
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol

import msgspec
from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError, LssMotionError
from lss_motion.files.texts import known_names
from lss_motion.playing.joint_view import JointView
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.job import Outcome
from lss_motion.playing.remote.message import plan_hash
from lss_motion.playing.remote.player_end import LossRule, Steering
from lss_motion.stage.log import StageLog, must_restart
from lss_motion.stage.model import Signal, TriggerKind
from lss_motion.stage.running import Options, StageRun
from lss_motion.stage.stage_timecode import opened, spec_of
from lss_motion.system.messages import plain
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.playing.player.player import Player
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.robot.model import Robot
    from lss_motion.stage.check import Planned
    from lss_motion.stage.director import Director
    from lss_motion.stage.log import Record
    from lss_motion.stage.model import Stage
    from lss_motion.stage.stage_timecode import StageTimecode
    from lss_motion.stage.timecode.source import TimecodeSource

RENEW_MAX_BYTES: Final = 1_000_000
"""Chosen: read in some 20 ms, by which no move is late that matters; an hour of six joints."""
STATE_NS: Final = NS_PER_S
"""The state is sent this often, and after each note."""


class DirectedJob(Struct, frozen=True, kw_only=True):
    """What the jobs of a stage with one robot and of a conductor share.

    `options`: `log_folder`, if it is not that of the stage, and those of the subclass.
    """

    rule: LossRule = field(default_factory=LossRule)
    options: dict[str, Any] = field(default_factory=dict)

    def run(self, operator: Operator) -> Outcome:
        """Play the stage with this client as its operator; send the first and the last event."""
        steering = self._steering(operator)
        try:
            with contextlib.ExitStack() as stack:
                outcome = self._play(steering, stack)
        except LssMotionError as refused:
            outcome = Outcome(None, refused)
        steering.note_log(is_last=True)
        steering.end(outcome.message)
        return outcome

    @property
    def plans(self) -> dict[str, bytes]:
        """The names of the plans that the own robot plays, by show."""
        raise NotImplementedError

    def renew(self, run: Any, player: Player | None) -> tuple[str, str]:  # noqa: ANN401  (its own)
        """Let the run go on with the files of this job; return kind and text of what came of it."""
        raise NotImplementedError

    def _steering(self, operator: Operator) -> StageSteering:
        return StageSteering(operator, self.rule)

    def _play(self, steering: StageSteering, stack: contextlib.ExitStack) -> Outcome:
        raise NotImplementedError

    def _open(
        self, stage: Stage, steering: StageSteering, stack: contextlib.ExitStack, **options: bool
    ) -> tuple[StageLog, TimecodeSource | None]:
        """Open the log, and the timecode, which virtual time (`is_virtual`) does not have."""
        rule, given, folder = stage.log, stage.sync.timecode, self.options.get("log_folder")
        if folder is not None:
            rule = replace(rule, folder=Path(folder))
        log = steering.kept = stack.enter_context(StageLog(rule, **options))
        if given is None or options.get("is_virtual"):
            return log, None
        from lss_motion.stage.timecode.source import TimecodeSource

        return log, stack.enter_context(TimecodeSource(spec_of(given), is_lasting=True))


class StageJob(DirectedJob, frozen=True, kw_only=True):
    """A planned stage with one robot, and how it is run.

    `options` are fields of `running.Options`, `start_at` as an ISO text; others are those of
    `playing.run.RunOptions`.
    """

    planned: Planned

    @property
    def plans(self) -> dict[str, bytes]:
        return {name: plan_hash(show.program) for name, show in self.planned.shows.items()}

    def renew(self, run: StageRun, player: Player | None) -> tuple[str, str]:
        return run.renew(self.planned, player)

    def _play(self, steering: StageSteering, stack: contextlib.ExitStack) -> Outcome:
        options, stage = options_of(self.options), self.planned.stage
        log, legs = self._open(stage, steering, stack, is_virtual=options.is_virtual)
        options.seen = log.seen
        texts: list[str] = []
        sends = () if options.is_virtual else stage.sync.send
        outs = opened(sends, stack, texts.append)
        run = StageRun(
            self.planned, options, steerer=steering, note=log.write, legs=legs, outs=outs
        )
        moved = {name for one in run.programs.values() for name in one.start_deg}
        servos = filter(moved.__contains__, run.robot.servo_robot.joints)
        steering.begin(run, run.robot, JointView(run.robot).joints_of(servos), self.plans)
        run.record("begins", "the stage begins")
        for text in texts:
            run.record("timecode", f"timecode: {text}")
        end = run.play()
        run.note_counts(is_last=True)
        return Outcome(None if end.last is None else end.last.report, end.error)


def options_of(given: dict[str, Any]) -> Options:
    """Return the options of a run; those that are not its own are `more`."""
    own = {name: value for name, value in given.items() if name in Options.__slots__}
    rest = {name: value for name, value in given.items() if name not in {*own, "log_folder"}}
    for name in ("start_at", "begins"):
        if isinstance(own.get(name), str):
            own[name] = datetime.fromisoformat(own[name])
    own["more"] = {**own.get("more", {}), **rest}
    return Options(**own)


def signal_of(operation: s.Trigger | s.FireCue | m.Go, stage: Stage) -> Signal:
    """Return the signal of an operation; raise `InputError` for a cue that there is not."""
    match operation:
        case s.Trigger():
            return Signal(
                kind=TriggerKind(operation.kind),
                address=operation.address,
                value=operation.value,
                channel=operation.channel,
                source=operation.source,
            )
        case s.FireCue():
            if stage.cue(operation.label) is None:
                known = known_names(operation.label, [cue.name for cue in stage.cues])
                raise InputError(f"no cue {operation.label!r}; {known}")
            return Signal(kind=TriggerKind.CUE, address=operation.label, source=operation.source)
        case _:
            return Signal(kind=TriggerKind.GO)


class Directed(Protocol):
    """What a client steers: a stage with one robot, or with figures."""

    stage: Stage
    director: Director
    timecode: StageTimecode | None
    now_ns: int

    def state_of(self) -> Record: ...

    def record(self, kind: str, text: str) -> None:
        """Keep what happened, with the time of day."""


def direct(run: Directed, operation: m.AnyOperation) -> bool:
    """Hand an operation to the director of a stage; return whether it is one of a stage."""
    director, now_ns = run.director, run.now_ns
    match operation:
        case s.Trigger() | s.FireCue() | m.Go():
            director.signal(signal_of(operation, run.stage), now_ns)
        case m.Follow() if run.timecode is not None:
            run.timecode.take(operation, now_ns)
        case s.Enable():
            director.enable(operation.cue, is_enabled=operation.is_enabled)
        case s.Arm():
            director.arm(operation.cue)
        case s.StagePlay():
            director.play(operation.show, now_ns)
        case s.StageStop():
            director.do("stop", now_ns)
        case s.StageRest():
            director.do("rest", now_ns)
        case s.StageWake():
            director.do("wake", now_ns)
        case _:
            return False
    return True


class StageSteering(Steering):
    """A client that steers a stage, also between two runs of the player."""

    def __init__(self, operator: Operator, rule: LossRule | None = None) -> None:
        super().__init__(operator, rule)
        self._run: Directed | None = None
        self.kept: StageLog | None = None
        """The log of the stage, to say when it cannot be written."""
        self._stated_ns = 0
        self._has_news = True

    @property
    def has_stopped(self) -> bool:
        """Whether the stage is to end."""
        return self._has_stopped

    @property
    def rate(self) -> float:
        """The rate that the client has set; 0: paused."""
        return 0.0 if self._is_paused else self._rate

    def begin(
        self, run: Directed, robot: Robot, joints: Iterable[str], plans: dict[str, bytes]
    ) -> None:
        """Send the first event of a stage."""
        self._run, self.plans = run, plans
        self.start_many(run.stage.name, robot, joints)

    # ---- controls

    def act(self, player: Player | None, now_ns: int) -> None:
        """Apply what has arrived; between two runs there is no player."""
        if player is not None:
            super().act(player, now_ns)
        else:
            self._act_alone(now_ns)
        for job in self.operator.take_objects():
            self._renew(job, player)
        self._state(now_ns)

    def _renew(self, job: bytes, player: Player | None) -> None:
        """Go on with newer files, or note why the stage must begin anew for them."""
        assert self._run is not None
        if player is not None and len(job) > RENEW_MAX_BYTES:
            reason = f"they have {len(job) / 1e6:.1f} MB, too much to be read beside moves"
            self._run.record(*must_restart(reason))
            return
        newer: DirectedJob = pickle.loads(job)  # noqa: S301  (from the server that started this)
        kind, text = newer.renew(self._run, player)
        self._run.record(kind, text)
        if kind == "renewed":
            self.plans = newer.plans

    def _watch(self, player: Player, now_ns: int) -> None:
        """End the stage when the server is gone: nothing could ever end it, and it has no end."""
        if self.operator.is_cut and not self._has_stopped:
            self._stop(player, now_ns)
        else:
            super()._watch(player, now_ns)

    def _act_alone(self, now_ns: int) -> None:
        if self.operator.take_signals():
            self._has_stopped = True
        for operation in self.operator.take(now_ns):
            try:
                self._apply_alone(operation)
            except InputError as refused:
                self.operator.refuse(operation, str(refused))
            else:
                self.operator.accept(operation)
        self.operator.look_for_client()
        is_silent = self.operator.is_lost(now_ns, self._rule.silent_s)
        if self.operator.is_cut or (is_silent and self._rule.on_lost == "stop"):
            self._has_stopped = True
        self.operator.link.flush()

    def _apply_alone(self, operation: m.AnyOperation) -> None:
        if isinstance(operation, m.Stop | m.Estop):
            self._has_stopped = True
        elif not isinstance(operation, m.Beat) and not self._direct(operation):
            raise InputError(f"{operation.op} is for a robot that is connected: not now")

    def _apply(self, operation: m.AnyOperation, player: Player, now_ns: int) -> None:
        if not self._direct(operation):  # A run that ends plays no cue; the director notes that.
            super()._apply(operation, player, now_ns)

    def _direct(self, operation: m.AnyOperation) -> bool:
        """Hand an operation to the director; return whether it is one of a stage."""
        assert self._run is not None
        return direct(self._run, operation)

    def _apply_rate(self, player: Player, now_ns: int) -> None:  # noqa: ARG002
        """Send the rate that was asked for; the run sets it, together with that of the budgets."""
        wish = (self._rate, self._is_paused)
        if wish != self._applied and not self._has_stopped and not player.is_finished:
            self._applied = wish
            self.operator.send(m.RateChanged(ratio=self._rate, is_paused=self._is_paused))

    # ---- observer

    def note(self, record: Record) -> None:
        """Send a note of the stage."""
        if "kind" not in record or record["kind"] == "sample":
            return
        self._has_news = True
        self.operator.send(
            s.StageNote(
                kind=record["kind"],
                text=record["text"],
                cue=record.get("cue"),
                show=record.get("show"),
                count=record.get("count", 1),
            )
        )

    def note_log(self, *, is_last: bool = False) -> None:
        """Send what people have to know of the log: the log itself cannot say it."""
        for text in () if self.kept is None else self.kept.take_texts(is_last=is_last):
            self.note({"kind": "log", "text": text})

    def _state(self, now_ns: int) -> None:
        """Send the whole state, if there is news or it is due, and no move."""
        if self._run is None or (now_ns < self._stated_ns + STATE_NS and not self._has_news):
            return
        self.note_log()
        self._has_news, self._stated_ns = False, now_ns
        state = self._run.state_of()
        shown = state["show"]
        plan = None if shown is None else self.plans.get(shown)
        state["show_plan"] = None if plan is None else plan.hex()
        plain_state = msgspec.to_builtins(state, enc_hook=plain)
        self.operator.offer(msgspec.convert(plain_state, s.StageState))
