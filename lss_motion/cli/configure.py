"""The command `configure`: compare, write, back up and restore the settings of servos.

What a person sees: differences, questions, outcomes. `servo_settings` talks to the servos.
"""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command, require_baud, require_joint, robot_at
from lss_motion.cli.messages import agrees, put, say
from lss_motion.cli.options import add_options, add_robot
from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE, BusError, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import comma_text, counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Mapping, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.maintenance.settings import ServoBackup, Target
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.discovery import ServoIdentity
    from lss_motion.robot.model import Bus, Joint, Robot


DESCRIPTION: Final = """\
Compare the settings of servos with those of the robot file or --set. Show the differences, ask,
write them and read them back.

  lss-motion configure my_robot.yaml                      write each joint's `stored:` settings
  lss-motion configure my_robot.yaml --set LED=3          one setting of all joints
  lss-motion configure my_robot.yaml --limits             the same, and the limits of each joint
  lss-motion configure my_robot.yaml --session            `stored:` and `settings:`, until power-off
  lss-motion configure --port P --id 0 --new-id 5         another id, for one servo at a time
  lss-motion configure my_robot.yaml --new-baud 500000    another rate, for all servos of a bus
  lss-motion configure my_robot.yaml --backup b.yaml      save all settings; --restore writes them

--limits is the recommended set-up. A servo that restarts (a loose plug, a dip of its supply)
forgets the limits that a show has given it. From the factory it then moves at its full speed, until
that is noticed; with stored limits it never does. Shows with --no-feedback require them.

Without anything to write it prints the stored settings. Names and units are those of
`lss-motion reference`; in a robot file: `stored: {G: -1, O: 2.5, LED: 3, FD: DIS}`.
Some settings act after a RESET: the servo restarts, and is limp for a moment.
"""
FACTORY_ID: Final = 0
"""The id of a smart servo from the factory (FACTS.md R1)."""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    configure = add_command(commands, "configure", _configure, DESCRIPTION)
    add_robot(configure, is_required=False)
    add_options(configure, "--port", "--baud")
    configure.add_argument(
        "--joint", action="append", metavar="NAME", help="only this joint; may be repeated"
    )
    configure.add_argument(
        "--id",
        action="append",
        type=int,
        metavar="N",
        dest="ids",
        help="only the servo with this id; may be repeated",
    )
    configure.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        dest="sets",
        help="write this setting, not those of the robot file; may be repeated",
    )
    configure.add_argument(
        "--limits",
        action="store_true",
        help="also store the speed and acceleration of each joint of ROBOT (SD, AA, AD)",
    )
    configure.add_argument(
        "--session", action="store_true", help="write values that last until power-off"
    )
    configure.add_argument("--dry-run", action="store_true", help="print the differences only")
    add_options(configure, "--yes", help="write without the question")
    add_options(
        configure,
        "--force",
        help="also write what may make a servo unreachable; overwrite a backup file",
    )
    modes = configure.add_mutually_exclusive_group()
    modes.add_argument("--new-id", type=int, metavar="N", help="give one servo this id")
    modes.add_argument("--new-baud", type=int, metavar="BPS", help="give a bus this baud rate")
    modes.add_argument("--backup", type=Path, metavar="FILE", help="save all settings to a file")
    modes.add_argument(
        "--restore", type=Path, metavar="FILE", help="write the settings of a backup"
    )


def _configure(arguments: argparse.Namespace) -> int:
    from lss_motion.playing.connection import connect

    robot = None
    if arguments.robot is not None:
        robot = robot_at(arguments.robot, arguments.port).servo_robot
    _check(arguments, robot)
    buses = {"main": _bus(arguments)} if robot is None else robot.buses
    with connect(buses, robot=robot) as connection:
        if connection.simulated:
            say("The servos are simulated: they lose what is written when this command ends.")
        _note_other_hosts(connection)
        if arguments.new_id is not None:
            return _change_id(connection, arguments)
        if arguments.new_baud is not None:
            return _change_baud(connection, robot, arguments)
        if arguments.restore is not None:
            return _restore(connection, arguments)
        targets = _targets(connection, robot, arguments)
        if arguments.backup is not None:
            return _back_up(
                connection,
                targets,
                arguments.backup,
                robot_path=arguments.robot,
                is_forced=arguments.force,
            )
        wanted = _wanted(targets, robot, arguments)
        if any(wanted.values()):
            return _apply(connection, targets, wanted, arguments)
        code = _show(connection, targets, arguments)
        if robot is not None and not arguments.session:
            _note_limits(connection, targets, robot)
        return code


