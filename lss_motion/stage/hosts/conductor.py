"""The conductor: one show at a time, together on all figures. No network, clock or port.

The director of the stage orders (`play`, `leave`, `connect`), operators steer (`pause`, `set_rate`,
`seek`, `stop`), figures send their states, and `tick` looks after all of them. What all figures
must know is in `beat`; what became of an order goes to the `Listener`, by its number.

    state       play     leave    connect     stop      tick, until ...
    ----------  -------  -------  ----------  --------  ------------------------------------------
    connecting  leaving  -        -           -         all figures are there, or (`go_on`) some
                                                        after `CONNECT_S`: standing
    standing    leaving  -        connecting  -         -
    leaving     leaving  leaving  leaving     leaving   no figure has a player, or `LEAVE_S` are
                                                        over: readying, connecting or standing
    readying    leaving  leaving  leaving     standing  all are ready: arming; `READY_S` are over:
                                                        standing (refused)
    arming      leaving  leaving  leaving     standing  all stand at their place: playing; a
                                                        figure fell: leaving (faulted); one ended,
                                                        or `ARM_S` are over: standing (refused)
    playing     leaving  leaving  leaving     standing  the show is over: standing (finished);
                                                        figures are away: leaving (faulted)

Where figures follow another conductor, a show is refused, and one that plays is left: standing.

What the states want of the figures: `armed` while arming and playing, `ready` from readying on and
after a show that has ended, `stopped` after one that was left. A figure that is lost, out or
faulted while a show plays leaves the others to `others`: they go on, slow down, or hold until it
is back. With `go_on` a show also starts without it.
"""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final, Literal, Protocol

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.player.following import RUNNING_RATE
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.robot.on_fault import Cause
from lss_motion.stage.hosts.legs import LEAD_NS, ShowLegs
from lss_motion.stage.hosts.messages import EPOCHS_AHEAD, ConductorBeat, StopAll, hash_of, packed
from lss_motion.stage.hosts.remote_figures import LOST_NS, PLAYABLE, TWICE, RemoteFigure
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s, s_from_ns

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Sequence

    from lss_motion.stage.hosts.messages import Cast, FigureStatus, NetworkLeg, Wanted
    from lss_motion.stage.orders import Outcome

Others = Literal["go_on", "slow", "hold"]

BEAT_NS: Final = 100 * NS_PER_MS
STOOD_NS: Final = NS_PER_S // 2
"""Figures that stand are seen to do so this long after a leg: their states arrive 5 times a second,
and repeat."""
THERE_S: Final = 2.0
"""A figure that stands so near stands at the place that was sought. Chosen: the ramp of a pause
takes less."""
SEEK_MAX_NS: Final = 30 * NS_PER_S
"""Figures that are not there by then join the others later. Chosen: any way at the approach speed
takes less."""
SLOW_RATIO: Final = 0.5
"""With `others: slow`. Chosen: slow enough to be seen, and the show is still one."""
NAME_NS: Final = 5 * NS_PER_S
"""Figures that have not connected are named after this time."""
CONNECT_S: Final = 60.0
"""So long a stage with `others: go_on` waits for all its figures before it begins without some."""
LEAVE_S: Final = 30.0
"""Figures that have not stopped by then are not waited for. Chosen: any show brakes in seconds, and
a player that does not end is ended after 20 s."""
WITHOUT_S: Final = 10.0
"""With `others: go_on`, figures that cannot take part are waited for so long before a show starts
without them. Chosen: a process that starts again is there in 4 s."""
READY_S: Final = 30.0
"""A show whose figures are not ready by then is refused, with the reasons. Chosen: a plan is
fetched and verified in seconds."""
ARM_S: Final = 60.0
"""A robot that is not at its start by then is named, and the start is given up."""
NEAR_S: Final = 5.0
"""A leader that is further away may still be wound somewhere else."""
OVER_S: Final = 15.0
"""A show that some figure has not ended by then is over. Chosen: figures give up before
(`figure.OVER_S`), and their servos get their settings back."""
FALLEN_S: Final = 10.0
"""A show ends so long after a figure fell that does not come back by itself."""
AWAY_S: Final = 60.0
"""The same after a figure was lost: its computer may start again."""
ARM_LEAD_S: Final = 8.0
"""A show that joins the timecode waits at the place that it reaches so much later, the first time.
Chosen: two figures of five joints need 3 s, eight of 18 on two busy cores 11 s."""
ARM_LEAD_RATIO: Final = 1.3
ARM_LEAD_LEAST_S: Final = 4.0
"""Afterwards it is what the robots needed the last time, with so much room, and the leg's second,
but no less than this, as the way may be longer this time."""


