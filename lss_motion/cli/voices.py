"""The parts of `import` for sounds and labels: their options, and what is printed."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Final

from lss_motion.cli.messages import say
from lss_motion.cli.options import number_from
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    from pathlib import Path

    from lss_motion.interchange.reader import LabelTrack
    from lss_motion.interchange.voice import Shortfall, Voiced, VoiceStyle
    from lss_motion.robot.model import Robot
    from lss_motion.sound.files import Channel, SoundPart

CHANNELS_MAX: Final = 1024
"""The most that a sound file can have (libsndfile)."""

SOUND_TEXT: Final = """\
A sound becomes the motion of one joint: --joint jaw makes keys of its syllables, one for each
opening and one between two of them, as far as the servo can follow on time. The angles run from
--closed-deg to --open-deg (by default the range of the joint). --follow energy makes slow swells of
its loudness, for a nod, and --follow stereo moves between its left and its right side.

  lss-motion import voice.wav --robot my_robot.yaml --joint jaw -o jaw.yaml
  lss-motion import voice.wav --robot my_robot.yaml --joint nod --follow energy --closed-deg 0 \\
    --open-deg 12 -o nod.yaml
"""

LABEL_TEXT: Final = """\
Lip-sync files (rhubarb, papagayo) become poses of a mouth, the visemes of the robot file; so do
labels of other tools that are mouth shapes or phonemes, in ARPABET or IPA. Other labels become
keyframes with the pose of that name, or that of --pose.

  lss-motion import voice.json --robot my_robot.yaml -o mouth.yaml
  lss-motion import labels.txt --robot my_robot.yaml --pose home --anchors -o skeleton.yaml
"""

LABEL_OPTIONS: Final = ("labels", "pose", "anchors", "fps")

OPTIONS: Final = (
    "follow", "channel", "span", "closed_deg", "open_deg", "band_hz", "threshold_db", "gain_db",
    "attack_s", "release_s", "opening_min", "speed_max_deg_s", "full",
)  # fmt: skip
"""What is only for sounds."""

NOT_FOR_SOUND: Final = (
    "format_name", "motion", "map", "make_map", "unwrap", "clip", *LABEL_OPTIONS,
)  # fmt: skip
NOT_FOR_LABELS: Final = ("map", "make_map", "unwrap", "clip")


def add_sound_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of a sound to `import`."""
    group = parser.add_argument_group("sounds (WAV, FLAC, OGG, MP3)")
    group.add_argument("--joint", metavar="NAME", help="the joint that follows the sound")
    group.add_argument(
        "--follow",
        choices=("syllables", "energy", "stereo"),
        help="what it follows: syllables (default), the loudness of phrases, or the side from "
        "which the sound comes",
    )
    group.add_argument(
        "--channel",
        type=channel_of,
        metavar="C",
        help="only this channel: left, right, or a number from 1 on, as for the voice of one of "
        "several figures (default: the mean of all)",
    )
    group.add_argument(
        "--span",
        nargs=2,
        type=number_from(0.0, 86_400.0, "s"),
        metavar=("FROM", "TO"),
        help="only this part, in seconds; its keys keep the times of the sound",
    )
    _add_level_options(group)
    _add_motion_options(group)
    group.add_argument(
        "--no-sound",
        action="store_const",
        const=True,
        help="the written sequence does not play the sound: for a layer of a show that does",
    )


def _add_level_options(group: argparse._ArgumentGroup) -> None:
    """Add how the level of a sound becomes an opening."""
    seconds = number_from(0.0, 10.0, "s", is_above=True)
    group.add_argument(
        "--band-hz",
        nargs=2,
        type=number_from(1.0, 96_000.0, "Hz"),
        metavar=("LOW", "HIGH"),
        help="only sound between these frequencies counts (default 150 5000)",
    )
    group.add_argument(
        "--threshold-db",
        type=number_from(-90.0, -1.0, "dB"),
        metavar="DB",
        help="what is so much softer than loud speech leaves the mouth closed (default -30)",
    )
    group.add_argument(
        "--gain-db",
        type=number_from(-40.0, 40.0, "dB"),
        metavar="DB",
        help="more opens wider: soft syllables are seen, loud ones are all full (default 0)",
    )
    group.add_argument(
        "--attack-s", type=seconds, metavar="S", help="least time of a full opening (default 0.05)"
    )
    group.add_argument(
        "--release-s", type=seconds, metavar="S", help="least time of a full closing (default 0.1)"
    )
    group.add_argument(
        "--opening-min",
        type=number_from(0.0, 1.0),
        metavar="RATIO",
        help="each syllable opens at least so far; 1 is fully (default 0.15)",
    )


