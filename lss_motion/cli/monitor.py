"""The command `monitor`: the live state of all servos, as table, lines, CSV file and beeps."""

from __future__ import annotations

import contextlib
import csv
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final, Self, TextIO

from lss_motion.cli.commands import SIMULATED_NOTE, add_command, robot_at
from lss_motion.cli.messages import put, say, shown
from lss_motion.cli.options import add_options, add_robot, number_from
from lss_motion.errors import EXIT_FINISHED, EXIT_INPUT, BusError, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.system.signals import exit_code
from lss_motion.units import NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Sequence

    from rich.console import RenderableType

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.monitor import Alarms, Polling, ServoState
    from lss_motion.maintenance.settings import Target
    from lss_motion.playing.connection import Connection
    from lss_motion.robot.model import Robot


DESCRIPTION: Final = """\
Show position, speed, current, supply, temperature and status of all servos, as fast as the bus
allows. Sends queries only; moves and changes nothing. Ctrl-C ends it.

  lss-motion monitor my_robot.yaml
  lss-motion monitor --port /dev/ttyUSB0 --csv evening.csv
  lss-motion monitor my_robot.yaml --for 10 | cat      lines instead of a table

It beeps once when a servo gets hot, draws much current, has a wrong supply voltage, is stuck, is in
safe mode, or stops replying; and when another host asks the servos, or one sends by itself. To
notice that, it asks nothing for a moment every few seconds. Angles and speeds are those of the
servos, not of the joints.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    monitor = add_command(commands, "monitor", _monitor, DESCRIPTION)
    add_robot(monitor, is_required=False)
    add_options(monitor, "--port")
    add_options(monitor, "--baud", default=115200)
    monitor.add_argument(
        "--csv", type=Path, metavar="FILE", help="write every reading to this file"
    )
    add_options(monitor, "--force")
    number = number_from(-1e6, 1e6)
    seconds = number_from(0.0, 1e9, "seconds", is_above=True)
    monitor.add_argument(
        "--for", type=seconds, metavar="S", dest="for_s", help="end after S seconds"
    )
    monitor.add_argument(
        "--every", type=seconds, default=1.0, metavar="S", help="seconds between lines (default 1)"
    )
    monitor.add_argument(
        "--hot-c",
        type=number,
        default=65.0,
        metavar="C",
        help="alarm above this °C (default 65)",
    )
    monitor.add_argument(
        "--current-a",
        type=number,
        default=1.5,
        metavar="A",
        help="alarm above this A (default 1.5)",
    )
    monitor.add_argument(
        "--supply-v",
        type=number,
        nargs=2,
        default=(6.0, 12.6),
        metavar=("MIN", "MAX"),
        help="alarm outside these V (default 6 12.6)",
    )
    add_options(monitor, "--quiet", help="do not beep")


def _monitor(arguments: argparse.Namespace) -> int:
    from lss_motion.maintenance.monitor import Alarms, Polling, Thresholds
    from lss_motion.playing.connection import connect
    from lss_motion.robot.model import Bus

    if arguments.robot is None and arguments.port is None:
        raise InputError("give a ROBOT file, or --port")
    outputs = [Output(arguments.csv, OutputKind.READINGS)]
    require_outputs(outputs, sources=[arguments.robot], is_forced=arguments.force)
    robot = None
    if arguments.robot is not None:
        robot = robot_at(arguments.robot, arguments.port).servo_robot
    main = Bus(name="main", port=arguments.port or "", baud_bps=arguments.baud, firmware=370)
    buses = {"main": main} if robot is None else robot.buses
    alarms = Alarms(
        Thresholds(
            temperature_max_c=arguments.hot_c,
            current_max_a=arguments.current_a,
            supply_min_v=arguments.supply_v[0],
            supply_max_v=arguments.supply_v[1],
        )
    )
    with contextlib.ExitStack() as stack:
        table = None if arguments.csv is None else stack.enter_context(_open(arguments.csv))
        connection = stack.enter_context(connect(buses, robot=robot))
        if connection.simulated:
            say(SIMULATED_NOTE)
        watch = Polling(_with_firmware(connection, _targets(connection, robot)), connection.buses)
        screen = stack.enter_context(
            MonitorScreen(watch, alarms, every_s=arguments.every, is_quiet=arguments.quiet)
        )
        recorder = None if table is None else Recorder(table)
        return _run(connection, watch, screen, recorder, arguments.for_s)


def _run(
    connection: Connection,
    watch: Polling,
    screen: MonitorScreen,
    recorder: Recorder | None,
    for_s: float | None,
) -> int:
    from lss_motion.playing.runner import run

    started_ns = connection.clock.now_ns()
    end_ns = None if for_s is None else started_ns + ns_from_s(for_s)

    def on_turn(watch: Polling, now_ns: int) -> None:
        fresh = watch.take_fresh()
        if recorder is not None:
            recorder.write(fresh, started_ns)
        screen.update(now_ns, started_ns)
        if end_ns is not None and now_ns >= end_ns:
            watch.stop()

    try:
        run(watch, connection.ports, connection.clock, on_turn=on_turn)
    except KeyboardInterrupt as interrupt:
        return exit_code(interrupt)
    return EXIT_FINISHED if recorder is None or recorder.problem is None else EXIT_INPUT


def _targets(connection: Connection, robot: Robot | None) -> list[Target]:
    """Return all joints of the robot, or without one the servos that reply."""
    from lss_motion.maintenance.settings import Target
    from lss_motion.maintenance.survey import roll_call

    if robot is not None:
        return [
            Target(
                name=joint.name,
                bus=joint.bus,
                servo_id=joint.servo_id,
                model=joint.model.name,
                family=joint.model.family,
                firmware=None,
                units=joint.model.units,
            )
            for joint in robot.joints.values()
        ]
    found = [present for present in roll_call(connection, "main") if present.is_single]
    if not found:
        bus = connection.buses["main"]
        raise BusError(
            f"no servo with an id of its own replies on {bus.port} at {bus.baud_bps} bps; "
            f"try `lss-motion scan {bus.port}`",
            url=bus.port,
        )
    return [
        Target(
            name=f"servo {present.servo_id}",
            bus="main",
            servo_id=present.servo_id,
            model=present.model,
            family=present.family,
            firmware=None,
        )
        for present in found
        if not present.model.endswith("-LED")
    ]


def _with_firmware(connection: Connection, targets: Sequence[Target]) -> list[Target]:
    """Return the targets with the firmware that they report; the codes of a status depend on it."""
    from msgspec.structs import replace

    from lss_motion.playing.player.handshake import Item
    from lss_motion.protocol.constants import Family
    from lss_motion.protocol.framing import Command

    answers = connection.ask(
        Item(bus=target.bus, command=Command(target.servo_id, "QF"), tries=1)
        for target in targets
        if target.family is not Family.IO2
    )
    complete = []
    for target in targets:
        firmware = answers.get((target.bus, target.servo_id, "QF"))
        complete.append(replace(target, firmware=firmware) if isinstance(firmware, int) else target)
    return complete


def _open(path: Path) -> TextIO:
    """Return a new table; rows are appended to it as they are measured."""
    write_output(path, "")
    try:
        return path.open("a", encoding="utf-8", newline="")
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", path=path) from error


FRAME_NS: Final = NS_PER_S // 8
BARS: Final = "▁▂▃▄▅▆▇█"
SPARK_MIN_DEG: Final = 1.0
"""A horn that moves less than this is shown as a flat line, without its noise."""
SETTLED_S: Final = 1.0
"""Lines are printed when every value has been queried once, or after this time."""
CSV_HEAD: Final = (
    "t_s",
    "servo",
    "position_deg",
    "speed_deg_s",
    "current_a",
    "voltage_v",
    "temperature_c",
    "status",
)


class MonitorScreen:
    """A table on a terminal, lines elsewhere. Beeps for new alarms."""

    def __init__(self, watch: Polling, alarms: Alarms, *, every_s: float, is_quiet: bool) -> None:
        self._watch = watch
        self._alarms = alarms
        self._is_quiet = is_quiet
        self._is_live = sys.stdout.isatty()
        self._every_ns = FRAME_NS if self._is_live else ns_from_s(every_s)
        self._next_ns = 0
        self._stack = contextlib.ExitStack()

    def __enter__(self) -> Self:
        if self._is_live:
            from rich.live import Live

            self._live = self._stack.enter_context(Live(auto_refresh=False))
        return self

    def __exit__(self, *error: object) -> None:
        self._stack.close()

    def update(self, now_ns: int, started_ns: int) -> None:
        """Print new alarms; draw the table or print lines, if they are due."""
        for text in self._alarms.update(self._watch.readings, self._watch.disturbed):
            if not self._is_quiet:
                say("", sys.stderr, end="", control="\a")
            if not self._is_live:
                say(f"{s_from_ns(now_ns - started_ns):7.1f} s  ALARM  {text}")
        if now_ns < self._next_ns:
            return
        self._next_ns = now_ns + self._every_ns
        elapsed_s = s_from_ns(now_ns - started_ns)
        if self._is_live:
            self._live.update(rendered(self._watch, self._alarms, elapsed_s), refresh=True)
        elif elapsed_s >= SETTLED_S or self._watch.has_asked_all:
            say("\n".join(_lines(self._watch.readings, elapsed_s)))
        else:
            self._next_ns = now_ns


class Recorder:
    """Writes readings as CSV, one row per servo and round.

    A table that cannot be written to its end has a `problem`; the monitor goes on without it.
    """

    def __init__(self, file: TextIO) -> None:
        self.problem: str | None = None
        self._file = file
        self._writer = csv.writer(file, lineterminator="\n")
        self._writer.writerow(CSV_HEAD)

    def write(self, readings: Iterable[ServoState], started_ns: int) -> None:
        if self.problem is not None:
            return
        try:
            self._write(readings, started_ns)
        except OSError as error:
            reason = error.strerror or str(error)
            self.problem = f"{self._file.name}: the table is not complete: {reason}"
            put(f"warning: {self.problem}", sys.stderr)
            with contextlib.suppress(OSError):
                self._file.close()

    def _write(self, readings: Iterable[ServoState], started_ns: int) -> None:
        for reading in readings:
            values = (
                reading.position_deg,
                reading.speed_deg_s,
                reading.current_a,
                reading.voltage_v,
                reading.temperature_c,
            )
            self._writer.writerow(
                [
                    f"{s_from_ns(reading.at_ns - started_ns):.3f}",
                    reading.target.name,
                    *("" if value is None else f"{value:g}" for value in values),
                    "" if reading.status is None else reading.status.value,
                ]
            )
        self._file.flush()


def rendered(watch: Polling, alarms: Alarms, elapsed_s: float) -> RenderableType:
    """Return the table, the alarms and a foot line for rich."""
    from rich.console import Group
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("servo", "id"):
        table.add_column(title)
    for title in ("position", "", "speed", "current", "supply", "heat", "status"):
        table.add_column(title, justify="left" if title in ("", "status") else "right")
    wrong = {name for name, _ in alarms.active}
    for reading in watch.readings:
        name = reading.target.name
        table.add_row(
            shown(name, style="red" if name in wrong else ""),
            str(reading.target.servo_id),
            *_cells(reading),
        )
    rates = ", ".join(
        f"{name} {rounds / max(elapsed_s, 0.1):.0f} rounds/s"
        for name, rounds in watch.rounds.items()
    )
    notes = [shown(text, style="red") for text in alarms.active.values()]
    foot = shown(f"{elapsed_s:.0f} s   {rates}   Ctrl-C ends", style="dim")
    return Group(table, *notes, foot)


def sparkline(values: Sequence[float]) -> str:
    """Return values as small bars, scaled from the lowest to the highest."""
    if not values:
        return ""
    low, span = min(values), max(values) - min(values)
    if span < SPARK_MIN_DEG:
        return BARS[0] * len(values)
    return "".join(BARS[round((value - low) / span * (len(BARS) - 1))] for value in values)


def _cells(reading: ServoState) -> tuple[str, ...]:
    if reading.is_silent:
        return ("-", "", "-", "-", "-", "-", "silent")
    position = _formatted(reading.position_deg, "{:z.1f} deg")
    return (
        position if reading.raw is None else f"{reading.raw:.0f} raw",
        sparkline(reading.positions_deg),
        _formatted(reading.speed_deg_s, "{:z.0f} deg/s"),
        _formatted(reading.current_a, "{:.2f} A"),
        _formatted(reading.voltage_v, "{:.1f} V"),
        _formatted(reading.temperature_c, "{:.0f} °C"),
        "-" if reading.status is None else reading.status.value,
    )


def _lines(readings: Sequence[ServoState], elapsed_s: float) -> list[str]:
    width = max(len(reading.target.name) for reading in readings)
    lines = []
    for reading in readings:
        cells = [cell for column, cell in enumerate(_cells(reading)) if column != 1]
        shown = "  ".join(f"{cell:>10}" for cell in cells[:-1])
        lines.append(f"{elapsed_s:7.1f} s  {reading.target.name:{width}}  {shown}  {cells[-1]}")
    return lines


def _formatted(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
