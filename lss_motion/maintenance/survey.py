"""Finds the servos of a bus over an open connection. Sends queries only; moves nothing.

`survey` tries baud rates and ids, for `scan`. `roll_call` finds all ids at the present rate, for
`monitor` and `configure`. `query_each` sends queries to single ids, one at a time, so that replies
of two servos with the same id are noticed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from msgspec.structs import replace

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from lss_motion.playing.connection import Connection
    from lss_motion.playing.discovery import ServoCondition, ServoIdentity, Unasked
    from lss_motion.robot.model import Bus


def survey(
    connection: Connection,
    bus: Bus,
    baud_bps: int | None,
    progress: Callable[[str], None] = lambda _: None,
) -> list[ServoCondition]:
    """Return the servos of a bus, at `baud_bps` or at every rate with a reply.

    `progress` is called with the text of each step. Leaves the port at the rate with the most
    replies.
    """
    from lss_motion.playing.discovery import RATES_BPS, Listening, presence_steps

    rates_bps = list(dict.fromkeys((bus.baud_bps, *RATES_BPS))) if baud_bps is None else [baud_bps]
    used_bps = []
    for rate_bps in rates_bps:
        progress(f"{bus.port}: {rate_bps} bps")
        connection.set_baud(bus.name, rate_bps)
        if any(connection.run(Listening(bus.name, presence_steps(rate_bps))).received):
            used_bps.append(rate_bps)
    looks: list[ServoCondition] = []
    for rate_bps in (
        used_bps or rates_bps[:1]
    ):  # A lone 2IO with other ids replies to its own ids only.
        progress(f"{bus.port}: {rate_bps} bps, all ids")
        connection.set_baud(bus.name, rate_bps)
        looks += _look(connection, bus.name, rate_bps)
    counts = [look.baud_bps for look in looks]
    if counts:
        connection.set_baud(bus.name, max(counts, key=counts.count))
    progress("")
    return looks


def observed(connection: Connection, bus_name: str) -> Unasked:
    """Return what arrives on a bus at its present rate without a query of this program.

    The bus is observed in silence once for each rate.
    """
    from lss_motion.playing import discovery

    baud_bps = connection.buses[bus_name].baud_bps
    unasked = connection.unasked.get((bus_name, baud_bps))
    if unasked is None:
        unasked = connection.unasked[bus_name, baud_bps] = discovery.Unasked()
        silence = discovery.Listening(bus_name, discovery.silent_steps(baud_bps))
        unasked.observe(connection.run(silence).received)
    return unasked


def unreadable(connection: Connection, bus: Bus) -> list[str]:
    """Return the note about a bus on which a survey found unreadable bytes; none without them."""
    from lss_motion.playing.player.unasked import unreadable_text

    seen = [one for (name, _), one in connection.unasked.items() if name == bus.name]
    return [unreadable_text(bus.port)] if any(one.unreadable_bytes for one in seen) else []


def roll_call(connection: Connection, bus_name: str) -> list[ServoIdentity]:
    """Return the servos that reply on a bus at its present rate."""
    from lss_motion.playing import discovery
    from lss_motion.playing.discovery import Listening
    from lss_motion.protocol.constants import ID_MAX

    baud_bps = connection.buses[bus_name].baud_bps
    unasked = observed(connection, bus_name)
    models: dict[int, str] = {}
    doubtful: set[int] = set()
    for _ in range(discovery.ROLL_CALLS):
        left = [servo_id for servo_id in range(ID_MAX + 1) if servo_id not in models]
        received = connection.run(
            Listening(bus_name, discovery.roll_call_steps(baud_bps, left))
        ).received
        unasked.take(received, is_silent=False)
        answered, again = discovery.read_roll_call(baud_bps, left, received)
        models |= answered
        doubtful |= again
    found = {servo_id: models.get(servo_id, "") for servo_id in sorted(models.keys() | doubtful)}
    return query_each(connection, bus_name, found)


def query_each(
    connection: Connection, bus_name: str, models: Mapping[int, str]
) -> list[ServoIdentity]:
    """Return the servos that reply at these ids. `models` may be empty texts.

    While another host disturbs the bus, an id whose queries are regularly answered by unreadable
    bytes is returned as doubtful.
    """
    from lss_motion.playing import discovery
    from lss_motion.playing.discovery import Listening, ServoIdentity
    from lss_motion.protocol.constants import Family

    baud_bps = connection.buses[bus_name].baud_bps
    unasked = observed(connection, bus_name)
    replies: dict[int, list[bytes]] = {servo_id: [] for servo_id in models}

    def query(ids: Iterable[int], keyword: str, times: int) -> None:
        asked = [servo_id for servo_id in ids for _ in range(times)]
        steps = [discovery.question_alone(servo_id, keyword, baud_bps) for servo_id in asked]
        received = connection.run(Listening(bus_name, steps)).received
        for servo_id, data in zip(asked, discovery.own_answers(asked, received), strict=True):
            replies[servo_id].append(data)

    def judge(servo_id: int) -> ServoIdentity | None:
        model, received = models[servo_id], replies[servo_id]
        return discovery.judge_answers(servo_id, model, received, is_disturbed=unasked.is_disturbed)

    query(models, "QMS", discovery.ASKED_ALONE)
    unreadable: list[int] = []
    if unasked.is_decidable:
        unreadable = list(models)
        for _ in range(discovery.UNREADABLE_MAX - discovery.ASKED_ALONE):
            unreadable = [n for n in unreadable if discovery.only_unreadable(n, replies[n])]
            query(unreadable, "QMS", 1)
        unreadable = [n for n in unreadable if discovery.only_unreadable(n, replies[n])]
    judged = {servo_id: judge(servo_id) for servo_id in models}
    numbered = [n for n, present in judged.items() if present and present.family is not Family.IO2]
    query(numbered, "QN", discovery.ASKED_ALONE)
    doubtful = [n for n in models if discovery.is_doubtful(n, replies[n])]
    query([n for n in doubtful if n in numbered], "QN", discovery.ASKED_AGAIN)
    if not unasked.is_decidable:
        query([n for n in doubtful if n not in numbered], "QMS", discovery.ASKED_AGAIN)
    for servo_id in models:
        judged[servo_id] = judge(servo_id)
    for servo_id in unreadable:
        judged[servo_id] = ServoIdentity(servo_id=servo_id, model="", is_doubtful=True)
    return [present for present in judged.values() if present is not None]


def _look(connection: Connection, bus_name: str, baud_bps: int) -> list[ServoCondition]:
    from lss_motion.playing import discovery

    found = roll_call(connection, bus_name)
    unasked = observed(connection, bus_name)
    items = [item for p in found if p.is_single for item in discovery.questions(bus_name, p)]
    answers = connection.ask(items)
    looks = [discovery.read_condition(bus_name, baud_bps, present, answers) for present in found]
    looks = [replace(seen, unasked=unasked.replies[seen.servo_id]) for seen in looks]
    causes = connection.ask(discovery.cause_questions(looks))
    return [
        replace(seen, cause=discovery.read_cause(seen, causes))
        if (bus_name, seen.servo_id, "Q") in causes
        else seen
        for seen in looks
    ]
