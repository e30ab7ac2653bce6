"""Questions and orders alone, without a show: for tools that look at a robot or set it up."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lss_motion.player.dialogue import Dialogue
from lss_motion.player.line import Line
from lss_motion.player.queries import Questioner

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from lss_motion.player.dialogue import Item
    from lss_motion.player.events import Event
    from lss_motion.robot.model import Bus


class Conversation:
    """A `Dialogue` that the runner can drive by itself. Moves nothing that its items do not."""

    def __init__(self, items: Iterable[Item], buses: Mapping[str, Bus]) -> None:
        self.lines = {name: Line(bus) for name, bus in buses.items()}
        questioners = {name: Questioner(line) for name, line in self.lines.items()}
        self._dialogue = Dialogue(items, self.lines, questioners)

    @property
    def answers(self) -> Mapping[tuple[str, int, str], int | str | None]:
        """Return what was answered: `(bus, servo id, keyword)` → value."""
        return self._dialogue.answers

    def data_to_send(self, now_ns: int) -> Mapping[str, bytes]:
        self._dialogue.advance(now_ns)
        return {name: data for name, line in self.lines.items() if (data := line.take())}

    def receive_data(self, bus: str, data: bytes, now_ns: int) -> None:
        for reply in self.lines[bus].receive(data):
            self._dialogue.receive(bus, reply, now_ns)

    def next_wakeup_ns(self) -> int | None:
        return None if self._dialogue.is_finished else self._dialogue.next_wakeup_ns()

    def next_event(self) -> Event | None:
        return None

    def safe_bytes(self) -> Mapping[str, bytes]:
        return {}
