"""Serve one figure of a stage with several: `lss-motion serve STAGE.yaml --figure NAME`.

The conductor's computer plans the shows for all, when they are needed, and is told what to do by
lines of its input (`Commands`), or by what else holds a `Host`. The others need no operator.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import queue
import signal
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from lss_motion.errors import EXIT_FINISHED, InputError, LssMotionError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.stage.hosts.host import Host
from lss_motion.stage.hosts.plans import PlanStore, planned_cast
from lss_motion.stage.hosts.player_link import PlayerLink
from lss_motion.stage.hosts.settings import PORT, NetworkSettings, check_settings

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from concurrent.futures import Future
    from contextlib import AbstractContextManager
    from pathlib import Path

    from lss_motion.playing.remote.schema import AnyOperation
    from lss_motion.robot.model import Robot
    from lss_motion.stage.hosts.plans import PlannedCast
    from lss_motion.stage.model import Stage

    Sources = Callable[["Take"], AbstractContextManager[None]]

HELP: Final = (
    "keys, each with Enter: g GO · l SHOW load a show · p pause · r resume · v RATIO speed · "
    "j S jump to a show time · s STOP all · c CUE fire a cue · ? states · q end"
)


class Take(Protocol):
    """Takes what a source of triggers has received, from any thread."""

    def __call__(self, operation: AnyOperation, origin: str) -> None: ...


def begin_planner() -> None:
    """Prepare the process that plans: Ctrl-C is not for it, and it ends with who started it.

    A worker of a pool whose parent was killed would wait for work for ever.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(0)


def settings_of(stage: Stage, figure: str, *, is_trusted: bool) -> NetworkSettings:
    """Return the network settings of one figure of a stage."""
    if not stage.figures or stage.conductor is None:
        raise InputError("has no figures: it is served without --figure", path=stage.path)
    if figure not in stage.figures:
        known = ", ".join(stage.figures)
        raise InputError(f"has no figure {figure!r}; there are {known}", path=stage.path)
    address = stage.figures[stage.conductor].address or ("127.0.0.1", PORT)
    host = f"[{address[0]}]" if ":" in address[0] else address[0]
    return NetworkSettings(
        stage=stage.name,
        figure=figure,
        conductor=stage.conductor,
        figures=tuple(stage.figures),
        address=f"{host}:{address[1]}",
        keys=stage.network.keys,
        scouting=stage.network.scouting or "",
        is_trusted=is_trusted,
    )


def serve_figure(
    stage: Stage,
    figure: str,
    *,
    port: str | None = None,
    trust_network: bool = False,
    starts: bool = False,
    folder: Path | None = None,
    is_real_time: bool = False,
    sources: Sources | None = None,
) -> int:
    """Serve one figure until Ctrl-C or `q`; return the exit code.

    `port` replaces the port of its robot file. With `starts`, the conductor starts its first show
    as soon as all figures are ready. Plans are kept in `folder`, or else in the user's cache.
    `sources` opens the triggers at this figure, and hands over what arrives, in any thread.
    """
    log = _log(figure)
    host, robots = host_of(
        stage,
        figure,
        port=port,
        trust_network=trust_network,
        folder=folder,
        log=log,
        is_real_time=is_real_time,
    )
    settings = host.settings
    log(f"{'conducts' if settings.is_conductor else 'is a figure of'} stage {stage.name!r}")
    commands = Commands(host, stage, robots, log, starts=starts)
    with contextlib.ExitStack() as stack:
        stack.enter_context(_signals(commands))
        if sources is not None:
            stack.enter_context(sources(commands.put_operation))
        try:
            while not commands.has_ended:
                host.turn()
                commands.turn()
        finally:
            commands.close()
            host.close()
    return EXIT_FINISHED


