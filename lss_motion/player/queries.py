"""One query in flight on one bus: what was asked, what answers it, when to give up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.line import Command, encode
from lss_motion.units import NS_PER_MS

if TYPE_CHECKING:
    from lss_motion.player.line import Line
    from lss_motion.protocol.line import Reply

REPLY_TIMEOUT_NS: Final = 30 * NS_PER_MS
"""From the end of a query to the end of its answer, without the answer's own line time: 10 ms is
what the tighter libraries wait (lss_facts 2.5), and a USB adapter may add its 16 ms timer."""
REPLY_MAX_BYTES: Final = 24
"""The longest answer that is waited for: a serial number (lss_facts 4)."""
STRAY_NS: Final = 100 * NS_PER_MS
"""After a timeout the servo is left alone this long, so that a late answer is not taken for the
answer to the next question."""


@dataclass(frozen=True, slots=True)
class Asked:
    """A query in flight. `heard_ns` is when the servo had it complete."""

    command: Command
    heard_ns: int
    give_up_ns: int


class Questioner:
    """Asks on one line, one question at a time, and knows which answers may be believed."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self.asked: Asked | None = None
        self.asked_count = 0
        self.answered_count = 0
        self.timeouts = 0
        self.strays = 0
        self._quiet_until_ns: dict[int, int] = {}

    def is_free(self, servo_id: int, now_ns: int) -> bool:
        """Return whether a question to `servo_id` may be asked now."""
        return self.asked is None and now_ns >= self._quiet_until_ns.get(servo_id, now_ns)

    def quiet_until_ns(self, servo_id: int) -> int | None:
        return self._quiet_until_ns.get(servo_id)

    def ask(self, command: Command, now_ns: int) -> None:
        assert self.asked is None, "one question at a time"
        heard_ns = self._line.send(encode(command), now_ns)
        give_up_ns = heard_ns + REPLY_TIMEOUT_NS + self._line.time_ns(REPLY_MAX_BYTES)
        self.asked = Asked(command, heard_ns, give_up_ns)
        self.asked_count += 1

    def answer(self, reply: Reply, now_ns: int) -> Asked | None:
        """Return the question that `reply` answers, or None for a stray, which is counted.

        `*QID5` names no sender; it answers a question for an id only.
        """
        asked = self.asked
        if (
            asked is None
            or reply.keyword != asked.command.keyword
            or (reply.servo_id is None and reply.keyword != "QID")
            or reply.servo_id not in (asked.command.servo_id, None)
            or now_ns < asked.heard_ns
        ):
            self.strays += 1
            return None
        self.asked = None
        self.answered_count += 1
        self._quiet_until_ns.pop(asked.command.servo_id, None)
        return asked

    def expire(self, now_ns: int) -> Asked | None:
        """Give up the question in flight if its time is over; return it then."""
        asked = self.asked
        if asked is None or now_ns < asked.give_up_ns:
            return None
        self.asked = None
        self.timeouts += 1
        self._quiet_until_ns[asked.command.servo_id] = now_ns + STRAY_NS
        return asked
