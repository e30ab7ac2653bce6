"""The conductor: one cast, one run, one leg at a time, for all figures. No network, clock or port.

    load(cast)          the figures fetch, verify and synchronise: `ready`
    arm(now)            their robots move to the start: `armed`
    start(now)          the first leg, at least `LEAD_NS` ahead
    pause, resume, set_rate, seek, trim
    stop()              brake, hold, end; again and again is the same as once

`tick(now)` looks after the figures and returns what a person should know. `beat` is what all of
them must know; it is sent `BEAT_NS` apart and whenever it changes.

A figure that is lost, out or faulted while a show plays leaves the others to `others`: they go on,
slow down, or hold until it is back. With `go_on` a show also starts without it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal

from lss_motion.errors import InputError
from lss_motion.playing.player.following import RUNNING_RATE, SLOW_RATE, SPEED_STEP
from lss_motion.stage.hosts.clocks import REFUSE_NS, WARN_NS
from lss_motion.stage.hosts.messages import (
    EPOCHS_AHEAD,
    PROTOCOL,
    Beat,
    NetworkLeg,
    Status,
    hash_of,
    packed,
)
from lss_motion.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from lss_motion.playing.player.show_clock import Leg
    from lss_motion.stage.hosts.messages import Cast, Wanted

Others = Literal["go_on", "slow", "hold"]

BEAT_NS: Final = 100 * NS_PER_MS
LEAD_NS: Final = NS_PER_S
"""A leg takes effect this long after it was made. A message arrives in 80 ms even on a bad Wi-Fi,
and ten beats repeat it meanwhile."""
LOST_NS: Final = NS_PER_S
"""Without a word for so long, a figure is lost."""
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
CONNECT_NS: Final = 5 * NS_PER_S
"""Figures that have not connected are named after this time."""
NOTE_AGAIN_NS: Final = NS_PER_S
"""A figure that comes and goes is named no more often. What it does is not delayed by that."""
TWICE_AGAIN_NS: Final = 60 * NS_PER_S
"""A figure that two processes serve is named no more often: they answer in turn, 10 a second."""
PROCESSES_MAX: Final = 8
"""Processes of one figure that are told apart; those of earlier restarts are forgotten."""
TWICE: Final = "two processes serve it: end one of them (`lss-motion serve … --figure`)"
PLAYABLE: Final = frozenset({"armed", "playing"})


@dataclass
class FigureSeat:
    """What the conductor knows of one figure."""

    name: str
    status: Status | None = None
    heard_ns: int | None = None
    is_alive: bool = False
    """Whether its token is there (`peer`)."""
    problem: str = ""
    """Why it does not take part; empty: it does."""
    problem_ns: int | None = None
    """Since when there is one."""
    noted: str = ""
    """The last problem that a person was told, without its numbers."""
    noted_ns: int = -NOTE_AGAIN_NS
    last_words: dict[str, str] = field(default_factory=dict)
    """The last text of each process that has served it, the oldest process first."""
    is_twice_ns: int | None = None
    """When it was last seen that two processes serve it."""
    told_twice_ns: int | None = None
    apart_ns: int | None = None
    """Since when it says that it follows another conductor."""

    def is_twice(self, now_ns: int) -> bool:
        """Return whether two processes serve it, and answer in turn."""
        return self.is_twice_ns is not None and now_ns - self.is_twice_ns <= LOST_NS

    def is_lost(self, now_ns: int) -> bool:
        """Return whether nothing has arrived from it for `LOST_NS`."""
        return self.heard_ns is None or now_ns - self.heard_ns > LOST_NS


@dataclass
class Conductor:
    """The state of one conductor. `epoch` must be higher than any that a figure has followed."""

    name: str
    figures: Collection[str]
    epoch: int
    instance: str
    others: Others = "hold"
    freewheel_s: float = 2.0
    seats: dict[str, FigureSeat] = field(init=False)
    wanted: Wanted = field(default="nothing", init=False)
    cast: Cast | None = field(default=None, init=False)
    catalogue: str | None = field(default=None, init=False)
    """Hash of the `messages.Catalogue`."""
    run: int = field(default=0, init=False)
    leg: NetworkLeg | None = field(default=None, init=False)
    speed: float = field(default=1.0, init=False)
    """The share of the speed of the plan that a person asked for (`set_rate`)."""
    is_paused: bool = field(default=False, init=False)
    examines: int = field(default=0, init=False)
    """Raised to let all figures examine themselves."""
    superseded: str = field(default="", init=False)
    """Why another conductor has taken over; empty: none has."""

    def __post_init__(self) -> None:
        self.seats = {name: FigureSeat(name) for name in self.figures}
        self._count = 0
        self._cast_hash: str | None = None
        self._limit = 1.0
        """What `others` allows at present."""
        self._led_rate = 1.0
        """That of a leader, if there is one."""
        self._start_s = 0.0
        self._notes: list[str] = []
        self._begun_ns: int | None = None
        self._without: set[str] = set()
        """Figures that did not take part when the show was started."""
        self._is_seeking = False
        """Whether the show stands until all robots are at the place of its leg."""
        self._refused = ""
        """The other conductor that was refused last."""
        self._rival: tuple[str, int] | None = None
        """A conductor that would take over, and when its first beat came."""

    # ---- what is sent

    def beat(self) -> Beat:
        """Return the next beat."""
        self._count += 1
        return Beat(
            conductor=self.name,
            epoch=self.epoch,
            instance=self.instance,
            count=self._count,
            wanted=self.wanted,
            run=self.run,
            cast=self._cast_hash,
            catalogue=self.catalogue,
            leg=self.leg,
            freewheel_s=self.freewheel_s,
            start_s=self._start_s,
            examines=self.examines,
        )

    # ---- what arrives

    def take_status(self, status: Status, now_ns: int) -> None:
        """Take the state of a figure."""
        seat = self.seats.get(status.figure)
        if seat is None:
            return
        is_ours = status.epoch < self.epoch or status.follows in ("", self.instance)
        if is_ours or status.epoch > self.epoch + EPOCHS_AHEAD:
            seat.apart_ns = None
        else:
            self._meet(seat, status, now_ns)
        if seat.status is not None and seat.status.instance != status.instance:
            self._meet_process(seat, status.instance, now_ns)
        if status.text and seat.last_words.get(status.instance) != status.text:
            self._notes.append(f"figure {seat.name}: {status.text}")
        seat.last_words[status.instance] = status.text
        while len(seat.last_words) > PROCESSES_MAX:
            del seat.last_words[next(iter(seat.last_words))]
        seat.status, seat.heard_ns = status, now_ns

    def _meet_process(self, seat: FigureSeat, instance: str, now_ns: int) -> None:
        """Note that another process serves a figure. One that was there before: two do at once."""
        if instance not in seat.last_words:
            self._notes.append(f"figure {seat.name} has started again")
            return
        seat.is_twice_ns = now_ns
        if seat.told_twice_ns is None or now_ns - seat.told_twice_ns >= TWICE_AGAIN_NS:
            seat.told_twice_ns = now_ns
            self._notes.append(f"figure {seat.name}: {TWICE}")

    def _meet(self, seat: FigureSeat, status: Status, now_ns: int) -> None:
        """Begin a later epoch than that of the conductor before this one, or give way to it.

        A show is given up only for what a figure says for `LOST_NS`: one message may be anyone's.
        """
        if seat.apart_ns is None:
            seat.apart_ns = now_ns
        is_sure = now_ns - seat.apart_ns >= LOST_NS
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
        """Note that the token of a figure has come, or gone: its process or its line is lost."""
        if (seat := self.seats.get(name)) is not None and seat.is_alive != is_alive:
            seat.is_alive = is_alive
            if not is_alive:
                seat.heard_ns = None

    def take_beat(self, beat: Beat, now_ns: int) -> None:
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
            seat.status is not None
            and seat.status.follows == self.instance
            and not seat.is_lost(now_ns)
            for name, seat in self.seats.items()
            if name != self.name
        )

    # ---- what a person or a cue wants

    def load(self, cast: Cast) -> None:
        """Let all figures make this cast ready; what plays is stopped first."""
        self._require_sole()
        if self.wanted == "armed":
            raise InputError("a show plays or waits for its start: stop it first")
        self.cast, self._cast_hash = cast, hash_of(packed(cast))
        self.wanted, self.leg = "ready", None

    def arm(self, now_ns: int, start_s: float = 0.0) -> None:
        """Let the robots move to the start, or another place of the show.

        Raises `InputError` that names figures that are not ready.
        """
        self._require_sole()
        if self.cast is None:
            raise InputError("no show is loaded")
        if self.wanted == "armed":
            return
        if problems := self.problems(now_ns):
            raise InputError("not all figures are ready: " + "; ".join(problems))
        absent = self.absent(now_ns)
        self._notes += [f"starts without {name}: {why}" for name, why in absent.items()]
        self._without = set(absent)
        self.run += 1
        self._start_s = start_s
        self.wanted, self.leg = "armed", None
        self._limit, self._led_rate, self.is_paused = 1.0, 1.0, False
        self.speed, self._is_seeking = 1.0, False

    def start(self, now_ns: int, leader: Leg | None = None) -> NetworkLeg:
        """Make the first leg, that of a leader if there is one.

        Raises `InputError` that names whose robot is not at the start.
        """
        self._require_sole()
        if self.leg is not None:
            return self.leg
        waiting = [seat.name for seat in self._expected() if not self._is_armed(seat, now_ns)]
        if self.wanted != "armed" or waiting:
            names = ", ".join(waiting) or "none was asked"
            raise InputError(f"not all figures stand at the start: {names}")
        at_ns = now_ns + LEAD_NS
        show_s, rate = self._start_s, 1.0
        if leader is not None:
            show_s = leader.at_s(at_ns)
            rate = self._led_rate = min(leader.rate, 1.1)
        self.leg = NetworkLeg(number=1, instant_ns=at_ns, show_s=show_s, rate=rate)
        return self.leg

    def pause(self, now_ns: int) -> None:
        """Let all stand, from an instant `LEAD_NS` ahead."""
        self._require_leg()
        self.is_paused = True
        self._rerate(now_ns)

    def resume(self, now_ns: int) -> None:
        """Go on after `pause`."""
        self._require_leg()
        self.is_paused = False
        self._rerate(now_ns)

    def set_rate(self, ratio: float, now_ns: int) -> float:
        """Play at this share of the speed of the plan until the next start; return which it is.

        It is the nearest one that a figure follows. A paused show has it when it is resumed.
        """
        self._require_leg()
        self.speed = followed_rate(ratio)
        self._rerate(now_ns)
        return self.speed

    def seek(self, show_s: float, now_ns: int) -> None:
        """Go on from another show time: figures brake, move there, and start there together.

        Raises `InputError` for a time that is not in the show.
        """
        leg = self._require_leg()
        duration_s = None if self.cast is None else self.cast.duration_s
        if not 0.0 <= show_s < (float("inf") if duration_s is None else duration_s):
            end = "" if duration_s is None else f", which ends at {duration_s:.1f} s"
            raise InputError(f"{show_s:g} s is not in the show{end}")
        self._is_seeking = True
        self._notes.append(f"the robots go to {show_s:.1f} s of the show")
        self.leg = NetworkLeg(
            number=leg.number + 1, instant_ns=now_ns + LEAD_NS, show_s=show_s, rate=0.0
        )

    def trim(self, instant_ns: int, show_s: float, rate: float, now_ns: int) -> None:
        """Follow a leader: at `instant_ns` the show was at `show_s`, at this rate.

        While the show is paused or slowed down for a figure, it is met only afterwards.
        """
        leg = self._require_leg()
        at_ns = now_ns + LEAD_NS
        if leg.instant_ns > now_ns:
            return  # One leg at a time: figures may not have got the last one yet.
        self._led_rate = min(max(rate, 0.0), 1.1)
        if self.is_paused or self._limit < 1.0:
            self._rerate(now_ns)
            return
        at_s = show_s + rate * (at_ns - instant_ns) / NS_PER_S
        self.leg = NetworkLeg(
            number=leg.number + 1, instant_ns=at_ns, show_s=at_s, rate=self._led_rate
        )

    def stop(self) -> None:
        """Stop all figures. Best effort: this is no emergency stop."""
        if self.wanted == "armed":
            self.wanted = "stopped"

    def end(self) -> None:
        """Note that the show has ended: figures rest, and keep the cast ready."""
        if self.wanted == "armed":
            self.wanted = "ready"
        self.leg = None

    # ---- looking after the figures

    def show_s(self, now_ns: int) -> float | None:
        """Return the show time; None while none plays. Before its start it is negative."""
        return None if self.leg is None else self.leg.at_s(now_ns)

    def tick(self, now_ns: int) -> list[str]:
        """Do what `others` requires; return what a person should know since the last call."""
        if self._begun_ns is None:
            self._begun_ns = now_ns
        for seat in self._cast_seats():
            if seat.status is None and now_ns - self._begun_ns < CONNECT_NS:
                continue
            problem = self._problem(seat, now_ns)
            self._note(seat, problem, now_ns)
            if bool(problem) != bool(seat.problem):
                seat.problem_ns = now_ns if problem else None
            seat.problem = problem
        self._look_after(now_ns)
        notes, self._notes = self._notes, []
        return notes

    def _note(self, seat: FigureSeat, problem: str, now_ns: int) -> None:
        """Tell a person about a figure, unless that was told a moment ago."""
        kind = re.sub(r"\d+", "", problem)
        if kind == seat.noted or now_ns - seat.noted_ns < NOTE_AGAIN_NS:
            return
        self._notes.append(
            f"figure {seat.name}{f': {problem}' if problem else ' takes part again'}"
        )
        seat.noted, seat.noted_ns = kind, now_ns

    def problems(self, now_ns: int) -> list[str]:
        """Return why the show cannot start, a sentence for each figure; empty: it can."""
        found, absent = [], self.absent(now_ns)
        may_go_without = self.others == "go_on" and len(absent) < len(self._cast_seats())
        for seat in self._cast_seats():
            if problem := absent.get(seat.name):
                if not may_go_without:
                    found.append(f"{seat.name}: {problem}")
            elif seat.is_twice(now_ns):
                found.append(f"{seat.name}: {TWICE}")
            elif seat.status is not None and seat.status.state != "ready":
                found.append(f"{seat.name} is {seat.status.state}")
        return found

    def absent(self, now_ns: int, for_ns: int = 0) -> dict[str, str]:
        """Return the figures that cannot take part, and why; those that could not for so long."""
        found = {}
        for seat in self._cast_seats():
            is_long = seat.problem_ns is not None and now_ns - seat.problem_ns >= for_ns
            if (problem := self._problem(seat, now_ns)) and (is_long or for_ns == 0):
                found[seat.name] = problem
        return found

    def warnings(self) -> list[str]:
        """Return what is no reason to refuse a start, but should be known."""
        return [
            f"{seat.name}: its clock is known to {seat.status.bound_ns / NS_PER_MS:.1f} ms only"
            for seat in self._cast_seats()
            if seat.status is not None
            and seat.status.bound_ns is not None
            and seat.status.bound_ns > WARN_NS
        ]

    def has_failed(self, now_ns: int) -> bool:
        """Return whether the player of a figure has ended before the start."""
        return any(
            seat.status is not None
            and (seat.status.epoch, seat.status.run) == (self.epoch, self.run)
            and seat.status.state in ("stopped", "out")
            and bool(self._problem(seat, now_ns))
            for seat in self._expected()
        )

    def is_armed(self, now_ns: int) -> bool:
        """Return whether all robots stand at the start."""
        return self.wanted == "armed" and all(
            self._is_armed(seat, now_ns) for seat in self._expected()
        )

    def _expected(self) -> Sequence[FigureSeat]:
        """Return the figures without which the show does not start."""
        return [seat for seat in self._cast_seats() if seat.name not in self._without]

    def _cast_seats(self) -> Sequence[FigureSeat]:
        parts = self.seats if self.cast is None else self.cast.parts
        return [seat for name, seat in self.seats.items() if name in parts]

    def _is_armed(self, seat: FigureSeat, now_ns: int) -> bool:
        status = seat.status
        return (
            status is not None
            and not self._problem(seat, now_ns)
            and status.run == self.run
            and status.state in PLAYABLE
        )

    def _takes_part(self, seat: FigureSeat, now_ns: int) -> bool:
        """Return whether a figure plays, or has played all of its part."""
        has_ended = seat.status is not None and seat.status.state == "ended"
        return not seat.problem and (has_ended or self._is_armed(seat, now_ns))

    def _problem(self, seat: FigureSeat, now_ns: int) -> str:
        """Return why a figure does not take part; empty: it does, or will."""
        status = seat.status
        if status is None:
            return "it has not connected: is it on, are address and keys right?"
        if seat.is_lost(now_ns):
            return "lost: nothing arrives from it"
        if status.protocol != PROTOCOL:
            return f"it has protocol {status.protocol}, the conductor {PROTOCOL}: same version?"
        if status.state == "out":
            return f"out: {status.text}"
        if status.bound_ns is not None and status.bound_ns > REFUSE_NS and self.leg is None:
            return (
                f"its clock is known to {status.bound_ns / NS_PER_MS:.0f} ms only, allowed are "
                f"{REFUSE_NS / NS_PER_MS:.0f}: the network is too slow or too busy"
            )
        is_mine = status.run == self.run and status.epoch == self.epoch
        is_over = status.state in ("stopped", "holding")
        if self.wanted == "armed" and self.run > 0 and is_mine and is_over:
            return f"it does not play: {status.text or status.state}"
        return ""

    def _look_after(self, now_ns: int) -> None:
        """Go on, slow down or hold, as `others` says, while figures do not take part."""
        if self.leg is None or self.wanted != "armed" or self.leg.instant_ns > now_ns:
            return
        if self._is_seeking:
            self._end_seek(self.leg, now_ns)
        are_all_there = all(self._takes_part(seat, now_ns) for seat in self._cast_seats())
        limit = (
            1.0 if are_all_there else {"go_on": 1.0, "slow": SLOW_RATIO, "hold": 0.0}[self.others]
        )
        if limit == self._limit:
            return
        self._limit = limit
        slower = "the others are slower" if limit else "the others hold"
        self._notes.append("all figures play: the show goes on" if limit == 1.0 else slower)
        self._rerate(now_ns)

    def _end_seek(self, leg: NetworkLeg, now_ns: int) -> None:
        """Go on when all figures that take part stand at the place that was sought."""
        since_ns = now_ns - leg.instant_ns
        there = (
            self._is_there(seat, leg)
            for seat in self._cast_seats()
            if self._takes_part(seat, now_ns)
        )
        if since_ns >= STOOD_NS and (all(there) or since_ns >= SEEK_MAX_NS):
            self._is_seeking = False
            self._rerate(now_ns)

    def _is_there(self, seat: FigureSeat, leg: NetworkLeg) -> bool:
        status = seat.status
        assert status is not None, "it takes part"
        if status.state == "ended":
            return True
        off_s = abs((status.show_s or 0.0) - leg.show_s)
        return status.leg == leg.number and status.stands and off_s < THERE_S

    @property
    def _wanted_rate(self) -> float:
        slower = self._limit * self.speed
        if self.is_paused or self._is_seeking or slower == 0.0:
            return 0.0
        return self._led_rate if slower == 1.0 else self._led_rate * followed_rate(slower)

    def _rerate(self, now_ns: int) -> None:
        """Make a leg with the rate that is wanted, where the present one will have come to."""
        leg = self.leg
        if leg is None or leg.rate == self._wanted_rate:
            return
        at_ns = max(now_ns + LEAD_NS, leg.instant_ns)
        self.leg = NetworkLeg(
            number=leg.number + 1, instant_ns=at_ns, show_s=leg.at_s(at_ns), rate=self._wanted_rate
        )

    def _require_sole(self) -> None:
        if self.superseded:
            raise InputError(self.superseded)

    def _require_leg(self) -> NetworkLeg:
        self._require_sole()
        if self.leg is None or self.wanted != "armed":
            raise InputError("no show plays")
        return self.leg


def followed_rate(ratio: float) -> float:
    """Return the rate next to a ratio that figures follow as it is (`following.FollowRule`)."""
    slowest = min(max(ratio, SLOW_RATE), RUNNING_RATE - SPEED_STEP)
    slower = round(round(slowest / SPEED_STEP) * SPEED_STEP, 3)
    return slower if ratio - slower < 1.0 - ratio else 1.0