def host_of(
    stage: Stage,
    figure: str,
    *,
    port: str | None = None,
    trust_network: bool = False,
    folder: Path | None = None,
    log: Callable[[str], None] = lambda _text: None,
    is_real_time: bool = False,
) -> tuple[Host, dict[str, Robot]]:
    """Return the host of one figure, and the robots that it knows: the conductor's knows all."""
    from lss_motion.playing.connection import with_port
    from lss_motion.robot.load import load_robot

    check_settings(settings_of(stage, figure, is_trusted=trust_network))
    robots = {
        name: load_robot(one.robot_path)
        for name, one in stage.figures.items()
        if figure in (name, stage.conductor)
    }
    robot = with_port(robots[figure], port)
    host = host_for(
        stage,
        figure,
        robot,
        trust_network=trust_network,
        folder=folder,
        log=log,
        is_real_time=is_real_time,
        examines_port=port,
    )
    return host, robots


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
    check_settings(settings)
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
        freewheel_s=freewheel_s,
        log=log,
        examine=lambda number: examined(figure, number, robot, examines_port, plans),
    )


class Commands:
    """What the lines of standard input mean; and the planner of the conductor."""

    def __init__(
        self,
        host: Host,
        stage: Stage,
        robots: dict[str, Robot],
        log: Callable[[str], None],
        *,
        starts: bool = False,
    ) -> None:
        self.has_ended = False
        self._host, self._stage, self._robots, self._log = host, stage, robots, log
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._operations: queue.SimpleQueue[tuple[AnyOperation, str]] = queue.SimpleQueue()
        # A plan in this process would keep it from sending beats, and figures would hold.
        self._planners = ProcessPoolExecutor(
            1,
            multiprocessing.get_context("spawn"),
            begin_planner,
        )
        self._plan: tuple[str, Future[PlannedCast]] | None = None
        self._starts = starts
        threading.Thread(target=self._read, daemon=True).start()
        if host.conductor is not None and stage.shows:
            self.load(stage.idle or next(iter(stage.shows)))

    def put(self, line: str) -> None:
        """Take a line as if it had been typed."""
        self._lines.put(line)

    def put_operation(self, operation: AnyOperation, origin: str) -> None:
        """Take what a source of this computer has received; from any thread."""
        self._operations.put((operation, origin))

    def _pass_on(self, operation: AnyOperation, origin: str) -> None:
        """Hand a trigger to the conductor; a stop is carried out here, too."""
        match operation:
            case s.Trigger():
                self._host.trigger(
                    operation.kind,
                    operation.address,
                    operation.value,
                    operation.channel,
                    operation.source or origin,
                )
            case s.Cue():
                self._host.cue(operation.label)
            case m.Go():
                self._do(self._host.go)
            case m.Stop() | m.Estop():
                self._host.stop()
            case _:
                self._log(f"{origin}: {operation.op} is for the conductor's computer")

    def load(self, show: str) -> None:
        """Plan a show for all figures, in a process of its own."""
        if show not in self._stage.shows:
            self._log(f"no show {show!r}; there are {', '.join(self._stage.shows)}")
        elif self._plan is None:
            paths = self._stage.shows[show].paths
            source = next(iter(paths.values())) if "" in paths else dict(paths)
            conductor = self._stage.conductor or ""
            made = self._planners.submit(planned_cast, show, source, self._robots, conductor)
            self._plan = (show, made)

    def turn(self) -> None:
        """Do what was typed, and what was asked for by other computers."""
        if self._plan is not None and self._plan[1].done():
            (show, made), self._plan = self._plan, None
            try:
                planned = made.result()
                self._do(partial(self._host.load, planned.cast, planned.contents))
            except (LssMotionError, BrokenProcessPool) as error:
                self._log(f"show {show!r} cannot be planned: {error}")
        while not self._lines.empty():
            self._obey(self._lines.get().split())
        while not self._operations.empty():
            self._pass_on(*self._operations.get())
        while self._host.cues:
            figure, ask = self._host.cues.popleft()
            if ask.what == "go":
                self._do(self._host.go)
            else:
                self._fire(ask.cue, figure)
        conductor = self._host.conductor
        is_loaded = conductor is not None and conductor.wanted == "ready"
        if self._starts and is_loaded and self._host.are_all_ready():
            self._starts = False
            self._do(self._host.go)

    def _obey(self, words: list[str]) -> None:
        match words:
            case ["g"]:
                self._do(self._host.go)
            case ["s"]:
                self._host.stop()
            case ["q"]:
                self.has_ended = True
            case ["l", show]:
                self.load(show)
            case ["c", cue]:
                self._host.cue(cue)
            case ["p" | "r" | "v" | "j", *rest]:
                self._do(lambda: self._steer(words[0], rest))
            case ["?"]:
                for line in states(self._host):
                    self._log(line)
            case []:
                pass
            case _:
                self._log(HELP)

    def _steer(self, word: str, rest: list[str]) -> None:
        conductor = self._host.conductor
        if conductor is None:
            raise InputError(f"{self._stage.conductor} conducts this stage")
        now_ns = time.monotonic_ns()
        if word == "p":
            conductor.pause(now_ns)
        elif word == "r":
            conductor.resume(now_ns)
        elif word == "v":
            ratio = _number(rest, "v needs a share of the speed of the plan: v 0.5")
            self._log(f"speed {conductor.set_rate(ratio, now_ns):g}")
        else:
            conductor.seek(_number(rest, "j needs a show time in seconds: j 12.5"), now_ns)

    def _fire(self, name: str, figure: str) -> None:
        """Fire a cue that a figure asked for: its show, or what it does."""
        cue = self._stage.cue(name)
        if cue is None:
            self._log(f"figure {figure} asks for cue {name!r}, which the stage does not have")
        elif cue.deed == "stop":
            self._host.stop()
        elif cue.shows:
            self._starts = True
            self.load(cue.shows[0])

    def _do(self, call: Callable[[], object]) -> None:
        try:
            call()
        except InputError as refused:
            self._log(f"refused: {refused}")

    def close(self) -> None:
        """End the planner."""
        self._planners.shutdown(wait=False, cancel_futures=True)

    def _read(self) -> None:
        with contextlib.suppress(ValueError, OSError):
            for line in sys.stdin:
                self._lines.put(line)


