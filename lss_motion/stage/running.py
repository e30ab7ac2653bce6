"""Couples the director and the player, in the process of the player and in virtual time.

`StageRun.play` plays a stage until it is stopped. It makes one run of the player after the other
(`playing.run.perform`): a run ends with a fault, or when a resting figure goes limp,
and the director says when the next one begins. Between two runs nothing is open and nothing moves.

`StageRun` is the observer and the controls of these runs. It reads the sensors of cues, gives the
director the time, the readings and the events, and obeys its orders at the next turn. All of this
takes a fraction of a millisecond, and nothing in it waits.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from random import Random
from typing import TYPE_CHECKING, Any, Final, Protocol

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import BusError, InputError, LssMotionError
from lss_motion.playing.player.events import (
    Faulted,
    Phase,
    PhaseEntered,
    ShowBegan,
    ShowOver,
    Warned,
)
from lss_motion.playing.player.repertoire import Repertoire
from lss_motion.playing.run import Observer, perform
from lss_motion.playing.sound_choice import SoundChoice
from lss_motion.robot.on_fault import ENDING, Cause
from lss_motion.stage import orders
from lss_motion.stage.director import Director
from lss_motion.stage.log import Records, Ring, must_restart, renewed, state_word
from lss_motion.stage.model import Signal, TriggerKind
from lss_motion.stage.orders import ShowInfo
from lss_motion.stage.stage_timecode import Sending, StageTimecode
from lss_motion.system.clock import MonotonicClock
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.log import PortState
    from lss_motion.playing.player.events import Event, PlayerRequest, ShowSummary
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.report import StageReport
    from lss_motion.playing.run import Result
    from lss_motion.playing.runner import Tap
    from lss_motion.robot.model import Robot
    from lss_motion.stage.check import Planned
    from lss_motion.stage.log import Record
    from lss_motion.stage.stage_timecode import Out
    from lss_motion.stage.timecode.source import LegSource


@dataclass(slots=True)
class NumberedShows:
    """The shows of the player by the numbers of the director."""

    main: int | None = None
    has_begun: bool = False
    start_s: float | None = None
    leaving: deque[int] = field(default_factory=deque)
    """Shows that have begun and brake for another one; the player reports each when it is over."""
    added: dict[str, int] = field(default_factory=dict)
    begun: set[str] = field(default_factory=set)
    """Those of the added ones that have begun."""

    def leave(self, order: orders.PlayOrder | None) -> list[tuple[int, float | None]]:
        """Note what was ordered in place of all; return what is over at once: it had not begun."""
        waiting = self.added.keys() - self.begun
        over: list[tuple[int, float | None]] = [(self.added.pop(name), None) for name in waiting]
        if self.main is not None and self.has_begun:
            self.leaving.append(self.main)
        elif self.main is not None:
            over.append((self.main, self.start_s))
        self.main = None if order is None else order.number
        self.start_s = None if order is None else order.start_s
        self.has_begun = False
        return over

    def note_begun(self, event: ShowBegan) -> None:
        if event.is_added:
            self.begun.add(event.name)
        else:
            self.has_begun = True

    def note_over(self, summary: ShowSummary) -> int | None:
        """Return the number of a show that is over."""
        if summary.is_added:
            self.begun.discard(summary.name)
            return self.added.pop(summary.name, None)
        if self.leaving:
            return self.leaving.popleft()
        number, self.main, self.has_begun = self.main, None, False
        return number


class Both:
    """Two taps as one."""

    def __init__(self, one: Tap, other: Tap) -> None:
        self._taps = (one, other)

    def sent(self, bus: str, data: bytes, now_ns: int) -> None:
        for tap in self._taps:
            tap.sent(bus, data, now_ns)

    def received(self, bus: str, data: bytes, now_ns: int) -> None:
        for tap in self._taps:
            tap.received(bus, data, now_ns)

    def turned(self, now_ns: int) -> None:
        for tap in self._taps:
            tap.turned(now_ns)

    def happened(self, event: Event, now_ns: int) -> None:
        for tap in self._taps:
            tap.happened(event, now_ns)

    def requested(self, request: PlayerRequest, now_ns: int) -> None:
        for tap in self._taps:
            tap.requested(request, now_ns)

    def noted(self, bus: str, state: PortState, now_ns: int, reason: str = "") -> None:
        for tap in self._taps:
            tap.noted(bus, state, now_ns, reason)


MEASURE_NS: Final = NS_PER_S
"""Temperatures and currents are polled every second or so."""
SAMPLE_NS: Final = 60 * NS_PER_S
"""A line about them in the log: 200 kilobytes in a day."""
RATE_EVERY_NS: Final = 100 * NS_PER_MS
"""As `playing.remote.player_end.RATE_EVERY_NS`."""
PORT_NS: Final = 5 * NS_PER_S
"""A port that is missing at the start is tried again this much later."""


class Steerer(Protocol):
    """Who steers the stage from outside, as `stage.job.StageSteering`."""

    def filenos(self) -> Sequence[int]: ...

    def act(self, player: Player | None, now_ns: int) -> None:
        """Apply what has arrived; `player` is None between two runs."""

    def on_event(self, event: Event) -> None: ...

    def on_turn(self, player: Player, now_ns: int) -> None: ...

    def note(self, record: Record) -> None:
        """Send what the stage has noted."""

    @property
    def has_stopped(self) -> bool:
        """Whether the stage is to end."""

    @property
    def rate(self) -> float:
        """The rate that it has set; 0: paused."""


@dataclass(slots=True, kw_only=True)
class Options:
    """How a stage is run."""

    is_virtual: bool = False
    is_real_time: bool = False
    may_run: bool = False
    waits_for_port: bool = False
    waits_for_go: bool = False
    start_at: datetime | None = None
    seen: datetime | None = None
    """When the process before this one was seen last."""
    begins: datetime | None = None
    """Virtual time only: the time of day at its beginning."""
    lasts_s: float | None = None
    """Stop after so long; None: when a person stops it."""
    seed: int | None = None
    """Of random choices and of the simulated bus; None: another one each time."""
    more: dict[str, Any] = field(default_factory=dict)
    """Other options of `playing.run.RunOptions`."""
    next_faults: Callable[[int], Sequence[Any]] | None = None
    """Returns the simulated faults of the run that begins at an instant."""


class StageEnd(Struct, frozen=True, kw_only=True):
    """How a stage has ended."""

    runs: int
    error: LssMotionError | None
    """Why it could not begin."""
    last: Result[StageReport] | None = None


class StageRun:
    """All runs of one stage; the observer and the controls of the present one."""

    def __init__(
        self,
        planned: Planned,
        options: Options,
        *,
        steerer: Steerer | None = None,
        note: Callable[[Record], None] | None = None,
        tap: Callable[[int], Tap] | None = None,
        legs: LegSource | None = None,
        outs: Sequence[Out] = (),
    ) -> None:
        """`legs`: the source of its timecode; `outs`: the receivers of the show clock."""
        stage = planned.stage
        self.stage, self.options = stage, options
        self.programs = {name: show.program for name, show in planned.shows.items()}
        self._functions = planned.functions
        self._modules = options.more.get("modules", planned.modules)
        """What a person has agreed to: no run calls what lies beside the shows later."""
        self.robot = robot_of(planned)
        random = Random(options.seed)  # noqa: S311  (which show is next)
        self.director = Director(
            stage,
            infos_of(self.programs),
            random,
            waits_for_go=options.waits_for_go,
            start_at=options.start_at,
            seen=options.seen,
        )
        self.state = "connecting"
        """For operators, while no show plays."""
        self.now_ns = 0
        """The instant of the director: it goes on through all runs."""
        given = stage.sync.timecode
        self.timecode = None if given is None else StageTimecode(given, legs)
        self._sending = Sending(outs)
        self._steerer = steerer
        self._note = note or (lambda _record: None)
        self._tap = tap
        self.ring = Ring(stage.log.ring_s)
        self._offset_ns = 0
        """Added to the clock of the present run."""
        self._playing = NumberedShows()
        self._rate, self._rated_ns = 1.0, 0
        self._is_led = self._must_stop = False
        """Whether the present show follows the timecode; and whether it is to be left, as soon as
        the run has recovered."""
        self._records = Records(stage, self.wall, self._write)
        self.director.cron.begin(self.wall())
        self._must_connect = True
        self._is_relaxing = self._is_over = False
        self._measured_ns = self._sampled_ns = 0
        self._celsius: dict[str, float] = {}
        self._amperes: dict[str, float] = {}
        """The last readings of each servo in this run."""
        self._ring_ns: int | None = None
        self._ticked_ns: int | None = None
        self._clock = MonotonicClock()
        if not options.is_virtual:
            self.now_ns = self._clock.now_ns()
        self._end_ns = None if options.lasts_s is None else self.now_ns + ns_from_s(options.lasts_s)

    def renew(self, planned: Planned, player: Player | None) -> tuple[str, str]:
        """Go on with newer files. Return `renewed`, `busy` or `must_restart`, and a text.

        What the run has opened at its start must be the same: the robot, the timecode, the log.
        Nothing is changed otherwise, or while a show plays.
        """
        director = self.director
        is_changing = player is not None and not director.is_connected
        if not director.is_free or is_changing:
            return "busy", ""
        stage, programs = planned.stage, {n: show.program for n, show in planned.shows.items()}
        sensor, old = TriggerKind.SENSOR, self.stage
        differs = [
            name
            for name, before, after in (
                ("the robot", self.robot, robot_of(planned)),
                ("sync", old.sync, stage.sync),
                ("log", old.log, stage.log),
                ("a sensor of the cues", old.addresses(sensor), stage.addresses(sensor)),
                ("a function of the shows", self._functions, planned.functions),
            )
            if before != after
        ]
        if differs:
            return must_restart(f"another value of {', '.join(differs)}")
        try:
            if player is not None:
                player.repertoire.renew(programs)
        except InputError as refused:
            return must_restart(refused.reason)
        changed = {name for name in programs if programs[name] != self.programs.get(name)}
        self.stage, self.programs = stage, programs
        director.renew(stage, infos_of(programs), changed)
        self._records.renew(stage)
        return renewed(changed)

    # ---- one run after the other

    def play(self, on_result: Callable[[Result[StageReport], int], None] | None = None) -> StageEnd:
        """Begin runs until the stage is over."""
        runs, last = 0, None
        while not self._is_over:
            self._begin_run()
            runs += 1
            began_ns = self.now_ns
            try:
                last = self._perform()
            except (InputError, BusError) as error:
                if not self._after_error(error):
                    return StageEnd(runs=runs, error=error, last=last)
                continue
            finally:
                self._offset_ns = self.now_ns if self.options.is_virtual else 0
            if on_result is not None:
                on_result(last, began_ns)
            if not self._after_run(last):
                return StageEnd(runs=runs, error=last.error, last=last)
        return StageEnd(runs=runs, error=None, last=last)

    def _begin_run(self) -> None:
        self._must_connect = False
        self._playing = NumberedShows()
        self._celsius, self._amperes = {}, {}
        self._rate, self._rated_ns = 1.0, -RATE_EVERY_NS
        self._is_led = self._must_stop = False
        if self.timecode is not None:
            self.timecode.leave()
        self.state = "connecting"
        self.record("connecting", "the servos are checked and set up")

    def _perform(self) -> Result[StageReport]:
        options = self.options
        faults = () if options.next_faults is None else options.next_faults(self.now_ns)
        # Where timecode leads the shows, no sound device does.
        sound = None if self.timecode is None else SoundChoice(leads=False)
        observer = Observer(
            on_event=self.on_event, on_turn=self.on_turn, controls=self, make_tap=self._make_tap
        )
        return perform(
            Repertoire(self.programs, self.robot, watched=self.stage.addresses(TriggerKind.SENSOR)),
            self.robot,
            is_virtual=options.is_virtual,
            is_real_time=options.is_real_time,
            may_run=options.may_run,
            seed=options.seed or 0,
            observer=observer,
            faults=faults,
            **{"sound": sound, "modules": self._modules, **options.more},
        )

    def _make_tap(self, started_ns: int) -> Tap:
        ring: Tap = self.ring.started(started_ns)
        return ring if self._tap is None else Both(ring, self._tap(started_ns))

    def _after_run(self, result: Result[StageReport]) -> bool:
        """Tell the director how a run ended; return whether another one may come."""
        self._obey(None)
        is_relaxed, self._is_relaxing = self._is_relaxing, False
        if self._is_over or (result.error is None and result.player.outcome == "stopped"):
            self._is_over = True
            return False
        if is_relaxed and result.error is None and result.player.outcome == "finished":
            self.director.relaxed(self.now_ns)
            return self._pause("rests")
        if not self.director.is_connected and isinstance(result.error, BusError):
            return self._after_error(result.error)
        cause, text = cause_of(result)
        self._fail(cause, text)
        return self._pause("rests")

    def _after_error(self, error: LssMotionError) -> bool:
        """Return whether the stage goes on after a run that could not begin."""
        if self.director.has_begun:
            cause = Cause.LOST_PORT if isinstance(error, BusError) else None
            self._fail(cause, str(error))
            return self._pause("rests")
        if not self.options.waits_for_port or not isinstance(error, BusError):
            return False
        self.record("waits", f"tries again in {PORT_NS // NS_PER_S} s: {error}")
        self._pause("waits_for_port", self.now_ns + PORT_NS)
        self._must_connect = True
        return not self._is_over

    def _fail(self, cause: Cause | None, text: str) -> None:
        """Keep the bytes before a fault, and tell the director."""
        self._dump_ring()
        self.record("fault", text, cause=None if cause is None else cause.value)
        self.director.faulted(cause, text, self.now_ns)

    def _pause(self, state: str, until_ns: int | None = None) -> bool:
        """Let time pass without a run; return whether one is to begin."""
        self.state = state
        while not self._is_over and not self._must_connect:
            self._turn(None, self.now_ns)
            if until_ns is not None and self.now_ns >= until_ns:
                break
            wakeup_ns = min(self.director.next_wakeup_ns(), until_ns or 1 << 62)
            if self.options.is_virtual:
                self.now_ns = max(wakeup_ns, self.now_ns + 1)
            else:
                self._clock.wait_until(wakeup_ns, self.filenos())
                self.now_ns = self._clock.now_ns()
        self._offset_ns = self.now_ns if self.options.is_virtual else 0
        return not self._is_over

    # ---- controls and observer of a run

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""
        who = (one for one in (self._steerer, self.timecode) if one is not None)
        return [fileno for one in who for fileno in one.filenos()]

    def act(self, player: Player, now_ns: int) -> None:
        """Give the director what has come, and do what it orders."""
        self.now_ns = self._offset_ns + now_ns
        self._turn(player, now_ns)
        if self._is_over and not player.is_finished and player.outcome is None:
            player.stop(now_ns)

    def on_event(self, event: Event) -> None:
        """Tell the director what the player did."""
        if self._steerer is not None:
            self._steerer.on_event(event)
        match event:
            case PhaseEntered(Phase.STANDING) if not self.director.is_connected:
                self.record("connected", "the servos are ready")
                self.director.connected(self.now_ns)
            case ShowBegan():
                self._playing.note_begun(event)
            case ShowOver():
                self._note_over(event.summary)
            case Faulted():
                self.record(
                    "player_fault", str(event), cause=event.kind.value, step=event.step.value
                )
                self._ring_ns = self._ring_ns or self.now_ns + NS_PER_S
            case Warned():
                self.record("warned", event.text)

    def on_turn(self, player: Player, now_ns: int) -> None:
        """Let operators see the run, and others receive the show clock."""
        main = self.director.main
        is_played = main is not None and self._playing.has_begun and not main.is_ready
        self._sending.turn(player, main if is_played else None, now_ns)
        if self._steerer is not None:
            self._steerer.on_turn(player, now_ns)

    def _turn(self, player: Player | None, now_ns: int) -> None:
        director = self.director
        if self._steerer is not None:
            self._steerer.act(player, now_ns)
            self._is_over = self._is_over or self._steerer.has_stopped
        if self._end_ns is not None and self.now_ns >= self._end_ns:
            self._is_over = True
        self._take_timecode()
        if player is not None and not self._is_over:
            self._read(player)
            self._set_rate(player, now_ns)
        if self.now_ns >= director.next_wakeup_ns() or self._ticked_ns is None:
            self._ticked_ns = self.now_ns
            director.tick(self.now_ns, self.wall())
            self.note_counts()
        if self._ring_ns is not None and self.now_ns >= self._ring_ns:
            self._dump_ring()
        if self._is_over or player is None:
            self._obey(None)
            return
        if self.timecode is not None:
            self.timecode.prepare(director, player, self.now_ns, now_ns)
        self._obey(player, now_ns)
        if self.timecode is not None:
            self.timecode.steer(player, now_ns, is_paused=self._wanted_rate == 0.0)

    def _take_timecode(self) -> None:
        """Give the director the timecode."""
        if self.timecode is not None:
            self.timecode.turn(self.director, self.now_ns)
            for text in self.timecode.take_texts():
                self.record("timecode", text)

    @property
    def _wanted_rate(self) -> float:
        """The rate that the operator has set; 0: paused."""
        return 1.0 if self._steerer is None else self._steerer.rate

    def wall(self) -> datetime:
        """Return the time of day."""
        if not self.options.is_virtual:
            return datetime.now(tz=UTC)
        begins = self.options.begins or datetime(2026, 1, 1, 12, 0, tzinfo=UTC)
        return begins + timedelta(microseconds=self.now_ns // 1000)

    def _read(self, player: Player) -> None:
        """Pass on the readings of sensors, and each second the temperatures and currents."""
        for name, value in player.watched.take_readings():
            self.director.signal(
                Signal(kind=TriggerKind.SENSOR, address=name, value=float(value)), self.now_ns
            )
        if self.now_ns < self._measured_ns + MEASURE_NS or player.show is None:
            return
        self._measured_ns = self.now_ns
        if player.show.scheduler is None:
            return
        health = player.show.scheduler.health
        # A show that has just begun has not asked every servo yet.
        self._celsius |= health.temperatures_c
        self._amperes |= health.currents_a
        celsius = [(value, name) for name, value in self._celsius.items()]
        hot: tuple[float | None, str] = max(celsius, default=(None, ""))
        current_a = sum(self._amperes.values()) if self._amperes else None
        self.director.measured(hot[0], current_a, self.now_ns, hot[1])
        if self.now_ns >= self._sampled_ns + SAMPLE_NS:
            self._sampled_ns = self.now_ns
            states = player.show.joint_states.values()
            volts = [one.voltage_min_v for one in states if one.voltage_min_v is not None]
            self.record(
                "sample",
                "",
                hottest_c=hot[0],
                hottest=hot[1],
                current_a=None if current_a is None else round(current_a, 3),
                voltage_min_v=min(volts, default=None),
            )

    # ---- orders

    def _obey(self, player: Player | None, now_ns: int = 0) -> None:
        """Do what the director has ordered; without a player only what needs none."""
        if self._must_stop and player is not None:
            self._stop(player, now_ns)
        while (order := self.director.next_order()) is not None:
            match order:
                case orders.PlayOrder():
                    self._play(order, player, now_ns)
                case orders.StopOrder() if player is not None:
                    self._stop(player, now_ns)
                case orders.RelaxOrder() if player is not None:
                    self._is_relaxing = True
                    player.finish(now_ns)
                case orders.ConnectOrder():
                    self._must_connect = True
                case orders.Note():
                    self._records.note_order(order, self.now_ns)

    def _play(self, order: orders.PlayOrder, player: Player | None, now_ns: int) -> None:
        if player is None:
            self.director.refused(order.number, "the run has ended", self.now_ns)
            return
        program = player.repertoire.programs[order.show]
        try:
            if order.how == "add":
                player.add(program, now_ns, start_s=order.start_s)
                self._playing.added[order.show] = order.number
            else:
                self._change(player, order, now_ns)
        except InputError as refused:
            self.director.refused(order.number, refused.reason, self.now_ns)

    def _stop(self, player: Player, now_ns: int) -> None:
        """Let no show play: at once, or when the run has recovered; one that ends plays none."""
        try:
            self._change(player, None, now_ns)
        except InputError:
            self._must_stop = True

    def _change(self, player: Player, order: orders.PlayOrder | None, now_ns: int) -> None:
        """Play another show in place of all, or none; those that had not begun are over at once."""
        program = None if order is None else player.repertoire.programs[order.show]
        start_s = None if order is None else order.start_s
        place_s = None
        if self.timecode is not None:
            self.timecode.leave()
            if order is not None and program is not None:
                place_s = self.timecode.begin(order, program, player, now_ns, self._offset_ns)
        player.change_to(program, now_ns, start_s=start_s if place_s is None else place_s)
        self._must_stop = False
        was_led = self._is_led
        self._is_led = self.timecode is not None and self.timecode.following is not None
        if was_led or self._is_led:  # It begins paused, and has the rate of its leader then.
            self._rate = 0.0 if self._is_led else self._wanted_rate * self.director.duty.rate
            player.set_rate(self._rate, now_ns)
        for name in self._playing.added.keys() & set(player.added):
            player.end_added(name, now_ns)
        for number, reached_s in self._playing.leave(order):
            self.director.ended(number, "left", reached_s, self.now_ns)

    def _set_rate(self, player: Player, now_ns: int) -> None:
        """Set the rate that budgets and the operator allow together."""
        if self._is_led:
            return
        rate = self._wanted_rate * self.director.duty.rate
        if rate != self._rate and now_ns >= self._rated_ns + RATE_EVERY_NS:
            self._rate, self._rated_ns = rate, now_ns
            player.set_rate(rate, now_ns)

    def _note_over(self, summary: ShowSummary) -> None:
        number = self._playing.note_over(summary)
        if self.timecode is not None and number == self.timecode.number:
            self.timecode.leave()
        worst = max(
            ((joint.error_max_deg, name) for name, joint in summary.joints.items()),
            default=(0.0, ""),
        )
        self.record(
            "over",
            f"{summary.name} {summary.outcome}",
            show=summary.name,
            outcome=summary.outcome,
            played_s=round(s_from_ns(summary.ended_ns - summary.began_ns), 2),
            error_max_deg=worst[0],
            worst=worst[1],
            commands=summary.commands,
            missed=summary.missed,
            late_max_us=summary.late_max_us,
        )
        if number is not None and summary.outcome != "stopped":
            self.director.ended(number, summary.outcome, summary.reached_s, self.now_ns)

    # ---- what is kept

    def record(self, kind: str, text: str, **more: object) -> None:
        """Keep what happened, with the time of day."""
        self._records.note(kind, text, **more)

    def _write(self, record: Record) -> None:
        self._note(record)
        if self._steerer is not None:
            self._steerer.note(record)

    def note_counts(self, *, is_last: bool = False) -> None:
        """Note how often cues were refused, once a minute; at the end what still waited, too."""
        if is_last:
            self._records.note_waiting(self.director, self.now_ns)
        self._records.note_counts(self.now_ns, is_last=is_last)

    def state_of(self) -> Record:
        """Return the whole state, for operators."""
        return {
            "state": state_word(self.director, self.state),
            "timecode": None if self.timecode is None else self.timecode.state_of(self.now_ns),
            **self._records.state_of(self.director, self.now_ns),
        }

    def _dump_ring(self) -> None:
        """Keep the last bytes, and what came in the second after the fault."""
        self._ring_ns = None
        if self.stage.log.ring_s > 0.0:
            name = self.wall().astimezone(self.stage.zone).strftime("%Y%m%d-%H%M%S")
            self._note({"dump": name, "content": self.ring.content()})


def cause_of(result: Result[StageReport]) -> tuple[Cause | None, str]:
    """Return the kind and the text of the fault that ended a run."""
    for fault in reversed(result.player.faults):
        if fault.step in ENDING:
            return fault.kind, str(fault)
    error = result.error
    cause = Cause.LOST_PORT if isinstance(error, BusError) else None
    return cause, "the run has ended" if error is None else str(error)


def robot_of(planned: Planned) -> Robot:
    """Return the robot of a stage, which ends limp if it rests so."""
    robot = next(iter(planned.shows.values())).robot
    return replace(robot, end="limp") if planned.stage.duty.is_limp else robot


def infos_of(programs: Mapping[str, Program]) -> dict[str, ShowInfo]:
    """Return what a director needs to know of shows."""
    return {
        name: ShowInfo(joints=frozenset(one.start_deg), duration_s=one.duration_s)
        for name, one in programs.items()
    }
