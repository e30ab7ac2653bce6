"""Keeps one show in step with a leader: timecode, or the conductor of many computers.

Another process sends legs: where the leader is, and at what rate it goes on. `Following` steers the
player by what any caller may do: trim its clock, brake, seek, run. A leader that runs evenly costs
trims of at most `TRIM_MAX_RATIO`. Everything else is a place to begin at: the robot stands on its
course at some show time, and begins to move so early that it is in step when it has its speed. If
the leader is elsewhere, the robot first approaches a place that lies in the leader's future. A
leader that stands elsewhere is waited for, or gone to if the rule says so.

A leader that runs between `SLOW_RATE` and `RUNNING_RATE` is followed at its speed, if the rule says
so. When it changes that at an instant that it gave ahead, the ramp of the robot has its middle
there: so it ends in step.
"""

from __future__ import annotations

from collections import deque
from enum import StrEnum
from typing import TYPE_CHECKING, Final, Literal

from msgspec import Struct

from lss_motion.errors import InputError
from lss_motion.playing.player.events import Phase, PlayerRequest, note_nowhere
from lss_motion.playing.player.session import approach_s
from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.units import NS_PER_MS, NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Callable

    from lss_motion.planning.program.model import Program
    from lss_motion.playing.player.player import Player
    from lss_motion.playing.player.streamer import Streamer

OnNoLeader = Literal["go_on", "hold"]

TRIM_MAX_RATIO: Final = 0.005
"""The clock of a show that follows differs from its leader's rate by no more. Such a show is
planned with more headroom than that (`planning.shows.with_headroom`)."""
CLOSING_S: Final = 1.0
"""An error is made up over this time, as far as the trim allows. Chosen: the legs are smooth
already, and a leader that changes its speed by 0.1 % is 1 ms off at most."""
JUMP_S: Final = 0.1
"""An error that is larger is not trimmed away, which would take more than 20 s, but rejoined."""
FOLLOW_NS: Final = NS_PER_S // 10
"""The trim is set this often, and with every new leg."""
RUNNING_RATE: Final = 0.9
"""A leader that is faster than this runs as planned, but for a trim."""
SLOW_RATE: Final = 0.2
"""A leader that is slower than this stands, for who follows it."""
SPEED_STEP: Final = 0.05
"""The speed of a slow leader is known as a multiple of this; the rest is trimmed."""
PROMPT_S: Final = 5e-4
"""The run begins when this near to its instant: the rest is trimmed."""
WAIT_MAX_S: Final = 3.0
"""A robot that is ahead of its leader by more goes back to it instead of waiting for it."""
LATE_MAX_S: Final = 0.03
"""A start that is late by no more is trimmed away, in 6 s at most; else another place is chosen."""
FIRST_SLACK_S: Final = 1.2
"""Added to the time of an approach: to settle, and to ask the servos where they are."""
MORE_SLACK_S: Final = 0.3
"""Added to what was missing, when an approach took too long."""
NAMED_MAX: Final = 20
"""Number of texts of one kind of trouble in a run."""


class FollowingStep(StrEnum):
    """What a show does that follows."""

    WAITING = "waits"
    RUNNING = "in step"
    FREEWHEELING = "freewheels"
    ALONE = "goes on alone"
    HOLDING = "holds"
    JOINING = "rejoins"


class FollowRule(Struct, frozen=True, kw_only=True):
    """What is done without legs: go on for `freewheel_s` (None: for ever), then `lost`."""

    freewheel_s: float | None = 2.0
    lost: OnNoLeader = "go_on"
    slowest: float = RUNNING_RATE
    """A leader that is slower stands. A conductor slows down on purpose, a tape only when a person
    shuttles it."""
    goes_to_it: bool = False
    """Whether the robot goes to where its leader stands: a conductor has sought that place, a tape
    may still be wound."""

    def speed_of(self, leader: LeaderPosition) -> float:
        """Return the rate at which a show runs beside a leader, but for the trim; 0: it stands."""
        if leader.rate >= RUNNING_RATE:
            return 1.0
        if leader.rate < self.slowest:
            return 0.0
        return round(round(leader.rate / SPEED_STEP) * SPEED_STEP, 3)


def require_can_follow(program: Program) -> None:
    """Raise `InputError` for a show that cannot follow a leader."""
    if program.waits:
        raise InputError("a show that waits for a sensor cannot follow a leader: it would be late")


