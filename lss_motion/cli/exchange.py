"""The commands `import` and `export`: motion of other tools, and motion for them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import TOLERANCE_MAX_DEG, add_command, reader
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options, channel_of, number_from
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Iterable

    from lss_motion.cli.commands import Commands
    from lss_motion.interchange.reader import LabelTrack
    from lss_motion.interchange.voice import Shortfall, Voiced, VoiceStyle
    from lss_motion.planning.shows import Show
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.robot.model import Robot
    from lss_motion.show.model import Sequence
    from lss_motion.sound.files import SoundPart

FORMATS_IN: Final = (
    "d6a, lerobot, numpy, mcap, rhubarb, papagayo, praat, xlights, audacity, "
    "bitbots, hulks, reachy, pypot, blender, bottango, choregraphe, webots, bvh, mtn, maestro, "
    "ssc32-csv, pypose, nubots, ros, csv, commands, opencat, poses, robotis-bin"
)
"""The names of `interchange.FORMAT_NAMES`, which loads too slowly for a help text; a test
compares them."""

PROGRAM: Final = "lss"

SKETCH: Final = "arduino"

MCAP: Final = "mcap"

FORMATS_OUT: Final = ("csv", "ros", "blender-csv", "blender-json", PROGRAM, SKETCH, MCAP)
"""The names of `interchange.EXPORT_NAMES`; the compiled program, as text and as a sketch; a log."""

KINDS: Final = {
    "csv": OutputKind.TABLE,
    "ros": OutputKind.ROS,
    "blender-csv": OutputKind.TABLE,
    "blender-json": OutputKind.BLENDER,
    PROGRAM: OutputKind.PROGRAM,
    SKETCH: OutputKind.ARDUINO,
    MCAP: OutputKind.MCAP,
}

SUFFIXES: Final = {
    ".csv": "csv",
    ".yaml": "ros",
    ".yml": "ros",
    ".json": "blender-json",
    ".lss": PROGRAM,
    ".ino": SKETCH,
    ".mcap": MCAP,
}

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

IMPORT_TEXT: Final = f"""\
Turn the motion of another tool into a sequence file that a person can read and edit.

  lss-motion import dance.csv --robot my_robot.yaml -o dance.yaml
  lss-motion import dance.csv --robot my_robot.yaml --make-map map.yaml
  lss-motion import dance.csv --robot my_robot.yaml --map map.yaml -o dance.yaml

Formats: {FORMATS_IN}.
The format is recognised by the content. A dense recording is reduced to the fewest keys that stay
within the tolerance. A map file gives, for each joint of the motion, the joint of this robot and
the meaning of its values; --make-map writes one to begin with.

{SOUND_TEXT}
{LABEL_TEXT}"""

EXPORT_TEXT: Final = """\
Write the motion of a sequence, or a log of lss-play, for other tools.

  lss-motion export wave.yaml -o wave.csv
  lss-motion export wave.yaml --to blender-csv -o wave.csv
  lss-motion export wave.yaml -o wave/wave.ino
  lss-motion export wave.log -o wave.mcap

An Arduino sketch (and wave_program.h beside it) plays the compiled program without a computer, with
the library "LSS" of the maker of the servos. MCAP holds what a log does: positions that the servos
reported and targets that they were sent as sensor_msgs/msg/JointState, events as JSON.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_import(commands)
    _add_export(commands)


def _add_import(commands: Commands) -> None:
    imported = add_command(commands, "import", _import, IMPORT_TEXT)
    imported.add_argument("file", type=Path, metavar="FILE", help="the file of the other tool")
    imported.add_argument(
        "--from",
        dest="format_name",
        metavar="FORMAT",
        help="one of the formats above (default: recognised by content)",
    )
    add_options(imported, "--robot", required=True, help="the robot that is to play it")
    add_options(imported, "--robot-cache")
    imported.add_argument(
        "--motion", metavar="NAME", help="which motion, if the file holds several"
    )
    imported.add_argument(
        "--map", type=Path, metavar="M.yaml", help="the map of its joints to those of the robot"
    )
    imported.add_argument(
        "--tolerance-deg",
        type=number_from(0.0, TOLERANCE_MAX_DEG, "degrees"),
        default=1.0,
        metavar="DEG",
        help="largest deviation from a recording (default 1; 0: every sample is a key, within "
        "0.02 deg)",
    )
    imported.add_argument(
        "--interpolation",
        choices=("spline", "smooth", "linear"),
        default="spline",
        help="between the keys of a recording: spline (default) needs the least acceleration, "
        "smooth never goes beyond a key, linear stops at every key",
    )
    imported.add_argument(
        "--unwrap",
        action="store_true",
        help="remove the full turns of encoders that wrap, in a recording",
    )
    imported.add_argument(
        "--clip",
        action="store_true",
        help="limit angles beyond the range of a joint to the range, and list them",
    )
    imported.add_argument(
        "--keep",
        choices=("angle", "time"),
        help="what joints keep where their servo is too slow: every angle, but later (default), or "
        "every instant, but less far (default for a sound); commands of a script then stay as they "
        "are",
    )
    imported.add_argument(
        "--wait-unit",
        choices=("ms", "s"),
        help="unit of `wait` and `pause` in command text where they have none (default: s for "
        "fractions and if all whole numbers are below 20, else ms)",
    )
    add_sound_options(imported)
    add_label_options(imported)
    target = imported.add_mutually_exclusive_group(required=True)
    add_options(target, "--output", metavar="S.yaml", help="the sequence to write")
    target.add_argument(
        "--make-map", type=Path, metavar="M.yaml", help="write only a map file to begin with"
    )
    add_options(imported, "--force")


