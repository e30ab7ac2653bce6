"""Which bus languages there are."""

from __future__ import annotations

from enum import StrEnum


class Family(StrEnum):
    """Which of the three bus languages a servo speaks."""

    LSS = "LSS"
    LSS_PRO = "LSS-PRO"
    IO2 = "LSS-2IO"
