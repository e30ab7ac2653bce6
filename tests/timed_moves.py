"""Timed moves: on the line, where `#5QDT` has the same letters, and of a joint under test."""

from __future__ import annotations

import re
from typing import Final

from lss_motion.planning.program.model import Move

MOVE: Final = re.compile(rb"#(\d+)D(-?\d+)T(\d+)\r?")


def is_move(line: bytes) -> bool:
    return MOVE.fullmatch(line) is not None


def travel(target_deg, due_s=0.0, lasts_s=1.0):
    return Move(round(1e6 * due_s), "main", 1, round(10 * target_deg), round(1000 * lasts_s))


def timed(kit, *moves, **fields):
    """Return the track of a joint whose plan receives all of `moves`; the first is under way."""
    state = kit.state(kit.joint(**fields), moves)
    state.begin_move(moves[0])
    return state
