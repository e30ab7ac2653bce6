"""Notices that two servos have one id: their answers come twice, or damage each other.

A line that doubles replies does so for all servos; two servos with one id answer twice for that id
alone. An answer is clean if neither a second one nor garbage comes until `TWIN_NS` after it: two
servos give none. From the first answer that came twice, or the third in a row that was damaged,
until a clean one, an id is unclear: its servo is sent no move. After two that came twice it must be
examined. So no move leaves from the answers on that show it; damaged ones take three queries, some
0.1 s, since noise damages single ones.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from lss_motion.protocol.framing import Reply

TWIN_NS: Final = 10 * NS_PER_MS
"""A second servo of an id answers at most so much later than the first: 2 ms (FACTS.md W14), with a
margin for the line and the adapter."""
TWIN_ANSWERS: Final = 2
"""After so many answers in a row that came twice, two servos may have the id. Chosen: to examine
it costs a show some seconds."""
DAMAGED_ANSWERS: Final = 3
"""After so many damaged answers in a row an id is unclear. Chosen: as many signs of a restart hold
the moves of a servo back (`servo_model.HOLD_SIGNS`), and these are such signs, too."""
SINGLE_FLIGHTS: Final = 6
"""The others must have been asked so often, and no answer of theirs came twice: a line that doubles
replies, all or a fifth of them, shows by then that it is no matter of one id. Chosen. Answers that
differ need no others: no line makes them."""
TWIN_PAUSE: Final = 100
"""So many must come twice until the same is suspected once more. Chosen: an examination found one
servo, so the line doubles its replies."""


class _Answered(NamedTuple):
    """The last answer to one keyword, unless it has come twice."""

    at_ns: int
    value: int | str | None
    garbage: int
    """Garbage of the line when its queries began."""


class Twins:
    """Which ids on one line may be those of two servos."""

    def __init__(self) -> None:
        self.doubled: list[int] = []
        """Ids to be examined; a caller that uses them empties it."""
        self.unclear: dict[int, int] = {}
        """By id that is unclear, its answers in a row that came twice."""
        self._asked: Counter[int] = Counter()
        self._damaged: Counter[int] = Counter()
        """By id, the damaged answers in a row."""
        self._answers: dict[int, dict[str, _Answered]] = {}
        self._doublers: set[int] = set()
        """Ids of which an answer ever came twice."""
        self._pauses: dict[int, int] = {}
        """By id that was examined, how many of its answers are to come twice until the next."""

    def note_asked(self, servo_id: int) -> None:
        """Note a row of queries."""
        self._asked[servo_id] += 1

    def note_answer(
        self, servo_id: int, reply: Reply, now_ns: int, before: int, garbage: int
    ) -> None:
        """Note the answer to a query; `before` its row so much garbage had come, and by now."""
        answers = self._answers.setdefault(servo_id, {})
        answers[reply.keyword] = _Answered(now_ns, reply.value, before)
        if before == garbage and self._damaged:
            self._damaged.pop(servo_id, None)

    def note_damaged(self, servo_id: int) -> None:
        """Note that garbage came in place of an answer."""
        self._damaged[servo_id] += 1
        if self._damaged[servo_id] >= DAMAGED_ANSWERS and servo_id not in self.unclear:
            self._answers[servo_id] = {}
            self.unclear[servo_id] = 0

    def note_again(self, servo_id: int, reply: Reply, now_ns: int) -> None:
        """Note a reply that answers no query."""
        answers = self._answers.get(servo_id, {})
        first = answers.pop(reply.keyword, None)
        if first is None or now_ns - first.at_ns > TWIN_NS:
            return
        self._doublers.add(servo_id)
        self._pauses[servo_id] = self._pauses.get(servo_id, 1) - 1
        is_examined = self._pauses[servo_id] > 0
        if is_examined or not self._is_only(servo_id, is_other=first.value != reply.value):
            return
        if servo_id not in self.unclear:
            self._answers[servo_id] = {  # What is older says nothing about now.
                keyword: one for keyword, one in answers.items() if now_ns - one.at_ns <= TWIN_NS
            }
        self.unclear[servo_id] = self.unclear.get(servo_id, 0) + 1
        if self.unclear[servo_id] >= TWIN_ANSWERS:
            self._pauses[servo_id] = TWIN_PAUSE
            self.doubled.append(servo_id)

    def settle(self, now_ns: int, garbage: int) -> None:
        """Let no id be unclear that has given a clean answer; so much garbage has come by now."""
        for servo_id in list(self.unclear):
            answers = self._answers[servo_id]
            over = [word for word, one in answers.items() if now_ns - one.at_ns > TWIN_NS]
            is_explained = self._pauses.get(servo_id, 0) > 0 or not self._doublers <= {servo_id}
            if is_explained or any(answers[word].garbage == garbage for word in over):
                del self.unclear[servo_id]
                self._damaged.pop(servo_id, None)
            for word in over:
                del answers[word]

    def settles_ns(self) -> int | None:
        """Return when `settle` can tell more; None: it cannot before an answer comes."""
        waits = [one.at_ns for servo_id in self.unclear for one in self._answers[servo_id].values()]
        return min(waits) + TWIN_NS + 1 if waits else None

    def _is_only(self, servo_id: int, *, is_other: bool) -> bool:
        """Return whether nothing but this id answers twice, as far as is known.

        `is_other`: its two answers differ.
        """
        if self._doublers != {servo_id}:
            return False
        others = [count for other, count in self._asked.items() if other != servo_id]
        return is_other or min(others, default=0) >= SINGLE_FLIGHTS
