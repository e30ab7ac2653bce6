"""What playing a show with feedback costs: in virtual time, and of a core in real time.

Processor time of the process that plays, without planning and compiling. In real time the
simulated robot is a process of its own, behind a pseudo-terminal, and the show is judged by itself,
from its first instant to its last: connecting, settings, approach and report take their time once,
however long the show is, and are stated beside it. In virtual time all of the run counts.

On a quiet machine on which `import numpy` takes 0.16 s and the walk took 18.5 s as a whole process
at ca11cdd: the walk is simulated at 4.8 x real time, the lively show of 18 joints at 6.7 x, and one
in real time takes 14 to 15 % of a core. The goal of 10 x is not reached, for the reasons below.

What it costs, as calls of functions of the walk with a tolerance of 0.03 deg (18,645 turns of the
loop, 11,090 queries, 5,416 moves, 25 s of run), which do not depend on other work of the computer:
6.04 million. The player has 4.26 of them, 228 a turn, and 69 % of the time under cProfile. No
function of it has more than 3 % of its calls. In real time a turn costs more than in virtual time
(0.4 and 0.14 ms, before the gains below): a process which slept finds the caches cold. Two servos
cannot be polled in one write, because their answers would meet; only group queries (FACTS.md W17,
from firmware 370) could save turns.

What was gained last, all of it byte for byte the same (`tools/freeze.py`):

- the player, 7.81 million calls to 4.26 (419 a turn to 228), in three alternating pairs with the
  version before 0.69, 0.70 and 0.76 of the processor time of the run: when the next move leaves,
  when a query may, which joints are sent targets of their own, and what is derived of load and lag
  are kept until a move, a reply, the clock or a wait changes them
  (`tests/virtual/test_kept_instants.py`); profiles of servos that may have lost a move are computed
  when a reading is compared with them.
- before that, 7.50 million to 6.09 at a tolerance of 0.2 deg: lines of queries parsed and encoded
  once, profiles and horns at an instant without calls, arrival times from a table.

Simulator and loop: of the walk within 0.03 degrees (18,645 turns, 5,416 moves, 11,090 queries) the
functions of `sim`, `runtime` and `protocol`, with the builtins that they call, took 3.19 of 11.17
million calls and take 1.88 of 9.62. With the same player that is 0.86 of the processor time of the
whole run (median of 13 alternating pairs, 0.78 to 0.93, at a load of 13 processes):

- to 2.15: the port writes and reads without advancing the motors, a plain query is one look-up and
  one measurement, faults that are not there are not called for, and the loop takes no numbers of
  files in virtual time.
- to 2.08: common lines and replies with numbers are read without a parser.
- to 1.88: a horn is computed by itself when its servo is read or ordered, and the control loops of
  up to 0.32 s at once (`sim/horns.py`): 4,784 loops in 560 blocks. A load, play, or a motor that
  may be held back need each loop after the one before it, as ever. Bytes and instants are the
  same. Horns differ by up to 4e-7 degrees, and by 1.2e-5 where a motor is held back: one value of
  39,000 in thousandths of a degree.

Not done. To poll the servo that is due for longest, whatever its speed and error, saves 160,000
calls, but another one is read, and loaded joints had 2 % more error (`robust.py droop`).
Of 21,957 looks for a query 7,200 end because the servo before may still answer; to choose the
next servo only when it may be sent one would save these. 20 x real time needs fewer visits to
servos, now 13 a second and joint: that is fewer readings (FACTS.md N13).
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
from lss_motion.planning import shows
from lss_motion.playing import api
from lss_motion.playing.player.events import Phase, PhaseEntered
from lss_motion.playing.run import Observer, perform

if TYPE_CHECKING:
    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.events import Event
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
