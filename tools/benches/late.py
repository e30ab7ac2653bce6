"""How late commands reach the servo over a pseudo-terminal, with the display on.

Meanwhile a loop in C sends the same moves at the same distances to a second simulated robot. Its
lateness is that of the machine at this time. (In turns would not do: what the owner of a
virtual machine takes away of it changes from minute to minute.) What the loop does alone is shown
too: the rest is what the player, its screen and its robot, which is a process here, cost it. A
process in C notes at the far end of the port what comes through (`native.tapped`).

Shown are the quantiles of all moves; judged is the median of the rounds. On a virtual machine even
a process of the highest real-time priority, bound to one processor, finds 10 ms of it gone once a
second and 100 ms once a minute (measured), and that comes to one of the two or to the other: more
often to a player that reads a thousand answers a second than to a loop that sleeps. So each row
comes with another, less the time in which a processor was away while a move was late (`native`).

Beside busy programs the figures are worse. A player takes a third of a processor here, which is
about the share that an ordinary process gets beside them and the robots. A process that has used
its share waits for the next tick, 4 ms. With `--real-time` it does not wait; what is left is a
move that is due while a reply is processed, which takes up to a millisecond.
"""

from __future__ import annotations

import contextlib
import os
import re
import statistics
import subprocess
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from benches.behind_pty import busy_cores, robot_behind_pty
from benches.native import DEADLINES_C, away, compiled, tapped
from benches.shows import lively_show, robot_of
from benches.table import Row
from lss_motion.cli.display import Display
from lss_motion.playing import api
from lss_motion.playing.run import Observer, perform
from lss_motion.system.real_time import PRIORITY, real_time
from lss_motion.units import NS_PER_US, line_time_ns, ns_from_s, s_from_us

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from benches.behind_pty import Heard
    from benches.native import Away
    from lss_motion.planning.program.model import Program
    from lss_motion.robot.model import Robot

SERVOS = 18
SHOW_S = 10.0
ROUNDS = 6
"""A minute of show."""
HELD_MAX = 3
"""A show that is held, as for a servo that does not answer, says nothing of lateness."""
LOOP_AFTER_S = 1.5
"""When the player is about to begin: it connects, and goes to where the show starts."""
COMMAND_BYTES = len(b"#12D-450T50\r")
QUANTILES = (50.0, 99.0, 99.9, 100.0)
JUDGED = 99.9
LINE_TIMES_TARGET = 1.0
MOVE: Final = re.compile(rb"#(\d+)D-?\d+T")


def measure(rounds: int = ROUNDS) -> list[Row]:
    """Return the lateness of the player and of the loop in C, idle and with all cores busy."""
    robot = robot_of(SERVOS)
    program = api.compile(api.plan(lively_show(robot, SHOW_S, seed=4), robot), robot)
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        ours, theirs = (_robot(robot, stack) for _ in range(2))
        pair = Pair(program, ours, theirs, compiled(DEADLINES_C, Path(folder), "deadlines"))
        rows = pair.alone() + pair.compared("idle", rounds)
        with busy_cores():
            rows += pair.compared("every core busy", rounds, is_watched=False)
            with real_time() as refused:
                pass
            what = "every core busy, --real-time"
            if any("priority" in text for text in refused):
                rows.append(Row(what=what, ours="not permitted here"))
            else:
                rows += pair.compared(what, rounds, is_real_time=True)
    return rows


def _robot(robot: Robot, stack: contextlib.ExitStack) -> tuple[Robot, Callable[[], Heard]]:
    """Return a robot behind a port, and what says what came through it, tapped if that can be."""
    real, received = stack.enter_context(robot_behind_pty(robot))
    return stack.enter_context(tapped(real)) or (real, received)


def measure_short() -> list[Row]:
    """Return the same from three rounds, in which the worst of a thousand is about the worst."""
    return measure(3)


