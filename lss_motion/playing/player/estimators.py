"""Estimators for one joint from its readings: load, play and lag.

A bus without checksums can deliver a wrong number that looks right, so `DisturbanceEstimator` first
checks that a reading is plausible. It keeps the correction: what is added to the targets of a
joint, within bounds.

`HornEstimator` estimates why the horn is not where the response model has it: a load, the play of
the gears, a lag. What no such cause explains, as wrong ramps or a weak motor, makes it less sure,
and corrections that make the errors larger are dropped.

`Swing` knows in which direction a joint turns, and whether its horn may stand within the play.

`Trace` keeps readings for a picture.
"""

from __future__ import annotations

import math
import operator
from dataclasses import dataclass, field
from typing import Final

JUMP_MARGIN_DEG: Final = 5.0
"""A horn may seem to jump this far beyond what its speed allows: noise, backlash and lag."""
OFFSET_MAX_DEG: Final = 7.5
"""Largest correction (FACTS.md A20): three quarters of the distance at which a joint is astray."""
OFFSET_RATE_DEG_S: Final = 10.0
"""Fastest change of a correction: a tenth of the speed of an ordinary move."""

USUAL: Final = (2.0, 2.0, 2.0, 0.5, 0.03)
"""What load (deg), play (deg) and lag (s) are expected to be before anything is known, as standard
deviations."""
DRIFT: Final = (0.05, 0.05, 0.05, 0.02, 0.003)
"""So much they change in a second, besides with the angle. Chosen: a reading that scatters by half
a degree moves the load by a fiftieth of that, and a load that is new is known after a second."""
SMALL_DEG: Final = 0.1
"""A smaller load is not corrected: a unit of an LSS. One of twice as much is corrected fully."""
UNSEEN_DEG: Final = 0.5
"""By so much a load may be larger than any that was seen at rest: half of the play of worn gears,
which shows in motion only."""
UNSEEN_SIGMAS: Final = 2.0
"""What exceeds that must be so many times surer. Measured: of 4 random shows on servos that begin
each move at rest, whose RMS was 1.03 times as large in the first second, one is left; load and play
are corrected as before. Where all loads must be so sure, gains with a load of 3 deg fall by 10 %,
with play by 25 %."""
NOISE_DEG: Final = 0.3
NOISE_LEAST_DEG: Final = 0.03
"""Scatter of readings at rest, before it is known, and at the least (FACTS.md E7, P15)."""
NOISE_S: Final = 3.0
"""Time over which the scatter is averaged."""
NOISE_READINGS: Final = 2
"""What is assumed of the scatter counts as much as so many readings."""
TIMING_S: Final = 0.015
TIMING_LEAST_S: Final = 0.004
"""Uncertainty of the instants in motion, before it is known, and at the least: an error by timing
grows with the speed. So the less a moving horn does what is expected, the less it says of the
load."""
MOTION_S: Final = 1.0
"""Time of motion over which that uncertainty is averaged: an ordinary move."""
CORRELATED_S: Final = 0.2
"""Errors of readings within this time have a common cause, such as one wrong instant, and count
once. Chosen: an ordinary ramp."""
STRANGE_SIGMAS: Final = 3.0
"""A reading that is further off than this counts less: a move went wrong."""
LAG_MAX_S: Final = 0.06
"""Largest lag that is corrected, in both directions: three times the lag that is assumed of a servo
(`lag_s`). Chosen: a horn that lags more is held up by something."""
DEAD_S: Final = 0.004
"""A smaller difference is not corrected, since commands would lose their slots on the line for
nothing. Chosen: on simulated servos that lag as assumed the estimate stays within 3 ms
(measured). A difference of twice as much is corrected fully."""
SPEED_DEG_S: Final = 20.0
"""From this speed on a reading says how late the horn is."""
STEADY_RATIO: Final = 0.7
"""A slower reading does so, too, where the horn has not been much faster shortly before: in the
ramps of a quick move the response model is least right."""
CLEAR_S: Final = 0.01
"""One whose scatter is as large as the way of this time counts half: in slow moves it says less."""
LATE_MAX_S: Final = 0.15
"""A horn that seems later than this counts as this late."""
TRUST_S: Final = 2.0
"""Seconds of motion over which it is judged whether the lag explains the errors. Chosen: a few
moves of a show."""
EXPLAINED_LEAST: Final = 0.3
EXPLAINED_SURE: Final = 0.6
"""A lag that explains less than the first share of the squared errors in motion is none, one that
explains the second is corrected fully. Measured: of a lag it explains nine tenths, of wrong ramps
or a weak motor less than a third; to send earlier for these made things worse."""

