"""Serve one figure of a stage with several: `lss-motion serve STAGE.yaml --figure NAME`.

Without its pages, the conductor's computer plans the shows for all, and is told what to do by lines
of its input, which are operations of `playing.remote.schema`. The others need no operator.
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
from typing import TYPE_CHECKING, Any, Final

from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.stage.hosts.conducting import ConductedStage, Offer
from lss_motion.stage.hosts.host import Host
from lss_motion.stage.hosts.plans import PlanStore, planned_stage
from lss_motion.stage.hosts.player_link import PlayerLink
from lss_motion.stage.hosts.settings import PORT, NetworkSettings, check_settings
from lss_motion.stage.model import Kind

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from contextlib import AbstractContextManager
    from pathlib import Path

    from lss_motion.playing.remote.schema import AnyOperation
    from lss_motion.robot.model import Robot
    from lss_motion.stage.model import Stage
    from lss_motion.stage.triggers.sources import Sink

    Sources = Callable[[Sink], AbstractContextManager[None]]

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
        keys=stage.network.keys,
        scouting=stage.network.scouting or "",
        is_trusted=is_trusted,
    )
    check_settings(settings)
    return settings


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
    as soon as all figures are there, else with GO. Plans are kept in `folder`, or else in the
    user's cache. `sources` opens the triggers at this figure, and hands over what arrives, in any
    thread.
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
    has_go = stage.idle is not None or any(one.on.kind is Kind.GO for one in stage.cues)
    match letter, rest:
        case "g", [] if not has_go:
            return s.StagePlay(show=next(iter(stage.shows)))
        case _, [] if letter in plain:
            return plain[letter]()
        case "l", [show]:
            return s.StagePlay(show=show)
        case "c", [cue]:
            return s.Cue(label=cue)
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


def _log(figure: str) -> Callable[[str], None]:
    def log(text: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.write(f"{time.strftime('%H:%M:%S')} {figure}: {text}\n")
            sys.stdout.flush()

    return log


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