def _add_motion_options(group: argparse._ArgumentGroup) -> None:
    """Add what of the joint moves."""
    angle = number_from(-3600.0, 3600.0, "degrees")
    group.add_argument(
        "--closed-deg", type=angle, metavar="DEG", help="angle in silence; stereo: at the left"
    )
    group.add_argument(
        "--open-deg", type=angle, metavar="DEG", help="angle when loud; stereo: at the right"
    )
    group.add_argument(
        "--speed-max-deg-s",
        type=number_from(0.0, 1000.0, "deg/s", is_above=True),
        metavar="V",
        help="energy and stereo move no faster (default: a quarter of the speed of the joint)",
    )
    group.add_argument(
        "--full",
        action="store_const",
        const=True,
        help="keep the angles of the sound where the servo cannot reach them; what is planned then "
        "gives up angle, and the peaks move",
    )


def add_label_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of labels to `import`."""
    group = parser.add_argument_group("labels and mouth shapes")
    group.add_argument(
        "--labels",
        choices=("mouth", "keyframes"),
        help="what they become (default: a mouth if the robot has visemes for them)",
    )
    group.add_argument("--pose", metavar="NAME", help="the pose of labels that are no pose")
    group.add_argument(
        "--anchors",
        action="store_const",
        const=True,
        help="keyframes of labels are anchors: their times must be met",
    )
    group.add_argument(
        "--fps",
        type=number_from(1.0, 1000.0),
        metavar="N",
        help="frames per second of switch data, which does not give it (default 24)",
    )


def _typed(arguments: argparse.Namespace, names: tuple[str, ...]) -> str:
    """Return the options of `names` that were given, as they are typed."""
    given = [name for name in names if getattr(arguments, name) not in (None, False)]
    return ", ".join(f"--{name.replace('_', '-').replace('format-name', 'from')}" for name in given)


def require_no_labels(arguments: argparse.Namespace) -> None:
    """Raise `InputError` for options of labels, where the file holds none."""
    if names := _typed(arguments, (*LABEL_OPTIONS, "no_sound")):
        raise InputError(f"{names}: only for labels, and this is a motion", path=arguments.file)


def require_options(arguments: argparse.Namespace) -> None:
    """Raise `InputError` for options that do not go together."""
    if arguments.joint is None and (names := _typed(arguments, OPTIONS)):
        raise InputError(f"{names}: only for a sound; add --joint, which follows it")
    if arguments.joint is not None and (names := _typed(arguments, NOT_FOR_SOUND)):
        raise InputError(f"{names}: not for a sound; leave it out, or leave out --joint")


def import_sound(arguments: argparse.Namespace, robot: Robot) -> int:
    """Write the sequence of the joint that follows the sound; print what was made of it."""
    from lss_motion.interchange.voice import shortfall, voice_comments, voice_sequence
    from lss_motion.planning.summaries import late_marks, plan_lines
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.parts import keeping
    from lss_motion.show.write import write_sequence

    part, style = _part(arguments), _style(arguments)
    voiced = voice_sequence(part, robot, arguments.joint, style)
    sequence = voiced.sequence
    if arguments.keep == "angle":
        sequence = keeping(sequence, is_time=False)
    trajectory = plan(sequence, robot)
    comments = voice_comments(voiced, part, style)
    if late := late_marks(trajectory):
        comments += [
            f"keep: angle leaves the joint up to {late[0][1]:.3f} s behind the sound; with",
            "keep: time (the default for a sound) it stays with it, and gives up angle.",
        ]
    elif style.follow == "syllables":
        found = shortfall(voiced, lambda times_s: trajectory.sample(times_s)[:, 0])
        comments += _shortfall_lines(found, voiced)
    write_sequence(sequence, arguments.output, comments=comments)
    say(f"{arguments.output}: {counted(sequence.keyframes, 'keyframe')} from {arguments.file}")
    say("\n".join(comments))
    say("\n".join(plan_lines(trajectory, robot)))
    return EXIT_FINISHED


def import_labels(arguments: argparse.Namespace, track: LabelTrack, robot: Robot) -> int:
    """Write the sequence of a track of labels; print what was made of it."""
    from lss_motion.interchange.labels import LabelStyle, LabelUse, label_sequence
    from lss_motion.planning.summaries import plan_lines
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.parts import keeping
    from lss_motion.show.write import write_sequence

    if names := _typed(arguments, NOT_FOR_LABELS):
        raise InputError(f"{names}: not for labels; leave it out", path=arguments.file)
    style = LabelStyle(
        use=None if arguments.labels is None else LabelUse(arguments.labels),
        pose=arguments.pose,
        is_anchored=bool(arguments.anchors),
        fps=arguments.fps,
        is_sounding=not arguments.no_sound,
    )
    sequence, comments = label_sequence(track, robot, style)
    if arguments.keep is not None:
        sequence = keeping(sequence, is_time=arguments.keep == "time")
    trajectory = plan(sequence, robot)
    write_sequence(sequence, arguments.output, comments=comments)
    say(f"{arguments.output}: {counted(sequence.keyframes, 'keyframe')} from {arguments.file}")
    say("\n".join(comments))
    say("\n".join(plan_lines(trajectory, robot)))
    return EXIT_FINISHED


def _shortfall_lines(found: Shortfall, voiced: Voiced) -> list[str]:
    swing_deg = float(abs(voiced.asked_deg - voiced.asked_deg[0]).max())
    openings = f"{counted(found.openings, 'opening')} of up to {swing_deg:g} deg"
    if not found.less:
        return [f"{openings}: the servo makes all of them fully."]
    return [
        f"{openings}: the servo makes {found.openings - found.less} of them fully, and "
        f"{found.less} less far,",
        f"by {found.median_deg:.1f} deg (median), at most {found.worst_deg:.1f} deg at "
        f"{found.worst_at_s:.2f} s; {found.open} of the closings between them stay open.",
        "A smaller --open-deg or a faster servo comes nearer.",
    ]


def channel_of(text: str) -> Channel:
    """Return the channel of a sound that an argument names."""
    if text in ("left", "right", "mix"):
        return text  # type: ignore[return-value]  # mypy does not narrow a str to literals
    if text.isascii() and text.isdigit() and 1 <= int(text) <= CHANNELS_MAX:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not left, right, mix or a number from 1 on")


def _part(arguments: argparse.Namespace) -> SoundPart:
    from lss_motion.sound.files import SoundPart

    from_s, to_s = arguments.span or (0.0, None)
    path: Path = arguments.file
    return SoundPart(path=path, channel=arguments.channel or "mix", from_s=from_s, to_s=to_s)


def _style(arguments: argparse.Namespace) -> VoiceStyle:
    from lss_motion.interchange.voice import Follow, VoiceStyle
    from lss_motion.sound.envelope import MouthStyle

    names = ("threshold_db", "attack_s", "release_s", "gain_db", "opening_min")
    given = {name: getattr(arguments, name) for name in names}
    if arguments.band_hz:
        given["band_hz"] = tuple(arguments.band_hz)
    mouth = MouthStyle(**{name: value for name, value in given.items() if value is not None})
    return VoiceStyle(
        follow=Follow(arguments.follow or "syllables"),
        mouth=mouth,
        near_deg=arguments.closed_deg,
        far_deg=arguments.open_deg,
        speed_max_deg_s=arguments.speed_max_deg_s,
        is_fitted=not arguments.full,
        is_sounding=not arguments.no_sound,
    )
