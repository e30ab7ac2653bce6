"""The dialogue with the servos before anything moves.

`Preflight` asks what `checks` lists. An answer that would refuse the robot is asked for again: on a
bus without checksums a damaged answer can look like a setting. Then it reads the stored settings,
where they are needed. If bytes came damaged or twice, it looks for servos that share an id
(`TwinSearch`): their replies overlap. `Examination` is a preflight that the runner can drive.

The same calls as `handshake.Dialogue`; nothing but queries is sent.
"""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from lss_motion.errors import BusError, PlaybackError
from lss_motion.playing.player import checks
from lss_motion.playing.player.handshake import Conversation, Dialogue, Item, query, standing_deg
from lss_motion.playing.player.query_tracker import REPLY_MAX_BYTES, REPLY_TIMEOUT_NS
from lss_motion.protocol.codec import storable
from lss_motion.protocol.constants import Family
from lss_motion.protocol.framing import Command, encode
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

    from lss_motion.playing.player.checks import Refusal
    from lss_motion.playing.player.handshake import Answers
    from lss_motion.playing.player.query_tracker import QueryTracker
    from lss_motion.protocol.framing import Reply
    from lss_motion.robot.model import Joint, Robot
    from lss_motion.robot.on_fault import Escalations

AGREEING: Final = 3
"""So many answers must agree on a line that damages replies before they refuse a robot. Chosen: of
440 simulated robots with a third of their replies damaged, two equal wrong answers refused 12.
"""
ASKED_LEAST: Final = 2
ASKED_MOST: Final = 8
"""A servo is asked for its serial number so often, while its answers stay doubtful. Chosen: at
500000 bps about half of the replies of two servos do not overlap, and each number must come twice.
One of 100 such pairs is not found."""
IDENTITY: Final = {
    "MS": "model",
    "F": "firmware",
    "N": "serial number",
    "G": "gyre",
    "O": "origin",
    "AR": "angular range",
}
"""What makes a servo another one, or its angles other ones: it does not change while it is away."""
TWIN_SPREAD_NS: Final = 5 * NS_PER_MS
"""The other servo of an id answers at most so much later: 2 ms (FACTS.md W14), and a margin."""


@dataclass(slots=True)
class _Sample:
    """What came after one query."""

    texts: list[str] = field(default_factory=list)
    is_damaged: bool = False

    @property
    def is_clean(self) -> bool:
        return len(self.texts) == 1 and not self.is_damaged


@dataclass(slots=True)
class _OpenQuery:
    """The query that is waited for on a bus."""

    joint: Joint
    until_ns: int
    garbage: int
    sample: _Sample = field(default_factory=_Sample)


class TwinSearch:
    """Asks servos for their serial numbers, one at a time, to find several with one id.

    `shared` holds, by bus and id, what they answered. A single answer may be damaged or come twice,
    so a second servo has shown itself when two numbers came at least twice each. An RC servo on a
    2IO has no number: there, every query must bring two answers.
    """

    def __init__(
        self,
        joints: Iterable[Joint],
        trackers: Mapping[str, QueryTracker],
    ) -> None:
        self.shared: dict[tuple[str, int], tuple[str, ...]] = {}
        self.damaged: set[tuple[str, int]] = set()
        """Bus and id of servos that sent damaged bytes, and no undamaged answer."""
        self._trackers = trackers
        self._queues: dict[str, deque[Joint]] = {bus: deque() for bus in trackers}
        self._windows: dict[str, _OpenQuery] = {}
        self._samples: dict[tuple[str, int], list[_Sample]] = {}
        for joint in joints:
            self._queues[joint.bus].append(joint)

    @property
    def is_finished(self) -> bool:
        return not self._windows and not any(self._queues.values())

    def advance(self, now_ns: int) -> None:
        for bus, queue in self._queues.items():
            window = self._windows.get(bus)
            if window is not None and now_ns >= window.until_ns:
                del self._windows[bus]
                self._close(window)
                window = None
            if window is None and queue and self._trackers[bus].line.free_ns <= now_ns:
                self._ask(queue[0], now_ns)

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:  # noqa: ARG002
        window = self._windows.get(bus)
        if window is None or reply.servo_id != window.joint.servo_id:
            return
        if reply.keyword == _keyword(window.joint):
            window.sample.texts.append(str(reply.value))

    def next_wakeup_ns(self) -> int | None:
        wakeups_ns = [window.until_ns for window in self._windows.values()]
        wakeups_ns += [
            self._trackers[bus].line.free_ns
            for bus, queue in self._queues.items()
            if queue and bus not in self._windows
        ]
        return min(wakeups_ns, default=None)

    def _ask(self, joint: Joint, now_ns: int) -> None:
        tracker = self._trackers[joint.bus]
        line, latency = tracker.line, tracker.latency(joint.servo_id)
        arrival_ns = line.send(encode(Command(joint.servo_id, _keyword(joint))), now_ns)
        wait_ns = latency.latest_ns if latency.is_known else REPLY_TIMEOUT_NS
        until_ns = arrival_ns + wait_ns + TWIN_SPREAD_NS + line.time_ns(2 * REPLY_MAX_BYTES)
        self._windows[joint.bus] = _OpenQuery(joint, until_ns, line.garbage)

    def _close(self, window: _OpenQuery) -> None:
        """Keep what came after a query; go on with the next servo when this one is clear."""
        joint, sample = window.joint, window.sample
        address = (joint.bus, joint.servo_id)
        line = self._trackers[joint.bus].line
        sample.is_damaged = line.garbage > window.garbage or line.has_unfinished
        samples = self._samples.setdefault(address, [])
        samples.append(sample)
        if serials := _two_numbers(joint, samples):
            self.shared[address] = serials
        elif len(samples) < ASKED_LEAST or not _is_clear(samples):
            if len(samples) < ASKED_MOST:
                return
            damaged_count = sum(sample.is_damaged for sample in samples)
            if not any(sample.texts for sample in samples) and damaged_count >= ASKED_LEAST:
                self.damaged.add(address)
        self._queues[joint.bus].popleft()


