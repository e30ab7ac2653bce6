"""Couples the director of a stage with the conductor of its figures. No network, no clock.

    turn(now_ns)       reads the timecode, gives the director the time, and passes its orders on
    take(figure, ask)  a cue or a trigger that came to another figure
    obey(operation)    what an operator asks for

One show plays at a time, on all figures: see `conductor`.
"""

from __future__ import annotations

from datetime import UTC, datetime
from random import Random
from typing import TYPE_CHECKING, Final

from msgspec import Struct
from msgspec.structs import replace

from lss_motion.errors import InputError
from lss_motion.playing.player.following import RUNNING_RATE
from lss_motion.playing.remote import schema as m
from lss_motion.playing.remote import stage_messages as s
from lss_motion.stage import orders
from lss_motion.stage.director import Director
from lss_motion.stage.hosts.conductor import Wish
from lss_motion.stage.job import direct, signal_of
from lss_motion.stage.log import Records, must_restart, renewed, state_word
from lss_motion.stage.stage_timecode import READY_MAX_S
from lss_motion.stage.triggering import JUMP_S
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.playing.player.show_clock import LeaderPosition
    from lss_motion.robot.model import Robot
    from lss_motion.robot.on_fault import Cause
    from lss_motion.stage.hosts.host import Host
    from lss_motion.stage.hosts.messages import Ask, Cast
    from lss_motion.stage.hosts.remote_figures import RemoteFigure
    from lss_motion.stage.log import Record
    from lss_motion.stage.model import Stage
    from lss_motion.stage.stage_timecode import StageTimecode


READY_AHEAD_S: Final = 12.0
"""Figures go to the beginning of a show so long before the timecode comes there."""


class Offer(Struct, frozen=True):
    """A planned show: what each figure plays, and the contents by hash."""

    cast: Cast
    contents: Mapping[str, bytes]


