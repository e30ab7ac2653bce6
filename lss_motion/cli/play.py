"""`lss-play FILE`: plan, compile and play a sequence or a compiled program.

What a person sees and is asked before a real robot moves.

`lss-motion play`: the same as `lss-play`.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from lss_motion.cli.commands import add_cache_option, add_command, add_version, reader
from lss_motion.cli.messages import Printer, ended_by, guarded, nothing, put
from lss_motion.cli.report import report_lines
from lss_motion.connection import is_simulated
from lss_motion.errors import EXIT_FINISHED, EXIT_NOT_FOLLOWED, InputError, LostPortError
from lss_motion.player.events import Phase
from lss_motion.protocol.constants import Led

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.shows import Show
    from lss_motion.cli.terminal import Inputs, Terminal
    from lss_motion.errors import LssMotionError
    from lss_motion.perform import Result
    from lss_motion.player.events import Event, Found
    from lss_motion.player.player import Player
    from lss_motion.robot.model import Robot
    from lss_motion.runtime.runner import Controls
    from lss_motion.sequence.model import Cue
    from lss_motion.sim.faults import Fault


YES_HELP: Final = "move a real robot without asking first; it is checked all the same"
YES_KEYS: Final = "yY"
NO_KEYS: Final = "nNqQ\r\n\x1b\x03\x04"
"""Enter alone is no, as the question says."""
LEFT: Final = (0, 2, 4)
"""The columns of words."""


def must_ask(arguments: argparse.Namespace, robot: Robot) -> bool:
    """Return whether a person is to be asked: before anything real moves, unless `--yes` is given.

    A pseudo-terminal counts as real: nobody knows what is behind it. Raises `InputError` where
    nobody could answer.
    """
    from lss_motion.cli.terminal import is_at_keyboard

    if arguments.yes or is_simulated(robot):
        return False
    if not is_at_keyboard():
        raise InputError(
            "a real robot would move, and nobody is there to be asked: nothing was sent. Run it in "
            "a terminal, or add --yes to go without being asked"
        )
    return True


def table_lines(servos: Sequence[Found]) -> list[str]:
    """Return what the servos said, one line each, as a person wants to see it."""
    head = ("joint", "servo", "model", "firmware", "status", "at", "to start", "V", "°C", "deg/s",
            "deg/s²")  # fmt: skip
    rows = [head, *map(_row, servos)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    return [
        "  ".join(
            text.ljust(width) if column in LEFT else text.rjust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


def _row(found: Found) -> tuple[str, ...]:
    return (
        found.joint,
        str(found.servo_id),
        found.model or "-",
        "-" if found.firmware is None else str(found.firmware),
        found.status or "-",
        f"{found.position_deg:.1f}",
        f"{found.start_deg - found.position_deg:+.1f}",
        _number(found.voltage_v, 1),
        _number(found.temperature_c, 0),
        _number(found.speed_max_deg_s, 0),
        _number(found.accel_max_deg_s2, 0),
    )


def _number(value: float | None, decimals: int) -> str:
    return "-" if value is None else f"{value:.{decimals}f}"


class Agreement:
    """Controls that ask `go? [y/N]` once the robot has been checked; the rest is for `inner`.

    `note` is told what was answered, with its instant.
    """

    def __init__(
        self,
        inner: Controls[Player],
        inputs: Inputs,
        robot_name: str,
        note: Callable[[str, int], None] | None = None,
    ) -> None:
        self._inner = inner
        self._inputs = inputs
        self._robot_name = robot_name
        self._note = note
        self._is_asking = False

    def filenos(self) -> Sequence[int]:
        return (self._inputs if self._is_asking else self._inner).filenos()

    def act(self, driven: Player, now_ns: int) -> None:
        """Ask, wait for the answer, and pass it on."""
        if driven.phase is not Phase.READY:
            self._is_asking = False
            self._inner.act(driven, now_ns)
            return
        if not self._is_asking:
            self._is_asking = True
            _ask(f"the robot {self._robot_name!r} will move: go? [y/N] ")
        signals_count, keys = self._inputs.take()
        answer = next((key for key in keys if key in YES_KEYS + NO_KEYS), "")
        if signals_count or not self._inputs.has_keys or (answer and answer in NO_KEYS):
            _ask("no: nothing was moved\n")
            if self._note is not None:
                self._note("stop", now_ns)
            driven.stop(now_ns)
        elif answer:
            _ask("yes\n")
            if self._note is not None:
                self._note("go", now_ns)
            driven.go()


def _ask(text: str) -> None:
    put(text, sys.stderr, end="")


DESCRIPTION = "Play a sequence (YAML) or a compiled program (.lss) on a robot."
EPILOG = """\
A real robot is checked, what was found is shown, and you are asked before anything moves.
While it plays: space pauses, - slows down, + goes up to full speed (the plan's own, no faster),
q or Ctrl-C stops and holds, as does a signal or a terminal that is closed; a second Ctrl-C stops
at once, and leaves the servos the settings of the show until their power is off. Exit codes:
0 played to the end, 2 your files or arguments, 3 no plan or the line cannot carry it, 4 port or
servos not reachable, 5 the robot did not follow, 130 interrupted, 128 and its number for any other
signal.
"""
WAITING: Final = {
    "begun": "        waiting for {}",
    "met": "        {}: going on",
    "timeout": "warning: no {} in time; going on",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-play`; return its exit code."""
    arguments = make_parser().parse_args(argv)
    return guarded("lss-play", lambda: play(arguments))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `lss-play`."""
    parser = argparse.ArgumentParser(
        prog="lss-play",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_version(parser)
    add_arguments(parser)
    return parser


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `lss-play`."""
    parser.add_argument("file", type=Path, metavar="FILE", help="sequence.yaml or program.lss")
    parser.add_argument("--port", metavar="URL", help="serial device or URL; sim:// is simulated")
    parser.add_argument("--robot", type=Path, metavar="FILE", help="use this robot file")
    add_cache_option(parser)
    parser.add_argument(
        "--speed", type=_ratio, default=1.0, metavar="RATIO", help="0.5 is half as fast"
    )
    parser.add_argument("--loop", type=_loop, metavar="N|forever", help="how often to play")
    parser.add_argument("--from", type=_seconds, dest="start_s", metavar="S", help="start there")
    parser.add_argument("--no-feedback", action="store_true", help="no questions, no correction")
    parser.add_argument("--dry-run", action="store_true", help="plan, compile, check; move nothing")
    parser.add_argument(
        "--virtual", action="store_true", help="simulated bus in virtual time; deterministic"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of the simulated bus")
    parser.add_argument(
        "--faults",
        type=Path,
        metavar="FILE",
        help="simulated bus only: what goes wrong; see `lss-motion sim --help`",
    )
    parser.add_argument("--report", type=Path, metavar="FILE", help="write the report as JSON")
    parser.add_argument(
        "--truth", type=Path, metavar="FILE", help="simulated bus only: real horn angles as CSV"
    )
    parser.add_argument("--log", type=Path, metavar="FILE", help="every byte with its instant")
    parser.add_argument(
        "--real-time",
        action="store_true",
        help="ask for real-time priority and locked memory: on time beside other programs",
    )
    parser.add_argument("--quiet", action="store_true", help="no display; errors only")
    parser.add_argument("--yes", action="store_true", help=YES_HELP)


def play(arguments: argparse.Namespace) -> int:
    """Do what `lss-play` was asked for; return the exit code."""
    from lss_motion import api
    from lss_motion.cli import shows
    from lss_motion.cli.terminal import Terminal

    show = shows.prepare(
        arguments.file,
        arguments.robot,
        speed_ratio=arguments.speed,
        loop=arguments.loop,
        read_robot=reader(arguments, may_ask=not arguments.dry_run),
    )
    robot = api.with_port(show.robot, arguments.port)
    _check(arguments, show, is_simulated=api.is_simulated(robot))
    if arguments.dry_run:
        from lss_motion.cli.planning import program_lines

        for line in [] if arguments.quiet else program_lines(show):
            print(line)
        return EXIT_FINISHED
    is_asked = not arguments.virtual and must_ask(arguments, robot)
    with contextlib.ExitStack() as stack:
        printer = Printer()
        stack.callback(printer.finish)
        say = nothing if arguments.quiet else printer.say
        if api.is_simulated(robot):
            how = "in virtual time" if arguments.virtual else "in real time"
            say(f"{show.program.name}: no hardware, the robot {robot.name!r} is simulated {how}")
        terminal = stack.enter_context(Terminal())
        result = _perform(arguments, show, robot, say, terminal, is_asked=is_asked)
        _write_results(arguments, result)
        if result.error is not None:
            raise _explained(result.error, result)
        for line in report_lines(result.report.to_dict()):
            say(line)
        return _exit_code(result, terminal)


def _explained(error: LssMotionError, result: Result) -> LssMotionError:
    """Return the error that ended a run; of a lost port, with what became of robot and show."""
    if not isinstance(error, LostPortError) or not result.player.safe_bytes():
        return error
    text = (
        f"{error.reason}. Its servos could not be told to hold: they come to rest by themselves, "
        f"and keep the settings of the show until their power is off"
    )
    if result.player.show is not None:
        played_s = result.report.played_s
        text += f". The show had come to {played_s:.2f} s; --from {played_s:.2f} goes on from there"
    return LostPortError(text, url=error.url)


def _exit_code(result: Result, terminal: Terminal) -> int:
    """Return the exit code of a show; say what ended it early, if that was a fault."""
    match result.report.outcome:
        case "stopped":
            return ended_by(terminal.signal_number)
        case "fault":
            from lss_motion.robot.on_fault import ENDING, FaultStep

            for fault in result.player.faults:
                if fault.step in ENDING:
                    let_go = ", this joint let go" if fault.step is FaultStep.LIMP else ""
                    ending = f"The show was stopped and the robot holds{let_go}"
                    put(f"lss-play: {fault}. {ending}", sys.stderr)
            return EXIT_NOT_FOLLOWED
        case _:
            return EXIT_FINISHED


def _check(arguments: argparse.Namespace, show: Show, *, is_simulated: bool) -> None:
    """Refuse what would only be noticed after the show."""
    if arguments.truth is not None and not is_simulated:
        raise InputError("--truth needs the simulated bus: nobody knows the truth of a real one")
    if arguments.faults is not None and not is_simulated:
        raise InputError("--faults needs the simulated bus: nobody damages a real one")
    if arguments.virtual and show.program.repeat is not None:
        raise InputError("--virtual never ends with a loop forever; give --loop N")
    if arguments.start_s is not None and arguments.start_s >= show.program.duration_s:
        raise InputError(
            f"--from {arguments.start_s:g}: the show is over after {show.program.duration_s:.3f} s"
        )
    for path in (arguments.report, arguments.truth, arguments.log):
        if path is not None and not path.absolute().parent.is_dir():
            raise InputError("cannot be written: there is no such folder", path=path)


def _perform(
    arguments: argparse.Namespace,
    show: Show,
    robot: Robot,
    say: Callable[[str], None],
    terminal: Terminal,
    *,
    is_asked: bool,
) -> Result:
    from lss_motion.cli.display import Display
    from lss_motion.cli.terminal import Noted
    from lss_motion.perform import Observer, perform

    with contextlib.ExitStack() as stack:
        display = None
        if not arguments.quiet and not arguments.virtual and sys.stderr.isatty():
            display = Display(say=say)
            stack.callback(display.close)
        logs: list[Any] = []
        if arguments.log is not None:
            from lss_motion.runtime.log import ByteLog

            played = {**_played(arguments), "must_ask": is_asked, "limits": robot.read_limits}
            log = ByteLog(arguments.log, played=played, may_wait=arguments.virtual)
            logs.append(stack.enter_context(log))
        controls = Noted(terminal, logs[0]) if logs else terminal
        note = logs[0].requested if logs else None
        observer = Observer(
            on_event=lambda event: tell(event, say if display is None else display.note),
            on_turn=None if display is None else display.show,
            controls=Agreement(controls, terminal, robot.name, note),
            make_tap=logs[0].started if logs else None,
        )
        return perform(
            show.program,
            robot,
            is_virtual=arguments.virtual,
            seed=arguments.seed,
            has_feedback=not arguments.no_feedback,
            start_s=arguments.start_s,
            trajectory=show.trajectory,
            observer=observer,
            faults=_faults(arguments, robot),
            is_real_time=arguments.real_time,
            must_ask=is_asked,
        )


def _played(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return what `lss-motion replay` needs to make the same program again."""
    return {
        "file": str(arguments.file.absolute()),
        "robot": None if arguments.robot is None else str(arguments.robot.absolute()),
        "speed": arguments.speed,
        "loop": arguments.loop,
        "start_s": arguments.start_s,
        "has_feedback": not arguments.no_feedback,
    }


def _faults(arguments: argparse.Namespace, robot: Robot) -> Sequence[Fault]:
    if arguments.faults is None:
        return ()
    from lss_motion.sim.faults_file import load_faults

    return load_faults(arguments.faults, robot)


def tell(event: Event, say: Callable[[str], None]) -> None:
    """Say what happened, in one line if it is not the table of what was found."""
    from lss_motion.player.events import (
        Checked,
        CueReached,
        Faulted,
        MarkPassed,
        PhaseEntered,
        Waited,
        Warned,
    )

    match event:
        case PhaseEntered(phase):
            say(f"        {phase.value}")
        case Checked(servos):
            for line in table_lines(servos):
                say(line)
        case MarkPassed(label, show_s) if label:
            say(f"{show_s:7.2f} s {label}")
        case CueReached(cue, show_s):
            say(f"{show_s:7.2f} s {_cue_text(cue)}")
        case Waited(text, state):
            say(WAITING[state].format(text))
        case Warned(text):
            say(f"warning: {text}")
        case Faulted(step=step):
            say(f"fault: {event} ({step})")
        case _:
            pass


def _cue_text(cue: Cue) -> str:
    """Return in a few words what a cue does."""
    if cue.say:
        return f'"{cue.say}"'
    if cue.led:
        return "led " + ", ".join(f"{name} {Led(code).name.lower()}" for name, code in cue.led)
    return f"run {cue.run}" if cue.run else f"sound {Path(cue.sound).name}"


def _write_results(arguments: argparse.Namespace, result: Result) -> None:
    from lss_motion.perform import write_truth
    from lss_motion.runtime.report import write_report

    if arguments.report is not None:
        write_report(result.report, arguments.report)
    if arguments.truth is not None and result.truth is not None:
        write_truth(result.truth, arguments.truth)


def _ratio(text: str) -> float:
    value = float(text)
    if not 0.01 <= value <= 100.0:
        raise argparse.ArgumentTypeError(f"{text} is not in 0.01 to 100")
    return value


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < 1e6:
        raise argparse.ArgumentTypeError(f"{text} is not a time in seconds from 0 on")
    return value


def _loop(text: str) -> int | str:
    if text == "forever":
        return text
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a count from 1 on nor `forever`")
    return int(text)


if __name__ == "__main__":
    sys.exit(main())


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    description = f"{DESCRIPTION}\n\n{EPILOG}"
    add_arguments(add_command(commands, "play", play, "the same as lss-play", description))