class Following:
    """Follows one leader with one player. Call `turn` each turn, the first one before it moves."""

    def __init__(
        self, rule: FollowRule | None = None, *, place_s: float | None = None, pauses: bool = False
    ) -> None:
        """With `place_s`, a caller lets the show begin there: it is where to join.

        It begins paused: by the caller, or with `pauses` by the first turn.
        """
        self.rule = rule or FollowRule()
        self.step = FollowingStep.WAITING
        self.off_s: float | None = None
        """How far the leader is ahead of the show, while it is in step."""
        self.jumps = 0
        """How often the show was too far off, and rejoined."""
        self.note_request: Callable[[PlayerRequest, int], None] = note_nowhere
        """Notes what decides about the show, for a log."""
        self._leader: LeaderPosition | None = None
        self._coming: LeaderPosition | None = None
        """The next leg of a leader that changes its speed, until its instant."""
        self._led_ns = 0
        self._followed_ns = -FOLLOW_NS
        self._has_begun, self._is_new = place_s is not None and not pauses, False
        self._rate = 0.0
        """As the player was last asked for."""
        self._is_paused = False
        self._is_lost = self._is_beyond = False
        self.is_over = False
        """The leader is gone, and was beyond the end of the show: nothing is left to play."""
        self._slack_s = FIRST_SLACK_S
        self._place_s = place_s
        """Where an approach ends, while it is under way."""
        self._woken_ns = 0
        self._texts: deque[str] = deque(maxlen=64)
        self._named: dict[str, int] = {}

    # ---- what a caller says

    def lead(self, leader: LeaderPosition, now_ns: int) -> None:
        """Note where the leader is. One whose instant is to come stands there until then."""
        if self._is_lost:
            self._say("back", "the leader is back")
        self._is_new, self._is_lost, self.is_over = True, False, False
        self._led_ns = max(now_ns, leader.instant_ns)
        before = self._leader
        is_ahead = leader.instant_ns > now_ns
        one, other = (
            0.0 if before is None else self.rule.speed_of(before),
            self.rule.speed_of(leader),
        )
        if is_ahead and min(one, other) > 0.0 and one != other:
            self._coming = leader  # It goes on as before until then.
        else:
            self._leader, self._coming = leader, None

    def set_paused(self, *, is_paused: bool) -> None:
        """Hold, whatever the leader does, or follow it again."""
        self._is_paused = is_paused

    def take_texts(self) -> list[str]:
        """Return what a person should know, since the last call."""
        texts = list(self._texts)
        self._texts.clear()
        return texts

    # ---- each turn

    def turn(self, player: Player, now_ns: int) -> None:
        """Do what the leader requires now."""
        if not self._has_begun:
            self._has_begun = True
            if self._place_s is None:
                self._hold_before_start(player, now_ns)
            else:
                self.note_request(PlayerRequest("rate", (0.0,)), now_ns)
                player.set_rate(0.0, now_ns)
        show = player.show
        if show is None or player.phase is not Phase.SHOW:
            if player.phase is Phase.RECOVER:  # It goes on only when it is in step again.
                self._run_at(player, 0.0, now_ns)
            return
        before = self.step
        if before is FollowingStep.WAITING:
            self._say("waits", "waits for its leader", most=1)
        self._take_coming(player, show, now_ns)
        leader = self._running_leader(player, show, now_ns)
        if leader is None:
            self._hold(player, show, now_ns)
        elif show.clock.target_rate > 0.0:
            self._keep_step(player, show, leader, now_ns)
        else:
            self._begin(player, show, leader, now_ns)
        if self.step is FollowingStep.RUNNING and before in (
            FollowingStep.WAITING,
            FollowingStep.HOLDING,
            FollowingStep.JOINING,
        ):
            self._say("step", "in step with its leader")
        self._is_new = False

    def _take_coming(self, player: Player, show: Streamer, now_ns: int) -> None:
        """Change the speed half of the ramp before the leader does, which has none."""
        coming = self._coming
        if coming is None:
            return
        speed, present = self.rule.speed_of(coming), show.clock.target_rate
        if present > 0.0 and speed != present and not show.clock.is_ramping(now_ns):
            half_ns = ns_from_s(show.ramp_over_s(abs(speed - present), now_ns)) // 2
            if now_ns < coming.instant_ns - half_ns:
                self._wake(player, coming.instant_ns - half_ns)
            elif self.step is FollowingStep.RUNNING:
                self._run_at(player, speed, now_ns)
        if now_ns >= coming.instant_ns:
            self._leader, self._coming = coming, None

    def _running_leader(self, player: Player, show: Streamer, now_ns: int) -> LeaderPosition | None:
        """Return the leader, if the show has to run or to begin with it."""
        leader = self._leader
        if leader is None or self._is_paused:
            return None
        freewheel_s = self.rule.freewheel_s
        silent_ns = now_ns - self._led_ns
        if freewheel_s is not None and silent_ns > ns_from_s(freewheel_s):
            is_standing = show.clock.target_rate <= 0.0
            is_beyond = self._is_beyond or leader.show_s >= player.program.duration_s
            self.is_over = is_standing and is_beyond
            if not self._is_lost:
                self._is_lost = True
                does = "the show goes on" if self.rule.lost == "go_on" else "the robot holds"
                does = "it was beyond the end of the show, which ends" if self.is_over else does
                self._say("lost", f"no leader for {freewheel_s:g} s: {does}")
            if self.is_over or self.rule.lost == "hold":
                return None
            has_begun = show.show_s(now_ns) >= show.begin_s
            if has_begun and self.rule.speed_of(leader) == 0.0 and show.is_standing(now_ns):
                self._leader = leader = self._alone(show, now_ns)
        return None if self.rule.speed_of(leader) == 0.0 else leader

    def _alone(self, show: Streamer, now_ns: int) -> LeaderPosition:
        """Return a leader with which the show goes on from where it stands, now."""
        before_s = 0.5 * show.ramp_over_s(1.0, now_ns)
        return LeaderPosition(now_ns, show.show_s(now_ns) - before_s, 1.0)

    def _hold(self, player: Player, show: Streamer, now_ns: int) -> None:
        """Stand: at once before the start, else after braking."""
        self.off_s = None
        if show.clock.target_rate <= 0.0:
            if self.step is not FollowingStep.WAITING:
                self.step = FollowingStep.HOLDING
            self._go_to(player, show, now_ns)
        elif show.show_s(now_ns) < show.begin_s:
            self._hold_before_start(player, now_ns)
            self.step = FollowingStep.WAITING
        else:
            self._run_at(player, 0.0, now_ns)
            self.step = FollowingStep.HOLDING

    def _go_to(self, player: Player, show: Streamer, now_ns: int) -> None:
        """Go to where the leader stands, unless that is as near as a pause leaves it."""
        leader, here_s = self._leader, show.show_s(now_ns)
        if not self.rule.goes_to_it or self._is_paused:
            return
        if leader is None or self.rule.speed_of(leader) > 0.0:
            return
        if here_s >= show.begin_s and not show.is_standing(now_ns):
            return
        near_s = show.ramp_over_s(1.0, now_ns) + JUMP_S
        is_in_show = 0.0 <= leader.show_s < player.program.duration_s
        if is_in_show and abs(leader.show_s - here_s) > near_s:
            self.step = FollowingStep.JOINING
            self.note_request(PlayerRequest("seek", (leader.show_s,)), now_ns)
            player.seek(leader.show_s, now_ns)

    def _keep_step(
        self, player: Player, show: Streamer, leader: LeaderPosition, now_ns: int
    ) -> None:
        """Trim the clock; stand if the leader is too far away, to rejoin it from there."""
        if not self._is_new and now_ns - self._followed_ns < FOLLOW_NS:
            return
        self._followed_ns = now_ns
        leader_s = leader.at_s(now_ns)
        if show.show_s(now_ns) < show.begin_s:
            if leader_s > show.begin_s + LATE_MAX_S:
                self._hold_before_start(player, now_ns)
            elif abs(leader_s - show.show_s(now_ns)) > PROMPT_S:
                self._run_from(player, min(leader_s, show.begin_s), now_ns)
            return
        if show.clock.is_ramping(now_ns):
            return
        speed = self.rule.speed_of(leader)
        if show.clock.target_rate != speed:
            if self._coming is None and show.clock.target_rate == self._rate:
                self._run_at(player, speed, now_ns)  # Else a fault has slowed it down.
            return
        leader = leader._replace(instant_ns=now_ns, show_s=leader_s)
        values = (leader_s, leader.rate, TRIM_MAX_RATIO, CLOSING_S)
        self.note_request(PlayerRequest("follow", values), now_ns)
        self.off_s = player.follow(leader, now_ns, TRIM_MAX_RATIO, CLOSING_S)
        if self.off_s is None:
            return
        if abs(self.off_s) > JUMP_S:
            self.jumps += 1
            self._say("jump", f"the leader is {self.off_s:+.2f} s away: the show rejoins it")
            self._run_at(player, 0.0, now_ns)
            self.off_s, self.step = None, FollowingStep.JOINING
            return
        silent_ns = now_ns - self._led_ns
        is_led = silent_ns <= 3 * FOLLOW_NS
        is_alone = FollowingStep.ALONE if self._is_lost else FollowingStep.FREEWHEELING
        self.step = FollowingStep.RUNNING if is_led else is_alone

    def _begin(self, player: Player, show: Streamer, leader: LeaderPosition, now_ns: int) -> None:
        """Begin to run from where the show stands, or go to where the leader will be."""
        leader_s, here_s = leader.at_s(now_ns), show.show_s(now_ns)
        if here_s < show.begin_s:
            if leader_s <= show.begin_s + LATE_MAX_S:
                self._run_from(player, min(leader_s, show.begin_s), now_ns)
                self.step = FollowingStep.RUNNING
            else:
                self._join(player, show, leader, now_ns)
            return
        if not show.is_standing(now_ns):
            return
        speed = self.rule.speed_of(leader)
        ramp_s = show.ramp_over_s(speed, now_ns)
        # While it gains its speed, the show covers half of the way of its leader.
        early_s = (here_s + (0.5 * speed - leader.rate) * ramp_s - leader_s) / leader.rate
        if self._place_s is not None:
            if early_s < -PROMPT_S:
                self._slack_s += MORE_SLACK_S - early_s
            self._place_s = None
        if -LATE_MAX_S <= early_s <= PROMPT_S:
            self._run_at(player, speed, now_ns)
            self.step = FollowingStep.JOINING
        elif 0.0 < early_s <= WAIT_MAX_S or (early_s > 0.0 and here_s <= show.begin_s + JUMP_S):
            self._wake(player, now_ns + ns_from_s(early_s))
        else:
            self._join(player, show, leader, now_ns)

    def _join(self, player: Player, show: Streamer, leader: LeaderPosition, now_ns: int) -> None:
        """Go to a place where the leader will be when the robot has arrived there."""
        leader_s = leader.at_s(now_ns)
        place_s = max(leader_s, 0.0)
        for _ in range(3):  # The way depends on the place, and the place on the way.
            if not 0.0 <= place_s < player.program.duration_s:
                break
            way_s = approach_s(player.robot, show.pose_deg(now_ns), show.pose_at(place_s))
            place_s = max(leader_s + leader.rate * (way_s + self._slack_s), 0.0)
        if not 0.0 <= place_s < player.program.duration_s:
            if not self._is_beyond:
                self._say("end", "the leader is beyond the end of the show: the robot holds")
            self._is_beyond, self.step = True, FollowingStep.HOLDING
            return
        self._is_beyond = False
        self._place_s, self.step = place_s, FollowingStep.JOINING
        self._run_at(player, 0.0, now_ns)
        self.note_request(PlayerRequest("seek", (place_s,)), now_ns)
        player.seek(place_s, now_ns)

    # ---- what the player is asked for

    def _run_at(self, player: Player, rate: float, now_ns: int) -> None:
        if rate == self._rate:
            return
        self._rate = rate
        self._is_beyond = self._is_beyond and rate == 0.0
        self.note_request(PlayerRequest("rate", (rate,)), now_ns)
        player.set_rate(rate, now_ns)

    def _run_from(self, player: Player, show_s: float, now_ns: int) -> None:
        self._rate, self._is_beyond = 1.0, False
        self.note_request(PlayerRequest("run_from", (show_s,)), now_ns)
        player.run_from(show_s, now_ns)

    def _hold_before_start(self, player: Player, now_ns: int) -> None:
        self._rate = 0.0
        self.note_request(PlayerRequest("hold_before_start"), now_ns)
        player.hold_before_start(now_ns)

    def _wake(self, player: Player, instant_ns: int) -> None:
        if abs(instant_ns - self._woken_ns) > NS_PER_MS // 20:
            self._woken_ns = instant_ns
            player.wake_at(instant_ns)

    def _say(self, kind: str, text: str, most: int = NAMED_MAX) -> None:
        count = self._named[kind] = self._named.get(kind, 0) + 1
        if count <= most:
            self._texts.append(text)
