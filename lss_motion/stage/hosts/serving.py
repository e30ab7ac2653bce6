"""Serve one figure of a stage with several: `lss-motion serve STAGE.yaml --figure NAME`.

Without its pages, the conductor's computer plans the shows for all, and is told what to do by lines
of its input, which are operations of `playing.remote.schema`. The others need no operator.

With pages, it runs a `ConductorJob` in a process of its own, as `stage.job.StageJob` for one robot,
with the same operations and events. The players of all figures are processes of their own; that of
the conductor's figure is started from here.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import sys
import threading
import time
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec import field
from msgspec.structs import replace

from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.playing.remote.job import Outcome
from lss_motion.stage.hosts.conducting import ConductedStage, Offer
from lss_motion.stage.hosts.host import Host
from lss_motion.stage.hosts.peer import PORT, NetworkSettings, check_settings
from lss_motion.stage.hosts.plans import SEPARATOR, PlanStore, planned_stage
from lss_motion.stage.hosts.player_link import PlayerLink
from lss_motion.stage.job import DirectedJob, StageSteering
from lss_motion.stage.log import must_restart
from lss_motion.stage.model import TriggerKind
from lss_motion.stage.stage_timecode import StageTimecode
from lss_motion.system.messages import Kind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from contextlib import AbstractContextManager

    from lss_motion.playing.remote.schema import AnyOperation
    from lss_motion.robot.model import Robot
    from lss_motion.stage.model import Stage
    from lss_motion.stage.triggers.sources import Sink

    Sources = Callable[[Sink], AbstractContextManager[None]]

    from lss_motion.playing.player.player import Player
    from lss_motion.playing.remote.operator_end import Operator
    from lss_motion.stage.hosts.plans import PlannedCast
    from lss_motion.stage.log import Record

HELP: Final = (
    "keys, each with Enter: g GO · l SHOW play a show · p pause · r resume · v RATIO speed · "
    "j S jump to a show time · s STOP all · c CUE fire a cue · ? states · q end"
)


def settings_of(stage: Stage, figure: str, *, is_trusted: bool) -> NetworkSettings:
    """Return the network settings of one figure of a stage; raises `InputError`."""
    if not stage.figures or stage.conductor is None:
        raise InputError("has no figures: it is served without --figure", path=stage.path)
    if figure not in stage.figures:
        known = ", ".join(stage.figures)
        raise InputError(f"has no figure {figure!r}; there are {known}", path=stage.path)
    address = stage.figures[stage.conductor].address or ("127.0.0.1", PORT)
    host = f"[{address[0]}]" if ":" in address[0] else address[0]
    settings = NetworkSettings(
        stage=stage.name,
        figure=figure,
        conductor=stage.conductor,
        figures=tuple(stage.figures),
        address=f"{host}:{address[1]}",
        keys=stage.keys,
        scouting=stage.network.scouting or "",
        is_trusted=is_trusted,
    )
    check_settings(settings)
    return settings


def serve_figure(  # noqa: PLR0913  (what an operator may choose)
    stage: Stage,
    figure: str,
    *,
    port: str | None = None,
    trust_network: bool = False,
    starts: bool = False,
    folder: Path | None = None,
    is_real_time: bool = False,
    sources: Sources | None = None,
    print_line: Callable[[str], None],
) -> int:
    """Serve one figure until Ctrl-C or `q`; return the exit code.

    `port` replaces the port of its robot file. With `starts`, the conductor starts its first show
    as soon as all figures are there, else with GO. Plans are kept in `folder`, or else in the
    user's cache. `sources` opens the triggers at this figure, and hands over what arrives, in any
    thread. `print_line` prints what happens.
    """

    def log(text: str) -> None:
        print_line(f"{time.strftime('%H:%M:%S')} {figure}: {text}")

    host, robots = host_of(
        stage,
        figure,
        port=port,
        trust_network=trust_network,
        folder=folder,
        log=log,
        is_real_time=is_real_time,
    )
    typed = TypedOperations(stage, lambda: states(host), log)
    with contextlib.ExitStack() as stack:
        stack.callback(host.close)
        stack.enter_context(_signals(typed))
        if sources is not None:
            stack.enter_context(sources(typed.put))
        typed.read(sys.stdin)
        if host.conductor is None:
            log(f"is a figure of stage {stage.name!r}")
            while not typed.has_ended:
                host.turn()
                typed.carry_out(host.obey)
        else:
            log(f"conducts stage {stage.name!r}")
            run = conducted(stage, robots, host, log, starts=starts)

            def obey(operation: AnyOperation, origin: str) -> None:
                if not run.obey(operation):
                    host.obey(operation, origin)

            def act(_now_ns: int) -> bool:
                typed.carry_out(obey)
                return typed.has_ended

            conduct(host, run, act)
    return EXIT_FINISHED


def conducted(
    stage: Stage,
    robots: Mapping[str, Robot],
    host: Host,
    log: Callable[[str], None],
    *,
    starts: bool = False,
) -> ConductedStage:
    """Return a stage without pages, planned here: `log` gets what happens."""

    def write(record: dict[str, Any]) -> None:
        if "text" in record:
            log(record["text"])

    made = planned_stage(stage, robots)
    offers = {name: Offer(one.cast, one.contents) for name, one in made.items()}
    return ConductedStage(
        stage,
        offers,
        host,
        write,
        waits_for_go=not starts and stage.idle is not None,
        plays_first=starts,
    )


def conduct(host: Host, run: ConductedStage, act: Callable[[int], bool]) -> None:
    """Conduct until `act`, which is called each turn with the instant, returns true."""
    has_ended = False
    while not has_ended:
        host.turn()
        now_ns = time.monotonic_ns()
        while host.cues:
            run.take(*host.cues.popleft())
        run.turn(now_ns)
        has_ended = act(now_ns)
    run.note_counts()


def host_of(
    stage: Stage,
    figure: str,
    *,
    port: str | None = None,
    trust_network: bool = False,
    **options: Any,  # noqa: ANN401
) -> tuple[Host, dict[str, Robot]]:
    """Return the host of one figure, as `host_for`, and the robots of those that it knows.

    The conductor's knows all.
    """
    from lss_motion.playing.connection import with_port
    from lss_motion.robot.load import load_robot

    settings_of(stage, figure, is_trusted=trust_network)
    robots = {
        name: load_robot(one.robot_path)
        for name, one in stage.figures.items()
        if figure in (name, stage.conductor)
    }
    robot = with_port(robots[figure], port)
    more = {"trust_network": trust_network, "examines_port": port, **options}
    return host_for(stage, figure, robot, **more), robots


def host_for(
    stage: Stage,
    figure: str,
    robot: Robot,
    *,
    trust_network: bool = False,
    folder: Path | None = None,
    log: Callable[[str], None] = lambda _text: None,
    examines_port: str | None = None,
    **options: Any,  # noqa: ANN401
) -> Host:
    """Return the host of one figure with its robot; `options` are those of its `PlayerLink`."""
    from lss_motion import __version__
    from lss_motion.files.cache import cache_directory
    from lss_motion.stage.hosts.examine import examined
    from lss_motion.stage.hosts.peer import Peer

    settings = settings_of(stage, figure, is_trusted=trust_network)
    freewheel_s = stage.network.freewheel_s
    plans = folder or cache_directory() / "network"
    return Host(
        settings,
        robot,
        PlayerLink(robot, freewheel_s=freewheel_s, log=log, **options),
        PlanStore(plans),
        lambda instance: Peer(settings, clock_id=instance if settings.is_conductor else ""),
        version=__version__,
        others=stage.retry.others,
        log=log,
        examine=lambda number: examined(figure, number, robot, examines_port, plans),
    )


class TypedOperations:
    """Operations that were typed at this computer, or that its triggers sent: from any thread."""

    def __init__(
        self, stage: Stage, states: Callable[[], list[str]], log: Callable[[str], None]
    ) -> None:
        self.has_ended = False
        self._stage, self._states, self._log = stage, states, log
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._operations: queue.SimpleQueue[tuple[AnyOperation, str]] = queue.SimpleQueue()

    def put(self, operation: AnyOperation, origin: str) -> None:
        """Take what a trigger of this computer has sent."""
        self._operations.put((operation, origin))

    def type(self, line: str) -> None:
        """Take a line as if it had been typed."""
        self._lines.put(line)

    def read(self, lines: Iterable[str]) -> None:
        """Take lines as they come, in a thread."""

        def read() -> None:
            with contextlib.suppress(ValueError, OSError):
                for line in lines:
                    self._lines.put(line)

        threading.Thread(target=read, daemon=True).start()

    def carry_out(self, obey: Callable[[AnyOperation, str], None]) -> None:
        """Let `obey` carry out what has come; log what it refuses."""
        while not self._lines.empty():
            words = self._lines.get().split()
            if words == ["q"]:
                self.has_ended = True
            elif words == ["?"]:
                for text in self._states():
                    self._log(text)
            elif words:
                self._do(lambda words=words: obey(operation_of(words, self._stage), "keyboard"))  # type: ignore[misc]
        while not self._operations.empty():
            operation, origin = self._operations.get()
            self._do(lambda operation=operation, origin=origin: obey(operation, origin))  # type: ignore[misc]

    def _do(self, call: Callable[[], None]) -> None:
        try:
            call()
        except InputError as refused:
            self._log(f"refused: {refused}")


def operation_of(words: Sequence[str], stage: Stage) -> AnyOperation:
    """Return the operation that a typed line means; raise `InputError` with what there is."""
    letter, *rest = words
    plain: dict[str, type[m.Go | m.Stop | m.Pause | m.Resume]] = {
        "g": m.Go,
        "s": m.Stop,
        "p": m.Pause,
        "r": m.Resume,
    }
    has_go = stage.idle is not None or any(one.on.kind is TriggerKind.GO for one in stage.cues)
    match letter, rest:
        case "g", [] if not has_go:
            return s.StagePlay(show=next(iter(stage.shows)))
        case _, [] if letter in plain:
            return plain[letter]()
        case "l", [show]:
            return s.StagePlay(show=show)
        case "c", [cue]:
            return s.FireCue(label=cue)
        case "v", _:
            return _with_number("rate", "ratio", rest, "v needs a share of the speed: v 0.5")
        case "j", _:
            return _with_number("seek", "to", rest, "j needs a show time in seconds: j 12.5")
    raise InputError(HELP)


def _with_number(op: str, field: str, words: Sequence[str], remedy: str) -> AnyOperation:
    try:
        (word,) = words
        return m.parse_operation(json.dumps({"op": op, field: float(word)}))
    except (ValueError, InputError):
        raise InputError(remedy) from None


def states(host: Host) -> list[str]:
    """Return the state of every figure that this computer knows, a line each."""
    conductor = host.conductor
    if conductor is None:
        return [f"{host.figure.name}: {host.figure.state} {host.figure.text}".rstrip()]
    found = []
    for name, one in conductor.figures.items():
        status = one.status
        if status is None:
            found.append(f"{name}: not connected")
            continue
        bound = "" if status.bound_ns is None else f", clock ± {status.bound_ns / 1e6:.2f} ms"
        show = "" if status.show_s is None else f", at {status.show_s:.2f} s"
        off = "" if status.off_s is None else f" ({1e3 * status.off_s:+.1f} ms)"
        text = f": {status.text or one.problem}" if status.text or one.problem else ""
        state = "lost" if one.is_lost(time.monotonic_ns()) else status.state
        found.append(f"{name}: {state}{show}{off}{bound}{text}")
    return found


@contextlib.contextmanager
def _signals(typed: TypedOperations):  # type: ignore[no-untyped-def]  # noqa: ANN202
    """End at the first signal; the second one ends this process at once."""

    def note(number: int, _frame: object) -> None:
        if typed.has_ended:
            os._exit(128 + number)
        typed.has_ended = True

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


PASSED_ON: Final = frozenset({"checked", "mark", "fault", "phase"})
"""Events of the conductor's own player that operators get."""


