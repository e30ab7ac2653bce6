"""One run of a program on a robot: ports, clock, player, observer, report and simulated horns.

`perform` is what `playing.api.play`, the commands, the tests and the benches call. It opens the
ports, runs the player until it has ended, closes the ports and makes the report, also when the run
fails on the way. `Observer` has the callbacks through which a caller watches and steers the run.
`Result.truth` has the angles of the simulated horns (`truth`).
"""

from __future__ import annotations

import contextlib
from functools import partial
from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from lss_motion.errors import BlockedPortError, BusError, InputError, LssMotionError
from lss_motion.files.source import known_names
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

    from lss_motion.planning.program.model import Program
    from lss_motion.planning.trajectory.model import Trajectory
    from lss_motion.playing.connection import Connection
    from lss_motion.playing.player.events import Event
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.report import Report
    from lss_motion.playing.runner import Controls, Tap
    from lss_motion.playing.sound_choice import SoundReport
    from lss_motion.playing.sounds import SoundDesk
    from lss_motion.playing.truth import Truth
    from lss_motion.robot.model import Robot
    from lss_motion.sim.bus import SimBus
    from lss_motion.sim.deviation import Deviation
    from lss_motion.sim.faults import Fault


class Result(Struct, frozen=True, kw_only=True):
    """A run that has ended: its report, its player, and the horns if they are simulated."""

    report: Report
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


def perform(  # noqa: PLR0913  (the options of one run)
    program: Program,
    robot: Robot,
    *,
    is_virtual: bool = False,
    seed: int = 0,
    has_feedback: bool = True,
    start_s: float | None = None,
    trajectory: Trajectory | None = None,
    observer: Observer | None = None,
    faults: Sequence[Fault] = (),
    is_open: bool = False,
    is_real_time: bool = False,
    must_ask: bool = False,
    may_run: bool = False,
    is_forced: bool = False,
    pace: Pace | None = BY_NEED,
    sound: SoundChoice | None = None,
    deviation: Deviation | None = None,
) -> Result:
    """Play `program` on `robot` and return the result, also when the run failed on the way.

    With `trajectory`, the report has the distance of the simulated horns from it. `faults` apply to
    simulated buses and, in virtual time, to the host; `deviation` to simulated servos. While
    `is_open`, `observer.controls` may extend the show, which with `must_ask` moves no joint before
    they call `go`. Functions need `may_run`; `is_real_time`: `real_time`. Others: see `Player`.
    Raises `InputError` or `BusError` only before the first byte.
    """
    check_needs(program, may_run=may_run or is_virtual, has_feedback=has_feedback)
    worse: dict[str, Any] = {"faults": faults, "deviation": deviation}
    simulated = check_bus(program, robot, is_virtual=is_virtual, **worse)
    clock = make_clock(faults, is_virtual=is_virtual, seed=seed)
    connection = connect(robot.buses, robot=robot, clock=clock, seed=seed, **worse)
    started_ns, error, observer = clock.now_ns(), None, observer or Observer()
    player = Player(
        Repertoire.single(program, robot),
        robot,
        start_s=start_s,
        has_feedback=has_feedback,
        must_ask=must_ask,
        is_open=is_open,
        is_forced=is_forced,
        pace=pace,
    )
    warnings: list[str] = []
    note, desk = Noting(observer.on_event, partial(_keep_warning, warnings)), None
    recorder = TruthRecorder(player.robot, connection.simulated, trajectory) if simulated else None
    try:
        with (
            real_time(is_wanted=is_real_time) as refused,
            effects(player, note, sound or SoundChoice(), is_virtual=is_virtual) as performers,
        ):
            on_event, desk = performers
            for text in refused:
                on_event(Warned(text))
            turns = [] if recorder is None else [recorder.turn]
            drive(player, connection, observer, on_event, desk, turns=turns, started_ns=started_ns)
    except BusError as lost:
        error = lost
    except BaseException:
        if recorder is not None:
            recorder.close()
        raise
    finally:
        error = close(connection, error)
    player.end_show(clock.now_ns())
    run_s = s_from_ns(clock.now_ns() - started_ns)
    report = None if desk is None else desk.report
    return _result(player, connection, recorder, run_s, error, warnings=warnings, sound=report)


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
    player: Player, note: Noting, choice: SoundChoice, *, is_virtual: bool
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

            performed = performing(program.cues, note, is_virtual=is_virtual, has_stream=has_stream)
            on_event = stack.enter_context(performed)
        yield on_event, desk


def _result(
    player: Player,
    connection: Connection,
    recorder: TruthRecorder | None,
    run_s: float,
    error: LssMotionError | None,
    *,
    warnings: list[str],
    sound: SoundReport | None,
) -> Result:
    """Return the result of a run that has ended; `recorder` is None on a real robot."""
    from lss_motion.playing.report import make_report  # When nothing moves any more.

    truth = None if recorder is None else recorder.finish(player)
    report = make_report(
        player,
        run_s=run_s,
        is_simulated=recorder is not None,
        outcome=_outcome(player, error),
        warnings=warnings,
        sound=sound,
        horn_error_deg=None if recorder is None else recorder.errors_deg(),
    )
    return Result(
        report=report,
        player=player,
        truth=truth,
        error=player.error or error,
        simulated={} if recorder is None else connection.simulated,
    )


def close(connection: Connection, error: BusError | None) -> BusError | None:
    """Close the ports; return the error that ended the run, or that of bytes that did not leave."""
    try:
        connection.close()
    except BlockedPortError as blocked:
        return error or blocked
    return error


def _outcome(player: Player, error: LssMotionError | None) -> str:
    is_lost = error is not None or isinstance(player.error, BusError)
    return "lost" if is_lost and player.show is not None else player.outcome or "stopped"


class Noting:
    """Passes events to a watcher, if there is one, and to what keeps the report's part of them."""

    def __init__(
        self, on_event: Callable[[Event], None] | None, keep: Callable[[Event], None]
    ) -> None:
        self._on_event = on_event
        self._keep = keep

    def __call__(self, event: Event) -> None:
        self._keep(event)
        if self._on_event is not None:
            self._on_event(event)


def _keep_warning(warnings: list[str], event: Event) -> None:
    if isinstance(event, Warned):
        warnings.append(event.text)


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