class ConductedStage:
    """The evening of one stage with figures, on the computer of its conductor."""

    def __init__(  # noqa: PLR0913  (what an evening has)
        self,
        stage: Stage,
        offers: Mapping[str, Offer],
        host: Host,
        write: Callable[[Record], None],
        *,
        robot: Robot | None = None,
        timecode: StageTimecode | None = None,
        waits_for_go: bool = False,
        start_at: datetime | None = None,
        seen: datetime | None = None,
        seed: int | None = None,
        plays_first: bool = False,
        wall: Callable[[], datetime] = lambda: datetime.now(tz=UTC),
    ) -> None:
        self.stage, self.conductor = stage, host.conducts
        self.robot, self.timecode = robot, timecode
        """`robot` is that of the conductor's own figure, if newer files may come."""
        self.now_ns = 0
        self._host, self._wall = host, wall
        self._offers = dict(offers)
        self.director = Director(
            stage,
            infos_of(offers),
            Random(seed),  # noqa: S311  (which show is next)
            waits_for_go=waits_for_go,
            start_at=start_at,
            seen=seen,
        )
        self._records = Records(stage, wall, write)
        self.director.cron.begin(wall())
        self._order: orders.PlayOrder | None = None
        """The show that plays, or is about to."""
        self._plays_first = plays_first
        self._offer()
        self.conductor.listener = self

    # ---- what arrives

    def take(self, figure: str, ask: Ask) -> None:
        """Take a cue, a trigger, GO or a stop that came to a figure."""
        match ask.operation:
            case m.Stop():  # The figures know it already.
                self.director.halt(self.now_ns)
            case s.FireCue() | s.Trigger() | m.Go():
                try:
                    signal = signal_of(ask.operation, self.stage)
                except InputError as refused:
                    self.record("note", f"{figure}: {refused.reason}")
                    return
                source = f"{figure}: {signal.source}" if signal.source else figure
                self.director.signal(replace(signal, source=source), self.now_ns)

    def obey(self, operation: m.AnyOperation) -> bool:
        """Carry out what an operator asks for; return whether it is for a stage with figures."""
        conductor, now_ns = self.conductor, self.now_ns
        match operation:
            case m.Pause() | m.Resume():
                conductor.pause(now_ns, is_paused=isinstance(operation, m.Pause))
            case m.Rate() | m.Seek() if self.is_led:
                raise InputError(f"the show follows a leader: {operation.op} has no meaning now")
            case m.Rate():
                conductor.set_rate(operation.ratio, now_ns)
            case m.Seek():
                if not isinstance(operation.to, int | float):
                    raise InputError("a show of several figures goes to a time, not to a label")
                conductor.seek(float(operation.to), now_ns)
            case _:
                return direct(self, operation)
        return True

    # ---- what became of an order (`conductor.Listener`)

    def connected(self, text: str, now_ns: int) -> None:
        """Let the director begin."""
        self.record("connected", text)
        self.director.connected(now_ns)
        if self._plays_first:
            self._plays_first = False
            self.director.play(next(iter(self._offers)), now_ns)

    def refused(self, number: int, reason: str, now_ns: int) -> None:
        """Take that a show cannot be played now."""
        self._order = None
        self.director.refused(number, reason, now_ns)

    def ended(
        self, number: int, outcome: orders.Outcome, show_s: float | None, now_ns: int
    ) -> None:
        """Take that a show is over, or was left for another one."""
        self._order = None
        self.director.ended(number, outcome, show_s, now_ns)

    def faulted(self, cause: Cause, text: str, now_ns: int) -> None:
        """Take that a show ended since figures do not play."""
        self._order = None
        self.record("fault", text)
        self.director.faulted(cause, text, now_ns)

    # ---- each turn

    def turn(self, now_ns: int) -> None:
        """Do what is due."""
        self.now_ns = now_ns
        director = self.director
        if self.timecode is not None:
            self.timecode.turn(director, now_ns)
            for text in self.timecode.take_texts():
                self.record("timecode", text)
            self._follow_timecode(self.timecode)
        if now_ns >= director.next_wakeup_ns():
            director.tick(now_ns, self._wall())
            self._records.note_counts(now_ns)
        while (order := director.next_order()) is not None:
            match order:
                case orders.PlayOrder():
                    self._play(order)
                case orders.StopOrder():
                    self.conductor.leave(now_ns)
                case orders.ConnectOrder():
                    self.conductor.connect(now_ns)
                case orders.Note():
                    self._records.note_order(order, now_ns)

    def _play(self, order: orders.PlayOrder) -> None:
        """Let the conductor play a show instead of the present one."""
        offer, given = self._offers[order.show], self.stage.sync.timecode
        try:
            self._host.keep(offer.contents.values())
        except OSError as error:
            self.conductor.leave(self.now_ns)
            self.director.refused(order.number, str(error), self.now_ns)
            return
        wish = Wish(
            number=order.number,
            cast=offer.cast,
            start_s=order.start_s or 0.0,
            leader=None if order.follows_s is None else self._leader,
            holds_without=given is not None and given.lost == "hold",
        )
        self.conductor.play(wish, self.now_ns)
        self._order = order

    def renew(self, stage: Stage, offers: Mapping[str, Offer]) -> tuple[str, str]:
        """Go on with newer files, as `stage.running.StageRun.renew`."""
        if not self.director.is_free:
            return "busy", ""
        for name in ("figures", "conductor", "network", "sync", "log", "retry"):
            if getattr(self.stage, name) != getattr(stage, name):
                return must_restart(f"another value of {name}")
        changed = {name for name in offers if offers[name] != self._offers.get(name)}
        self.stage, self._offers = stage, dict(offers)
        self._offer()
        self.director.renew(stage, infos_of(offers), changed)
        self._records.renew(stage)
        return renewed(changed)

    def record(self, kind: str, text: str) -> None:
        """Keep what happened, with the time of day."""
        self._records.note(kind, text)

    def _offer(self) -> None:
        """Let figures fetch and verify every show before it is wanted."""
        shows = self._offers.values()
        try:
            for show in shows:
                self._host.keep(show.contents.values())
            self._host.offer([one.cast for one in shows])
        except OSError as error:
            self.record("network", f"the plans cannot be offered yet: {error}")

    def note_counts(self) -> None:
        """Keep what was counted since the last time."""
        self._records.note_waiting(self.director, self.now_ns)
        self._records.note_counts(self.now_ns, is_last=True)

    # ---- the timecode

    @property
    def is_led(self) -> bool:
        """Whether the timecode says where the present show is."""
        return self._order is not None and self._order.follows_s is not None

    def _leader(self) -> LeaderPosition | None:
        """Return the timecode as show time of the present show; None: it does not follow."""
        order = self._order
        if self.timecode is None or order is None or order.follows_s is None:
            return None
        return self.timecode.leader(order.follows_s)

    def _follow_timecode(self, timecode: StageTimecode) -> None:
        """Let the next show wait at its beginning; leave one that the timecode has left."""
        director, order = self.director, self._order
        coming = director.coming(self.now_ns)
        if coming is not None and coming[1] <= READY_AHEAD_S:
            director.get_ready(coming[0], self.now_ns)
        elif order is not None and order.follows_s is not None:
            leader = timecode.leader(order.follows_s)
            duration_s = director.shows[order.show].duration_s
            if leader is None:
                is_left = director.is_ready(order.number) and not director.waits_on(order.number)
            else:
                at_s = leader.at_s(self.now_ns)
                early_s = READY_MAX_S if director.is_ready(order.number) else JUMP_S
                is_left = not -early_s <= at_s <= duration_s + JUMP_S
                is_left = is_left and leader.rate >= RUNNING_RATE
            if is_left:
                self.record("timecode", "timecode: it has left the show")
                director.leave(order.number, self.now_ns)

    # ---- for operators

    def state_of(self) -> Record:
        """Return the whole state: fields of `playing.remote.stage_messages.StageState`."""
        return {
            "state": state_word(self.director, "connecting"),
            "timecode": None if self.timecode is None else self.timecode.state_of(self.now_ns),
            "hosts": tuple(self._host_info(one) for one in self.conductor.figures.values()),
            **self._records.state_of(self.director, self.now_ns),
        }

    def _host_info(self, figure: RemoteFigure) -> Record:
        """Return fields of `playing.remote.stage_messages.HostInfo`."""
        status = figure.status
        is_lost = figure.is_lost(self.now_ns)
        info: Record = {
            "name": figure.name,
            "is_conductor": figure.name == self.conductor.name,
            "state": "not connected" if status is None else "lost" if is_lost else status.state,
            "text": figure.problem or ("" if status is None else status.text),
        }
        if status is None:
            return info
        heard_ns = figure.heard_ns
        return info | {
            "is_good": not is_lost and not figure.problem and status.state != "out",
            "version": status.version,
            "offset_ms": _ms(status.offset_ns),
            "bound_ms": _ms(status.bound_ns),
            "round_trip_ms": _ms(status.round_trip_ns),
            "show_s": status.show_s,
            "off_ms": None if status.off_s is None else round(1000.0 * status.off_s, 2),
            "hottest_c": status.hottest_c,
            "late_ms": None if status.late_us is None else round(status.late_us / 1000.0, 1),
            "heard_s": None if heard_ns is None else round((self.now_ns - heard_ns) / NS_PER_S, 1),
        }


def _ms(span_ns: int | None) -> float | None:
    return None if span_ns is None else round(span_ns / NS_PER_MS, 3)


def infos_of(offers: Mapping[str, Offer]) -> dict[str, orders.ShowInfo]:
    """Return what the director knows of shows."""
    return {
        name: orders.ShowInfo(
            joints=frozenset(one.cast.parts),
            duration_s=float("inf") if one.cast.duration_s is None else one.cast.duration_s,
        )
        for name, one in offers.items()
    }