def _keyword(joint: Joint) -> str:
    return "QMS" if joint.model.family is Family.IO2 else "QN"


def _is_clear(samples: Sequence[_Sample]) -> bool:
    """Return whether there is one servo, or none, at an id."""
    is_silent = not any(sample.texts or sample.is_damaged for sample in samples)
    is_single = all(sample.is_clean for sample in samples)
    return is_silent or (is_single and len({sample.texts[0] for sample in samples}) == 1)


def _two_numbers(joint: Joint, samples: Sequence[_Sample]) -> tuple[str, ...]:
    """Return what several servos with one id answered; nothing if there is no proof of a second."""
    counts = Counter(text for sample in samples for text in sample.texts)
    if joint.model.family is Family.IO2:
        is_double = len(samples) == ASKED_MOST and all(len(s.texts) > 1 for s in samples)
        return tuple(counts) if is_double else ()
    often = [text for text, count in counts.most_common(2) if count >= ASKED_LEAST]
    if len(often) < 2 or _is_shortened(*often) or _is_shortened(*reversed(often)):
        return ()
    return tuple(often)


def _is_shortened(text: str, other: str) -> bool:
    """Return whether `other` is `text` without one character, as a lost byte leaves it."""
    return any(text[:place] + text[place + 1 :] == other for place in range(len(text)))