@dataclass(frozen=True)
class Lateness:
    """When the moves of one round were to be received, and how much later each of them was."""

    expected_ns: np.ndarray
    late_ns: np.ndarray

    @property
    def us(self) -> np.ndarray:
        return self.late_ns / NS_PER_US

    def less(self, gone: Away) -> Lateness:
        """Return what is left without the time in which a processor was away meanwhile."""
        received_ns = self.expected_ns + self.late_ns
        return Lateness(
            self.expected_ns, self.late_ns - gone.within_ns(self.expected_ns, received_ns)
        )


@dataclass(frozen=True)
class Pair:
    """The player with its robot, and the loop, if there is a compiler, with another."""

    program: Program
    ours: tuple[Robot, Callable[[], Heard]]
    theirs: tuple[Robot, Callable[[], Heard]]
    loop: Path | None

    def alone(self) -> list[Row]:
        """Return the lateness of the loop while nothing else runs."""
        if self.loop is None:
            return []
        with self._loop(is_real_time=False) as dues_ns:
            pass
        late_us = lateness(self.program, self.theirs, dues_ns).us
        what = f"a loop in C alone: late at the servo, p50, p99, p99.9, max of {len(late_us)}"
        return [Row(what=what, ours=_said(np.percentile(late_us, QUANTILES)))]

    def compared(
        self, what: str, rounds: int, *, is_real_time: bool = False, is_watched: bool = True
    ) -> list[Row]:
        """Return the lateness of both at the same time.

        Where `is_watched`, also less what the machine was away. Beside busy programs the watching
        itself makes late: an ordinary process that is interrupted is put behind them.
        """
        ours: list[Lateness] = []
        theirs: list[Lateness] = []
        held = 0
        with away(is_wanted=is_watched) as gone:
            while len(ours) < rounds and held < HELD_MAX:
                with self._loop(is_real_time=is_real_time) as loop_dues_ns:
                    dues_ns = self._play(is_real_time=is_real_time)
                if dues_ns is None:
                    held += 1
                    continue
                ours.append(lateness(self.program, self.ours, dues_ns))
                if self.loop is not None:
                    theirs.append(lateness(self.program, self.theirs, loop_dues_ns))
            if held:
                what += f" ({held} more rounds were held for a fault)"
            if not ours:
                return [Row(what=what, ours="no show was played through", is_met=False)]
            rows = [_row(what, ours, theirs)]
            if gone.is_known:
                left = ([late.less(gone) for late in side] for side in (ours, theirs))
                rows.append(_row(f"{what}, less what this machine was away", *left))
        return rows

    def _play(self, *, is_real_time: bool) -> list[int] | None:
        """Play; return when each move was due, or None if the show was held in the middle."""
        robot, received = self.ours
        received()
        with _screen() as display:
            observer = Observer(on_turn=display.show)
            result = perform(self.program, robot, observer=observer, is_real_time=is_real_time)
        show = result.player.show
        assert show is not None
        dues_ns = []
        for move in self.program.moves:
            due_ns = show.clock.instant_ns(s_from_us(move.due_us))
            assert due_ns is not None
            dues_ns.append(due_ns)
        is_held = show.clock.ramp_end_ns > min(dues_ns)
        return None if is_held else dues_ns

    @contextlib.contextmanager
    def _loop(self, *, is_real_time: bool) -> Iterator[list[int]]:
        """Run the loop until its end; yield when each move is due."""
        robot, received = self.theirs
        received()
        start_ns = time.monotonic_ns() + ns_from_s(LOOP_AFTER_S)
        dues_ns = [start_ns + move.due_us * NS_PER_US for move in self.program.moves]
        if self.loop is None:
            yield dues_ns
            return
        plan = zip(dues_ns, self.program.moves, strict=True)
        text = "".join(f"{due_ns} {move.data.decode().strip()}\n" for due_ns, move in plan)
        [bus] = robot.buses.values()
        words = [self.loop, bus.port, str(PRIORITY if is_real_time else 0)]
        with tempfile.TemporaryFile("w+") as file:
            file.write(text)
            file.seek(0)
            process = subprocess.Popen(words, stdin=file)
        try:
            yield dues_ns
        finally:
            code = process.wait()
        assert code == 0, "the loop in C failed"
        time.sleep(0.1)


