"""The keys of a sequence file: names, units, and bounds of each key alone.

`show.load` checks what several keys mean together. The descriptions are the
reference of the file format.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Final, Literal

from lss_motion.files.keys import (
    FILE_VERSION,
    VERSION,
    Field,
    FileModel,
    Name,
    Plain,
    Text,
    Version,
)
from lss_motion.robot.file import OnFaultEntry
from lss_motion.robot.linkage_file import AngleDeg  # noqa: TC001  (read when it is checked)
from lss_motion.show.model import KEYFRAMES_MAX, PLAY_STEPS_MAX, TIME_MAX_S

TIME_MIN_S: Final = 0.001
"""The unit of T on the wire: one millisecond."""

LOOP_MAX: Final = 1_000_000
"""Chosen: a one-second loop lasts twelve days; use `forever` for more."""

FOREVER: Final = "forever"

EVENTS_MAX: Final = 10_000
"""Chosen: more than an hour of beats."""

LEAD_MAX_S: Final = 10.0
"""Chosen: longer than any player of sounds takes to start."""

RUN_PATTERN: Final = r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$"
"""`module:function`, as entry points are written."""

LAYERS_MAX: Final = 32
"""Chosen: more than a viewer can tell apart."""

SMOOTH_MAX_S: Final = 2.0
"""Chosen: at 600 deg/s², a joint that takes so long to speed up is far beyond any speed limit."""

SLOPE_MAX_DEG_S: Final = 10_000.0
"""Chosen: far beyond any servo; a slope beyond that is a typing error."""

SPEED_MIN_RATIO: Final = 0.01
SPEED_MAX_RATIO: Final = 100.0
"""Chosen: a hundredfold either way; a ratio beyond that is a typing error."""

SPEED_RATIO: Final = (
    "All times are divided by this: 0.5 is half as fast. More than 1 only with times."
)
MIRROR: Final = "Exchange left and right, as given under mirror in the robot file."

FileName = Annotated[str, Field(min_length=1)]
SpeedRatio = Annotated[float, Field(ge=SPEED_MIN_RATIO, le=SPEED_MAX_RATIO)]
TimeS = Annotated[float, Field(ge=0.0, le=TIME_MAX_S)]
SlopeDegS = Annotated[float, Field(ge=-SLOPE_MAX_DEG_S, le=SLOPE_MAX_DEG_S)]
Colour = Literal["off", "red", "green", "blue", "yellow", "cyan", "magenta", "white"]
Ease = Literal["smooth", "spline", "linear", "hold", "command"]
Keep = Literal["angle", "time"]
BeatTimes = Annotated[list[TimeS], Field(min_length=2, max_length=EVENTS_MAX)]

WEIGHT_MAX: Final = 1000.0
"""Chosen: a weight of 100 misses a key of a fast jaw by less than a tenth of a degree."""

KEEP: Final = (
    "What a joint keeps where its servo cannot follow. angle: every angle, but later. time: every "
    "instant, but less far, with the least squared deviation."
)


def _check_loop(loop: Any, _key: str) -> int | Literal["forever"]:  # noqa: ANN401  whatever YAML holds
    match loop:
        case "forever":
            return "forever"
        case int() if not isinstance(loop, bool) and 1 <= loop <= LOOP_MAX:
            return loop
        case _:
            raise ValueError(f"must be a count from 1 to {LOOP_MAX:,}, or forever")


Reading = Annotated[float, Field(ge=0.0, le=5000.0)]
"""Millimetres or raw counts: more than any of the sensors can return."""

Loop = Annotated[
    int | Literal["forever"],
    Plain(
        _check_loop,
        {"anyOf": [{"type": "integer", "minimum": 1, "maximum": LOOP_MAX}, {"const": FOREVER}]},
    ),
]


class KeyframeEntry(FileModel, title="keyframe"):
    """Joint angles to be reached at one time; joints that it does not name keep their motion.

    A keyframe names at least one joint, by `pose`, `deg` or both. `at_s` is absolute; `after_s`
    counts from the end of the keyframe before (its time plus its `hold_s`), for the first
    keyframe from the start of the show. The first keyframe may leave its time out: 0.
    Keyframes at one time are reached together, and none may give a joint another angle than
    the others; `after_s` then counts from the end of the longest hold.
    """

    at_s: TimeS | None = Field(default=None, description="Seconds from the start of the show.")
    after_s: TimeS | None = Field(
        default=None,
        description="Seconds from the end of the keyframe before, hold_s included.",
    )
    at_beat: Annotated[float, Field(ge=1.0, le=EVENTS_MAX)] | None = Field(
        default=None,
        description="Number of a beat of the file, from 1 on, in place of a time; 12.5 is half "
        "way between two beats.",
    )
    pose: Name | None = Field(default=None, description="Name of a pose of the robot file.")
    deg: dict[Name, AngleDeg] | None = Field(
        default=None,
        description="Joint angles in degrees, in place of those of the pose.",
        examples=[{"elbow": -20}],
    )
    hold_s: TimeS = Field(
        default=0.0,
        description="How long the named joints stay there, at least; kept when the motion is late.",
    )
    hold_may_shrink: bool | None = Field(
        default=None,
        description="A motion that is late may shorten hold_s to make up for it. "
        "Default: hold_may_shrink of the track or file.",
    )
    anchor: bool = Field(
        default=False, description="This time must be met; planning fails if it cannot be."
    )
    exact: bool = Field(
        default=False,
        description="Joints with keep: time meet this angle, too, and hold it; planning fails if "
        "they cannot.",
    )
    keep: Literal["time"] | None = Field(
        default=None,
        description="time: the joints it names keep their time, and give up angle here where they "
        "are too slow. At keyframes without it those joints keep both, as with exact, unless file "
        "or track says keep: time of them.",
    )
    weight: float = Field(
        default=1.0,
        ge=1.0,
        le=WEIGHT_MAX,
        description="How much more the angle of joints with keep: time counts here than between "
        "keyframes.",
    )
    ease: Ease | None = Field(
        default=None,
        description="How the joints travel to this keyframe. Default: interpolation of the file.",
    )
    slope_deg_s: dict[Name, SlopeDegS] | None = Field(
        default=None,
        description="How fast joints of this keyframe pass it, in degrees per second of its times; "
        "else the curve finds that itself. They may then go beyond their keys. For smooth and "
        "spline; a motion that is late passes it as much slower.",
        examples=[{"jaw": 40}],
    )
    label: Text | None = Field(
        default=None, description="Shown on screen and in plots. Default: the name of the pose."
    )


class TrackEntry(FileModel, title="track"):
    """Joints that are planned together: keyframes in order of time, played once or in a loop."""

    more_schema: ClassVar = {"required": ["keyframes"]}

    timing: Literal["authored", "fastest", "fit"] | None = Field(
        default=None,
        description="authored: times of the keyframes, slower only where a servo cannot follow. "
        "fastest: as fast as the servos can, without times. fit: one pass takes duration_s. "
        "Default: authored, or fastest if no keyframe has a time.",
    )
    duration_s: float | None = Field(
        default=None,
        ge=TIME_MIN_S,
        le=TIME_MAX_S,
        description="How long one pass takes; only with timing: fit.",
    )
    interpolation: Ease = Field(
        default="smooth",
        description="How joints travel between keyframes. smooth: never beyond the keys. "
        "spline: rounder, may swing beyond them. linear: straight lines with stops. "
        "hold: wait, then move as late as possible. command: as the servo moves by itself on one "
        "command with the time between the keys as its T; needs keep: time.",
    )
    smooth_s: float | None = Field(
        default=None,
        ge=0.0,
        le=SMOOTH_MAX_S,
        description="The acceleration does not jump: each change of it takes at least so long. "
        "0: it may jump. Default of a track: that of the file; of a file: 0. See also "
        "jerk_max_deg_s3 in the robot file.",
        examples=[0.1],
    )
    hold_may_shrink: bool | None = Field(
        default=None,
        description="Default of the keyframes: a motion that is late may shorten their hold_s. "
        "Default of a track: that of the file; of a file: false.",
    )
    keep: Keep | Annotated[dict[Name, Keep], Field(min_length=1)] | None = Field(
        default=None,
        description=f"{KEEP} For all joints, or by joints and groups. Default of a track: that of "
        "the file; of a file: angle.",
        examples=["time", {"jaw": "time"}],
    )
    keyframes: Annotated[list[KeyframeEntry], Field(min_length=1, max_length=KEYFRAMES_MAX)] = (
        Field(default=[], description="In order of time.")
    )
    loop: Loop = Field(default=1, description="How often it is played: a count, or forever.")


MUTE: Final = "It is left out, as if it were not there; it is checked all the same."


class NamedTrackEntry(TrackEntry, title="named track"):
    """A track beside the keyframes of the file."""

    mute: bool = Field(default=False, description=MUTE)


class WaitEntry(FileModel, title="wait"):
    """The condition to wait for: a sensor of the robot reads below or above a value."""

    sensor: Name = Field(description="Name of a sensor of the robot file.")
    below_mm: Reading | None = Field(default=None, description="An object comes nearer.")
    above_mm: Reading | None = Field(default=None, description="It moves further away.")
    below_raw: Reading | None = Field(default=None, description="For a sensor of kind raw.")
    above_raw: Reading | None = Field(default=None, description="For a sensor of kind raw.")


class StepEntry(FileModel, title="step"):
    """One entry of a play list: a sequence file, a pause, or a wait for a sensor."""

    file: FileName | None = Field(
        default=None, description="Sequence file, relative to this file.", examples=["wave.yaml"]
    )
    times: int = Field(default=1, ge=1, le=LOOP_MAX, description="How often it is played.")
    speed_ratio: SpeedRatio = Field(default=1.0, description=SPEED_RATIO)
    mirror: bool = Field(default=False, description=MIRROR)
    join: Literal["rest", "through"] = Field(
        default="rest",
        description="rest: comes to rest before it begins. through: its keyframes follow those "
        "of the step before as if they were written there, without a stop.",
    )
    move_s: float | None = Field(
        default=None,
        ge=TIME_MIN_S,
        le=TIME_MAX_S,
        description="How long the move to its first keyframe takes, where the robot stands "
        "elsewhere. Default: it has the speed approach_speed_deg_s of the robot.",
    )
    pause_s: TimeS | None = Field(default=None, description="Pause for so long.")
    wait_for: WaitEntry | None = Field(
        default=None,
        description="Pause until a sensor meets a condition.",
        examples=[{"sensor": "eye", "below_mm": 300}],
    )
    timeout_s: TimeS | None = Field(
        default=None,
        description="Continue after so long in any case. Default: no timeout.",
    )
    idle: FileName | None = Field(
        default=None,
        description="With wait_for: a sequence file that is played again and again while it waits. "
        "Of a file that loops forever, one pass is repeated. "
        "When the wait is over, it is played to its end, and the show goes on from there.",
        examples=["breathe.yaml"],
    )


class LayerEntry(FileModel, title="layer"):
    """A sequence on top of the show. The limits of the joints hold for the result."""

    file: FileName = Field(description="Sequence file, relative to this file.")
    joints: Annotated[list[Name], Field(min_length=1)] | None = Field(
        default=None,
        description="Joints and groups of the robot that it moves. Default: all that it keys.",
    )
    mode: Literal["override", "add"] = Field(
        default="override",
        description="override: its angles in place of those below. add: its angles added to them.",
    )
    weight: float = Field(
        default=1.0, ge=0.0, le=1.0, description="Its share of the result, from 0 to 1."
    )
    from_s: TimeS = Field(default=0.0, description="When it begins, in seconds of the show.")
    to_s: TimeS | None = Field(
        default=None, description="When it ends. Default: with its last keyframe."
    )
    fade_s: TimeS = Field(
        default=0.0, description="How long it takes to fade in, and out again at its end."
    )
    speed_ratio: SpeedRatio = Field(default=1.0, description=SPEED_RATIO)
    mirror: bool = Field(default=False, description=MIRROR)
    keep: Keep | None = Field(
        default=None,
        description=f"{KEEP} It counts for the sum of the layer and what lies below it. Default: "
        "that of the layer's file.",
    )
    mute: bool = Field(default=False, description=MUTE)


GAIN_LEAST_DB: Final = 60.0
GainDb = Annotated[float, Field(ge=-GAIN_LEAST_DB, le=20.0)]
GAIN: Final = "How much louder than in the file; -6 is half."


class EventEntry(FileModel, title="event"):
    """An event that is not motion, at a time of the show: one of led, say, run and sound."""

    at_s: TimeS = Field(description="Seconds from the start of the show.")
    led: dict[Name, Colour] | None = Field(
        default=None,
        min_length=1,
        description="LED colours of joints. After the show they have their old colours again.",
        examples=[{"elbow": "red"}],
    )
    say: Text | None = Field(default=None, description="A line on screen and in the log.")
    run: Annotated[str, Field(pattern=RUN_PATTERN)] | None = Field(
        default=None,
        description="A Python function, called with the time of the show in seconds, in a process "
        "of its own: module:function. The module may stand beside this file.",
        examples=["effects:fog"],
    )
    sound: FileName | None = Field(
        default=None,
        description="A sound file, relative to this file: WAV, FLAC, OGG or MP3. It sounds at at_s "
        "(with the extra [sound]; else a player of the system plays it, later).",
    )
    lead_s: Annotated[float, Field(ge=0.0, le=LEAD_MAX_S)] = Field(
        default=0.0,
        description="A player of the system is started so much earlier, because it needs time to "
        "start. With the extra [sound] it has no effect.",
    )
    gain_db: GainDb = Field(default=0.0, description=GAIN)
    loop: bool = Field(
        default=False, description="The sound is repeated until the end of the show, or of a pass."
    )
    duck_db: Annotated[float, Field(ge=0.0, le=GAIN_LEAST_DB)] = Field(
        default=0.0, description="The sound of the show is so much softer while this one sounds."
    )


class SoundEntry(FileModel, title="sound"):
    """The sound of the show: it begins with it, and the show follows its clock."""

    file: FileName = Field(
        description="A sound file, relative to this file: WAV, FLAC, OGG or MP3.",
        examples=["music.ogg"],
    )
    gain_db: GainDb = Field(default=0.0, description=GAIN)
    loop: bool = Field(
        default=False, description="It is repeated where it is shorter than the show."
    )


class BeatsEntry(FileModel, title="beats"):
    """The beats of the music, for at_beat of keyframes."""

    at_s: BeatTimes = Field(description="The instant of each beat, in order.")
    anchor: bool = Field(
        default=False, description="Keyframes with at_beat are anchors, unless they say otherwise."
    )


class SequenceFile(TrackEntry, title="sequence file"):
    """A show for one robot: keyframes, tracks beside them, or a play list; layers on top."""

    more_schema: ClassVar = {
        "anyOf": [{"required": [key]} for key in ("keyframes", "tracks", "play")]
    }

    sequence: Text = Field(description="Name of the sequence, as shown on screen and in reports.")
    version: Version = Field(default=FILE_VERSION, description=VERSION)
    robot: FileName | None = Field(
        default=None,
        description="Robot file, relative to this file. May be left out if --robot gives it.",
        examples=["robots/desk_arm.yaml"],
    )
    speed_ratio: SpeedRatio = Field(default=1.0, description=SPEED_RATIO)
    mirror: bool = Field(default=False, description=MIRROR)
    loop_span_s: Annotated[list[TimeS], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="From when to when keyframes are looped. Positions and speeds must be equal "
        "at both times. The keyframes before and after it are played once.",
        examples=[[2.0, 3.5]],
    )
    tracks: Annotated[dict[Name, NamedTrackEntry], Field(min_length=1)] = Field(
        default={},
        description="Other joints at the same time, by the name of the track, each with its own "
        "keyframes, timing and loop. Tracks are independent except for anchors.",
    )
    play: Annotated[list[StepEntry], Field(min_length=1, max_length=PLAY_STEPS_MAX)] = Field(
        default=[],
        description="Instead of keyframes: other sequences and pauses, one after the other.",
    )
    layers: Annotated[list[LayerEntry], Field(min_length=1, max_length=LAYERS_MAX)] = Field(
        default=[],
        description="Other sequences on top, the later ones above the earlier. On a show that "
        "loops forever, a layer that ends is played once; an endless one goes on with it.",
    )
    events: Annotated[list[EventEntry], Field(min_length=1, max_length=EVENTS_MAX)] = Field(
        default=[],
        description="Not motion: colours, texts, functions, sounds. A loop repeats them.",
    )
    sound: FileName | SoundEntry | None = Field(
        default=None,
        description="A sound that begins with the show and ends with it at the latest, as music; "
        "in every pass of a loop. Pauses and --from reach it. Its clock leads the show.",
        examples=["music.ogg"],
    )
    beats: BeatTimes | BeatsEntry | None = Field(
        default=None,
        description="The beats of the music in seconds, for at_beat of keyframes, also in tracks. "
        "`lss-motion beats` proposes them.",
        examples=[[0.48, 0.98, 1.48]],
    )
    on_fault: OnFaultEntry = Field(
        default_factory=OnFaultEntry,
        description="What is done in this show when something is wrong. Joints can have their own. "
        "Only that of the file that is played has an effect, not those of its parts.",
    )
