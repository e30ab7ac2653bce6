"""Who is gone, how long they are waited for, and what to ask them when they are back."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from lss_motion.player import settings, setup
from lss_motion.player.settling import read_back, untaken

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.player.dialogue import Item
    from lss_motion.player.settings import Answers
    from lss_motion.robot.model import Joint

ASKED_FOREVER: Final = 1_000_000
"""Until the time is over, whatever the number of tries."""


def telling_orders(joints: Iterable[Joint], had: Answers) -> list[Item]:
    """Return one setting of each servo that it no longer has if it restarts, if there is one.

    All that a session changes is lost together; what it did not change, a restart does not either.
    """
    telling: dict[tuple[str, int], Item] = {}
    for order in changing_orders(joints, had):
        telling.setdefault((order.bus, order.command.servo_id), order)
    return list(telling.values())


def changing_orders(joints: Iterable[Joint], had: Answers) -> list[Item]:
    """Return the settings for the show that servos had otherwise before."""
    return untaken(settings.session_orders(joints, had), had)


@dataclass(slots=True)
class Recovery:
    """One wait: the player brakes, asks until all of `missing` answer, or gives up."""

    give_up_ns: int
    missing: list[Joint] = field(default_factory=list)

    def add(self, joints: list[Joint]) -> None:
        self.missing += [joint for joint in joints if joint not in self.missing]

    def questions(self, had: Answers) -> list[Item]:
        """Return what to ask: where they are, and whether they still have what they were given."""
        orders = settings.session_orders(self.missing, had)
        items = [*read_back(orders), *setup.place_questions(self.missing)]
        return [replace(item, tries=ASKED_FOREVER) for item in items]

    def absent(self, answers: Answers) -> list[Joint]:
        """Return who has not said where it is."""
        present = setup.standing_deg(self.missing, answers)
        return [joint for joint in self.missing if joint.name not in present]

    def restarted(self, answers: Answers, had: Answers) -> list[Joint]:
        """Return who has lost what it was given."""
        return [
            joint
            for joint in self.missing
            if untaken(settings.session_orders([joint], had), answers)
        ]
