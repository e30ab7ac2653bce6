"""What the freezing takes from the inside of the package: every import of it stands here.

Where a module moves or a class gets another shape, this file changes, and what it gives the cases
stays: the bytes of every simulated port, a stage in virtual time, and a stage of two computers.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import tempfile
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Self
from unittest.mock import patch

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from benches.stage_model import Host, World

NS_PER_S: Final = 1_000_000_000
CHILD: Final = Path(__file__).parent / "child"
WIRE_FOLDER: Final = "LSS_FREEZE_WIRE"
"""Environment variable: where processes that play by themselves write their bytes."""
PLANNING_S: Final = 0.2
"""So long a walk planner needs here, whatever the computer does."""


@dataclass
class Wire:
    """What passed the simulated ports, in the order in which they were opened."""

    lines: list[str] = field(default_factory=list)
    ports: int = 0

    def add(self, port: int, way: str, data: bytes, now_ns: int) -> None:
        text = data.decode("latin-1").replace("\r", "\\r")
        self.lines.append(f"{now_ns / NS_PER_S:.9f} {port} {way} {text}\n")

    @property
    def text(self) -> str:
        return "".join(self.lines)


@contextlib.contextmanager
def wire() -> Iterator[Wire]:
    """Record what passes each simulated port that is opened in this process."""
    from lss_motion.sim.bus import SimPort

    kept = Wire()

    class Recorded(SimPort):
        def __init__(self, *arguments: Any) -> None:  # noqa: ANN401
            super().__init__(*arguments)
            kept.ports += 1
            self._number = kept.ports

        def write(self, data: bytes) -> None:
            kept.add(self._number, ">", data, self._clock.now_ns())
            super().write(data)

        def read(self) -> bytes:
            if data := super().read():
                kept.add(self._number, "<", data, self._clock.now_ns())
            return data

    with patch(f"{SimPort.__module__}.SimPort", Recorded):
        yield kept


@contextlib.contextmanager
def wire_of_all() -> Iterator[Wire]:
    """Record as `wire`, also in the processes that are started meanwhile, one after the other."""
    path = os.pathsep.join([str(CHILD), os.environ["PYTHONPATH"]])
    with tempfile.TemporaryDirectory() as folder, wire() as kept:
        with patch.dict(os.environ, {WIRE_FOLDER: folder, "PYTHONPATH": path}):
            yield kept
        kept.lines += [file.read_text("utf-8") for file in sorted(Path(folder).iterdir())]


def record_this_process() -> None:
    """Write what this process plays to a file in the folder that is asked for, at its end."""
    folder, stack = Path(os.environ[WIRE_FOLDER]), contextlib.ExitStack()
    kept = stack.enter_context(wire())

    def write() -> None:
        stack.close()
        if kept.lines:
            path = folder / f"{len(list(folder.iterdir())):03d}"
            path.write_text(kept.text, encoding="utf-8", newline="\n")

    atexit.register(write)


@contextlib.contextmanager
def planner_in_process() -> Iterator[None]:
    """Let the planner of a walk plan here, and always take `PLANNING_S`."""
    from local_planner import LocalPlanner

    from lss_motion.playing.walking import planner

    class InProcess(LocalPlanner):
        planning_s = PLANNING_S

        def __init__(self, *arguments: Any) -> None:  # noqa: ANN401
            super().__init__(planner.WalkPlanner(*arguments), lambda: PLANNING_S)
            self._ends = os.pipe()

        def fileno(self) -> int:
            return self._ends[0]

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None:
            for end in self._ends:
                os.close(end)

    with patch.object(planner, "PlannerProcess", InProcess):
        yield


# ---- a stage


@dataclass
class Evening:
    """A stage in virtual time: `acts` are what arrives from outside, `(at_s, kind, address)`.

    The kinds are those of triggers, and `cue`, `play`, `enable`, `disable`, `rest`, `wake`, `stop`.
    """

    acts: list[tuple[float, str, str]]
    run: Any = None
    has_stopped: Final = False
    rate: Final = 1.0

    def filenos(self) -> tuple[int, ...]:
        return ()

    def act(self, _player: object, _now_ns: int) -> None:
        while self.acts and self.acts[0][0] * NS_PER_S <= self.run.now_ns:
            self._do(*self.acts.pop(0)[1:])

    def on_event(self, _event: object) -> None: ...

    def on_turn(self, _player: object, _now_ns: int) -> None: ...

    def note(self, _record: object) -> None: ...

    def _do(self, kind: str, address: str) -> None:
        from lss_motion.stage.model import Signal, TriggerKind

        director, now_ns = self.run.director, self.run.now_ns
        match kind:
            case "play":
                director.play(address, now_ns)
            case "enable" | "disable":
                director.enable(address, is_enabled=kind == "enable")
            case "rest" | "wake" | "stop":
                director.do(kind, now_ns)
            case _:
                signal = Signal(kind=TriggerKind(kind), address=address, value=1.0, source="script")
                director.signal(signal, now_ns)


def play_stage(
    path: str, lasts_s: float, acts: list[tuple[float, str, str]], faults: str = ""
) -> Iterator[tuple[str, Any]]:
    """Play a stage; yield `record`s of its log and `report`s of its runs, as plain values."""
    from lss_motion.sim.faults import load_faults
    from lss_motion.stage.check import plan_stage
    from lss_motion.stage.load import load_stage
    from lss_motion.stage.running import Options, StageRun

    found: list[tuple[str, Any]] = []
    planned = plan_stage(load_stage(path))
    given = load_faults(faults, planned.stage.robot) if faults else ()
    begins = datetime(2026, 10, 30, 18, tzinfo=UTC)
    options = Options(
        is_virtual=True,
        begins=begins,
        lasts_s=lasts_s,
        seed=1,
        next_faults=lambda began_ns: given if not began_ns else (),
    )
    evening = Evening(sorted(acts))

    def note(record: Mapping[str, Any]) -> None:
        if "t" not in record:  # The bytes before a fault, in the form of a log.
            found.append(("dump", record["dump"]))
            return
        at_s = (datetime.fromisoformat(record["t"]) - begins).total_seconds()
        found.append(("record", {**record, "t": at_s}))

    run = StageRun(planned, options, steerer=evening, note=note)
    evening.run = run
    run.play(lambda result, _: found.append(("report", result.report.to_dict())))
    run.note_counts(is_last=True)
    yield from found


# ---- a stage of several computers


def play_computers(
    parts: Mapping[str, str], script: list[tuple[float, Callable[[World], None]]]
) -> Iterator[tuple[float, str, str]]:
    """Yield `(true second, computer, what)`: states, orders to its player, and what it says.

    `parts`: the show of each figure, which its player then plays as it was told.
    """
    from benches.network import played
    from benches.stage_model import World

    programs = [_compiled(path) for path in parts.values()]
    world = World(len(parts), seed=3, ppm=100.0, show_s=programs[0][0].duration_s)
    world.go()
    began_ns, marks = world.now_ns, dict.fromkeys(world.hosts, 0)
    states: dict[str, str] = {}
    for at_s, do in [*script, (120.0, lambda _: None)]:
        while world.now_ns < began_ns + at_s * NS_PER_S:
            world.run(0.1)
            for host in world.hosts.values():
                yield from _news(world, host, states, marks)
            yield from ((world.now_ns / NS_PER_S, "conductor", one) for one in world.notes)
            world.notes.clear()
            if all(host.player.does == "ended" for host in world.hosts.values()):
                break
        do(world)
    for (program, robot), host in zip(programs, world.hosts.values(), strict=True):
        for follow in host.player.follows:
            yield follow[0] / NS_PER_S, host.name, repr(follow[1])
        for arrived_ns in played(program, robot, host.player.follows):
            yield arrived_ns / NS_PER_S, host.name, "a move arrives"


def _compiled(path: str) -> tuple[Any, Any]:
    import lss_motion as lss

    sequence = lss.load_sequence(path)
    robot = lss.load_robot(sequence.robot_path)
    return lss.compile(lss.plan(sequence, robot), robot), robot


def _news(
    world: World, host: Host, states: dict[str, str], marks: dict[str, int]
) -> Iterator[tuple[float, str, str]]:
    at_s, name = world.now_ns / NS_PER_S, host.name
    state = f"{host.figure.state}, player {host.player.does}"
    if states.get(name) != state:
        states[name] = state
        yield at_s, name, state
    yield from ((at_s, name, text) for text in host.log[marks[name] :])
    marks[name] = len(host.log)


# ---- the log of a run


def log_rows(text: str) -> Iterator[tuple[str, str, str, str]]:
    """Yield the lines of a log as `(instant, bus, mark, content)`."""
    import msgspec

    from lss_motion.playing import log

    decode = msgspec.json.Decoder(log.LogLine).decode
    for line in map(decode, text.split("\n")[1:-1]):
        instant = f"{line.at_ns // NS_PER_S}.{line.at_ns % NS_PER_S:09d}"
        match line:
            case log.SentLine():
                yield instant, line.bus, ">", _escaped(line.text)
            case log.ReceivedLine():
                yield instant, line.bus, "<", _escaped(line.text)
            case log.TurnedLine():
                yield instant, "-", ".", ""
            case log.HappenedLine():
                yield instant, "-", "!", _escaped(repr(line.event))
            case log.RequestedLine():
                yield instant, "-", "=", line.request.text
            case log.PortLine():
                yield instant, line.bus, "~", _escaped(f"{line.state} {line.reason}".rstrip())
            case log.SkippedLine():
                yield instant, "-", "?", f"{line.count} lines lost"
            case log.EndedLine():
                yield instant, "-", "#", ""


def _escaped(text: str) -> str:
    return text.encode("unicode_escape").decode("ascii")
