"""One run of many shows on a robot: as `perform`, but it goes on until it is stopped.

`perform_stage` opens the ports, checks the servos and sets them up once for all shows, plays what
`Observer.controls` tell the player to (`Player.change_to`), and holds all joints meanwhile.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from msgspec import Struct, field

from lss_motion.errors import BusError, InputError, LssMotionError
from lss_motion.files.source import known_names
from lss_motion.playing.connection import connect
from lss_motion.playing.perform import (
    Noting,
    Observer,
    check_bus,
    check_needs,
    close,
    drive,
    effects,
    make_clock,
)
from lss_motion.playing.player.events import Warned
from lss_motion.playing.player.player import Player
from lss_motion.playing.player.query_choice import ON_STAGE
from lss_motion.playing.player.repertoire import Repertoire
from lss_motion.playing.sound_choice import SoundChoice
from lss_motion.playing.stage_report import Ledger
from lss_motion.system.real_time import real_time
from lss_motion.units import s_from_ns

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.query_choice import Pace
    from lss_motion.playing.stage_report import StageReport
    from lss_motion.robot.model import Robot
    from lss_motion.sim.bus import SimBus
    from lss_motion.sim.deviation import Deviation
    from lss_motion.sim.faults import Fault


class StageResult(Struct, frozen=True, kw_only=True):
    """A run that has ended: its report, its player, and the simulated buses if there are any."""

    report: StageReport
    player: Player
    error: LssMotionError | None = None
    """Why the run could not begin or go on."""
    simulated: Mapping[str, SimBus] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"StageResult({self.report!r}, error={self.error!r})"


def perform_stage(  # noqa: PLR0913  (the options of one run)
    programs: Mapping[str, Program],
    robot: Robot,
    *,
    first: str | None = None,
    watched: Iterable[str] = (),
    is_virtual: bool = False,
    seed: int = 0,
    has_feedback: bool = True,
    observer: Observer | None = None,
    faults: Sequence[Fault] = (),
    is_real_time: bool = False,
    must_ask: bool = False,
    may_run: bool = False,
    is_forced: bool = False,
    pace: Pace | None = ON_STAGE,
    sound: SoundChoice | None = None,
    deviation: Deviation | None = None,
    is_recorded: bool = True,
) -> StageResult:
    """Run a stage with these shows by name; return the result, also when it failed on the way.

    It begins with `first`; None: the robot holds where it stands. The sensors `watched` are polled
    all the time; `player.watched` has their readings. The other options are those of
    `perform` and of `playing.connection.connect`. Raises `InputError` or `BusError` only before the
    first byte.
    """
    repertoire = Repertoire(programs, robot, watched=watched)
    if first is not None and first not in repertoire.programs:
        raise InputError(f"no show {first!r}; {known_names(first, repertoire.programs)}")
    opening = None if first is None else repertoire.programs[first]
    needs = repertoire.needs(opening)
    check_needs(needs, may_run=may_run or is_virtual, has_feedback=has_feedback)
    worse: dict[str, Any] = {"faults": faults, "deviation": deviation}
    is_simulated = check_bus(needs, robot, is_virtual=is_virtual, **worse)
    clock = make_clock(faults, is_virtual=is_virtual, seed=seed)
    connection = connect(
        robot.buses, robot=robot, clock=clock, seed=seed, is_recorded=is_recorded, **worse
    )
    started_ns, error, observer = clock.now_ns(), None, observer or Observer()
    options = {"has_feedback": has_feedback, "is_forced": is_forced, "must_ask": must_ask}
    player = Player(repertoire, robot, first=opening, pace=pace, **options)
    ledger, desk = Ledger(), None
    note = Noting(observer.on_event, ledger.note)
    try:
        with (
            real_time(is_wanted=is_real_time) as refused,
            effects(player, note, sound or SoundChoice(), is_virtual=is_virtual) as performers,
        ):
            on_event, desk = performers
            for text in refused:
                on_event(Warned(text))
            drive(player, connection, observer, on_event, desk, started_ns=started_ns)
    except BusError as lost:
        error = lost
    finally:
        error = close(connection, error)
    player.end_show(clock.now_ns())
    while (event := player.next_event()) is not None:
        note(event)
    why = player.error or error
    report = ledger.report(
        player,
        run_s=s_from_ns(clock.now_ns() - started_ns),
        is_simulated=is_simulated,
        outcome="lost" if isinstance(why, BusError) else player.outcome or "stopped",
        sound=None if desk is None else desk.report,
    )
    simulated = connection.simulated if is_simulated else {}
    return StageResult(report=report, player=player, error=why, simulated=simulated)
