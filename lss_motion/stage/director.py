"""Decides which show plays: cues, start modes, priorities, the queue, the rest. Pure.

    signal(signal, now_ns)      takes what arrived from outside
    tick(now_ns, wall)          takes the time; `wall` only for times of day
    connected, ended, refused,
    faulted, measured           take what the player did
    next_wakeup_ns()            returns when `tick` must be called at the latest
    next_order()                returns what is to be done, and what is to be noted; oldest first

No clock, port, thread or random number of its own: the same calls give the same orders. Every
trigger ends in one note: its cue has fired, or was refused, with the reason.

Law: at most one main show plays, and shows beside it on joints of their own. An order is taken for
done until `ended` or `refused` says otherwise; both name the number of the show, so that a late
answer about a show that was left is never taken for the next one.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.errors import InputError
from lss_motion.files.texts import known_names
from lss_motion.stage import orders
from lss_motion.stage.duty import Duty, Reason
from lss_motion.stage.model import CueTrigger, Signal, StageCue, TriggerKind
from lss_motion.stage.orders import OrderedShow, ShowInfo, WaitingShow, not_played
from lss_motion.stage.triggering import FREEWHEEL_S, Bags, CronClock, TimecodeCues, Triggers
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Mapping
    from datetime import datetime
    from random import Random

    from lss_motion.robot.on_fault import Cause
    from lss_motion.stage.file import StartMode
    from lss_motion.stage.model import Stage

DEBOUNCE_NS: Final = 300 * NS_PER_MS
"""A cue that was triggered so shortly before is one press of a button. Chosen: contacts bounce for
tens of milliseconds, and two hands press GO within a third of a second."""

QUEUE_MAX: Final = 16
"""Chosen: more waiting shows than an operator overlooks."""

LEFT_MAX: Final = 4
"""Shows that were interrupted and wait to be resumed. Chosen: an interruption of an interruption is
rare."""

TICK_NS: Final = NS_PER_S
"""The wall clock may be set at any time, so it is looked at every second."""

AGAIN_NS: Final = 5 * NS_PER_S
"""After an idle or rest show was refused, it is tried again this much later."""

OPERATOR: Final = "operator"
OPERATOR_PRIORITY: Final = 100
ENDLESS_S: Final = float("inf")


class Director:
    """The shows and cues of one stage, or of one figure of it."""

    def __init__(
        self,
        stage: Stage,
        shows: Mapping[str, ShowInfo],
        random: Random,
        *,
        waits_for_go: bool = False,
        start_at: datetime | None = None,
        seen: datetime | None = None,
    ) -> None:
        """Direct `stage`, from GO or `start_at` on; `seen`: the end of the process before."""
        self.stage = stage
        self.duty = Duty(stage)
        self.shows = dict(shows)
        self.main: OrderedShow | None = None
        self.added: list[OrderedShow] = []
        self.queue: list[WaitingShow] = []
        self.left: list[WaitingShow] = []
        self.is_connected = False
        self.enabled = {cue.name: cue.is_enabled for cue in stage.cues}
        self.armed: str | None = None
        self._bags = Bags(random)
        self._triggers = Triggers(stage.cues)
        self.cron = CronClock(stage.addresses(TriggerKind.TIME), stage.zone, seen)
        given = stage.sync.timecode
        freewheel_s = FREEWHEEL_S if given is None else given.freewheel_s
        self.timecode = TimecodeCues(stage.cues, self._durations_s(), freewheel_s)
        self._orders: deque[orders.Order | orders.Note] = deque()
        self._leaving: dict[int, OrderedShow] = {}
        self._until_ns: dict[str, int | None] = {}
        """End of the cooldown by cue; None: its show waits or plays."""
        self._fired_ns: dict[str, int] = {}
        """When each cue has fired last; GO is ``."""
        self._number = 0
        self._now_ns = self._ticked_ns = 0
        self.has_begun = False
        """Whether the robot was connected once."""
        self._rests = False
        """Whether the way to the rest was ordered."""
        self._must_connect = self._is_limp = False
        self._reasons: tuple[str, ...] = ()
        self._rate = 1.0
        self._again_ns: int | None = None
        self._is_halted = False
        """Whether a person has stopped all: the idle show waits until something is played."""
        if waits_for_go:
            self.duty.begin(Reason.GO)
        if start_at is not None:
            self.duty.start_at = start_at
            self.duty.begin(Reason.START_AT, f"({start_at:%Y-%m-%d %H:%M:%S})")

    def renew(self, stage: Stage, shows: Mapping[str, ShowInfo], changed: set[str]) -> None:
        """Go on with newer files, while the figure `is_free`; of these shows they have new ones."""
        self.stage, self.shows = stage, dict(shows)
        self.enabled = {c.name: self.enabled.get(c.name, c.is_enabled) for c in stage.cues}
        self.armed = self.armed if stage.cue(self.armed or "") is not None else None
        self.duty.renew(stage)
        self._bags.forget()
        self._triggers.cues = stage.cues
        self.cron.watch(stage.addresses(TriggerKind.TIME), stage.zone)
        self.timecode.renew(stage.cues, self._durations_s())
        is_same = self.main is None or (self.main.show == stage.idle and stage.idle not in changed)
        if not is_same and not self._rests:
            self._stop_all()
        self._settle()

    def _durations_s(self) -> dict[str, float]:
        return {name: info.duration_s for name, info in self.shows.items()}

    @property
    def is_free(self) -> bool:
        """Whether nothing plays for a cue, or will: what waits for timecode may be left."""
        return not (self._playing() or self.queue or self.left)

    # ---- what is to be done

    def _note(self, text: str, kind: str = "note", **fields: object) -> None:
        self._orders.append(orders.Note(text, kind, fields))

    def next_order(self) -> orders.Order | orders.Note | None:
        return self._orders.popleft() if self._orders else None

    def next_wakeup_ns(self) -> int:
        """Return when `tick` must be called at the latest."""
        soon = [self._ticked_ns + TICK_NS, self.duty.next_ns(), self.timecode.next_ns()]
        return max(self._now_ns, min(ns for ns in soon if ns is not None))

    # ---- the time

    def tick(self, now_ns: int, wall: datetime) -> None:
        """Do what is due."""
        self._now_ns = self._ticked_ns = now_ns
        is_moving = bool(self.added) or (self.main is not None and not self.main.is_ready)
        self.duty.tick(now_ns, wall, self.cron.local(wall), is_moving=is_moving)
        self._note_rest()
        self.cron.begin(wall)
        expressions, text = self.cron.due(wall) if self.has_begun else ([], "")
        if text:
            self._note(text)
        for expression in expressions:
            self.signal(Signal(kind=TriggerKind.TIME, address=expression), now_ns)
        for cue, start_s in self.timecode.tick(now_ns):
            self._by_timecode(cue, start_s)
        self._settle()

    def take_timecode(self, at_s: float | None, rate: float, now_ns: int, song: str = "") -> None:
        """Take a position of the timecode, its offset included, and the song; None: it is lost."""
        self._now_ns = now_ns
        for cue, start_s in self.timecode.take(at_s, rate, now_ns, song):
            self._by_timecode(cue, start_s)

    def _by_timecode(self, cue: StageCue, start_s: float | None) -> None:
        main, signal = self.main, Signal(kind=TriggerKind.TIMECODE, address=cue.on.address)
        if main is not None and main.cue is cue and main.is_ready:
            main.is_ready = False
            main.since_ns = self._now_ns
            self._until_ns[cue.name] = None
            self._note_fired(cue, signal, f"plays {main.show}, in step")
            self._note_fire(cue)
            return
        if main is not None and main.is_ready:
            self.leave(main.number, self._now_ns)
        if start_s is not None and main is not None and main.cue is cue:
            return  # It follows the jump itself.
        self._fire(cue, signal, start_s)
        self._settle()

    def get_ready(self, cue: StageCue, now_ns: int) -> None:
        """Let the show of a cue, as of `coming`, wait at its beginning for the timecode."""
        self._now_ns, show = now_ns, cue.shows[0]
        self._note(f"waits at the beginning of {show} (cue {cue.name})")
        self._play(show, cue, waits=True)

    def coming(self, now_ns: int) -> tuple[StageCue, float] | None:
        """Return the cue whose show follows the timecode next, and the seconds up to it.

        None: there is none, or another cue plays. 0 s: it is to wait, since there is no timecode.
        """
        is_idle = self.main is None or self.main.cue is None
        if not (is_idle and self.is_free and self.is_connected):
            return None
        found = self.timecode.coming(now_ns)
        if found is None and not self.timecode.has_position:
            armed = self.stage.cue(self.armed or "")
            ready = (cue for cue in self.stage.cues if cue.is_ready)
            cue = armed if armed is not None and armed.can_wait else next(ready, None)
            found = None if cue is None else (cue, 0.0)
        if found is None or found[0].shows[0] not in self.shows or self._refusal(found[0]):
            return None
        return found

    # ---- signals and operators

    def signal(self, signal: Signal, now_ns: int) -> None:
        """Fire the cues that a signal triggers, or refuse them."""
        self._now_ns = now_ns
        if signal.kind is TriggerKind.GO:
            self._go(signal)
        else:
            for cue in self._triggers.triggered(signal):
                self._fire(cue, signal)
        self._settle()

    def arm(self, name: str) -> None:
        """Make a cue the next one of GO."""
        self.armed = self._known(name).name
        self._note(f"cue {name} is next on GO")

    def enable(self, name: str, *, is_enabled: bool) -> None:
        """Let a cue fire, or not."""
        self.enabled[self._known(name).name] = is_enabled
        self._note(f"cue {name} {'enabled' if is_enabled else 'disabled'}")

    def play(self, show: str, now_ns: int, start: StartMode = "terminate") -> None:
        """Play a show for an operator."""
        if show not in self.shows:
            raise InputError(f"no show {show!r}; {known_names(show, self.shows)}")
        cue = StageCue(
            name=OPERATOR,
            on=CueTrigger(kind=TriggerKind.CUE),
            shows=(show,),
            start=start,
            priority=OPERATOR_PRIORITY,
        )
        self._now_ns = now_ns
        self._fire(cue, Signal(kind=TriggerKind.CUE, address=show, source=OPERATOR))
        self._settle()

    def do(self, deed: Literal["stop", "rest", "wake"], now_ns: int) -> None:
        """Stop all shows, go to rest or wake, for an operator."""
        self._now_ns = now_ns
        self._do(deed)
        self._settle()

    def halt(self, now_ns: int) -> None:
        """Stop all shows for a person; the idle show waits for GO, a cue or `wake`."""
        self._is_halted = True
        self.do("stop", now_ns)

    def leave(self, number: int, now_ns: int) -> None:
        """Leave the show of that number: what it follows is elsewhere."""
        self._now_ns = now_ns
        if self.main is not None and self.main.number == number:
            self._stop_all()
            self._settle()

    def is_ready(self, number: int) -> bool:
        """Return whether the show of that number waits for the timecode."""
        return self.main is not None and self.main.number == number and self.main.is_ready

    def waits_on(self, number: int) -> bool:
        """Return whether that show waits also while there is no timecode."""
        cue = self.main.cue if self.main is not None and self.is_ready(number) else None
        return cue is not None and (cue.is_ready or cue.name == self.armed)

    def next_go(self) -> str | None:
        """Return the cue that GO fires; None: there is none."""
        goes = [cue.name for cue in self.stage.cues if cue.on.kind is TriggerKind.GO]
        return self.armed or next(iter(goes), None)

    def _known(self, name: str) -> StageCue:
        cue = self.stage.cue(name)
        if cue is None:
            known = known_names(name, [cue.name for cue in self.stage.cues])
            raise InputError(f"no cue {name!r}; {known}")
        return cue

    def _go(self, signal: Signal) -> None:
        name = self.next_go()
        if self._has_bounced(""):
            self._refuse(name or "GO", signal, "GO was pressed just before")
            return
        self._fired_ns[""] = self._now_ns
        if Reason.GO in self.duty.reasons:
            self.duty.end(Reason.GO)
            self._note("GO: the stage begins")
        elif name is None and self._is_halted:
            self._is_halted = False
            self._note("GO: the stage goes on")
        elif name is None:
            self._refuse("GO", signal, "no cue waits for GO, and none is armed")
        elif self._fire(self._known(name), signal):
            goes = [cue.name for cue in self.stage.cues if cue.on.kind is TriggerKind.GO]
            after = goes[goes.index(name) + 1 :] if name in goes else goes
            self.armed = next(iter(after or goes), None)

    # ---- what the player did

    def connected(self, now_ns: int) -> None:
        """Note that the servos were checked and stand ready."""
        self._now_ns = now_ns
        self.is_connected, self._is_limp = True, False
        self.duty.end(Reason.RETRY)
        self._note_rest()
        if not self.has_begun:
            self.has_begun = True
            self.signal(Signal(kind=TriggerKind.START), now_ns)
        self._settle()
        for cue, start_s in self.timecode.under_way(now_ns):
            self._by_timecode(cue, start_s)

    def ended(
        self, number: int, outcome: orders.Outcome, show_s: float | None, now_ns: int
    ) -> None:
        """Note that a show is over; `show_s`: the show time that it had reached."""
        self._now_ns = now_ns
        if (gone := self._leaving.pop(number, None)) is not None:
            self._note_end(gone, outcome if outcome == "fault" else "left")
            if gone.resumes:
                self._keep_place(gone, show_s)
            return
        over = self._taken(number)
        if over is None:
            return
        self._note_end(over, outcome)
        if outcome == "finished":
            if over.is_rest and self.stage.duty.is_limp and self._rests:
                self._orders.append(orders.RelaxOrder())
            self.signal(Signal(kind=TriggerKind.END_OF, address=over.show), now_ns)
        self._settle()

    def refused(self, number: int, reason: str, now_ns: int) -> None:
        """Note that a show cannot be played now."""
        self._now_ns = now_ns
        over = self._taken(number)
        if over is None:
            return
        if over.is_rest:
            self._orders.append(orders.StopOrder())
        if over.cue is None:
            self._again_ns = now_ns + AGAIN_NS
            self._note(f"show {over.show} cannot be played now: {reason}")
        else:
            self._cool_down(over.cue)
            self._orders.append(not_played(over.cue, over.show, reason))
        self._settle()

    def faulted(self, cause: Cause | None, text: str, now_ns: int) -> None:
        """Note a fault that ended the run: nothing plays, and the robot is safe."""
        self._now_ns = now_ns
        self.is_connected, self._must_connect = False, True
        for over in [*self._ordered, *self._leaving.values()]:
            self._note_end(over, "fault")
        self.main, self.added, self._rests = None, [], False
        self._leaving.clear()
        self._drop_waiting()
        begins_again = self.duty.failed(cause, now_ns)
        kind = "fault" if begins_again else "given_up"
        after = self.duty.reasons[Reason.RETRY if begins_again else Reason.FAULT]
        self._note(f"{text}; {after}", "alert", alert=kind)
        self._note_rest()

    def relaxed(self, now_ns: int) -> None:
        """Note that the servos are limp in the rest pose, and the run has ended for that."""
        self._now_ns = now_ns
        self.is_connected, self._must_connect = False, True
        self.main, self.added, self._rests = None, [], False
        self._is_limp = True
        self._leaving.clear()
        self.duty.relax(now_ns)
        self._note("the servos are limp")

    def measured(
        self, temperature_c: float | None, current_a: float | None, now_ns: int, who: str = ""
    ) -> None:
        """Take the temperature of the hottest servo and the current of all of them."""
        self._now_ns = now_ns
        self.duty.measured(temperature_c, current_a, now_ns, who)
        if self.duty.rate != self._rate:
            self._rate = self.duty.rate
            self._note(f"plays at {self._rate:.0%} of its speed, by budget")
        self._settle()

    def _taken(self, number: int) -> OrderedShow | None:
        """Return the show of that number, which plays no more; None: it did not play."""
        if self.main is not None and self.main.number == number:
            over, self.main = self.main, None
            return over
        for added in self.added:
            if added.number == number:
                self.added.remove(added)
                return added
        return None

    def _keep_place(self, over: OrderedShow, show_s: float | None) -> None:
        """Keep where an interrupted show was, if it still waits to be resumed."""
        for waiting in self.left:
            if waiting.cue is over.cue and waiting.show_s is None:
                waiting.show_s = show_s

    def _note_end(self, over: OrderedShow, outcome: orders.Outcome) -> None:
        played_s = s_from_ns(self._now_ns - over.since_ns)
        text = f"show {over.show} {outcome} after {played_s:.1f} s"
        self._note(text, "ended", show=over.show, outcome=outcome)
        if over.cue is not None and not over.resumes and not over.is_ready:
            self._cool_down(over.cue)

    def _cool_down(self, cue: StageCue) -> None:
        self._until_ns[cue.name] = self._now_ns + ns_from_s(cue.cooldown_s)

    # ---- cues

    def _fire(self, cue: StageCue, signal: Signal, start_s: float | None = None) -> bool:
        """Do what a cue says, or refuse it; return whether it has fired."""
        if reason := self._refusal(cue) or (self._start(cue, signal, start_s) if cue.shows else ""):
            self._refuse(cue.name, signal, reason)
            return False
        if not cue.shows:
            self._note_fired(cue, signal, cue.deed or "enables, disables")
        self._note_fire(cue)
        return True

    def _note_fire(self, cue: StageCue) -> None:
        """Do what a cue that fires does besides its show."""
        self._fired_ns[cue.name] = self._now_ns
        self._is_halted = self._is_halted and not cue.shows
        if self.armed == cue.name and cue.follows:
            self.armed = None
        for name in (*cue.enables, *cue.disables):
            self.enable(name, is_enabled=name in cue.enables)
        if cue.deed is not None:
            self._do(cue.deed)

    def _refusal(self, cue: StageCue) -> str:
        """Return why a cue cannot fire, whatever plays; empty if it can."""
        if not self.enabled.get(cue.name, True):
            return "it is disabled"
        if self._has_bounced(cue.name):
            return "it has fired just before"
        if not cue.shows:
            return ""
        if self.duty.reasons:
            return "the figure rests: " + ", ".join(self.duty.reasons.values())
        if not self.is_connected:
            return "the robot is not connected"
        until_ns = self._until_ns.get(cue.name, 0)
        if cue.cooldown_s > 0.0 and until_ns is None:
            return "its show waits or plays, and it has a cooldown"
        if until_ns is not None and self._now_ns < until_ns:
            return f"cooldown, for another {s_from_ns(until_ns - self._now_ns):.1f} s"
        return ""

    def _has_bounced(self, name: str) -> bool:
        fired_ns = self._fired_ns.get(name)
        return fired_ns is not None and self._now_ns - fired_ns < DEBOUNCE_NS

    def _start(self, cue: StageCue, signal: Signal, start_s: float | None) -> str:
        """Play or queue the next show of a cue; return why that is not possible, or nothing."""
        show, main = self._bags.next(cue), self.main
        if show not in self.shows:
            return f"show {show} cannot be played: its file has faults"
        playing = self._playing()
        start = cue.start
        if start == "restart" and (main is None or main.cue is None or main.show != show):
            start = "only_if_idle"
        match start:
            case "queue" if playing or self.queue:
                reason = self._why_not_queued(cue)
            case "add" if main is not None or self.added:
                reason = self._why_not_added(show)
            case "only_if_idle" if playing:
                reason = f"{playing[0].show} plays"
            case "interrupt" if main is not None and main in playing:
                reason = self._why_not_left(cue, main)
            case _:
                reason = self._outranked(cue)
        if reason:
            return reason
        self._bags.take(cue)
        self._until_ns[cue.name] = None
        self._apply(start, show, cue, signal, start_s)
        return ""

    def _apply(
        self, start: StartMode, show: str, cue: StageCue, signal: Signal, start_s: float | None
    ) -> None:
        """Do what a start mode says, after all that could refuse it."""
        main = self.main
        if start == "queue" and (self._playing() or self.queue):
            self.queue.append(WaitingShow(show, cue))
            self._note_fired(cue, signal, f"{show} is queued")
            return
        self._note_fired(cue, signal, f"plays {show}, {start}")
        if start == "terminate":
            self._drop_waiting()
        if start == "interrupt" and main is not None and main in self._playing():
            assert main.cue is not None
            main.resumes = True
            self.left.append(WaitingShow(main.show, main.cue))
        is_beside = start == "add" and (main is not None or self.added)
        how: orders.How = "add" if is_beside else "change"
        self._play(show, cue, how=how, start_s=start_s)

    def _playing(self) -> list[OrderedShow]:
        """Return the shows that play for a cue, or will when the timecode that runs comes there."""
        main = self.main
        if main is None or main.cue is None:
            return [*self.added]
        is_waiting = main.is_ready and not self.timecode.is_running(self._now_ns)
        return [*self.added] if is_waiting else [main, *self.added]

    @property
    def _ordered(self) -> list[OrderedShow]:
        return [*filter(None, [self.main]), *self.added]

    def _outranked(self, cue: StageCue) -> str:
        for playing in self._playing():
            if playing.priority > cue.priority:
                return f"{playing.show} plays with priority {playing.priority}"
        return ""

    def _why_not_queued(self, cue: StageCue) -> str:
        if any(waiting.cue is cue for waiting in self.queue):
            return "it is in the queue"
        if len(self.queue) >= QUEUE_MAX:
            return f"{QUEUE_MAX} shows are in the queue"
        return ""

    def _why_not_added(self, show: str) -> str:
        for playing in self._ordered:
            shared = self.shows[playing.show].joints & self.shows[show].joints
            if playing.show == show:
                return f"{show} plays"
            if shared:
                return f"{', '.join(sorted(shared))} in use by {playing.show}"
        return ""

    def _why_not_left(self, cue: StageCue, main: OrderedShow) -> str:
        if main.cue is cue:
            return f"{main.show} plays for it"
        if len(self.left) >= LEFT_MAX:
            return f"{LEFT_MAX} shows wait to be resumed"
        return self._outranked(cue)

    def _note_fired(self, cue: StageCue, signal: Signal, what: str) -> None:
        self._note(f"cue {cue.name}: {what} ({signal.text})", "fired", cue=cue.name, what=what)

    def _refuse(self, name: str, signal: Signal, reason: str) -> None:
        text = f"cue {name} refused: {reason} ({signal.text})"
        self._note(text, "refused", cue=name, reason=reason)

    # ---- what plays

    def _play(
        self,
        show: str,
        cue: StageCue | None,
        *,
        how: orders.How = "change",
        start_s: float | None = None,
        is_rest: bool = False,
        waits: bool = False,
    ) -> None:
        """Order a show, in place of all others or beside them."""
        self._number += 1
        playing = OrderedShow(
            number=self._number,
            show=show,
            cue=cue,
            since_ns=self._now_ns,
            is_rest=is_rest,
            is_ready=waits,
        )
        if how == "add":
            self.added.append(playing)
        else:
            self._leave_all()
            self.main = playing
        is_led = waits or (
            cue is not None and cue.start != "add" and self.timecode.is_within(cue, self._now_ns)
        )
        order = orders.PlayOrder(
            number=self._number,
            show=show,
            how=how,
            start_s=start_s,
            follows_s=cue.on.at_s if cue is not None and is_led else None,
            waits=waits,
        )
        self._orders.append(order)
        cause = "the rest" if is_rest else "idle" if cue is None else f"cue {cue.name}"
        self._note(f"show {show} for {cause}", "started", show=show, cause=cause)

    def _stop_all(self) -> None:
        self._leave_all()
        self._orders.append(orders.StopOrder())

    def _leave_all(self) -> None:
        for playing in self._ordered:
            self._leaving[playing.number] = playing
        self.main, self.added = None, []

    def _drop_waiting(self) -> None:
        """Forget the shows that are queued, and those that were to be resumed."""
        for waiting in (*self.queue, *self.left):
            self._note(f"show {waiting.show} of {waiting.cue.name} dropped")
            self._cool_down(waiting.cue)
        self.queue, self.left = [], []

    def _do(self, deed: Literal["stop", "rest", "wake"]) -> None:
        match deed:
            case "stop":
                self._drop_waiting()
                self._stop_all()
            case "rest":
                self.duty.begin(Reason.OPERATOR)
            case "wake":
                self._is_halted = False
                self.duty.wake()

    # ---- what comes next

    def _settle(self) -> None:
        """Go to rest, or on to the next show, if nothing else is under way."""
        self._note_rest()
        if not self.is_connected:
            is_waiting = bool(self._is_limp and self.duty.reasons)
            is_waiting |= bool(self.duty.reasons.keys() & {Reason.RETRY, Reason.FAULT})
            if self._must_connect and not is_waiting:
                self._must_connect = False
                self._orders.append(orders.ConnectOrder())
            return
        if self.duty.reasons:
            self._go_to_rest()
            return
        self._rests = False
        main = self.main
        is_idle = main is None or main.cue is None or main.is_ready
        is_free = main is None or main.is_rest or (is_idle and bool(self.queue))
        if is_free and not self.added and self.has_begun:
            self._next()

    def _go_to_rest(self) -> None:
        """Go to the rest once; a show that may end by itself is played to its end."""
        playing = self._playing()
        is_ending = all(self.shows[one.show].duration_s < ENDLESS_S for one in playing)
        if self._rests or (playing and is_ending and not self.duty.is_urgent):
            return
        self._rests = True
        self._drop_waiting()
        is_first = self.main is None and self._number == 0
        if is_first and self.duty.reasons.keys() <= {Reason.GO, Reason.START_AT}:
            return  # It stands as it was found until it begins.
        rest = self.stage.duty.rest
        if rest in self.shows:
            assert rest is not None
            self._play(rest, None, is_rest=True)
        elif self.main is not None or self.added:
            self._stop_all()

    def _next(self) -> None:
        """Resume what was interrupted, then play what is queued, then the idle show."""
        idle = self.stage.idle
        if self.left:
            waiting = self.left.pop()
            self._play(waiting.show, waiting.cue, start_s=waiting.show_s)
        elif self.queue:
            waiting = max(self.queue, key=lambda one: one.cue.priority)  # The oldest of equals.
            self.queue.remove(waiting)
            self._play(waiting.show, waiting.cue)
        elif self._is_halted:
            return
        elif idle in self.shows and (self._again_ns is None or self._now_ns >= self._again_ns):
            assert idle is not None
            self._again_ns = None
            self._play(idle, None)

    def _note_rest(self) -> None:
        """Note why the figure rests, if that has changed."""
        reasons = tuple(map(str, self.duty.reasons))
        if reasons != self._reasons:
            self._reasons = reasons
            why = list(self.duty.reasons.values())
            self._note(f"rests: {', '.join(why)}" if why else "works", "rest", reasons=why)