def _note_other_hosts(connection: Connection) -> None:
    """Print what arrives on the buses without a query of this program."""
    from lss_motion.maintenance.survey import observed, other_hosts

    for bus in connection.buses.values():
        for text in other_hosts(bus.port, observed(connection, bus.name)):
            say(f"note: {text}")


def _is_agreed(arguments: argparse.Namespace, question: str) -> bool:
    """Ask a person whether to go on. With `--yes` the answer is yes."""
    if arguments.yes:
        return True
    if not sys.stdin.isatty():
        raise InputError(
            "there is no terminal to agree on; add --yes to write without the question"
        )
    try:
        return agrees(question)
    except KeyboardInterrupt:
        say("\nnothing was written")
        raise


@contextlib.contextmanager
def _writing(text: str) -> Iterator[None]:
    """While servos are written: print `text`, which says what to do, when that is interrupted."""
    try:
        yield
    except KeyboardInterrupt:
        put(f"interrupted while servos were written: {text}", sys.stderr)
        raise


def _check(arguments: argparse.Namespace, robot: Robot | None) -> None:
    """Refuse arguments that contradict each other."""
    if robot is None and arguments.port is None:
        raise InputError("give a ROBOT file, or --port and --id of a servo")
    if robot is None and arguments.joint:
        raise InputError("--joint needs a ROBOT file; without one, --id names the servo")
    if arguments.limits and (robot is None or arguments.session):
        raise InputError(
            "--limits stores the limits of a ROBOT file; it cannot be used without one, nor with "
            "--session"
        )
    if robot is not None and arguments.baud is not None:
        raise InputError(
            "the robot file sets the baud rate; --baud is for --port without a robot file"
        )
    _check_numbers(arguments)
    for name in arguments.joint or ():
        if robot is not None:
            require_joint(robot, name)
    is_other = any(
        mode is not None
        for mode in (arguments.new_id, arguments.new_baud, arguments.backup, arguments.restore)
    )
    if is_other and (arguments.sets or arguments.session or arguments.limits):
        raise InputError(
            "--set, --limits and --session cannot be used with --new-id, --new-baud, --backup or "
            "--restore"
        )
    if arguments.new_id is not None and len(arguments.ids or ()) != 1:
        raise InputError("--new-id is for one servo; give its present id with --id")


def _check_numbers(arguments: argparse.Namespace) -> None:
    from lss_motion.protocol.constants import ID_MAX

    require_baud("--baud", arguments.baud)
    require_baud("--new-baud", arguments.new_baud)
    for servo_id in [
        *(arguments.ids or ()),
        *([] if arguments.new_id is None else [arguments.new_id]),
    ]:
        if not 0 <= servo_id <= ID_MAX:
            raise InputError(f"id {servo_id}: an id is from 0 to {ID_MAX}")


def _bus(arguments: argparse.Namespace) -> Bus:
    from lss_motion.robot.model import Bus

    return Bus(name="main", port=arguments.port, baud_bps=arguments.baud or 115200, firmware=370)


def _targets(
    connection: Connection, robot: Robot | None, arguments: argparse.Namespace
) -> list[Target]:
    """Return the chosen servos; each of them has replied."""
    from msgspec.structs import replace

    from lss_motion.maintenance.api import targets_at
    from lss_motion.maintenance.survey import roll_call
    from lss_motion.robot.servo_models import model_mismatch_text

    if robot is None:
        ids = arguments.ids or [present.servo_id for present in roll_call(connection, "main")]
        if not ids:
            raise BusError(
                f"no servo replies on {arguments.port}; try `lss-motion scan {arguments.port}`"
            )
        return targets_at(connection, "main", {servo_id: f"servo {servo_id}" for servo_id in ids})
    joints = {
        name: joint
        for name, joint in robot.joints.items()
        if name in (arguments.joint or robot.joints)
        and joint.servo_id in (arguments.ids or [joint.servo_id])
    }
    found: dict[str, Target] = {}
    for bus in robot.buses:
        names = {joint.servo_id: name for name, joint in joints.items() if joint.bus == bus}
        found |= {target.name: target for target in targets_at(connection, bus, names)}
    for name, joint in joints.items():
        if not found[name].model.startswith(joint.model.name):
            raise InputError(
                f"joint {name!r}: {model_mismatch_text(joint, found[name].model)}",
                path=robot.path,
                line=joint.lines.get("model"),
            )
    return [replace(found[name], units=joint.model.units) for name, joint in joints.items()]


