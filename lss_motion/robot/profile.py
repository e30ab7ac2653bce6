"""How a servo in EM1 moves on one `D…T…`: a ramp to a travel speed, a cruise, a ramp to rest.

Angles are servo angles in degrees, instants are seconds on one clock. `robot.model.Response` names
the source of each assumption. `planning.program.response` computes the same over many commands and
servos.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

from lss_motion.robot.servo_models import ramp_of_steps, ramp_steps, ramp_steps_max

if TYPE_CHECKING:
    from collections.abc import Iterator

    from lss_motion.robot.model import Joint, Response

DURATION_MIN_MS: Final = 10
"""The smallest T that is sent: two control ticks of the servo. Only a landing that comes back to
where the profile is passing could need less, and a horn that is elsewhere would jerk."""

EXACT_LAW_STEPS: Final = 40
"""Bisection steps for the travel speed under `t_law: exact`: 2⁻⁴⁰ of the top speed is far below
what one wire unit can express."""


def ramp_setting_deg_s2(joint: Joint) -> float:
    """Return the AA and AD of a timed joint's servo: its limit, as far as the setting reaches.

    With its ramps at the joint's own limit the servo never exceeds it, whatever it receives.
    """
    model = joint.model
    steps = ramp_steps(model, joint.accel_max_deg_s2, joint.ramp_ratio)
    return ramp_of_steps(model, min(max(steps, 1), ramp_steps_max(model)))


def ramp_deg_s2(joint: Joint) -> float:
    """Return the ramp that the servo of a timed joint drives with its setting."""
    return ramp_setting_deg_s2(joint) * joint.ramp_ratio


def profile_lead_s(joint: Joint) -> float:
    """Return by how much a joint's profile is earlier than its horn.

    This is the lag of its servo and, unless its model includes it, half of the control tick at
    which the servo takes up a command.
    """
    half_tick_s = 0.0 if joint.drive == "streamed" else 0.5 * joint.response.loop_s
    return joint.response.lag_s + half_tick_s


class Piece(NamedTuple):
    """A part of a profile with constant acceleration, from `start_s` until the next piece."""

    start_s: float
    position_deg: float
    speed_deg_s: float
    accel_deg_s2: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`."""
        dt = time_s - self.start_s
        return (
            self.position_deg + dt * (self.speed_deg_s + 0.5 * self.accel_deg_s2 * dt),
            self.speed_deg_s + self.accel_deg_s2 * dt,
        )


def trapezoid(
    start: Piece, target_deg: float, travel_deg_s: float, ramp_deg_s2: float
) -> list[Piece]:
    """Return the pieces of a move that begins at `start` and ends at rest on `target_deg`.

    A start that is faster than `travel_deg_s` first brakes down to it. A start that is too fast to
    stop on the target stops beyond it and comes back, as a profile with bounded ramps must.
    """
    position, speed = start.position_deg, start.speed_deg_s
    stop_deg = position + speed * abs(speed) / (2.0 * ramp_deg_s2)
    sign = 1.0 if target_deg >= stop_deg else -1.0
    distance, v0 = sign * (target_deg - position), sign * speed
    square = ramp_deg_s2 * distance + 0.5 * v0 * v0
    reachable = square**0.5 if square > 0.0 else 0.0
    peak = min(reachable, travel_deg_s)
    is_faster = peak >= v0
    ramp_in_s = (peak - v0 if is_faster else v0 - peak) / ramp_deg_s2
    ramp_out_s = peak / ramp_deg_s2
    cruised = distance - (0.5 * (v0 + peak) * ramp_in_s + 0.5 * peak * ramp_out_s)
    cruise_s = cruised / peak if cruised > 0.0 < peak else 0.0

    pieces: list[Piece] = []
    now = start.start_s
    accel_in = sign * ramp_deg_s2 if is_faster else -sign * ramp_deg_s2
    for duration_s, accel in ((ramp_in_s, accel_in), (cruise_s, 0.0)):
        if duration_s > 0.0:
            pieces.append(Piece(now, position, speed, accel))
            passed_s = now + duration_s - now  # As instants are rounded.
            position += passed_s * (speed + 0.5 * accel * passed_s)
            now += duration_s
            speed = sign * peak
    if ramp_out_s > 0.0:
        pieces.append(Piece(now, position, speed, -sign * ramp_deg_s2))
        now += ramp_out_s
    pieces.append(Piece(now, target_deg, 0.0, 0.0))
    return pieces


