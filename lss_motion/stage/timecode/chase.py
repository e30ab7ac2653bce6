"""Chases timecode: from single frames to legs, which say where the leader is and how it goes on.

`Chase` is pure: it gets observations with the instants at which they were true, and `advance` with
the time. What was read is checked for consistency before anything follows it; then rate and phase
are a weighted regression over the last seconds, so that the jitter of the way is smoothed.

    searching      nothing consistent yet
    locked         the leader runs
    freewheeling   nothing comes, or nothing that fits: the last leg is continued
    lost           that for longer than `freewheel_s`
    standing       the leader stands; legs have rate 0, as in the two states that follow
    reverse        it runs backward
    off_speed      it runs at another speed than a robot can follow, or is wound
"""

from __future__ import annotations

import math
from collections import deque
from enum import StrEnum
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct

from lss_motion.playing.player.show_clock import LeaderPosition
from lss_motion.units import NS_PER_S, ns_from_s

if TYPE_CHECKING:
    from collections.abc import Sequence

RATE_MAX_RATIO: Final = 0.005
"""A leader that is further from its nominal speed is not followed: no show is trimmed by more."""
RATE_SLACK_RATIO: Final = 0.0005
"""A leader that was off speed is followed again when it is nearer than the limit by this."""
PRIOR_RATIO: Final = 0.002
"""Speeds of leaders differ from nominal by about this: crystals by 0.0001, pull-down by 0.001. A
fit over a short time is damped accordingly."""
PULL_DOWN_RATIO: Final = 1.0 / 1.001
PULL_DOWN_BAND: Final = 2e-4
LEG_NS: Final = NS_PER_S // 10
"""A leg is made this often while the leader runs, and at once when it changes what it does."""
STANDING_LEG_NS: Final = NS_PER_S // 2
JUDGED_S: Final = 1.0
"""The speed of a leader is judged after this time."""
SURE_ERRORS: Final = 5.0
"""A verdict on the speed of a leader is given when it is so many standard errors clear."""
FEW_COUNT: Final = 4
"""The typical jitter counts as so many points of a fit: a few points do not show theirs."""
CONSISTENT_RATIO: Final = 0.06
"""Two frames whose distance differs by more from the time between them are not consecutive."""
ASTRAY_S: Final = 0.3
ASTRAY_COUNT: Final = 4
"""A leader from which so many frames came over `ASTRAY_S`, none of which fits, is wound."""
STANDING_COUNT: Final = 3
SOURCES_NAMED_MAX: Final = 8


class ChaseState(StrEnum):
    """What the leader does, as far as is known."""

    SEARCHING = "searching"
    LOCKED = "locked"
    FREEWHEELING = "freewheeling"
    LOST = "lost"
    STANDING = "standing"
    REVERSE = "reverse"
    OFF_SPEED = "off_speed"


HELD: Final = (ChaseState.STANDING, ChaseState.REVERSE, ChaseState.OFF_SPEED)
"""While the leader does this, a robot that follows it holds."""


class TimecodeObservation(NamedTuple):
    """The leader was at `position_s` at `instant_ns`; `direction` 1 forward, -1 back, 0 stands."""

    instant_ns: int
    position_s: float
    direction: int = 1
    song: str = ""
    """What the leader plays, where it says so."""


class Style(Struct, frozen=True, kw_only=True):
    """How a way of transport is read."""

    jitter_s: float
    """Typical error of an instant."""
    jump_s: float
    """An observation further from the fit than this does not fit."""
    lock_count: int
    """So many consistent observations in a row lock."""
    window_s: float
    """Older observations do not count."""
    gap_s: float
    """Without an observation for so long the leader is not there."""


