"""The commands `doctor` and `devices`: whether this computer can play, and its sound devices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from msgspec import to_builtins

from lss_motion.cli.commands import add_command, print_json, robot_at
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options, add_robot
from lss_motion.errors import (
    EXIT_FINISHED,
    EXIT_INPUT,
    EXIT_UNREACHABLE,
    BusError,
    InputError,
    LssMotionError,
)
from lss_motion.files.texts import aligned

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands
    from lss_motion.robot.model import Robot
    from lss_motion.system.computer import Finding


DESCRIPTION = """\
Check this computer: Python, packages, permissions of the ports, USB latency, programs that occupy
ports, clock and timer, sound. Each finding has its remedy. It takes a second, opens no port and
changes nothing.

  lss-motion doctor
  lss-motion doctor --tone             play a short tone as well
  lss-motion doctor my_robot.yaml      the servos of this robot as well

  lss-motion doctor --stage hall.yaml  a stage of several figures, before the doors open

With a stage it asks every figure, on the conductor's computer while the figures are served:
does it answer, are version and robot file the same, how well is its clock known, and what does it
find about its computer, disk and servos. It exits with 4 if anything there is bad.

With a robot it also sends queries to its servos: whether they are set up as the robot file has it,
and whether they would restart with higher limits than their joints have. Nothing moves.

Exit codes: 0 ready to play (hints may remain); 2 a package is missing or too old, or a servo is not
what the robot file states; 4 a port may not be opened, or a servo cannot be used.
"""

DEVICES_TEXT = """\
List the sound devices of this computer that can play, each with its driver and the latency that
this driver states. The default device is marked.

Sounds on time need the extra [sound]; on Linux also: sudo apt install libportaudio2
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    doctor = add_command(commands, "doctor", _doctor, DESCRIPTION)
    add_robot(doctor, is_required=False)
    add_options(doctor, "--port")
    doctor.add_argument(
        "--tone",
        nargs="?",
        const="",
        metavar="DEVICE",
        help="play a short tone on the default sound device, or on this one, and print its latency",
    )
    doctor.add_argument(
        "--stage", type=Path, metavar="STAGE", help="examine the figures of this stage instead"
    )
    doctor.add_argument(
        "--trust-network", action="store_true", help="with --stage: the network needs no keys"
    )
    add_options(doctor, "--json")
    add_options(add_command(commands, "devices", _devices, DEVICES_TEXT), "--json")


def _doctor(arguments: argparse.Namespace) -> int:
    from lss_motion.system.computer import Level, examine

    robot = None
    if arguments.stage is not None:
        return _stage(arguments)
    if arguments.robot is not None:
        robot = robot_at(arguments.robot, arguments.port).servo_robot
    elif arguments.port is not None:
        raise InputError("--port is the port of a ROBOT; give its file")
    findings = [*examine(), _sound(arguments.tone)]
    error = None
    if robot is not None:
        more, error = _examined(robot)
        findings += more
    width = max(len(finding.subject) for finding in findings)
    if arguments.json:
        print_json({"findings": to_builtins(findings)})
    for finding in [] if arguments.json else findings:
        say(f"{finding.level:4}  {finding.subject:{width}}  {finding.text}")
        if finding.fix:
            say(f"{'':6}{'':{width}}  → {finding.fix}")
    bad = {finding.subject for finding in findings if finding.level is Level.BAD}
    if not bad:
        return EXIT_FINISHED
    if "packages" in bad or isinstance(error, InputError):
        return EXIT_INPUT
    return EXIT_UNREACHABLE


