"""The ease `command`: a joint moves as its servo does by itself on one command.

The command leaves at the key before; its T is the time from there to the key. The servo ramps to a
constant speed and comes to rest on the angle, by its ramps later than at the key (`t_law: cruise`;
with `exact`, at the key). The next command finds it where it is then, in motion or at rest.

A servo can carry a command out from where it is then, if the travel speed (distance / T) is within
its limit and is reached within T, and the ramp to it costs no more than the distance itself: a
servo that must first turn back would creep to its angle long after the key. Else the command gets
another T: that with which the servo is at its angle at the key, or as soon as its limits allow. The
next command finds it where it is then, so it is possible or not by that.

A joint whose command cannot be left to the servo, because it must be at rest before another ease or
the end of the show, is asked to go from where it is to the angle, and to rest there at the key:
`keep_time` makes of that what the limits allow.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from msgspec import Struct

from lss_motion.planning.trajectory.keys import PATH_DECIMALS, SAME_ANGLE_DEG
from lss_motion.robot.profile import (
    DURATION_MIN_MS,
    Piece,
    least_travel_speed,
    ramp_deg_s2,
    trapezoid,
    travel_speed,
)
from lss_motion.units import MS_PER_S, s_from_ms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint

    FloatArray = NDArray[np.float64]

ROUNDING_RATIO: Final = 1e-9
"""A command this little beyond a limit is at it."""

SURE_S: Final = 0.05
"""A servo in motion gets another T only where it is this far, at its speed, from its angle: if the
command arrives a millisecond late, its way and so its travel speed differ by 2 %. Chosen."""

LATER_S: Final = 0.01
"""Step in which a later instant is tried. Chosen: two control ticks of the servo."""


class CarriedOut(Struct, frozen=True):
    """What a servo makes of commands: its motion from the first of them to each rest, as cubics.

    Command n leads from key `moves[n]` to the next one; it is received at `received_s[n]` with the
    T `durations_s[n]`, or is left out if that is 0. `off_deg[n]`: how far from its angle the servo
    could stop when the next command replaces it, or is at the key if it cannot be there in time;
    else 0. `covered` are the moves that the cubics contain: those, and moves that are asked for
    from a joint in motion.
    """

    moves: NDArray[np.intp]
    received_s: FloatArray
    durations_s: FloatArray
    off_deg: FloatArray
    covered: NDArray[np.intp]
    starts_s: FloatArray
    ends_s: FloatArray
    cubics: FloatArray

    @property
    def spans_s(self) -> list[tuple[float, float]]:
        """The spans in which the servo moves on commands alone, from the first one to each rest."""
        found: list[tuple[float, float]] = []
        is_own = self.cubics[:, 3] == 0.0
        for from_s, to_s in zip(
            self.starts_s[is_own].tolist(), self.ends_s[is_own].tolist(), strict=True
        ):
            if found and from_s <= found[-1][1]:
                found[-1] = found[-1][0], to_s
            else:
                found.append((from_s, to_s))
        return found

    def after(self, times_s: FloatArray) -> FloatArray:
        """Return the times, those within the motion moved to its end."""
        if not len(self.starts_s):
            return times_s
        is_last = np.append(self.starts_s[1:] > self.ends_s[:-1], True)
        ends_s = self.ends_s[is_last]
        is_first = np.append(True, is_last[:-1])
        at = np.searchsorted(self.starts_s[is_first], times_s, side="right") - 1
        return np.where(at >= 0, np.maximum(times_s, ends_s[np.maximum(at, 0)]), times_s)


_NO_MOVES: Final = np.zeros(0, dtype=np.intp)
_NO_TIMES: Final = np.zeros(0)
NOTHING: Final = CarriedOut(
    moves=_NO_MOVES,
    received_s=_NO_TIMES,
    durations_s=_NO_TIMES,
    off_deg=_NO_TIMES,
    covered=_NO_MOVES,
    starts_s=_NO_TIMES,
    ends_s=_NO_TIMES,
    cubics=np.zeros((0, 4)),
)


def carried_out(
    reached_s: FloatArray,
    left_s: FloatArray,
    deg: FloatArray,
    is_command: NDArray[np.bool_],
    joint: Joint,
    end_s: float,
) -> CarriedOut:
    """Return what the servo of `joint` makes of the moves for which `is_command` is set.

    Keys are reached and left at path positions that are times. A move with another ease begins at
    rest, and the show ends at rest at `end_s`: the command before is not carried out if the servo
    would still be in motion then.
    """
    if not is_command.any():
        return NOTHING
    moves = np.flatnonzero(np.abs(np.diff(deg)) > SAME_ANGLE_DEG).tolist()
    end_s = max(end_s, float(left_s[-1]))
    until_s = [*left_s[moves[1:]].tolist(), end_s]
    refused: set[int] = set()
    while True:
        servo, last, before = _CommandedServo(joint), -1, len(refused)
        for move, next_s in zip(moves, until_s, strict=True):
            from_s, to_s = float(left_s[move]), float(reached_s[move + 1])
            if not is_command[move]:
                refused |= set() if servo.rests(from_s) else {last}
                continue
            last = move
            way_deg = float(deg[move]), float(deg[move + 1])
            span_s = from_s, to_s, next_s
            if move in refused or not servo.receive(move, span_s, way_deg):
                servo.hurry(move, from_s, to_s, way_deg[1])
        refused |= set() if servo.rests(end_s) else {last}
        if len(refused) == before:
            return servo.carried_out()


class _ReceivedCommand(NamedTuple):
    """A command of the author as the servo receives it. `off_deg`: see `CarriedOut`."""

    move: int
    received_s: float
    target_deg: float
    duration_s: float
    off_deg: float


class _CommandedServo:
    """The profile of a servo in joint degrees, command by command."""

    def __init__(self, joint: Joint) -> None:
        self._response, self._ramp = joint.response, ramp_deg_s2(joint)
        self._speed_max = joint.speed_max_deg_s
        self._is_timed = joint.drive == "timed"
        self._pieces: list[tuple[Piece, float, float]] = []
        """Each with its end and the coefficient of its cube."""
        self._rest_s = -math.inf
        self._covered: list[int] = []
        self._commands: list[_ReceivedCommand] = []
        self._left_out: list[_ReceivedCommand] = []

    def rests(self, at_s: float) -> bool:
        return self._rest_s <= at_s + 0.5 * 10.0**-PATH_DECIMALS

    def receive(
        self, move: int, span_s: tuple[float, float, float], way_deg: tuple[float, float]
    ) -> bool:
        """Take a command from the first angle of `way_deg`, if at rest, to the second.

        `span_s`: when it is sent, its key, and when the next one is sent. Returns False, and
        changes nothing, if it cannot be left to the servo.
        """
        from_s, to_s, next_s = span_s
        is_rest, target_deg = self.rests(from_s), way_deg[1]
        is_known = is_rest or self._response.retarget == "keep_speed"
        if not (self._is_timed and is_known):
            return False
        start = Piece(from_s, way_deg[0], 0.0, 0.0) if is_rest else self._state(from_s)
        duration_s = to_s - from_s
        speed = travel_speed(start, target_deg, duration_s, self._ramp, self._response)
        is_possible = self._can_carry_out(start, target_deg, speed, duration_s)
        if not is_possible:
            start = self._sure(start, target_deg, next_s)
            duration_s, speed = self._in_time(start, target_deg, to_s)
            if start.start_s >= next_s:
                return self._leave_out(move, span_s, target_deg)
        self._covered.append(move)
        self._replace(start.start_s)
        made = trapezoid(start, target_deg, min(speed, self._speed_max), self._ramp)
        starts_s = [round(piece.start_s, PATH_DECIMALS) for piece in made]
        for piece, start_s, end_s in zip(made, starts_s, starts_s[1:], strict=False):
            if end_s > start_s:
                state = (*piece.at(start_s), piece.accel_deg_s2)
                self._pieces.append((Piece(start_s, *state), end_s, 0.0))
        self._rest_s = starts_s[-1]
        off_deg = 0.0
        if self._rest_s < to_s:  # It began in motion, or its T includes the ramps.
            self._pieces.append((Piece(self._rest_s, target_deg, 0.0, 0.0), to_s, 0.0))
        elif not is_possible and not self.rests(to_s):
            off_deg = target_deg - self._state(to_s).position_deg
        self._commands.append(
            _ReceivedCommand(move, start.start_s, target_deg, duration_s, off_deg)
        )
        return True

    def _leave_out(self, move: int, span_s: tuple[float, float, float], target_deg: float) -> bool:
        """Send no command for this move, if the next one comes before the servo rests."""
        from_s, to_s, next_s = span_s
        if self.rests(next_s):
            return False
        off_deg = target_deg - self._state(to_s).position_deg
        self._covered.append(move)
        self._left_out.append(_ReceivedCommand(move, from_s, target_deg, 0.0, off_deg))
        return True

    def _sure(self, start: Piece, target_deg: float, next_s: float) -> Piece:
        """Return from where the servo can be given another T, `next_s` at the latest.

        Where it passes its angle, its speed would depend on the millisecond in which the command
        arrives.
        """
        while abs(target_deg - start.position_deg) < SURE_S * abs(start.speed_deg_s):
            at_s = min(round(start.start_s + LATER_S, PATH_DECIMALS), next_s)
            if self.rests(at_s):
                return Piece(at_s, self._commands[-1].target_deg, 0.0, 0.0)
            start = self._state(at_s)
            if at_s == next_s:
                break
        return start

    def _in_time(self, start: Piece, target_deg: float, to_s: float) -> tuple[float, float]:
        """Return T and travel speed with which the servo rests as late as it may.

        If it cannot be at its angle in time, it goes as fast as its limit allows.
        """
        within_s = max(to_s - start.start_s, 0.0)
        speed = least_travel_speed(start, target_deg, within_s, self._ramp)
        speed = min(speed, self._speed_max)
        if self._response.t_law == "cruise":
            needed_s = abs(target_deg - start.position_deg) / speed
        else:
            needed_s = trapezoid(start, target_deg, speed, self._ramp)[-1].start_s - start.start_s
        shortest_ms = max(math.floor(MS_PER_S * needed_s), DURATION_MIN_MS)
        shorter, longer = (
            (
                s_from_ms(ms),
                travel_speed(start, target_deg, s_from_ms(ms), self._ramp, self._response),
            )
            for ms in (shortest_ms, shortest_ms + 1)
        )
        return shorter if shorter[1] <= self._speed_max else longer

    def hurry(self, move: int, from_s: float, to_s: float, target_deg: float) -> None:
        """Go from the motion at `from_s` to rest at `to_s`; from a rest, that is another ease."""
        if self.rests(from_s):
            return
        start = self._state(from_s)
        self._replace(from_s)
        length_s = to_s - from_s
        secant = (target_deg - start.position_deg) / length_s
        square = (3.0 * secant - 2.0 * start.speed_deg_s) / length_s
        cube = (start.speed_deg_s - 2.0 * secant) / length_s**2
        self._pieces.append((start._replace(accel_deg_s2=2.0 * square), to_s, cube))
        self._rest_s = to_s
        self._covered.append(move)

    def _state(self, at_s: float) -> Piece:
        """Return the state at an instant before the servo rests."""
        piece, _, cube = self._pieces[self._at(at_s)]
        position_deg, speed_deg_s = piece.at(at_s)
        assert cube == 0.0, "what is asked for ends at rest"
        return Piece(at_s, position_deg, speed_deg_s, 0.0)

    def _at(self, at_s: float) -> int:
        return bisect_right(self._pieces, at_s, key=lambda part: part[0].start_s) - 1

    def _replace(self, at_s: float) -> None:
        """Forget what was to come from `at_s` on."""
        if self.rests(at_s):
            return
        before, state = self._commands[-1], self._state(at_s)
        stop_deg = state.position_deg + state.speed_deg_s * abs(state.speed_deg_s) / (
            2.0 * self._ramp
        )
        if not before.off_deg:
            self._commands[-1] = before._replace(off_deg=before.target_deg - stop_deg)
        self._pieces = [part for part in self._pieces if part[0].start_s < at_s]
        piece, _, cube = self._pieces[-1]
        self._pieces[-1] = piece, at_s, cube

    def _can_carry_out(
        self, start: Piece, target_deg: float, speed: float, duration_s: float
    ) -> bool:
        """Return whether the servo comes to its travel speed, within T, and does not creep."""
        v0, ramp = start.speed_deg_s, self._ramp
        stop_deg = start.position_deg + v0 * abs(v0) / (2.0 * ramp)
        sign = 1.0 if target_deg >= stop_deg else -1.0
        way_deg = sign * (target_deg - start.position_deg)
        ramp_s, slack = abs(speed - sign * v0) / ramp, 1.0 + ROUNDING_RATIO
        is_exact = self._response.t_law == "exact"
        return (
            speed <= slack * self._speed_max
            and speed * speed <= slack * (ramp * way_deg + 0.5 * v0 * v0)
            and ramp_s <= slack * duration_s
            and (is_exact or 0.5 * ramp * ramp_s * ramp_s <= slack * abs(way_deg))
        )

    def carried_out(self) -> CarriedOut:
        """Return all of it."""
        cubics = [
            [piece.position_deg, piece.speed_deg_s, 0.5 * piece.accel_deg_s2, cube]
            for piece, _, cube in self._pieces
        ]
        commands = sorted([*self._commands, *self._left_out])
        return CarriedOut(
            moves=np.array([command.move for command in commands], dtype=np.intp),
            received_s=np.array([command.received_s for command in commands]),
            durations_s=np.array([command.duration_s for command in commands]),
            off_deg=np.array([command.off_deg for command in commands]),
            covered=np.array(self._covered, dtype=np.intp),
            starts_s=np.array([piece.start_s for piece, _, _ in self._pieces]),
            ends_s=np.array([end_s for _, end_s, _ in self._pieces]),
            cubics=np.array(cubics).reshape(-1, 4),
        )
