"""The largest robot that one line and one computer carry, and an estimate for larger ones.

Two shows ask for it. `lively` is that of the other benches. In `relentless` no joint ever rests:
back and forth every quarter of a second, as far as its acceleration allows, which takes the most
commands of all such periods (measured from 0.05 to 0.5 s: 17 a second and joint).

What playing the largest one costs is measured in virtual time, since its simulator cannot keep pace
with the clock: the whole run, less the simulator hearing and answering the same bytes.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from benches.plan import empty_cache
from benches.shows import ACCEL_MAX_DEG_S2, lively_show, robot_of
from benches.table import Row
from lss_motion.errors import LineLoadError
from lss_motion.planning.program.model import TOLERANCE_DEG
from lss_motion.playing import api
from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.playing.run import Observer, perform
from lss_motion.robot.servo_models import SERVO_ID_MAX
from lss_motion.show.model import Keyframe, Sequence
from lss_motion.sim.bus import bus_from_robot

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
    from lss_motion.robot.model import Robot

BAUDS_BPS: Final = (115_200, 500_000, 921_600)
CAPACITY_S: Final = 2.0
PRECISION: Final = 20
"""Largest robots are found to one in so many joints."""
RELENTLESS_S: Final = 0.25
RELENTLESS_RATIO: Final = 0.98

CORE_RATIO: Final = 0.5
"""On paper a player may keep half of a core busy, so that it is on time when others want it too."""
PAPER_JOINTS: Final = (100, 300, 1000)


@dataclass(frozen=True)
class Largest:
    """The largest robot that a line carries with one kind of show, and what gives out beyond."""

    robot: Robot
    program: Program
    limit: str


def measure() -> list[Row]:
    """Return the largest robots per baud rate, what gives out, and the estimate for more."""
    rows: list[Row] = []
    rates = {}
    for baud_bps in BAUDS_BPS:
        lively = _largest(baud_bps, lambda robot: lively_show(robot, CAPACITY_S, seed=1))
        relentless = _largest(baud_bps, relentless_show)
        core_ratio, answers_hz = _filled(lively.program, lively.robot)
        rates[baud_bps] = core_ratio, len(lively.robot.joints)
        rows += _capacity_rows(lively, relentless, core_ratio, answers_hz)
    return rows + _on_paper(*rates[BAUDS_BPS[0]])


class _Sent:
    """A `Tap` that keeps what was sent, and the show's instants with the processor time so far."""

    def __init__(self) -> None:
        self.lines: list[tuple[bytes, int]] = []
        self.show: list[tuple[int, float]] = []

    def happened(self, event: Event, now_ns: int) -> None:
        if isinstance(event, PhaseEntered) and (event.phase is Phase.SHOW or self.show):
            self.show.append((now_ns, time.process_time()))

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:  # noqa: ARG002
        self.lines.append((data, now_ns))

    def received(self, bus: str, data: bytes, now_ns: int) -> None: ...

    def turned(self, now_ns: int) -> None: ...

    def requested(self, request: object, now_ns: int) -> None: ...

    def noted(self, bus: str, state: str, now_ns: int, reason: str = "") -> None: ...


def _filled(program: Program, robot: Robot) -> tuple[float, float]:
    """Return the share of a core that the player takes to keep the line full, and answers/s."""
    tap = _Sent()
    observer = Observer(make_tap=lambda _: tap)
    report = perform(program, robot, is_virtual=True, observer=observer).report
    assert report.outcome == "finished", report
    (from_ns, before_s), (to_ns, after_s), *_ = tap.show
    bus = bus_from_robot(robot, "main", seed=0)
    received_s: list[float] = []
    for data, now_ns in tap.lines:
        if now_ns >= (from_ns, to_ns, math.inf)[len(received_s)]:
            received_s.append(time.process_time())
        while (arrival_ns := bus.next_arrival_ns()) is not None and arrival_ns <= now_ns:
            bus.read(arrival_ns)
        bus.write(data, now_ns)
    simulator_s = received_s[1] - received_s[0]
    core_ratio = (after_s - before_s - simulator_s) / report.played_s
    return core_ratio, report.buses["main"].query_rate_hz