def _said(quantiles_us: np.ndarray) -> str:
    return ", ".join(f"{value:.0f}" for value in quantiles_us) + " us"


def _row(what: str, ours: list[Lateness], theirs: list[Lateness]) -> Row:
    """Return one comparison: the quantiles of all moves, judged by the median round."""
    count = sum(len(late.us) for late in ours)
    what = f"{what}: late at the servo, p50, p99, p99.9, max of {count}"
    own = _said(np.percentile(np.concatenate([late.us for late in ours]), QUANTILES))
    if not theirs:
        return Row(what=what, ours=own, reference="no C compiler")
    bare = _said(np.percentile(np.concatenate([late.us for late in theirs]), QUANTILES))
    own_us, bare_us = (
        statistics.median(float(np.percentile(late.us, JUDGED)) for late in side)
        for side in (ours, theirs)
    )
    command_us = line_time_ns(COMMAND_BYTES, 115_200) / NS_PER_US
    return Row(
        what=what,
        ours=f"{own}; {own_us:.0f} us in the median round",
        reference=f"{bare}; {bare_us:.0f} us for a loop in C",
        ratio=(own_us - bare_us) / command_us,
        target=f"p99.9 of the median round <= C + {LINE_TIMES_TARGET:g} line time",
        is_met=own_us <= bare_us + LINE_TIMES_TARGET * command_us,
    )


def lateness(
    program: Program, side: tuple[Robot, Callable[[], Heard]], dues_ns: list[int]
) -> Lateness:
    """Return how late every move was received."""
    robot, received = side
    [bus] = robot.buses.values()
    received_ns: dict[int, list[int]] = {}
    expected_ns: dict[int, list[int]] = {}
    for instant_ns, line in received():
        if (match := MOVE.match(line)) is not None:
            received_ns.setdefault(int(match[1]), []).append(instant_ns)
    for due_ns, move in zip(dues_ns, program.moves, strict=True):
        line_ns = line_time_ns(len(move.data), bus.baud_bps)
        expected_ns.setdefault(move.servo_id, []).append(due_ns + line_ns)
    late_ns = [
        _in_order(np.array(instants_ns), np.array(received_ns[servo_id]))
        for servo_id, instants_ns in expected_ns.items()
    ]
    expected = np.concatenate([np.array(instants_ns) for instants_ns in expected_ns.values()])
    return Lateness(expected, np.concatenate(late_ns))


def _in_order(expected_ns: np.ndarray, received_ns: np.ndarray) -> np.ndarray:
    """Return the lateness of one servo's moves, each taken for another line, in their order.

    There are more lines than moves: the approach, and what is said once more after a late move, for
    the sake of the speed limit. The lines are chosen that are nearest in all.
    """
    late_ns = received_ns[:, None] - expected_ns
    best = np.full((len(received_ns) + 1, len(expected_ns) + 1), np.inf)
    best[:, 0] = 0.0
    for line in range(len(received_ns)):
        taken = best[line, :-1] + np.abs(late_ns[line])
        best[line + 1, 1:] = np.minimum(best[line, 1:], taken)
    lates_ns = np.empty(len(expected_ns))
    line, move = len(received_ns), len(expected_ns)
    while move:
        line -= 1
        if best[line + 1, move] < best[line, move]:
            move -= 1
            lates_ns[move] = late_ns[line, move]
    return lates_ns


@contextlib.contextmanager
def _screen() -> Iterator[Display]:
    """Yield a display on a terminal whose output is read, as that of a real one."""
    master_fd, slave_fd = os.openpty()
    # In a process of its own, as a terminal program is.
    quiet = subprocess.DEVNULL
    reader = subprocess.Popen(["cat"], stdin=master_fd, stdout=quiet, stderr=quiet)
    before_fd = os.dup(2)
    os.dup2(slave_fd, 2)
    try:
        display = Display()
        yield display
        display.close()
    finally:
        os.dup2(before_fd, 2)
        for fd in (before_fd, slave_fd, master_fd):
            os.close(fd)
        reader.kill()
        reader.wait()
