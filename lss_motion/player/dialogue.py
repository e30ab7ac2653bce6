"""A list of questions and orders, worked through on every bus at once: for before and after."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from lss_motion.protocol.line import encode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.line import Line
    from lss_motion.player.queries import Asked, Questioner
    from lss_motion.protocol.line import Command, Reply

TRIES: Final = 3
"""A question is asked so often before the servo counts as silent. A RESET takes 1.25 s, but
nobody starts a show in the middle of one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Item:
    """One command for one bus. A question waits for its answer, an order does not."""

    bus: str
    command: Command
    is_question: bool
    tries: int = TRIES


class Dialogue:
    """Works through items in order, bus by bus at the same time.

    `answers` maps `(bus, servo id, keyword)` to the value; a question without an answer is absent.
    """

    def __init__(
        self,
        items: Iterable[Item],
        lines: Mapping[str, Line],
        questioners: Mapping[str, Questioner],
    ) -> None:
        self.answers: dict[tuple[str, int, str], int | str | None] = {}
        self._lines = lines
        self._questioners = questioners
        self._queues: dict[str, deque[Item]] = {bus: deque() for bus in lines}
        self._tries: dict[str, int] = dict.fromkeys(lines, 0)
        for item in items:
            self._queues[item.bus].append(item)

    @property
    def is_finished(self) -> bool:
        return not any(self._queues.values())

    def advance(self, now_ns: int) -> None:
        """Send what can be sent now."""
        for bus, queue in self._queues.items():
            questioner, line = self._questioners[bus], self._lines[bus]
            expired = questioner.expire(now_ns)
            if self._is_next(bus, expired) and self._tries[bus] >= queue[0].tries:
                self._next(bus)
            while queue and questioner.asked is None and line.free_ns <= now_ns:
                item = queue[0]
                if not item.is_question:
                    line.send(encode(item.command), now_ns)
                    self._next(bus)
                elif questioner.is_free(item.command.servo_id, now_ns):
                    questioner.ask(item.command, now_ns)
                    self._tries[bus] += 1
                else:
                    break

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        asked = self._questioners[bus].answer(reply, now_ns)
        if asked is not None and self._is_next(bus, asked):
            self.answers[bus, asked.command.servo_id, asked.command.keyword] = reply.value
            self._next(bus)

    def next_wakeup_ns(self) -> int | None:
        wakeups_ns = []
        for bus, queue in self._queues.items():
            questioner = self._questioners[bus]
            if questioner.asked is not None:
                wakeups_ns.append(questioner.asked.give_up_ns)
            elif queue:
                quiet_ns = questioner.quiet_until_ns(queue[0].command.servo_id)
                free_ns = self._lines[bus].free_ns
                wakeups_ns.append(max(free_ns, quiet_ns if quiet_ns is not None else free_ns))
        return min(wakeups_ns, default=None)

    def _is_next(self, bus: str, asked: Asked | None) -> bool:
        """Return whether `asked` is ours: one may be left in flight by what came before."""
        queue = self._queues[bus]
        return bool(queue) and asked is not None and asked.command is queue[0].command

    def _next(self, bus: str) -> None:
        self._queues[bus].popleft()
        self._tries[bus] = 0
