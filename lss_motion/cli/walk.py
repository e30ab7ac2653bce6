"""`lss-motion walk GAIT`: a walk that is steered with keys or a gamepad while it goes.

`lss-motion gait`: what a gait file comes to, before a robot is involved.
"""

from __future__ import annotations

import argparse
import contextlib
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import (
    add_cache_option,
    add_command,
    add_force,
    reader,
    refuse_overwriting,
)
from lss_motion.cli.messages import Printer, ended_by, nothing
from lss_motion.cli.play import YES_HELP, Agreement, must_ask
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError, PlanningError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.terminal import Terminal
    from lss_motion.gait.model import Gait
    from lss_motion.gait.stepping import Twist
    from lss_motion.perform import Result
    from lss_motion.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.walking.inputs import Gamepad, OperatorInput
    from lss_motion.walking.pilot import Pilot
    from lss_motion.walking.process import PlannerProcess


TOP_STRIDE_MM: Final = 40.0
TOP_TURN_DEG: Final = 12.0
"""The most in one cycle, where neither the file nor an option says it; halved while it is out of
reach, at most `HALVINGS_MAX` times. Chosen: half of what the example robots reach."""
HALVINGS_MAX: Final = 4

KEYS_HELP: Final = (
    "arrows or w s forward, back; arrows turn; a d sideways; + - speed; space stop; x sit, stand; "
    "q end"
)

DESCRIPTION = """\
Walk, steered with the keys or a gamepad while it goes. A new velocity is taken up when the next
legs lift, and blended in over one cycle. The robot always knows its way to a stable stand: it goes
there when it is let go, on Ctrl-C, and when planning is late. A second Ctrl-C stops at once.
"""


def add_to(commands: Commands) -> None:
    """Add the commands of this module."""
    _add_gait_to(commands)
    text = "walk, steered live with keys or a gamepad"
    walk = add_command(commands, "walk", _walk, text, f"{DESCRIPTION}\nKeys: {KEYS_HELP}.")
    walk.add_argument("file", type=Path, metavar="GAIT", help="a gait file")
    walk.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
    add_cache_option(walk)
    walk.add_argument("--port", metavar="URL", help="serial device or URL; sim:// is simulated")
    for name, unit in (("forward", "mm-s"), ("left", "mm-s"), ("turn", "deg-s")):
        walk.add_argument(
            f"--{name}-{unit}",
            type=_speed,
            metavar="SPEED",
            help=f"the most {name}; default: the most in the file",
        )
    walk.add_argument(
        "--gamepad", type=Path, metavar="DEVICE", help="steer with it, such as /dev/input/js0"
    )
    walk.add_argument("--no-feedback", action="store_true", help="no questions, no correction")
    walk.add_argument("--seed", type=int, default=0, metavar="N", help="of the simulated bus")
    walk.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    walk.add_argument("--quiet", action="store_true", help="no display; errors only")
    walk.add_argument("--yes", action="store_true", help=YES_HELP)


def _walk(arguments: argparse.Namespace) -> int:
    from lss_motion import api
    from lss_motion.cli import shows
    from lss_motion.cli.report import report_lines
    from lss_motion.cli.terminal import Terminal
    from lss_motion.connection import with_port
    from lss_motion.gait.model import BodyPose
    from lss_motion.runtime.report import write_report
    from lss_motion.walking.inputs import OperatorInput

    if arguments.report is not None and not arguments.report.absolute().parent.is_dir():
        raise InputError("cannot be written: there is no such folder", path=arguments.report)
    gait, robot = shows.load_gait(arguments.file, arguments.robot, reader(arguments, may_ask=True))
    gait, top = fastest(replace(gait, start=BodyPose()), robot, arguments)
    robot = with_port(robot, arguments.port)
    is_asked = must_ask(arguments, robot)
    with contextlib.ExitStack() as stack:
        printer = Printer()
        stack.callback(printer.finish)
        say: Callable[[str], None] = nothing if arguments.quiet else printer.say
        if api.is_simulated(robot):
            say(f"{gait.name}: no hardware, the robot {robot.name!r} is simulated in real time")
        say(f"at most {speed_text(top)}, one cycle {gait.cycle_s:.2f} s")
        wishes = OperatorInput(top)
        terminal = stack.enter_context(Terminal(wishes.press))
        steered = (wishes, terminal)
        result, pilot = _perform(arguments, gait, robot, steered, say, is_asked=is_asked)
        if arguments.report is not None:
            write_report(result.report, arguments.report)
        for failed in (result.error, pilot.lost):
            if failed is not None:
                raise failed
        say(f"{pilot.taken} stretches walked, {pilot.late} planned too late")
        for line in report_lines(result.report.to_dict()):
            say(line)
        match result.report.outcome:
            case "stopped":
                return ended_by(terminal.signal_number)
            case "fault":
                return EXIT_NOT_FOLLOWED
            case _:
                return EXIT_FINISHED


