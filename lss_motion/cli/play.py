"""`lss-play FILE` and `lss-motion play FILE`: plan, compile and play a show."""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from msgspec.structs import replace

from lss_motion.cli.careful import Learning, careful_run, run_carefully
from lss_motion.cli.commands import Parser, add_command, add_version, deviation_of, prepared
from lss_motion.cli.dialog import (
    Confirmation,
    agreed_modules,
    must_ask,
    print_event,
    simulated_text,
)
from lss_motion.cli.messages import Printer, discard, ended_by, failures, guarded, put, say
from lss_motion.cli.options import OPTIONS, UNLIMITED_HELP, add_options, number_from
from lss_motion.errors import (
    EXIT_FINISHED,
    EXIT_INPUT,
    EXIT_INTERRUPTED,
    EXIT_NOT_FOLLOWED,
    InputError,
    LostPortError,
    PlaybackError,
)
from lss_motion.files.output import OTHER_NAME_REMEDY, Output, OutputKind, require_outputs
from lss_motion.system.signals import as_program
from lss_motion.units import SPEED_RATIO_MAX

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from lss_motion.cli.commands import Commands
    from lss_motion.cli.terminal import Terminal
    from lss_motion.errors import LssMotionError
    from lss_motion.planning.program.model import Program
    from lss_motion.planning.shows import Show
    from lss_motion.playing.log import PlayedShow
    from lss_motion.playing.player.events import PlayerRequest
    from lss_motion.playing.player.following import FollowRule
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.report import Report
    from lss_motion.playing.run import Result
    from lss_motion.playing.runner import Controls
    from lss_motion.playing.sound_choice import SoundChoice, SoundReport
    from lss_motion.robot.model import Robot
    from lss_motion.show.functions import ModuleSource
    from lss_motion.sim.faults import Fault
    from lss_motion.stage.timecode.source import TimecodeOut, TimecodeSource
    from lss_motion.stage.timecode.timecode import FollowSpec, SendSpec

    Turn = Callable[[Player, int], None]

DESCRIPTION: Final = """\
Play a sequence (YAML), a gait (YAML) or a compiled program (.lss) on a robot.

  lss-play wave.yaml                         on the robot and port that the files name
  lss-play wave.yaml --port /dev/ttyUSB0     on this port
  lss-play wave.yaml --port sim://           simulated
  lss-play wave.yaml --dry-run               print the plan; nothing moves
"""
EPILOG: Final = """\
A real robot is checked first. You see what was found, and nothing moves before you agree. Where no
show was played to its end with its robot file, the question offers a careful run, too (key c).

Keys while it plays: space pauses, - slows down, + goes up to full speed, which is the speed of the
plan; , and . make the sounds earlier and later, and k keeps that for this robot; q or Ctrl-C stops,
and the servos hold. A signal or a closed terminal stops in the same way. A second Ctrl-C stops at
once; the servos then keep the settings of the show until they are switched off.

Exit codes: 0 played to the end; 2 a file or an argument is wrong, or the show was played and a log,
report or truth could not be written; 3 no plan is possible, or the bus is too slow for it; 4 port
or servos not reachable; 5 the robot did not follow; 130 interrupted; 128 plus its number for any
other signal.
"""


def add_to(commands: Commands) -> None:
    """Add the command of this module."""
    description = f"{DESCRIPTION}\n{EPILOG}"
    add_arguments(add_command(commands, "play", play, description))


