"""`lss-motion import | export`: motion of other tools, and for them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import (
    add_cache_option,
    add_command,
    add_force,
    reader,
    refuse_overwriting,
)
from lss_motion.errors import EXIT_FINISHED, InputError

if TYPE_CHECKING:
    from lss_motion.cli.commands import Commands
    from lss_motion.interchange.export import Samples
    from lss_motion.interchange.reduce import KeyFit
    from lss_motion.trajectory.model import Trajectory

FORMATS_IN: Final = (
    "bitbots, hulks, pypot, blender, bottango, webots, mtn, maestro, ssc32-csv, pypose, ros, csv, "
    "commands, robotis-bin"
)
"""As `interchange.FORMAT_NAMES`, too slow to import for a help text; a test compares."""

PROGRAM: Final = "lss"
FORMATS_OUT: Final = ("csv", "ros", "blender-csv", "blender-json", PROGRAM)
"""As `interchange.EXPORT_NAMES`, and our own compiled program."""

SUFFIXES: Final = {
    ".csv": "csv",
    ".yaml": "ros",
    ".yml": "ros",
    ".json": "blender-json",
    ".lss": PROGRAM,
}

TOLERANCE_MAX_DEG: Final = 90.0
"""Beyond this nothing is left of a motion."""

IMPORT_TEXT: Final = f"""\
Turn another tool's motion into a sequence file that a person can read and edit.

Formats: {FORMATS_IN}.
The content decides which it is. Dense recordings are reduced to the fewest keys that stay within
the tolerance. A map file says what joints are called and what their values mean on this robot;
--make-map writes one to begin with.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    imported = add_command(
        commands, "import", _import, "turn another tool's motion into a sequence file", IMPORT_TEXT
    )
    imported.add_argument("file", type=Path, metavar="FILE")
    imported.add_argument(
        "--from",
        dest="format_name",
        metavar="FORMAT",
        help="one of the formats above; default: recognised by content",
    )
    imported.add_argument("--robot", type=Path, required=True, metavar="FILE")
    add_cache_option(imported)
    imported.add_argument(
        "--motion", metavar="NAME", help="which one, where the file holds several"
    )
    imported.add_argument("--map", type=Path, metavar="M.yaml", help="what the joints are here")
    imported.add_argument(
        "--tolerance-deg",
        type=tolerance,
        default=1.0,
        metavar="DEG",
        help="how far keys may lead away from a recording (default 1; 0: every sample is a key, "
        "within 0.02 deg)",
    )
    imported.add_argument(
        "--interpolation",
        choices=("spline", "smooth", "linear"),
        default="spline",
        help="between the keys of a recording: spline (default) asks for the least acceleration, "
        "smooth never goes beyond a key, linear stops at every key",
    )
    target = imported.add_mutually_exclusive_group(required=True)
    target.add_argument("-o", "--output", type=Path, metavar="S.yaml")
    target.add_argument(
        "--make-map", type=Path, metavar="M.yaml", help="write a map file to begin with, no more"
    )
    add_force(imported)
    exported = add_command(
        commands, "export", _export, "write the motion of a sequence for other tools"
    )
    exported.add_argument("file", type=Path, metavar="FILE", help="a sequence")
    exported.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
    add_cache_option(exported)
    exported.add_argument(
        "--to",
        choices=FORMATS_OUT,
        help="default: csv, ros (.yaml), blender-json or lss by the suffix of the output",
    )
    exported.add_argument(
        "--rate-hz", type=_rate, default=100.0, metavar="N", help="samples a second (default 100)"
    )
    exported.add_argument("-o", "--output", type=Path, required=True, metavar="F")


