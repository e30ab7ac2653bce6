"""The command `import-urdf`: a robot that others described, as a robot file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

from lss_motion.cli.commands import add_command
from lss_motion.cli.messages import say
from lss_motion.cli.options import add_options
from lss_motion.errors import EXIT_FINISHED, InputError
from lss_motion.files.output import Output, OutputKind, require_outputs, write_output
from lss_motion.files.texts import counted, known_names

if TYPE_CHECKING:
    import argparse

    from lss_motion.cli.commands import Commands

DEFAULT_MODEL: Final = "LSS-ST1"
IMPORT_URDF_TEXT: Final = """\
Make a robot file of a URDF or xacro file: joints, limits, the figure, and a gait where it has legs.

  lss-motion import-urdf arm.urdf -o my_arm.yaml
  lss-motion import-urdf hexapod.urdf.xacro --model LSS-HT1 -o my_hexapod.yaml --allow-run

What the file does not say, and what no servo can do, gets a value that is stated: each is a line
here and a comment in the robot file. Where masses, inertias or efforts were mended, or the file is
xacro or lies in another folder, a URDF file is written beside the robot file, with the same name.
Four or six legs become a gait file beside it, such as my_hexapod_gait.yaml. A xacro file is a
program: it is expanded only with --allow-run, and needs the extra `urdf`.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    added = add_command(commands, "import-urdf", _import_urdf, IMPORT_URDF_TEXT)
    added.add_argument("file", type=Path, metavar="FILE", help="a URDF or xacro file")
    added.add_argument(
        "--model",
        default=DEFAULT_MODEL,
        metavar="MODEL",
        help=f"the model of its servos (default {DEFAULT_MODEL})",
    )
    add_options(added, "--output", required=True, metavar="R.yaml", help="the robot file to write")
    added.add_argument(
        "--allow-run", action="store_true", help="expand a xacro file, which Python evaluates"
    )
    add_options(added, "--force")


def _import_urdf(arguments: argparse.Namespace) -> int:
    from lss_motion.interchange.urdf_robot import imported_robot
    from lss_motion.robot.load import load_robot
    from lss_motion.robot.servo_models import SERVO_MODELS
    from lss_motion.robot.urdf import urdf_figure

    output: Path = arguments.output
    if arguments.model not in SERVO_MODELS:
        raise InputError(f"--model: {known_names(arguments.model, SERVO_MODELS)}")
    urdf, gait = output.with_suffix(".urdf"), output.with_name(f"{output.stem}_gait.yaml")
    given = [arguments.file]
    require_outputs([Output(output, OutputKind.YAML)], sources=given, is_forced=arguments.force)
    made = imported_robot(
        arguments.file, output, model=arguments.model, may_run=arguments.allow_run
    )
    others = [
        Output(urdf if made.urdf is not None else None, OutputKind.YAML),
        Output(gait if made.gait is not None else None, OutputKind.YAML),
    ]
    require_outputs(others, sources=given, is_forced=arguments.force)
    if made.urdf is not None:
        write_output(urdf, made.urdf)
    write_output(output, made.robot)
    if made.gait is not None:
        write_output(gait, made.gait)
    robot = load_robot(output)
    say(f"{output}: {counted(robot.joints, 'joint')} from {arguments.file}")
    if made.urdf is not None:
        say(f"{urdf}: the figure, which the robot file names")
    if made.gait is not None:
        say(f"{gait}: a gait to begin with; see it with lss-motion gait {gait}")
    for note in made.notes:
        say(f"  {note}")
    if robot.urdf is not None:
        for note in urdf_figure(robot.urdf, robot.joints).notes:
            say(f"  {note}")
    say(f"next: write port and ids into {output}, then lss-motion check {output}")
    return EXIT_FINISHED
