"""The command `scan`: find ports, baud rates and servos; write a first robot file."""

from __future__ import annotations

import contextlib
import sys
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.cli.commands import SIMULATED_NOTE, add_command, print_json, require_baud, robot_at
from lss_motion.cli.messages import StepLine, say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE, BusError, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import counted
from lss_motion.maintenance.survey import survey, unreadable

if TYPE_CHECKING:
    import argparse
    from collections.abc import Sequence
    from pathlib import Path

    from lss_motion.cli.commands import Commands
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.discovery import ServoCondition
    from lss_motion.robot.model import Bus, Robot


DESCRIPTION: Final = """\
Find ports, baud rates and servos. Sends queries only; moves and changes nothing.

  lss-motion scan                                  list the ports; scan the USB port if it is one
  lss-motion scan /dev/ttyUSB0                     try all baud rates and ids
  lss-motion scan /dev/ttyUSB0 -o my_robot.yaml    write a robot file to begin with
  lss-motion scan --robot my_robot.yaml            compare the servos with this robot

Exit code 4: no servo replies, two servos share an id, or a servo of the robot is missing or has
another model, gyre, origin or range.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    scan = add_command(commands, "scan", _scan, DESCRIPTION)
    scan.add_argument(
        "port", nargs="?", metavar="PORT", help="serial device or URL (default: the only USB port)"
    )
    add_options(scan, "--robot", help="compare with this robot file")
    add_options(scan, "--baud", help="try only this baud rate (default: all)")
    add_options(scan, "--output", help="write a robot file to begin with")
    add_options(scan, "--force", "--json")


def _scan(arguments: argparse.Namespace) -> int:
    """Scan. With --json the lines for people go to standard error."""
    if not arguments.json:
        return _scanned(arguments, [])
    found: list[dict[str, Any]] = []
    with contextlib.redirect_stdout(sys.stderr):
        code = _scanned(arguments, found)
    print_json({"buses": found})
    return code


def _scanned(arguments: argparse.Namespace, found: list[dict[str, Any]]) -> int:
    """Scan and print; append the result of each bus to `found`."""
    from lss_motion.playing.connection import connect

    require_baud("--baud", arguments.baud)
    require_outputs(
        [Output(arguments.output, OutputKind.YAML)],
        sources=[arguments.robot],
        is_forced=arguments.force,
    )
    robot = None
    if arguments.robot is not None:
        robot = robot_at(arguments.robot, arguments.port).servo_robot
    buses = {"main": _bus(arguments.port)} if robot is None else robot.buses
    if arguments.output is not None and len(buses) > 1:
        raise InputError(
            "-o writes the robot of one port; this robot has several", path=arguments.robot
        )
    is_good, step = True, StepLine()
    with connect(buses, robot=robot) as connection:
        if connection.simulated:
            say(SIMULATED_NOTE)
        for bus in buses.values():
            try:
                looks = survey(connection, bus, arguments.baud, step.show)
            finally:
                step.show("")  # Errors begin on a line of their own.
            others = unreadable(connection, bus, is_silent=not looks)
            frames = [] if robot is None else _frame_problems(connection, bus, robot, looks)
            problems, notes = _print_findings(bus, robot, looks, frames, others)
            found.append(_as_json(bus, looks, problems, notes))
            is_good = is_good and not problems
            if arguments.output is not None:
                _write_starter(arguments.output, bus, looks)
    return EXIT_FINISHED if is_good else EXIT_UNREACHABLE


def _bus(port: str | None) -> Bus:
    """Return the bus at `port`; without it, list the ports and return the only one on USB."""
    from lss_motion.maintenance.api import scanned_bus
    from lss_motion.system.devices import list_devices

    if port is None:
        devices = list_devices()
        for device in devices:
            say(f"{device.path}  {device.name}")
        usb = [device for device in devices if device.is_usb]
        if not usb:
            raise BusError(
                "no serial port on USB was found; plug the adapter in. Name a port that is not on "
                "USB: lss-motion scan /dev/ttyAMA0. To try it without hardware: "
                "lss-motion scan --robot sequences/robots/desk_arm.yaml"
            )
        if len(usb) > 1:
            raise InputError(f"there are {len(usb)} ports on USB; name one, such as {usb[0].path}")
        port = usb[0].path
    return scanned_bus(port)


def _as_json(
    bus: Bus, looks: Sequence[ServoCondition], problems: Sequence[str], notes: Sequence[str]
) -> dict[str, Any]:
    return {
        "bus": bus.name,
        "port": bus.port,
        "servos": [
            {
                "id": look.servo_id,
                "baud_bps": look.baud_bps,
                "model": look.identity.model,
                "is_shared": look.identity.is_shared,
                "is_doubtful": look.identity.is_doubtful,
                "firmware": look.firmware,
                "position_deg": look.position_deg,
                "voltage_v": look.voltage_v,
                "temperature_c": look.temperature_c,
                "status": None if look.status is None else look.status.value,
            }
            for look in looks
        ],
        "problems": problems,
        "notes": notes,
    }


def _frame_problems(
    connection: Connection, bus: Bus, robot: Robot, looks: Sequence[ServoCondition]
) -> list[str]:
    """Compare gyre, origin and range of the servos that can be driven with the robot file."""
    from lss_motion.playing.player.checks import frame_problems, frame_queries

    found = {
        look.servo_id: look.identity.model
        for look in looks
        if look.baud_bps == bus.baud_bps and look.identity.is_single
    }
    joints = [
        joint
        for joint in robot.joints.values()
        if joint.bus == bus.name and found.get(joint.servo_id, "").startswith(joint.model.name)
    ]
    connection.set_baud(bus.name, bus.baud_bps)
    return frame_problems(joints, connection.ask(frame_queries(joints)), robot)


def _print_findings(
    bus: Bus,
    robot: Robot | None,
    looks: Sequence[ServoCondition],
    frames: Sequence[str],
    others: Sequence[str],
) -> tuple[list[str], list[str]]:
    """Print the servos of a bus; return the problems and the notes about them.

    `frames` are the problems with gyres, origins and ranges, `others` notes about the whole bus.
    """
    from lss_motion.maintenance import survey as report

    names = {}
    if robot is not None:
        names = {j.servo_id: j.name for j in robot.joints.values() if j.bus == bus.name}
    problems = list(report.unreachable(bus, looks))
    notes = [*others, *report.warnings(looks, f"--port {bus.port}")]
    if robot is not None:
        problems += [*report.differences(robot, bus, looks), *frames]
        notes += report.unnamed(robot, bus, looks)
    if not looks:
        problems = [report.NO_ANSWER]
    for rate_bps in dict.fromkeys(look.baud_bps for look in looks):
        at_rate = [look for look in looks if look.baud_bps == rate_bps]
        count = "1 id replies" if len(at_rate) == 1 else f"{len(at_rate)} ids reply"
        say(f"{bus.port} at {rate_bps} bps: {count}")
        say("\n".join(f"  {row}" for row in report.table(at_rate, names)))
    for kind, texts in (("note", notes), ("problem", problems)):
        for text in texts:
            say(f"{kind}: {text}")
    return problems, notes


def _write_starter(path: Path, bus: Bus, looks: Sequence[ServoCondition]) -> None:
    from lss_motion.maintenance.survey import starter_file
    from lss_motion.robot.load import load_robot

    rates = [look.baud_bps for look in looks]
    main_bps = max(rates, key=rates.count) if rates else bus.baud_bps
    text = starter_file(path.stem, replace(bus, baud_bps=main_bps), looks)
    if text is None:
        raise BusError("no robot file was written: no servo has an id of its own")
    write_output(path, text)
    robot = load_robot(path)
    say(f"wrote {path}: {counted(robot.joints, 'joint')}. Edit the ranges before you move it")