def _add_export(commands: Commands) -> None:
    exported = add_command(commands, "export", _export, EXPORT_TEXT)
    exported.add_argument(
        "file", type=Path, metavar="FILE", help="a sequence or a gait; for mcap a log"
    )
    add_options(exported, "--robot", "--robot-cache")
    exported.add_argument(
        "--to",
        choices=FORMATS_OUT,
        help="the format (default, by the suffix of the output: csv, ros for .yaml, blender-json "
        "for .json, lss, arduino for .ino, mcap)",
    )
    exported.add_argument(
        "--rate-hz",
        type=number_from(0.1, 1000.0, "Hz"),
        default=100.0,
        metavar="N",
        help="samples per second (default 100)",
    )
    add_options(exported, "--output", required=True, metavar="F", help="the file to write")
    add_options(exported, "--force")


def _import(arguments: argparse.Namespace) -> int:
    from lss_motion.interchange.importing import imported, read_motion
    from lss_motion.interchange.mapping import load_map, map_template
    from lss_motion.interchange.reader import LabelTrack
    from lss_motion.planning.summaries import fit_text
    from lss_motion.show.model import Interpolation
    from lss_motion.sound.files import is_sound

    require_outputs(
        [Output(arguments.make_map or arguments.output, OutputKind.YAML)],
        sources=[arguments.file, arguments.robot, arguments.robot_cache, arguments.map],
        is_forced=arguments.force,
    )
    require_options(arguments)
    robot = reader(arguments, may_query=False)(arguments.robot)
    if arguments.joint is not None:
        return import_sound(arguments, robot)
    if is_sound(arguments.file):
        raise InputError(
            "is a sound; name the joint that follows it, such as --joint jaw", path=arguments.file
        )
    motion = read_motion(
        arguments.file,
        format_name=arguments.format_name,
        motion_name=arguments.motion,
        wait_unit=arguments.wait_unit,
    )
    if isinstance(motion, LabelTrack):
        return import_labels(arguments, motion, robot)
    require_no_labels(arguments)
    if arguments.make_map is not None:
        write_output(arguments.make_map, map_template(motion, robot))
        say(f"{arguments.make_map}: {counted(motion.channels, 'joint')}; edit it, then use --map")
        return EXIT_FINISHED
    made = imported(
        motion,
        robot,
        motion_map=None if arguments.map is None else load_map(arguments.map),
        tolerance_deg=arguments.tolerance_deg,
        ease=Interpolation(arguments.interpolation),
        is_unwrapped=arguments.unwrap,
        is_clipped=arguments.clip,
        keeps_time=arguments.keep == "time",
    )
    fit = [] if made.fit is None else [fit_text(made.fit)]
    return _write(arguments, made.sequence, [*made.comments, *fit], robot)


def _write(
    arguments: argparse.Namespace,
    sequence: Sequence,
    comments: Iterable[str],
    robot: Robot,
    trajectory: Trajectory | None = None,
) -> int:
    """Write the sequence of an import; print what was made of it, and its plan."""
    from lss_motion.planning.summaries import plan_lines
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.write import write_sequence

    comments = list(comments)
    write_sequence(sequence, arguments.output, comments=comments)
    say(f"{arguments.output}: {counted(sequence.keyframes, 'keyframe')} from {arguments.file}")
    say("\n".join(comments))
    say("\n".join(plan_lines(trajectory or plan(sequence, robot), robot)))
    return EXIT_FINISHED


