"""One run on a robot: ports, clock, player, observer, report and simulated horns.

`perform` is what `api.play`, the commands, the stage, the tests and the benches call. It plays a
program, and ends with it, or a repertoire of many until it is stopped. It opens the ports, runs the
player until it has ended, closes the ports and makes the report, also when the run fails on the
way. `Observer` has the callbacks through which a caller watches and steers the run.
`Result.truth` has the angles of the simulated horns (`truth`).
"""

from __future__ import annotations

import contextlib
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypedDict, TypeVar, Unpack, overload

from msgspec import Struct, field

from lss_motion.errors import BlockedPortError, BusError, InputError, LssMotionError
from lss_motion.files.texts import known_names
from lss_motion.planning.program.model import Program
from lss_motion.playing.connection import connect, is_simulated
from lss_motion.playing.player.events import Warned
from lss_motion.playing.player.player import Player
from lss_motion.playing.player.query_choice import BY_NEED
from lss_motion.playing.player.repertoire import Repertoire
from lss_motion.playing.runner import run
from lss_motion.playing.sound_choice import SoundChoice
from lss_motion.playing.truth import TruthRecorder
from lss_motion.system.clock import MonotonicClock, VirtualClock
from lss_motion.system.port import ReopeningPort
from lss_motion.system.real_time import real_time
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.report import Ledger, Report, StageReport
    from lss_motion.playing.runner import Controls, Tap
    from lss_motion.playing.sound_choice import SoundReport
    from lss_motion.playing.sounds import SoundDesk
    from lss_motion.playing.truth import Truth
    from lss_motion.robot.model import Robot
    from lss_motion.show.functions import ModuleSource
    from lss_motion.sim.bus import SimBus
    from lss_motion.sim.deviation import Deviation
    from lss_motion.sim.faults import Fault


R = TypeVar("R")


class Result(Struct, Generic[R], frozen=True, kw_only=True):
    """A run that has ended: its report, its player, and the horns if they are simulated."""

    report: R
    """A `Report` of a program, a `StageReport` of a repertoire."""
    player: Player
    truth: Truth | None = None
    error: LssMotionError | None = None
    """Why the run could not begin or go on: `BusError`, `InputError` or `PlaybackError`."""
    simulated: Mapping[str, SimBus] = field(default_factory=dict)
    """The simulated buses by name, with every byte that they received and every horn angle."""

    def __repr__(self) -> str:
        return f"Result({self.report!r}, error={self.error!r})"


class Observer(Struct, frozen=True, kw_only=True):
    """Callbacks that watch and steer a run. They must not block: they run between two commands."""

    on_event: Callable[[Event], None] | None = None
    on_turn: Callable[[Player, int], None] | None = None
    controls: Controls[Player] | None = None
    make_tap: Callable[[int], Tap] | None = None
    """Returns the tap that gets every byte; its argument is the instant at which the run began."""


class RunOptions(TypedDict, total=False):
    """The options of a run: what is not given is off, or as in real time."""

    is_virtual: bool
    """Time passes as fast as the computer can. Only on simulated buses."""
    seed: int
    has_feedback: bool
    start_s: float | None
    """Show time from which the program is played; None: from its beginning."""
    first: str | None
    """The show with which a repertoire begins; None: all joints hold where they stand."""
    trajectory: Trajectory | None
    """The report has the distance of the simulated horns from it."""
    observer: Observer | None
    faults: Sequence[Fault]
    """Of simulated buses and, in virtual time, of the host."""
    deviation: Deviation | None
    """Of simulated servos from the robot file."""
    is_recorded: bool
    """Whether simulated buses keep what they receive."""
    is_open: bool
    """`observer.controls` may extend the program, which with `must_ask` moves no joint before they
    call `go`."""
    must_ask: bool
    may_run: bool
    """The functions of the shows may be called."""
    modules: Sequence[ModuleSource] | None
    """Their modules, as a person has agreed to them; None: as they lie beside the shows now."""
    is_forced: bool
    is_real_time: bool
    """See `real_time`."""
    pace: Pace | None
    """How often a program has angles queried (`Player`)."""
    sound: SoundChoice | None


