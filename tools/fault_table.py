#!/usr/bin/env python3
"""Measure how each kind of fault is noticed, and how fast; print the table of the guide.

    tools/run python tools/fault_table.py                 print it
    tools/run python tools/fault_table.py --write         write it into the guide

`sequences/wave.yaml` is played in virtual time with one fault, at another instant and for another
servo with each seed, spread over the show. A fault counts as noticed with the first event that
names it: a fault, a warning, a refusal. What a show does not notice is tried in a careful run, too.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import re
import statistics
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

sys.path.insert(0, str(Path(__file__).resolve().parent))

from campaign.judge import MOVE
from campaign.three_shows import Show
from campaign.witness import HangError, Witness

from lss_motion.maintenance.careful import CarefulRun, way_of
from lss_motion.playing import api
from lss_motion.playing.connection import connect
from lss_motion.playing.player import handshake
from lss_motion.playing.player.events import Faulted, Warned
from lss_motion.playing.run import Observer, perform
from lss_motion.sim.faults import Fault, FaultKind
from lss_motion.sim.physics import TICK_NS
from lss_motion.system.clock import VirtualClock
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.run import Result
    from lss_motion.robot.model import Joint, Robot

    Rows = Callable[[Joint, float], list[Fault]]

ROOT: Final = Path(__file__).resolve().parents[1]
SHOW: Final = ROOT / "sequences" / "wave.yaml"
GUIDE: Final = ROOT / "sequences" / "guides" / "faults.md"
MARKS: Final = ("<!-- faults: begin, tools/fault_table.py -->", "<!-- faults: end -->")
SEEDS: Final = 5
FIRST_S: Final = 2.0
"""The robot is on its way to the start by then."""


@dataclass(frozen=True)
class Case:
    """A row of the table. Without `is_in_show` the fault is there from power-up."""

    text: str
    rows: Rows
    is_in_show: bool = True
    has_feedback: bool = True
    is_careful: bool = False
    """The joint with the fault makes its careful run; no show is played."""


def _servo(kind: FaultKind, **values: object) -> Rows:
    """Return a fault of one servo from an instant on, for good or as `values` have it."""
    return lambda joint, at_s: [Fault(kind=kind, at_s=at_s, servo_id=joint.servo_id, **values)]  # type: ignore[arg-type]


def _line(kind: FaultKind, lasts_s: float = math.inf, **values: float) -> Rows:
    """Return a fault of the line or the host."""
    return lambda _, at_s: [Fault(kind=kind, at_s=at_s, until_s=at_s + lasts_s, **values)]  # type: ignore[arg-type]


def _stored(**settings: int) -> Rows:
    return lambda joint, _: [
        Fault(kind=FaultKind.STORED, servo_id=joint.servo_id, settings=settings)
    ]


def _scale(setting: str, scale_ratio: float) -> Rows:
    return lambda joint, _: [
        Fault(
            kind=FaultKind.WRONG_SCALE,
            servo_id=joint.servo_id,
            setting=setting,
            scale_ratio=scale_ratio,
        )
    ]


def _other(text: str, every_s: float) -> Rows:
    return lambda joint, at_s: [
        Fault(
            kind=FaultKind.SECOND_MASTER,
            at_s=at_s,
            text=text.format(id=joint.servo_id),
            every_s=every_s,
        )
    ]


CASES: Final = (
    Case("a servo restarts and is back after 20 ms", _servo(FaultKind.RESET, deaf_s=0.02)),
    Case("… after 0.3 s", _servo(FaultKind.RESET, deaf_s=0.3)),
    Case("… after 1.25 s, as after RESET", _servo(FaultKind.RESET)),
    Case("another servo with another origin takes its place in 1.25 s",
         _servo(FaultKind.EXCHANGED, settings={"O": 900})),
    Case("a servo falls silent for good", _servo(FaultKind.DEAF)),
    Case("a horn is held fast", _servo(FaultKind.STUCK)),
    Case("a motor has a tenth of its speed", _servo(FaultKind.WEAK, speed_ratio=0.1)),
    Case("a servo has 78 °C", _servo(FaultKind.HOT, temperature_c=78.0)),
    Case("a servo has 90 °C: it lets go by itself", _servo(FaultKind.HOT, temperature_c=90.0)),
    Case("the supply falls to 5 V", _line(FaultKind.LOW_VOLTAGE, supply_v=5.0)),
    Case("the supply is too low from the start",
         _line(FaultKind.LOW_VOLTAGE, supply_v=5.0), is_in_show=False),
    Case("the port is unplugged for 2 s", _line(FaultKind.UNPLUGGED, 2.0)),
    Case("the port is unplugged for good", _line(FaultKind.UNPLUGGED)),
    Case("the port takes no bytes for 0.3 s", _line(FaultKind.BLOCKED_PORT, 0.3)),
    Case("the port takes no bytes any more", _line(FaultKind.BLOCKED_PORT)),
    Case("the adapter returns what is sent", _line(FaultKind.ECHO), is_in_show=False),
    Case("every tenth reply is damaged", _line(FaultKind.CORRUPT_REPLY, ratio=0.1)),
    Case("every tenth command is lost", _line(FaultKind.LOST_COMMAND, ratio=0.1)),
    Case("the computer stands still for 0.2 s", _line(FaultKind.OVERSLEEP, 0.1, late_s=0.2)),
    Case("… for 5 s", _line(FaultKind.OVERSLEEP, 0.1, late_s=5.0)),
    Case("… for 30 s", _line(FaultKind.OVERSLEEP, 0.1, late_s=30.0)),
    Case("a servo turns the other way (G)", _stored(G=-1), is_in_show=False),
    Case("a servo has another origin (O)", _stored(O=50), is_in_show=False),
    Case("a servo has another angular range (AR)", _stored(AR=3600), is_in_show=False),
    Case("two servos have the same id", _servo(FaultKind.TWIN), is_in_show=False),
    Case("without feedback: stored limits above those of the joint",
         _stored(SD=3600, AA=100, AD=100), is_in_show=False, has_feedback=False),
    Case("positions are in hundredths instead of tenths", _scale("D", 0.1), is_in_show=False),
    Case("speeds (SD) are ten times as fast", _scale("SD", 10.0), is_in_show=False),
    Case("times (T) are ten times as short", _scale("T", 0.1), is_in_show=False),
    Case("in a careful run: a motor has a tenth of its speed",
         _servo(FaultKind.WEAK, speed_ratio=0.1), is_in_show=False, is_careful=True),
    Case("in a careful run: positions are in hundredths instead of tenths", _scale("D", 0.1),
         is_in_show=False, is_careful=True),
    Case("in a careful run: speeds (SD) are ten times as fast", _scale("SD", 10.0),
         is_in_show=False, is_careful=True),
    Case("in a careful run: times (T) are ten times as short", _scale("T", 0.1),
         is_in_show=False, is_careful=True),
    Case("another host asks every 0.1 s", _other("#{id}QD", 0.1)),
    Case("another host moves a joint every 0.5 s", _other("#{id}D300T500", 0.5)),
    Case("another host lets a joint go", _other("#{id}L", 100.0)),
)  # fmt: skip


@dataclass
class EventWitness(Witness):
    """Keeps every event with its instant."""

    events: list[tuple[int, Event]] = field(default_factory=list)

    def happened(self, event: Event, now_ns: int) -> None:
        self.events.append((now_ns, event))
        super().happened(event, now_ns)


@dataclass(frozen=True)
class Played:
    """What became of one run: how it was noticed, after how long, how it ended."""

    noticed: str
    after_s: float | None
    end: str


def main() -> int:
    """Play all cases; print the table, or write it into the guide."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=SEEDS, metavar="N")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes")
    parser.add_argument("--write", action="store_true", help="write it into the guide")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as plans:
        os.environ["LSS_MOTION_CACHE_DIR"] = plans
        lines = table(arguments.seeds, arguments.jobs)
    text = "\n".join(lines)
    if not arguments.write:
        print(text)
        return 0
    page = GUIDE.read_text(encoding="utf-8")
    begin, end = map(re.escape, MARKS)
    assert re.search(begin, page), f"{GUIDE} has no line {MARKS[0]}"
    new = re.sub(
        f"{begin}.*?{end}", lambda _: f"{MARKS[0]}\n{text}\n{MARKS[1]}", page, flags=re.DOTALL
    )
    GUIDE.write_text(new, encoding="utf-8")
    return 0


