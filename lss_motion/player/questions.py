"""What servos are asked in a show, in words that their family knows."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

from lss_motion.protocol.families import FAMILY_TABLES
from lss_motion.protocol.family import Family
from lss_motion.protocol.line import Command, encode

TARGET_KEYWORD: Final = "QDT"
"""Its answer shows whether a servo heard its last move."""
HEALTH_KEYWORDS: Final = ("Q", "QT", "Q", "QV", "Q", "QC")
"""Status, temperature, voltage, current: a fault is known after half a second. A servo is not asked
what its family has no word for, as an LSS-PRO for its voltage."""


@lru_cache(maxsize=len(Family))
def health_words(family: Family) -> tuple[str, ...]:
    """Return what a servo of that family is asked about its health, in turn."""
    known = FAMILY_TABLES[family].by_keyword
    return tuple(word for word in HEALTH_KEYWORDS if word in known)


@lru_cache(maxsize=1024)
def question_of(servo_id: int, keyword: str) -> tuple[Command, int]:
    """Return a question and its size in bytes: the same few are asked all the time."""
    question = Command(servo_id, keyword)
    return question, len(encode(question))
