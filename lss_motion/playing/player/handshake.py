"""Dialogues with the servos: settings, restore and recovery, which surround the motion of a show.

`Dialogue` sends a list of queries and orders on all buses, repeats lost queries, and collects the
answers. `Conversation` is one with its own lines, for tools that set up servos without a show.

Before the show, `preflight` has queried every servo, and `checks` has compared the answers with the
robot file and the program. `SettingsDialogue` then sends the session settings until every servo
answers with what it was sent: a timed servo gets the joint's own limits (AA, AD and SD), which it
keeps whatever it receives, and EM1, in which `D…T…` works; a streamed one gets EM0 with the
program's FPC. An RC servo on a 2IO has no settings. `Recovery` waits for servos that are missing.
Afterwards `restoring_orders` gives back the original settings, and `safe_bytes` are the last bytes.

Answers are keyed by `(bus, servo id, keyword)`.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import BusError, PlaybackError
from lss_motion.playing.player.cues import LED_KEYWORD
from lss_motion.playing.player.query_tracker import QueryTracker, SerialLine
from lss_motion.playing.player.servo_model import Probe
from lss_motion.protocol.codec import language_table, make_command, read_reply
from lss_motion.protocol.constants import BROADCAST_ID
from lss_motion.protocol.framing import Command, Reply, encode
from lss_motion.robot.profile import ramp_setting_deg_s2
from lss_motion.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.query_tracker import PendingQuery
    from lss_motion.robot.model import Bus, Joint, Robot, Sensor

    Answers = Mapping[tuple[str, int, str], int | str | None]

TRIES: Final = 6
"""A query is sent this often before the servo counts as silent: on a line that loses every third
answer, one of 700 queries stays open. A servo without any answer does not get its other queries."""
AGREE_TRIES: Final = 8
"""A query whose answer must be confirmed is sent this often at most: on a line that corrupts every
third answer, one of 500 queries stays open."""
UNEXPECTED_AGREEING: Final = 5
"""So many answers must agree on an angle where a joint that rests was not. Chosen: of answers of
which every other one has lost a byte, two like `-11` and `-18` for `-118` come before two right
ones at one servo of 8, five at one of 400 (computed)."""


class Item(Struct, frozen=True, kw_only=True):
    """One command for one bus. A query waits for its answer, an order does not.

    With `agree_within`, a number is accepted when `agreeing` answers differ by no more than that
    (wire units), and a word when it came so often: a bus without checksums can deliver a wrong one.
    A number that differs by more from `expected` needs `UNEXPECTED_AGREEING`.
    """

    bus: str
    command: Command
    tries: int = TRIES
    agree_within: int | None = None
    agreeing: int = 2
    expected: int | None = None

    @classmethod
    def to(cls, servo: Joint | Sensor, keyword: str, value: int | None = None) -> Item:
        """Return a query or an order for one servo, with a value in wire units."""
        return cls(bus=servo.bus, command=Command(servo.servo_id, keyword, value))

    @property
    def is_query(self) -> bool:
        return self.command.keyword.startswith("Q")


@dataclass(slots=True, eq=False)
class _Entry:
    item: Item
    tries_left: int
    earlier_values: list[int | str | None] = field(default_factory=list)

    def accepts(self, value: int | str | None) -> bool:
        """Use an answer; return whether it is accepted."""
        within = self.item.agree_within
        if within is None:
            return True
        agreeing = 1 + sum(_agree(value, earlier, within) for earlier in self.earlier_values)
        self.earlier_values.append(value)
        expected = self.item.expected
        is_expected = expected is None or _agree(value, expected, within)
        return agreeing >= (self.item.agreeing if is_expected else UNEXPECTED_AGREEING)

    @property
    def may_agree(self) -> bool:
        """Whether it is worth sending it again, after an answer that was not accepted."""
        agreeing = self.item.agreeing if self.item.expected is None else UNEXPECTED_AGREEING
        return len(self.earlier_values) < AGREE_TRIES * (agreeing - 1)


class Transactions(Protocol):
    """Queries and orders that are sent on all buses until they are finished."""

    answers: dict[tuple[str, int, str], int | str | None]

    @property
    def is_finished(self) -> bool: ...

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None: ...

    def next_wakeup_ns(self) -> int | None: ...


class Dialogue:
    """Sends items in order, on all buses at the same time.

    Different queries to one servo are in flight together; an order waits until all queries before
    it are answered. `answers` maps `(bus, servo id, keyword)` to the value; a query without an
    answer is absent.
    """

    def __init__(
        self,
        items: Iterable[Item],
        trackers: Mapping[str, QueryTracker],
    ) -> None:
        self.answers: dict[tuple[str, int, str], int | str | None] = {}
        self._trackers = trackers
        self._queues: dict[str, deque[_Entry]] = {bus: deque() for bus in trackers}
        self._in_flight: dict[str, list[_Entry]] = {bus: [] for bus in trackers}
        self._answering: set[tuple[str, int]] = set()
        for item in items:
            self._queues[item.bus].append(_Entry(item, item.tries))

    @property
    def is_finished(self) -> bool:
        return not any(self._queues.values()) and not any(self._in_flight.values())

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""
        for bus in self._queues:
            self._trackers[bus].expire(now_ns)
            self._take_back(bus)
            queue = self._queues[bus]
            while queue and self._can_send(bus, queue[0].item, now_ns):
                entry = queue.popleft()
                if entry.item.is_query:
                    self._trackers[bus].send(entry.item.command, now_ns)
                    entry.tries_left -= 1
                    self._in_flight[bus].append(entry)
                else:
                    self._trackers[bus].line.send(encode(entry.item.command), now_ns)

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        for query, answer in self._trackers[bus].receive(reply, now_ns):
            if (entry := self._entry_of(bus, query)) is not None:
                self._in_flight[bus].remove(entry)
                self._answering.add((bus, query.command.servo_id))
                if entry.accepts(answer.value):
                    self.answers[bus, query.command.servo_id, query.command.keyword] = answer.value
                elif entry.may_agree:
                    entry.tries_left = entry.item.tries  # It answers, so it is not silent.
                    self._queues[bus].appendleft(entry)

    def next_wakeup_ns(self) -> int | None:
        wakeups_ns = []
        for bus, queue in self._queues.items():
            tracker = self._trackers[bus]
            if (give_up_ns := tracker.give_up_ns) is not None:
                wakeups_ns.append(give_up_ns)
            if queue and (earliest_ns := self._earliest_ns(bus, queue[0].item)) is not None:
                wakeups_ns.append(max(self._trackers[bus].line.free_ns, earliest_ns))
        return min(wakeups_ns, default=None)

    def _can_send(self, bus: str, item: Item, now_ns: int) -> bool:
        earliest_ns = self._earliest_ns(bus, item)
        return (
            earliest_ns is not None and max(self._trackers[bus].line.free_ns, earliest_ns) <= now_ns
        )

    def _earliest_ns(self, bus: str, item: Item) -> int | None:
        """Return when `item` may leave; None: a query must be answered first."""
        command, in_flight = item.command, self._in_flight[bus]
        if not item.is_query:
            return None if in_flight else 0
        if any(entry.item.command == command for entry in in_flight):
            return None
        return self._trackers[bus].earliest_ns(command.servo_id, len(encode(command)))

    def _take_back(self, bus: str) -> None:
        """Queue unanswered queries again, in front, as long as they have tries left.

        Only those of servos without a query in flight: theirs were given up, or not accepted. A
        servo that is late with one answer is late with those behind it, which therefore lose no
        try.
        """
        tracker = self._trackers[bus]
        entries = [
            entry
            for entry in self._in_flight[bus]
            if not tracker.is_waiting(entry.item.command.servo_id)
        ]
        late: set[int] = set()
        for entry in entries:
            if entry.item.command.servo_id in late:
                entry.tries_left += 1
            late.add(entry.item.command.servo_id)
        for entry in reversed(entries):
            self._in_flight[bus].remove(entry)
            if entry.tries_left > 0:
                self._queues[bus].appendleft(entry)
            elif (bus, entry.item.command.servo_id) not in self._answering:
                self._give_up(bus, entry.item.command.servo_id)

    def _give_up(self, bus: str, servo_id: int) -> None:
        """Drop the queries to a servo that has answered none; it may still receive orders."""
        kept = [
            entry
            for entry in self._queues[bus]
            if not (entry.item.is_query and entry.item.command.servo_id == servo_id)
        ]
        self._queues[bus] = deque(kept)

    def _entry_of(self, bus: str, query: PendingQuery) -> _Entry | None:
        """Return the entry of a query; None: an earlier dialogue has sent the query."""
        for entry in self._in_flight[bus]:
            if entry.item.command is query.command:
                return entry
        return None


def _agree(one: int | str | None, other: int | str | None, within: int) -> bool:
    if isinstance(one, int) and isinstance(other, int):
        return abs(one - other) <= within
    return one == other


class Conversation:
    """A `Dialogue` that the runner can drive by itself. It sends nothing but its items."""

    def __init__(self, items: Iterable[Item], buses: Mapping[str, Bus]) -> None:
        self.lines = {name: SerialLine(bus) for name, bus in buses.items()}
        self.trackers = {name: QueryTracker(line) for name, line in self.lines.items()}
        self._dialogue: Transactions = Dialogue(items, self.trackers)

    @property
    def answers(self) -> Mapping[tuple[str, int, str], int | str | None]:
        """Answers by `(bus, servo id, keyword)`."""
        return self._dialogue.answers

    def data_to_send(self, leaves_ns: int) -> Mapping[str, bytes]:
        self._dialogue.advance(leaves_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        for reply, _ in self.lines[bus].receive(data, now_ns):
            self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return None if self._dialogue.is_finished else self._dialogue.next_wakeup_ns()

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}


UNCONFIRMED_TRIES: Final = 2
"""Tries per round for a query that a servo has not answered before."""
SETTING_TRIES: Final = 4
"""Rounds in which a setting is sent until the servo answers with it. Chosen: on a line that loses
every tenth command, one of 10,000 settings stays wrong."""


class SettingsDialogue:
    """A `Dialogue` that sends orders until every servo answers with what it was sent.

    `wrong` are the orders that were not applied in `SETTING_TRIES` rounds. Those of `unconfirmed`
    may also stay unanswered, since the servo may not support them. `then` are queries that follow
    the orders in every round.
    """

    def __init__(
        self,
        orders: Sequence[Item],
        then: Iterable[Item],
        unconfirmed: Sequence[Item],
        trackers: Mapping[str, QueryTracker],
    ) -> None:
        self.wrong = list(orders)
        self.answers: dict[tuple[str, int, str], int | str | None] = {}
        self._then = list(then)
        self._unconfirmed = list(unconfirmed)
        self._trackers = trackers
        self._rounds = 0
        self._dialogue = self._round()

    @classmethod
    def of(
        cls,
        joints: Sequence[Joint],
        answers: Answers,
        trackers: Mapping[str, QueryTracker],
        expected_deg: Mapping[str, float] = MappingProxyType({}),
    ) -> SettingsDialogue:
        """Return the dialogue that gives servos the settings for a show, and asks where they are.

        `answers` are those before anything was changed; for `expected_deg` see `position_queries`.
        """
        orders, unconfirmed = session_orders(joints, answers), unconfirmed_orders(joints, answers)
        return cls(orders, position_queries(joints, expected_deg), unconfirmed, trackers)

    @property
    def is_finished(self) -> bool:
        return self._dialogue.is_finished and not self._must_repeat()

    def advance(self, now_ns: int) -> None:
        self._dialogue.advance(now_ns)
        if not self._dialogue.is_finished:
            return
        self.answers.update(self._dialogue.answers)
        self.wrong = not_applied(self.wrong, self.answers)
        self._unconfirmed = not_applied(self._unconfirmed, self.answers)
        if self._must_repeat():
            self._dialogue = self._round()
            self._dialogue.advance(now_ns)
        else:
            self.wrong += [order for order in self._unconfirmed if is_answered(order, self.answers)]
            self._unconfirmed = []

    def _must_repeat(self) -> bool:
        return bool(self.wrong or self._unconfirmed) and self._rounds < SETTING_TRIES

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return self._dialogue.next_wakeup_ns()

    def _round(self) -> Dialogue:
        self._rounds += 1
        unconfirmed = [
            replace(item, tries=UNCONFIRMED_TRIES) for item in read_back(self._unconfirmed)
        ]
        items = [*self.wrong, *self._unconfirmed, *read_back(self.wrong), *unconfirmed, *self._then]
        return Dialogue(items, self._trackers)


STALE_NS: Final = NS_PER_S
"""After so long the settings of all servos are examined before anything moves. Chosen: longer than
that takes with servos that all answer; one that restarts is silent for longer."""
AWAY_NS: Final = NS_PER_S // 4
"""Another servo is not put in the place of one in less. Chosen."""


class Preparation(NamedTuple):
    """When settings were begun to be set, and how many queries had had no answer until then."""

    from_ns: int = 0
    timeouts: int = 0

    def is_doubtful(self, timeouts: int, now_ns: int) -> bool:
        """Return whether a servo may have restarted since its settings were read."""
        return now_ns - self.from_ns > STALE_NS or timeouts > self.timeouts

    def has_missed(self, timeouts: int, now_ns: int) -> bool:
        """Return whether a servo may have been away meanwhile."""
        return now_ns - self.from_ns > AWAY_NS and timeouts > self.timeouts


def read_back(orders: Iterable[Item]) -> list[Item]:
    """Return the queries that show whether orders were applied."""
    return [
        Item(
            bus=order.bus,
            command=Command(order.command.servo_id, f"Q{order.command.keyword}"),
            agree_within=0,
        )
        for order in orders
    ]


def not_applied(orders: Iterable[Item], answers: Answers) -> list[Item]:
    """Return the orders whose values the answers to `read_back` do not confirm."""
    return [
        order
        for order in orders
        if answers.get((order.bus, order.command.servo_id, f"Q{order.command.keyword}"))
        != order.command.value
    ]


def is_answered(order: Item, answers: Answers) -> bool:
    """Return whether the servo answered the read-back of an order."""
    return (order.bus, order.command.servo_id, f"Q{order.command.keyword}") in answers


def not_applied_error(order: Item, answers: Answers, joints: Iterable[Joint]) -> PlaybackError:
    """Return the error for an order that was not applied in `SETTING_TRIES` rounds."""
    command = order.command
    name = next(j.name for j in joints if (j.bus, j.servo_id) == (order.bus, command.servo_id))
    answer = answers.get((order.bus, command.servo_id, f"Q{command.keyword}"))
    return PlaybackError(
        f"joint {name!r}: servo {command.servo_id} was set to {command.keyword} {command.value} "
        f"{SETTING_TRIES} times and answers {'nothing' if answer is None else answer}. Check "
        f"wiring and power; nothing is driven without its limits",
        joint=name,
    )


RESTORING_TIMES: Final = 2
"""Settings are given back this often, without read-back: a stop must not take longer."""
SESSION_KEYWORDS: Final = ("EM", "AA", "AD", "SD", "FPC", "IPE")
LIMIT_KEYWORDS: Final = ("EM", "AA", "AD", "SD")
"""Without these a servo does not keep the joint's limits, or accepts no limits at all."""