def _number(words: Sequence[str], remedy: str) -> float:
    """Return the one finite number that was typed, or raise `InputError` with the remedy."""
    try:
        (word,) = words
        number = float(word)
    except ValueError:
        raise InputError(remedy) from None
    if not math.isfinite(number):
        raise InputError(remedy)
    return number


def states(host: Host) -> list[str]:
    """Return the state of every figure that this computer knows, a line each."""
    conductor = host.conductor
    if conductor is None:
        return [f"{host.figure.name}: {host.figure.state} {host.figure.text}".rstrip()]
    found = []
    for name, seat in conductor.seats.items():
        status = seat.status
        if status is None:
            found.append(f"{name}: not connected")
            continue
        bound = "" if status.bound_ns is None else f", clock ± {status.bound_ns / 1e6:.2f} ms"
        show = "" if status.show_s is None else f", at {status.show_s:.2f} s"
        off = "" if status.off_s is None else f" ({1e3 * status.off_s:+.1f} ms)"
        text = f": {status.text or seat.problem}" if status.text or seat.problem else ""
        state = "lost" if seat.is_lost(time.monotonic_ns()) else status.state
        found.append(f"{name}: {state}{show}{off}{bound}{text}")
    return found


def _log(figure: str) -> Callable[[str], None]:
    def log(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.write(f"{time.strftime('%H:%M:%S')} {figure}: {text}\n")
            sys.stdout.flush()

    return log


@contextlib.contextmanager
def _signals(commands: Commands):  # type: ignore[no-untyped-def]  # noqa: ANN202
    """End at the first signal; the second one ends this process at once."""

    def note(number: int, _frame: object) -> None:
        if commands.has_ended:
            os._exit(128 + number)
        commands.has_ended = True

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
