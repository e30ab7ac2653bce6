"""The steps of `lss-motion configure` that a person sees: differences, questions, outcomes."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.cli import servo_settings
from lss_motion.cli.commands import refuse_overwriting
from lss_motion.cli.configuring import agree
from lss_motion.cli.scanning import ask_alone, roll_call
from lss_motion.cli.tables import write_text
from lss_motion.errors import EXIT_FINISHED, EXIT_UNREACHABLE, BusError, InputError
from lss_motion.maintenance import settings
from lss_motion.maintenance.backup import Kept, backup_text, read_backup
from lss_motion.protocol.family import Family
from lss_motion.protocol.io2 import PIN_IDS

if TYPE_CHECKING:
    import argparse
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from lss_motion.connection import Connection
    from lss_motion.maintenance.roll_call import Present
    from lss_motion.maintenance.settings import Target
    from lss_motion.robot.model import Robot

FACTORY_ID = 0
"""The id of a smart servo from the factory (FACTS.md R1)."""


def apply(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    arguments: argparse.Namespace,
) -> int:
    """Show the differences, ask, write. `wanted` is by the name of the target."""
    is_session = arguments.session
    needed = servo_settings.differing(connection, targets, wanted, is_session=is_session)
    if not needed:
        print(f"nothing to write: {len(targets)} servos are as wanted")
        return EXIT_FINISHED
    print("\n".join(map(str, needed)))
    dangers = {
        text
        for change in needed
        for text in settings.dangers([change], connection.buses[change.target.bus].baud_bps)
    }
    if dangers and not arguments.force:
        raise InputError("; ".join([*sorted(dangers), "--force writes it all the same"]))
    if arguments.dry_run:
        return EXIT_FINISHED
    limp = {c.target.name for c in needed if settings.goes_limp(c, is_session=is_session)}
    if limp:
        print(f"These let go meanwhile: {', '.join(sorted(limp))}. Support what they hold.")
    if not agree(arguments, f"Write {len(needed)} settings?"):
        print("nothing was written")
        return EXIT_FINISHED
    done = servo_settings.write(connection, targets, wanted, is_session=is_session)
    print(f"written and read back: {len(done)} settings")
    return EXIT_FINISHED


def give_id(connection: Connection, arguments: argparse.Namespace) -> int:
    """Give the one servo at an id another one."""
    bus = next(iter(connection.buses))
    (old_id,), new_id = arguments.ids, arguments.new_id
    if len(connection.buses) > 1:
        raise InputError("--new-id needs one line: give --port and --baud instead of ROBOT")
    if old_id == new_id:
        raise InputError(f"it has id {old_id} already")
    (present,) = servo_settings.all_at(connection, bus, [old_id])
    print(f"{present.model}: id {old_id} → {new_id}")
    if arguments.dry_run or not agree(
        arguments, f"Restart the servo with id {old_id} as {new_id}?"
    ):
        print("nothing was written")
        return EXIT_FINISHED
    present = servo_settings.renumber(connection, bus, old_id, new_id)
    number = f", serial number {present.serial_number}" if present.serial_number else ""
    print(f"the {present.model}{number} now has id {new_id}")
    return EXIT_FINISHED


def give_rate(connection: Connection, robot: Robot | None, arguments: argparse.Namespace) -> int:
    """Give all servos of a line another rate; one of several only with `--force`."""
    if len(connection.buses) > 1:
        raise InputError("--new-baud changes one line: give --port and --baud instead of ROBOT")
    (bus,) = connection.buses.values()
    rate_bps = arguments.new_baud
    everybody = roll_call(connection, bus.name)
    if not everybody:
        raise BusError(f"nobody answers on {bus.port} at {bus.baud_bps} bps", url=bus.port)
    shared = [present.servo_id for present in everybody if present.is_shared]
    if shared:
        raise BusError(f"several servos share id {shared[0]}; give each its own first (--new-id)")
    expected = set(arguments.ids or [present.servo_id for present in everybody])
    if robot is not None and not arguments.ids:
        expected = {joint.servo_id for joint in robot.joints.values()}
        missing = expected - {present.servo_id for present in everybody}
        if missing and not arguments.force:
            listed = ", ".join(map(str, sorted(missing)))
            raise InputError(
                f"servo {listed} does not answer and would stay at {bus.baud_bps} bps, where it "
                f"then is alone; plug it in, or add --force"
            )
        expected |= {present.servo_id for present in everybody}
    chosen = [present for present in everybody if present.servo_id in expected]
    left = [str(present.servo_id) for present in everybody if present.servo_id not in expected]
    if left and not arguments.force:
        raise InputError(
            f"servo {', '.join(left)} would stay at {bus.baud_bps} bps: a line carries one rate. "
            f"Leave --id out to change all, or add --force"
        )
    print(f"{len(chosen)} ids go from {bus.baud_bps} to {rate_bps} bps; servos are limp meanwhile.")
    if arguments.dry_run or not agree(arguments, "Go on?"):
        print("nothing was written")
        return EXIT_FINISHED
    lost = servo_settings.change_rate(connection, bus.name, chosen, rate_bps)
    if lost:
        listed = ", ".join(map(str, lost))
        print(f"servo {listed} does not answer at {rate_bps} bps; see `lss-motion scan {bus.port}`")
        return EXIT_UNREACHABLE
    print(f"all answer at {rate_bps} bps; write `baud_bps: {rate_bps}` into the robot file")
    return EXIT_FINISHED


def back_up(
    connection: Connection, targets: Sequence[Target], path: Path, *, is_forced: bool
) -> int:
    """Write all that servos store to a file."""
    refuse_overwriting(path, is_forced=is_forced)
    found = servo_settings.read_whole(connection, targets)
    present = {
        (bus, p.servo_id): p
        for bus in {target.bus for target in targets}
        for p in ask_alone(connection, bus, {t.servo_id: t.model for t in targets if t.bus == bus})
    }
    servos = [
        Kept(
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
        raise BusError("a servo stopped answering while its settings were read; try again")
    write_text(path, backup_text(servos))
    count = sum(len(kept.settings) for kept in servos)
    print(f"wrote {path}: {count} settings of {len(servos)} servos")
    return EXIT_FINISHED


def restore(connection: Connection, arguments: argparse.Namespace) -> int:
    """Write a backup back. A servo that has its factory id again gets its own first."""
    servos = [
        kept
        for kept in read_backup(arguments.restore)
        if kept.servo_id in (arguments.ids or [kept.servo_id])
    ]
    targets, wanted, moves = [], {}, []
    for kept in servos:
        if kept.bus not in connection.buses:
            known = ", ".join(connection.buses)
            raise InputError(
                f"there is no bus {kept.bus!r} here, but {known}", path=arguments.restore
            )
        name = f"servo {kept.servo_id}" + (f" on {kept.bus}" if len(connection.buses) > 1 else "")
        now_id = _find(connection, kept, arguments)
        (target,) = servo_settings.targets_at(connection, kept.bus, {now_id: name})
        if now_id != kept.servo_id:
            moves.append((target, kept.servo_id))
        targets.append(target)
        wanted[target.name] = kept.settings
    for target, servo_id in moves:
        print(f"{target.model}: id {target.servo_id} → {servo_id}")
    if moves and (
        arguments.dry_run or not agree(arguments, f"Give {len(moves)} servos their ids?")
    ):
        print("nothing was written")
        return EXIT_FINISHED
    for target, servo_id in moves:
        servo_settings.renumber(connection, target.bus, target.servo_id, servo_id)
        index = targets.index(target)
        (targets[index],) = servo_settings.targets_at(
            connection, target.bus, {servo_id: target.name}
        )
    return apply(connection, targets, wanted, arguments)


def _find(connection: Connection, kept: Kept, arguments: argparse.Namespace) -> int:
    """Return the id at which the servo of a backup answers now: its own, or that of the factory."""
    pin = kept.model.removeprefix("LSS-2IO-").replace("LED", "MASTER")
    factory_id = PIN_IDS.get(pin, FACTORY_ID)
    found = ask_alone(connection, kept.bus, dict.fromkeys((kept.servo_id, factory_id), ""))
    for present in found:
        if not present.is_shared and _is_same(present, kept):
            return present.servo_id
    own = next((present for present in found if present.servo_id == kept.servo_id), None)
    if own is None or own.is_shared:
        servo_settings.all_at(connection, kept.bus, [kept.servo_id])  # Says what is wrong.
        raise BusError(f"servo {kept.servo_id} answers only now and then; check its plug")
    if own.model != kept.model:
        raise InputError(
            f"servo {kept.servo_id} is an {own.model}; the backup is of an {kept.model}"
        )
    if not arguments.force:
        raise InputError(
            f"servo {kept.servo_id} has serial number {own.serial_number}, the backup is of "
            f"{kept.serial_number}; --force writes it into the new servo"
        )
    return own.servo_id


def _is_same(present: Present, kept: Kept) -> bool:
    if present.model != kept.model:
        return False
    return present.family is Family.IO2 or present.serial_number == kept.serial_number
