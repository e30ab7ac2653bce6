"""The values of a sequence: keyframes at times, tracks, play lists, layers, events.

They are immutable. `show.load` makes them from files; `trajectory` plans them.
"""

# ruff: noqa: TC001, TC003 - public: `help` looks up the annotations.
from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import ClassVar, Final, Literal

from msgspec import Struct, field

from lss_motion.files.source import Located, Location
from lss_motion.files.texts import counted
from lss_motion.robot.on_fault import Escalations

KEYFRAMES_MAX: Final = 10_000
"""Chosen: hours of a lively show. The cost of planning grows with the count; an export that is far
too large is refused early."""

TIME_MAX_S: Final = 86_400.0
"""Chosen: a day. A longer show is a loop; a larger time is a typing error."""

EXPANDED_MAX: Final = 50_000
"""Keyframes of the parts of a show, with every repetition. Chosen: five of the longest files. Only
the loop of the file that is played costs nothing, because its passes are not written out."""

PLAY_STEPS_MAX: Final = 1000
"""Steps of a play list, nested ones included. Chosen: a day of shows; more is a mistake."""


class Timing(StrEnum):
    """Where the times of the keyframes come from."""

    AUTHORED = "authored"
    """The keyframes give them."""
    FASTEST = "fastest"
    """The planner makes them as short as the limits allow."""
    FIT = "fit"
    """The planner scales them, so that one pass takes a given duration."""


class Interpolation(StrEnum):
    """How a joint travels from one of its keys to the next."""

    SMOOTH = "smooth"
    """C1, never beyond the keys, at rest where the direction turns: but for given slopes."""
    SPLINE = "spline"
    """C2; may swing beyond the keys, so the path is checked against the range."""
    LINEAR = "linear"
    """Straight in joint space; stops at corners."""
    HOLD = "hold"
    """Stays, then moves as late as the limits allow to arrive at the key in time."""
    COMMAND = "command"
    """As the servo moves by itself on one command whose T is the time to the key; only for joints
    that keep their time. It comes to rest by its ramps later."""


FLOWING: Final = (Interpolation.SMOOTH, Interpolation.SPLINE)
"""Between two of these a joint passes its key in motion; the others stop at keys."""

LINEAR_RAMP_RATIO: Final = 0.25
"""Each ramp of a `linear` move takes this share of its duration. Chosen: the peak speed is 4/3 of
the mean. All joints use the same share, so that the line stays straight."""


class Keyframe(Located, frozen=True, kw_only=True):
    """Joint angles to be reached at one instant, and kept for `hold_s`.

    `at_s` is absolute (relative times are resolved by the loader) and None for every keyframe
    of a `fastest` sequence that gives no times. `line` is the line in the file, from 1, and `place`
    the way to it, as `("tracks", "jaw", "keyframes", 3)`.
    """

    _where: ClassVar = frozenset({"line", "place"})
    deg: Mapping[str, float]
    at_s: float | None = None
    hold_s: float = 0.0
    hold_may_shrink: bool = False
    """A motion that is late may leave earlier than after `hold_s`; else it is kept in full."""
    is_anchor: bool = False
    is_exact: bool = False
    """Joints that keep their time (`Sequence.keeps_time`) reach this angle, too."""
    weight: float = 1.0
    """How much the angle counts here for joints that keep their time; 1: as elsewhere."""
    ease: Interpolation = Interpolation.SMOOTH
    """How the named joints travel *to* this keyframe; the default of the file is applied."""
    label: str = ""
    slope_deg_s: Mapping[str, float] = {}
    """Joints that pass this keyframe with a speed that the author gives, in authored seconds."""
    line: int | None = None
    place: Location = ()


class SoundStyle(Struct, frozen=True, kw_only=True):
    """How a sound is played. The defaults: once, as it is, to its end."""

    gain_db: float = 0.0
    is_looped: bool = False
    is_bed: bool = False
    """It is the sound of the show itself: the show clock follows it."""
    duck_db: float = 0.0
    """The bed is so much softer while this sounds."""
    speed_ratio: float = 1.0
    """Seconds of the sound per second of the show."""
    lasts_s: float | None = None
    """It is cut this long after its start, in show time; None: only where it ends."""


