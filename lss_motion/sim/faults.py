"""What goes wrong on a simulated bus: rows of when, who and what, repeatable from a seed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from lss_motion.units import ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable
    from random import Random


class FaultKind(StrEnum):
    """What happens. The first group is about bytes, the second about one servo."""

    LOST_COMMAND = "lost_command"
    CORRUPT_COMMAND = "corrupt_command"
    LOST_REPLY = "lost_reply"
    CORRUPT_REPLY = "corrupt_reply"
    LATE_REPLY = "late_reply"
    DOUBLE_REPLY = "double_reply"

    DEAF = "deaf"
    WRONG_ID = "wrong_id"
    RESET = "reset"
    STUCK = "stuck"
    WEAK = "weak"
    HOT = "hot"


INSTANT = frozenset({FaultKind.RESET, FaultKind.HOT})
"""These happen once, at `at_s`; all others last until `until_s`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One row. Times count from power-up.

    `servo_id`       whom it befalls; None: all servos, or the line
    `ratio`          how many of the lines or replies in the time; 1: all
    `late_s`         for `late_reply`
    `as_id`          for `wrong_id`: the id that stands in the replies
    `speed_ratio`    for `weak`: what is left of the top speed
    `temperature_c`  for `hot`
    """

    kind: FaultKind
    at_s: float = 0.0
    until_s: float = math.inf
    servo_id: int | None = None
    ratio: float = 1.0
    late_s: float = 0.0
    as_id: int = 0
    speed_ratio: float = 1.0
    temperature_c: float = 0.0


@dataclass(frozen=True, slots=True)
class Turn:
    """An instant at which a fault of a servo begins or ends."""

    due_ns: int
    fault: Fault
    is_begin: bool


class Faults:
    """The rows at work. Chance is drawn once for each line or reply, in their order."""

    def __init__(self, faults: Iterable[Fault], random: Random) -> None:
        self._faults = tuple(faults)
        self._random = random
        self._origin_ns = 0
        self._turns: list[Turn] = []

    def start(self, now_ns: int) -> None:
        """Count time from `now_ns`."""
        self._origin_ns = now_ns
        about_servos = {FaultKind.RESET, FaultKind.HOT, FaultKind.STUCK, FaultKind.WEAK}
        for fault in self._faults:
            if fault.kind in about_servos:
                self._turns.append(Turn(now_ns + ns_from_s(fault.at_s), fault, is_begin=True))
                if fault.kind not in INSTANT and math.isfinite(fault.until_s):
                    self._turns.append(
                        Turn(now_ns + ns_from_s(fault.until_s), fault, is_begin=False)
                    )
        self._turns.sort(key=lambda turn: turn.due_ns, reverse=True)

    def next_turn_ns(self) -> int | None:
        return self._turns[-1].due_ns if self._turns else None

    def pop_turn(self) -> Turn:
        return self._turns.pop()

    def heard(self, line: bytes, now_ns: int) -> bytes:
        """Return what of a line reaches the servos."""
        for fault in self._active(now_ns, None):
            if fault.kind is FaultKind.LOST_COMMAND and self._strikes(fault):
                return b""
            if fault.kind is FaultKind.CORRUPT_COMMAND and self._strikes(fault):
                line = self._damaged(line[:-1]) + line[-1:]
        return line

    def is_deaf(self, servo_id: int, now_ns: int) -> bool:
        active = self._active(now_ns, servo_id)
        return any(fault.kind is FaultKind.DEAF and self._strikes(fault) for fault in active)

    def sender(self, servo_id: int, now_ns: int) -> int:
        """Return the id that a servo puts into its reply."""
        for fault in self._active(now_ns, servo_id):
            if fault.kind is FaultKind.WRONG_ID and self._strikes(fault):
                return fault.as_id
        return servo_id

    def sent(self, servo_id: int, data: bytes, start_ns: int) -> list[tuple[bytes, int]]:
        """Return what a servo sends instead of one reply, and when each begins."""
        count = 1
        for fault in self._active(start_ns, servo_id):
            match fault.kind:
                case FaultKind.LOST_REPLY if self._strikes(fault):
                    return []
                case FaultKind.CORRUPT_REPLY if self._strikes(fault):
                    data = self._damaged(data)
                case FaultKind.LATE_REPLY if self._strikes(fault):
                    start_ns += ns_from_s(fault.late_s)
                case FaultKind.DOUBLE_REPLY if self._strikes(fault):
                    count = 2
                case _:
                    pass
        return [(data, start_ns)] * count

    def _active(self, now_ns: int, servo_id: int | None) -> list[Fault]:
        if not self._faults:
            return []
        now_s = s_from_ns(now_ns - self._origin_ns)
        return [
            fault
            for fault in self._faults
            if fault.at_s <= now_s < fault.until_s and fault.servo_id in (None, servo_id)
        ]

    def _strikes(self, fault: Fault) -> bool:
        return fault.ratio >= 1.0 or self._random.random() < fault.ratio

    def _damaged(self, data: bytes) -> bytes:
        """Return the bytes with one of them replaced by another."""
        if not data:
            return data
        place = self._random.randrange(len(data))
        other = (data[place] + self._random.randrange(1, 256)) % 256
        return data[:place] + bytes([other]) + data[place + 1 :]