def _stage(arguments: argparse.Namespace) -> int:
    """Print what all figures of a stage find."""
    from lss_motion.stage.hosts.examine import examine_stage, examined_by_conductor
    from lss_motion.stage.hosts.serving import host_of, settings_of
    from lss_motion.stage.load import load_stage

    if arguments.robot is not None or arguments.tone is not None:
        raise InputError("--stage goes without a robot and without --tone")
    stage = load_stage(arguments.stage)
    if stage.conductor is None:
        raise InputError("has no figures: examine its robot instead", path=arguments.stage)
    try:
        host, robots = host_of(
            stage, stage.conductor, port=arguments.port, trust_network=arguments.trust_network
        )
    except BusError as error:  # The address is in use: perhaps by the conductor.
        settings = settings_of(stage, stage.conductor, is_trusted=arguments.trust_network)
        try:
            found = examined_by_conductor(settings)
        except BusError:
            raise error from None
    else:
        try:
            found = examine_stage(host, robots)
        finally:
            host.close()
    rows = [
        {"figure": one.figure, "subject": row.subject, "level": row.level, "text": row.text}
        for one in found
        for row in one.rows
    ]
    if arguments.json:
        print_json({"rows": rows})
    else:
        cells = [(f"{row['level']:4}", row["figure"], row["subject"], row["text"]) for row in rows]
        for line in aligned(cells):
            say(line)
    return EXIT_UNREACHABLE if any(row["level"] == "bad" for row in rows) else EXIT_FINISHED


def _sound(tone: str | None) -> Finding:
    """Return what can be told of sound; play a tone if a device is named, "" for the default."""
    from lss_motion.sound.device import NoDeviceError, chosen_device, play_tone
    from lss_motion.system.computer import Finding, Level

    try:
        if tone is None:
            device = chosen_device("")
            latency_s, done = device.latency_s, "can play"
        else:
            device, latency_s = play_tone(tone)
            done = "has played a tone; if you did not hear it, look at its volume"
    except NoDeviceError as error:
        fix = "lss-motion devices" if tone else ""
        return Finding(subject="sound", level=Level.HINT, text=str(error), fix=fix)
    text = f"{device.name} ({device.driver}) {done}; its driver states {1000 * latency_s:.0f} ms"
    return Finding(subject="sound", level=Level.OK, text=text)


def _examined(robot: Robot) -> tuple[list[Finding], LssMotionError | None]:
    """Return what a preflight of all joints finds, and the error that would refuse a show."""
    from lss_motion.playing.connection import ask_limits, connect
    from lss_motion.playing.player import checks
    from lss_motion.playing.player.preflight import Examination
    from lss_motion.system.clock import MonotonicClock, VirtualClock
    from lss_motion.system.computer import Finding, Level

    is_simulated = all(bus.is_simulated for bus in robot.buses.values())
    clock = VirtualClock() if is_simulated else MonotonicClock()
    try:
        robot = ask_limits(robot)
        joints = list(robot.joints.values())
        with connect(robot.buses, robot=robot, clock=clock) as connection:
            preflight = connection.run(Examination(joints, robot, reads_stored=True)).preflight
        warnings = preflight.echoes()
        preflight.require_own_ids()
        warnings += checks.check_answers(joints, preflight.answers, robot, stored=preflight.stored)
        warnings += checks.check_range(joints, preflight.answers)
    except LssMotionError as error:
        return [Finding(subject="robot", level=Level.BAD, text=str(error))], error
    findings = [Finding(subject="robot", level=Level.HINT, text=text) for text in warnings]
    findings += [
        Finding(
            subject="stored limits",
            level=Level.HINT,
            text=f"{text}: with that it would restart",
            fix=f"lss-motion configure {robot.path} --limits",
        )
        for text in checks.stored_excesses(joints, preflight.stored)
    ]
    simulated = " (simulated)" if is_simulated else ""
    text = f"{len(joints)} servos answer as {robot.name!r} has them{simulated}"
    return [*findings, Finding(subject="robot", level=Level.OK, text=text)], None


def _devices(arguments: argparse.Namespace) -> int:
    from lss_motion.sound.device import NoDeviceError, devices

    try:
        found = devices()
    except NoDeviceError as error:
        raise InputError(str(error)) from error
    if arguments.json:
        print_json({"devices": to_builtins(found)})
        return EXIT_FINISHED
    width = max((len(device.name) for device in found), default=0)
    for device in found:
        mark = "*" if device.is_default else " "
        say(
            f"{mark} {device.name:{width}}  {device.channels:2} channels  {device.rate_hz:6} Hz  "
            f"{1000.0 * device.latency_s:5.1f} ms  {device.driver}"
        )
    if not found:
        say("this computer has no sound device; connect one, or start its sound server")
    return EXIT_FINISHED