class Cue(Located, frozen=True, kw_only=True):
    """An event that is not motion, at `at_s` of the show: one of `led`, `say`, `run`, `sound`.

    In a sequence, `at_s` is the time that the author gives; in a plan, the time that it comes to.
    """

    _where: ClassVar = frozenset({"line"})
    at_s: float
    led: tuple[tuple[str, int], ...] = ()
    """Joints and the codes of the colours (`LED`) that they are set to."""
    say: str = ""
    run: str = ""
    """`module:function`; the module is searched beside the sequence file, then as installed."""
    sound: str = ""
    """Path of a sound file."""
    lead_s: float = 0.0
    """A player of sounds that is spawned is started this long before `at_s`. On an open stream, a
    sound needs no lead."""
    style: SoundStyle = SoundStyle()
    folder: str = ""
    """Folder of the sequence file; set for `run` only."""
    line: int | None = None

    @property
    def text(self) -> str:
        """What it does, in a few words."""
        if self.led:
            return ", ".join(name for name, _ in self.led)
        return self.say or self.run or self.sound.replace("\\", "/").rsplit("/", maxsplit=1)[-1]

    @property
    def start_s(self) -> float:
        """When it must be started."""
        return self.at_s - self.lead_s


class Wait(Struct, frozen=True, kw_only=True):
    """The show pauses until a sensor reads below or above `threshold`, in the unit of the sensor.

    It continues after `timeout_s` in any case; None: no timeout.
    """

    sensor: str
    side: Literal["below", "above"]
    threshold: float
    timeout_s: float | None = None

    def is_met(self, value: float) -> bool:
        return value < self.threshold if self.side == "below" else value > self.threshold


class PlaylistStep(Struct, frozen=True, kw_only=True):
    """One entry of a play list: a sequence, a pause or a wait (then `sequence` is the idle motion).

    `move_s` is how long the move to its first keyframe takes, where the robot stands elsewhere;
    None: the move has the approach speed of the robot.
    """

    sequence: Sequence | None = None
    times: int = 1
    pause_s: float = 0.0
    wait: Wait | None = None
    move_s: float | None = None


class Layer(Located, frozen=True, kw_only=True):
    """A sequence on top of the show from `from_s` to `to_s` (None: to its last keyframe).

    `override` replaces the angles of the show, `add` adds to them, both weighted by `weight`. The
    weight rises from 0 over the first `fade_s` and falls to 0 over the last.
    """

    _where: ClassVar = frozenset({"line"})
    sequence: Sequence
    joints: tuple[str, ...]
    """Only these joints; those that the sequence does not key are left as they are."""
    mode: Literal["override", "add"] = "override"
    weight: float = 1.0
    from_s: float = 0.0
    to_s: float | None = None
    fade_s: float = 0.0
    line: int | None = None


class Sequence(Located, frozen=True, kw_only=True):
    """Keyframes in order of time, with tracks, play list, layers and events.

    `loop` is how often the keyframes (or the play list) are played; None is forever. Files and
    lines are not compared: two sequences with the same content are equal.
    """

    _where: ClassVar = frozenset({"path", "robot_path"})
    name: str
    keyframes: tuple[Keyframe, ...] = ()
    path: Path | None = None
    robot_path: Path | None = None
    timing: Timing = Timing.AUTHORED
    fit_duration_s: float | None = None
    """Only with `Timing.FIT`: how long one pass takes."""
    loop: int | None = 1
    loop_span_s: tuple[float, float] | None = None
    """From when to when the keyframes are looped; those before and after are played once. None: all
    of them are looped."""
    keeps_time: frozenset[str] = frozenset()
    """Joints that meet every instant, and give up angle where their servo cannot follow."""
    speed_ratio: float = 1.0
    """All times are divided by this; at most 1 where the timing is `fastest`."""
    smooth_s: float = 0.0
    """Every change of the acceleration takes at least so long; 0: it may jump."""
    tracks: tuple[Sequence, ...] = ()
    """Other joints at the same time, each with its own keyframes, timing and loop."""
    play: tuple[PlaylistStep, ...] = ()
    """Instead of keyframes and tracks: other sequences, one after the other."""
    layers: tuple[Layer, ...] = ()
    """On top of the others, in this order. Their times count from the start of the show."""
    events: tuple[Cue, ...] = ()
    """Events that are not motion. They are repeated with every pass of a loop."""
    beats_s: tuple[float, ...] = ()
    """The beats of the music. The times of keyframes are given as such already; for pictures."""
    on_fault: Escalations = field(default_factory=dict)
    """Escalations of this show, in place of those of its robot. Those of the sequences that it
    plays have no effect."""

    def __repr__(self) -> str:
        """Return one line: name, counts of what it holds, and how often it is played."""
        held = {"keyframe": self.keyframes, "track": self.tracks, "part": self.play}
        held |= {"layer": self.layers, "event": self.events}
        counts = [counted(things, one) for one, things in held.items() if things]
        loops = [] if self.loop == 1 else [f"loop {self.loop or 'forever'}"]
        return f"Sequence({', '.join([repr(self.name), *counts, *loops])})"