def _wanted(
    targets: Sequence[Target], robot: Robot | None, arguments: argparse.Namespace
) -> dict[str, dict[str, int | None]]:
    """Return the wire values that the robot file or `--set` sets, by the name of the target."""
    from lss_motion.protocol.codec import stored_wire

    given = dict(_assigned(text) for text in arguments.sets)
    wanted: dict[str, dict[str, int | None]] = {}
    for target in targets:
        stored: dict[str, float | None] = dict(given)
        if robot is not None and not given:
            stored = dict(robot.joints[target.name].stored)
        values = {name: stored_wire(target.language, name, value) for name, value in stored.items()}
        if robot is not None and arguments.limits:
            values |= _limits(robot.joints[target.name], values)
        if arguments.session:
            if robot is not None and not given:
                values |= robot.joints[target.name].settings
            session = target.rows(is_session=True)
            for name in [name for name in values if name not in session]:
                if name in given:
                    raise InputError(f"{name} has no value until power-off; leave --session out")
                del values[name]
        wanted[target.name] = values
    return wanted


def _limits(joint: Joint, wanted: Mapping[str, int | None]) -> dict[str, int]:
    """Return the limits of a joint as wire values, or lower ones that the file wants stored."""
    from lss_motion.playing.player.checks import stored_limits

    limits = stored_limits(joint)
    own = {name: value for name, value in wanted.items() if value is not None and name in limits}
    return {name: min(limit, own.get(name, limit)) for name, limit in limits.items()}


def _assigned(text: str) -> tuple[str, float | None]:
    name, separator, value = text.partition("=")
    try:
        return name.upper(), None if value.upper() == "DIS" else float(value)
    except ValueError:
        hint = "write NAME=VALUE, such as LED=3; FD=DIS switches a first position off"
        problem = f"{value!r} is not a number{comma_text(value)}" if separator else "there is no ="
        raise InputError(f"--set {text}: {problem}; {hint}") from None


def _show(connection: Connection, targets: Sequence[Target], arguments: argparse.Namespace) -> int:
    """Print the stored settings, or with --session the present ones."""
    from lss_motion.maintenance import settings
    from lss_motion.maintenance.api import read_settings

    found = read_settings(connection, targets, is_session=arguments.session)
    is_whole = True
    for target in targets:
        say(f"{target.name} (id {target.servo_id}, {target.model}):")
        for name, row in target.rows(is_session=arguments.session).items():
            is_whole = is_whole and name in found[target.name]
            value = found[target.name].get(name)
            shown = settings.value_text(row, value) if name in found[target.name] else "no reply"
            say(f"  {name:10} {shown:16} {row.meaning}")
    return EXIT_FINISHED if is_whole else EXIT_UNREACHABLE


def _note_limits(connection: Connection, targets: Sequence[Target], robot: Robot) -> None:
    """Print which servos store higher limits than their joints have, and how to mend it."""
    from lss_motion.playing.player.checks import stored_excesses, stored_queries

    joints = [robot.joints[target.name] for target in targets]
    excesses = stored_excesses(joints, connection.ask(stored_queries(joints)))
    if excesses:
        say(
            f"note: {len(excesses)} of {len(joints)} servos store higher limits than their joints "
            f"have, with which they would restart. --limits stores those of the joints: "
            f"{excesses[0]}"
        )


def _apply(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    arguments: argparse.Namespace,
) -> int:
    """Show the differences, ask, write. `wanted` is by the name of the target."""
    from lss_motion.maintenance import api, settings

    is_session = arguments.session
    needed = api.differing(connection, targets, wanted, is_session=is_session)
    if not needed:
        say(f"nothing to write: {len(targets)} servos have these settings already")
        return EXIT_FINISHED
    say("\n".join(map(str, needed)))
    dangers = {
        text
        for change in needed
        for text in settings.dangers([change], connection.buses[change.target.bus].baud_bps)
    }
    if dangers and not arguments.force:
        raise InputError("; ".join([*sorted(dangers), "add --force to write it"]))
    if arguments.dry_run:
        return EXIT_FINISHED
    limp = {c.target.name for c in needed if settings.goes_limp(c, is_session=is_session)}
    if limp:
        say(f"These go limp meanwhile: {', '.join(sorted(limp))}. Support their load.")
    if not _is_agreed(arguments, f"Write {counted(needed, 'setting')}?"):
        say("nothing was written")
        return EXIT_FINISHED
    with _writing("some may have their new settings, others not. Give the same command again"):
        done = api.write_settings(connection, targets, wanted, is_session=is_session)
    say(f"written and read back: {counted(done, 'setting')}")
    return EXIT_FINISHED


