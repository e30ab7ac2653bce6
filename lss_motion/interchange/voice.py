"""A sound → the motion of a joint: syllables for a jaw, swells for a nod, sides for a sway.

The keys are those that a person would set, and may edit: one for each syllable and one between two
of them. Their times are those of the sound. Their angles are the closest ones between which
the servo can move in time (`fitted`): measured on speech at 1000 deg/s², 97 % of the peaks of the
jaw are within 20 ms of those of the sound then, but 64 % if the planner alone gives up angle. The
joint keeps its time (`keep: time`) in any case.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import counted, known_names
from lss_motion.show.model import KEYFRAMES_MAX, Cue, Keyframe, Sequence, SoundStyle
from lss_motion.sound.envelope import (
    MouthStyle,
    loudness,
    openings,
    sides,
    slowed,
    swell_keys,
    syllable_keys,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from collections.abc import Sequence as SequenceOf

    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint, Robot
    from lss_motion.sound.envelope import TurningPoint
    from lss_motion.sound.files import SoundPart

    FloatArray = NDArray[np.float64]

SWELL_S: Final = 0.25
"""Standard deviation of the bell that smooths the loudness for a nod: phrases remain. Chosen."""
SIDE_S: Final = 0.4
"""The same for the side from which a sound comes. Chosen: slower than a head turns."""
SWELL_PROMINENCE: Final = 0.08
"""A swell that is seen, as a share of the whole swing. Chosen."""
EASE_PEAK: Final = 1.5
"""A smooth move from rest to rest is so much faster in its middle than on the average (exact)."""
SPEED_SHARE: Final = 0.25
"""Without an own limit a swell uses this share of the speed of the joint: it accompanies."""
SPAN_MAX_DEG: Final = 60.0
"""A jaw opens less. Where the range of a joint is larger, its angles must be given."""
REACH_RATIO: Final = 0.3
"""A joint turns by this times a t² in t between two turns, at an acceleration of a; 0.25 would be
from rest to rest. Measured on speech: more moves the peaks (0.35: 96 % within 20 ms), less makes
the mouth smaller."""
ROUNDS_MAX: Final = 2000
CLOSE_DEG: Final = 1e-3
"""Rounds of `fitted`, and the change of a round after which it ends."""
CENTRE_RATIO: Final = 0.8
"""Of the way to the middle. Measured on speech: 330 of 424 syllables are seen then, else 300."""
YIELD_RATIO: Final = 0.9
"""Of a pause, so much may be used for closing the mouth and opening it again."""
PAUSE_S: Final = 0.05
"""A closed mouth counts twice as much as a peak, and once more for each of this in a pause."""
FULL_DEG: Final = 0.5
FULL_RATIO: Final = 0.1
"""An opening that lacks less, in degrees and as a share of the largest, is full."""
FADE_S: Final = 0.2
"""Fade of a layer whose mouth is open from its first instant on. Chosen: a syllable."""
TIME_DIGITS: Final = 3
ANGLE_DIGITS: Final = 2
"""Of the keys: a millisecond, and a hundredth of a degree."""


class VoiceFollow(StrEnum):
    """What of a sound a joint follows."""

    SYLLABLES = "syllables"
    ENERGY = "energy"
    STEREO = "stereo"


class VoiceStyle(Struct, frozen=True, kw_only=True):
    """How a sound moves a joint: `near_deg` when it is silent, `far_deg` when it is loud.

    With `VoiceFollow.STEREO` these are the angles for a sound from the left and the right. None: an
    end of the range of the joint.
    """

    follow: VoiceFollow = VoiceFollow.SYLLABLES
    mouth: MouthStyle = field(default_factory=MouthStyle)
    near_deg: float | None = None
    far_deg: float | None = None
    speed_max_deg_s: float | None = None
    """No faster than this (not for syllables); None: a quarter of the speed of the joint."""
    is_fitted: bool = True
    """Syllables are as large as the servo can make them; else as the sound has them."""
    is_sounding: bool = True
    """The sequence plays the sound; only with syllables."""


class Voiced(Struct, frozen=True, kw_only=True):
    """The motion of a joint that follows a sound, and the angles of its keys before `fitted`."""

    sequence: Sequence
    asked_deg: FloatArray


def voice_sequence(part: SoundPart, robot: Robot, joint_name: str, style: VoiceStyle) -> Voiced:
    """Return the motion of a joint that follows a part of a sound file.

    Raises `InputError` for a file that cannot be used, and angles that the joint does not have.
    """
    if joint_name not in robot.joints:
        known = known_names(joint_name, robot.joints)
        raise InputError(f"robot {robot.name!r} has no joint {joint_name!r}; {known}")
    joint = robot.joints[joint_name]
    near_deg, far_deg = _angles(joint, style)
    turns = _turns(part, style, joint, far_deg - near_deg)
    asked_deg = near_deg + np.array([turn.ratio for turn in turns]) * (far_deg - near_deg)
    angles_deg = asked_deg
    if style.follow is VoiceFollow.SYLLABLES and style.is_fitted:
        turns = centred(turns)
        angles_deg = fitted(turns, asked_deg, joint)
        turns = in_time(turns, angles_deg, joint)
    frames = _keyframes(turns, angles_deg, joint_name, part.from_s)
    if len(frames) > KEYFRAMES_MAX:
        raise InputError(
            f"gives {len(frames):,} keyframes, at most {KEYFRAMES_MAX:,} are allowed; import it in "
            f"parts of up to {KEYFRAMES_MAX / len(frames) * turns[-1].at_s / 60.0:.0f} minutes "
            "with --span FROM TO",
            path=part.path,
        )
    sequence = Sequence(
        name=part.path.stem,
        keyframes=frames,
        path=part.path,
        robot_path=robot.path,
        keeps_time=frozenset({joint_name}),
        events=_sound(part, style),
    )
    return Voiced(sequence=sequence, asked_deg=asked_deg)


def voice_comments(voiced: Voiced, part: SoundPart, style: VoiceStyle) -> list[str]:
    """Return what the file is, and how it becomes a layer, for its head."""
    sequence, closed_deg = voiced.sequence, round(float(voiced.asked_deg[0]), ANGLE_DIGITS)
    where = "" if part.channel == "mix" else f", channel {part.channel}"
    span = "" if not part.from_s else f", from {part.from_s:g} s on"
    what = counted(sequence.keyframes, "key")
    (joint,) = sequence.keeps_time
    lines = [f"The {style.follow} of {part.path.name}{where}{span} as {what} of {joint}."]
    if style.follow is not VoiceFollow.SYLLABLES:
        lines.append(f"As a layer: {{file: THIS_FILE, joints: [{joint}], mode: add}}")
    elif sequence.keyframes[0].deg[joint] == closed_deg:
        lines.append(f"As a layer: {{file: THIS_FILE, joints: [{joint}]}}")
    else:
        lines.append(
            f"It begins to speak at once: as a layer {{file: THIS_FILE, joints: [{joint}], "
            f"fade_s: {FADE_S:g}}}."
        )
    return lines


def _angles(joint: Joint, style: VoiceStyle) -> tuple[float, float]:
    """Return the angles of silence and of full sound; raises `InputError` if they cannot be."""
    low, high = joint.position_min_deg, joint.position_max_deg
    near_deg, far_deg = style.near_deg, style.far_deg
    if near_deg is None or far_deg is None:
        if high - low > SPAN_MAX_DEG:
            raise InputError(
                f"joint {joint.name!r} has a range of {low:g} to {high:g} deg, more than a jaw "
                "opens: give both --closed-deg and --open-deg"
            )
        ends = (low, high) if abs(low) <= abs(high) else (high, low)
        near_deg = ends[0] if near_deg is None else near_deg
        far_deg = ends[1] if far_deg is None else far_deg
    for name, deg in (("--closed-deg", near_deg), ("--open-deg", far_deg)):
        if not low <= deg <= high:
            raise InputError(
                f"{name} {deg:g} is outside the range of joint {joint.name!r}: {low:g} to "
                f"{high:g} deg"
            )
    if near_deg == far_deg:
        raise InputError(f"--closed-deg and --open-deg are both {near_deg:g}: nothing would move")
    return near_deg, far_deg


def _turns(
    part: SoundPart, style: VoiceStyle, joint: Joint, swing_deg: float
) -> list[TurningPoint]:
    """Return where the joint turns, from 0 (silent, left) to 1 (loud, right)."""
    if style.follow is VoiceFollow.SYLLABLES:
        curve = loudness(part, style.mouth.band_hz)
        ratio = openings(curve, style.mouth)
        return syllable_keys(ratio, curve.step_s, style.mouth.opening_min)
    if style.follow is VoiceFollow.ENERGY:
        curve = loudness(part, style.mouth.band_hz, SWELL_S)
        return _swells(curve.level / curve.full, curve.step_s, joint, style, swing_deg)
    step_s, side = sides(part, style.mouth.band_hz, SIDE_S)
    return _swells(side, step_s, joint, style, swing_deg)


def _swells(
    ratio: FloatArray, step_s: float, joint: Joint, style: VoiceStyle, swing_deg: float
) -> list[TurningPoint]:
    """Return the turns of a slow curve, within the limit of speed."""
    speed_deg_s = style.speed_max_deg_s or SPEED_SHARE * joint.speed_max_deg_s
    per_s = speed_deg_s / (EASE_PEAK * abs(swing_deg))
    values = slowed(np.clip(ratio, 0.0, 1.0), step_s, per_s)
    # A layer begins and ends where the show below it is: at rest.
    rest = 0.5 if style.follow is VoiceFollow.STEREO else 0.0
    places = np.arange(len(values))
    away = per_s * step_s * np.minimum(places, places[::-1])
    values = rest + np.clip(values - rest, -away, away)
    return swell_keys(values, step_s, SWELL_PROMINENCE)


def centred(turns: SequenceOf[TurningPoint]) -> list[TurningPoint]:
    """Return the turns with valleys nearer to the middle between their peaks.

    The mouth of a slow servo then has as much time to close as to open. When exactly a mouth is
    half closed cannot be seen.
    """
    found = list(turns)
    for index, turn in enumerate(turns[1:-1], start=1):
        before, after = turns[index - 1], turns[index + 1]
        if before.is_peak and after.is_peak and not turn.hold_s:
            middle_s = 0.5 * (before.at_s + after.at_s)
            found[index] = replace(turn, at_s=turn.at_s + CENTRE_RATIO * (middle_s - turn.at_s))
    return found


def fitted(turns: SequenceOf[TurningPoint], asked_deg: FloatArray, joint: Joint) -> FloatArray:
    """Return the angles between which the joint can move in time, closest to those asked.

    Closest in the sense of least squares: the projection on the angles whose neighbours are within
    reach of each other, by the method of Dykstra, even and odd pairs in turn. Pauses count more.
    """
    moving_s = _moving_s(turns, YIELD_RATIO)
    reach_deg = np.minimum(
        REACH_RATIO * joint.accel_max_deg_s2 * moving_s**2,
        joint.speed_max_deg_s * moving_s / EASE_PEAK,
    )
    gives = np.array(
        [1.0 if turn.ratio else PAUSE_S / (2.0 * PAUSE_S + turn.hold_s) for turn in turns]
    )
    shares = gives[:-1] + gives[1:]
    angles_deg, pulls_deg = asked_deg.copy(), np.zeros(len(reach_deg))
    for _ in range(ROUNDS_MAX):
        before_deg = angles_deg.copy()
        for first in (0, 1):
            left = np.arange(first, len(reach_deg), 2)
            angles_deg[left] -= gives[left] * pulls_deg[left]
            angles_deg[left + 1] += gives[left + 1] * pulls_deg[left]
            apart_deg = angles_deg[left + 1] - angles_deg[left]
            beyond_deg = np.maximum(np.abs(apart_deg) - reach_deg[left], 0.0)
            pulls_deg[left] = np.sign(apart_deg) * beyond_deg / shares[left]
            angles_deg[left] += gives[left] * pulls_deg[left]
            angles_deg[left + 1] -= gives[left + 1] * pulls_deg[left]
        if np.abs(angles_deg - before_deg).max() < CLOSE_DEG:
            break
    return np.clip(angles_deg, asked_deg.min(), asked_deg.max())


def _moving_s(turns: SequenceOf[TurningPoint], given_ratio: float) -> FloatArray:
    """Return the time from each turn to the next, if pauses give that share of theirs."""
    at_s = np.array([turn.at_s for turn in turns])
    hold_s = np.array([turn.hold_s for turn in turns])
    given_s = 0.5 * given_ratio * hold_s
    is_outer = np.zeros(len(turns), dtype=np.bool_)
    is_outer[[0, -1]] = True  # They have only one neighbour, which may have all.
    given_s[is_outer] = given_ratio * hold_s[is_outer]
    moving_s: FloatArray = at_s[1:] + given_s[1:] - (at_s + hold_s - given_s)[:-1]
    return np.maximum(moving_s, 0.0)


def in_time(
    turns: SequenceOf[TurningPoint], angles_deg: FloatArray, joint: Joint
) -> list[TurningPoint]:
    """Return the turns with pauses that begin later and end earlier where the moves need it."""
    apart_deg = np.abs(np.diff(angles_deg))
    needed_s = np.sqrt(apart_deg / (REACH_RATIO * joint.accel_max_deg_s2))
    needed_s = np.maximum(needed_s, EASE_PEAK * apart_deg / joint.speed_max_deg_s)
    lacking_s = np.minimum(needed_s, _moving_s(turns, YIELD_RATIO)) - _moving_s(turns, 0.0)
    lacking_s = np.maximum(lacking_s, 0.0)
    before_s, after_s = np.append(0.0, lacking_s), np.append(lacking_s, 0.0)
    found = []
    for turn, late_s, early_s in zip(turns, before_s.tolist(), after_s.tolist(), strict=True):
        if turn.hold_s:
            rest_s = turn.hold_s - late_s - early_s
            found.append(replace(turn, at_s=turn.at_s + late_s, hold_s=rest_s))
        else:
            found.append(turn)
    return found


def _keyframes(
    turns: SequenceOf[TurningPoint], angles_deg: FloatArray, joint: str, from_s: float
) -> tuple[Keyframe, ...]:
    """Return the turns as keyframes, in whole milliseconds and hundredths of a degree."""
    frames: list[Keyframe] = []
    for turn, angle_deg in zip(turns, angles_deg.tolist(), strict=True):
        at_s = round(from_s + turn.at_s, TIME_DIGITS)
        end_s = round(from_s + turn.at_s + turn.hold_s, TIME_DIGITS)
        deg = {joint: round(angle_deg, ANGLE_DIGITS) + 0.0}
        frames.append(Keyframe(at_s=at_s, deg=deg, hold_s=round(end_s - at_s, TIME_DIGITS)))
    return tuple(frames)


def _sound(part: SoundPart, style: VoiceStyle) -> tuple[Cue, ...]:
    """Return the sound of the show, if the sequence plays it."""
    if style.follow is not VoiceFollow.SYLLABLES or not style.is_sounding:
        return ()
    return (Cue(at_s=0.0, sound=str(part.path.absolute()), style=SoundStyle(is_bed=True)),)


class Shortfall(Struct, frozen=True, kw_only=True):
    """How much of the openings of a joint a plan does not give."""

    openings: int
    less: int
    """Openings that are not made fully."""
    median_deg: float
    """Of those."""
    worst_deg: float
    worst_at_s: float
    open: int
    """Closings between them that are not made fully."""


def shortfall(voiced: Voiced, angle_at: Callable[[FloatArray], FloatArray]) -> Shortfall:
    """Return what the servo cannot make of the syllables; `angle_at` gives the planned angles."""
    times_s = np.array([frame.at_s for frame in voiced.sequence.keyframes])
    closed_deg = voiced.asked_deg[0]
    swing_deg = voiced.asked_deg - closed_deg
    sign = float(np.sign(swing_deg[np.abs(swing_deg).argmax()]))
    asked = sign * swing_deg
    given = sign * (angle_at(times_s) - closed_deg)
    is_peak = np.zeros(len(asked), dtype=np.bool_)
    is_peak[1:-1] = (asked[1:-1] > asked[:-2]) & (asked[1:-1] > asked[2:])
    less = np.where(is_peak, asked - given, 0.0)
    full_deg = min(FULL_DEG, FULL_RATIO * float(asked.max()))
    short = less > full_deg
    worst = int(less.argmax())
    return Shortfall(
        openings=int(is_peak.sum()),
        less=int(short.sum()),
        median_deg=float(np.median(less[short])) if short.any() else 0.0,
        worst_deg=float(less[worst]),
        worst_at_s=float(times_s[worst]),
        open=int((~is_peak & (given - asked > full_deg)).sum()),
    )
