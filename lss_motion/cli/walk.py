"""The command `walk`: a gait that is steered with keys or a gamepad while it runs."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.cli.careful import Learning, careful_run, run_carefully
from lss_motion.cli.commands import add_command, reader
from lss_motion.cli.dialog import Confirmation, must_ask, print_event, simulated_text
from lss_motion.cli.messages import Printer, discard, ended_by, failures, put
from lss_motion.cli.options import OPTIONS, UNLIMITED_HELP, add_options, number_from
from lss_motion.errors import (
    EXIT_FINISHED,
    EXIT_INPUT,
    EXIT_NOT_FOLLOWED,
)
from lss_motion.files.output import OTHER_NAME_REMEDY, Output, OutputKind, require_outputs
from lss_motion.files.texts import counted

if TYPE_CHECKING:
    import argparse
    from collections.abc import Callable, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.terminal import Terminal
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.report import Report
    from lss_motion.playing.run import Result
    from lss_motion.playing.walking.inputs import Gamepad, OperatorInput
    from lss_motion.playing.walking.pilot import Pilot
    from lss_motion.playing.walking.planner import PlannerProcess
    from lss_motion.robot.model import Robot
    from lss_motion.show.gait.model import Gait
    from lss_motion.show.gait.stepping import Twist


KEYS_HELP: Final = (
    "arrows or w s forward, back; arrows turn; a d sideways; + - speed; space stop; x sit, stand; "
    "q end"
)

DESCRIPTION: Final = f"""\
Walk a gait and steer it with keys or a gamepad.

  lss-motion walk hexapod_walk.yaml
  lss-motion walk hexapod_walk.yaml --gamepad /dev/input/js0

A new velocity begins when the next legs lift, and is blended in over one cycle. The robot can
always reach a stable stand. It goes there when you release the keys or the stick, on Ctrl-C, and
when planning is late. A second Ctrl-C stops at once.

Keys: {KEYS_HELP}.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    walk = add_command(commands, "walk", _walk, DESCRIPTION)
    walk.add_argument("file", type=Path, metavar="GAIT", help="a gait file")
    add_options(walk, "--robot", "--robot-cache", "--port")
    for name, unit, help_text in (
        ("forward", "mm-s", "largest speed forward and back"),
        ("left", "mm-s", "largest speed sideways"),
        ("turn", "deg-s", "largest speed of turning"),
    ):
        walk.add_argument(
            f"--{name}-{unit}",
            type=number_from(0.0, 10_000.0, unit.replace("-", "/"), is_above=True),
            metavar="SPEED",
            help=f"{help_text} (default: the largest in the file)",
        )
    walk.add_argument(
        "--gamepad", type=Path, metavar="DEVICE", help="steer with it, such as /dev/input/js0"
    )
    add_options(walk, "--no-feedback")
    add_options(walk, "--force", help=UNLIMITED_HELP)
    add_options(walk, "--seed", "--report", "--quiet", "--verbose", "--yes")
    add_options(
        walk, "--careful", help=OPTIONS["--careful"]["help"].replace("then play", "then walk")
    )
    walk.set_defaults(virtual=False)  # A person steers it.


def _walk(arguments: argparse.Namespace) -> int:
    from lss_motion.planning import shows
    from lss_motion.playing import api
    from lss_motion.playing.connection import with_port
    from lss_motion.playing.walking.steered import fastest
    from lss_motion.show.gait.model import BodyPose

    outputs = [Output(arguments.report, OutputKind.REPORT)]
    sources = [arguments.file, arguments.robot, arguments.robot_cache]
    require_outputs(outputs, sources=sources, remedy=OTHER_NAME_REMEDY)
    read_robot = reader(arguments, may_query=True)
    gait, robot = shows.load_gait(arguments.file, arguments.robot, read_robot)
    gait, top = fastest(replace(gait, start=BodyPose()), robot, vars(arguments))
    robot = with_port(robot, arguments.port)
    joints = [name for leg in gait.legs for name in leg.joints]
    learning = Learning(robot, joints, is_kept=not api.is_simulated(robot))
    print_line = discard if arguments.quiet else put
    return run_carefully(
        arguments,
        lambda rate: _walked(arguments, gait, robot, top, learning, speed_ratio=rate),
        lambda: careful_run(arguments, robot, joints, learning, print_line, what="walk begins"),
    )


def _walked(
    arguments: argparse.Namespace,
    gait: Gait,
    robot: Robot,
    top: Twist,
    learning: Learning,
    *,
    speed_ratio: float | None = None,
) -> int | None:
    """Walk, at first at `speed_ratio` of the largest speed; return the exit code.

    None: a person wants a careful run first, which is offered where no `speed_ratio` is given.
    """
    from lss_motion.cli.report import report_lines
    from lss_motion.cli.terminal import Terminal
    from lss_motion.playing import api
    from lss_motion.playing.report import write_report
    from lss_motion.playing.walking.inputs import OperatorInput

    is_asked = must_ask(arguments, robot)
    offer = learning.offer if is_asked and speed_ratio is None else ""
    with contextlib.ExitStack() as stack:
        printer = Printer()
        stack.callback(printer.finish)
        print_line = discard if arguments.quiet else printer.print
        if api.is_simulated(robot):
            print_line(simulated_text(gait.name, robot, " in real time"))
        print_line(f"at most {speed_text(top)}, one cycle {gait.cycle_s:.2f} s")
        wishes = OperatorInput(top, speed_ratio=speed_ratio or 1.0)
        terminal = stack.enter_context(Terminal(wishes.press))
        steered, asking = (wishes, terminal), (is_asked, offer)
        done = _perform(arguments, gait, robot, steered, print_line, asking)
        if done is None:
            return None
        result, pilot = done
        problems = []
        if result.report.outcome == "finished":
            learning.note_completed()
        if arguments.report is not None:
            problems = failures(write_report, result.report, arguments.report)
        for text in problems:
            put(f"lss-motion: {text}", sys.stderr)
        for failed in (result.error, pilot.lost):
            if failed is not None:
                raise failed
        print_line(f"{counted(pilot.taken, 'span')} walked, {pilot.late} planned too late")
        for line in report_lines(result.report.to_dict(), is_whole=arguments.verbose):
            print_line(line)
        return _exit_code(result, terminal) or (EXIT_INPUT if problems else EXIT_FINISHED)