LTC: Final = Style(jitter_s=5e-5, jump_s=0.01, lock_count=2, window_s=4.0, gap_s=0.2)
MTC: Final = Style(jitter_s=6e-3, jump_s=0.04, lock_count=16, window_s=5.0, gap_s=0.2)
ART_NET: Final = Style(jitter_s=5e-3, jump_s=0.08, lock_count=3, window_s=8.0, gap_s=0.4)
FPP: Final = Style(jitter_s=5e-3, jump_s=0.15, lock_count=2, window_s=20.0, gap_s=3.0)
"""Chosen. Jitters: of a sound input; of MIDI through JACK, which hands over at once what came in a
period of 21 ms; of a busy network. The gap is a few frames, of FPP the longest time between two
packets."""


class Chase:
    """Follows one leader. Positions are seconds from the start of the show."""

    def __init__(self, style: Style, *, freewheel_s: float = 2.0) -> None:
        self.state = ChaseState.SEARCHING
        self.rate = 1.0
        """Of the leader, as fitted."""
        self.source = ""
        """The source that is followed, once there was one."""
        self.song = ""
        """What the leader plays, where it says so: of the observations that fit."""
        self.ignored = 0
        """Observations that did not fit, or came from another source."""
        self._rate_error = math.inf
        """Standard error of `rate`."""
        self._style = style
        self._freewheel_ns = ns_from_s(freewheel_s)
        self._points: deque[TimecodeObservation] = deque()
        self._chain: list[TimecodeObservation] = []
        self._last: TimecodeObservation | None = None
        self._fitted_at: TimecodeObservation | None = None
        """Where the fit has its origin, and the position there."""
        self._good_ns = self._leg_ns = self._received_ns = 0
        self._since_ns = 0
        self._astray = self._still = 0
        self._held_s = 0.0
        self._legs: deque[LeaderPosition] = deque(maxlen=64)
        self._texts: deque[str] = deque(maxlen=64)
        self._reported: set[str] = set()

    # ---- what comes

    def take(self, observation: TimecodeObservation, source: str = "") -> None:
        """Take what was read. Instants of one source do not decrease, or it is ignored."""
        if not self._is_from_leader(source, observation.instant_ns):
            self.ignored += 1
            return
        self._received_ns = observation.instant_ns
        before, self._last = self._last, observation
        if before is not None and observation.instant_ns < before.instant_ns:
            self.ignored += 1
            return
        if observation.direction == 0:
            self._hold(ChaseState.STANDING, observation)
        elif before is not None and observation[1:] == before[1:]:
            self._still += 1
            if self._still >= STANDING_COUNT:
                self._hold(ChaseState.STANDING, observation)
        elif observation.direction < 0:
            self._still = 0
            if before is not None and before.direction < 0:
                self._hold(ChaseState.REVERSE, observation)
        else:
            self._still = 0
            self._take_forward(observation)

    def advance(self, now_ns: int) -> None:
        """Let time pass: what has not come for too long is gone, and legs are due."""
        silent_ns = now_ns - self._good_ns
        if self.state is ChaseState.LOCKED and silent_ns > ns_from_s(self._style.gap_s):
            self._enter(ChaseState.FREEWHEELING)
        if self.state in HELD and now_ns - self._received_ns > self._freewheel_ns:
            self._enter(ChaseState.LOST)
            self._forget()
        if self.state is ChaseState.FREEWHEELING and silent_ns > self._freewheel_ns:
            self._enter(ChaseState.LOST)
            self._forget()
        self._add_due_leg(now_ns)

    def take_legs(self) -> list[LeaderPosition]:
        """Return the legs since the last call, oldest first."""
        legs = list(self._legs)
        self._legs.clear()
        return legs

    def take_texts(self) -> list[str]:
        """Return what a person should know, since the last call."""
        texts = list(self._texts)
        self._texts.clear()
        return texts

    def add_text(self, text: str) -> None:
        """Tell a person, each time."""
        self._texts.append(text)

    def say(self, text: str) -> None:
        """Tell a person once."""
        if text not in self._reported and len(self._reported) < SOURCES_NAMED_MAX:
            self._reported.add(text)
            self._texts.append(text)

    # ---- which leader

    def _is_from_leader(self, source: str, now_ns: int) -> bool:
        """Return whether it is the source that came first, or that one is gone."""
        if source == self.source:
            return True
        is_gone = now_ns - self._received_ns > self._freewheel_ns
        if not self._received_ns or is_gone:
            if self._received_ns:
                self.say(f"timecode of {source} is followed now: that of {self.source} has ended")
            self.source = source
            self._forget()
            self._last = None
            return True
        self.say(f"timecode of {source} is ignored: that of {self.source} came first")
        return False

    # ---- forward

    def _take_forward(self, observation: TimecodeObservation) -> None:
        off_s = self._off_s(observation)
        if off_s is not None and abs(off_s) <= self._style.jump_s:
            self._chain.clear()
            self._accept(observation)
            return
        self._astray += 1
        chain = self._chain
        if chain and not self._is_consistent(chain[-1], observation):
            chain.clear()
        chain.append(observation)
        if len(chain) >= self._style.lock_count:
            if off_s is not None and self.state is ChaseState.LOCKED:
                self._texts.append(f"timecode jumps by {off_s:+.2f} s")
            self._lock()
            return
        self.ignored += 1
        is_long = observation.instant_ns - self._good_ns > ns_from_s(ASTRAY_S)
        if self._good_ns and is_long and self._astray >= ASTRAY_COUNT and self.state not in HELD:
            self._hold(ChaseState.OFF_SPEED, observation)

    def _is_consistent(self, one: TimecodeObservation, other: TimecodeObservation) -> bool:
        passed_s = (other.instant_ns - one.instant_ns) / NS_PER_S
        way_s = other.position_s - one.position_s
        slack_s = 4.0 * self._style.jitter_s + CONSISTENT_RATIO * passed_s
        return abs(way_s - passed_s) <= slack_s and passed_s <= self._style.gap_s + 0.1

    def _lock(self) -> None:
        self._points = deque(self._chain)
        self._since_ns = self._points[0].instant_ns
        self._chain.clear()
        self._fit()
        self._good_ns, self._astray = self._points[-1].instant_ns, 0
        self.song = self._points[-1].song
        self._enter(ChaseState.LOCKED)
        self._add_leg(self._good_ns)

    def _accept(self, observation: TimecodeObservation) -> None:
        self._points.append(observation)
        oldest_ns = observation.instant_ns - ns_from_s(self._style.window_s)
        while self._points[0].instant_ns < oldest_ns:
            self._points.popleft()
        self._good_ns, self._astray = observation.instant_ns, 0
        self.song = observation.song
        if self.state is not ChaseState.LOCKED and self.state is not ChaseState.OFF_SPEED:
            self._enter(ChaseState.LOCKED)
        # Not as often as legs: `advance` adds them, too, and then none would be due here.
        if self._fitted_at is None or observation.instant_ns - self._fitted_at.instant_ns >= LEG_NS:
            self._fit()
            self._judge_speed(observation)
            self._add_due_leg(observation.instant_ns)

    # ---- rate and phase

    def _off_s(self, observation: TimecodeObservation) -> float | None:
        """Return how far an observation is from the fit; None: there is none."""
        if self._fitted_at is None:
            return None
        return observation.position_s - self._position_s(observation.instant_ns)

    def _position_s(self, instant_ns: int) -> float:
        at = self._fitted_at
        assert at is not None, "nothing is fitted"
        return at.position_s + self.rate * (instant_ns - at.instant_ns) / NS_PER_S

    def _fit(self) -> None:
        """Fit a line through the points; newer ones count for more."""
        last = self._points[-1]
        times_s, lates_s = _relative(self._points, last)
        weights = np.exp(2.0 * times_s / self._style.window_s)
        total = float(weights.sum())
        middle_s = float((weights * times_s).sum()) / total
        late_s = float((weights * lates_s).sum()) / total
        away_s = times_s - middle_s
        damping = (self._style.jitter_s / PRIOR_RATIO) ** 2
        weighted_s = weights * away_s
        spread = float(weighted_s @ away_s) + damping
        slope = float(weighted_s @ lates_s) / spread
        self.rate = 1.0 + slope
        rest_s = lates_s - late_s - slope * away_s
        known = FEW_COUNT * self._style.jitter_s**2 + float(rest_s @ rest_s)
        jitter_s = math.sqrt(known / max(len(self._points) - 2, 1))
        self._rate_error = jitter_s * math.sqrt(float(weighted_s @ weighted_s)) / spread
        position_s = last.position_s + late_s - slope * middle_s
        self._fitted_at = last._replace(position_s=position_s)

    def _judge_speed(self, observation: TimecodeObservation) -> None:
        """Hold while the leader is too fast or too slow to be followed."""
        if observation.instant_ns - self._since_ns < ns_from_s(JUDGED_S):
            return
        off_ratio = abs(self.rate - 1.0)
        unsure_ratio = SURE_ERRORS * self._rate_error
        if self.state is ChaseState.OFF_SPEED:
            if off_ratio < RATE_MAX_RATIO - RATE_SLACK_RATIO:
                self._enter(ChaseState.LOCKED)
                self._add_leg(observation.instant_ns)
        elif off_ratio - unsure_ratio > RATE_MAX_RATIO:
            self._texts.append(
                f"timecode runs at {self.rate:.3f} of its speed, more than "
                f"{100.0 * RATE_MAX_RATIO:g} % off: the robot holds until it is slower or faster"
            )
            self._hold(ChaseState.OFF_SPEED, observation)
        elif abs(self.rate - PULL_DOWN_RATIO) < PULL_DOWN_BAND and unsure_ratio < off_ratio:
            self.say(
                "timecode runs at 0.999 of its speed, as 23.976 or 29.97 frames a second that are "
                "labelled as 24 or 30: followed as it runs. If its seconds are to count instead, "
                "ask for the rate 23.976 or 29.97"
            )

    # ---- legs

    def _hold(self, state: ChaseState, observation: TimecodeObservation) -> None:
        """Note that the leader does not run as it should; legs stand there."""
        self._good_ns = observation.instant_ns
        self._held_s, self.song = observation.position_s, observation.song
        if state is not ChaseState.OFF_SPEED:
            self._forget()
        if self.state is not state:
            self._enter(state)
            self._add_leg(observation.instant_ns)

    def _forget(self) -> None:
        self._points.clear()
        self._chain.clear()
        self._fitted_at = None
        self._astray = 0

    def _enter(self, state: ChaseState) -> None:
        self.state = state

    def _add_due_leg(self, now_ns: int) -> None:
        is_held = self.state in HELD
        every_ns = STANDING_LEG_NS if is_held else LEG_NS
        has_legs = self._received_ns > self._leg_ns if is_held else self.state is ChaseState.LOCKED
        if has_legs and now_ns - self._leg_ns >= every_ns:
            self._add_leg(now_ns)

    def _add_leg(self, now_ns: int) -> None:
        self._leg_ns = now_ns
        if self.state in HELD:
            self._legs.append(LeaderPosition(now_ns, self._held_s, 0.0))
        else:
            self._legs.append(LeaderPosition(now_ns, self._position_s(now_ns), self.rate))


def _relative(
    points: Sequence[TimecodeObservation] | deque[TimecodeObservation], last: TimecodeObservation
) -> tuple[
    np.ndarray[tuple[int], np.dtype[np.float64]], np.ndarray[tuple[int], np.dtype[np.float64]]
]:
    """Return seconds before `last`, and how much further than the clock the leader has gone."""
    times_s = np.array([p.instant_ns - last.instant_ns for p in points]) / NS_PER_S
    ways_s = np.array([p.position_s - last.position_s for p in points])
    return times_s, ways_s - times_s