class Preflight:
    """One dialogue with the servos of `joints`; see the module.

    `answers` and `stored` map `(bus, servo id, keyword)` to the present and the stored value.
    `more` are further queries. With `reads_stored` the stored settings of all servos are read,
    otherwise only those of servos whose present frame is wrong. `show` are the escalations of the
    show.

    With `before`, the servos were away since that preflight, and have given `answers` since: they
    are asked what makes a servo another one, and must answer as they did then (`require_same`).
    Other servos may have the ids of `suspects`: they are looked for first.
    """

    def __init__(  # noqa: PLR0913  (what differs between its callers)
        self,
        joints: Iterable[Joint],
        robot: Robot,
        trackers: Mapping[str, QueryTracker],
        *,
        more: Sequence[Item] = (),
        led_joints: Container[str] = (),
        reads_stored: bool = False,
        show: Escalations | None = None,
        before: Preflight | None = None,
        answers: Answers = MappingProxyType({}),
        suspects: Sequence[Joint] = (),
    ) -> None:
        self.answers: dict[tuple[str, int, str], int | str | None] = dict(answers)
        self.stored: dict[tuple[str, int, str], int | str | None] = {}
        self.twins: TwinSearch | None = None
        self.joints = list(joints)
        self._robot = robot
        self._trackers = trackers
        self._reads_stored = reads_stored or (before is not None and bool(before.stored))
        self._show = show
        self._before = before
        self._suspects = suspects
        self._calm = {bus: self._disturbances(bus) for bus in trackers}
        if before is None:
            items = [*checks.queries(self.joints, led_joints), *more]
        else:
            items = _identity_queries(self.joints, before.answers)
        self._rounds = self._all_rounds(items)
        self._round: Dialogue | TwinSearch | None = next(self._rounds)

    @property
    def is_finished(self) -> bool:
        return self._round is None

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""
        while self._round is not None:
            self._round.advance(now_ns)
            if not self._round.is_finished:
                return
            self._round = next(self._rounds, None)

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        if self._round is not None:
            self._round.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return None if self._round is None else self._round.next_wakeup_ns()

    def echoes(self) -> list[str]:
        """Return a warning for each port that echoes; raise `BusError` if one does nothing else."""
        return checks.check_echo(self._robot, self.answers, self._trackers)

    def require_own_ids(self) -> None:
        """Raise `BusError` if several servos answer to the id of a joint."""
        twins = self.twins
        for joint in self.joints if twins is not None else ():
            assert twins is not None
            address = (joint.bus, joint.servo_id)
            bus = self._robot.buses[joint.bus]
            remedy = (
                f"Connect one of them alone and give it an id of its own: lss-motion configure "
                f"--port {bus.port} --baud {bus.baud_bps} --id {joint.servo_id} --new-id N"
            )
            if address in twins.shared:
                which = ""
                if joint.model.family is not Family.IO2:
                    which = f" (serial numbers {' and '.join(twins.shared[address])})"
                raise BusError(
                    f"joint {joint.name!r}: several servos{which} have the id {joint.servo_id} on "
                    f"bus {joint.bus!r}, and all of them would move. {remedy}",
                    url=bus.port,
                )
            if address in twins.damaged and joint.name not in standing_deg([joint], self.answers):
                raise BusError(
                    f"joint {joint.name!r}: every answer of id {joint.servo_id} on bus "
                    f"{joint.bus!r} is damaged, as when several servos have one id. {remedy}. If "
                    f"there is only one, check its plug and the baud rate ({bus.baud_bps} bps)",
                    url=bus.port,
                )

    def require_same(self) -> None:
        """Raise if a servo is another one than before, was set up anew, or shares its id.

        Serial numbers are first asked for by the first such preflight: they are compared later.
        """
        assert self._before is not None
        self.require_own_ids()
        if found := self._refusals():
            raise checks.combined(found)
        serials = {key: value for key, value in self.answers.items() if key[2] == "QN"}
        self._before.answers |= serials

    @property
    def unproved(self) -> list[Joint]:
        """The joints whose servos have not answered all that they did before."""
        assert self._before is not None
        known = {key for key in self._before.answers if key[2][1:] in IDENTITY}
        left = (known - self.answers.keys()) | (self._before.stored.keys() - self.stored.keys())
        servos = {(bus, servo_id) for bus, servo_id, _ in left}
        return [joint for joint in self.joints if (joint.bus, joint.servo_id) in servos]

    # ---- the rounds

    def _all_rounds(self, items: Sequence[Item]) -> Iterator[Dialogue | TwinSearch]:
        """Yield one dialogue after the other; each is finished when the next is asked for."""
        if self._suspects:
            self.twins = TwinSearch(self._suspects, self._trackers)
            yield self.twins
            if self.twins.shared:
                return
        first = self._dialogue(items)
        yield first
        self.answers |= first.answers
        disturbed = [j for j in self.joints if self._disturbances(j.bus) > self._calm[j.bus]]
        if disturbed:
            self.twins = TwinSearch(disturbed, self._trackers)
            yield self.twins
        if self.twins is not None and self.twins.shared:
            return
        if items := [*self._asked_again(self._refusals()), *self._unanswered()]:
            again = self._dialogue(items)
            yield again
            self.answers |= again.answers
        wrong = {refusal.joint.name for refusal in self._refusals() if refusal.is_frame}
        joints = [j for j in self.joints if self._reads_stored or j.name in wrong]
        items = checks.stored_queries(joints)
        if self._before is not None:
            items = [item for item in items if _address(item) in self._before.stored]
        if items:
            stored = self._dialogue(items)
            yield stored
            self.stored |= stored.answers
        doubtful = [refusal for refusal in self._refusals() if refusal.is_stored]
        if items := self._asked_again(doubtful):
            again = self._dialogue(items)
            yield again
            self.stored |= again.answers

    def _dialogue(self, items: Iterable[Item]) -> Dialogue:
        return Dialogue(items, self._trackers)

    def _disturbances(self, bus: str) -> int:
        """Return how many bytes or replies came that belong to no query."""
        return self._trackers[bus].line.garbage + self._trackers[bus].strays

    def _refusals(self) -> list[Refusal]:
        if self._before is not None:
            before, robot = self._before, self._robot
            return [one for joint in self.joints for one in _exchange(joint, self, before, robot)]
        present = standing_deg(self.joints, self.answers)
        joints = [joint for joint in self.joints if joint.name in present]
        return checks.refusals(joints, self.answers, self.stored, self._robot, self._show)

    def _unanswered(self) -> list[Item]:
        """Return the queries for angle and frame that a servo left open which answered others.

        It may have restarted in between, which takes longer than all tries of one query.
        """
        if self._before is not None:
            items = _identity_queries(self.joints, self._before.answers)
            return [item for item in items if _address(item) not in self.answers]
        present = standing_deg(self.joints, self.answers)
        answering = {address[:2] for address in self.answers}
        joints = [one for one in self.joints if (one.bus, one.servo_id) in answering]
        angles = [query(joint, "QD") for joint in joints if joint.name not in present]
        frames = [
            item for item in checks.frame_queries(joints) if _address(item) not in self.answers
        ]
        return angles + frames

    def _asked_again(self, doubtful: Iterable[Refusal]) -> list[Item]:
        """Return the queries behind refusals once more; several answers must agree."""
        items = []
        for refusal in doubtful:
            is_disturbed = self._disturbances(refusal.joint.bus) > self._calm[refusal.joint.bus]
            for keyword in refusal.keywords:
                item = query(refusal.joint, keyword)
                item = replace(item, agreeing=AGREEING) if is_disturbed else item
                if refusal.is_stored:
                    item = replace(item, command=item.command._replace(value=1))
                items.append(item)
        return list(dict.fromkeys(items))