@overload
def perform(shows: Program, robot: Robot, **options: Unpack[RunOptions]) -> Result[Report]: ...


@overload
def perform(
    shows: Repertoire, robot: Robot, **options: Unpack[RunOptions]
) -> Result[StageReport]: ...


def perform(  # noqa: PLR0913  (the options of one run)
    shows: Program | Repertoire,
    robot: Robot,
    *,
    is_virtual: bool = False,
    seed: int = 0,
    has_feedback: bool = True,
    start_s: float | None = None,
    first: str | None = None,
    trajectory: Trajectory | None = None,
    observer: Observer | None = None,
    faults: Sequence[Fault] = (),
    deviation: Deviation | None = None,
    is_recorded: bool = True,
    is_open: bool = False,
    must_ask: bool = False,
    may_run: bool = False,
    modules: Sequence[ModuleSource] | None = None,
    is_forced: bool = False,
    is_real_time: bool = False,
    pace: Pace | None = BY_NEED,
    sound: SoundChoice | None = None,
) -> Result[Any]:
    """Play a program, or the shows of a repertoire until it is stopped; return the result.

    Raises `InputError` or `BusError` only before the first byte: later they are in the result.
    """
    figure, robot = robot, robot.servo_robot
    opening = None if isinstance(shows, Program) else _opening(shows, first)
    needs = shows if isinstance(shows, Program) else shows.needs(opening)
    check_needs(needs, may_run=may_run or is_virtual, has_feedback=has_feedback)
    worse: dict[str, Any] = {"faults": faults, "deviation": deviation}
    check_bus(needs, robot, is_virtual=is_virtual, **worse)
    clock = make_clock(faults, is_virtual=is_virtual, seed=seed)
    connection = connect(
        robot.buses, robot=robot, clock=clock, seed=seed, is_recorded=is_recorded, **worse
    )
    started_ns, error, observer = clock.now_ns(), None, observer or Observer()
    player = Player(
        Repertoire.single(shows, robot, pace=pace) if isinstance(shows, Program) else shows,
        robot,
        first=opening,
        start_s=start_s,
        has_feedback=has_feedback,
        must_ask=must_ask,
        is_open=is_open,
        is_forced=is_forced,
    )
    kept, desk = _Kept(player, figure, connection, trajectory, observer.on_event), None
    try:
        with (
            real_time(is_wanted=is_real_time) as refused,
            effects(
                player, kept.note, sound or SoundChoice(), modules, is_virtual=is_virtual
            ) as begun,
        ):
            (on_event, desk), turns = begun, kept.turns
            for text in refused:
                on_event(Warned(text))
            drive(player, connection, observer, on_event, desk, turns=turns, started_ns=started_ns)
    except BusError as lost:
        error = lost
    except BaseException:
        kept.close()
        raise
    finally:
        error = close(connection, error)
    player.end_show(clock.now_ns())
    run_s = s_from_ns(clock.now_ns() - started_ns)
    return kept.result(run_s, error, None if desk is None else desk.report)


def _opening(shows: Repertoire, first: str | None) -> Program | None:
    """Return the show with which a repertoire begins."""
    if first is not None and first not in shows.programs:
        raise InputError(f"no show {first!r}; {known_names(first, shows.programs)}")
    return None if first is None else shows.programs[first]


