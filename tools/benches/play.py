"""What playing a show with feedback costs: in virtual time, and of a core in real time.

Processor time of the process that plays, without planning and compiling. In real time the
simulated robot is a process of its own, behind a pseudo-terminal, and the show is judged by itself,
from its first instant to its last: connecting, settings, approach and report take their time once,
however long the show is, and are stated beside it. In virtual time all of the run counts.

Where it goes, by samples of the walk of 18 joints (8,840 turns of the loop, 9,440 queries, 1,990
moves, 25 s of run): the simulator 31 % (11 % ticks of 5 ms, 13 % lines that servos receive), the
player's turns 31 % (15 % polling, 8 % moves), answers 26 % (14 % the estimators), wake-ups 6 %, the
loop 6 %: no function has more than 5 %. In real time a turn costs 0.4 ms, in virtual time 0.14 ms
without the simulator (before the gains below): a process which slept finds the caches cold. So
wake-ups count: 290 a second, of which 100 are moves, 150 servos that are polled at an instant of
their own, and 40 answers. Two servos cannot be polled in one write, because their answers would
meet; only group queries (FACTS.md W17, from firmware 370) could save more of these.

What was gained last, all of it byte for byte the same (`tools/freeze.py`), as calls of functions
for the walk, which do not depend on other work of the computer, and as processor time of the walk
in alternating pairs with the version before all of it:

- 7.50 to 7.12 million calls: lines of queries are parsed and encoded once, sizes of replies counted
  without encoding, servos found by id, no look for faults that are not there, no outbox for a port
  that is never blocked, scales of the tables as numbers. With ticks that reuse their arrays
  (a fifth less for one): 0.91 of the time.
- to 6.67: instants of moves, marks and the next query are kept while they hold.
- to 6.35: profiles and horns at an instant without calls, arrival times from a table.
- to 6.09: a load below a unit is not weighed, the Kalman filter's products are written out. With
  these three: 0.83 of the time, of the lively show as well. In real time the lively show takes
  0.96 of what it took (19.0 and 19.8 % of a core, pairs at a load of 20 processes, not quiet).

Simulator and loop: of the walk as `lss-play` compiles it (18,645 turns, 5,416 moves, 11,090
queries) the functions of `sim`, `runtime` and `protocol` took 3.19 million calls and take 1.88:

- to 2.15: the port writes and reads without advancing the motors, a plain query is one look-up and
  one measurement, faults that are not there are not called for, and the loop takes no numbers of
  files in virtual time.
- to 2.08: common lines and replies with numbers are read without a parser.
- to 1.88: a horn is computed by itself when its servo is read or ordered, and the control loops of
  up to 0.32 s at once (`sim/blocks.py`): 4,784 loops in 560 blocks. A load, play, or a motor that
  may be held back need each loop after the one before it, as ever.

Not done. Answers that wait longer than 4 ms: 583 turns are for these alone, and a lost
move would be sent again later. What is left is spread evenly over 5,900 visits to servos, 13 a
second and joint, so 20 x real time needs fewer visits: that is fewer readings (FACTS.md N13).
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
from lss_motion import api, shows
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
    walk = shows.prepare(SEQUENCES / "hexapod_walk.yaml", None)
    rows = [_virtual("hexapod_walk", walk.program, walk.robot)]
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
