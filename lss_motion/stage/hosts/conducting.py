"""Couples the director of a stage with the conductor of its figures. No network, no clock.

    turn(now_ns)       reads the timecode, gives the director the time, and obeys its orders
    take(figure, ask)  a cue or a trigger that came to another figure

One show plays at a time, on all figures. It is loaded, armed and started (`host.Host`), each when
all figures are ready for it; another one begins when all have stopped. A figure that falls while a
show plays leaves the others to `others` first; when it does not come back, the show ends, and the
stage begins again as often as its retry rules allow.
"""

from __future__ import annotations

from datetime import UTC, datetime
from random import Random
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.player.following import RUNNING_RATE
from lss_motion.playing.player.show_clock import Leg
from lss_motion.robot.on_fault import Cause
from lss_motion.stage import orders
from lss_motion.stage.director import Director
from lss_motion.stage.hosts.conductor import LEAD_NS
from lss_motion.stage.model import Kind, Signal
from lss_motion.stage.records import Records, must_restart, renewed, state_word
from lss_motion.stage.stage_timecode import READY_MAX_S
from lss_motion.stage.triggering import JUMP_S
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from lss_motion.stage.hosts.conductor import FigureSeat
    from lss_motion.stage.hosts.host import Host
    from lss_motion.stage.hosts.messages import Ask, Cast
    from lss_motion.stage.model import Stage
    from lss_motion.stage.stage_timecode import StageTimecode

    Record = dict[str, Any]

WITHOUT_S: Final = 10.0
"""With `others: go_on`, figures that cannot take part are waited for so long before a show starts
without them. Chosen: a process that starts again is there in 4 s."""
READY_S: Final = 30.0
"""A show whose figures are not ready by then is refused, with the reasons. Chosen: a plan is
fetched and verified in seconds."""
FALLEN_S: Final = 10.0
"""A show ends so long after a figure fell that does not come back by itself."""
LOST_S: Final = 60.0
"""The same after a figure was lost: its computer may start again. So long, too, a stage with
`others: go_on` waits for all its figures before it begins without some."""
CHASE_NS: Final = NS_PER_S
"""Legs that follow the timecode are so far apart, as each is made a second ahead."""
OFF_S: Final = 1e-3
RATE_OFF: Final = 50e-6
"""The legs follow the timecode when it is further away than this. Chosen: half of the goal of 2 ms;
figures trim the rest away."""
READY_AHEAD_S: Final = 12.0
"""Figures go to the beginning of a show so long before the timecode comes there."""
ARM_LEAD_S: Final = 8.0
"""A show that joins the timecode waits at the place that it reaches so much later, the first time.
Chosen: two figures of five joints need 3 s, eight of 18 on two busy cores 11 s."""
ARM_LEAD_RATIO: Final = 1.3
ARM_LEAD_LEAST_S: Final = 4.0
"""Afterwards it is what the robots needed the last time, with so much room, and the leg's second,
but no less than this, as the way may be longer this time."""

ACTIVE: Final = frozenset({"arming", "armed", "playing", "freewheeling", "holding", "stopping"})
"""States of a figure with a player."""

Phase = Literal["standing", "leaving", "readying", "arming", "playing"]


class Offer(Struct, frozen=True):
    """A planned show: what each figure plays, and the contents by hash."""

    cast: Cast
    contents: Mapping[str, bytes]