BOUND_RATIO: Final = 0.9
"""A lag of this share of the largest one is at its bound, as far as readings can tell."""
LAG_SURE_S: Final = 0.008
"""A lag is certain if its standard deviation is below this. Measured: 4 to 8 ms with a lag, in slow
shows 10 with play that looks like one."""
FOUND_S: Final = 0.02
"""From this error in motion on less is corrected, and none from twice as much on. Measured: 1 to
9 ms where the model of the servo is right, 20 to 580 ms with other ramps, another retarget, or a
weak motor."""
UNEXPLAINED_MAX_S: Final = 0.1
"""A reading counts as no further off than this, so that a wrong one, or a few behind a lost move,
are not taken for a wrong model. Chosen: more than twice `FOUND_S`."""
NAMED_S: Final = 0.0165
NAMED_READINGS: Final = 7
"""An error of this size that is left in motion, at so many readings in a row, is a wrong model of
the servo."""
NAMED_FROM: Final = 20
"""Readings in motion before that."""
LEFT_MAX_S: Final = 0.03
LEFT_S: Final = 2.0
"""An error counts as this large at the most, and is averaged over so much motion, so that a push or
a lost move is not taken for a wrong model. Measured at six readings in a row: up to 14 ms with a
push of 6 deg for half a second in motion (16 ms where commands are lost besides), 13 ms with play
or noise; 17 ms and more where the model is wrong and the horn is off by 30 ms."""
WORTH_DEG2_S: Final = 0.1
"""Weight of the assumption that a correction for the load helps: a third of a degree for a
second."""
WORTH_S: Final = 5.0
"""Seconds over which it is judged whether it does."""

WAY_DEG: Final = 0.5
"""A profile that has moved by this has a direction, and turns round if it comes back by as much.
Chosen: half of the play of worn gears, since the horn follows when all of it is taken up."""
PLAY_LEAST_DEG: Final = 0.05
"""Half of a play that is estimated smaller than this is none: half a unit of an LSS."""
SWING_RATIO: Final = 4.0
"""Nothing is corrected in swings shorter than this times the estimated half of the play, all in
those of twice as much. A horn stands within its play then, wherever the last larger swing left it:
its errors are no load, and show no more of the play than half of the swing, so that twice the
estimate is assumed. Measured: in swings of 1 to 4 deg with a play of 0.5 to 2 deg corrections made
RMS up to 1.13 times as large."""

SIZE: Final = len(USUAL)
PLAY: Final = 3
"""Index of the play in these."""


