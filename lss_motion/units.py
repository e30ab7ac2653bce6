"""All conversions between units. No other module has powers of ten."""

from __future__ import annotations

from typing import Final

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
NS_PER_US: Final = 1_000
US_PER_S: Final = 1_000_000
MS_PER_S: Final = 1_000

LINE_BITS_PER_BYTE: Final = 10
"""Start bit, eight data bits, stop bit (8N1: FACTS.md W1)."""


def ns_from_s(duration_s: float) -> int:
    return round(duration_s * NS_PER_S)


def s_from_ns(duration_ns: int) -> float:
    return duration_ns / NS_PER_S


SPEED_RATIO_MAX: Final = 100.0
"""Largest ratio that `--speed` takes. Chosen: an hour in 36 s."""


def us_from_s(duration_s: float) -> int:
    return round(duration_s * US_PER_S)


def s_from_us(duration_us: float) -> float:
    return duration_us / US_PER_S


def s_from_ms(duration_ms: float) -> float:
    return duration_ms / MS_PER_S


def significant(value: float, digits: int = 4) -> str:
    """Return a number as text with `digits` significant digits and no exponent."""
    return f"{float(f'{value:.{digits}g}'):.15g}"


def line_time_ns(size_bytes: int, baud_bps: int) -> int:
    """Return how long `size_bytes` occupy a line of `baud_bps`, rounded up."""
    return -(-size_bytes * LINE_BITS_PER_BYTE * NS_PER_S // baud_bps)