def conductor_job(
    stage: Stage, made: Mapping[str, PlannedCast], robot: Robot, hashes: Mapping[str, str]
) -> ConductorJob:
    """Return the job of a planned stage; `hashes` are those of the conductor's own programs."""
    is_joined = any("" in one.shows for one in made.values())
    return ConductorJob(
        stage=replace(stage, robot=None),
        offers={name: Offer(one.cast, one.contents) for name, one in made.items()},
        robot=robot,
        prefix=f"{stage.conductor}{SEPARATOR}" if is_joined else "",
        hashes=dict(hashes),
    )


class ConductorJob(DirectedJob, frozen=True, kw_only=True):
    """A planned stage with figures, for the computer of its conductor.

    `options`: `waits_for_go`, `start_at`, `is_real_time`, `may_run`, `seed`, `goes` (play the first
    show when all are there), `trusts_network`, `plans`.
    """

    stage: Stage
    offers: Mapping[str, Offer]
    robot: Robot
    prefix: str = ""
    """Before the names of its joints on the pages, where a show has the joints of all."""
    hashes: Mapping[str, str] = field(default_factory=dict)
    """Of the program of the own figure, by show."""

    @property
    def plans(self) -> dict[str, bytes]:
        return {show: bytes.fromhex(plan) for show, plan in self.hashes.items()}

    def renew(self, run: ConductedStage, player: Player | None) -> tuple[str, str]:  # noqa: ARG002
        if self.robot != run.robot:
            return must_restart("another robot")
        return run.renew(self.stage, self.offers)

    def _steering(self, operator: Operator) -> ConductorSteering:
        return ConductorSteering(operator, self)

    def _play(self, steering: StageSteering, stack: contextlib.ExitStack) -> Outcome:
        options, given, operator = self.options, self.stage.sync.timecode, steering.operator
        assert isinstance(steering, ConductorSteering)
        log, legs = self._open(self.stage, steering, stack)
        start_at = options.get("start_at")

        def pass_on(kind: Kind, content: bytes) -> None:
            if kind is Kind.TELEMETRY:
                operator.link.offer(kind, content)
            elif kind is Kind.EVENT:
                steering.pass_on(m.parse_event(content))

        def write(record: Record) -> None:
            log.write(record)
            steering.note(record)

        host = host_for(
            self.stage,
            self.stage.conductor or "",
            self.robot,
            trust_network=bool(options.get("trusts_network")),
            folder=None if options.get("plans") is None else Path(options["plans"]),
            log=steering.log,
            pass_on=pass_on,
            new_stop_end=operator.new_stop_end,
            is_real_time=bool(options.get("is_real_time")),
            may_run=bool(options.get("may_run")),
        )
        stack.callback(host.close)
        run = steering.conducted = ConductedStage(
            self.stage,
            self.offers,
            host,
            write,
            robot=self.robot,
            timecode=None if given is None else StageTimecode(given, legs),
            waits_for_go=bool(options.get("waits_for_go")),
            start_at=None if start_at is None else datetime.fromisoformat(start_at),
            seen=log.seen,
            seed=options.get("seed"),
            plays_first=bool(options.get("goes")),
        )
        joints = (self.prefix + name for name in self.robot.joints)
        steering.begin(run, self.robot, joints, self.plans)
        run.record("begins", "the stage begins")

        def act(now_ns: int) -> bool:
            steering.act(None, now_ns)
            return steering.has_stopped

        conduct(host, run, act)
        return Outcome(None, None)