def fastest(gait: Gait, robot: Robot, arguments: argparse.Namespace) -> tuple[Gait, Twist]:
    """Return the gait with a cycle that the servos can do, and the most that it is steered to.

    Raises `InputError` or `PlanningError` for an option or a walk of the file beyond the reach.
    """
    from lss_motion.gait.model import Walk
    from lss_motion.gait.steering import slowed_to_limits
    from lss_motion.gait.stepping import STILL

    wanted, guessed = STILL, {}
    for name, guess in (
        ("forward_mm_s", TOP_STRIDE_MM / gait.cycle_s),
        ("left_mm_s", TOP_STRIDE_MM / gait.cycle_s),
        ("turn_deg_s", TOP_TURN_DEG / gait.cycle_s),
    ):
        asked = getattr(arguments, name)
        said = [abs(getattr(own, name)) for own in gait.actions if isinstance(own, Walk)]
        if asked is None and max(said, default=0.0) == 0.0:
            guessed[name] = guess
        else:
            wanted = replace(wanted, **{name: asked or max(said)})
    for name, guess in guessed.items():
        for halvings in range(HALVINGS_MAX):
            with contextlib.suppress(InputError, PlanningError):
                slowed_to_limits(gait, robot, replace(STILL, **{name: guess / 2**halvings}))
                wanted = replace(wanted, **{name: guess / 2**halvings})
                break
    return slowed_to_limits(gait, robot, wanted)


class Reins:
    """Keys, gamepad and signals of one walk, between two commands."""

    def __init__(
        self,
        pilot: Pilot,
        wishes: OperatorInput,
        link: PlannerProcess,
        terminal: Terminal,
        say: Callable[[str], None],
    ) -> None:
        self.gamepad: Gamepad | None = None
        self.sits: tuple[Any, Any] | None = None
        """The poses in which it stands and sits, if it can sit."""
        self._pilot = pilot
        self._wishes = wishes
        self._link = link
        self._terminal = terminal
        self._say = say
        self._is_sitting = False
        self._said: object = None

    def filenos(self) -> Sequence[int]:
        gamepad = [] if self.gamepad is None else self.gamepad.filenos()
        return [self._link.fileno(), *self._terminal.filenos(), *gamepad]

    def act(self, driven: Player, now_ns: int) -> None:
        """Apply what was asked for since the last call."""
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
        self._tell()

    def _tell(self) -> None:
        pilot = self._pilot
        now = (pilot.twist, pilot.reason, pilot.late)
        if now != self._said:
            late = f", {pilot.late} planned too late" if pilot.late else ""
            reason = f" ({pilot.reason})" if pilot.reason else ""
            self._say(f"walks {speed_text(pilot.twist)}{late}{reason}")
        self._said = now


def _perform(
    arguments: argparse.Namespace,
    gait: Gait,
    robot: Robot,
    steered: tuple[OperatorInput, Terminal],
    say: Callable[[str], None],
    *,
    is_asked: bool,
) -> tuple[Result, Pilot]:
    import sys

    from lss_motion.cli.display import Display
    from lss_motion.cli.play import tell
    from lss_motion.cli.shows import GAIT_TOLERANCE_DEG
    from lss_motion.gait.model import BodyPose
    from lss_motion.perform import Observer, perform
    from lss_motion.walking.inputs import Gamepad
    from lss_motion.walking.pilot import Pilot
    from lss_motion.walking.planner import WalkPlanner
    from lss_motion.walking.process import PlannerProcess

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
            display = Display(KEYS_HELP, say=say)
            stack.callback(display.close)
        note = say if display is None else display.note
        reins = Reins(pilot, wishes, link, terminal, note)
        if gait.sit is not None:
            reins.sits = (BodyPose(), gait.sit)
        if arguments.gamepad is not None:
            reins.gamepad = stack.enter_context(Gamepad(arguments.gamepad))
        result = perform(
            planner.program,
            robot,
            seed=arguments.seed,
            has_feedback=not arguments.no_feedback,
            observer=Observer(
                on_event=lambda event: tell(event, note),
                on_turn=None if display is None else display.show,
                controls=Agreement(reins, terminal, robot.name),
            ),
            is_open=True,
            must_ask=is_asked,
        )
        return result, pilot


def speed_text(twist: Twist) -> str:
    """Return a velocity as a person reads it."""
    return (
        f"{twist.forward_mm_s:.0f} mm/s forward, {twist.left_mm_s:.0f} mm/s left, "
        f"{twist.turn_deg_s:.0f} deg/s"
    )


def _speed(text: str) -> float:
    value = float(text)
    if not (math.isfinite(value) and 0.0 < value <= 10_000.0):
        raise argparse.ArgumentTypeError(f"{text} is not a speed above 0")
    return value


def _add_gait_to(commands: Commands) -> None:
    gait = add_command(
        commands, "gait", _gait, "say how a gait walks; write it as keyframes or a picture"
    )
    gait.add_argument("file", type=Path, metavar="FILE", help="a gait file")
    gait.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
    add_cache_option(gait)
    gait.add_argument(
        "-o", "--output", type=Path, metavar="S.yaml", help="write the keyframes as a sequence"
    )
    add_force(gait)
    gait.add_argument("--plot", type=Path, metavar="F.png", help="draw it; the suffix says how")


def _gait(arguments: argparse.Namespace) -> int:
    from lss_motion.cli import shows
    from lss_motion.gait.pacing import gait_lines, paced
    from lss_motion.gait.to_sequence import sequence_from
    from lss_motion.sequence.write import write_sequence
    from lss_motion.trajectory.planner import plan

    refuse_overwriting(arguments.output, is_forced=arguments.force)
    gait, robot = shows.load_gait(arguments.file, arguments.robot, reader(arguments, may_ask=False))
    passages = paced(gait, robot)
    sequence = sequence_from(gait, passages)
    plan(sequence, robot)  # Its own judge has to agree before anything is written.
    if arguments.output is not None:
        write_sequence(sequence, arguments.output, comments=[f"What {arguments.file} comes to."])
    if arguments.plot is not None:
        from lss_motion.gait.plot import plot_gait

        plot_gait(gait, passages, arguments.plot)
    print("\n".join(gait_lines(gait, passages)))
    return EXIT_FINISHED