def _exit_code(result: Result[Report], terminal: Terminal) -> int:
    match result.report.outcome:
        case "stopped":
            return ended_by(terminal.signal_number)
        case "fault":
            return EXIT_NOT_FOLLOWED
        case _:
            return EXIT_FINISHED


class WalkControls:
    """Keys, gamepad and signals of one walk."""

    def __init__(
        self,
        pilot: Pilot,
        wishes: OperatorInput,
        link: PlannerProcess,
        terminal: Terminal,
        print_line: Callable[[str], None],
    ) -> None:
        self.gamepad: Gamepad | None = None
        self.sits: tuple[Any, Any] | None = None
        """The body poses of standing and sitting, or None if the gait has no sitting pose."""
        self._pilot = pilot
        self._wishes = wishes
        self._link = link
        self._terminal = terminal
        self._print_line = print_line
        self._is_sitting = False
        self._printed: object = None

    def filenos(self) -> Sequence[int]:
        gamepad = [] if self.gamepad is None else self.gamepad.filenos()
        return [self._link.fileno(), *self._terminal.filenos(), *gamepad]

    def act(self, driven: Player, now_ns: int) -> None:
        """Apply the keys, the stick and the signals since the last call."""
        self._terminal.act(driven, now_ns)
        if self.gamepad is not None and (stick := self.gamepad.stick()) is not None:
            self._wishes.steer(*stick)
        wishes, pilot = self._wishes, self._pilot
        if self.sits is None:
            wishes.is_sitting = False
        elif wishes.is_sitting != self._is_sitting:
            self._is_sitting = wishes.is_sitting
            pilot.commanded_pose = self.sits[int(wishes.is_sitting)]
        pilot.commanded = wishes.twist()
        pilot.act(driven, now_ns)
        if wishes.has_ended and driven.show is not None:
            driven.close()
        self._print_change()

    def _print_change(self) -> None:
        pilot = self._pilot
        now = (pilot.twist, pilot.reason, pilot.late)
        if now != self._printed:
            late = f", {pilot.late} planned too late" if pilot.late else ""
            reason = f" ({pilot.reason})" if pilot.reason else ""
            self._print_line(f"walks {speed_text(pilot.twist)}{late}{reason}")
        self._printed = now


def _perform(
    arguments: argparse.Namespace,
    gait: Gait,
    robot: Robot,
    steered: tuple[OperatorInput, Terminal],
    print_line: Callable[[str], None],
    asking: tuple[bool, str],
) -> tuple[Result[Report], Pilot] | None:
    """Walk; `asking`: whether to ask before, and what to offer. None: that was taken."""
    from lss_motion.cli.display import Display
    from lss_motion.planning.shows import GAIT_TOLERANCE_DEG
    from lss_motion.playing.run import Observer, perform
    from lss_motion.playing.walking.inputs import Gamepad
    from lss_motion.playing.walking.pilot import Pilot
    from lss_motion.playing.walking.planner import PlannerProcess, WalkPlanner
    from lss_motion.show.gait.model import BodyPose

    planner = WalkPlanner(gait, robot, GAIT_TOLERANCE_DEG)
    wishes, terminal = steered
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(PlannerProcess(gait, robot, GAIT_TOLERANCE_DEG))
        pilot = Pilot(
            link,
            phase_s=planner.phase_s,
            splice_s=planner.splice_s,
            planning_s=link.planning_s,
        )
        display = None
        if not arguments.quiet and sys.stderr.isatty():
            display = Display(KEYS_HELP, print_line=print_line)
            stack.callback(display.close)
        note = print_line if display is None else display.note
        controls = WalkControls(pilot, wishes, link, terminal, note)
        if gait.sit is not None:
            controls.sits = (BodyPose(), gait.sit)
        if arguments.gamepad is not None:
            controls.gamepad = stack.enter_context(Gamepad(arguments.gamepad))
        is_asked, offer = asking
        confirmation = Confirmation(controls, terminal, robot.name, offer=offer)
        result = perform(
            planner.program,
            robot,
            seed=arguments.seed,
            has_feedback=not arguments.no_feedback,
            is_forced=arguments.force,
            observer=Observer(
                on_event=lambda event: print_event(event, note, is_verbose=arguments.verbose),
                on_turn=None if display is None else display.show,
                controls=confirmation,
            ),
            is_open=True,
            must_ask=is_asked,
        )
        return None if confirmation.is_careful else (result, pilot)


def speed_text(twist: Twist) -> str:
    """Return the text of a velocity."""
    return (
        f"{twist.forward_mm_s:z.0f} mm/s forward, {twist.left_mm_s:z.0f} mm/s left, "
        f"{twist.turn_deg_s:z.0f} deg/s"
    )