def drive(
    player: Player,
    connection: Connection,
    observer: Observer,
    on_event: Callable[[Event], None],
    desk: SoundDesk | None,
    *,
    turns: Sequence[Callable[[Player, int], None]] = (),
    started_ns: int,
) -> None:
    """Run `player` over the open ports until it has ended; `turns` are called on each turn."""
    tap = None if observer.make_tap is None else observer.make_tap(started_ns)
    if desk is not None:
        desk.note_to(on_event, None if tap is None else tap.requested)
    calls = [*([] if observer.on_turn is None else [observer.on_turn]), *turns]
    calls += [] if desk is None else [desk.turn]

    def turn(player: Player, now_ns: int) -> None:
        for call in calls:
            call(player, now_ns)

    run(
        player,
        _reopening(connection, player, tap),
        connection.clock,
        on_event=on_event,
        on_turn=calls[0] if len(calls) == 1 else turn,
        controls=observer.controls,
        tap=tap,
    )


@contextlib.contextmanager
def effects(
    player: Player,
    note: Callable[[Event], None],
    choice: SoundChoice,
    modules: Sequence[ModuleSource] | None = None,
    *,
    is_virtual: bool,
) -> Iterator[tuple[Callable[[Event], None], SoundDesk | None]]:
    """Yield the event handler that starts functions, and what plays the sounds of the show.

    The latter is None if the show has none, or in virtual time.
    """
    program, desk = player.program, None
    with contextlib.ExitStack() as stack:
        if not is_virtual and not choice.is_off and any(cue.sound for cue in program.cues):
            from lss_motion.playing.sounds import SoundDesk

            desk = SoundDesk(
                program, choice, offset_s=player.robot.sound_offset_s, start_s=player.start_s
            )
            stack.callback(desk.close)
        has_stream = choice.is_off or (desk is not None and desk.is_open)
        on_event: Callable[[Event], None] = note
        if any(cue.run or cue.sound for cue in program.cues):
            from lss_motion.playing.performer import performing

            performed = performing(
                program.cues, note, is_virtual=is_virtual, has_stream=has_stream, modules=modules
            )
            on_event = stack.enter_context(performed)
        yield on_event, desk


def close(connection: Connection, error: BusError | None) -> BusError | None:
    """Close the ports; return the error that ended the run, or that of bytes that did not leave."""
    try:
        connection.close()
    except BlockedPortError as blocked:
        return error or blocked
    return error


class _Kept:
    """What is kept of a run for its result: of one show all, of many their totals."""

    def __init__(
        self,
        player: Player,
        figure: Robot,
        connection: Connection,
        trajectory: Trajectory | None,
        on_event: Callable[[Event], None] | None,
    ) -> None:
        """Keep what comes of `player` over its ports.

        `figure` has the joints of the servos that are played.
        """
        self._figure = figure
        self._on_event = on_event
        self._player = player
        self._simulated = simulated = connection.simulated or None
        self._warnings: list[str] = []
        self._ledger: Ledger | None = None
        self._recorder: TruthRecorder | None = None
        if player.repertoire.only is None:
            from lss_motion.playing.report import Ledger

            self._ledger = Ledger()
        elif simulated is not None:
            self._recorder = TruthRecorder(figure, simulated, trajectory)

    @property
    def turns(self) -> list[Callable[[Player, int], None]]:
        """What must be called on each turn."""
        return [] if self._recorder is None else [self._recorder.turn]

    def note(self, event: Event) -> None:
        """Keep what an event tells, if it tells anything; pass it on to who watches."""
        if self._ledger is not None:
            self._ledger.note(event)
        elif isinstance(event, Warned):
            self._warnings.append(event.text)
        if self._on_event is not None:
            self._on_event(event)

    def close(self) -> None:
        """Forget it all."""
        if self._recorder is not None:
            self._recorder.close()

    def result(
        self,
        run_s: float,
        error: LssMotionError | None,
        sound: SoundReport | None,
    ) -> Result[Any]:
        """Return the result of the run, which has ended."""
        player, ledger = self._player, self._ledger
        truth = None if self._recorder is None else self._recorder.finish(player)
        common: dict[str, Any] = {"run_s": run_s, "sound": sound}
        common["is_simulated"] = self._simulated is not None
        why = player.error or error
        is_lost = error is not None or isinstance(player.error, BusError)
        report: Report | StageReport
        if ledger is None:
            from lss_motion.playing.report import make_report  # When nothing moves any more.

            errors_deg = None if self._recorder is None else self._recorder.errors_deg()
            report = make_report(
                player,
                outcome="lost" if is_lost and player.show else player.outcome or "stopped",
                warnings=self._warnings,
                horn_error_deg=errors_deg,
                **common,
            )
            if self._figure.servos:
                from lss_motion.playing.report_joints import with_joints

                report = with_joints(report, self._figure, player.program, errors_deg)
        else:
            while (event := player.next_event()) is not None:
                self.note(event)
            is_lost = isinstance(why, BusError)
            outcome = "lost" if is_lost else player.outcome or "stopped"
            report = ledger.report(player, outcome=outcome, **common)
        buses = self._simulated or {}
        return Result(report=report, player=player, truth=truth, error=why, simulated=buses)


