"""The three bus languages, and the fixed numbers of the bus: ids, colours, states, baud rates.

The commands are not here; they are rows of the tables in `lss`, `lss_pro` and `io2`.
"""

from __future__ import annotations

from enum import Enum, IntEnum, IntFlag, StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


class Family(StrEnum):
    """The bus language of a servo."""

    LSS = "LSS"
    LSS_PRO = "LSS-PRO"
    IO2 = "LSS-2IO"


ID_MIN: Final = 0
ID_MAX: Final = 250
"""Range of the ids that a servo may have (FACTS.md R1)."""
BROADCAST_ID: Final = 254
"""Every servo acts on a command to this id (FACTS.md R1)."""
BUTTON_ID: Final = 255
"""Id of a servo whose button was held at power-up (FACTS.md R2)."""

GROUP_FIRMWARE: Final = 370
"""First LSS firmware with group lines, reply slots and `QID<delay>`. Its reply to a broadcast QID
contains the id of the sender, `*5QID5` (FACTS.md W16 to W19, C5)."""

RESET_S: Final = 1.25
"""Time after RESET in which a servo receives nothing (FACTS.md R4)."""

DEG_S_PER_RPM: Final = 6.0
"""One turn per minute."""

PULSE_MIN_US: Final = 500
PULSE_MAX_US: Final = 2500
"""Range of pulse widths (FACTS.md C11; LSS-2IO: B7)."""

BAUD_RATES_BPS: Final[Mapping[int, int]] = {
    9600: 0,
    19200: 0,
    38400: 0,
    57600: 0,
    115200: 0,
    230400: 0,
    250000: 0,
    460800: 0,
    500000: 0,
    750000: 369,
    921600: 369,
}
"""Rate → first firmware (FACTS.md W22). Firmware 369 is experimental, 370 is released."""


class Led(IntEnum):
    """LED colours of all families (FACTS.md C8)."""

    OFF = 0
    RED = 1
    GREEN = 2
    BLUE = 3
    YELLOW = 4
    CYAN = 5
    MAGENTA = 6
    WHITE = 7


class Blink(IntFlag):
    """States in which the LED blinks (FACTS.md C9)."""

    LIMP = 1
    HOLDING = 2
    ACCELERATING = 4
    DECELERATING = 8
    FREE = 16
    TRAVELING = 32


class Gyre(IntEnum):
    """Direction of positive angles (FACTS.md C13)."""

    CLOCKWISE = 1
    COUNTERCLOCKWISE = -1


class Status(Enum):
    """State of a servo. The number of a state depends on family and firmware (`status_codes`)."""

    UNKNOWN = "unknown"
    LIMP = "limp"
    FREE_MOVING = "free moving"
    ACCELERATING = "accelerating"
    TRAVELING = "traveling"
    DECELERATING = "decelerating"
    HOLDING = "holding"
    OUTSIDE_LIMITS = "outside limits"
    STUCK = "stuck"
    BLOCKED = "blocked"
    SAFE_MODE = "safe mode"
    ERROR = "error"


class SafeModeCause(IntEnum):
    """The answer to `Q1` (FACTS.md S5)."""

    NONE = 0
    CURRENT = 1
    INPUT_VOLTAGE = 2
    TEMPERATURE = 3


STATUS_CODES: Final = (
    Status.UNKNOWN,
    Status.LIMP,
    Status.FREE_MOVING,
    Status.ACCELERATING,
    Status.TRAVELING,
    Status.DECELERATING,
    Status.HOLDING,
    Status.OUTSIDE_LIMITS,
    Status.STUCK,
    Status.BLOCKED,
    Status.SAFE_MODE,
)
"""States by number (FACTS.md S1). The LSS page prints `*5Q9` for 10, a misprint (C7)."""

PRO_STATUS_CODES: Final = (
    Status.UNKNOWN,
    Status.LIMP,
    Status.ACCELERATING,
    Status.TRAVELING,
    Status.DECELERATING,
    Status.HOLDING,
    Status.ERROR,
)
"""States by number in newer LSS-PRO firmware (FACTS.md P5, maker's driver of December 2024)."""

PRO_STATUS_FIRMWARE: Final = 780
"""First LSS-PRO firmware with the newer numbers (FACTS.md P5: about 780)."""


def status_codes(family: Family, firmware: int | None) -> tuple[Status, ...]:
    """Return the states in the order of their numbers.

    `firmware` is what the servo itself answers to QF. None, where it did not answer, is the newest:
    an LSS-PRO that holds is then shown as in error, which is safer than the reverse.
    """
    is_newer = firmware is None or firmware >= PRO_STATUS_FIRMWARE
    return PRO_STATUS_CODES if family is Family.LSS_PRO and is_newer else STATUS_CODES


def status_from(code: int, family: Family, firmware: int | None) -> Status:
    """Return the state of number `code` (`status_codes`); unknown numbers are `UNKNOWN`."""
    codes = status_codes(family, firmware)
    return codes[code] if 0 <= code < len(codes) else Status.UNKNOWN