class Conducting:
    """The evening of one stage with figures, on the computer of its conductor."""

    def __init__(  # noqa: PLR0913  (what an evening has)
        self,
        stage: Stage,
        offers: Mapping[str, Offer],
        host: Host,
        write: Callable[[Record], None],
        *,
        timecode: StageTimecode | None = None,
        waits_for_go: bool = False,
        start_at: datetime | None = None,
        seed: int | None = None,
        plays_first: bool = False,
        wall: Callable[[], datetime] = lambda: datetime.now(tz=UTC),
    ) -> None:
        assert host.conductor is not None, "the conductor's computer conducts"
        self.stage, self.host, self.conductor = stage, host, host.conductor
        self.timecode = timecode
        self.now_ns = 0
        self._offers = dict(offers)
        self.director = Director(
            stage,
            infos_of(offers),
            Random(seed),  # noqa: S311  (which show is next)
            waits_for_go=waits_for_go,
            start_at=start_at,
        )
        self._wall = wall
        self.records = Records(stage, wall, write)
        self._offer()
        self.phase: Phase = "standing"
        self._since_ns = 0
        self._order: orders.Play | None = None
        """The show that plays, or is about to."""
        self._must_connect = True
        self._connecting_ns: int | None = None
        self._plays_first = plays_first
        self._bad_ns: int | None = None
        """Since when a figure does not play."""
        self._chased_ns = 0

    # ---- what arrives

    def take(self, figure: str, ask: Ask) -> None:
        """Take a cue or a trigger that came to a figure."""
        source = f"{figure}: {ask.source}" if ask.source else figure
        if ask.what == "cue":
            if self.stage.cue(ask.cue) is None:
                self.records.note("note", f"{figure} fires cue {ask.cue!r}, which there is not")
                return
            signal = Signal(kind=Kind.CUE, address=ask.cue, source=source)
        elif ask.what == "go":
            signal = Signal(kind=Kind.GO, source=source)
        else:
            try:
                kind = Kind(ask.kind)
            except ValueError:
                return
            signal = Signal(
                kind=kind, address=ask.cue, value=ask.value, channel=ask.channel, source=source
            )
        self.director.signal(signal, self.now_ns)

    # ---- each turn

    def turn(self, now_ns: int) -> None:
        """Do what is due."""
        self.now_ns = now_ns
        director = self.director
        if self._must_connect and (text := self._connected()):
            self._must_connect, self._connecting_ns = False, None
            self.records.note("connected", text)
            director.connected(now_ns)
            if self._plays_first:
                self._plays_first = False
                director.play(next(iter(self._offers)), now_ns)
        if self.timecode is not None:
            self.timecode.turn(director, now_ns)
            for text in self.timecode.take_texts():
                self.records.note("timecode", text)
            self._follow_timecode(self.timecode)
        if now_ns >= director.next_wakeup_ns():
            director.tick(now_ns, self._wall())
            self.records.note_counts(now_ns)
        self._obey()
        self._step()
        self._obey()

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
        self.records.renew(stage)
        return renewed(changed)

    def _offer(self) -> None:
        """Let figures fetch and verify every show before it is wanted."""
        shows = self._offers.values()
        contents = {name: one for show in shows for name, one in show.contents.items()}
        try:
            self.host.offer([one.cast for one in shows], contents)
        except OSError as error:
            self.records.note("network", f"the plans cannot be offered yet: {error}")

    @property
    def is_led(self) -> bool:
        """Whether the timecode says where the present show is."""
        return self._order is not None and self._order.follows_s is not None

    def note_counts(self) -> None:
        """Keep what was counted since the last time."""
        self.records.note_counts(self.now_ns, is_last=True)

    def _connected(self) -> str:
        """Return that the stage may begin, and with which figures; empty: it waits for some."""
        if self._connecting_ns is None:
            self._connecting_ns = self.now_ns
        absent = self._absent()
        if not absent:
            return "all figures are there"
        is_long = self.now_ns - self._connecting_ns > ns_from_s(LOST_S)
        may_go_without = self.stage.retry.others == "go_on"
        if is_long and may_go_without and len(absent) < len(self.conductor.seats):
            return f"begins without {', '.join(absent)}"
        return ""

    def _absent(self) -> list[str]:
        seats = self.conductor.seats.values()
        return [one.name for one in seats if one.status is None or one.is_lost(self.now_ns)]

    def _obey(self) -> None:
        while (order := self.director.next_order()) is not None:
            match order:
                case orders.Play():
                    self._change(order)
                case orders.Stop():
                    self._change(None)
                case orders.Connect():
                    self._must_connect = True
                case _:
                    self.records.note_order(order, self.now_ns)

    def _change(self, order: orders.Play | None) -> None:
        """Leave what plays, for another show or for none."""
        left, self._order = self._order, order
        if left is not None:
            show_s = self.conductor.show_s(self.now_ns)
            reached_s = left.start_s if show_s is None else max(show_s, 0.0)
            self.director.ended(left.number, "left", reached_s, self.now_ns)
        self._enter("leaving")

    def _enter(self, phase: Phase) -> None:
        self.phase, self._since_ns, self._bad_ns = phase, self.now_ns, None

    def _step(self) -> None:
        match self.phase:
            case "leaving":
                self._leave()
            case "readying":
                self._make_ready()
            case "arming":
                self._arm()
            case "playing":
                self._look_after()

    def _leave(self) -> None:
        """Stop all figures, and load the next show when they stand."""
        if self.conductor.wanted == "armed":
            self.host.stop()
            return
        seats = self.conductor.seats.values()
        if any(
            one.status is not None and not one.is_lost(self.now_ns) and one.status.state in ACTIVE
            for one in seats
        ):
            return
        if self._order is None:
            self._enter("standing")
            return
        offer = self._offers[self._order.show]
        try:
            self.host.load(offer.cast, offer.contents)
        except (InputError, OSError) as error:
            self._refuse(str(error))
        else:
            self._enter("readying")

    def _make_ready(self) -> None:
        assert self._order is not None
        problems = self.host.problems()
        if problems:
            if self.now_ns - self._since_ns > ns_from_s(READY_S):
                self._refuse("; ".join(problems))
            return
        absent = self.conductor.absent(self.now_ns)
        if absent != self.conductor.absent(self.now_ns, ns_from_s(WITHOUT_S)):
            return  # Some may be back in a moment.
        place_s = self._order.start_s or 0.0
        if (leader := self._leader()) is not None and leader.rate >= RUNNING_RATE:
            place_s = max(leader.at_s(self.now_ns + ns_from_s(self._arm_lead_s())), 0.0)
        try:
            self.host.go(place_s, self._leader if self.is_led else None)
        except InputError as refused:
            self._refuse(str(refused))
        else:
            self._enter("arming")

    def _arm_lead_s(self) -> float:
        """Return how far ahead of the timecode the robots wait for it."""
        armed_s = self.host.armed_s
        if armed_s is None:
            return ARM_LEAD_S
        return max(ARM_LEAD_LEAST_S, ARM_LEAD_RATIO * armed_s + s_from_ns(LEAD_NS))

    def _arm(self) -> None:
        assert self._order is not None
        if self.conductor.leg is not None:
            self._enter("playing")
        elif self.conductor.wanted != "armed":
            fallen = self._fallen()
            if fallen:
                self._fail(fallen)
            else:
                self._refuse("; ".join(self.host.problems()) or "the start was given up")

    def _refuse(self, reason: str) -> None:
        assert self._order is not None
        order, self._order = self._order, None
        self._enter("standing")
        self.director.refused(order.number, reason, self.now_ns)

    # ---- while it plays

    def _look_after(self) -> None:
        """Notice the end of the show, and figures that do not play; follow the timecode."""
        assert self._order is not None
        conductor, order = self.conductor, self._order
        if conductor.wanted != "armed" or conductor.leg is None:
            self._order = None
            self._enter("standing")
            is_finished = conductor.wanted == "ready"
            self.director.ended(
                order.number, "finished" if is_finished else "left", None, self.now_ns
            )
            return
        self._chase()
        fallen = self._fallen()
        bad = fallen or [one for one in self._cast() if one.problem]
        is_enough = self.stage.retry.others == "go_on" and len(bad) < len(self._cast())
        if not bad or is_enough:
            self._bad_ns = None
            return
        self._bad_ns = self._bad_ns or self.now_ns
        limit_s = FALLEN_S if fallen else LOST_S
        if self.now_ns - self._bad_ns > ns_from_s(limit_s):
            self._fail(bad)

    def _cast(self) -> list[FigureSeat]:
        cast = self.conductor.cast
        seats = self.conductor.seats
        return [] if cast is None else [seats[name] for name in cast.parts if name in seats]

    def _fallen(self) -> list[FigureSeat]:
        """Return the figures whose player has ended with a fault."""
        return [
            one
            for one in self._cast()
            if one.status is not None
            and not one.is_lost(self.now_ns)
            and one.status.state == "stopped"
            and one.status.run == self.conductor.run
            and one.status.cause
        ]

    def _fail(self, seats: list[FigureSeat]) -> None:
        """End the show for all; the director decides about another attempt."""
        texts, causes = [], []
        for seat in seats:
            status = seat.status
            cause = "" if status is None or seat.is_lost(self.now_ns) else status.cause
            causes.append(Cause(cause) if cause in list(Cause) else Cause.LOST_PORT)
            texts.append(f"{seat.name}: {seat.problem or (status.text if status else '')}")
        text = "; ".join(texts)
        self.records.note("fault", text)
        self._order = None
        self._enter("leaving")
        self.director.faulted(causes[0], text, self.now_ns)

    # ---- the timecode

    def _leader(self) -> Leg | None:
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
            duration_s = self._duration_s(order)
            if leader is None:
                is_left = director.is_ready(order.number) and not director.waits_on(order.number)
            else:
                at_s = leader.at_s(self.now_ns)
                early_s = READY_MAX_S if director.is_ready(order.number) else JUMP_S
                is_left = not -early_s <= at_s <= duration_s + JUMP_S
                is_left = is_left and leader.rate >= RUNNING_RATE
            if is_left:
                self.records.note("timecode", "timecode: it has left the show")
                director.leave(order.number, self.now_ns)

    def _duration_s(self, order: orders.Play) -> float:
        return self.director.shows[order.show].duration_s

    def _chase(self) -> None:
        """Make another leg where the timecode has left the present one."""
        leg, now_ns = self.conductor.leg, self.now_ns
        order, given = self._order, self.stage.sync.timecode
        if order is None or order.follows_s is None or leg is None or given is None:
            return
        leader = self._leader()
        if leader is None and given.lost == "hold":
            leader = Leg(now_ns, leg.at_s(now_ns), 0.0)
        if leader is None or now_ns < self._chased_ns + CHASE_NS:
            return
        at_ns = max(now_ns, leg.instant_ns) + CHASE_NS
        rate = leader.rate if leader.rate >= RUNNING_RATE else 0.0
        if rate == leg.rate == 0.0:
            return  # Both stand: figures rejoin when it runs again.
        off_s = leader.at_s(at_ns) - leg.at_s(at_ns)
        if abs(off_s) <= OFF_S and abs(rate - leg.rate) <= RATE_OFF:
            return
        self._chased_ns = now_ns
        self.conductor.trim(leader.instant_ns, leader.show_s, rate, now_ns)

    # ---- for operators

    def state_of(self) -> Record:
        """Return the whole state: fields of `playing.remote.stage_messages.StageState`."""
        return {
            "state": state_word(self.director, "connecting"),
            "timecode": None if self.timecode is None else self.timecode.state_of(self.now_ns),
            "hosts": tuple(self._host_info(one) for one in self.conductor.seats.values()),
            **self.records.state_of(self.director, self.now_ns),
        }

    def _host_info(self, seat: FigureSeat) -> Record:
        """Return fields of `playing.remote.stage_messages.HostInfo`."""
        status = seat.status
        is_lost = seat.is_lost(self.now_ns)
        info: Record = {
            "name": seat.name,
            "is_conductor": seat.name == self.conductor.name,
            "state": "not connected" if status is None else "lost" if is_lost else status.state,
            "text": seat.problem or ("" if status is None else status.text),
        }
        if status is None:
            return info
        heard_ns = seat.heard_ns
        return info | {
            "is_good": not is_lost and not seat.problem and status.state != "out",
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