def travel_speed(
    start: Piece, target_deg: float, duration_s: float, ramp_deg_s2: float, response: Response
) -> float:
    """Return the travel speed of the servo for `D target T duration`, before its speed limit."""
    if response.t_law == "cruise":
        return abs(target_deg - start.position_deg) / duration_s
    return least_travel_speed(start, target_deg, duration_s, ramp_deg_s2)


def least_travel_speed(
    start: Piece, target_deg: float, duration_s: float, ramp_deg_s2: float
) -> float:
    """Return the slowest travel speed with which a move from `start` ends within `duration_s`.

    Where none does, it is above that of any servo.
    """
    slow, fast = 0.0, 1e4
    for _ in range(EXACT_LAW_STEPS):
        middle = 0.5 * (slow + fast)
        end_s = trapezoid(start, target_deg, middle, ramp_deg_s2)[-1].start_s
        slow, fast = (middle, fast) if end_s - start.start_s > duration_s else (slow, middle)
    return fast


class Profile:
    """The profile of one servo, command by command. Instants passed to it must not decrease."""

    def __init__(
        self,
        position_deg: float,
        *,
        ramp_deg_s2: float,
        speed_max_deg_s: float,
        response: Response,
        start_s: float = float("-inf"),
    ) -> None:
        self.ramp_deg_s2 = ramp_deg_s2
        self._speed_max_deg_s = speed_max_deg_s
        self._response = response
        self._pieces: list[Piece] = [Piece(start_s, position_deg, 0.0, 0.0)]

    def at(self, time_s: float) -> tuple[float, float]:
        """Return position and speed at `time_s`; before the known history, its first position."""
        for start_s, position_deg, speed_deg_s, accel_deg_s2 in reversed(self._pieces):
            if start_s > time_s:
                continue
            if not (speed_deg_s or accel_deg_s2):
                return position_deg, 0.0
            dt = time_s - start_s  # As `Piece.at`, without a call.
            return (
                position_deg + dt * (speed_deg_s + 0.5 * accel_deg_s2 * dt),
                speed_deg_s + accel_deg_s2 * dt,
            )
        return self._pieces[0].position_deg, 0.0

    @property
    def target_deg(self) -> float:
        """Where the profile comes to rest if the servo receives no other command."""
        return self._pieces[-1].position_deg

    def state(self, time_s: float) -> Piece:
        """Return the state from which a command received at `time_s` starts."""
        position_deg, speed_deg_s = self.at(time_s)
        if self._response.retarget == "from_rest":
            speed_deg_s = 0.0
        return Piece(time_s, position_deg, speed_deg_s, 0.0)

    def retarget(self, received_s: float, target_deg: float, duration_s: float | None) -> None:
        """Apply `D target [T duration]` received at `received_s`, from the motion at that instant.

        The motion planned after it is dropped.
        """
        start = self.state(received_s)
        travel = self._speed_max_deg_s
        if duration_s is not None and target_deg != start.position_deg:
            asked = travel_speed(start, target_deg, duration_s, self.ramp_deg_s2, self._response)
            travel = min(travel, asked)
        pieces = self._pieces
        while pieces and pieces[-1].start_s >= received_s:
            pieces.pop()
        pieces += trapezoid(start, target_deg, travel, self.ramp_deg_s2)

    def forget_before(self, time_s: float) -> None:
        """Drop history that ends before `time_s`, so that memory stays bounded."""
        pieces = self._pieces
        while len(pieces) > 1 and pieces[1].start_s <= time_s:
            del pieces[0]

    def pieces(self) -> Iterator[Piece]:
        return iter(self._pieces)

    def copy(self) -> Profile:
        """Return an independent profile with the same history."""
        twin = Profile.__new__(Profile)
        twin.ramp_deg_s2 = self.ramp_deg_s2
        twin._speed_max_deg_s = self._speed_max_deg_s  # noqa: SLF001  (its own)
        twin._response = self._response  # noqa: SLF001
        twin._pieces = [*self._pieces]  # noqa: SLF001
        return twin
