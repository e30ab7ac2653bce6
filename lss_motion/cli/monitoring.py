"""`lss-motion monitor`: how all servos do, live."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from lss_motion.cli.commands import add_command, add_robot
from lss_motion.cli.robots import robot_at
from lss_motion.errors import EXIT_FINISHED, EXIT_INTERRUPTED, BusError, InputError
from lss_motion.units import ns_from_s

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.monitor_screen import Recorder, Screen
    from lss_motion.connection import Connection
    from lss_motion.maintenance.settings import Target
    from lss_motion.maintenance.watch import Watch
    from lss_motion.robot.model import Robot

DESCRIPTION = """\
Show position, speed, current, supply, temperature and status of all servos, as fast as the line
allows. Asks only; moves and changes nothing. Ctrl-C ends it.

  lss-motion monitor my_robot.yaml
  lss-motion monitor --port /dev/ttyUSB0 --csv evening.csv
  lss-motion monitor my_robot.yaml --for 10 | cat      lines instead of a table

It beeps once when a servo gets hot, takes much current, is badly supplied, is stuck or in safe
mode, or falls silent. Angles and speeds are those of the servos, not of joints.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    monitor = add_command(
        commands, "monitor", _monitor, "show how all servos do, live", DESCRIPTION
    )
    add_robot(monitor, is_required=False)
    monitor.add_argument("--port", metavar="URL", help="serial device or URL")
    monitor.add_argument("--baud", type=int, default=115200, metavar="BPS", help="without ROBOT")
    monitor.add_argument("--csv", type=Path, metavar="FILE", help="write every reading")
    monitor.add_argument("--for", type=_seconds, metavar="S", dest="for_s", help="end after S s")
    monitor.add_argument(
        "--every", type=_seconds, default=1.0, metavar="S", help="between lines; default 1"
    )
    monitor.add_argument("--hot-c", type=float, default=65.0, metavar="C", help="default 65")
    monitor.add_argument("--current-a", type=float, default=1.5, metavar="A", help="default 1.5")
    monitor.add_argument(
        "--supply-v",
        type=float,
        nargs=2,
        default=(6.0, 12.6),
        metavar=("MIN", "MAX"),
        help="default 6 12.6",
    )
    monitor.add_argument("--quiet", action="store_true", help="do not beep")


def _monitor(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.monitor_screen import Recorder, Screen
    from lss_motion.connection import connect
    from lss_motion.maintenance.alarms import Alarms, Thresholds
    from lss_motion.maintenance.watch import Watch
    from lss_motion.robot.model import Bus

    if arguments.robot is None and arguments.port is None:
        raise InputError("give a ROBOT file, or --port")
    robot = None
    if arguments.robot is not None:
        robot = robot_at(arguments.robot, arguments.port)
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
            print("The servos are simulated: nothing here says anything about a real robot.")
        watch = Watch(_dated(connection, _targets(connection, robot)), connection.buses)
        screen = stack.enter_context(
            Screen(watch, alarms, every_s=arguments.every, is_quiet=arguments.quiet)
        )
        recorder = None if table is None else Recorder(table)
        return _run(connection, watch, screen, recorder, arguments.for_s)


def _run(
    connection: Connection,
    watch: Watch,
    screen: Screen,
    recorder: Recorder | None,
    for_s: float | None,
) -> int:
    from lss_motion.runtime.runner import run

    started_ns = connection.clock.now_ns()
    end_ns = None if for_s is None else started_ns + ns_from_s(for_s)

    def on_turn(watch: Watch, now_ns: int) -> None:
        fresh = watch.take_fresh()
        if recorder is not None:
            recorder.write(fresh, started_ns)
        screen.update(now_ns, started_ns)
        if end_ns is not None and now_ns >= end_ns:
            watch.stop()

    try:
        run(watch, connection.ports, connection.clock, on_turn=on_turn)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    return EXIT_FINISHED


def _targets(connection: Connection, robot: Robot | None) -> list[Target]:
    """Return whom to watch: the joints of the robot, there or not, or everybody who answers."""
    from lss_motion.cli.scanning import roll_call
    from lss_motion.maintenance.settings import Target

    if robot is not None:
        return [
            Target(
                name=joint.name,
                bus=joint.bus,
                servo_id=joint.servo_id,
                model=joint.model.name,
                family=joint.model.family,
                firmware=robot.buses[joint.bus].firmware,
            )
            for joint in robot.joints.values()
        ]
    found = [present for present in roll_call(connection, "main") if not present.is_shared]
    if not found:
        bus = connection.buses["main"]
        raise BusError(
            f"no servo with an id of its own answers on {bus.port} at {bus.baud_bps} bps; "
            f"`lss-motion scan {bus.port}` says more",
            url=bus.port,
        )
    return [
        Target(
            name=f"servo {present.servo_id}",
            bus="main",
            servo_id=present.servo_id,
            model=present.model,
            family=present.family,
            firmware=370,
        )
        for present in found
        if not present.model.endswith("-LED")
    ]


def _dated(connection: Connection, targets: Sequence[Target]) -> list[Target]:
    """Return the targets with the firmware that they say: it decides what a status means."""
    from dataclasses import replace

    from lss_motion.player.dialogue import Item
    from lss_motion.protocol.family import Family
    from lss_motion.protocol.line import Command

    answers = connection.ask(
        Item(bus=target.bus, command=Command(target.servo_id, "QF"), is_question=True, tries=1)
        for target in targets
        if target.family is not Family.IO2
    )
    dated = []
    for target in targets:
        firmware = answers.get((target.bus, target.servo_id, "QF"))
        dated.append(replace(target, firmware=firmware) if isinstance(firmware, int) else target)
    return dated


def _open(path: Path) -> TextIO:
    try:
        return path.open("w", encoding="utf-8", newline="")
    except OSError as error:
        raise InputError(f"cannot write it: {error.strerror}", path=path) from error


def _seconds(text: str) -> float:
    import argparse

    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds < 1e9:
        raise argparse.ArgumentTypeError(f"{text!r} is no number of seconds above 0")
    return seconds