def _address(item: Item) -> tuple[str, int, str]:
    return item.bus, item.command.servo_id, item.command.keyword


# ---- servos that were away


def _identity_queries(joints: Iterable[Joint], before: Answers) -> list[Item]:
    """Return the queries that show whether servos are still those that answered `before`.

    A serial number, which is not asked for before a show, is asked for in any case.
    """
    return [
        Item.to(joint, keyword)
        for joint in joints
        for keyword in (f"Q{name}" for name in IDENTITY)
        if (joint.bus, joint.servo_id, keyword) in before
        or (keyword == "QN" and joint.model.family is not Family.IO2)
    ]


def _exchange(joint: Joint, asked: Preflight, before: Preflight, robot: Robot) -> Iterator[Refusal]:
    """Yield a refusal if the servo of a joint does not answer as it did `before`.

    Another one may have taken its place, or it was set up anew, while it was away.
    """
    for new, old, is_stored in (
        (asked.answers, before.answers, False),
        (asked.stored, before.stored, True),
    ):
        names = (*checks.FRAME, *checks.STORED_LIMITS) if is_stored else tuple(IDENTITY)
        keys = {name: (joint.bus, joint.servo_id, f"Q{name}") for name in names}
        other = [n for n, key in keys.items() if key in new and key in old and new[key] != old[key]]
        if not other:
            continue
        kept = "stored " if is_stored else ""
        values = [
            " and ".join(
                f"{kept}{IDENTITY.get(name, 'limit')} ({name}) {_shown(joint, name, value)}"
                for name, value in ((name, one[keys[name]]) for name in other)
            )
            for one in (new, old)
        ]
        error = PlaybackError(
            f"joint {joint.name!r}: servo {joint.servo_id} has {values[0]} since it was away, and "
            f"had {values[1]}: another servo is in its place, or it was set up anew. It is not "
            f"driven. Put the right one back, or look at {robot.path or 'the robot file'}, and "
            f"begin anew",
            joint=joint.name,
        )
        yield checks.Refusal(joint, tuple(f"Q{name}" for name in other), error, is_stored=is_stored)
        return


def _shown(joint: Joint, name: str, value: int | str | None) -> str:
    """Return the value of a setting for a person."""
    row = storable(joint.model.language).get(name)
    if row is None or not isinstance(value, int):
        return str(value)
    return f"{row.physical(value):g} {row.unit}".rstrip()


class Examination(Conversation):
    """A preflight that the runner can drive by itself, for commands without a show."""

    def __init__(
        self, joints: Iterable[Joint], robot: Robot, *, reads_stored: bool = False
    ) -> None:
        super().__init__((), robot.buses)
        self.preflight = Preflight(joints, robot, self.trackers, reads_stored=reads_stored)
        self._dialogue = self.preflight