@dataclass(slots=True)
class HornEstimator:
    """How far the horn of one joint is behind its profile: by its load, its play, and its lag.

    A weight on an arm pulls with the sine and cosine of its angle, a spring or a wrong zero with a
    constant; the play of the gears holds the horn back on its way; a lag holds it back with its
    speed. These five numbers are estimated by a Kalman filter. The weight of a reading falls with
    the speed, by as much as the errors in motion have shown so far. So what is learnt of the load
    comes from rests and slow moves, where there are any.
    """

    _mean: list[float] = field(default_factory=lambda: [0.0] * SIZE)
    _cov: list[list[float]] = field(
        default_factory=lambda: [
            [usual * usual if row == column else 0.0 for column in range(SIZE)]
            for row, usual in enumerate(USUAL)
        ]
    )
    noise_deg2: float = NOISE_DEG**2
    """Variance of a reading at rest."""
    _readings: int = 0
    """From which the variance was learnt."""
    _timing_deg2: float = TIMING_S**2 * 100.0**2
    _timing_speed2: float = 100.0**2
    """Sums of squared errors and speeds in motion."""
    moving: int = 0
    """Readings in motion."""
    _left_deg2: float = 0.0
    _left_speed2: float = 1.0
    """Sums of squares in motion: of errors that neither load nor corrections take away, none of
    them counted as larger than `LEFT_MAX_S`, and of speeds."""
    _found: int = 0
    """Last readings in motion, in a row, at which these were large; kept at `NAMED_READINGS`."""
    _common: float = WORTH_DEG2_S
    _square: float = WORTH_DEG2_S
    """Sums of products of the load with the error that would be without a correction, and of its
    squares."""
    _plain: float = 0.0
    _left: float = 0.0
    """Sums of squared errors in seconds: without an extra lag, and with that estimated so far."""
    lag_s: float = 0.0
    """Lag besides the assumed one, within `LAG_MAX_S`."""
    early_s: float = 0.0
    """By how much commands are sent earlier: the lag, or 0 if it is small or no lag."""
    model_ratio: float = 1.0
    """Share of a correction that may be used: 1 unless the model of the servo is wrong.

    With other ramps or a weak motor a horn is still on its way where its model rests, and that is
    no load.
    """
    _rested_deg: float = 0.0
    """The largest load that was seen at rest, or nearly so."""
    worth_ratio: float = 1.0
    """Share of the load that is worth correcting: the one that makes the errors smallest."""

    # ---- what is known

    def load_deg(self, angle_deg: float, way: float) -> float:
        """Return by how much load and play keep the horn below its profile at an angle.

        `way` is the direction in which it turned last: 1, -1, or 0 if that is not known.
        """
        load_deg: float = sum(map(operator.mul, self._mean, _basis(angle_deg, way, 0.0)))
        return load_deg

    def correction_deg(self, angle_deg: float, way: float) -> float:
        """Return what may be added to a target: the load, or 0 if it is small or not sure.

        What is larger than any load seen at rest must be surer: in a first quick move, a wrong
        model looks like a load.
        """
        basis = _basis(angle_deg, way, 0.0)
        load_deg: float = sum(map(operator.mul, self._mean, basis))
        if abs(load_deg) <= SMALL_DEG:
            return 0.0
        unsure_deg, size_deg = self._unsure_deg(basis), abs(load_deg)
        seen_deg = min(size_deg * _share(size_deg, unsure_deg), self._rested_deg + UNSEEN_DEG)
        sure_deg = size_deg * _share(size_deg, UNSEEN_SIGMAS * unsure_deg)
        return math.copysign(max(seen_deg, sure_deg), load_deg)

    @property
    def late_s(self) -> float:
        """How much later or earlier than expected a horn may be that is on its course."""
        return STRANGE_SIGMAS * self.unexplained_s

    def free_deg(self, deg: float, late_deg: float, early_deg: float) -> tuple[float, float]:
        """Return by how much a horn in motion may be below or above its profile without a push.

        It may be late or early, and on one side of its play; anywhere if its model is wrong.
        """
        if self.model_ratio < 1.0:
            return -math.inf, math.inf
        play_deg = 2.0 * (self.half_play_deg + math.sqrt(self._cov[PLAY][PLAY]))
        low_deg, high_deg = min(late_deg, early_deg, deg), max(late_deg, early_deg, deg)
        return low_deg - deg - play_deg, high_deg - deg + play_deg

    def _unsure_deg(self, basis: tuple[float, ...]) -> float:
        spread = (sum(map(operator.mul, row, basis)) for row in self._cov)
        return math.sqrt(max(sum(map(operator.mul, spread, basis)), 0.0))

    @property
    def half_play_deg(self) -> float:
        """Half of the play of the gears, as far as it is known."""
        return abs(self._mean[PLAY])

    def _note_known(self) -> None:
        """Compute anew what a reading has changed and every move needs."""
        self.lag_s = min(max(self._mean[-1], -LAG_MAX_S), LAG_MAX_S)
        self.model_ratio = min(max(0.0, 2.0 - self.unexplained_s / FOUND_S), 1.0)
        self._note_worth()
        self.early_s = self._early_s()

    def _note_worth(self) -> None:
        helped_ratio = 2.0 * self._common / self._square - 1.0
        self.worth_ratio = min(max(helped_ratio, 0.0), 1.0) * self.model_ratio

    def _early_s(self) -> float:
        """Return the lag, or 0 if it is small or no lag.

        Where much is left that it does not explain, it is no lag either: a motor that is too weak
        is late on its way there, and on the way back it was sent too early.
        """
        lag_s = self.lag_s
        if abs(lag_s) <= DEAD_S:
            return 0.0
        unsure_s = math.sqrt(max(self._cov[-1][-1], 0.0))
        clear = min(max(0.0, abs(lag_s) / (DEAD_S + unsure_s) - 1.0), 1.0)
        if clear == 0.0:
            return 0.0
        sure = (self.explained_ratio - EXPLAINED_LEAST) / (EXPLAINED_SURE - EXPLAINED_LEAST)
        return lag_s * clear * min(max(0.0, sure), 1.0) * self.model_ratio

    @property
    def explained_ratio(self) -> float:
        """Share of the squared errors in motion that the lag has explained, before each was known.

        An error counts as time, so that fast moves do not outvote the others.
        """
        return 1.0 - self._left / self._plain if self._plain > 0.0 else 0.0

    @property
    def unexplained_s(self) -> float:
        """Error in motion, as a time, that neither load nor lag explains."""
        return math.sqrt(self._timing_deg2 / self._timing_speed2)

    @property
    def finding(self) -> str:
        """What the response model does not explain about this joint; empty: nothing."""
        unsure_s = math.sqrt(max(self._cov[-1][-1], 0.0))
        is_lag = unsure_s < LAG_SURE_S and self.explained_ratio > EXPLAINED_SURE
        if abs(self.lag_s) >= BOUND_RATIO * LAG_MAX_S and is_lag:
            return f"it lags {1e3 * self.lag_s:.0f} ms besides what its robot file says, or more"
        if self._found >= NAMED_READINGS:
            off_s = max(self.unexplained_s, NAMED_S)
            return (
                f"in motion it is {1e3 * off_s:.0f} ms off what its robot file says of its "
                f"servo, and neither load nor lag explains that"
            )
        return ""

    # ---- what readings say

    def judge_effect(self, plain_deg: float, effect_deg: float, elapsed_s: float) -> None:
        """Note the distance from the plan that the horn would have without corrections.

        `effect_deg` is by how much they have taken its profile off the plan.
        """
        weight = min(elapsed_s, CORRELATED_S)
        keep = math.exp(-weight / WORTH_S)
        most_deg = 2.0 * abs(effect_deg) + 1.0
        plain_deg = min(max(plain_deg, -most_deg), most_deg)
        rest = (1.0 - keep) * WORTH_DEG2_S
        self._common = keep * self._common + weight * plain_deg * effect_deg + rest
        self._square = keep * self._square + weight * effect_deg * effect_deg + rest
        self._note_worth()

    def take(
        self,
        measured_deg: float,
        course: tuple[float, float, float, float],
        way: float,
        elapsed_s: float,
        *,
        is_pushed: bool = False,
    ) -> None:
        """Use a reading, `elapsed_s` after the one before.

        One of a horn that `is_pushed` says nothing about load and lag.

        `course` is the angle of the profile without an extra lag, angle and speed with `lag_s`, and
        the largest speed of the last quarter of a second.
        """
        plain_deg, lagged_deg, speed_deg_s, recent_deg_s = course
        for index, drift in enumerate(DRIFT):
            self._cov[index][index] += drift * drift * min(elapsed_s, NOISE_S)
        basis = _basis(lagged_deg, way, speed_deg_s)
        one, sine, cosine, turned, speed = basis  # Written out: this is most of the work.
        spread = [
            a * one + b * sine + c * cosine + d * turned + e * speed for a, b, c, d, e in self._cov
        ]
        known = sum(map(operator.mul, spread, basis))
        load_deg: float = sum(map(operator.mul, self._mean, basis[:-1]))
        surprise_deg = lagged_deg - measured_deg - load_deg
        timing_s2 = max(self._timing_deg2 / self._timing_speed2, TIMING_LEAST_S**2)
        timing_deg2 = timing_s2 * recent_deg_s * recent_deg_s
        noise = (self.noise_deg2 + timing_deg2) * max(1.0, CORRELATED_S / max(elapsed_s, 1e-3))
        strange = surprise_deg * surprise_deg / (STRANGE_SIGMAS**2 * (known + noise))
        is_slow = timing_deg2 < self.noise_deg2
        late_deg = (self.lag_s - self._early_s()) * speed_deg_s
        total = known + noise * max(1.0, strange * strange)
        for row, own in enumerate(() if is_pushed else spread):
            self._mean[row] += own / total * surprise_deg
            pairs = zip(self._cov[row], spread, strict=True)
            self._cov[row] = [before - own * other / total for before, other in pairs]
        square_deg2 = max(surprise_deg * surprise_deg - known, 0.0)
        if is_slow and not is_pushed:
            self._note_rested(abs(lagged_deg - measured_deg), basis)
        if is_slow and recent_deg_s > 0.0:
            self._learn_noise(min(square_deg2, 4.0 * self.noise_deg2), elapsed_s)
        if recent_deg_s > SPEED_DEG_S:
            self._judge_model(surprise_deg + late_deg, recent_deg_s, elapsed_s)
        if recent_deg_s > 0.0:
            self._learn_timing(square_deg2, recent_deg_s, elapsed_s)
        is_moving = abs(speed_deg_s) >= min(SPEED_DEG_S, STEADY_RATIO * recent_deg_s) > 0.0
        if is_moving and not is_pushed:
            late_s = (plain_deg - measured_deg - load_deg) / speed_deg_s
            self._judge_lag(late_s, surprise_deg / speed_deg_s, speed_deg_s, elapsed_s)
        self._note_known()

    def _note_rested(self, off_deg: float, basis: tuple[float, ...]) -> None:
        load_deg: float = sum(map(operator.mul, self._mean, basis[:-1]))
        self._rested_deg = max(self._rested_deg, min(off_deg, abs(load_deg)))

    def rest(self, load_deg: float, angle_deg: float) -> None:
        """Use the distance of a horn that certainly rests on `angle_deg` from its profile."""
        self.doubt()
        profile_deg = angle_deg + load_deg
        course = profile_deg, profile_deg, 0.0, 0.0
        self.take(angle_deg, course, 0.0, CORRELATED_S)

    def doubt(self) -> None:
        """Note that the load may be another one now."""
        for index, usual in enumerate(USUAL[:-1]):
            self._cov[index][index] += usual * usual

    def note_scatter(self, change_deg: float, elapsed_s: float) -> None:
        """Note by how much two readings in a row of a horn at rest differ."""
        self._learn_noise(min(0.5 * change_deg * change_deg, 1.0), elapsed_s)

    def _learn_noise(self, square_deg2: float, elapsed_s: float) -> None:
        self._readings += 1
        share = max(min(elapsed_s / NOISE_S, 0.1), 1.0 / (self._readings + NOISE_READINGS))
        square_deg2 = max(square_deg2, NOISE_LEAST_DEG * NOISE_LEAST_DEG)
        self.noise_deg2 += share * (square_deg2 - self.noise_deg2)

    def _learn_timing(self, square_deg2: float, speed_deg_s: float, elapsed_s: float) -> None:
        """Note a squared error in motion: what is more than the scatter of readings is timing."""
        speed2 = speed_deg_s * speed_deg_s
        share = speed2 / (speed2 + self.noise_deg2 / FOUND_S**2)
        keep = math.exp(-share * min(elapsed_s, CORRELATED_S) / MOTION_S)
        square_deg2 = min(square_deg2, UNEXPLAINED_MAX_S**2 * speed2 + self.noise_deg2)
        timing_deg2 = keep * self._timing_deg2 + (1.0 - keep) * (square_deg2 - self.noise_deg2)
        self._timing_deg2 = max(timing_deg2, 0.0)
        self._timing_speed2 = keep * self._timing_speed2 + (1.0 - keep) * speed2

    def _judge_model(self, left_deg: float, speed_deg_s: float, elapsed_s: float) -> None:
        """Note an error in motion that load and corrections leave."""
        self.moving += 1
        most_deg = LEFT_MAX_S * speed_deg_s
        keep = math.exp(-min(elapsed_s, CORRELATED_S) / LEFT_S)
        square_deg2 = min(left_deg * left_deg, most_deg * most_deg)
        self._left_deg2 = keep * self._left_deg2 + (1.0 - keep) * square_deg2
        self._left_speed2 = keep * self._left_speed2 + (1.0 - keep) * speed_deg_s * speed_deg_s
        is_large = self._left_deg2 > NAMED_S * NAMED_S * self._left_speed2
        if self._found < NAMED_READINGS:
            self._found = self._found + 1 if is_large and self.moving > NAMED_FROM else 0

    def _judge_lag(
        self, late_s: float, left_s: float, speed_deg_s: float, elapsed_s: float
    ) -> None:
        scatter_s2 = self.noise_deg2 / (speed_deg_s * speed_deg_s)
        weight = CLEAR_S**2 / (CLEAR_S**2 + scatter_s2) * min(elapsed_s, CORRELATED_S)
        keep = math.exp(-weight / TRUST_S)
        self._plain = keep * self._plain + weight * min(late_s * late_s, LATE_MAX_S**2)
        self._left = keep * self._left + weight * min(left_s * left_s, LATE_MAX_S**2)


