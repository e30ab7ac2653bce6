"""Where a pass that is repeated joins itself: every servo goes on as it began the pass."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Final

from lss_motion.program.attempt import sent_us
from lss_motion.program.model import Move

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lss_motion.program.model import Repeat
    from lss_motion.robot.model import Robot

US_PER_MS: Final = 1_000

STRETCH_MAX_US: Final = 10_000
"""A move may last so much longer than planned. Chosen: at 1000 deg/s² the horn is 0.05 deg off."""


def closed(moves: Iterable[Move], repeat: Repeat, robot: Robot) -> list[Move]:
    """Return the moves until the end of the repeated pass, so that it can follow itself.

    Commands around the two seams fall differently, as the line allows. Where the last move of the
    pass would have to wait for its successor longer than planned, the move that is under way when
    the pass begins is said again at its beginning.
    """
    own: dict[tuple[str, int], list[Move]] = defaultdict(list)
    for move in moves:
        own[move.bus, move.servo_id].append(move)
    kept = [move for mine in own.values() for move in mine if move.due_us < repeat.to_us]
    for mine in own.values():
        again = _said_again(mine, repeat)
        if again is None or again.duration_ms is None:
            continue
        due_us = _free_us(_taken(kept, again.bus, repeat, robot), repeat.from_us, again, robot)
        if due_us >= min(m.due_us for m in mine if m.due_us >= repeat.from_us):
            continue  # The line is so full that its successor comes first.
        ends_us = again.due_us + again.duration_ms * US_PER_MS
        kept.append(
            Move(
                due_us=due_us,
                bus=again.bus,
                servo_id=again.servo_id,
                target_wire=again.target_wire,
                duration_ms=max(1, round((ends_us - due_us) / US_PER_MS)),
            )
        )
    return sorted(kept, key=lambda move: (move.due_us, move.bus, move.servo_id))


def _taken(moves: Iterable[Move], bus: str, repeat: Repeat, robot: Robot) -> list[tuple[int, int]]:
    """Return from when to when a line is busy after the first seam, with either pass before it."""
    period_us = repeat.to_us - repeat.from_us
    taken = []
    for move in moves:
        if move.bus != bus:
            continue
        end_us = move.due_us + sent_us(len(move.data), robot.buses[bus].baud_bps)
        if end_us > repeat.to_us:
            taken.append((move.due_us - period_us, end_us - period_us))
        if repeat.from_us < end_us:
            taken.append((move.due_us, end_us))
    return sorted(taken)


def _said_again(mine: list[Move], repeat: Repeat) -> Move | None:
    """Return the move under way at the first seam, if the one at the second cannot stand for it."""
    before = [move for move in mine if move.due_us < repeat.from_us]
    after_us = [m.due_us - repeat.from_us for m in mine if m.due_us >= repeat.from_us]
    planned_us = [m.due_us - repeat.to_us for m in mine if m.due_us >= repeat.to_us]
    if not before or not after_us or not planned_us:
        return None
    return before[-1] if after_us[0] - planned_us[0] > STRETCH_MAX_US else None


def _free_us(taken: list[tuple[int, int]], from_us: int, move: Move, robot: Robot) -> int:
    """Return the first instant from `from_us` on at which the line is free for `move`."""
    size_us = sent_us(len(move.data), robot.buses[move.bus].baud_bps)
    due_us = from_us
    for start_us, end_us in taken:
        if start_us >= due_us + size_us:
            break
        due_us = max(due_us, end_us)
    return due_us
