"""Gives servos their settings, and makes sure of it: said, asked back, said again."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from lss_motion.errors import PlaybackError
from lss_motion.player.dialogue import Dialogue, Item
from lss_motion.protocol.line import Command

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.player.line import Line
    from lss_motion.player.queries import Questioner
    from lss_motion.player.settings import Answers
    from lss_motion.protocol.line import Reply
    from lss_motion.robot.model import Joint

UNSURE_TRIES: Final = 2
"""How often a servo is asked, in a round, for what it has not answered before."""
SETTING_TRIES: Final = 4
"""How often a setting is sent that the servo does not answer with. Chosen: on a line that loses
every tenth command, one of 10,000 settings stays wrong."""


class Settling:
    """A `Dialogue` that sends orders until every servo answers with what it was told.

    `wrong` are the orders that were not taken in `SETTING_TRIES` rounds. Those of `unsure` may
    also stay unanswered: nobody knows whether the servo knows them. `then` is asked in every
    round, after the orders.
    """

    def __init__(
        self,
        orders: Sequence[Item],
        then: Iterable[Item],
        unsure: Sequence[Item],
        lines: Mapping[str, Line],
        questioners: Mapping[str, Questioner],
    ) -> None:
        self.wrong = list(orders)
        self.answers: dict[tuple[str, int, str], int | str | None] = {}
        self._then = list(then)
        self._unsure = list(unsure)
        self._lines = lines
        self._questioners = questioners
        self._rounds = 0
        self._dialogue = self._round()

    @property
    def is_finished(self) -> bool:
        return self._dialogue.is_finished and not self._must_say_again()

    def advance(self, now_ns: int) -> None:
        self._dialogue.advance(now_ns)
        if not self._dialogue.is_finished:
            return
        self.answers.update(self._dialogue.answers)
        self.wrong = untaken(self.wrong, self.answers)
        self._unsure = untaken(self._unsure, self.answers)
        if self._must_say_again():
            self._dialogue = self._round()
            self._dialogue.advance(now_ns)
        else:
            self.wrong += [order for order in self._unsure if is_answered(order, self.answers)]
            self._unsure = []

    def _must_say_again(self) -> bool:
        return bool(self.wrong or self._unsure) and self._rounds < SETTING_TRIES

    def receive(self, bus: str, reply: Reply, now_ns: int) -> None:
        self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return self._dialogue.next_wakeup_ns()

    def _round(self) -> Dialogue:
        self._rounds += 1
        unsure = [replace(item, tries=UNSURE_TRIES) for item in read_back(self._unsure)]
        items = [*self.wrong, *self._unsure, *read_back(self.wrong), *unsure, *self._then]
        return Dialogue(items, self._lines, self._questioners)


def read_back(orders: Iterable[Item]) -> list[Item]:
    """Return what to ask to know whether orders were taken."""
    return [
        Item(
            bus=order.bus,
            command=Command(order.command.servo_id, f"Q{order.command.keyword}"),
            is_question=True,
            agree_within=0,
        )
        for order in orders
    ]


def untaken(orders: Iterable[Item], answers: Answers) -> list[Item]:
    """Return the orders that the servos, asked by `read_back`, do not answer with."""
    return [
        order
        for order in orders
        if answers.get((order.bus, order.command.servo_id, f"Q{order.command.keyword}"))
        != order.command.value
    ]


def is_answered(order: Item, answers: Answers) -> bool:
    """Return whether the servo said what it has of what it was told."""
    return (order.bus, order.command.servo_id, f"Q{order.command.keyword}") in answers


def untaken_error(order: Item, answers: Answers, joints: Iterable[Joint]) -> PlaybackError:
    """Return what to say about an order that was not taken in `SETTING_TRIES` tries."""
    command = order.command
    name = next(j.name for j in joints if (j.bus, j.servo_id) == (order.bus, command.servo_id))
    said = answers.get((order.bus, command.servo_id, f"Q{command.keyword}"))
    return PlaybackError(
        f"joint {name!r}: servo {command.servo_id} was set to {command.keyword} {command.value} "
        f"{SETTING_TRIES} times and answers {'nothing' if said is None else said}. Check wiring "
        f"and power; nothing is driven without its limits",
        joint=name,
    )