def main(argv: Sequence[str] | None = None) -> int:
    """Run `lss-play`; return its exit code."""
    arguments = make_parser().parse_args(argv)
    return guarded("lss-play", lambda: play(arguments))


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of `lss-play`."""
    parser = Parser(
        prog="lss-play",
        description=DESCRIPTION,
        epilog=EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add_version(parser)
    add_arguments(parser)
    return parser


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `lss-play`."""
    parser.add_argument(
        "file", type=Path, metavar="FILE", help="a sequence or gait (.yaml), or a program (.lss)"
    )
    add_options(parser, "--port", "--robot", "--robot-cache")
    parser.add_argument(
        "--speed",
        type=number_from(0.01, SPEED_RATIO_MAX),
        default=1.0,
        metavar="RATIO",
        help="speed relative to the file; 0.5 is half as fast (default 1)",
    )
    parser.add_argument(
        "--loop", type=_loop, metavar="N|forever", help="how often to play; replaces that of FILE"
    )
    parser.add_argument(
        "--from",
        type=_place,
        dest="start_s",
        metavar="S|LABEL",
        help="start S seconds into the show, or at the first keyframe with this label",
    )
    add_options(parser, "--no-feedback")
    add_options(parser, "--force", help=UNLIMITED_HELP)
    parser.add_argument(
        "--dry-run", action="store_true", help="plan, compile and check; move nothing"
    )
    add_options(parser, "--all", help=f"with --dry-run: {OPTIONS['--all']['help']}")
    add_options(parser, "--virtual", "--seed", "--faults")
    add_options(parser, "--sim")
    add_options(parser, "--report")
    parser.add_argument(
        "--truth",
        type=Path,
        metavar="FILE",
        help="simulated bus only: write the true horn angles to this CSV file",
    )
    parser.add_argument(
        "--log",
        type=Path,
        metavar="FILE",
        help="write every byte with its instant; `lss-motion replay` reads it",
    )
    add_options(parser, "--real-time")
    parser.add_argument(
        "--sound-device",
        default="",
        metavar="NAME",
        help="play the sounds on this device; `lss-motion devices` lists them",
    )
    parser.add_argument("--no-sound", action="store_true", help="play the show without its sounds")
    add_timecode_options(parser)
    add_options(parser, "--quiet", "--verbose", "--yes")
    add_options(parser, "--careful")
    add_options(parser, "--allow-run")