class ConductorSteering(StageSteering):
    """Operators of a stage with figures."""

    def __init__(self, operator: Operator, job: ConductorJob) -> None:
        super().__init__(operator, job.rule)
        self._job = job
        self.conducted: ConductedStage | None = None

    def pass_on(self, event: m.AnyEvent) -> None:
        """Let operators see what the player of the own figure does."""
        prefix = self._job.prefix
        if isinstance(event, m.Started):
            joints = tuple(prefix + name for name in event.joints)
            self.start(replace(event, name=self._job.stage.name, joints=joints), self._job.robot)
        elif isinstance(event, m.Health):
            named = {prefix + name: one for name, one in event.joints.items()}
            self.operator.offer(replace(event, joints=named))
        elif event.event in PASSED_ON:
            self.operator.send(event)

    def log(self, text: str) -> None:
        """Keep a line of the host, for the log and the pages."""
        if self.conducted is not None:
            self.conducted.record("network", text)

    def _direct(self, operation: m.AnyOperation) -> bool:
        assert self.conducted is not None
        is_done = self.conducted.obey(operation)
        if isinstance(operation, m.Pause | m.Resume | m.Rate):
            legs = self.conducted.conductor.legs
            self.operator.send(m.RateChanged(ratio=legs.speed, is_paused=legs.is_paused))
        return is_done
