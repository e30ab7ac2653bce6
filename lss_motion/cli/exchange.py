"""The commands `import` and `export`: motion of other tools, and motion for them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import TOLERANCE_MAX_DEG, add_command, reader
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options, number_from
from lss_motion.cli.voices import (
    LABEL_TEXT,
    SOUND_TEXT,
    add_label_options,
    add_sound_options,
    import_labels,
    import_sound,
    require_no_labels,
    require_options,
)
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Kind, Output, require_outputs, write_output
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable

    from lss_motion.cli.commands import Commands
    from lss_motion.planning.shows import Show
    from lss_motion.robot.model import Robot


FORMATS_IN: Final = (
    "rhubarb, papagayo, praat, xlights, audacity, "
    "bitbots, hulks, pypot, blender, bottango, webots, bvh, mtn, maestro, ssc32-csv, pypose, ros, "
    "csv, commands, d6a, lerobot, opencat, poses, robotis-bin"
)
"""The names of `interchange.FORMAT_NAMES`, which loads too slowly for a help text; a test
compares them."""

PROGRAM: Final = "lss"

SKETCH: Final = "arduino"

MCAP: Final = "mcap"

FORMATS_OUT: Final = ("csv", "ros", "blender-csv", "blender-json", PROGRAM, SKETCH, MCAP)
"""The names of `interchange.EXPORT_NAMES`; the compiled program, as text and as a sketch; a log."""

KINDS: Final = {
    "csv": Kind.TABLE,
    "ros": Kind.ROS,
    "blender-csv": Kind.TABLE,
    "blender-json": Kind.BLENDER,
    PROGRAM: Kind.PROGRAM,
    SKETCH: Kind.ARDUINO,
    MCAP: Kind.MCAP,
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
    from lss_motion.planning.summaries import fit_text, plan_lines
    from lss_motion.planning.trajectory.planner import plan
    from lss_motion.show.model import Interpolation
    from lss_motion.show.write import write_sequence
    from lss_motion.sound.files import is_sound

    require_outputs(
        [Output(arguments.make_map or arguments.output, Kind.YAML)],
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
    write_sequence(made.sequence, arguments.output, comments=[*made.comments, *fit])
    keyframes = counted(made.sequence.keyframes, "keyframe")
    say(f"{arguments.output}: {keyframes} from {arguments.file}")
    say("\n".join([*made.comments, *fit]))
    say("\n".join(plan_lines(plan(made.sequence, robot), robot)))
    return EXIT_FINISHED


def _export(arguments: argparse.Namespace) -> int:
    from lss_motion.interchange.export import Samples, exported
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
        outputs.append(Output(output.with_name(header_name(output)), Kind.ARDUINO))
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
    samples = Samples.of(trajectory, shows.shown_s(trajectory), arguments.rate_hz)
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

    joints = [show.robot.joints[name] for name in show.program.start_deg]
    made = sketch(show.program, show.robot, session_commands(joints), output)
    header = output.with_name(header_name(output))
    write_output(header, made.header)
    write_output(output, made.sketch)
    say(f"{output}, {header.name}: {counted(show.program.moves, 'command')}")
    for text in (*(f"Not carried over: {text}" for text in made.left_out), *made.notes):
        say(text)
    if output.absolute().parent.name != output.stem:
        say(f"the Arduino IDE opens it in a folder named {output.stem}")
