"""Labels of a sound → a sequence: mouth shapes as poses, or a keyframe for each label.

A mouth shape is reached after the beginning of its span and left before its end, so that the change
from one to the next is centred on the instant between them. The joints keep their time
(`keep: time`).
"""

from __future__ import annotations

import math
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.interchange.reader import DIGITS, Span, motion_label
from lss_motion.show.check import clashes, jumps
from lss_motion.show.model import (
    KEYFRAMES_MAX,
    TIME_MAX_S,
    Cue,
    Keyframe,
    Sequence,
    SoundStyle,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping

    from lss_motion.interchange.reader import LabelTrack
    from lss_motion.robot.model import Robot

BLAIR: Final = ("AI", "E", "etc", "FV", "L", "MBP", "O", "rest", "U", "WQ")
"""Open; wide; most consonants; lip under the teeth; tongue up; lips closed; round; at rest;
pursed; pursed more."""

RHUBARB: Final[Mapping[str, str]] = {
    "A": "MBP", "B": "etc", "C": "E", "D": "AI", "E": "O", "F": "U", "G": "FV", "H": "L",
    "X": "rest",
}  # fmt: skip

INSTEAD: Final[Mapping[str, tuple[str, ...]]] = {
    "rest": ("MBP",), "MBP": ("rest",), "FV": ("MBP", "rest"), "L": ("E",), "WQ": ("U", "O"),
    "U": ("WQ", "O"), "etc": ("E",), "O": ("U",), "E": ("etc", "AI"), "AI": ("E",),
}  # fmt: skip
"""What is taken where a robot does not have a shape; as far as Rhubarb has optional shapes, its
own choice."""

_ARPABET: Final[Mapping[str, str]] = {
    "AI": "AA AE AH AW AX AY",
    "E": "EH ER EY IH IX IY AXR",
    "O": "AO OW OY",
    "U": "UH UW UX",
    "WQ": "W",
    "MBP": "B M P",
    "FV": "F V",
    "L": "L EL",
    "etc": "CH D DH DX EN G HH JH K N NG R S SH T TH Y Z ZH Q",
    "rest": "SIL SP SPN PAU",
}
ARPABET: Final = {phone: shape for shape, row in _ARPABET.items() for phone in row.split()}

_IPA: Final[Mapping[str, str]] = {
    "AI": "aɑæʌɐ{",
    "E": "eɛiɪəɜɚɝɘɨᵻ@",
    "O": "oɔɒɵ",
    "U": "uʊɯyʏøœʉ",
    "WQ": "wʍɥ",
    "MBP": "bmpɓ",
    "FV": "fvɱʋ",
    "L": "lɫɭʎ",
    "etc": "cdðɖɾɡgɣhɦjkçxχnŋɲɳqrɹɻʀʁsʃʂʒzʐtθʈʔʝɟβɸ",
}
IPA: Final = {sound: shape for shape, row in _IPA.items() for sound in row}
_MARKS: Final = "ˈˌːˑ.'̯̩̃͡ʰʲʷ̥"
"""Stress, length and other marks, which say nothing about the lips."""
IPA_MAX_CHARS: Final = 2
"""Letters of a diphthong or an affricate; a longer label is a word."""


def shape_reader(labels: Iterable[str]) -> Callable[[str], str] | None:
    """Return the function from label to shape of `BLAIR` that knows all labels; None if none does.

    An empty label is a mouth at rest.
    """
    known = {label for label in labels if label}
    for reader in (_rhubarb, _blair, _arpabet, _ipa):
        if known and all(map(reader, known)):
            return lambda label: reader(label) if label else "rest"
    return None


def _rhubarb(label: str) -> str:
    return RHUBARB.get(label, "")


def _blair(label: str) -> str:
    return next((shape for shape in BLAIR if shape.lower() == label.lower()), "")


def _arpabet(label: str) -> str:
    return ARPABET.get(label.rstrip("012").upper(), "")


def _ipa(label: str) -> str:
    bare = [char for char in label if char not in _MARKS]
    if not 1 <= len(bare) <= IPA_MAX_CHARS or not all(char in IPA for char in bare):
        return ""
    return IPA[bare[0]]


def robot_shapes(names: Collection[str]) -> dict[str, str]:
    """Return the names of a robot's visemes by the shape of `BLAIR` that they mean.

    They are names of Rhubarb if all are, else those of Blair; other names mean no shape.
    """
    reader = _rhubarb if all(name in RHUBARB for name in names) else _blair
    return {shape: name for name in names if (shape := reader(name))}


def nearest(shape: str, shapes: Mapping[str, str]) -> str | None:
    """Return the name among `shapes` of a shape, or of what is taken instead; None: neither."""
    return next((shapes[one] for one in (shape, *INSTEAD[shape]) if one in shapes), None)


CHANGE_S: Final = 0.1
"""A mouth takes so long from one shape to the next, where the shapes are long enough. Chosen."""
GAP_S: Final = 0.03
"""A gap between two shapes that is longer is a mouth at rest."""


class LabelUse(StrEnum):
    """What labels become."""

    MOUTH = "mouth"
    """Poses of a mouth: the `visemes` of the robot."""
    KEYFRAMES = "keyframes"
    """A keyframe each, with the label and the angles of the pose of that name."""


class LabelStyle(Struct, frozen=True, kw_only=True):
    """How labels become keyframes."""

    use: LabelUse | None = None
    """None: a mouth if all labels are mouth shapes or phonemes and the robot has visemes."""
    pose: str | None = None
    """Pose of the robot for labels that are no pose."""
    is_anchored: bool = False
    """Keyframes of labels are anchors."""
    fps: float | None = None
    """Frame rate, where the file does not give it."""
    is_sounding: bool = True
    """The sequence plays the sound that the file names, if it is beside it."""


def label_sequence(
    track: LabelTrack, robot: Robot, style: LabelStyle
) -> tuple[Sequence, tuple[str, ...]]:
    """Return the sequence of a track for a robot, and comments about it.

    Raises `InputError` if the robot has no pose for what the labels say.
    """
    track, comments = _timed(track, style.fps)
    shape_of = shape_reader(span.text for span in track.spans)
    use = style.use or _use(track, robot, is_known=shape_of is not None)
    if use is LabelUse.MOUTH:
        frames, more = _mouth(track, robot, shape_of)
    else:
        frames, more = _labelled(track, robot, style), []
    if len(frames) > KEYFRAMES_MAX:
        raise InputError(
            f"has {len(frames):,} keyframes, at most {KEYFRAMES_MAX:,} are allowed", path=track.path
        )
    last_s = max((frame.at_s or 0.0) + frame.hold_s for frame in frames)
    if last_s > TIME_MAX_S:
        reason = f"takes {last_s:g} s, more than a day ({TIME_MAX_S:g} s)"
        raise InputError(reason, path=track.path)
    for index, reason in (*jumps(frames), *clashes(frames)):
        at_s = frames[index].at_s or 0.0
        text = f"label {frames[index].label!r} at {at_s:g} s: {reason}"
        raise InputError(text, path=track.path, line=frames[index].line)
    is_mouth = use is LabelUse.MOUTH
    sequence = Sequence(
        name=track.name,
        keyframes=tuple(frames),
        path=track.path,
        robot_path=robot.path,
        keeps_time=frozenset(name for frame in frames for name in frame.deg if is_mouth),
        events=_sound(track, style),
    )
    return sequence, (*track.comments, *comments, *more)


def _timed(track: LabelTrack, fps: float | None) -> tuple[LabelTrack, list[str]]:
    """Return the track at a frame rate, and a comment if that was assumed."""
    if track.assumed_fps is None:
        if fps is not None:
            raise InputError("gives its times itself; leave out --fps", path=track.path)
        return track, []
    if fps is None:
        what = f"Assumed: {track.assumed_fps:g} frames per second (--fps N gives another rate)."
        return track, [what]
    ratio = track.assumed_fps / fps
    spans = tuple(
        replace(
            span, from_s=round(ratio * span.from_s, DIGITS), to_s=round(ratio * span.to_s, DIGITS)
        )
        for span in track.spans
    )
    return replace(track, spans=spans), []


def _use(track: LabelTrack, robot: Robot, *, is_known: bool) -> LabelUse:
    if track.is_mouth or (is_known and robot.visemes):
        return LabelUse.MOUTH
    return LabelUse.KEYFRAMES


def _mouth(
    track: LabelTrack, robot: Robot, shape_of: Callable[[str], str] | None
) -> tuple[list[Keyframe], list[str]]:
    """Return the mouth shapes as keyframes, and comments."""
    if not robot.visemes:
        raise InputError(
            f"holds mouth shapes, but robot {robot.name!r} has none; give it the angles of each, "
            "such as visemes: {rest: {jaw: 0}, MBP: {jaw: 0}, AI: {jaw: 25}, E: {jaw: 12}, "
            "O: {jaw: 18}, U: {jaw: 8}, etc: {jaw: 6}}, or use the labels as keyframes "
            "(--labels keyframes)",
            path=track.path,
        )
    names, comments = _visemes(track, robot, shape_of)
    frames: list[Keyframe] = []
    for span in _filled(track.spans):
        name = names[span.text]
        inset_s = 0.5 * min(CHANGE_S, span.to_s - span.from_s)
        at_s, end_s = round(span.from_s + inset_s, DIGITS), round(span.to_s - inset_s, DIGITS)
        if frames and at_s <= (frames[-1].at_s or 0.0) + frames[-1].hold_s:
            continue  # Shorter than the rounding.
        frames.append(
            Keyframe(
                at_s=at_s,
                deg=robot.visemes[name],
                hold_s=round(max(end_s - at_s, 0.0), DIGITS),
                label=motion_label(name),
                line=span.line,
            )
        )
    return frames, comments


def _visemes(
    track: LabelTrack, robot: Robot, shape_of: Callable[[str], str] | None
) -> tuple[Mapping[str, str], list[str]]:
    """Return the viseme of the robot for each label, and what was taken instead of another."""
    shapes = robot_shapes(robot.visemes)
    names: dict[str, str] = {}
    missing: dict[str, int | None] = {}
    instead: list[str] = []
    for span in (*track.spans, Span(0.0, 0.0, "")):
        text = span.text
        shape = shape_of(text) if shape_of is not None else ("" if text else "rest")
        if text in robot.visemes and not (shape and shapes.get(shape)):
            names[text] = text
        elif (name := nearest(shape, shapes) if shape else None) is not None:
            names[text] = name
            if shapes.get(shape) != name:
                instead.append(f"{name} is taken for {shape}, which the robot does not have.")
        else:
            missing.setdefault(text, span.line)
    if missing:
        text, line = next(iter(missing.items()))
        known = known_names(text or "rest", robot.visemes)
        others = f" (and {len(missing) - 1} more)" if len(missing) > 1 else ""
        raise InputError(
            f"robot {robot.name!r} has no viseme for {text or 'rest'!r:.60}{others}; {known}",
            path=track.path,
            line=line,
        )
    return names, list(dict.fromkeys(instead))


def _filled(spans: tuple[Span, ...]) -> list[Span]:
    """Return the spans without overlaps, with rests between them, equal neighbours joined."""
    found: list[Span] = []
    end_s = 0.0
    for span, after in zip(spans, [*spans[1:], None], strict=True):
        if span.from_s > end_s:
            found.append(Span(end_s, span.from_s, ""))
        end_s = span.to_s
        if after is not None and (end_s > after.from_s or after.from_s - end_s <= GAP_S):
            end_s = after.from_s
        found.append(replace(span, to_s=end_s))
    joined: list[Span] = []
    for span in found:
        if joined and joined[-1].text == span.text:
            joined[-1] = replace(joined[-1], to_s=span.to_s)
        else:
            joined.append(span)
    return joined


def _labelled(track: LabelTrack, robot: Robot, style: LabelStyle) -> list[Keyframe]:
    """Return a keyframe for each label that has a text."""
    spans = [span for span in track.spans if span.text]
    if not spans:
        raise InputError("has no label with a text", path=track.path)
    if style.pose is not None and style.pose not in robot.poses:
        raise InputError(f"unknown pose {style.pose!r}; {known_names(style.pose, robot.poses)}")
    poses = [_pose(span, track, robot, style) for span in spans]
    frames: list[Keyframe] = []
    for index, (span, deg) in enumerate(zip(spans, poses, strict=True)):
        end_s = span.to_s
        if index + 1 < len(spans):
            end_s = min(end_s, spans[index + 1].from_s - _move_s(robot, deg, poses[index + 1]))
        frames.append(
            Keyframe(
                at_s=span.from_s,
                deg=deg,
                hold_s=round(max(end_s - span.from_s, 0.0), DIGITS),
                is_anchor=style.is_anchored,
                label=motion_label(span.text),
                line=span.line,
            )
        )
    return frames


def _pose(span: Span, track: LabelTrack, robot: Robot, style: LabelStyle) -> Mapping[str, float]:
    """Return the angles of the pose of a label's name, or of the one for all others."""
    name = span.text if span.text in robot.poses else style.pose
    if name is None:
        known = known_names(span.text, robot.poses)
        raise InputError(
            f"label {span.text!r:.60} is no pose of robot {robot.name!r}, whose angles its "
            f"keyframe could have; {known}; --pose NAME gives a pose for such labels",
            path=track.path,
            line=span.line,
        )
    return robot.poses[name]


def _move_s(robot: Robot, before: Mapping[str, float], after: Mapping[str, float]) -> float:
    """Return how long a smooth move over d takes: speed 1.5 d / t, acceleration 6 d / t²."""
    found_s = 0.0
    for name in before.keys() & after.keys():
        joint, apart_deg = robot.joints[name], abs(after[name] - before[name])
        found_s = max(found_s, 1.5 * apart_deg / joint.speed_max_deg_s)
        found_s = max(found_s, math.sqrt(6.0 * apart_deg / joint.accel_max_deg_s2))
    return found_s


def _sound(track: LabelTrack, style: LabelStyle) -> tuple[Cue, ...]:
    """Return the sound that the file names, if it is beside it."""
    path = track.path.absolute().parent / (track.sound or ".")
    if not style.is_sounding or not path.is_file():
        return ()
    return (Cue(at_s=0.0, sound=str(path), style=SoundStyle(is_bed=True)),)
