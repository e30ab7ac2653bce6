"""The ease `command`: a joint moves as its servo does by itself on one command.

The command leaves at the key before; its T is the time from there to the key. The servo ramps to a
constant speed and comes to rest on the angle, by its ramps later than at the key (`t_law: cruise`;
with `exact`, at the key). The next command finds it where it is then, in motion or at rest.

A servo can carry a command out if distance / T is within the speed limit and its ramp ends within
T. Else the joint is asked to go from where it is to the angle, and to rest there at the key:
`keep_time` makes of that what the limits allow.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from lss_motion.robot.profile import Piece, ramp_deg_s2, trapezoid, travel_speed
from lss_motion.trajectory.keys import PATH_DECIMALS, SAME_ANGLE_DEG

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from lss_motion.robot.model import Joint

    FloatArray = NDArray[np.float64]

ROUNDING_RATIO: Final = 1e-9
"""A command this little beyond a limit is at it."""


@dataclass(frozen=True, slots=True)
class CarriedOut:
    """What a servo makes of commands: its motion from the first of them to each rest, as cubics.

    Command n leads from key `moves[n]` to the next one. `off_deg[n]`: how far from its angle the
    servo could stop when the next command replaces it; 0 if it comes to rest there. `covered` are
    the moves that the cubics contain: those, and moves that are asked for from a joint in motion.
    """

    moves: NDArray[np.intp]
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
    refused: set[int] = set()
    while True:
        servo, last, before = _Servo(joint), -1, len(refused)
        for move in moves:
            from_s, to_s = float(left_s[move]), float(reached_s[move + 1])
            if not is_command[move]:
                refused |= set() if servo.rests(from_s) else {last}
                continue
            last = move
            way_deg = float(deg[move]), float(deg[move + 1])
            if move in refused or not servo.receive(move, from_s, to_s, way_deg):
                servo.hurry(move, from_s, to_s, way_deg[1])
        refused |= set() if servo.rests(max(end_s, float(left_s[-1]))) else {last}
        if len(refused) == before:
            return servo.carried_out()


class _Servo:
    """The profile of a servo in joint degrees, command by command."""

    def __init__(self, joint: Joint) -> None:
        self._response, self._ramp = joint.response, ramp_deg_s2(joint)
        self._speed_max = joint.speed_max_deg_s
        self._is_timed = joint.drive == "timed"
        self._pieces: list[tuple[Piece, float, float]] = []
        """Each with its end and the coefficient of its cube."""
        self._rest_s = -math.inf
        self._covered: list[int] = []
        self._commands: list[tuple[int, float, float]] = []
        """Move, target, and how far from it the servo could stop when it is replaced."""

    def rests(self, at_s: float) -> bool:
        return self._rest_s <= at_s + 0.5 * 10.0**-PATH_DECIMALS

    def receive(self, move: int, from_s: float, to_s: float, way_deg: tuple[float, float]) -> bool:
        """Take a command from the first angle of `way_deg`, if at rest, to the second.

        Returns False, and changes nothing, if the servo cannot carry it out.
        """
        is_rest, target_deg = self.rests(from_s), way_deg[1]
        start = Piece(from_s, way_deg[0], 0.0, 0.0) if is_rest else self._state(from_s)
        speed = travel_speed(start, target_deg, to_s - from_s, self._ramp, self._response)
        is_known = is_rest or self._response.retarget == "keep_speed"
        if not (self._is_timed and is_known and self._cruises(start, target_deg, speed, to_s)):
            return False
        self._replace(from_s)
        made = trapezoid(start, target_deg, min(speed, self._speed_max), self._ramp)
        starts_s = [round(piece.start_s, PATH_DECIMALS) for piece in made]
        for piece, start_s, end_s in zip(made, starts_s, starts_s[1:], strict=False):
            if end_s > start_s:
                state = (*piece.at(start_s), piece.accel_deg_s2)
                self._pieces.append((Piece(start_s, *state), end_s, 0.0))
        self._rest_s = starts_s[-1]
        if self._rest_s < to_s:  # It began in motion, or its T includes the ramps.
            self._pieces.append((Piece(self._rest_s, target_deg, 0.0, 0.0), to_s, 0.0))
        self._covered.append(move)
        self._commands.append((move, target_deg, 0.0))
        return True

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
        move, target_deg, _ = self._commands[-1]
        state = self._state(at_s)
        stop_deg = state.position_deg + state.speed_deg_s * abs(state.speed_deg_s) / (
            2.0 * self._ramp
        )
        self._commands[-1] = move, target_deg, target_deg - stop_deg
        self._pieces = [part for part in self._pieces if part[0].start_s < at_s]
        piece, _, cube = self._pieces[-1]
        self._pieces[-1] = piece, at_s, cube

    def _cruises(self, start: Piece, target_deg: float, speed: float, to_s: float) -> bool:
        """Return whether the servo comes to its travel speed, and before the command is to end."""
        v0, ramp = start.speed_deg_s, self._ramp
        stop_deg = start.position_deg + v0 * abs(v0) / (2.0 * ramp)
        sign = 1.0 if target_deg >= stop_deg else -1.0
        square = ramp * sign * (target_deg - start.position_deg) + 0.5 * v0 * v0
        ramp_s, slack = abs(speed - sign * v0) / ramp, 1.0 + ROUNDING_RATIO
        return (
            speed <= slack * self._speed_max
            and speed * speed <= slack * square
            and ramp_s <= slack * (to_s - start.start_s)
        )

    def carried_out(self) -> CarriedOut:
        """Return all of it."""
        cubics = [
            [piece.position_deg, piece.speed_deg_s, 0.5 * piece.accel_deg_s2, cube]
            for piece, _, cube in self._pieces
        ]
        return CarriedOut(
            moves=np.array([move for move, _, _ in self._commands], dtype=np.intp),
            off_deg=np.array([off_deg for _, _, off_deg in self._commands]),
            covered=np.array(self._covered, dtype=np.intp),
            starts_s=np.array([piece.start_s for piece, _, _ in self._pieces]),
            ends_s=np.array([end_s for _, end_s, _ in self._pieces]),
            cubics=np.array(cubics).reshape(-1, 4),
        )
