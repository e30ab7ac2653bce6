"""What playing a show with feedback costs: in virtual time, and of a core in real time.

Processor time of the process that plays, without planning and compiling. In real time the
simulated robot is a process of its own, behind a pseudo-terminal, and the show is judged by itself,
from its first instant to its last: connecting, settings, approach and report take their time once,
however long the show is, and are stated beside it. In virtual time all of the run counts.

Where it goes, by samples of the walk of 18 joints (8,840 turns of the loop, 9,440 queries, 25 s of
run): the simulator 34 % (14 % ticks of 5 ms, 14 % lines that servos receive), the player's turns
29 % (19 % polling, 6 % moves), answers 22 % (14 % the estimators), wake-ups 7 %, the loop 5 %: no
function has more than 4 %. In real time a turn costs 0.4 ms, in virtual time 0.14 ms without
the simulator: the rest is that a process which slept finds the processor's caches cold. So wake-ups
count: 290 a second, of which 100 are moves, 150 servos that are polled at an instant of their own,
and 40 answers. Two servos cannot be polled in one write, because their answers would meet; only
group queries (FACTS.md W17, from firmware 370) could save more of these.
"""

from __future__ import annotations

import statistics
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from benches.behind_pty import robot_behind_pty
from benches.shows import lively_show, robot_of
from benches.table import Row, core_seconds
from lss_motion import api
from lss_motion.perform import Observer, perform
from lss_motion.player.events import Phase, PhaseEntered

if TYPE_CHECKING:
    from lss_motion.player.events import Event
    from lss_motion.program.model import Program
    from lss_motion.robot.model import Robot

SEQUENCES: Final = Path(__file__).resolve().parents[2] / "sequences"
SHOWS: Final = ((6, 115_200), (18, 115_200), (40, 500_000))
"""Joints, and the baud rate that carries them."""
SHOW_S: Final = 10.0
REPEATS: Final = 3
SPEED_TARGET: Final = 10.0
CPU_TARGET: Final = 0.15
JUDGED: Final = 18


def measure() -> list[Row]:
    """Return the speed of simulated shows, and the share of a core that shows in real time take."""
    walk_robot = api.load_robot(SEQUENCES / "robots" / "hexapod.yaml")
    walk = api.plan(api.load_sequence(SEQUENCES / "hexapod_walk.yaml"), walk_robot)
    rows = [_virtual("hexapod_walk", api.compile(walk, walk_robot), walk_robot)]
    for joints, baud_bps in SHOWS:
        robot = robot_of(joints, baud_bps=baud_bps)
        show = api.plan(lively_show(robot, SHOW_S, seed=3), robot)
        program = api.compile(show, robot)
        rows.append(_virtual("lively show", program, robot))
        rows.append(_in_real_time("lively show", program, robot))
    return rows


def _virtual(what: str, program: Program, robot: Robot) -> Row:
    taken_s = [
        core_seconds(lambda: perform(program, robot, is_virtual=True)) for _ in range(REPEATS)
    ]
    joints, ratio = len(robot.joints), program.duration_s / statistics.median(taken_s)
    is_judged = joints == JUDGED
    return Row(
        what=f"{what}, {joints} joints, virtual time",
        ours=f"{ratio:.1f} x real time",
        reference="real time, one core",
        ratio=ratio,
        target=f">= {SPEED_TARGET:g} x" if is_judged else "",
        is_met=ratio >= SPEED_TARGET if is_judged else None,
    )


@dataclass(slots=True)
class _Phases:
    """When each phase of a run began: on the clock, and in processor time of this process."""

    began_s: dict[Phase, tuple[float, float]] = field(default_factory=dict)

    def note(self, event: Event) -> None:
        if isinstance(event, PhaseEntered):
            self.began_s[event.phase] = time.monotonic(), time.process_time()

    def show_s(self) -> tuple[float, float]:
        """Return how long the show took, and how long it kept a core busy."""
        began, ended = self.began_s[Phase.SHOW], self.began_s[Phase.RESTORE]
        return ended[0] - began[0], ended[1] - began[1]


def _in_real_time(what: str, program: Program, robot: Robot) -> Row:
    phases = _Phases()
    with robot_behind_pty(robot) as (real, _):
        observer = Observer(on_event=phases.note)
        taken_s = core_seconds(lambda: perform(program, real, observer=observer))
    show_s, busy_s = phases.show_s()
    joints, ratio = len(robot.joints), busy_s / show_s
    is_judged = joints == JUDGED
    return Row(
        what=f"{what}, {joints} joints, real time",
        ours=f"{ratio:.1%} of one core, and {taken_s - busy_s:.2f} s before and after it",
        reference="one core",
        ratio=ratio,
        target=f"<= {CPU_TARGET:.0%}" if is_judged else "",
        is_met=ratio <= CPU_TARGET if is_judged else None,
    )
