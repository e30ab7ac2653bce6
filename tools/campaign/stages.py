"""Hours of a stage: visitors, faults and a clock that is set, by seed.

Visitors come to the sensor, operators press keys, servos go deaf, restart, get stuck and hot, the
line is unplugged, and the wall clock is set forth and back. Judged, by code that shares nothing
with the player: every byte that is sent (each target within the range of its joint), the horns ten
times a second (range and speed), the last bytes of each run (all servos hold, or are limp), the
memory (of the process, and the number of its objects: the garbage collector is off during a run),
the size of the log, and whether `lss-motion morning` explains every trigger.
"""

from __future__ import annotations

import gc
import re
import resource
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from random import Random
from statistics import linear_regression
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from msgspec.structs import replace

from campaign import Told
from lss_motion.playing import run as playing_run
from lss_motion.sim.faults import SENSOR_NAMES, Fault, FaultKind
from lss_motion.stage.check import plan_stage
from lss_motion.stage.load import load_stage
from lss_motion.stage.log import StageLog
from lss_motion.stage.model import Signal, TriggerKind
from lss_motion.stage.morning import read_night
from lss_motion.stage.running import Options, StageRun
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterator

    from lss_motion.playing.player.player import Player
    from lss_motion.playing.report import StageReport
    from lss_motion.playing.run import Result
    from lss_motion.robot.model import Robot
    from lss_motion.stage.check import Planned

SEEDS: Final = 1
ROOT: Final = Path(__file__).resolve().parents[2]
STAGE: Final = ROOT / "sequences" / "stages" / "haunted_hall.yaml"
BEGINS: Final = datetime(2026, 10, 24, 17, 0, tzinfo=UTC)
"""A Saturday in October: summer time ends in this night in Europe."""
VISIT_S: Final = 300.0
KEY_S: Final = 900.0
FAULT_S: Final = 3600.0
CLOCK_S: Final = 6 * 3600.0
"""Mean times between visitors, keys, faults, and settings of the clock."""
LOOK_NS: Final = 100 * NS_PER_MS
"""Also how often the player is called at least: no operator watches, and this halves the turns."""
RANGE_SLACK_DEG: Final = 1.0
"""A horn swings past its target by less: its own controller, and the play of its gears."""
SPEED_SLACK_RATIO: Final = 1.15
"""Between two looks, and a limp horn that sags is not driven."""
MEMORY_S: Final = 600.0
SETTLED_H: Final = 0.4
"""Later samples of the memory count: until then it fills its rings and caches."""
GROWTH_MAX_B, GROWTH_MAX_B_H = 10_000_000, 100_000
OBJECTS_MAX, OBJECTS_MAX_H = 20_000, 100
"""Growth in all, and in an hour, as a line through the samples; that of an hour has few of them.
Chosen: of a week 27 MB; shows that stayed in memory would be some thousand objects each."""
PAGE_B: Final = resource.getpagesize()
MOVE: Final = re.compile(rb"#(\d+)D(-?\d+)(?:T\d+|S\d+)?\r")
SAFE: Final = re.compile(rb"#254[HL]\r\Z")


