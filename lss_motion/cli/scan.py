"""`lss-motion scan`: which ports, baud rates and servos there are."""

from __future__ import annotations

import contextlib
import dataclasses
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lss_motion.cli.commands import (
    add_command,
    add_force,
    add_json,
    print_json,
    refuse_overwriting,
    robot_at,
)
from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE, BusError, InputError

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.connection import Connection
    from lss_motion.maintenance.discovery import ServoCondition, ServoIdentity
    from lss_motion.robot.model import Bus, Robot


DESCRIPTION = """\
Find ports, baud rates and servos. Asks only; moves and changes nothing.

  lss-motion scan                                  the ports of this computer; scans the only one
  lss-motion scan /dev/ttyUSB0                     all baud rates, all ids
  lss-motion scan /dev/ttyUSB0 -o my_robot.yaml    writes a robot file to begin with
  lss-motion scan --robot my_robot.yaml            who of this robot is there, and how it does

Ends with exit code 4 if nobody answers, an id is shared, or a servo of the robot is missing.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    scan = add_command(commands, "scan", _scan, "find ports, baud rates and servos", DESCRIPTION)
    scan.add_argument("port", nargs="?", metavar="PORT", help="serial device or URL")
    scan.add_argument("--robot", type=Path, metavar="FILE", help="compare with this robot")
    scan.add_argument("--baud", type=int, metavar="BPS", help="try this rate only")
    scan.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write a robot file to begin with"
    )
    add_force(scan)
    add_json(scan)


def _scan(arguments: argparse.Namespace) -> int:
    """Scan; with --json the lines for people go to standard error."""
    if not arguments.json:
        return _scanned(arguments, [])
    found: list[dict[str, Any]] = []
    with contextlib.redirect_stdout(sys.stderr):
        code = _scanned(arguments, found)
    print_json({"buses": found})
    return code


def _scanned(arguments: argparse.Namespace, found: list[dict[str, Any]]) -> int:
    """Scan and print; append what was found on each bus to `found`."""
    from lss_motion.connection import connect
    from lss_motion.protocol.constants import BAUD_RATES_BPS

    if arguments.baud is not None and arguments.baud not in BAUD_RATES_BPS:
        allowed = ", ".join(map(str, BAUD_RATES_BPS))
        raise InputError(f"--baud {arguments.baud}: servos know {allowed}")
    refuse_overwriting(arguments.output, is_forced=arguments.force)
    robot = None
    if arguments.robot is not None:
        robot = robot_at(arguments.robot, arguments.port)
    buses = {"main": _bus(arguments.port)} if robot is None else robot.buses
    if arguments.output is not None and len(buses) > 1:
        raise InputError("-o describes one port; this robot has several", path=arguments.robot)
    is_well = True
    with connect(buses, robot=robot) as connection:
        if connection.simulated:
            print("The servos are simulated: nothing here says anything about a real robot.")
        for bus in buses.values():
            looks = survey(connection, bus, arguments.baud)
            problems, notes = _tell(bus, robot, looks)
            found.append(_as_json(bus, looks, problems, notes))
            is_well = is_well and not problems
            if arguments.output is not None:
                _write_starter(arguments.output, bus, looks)
    return EXIT_FINISHED if is_well else EXIT_UNREACHABLE


def survey(connection: Connection, bus: Bus, baud_bps: int | None) -> list[ServoCondition]:
    """Return everybody on a bus, at `baud_bps` or at every rate at which somebody answers.

    Leaves the port at the rate at which most answered.
    """
    from lss_motion.maintenance.discovery import RATES_BPS, Listening, presence_steps

    rates_bps = list(dict.fromkeys((bus.baud_bps, *RATES_BPS))) if baud_bps is None else [baud_bps]
    spoken = []
    for rate_bps in rates_bps:
        _progress(f"{bus.port}: {rate_bps} bps")
        connection.set_baud(bus.name, rate_bps)
        if any(connection.run(Listening(bus.name, presence_steps(rate_bps))).received):
            spoken.append(rate_bps)
    looks: list[ServoCondition] = []
    for rate_bps in spoken or rates_bps[:1]:  # A lone 2IO with other ids answers by name only.
        _progress(f"{bus.port}: {rate_bps} bps, all ids")
        connection.set_baud(bus.name, rate_bps)
        looks += _look(connection, bus.name, rate_bps)
    counts = [look.baud_bps for look in looks]
    if counts:
        connection.set_baud(bus.name, max(counts, key=counts.count))
    _progress("")
    return looks


def roll_call(connection: Connection, bus_name: str) -> list[ServoIdentity]:
    """Return everybody who answers on a bus at its present rate."""
    from lss_motion.maintenance import discovery
    from lss_motion.maintenance.discovery import Listening
    from lss_motion.protocol.constants import ID_MAX

    baud_bps = connection.buses[bus_name].baud_bps
    models: dict[int, str] = {}
    doubtful: set[int] = set()
    for _ in range(discovery.ROLL_CALLS):
        left = [servo_id for servo_id in range(ID_MAX + 1) if servo_id not in models]
        heard = connection.run(
            Listening(bus_name, discovery.roll_call_steps(baud_bps, left))
        ).received
        answered, again = discovery.read_roll_call(baud_bps, left, heard)
        models |= answered
        doubtful |= again
    everybody = {
        servo_id: models.get(servo_id, "") for servo_id in sorted(models.keys() | doubtful)
    }
    return ask_alone(connection, bus_name, everybody)


def ask_alone(
    connection: Connection, bus_name: str, models: Mapping[int, str]
) -> list[ServoIdentity]:
    """Return what answers to ids that are asked one by one. `models` may be empty texts."""
    from lss_motion.maintenance import discovery
    from lss_motion.maintenance.discovery import Listening
    from lss_motion.protocol.constants import Family

    baud_bps = connection.buses[bus_name].baud_bps
    heard: dict[int, list[bytes]] = {servo_id: [] for servo_id in models}

    def ask(ids: Iterable[int], keyword: str, times: int) -> None:
        asked = [servo_id for servo_id in ids for _ in range(times)]
        steps = [discovery.question_alone(servo_id, keyword, baud_bps) for servo_id in asked]
        for servo_id, data in zip(
            asked, connection.run(Listening(bus_name, steps)).received, strict=True
        ):
            heard[servo_id].append(data)

    ask(models, "QMS", discovery.ASKED_ALONE)
    judged = {
        servo_id: discovery.judge_answers(servo_id, models[servo_id], heard[servo_id])
        for servo_id in models
    }
    numbered = [n for n, present in judged.items() if present and present.family is not Family.IO2]
    ask(numbered, "QN", discovery.ASKED_ALONE)
    doubtful = [n for n in models if discovery.is_doubtful(n, heard[n])]
    ask([n for n in doubtful if n in numbered], "QN", discovery.ASKED_AGAIN)
    ask([n for n in doubtful if n not in numbered], "QMS", discovery.ASKED_AGAIN)
    final = (discovery.judge_answers(n, models[n], heard[n]) for n in models)
    return [present for present in final if present is not None]


def _look(connection: Connection, bus_name: str, baud_bps: int) -> list[ServoCondition]:
    from lss_motion.maintenance import discovery

    found = roll_call(connection, bus_name)
    items = [item for p in found if not p.is_shared for item in discovery.questions(bus_name, p)]
    answers = connection.ask(items)
    looks = [discovery.read_condition(bus_name, baud_bps, present, answers) for present in found]
    causes = connection.ask(discovery.cause_questions(looks))
    return [
        dataclasses.replace(seen, cause=discovery.read_cause(seen, causes))
        if (bus_name, seen.servo_id, "Q") in causes
        else seen
        for seen in looks
    ]


def _bus(port: str | None) -> Bus:
    """Return the bus at `port`, or at the only USB port there is; shows the ports then."""
    from lss_motion.robot.model import Bus
    from lss_motion.runtime.port import list_devices

    if port is None:
        devices = list_devices()
        for device in devices:
            print(f"{device.path}  {device.name}")
        usb = [device for device in devices if device.is_usb]
        if not usb:
            raise BusError(
                "no serial port on USB was found. Is the adapter plugged in? A port that is not "
                "on USB can be named: lss-motion scan /dev/ttyAMA0. Without a robot: "
                "lss-motion scan --robot sequences/robots/desk_arm.yaml"
            )
        if len(usb) > 1:
            raise InputError(f"there are {len(usb)} ports on USB: name one, such as {usb[0].path}")
        port = usb[0].path
    return Bus(name="main", port=port, baud_bps=115200, firmware=370)


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


def _tell(
    bus: Bus, robot: Robot | None, looks: Sequence[ServoCondition]
) -> tuple[list[str], list[str]]:
    """Print what was found on a bus; return the problems and the notes about it."""
    from lss_motion.maintenance import findings

    names = {}
    if robot is not None:
        names = {j.servo_id: j.name for j in robot.joints.values() if j.bus == bus.name}
    problems = list(findings.unreachable(bus, looks))
    notes = list(findings.warnings(looks, f"--port {bus.port}"))
    if robot is not None:
        problems += findings.differences(robot, bus, looks)
        notes += findings.unnamed(robot, bus, looks)
    if not looks:
        problems = [findings.NO_ANSWER]
    for rate_bps in dict.fromkeys(look.baud_bps for look in looks):
        at_rate = [look for look in looks if look.baud_bps == rate_bps]
        count = "1 id answers" if len(at_rate) == 1 else f"{len(at_rate)} ids answer"
        print(f"{bus.port} at {rate_bps} bps: {count}")
        print("\n".join(f"  {row}" for row in findings.table(at_rate, names)))
    for kind, texts in (("note", notes), ("problem", problems)):
        for text in texts:
            print(f"{kind}: {text}")
    return problems, notes


def _write_starter(path: Path, bus: Bus, looks: Sequence[ServoCondition]) -> None:
    from lss_motion.cli.tables import write_text
    from lss_motion.maintenance.findings import starter_file
    from lss_motion.robot.load import load_robot

    rates = [look.baud_bps for look in looks]
    main_bps = max(rates, key=rates.count) if rates else bus.baud_bps
    text = starter_file(path.stem, dataclasses.replace(bus, baud_bps=main_bps), looks)
    if text is None:
        raise BusError("no robot file was written: it needs a servo with an id of its own")
    write_text(path, text)
    robot = load_robot(path)
    print(f"wrote {path}: {len(robot.joints)} joints. Edit the ranges before anything moves")


def _progress(text: str) -> None:
    """Show what is being tried, where somebody watches."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{text}", end="", file=sys.stderr, flush=True)