def _reopening(connection: Connection, player: Player, tap: Tap | None) -> dict[str, ReopeningPort]:
    """Return ports that are opened again after a loss, as long as the player waits for them."""

    def lose(bus: str, reason: str, now_ns: int) -> None:
        if tap is not None:
            tap.noted(bus, "lost", now_ns, reason)
        player.port_lost(bus, reason, now_ns)

    def find(bus: str, now_ns: int) -> None:
        if tap is not None:
            tap.noted(bus, "found", now_ns)
        player.port_found(bus)

    return {
        name: ReopeningPort(
            port,
            partial(connection.reopen, name),
            connection.clock,
            waits=partial(player.waits_for_port, name),
            lost=partial(lose, name),
            found=partial(find, name),
        )
        for name, port in connection.ports.items()
    }


def check_bus(
    program: Program,
    robot: Robot,
    *,
    is_virtual: bool,
    faults: Sequence[Fault],
    deviation: Deviation | None,
) -> bool:
    """Return whether the robot is simulated.

    Refuses a program for another robot, and virtual time, faults and deviations on a real bus.
    """
    _check_joints(program, robot)
    simulated = is_simulated(robot)
    if is_virtual and not simulated:
        raise InputError("--virtual needs the simulated bus: use it with --port sim://")
    if deviation is not None and not simulated:
        raise InputError("--sim needs the simulated bus: use it with --port sim://")
    if not faults:
        return simulated
    from lss_motion.sim.faults import FaultKind

    if not simulated:
        raise InputError("--faults needs the simulated bus: use it with --port sim://")
    if not is_virtual and any(fault.kind is FaultKind.OVERSLEEP for fault in faults):
        raise InputError(f"{FaultKind.OVERSLEEP} needs --virtual: in real time this host is real")
    return simulated


def _check_joints(program: Program, robot: Robot) -> None:
    """Refuse a program that was compiled for another robot."""
    for name in program.start_deg:
        if name not in robot.joints:
            raise InputError(
                f"program {program.name!r} moves joint {name!r}, which robot {robot.name!r} does "
                f"not have: {known_names(name, robot.joints)}; compile it for this robot"
            )


def check_needs(program: Program, *, may_run: bool, has_feedback: bool) -> None:
    """Refuse waits without feedback, and a show that would call functions without consent."""
    if program.waits and not has_feedback:
        raise InputError("the show waits for a sensor, which must be asked: not with --no-feedback")
    functions = ", ".join(dict.fromkeys(cue.run for cue in program.cues if cue.run))
    if functions and not may_run:
        raise InputError(
            f"the show would call Python functions ({functions}); read them, then play it with "
            f"allow_run=True"
        )


def make_clock(
    faults: Sequence[Fault], *, is_virtual: bool, seed: int
) -> MonotonicClock | VirtualClock:
    if not is_virtual:
        return MonotonicClock()
    if not faults:
        return VirtualClock()
    from lss_motion.sim.faults import SleepyClock

    return SleepyClock(faults, seed=seed)