def relentless_show(robot: Robot) -> Sequence:
    """Return a show in which every joint always turns round, as far as its acceleration allows."""
    # A cubic from rest to rest bends most at its ends: 6 d / t².
    swing_deg = RELENTLESS_RATIO * ACCEL_MAX_DEG_S2 * RELENTLESS_S**2 / 6.0
    sides = (-0.5, 0.5)
    frames = [
        Keyframe(
            at_s=round(turn * RELENTLESS_S, 3),
            deg={
                name: round(swing_deg * sides[(turn + place) % 2], 1) if turn else 0.0
                for place, name in enumerate(robot.joints)
            },
        )
        for turn in range(math.ceil(CAPACITY_S / RELENTLESS_S) + 1)
    ]
    return Sequence(name="relentless", keyframes=tuple(frames))


def _largest(baud_bps: int, make_show: Callable[[Robot], Sequence]) -> Largest:
    """Return the largest robot that a line carries without relaxing the tolerance."""
    for count in (SERVO_ID_MAX, 1):
        robot = robot_of(count, baud_bps=baud_bps)
        if (program := _carried(make_show(robot), robot)) is not None:
            break
    assert program is not None, "no line is too slow for one joint"
    low, high = count, SERVO_ID_MAX + 1
    while high - low > max(1, low // PRECISION):
        # A line that is half full with commands is about as much as there can be.
        guess = round(0.45 * low / program.line_use["main"].utilisation_ratio)
        count = guess if low < guess < high else (low + high) // 2
        more = robot_of(count, baud_bps=baud_bps)
        if (found := _carried(make_show(more), more)) is None:
            high = count
        else:
            low, robot, program = count, more, found
    return Largest(robot, program, _limit(make_show, robot_of(high, baud_bps=baud_bps)))


def _carried(show: Sequence, robot: Robot) -> Program | None:
    with empty_cache():
        planned = api.plan(show, robot)
    try:
        program = api.compile(planned, robot)
    except LineLoadError:
        return None
    return program if program.tolerance_deg == TOLERANCE_DEG else None


def _limit(make_show: Callable[[Robot], Sequence], robot: Robot) -> str:
    """Return what gives out with this robot, which is too large."""
    count = len(robot.joints)
    if count > SERVO_ID_MAX:
        return "servo ids"
    [bus] = robot.buses.values()
    unread = replace(robot, buses={bus.name: replace(bus, reading_rate_min_hz=0.0)})
    if _carried(make_show(unread), unread) is None:
        return f"room for commands, at {count}"
    return f"{bus.reading_rate_min_hz:g} readings/s of each joint, at {count}"


def _capacity_rows(
    lively: Largest, relentless: Largest, core_ratio: float, answers_hz: float
) -> list[Row]:
    [bus] = lively.robot.buses.values()
    rows = []
    for what, found in (("lively", lively), ("relentless", relentless)):
        count, use = len(found.robot.joints), found.program.line_use[bus.name]
        each_hz = use.commands / count / found.program.duration_s
        rows.append(
            Row(
                what=f"largest robot at {bus.baud_bps} bps, {what}",
                ours=f"{count} joints, {each_hz:.1f} commands/s each, "
                f"line {use.utilisation_ratio:.0%}",
                reference=f"gives out: {found.limit}",
            )
        )
    rows.append(
        Row(
            what="  streaming the lively one, the line full of questions",
            ours=f"{core_ratio:.0%} of a core, {answers_hz:.0f} answers/s",
            reference="beyond one core there are fewer questions; commands go first",
            ratio=core_ratio,
        )
    )
    return rows


def _on_paper(core_ratio: float, joints: int) -> list[Row]:
    """Estimate larger shows from the largest robot that one slow line carries.

    Assumes: every bus is at 115200 bps and as full as that one; buses cost the player what one
    costs, each; it has one thread; a USB adapter and hub delay no bus for another; several
    computers start by one clock and share nothing else; planning and compiling are done before.
    """
    per_computer = max(1, int(CORE_RATIO / core_ratio))
    rows = []
    for wanted in PAPER_JOINTS:
        buses = math.ceil(wanted / joints)
        rows.append(
            Row(
                what=f"on paper: {wanted} joints, lively, at {BAUDS_BPS[0]} bps",
                ours=f"{buses} buses, {math.ceil(buses / per_computer)} computers",
                reference=f"{joints} joints a bus; {per_computer} buses keep {CORE_RATIO:.0%} of "
                "one core busy; costs add up, adapters delay nothing, one clock for all",
            )
        )
    return rows