class ConductorState(StrEnum):
    """What the conductor does."""

    CONNECTING = "connecting"
    STANDING = "standing"
    LEAVING = "leaving"
    READYING = "readying"
    ARMING = "arming"
    PLAYING = "playing"


class Wish(Struct, frozen=True, kw_only=True):
    """A show that is to be played, by the number of its order."""

    number: int
    cast: Cast
    start_s: float = 0.0
    leader: Callable[[], LeaderPosition | None] | None = None
    """Where the timecode is in this show, which then follows it; None: nowhere at present."""
    holds_without: bool = False
    """Whether the show holds while its leader is lost, instead of going on."""


class Listener(Protocol):
    """Gets what became of orders."""

    def connected(self, text: str, now_ns: int) -> None: ...

    def refused(self, number: int, reason: str, now_ns: int) -> None: ...

    def ended(self, number: int, outcome: Outcome, show_s: float | None, now_ns: int) -> None: ...

    def faulted(self, cause: Cause, text: str, now_ns: int) -> None: ...


class Conductor:
    """The state of one conductor. `epoch` must be higher than any that a figure has followed."""

    def __init__(
        self,
        *,
        name: str,
        figures: Collection[str],
        epoch: int,
        instance: str,
        others: Others = "hold",
    ) -> None:
        self.name, self.epoch, self.instance = name, epoch, instance
        self.others = others
        self.figures = {one: RemoteFigure(one) for one in figures}
        self.listener: Listener | None = None
        self.state = ConductorState.CONNECTING
        self.legs = ShowLegs()
        self.run = 0
        """Counts the shows that were armed."""
        self.catalogue: str | None = None
        """Hash of the `messages.Catalogue`."""
        self.examines = 0
        """Raised to let all figures examine themselves."""
        self.superseded = ""
        """Why another conductor has taken over; empty: none has."""
        self.stops = 0
        """Counts what was stopped: each is told to all at once, and repeated."""
        self.armed_s: float | None = None
        """How long the last start took until all robots stood at their place."""
        self._wish: Wish | None = None
        """What plays, or is about to."""
        self._after_leaving = ConductorState.STANDING
        """Where `leaving` leads to without a wish."""
        self._at_rest: Wanted = "nothing"
        """What is wanted of figures whose robots are not wanted at a show."""
        self._cast: tuple[Cast, str] | None = None
        """The one that is wanted, and its hash."""
        self._start_s = 0.0
        self._without: set[str] = set()
        """Figures that did not take part when the show was started."""
        self._now_ns = 0
        self._begun_ns: int | None = None
        self._since_ns: int | None = None
        """Of the present state."""
        self._have_stood = False
        """Whether all robots have stood at their place, for this start."""
        self._bad_ns: int | None = None
        """Since when a figure does not play."""
        self._count = 0
        self._notes: list[str] = []
        self._refused = ""
        """The other conductor that was refused last."""
        self._rival: tuple[str, int] | None = None
        """A conductor that would take over, and when its first beat came."""

    # ---- what is sent

    @property
    def wanted(self) -> Wanted:
        """What is wanted of all figures."""
        return (
            "armed"
            if self.state in (ConductorState.ARMING, ConductorState.PLAYING)
            else self._at_rest
        )

    @property
    def cast(self) -> Cast | None:
        """The show that figures are wanted for, or were last."""
        return None if self._cast is None else self._cast[0]

    def beat(self) -> ConductorBeat:
        """Return the next beat."""
        self._count += 1
        return ConductorBeat(
            conductor=self.name,
            epoch=self.epoch,
            instance=self.instance,
            count=self._count,
            wanted=self.wanted,
            run=self.run,
            cast=None if self._cast is None else self._cast[1],
            catalogue=self.catalogue,
            leg=self.legs.newest,
            start_s=self._start_s,
            examines=self.examines,
        )

    def stop_message(self) -> StopAll:
        """Return what is repeated after a stop, beside the beats."""
        return StopAll(conductor=self.name, epoch=self.epoch, instance=self.instance, run=self.run)

    # ---- what arrives

    def take_status(self, status: FigureStatus, now_ns: int) -> None:
        """Take the state of a figure."""
        figure = self.figures.get(status.figure)
        if figure is None:
            return
        is_ours = status.epoch < self.epoch or status.follows in ("", self.instance)
        if is_ours or status.epoch > self.epoch + EPOCHS_AHEAD:
            figure.apart_ns = None
        else:
            self._meet(figure, status, now_ns)
        figure.take_status(status, now_ns)

    def take_other_protocol(self, name: str, protocol: int, now_ns: int) -> None:
        """Note a figure of another version, whose state cannot be read."""
        if (figure := self.figures.get(name)) is not None:
            figure.other_protocol, figure.heard_ns = protocol, now_ns

    def _meet(self, figure: RemoteFigure, status: FigureStatus, now_ns: int) -> None:
        """Begin a later epoch than that of the conductor before this one, or give way to it.

        A show is given up only for what a figure says for `LOST_NS`: one message may be anyone's.
        """
        if figure.apart_ns is None:
            figure.apart_ns = now_ns
        is_sure = now_ns - figure.apart_ns >= LOST_NS
        if self.wanted != "armed":
            self.epoch = status.epoch + 1
        elif status.epoch > self.epoch and is_sure and not self.superseded:
            self.superseded = (
                f"figure {status.figure} follows a conductor that began later (epoch "
                f"{status.epoch}, this one has {self.epoch}): this one conducts no more; end it, "
                f"and start it again if it is the right one"
            )
            self._notes.append(self.superseded)

    def take_alive(self, name: str, *, is_alive: bool) -> None:
        """Note that the token of a figure has come, or gone."""
        if (figure := self.figures.get(name)) is not None:
            figure.take_alive(is_alive=is_alive)

    def take_beat(self, beat: ConductorBeat, now_ns: int) -> None:
        """Take the beat of another conductor of this stage: one of the two is wrong.

        While figures play what this one says, it is the other one, however late that began.
        """
        if beat.instance == self.instance or self.superseded:
            return
        if self._rival is None or self._rival[0] != beat.instance:
            self._rival = (beat.instance, now_ns)
        if self.wanted == "armed" and self._is_followed(now_ns):
            if self._refused != beat.instance:
                self._refused = beat.instance
                self._notes.append(
                    f"another conductor ({beat.conductor}, epoch {beat.epoch}) is refused: figures "
                    f"play what this one says; end the other one"
                )
            return
        is_later = (beat.epoch, beat.instance) > (self.epoch, self.instance)
        if not is_later or beat.epoch > self.epoch + EPOCHS_AHEAD:
            return
        if now_ns - self._rival[1] >= LOST_NS:
            self.superseded = (
                f"another conductor ({beat.conductor}, epoch {beat.epoch}) conducts this stage: "
                f"this one (epoch {self.epoch}) conducts no more"
            )
            self._notes.append(self.superseded)

    def _is_followed(self, now_ns: int) -> bool:
        """Return whether a figure of another computer has just told that it follows this one."""
        return any(
            one.status is not None
            and one.status.follows == self.instance
            and not one.is_lost(now_ns)
            for name, one in self.figures.items()
            if name != self.name
        )

    # ---- what the director orders

    def play(self, wish: Wish, now_ns: int) -> None:
        """Play a show on all figures; what plays is left first."""
        self._now_ns = now_ns
        self._leave(wish)

    def leave(self, now_ns: int) -> None:
        """Let all figures brake, hold and end."""
        self._now_ns = now_ns
        if self.state not in (ConductorState.CONNECTING, ConductorState.STANDING):
            self._leave(None)

    def connect(self, now_ns: int) -> None:
        """Wait until all figures are there, as at the beginning."""
        self._now_ns = now_ns
        if self.state is ConductorState.STANDING:
            self._enter(ConductorState.CONNECTING)
        elif self.state is not ConductorState.CONNECTING:
            if self.state is not ConductorState.LEAVING or self._wish is not None:
                self._leave(None)
            self._after_leaving = ConductorState.CONNECTING

    def _leave(self, wish: Wish | None) -> None:
        if self.state is not ConductorState.LEAVING:
            self._after_leaving = ConductorState.STANDING
        if self.wanted == "armed":
            self._notes.append("STOP for all")
            self.stops += 1
        show_s = self.legs.show_s(self._now_ns)
        start_s = 0.0 if self._wish is None else self._wish.start_s
        self._drop(ConductorState.LEAVING, "left", start_s if show_s is None else max(show_s, 0.0))
        self._wish = wish

    def _drop(
        self,
        state: ConductorState,
        outcome: Outcome | None = None,
        show_s: float | None = None,
        *,
        reason: str = "",
    ) -> None:
        """Let go what plays or was to play, and tell what became of it: refused, or its end."""
        wish, self._wish = self._wish, None
        if self.wanted == "armed":
            self._at_rest = "ready" if outcome == "finished" else "stopped"
        self.legs.reset()
        self._enter(state)
        if wish is None or self.listener is None:
            return
        if outcome is None:
            self.listener.refused(wish.number, reason, self._now_ns)
        else:
            self.listener.ended(wish.number, outcome, show_s, self._now_ns)

    # ---- what operators ask for

    def stop(self, now_ns: int) -> None:
        """Stop all figures, and what was to be played. Best effort: this is no emergency stop."""
        self._now_ns = now_ns
        self._notes.append("STOP for all")
        self.stops += 1
        is_under_way = self.state in (
            ConductorState.READYING,
            ConductorState.ARMING,
            ConductorState.PLAYING,
        )
        outcome: Outcome | None = "left" if self.state is ConductorState.PLAYING else None
        self._drop(
            ConductorState.STANDING if is_under_way else self.state,
            outcome,
            reason="all were stopped",
        )

    def pause(self, now_ns: int, *, is_paused: bool = True) -> None:
        """Let all stand, from an instant `LEAD_NS` ahead, or go on."""
        self._require_leg()
        self.legs.pause(now_ns, is_paused=is_paused)

    def set_rate(self, ratio: float, now_ns: int) -> float:
        """Play at this share of the speed of the plan until the next start; return which it is.

        It is the nearest one that a figure follows. A paused show has it when it is resumed.
        """
        self._require_leg()
        return self.legs.set_rate(ratio, now_ns)

    def seek(self, show_s: float, now_ns: int) -> None:
        """Go on from another show time: figures brake, move there, and start there together.

        Raises `InputError` for a time that is not in the show.
        """
        self._require_leg()
        self.legs.seek(show_s, None if self.cast is None else self.cast.duration_s, now_ns)
        self._notes.append(f"the robots go to {show_s:.1f} s of the show")

    def _require_leg(self) -> None:
        if self.superseded:
            raise InputError(self.superseded)
        if self.state is not ConductorState.PLAYING:
            raise InputError("no show plays")

    # ---- each turn

    def show_s(self, now_ns: int) -> float | None:
        """Return the show time; None while none plays. Before its start it is negative."""
        return self.legs.show_s(now_ns)

    def tick(self, now_ns: int) -> list[str]:
        """Do what is due; return what a person should know since the last call."""
        self._now_ns = now_ns
        if self._begun_ns is None:
            self._begun_ns = self._since_ns = now_ns
        for figure in self._cast_figures():
            if figure.status is not None or now_ns - self._begun_ns >= NAME_NS:
                figure.note_problem(self._problem(figure), now_ns)
        if self.superseded and self.wanted == "armed":
            self._drop(ConductorState.STANDING, "left")
        self._go_on()
        notes, self._notes = self._notes, []
        for figure in self.figures.values():
            notes += figure.notes
            figure.notes.clear()
        return notes

    def _go_on(self) -> None:
        """Do what the present state waits for."""
        match self.state:
            case ConductorState.CONNECTING:
                self._await_figures()
            case ConductorState.LEAVING:
                self._await_stop()
            case ConductorState.READYING:
                self._make_ready()
            case ConductorState.ARMING:
                self._arm()
            case ConductorState.PLAYING:
                self._look_after()

    def _enter(self, state: ConductorState) -> None:
        self.state, self._since_ns = state, self._now_ns
        self._have_stood, self._bad_ns = False, None

    def _is_past(self, seconds: float) -> bool:
        """Return whether the present state has lasted for longer."""
        return self._since_ns is not None and self._now_ns - self._since_ns > ns_from_s(seconds)

    def _await_figures(self) -> None:
        figures = self.figures.values()
        absent = [one.name for one in figures if one.status is None or one.is_lost(self._now_ns)]
        may_go_without = self.others == "go_on" and len(absent) < len(figures)
        if absent and not (may_go_without and self._is_past(CONNECT_S)):
            return
        self._enter(ConductorState.STANDING)
        text = f"begins without {', '.join(absent)}" if absent else "all figures are there"
        if self.listener is not None:
            self.listener.connected(text, self._now_ns)

    def _await_stop(self) -> None:
        """Go on when no figure has a player; a figure that does not stop is not waited for."""
        active = [one.name for one in self.figures.values() if one.is_active(self._now_ns)]
        if active and not self._is_past(LEAVE_S):
            return
        wish = self._wish
        if wish is None:
            self._enter(self._after_leaving)
        elif active:
            self._refuse(f"{', '.join(active)} does not stop")
        elif self.superseded:
            self._refuse(self.superseded)
        else:
            self._cast = (wish.cast, hash_of(packed(wish.cast)))
            self._at_rest = "ready"
            self._notes.append(f"loads {wish.cast.show!r}")
            self._enter(ConductorState.READYING)

    def _make_ready(self) -> None:
        """Arm all figures when all are ready, or refuse the show."""
        wish = self._wish
        assert wish is not None, "a show is about to play"
        if self.superseded:
            self._refuse(self.superseded)
            return
        if problems := self.problems(self._now_ns):
            if self._is_past(READY_S):
                self._refuse("; ".join(problems))
            return
        absent = self.absent(self._now_ns)
        if absent != self.absent(self._now_ns, ns_from_s(WITHOUT_S)):
            return  # Some may be back in a moment.
        self._notes += [f"starts without {name}: {why}" for name, why in absent.items()]
        warnings = filter(None, (one.warning() for one in self._cast_figures()))
        self._notes += [f"warning: {text}" for text in warnings]
        self._without = set(absent)
        self.run += 1
        self.legs.reset()
        self._start_s = wish.start_s
        leader = None if wish.leader is None else wish.leader()
        if leader is not None and leader.rate >= RUNNING_RATE:
            self._start_s = max(leader.at_s(self._now_ns + ns_from_s(self._arm_lead_s())), 0.0)
        self._notes.append("GO: the robots move to their start")
        self._enter(ConductorState.ARMING)

    def _arm_lead_s(self) -> float:
        """Return how far ahead of the timecode the robots wait for it."""
        if self.armed_s is None:
            return ARM_LEAD_S
        return max(ARM_LEAD_LEAST_S, ARM_LEAD_RATIO * self.armed_s + s_from_ns(LEAD_NS))

    def _arm(self) -> None:
        """Make the first leg when all stand at their place, and their leader is near."""
        wish = self._wish
        assert wish is not None, "a show is about to play"
        if all(self._is_armed(one) for one in self._expected()):
            if not self._have_stood:
                self._have_stood = True
                self.armed_s = s_from_ns(self._now_ns - (self._since_ns or 0))
            leader = None if wish.leader is None else wish.leader()
            if wish.leader is None or _is_near(leader, self._now_ns):
                self.legs.begin(self._start_s, leader, self._now_ns)
                self._notes.append(
                    f"all stand at the start after {self.armed_s or 0.0:.1f} s: starts"
                )
                self._enter(ConductorState.PLAYING)
        elif self._is_past(ARM_S) or any(one.name not in self._without for one in self._ended()):
            problems = "; ".join(self.problems(self._now_ns))
            self._notes.append(f"the start is given up: {problems}")
            if fallen := self._fallen():
                self._fail(fallen)
            else:
                self.stops += 1
                self._refuse(problems or "the start was given up")

    def _refuse(self, reason: str) -> None:
        self._drop(ConductorState.STANDING, reason=reason)

    # ---- while it plays

    def _look_after(self) -> None:
        """Notice the end of the show and figures that do not play; follow the leader."""
        leg, wish = self.legs.newest, self._wish
        assert leg is not None, "a show plays"
        assert wish is not None
        if self._is_over():
            self._notes.append("the show has ended")
            self._drop(ConductorState.STANDING, "finished")
            return
        if leg.instant_ns <= self._now_ns:
            self._obey_others(leg)
        if wish.leader is not None:
            leader = wish.leader()
            if leader is None and wish.holds_without:
                leader = LeaderPosition(self._now_ns, leg.at_s(self._now_ns), 0.0)
            if leader is not None:
                self.legs.chase(leader, self._now_ns)
        fallen = self._fallen()
        bad = fallen or [one for one in self._cast_figures() if one.problem]
        is_enough = self.others == "go_on" and len(bad) < len(self._cast_figures())
        if not bad or is_enough:
            self._bad_ns = None
            return
        self._bad_ns = self._bad_ns or self._now_ns
        if self._now_ns - self._bad_ns > ns_from_s(FALLEN_S if fallen else AWAY_S):
            self._fail(bad)

    def _is_over(self) -> bool:
        show_s, cast = self.legs.show_s(self._now_ns), self.cast
        if cast is None or cast.duration_s is None or show_s is None:
            return False
        states = {
            one.status.state
            for one in self._cast_figures()
            if one.status is not None and not one.is_lost(self._now_ns)
        }
        is_played = show_s > cast.duration_s and not {"playing", "arming"} & states
        return is_played or show_s > cast.duration_s + OVER_S

    def _fail(self, figures: Sequence[RemoteFigure]) -> None:
        """End the show for all; the director decides about another attempt."""
        texts, causes = [], []
        for one in figures:
            status = one.status
            cause = "" if status is None or one.is_lost(self._now_ns) else status.cause
            causes.append(Cause(cause) if cause in list(Cause) else Cause.LOST_PORT)
            texts.append(f"{one.name}: {one.problem or (status.text if status else '')}")
        self._wish = None
        self._leave(None)
        if self.listener is not None:
            self.listener.faulted(causes[0], "; ".join(texts), self._now_ns)

    def _obey_others(self, leg: NetworkLeg) -> None:
        """Go on, slow down or hold, as `others` says, while figures do not take part."""
        if self.legs.is_seeking:
            self._end_seek(leg)
        are_all_there = all(self._takes_part(one) for one in self._cast_figures())
        limit = (
            1.0 if are_all_there else {"go_on": 1.0, "slow": SLOW_RATIO, "hold": 0.0}[self.others]
        )
        if limit != self.legs.limit:
            slower = "the others are slower" if limit else "the others hold"
            self._notes.append("all figures play: the show goes on" if limit == 1.0 else slower)
            self.legs.set_limit(limit, self._now_ns)

    def _end_seek(self, leg: NetworkLeg) -> None:
        """Go on when all figures that take part stand at the place that was sought."""
        since_ns = self._now_ns - leg.instant_ns
        there = (self._is_there(one, leg) for one in self._cast_figures() if self._takes_part(one))
        if since_ns >= STOOD_NS and (all(there) or since_ns >= SEEK_MAX_NS):
            self.legs.end_seek(self._now_ns)

    def _is_there(self, figure: RemoteFigure, leg: NetworkLeg) -> bool:
        status = figure.status
        assert status is not None, "it takes part"
        if status.state == "ended":
            return True
        off_s = abs((status.show_s or 0.0) - leg.show_s)
        return status.leg == leg.number and status.stands and off_s < THERE_S

    # ---- which figures take part

    def problems(self, now_ns: int) -> list[str]:
        """Return why the show cannot start, a sentence for each figure; empty: it can."""
        found, absent = [], self.absent(now_ns)
        may_go_without = self.others == "go_on" and len(absent) < len(self._cast_figures())
        for one in self._cast_figures():
            if problem := absent.get(one.name):
                if not may_go_without:
                    found.append(f"{one.name}: {problem}")
            elif one.is_twice(now_ns):
                found.append(f"{one.name}: {TWICE}")
            elif one.status is not None and one.status.state != "ready":
                found.append(f"{one.name} is {one.status.state}")
        return found

    def absent(self, now_ns: int, for_ns: int = 0) -> dict[str, str]:
        """Return the figures that cannot take part, and why; those that could not for so long."""
        found = {}
        for one in self._cast_figures():
            is_long = one.problem_ns is not None and now_ns - one.problem_ns >= for_ns
            if (problem := self._problem(one)) and (is_long or for_ns == 0):
                found[one.name] = problem
        return found

    def _cast_figures(self) -> Sequence[RemoteFigure]:
        parts = self.figures if self.cast is None else self.cast.parts
        return [one for name, one in self.figures.items() if name in parts]

    def _expected(self) -> Sequence[RemoteFigure]:
        """Return the figures without which the show does not start."""
        return [one for one in self._cast_figures() if one.name not in self._without]

    def _problem(self, figure: RemoteFigure) -> str:
        is_armed = self.wanted == "armed"
        return figure.problem_of(
            self._now_ns,
            has_begun=self.legs.newest is not None,
            is_over=is_armed and figure.is_of(self.epoch, self.run),
        )

    def _is_armed(self, figure: RemoteFigure) -> bool:
        status = figure.status
        if status is None or status.run != self.run or status.state not in PLAYABLE:
            return False
        return not self._problem(figure)

    def _takes_part(self, figure: RemoteFigure) -> bool:
        """Return whether a figure plays, or has played all of its part."""
        has_ended = figure.status is not None and figure.status.state == "ended"
        return not figure.problem and (has_ended or self._is_armed(figure))

    def _ended(self) -> list[RemoteFigure]:
        """Return the figures that are out of this run, or whose player has ended in it."""
        return [
            one
            for one in self._cast_figures()
            if one.status is not None
            and one.is_of(self.epoch, self.run)
            and not one.is_lost(self._now_ns)
            and one.status.state in ("stopped", "out")
        ]

    def _fallen(self) -> list[RemoteFigure]:
        """Return those of them whose player has ended with a fault."""
        return [one for one in self._ended() if one.status is not None and one.status.cause]


def _is_near(leader: LeaderPosition | None, now_ns: int) -> bool:
    """Return whether a leader runs, and is not further than `NEAR_S` before the show."""
    return leader is not None and leader.rate >= RUNNING_RATE and leader.at_s(now_ns) >= -NEAR_S
