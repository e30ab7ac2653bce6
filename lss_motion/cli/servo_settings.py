"""Reads and writes the settings of servos over an open connection, for `configure`.

Every write is read back. A servo with changes that act after a RESET is restarted, and its settings
are read once more. `change_id` and `change_baud` write a setting that moves the servo to another
address, and look for it there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.errors import BusError, InputError
from lss_motion.maintenance import settings
from lss_motion.maintenance.settings import Target
from lss_motion.maintenance.survey import doubtful_text, query_each
from lss_motion.playing.player.handshake import Item
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.constants import RESET_S, Family
from lss_motion.protocol.framing import Command

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.maintenance.settings import SettingChange, Values
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.discovery import ServoIdentity


RESET_WAIT_S: Final = RESET_S + 0.25
"""No command is sent for this time after a RESET: the servo receives nothing for 1.25 s
(FACTS.md R4), and libraries wait 1.5 s and more."""
ROUNDS: Final = 4
"""Attempts until a value is read or written: a command can be lost, a servo can restart."""
SETTLE_S: Final = 0.02
"""Time between writing and reading back: twice the 10 ms that careful users leave (FACTS.md R9)."""


def targets_at(connection: Connection, bus: str, names: Mapping[int, str]) -> list[Target]:
    """Return the servos at these ids of a bus, with the names that people use for them.

    Raises `BusError` if no servo or more than one replies at an id.
    """
    found = {present.servo_id: present for present in servos_at(connection, bus, names)}
    answers = connection.ask(
        Item(bus=bus, command=Command(servo_id, "QF"), is_query=True)
        for servo_id, present in found.items()
        if present.family is not Family.IO2
    )
    targets = []
    for servo_id, name in names.items():
        present, firmware = found[servo_id], answers.get((bus, servo_id, "QF"))
        targets.append(
            Target(
                name=name,
                bus=bus,
                servo_id=servo_id,
                model=present.model,
                family=present.family,
                firmware=firmware if isinstance(firmware, int) else None,
            )
        )
    return targets


def servos_at(connection: Connection, bus: str, ids: Iterable[int]) -> list[ServoIdentity]:
    """Return the servo at each of these ids, in their order.

    Raises `BusError` if no servo or more than one replies at an id.
    """
    ids = list(ids)
    found: dict[int, ServoIdentity] = {}
    for wait_s in (0.0, RESET_WAIT_S):  # A reply can be lost, or a servo restarts.
        left = {servo_id: "" for servo_id in ids if servo_id not in found}
        if left:
            connection.wait(wait_s)
        found |= {present.servo_id: present for present in query_each(connection, bus, left)}
    port, baud_bps = connection.buses[bus].port, connection.buses[bus].baud_bps
    missing = [str(servo_id) for servo_id in ids if servo_id not in found]
    if missing:
        raise BusError(
            f"no servo replies at id {', '.join(missing)} on {port} at {baud_bps} bps; "
            f"`lss-motion scan {port}` lists the servos",
            url=port,
        )
    for servo_id in ids:
        if found[servo_id].is_shared:
            raise BusError(
                f"several servos share id {servo_id}; connect one of them alone",
                url=port,
            )
        if found[servo_id].is_doubtful:
            raise BusError(doubtful_text(servo_id), url=port)
    return [found[servo_id] for servo_id in ids]


def read(
    connection: Connection, targets: Sequence[Target], *, is_session: bool = False
) -> dict[str, Values]:
    """Return the settings of every target by its name, without those that got no reply.

    A servo that sent some replies is queried again for the rest, because a reply can be lost.
    """
    left = {target.name: dict(target.rows(is_session=is_session)) for target in targets}
    found: dict[str, Values] = {target.name: {} for target in targets}
    for _ in range(ROUNDS):
        answers = connection.ask(
            item
            for target in targets
            for item in settings.questions(target, left[target.name], is_session=is_session)
        )
        for target in targets:
            values = settings.values(target, left[target.name], answers)
            found[target.name] |= values
            rows = left[target.name].items()
            left[target.name] = {name: row for name, row in rows if values and name not in values}
        if not any(left.values()):
            break
    return found


def read_whole(connection: Connection, targets: Sequence[Target]) -> dict[str, Values]:
    """Return all stored settings; raise `BusError` if one cannot be read."""
    found = read(connection, targets)
    for target in targets:
        missing = [name for name in target.rows(is_session=False) if name not in found[target.name]]
        if missing:
            raise BusError(
                f"{target.name} (id {target.servo_id}) did not report all settings: "
                f"{', '.join(missing)} missing. Check plugs and power, then try again"
            )
    return found


def write(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    *,
    is_session: bool = False,
) -> list[SettingChange]:
    """Write the settings that differ from `wanted` until they read back; return the changes.

    A servo with a change that acts after a RESET is restarted, and its settings must read back once
    more, unless it went to another baud rate or into RC mode. Raises `BusError` for settings that
    a servo does not keep.
    """
    needed = differing(connection, targets, wanted, is_session=is_session)
    done, unread = list(needed), [c for c in needed if not c.row.queries]
    connection.ask(settings.limp_orders(needed))
    for _ in range(ROUNDS):
        connection.ask(settings.orders(needed, is_session=is_session))
        connection.wait(SETTLE_S)
        needed = differing(connection, targets, wanted, is_session=is_session)
        needed = [change for change in needed if change not in unread]
        if not needed:
            break
        connection.wait(RESET_WAIT_S)
    restarted = {c.target.name: c.target for c in done if c.row.needs_reset and not is_session}
    if restarted and not needed:
        reset(connection, list(restarted.values()))
        gone = {c.target.name for c in done if c.row.name in settings.LEAVING}
        again = [target for name, target in restarted.items() if name not in gone]
        needed = differing(connection, again, wanted, is_session=False)
    if needed:
        kept = "; ".join(
            f"{c.target.name}: {c.row.name} is {settings.value_text(c.row, c.had)}, not "
            f"{settings.value_text(c.row, c.wanted)}"
            for c in needed
        )
        raise BusError(f"servos did not keep all settings: {kept}. The others are kept; try again")
    return done


def differing(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    *,
    is_session: bool,
) -> list[SettingChange]:
    """Return the settings that differ from `wanted`. A silent servo gets time to restart first."""
    had = read(connection, targets, is_session=is_session)
    silent = [target for target in targets if not had[target.name]]
    if silent:
        connection.wait(RESET_WAIT_S)
        had |= read(connection, silent, is_session=is_session)
    for target in silent:
        if not had[target.name]:
            raise BusError(
                f"{target.name} (id {target.servo_id}) no longer replies; check plugs and "
                f"power, then try again"
            )
    return [
        change
        for target in targets
        for change in settings.changes(target, had[target.name], wanted.get(target.name, {}))
    ]


def reset(connection: Connection, targets: Sequence[Target]) -> None:
    """Restart servos and wait until they receive commands again. They go limp."""
    items = [
        Item(bus=target.bus, command=Command(target.servo_id, "RESET"), is_query=False)
        for target in targets
        if target.family is not Family.IO2
    ]
    connection.restart(items, RESET_WAIT_S)


def change_id(connection: Connection, bus: str, old_id: int, new_id: int) -> ServoIdentity:
    """Give the only servo at `old_id` another id; return it as it answers there.

    Raises `InputError` if the id is in use, `BusError` if no servo or more than one replies, or if
    the servo keeps its old id.
    """
    (present,) = servos_at(connection, bus, [old_id])
    command = make_command(present.family, old_id, "CID", new_id)
    for other in query_each(connection, bus, {new_id: ""}):
        raise InputError(
            f"id {new_id} is used by a {other.model or 'servo'}; choose another, or connect the "
            f"servo with id {old_id} alone"
        )
    for _ in range(ROUNDS):
        connection.ask([Item(bus=bus, command=command, is_query=False)])
        connection.wait(SETTLE_S)
        if present.family is not Family.IO2:
            reset_item = Item(bus=bus, command=Command(old_id, "RESET"), is_query=False)
            connection.restart([reset_item], RESET_WAIT_S)
        found = query_each(connection, bus, {new_id: "", old_id: ""})
        if [p.servo_id for p in found] == [new_id] and found[0].model == present.model:
            return found[0]
        if not any(p.servo_id == old_id for p in found):
            connection.wait(RESET_WAIT_S)
    raise BusError(
        f"the {present.model} did not change from id {old_id} to {new_id}; switch it off "
        f"and on, then `lss-motion scan {connection.buses[bus].port}`"
    )


def change_baud(
    connection: Connection, bus: str, servos: Sequence[ServoIdentity], baud_bps: int
) -> list[int]:
    """Set servos of a bus and its port to another baud rate; return the ids without a reply there.

    Raises `ProtocolError` or `InputError` before anything is written if a servo cannot change.
    """
    fixed = [str(p.servo_id) for p in servos if p.family is Family.LSS_PRO]
    if fixed:
        raise InputError(f"LSS-PRO servos have no baud rate to set (ids {', '.join(fixed)})")
    firmware = {
        servo_id: value
        for (_, servo_id, _), value in connection.ask(
            Item(bus=bus, command=Command(p.servo_id, "QF"), is_query=True)
            for p in servos
            if p.family is Family.LSS
        ).items()
    }
    smart: list[Command] = []
    boards: list[Command] = []
    for present in servos:
        if present.family is Family.IO2 and not present.model.endswith("-LED"):
            continue
        known = firmware.get(present.servo_id)
        command = make_command(
            present.family,
            present.servo_id,
            "CB",
            baud_bps,
            firmware=known if isinstance(known, int) else None,
        )
        (boards if present.family is Family.IO2 else smart).append(command)
    for _ in range(2):  # No reply confirms it; the second covers a lost command.
        connection.ask(Item(bus=bus, command=command, is_query=False) for command in smart)
        connection.wait(SETTLE_S)
    # A board changes its rate at once, so it is the last to get its command at the old rate.
    last = [Command(command.servo_id, "RESET") for command in smart] + boards
    connection.ask(Item(bus=bus, command=command, is_query=False) for command in last)
    connection.wait(RESET_WAIT_S)
    connection.set_baud(bus, baud_bps)
    there = {p.servo_id for p in query_each(connection, bus, {p.servo_id: "" for p in servos})}
    return [present.servo_id for present in servos if present.servo_id not in there]