def _export(arguments: argparse.Namespace) -> int:
    from lss_motion.interchange.export import PlanSamples, exported
    from lss_motion.planning import shows
    from lss_motion.planning.program.arduino import header_name
    from lss_motion.planning.program.text import to_text

    read_robot = reader(arguments, may_query=False)
    output: Path = arguments.output
    format_name = arguments.to or SUFFIXES.get(output.suffix.lower())
    if format_name is None:
        known = ", ".join(FORMATS_OUT)
        raise InputError(f"has a suffix without a format; add --to: {known}", path=output)
    outputs = [Output(output, KINDS[format_name])]
    if format_name == SKETCH:
        outputs.append(Output(output.with_name(header_name(output)), OutputKind.ARDUINO))
    given = [arguments.file, arguments.robot, arguments.robot_cache]
    if format_name == SKETCH and output.parent.name == output.stem and output.parents[1].is_dir():
        output.parent.mkdir(exist_ok=True)  # The Arduino tools require a folder of this name.
    require_outputs(outputs, sources=given, is_forced=arguments.force)
    if format_name == PROGRAM:
        shows.require_program_suffix(output)
        show = shows.prepare(arguments.file, arguments.robot, read_robot=read_robot)
        write_output(output, to_text(show.program, folder=output.absolute().parent))
        say(f"{output}: {counted(show.program.moves, 'command')}")
        return EXIT_FINISHED
    if format_name == SKETCH:
        show = shows.prepare(arguments.file, arguments.robot, read_robot=read_robot)
        _write_sketch(show, output)
        return EXIT_FINISHED
    if format_name == MCAP:
        _write_mcap(arguments.file, arguments.robot, output, read_robot)
        return EXIT_FINISHED
    sequence, robot = shows.load(arguments.file, arguments.robot, read_robot)
    sources = [*given, *shows.files_of(sequence)]
    require_outputs(outputs, sources=sources, is_forced=arguments.force)
    trajectory = shows.planned(sequence, robot)
    shows.require_rows(trajectory, arguments.rate_hz)
    samples = PlanSamples.of(trajectory, shows.shown_s(trajectory), arguments.rate_hz)
    write_output(output, exported(samples, format_name))
    say(f"{output}: {counted(samples.times_s, 'sample')} of {counted(samples.joints, 'joint')}")
    return EXIT_FINISHED


def _write_mcap(
    log: Path, robot_path: Path | None, output: Path, read_robot: Callable[[Path], Robot]
) -> None:
    """Write a log as MCAP; the log names the robot if `robot_path` does not."""
    from lss_motion.playing.log import read_log
    from lss_motion.playing.log_mcap import mcap_of_log
    from lss_motion.playing.replay import logged_robot

    read = read_log(log)
    robot = logged_robot(read, read_robot) if robot_path is None else read_robot(robot_path)
    write_output(output, mcap_of_log(read.lines, robot))
    say(f"{output}: {counted(read.lines, 'line')} of {log}")


def _write_sketch(show: Show, output: Path) -> None:
    """Write the sketch and its header."""
    from lss_motion.planning.program.arduino import header_name, sketch
    from lss_motion.playing.player.handshake import session_commands

    servos = show.robot.servo_robot.joints
    joints = [servos[name] for name in show.program.start_deg]
    made = sketch(show.program, show.robot, session_commands(joints), output)
    header = output.with_name(header_name(output))
    write_output(header, made.header)
    write_output(output, made.sketch)
    say(f"{output}, {header.name}: {counted(show.program.moves, 'command')}")
    for text in (*(f"Not carried over: {text}" for text in made.left_out), *made.notes):
        say(text)
    if output.absolute().parent.name != output.stem:
        say(f"the Arduino IDE opens it in a folder named {output.stem}")


LABEL_OPTIONS: Final = ("labels", "pose", "anchors", "fps")

SOUND_OPTIONS: Final = (
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
    if arguments.joint is None and (names := _typed(arguments, SOUND_OPTIONS)):
        raise InputError(f"{names}: only for a sound; add --joint, which follows it")
    if arguments.joint is not None and (names := _typed(arguments, NOT_FOR_SOUND)):
        raise InputError(f"{names}: not for a sound; leave it out, or leave out --joint")


def import_sound(arguments: argparse.Namespace, robot: Robot) -> int:
    """Write the sequence of the joint that follows the sound; print what was made of it."""
    from lss_motion.interchange.voice import shortfall, voice_comments, voice_sequence
    from lss_motion.planning.summaries import late_marks
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.parts import keeping

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
    return _write(arguments, sequence, comments, robot, trajectory)


def import_labels(arguments: argparse.Namespace, track: LabelTrack, robot: Robot) -> int:
    """Write the sequence of a track of labels; print what was made of it."""
    from lss_motion.interchange.labels import LabelStyle, LabelUse, label_sequence
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.parts import keeping

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
    return _write(arguments, sequence, comments, robot, trajectory)


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


def _part(arguments: argparse.Namespace) -> SoundPart:
    from lss_motion.sound.files import SoundPart

    from_s, to_s = arguments.span or (0.0, None)
    path: Path = arguments.file
    return SoundPart(path=path, channel=arguments.channel or "mix", from_s=from_s, to_s=to_s)


def _style(arguments: argparse.Namespace) -> VoiceStyle:
    from lss_motion.interchange.voice import VoiceFollow, VoiceStyle
    from lss_motion.sound.envelope import MouthStyle

    names = ("threshold_db", "attack_s", "release_s", "gain_db", "opening_min")
    given = {name: getattr(arguments, name) for name in names}
    if arguments.band_hz:
        given["band_hz"] = tuple(arguments.band_hz)
    mouth = MouthStyle(**{name: value for name, value in given.items() if value is not None})
    return VoiceStyle(
        follow=VoiceFollow(arguments.follow or "syllables"),
        mouth=mouth,
        near_deg=arguments.closed_deg,
        far_deg=arguments.open_deg,
        speed_max_deg_s=arguments.speed_max_deg_s,
        is_fitted=not arguments.full,
        is_sounding=not arguments.no_sound,
    )
