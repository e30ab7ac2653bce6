"""Reading and writing what servos store, over an open connection: ask, write, read back, RESET."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from lss_motion.cli.scan import ask_alone
from lss_motion.errors import BusError, InputError
from lss_motion.maintenance import settings
from lss_motion.maintenance.settings import Target
from lss_motion.player.transactions import Item
from lss_motion.protocol.codec import make_command
from lss_motion.protocol.constants import RESET_S, Family
from lss_motion.protocol.line import Command

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.connection import Connection
    from lss_motion.maintenance.discovery import ServoIdentity
    from lss_motion.maintenance.settings import Change, Values

RESET_WAIT_S: Final = RESET_S + 0.25
"""How long a servo is left alone after RESET: it is deaf for 1.25 s (FACTS.md R4), and libraries
wait 1.5 s and more."""
ROUNDS: Final = 4
"""How often a thing is tried until it is so: a line may lose a command, a servo may restart."""
SETTLE_S: Final = 0.02
"""Between writing and reading back: 10 ms is what careful users leave (FACTS.md R9), doubled."""


def targets_at(connection: Connection, bus: str, names: Mapping[int, str]) -> list[Target]:
    """Return the servos at ids of a bus, with the names that people know them by.

    Raises `BusError` if nobody, or more than one, answers to one of them.
    """
    found = {present.servo_id: present for present in all_at(connection, bus, names)}
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
                firmware=firmware if isinstance(firmware, int) else 0,
            )
        )
    return targets


def all_at(connection: Connection, bus: str, ids: Iterable[int]) -> list[ServoIdentity]:
    """Return what answers to each of some ids, in their order.

    Raises `BusError` if there is nobody, or more than one, at one of them.
    """
    ids = list(ids)
    found: dict[int, ServoIdentity] = {}
    for _ in range(2):  # An answer can be lost.
        left = {servo_id: "" for servo_id in ids if servo_id not in found}
        found |= {present.servo_id: present for present in ask_alone(connection, bus, left)}
    line = connection.buses[bus]
    missing = [str(servo_id) for servo_id in ids if servo_id not in found]
    if missing:
        raise BusError(
            f"no servo answers to id {', '.join(missing)} on {line.port} at {line.baud_bps} bps; "
            f"`lss-motion scan {line.port}` finds who is there",
            url=line.port,
        )
    for servo_id in ids:
        if found[servo_id].is_shared:
            raise BusError(
                f"several servos answer to id {servo_id} at once: connect one of them alone",
                url=line.port,
            )
    return [found[servo_id] for servo_id in ids]


def read(
    connection: Connection, targets: Sequence[Target], *, is_session: bool = False
) -> dict[str, Values]:
    """Return the settings of every target by its name; what was not answered is absent.

    A servo that answered something is asked again for the rest: a line may lose an answer.
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
            said = settings.values(target, left[target.name], answers)
            found[target.name] |= said
            rows = left[target.name].items()
            left[target.name] = {name: row for name, row in rows if said and name not in said}
        if not any(left.values()):
            break
    return found


def read_whole(connection: Connection, targets: Sequence[Target]) -> dict[str, Values]:
    """Return all stored settings; raises `BusError` if one cannot be read."""
    found = read(connection, targets)
    for target in targets:
        missing = [name for name in target.rows(is_session=False) if name not in found[target.name]]
        if missing:
            raise BusError(
                f"{target.name} (id {target.servo_id}) did not say all that it stores: "
                f"{', '.join(missing)}. Check plugs and power and try again"
            )
    return found


