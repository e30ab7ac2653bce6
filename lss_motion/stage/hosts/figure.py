"""A figure: follows its conductor, and is safe without it. No network, player, clock or port.

It is given what arrives (beats, content, the clock of the conductor, what its player reports), and
`tick` returns what must be done (`Action`). Its state follows from what is wanted of it (rows) and
what its player does (columns); "the run" is the one that its player was started for:

               none or ended      starting  standing  playing    stopping  failed
    ---------  -----------------  --------  --------  ---------  --------  -------
    unknown    alone              STOP      STOP      STOP       stopping  alone
    lost       alone              STOP      STOP      FREEWHEEL  stopping  alone
    nothing    idle               STOP      STOP      STOP       stopping  idle
    stopped    stopped            STOP      STOP      STOP       stopping  stopped
    ready      PREPARE            STOP      STOP      STOP       stopping  PREPARE
    armed      ARM                STOP      STOP      STOP       stopping  ARM
    the run    stopped; or ended  arming    FOLLOW    FOLLOW     stopping  stopped

Capitals are what is done, and the state says how far it is. STOP: stopping. PREPARE: idle (no part
in the show), out (another robot, or a plan that does not fit), fetching, verifying, synchronising,
ready. ARM: the same, then arming. FOLLOW: armed, playing, or stopping where the show has ended
without this figure. FREEWHEEL: freewheeling, then holding. How long the player freewheels before it
holds, and how it comes into step, it decides itself (`player.following`): it gets legs only while
beats arrive.

One conductor is followed at a time. Another one is refused while the first is there, and for ever
if its epoch is lower than that of the last one: then it is an old process that came back.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.player.events import Phase
from lss_motion.stage.hosts.messages import (
    CAST_MAX_BYTES,
    EPOCHS_AHEAD,
    PROTOCOL,
    Cast,
    Catalogue,
    FigureState,
    FigureStatus,
    hash_of,
    parse,
)
from lss_motion.stage.hosts.remote_figures import LOST_NS
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lss_motion.stage.hosts.clocks import ClockEstimate
    from lss_motion.stage.hosts.messages import ConductorBeat, NetworkLeg, Part, StopAll

FETCH_AGAIN_NS: Final = NS_PER_S
FOLLOW_NS: Final = 200 * NS_PER_MS
"""The player is told where the show is this often. Chosen: at 200 ppm it is 40 us off by then."""
AHEAD_NS: Final = 50 * NS_PER_MS
"""A leg that is not the first is passed on this long before its instant, since the player follows
one leg at a time."""
SPEED_AHEAD_NS: Final = 600 * NS_PER_MS
"""A leg that changes the speed, or ends a stand, is passed on so early: half of the ramp is before
its instant. Chosen: 0.5 of the rate takes 0.4 s at 180 deg/s and 600 deg/s2."""
STOP_AGAIN_NS: Final = NS_PER_S // 2
OVER_S: Final = 3.0
"""A player that has not ended so long after the end of its show holds somewhere in it. Chosen: a
joint has a second to come within its goal tolerance."""
ARM_S: Final = 6.0
"""Who comes back joins the show this much later: the player is started (2 s), checks its servos and
moves to where the show will be. If that takes longer, the player rejoins later by itself."""


COUNTS_AHEAD: Final = 256
"""A beat whose count is further ahead of the last one is not of this conductor: it sends 10 in a
second, and one a change, and without any for `LOST_NS` every count is taken."""
NAMED_MAX: Final = 64
"""Conductors that were refused, and texts about them, that are remembered, so that strangers do not
fill the memory and the log of a figure."""
KEPT_PLANS: Final = 16
"""So many verified plans are kept ready. Chosen: one of ten minutes with 18 joints has 3 MB."""
SILENT_NS: Final = 5 * NS_PER_S
"""Without a conductor for so long after its start, a figure says so."""
AT_LEISURE: Final = frozenset({"idle", "ready", "playing", "stopped", "ended"})
"""States in which what may be wanted later is fetched and verified, one plan at a time. An idle
show may play all evening."""

Wants = Literal["unknown", "lost", "nothing", "stopped", "ready", "armed", "the run"]
"""What is wanted of a figure."""
Does = Literal["none", "starting", "standing", "playing", "stopping", "ended", "failed"]
"""What its player does. `standing`: the robot waits at its place for a leg."""
STARTING: Final = frozenset({"", Phase.CONNECT, Phase.READY, Phase.PREPARE, Phase.APPROACH})
"""Phases of a player that is on its way to the start."""
ENDING: Final = frozenset({Phase.STOP, Phase.RESTORE, Phase.DONE})


class PlayerReport(Struct, frozen=True, kw_only=True):
    """What is known of the player of this figure."""

    is_running: bool = False
    """Whether it has a job that has not ended."""
    phase: str = ""
    """By `player.events.Phase`; empty: none is known yet."""
    is_stopped: bool = False
    """Whether it was told to stop."""
    show_s: float | None = None
    stands: bool = False
    """Whether the robot stands at `show_s`, and goes to no other place."""
    outcome: Literal["", "finished", "failed"] = ""
    """How it ended; empty: it has not, or was stopped."""
    text: str = ""
    cause: str = ""
    """Kind of the fault by which it `failed`, or `error`."""
    hottest_c: float | None = None
    late_us: int | None = None

    def does(self, first_ns: int | None, now_ns: int) -> Does:
        """Return what it does, if the first leg that it was given begins at `first_ns`."""
        if self.outcome:
            return "ended" if self.outcome == "finished" else "failed"
        if not self.is_running:
            return "none"
        if self.phase in ENDING and (self.is_stopped or self.phase == Phase.STOP):
            return "stopping"
        if self.phase in STARTING and (first_ns is None or not self.phase):
            return "starting"
        return "standing" if first_ns is None or now_ns < first_ns else "playing"


class Fetch(Struct, frozen=True):
    """Ask for the content with this hash, check it, and give it to `take_content`."""

    hash: str


class Verify(Struct, frozen=True):
    """Verify the plan against the robot of this figure, and call `take_verified`."""

    plan: str


class ArmPlayer(Struct, frozen=True):
    """Start the player with this plan: it moves to `start_s` of the show and waits there."""

    plan: str
    start_s: float


class FollowLeg(Struct, frozen=True):
    """At the own instant `instant_ns` the show is at `show_s`, and goes on at `rate`."""

    instant_ns: int
    show_s: float
    rate: float


class StopPlayer(Struct, frozen=True):
    """Brake within the limits, hold, and end."""


Action = Fetch | Verify | ArmPlayer | FollowLeg | StopPlayer


class Deed(StrEnum):
    """What is done in a place of the table."""

    STOP = "stop"
    PREPARE = "prepare"
    ARM = "prepare, then arm"
    FOLLOW = "follow"
    FREEWHEEL = "freewheel"


def _row(
    without: FigureState | Deed,
    starting: FigureState | Deed = Deed.STOP,
    standing: FigureState | Deed = Deed.STOP,
    playing: FigureState | Deed = Deed.STOP,
    *,
    ended: FigureState | None = None,
) -> Mapping[Does, FigureState | Deed]:
    """Return a row of the table; `without` is for all that have no player."""
    return {
        "none": without,
        "starting": starting,
        "standing": standing,
        "playing": playing,
        "stopping": "stopping",
        "ended": ended or without,
        "failed": without,
    }


TABLE: Final[Mapping[Wants, Mapping[Does, FigureState | Deed]]] = {
    "unknown": _row("alone"),
    "lost": _row("alone", playing=Deed.FREEWHEEL),
    "nothing": _row("idle"),
    "stopped": _row("stopped"),
    "ready": _row(Deed.PREPARE),
    "armed": _row(Deed.ARM),
    "the run": _row("stopped", "arming", Deed.FOLLOW, Deed.FOLLOW, ended="ended"),
}
"""The state, or what is done, by what is wanted and what the player does."""
WHY_STOPPED: Final[Mapping[Wants, str]] = {
    "lost": "the conductor is lost before the start",
    "ready": "the conductor ended the run",
    "armed": "the conductor ended the run",
}


@dataclass
class FollowingFigure:
    """The state of one figure. `robot` is the hash of its own robot (`plans.robot_hash`)."""

    name: str
    conductor: str
    robot: str
    instance: str
    version: str
    state: FigureState = field(default="alone", init=False)
    text: str = field(default="", init=False)
    epoch: int = field(default=0, init=False)
    player: PlayerReport = field(default_factory=PlayerReport, init=False)
    beat: ConductorBeat | None = field(default=None, init=False)
    """The last one of the conductor that is followed."""
    clock: ClockEstimate | None = field(default=None, init=False)
    """The last one that is fit to follow legs by."""
    offered: ClockEstimate | None = field(default=None, init=False)
    round_trip_ns: int | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._received_ns: int | None = None
        self._cast: Cast | None = None
        self._cast_hash: str | None = None
        self._casts: dict[str, Cast] = {}
        """By hash: the one that is wanted, and those of the catalogue."""
        self._catalogue: tuple[str, list[str]] | None = None
        """Its hash, and what of it was not looked at yet."""
        self._verified: list[str] = []
        """Plans, the one that was verified last at the end."""
        self._asked_verify: set[str] = set()
        self._problems: dict[str, str] = {}
        """Why a plan cannot be played here."""
        self._contents: set[str] = set()
        self._fetched_ns: dict[str, int] = {}
        self._armed_run: tuple[int, int] | None = None
        self._stopped_ns: int | None = None
        self._is_stopped = False
        self._why = ""
        """Why it stopped by itself."""
        self._first_ns: int | None = None
        """When the first leg begins that the player was given, in its run."""
        self._told_ns: int | None = None
        """When the last beat arrived whose leg the player was given."""
        self._begun_ns: int | None = None
        self._is_silent = False
        """Whether it was told that no conductor is there."""
        self._legs: list[NetworkLeg] = []
        self._followed: tuple[int, int] | None = None
        self._notes: list[str] = []
        self._refused: set[str] = set()
        self._passed_over_ns: dict[str, int] = {}
        """When a conductor was first not followed whose epoch is too low, by its instance."""

    # ---- what arrives

    def take_beat(self, beat: ConductorBeat, now_ns: int) -> None:
        """Follow this conductor, or refuse it."""
        if why := self._refusal(beat, now_ns):
            if not self._may_begin_later(beat, now_ns):
                self._note_once(why)
            return
        bound = self.beat
        is_new = bound is None or (bound.epoch, bound.instance) != (beat.epoch, beat.instance)
        if not is_new and bound is not None and not self._is_next(beat, bound, now_ns):
            return
        if is_new:
            self._rebind(beat)
        elif self._received_ns is not None and now_ns - self._received_ns > LOST_NS:
            self._notes.append("the conductor is back")
        self.beat, self._received_ns = beat, now_ns
        is_other = bound is None or is_new or beat.run != bound.run or beat.cast != bound.cast
        if is_other or beat.wanted == "ready":  # What was stopped is over for all.
            self._is_stopped = False
            self._why = ""
            self._legs.clear()
        last = self._legs[-1].number if self._legs else 0
        if beat.leg is None or beat.leg.number < last:
            self._legs.clear()  # Numbers rise: the last one was not of this conductor.
        if beat.leg is not None and beat.leg.number != last:
            self._legs.append(beat.leg)

    def _is_next(self, beat: ConductorBeat, bound: ConductorBeat, now_ns: int) -> bool:
        """Return whether a beat is newer than the last one, by what can have happened since.

        It may have been overtaken by a newer one; but not by more than `LOST_NS`.
        """
        is_fresh = self._received_ns is not None and now_ns - self._received_ns <= LOST_NS
        return not is_fresh or bound.count < beat.count <= bound.count + COUNTS_AHEAD

    def take_other_protocol(self, protocol: int) -> None:
        """Refuse a conductor of another version."""
        self._note_once(
            f"the conductor has protocol {protocol}, this figure {PROTOCOL}: not followed; install "
            f"the same version on both"
        )

    def take_stop(self, stop: StopAll) -> None:
        """Stop this run; the same message again changes nothing."""
        beat = self.beat
        if beat is None or (stop.epoch, stop.instance) != (beat.epoch, beat.instance):
            return
        if stop.run == beat.run and beat.wanted == "armed":
            self._is_stopped = True

    def take_lost(self) -> None:
        """Note that the token of the conductor is gone: its process or the line is lost."""
        self._received_ns = None

    def take_content(self, content: bytes) -> None:
        """Take content whose hash was checked: a cast, or a plan that is stored."""
        name, beat = hash_of(content), self.beat
        self._contents.add(name)
        if beat is None:
            return
        try:
            if name == beat.catalogue:
                casts = list(parse(Catalogue, content, CAST_MAX_BYTES).casts)
                self._catalogue = (name, casts[:KEPT_PLANS])
            elif name == beat.cast or (self._catalogue and name in self._catalogue[1]):
                self._casts[name] = parse(Cast, content, CAST_MAX_BYTES)
        except InputError as error:
            self._note_once(f"the cast cannot be read: {error}")

    def take_missing(self, plan: str) -> None:
        """Take that a plan which was to be verified is stored no more: it is fetched again."""
        self._asked_verify.discard(plan)
        self._contents.discard(plan)

    def take_verified(self, plan: str, problem: str) -> None:
        """Take the result of a `Verify`; `problem` is empty where the plan is good."""
        self._asked_verify.discard(plan)
        if problem:
            self._problems[plan] = f"the plan does not fit this robot: {problem}"
            self._notes.append(self._problems[plan])
            return
        others = [one for one in self._verified if one != plan]
        self._verified = [*others[1 - KEPT_PLANS :], plan]

    def take_clock(self, estimate: ClockEstimate | None, round_trip_ns: int | None) -> None:
        """Take what is known of the clock of the conductor at present."""
        self.offered, self.round_trip_ns = estimate, round_trip_ns
        if estimate is not None and estimate.verdict != "unfit":
            self.clock = estimate

    def take_player(self, report: PlayerReport) -> None:
        """Take what the own player reports."""
        if report.outcome == "failed" and self.player.outcome != "failed":
            self._notes.append(f"the player ended: {report.text}")
        self.player = report

    # ---- what must be done

    def tick(self, now_ns: int) -> list[Action]:
        """Return what must be done now."""
        actions: list[Action] = []
        before = self.state
        self.state = self._step(now_ns, actions)
        if self.state in AT_LEISURE and self.beat is not None and not self._is_lost(now_ns):
            self._look_ahead(self.beat, now_ns, actions)
        if self.state != before:
            about = f": {self.text}" if self.text and self.state in ("out", "stopped") else ""
            self._notes.append(f"{before} -> {self.state}{about}")
        self._note_silence(now_ns)
        return actions

    def _note_silence(self, now_ns: int) -> None:
        """Tell once that no conductor has been received: wrong keys, too, are only silence."""
        if self._begun_ns is None:
            self._begun_ns = now_ns
        if self.beat is None and not self._is_silent and now_ns - self._begun_ns > SILENT_NS:
            self._is_silent = True
            self._notes.append(
                f"nothing arrives from the conductor {self.conductor}: is it served, are address, "
                f"cable and keys right?"
            )

    def take_notes(self) -> list[str]:
        """Return what happened since the last call, for the log."""
        notes, self._notes = self._notes, []
        return notes

    def status(self, now_ns: int) -> FigureStatus:
        """Return what the conductor is told."""
        does = self.player.does(self._first_ns, now_ns)
        show_s = self.player.show_s if does in ("standing", "playing") else None
        off_s = None
        if show_s is not None and self.clock is not None and does == "playing":
            leg = self._leg_at(self.clock.other_ns(now_ns))
            if leg is not None and leg.rate > 0.0:
                off_s = show_s - leg.at_s(self.clock.other_ns(now_ns))
        estimate = self.offered
        return FigureStatus(
            protocol=PROTOCOL,
            figure=self.name,
            instance=self.instance,
            version=self.version,
            state=self.state,
            epoch=self.epoch,
            follows="" if self.beat is None else self.beat.instance,
            run=0 if self.beat is None else self.beat.run,
            cast=self._cast_hash,
            leg=self._followed[0] if self._followed else 0,
            robot=self.robot,
            offset_ns=None if estimate is None else estimate.offset_ns,
            bound_ns=None if estimate is None else estimate.bound_ns,
            round_trip_ns=self.round_trip_ns,
            show_s=show_s,
            off_s=off_s,
            stands=does == "playing" and self.player.stands,
            hottest_c=self.player.hottest_c,
            late_us=self.player.late_us,
            cause=self.player.cause if self.state == "stopped" else "",
            text=self.text[:400],
        )

    # ---- inside

    def _refusal(self, beat: ConductorBeat, now_ns: int) -> str:
        """Return why this conductor is not followed; empty: it is."""
        who = f"conductor {beat.conductor} (epoch {beat.epoch}, {beat.instance})"
        if beat.conductor != self.conductor:
            return f"{who} is refused: the stage file names {self.conductor}"
        if beat.epoch > self.epoch + EPOCHS_AHEAD:
            return f"{who} is refused: no conductor has begun so often"
        if beat.epoch < self.epoch:
            return f"{who} is refused: it is stale, a later one was followed (epoch {self.epoch})"
        bound = self.beat
        if bound is None or (bound.epoch, bound.instance) == (beat.epoch, beat.instance):
            return ""
        if beat.epoch == bound.epoch:
            return f"{who} is refused: a second one with the epoch of the first ({bound.instance})"
        if not self._is_lost(now_ns):
            return f"{who} is refused: the first one ({bound.instance}) still conducts"
        return ""

    def _may_begin_later(self, beat: ConductorBeat, now_ns: int) -> bool:
        """Return whether a conductor with too low an epoch may not know yet that there was another.

        It begins a later epoch when it gets the state of this figure.
        """
        first_ns = self._passed_over_ns.setdefault(beat.instance, now_ns)
        if len(self._passed_over_ns) > NAMED_MAX:
            del self._passed_over_ns[next(iter(self._passed_over_ns))]
        is_ours = beat.conductor == self.conductor and beat.epoch <= self.epoch
        return is_ours and self._is_lost(now_ns) and now_ns - first_ns < LOST_NS

    def _rebind(self, beat: ConductorBeat) -> None:
        self._notes.append(f"follows conductor {beat.conductor} of epoch {beat.epoch}")
        self.epoch = beat.epoch
        self.clock = self.offered = None
        self._armed_run = None
        self._followed = None

    def _is_lost(self, now_ns: int) -> bool:
        return self._received_ns is None or now_ns - self._received_ns > LOST_NS

    def _wants(self, now_ns: int) -> Wants:
        """Return what is wanted of this figure: the row of the table."""
        beat = self.beat
        if beat is None:
            return "unknown"
        if beat.wanted == "nothing":
            return "nothing"
        if self._is_stopped or beat.wanted == "stopped":
            return "stopped"
        is_in_run = beat.wanted == "armed" and self._armed_run == (beat.epoch, beat.run)
        if self._is_lost(now_ns) and (is_in_run or not self.player.is_running):
            return "lost"
        return "the run" if is_in_run else beat.wanted

    def _step(self, now_ns: int, actions: list[Action]) -> FigureState:
        """Do what the table says, and return the state."""
        wants, does = self._wants(now_ns), self.player.does(self._first_ns, now_ns)
        if does in ("none", "ended", "failed"):
            self._stopped_ns = None
        found = TABLE[wants][does]
        match found:
            case Deed.STOP:
                return self._stop(
                    self._why or WHY_STOPPED.get(wants, "the conductor stopped all"),
                    now_ns,
                    actions,
                )
            case Deed.PREPARE:
                return self._prepare(now_ns, actions)
            case Deed.ARM:
                return self._arm(now_ns, actions)
            case Deed.FOLLOW:
                return self._follow(does, now_ns, actions)
            case Deed.FREEWHEEL:
                return self._freewheel(now_ns)
        if wants == "the run" and found == "stopped":
            self.text = self.player.text or "the player ended"
        return found

    def _stop(self, why: str, now_ns: int, actions: list[Action]) -> FigureState:
        if self._stopped_ns is None:
            self._notes.append(f"stops: {why}")
        if self._stopped_ns is None or now_ns - self._stopped_ns >= STOP_AGAIN_NS:
            self._stopped_ns = now_ns
            actions.append(StopPlayer())
        return "stopping"

    def _arm(self, now_ns: int, actions: list[Action]) -> FigureState:
        state, beat = self._prepare(now_ns, actions), self.beat
        if state != "ready" or self._cast is None or beat is None:
            return state
        self._armed_run = (beat.epoch, beat.run)
        self._followed = self._stopped_ns = self._first_ns = None
        actions.append(ArmPlayer(self._cast.parts[self.name].plan, self._join_s(now_ns)))
        return "arming"

    def _freewheel(self, now_ns: int) -> FigureState:
        """Leave the player to its last leg: it goes on for the freewheel, then brakes and holds."""
        is_held = self.player.stands and bool(self._legs) and self._legs[-1].rate > 0.0
        if is_held and self.state != "holding":
            lost_s = (now_ns - (self._told_ns or now_ns)) / NS_PER_S
            self._notes.append(f"the conductor is lost for {lost_s:.1f} s: the robot holds")
        return "holding" if is_held else "freewheeling"

    def _prepare(self, now_ns: int, actions: list[Action]) -> FigureState:
        """Fetch cast and plan, verify it, wait for the clock; return how far that is."""
        beat = self.beat
        if beat is None or beat.cast is None:
            return "idle"
        if self._cast is None or self._cast_hash != beat.cast:
            if beat.cast not in self._casts:
                self._fetch(beat.cast, now_ns, actions)
                return "fetching"
            self._cast, self._cast_hash = self._casts[beat.cast], beat.cast
        part = self._cast.parts.get(self.name)
        if part is None:
            return "idle"
        if problem := self._part_problem(part):
            self.text = problem
            return "out"
        if part.plan not in self._contents:
            self._fetch(part.plan, now_ns, actions)
            return "fetching"
        if part.plan not in self._verified:
            self._verify(part.plan, actions)
            return "verifying"
        if self.offered is None or self.offered.verdict == "unfit":
            return "synchronising"
        self.text = ""
        return "ready"

    def _part_problem(self, part: Part) -> str:
        if part.robot != self.robot:
            return (
                f"its robot file differs from the one that the conductor planned for "
                f"({self.robot[:8]}, {part.robot[:8]}): give both computers the same file"
            )
        return self._problems.get(part.plan, "")

    def _look_ahead(self, beat: ConductorBeat, now_ns: int, actions: list[Action]) -> None:
        """Fetch and verify what may be wanted later, one after the other."""
        if beat.catalogue is None:
            return
        if self._catalogue is None or self._catalogue[0] != beat.catalogue:
            self._fetch(beat.catalogue, now_ns, actions)
            return
        waiting = self._catalogue[1]
        if not waiting or self._asked_verify:
            return
        if waiting[0] not in self._casts:
            self._fetch(waiting[0], now_ns, actions)
            return
        part = self._casts[waiting[0]].parts.get(self.name)
        if part is None or part.robot != self.robot or part.plan in self._problems:
            waiting.pop(0)
        elif part.plan not in self._contents:
            self._fetch(part.plan, now_ns, actions)
        else:
            waiting.pop(0)
            if part.plan not in self._verified:
                self._verify(part.plan, actions)

    def _verify(self, plan: str, actions: list[Action]) -> None:
        if plan not in self._asked_verify:
            self._asked_verify.add(plan)
            actions.append(Verify(plan))

    def _follow(self, does: Does, now_ns: int, actions: list[Action]) -> FigureState:
        if self._is_left_behind(now_ns):
            self._is_stopped = True
            self._why = self.text = "the show has ended without this figure"
            return self._stop(self._why, now_ns, actions)
        self._lead(now_ns, actions, is_waiting=does == "standing")
        return "playing" if does == "playing" else "armed"

    def _is_left_behind(self, now_ns: int) -> bool:
        """Return whether the show is over for all that follow it, and this player holds."""
        if self.clock is None or self._cast is None or self._cast.duration_s is None:
            return False
        conductor_ns = self.clock.other_ns(now_ns)
        leg = self._leg_at(conductor_ns)
        return leg is not None and leg.at_s(conductor_ns) > self._cast.duration_s + OVER_S

    def _lead(self, now_ns: int, actions: list[Action], *, is_waiting: bool) -> None:
        """Tell the player the leg that is in force, or the one that soon will be."""
        clock = self.clock
        if clock is None or not self._legs:
            return
        conductor_ns = clock.other_ns(now_ns)
        leg = self._leg_at(conductor_ns + (0 if is_waiting else self._ahead_ns(conductor_ns)))
        if leg is None and is_waiting:
            leg = self._legs[0]
        if leg is None or self._is_told(leg, now_ns):
            return
        # From now on, not from the instant of the leg: until then the clocks have drifted apart.
        at_ns = max(leg.instant_ns, conductor_ns)
        own_ns, rate = clock.own_ns(at_ns), leg.rate * (1.0 + clock.rate_ratio)
        self._followed, self._told_ns = (leg.number, now_ns), self._received_ns
        if self._first_ns is None and rate > 0.0:
            self._first_ns = own_ns
        actions.append(FollowLeg(own_ns, leg.at_s(at_ns), rate))

    def _is_told(self, leg: NetworkLeg, now_ns: int) -> bool:
        """Return whether the player was told this leg just now, or since the last beat."""
        if self._followed is None or self._followed[0] != leg.number:
            return False
        return now_ns - self._followed[1] < FOLLOW_NS or self._told_ns == self._received_ns

    def _ahead_ns(self, conductor_ns: int) -> int:
        """Return how long before its instant the next leg is passed on."""
        present = self._leg_at(conductor_ns)
        if present is None or len(self._legs) < 2:
            return AHEAD_NS
        coming = self._legs[1]
        return SPEED_AHEAD_NS if coming.rate not in (0.0, present.rate) else AHEAD_NS

    def _leg_at(self, conductor_ns: int) -> NetworkLeg | None:
        """Return the leg in force at an instant; older ones are forgotten."""
        while len(self._legs) > 1 and self._legs[1].instant_ns <= conductor_ns:
            self._legs.pop(0)
        if self._legs and self._legs[0].instant_ns <= conductor_ns:
            return self._legs[0]
        return None

    def _join_s(self, now_ns: int) -> float:
        """Return the show time at which the robot must stand to join the show."""
        if not self._legs or self.clock is None:
            return 0.0 if self.beat is None else self.beat.start_s
        leg = self._legs[-1]
        duration_s = None if self._cast is None else self._cast.duration_s
        show_s = max(0.0, leg.at_s(self.clock.other_ns(now_ns) + ns_from_s(ARM_S)))
        if leg.rate == 0.0:
            show_s = max(0.0, leg.show_s)
        return show_s if duration_s is None else min(show_s, duration_s)

    def _fetch(self, name: str, now_ns: int, actions: list[Action]) -> None:
        last_ns = self._fetched_ns.get(name)
        if last_ns is None or now_ns - last_ns >= FETCH_AGAIN_NS:
            self._fetched_ns[name] = now_ns
            actions.append(Fetch(name))

    def _note_once(self, text: str) -> None:
        if text not in self._refused and len(self._refused) < NAMED_MAX:
            self._refused.add(text)
            self._notes.append(text)