def _change_id(connection: Connection, arguments: argparse.Namespace) -> int:
    """Give the only servo at an id another id."""
    from lss_motion.maintenance import api

    bus = next(iter(connection.buses))
    (old_id,), new_id = arguments.ids, arguments.new_id
    if len(connection.buses) > 1:
        raise InputError("--new-id needs one bus: give --port and --baud instead of ROBOT")
    if old_id == new_id:
        raise InputError(f"it has id {old_id} already")
    (present,) = api.servos_at(connection, bus, [old_id])
    say(f"{present.model}: id {old_id} → {new_id}")
    if arguments.dry_run or not _is_agreed(
        arguments, f"Restart the servo with id {old_id} as {new_id}?"
    ):
        say("nothing was written")
        return EXIT_FINISHED
    with _writing(
        f"the {present.model} may have id {old_id} or {new_id}, and takes {new_id} when it is "
        f"switched off and on if it got that far. `lss-motion scan {connection.buses[bus].port}` "
        f"shows it"
    ):
        present = api.change_id(connection, bus, old_id, new_id)
    number = f", serial number {present.serial_number}" if present.serial_number else ""
    say(f"the {present.model}{number} now has id {new_id}")
    return EXIT_FINISHED


def _require_own_ids(servos: Sequence[ServoIdentity], port: str) -> None:
    """Raise `BusError` if several servos share an id, or may share it."""
    from lss_motion.maintenance.survey import doubtful_text

    shared = [present.servo_id for present in servos if present.is_shared]
    if shared:
        raise BusError(f"several servos share id {shared[0]}; give each its own first (--new-id)")
    for present in servos:
        if present.is_doubtful:
            raise BusError(doubtful_text(present.servo_id), url=port)


def _change_baud(connection: Connection, robot: Robot | None, arguments: argparse.Namespace) -> int:
    """Give all servos of a bus another baud rate; only some of them with `--force`."""
    from lss_motion.maintenance import api
    from lss_motion.maintenance.survey import roll_call

    if len(connection.buses) > 1:
        raise InputError("--new-baud changes one bus: give --port and --baud instead of ROBOT")
    (bus,) = connection.buses.values()
    rate_bps = arguments.new_baud
    servos = roll_call(connection, bus.name)
    if not servos:
        raise BusError(
            f"no servo replies on {bus.port} at {bus.baud_bps} bps; `lss-motion scan {bus.port}` "
            f"finds them at every rate",
            url=bus.port,
        )
    _require_own_ids(servos, bus.port)
    expected = set(arguments.ids or [present.servo_id for present in servos])
    if robot is not None and not arguments.ids:
        expected = {joint.servo_id for joint in robot.joints.values()}
        missing = expected - {present.servo_id for present in servos}
        if missing and not arguments.force:
            listed = ", ".join(map(str, sorted(missing)))
            raise InputError(
                f"servo {listed} does not reply and would stay alone at {bus.baud_bps} bps; plug "
                f"it in, or add --force if it has {rate_bps} bps already (`lss-motion scan "
                f"{bus.port}`)"
            )
        expected |= {present.servo_id for present in servos}
    chosen = [present for present in servos if present.servo_id in expected]
    left = [str(present.servo_id) for present in servos if present.servo_id not in expected]
    if left and not arguments.force:
        raise InputError(
            f"servo {', '.join(left)} would stay at {bus.baud_bps} bps, but a bus has one "
            f"rate. Leave --id out to change all, or add --force"
        )
    say(
        f"{len(chosen)} ids go from {bus.baud_bps} to {rate_bps} bps; "
        f"the servos are limp meanwhile."
    )
    if arguments.dry_run or not _is_agreed(arguments, "Go on?"):
        say("nothing was written")
        return EXIT_FINISHED
    with _writing(
        f"some servos may be at {bus.baud_bps} bps, others at {rate_bps}. `lss-motion scan "
        f"{bus.port}` lists them with the command that mends it"
    ):
        lost = api.change_baud(connection, bus.name, chosen, rate_bps)
    if lost:
        listed = ", ".join(map(str, lost))
        say(f"servo {listed} does not reply at {rate_bps} bps; see `lss-motion scan {bus.port}`")
        return EXIT_UNREACHABLE
    say(f"all servos reply at {rate_bps} bps; write `baud_bps: {rate_bps}` into the robot file")
    return EXIT_FINISHED