def _share(load_deg: float, unsure_deg: float) -> float:
    """Return what share of a load is corrected."""
    return min(max(0.0, load_deg / (SMALL_DEG + unsure_deg) - 1.0), 1.0)


def _basis(angle_deg: float, way: float, speed_deg_s: float) -> tuple[float, ...]:
    angle = math.radians(angle_deg)
    return 1.0, math.sin(angle), math.cos(angle), way, speed_deg_s


@dataclass(slots=True)
class Swing:
    """The swings of one profile, as its readings show them. Angles are servo degrees."""

    way: float = 0.0
    """Direction in which the profile moved last: 1, -1, or 0 at first."""
    _far_deg: float = 0.0
    """How far it has come in that direction."""
    _turn_deg: float = 0.0
    """Where that began."""
    _before_deg: float = math.inf
    """How far it moved in the direction before."""

    def take(self, profile_deg: float) -> None:
        """Note where the profile is."""
        ahead_deg = profile_deg - self._far_deg
        if ahead_deg * self.way > 0.0:
            self._far_deg = profile_deg
        elif abs(ahead_deg) > WAY_DEG:
            if self.way:
                self._before_deg = abs(self._far_deg - self._turn_deg)
            self._turn_deg, self._far_deg = self._far_deg, profile_deg
            self.way = math.copysign(1.0, ahead_deg)

    def way_of(self, way_deg: float) -> float:
        """Return the direction of a move that is `way_deg` long."""
        return math.copysign(1.0, way_deg) if abs(way_deg) > WAY_DEG else self.way

    def share(self, half_play_deg: float) -> float:
        """Return what share of a correction may be used: 0 if the horn may be within its play."""
        if half_play_deg < PLAY_LEAST_DEG:
            return 1.0
        swing_deg = max(self._before_deg, abs(self._far_deg - self._turn_deg))
        return min(max(swing_deg / (SWING_RATIO * half_play_deg) - 1.0, 0.0), 1.0)