def write(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    *,
    is_session: bool = False,
) -> list[Change]:
    """Write what is not as wanted until it reads back; return what was changed.

    Servos with changes that act after a RESET get one, and must read back once more after it,
    those that went to another rate or into RC mode excepted.
    Raises `BusError` for what they do not keep.
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
        raise BusError(f"not everything was kept: {kept}. Nothing else was lost; try again")
    return done


def differing(
    connection: Connection,
    targets: Sequence[Target],
    wanted: Mapping[str, Mapping[str, int | None]],
    *,
    is_session: bool,
) -> list[Change]:
    """Return what is not as wanted. A servo that is silent is waited for, then asked again."""
    had = read(connection, targets, is_session=is_session)
    silent = [target for target in targets if not had[target.name]]
    if silent:
        connection.wait(RESET_WAIT_S)
        had |= read(connection, silent, is_session=is_session)
    for target in silent:
        if not had[target.name]:
            raise BusError(
                f"{target.name} (id {target.servo_id}) does not answer any more; check plugs and "
                f"power, then try again"
            )
    return [
        change
        for target in targets
        for change in settings.changes(target, had[target.name], wanted.get(target.name, {}))
    ]


def reset(connection: Connection, targets: Sequence[Target]) -> None:
    """Restart servos and wait until they hear again. They go limp."""
    connection.ask(
        Item(bus=target.bus, command=Command(target.servo_id, "RESET"), is_query=False)
        for target in targets
        if target.family is not Family.IO2
    )
    connection.wait(RESET_WAIT_S)


def renumber(connection: Connection, bus: str, old_id: int, new_id: int) -> ServoIdentity:
    """Give the only servo at `old_id` another id; return it as it answers there.

    Raises `InputError` if the id is taken, `BusError` if nobody or more than one answers, or the
    servo does not take it.
    """
    (present,) = all_at(connection, bus, [old_id])
    command = make_command(present.family, old_id, "CID", new_id)
    for other in ask_alone(connection, bus, {new_id: ""}):
        raise InputError(
            f"id {new_id} is taken by a {other.model or 'servo'}; choose another, or connect the "
            f"servo with id {old_id} alone"
        )
    for _ in range(ROUNDS):
        connection.ask([Item(bus=bus, command=command, is_query=False)])
        connection.wait(SETTLE_S)
        if present.family is not Family.IO2:
            connection.ask([Item(bus=bus, command=Command(old_id, "RESET"), is_query=False)])
            connection.wait(RESET_WAIT_S)
        found = ask_alone(connection, bus, {new_id: "", old_id: ""})
        if [p.servo_id for p in found] == [new_id] and found[0].model == present.model:
            return found[0]
        if not any(p.servo_id == old_id for p in found):
            connection.wait(RESET_WAIT_S)
    raise BusError(
        f"the {present.model} did not go from id {old_id} to {new_id}; power it off and on, then "
        f"`lss-motion scan {connection.buses[bus].port}`"
    )


def change_rate(
    connection: Connection, bus: str, everybody: Sequence[ServoIdentity], baud_bps: int
) -> list[int]:
    """Set servos of a bus to another rate and go there; return the ids that do not answer there.

    Raises `ProtocolError` or `InputError` before anything is written if one of them cannot.
    """
    fixed = [str(p.servo_id) for p in everybody if p.family is Family.LSS_PRO]
    if fixed:
        raise InputError(f"LSS-PRO servos have no baud rate to set (here {', '.join(fixed)})")
    firmware = {
        servo_id: value
        for (_, servo_id, _), value in connection.ask(
            Item(bus=bus, command=Command(p.servo_id, "QF"), is_query=True)
            for p in everybody
            if p.family is Family.LSS
        ).items()
    }
    smart: list[Command] = []
    boards: list[Command] = []
    for present in everybody:
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
    for _ in range(2):  # Nothing acknowledges; the second is for a line that was lost.
        connection.ask(Item(bus=bus, command=command, is_query=False) for command in smart)
        connection.wait(SETTLE_S)
    # A board changes at once: whoever still listens at the old rate must have been told before.
    last = [Command(command.servo_id, "RESET") for command in smart] + boards
    connection.ask(Item(bus=bus, command=command, is_query=False) for command in last)
    connection.wait(RESET_WAIT_S)
    connection.set_baud(bus, baud_bps)
    there = {p.servo_id for p in ask_alone(connection, bus, {p.servo_id: "" for p in everybody})}
    return [present.servo_id for present in everybody if present.servo_id not in there]