def table(seeds: int, jobs: int = 1) -> list[str]:
    """Return the lines of the table."""
    lines = [
        "| what goes wrong | noticed as | after (median, worst) | what happens |",
        "|---|---|---|---|",
    ]
    with multiprocessing.Pool(jobs) as pool:
        for line in pool.imap(partial(measured_row, seeds=seeds), range(len(CASES))):
            lines.append(line)
            print(line, file=sys.stderr, flush=True)
    return lines


def measured_row(number: int, *, seeds: int) -> str:
    """Play a case with each seed; return its row."""
    show = wave()
    return row(CASES[number], [play(CASES[number], show, seed, seeds) for seed in range(seeds)])


@cache
def wave() -> Show:
    """Return the show that is played, once through."""
    sequence = replace(api.load_sequence(SHOW), loop=1)
    assert sequence.robot_path is not None
    robot = api.load_robot(sequence.robot_path)
    return Show(robot, api.compile(api.plan(sequence, robot), robot))


def row(case: Case, played: Sequence[Played]) -> str:
    """Return the row of a case."""
    return f"| {case.text} | {_noticed(played)} | {_after(case, played)} | {_ends(played)} |"


def play(case: Case, show: Show, seed: int, seeds: int) -> Played:
    """Play the show once with the fault of a case."""
    program, robot = show.program, show.robot
    joint = list(robot.joints.values())[seed % len(robot.joints)]
    if case.is_careful:
        return _run_carefully(case, robot, joint, seed)
    at_s = FIRST_S + program.duration_s * (seed + 0.5) / seeds if case.is_in_show else 0.0
    witness = EventWitness()
    try:
        result = perform(
            program,
            robot,
            is_virtual=True,
            seed=seed,
            has_feedback=case.has_feedback,
            faults=case.rows(joint, at_s),
            observer=Observer(controls=witness, make_tap=lambda _: witness),
        )
    except HangError:
        return Played("", None, "does not end")
    noticed, noticed_s = _first(witness, result, at_s)
    return Played(noticed, None if noticed_s is None else noticed_s - at_s, _end(result, witness))