def _back_up(
    connection: Connection,
    targets: Sequence[Target],
    path: Path,
    *,
    robot_path: Path | None,
    is_forced: bool,
) -> int:
    """Write all stored settings to a file."""
    from lss_motion.maintenance import api
    from lss_motion.maintenance.settings import ServoBackup, backup_text
    from lss_motion.maintenance.survey import query_each

    output = Output(path, OutputKind.YAML)
    require_outputs([output], sources=[robot_path], is_forced=is_forced)
    found = api.read_whole(connection, targets)
    present = {
        (bus, p.servo_id): p
        for bus in {target.bus for target in targets}
        for p in query_each(connection, bus, {t.servo_id: t.model for t in targets if t.bus == bus})
    }
    servos = [
        ServoBackup(
            bus=target.bus,
            servo_id=target.servo_id,
            model=target.model,
            serial_number=present[target.bus, target.servo_id].serial_number,
            settings=found[target.name],
        )
        for target in targets
        if (target.bus, target.servo_id) in present
    ]
    if len(servos) != len(targets):
        raise BusError("a servo stopped replying while its settings were read; try again")
    write_output(path, backup_text(servos))
    count = sum(len(kept.settings) for kept in servos)
    say(f"wrote {path}: {counted(count, 'setting')} of {counted(servos, 'servo')}")
    return EXIT_FINISHED


def _restore(connection: Connection, arguments: argparse.Namespace) -> int:
    """Write the settings of a backup. A servo with the factory id gets its old id first."""
    from lss_motion.maintenance import api
    from lss_motion.maintenance.settings import read_backup

    servos = [
        kept
        for kept in read_backup(arguments.restore)
        if kept.servo_id in (arguments.ids or [kept.servo_id])
    ]
    targets, wanted, moves = [], {}, []
    for kept in servos:
        if kept.bus not in connection.buses:
            known = ", ".join(connection.buses)
            raise InputError(f"unknown bus {kept.bus!r}; there is {known}", path=arguments.restore)
        name = f"servo {kept.servo_id}" + (f" on {kept.bus}" if len(connection.buses) > 1 else "")
        now_id = _find(connection, kept, arguments)
        (target,) = api.targets_at(connection, kept.bus, {now_id: name})
        if now_id != kept.servo_id:
            moves.append((target, kept.servo_id))
        targets.append(target)
        wanted[target.name] = kept.settings
    for target, servo_id in moves:
        say(f"{target.model}: id {target.servo_id} → {servo_id}")
    if moves and (
        arguments.dry_run or not _is_agreed(arguments, f"Give {counted(moves, 'servo')} a new id?")
    ):
        say("nothing was written")
        return EXIT_FINISHED
    for target, servo_id in moves:
        with _writing("some servos may have their ids, others not. Give the same command again"):
            api.change_id(connection, target.bus, target.servo_id, servo_id)
        index = targets.index(target)
        (targets[index],) = api.targets_at(connection, target.bus, {servo_id: target.name})
    return _apply(connection, targets, wanted, arguments)


def _find(connection: Connection, kept: ServoBackup, arguments: argparse.Namespace) -> int:
    """Return the present id of the servo of a backup: its own, or that of the factory."""
    from lss_motion.maintenance import api
    from lss_motion.maintenance.survey import query_each
    from lss_motion.protocol.io2 import PIN_IDS

    pin = kept.model.removeprefix("LSS-2IO-").replace("LED", "MASTER")
    factory_id = PIN_IDS.get(pin, FACTORY_ID)
    found = query_each(connection, kept.bus, dict.fromkeys((kept.servo_id, factory_id), ""))
    for present in found:
        if present.is_single and _is_same(present, kept):
            return present.servo_id
    own = next((present for present in found if present.servo_id == kept.servo_id), None)
    if own is None or not own.is_single:
        api.servos_at(connection, kept.bus, [kept.servo_id])  # Raises the error that explains it.
        raise BusError(f"servo {kept.servo_id} replies only sometimes; check its plug")
    if own.model != kept.model:
        raise InputError(
            f"servo {kept.servo_id} is an {own.model}, but the backup is of an {kept.model}"
        )
    if not arguments.force:
        raise InputError(
            f"servo {kept.servo_id} has serial number {own.serial_number}, but the backup is of "
            f"{kept.serial_number}; add --force to write it into this servo"
        )
    return own.servo_id


def _is_same(present: ServoIdentity, kept: ServoBackup) -> bool:
    from lss_motion.protocol.constants import Family

    if present.model != kept.model:
        return False
    return present.family is Family.IO2 or present.serial_number == kept.serial_number
