"""What the author wants: keyframes at times. Values only; `sequence.load` makes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


class Timing(StrEnum):
    """How the times of the keyframes are meant."""

    AUTHORED = "authored"
    FASTEST = "fastest"
    FIT = "fit"


class Interpolation(StrEnum):
    """How a joint travels from one of its keys to the next."""

    SMOOTH = "smooth"
    """C1, never beyond the keys, at rest where the direction turns."""
    SPLINE = "spline"
    """C2; may swing beyond the keys, so the path is checked against the range."""
    LINEAR = "linear"
    """Straight in joint space; stops at corners."""
    HOLD = "hold"
    """Stays, then moves as late as the limits allow, to arrive at the key."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Keyframe:
    """Joint angles to be reached at one instant, and kept for `hold_s`.

    `at_s` is absolute (relative times are resolved by the loader) and None for every keyframe
    of a `fastest` sequence that gives no times. `line` is the line in the file, from 1.
    """

    deg: Mapping[str, float]
    at_s: float | None = None
    hold_s: float = 0.0
    is_anchor: bool = False
    ease: Interpolation = Interpolation.SMOOTH
    """How the named joints travel *to* this keyframe (the file's default is already in)."""
    label: str = ""
    line: int | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """Keyframes in order of time. `loop` is how often they are played; None is forever.

    Sequences are equal when they say the same, whatever files and lines they come from.
    """

    name: str
    keyframes: tuple[Keyframe, ...]
    path: Path | None = field(default=None, compare=False)
    robot_path: Path | None = field(default=None, compare=False)
    timing: Timing = Timing.AUTHORED
    fit_duration_s: float | None = None
    """Only with `Timing.FIT`: how long one pass takes."""
    loop: int | None = 1