def _import(arguments: argparse.Namespace) -> int:
    from lss_motion.cli.planning import plan_lines
    from lss_motion.cli.tables import write_text
    from lss_motion.interchange.importing import imported, read_motion
    from lss_motion.interchange.mapping import load_map, map_template
    from lss_motion.sequence.model import Interpolation
    from lss_motion.sequence.write import write_sequence
    from lss_motion.trajectory.planner import plan

    refuse_overwriting(arguments.make_map or arguments.output, is_forced=arguments.force)
    robot = reader(arguments, may_ask=False)(arguments.robot)
    motion = read_motion(
        arguments.file, format_name=arguments.format_name, motion_name=arguments.motion
    )
    if arguments.make_map is not None:
        write_text(arguments.make_map, map_template(motion, robot))
        print(f"{arguments.make_map}: {len(motion.channels)} joints; edit it, then use --map")
        return EXIT_FINISHED
    made = imported(
        motion,
        robot,
        motion_map=None if arguments.map is None else load_map(arguments.map),
        tolerance_deg=arguments.tolerance_deg,
        ease=Interpolation(arguments.interpolation),
    )
    fit = [] if made.fit is None else [fit_text(made.fit)]
    write_sequence(made.sequence, arguments.output, comments=[*made.comments, *fit])
    print(f"{arguments.output}: {len(made.sequence.keyframes)} keyframes from {arguments.file}")
    print("\n".join([*made.comments, *fit]))
    print("\n".join(plan_lines(plan(made.sequence, robot), robot)))
    return EXIT_FINISHED


def fit_text(fit: KeyFit) -> str:
    """Return how a recording was reduced, in words."""
    return (
        f"Reduced from {fit.samples_count:,} samples to {fit.keys_count:,} keys in "
        f"{fit.keyframes_count:,} keyframes: at most {fit.error_max_deg:.2f} deg off (joint "
        f"{fit.joint} at {fit.at_s:.2f} s), {fit.error_rms_deg:.2f} deg RMS."
    )


def _export(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.cli.tables import write_text
    from lss_motion.interchange.export import exported
    from lss_motion.program.text import to_text

    read_robot = reader(arguments, may_ask=False)
    output: Path = arguments.output
    format_name = arguments.to or SUFFIXES.get(output.suffix.lower())
    if format_name is None:
        known = ", ".join(FORMATS_OUT)
        raise InputError(f"its suffix says no format; add --to: {known}", path=output)
    if format_name == PROGRAM:
        if not shows.is_program(output):
            raise InputError("must end in .lss, or lss-play takes it for a sequence", path=output)
        show = shows.prepare(arguments.file, arguments.robot, read_robot=read_robot)
        write_text(output, to_text(show.program, folder=shows.in_folder(output)))
        print(f"{output}: {len(show.program.moves)} commands")
        return EXIT_FINISHED
    sequence, robot = shows.load(arguments.file, arguments.robot, read_robot)
    samples = sampled(shows.planned(sequence, robot), arguments.rate_hz)
    write_text(output, exported(samples, format_name))
    print(f"{output}: {len(samples.times_s)} samples of {len(samples.joints)} joints")
    return EXIT_FINISHED


def sampled(trajectory: Trajectory, rate_hz: float) -> Samples:
    """Return the plan read off every `1 / rate_hz`, to its end or just beyond it.

    A show without end gives its first pass and one more.
    """
    import numpy as np

    from lss_motion.interchange.export import Samples

    end_s = trajectory.duration_s
    if trajectory.loop is None:
        end_s = trajectory.first.duration_s + trajectory.middle.duration_s
    times_s = np.arange(int(np.ceil(end_s * rate_hz - 1e-9)) + 1) / rate_hz
    return Samples(
        name=trajectory.name,
        joints=trajectory.joints,
        rate_hz=rate_hz,
        times_s=times_s,
        angles_deg=trajectory.sample(times_s),
        speeds_deg_s=trajectory.sample(times_s, 1),
    )


def tolerance(text: str) -> float:
    value = float(text)
    if not 0.0 <= value <= TOLERANCE_MAX_DEG:
        raise argparse.ArgumentTypeError(f"{text} is not in 0 to {TOLERANCE_MAX_DEG:g} degrees")
    return value


def _rate(text: str) -> float:
    value = float(text)
    if not 0.1 <= value <= 1000.0:
        raise argparse.ArgumentTypeError(f"{text} is not in 0.1 to 1000")
    return value
