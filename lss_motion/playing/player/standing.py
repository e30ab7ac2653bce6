"""Corrections of a joint at rest, whatever the cause of its error is, and pushes of a hand."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Final

STANDING_DEG: Final = 0.15
"""A joint at rest that is nearer to its plan than this is left alone: two units of an LSS."""
STANDING_SIGMAS: Final = 4.5
READINGS_LEAST: Final = 3
READINGS_MOST: Final = 30
"""A rest is judged by so many readings, and by more where they scatter."""
REST_LEAST_S: Final = 0.25
"""Where the model of the servo is wrong, a rest is judged for at least so long: a horn may be on
its way. One that turns round within ramps a tenth as steep as usual is slow for half of that."""
UNCHANGED_RATIO: Final = 0.1
UNCHANGED_SIGMAS: Final = 2.0
"""A correction had no effect if it changed the error by no more than this share, or than readings
scatter: the play of the gears took all of it up, and the next one is twice the error without any
correction: without a load that is half of the play, so these two are all that is needed."""
PLAY_LEAST_RATIO: Final = 1.2
"""The play is more than the correction that had no effect, at least by so much."""
PLAY_MAX_DEG: Final = 2.0
"""No more play than this is taken up at once. Chosen: more than the gears of any servo have."""
JUMP_LEAST_DEG: Final = 0.25
"""For a smaller error no play is taken up at once: with a load the play may be less than it seems,
and the horn go too far."""
HELPED_RATIO: Final = 0.6
"""A correction has helped if it leaves no more than this share of the error."""
ATTEMPTS_MAX: Final = 4
"""Corrections in one rest that do not help; then the rest is left as it began. More than one, since
the play of the gears takes up the first."""
ATTEMPTS_IN_ALL: Final = 8
MOVING_DEG: Final = 0.2
"""A horn moves if its first and last readings differ by more than this."""
PUSH_DEG: Final = 0.6
PUSH_SIGMAS: Final = 6.0
"""A resting horn that is suddenly off by more than these is pushed, or let go."""
SUDDEN_S: Final = 0.3
"""Time over which it is averaged where a horn is usually. Chosen: several readings."""
PUSH_S: Final = 1.5
"""What pushes for longer than this is a load: it is corrected for."""


@dataclass(slots=True)
class PushDetector:
    """Whether a hand pushes the horn of one joint, at rest or in motion.

    A load changes as the joint turns, and a lag holds a horn on its course. A horn that leaves
    its course suddenly is pushed, until it is back or has been off for `PUSH_S`.
    """

    is_pushed: bool = False
    _usual_deg: float | None = None
    """Distance of the horn from where its load holds it, unless it is pushed."""
    _since_s: float = 0.0
    """When the push began; before, when the last reading was taken."""
    _most_deg: float = 0.0
    """The largest change by this push."""
    _is_back: bool = False
    """Whether the horn has come back half of that way: it was let go, and may be on its way."""

    def take(
        self,
        off_deg: float,
        load_deg: float,
        read_s: float,
        noise_deg: float,
        free_deg: tuple[float, float],
    ) -> bool:
        """Use how far a horn is from where its load holds it; return whether a push is a load now.

        A horn that comes nearer to its profile, which is above it by `load_deg`, is not pushed.
        `noise_deg` is how readings at rest scatter; `free_deg` are the least and largest change of
        the distance of a horn in motion, by timing and play.
        """
        usual_deg = off_deg if self._usual_deg is None else self._usual_deg
        change_deg, far_deg = off_deg - usual_deg, sudden_deg(noise_deg)
        if self.is_pushed:
            self._most_deg = max(self._most_deg, abs(change_deg))
            is_load = read_s - self._since_s >= PUSH_S
            was_back, self._is_back = self._is_back, abs(change_deg) <= 0.5 * self._most_deg
            self.is_pushed = not (is_load or (was_back and self._is_back))
            self._usual_deg = off_deg if is_load else usual_deg
            return is_load
        is_free = free_deg[0] - far_deg <= change_deg <= free_deg[1] + far_deg
        is_nearer = abs(off_deg - load_deg) <= abs(usual_deg - load_deg)
        self.is_pushed = not (is_free or is_nearer)
        self._most_deg, self._is_back = abs(change_deg), False
        share = 0.0 if self.is_pushed else -math.expm1((self._since_s - read_s) / SUDDEN_S)
        self._usual_deg, self._since_s = usual_deg + share * change_deg, read_s
        return False


def sudden_deg(noise_deg: float) -> float:
    """Return from which change on a horn at rest is pushed."""
    return max(PUSH_DEG, PUSH_SIGMAS * noise_deg)


@dataclass(slots=True)
class StandingCorrector:
    """Corrections of one joint while it rests: one at a time, kept only if it helped."""

    _errors_deg: list[float] = field(default_factory=list)
    _since_s: float = 0.0
    """Instant of the first of these readings."""
    _tried_deg: float | None = None
    """Error before the correction that is on trial."""
    _before_deg: float = 0.0
    """Correction before that."""
    _is_jumped: bool = False
    """Whether the play has been taken up at once on this trial."""
    _last_deg: float = 0.0
    """Error before the last correction."""
    _misses: int = 0
    _attempts: int = 0

    def begin(self) -> None:
        """Note that a move was sent: a new rest will follow."""
        if self._errors_deg:
            self._errors_deg.clear()
        self._tried_deg = None
        self._misses, self._attempts = 0, 0

    @property
    def is_undecided(self) -> bool:
        """Whether the next few readings decide about a correction."""
        errors = self._errors_deg
        is_open = bool(errors) and len(errors) <= READINGS_LEAST
        return is_open and abs(errors[-1]) > STANDING_DEG and self._attempts < ATTEMPTS_IN_ALL

    def await_rest(self) -> None:
        """Drop the readings before a correction took effect."""
        self._errors_deg.clear()

    def take(self, error_deg: float, read_s: float, noise_deg: float) -> None:
        """Use a reading of the horn at rest; `error_deg`: how far the plan is above it."""
        errors = self._errors_deg
        if errors and abs(error_deg - sum(errors) / len(errors)) > 0.5 * sudden_deg(noise_deg):
            errors.clear()
        if not errors:
            self._since_s = read_s
        errors.append(error_deg)
        del errors[:-READINGS_MOST]

    def next_offset_deg(
        self, offset_deg: float, now_s: float, noise_deg: float, *, is_modelled: bool = True
    ) -> float | None:
        """Return the correction that shall replace `offset_deg`; None: it stays.

        Unless the servo `is_modelled` well, the horn may still be on its way.
        """
        count = len(self._errors_deg)
        if count < READINGS_LEAST:
            return None
        still_deg = max(MOVING_DEG, 4.0 * noise_deg) if is_modelled else MOVING_DEG
        if abs(self._errors_deg[-1] - self._errors_deg[0]) > still_deg:
            del self._errors_deg[0]  # It is still on its way.
            self._since_s = now_s
            return None
        if not is_modelled and now_s - self._since_s < REST_LEAST_S:
            return None
        error_deg = sum(self._errors_deg) / count
        spread = sum((one - error_deg) ** 2 for one in self._errors_deg) / (count - 1)
        scatter_deg = max(noise_deg, math.sqrt(spread)) / math.sqrt(count)
        least_deg = max(STANDING_DEG, STANDING_SIGMAS * scatter_deg)
        if self._tried_deg is not None and self._has_failed(error_deg, least_deg):
            self._tried_deg = None
            return self._before_deg
        if abs(error_deg) <= least_deg or self._attempts >= ATTEMPTS_IN_ALL:
            return None
        self._attempts += 1
        return offset_deg + self._step_deg(error_deg, offset_deg, scatter_deg)

    def _has_failed(self, error_deg: float, least_deg: float) -> bool:
        """Judge the correction that is on trial, where readings tell; return whether it ends."""
        assert self._tried_deg is not None
        if abs(error_deg) <= max(HELPED_RATIO * abs(self._tried_deg), 0.5 * least_deg):
            self._tried_deg, self._misses = None, 0
        elif abs(error_deg) > least_deg:
            self._misses += 1
            if self._misses == ATTEMPTS_MAX:
                self._attempts = ATTEMPTS_IN_ALL
                return True
        return False

    def _step_deg(self, error_deg: float, offset_deg: float, scatter_deg: float) -> float:
        """Return by how much the correction shall change: the error, or once all of the play."""
        changed_deg = abs(error_deg - self._last_deg)
        same_deg = UNCHANGED_SIGMAS * math.sqrt(2.0) * scatter_deg
        same_deg = max(UNCHANGED_RATIO * abs(self._last_deg), same_deg)
        is_stuck = self._misses > 0 and not self._is_jumped and changed_deg <= same_deg
        self._last_deg = error_deg
        if self._tried_deg is None:
            self._tried_deg, self._before_deg, self._is_jumped = error_deg, offset_deg, False
        if not is_stuck or abs(error_deg) <= JUMP_LEAST_DEG:
            return error_deg
        self._is_jumped = True
        bare_deg = abs(self._tried_deg + self._before_deg)
        taken_up_deg = abs(offset_deg - self._before_deg - self._tried_deg)
        play_deg = min(2.0 * bare_deg, PLAY_MAX_DEG) - taken_up_deg
        return math.copysign(max(play_deg, PLAY_LEAST_RATIO * abs(error_deg)), error_deg)
