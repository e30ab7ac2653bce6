"""The timecode of a stage: where it is, the cues that it passes, and the show that follows it.

    take(leg, now_ns)            takes where the timecode is, at instants of the stage
    turn(director, now_ns)       reads the source, and tells the director
    prepare(director, ...)       lets the next show wait at its beginning
    begin(order, player, ...)    lets a show follow, if there is time to get into it
    steer(player, ...)           keeps that show in step (`playing.player.following`)

Positions are the timecode minus `offset_s`, in seconds.

`Sending` is the way out: the show clock of the shows that play for cues. The idle show and the way
to the rest send nothing: between shows the timecode stands where the last show was left.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Protocol

from lss_motion.errors import InputError
from lss_motion.playing.player.following import FIRST_SLACK_S, RUNNING_RATE, Following, FollowRule
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.stage.timecode.chase import ChaseState
from lss_motion.stage.timecode.timecode import read_follow, read_send
from lss_motion.stage.triggering import JUMP_S
from lss_motion.system.clock_leg import ClockLeg
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    import contextlib
    from collections.abc import Callable, Sequence

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.remote.schema import Follow
    from lss_motion.stage.director import Director
    from lss_motion.stage.file import SendOutput, TimecodeInput
    from lss_motion.stage.orders import OrderedShow, PlayOrder
    from lss_motion.stage.timecode.source import LegSource
    from lss_motion.stage.timecode.timecode import FollowSpec, SendSpec

LEAVE_S: Final = 1.8
"""Added to the way to a show, for braking the one before and asking the servos where they are. A
simulated robot of seven joints took 1.0 s in a process of its own, 0.4 s in virtual time; a robot
that comes too late rejoins some 4 s later."""
READY_S: Final = 1.0
"""A robot is at the beginning of a show this much before the timecode."""
READY_MAX_S: Final = 60.0
"""A robot that waits there is sent away if the timecode is further than this before it. Chosen: a
show that is wound back to its count-in; from further away there is time to come again."""
PREPARE_NS: Final = NS_PER_S // 4
SILENT_NS: Final = NS_PER_S
"""Legs come twice a second at least; without one for so long it is a freewheel."""


def spec_of(given: TimecodeInput) -> FollowSpec:
    """Return the source that a stage file names; raises `InputError`."""
    rest = "" if given.input == "default" else f":{given.input}"
    # FPP sends seconds: with it the rate is that of the timecodes in the stage file.
    has_rate = given.rate_fps is not None and given.source != "fpp"
    rate = f"{given.rate_fps:g}" if has_rate else None
    return read_follow(
        f"{given.source}{rest}", rate=rate, offset=given.offset_s, freewheel_s=given.freewheel_s
    )


class StageTimecode:
    """The timecode of one stage, through all runs of the player."""

    def __init__(self, given: TimecodeInput, legs: LegSource | None = None) -> None:
        """`legs`: where it comes from; None: only from `take`."""
        self._given, self._legs = given, legs
        self._rule = FollowRule(freewheel_s=given.freewheel_s, lost=given.lost)
        self._leg: LeaderPosition | None = None
        self._source, self._word, self._song = "", ChaseState.SEARCHING.value, ""
        self._received_ns = 0
        self._is_new = self._is_lost = False
        self._texts: list[str] = []
        self.following: Following | None = None
        """Keeps the present show in step; None: it does not follow."""
        self.number = 0
        """Of the order by which the show plays that follows; 0: none does."""
        self._offset_ns = self._prepared_ns = 0
        self._begun_song = ""
        """What was played when the show that follows began."""
        self._begins_s = self._lasts_s = 0.0
        """Of the show that follows: the position at show time 0, and its duration."""

    def filenos(self) -> Sequence[int]:
        """Return what ends a wait."""
        return () if self._legs is None else self._legs.filenos()

    # ---- where it is

    def take(self, leg: Follow, now_ns: int) -> None:
        """Take where the timecode is; the instant is one of the stage."""
        self._leg = LeaderPosition(leg.instant_ns, leg.show_s, leg.rate)
        self._received_ns, self._is_new, self._is_lost = now_ns, True, False
        self._source = leg.source or self._source
        self._song = leg.song
        running = ChaseState.LOCKED if leg.rate >= RUNNING_RATE else ChaseState.STANDING
        self._word = leg.state or running.value

    def turn(self, director: Director, now_ns: int) -> None:
        """Read the source, and tell the director what the timecode does."""
        before = self._state(now_ns)
        for leg in () if self._legs is None else self._legs.take():
            self.take(leg, now_ns)
        if self._is_new and self._leg is not None:
            self._is_new = False
            self._leave_elsewhere(director, now_ns)
            at_s = self._leg.at_s(now_ns)
            director.take_timecode(at_s, self._leg.rate, now_ns, self._song)
            if self.following is not None:
                self.following.lead(self._led(), now_ns - self._offset_ns)
        elif self._leg is not None and not self._is_lost:
            self._is_lost = now_ns - self._received_ns > ns_from_s(self._given.freewheel_s)
            if self._is_lost:
                director.take_timecode(None, 0.0, now_ns)
                self._wait_without(director, now_ns)
        if self.following is not None and self.following.is_over:
            director.leave(self.number, now_ns)
        self._texts += () if self._legs is None else self._legs.take_texts()
        after = self._state(now_ns)
        if after != before and ChaseState.SEARCHING.value not in (after, before):
            self._texts.append(f"{after}, at {self._text(now_ns)}")
        elif after != before:
            self._texts.append(f"{after} to {self._source or self._given.source}")

    def take_texts(self) -> list[str]:
        """Return what a person should know, since the last call."""
        own, self._texts = self._texts, []
        if self.following is not None:
            own += self.following.take_texts()
        return [f"timecode: {text}" for text in own]

    # ---- the show that follows

    def prepare(self, director: Director, player: Player, now_ns: int, player_ns: int) -> None:
        """Let the next show wait at its beginning, when it is time to go there."""
        if now_ns < self._prepared_ns + PREPARE_NS or player.outcome is not None:
            return
        self._prepared_ns = now_ns
        if (coming := director.coming(now_ns)) is None or coming[1] > READY_MAX_S:
            return
        cue, ahead_s = coming
        way_s = player.way_s(player.repertoire.programs[cue.shows[0]], None, player_ns)
        if ahead_s <= LEAVE_S + way_s + FIRST_SLACK_S + READY_S:
            director.get_ready(cue, now_ns)

    def begin(
        self, order: PlayOrder, program: Program, player: Player, now_ns: int, offset_ns: int
    ) -> float | None:
        """Return the show time at which a show is to join the timecode.

        None: it plays by itself, since there is no timecode now, or it would be over by then.
        `now_ns` is the player's, `offset_ns` what the instants of the stage are later.
        """
        self.leave()
        has_leg = self._leg is not None and not self._is_lost
        if order.follows_s is None or not (has_leg or order.waits):
            return None
        self._begins_s, self._lasts_s = order.follows_s, program.duration_s
        self._offset_ns = offset_ns
        if order.waits:
            self.following, self.number = Following(self._rule), order.number
            if has_leg:
                self.following.lead(self._led(), now_ns)
            return None
        assert self._leg is not None
        leader_s = self._led().at_s(now_ns)
        way_s = player.way_s(program, max(leader_s, 0.0), now_ns)
        place_s = max(leader_s + self._leg.rate * (LEAVE_S + way_s + FIRST_SLACK_S), 0.0)
        if not place_s < program.duration_s:
            self._texts.append(
                f"show {order.show} plays by itself: it would be over before it has joined"
            )
            return None
        self.following = Following(self._rule, place_s=place_s)
        self.following.lead(self._led(), now_ns)
        self.number, self._begun_song = order.number, self._song
        return place_s

    def leave(self) -> None:
        """Let nothing follow any more."""
        self.following, self.number = None, 0

    def steer(self, player: Player, now_ns: int, *, is_paused: bool) -> None:
        """Keep the show in step; before, while the last show is left, nothing is to be done."""
        if self.following is not None and not player.is_leaving and player.outcome is None:
            self.following.set_paused(is_paused=is_paused)
            self.following.turn(player, now_ns)

    def leader(self, begins_s: float) -> LeaderPosition | None:
        """Return the timecode as show time of a show that begins at a position; None: lost."""
        if self._leg is None or self._is_lost:
            return None
        return self._leg._replace(show_s=self._leg.show_s - begins_s)

    def _led(self) -> LeaderPosition:
        """Return the leg of the show that follows, at instants of the player."""
        assert self._leg is not None
        instant_ns, at_s, rate = self._leg
        return LeaderPosition(instant_ns - self._offset_ns, at_s - self._begins_s, rate)

    def _wait_without(self, director: Director, now_ns: int) -> None:
        """Let a show that waits go on waiting without timecode, if it is to, or leave it.

        Without this it would freewheel into its beginning. A source that stood may send nothing.
        """
        assert self._leg is not None
        if self.following is None or not director.is_ready(self.number):
            return
        if director.waits_on(self.number):
            self.following = Following(self._rule)
        elif self._leg.rate >= RUNNING_RATE:
            director.leave(self.number, now_ns)

    def _leave_elsewhere(self, director: Director, now_ns: int) -> None:
        """Leave a show that follows if the timecode has jumped out of it."""
        assert self._leg is not None
        is_ready = director.is_ready(self.number)
        if self.following is None or (self._leg.rate < RUNNING_RATE and not is_ready):
            return
        show_s = self._leg.at_s(now_ns) - self._begins_s
        early_s = READY_MAX_S if is_ready else JUMP_S
        if is_ready:
            self._begun_song = self._song
        is_other = self._song != self._begun_song
        if is_other or not -early_s <= show_s <= self._lasts_s + JUMP_S:
            self._texts.append("the timecode has left the show")
            director.leave(self.number, now_ns)

    # ---- for operators

    def _state(self, now_ns: int) -> str:
        if self._leg is None:
            return ChaseState.SEARCHING.value
        if self._is_lost:
            return ChaseState.LOST.value
        is_silent = now_ns - self._received_ns > SILENT_NS
        return ChaseState.FREEWHEELING.value if is_silent else self._word

    def _text(self, now_ns: int) -> str:
        if self._leg is None:
            return ""
        seconds = int(self._leg.at_s(now_ns) + self._given.offset_s) % 86400
        return f"{seconds // 3600:02}:{seconds // 60 % 60:02}:{seconds % 60:02}"

    def state_of(self, now_ns: int) -> dict[str, Any]:
        """Return the fields of `playing.remote.stage_messages.TimecodeState`."""
        following = self.following
        off_s = None if following is None else following.off_s
        return {
            "state": self._state(now_ns),
            "source": self._source or self._given.source,
            "at": self._text(now_ns),
            "rate": None if self._leg is None else round(self._leg.rate, 6),
            "show": None if following is None else following.step.value,
            "off_ms": None if off_s is None else round(1000.0 * off_s, 2),
        }


class Out(Protocol):
    """A receiver of timecode: a `stage.timecode.source.TimecodeOut`, or a test."""

    def send_clock(self, leg: ClockLeg, show: str) -> None:
        """Send the clock of a show from now on; the same leg again changes nothing."""


def send_spec_of(output: SendOutput) -> SendSpec:
    """Return the receiver that a stage file names; raises `InputError`."""
    rest = "" if output.output == "default" else f":{output.output}"
    return read_send(f"{output.kind}{rest}", rate=f"{output.rate_fps:g}", offset=output.offset_s)


def opened(
    outputs: Sequence[SendOutput], stack: contextlib.ExitStack, tell: Callable[[str], None]
) -> list[Out]:
    """Open the receivers; one that cannot be opened is named, and the stage plays without it."""
    from lss_motion.stage.timecode.source import TimecodeOut

    outs: list[Out] = []
    for output in outputs:
        try:
            out = stack.enter_context(TimecodeOut(send_spec_of(output)))
        except InputError as error:
            tell(f"{error}: the stage plays without it")
        else:
            tell(f"sends {out.text}")
            outs.append(out)
    return outs


class Sending:
    """Sends the show clock of one stage. `turn` is called on each turn of the player.

    A pause and a trim are in the legs of that clock; a receiver is told only of new ones.
    """

    def __init__(self, outs: Sequence[Out] = ()) -> None:
        self._outs = outs
        self._show = ""
        self._last_s = 0.0
        self._stands: ClockLeg | None = None

    def turn(self, player: Player, main: OrderedShow | None, now_ns: int) -> None:
        """Send the clock of `main` if it plays for a cue; None: it has not begun."""
        if not self._outs:
            return
        if main is not None and main.cue is not None and player.show is not None:
            self._show, self._stands, leg = main.show, None, player.show.clock.leg
            # It is over a moment after its end, when the servos have arrived.
            self._last_s = min(player.show.show_s(now_ns), player.program.duration_s)
        elif self._show:
            self._stands = self._stands or ClockLeg(now_ns, self._last_s, 0.0, 0.0, 0)
            leg = self._stands
        else:
            return
        for out in self._outs:
            out.send_clock(leg, self._show)