def reported(joint: Joint, answers: Answers, keyword: str) -> float | None:
    """Return the value that a servo reported for `keyword`, in physical units; None: no number."""
    value = answers.get((joint.bus, joint.servo_id, keyword))
    if not isinstance(value, int):
        return None
    answer = read_reply(joint.model.language, Reply(joint.servo_id, keyword, value))
    return (
        float(answer.value)
        if answer is not None and isinstance(answer.value, int | float)
        else None
    )


def session_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the settings for the show whose original value is known; see `unconfirmed_orders`."""
    orders = []
    for joint in joints:
        orders += _session_orders(joint, answers, is_known=True)
        orders += [Item.to(joint, keyword, value) for keyword, value in joint.settings.items()]
    return orders


def unconfirmed_orders(joints: Iterable[Joint], answers: Answers) -> list[Item]:
    """Return the limits for the show whose original value is unknown.

    The line was bad, or the servo does not support the query (no document says which family answers
    all). The limits are sent all the same, since limits must hold. They cannot be given back: the
    servo keeps them until it restarts.
    """
    return [
        order
        for joint in joints
        for order in _session_orders(joint, answers, is_known=False)
        if order.command.keyword in LIMIT_KEYWORDS
    ]


def _session_orders(joint: Joint, answers: Answers, *, is_known: bool) -> list[Item]:
    known = language_table(joint.model.language).by_keyword
    return [
        Item(
            bus=joint.bus,
            command=make_command(joint.model.language, joint.servo_id, keyword, value),
        )
        for keyword, value in _session_of(joint).items()
        if f"Q{keyword}" in known
        and is_known is (reported(joint, answers, f"Q{keyword}") is not None)
    ]


def session_commands(joints: Iterable[Joint]) -> list[Command]:
    """Return the settings for the show, for a host that does not read the original values."""
    return [
        command
        for joint in joints
        for command in (
            *(
                make_command(joint.model.language, joint.servo_id, keyword, value)
                for keyword, value in _session_of(joint).items()
            ),
            *(Command(joint.servo_id, keyword, value) for keyword, value in joint.settings.items()),
        )
    ]


def changed(joint: Joint, led_joints: Container[str]) -> list[str]:
    """Return the keywords that a show sets besides those of the drive.

    `led_joints` are the joints whose LED colours it changes.
    """
    lights = [LED_KEYWORD] if joint.name in led_joints and LED_KEYWORD not in joint.settings else []
    return [*joint.settings, *lights]


def _session_of(joint: Joint) -> dict[str, float]:
    """Return the session settings that the drive of a joint needs, in physical units.

    FPC comes before EM0, so that the filter is right from its first step on. It is unknown whether
    SD limits anything in EM0; it does no harm.
    """
    if joint.drive == "stepped":
        return {}
    if joint.drive == "streamed":
        count = float(joint.filter_count)
        return {"FPC": count, "IPE": 1.0, "SD": joint.speed_max_deg_s, "EM": 0.0}
    ramp = ramp_setting_deg_s2(joint)
    return {"EM": 1.0, "AA": ramp, "AD": ramp, "SD": joint.speed_max_deg_s}


def restoring_orders(
    joints: Iterable[Joint], answers: Answers, led_joints: Container[str] = ()
) -> list[Item]:
    """Return the orders that give back all settings, and the LED colours of `led_joints`.

    All of them are repeated `RESTORING_TIMES`.
    """
    return [
        Item.to(joint, keyword, original)
        for _ in range(RESTORING_TIMES)
        for joint in joints
        for keyword in (*SESSION_KEYWORDS, *changed(joint, led_joints))
        if isinstance(original := answers.get((joint.bus, joint.servo_id, f"Q{keyword}")), int)
    ]


PLACE_WITHIN_DEG: Final = 2.0
"""Two positions agree within this: noise, and an arm that sags when a hand releases it."""
AGREE_WITHIN: Final = {"QV": 500, "QT": 20}
"""Largest change of voltage (mV) and temperature (tenths of a degree) within two milliseconds."""
ARRIVED_DEG: Final = 3.0
"""A joint further from its start than this is sent there again; less may be its load."""
LOADED_DEG: Final = 1.0
"""With feedback the load is known after the first approach. A joint that its load keeps further
away than this is sent there once more, corrected: that takes half a second, and the show then
begins at the right place."""


def settings_queries(joints: Iterable[Joint], led_joints: Container[str] = ()) -> list[Item]:
    """Return the queries for what `settings` of the robot file, and LED colours, will overwrite."""
    return [query(joint, f"Q{word}") for joint in joints for word in changed(joint, led_joints)]


def position_queries(
    joints: Iterable[Joint], expected_deg: Mapping[str, float] = MappingProxyType({})
) -> list[Item]:
    """Return the position query of every servo; those that rest should be at `expected_deg`."""
    return [
        replace(
            query(joint, "QD"), expected=round(expected_deg[joint.name] * joint.model.wire_per_deg)
        )
        if joint.name in expected_deg
        else query(joint, "QD")
        for joint in joints
    ]


def query(joint: Joint, keyword: str) -> Item:
    """Return a query of which two answers must agree."""
    within = AGREE_WITHIN.get(keyword, 0)
    if keyword == "QD":
        within = round(PLACE_WITHIN_DEG * joint.model.wire_per_deg)
    command = Command(joint.servo_id, keyword)
    return Item(bus=joint.bus, command=command, agree_within=within)


def standing_deg(joints: Iterable[Joint], answers: Answers) -> dict[str, float]:
    """Return the servo angle of every joint that reported its position."""
    angles = {joint.name: reported(joint, answers, "QD") for joint in joints}
    return {name: angle for name, angle in angles.items() if angle is not None}


def silent_error(
    silent: Sequence[Joint], joints: Sequence[Joint], robot: Robot, answers: Answers
) -> BusError:
    """Return the error for servos without an angle: they do not answer, or no two answers agree."""
    answering = {(bus, servo_id) for bus, servo_id, _ in answers}
    mute = [joint for joint in silent if (joint.bus, joint.servo_id) not in answering]
    named = ", ".join(f"{j.name} (id {j.servo_id} on bus {j.bus!r})" for j in mute or silent)
    bus = robot.buses[(mute or silent)[0].bus]
    if not mute:
        return BusError(
            f"no two angles (QD) agree within {PLACE_WITHIN_DEG:g} deg: {named}. Does something "
            f"move it? Else its servo counts other angles than its `model`, or two servos have "
            f"its id (lss-motion scan)",
            url=bus.port,
        )
    silent = mute
    return BusError(
        f"no answer from {len(silent)} of {len(joints)} servos: {named}. Check power, wiring, "
        f"ids and the baud rate ({bus.baud_bps} bps)",
        url=bus.port,
    )


def safe_bytes(
    robot: Robot, *, is_limp: bool = False, limp: Iterable[Joint] = ()
) -> dict[str, bytes]:
    """Return, per bus, the last bytes of every run: hold where it is, or go limp (FACTS.md A24).

    The motors of `limp` lose their power in any case.
    """
    last = dict.fromkeys(robot.buses, encode(Command(BROADCAST_ID, "L" if is_limp else "H")))
    for joint in limp:
        last[joint.bus] += limp_bytes(joint)
    return last


def limp_bytes(joint: Joint) -> bytes:
    """Return the bytes that take the power from one motor."""
    return encode(Command(joint.servo_id, "L"))


UNLIMITED_TRIES: Final = 1_000_000
"""A recovery ends by its time, not by a number of tries."""


def restart_probes(joints: Iterable[Joint], original: Answers) -> list[Item]:
    """Return for each servo one setting that a restart would change back, if there is one.

    A restart loses all that the session changed, and changes nothing else. So one is enough.
    """
    telling: dict[tuple[str, int], Item] = {}
    for order in changing_orders(joints, original):
        telling.setdefault((order.bus, order.command.servo_id), order)
    return list(telling.values())


def changing_orders(joints: Iterable[Joint], original: Answers) -> list[Item]:
    """Return the settings for the show that differ from the original ones."""
    return not_applied(session_orders(joints, original), original)


def probes(
    joints: Sequence[Joint], original: Answers, orders: Sequence[Item] | None = None
) -> dict[str, list[Probe]]:
    """Return by joint what shows whether its servo has restarted since it was given `orders`.

    None: the settings for a show.
    """
    names = {(joint.bus, joint.servo_id): joint.name for joint in joints}
    found: dict[str, list[Probe]] = {}
    given = session_orders(joints, original) if orders is None else orders
    for order in not_applied(given, original):
        servo, keyword = (order.bus, order.command.servo_id), f"Q{order.command.keyword}"
        before = original.get((*servo, keyword))
        if isinstance(order.command.value, int) and isinstance(before, int):
            probe = Probe(keyword, order.command.value, before)
            found.setdefault(names[servo], []).append(probe)
    return found


@dataclass(slots=True)
class Recovery:
    """One wait: the player brakes and polls until all of `missing` answer, or gives up."""

    give_up_ns: int
    garbage: Mapping[str, int]
    """Unreadable pieces of each bus when it began."""
    missing: list[Joint] = field(default_factory=list)

    def add(self, joints: list[Joint], give_up_ns: int) -> None:
        """Wait for these, too, and for all until `give_up_ns`."""
        self.give_up_ns = give_up_ns
        self.missing += [joint for joint in joints if joint not in self.missing]

    def replace_missing(self, joints: Iterable[Joint]) -> None:
        """Wait for these only."""
        self.missing = list(joints)

    def queries(self, original: Answers) -> list[Item]:
        """Return the queries for their positions, and for the settings that they were sent."""
        orders = session_orders(self.missing, original)
        items = [*read_back(orders), *position_queries(self.missing)]
        return [replace(item, tries=UNLIMITED_TRIES) for item in items]

    def absent(self, answers: Answers) -> list[Joint]:
        """Return the joints that have not reported their position."""
        present = standing_deg(self.missing, answers)
        return [joint for joint in self.missing if joint.name not in present]

    def restarted(self, answers: Answers, original: Answers) -> list[Joint]:
        """Return the joints that have lost the settings that they were sent."""
        return [
            joint
            for joint in self.missing
            if not_applied(session_orders([joint], original), answers)
        ]