def play(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    _check_outputs(arguments)
    show = prepared(
        arguments,
        may_query=not arguments.dry_run,
        speed_ratio=arguments.speed,
        loop=arguments.loop,
        is_following=arguments.follow is not None,
    )
    from lss_motion.playing.connection import is_simulated, with_port

    robot = with_port(show.robot, arguments.port)
    _check(arguments, show, robot)
    if arguments.dry_run:
        from lss_motion.planning.summaries import program_lines

        for line in [] if arguments.quiet else program_lines(show, is_whole=arguments.all):
            say(line)
        return EXIT_FINISHED
    modules: tuple[ModuleSource, ...] | None = ()
    if not arguments.virtual:  # In virtual time no function is called.
        modules = agreed_modules(arguments.file, show.program.cues, is_allowed=arguments.allow_run)
    if modules is None:
        put("no: nothing was played", sys.stderr)
        return EXIT_INTERRUPTED
    is_asked = not arguments.virtual and must_ask(arguments, robot)
    is_real = not is_simulated(robot)
    servos = robot.servo_robot
    learning = Learning(servos, show.program.start_deg, is_kept=is_real)

    def careful() -> int:
        print_line = discard if arguments.quiet else put
        faults, deviation = _faults(arguments, servos), deviation_of(arguments, servos)
        given = (arguments, servos, show.program.start_deg, learning, print_line)
        return careful_run(*given, faults=faults, deviation=deviation)

    def run(rate: float | None) -> int | None:
        return _play(arguments, show, robot, learning, modules, is_asked=is_asked, rate=rate)

    return run_carefully(arguments, run, careful)


def _play(
    arguments: argparse.Namespace,
    show: Show,
    robot: Robot,
    learning: Learning,
    modules: Sequence[ModuleSource],
    *,
    is_asked: bool,
    rate: float | None = None,
) -> int | None:
    """Play; return the exit code, or None if a person wants a careful run first.

    That is offered where no `rate` is given.
    """
    from lss_motion.cli.terminal import Terminal
    from lss_motion.playing.connection import is_simulated
    from lss_motion.playing.sound_choice import SoundChoice

    with contextlib.ExitStack() as stack:
        printer = Printer()
        stack.callback(printer.finish)
        print_line = discard if arguments.quiet else printer.print
        if is_simulated(robot):
            how = " in virtual time" if arguments.virtual else " in real time"
            print_line(simulated_text(show.program.name, robot, how))
        sound = SoundChoice(
            device=arguments.sound_device,
            is_off=arguments.no_sound,
            leads=arguments.follow is None,
        )
        terminal = stack.enter_context(
            Terminal(rate=rate or 1.0, sound=sound, is_virtual=arguments.virtual)
        )
        problems: list[str] = []
        offer = "" if rate is not None or not is_asked else learning.offer
        result, is_careful = _perform(
            arguments,
            show,
            _with_kept_offset(robot),
            print_line,
            terminal,
            problems,
            modules,
            is_asked=is_asked,
            offer=offer,
        )
        if is_careful:
            return None
        problems += _write_results(arguments, result)
        if result.report.outcome == "finished":
            learning.note_completed()
        for text in [*problems, *_unplayed_lines(result.report.sound)]:
            put(f"lss-play: {text}", sys.stderr)
        for line in _offset_lines(robot, sound):
            print_line(line)
        if result.error is not None:
            raise _explained(result.error, result)
        from lss_motion.cli.report import report_lines

        for line in report_lines(result.report.to_dict(), is_whole=arguments.verbose):
            print_line(line)
        return _exit_code(result, terminal) or (EXIT_INPUT if problems else EXIT_FINISHED)


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Refuse outputs that cannot be written, or that would replace what is not theirs."""
    outputs = [
        Output(arguments.report, OutputKind.REPORT),
        Output(arguments.truth, OutputKind.TABLE),
        Output(arguments.log, OutputKind.LOG),
    ]
    sources = [arguments.file, arguments.robot, arguments.robot_cache, arguments.faults]
    require_outputs(outputs, sources=sources, remedy=OTHER_NAME_REMEDY)


def _check(arguments: argparse.Namespace, show: Show, robot: Robot) -> None:
    """Refuse arguments whose fault would otherwise appear only after the show."""
    from lss_motion.playing.connection import is_simulated

    require_timecode(arguments)
    if arguments.all and not arguments.dry_run:
        raise InputError("--all lists what --dry-run prints; give both, or neither")
    if arguments.truth is not None and not is_simulated(robot):
        raise InputError("--truth needs the simulated bus: a real horn angle is not known exactly")
    if arguments.faults is not None and not is_simulated(robot):
        raise InputError("--faults needs the simulated bus")
    deviation_of(arguments, robot.servo_robot)
    if arguments.virtual and show.program.is_endless:
        raise InputError("--virtual never ends with a loop forever; give --loop N")
    if arguments.start_s is not None:
        try:
            arguments.start_s = show.program.instant_of(arguments.start_s)
        except InputError as error:
            raise InputError(f"--from: {error}") from None


def _perform(  # noqa: PLR0913  (what one run needs)
    arguments: argparse.Namespace,
    show: Show,
    robot: Robot,
    print_line: Callable[[str], None],
    terminal: Terminal,
    problems: list[str],
    modules: Sequence[ModuleSource],
    *,
    is_asked: bool,
    offer: str,
) -> tuple[Result[Report], bool]:
    """Play; return the result, and whether a person took the `offer` of a careful run.

    Add to `problems` why the log is not complete, if it is not.
    """
    from lss_motion.playing.run import Observer, perform

    with contextlib.ExitStack() as stack:
        display = None
        if not arguments.quiet and not arguments.virtual and sys.stderr.isatty():
            from lss_motion.cli.display import Display

            display = Display(print_line=print_line)
            stack.callback(display.close)
        log = None
        if arguments.log is not None:
            from lss_motion.playing.log import ByteLog

            played = _played(arguments, robot, is_asked=is_asked)
            log = ByteLog(arguments.log, played=played, may_wait=arguments.virtual)
            stack.enter_context(log.reporting_to(problems))
        note = print_line if display is None else display.note
        note_answer = None if log is None else log.requested
        if note_answer is not None and arguments.follow is None:
            terminal.note_request = note_answer
        confirmation = Confirmation(terminal, terminal, robot.name, note_answer, offer=offer)
        link = stack.enter_context(opened_timecode(arguments, show.program, note))
        observer = Observer(
            on_event=lambda event: print_event(event, note, is_verbose=arguments.verbose),
            on_turn=link.on_turn(None if display is None else display.show),
            controls=link.controls(confirmation, note, note_answer),
            make_tap=None if log is None else log.started,
        )
        result = perform(
            show.program,
            robot,
            is_virtual=arguments.virtual,
            seed=arguments.seed,
            has_feedback=not arguments.no_feedback,
            is_forced=arguments.force,
            start_s=arguments.start_s,
            trajectory=show.trajectory,
            observer=observer,
            faults=_faults(arguments, robot.servo_robot),
            deviation=deviation_of(arguments, robot.servo_robot),
            is_real_time=arguments.real_time,
            must_ask=is_asked,
            may_run=True,
            modules=modules,
            sound=terminal.sound,
        )
        if link.is_over and result.error is None and result.report.outcome == "stopped":
            reason = "the timecode was beyond the end of the show, and is gone: the show was ended"
            result = replace(result, error=PlaybackError(reason))
        return result, confirmation.is_careful


def _played(arguments: argparse.Namespace, robot: Robot, *, is_asked: bool) -> PlayedShow:
    """Return what `lss-motion replay` needs to make the same program again."""
    from lss_motion.playing.log import PlayedShow

    return PlayedShow(
        file=str(arguments.file.absolute()),
        robot=None if arguments.robot is None else str(arguments.robot.absolute()),
        speed=arguments.speed,
        loop=arguments.loop,
        start_s=arguments.start_s,
        has_feedback=not arguments.no_feedback,
        is_forced=arguments.force,
        port=arguments.port,
        is_following=arguments.follow is not None,
        must_ask=is_asked,
        limits=robot.read_limits,
    )


def _faults(arguments: argparse.Namespace, robot: Robot) -> Sequence[Fault]:
    if arguments.faults is None:
        return ()
    from lss_motion.sim.faults import load_faults

    return load_faults(arguments.faults, robot)


def _write_results(arguments: argparse.Namespace, result: Result[Report]) -> list[str]:
    """Write report and truth; return what could not be written, since the show was played."""
    from lss_motion.playing.report import write_report
    from lss_motion.playing.truth import write_truth

    problems = []
    if arguments.report is not None:
        problems += failures(write_report, result.report, arguments.report)
    if arguments.truth is not None and result.truth is not None:
        problems += failures(write_truth, result.truth, arguments.truth)
    return problems


def _explained(error: LssMotionError, result: Result[Report]) -> LssMotionError:
    """Return the error that ended a run; for a lost port, with the state of robot and show."""
    if not isinstance(error, LostPortError) or not result.player.safe_bytes():
        return error
    text = (
        f"{error.reason}. The command to hold could not be sent: the servos come to rest by "
        f"themselves, and keep the settings of the show until they are switched off"
    )
    if result.player.show is not None:
        played_s = result.report.played_s
        text += f". The show stopped at {played_s:.2f} s; --from {played_s:.2f} continues it"
    return LostPortError(text, url=error.url)


def _exit_code(result: Result[Report], terminal: Terminal) -> int:
    """Return the exit code of a show; print the fault that ended it early."""
    match result.report.outcome:
        case "stopped":
            return ended_by(terminal.signal_number)
        case "fault":
            from lss_motion.robot.on_fault import ENDING, FaultStep

            for fault in result.player.faults:
                if fault.step in ENDING:
                    limp = ", this joint is limp" if fault.step is FaultStep.LIMP else ""
                    ending = f"The show was stopped and the robot holds{limp}"
                    put(f"lss-play: {fault}. {ending}", sys.stderr)
            return EXIT_NOT_FOLLOWED
        case _:
            return EXIT_FINISHED


def _place(text: str) -> float | str:
    """Return a show time, or else a label."""
    try:
        seconds = float(text)
    except ValueError:
        return text
    return number_from(0.0, 1e6, "seconds")(text) if math.isfinite(seconds) else text


def _loop(text: str) -> int | str:
    if text == "forever":
        return text
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is neither a count from 1 up nor `forever`")
    return int(text)


def _with_kept_offset(robot: Robot) -> Robot:
    """Return the robot with the offset that was kept with the key k, if its file states none."""
    from lss_motion.robot.model import learnt_path

    if robot.path is None or robot.sound_offset_s or not learnt_path(robot.path).exists():
        return robot
    from lss_motion.robot.learnt import load_learnt

    try:
        kept_s = load_learnt(robot).sound_offset_s
    except InputError:  # `careful.Learning` has named what is wrong with the file.
        return robot
    return replace(robot, sound_offset_s=kept_s) if kept_s else robot


def _offset_lines(robot: Robot, sound: SoundChoice) -> list[str]:
    """Keep the offset if this was requested; return what a person must know about it.

    `robot` is that of the robot file, without what was kept before.
    """
    if not sound.shift_s and not sound.is_kept:
        return []
    from lss_motion.robot.learnt import load_learnt, save_learnt
    from lss_motion.robot.model import learnt_path

    offset_s = round(_with_kept_offset(robot).sound_offset_s + sound.shift_s, 4)
    by_hand = f"sound_offset_s: {offset_s:g} in the robot file"
    if not sound.is_kept:
        return [f"the sounds were shifted to {offset_s:g} s; to keep that: key k, or {by_hand}"]
    if robot.sound_offset_s or robot.path is None:
        return [f"the robot file states its own sound_offset_s; to change it: {by_hand}"]
    try:
        learnt = load_learnt(robot).changed(sound_offset_s=offset_s)
        save_learnt(learnt, robot)
    except InputError as error:
        return [f"warning: the offset of the sounds is not kept: {error}; give {by_hand}"]
    return [f"the sounds stay at {offset_s:g} s: kept in {learnt_path(robot.path).name}"]


def _unplayed_lines(sound: SoundReport | None) -> list[str]:
    """Return which sounds were not played, although the show was."""
    if sound is None or not sound.not_played:
        return []
    return [f"not played: {', '.join(sound.not_played)}"]


FREEWHEEL_S: Final = 2.0
FREEWHEEL_MAX_S: Final = 3600.0


def add_timecode_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--follow",
        metavar="SOURCE",
        help="wait for timecode, and stay in step with it: ltc[:DEVICE] (sound input), mtc[:PORT] "
        "(MIDI), artnet[:ADDRESS] or fpp[:ADDRESS] (senders; this computer only, if not given)",
    )
    parser.add_argument(
        "--send",
        action="append",
        default=[],
        metavar="RECEIVER",
        help="send timecode of the show: ltc[:DEVICE], mtc[:PORT], artnet:ADDRESS, fpp:ADDRESS or "
        "osc:HOST:PORT; may be given several times",
    )
    parser.add_argument(
        "--rate-fps",
        metavar="RATE",
        help="of the timecode: 23.976, 24, 25, 29.97, 29.97df or 30 (default: as it comes; 25 is "
        "sent)",
    )
    parser.add_argument(
        "--offset-s",
        default="0",
        metavar="HH:MM:SS:FF|S",
        help="timecode at which the show begins: subtracted from what comes, added to what is sent "
        "(default 0)",
    )
    parser.add_argument(
        "--song",
        default="",
        metavar="NAME",
        help="with --follow fpp: only while this sequence or media is played",
    )
    parser.add_argument(
        "--freewheel",
        type=number_from(0.1, FREEWHEEL_MAX_S, "seconds"),
        default=FREEWHEEL_S,
        metavar="S",
        help="with --follow: without timecode, go on for so long (default 2)",
    )
    parser.add_argument(
        "--lost",
        choices=("go_on", "hold"),
        default="go_on",
        help="with --follow: what to do then (default go_on)",
    )


def require_timecode(arguments: argparse.Namespace) -> tuple[FollowSpec | None, list[SendSpec]]:
    """Return what is followed and sent; raises `InputError` for options that do not fit."""
    if arguments.follow is None and not arguments.send:
        if arguments.song:
            raise InputError("--song is for --follow fpp")
        if arguments.rate_fps is not None or arguments.offset_s != "0":
            raise InputError(
                "--rate-fps and --offset-s are for --follow or --send; give one of them"
            )
        return None, []
    from lss_motion.stage.timecode.timecode import read_follow, read_send

    if arguments.virtual:
        raise InputError("--virtual has no clock to share: not with --follow or --send")
    style: dict[str, Any] = {"rate": arguments.rate_fps, "offset": arguments.offset_s}
    sends = [read_send(text, **style) for text in arguments.send]
    if arguments.follow is None:
        return None, sends
    for option in ("start_s", "careful"):
        if getattr(arguments, option):
            name = {"start_s": "--from"}.get(option, f"--{option}")
            raise InputError(f"{name} has no meaning with --follow: the timecode says where to be")
    if arguments.follow.startswith("fpp"):
        style["rate"] = None if sends else arguments.rate_fps
    return read_follow(
        arguments.follow, **style, freewheel_s=arguments.freewheel, song=arguments.song
    ), sends


class Link:
    """Timecode of one run: its controls, and what is called on each turn."""

    def __init__(
        self,
        source: TimecodeSource | None,
        outs: list[TimecodeOut],
        rule: FollowRule | None = None,
    ) -> None:
        from lss_motion.playing.player.following import Following

        self._source, self._outs = source, outs
        self.following = None if source is None else Following(rule)

    @property
    def is_over(self) -> bool:
        """Whether the timecode that was followed is gone, beyond the end of the show."""
        return self.following is not None and self.following.is_over

    def controls(
        self,
        inner: Controls[Player],
        tell: Callable[[str], None],
        note_request: Callable[[PlayerRequest, int], None] | None,
    ) -> Controls[Player]:
        """Return the controls of the run; `inner` are those of a person."""
        if self.following is None or self._source is None:
            return inner
        from lss_motion.stage.timecode.source import FollowControls

        if note_request is not None:
            self.following.note_request = note_request
        return FollowControls(self.following, self._source, inner=inner, tell=tell)

    def on_turn(self, inner: Turn | None) -> Turn | None:
        """Return what is called on each turn."""
        calls = [*([] if inner is None else [inner]), *(out.turn for out in self._outs)]
        if len(calls) < 2:
            return calls[0] if calls else None

        def turn(player: Player, now_ns: int) -> None:
            for call in calls:
                call(player, now_ns)

        return turn


@contextlib.contextmanager
def opened_timecode(
    arguments: argparse.Namespace, program: Program, tell: Callable[[str], None]
) -> Iterator[Link]:
    """Open what is followed and sent, if anything; raises `InputError`."""
    follow, sends = require_timecode(arguments)
    if follow is None and not sends:
        yield Link(None, [])
        return
    from msgspec.structs import replace

    from lss_motion.playing.player.following import FollowRule, require_can_follow
    from lss_motion.stage.timecode.source import TimecodeOut, TimecodeSource

    with contextlib.ExitStack() as stack:
        source = None
        if follow is not None:
            require_can_follow(program)
            source = stack.enter_context(TimecodeSource(follow))
        outs = [stack.enter_context(TimecodeOut(replace(s, show=program.name))) for s in sends]
        for out in outs:
            tell(f"sends {out.text}")
        rule = FollowRule(freewheel_s=arguments.freewheel, lost=arguments.lost)
        yield Link(source, outs, rule)


if __name__ == "__main__":
    sys.exit(as_program("lss-play", main))
