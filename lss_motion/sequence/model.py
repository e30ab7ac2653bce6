"""What the author wants: keyframes at times. Values only; `sequence.load` makes them."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Literal

from lss_motion.files.source import counted

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from lss_motion.robot.on_fault import Escalations


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
class Cue:
    """Something that is not motion, at `at_s` of the show: one of `led`, `say`, `run`, `sound`.

    Of a sequence, `at_s` is on its author's clock; of a plan, when it really comes.
    """

    at_s: float
    led: tuple[tuple[str, int], ...] = ()
    """Joints and the colours (codes of `LED`) that they take on."""
    say: str = ""
    run: str = ""
    """`module:function`; the module is looked for beside the sequence file, then as installed."""
    sound: str = ""
    """Path of a sound file."""
    lead_s: float = 0.0
    """A sound is started so much before `at_s`: what its player takes to be heard."""
    folder: str = ""
    """Where the file stands that holds it."""
    line: int | None = field(default=None, compare=False)

    @property
    def start_s(self) -> float:
        """When it must be set off."""
        return self.at_s - self.lead_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Wait:
    """The show stands still until a sensor is below or above `threshold`, in the sensor's unit.

    After `timeout_s` it goes on all the same; None waits as long as it takes.
    """

    sensor: str
    side: Literal["below", "above"]
    threshold: float
    timeout_s: float | None = None

    def is_met(self, value: float) -> bool:
        return value < self.threshold if self.side == "below" else value > self.threshold


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """One entry of a play list: a sequence, a pause or a wait (then `sequence` is None).

    `move_s` is how long the way from where the robot stands to the first keyframe takes; None is
    the robot's approach speed.
    """

    sequence: Sequence | None = None
    times: int = 1
    pause_s: float = 0.0
    wait: Wait | None = None
    move_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Layer:
    """A sequence on top of the show from `from_s` to `to_s` (None: as long as it lasts).

    `override` replaces the angles of the show, `add` adds to them; both by `weight`, which grows
    from 0 over the first `fade_s` and shrinks to it over the last.
    """

    sequence: Sequence
    joints: tuple[str, ...]
    """Only these joints; those of them that the sequence does not key stay as they are."""
    mode: Literal["override", "add"] = "override"
    weight: float = 1.0
    from_s: float = 0.0
    to_s: float | None = None
    fade_s: float = 0.0
    line: int | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Sequence:
    """Keyframes in order of time, and what goes on beside, after and on top of them.

    `loop` is how often the keyframes (or the play list) are played; None is forever. Sequences
    are equal when they say the same, whatever files and lines they come from.
    """

    name: str
    keyframes: tuple[Keyframe, ...] = ()
    path: Path | None = field(default=None, compare=False)
    robot_path: Path | None = field(default=None, compare=False)
    timing: Timing = Timing.AUTHORED
    fit_duration_s: float | None = None
    """Only with `Timing.FIT`: how long one pass takes."""
    loop: int | None = 1
    loop_span_s: tuple[float, float] | None = None
    """What is looped of keyframes with times: what is before it is played once, first, and what is
    after it once, at the end. None: all of them."""
    speed_ratio: float = 1.0
    """All times are divided by this; at most 1 where the timing is `fastest`."""
    tracks: tuple[Sequence, ...] = ()
    """Other joints at the same time, each with its own keyframes, timing and loop."""
    play: tuple[Step, ...] = ()
    """Instead of keyframes and tracks: other sequences, one after the other."""
    layers: tuple[Layer, ...] = ()
    """On top of all that, in this order. Their times count from the start of the show."""
    events: tuple[Cue, ...] = ()
    """What is not motion. Repeated with every pass of a loop."""
    on_fault: Escalations = field(default_factory=dict)
    """What this show does otherwise than its robot when something goes wrong; of the sequences
    that it plays, nobody asks."""

    def __repr__(self) -> str:
        """Return one line: name, counts of what it holds, and how often it is played."""
        held = {"keyframe": self.keyframes, "track": self.tracks, "part": self.play}
        held |= {"layer": self.layers, "event": self.events}
        counts = [counted(things, one) for one, things in held.items() if things]
        loops = [] if self.loop == 1 else [f"loop {self.loop or 'forever'}"]
        return f"Sequence({', '.join([repr(self.name), *counts, *loops])})"