GAP_S: Final = 0.1
"""Time that the first reading stands for."""


@dataclass(slots=True)
class DisturbanceEstimator:
    """Estimate for one joint, in servo degrees; times in seconds on one clock."""

    speed_max_deg_s: float
    standing_deg: float | None = None
    """Horn angle before the first reading, if it is known."""
    step_max_deg: float = math.inf
    """One reading changes the correction by no more than this."""
    horn: HornEstimator = field(default_factory=HornEstimator)
    offset_deg: float = 0.0
    """The correction: what is added to a target."""
    estimate_deg: float = 0.0
    """What the correction should be at the last reading."""
    readings: int = 0
    rejected: int = 0
    square_sum_deg2: float = 0.0
    error_deg: float = 0.0
    """Distance of the plan from the last reading."""
    model_error_deg: float = 0.0
    """Distance of the response model from the last reading."""
    error_max_deg: float = 0.0
    offset_max_deg: float = 0.0
    measured_deg: float | None = None
    read_s: float | None = None
    moved_deg: float = 0.0
    """The smaller of the last two changes of the reading; 0 if one leads back, as after a wrong
    reading."""
    _change_deg: float = 0.0
    _suspect: tuple[float, float] | None = field(default=None, repr=False)

    def take(
        self,
        measured_deg: float,
        read_s: float,
        *,
        expected_deg: float,
        planned_deg: float,
    ) -> float | None:
        """Use a reading that was taken at `read_s`; None: it was rejected.

        Return the time since the one before. `expected_deg` is the horn angle of the response
        model after all that was sent, `planned_deg` that of the plan.
        """
        if not self._is_plausible(measured_deg, read_s):
            self.rejected += 1
            return None
        elapsed_s = GAP_S if self.read_s is None else read_s - self.read_s
        if self.measured_deg is not None:
            self._note_change(measured_deg - self.measured_deg)
        self.measured_deg, self.read_s = measured_deg, read_s
        self.readings += 1
        self.error_deg = planned_deg - measured_deg
        self.model_error_deg = expected_deg - measured_deg
        self.square_sum_deg2 += self.error_deg * self.error_deg
        self.error_max_deg = max(self.error_max_deg, abs(self.error_deg))
        return elapsed_s

    def _note_change(self, change_deg: float) -> None:
        before_deg, self._change_deg = self._change_deg, change_deg
        is_on = change_deg * before_deg > 0.0
        self.moved_deg = min(abs(change_deg), abs(before_deg)) if is_on else 0.0

    def aim(self, target_deg: float, way: float, most_deg: float, share: float = 1.0) -> None:
        """Move the correction towards a share of what the load does at `target_deg`.

        It moves by `most_deg` at most; see `HornEstimator.load_deg` for `way`.
        """
        most_deg = min(most_deg, self.step_max_deg)
        correction_deg = share * self.horn.correction_deg(target_deg, way)
        change_deg = self.horn.worth_ratio * correction_deg - self.offset_deg
        self.correct(self.offset_deg + min(max(change_deg, -most_deg), most_deg))

    def note_estimate(self, angle_deg: float, way: float) -> None:
        """Note what the correction should be where the horn is."""
        self.estimate_deg = self.horn.worth_ratio * self.horn.correction_deg(angle_deg, way)

    def correct(self, offset_deg: float) -> None:
        """Set the correction, within its bounds."""
        self.offset_deg = min(max(offset_deg, -OFFSET_MAX_DEG), OFFSET_MAX_DEG)
        if not -self.offset_max_deg <= self.offset_deg <= self.offset_max_deg:
            self.offset_max_deg = abs(self.offset_deg)

    def stand_at(self, standing_deg: float) -> None:
        """Start anew with a horn that stands at `standing_deg`; the estimate is kept."""
        self.standing_deg = standing_deg
        self.measured_deg = self.read_s = self._suspect = None

    def take_over(self, earlier: DisturbanceEstimator) -> None:
        """Take over the estimate of the same joint."""
        self.horn, self.offset_deg = earlier.horn, earlier.offset_deg

    @property
    def last_deg(self) -> float | None:
        """The last horn angle that is known."""
        return self.standing_deg if self.measured_deg is None else self.measured_deg

    @property
    def error_rms_deg(self) -> float:
        return (self.square_sum_deg2 / self.readings) ** 0.5 if self.readings else 0.0

    def _is_plausible(self, measured_deg: float, read_s: float) -> bool:
        """Return whether a reading is accepted.

        It is if the horn can have reached it since the last accepted one, or if a second reading
        confirms it: a hand may have moved the horn.
        """
        if self.measured_deg is None or self.read_s is None:
            if self._suspect is None and self.standing_deg is not None:
                self._suspect = (self.standing_deg, read_s)
            elif self._suspect is None:
                return True
        elif self._could_reach(self.measured_deg, self.read_s, measured_deg, read_s):
            self._suspect = None
            return True
        suspect, self._suspect = self._suspect, (measured_deg, read_s)
        return suspect is not None and self._could_reach(*suspect, measured_deg, read_s)

    def _could_reach(self, from_deg: float, from_s: float, to_deg: float, to_s: float) -> bool:
        reach_deg = self.speed_max_deg_s * max(to_s - from_s, 0.0) + JUMP_MARGIN_DEG
        return abs(to_deg - from_deg) <= reach_deg


POINTS_MAX: Final = 1000
"""Chosen: one point for every pixel of a wide picture."""


@dataclass(slots=True)
class Trace:
    """Accepted readings, as `(seconds, planned angle, measured angle)` of the joint.

    Every `stride`-th is kept. When there are too many, every other one is dropped, so the points
    always cover the whole show evenly, and their number does not grow with it.
    """

    points: list[tuple[float, float, float]] = field(default_factory=list)
    stride: int = 1
    _count: int = 0

    def add(self, at_s: float, planned_deg: float, measured_deg: float) -> None:
        """Add the next reading; `at_s` counts from the start of the show, pauses included."""
        if self._count % self.stride == 0:
            self.points.append((at_s, planned_deg, measured_deg))
        self._count += 1
        if len(self.points) > POINTS_MAX:
            del self.points[1::2]
            self.stride *= 2