def _run_carefully(case: Case, robot: Robot, joint: Joint, seed: int) -> Played:
    """Make the careful run of the joint with the fault."""
    clock = VirtualClock()
    faults = case.rows(joint, 0.0)
    with connect(robot.buses, robot=robot, clock=clock, seed=seed, faults=faults) as connection:
        answers, _ = connection.examined([joint], robot)
        standing_deg = handshake.reported(joint, answers, "QD")
        assert standing_deg is not None
        way_deg = way_of(joint, robot, standing_deg)
        careful = CarefulRun(joint, robot, answers, standing_deg=standing_deg, way_deg=way_deg)
        began_ns, failed_ns = clock.now_ns(), None

        def look(run: CarefulRun, now_ns: int) -> None:
            nonlocal failed_ns
            if run.error is not None and failed_ns is None:
                failed_ns = now_ns

        connection.run(careful, on_turn=look)
        column = list(robot.joints).index(joint.name)
        times_ns = range(began_ns, clock.now_ns(), TICK_NS)
        horn_deg = connection.simulated[joint.bus].horn_deg(list(times_ns))[:, column]
    if failed_ns is None:
        return Played("", None, "the show may play")
    way_deg = math.ceil(float(abs(horn_deg - horn_deg[0]).max()))
    return Played("an error", s_from_ns(failed_ns - began_ns), f"halts within {way_deg} deg")


def _first(witness: EventWitness, result: Result, at_s: float) -> tuple[str, float | None]:
    """Return what named the fault first, and when."""
    for at_ns, event in witness.events:
        if s_from_ns(at_ns) < at_s:
            continue
        if isinstance(event, Faulted):
            return f"`{event.kind}`", s_from_ns(at_ns)
        if isinstance(event, Warned):
            return "a warning", s_from_ns(at_ns)
    if result.error is not None:
        return "an error", s_from_ns(witness.end_ns)
    return "", None


def _end(result: Result, witness: Witness) -> str:
    has_moved = any(MOVE.search(bytes(data)) for data in witness.sent_data.values())
    if result.error is not None and not has_moved:
        return "refused before anything moves"
    names = {"finished": "goes on to its end", "fault": "brakes and holds", "lost": "ends, lost"}
    return names.get(result.report.outcome, result.report.outcome)


def _noticed(played: Sequence[Played]) -> str:
    counts = Counter(one.noticed or "not noticed" for one in played)
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{name} ({count} of {len(played)})" for name, count in counts.most_common())


def _after(case: Case, played: Sequence[Played]) -> str:
    if not case.is_in_show and all(one.end.startswith("refused") for one in played):
        return "before anything moves"
    after_s = [one.after_s for one in played if one.after_s is not None]
    if not after_s:
        return "–"
    return f"{statistics.median(after_s):.2f} s, {max(after_s):.2f} s"


def _ends(played: Sequence[Played]) -> str:
    counts = Counter(one.end for one in played)
    if len(counts) == 1:
        return next(iter(counts))
    return ", ".join(f"{name} ({count})" for name, count in counts.most_common())


if __name__ == "__main__":
    sys.exit(main())