@dataclass
class Judge:
    """Looks at the bytes and the horns of all runs; keeps no more than the last bytes."""

    ranges_wire: dict[int, tuple[float, float]]
    ranges_deg: list[tuple[float, float]]
    speeds_deg_s: list[float]
    objections: Counter[str] = field(default_factory=Counter)
    moves: int = 0
    looks: int = 0
    runs: int = 0
    _bus: Any = None
    _tail: bytearray = field(default_factory=bytearray)
    _looked_ns: int = 0
    _before_deg: Any = None
    _was_driven: bool = False

    def watch(self, bus: Any) -> None:  # noqa: ANN401  (a simulated bus)
        """Look at the horns of the bus of a new run."""
        self._bus, self._looked_ns, self._before_deg = bus, 0, None
        self._tail.clear()

    # ---- a tap

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        for servo_id, target in MOVE.findall(data):
            self.moves += 1
            low, high = self.ranges_wire[int(servo_id)]
            if not low <= int(target) <= high:
                self.objections[f"servo {int(servo_id)} was sent out of its range"] += 1
        self._tail += data
        del self._tail[:-64]

    def received(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def turned(self, now_ns: int) -> None: ...

    def happened(self, event: object, now_ns: int) -> None: ...

    def requested(self, request: object, now_ns: int) -> None: ...

    def noted(self, bus: str, state: str, now_ns: int, reason: str = "") -> None: ...

    # ---- horns and ends

    def look(self, now_ns: int) -> None:
        """Judge where the horns are, and how fast they have moved since the last look."""
        if self._bus is None or now_ns < self._looked_ns + LOOK_NS:
            return
        passed_s, self._looked_ns = (now_ns - self._looked_ns) / NS_PER_S, now_ns
        self._bus.advance(now_ns)
        here_deg = [float(deg) for deg in self._bus.motors.horns.shafts_deg()]
        before_deg, self._before_deg = self._before_deg, here_deg
        self.looks += 1
        for index, deg in enumerate(here_deg):
            low, high = self.ranges_deg[index]
            if not low - RANGE_SLACK_DEG <= deg <= high + RANGE_SLACK_DEG:
                self.objections[f"horn {index} is out of its range"] += 1
            if before_deg is not None and passed_s < 2 * LOOK_NS / NS_PER_S:
                speed_deg_s = abs(deg - before_deg[index]) / passed_s
                if speed_deg_s > SPEED_SLACK_RATIO * self.speeds_deg_s[index]:
                    self.objections[f"horn {index} moves too fast"] += 1

    def end(self, result: Result[StageReport], _began_ns: int) -> None:
        """Judge the last bytes of a run."""
        self.runs += 1
        is_gone = result.report.outcome == "lost"  # No byte reaches a port that is gone.
        if not is_gone and SAFE.search(bytes(self._tail)) is None:
            self.objections["the last bytes of a run are not the safe state"] += 1


class Memory(NamedTuple):
    """The memory of this process, and the objects that the garbage collector knows.

    Without tuples: the ring of the last bytes has thousands of them, more or less.
    """

    at_h: float
    size_b: int
    objects: int


def memory_of(at_h: float) -> Memory:
    """Return it now; nothing is collected before."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return Memory(at_h, pages * PAGE_B, sum(type(one) is not tuple for one in gc.get_objects()))


def growth(memory: list[Memory]) -> tuple[float, float]:
    """Return by how many bytes and objects it grows in an hour, once it has settled."""
    settled = [one for one in memory if one.at_h >= SETTLED_H]
    if len(settled) < 3:
        return 0.0, 0.0
    at_h = [one.at_h for one in settled]
    line = [
        linear_regression(at_h, [float(one.size_b) for one in settled]),
        linear_regression(at_h, [float(one.objects) for one in settled]),
    ]
    return line[0].slope, line[1].slope


class Hands:
    """Operators who press keys, and a wall clock that is set, as a seed says."""

    has_stopped, rate = False, 1.0

    def __init__(self, seed: int, hurry: float) -> None:
        self._key_s, self._set_s = KEY_S / hurry, CLOCK_S / hurry
        self.run: StageRun | None = None
        self.set = timedelta()
        self.memory: list[Memory] = []
        self.on_sample: Callable[[Memory], None] = lambda _: None
        self._keys, self._clock = Random(f"{seed}/keys"), Random(f"{seed}/clock")
        self._key_ns = _next_ns(self._keys, 0, self._key_s)
        self._clock_ns = _next_ns(self._clock, 0, self._set_s)
        self._memory_ns = 0

    def filenos(self) -> tuple[()]:
        return ()

    def note(self, record: object) -> None: ...

    def on_event(self, event: object) -> None: ...

    def on_turn(self, player: object, now_ns: int) -> None: ...

    def act(self, player: object, now_ns: int) -> None:  # noqa: ARG002
        """Press keys, set the clock, weigh the memory."""
        assert self.run is not None
        now_ns = self.run.now_ns
        if now_ns >= self._key_ns:
            self._key_ns = _next_ns(self._keys, now_ns, self._key_s)
            for _ in range(self._keys.choice((1, 1, 1, 2, 30))):  # Some press in a storm.
                signal = Signal(kind=TriggerKind.KEY, address=self._keys.choice("sssrww"))
                self.run.director.signal(signal, now_ns)
        if now_ns >= self._clock_ns:
            self._clock_ns = _next_ns(self._clock, now_ns, self._set_s)
            self.set += timedelta(seconds=self._clock.uniform(-600.0, 600.0))
        if now_ns >= self._memory_ns:
            self._memory_ns = now_ns + round(MEMORY_S * NS_PER_S)
            self.memory.append(memory_of(now_ns / (3600.0 * NS_PER_S)))
            self.on_sample(self.memory[-1])


def _next_ns(random: Random, now_ns: int, mean_s: float) -> int:
    return now_ns + round(random.expovariate(1.0 / mean_s) * NS_PER_S)


class Weekend(StageRun):
    """A stage with a wall clock that is set, and a judge who looks at each turn."""

    def __init__(
        self,
        planned: Planned,
        options: Options,
        hands: Hands,
        judge: Judge,
        **more: Any,  # noqa: ANN401
    ) -> None:
        self._hands, self._judge = hands, judge
        super().__init__(planned, options, steerer=hands, **more)
        hands.run = self

    def wall(self) -> datetime:
        return super().wall() + self._hands.set

    def on_turn(self, player: Player, now_ns: int) -> None:
        super().on_turn(player, now_ns)
        player.idle_ns = LOOK_NS
        self._judge.look(now_ns)


def visits(random: Random, lasts_s: float, hurry: float) -> Iterator[Fault]:
    """Yield visitors before the sensor: they come, stay a while, and go."""
    raw = SENSOR_NAMES["GP2Y0A21YK0F"].raw
    at_s = 0.0
    while (at_s := at_s + random.expovariate(hurry / VISIT_S)) < lasts_s:
        near_mm = random.uniform(150.0, 750.0)
        yield Fault(kind=FaultKind.INPUT, servo_id=203, at_s=at_s, raw=raw(near_mm))
        at_s += random.uniform(0.3, 60.0) / hurry
        yield Fault(kind=FaultKind.INPUT, servo_id=203, at_s=at_s, raw=raw(800.0))


def troubles(random: Random, lasts_s: float, ids: list[int], hurry: float) -> Iterator[Fault]:
    """Yield faults of servos and of the line."""
    at_s = 0.0
    while (at_s := at_s + random.expovariate(hurry / FAULT_S)) < lasts_s:
        who, span_s = random.choice(ids), random.choice((2.0, 8.0, 30.0, 300.0))
        until_s = at_s + span_s
        yield random.choice(
            (
                Fault(kind=FaultKind.DEAF, servo_id=who, at_s=at_s, until_s=until_s),
                Fault(kind=FaultKind.RESET, servo_id=who, at_s=at_s),
                Fault(kind=FaultKind.STUCK, servo_id=who, at_s=at_s, until_s=until_s),
                Fault(kind=FaultKind.HOT, servo_id=who, at_s=at_s, temperature_c=70.0),
                Fault(kind=FaultKind.LOST_REPLY, at_s=at_s, until_s=until_s, ratio=0.4),
                Fault(kind=FaultKind.CORRUPT_REPLY, at_s=at_s, until_s=until_s, ratio=0.2),
                Fault(kind=FaultKind.UNPLUGGED, at_s=at_s, until_s=at_s + min(span_s, 30.0)),
                Fault(kind=FaultKind.OVERSLEEP, at_s=at_s, until_s=at_s + 1.0, late_s=0.6),
            )
        )


@dataclass(frozen=True)
class Outcome:
    """What a weekend has shown."""

    hours: float
    runs: int
    moves: int
    looks: int
    objections: Counter[str]
    triggers: int
    explained: int
    plays: int
    faults: int
    log_bytes: int
    memory: list[Memory]
    cpu_s: float


def weekend(
    hours: float,
    seed: int,
    folder: Path,
    stage_path: Path = STAGE,
    *,
    max_bytes: int = 20_000_000,
    hurry: float = 1.0,
    is_open: bool = False,
    says: Callable[[Memory, Judge], None] | None = None,
) -> Outcome:
    """Play it; the log goes to `folder`. All that happens comes `hurry` times as often.

    `is_open`: there are no quiet hours. `says` is told every ten minutes of it.
    """
    cpu_s = time.process_time()
    stage = load_stage(stage_path)
    stage = replace(stage, log=replace(stage.log, folder=folder, max_bytes=max_bytes))
    if is_open:
        stage = replace(stage, duty=replace(stage.duty, quiet=()))
    planned = plan_stage(stage)
    robot = next(iter(planned.shows.values())).robot
    lasts_s, ids = hours * 3600.0, [joint.servo_id for joint in robot.joints.values()]

    def faults(now_ns: int) -> list[Fault]:
        left_s = lasts_s - now_ns / NS_PER_S
        random = Random(f"{seed}/{now_ns}")
        return [*visits(random, left_s, hurry), *troubles(random, left_s, ids, hurry)]

    options = Options(
        is_virtual=True,
        begins=BEGINS,
        lasts_s=lasts_s,
        seed=seed,
        next_faults=faults,
        more={"is_recorded": False},
    )
    judge, counts = judge_of(robot), Counter[str]()
    with StageLog(stage.log, is_virtual=True) as log, watched(judge):

        def note(record: dict[str, Any]) -> None:
            if record.get("kind") in ("fired", "refused"):
                counts["explained"] += record.get("count", 1)
            log.write(record)

        hands = Hands(seed, hurry)
        if says is not None:
            hands.on_sample = lambda sample: says(sample, judge)
        run = Weekend(planned, options, hands, judge, note=note, tap=lambda _: judge)
        triggers = count_triggers(run)
        run.play(judge.end)
        run.note_counts(is_last=True)
    night = read_night(folder, BEGINS - timedelta(hours=12))
    explained = sum(cue.fired + sum(cue.refused.values()) for cue in night.cues.values())
    assert explained == counts["explained"], "the log holds what was noted"
    return Outcome(
        hours=hours,
        runs=judge.runs,
        moves=judge.moves,
        looks=judge.looks,
        objections=judge.objections,
        triggers=triggers["count"],
        explained=explained,
        plays=sum(show.plays for show in night.shows.values()),
        faults=night.fault_count,
        log_bytes=sum(file.stat().st_size for file in folder.iterdir()),
        memory=hands.memory,
        cpu_s=time.process_time() - cpu_s,
    )


def judge_of(robot: Robot) -> Judge:
    """Return the judge of a robot whose servos have neither an offset nor another direction."""
    joints = robot.joints.values()
    assert all(joint.zero_deg == 0.0 and joint.direction == 1 for joint in joints)
    return Judge(
        ranges_wire={
            j.servo_id: (10 * j.position_min_deg, 10 * j.position_max_deg) for j in joints
        },
        ranges_deg=[(j.position_min_deg, j.position_max_deg) for j in joints],
        speeds_deg_s=[j.speed_max_deg_s for j in joints],
    )


class watched:  # noqa: N801  (a context manager)
    """Lets a judge see the simulated bus of each run."""

    def __init__(self, judge: Judge) -> None:
        self._judge, self._connect = judge, playing_run.connect

    def __enter__(self) -> None:
        def connect(*given: Any, **more: Any) -> Any:  # noqa: ANN401
            connection = self._connect(*given, **more)
            self._judge.watch(next(iter(connection.simulated.values())))
            return connection

        playing_run.connect = connect

    def __exit__(self, *_: object) -> None:
        playing_run.connect = self._connect


def count_triggers(run: StageRun) -> Counter[str]:
    """Count what triggers a cue, before the director decides about it."""
    counts = Counter[str]()
    triggers, original = run.director._triggers, run.director._triggers.triggered  # noqa: SLF001

    class Counting:
        cues = triggers.cues

        @staticmethod
        def triggered(signal: Signal) -> list[Any]:
            found = original(signal)
            counts["count"] += len(found)
            return found

    run.director._triggers = Counting()  # type: ignore[assignment]  # noqa: SLF001
    return counts


def faults_of(outcome: Outcome, max_bytes: int) -> list[str]:
    """Return what a weekend must not show."""
    found = [f"{count} x {text}" for text, count in outcome.objections.items()]
    if outcome.triggers != outcome.explained:
        found.append(f"{outcome.triggers} triggers, but {outcome.explained} in the log")
    if outcome.log_bytes > max_bytes:
        found.append(f"the log has {outcome.log_bytes} bytes, allowed are {max_bytes}")
    bytes_h, objects_h = growth(outcome.memory)
    is_larger = outcome.hours * (bytes_h - GROWTH_MAX_B_H) > GROWTH_MAX_B
    if is_larger or outcome.hours * (objects_h - OBJECTS_MAX_H) > OBJECTS_MAX:
        found.append(
            f"the memory grows: {bytes_h / 1e3:.0f} kB and {objects_h:.0f} objects an hour"
        )
    return found


def say(sample: Memory, judge: Judge) -> None:
    """Print how far it has come, once an hour."""
    if sample.at_h % 1.0 < MEMORY_S / 3600.0:
        print(
            f"{sample.at_h:.1f} h: {judge.runs} runs ended, {judge.moves} moves, {judge.looks} "
            f"looks, objections: {dict(judge.objections)}, {sample.size_b / 1e6:.1f} MB",
            file=sys.stderr,
            flush=True,
        )


LOG_MAX_BYTES: Final = 20_000_000


def add_to(parser: argparse.ArgumentParser) -> None:
    """Add the options of this kind."""
    parser.add_argument("--hours", type=float, default=48.0, help="of each (default 48)")
    parser.add_argument("--stage", type=Path, default=STAGE)
    parser.add_argument("--hurry", type=float, default=1.0, help="all comes so many times as often")
    parser.add_argument("--open", action="store_true", help="without the quiet hours of the stage")
    parser.add_argument("--log", type=Path, help="keep the log in this folder")


def play(seed: int, options: argparse.Namespace) -> Told:
    """Play one evening."""
    with tempfile.TemporaryDirectory() as scratch:
        outcome = weekend(
            options.hours,
            seed,
            options.log or Path(scratch),
            options.stage,
            max_bytes=LOG_MAX_BYTES,
            hurry=options.hurry,
            is_open=options.open,
            says=say,
        )
    samples = [one for one in outcome.memory if one.at_h >= SETTLED_H]
    some = samples[:: max(1, len(samples) // 8)]
    bytes_h, objects_h = growth(samples)
    line = (
        f"{outcome.hours:g} h: {outcome.plays} shows, {outcome.runs} runs, {outcome.faults} "
        f"faults, {outcome.triggers} triggers ({outcome.explained} explained), {outcome.moves} "
        f"moves, {outcome.looks} looks at the horns\n"
        f"log {outcome.log_bytes / 1e6:.2f} MB; {outcome.cpu_s:.0f} s of processor time; memory, "
        f"MB after hours: {', '.join(f'{one.size_b / 1e6:.1f} ({one.at_h:.1f})' for one in some)}; "
        f"it grows by {bytes_h / 1e3:.1f} kB and {objects_h:.1f} of "
        f"{samples[-1].objects if samples else 0} objects an hour"
    )
    return Told("played", tuple(faults_of(outcome, LOG_MAX_BYTES)), line=line)
