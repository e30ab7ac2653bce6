"""What is a timed move on the line; a question for a target (`#5QDT`) has the same letters."""

from __future__ import annotations

import re
from typing import Final

MOVE: Final = re.compile(rb"#(\d+)D(-?\d+)T(\d+)\r?")


def is_move(line: bytes) -> bool:
    return MOVE.fullmatch(line) is not None
